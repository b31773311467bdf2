//! What can go wrong in a registration.

use thiserror::Error;

use super::{ScheduleError, StartFit, StartSearch};
use crate::correspondence::ScanError;
use crate::energy::{OptionsError, SampleError};
use crate::mesh::PoseError;
use crate::model::ModelError;
use crate::nlls::BoundsError;
use crate::term::TermError;

/// Why a registration could not be run or did not succeed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RegistrationError {
    /// The schedule is not usable.
    #[error("schedule: {0}")]
    Schedule(#[from] ScheduleError),
    /// The model's bounds cannot be held.
    #[error("bounds: {0}")]
    Bounds(#[from] BoundsError),
    /// The landmarks do not give a start.
    #[error("start: {0}")]
    Start(#[from] PoseError),
    /// A landmark lies outside the template.
    #[error("landmark: {0}")]
    Sample(#[from] SampleError),
    /// Subdivision makes too many vertices.
    #[error(
        "{rounds} rounds of subdivision make more than {most} vertices of this template; fewer rounds, or a coarser template"
    )]
    TooFine {
        /// Rounds.
        rounds: u8,
        /// Vertices at most.
        most: usize,
    },
    /// The template has no faces.
    #[error("the template has no faces; a registration needs its surface")]
    EmptyTemplate,
    /// A mask is no share.
    #[error("the {what} is {value} at vertex {vertex}; it must be from 0 to 1")]
    MaskValue {
        /// Which mask.
        what: &'static str,
        /// The vertex.
        vertex: usize,
        /// What it holds.
        value: f64,
    },
    /// Another registration's end does not fit.
    #[error("the warm start does not fit: {0}")]
    WarmStart(String),
    /// Nothing of the template is left to register.
    #[error(
        "the masks take out every vertex of the template; at least one must have mask above 0 and free mask below 1"
    )]
    EmptyMask,
    /// Something does not belong to the template.
    #[error(
        "the {what} has {found} vertices, the template has {template}; both must have the same vertices in the same order"
    )]
    VertexCount {
        /// What does not fit.
        what: &'static str,
        /// Its number of vertices.
        found: usize,
        /// The template's.
        template: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("{what}: number {index}, from 0, has coordinates that are not finite")]
    NotFinite {
        /// Whose.
        what: &'static str,
        /// Which vertex, or landmark.
        index: usize,
    },
    /// A landmark's standard deviation is none.
    #[error("landmark {name:?} has a standard deviation of {sigma}; it must be positive and finite")]
    LandmarkSigma {
        /// Its name.
        name: String,
        /// What it states.
        sigma: f64,
    },
    /// The model cannot move without blendshapes.
    #[error("model '{0}' needs blendshapes; give a rig")]
    NeedsShapes(String),
    /// The model could not be built.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A data term could not be built.
    #[error(transparent)]
    Term(#[from] TermError),
    /// A model or term does not take a level's options.
    #[error("{level}: {error}")]
    Options {
        /// Which level.
        level: String,
        /// Why not.
        error: OptionsError,
    },
    /// The scan cannot be searched.
    #[error(transparent)]
    Surface(#[from] ScanError),
    /// The template's geometry cannot be used.
    #[error("template: {0}")]
    Template(String),
    /// The scan's geometry cannot be used.
    #[error("scan: {0}")]
    Scan(String),
    /// Template and scan differ too much in size for a rigid start.
    #[error(
        "by its landmarks the scan is {scale:.4} times the template's size{unit}; bring both to the same unit (millimetres), \
         check that the landmarks name the right points, or set start = \"similarity\" in the schedule",
        unit = unit(*scale)
    )]
    Scale {
        /// Scan over template.
        scale: f64,
    },
    /// The landmarks fit the template's mirror image.
    #[error(
        "mirrored: the landmarks are {rms:.1} mm from the template's and {reflected:.1} mm from those of its mirror image; left and \
         right are swapped in their names, or the scan is mirrored"
    )]
    Mirrored {
        /// Root mean square distance, millimetres.
        rms: f64,
        /// The same of the mirror image.
        reflected: f64,
    },
    /// Template and scan differ too much in size for a start to be searched.
    #[error(
        "by the areas of their surfaces the scan is {ratio:.4} times the template's size{unit}, so the template cannot lie on it; \
         bring both to the same unit (millimetres), give landmarks, or set start = \"similarity\" in the schedule",
        unit = unit(*ratio)
    )]
    Size {
        /// Scan over template.
        ratio: f64,
    },
    /// The observer's flag was set before the first step.
    #[error("stopped while the start was searched")]
    Cancelled,
    /// No pose fits.
    #[error(
        "no start found: in the best of {tried} poses {share:.0} % of the template match the scan, with a loss of {loss:.2}; \
         give three landmarks, and check that the scan shows the template's subject and is not turned inside out",
        share = 100.0 * fit.share, loss = fit.loss
    )]
    NoStart {
        /// Poses tried.
        tried: usize,
        /// The best one's fit.
        fit: StartFit,
    },
    /// Several poses fit alike.
    #[error(
        "no start found: {tried} poses were tried, and two in different places fit alike, with losses of {loss:.2} and {other:.2}; \
         give three landmarks, or bring the scan near the template",
        tried = search.tried, loss = search.fit.loss, other = search.runner_up.map_or(1.0, |f| f.loss)
    )]
    AmbiguousStart {
        /// What was found.
        search: Box<StartSearch>,
    },
    /// No vertex found a correspondence.
    #[error(
        "{level}: no vertex of the template has a scan surface within {cap} mm that faces the same way and is not its open boundary; \
         give landmarks, check that template and scan are in the same unit, that the scan is not turned inside out, and that its \
         triangles share their vertices"
    )]
    NoOverlap {
        /// Level, as schedules' messages name it: `level 1`, `then.level 2`.
        level: String,
        /// Distance cap, millimetres.
        cap: f64,
    },
    /// No step could be computed.
    #[error("{level}, step {step}: {reason}")]
    Solver {
        /// Level, as schedules' messages name it.
        level: String,
        /// Step, from 1.
        step: usize,
        /// What the linear solver said.
        reason: String,
    },
    /// Something became infinite or NaN.
    #[error("{level}, step {step}: {what} is no longer finite")]
    Diverged {
        /// What: a vertex, or the energy, of a term or regulariser where one alone is at fault.
        what: String,
        /// Level, as schedules' messages name it.
        level: String,
        /// Step, from 1.
        step: usize,
    },
}

/// What a scan's size says of its unit, where the template's is the millimetre: scans of faces differ by less than units do.
fn unit(scale: f64) -> &'static str {
    match scale {
        s if (3e-4..5e-3).contains(&s) => ", as if it were in metres",
        s if (0.025..0.06).contains(&s) => ", as if it were in inches",
        s if (0.06..0.3).contains(&s) => ", as if it were in centimetres",
        s if s > 300.0 => ", as if it were in micrometres",
        _ => "",
    }
}

impl RegistrationError {
    /// Whether the inputs, as opposed to the computation on them, are at fault.
    #[must_use]
    pub fn is_input(&self) -> bool {
        !matches!(
            self,
            Self::Cancelled
                | Self::NoStart { .. }
                | Self::AmbiguousStart { .. }
                | Self::NoOverlap { .. }
                | Self::Solver { .. }
                | Self::Diverged { .. }
        )
    }
}
