//! How probable it is that a result is wrong.
//!
//! `P(error > 3 mm) = 1 / (1 + exp(-z))`, `z = intercept + sum_r c_r(x_r)`, with a curve `c_r` that never falls for each [`Risk`] of
//! the [`Evidence`]. Intercept and curves are fitted by `experiments silence` on registrations whose truth is known, and read from
//! `reliability.toml`; the same command measures how far the probability can be believed on others.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::one_surface::facing_one_way;
use super::{Doubt, Evidence, Quality, QualityError, RegistrationInput, RegistrationResult};
use crate::mesh::{PolygonMesh, Vec3, spikes};

/// Root mean square error over the vertices that the scan shows above which a result counts as wrong, millimetres on a face
/// (of 67 mm root mean square size); on other subjects the same share of the size: [`Reliability::wrong_mm`].
pub const WRONG_MM: f64 = 3.0;
const FACE_MM: f64 = 67.0;

/// Median distance from the scan, as a share of the size (0.6 mm on a face), above which nothing was calibrated: such a result is
/// as probably wrong as right at least. What lies off the scan is off the truth, as that of a rigid template.
const OFF_THE_SCAN: f64 = 0.009;

/// [`Coverage::contradicted`](super::Coverage::contradicted) and [`Coverage::unseen`](super::Coverage::unseen) above which nothing was
/// calibrated either: right results of the sets of `experiments silence` have 0.14 and 0.69 at most.
const CONTRADICTED: f64 = 0.25;
const UNSEEN: f64 = 0.75;

/// 1st percentile of the edges' lengths after over before, below which parts have fallen together, as those do that nothing holds.
const COLLAPSED: f64 = 0.1;

/// How far a vertex stands out at least, as a share of the size (10 mm on a face), to be one of the [`spikes`], after which a result is as
/// probably wrong as right at least: no median or percentile shows a few of them. Edges within an open or a pursed mouth grow by 4 mm.
const SPIKE: f64 = 0.15;

/// [`StartSearch::rival`](super::StartSearch::rival) above which another place fits as well, such as a second face, and what is then
/// the least probability: 3 of 14 such starts of the design set were wrong.
const RIVAL: (f64, f64) = (0.88, 0.2);

/// Least probability where the shapes [tell](super::Handedness::Shapes) that the scan is mirrored; the design set has too few of those
/// to calibrate by.
const MIRRORED: f64 = 0.9;

/// What a result says of itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reliability {
    /// Probability that the error exceeds `wrong_mm`.
    #[serde(rename = "error_probability")]
    pub probability: f64,
    /// [`WRONG_MM`] of a subject of this size, millimetres.
    pub wrong_mm: f64,
    /// What speaks for that, most telling first; empty unless the probability is above the threshold of the calibration.
    pub doubts: Vec<Doubt>,
    /// What it was computed from.
    pub evidence: Evidence,
}

/// Measures a result on the scan, facing as it was registered, and judges it. `input` is that of the registration.
///
/// # Errors
/// As [`Quality::measure`].
pub fn assess(
    input: &RegistrationInput<'_>,
    result: &RegistrationResult,
) -> Result<(Quality, Reliability), QualityError> {
    let turned = (result.template_repair.turned > 0).then(|| facing_one_way(input));
    let input = RegistrationInput { template: turned.as_ref().unwrap_or(input.template), ..*input };
    let quality = Quality::counted(&input, &result.hidden, &result.scan, &result.positions, result.untangled)?;
    let reliability = Reliability::of(&input, result, &quality);
    Ok((quality, reliability))
}

impl Reliability {
    fn of(input: &RegistrationInput<'_>, result: &RegistrationResult, quality: &Quality) -> Self {
        static CALIBRATION: LazyLock<Calibration> =
            LazyLock::new(|| toml::from_str(include_str!("reliability.toml")).expect("proven: a test reads it"));
        let evidence = Evidence::new(input, result, quality);
        let off = evidence.coverage.distance > OFF_THE_SCAN;
        let rival = evidence.start_rival > RIVAL.0;
        let mirrored = evidence.handedness.against() > 0.0;
        let contradicted = evidence.coverage.contradicted > CONTRADICTED;
        let unseen = evidence.coverage.unseen > UNSEEN;
        let collapsed = quality.mesh.stretch.p1 < COLLAPSED;
        let known = [
            (mirrored, Risk::Mirrored, MIRRORED),
            (contradicted, Risk::Contradicted, 0.5),
            (unseen, Risk::Unseen, 0.5),
            (collapsed, Risk::Squeeze, 0.5),
            (off, Risk::Distance, 0.5),
            (rival, Risk::StartRival, RIVAL.1),
        ];
        let known = known.into_iter().filter(|k| k.0);
        let spikes = count_spikes(input.template, &result.positions, SPIKE * evidence.size);
        let least = if spikes > 0 { 0.5 } else { 0.0 };
        let probability = known.clone().map(|k| k.2).fold(CALIBRATION.probability(&evidence).max(least), f64::max);
        let mut signs: Vec<Risk> = known.map(|k| k.1).collect();
        if probability > CALIBRATION.threshold {
            signs.extend(CALIBRATION.signs(|risk| risk.of(&evidence)));
        }
        let mut doubts: Vec<Doubt> = Vec::new();
        if spikes > 0 {
            doubts.push(Doubt::Spikes { vertices: spikes, longest: quality.mesh.stretch.max });
        }
        for doubt in signs.into_iter().map(|risk| Doubt::new(risk, &evidence, input, result, quality)) {
            // Two risks may be one doubt.
            if !doubts.iter().any(|known| known.name() == doubt.name()) {
                doubts.push(doubt);
            }
        }
        Self { probability, wrong_mm: WRONG_MM / FACE_MM * evidence.size, doubts, evidence }
    }

