//! What makes a result doubtful, in words: what was seen and what to do about it.
//!
//! [`Reliability`](super::Reliability) decides whether a result is doubtful and which risks speak for it; here each of them becomes
//! a sentence with its number.

use serde::Serialize;

use super::evidence::intersections_grown;
use super::{Evidence, Quality, RegistrationInput, RegistrationResult, Risk};
use crate::landmark::Landmark;

/// A reason to look at a result before it is used. Distances are millimetres, shares from 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "sign")]
pub enum Doubt {
    /// The pose that the search found is not much better than others, or fits badly.
    Start {
        /// Poses tried.
        tried: usize,
        /// Share of the template's surface that the best of them matches.
        share: f64,
        /// Root mean square distance of the matched part.
        residual: f64,
        /// [`StartSearch::rival`](super::StartSearch::rival).
        rival: f64,
    },
    /// The scan shows little of the template.
    LittleSeen {
        /// Share of the vertices that it shows.
        share: f64,
    },
    /// The scan has a surface where the template is, but elsewhere or facing elsewhere.
    Contradicted {
        /// Share of such vertices.
        share: f64,
    },
    /// The template does not lie on all of the scan's surface that is over it.
    ScanMissed {
        /// Share of that surface.
        share: f64,
    },
    /// The vertices near the scan are not on it.
    HighResidual {
        /// Their median distance.
        median: f64,
    },
    /// Landmarks are not where they were said to be.
    Landmarks {
        /// Root mean square distance; a landmark of standard deviation sigma counts `1 / sigma^2`.
        rms: f64,
        /// The one that is farthest off.
        worst: String,
        /// How far that is.
        distance: f64,
    },
    /// Landmarks are few, or lie so that they leave the pose open.
    FewLandmarks {
        /// How many there are.
        count: usize,
    },
    /// Without shapes, nothing says where along smooth skin a vertex belongs.
    NoShapes,
    /// The result is far from anything that the shapes can make.
    BeyondShapes {
        /// Root mean square distance from it.
        rms: f64,
    },
    /// Blendshape weights are far from what they stand for.
    ExtremeWeights {
        /// Mean square weight, in prior variances; usually less than 0.4, as shapes that the scan says nothing of stay at 0.
        energy: f64,
        /// The most extreme one.
        worst: String,
        /// It, in prior standard deviations.
        deviations: f64,
    },
    /// The data leave the weights open.
    LooseWeights {
        /// What their standard deviations come to at a vertex.
        shift: f64,
    },
    /// Triangles turned over, or pass through each other.
    ManyFolds {
        /// How many are turned over.
        folded: usize,
        /// Pairs that passed through each other at the last step, more than at rest.
        intersections: usize,
    },
    /// Edges became much longer or shorter.
    Stretched {
        /// 99th percentile of length after over before.
        longest: f64,
        /// 1st percentile.
        shortest: f64,
    },
    /// Vertices stand out from their neighbours.
    Spikes {
        /// How many.
        vertices: usize,
        /// Largest length of an edge after over before.
        longest: f64,
    },
    /// The template's features are not where the scan's are: its curvature is not that of the places it lies on.
    FeaturesMoved {
        /// Correlation of curvature between template and result.
        correlation: f64,
    },
    /// The last step still moved the result.
    Unsettled {
        /// Largest motion of a vertex in it.
        motion: f64,
    },
    /// The result's mirror image is more probable than the result.
    Mirrored {
        /// How many times.
        odds: f64,
    },
    /// The scan is of another size than the template.
    Scale {
        /// Size over the template's.
        scale: f64,
    },
}

