//! Signs that a result is probably wrong: what a report and a warning say instead of leaving it to be found out.
//!
//! No sign is proof. Thresholds are between what right and wrong results measure in `experiments faulty-scans`.

use serde::Serialize;

use super::{Quality, RegistrationInput, RegistrationResult, StartSearch, WITHIN_MM};
use crate::mesh::io::Landmark;
use crate::mesh::{Vec3, surface_points};

/// A sign that a result is probably wrong, with the number that gave it away.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "sign")]
pub enum Doubt {
    /// [`StartSearch::is_doubtful`].
    Start {
        /// Poses tried.
        tried: usize,
        /// Share of the template's surface that the best of them matches.
        share: f64,
        /// Root mean square distance of the matched part, millimetres.
        residual: f64,
        /// [`StartSearch::rival`].
        rival: f64,
    },
    /// Few of the template's vertices found the scan.
    FewInliers {
        /// Their share.
        share: f64,
    },
    /// The vertices near the scan are not on it.
    HighResidual {
        /// Median distance of those within [`WITHIN_MM`], millimetres.
        median: f64,
    },
    /// Landmarks are not where they were said to be.
    Landmarks {
        /// Root mean square distance, millimetres; a landmark of standard deviation sigma counts `1 / sigma^2`.
        rms: f64,
    },
    /// Triangles turned over.
    ManyFolds {
        /// How many.
        folded: usize,
        /// Of how many.
        of: usize,
    },
    /// Blendshapes far outside of what they stand for, or held at a bound other than zero.
    ExtremeWeights {
        /// How many.
        extreme: usize,
        /// Of how many.
        of: usize,
    },
}

/// Share of accepted vertices below which a result is doubtful.
const FEW_INLIERS: f64 = 0.5;
/// Median distance of the vertices near the scan, above which it is, as a share of [`WITHIN_MM`].
const HIGH_RESIDUAL: f64 = 0.2;
/// Root mean square distance of the landmarks above which it is, as a share of the template's size.
const FAR_LANDMARKS: f64 = 0.08;
/// Share of flipped triangles above which it is.
const MANY_FOLDS: f64 = 0.02;
/// Standard deviations from which on a weight is extreme, and the share of such weights above which a result is doubtful.
const EXTREME: f64 = 3.0;
const MANY_WEIGHTS: f64 = 0.02;

impl Doubt {
    /// All signs that a result shows, most telling first.
    #[must_use]
    pub fn of(input: &RegistrationInput<'_>, result: &RegistrationResult, quality: &Quality) -> Vec<Self> {
        let start = result.start_search.as_ref().filter(|search| search.is_doubtful()).map(Self::start);
        let inliers = result.history.last().map_or(0.0, |h| h.inliers);
        let size = size(&surface_points(input.rest_positions(), input.template.corners.iter().copied()));
        let unit = result.start.scale * size / result.schedule.reference_size;
        let landmarks = landmark_distance(input, &result.positions, result.schedule.sigma.landmark * unit);
        let triangles = input.template.triangulate().triangles.len();
        let extreme = extreme_weights(result);
        let (median, of) = (quality.median_within, result.weights.len());
        let signs = [
            start,
            (inliers < FEW_INLIERS).then_some(Self::FewInliers { share: inliers }),
            (landmarks > FAR_LANDMARKS * size).then_some(Self::Landmarks { rms: landmarks }),
            (median > HIGH_RESIDUAL * WITHIN_MM).then_some(Self::HighResidual { median }),
            (quality.flipped as f64 > MANY_FOLDS * triangles as f64)
                .then_some(Self::ManyFolds { folded: quality.flipped, of: triangles }),
            (extreme as f64 > MANY_WEIGHTS * of as f64).then_some(Self::ExtremeWeights { extreme, of }),
        ];
        signs.into_iter().flatten().collect()
    }

    fn start(search: &StartSearch) -> Self {
        let (tried, rival) = (search.tried, search.rival());
        Self::Start { tried, share: search.fit.share, residual: search.fit.residual, rival }
    }

    /// The sign's name, as in the report.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Start { .. } => "start",
            Self::FewInliers { .. } => "few_inliers",
            Self::HighResidual { .. } => "high_residual",
            Self::Landmarks { .. } => "landmarks",
            Self::ManyFolds { .. } => "many_folds",
            Self::ExtremeWeights { .. } => "extreme_weights",
        }
    }
}

impl std::fmt::Display for Doubt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Start { tried, share, residual, rival } => write!(
                f,
                "the start is doubtful: of {tried} poses tried, the best matches {:.0} % of the template to {residual:.1} mm, one in \
                 another place comes to {:.0} % of its gain; look at the picture, or give three landmarks",
                100.0 * share,
                100.0 * rival
            ),
            Self::FewInliers { share } => write!(
                f,
                "only {:.0} % of the template's vertices found the scan; check landmarks, units and the start",
                100.0 * share
            ),
            Self::HighResidual { median } => write!(
                f,
                "the vertices near the scan are {median:.2} mm off it in the median; check that it shows the template's subject"
            ),
            Self::Landmarks { rms } => write!(
                f,
                "the landmarks are {rms:.1} mm from where they should be; check that their names are right and that the scan is not \
                 mirrored"
            ),
            Self::ManyFolds { folded, of } => {
                write!(f, "{folded} of {of} triangles are folded; check landmarks and the start")
            }
            Self::ExtremeWeights { extreme, of } => write!(
                f,
                "{extreme} of {of} weights are beyond {EXTREME} standard deviations or at a bound; check the start and the rig"
            ),
        }
    }
}

/// Root mean square distance of the landmarks from their targets, each with its weight next to one of deviation `sigma`; 0
/// without any.
fn landmark_distance(input: &RegistrationInput<'_>, positions: &[Vec3], sigma: f64) -> f64 {
    let weighted = |l: &Landmark| l.weight(sigma) * (l.template.position(positions) - l.target).norm_squared();
    let total: f64 = input.landmarks.iter().map(|l| l.weight(sigma)).sum();
    if total > 0.0 { (input.landmarks.iter().map(weighted).sum::<f64>() / total).sqrt() } else { 0.0 }
}

/// Root mean square distance from the centroid.
fn size(points: &[Vec3]) -> f64 {
    let count = points.len().max(1) as f64;
    let centre = points.iter().sum::<Vec3>() / count;
    (points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / count).sqrt()
}

/// Weights beyond [`EXTREME`] prior standard deviations, or held at a bound that is not 0, where most expressions rest.
fn extreme_weights(result: &RegistrationResult) -> usize {
    let sigma = result.schedule.sigma.expression.max(result.schedule.sigma.identity);
    result.weights.iter().filter(|w| w.value.abs() > EXTREME * sigma || (w.at_bound && w.value != 0.0)).count()
}