    /// Whether it should be looked at.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        !self.doubts.is_empty()
    }

    /// The length that the error exceeds with this probability, for people.
    #[must_use]
    pub fn wrong_length(&self) -> String {
        format!("{:.*} mm", usize::from(self.wrong_mm < 10.0), self.wrong_mm)
    }
}

fn count_spikes(template: &PolygonMesh, positions: &[Vec3], least: f64) -> usize {
    let polygons = (0..template.polygon_count()).map(|f| template.polygon(f));
    let sides = polygons.flat_map(|p| (0..p.len()).map(|k| [p[k], p[(k + 1) % p.len()]]));
    spikes(sides, &template.positions, positions, least)
}

/// The risks and, each, its number from the evidence.
macro_rules! risks {
    ($evidence:ident: $($(#[$doc:meta])* $risk:ident => $value:expr,)+) => {
        /// A number of the evidence that grows with the risk of an error.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Risk {
            $($(#[$doc])* $risk,)+
        }

        impl Risk {
            /// All of them.
            pub const ALL: [Self; [$(stringify!($risk)),+].len()] = [$(Self::$risk),+];

            /// The number.
            #[must_use]
            pub fn of(self, $evidence: &Evidence) -> f64 {
                match self {
                    $(Self::$risk => $value,)+
                }
            }
        }
    };
}

risks! { e:
    /// Loss of the searched start.
    StartLoss => e.start_loss,
    /// How close another pose comes.
    StartRival => e.start_rival,
    /// Share of vertices that the scan does not show.
    Unseen => e.coverage.unseen,
    /// [`Coverage::contradicted`](super::Coverage::contradicted).
    Contradicted => e.coverage.contradicted,
    /// [`Coverage::turn`](super::Coverage::turn).
    Turn => e.coverage.turn,
    /// [`Coverage::scan_missed`](super::Coverage::scan_missed).
    ScanMissed => e.coverage.scan_missed,
    /// [`Coverage::distance`](super::Coverage::distance).
    Distance => e.coverage.distance,
    /// [`Coverage::distance_p90`](super::Coverage::distance_p90).
    DistanceSpread => e.coverage.distance_p90,
    /// [`Evidence::landmark_rms`].
    LandmarkRms => e.landmark_rms,
    /// [`Evidence::landmark_worst`].
    LandmarkWorst => e.landmark_worst,
    /// [`Evidence::landmark_freedom`].
    LandmarkFreedom => e.landmark_freedom,
    /// [`Evidence::landmark_suspects`].
    LandmarkSuspects => e.landmark_suspects,
    /// One over one more than the number of landmarks.
    FewLandmarks => 1.0 / (1.0 + e.landmarks as f64),
    /// One without shapes, else zero.
    NoShapes => f64::from(u8::from(e.shapes == 0)),
    /// [`Evidence::beyond_shapes`].
    BeyondShapes => e.beyond_shapes,
    /// [`Evidence::beyond_shapes_p95`].
    BeyondShapesSpread => e.beyond_shapes_p95,
    /// [`Evidence::weight_energy`].
    WeightEnergy => e.weight_energy,
    /// [`Evidence::weight_worst`].
    WeightWorst => e.weight_worst,
    /// [`Evidence::weight_uncertainty`].
    WeightUncertainty => e.weight_uncertainty,
    /// [`Evidence::flipped`].
    Flipped => e.flipped,
    /// [`Evidence::intersections`].
    Intersections => e.intersections,
    /// [`Evidence::stretch`].
    Stretch => e.stretch,
    /// [`Evidence::squeeze`].
    Squeeze => e.squeeze,
    /// One minus [`Evidence::curvature_kept`].
    CurvatureLost => 1.0 - e.curvature_kept,
    /// How far the logarithm of [`Evidence::scale`] is from 0.
    Scale => e.scale.max(f64::MIN_POSITIVE).ln().abs(),
    /// [`Evidence::last_motion`].
    LastMotion => e.last_motion,
    /// [`Handedness::against`](super::Handedness::against).
    Mirrored => e.handedness.against().max(0.0),
}

/// The fitted curves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Probability above which a result is doubtful.
    pub threshold: f64,
    /// Log-odds of a result that no risk speaks against.
    pub intercept: f64,
    /// One curve for each risk that says something.
    pub risks: Vec<RiskCurve>,
}

/// What a risk adds to the log-odds: `sum_j weights[j] ramp_j(x)`, where ramp `j` rises from 0 to 1 between knots `j` and `j + 1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RiskCurve {
    /// Which number of the evidence.
    pub risk: Risk,
    /// Ascending: quantiles of the results that it was fitted to, the last three `0.8`, `0.9` and `0.97`.
    pub knots: Vec<f64>,
    /// One less than knots, none negative.
    pub weights: Vec<f64>,
}

impl RiskCurve {
    /// Ramp `j` at `x`.
    #[must_use]
    pub fn ramp(&self, j: usize, x: f64) -> f64 {
        ((x - self.knots[j]) / (self.knots[j + 1] - self.knots[j])).clamp(0.0, 1.0)
    }

    /// Whether four of five of the results that it was fitted to have less.
    fn is_unusual(&self, x: f64) -> bool {
        x > self.knots[self.knots.len().saturating_sub(3)]
    }

    /// The curve at `x`.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.weights.iter().enumerate().map(|(j, w)| w * self.ramp(j, x)).sum()
    }
}