impl Doubt {
    /// The doubt that a risk stands for, with its numbers.
    pub(super) fn new(
        risk: Risk,
        evidence: &Evidence,
        input: &RegistrationInput<'_>,
        result: &RegistrationResult,
        quality: &Quality,
    ) -> Self {
        let size = evidence.size;
        let of_schedule = size / result.schedule.reference_size;
        match risk {
            Risk::StartLoss | Risk::StartRival => Self::Start {
                tried: result.start_search.as_ref().map_or(0, |s| s.tried),
                share: evidence.start_share,
                residual: result.start_search.as_ref().map_or(0.0, |s| s.fit.residual * of_schedule),
                rival: evidence.start_rival,
            },
            Risk::Unseen => Self::LittleSeen { share: 1.0 - evidence.coverage.unseen },
            Risk::Contradicted | Risk::Turn => Self::Contradicted { share: evidence.coverage.contradicted },
            Risk::ScanMissed => Self::ScanMissed { share: evidence.coverage.scan_missed },
            Risk::Distance | Risk::DistanceSpread => Self::HighResidual { median: evidence.coverage.distance * size },
            Risk::LandmarkRms | Risk::LandmarkWorst | Risk::LandmarkSuspects => {
                let distance = |l: &Landmark| (l.template.position(&result.positions) - l.target).norm();
                let sigma = result.schedule.sigma.landmark * of_schedule;
                let counted = |l: &Landmark| l.weight(sigma).sqrt() * distance(l);
                let worst = input.landmarks.iter().max_by(|a, b| counted(a).total_cmp(&counted(b)));
                Self::Landmarks {
                    rms: evidence.landmark_rms * size,
                    worst: worst.map(|l| l.name.clone()).unwrap_or_default(),
                    distance: worst.map_or(0.0, distance),
                }
            }
            Risk::FewLandmarks | Risk::LandmarkFreedom => Self::FewLandmarks { count: evidence.landmarks },
            Risk::NoShapes => Self::NoShapes,
            Risk::BeyondShapes | Risk::BeyondShapesSpread if evidence.shapes == 0 => Self::NoShapes,
            Risk::BeyondShapes | Risk::BeyondShapesSpread => Self::BeyondShapes { rms: evidence.beyond_shapes * size },
            Risk::WeightEnergy | Risk::WeightWorst => {
                let ratio = |w: &&super::NamedWeight| w.value.abs();
                let worst = result.weights.iter().max_by(|a, b| ratio(a).total_cmp(&ratio(b)));
                Self::ExtremeWeights {
                    energy: evidence.weight_energy,
                    worst: worst.map(|w| w.name.clone()).unwrap_or_default(),
                    deviations: evidence.weight_worst,
                }
            }
            Risk::WeightUncertainty => Self::LooseWeights { shift: evidence.weight_uncertainty * size },
            Risk::Flipped | Risk::Intersections => {
                Self::ManyFolds { folded: quality.flipped, intersections: intersections_grown(result, quality) }
            }
            Risk::Stretch | Risk::Squeeze => {
                Self::Stretched { longest: quality.mesh.stretch.p99, shortest: quality.mesh.stretch.p1 }
            }
            Risk::CurvatureLost => Self::FeaturesMoved { correlation: evidence.curvature_kept },
            Risk::LastMotion => Self::Unsettled { motion: evidence.last_motion * size },
            Risk::Mirrored => Self::Mirrored { odds: evidence.handedness.against().min(700.0).exp() },
            Risk::Scale => Self::Scale { scale: evidence.scale },
        }
    }

    /// The sign's name, as in the report.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Start { .. } => "start",
            Self::LittleSeen { .. } => "little_seen",
            Self::Contradicted { .. } => "contradicted",
            Self::ScanMissed { .. } => "scan_missed",
            Self::HighResidual { .. } => "high_residual",
            Self::Landmarks { .. } => "landmarks",
            Self::FewLandmarks { .. } => "few_landmarks",
            Self::NoShapes => "no_shapes",
            Self::BeyondShapes { .. } => "beyond_shapes",
            Self::ExtremeWeights { .. } => "extreme_weights",
            Self::LooseWeights { .. } => "loose_weights",
            Self::ManyFolds { .. } => "many_folds",
            Self::Stretched { .. } => "stretched",
            Self::Spikes { .. } => "spikes",
            Self::FeaturesMoved { .. } => "features_moved",
            Self::Unsettled { .. } => "unsettled",
            Self::Mirrored { .. } => "mirrored",
            Self::Scale { .. } => "scale",
        }
    }
}