impl Calibration {
    /// Probability that the error exceeds [`WRONG_MM`] on a face, the same share of the size on other subjects.
    #[must_use]
    pub fn probability(&self, evidence: &Evidence) -> f64 {
        1.0 / (1.0 + (-self.log_odds(evidence)).exp())
    }

    /// `z` of the head comment.
    #[must_use]
    pub fn log_odds(&self, evidence: &Evidence) -> f64 {
        self.intercept + self.risks.iter().map(|curve| curve.at(curve.risk.of(evidence))).sum::<f64>()
    }

    /// The risks that add most, one at least: those that add half as much as the greatest, of what is greater than usual if anything is.
    fn signs(&self, of: impl Fn(Risk) -> f64) -> Vec<Risk> {
        let unusual = |curve: &RiskCurve| curve.is_unusual(of(curve.risk));
        let any = self.risks.iter().any(unusual);
        let among = self.risks.iter().filter(|curve| !any || unusual(curve));
        let mut added: Vec<(f64, Risk)> = among.map(|curve| (curve.at(of(curve.risk)), curve.risk)).collect();
        added.sort_by(|a, b| b.0.total_cmp(&a.0));
        let greatest = added.first().map_or(0.0, |a| a.0);
        added.into_iter().take_while(|a| a.0 >= 0.5 * greatest).map(|a| a.1).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calibration_can_be_read_and_more_of_a_bad_sign_never_helps() {
        let calibration: Calibration = toml::from_str(include_str!("reliability.toml")).unwrap();
        assert!(calibration.threshold > 0.0 && calibration.threshold < 1.0 && !calibration.risks.is_empty());
        for curve in &calibration.risks {
            assert!(curve.knots.is_sorted_by(|a, b| a < b), "{curve:?}");
            assert_eq!(curve.weights.len() + 1, curve.knots.len());
            assert!(curve.weights.iter().all(|w| *w >= 0.0), "{curve:?}");
            let (first, last) = (curve.knots[0], curve.knots[curve.knots.len() - 1]);
            let values = [first - 1.0, first, 0.5 * (first + last), last, last + 1.0].map(|x| curve.at(x));
            assert!(values.is_sorted() && values[0] == 0.0, "{curve:?}");
            assert!((values[4] - curve.weights.iter().sum::<f64>()).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_usual_is_no_sign_beside_what_is_not() {
        let curve = |risk, first| RiskCurve { risk, knots: vec![0.0, 1.0, 2.0, 3.0], weights: vec![first, 0.5, 0.5] };
        let risks = vec![curve(Risk::Turn, 5.0), curve(Risk::Unseen, 0.0), curve(Risk::Stretch, 0.0)];
        let calibration = Calibration { threshold: 0.1, intercept: 0.0, risks };
        let signs = |turn: f64, unseen: f64, stretch: f64| {
            calibration.signs(|risk| match risk {
                Risk::Turn => turn,
                Risk::Unseen => unseen,
                _ => stretch,
            })
        };
        assert_eq!(signs(1.0, 2.0, 0.0), [Risk::Unseen]);
        assert_eq!(signs(1.0, 2.0, 3.0), [Risk::Stretch, Risk::Unseen]);
        assert_eq!(signs(1.0, 0.5, 1.0), [Risk::Turn]);
    }

    #[test]
    fn a_ramp_rises_from_knot_to_knot() {
        let curve = RiskCurve { risk: Risk::Turn, knots: vec![1.0, 2.0, 4.0], weights: vec![3.0, 5.0] };
        assert_eq!([0.0, 1.5, 2.0, 3.0, 9.0].map(|x| curve.at(x)), [0.0, 1.5, 3.0, 5.5, 8.0]);
    }
}