impl std::fmt::Display for Doubt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let percent = |share: f64| 100.0 * share;
        match self {
            Self::Start { tried, share, residual, rival } => write!(
                f,
                "of {tried} poses tried, the best matches {:.0} % of the template to {residual:.1} mm, and one in another place comes \
                 to {:.0} % of its gain; look at the picture, or give three landmarks",
                percent(*share),
                percent(*rival)
            ),
            Self::LittleSeen { share } => write!(
                f,
                "the scan shows only {:.0} % of the template; what it does not show is a guess",
                percent(*share)
            ),
            Self::Contradicted { share } => write!(
                f,
                "at {:.0} % of the vertices the scan has its surface elsewhere or facing elsewhere; look for hair, hands and clothes \
                 (--mask leaves them out), or a wrong start",
                percent(*share)
            ),
            Self::ScanMissed { share } => write!(
                f,
                "the template is not on {:.0} % of the scan's surface that lies over it; look there in the picture",
                percent(*share)
            ),
            Self::HighResidual { median } => write!(
                f,
                "the vertices near the scan are {median:.2} mm off it in the median; check that it shows the template's subject"
            ),
            Self::Landmarks { rms, worst, distance } => write!(
                f,
                "the landmarks are {rms:.1} mm from where they should be, {worst:?} {distance:.1} mm; check that one first, then that \
                 names are right and the scan is not mirrored"
            ),
            Self::FewLandmarks { count: 0 } => {
                f.write_str("there are no landmarks to confirm the result; three or more, far apart, would")
            }
            Self::FewLandmarks { count } => {
                write!(f, "{count} landmarks leave the pose open; more of them, far apart, would settle it")
            }
            Self::NoShapes => f.write_str(
                "without shapes nothing says where along smooth skin a vertex belongs: sliding is undetermined; a model with shapes, and a rig, would tell",
            ),
            Self::BeyondShapes { rms } => write!(
                f,
                "the scan is {rms:.1} mm from anything that the shapes make; check the neutral, or give more identity modes or \
                 expressions"
            ),
            Self::ExtremeWeights { energy, worst, deviations } => write!(
                f,
                "the shapes' weights are larger than usual, their mean square {energy:.2}, {worst:?} {deviations:.1} deviations; \
                 check the start, the neutral and that the rig has the shapes that the scan shows"
            ),
            Self::LooseWeights { shift } => {
                write!(f, "the scan leaves the shapes open by {shift:.1} mm at a vertex; landmarks would help")
            }
            Self::ManyFolds { folded, intersections } => write!(
                f,
                "{folded} triangles are turned over and {intersections} pairs passed through each other; look at lips, lids and the rim \
                 of what the scan shows"
            ),
            Self::Stretched { longest, shortest } => write!(
                f,
                "edges are stretched to {longest:.1} and shrunk to {shortest:.2} times their length; check landmarks and the start"
            ),
            Self::Spikes { vertices, longest } => write!(
                f,
                "{vertices} vertices stand out from their neighbours, with edges {longest:.0} times as long as the template's; look at \
                 the neutral, the warm start and the picture"
            ),
            Self::FeaturesMoved { correlation } => write!(
                f,
                "the template's features are not on the scan's: curvature agrees to {correlation:.2} only; look at nose, mouth and eyes"
            ),
            Self::Unsettled { motion } => write!(
                f,
                "the last step still moved the result by {motion:.1} mm: scan and template do not fit; check the start and the scan"
            ),
            Self::Mirrored { odds } => write!(
                f,
                "the result's mirror image is {odds:.0} times as probable as the result; check that the scan is not mirrored"
            ),
            Self::Scale { scale } => write!(
                f,
                "the subject is {scale:.2} times as large as the template; a rig of such subjects would fit better"
            ),
        }
    }
}
