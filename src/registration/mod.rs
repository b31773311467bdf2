//! Non-rigid registration: from a template, a model and a scan to the scan's shape in the template's topology.

mod correspondence;
mod driver;
mod error;
mod model_kind;
mod report;
mod schedule;
mod seam;
mod start;
mod surfels;
mod terms;

pub use correspondence::{Correspondences, ScanSurface, VertexCoincidence};
pub use driver::{
    RegistrationInput, RegistrationObserver, RegistrationResult, RegistrationStop, StepRecord, find_start, register,
    register_with,
};
pub use error::RegistrationError;
pub use model_kind::{ModelFactory, ModelInput, ModelKind, RegistrationModel};
pub use report::{InputFile, Quality, QualityError, Report, WITHIN_MM};
pub use schedule::{
    GraphDistance, GraphOptions, Level, ScanOptions, Schedule, ScheduleError, SeamOptions, SigmaOptions, StopOptions,
};
pub use seam::Seams;
pub use start::{StartFit, StartOptions, StartSearch};
pub use terms::{RegistrationTerm, TermFactory, TermInput, TermKind};

/// The default schedules, by model.
pub const DEFAULT_SCHEDULES: [(&str, &str); 5] = [
    ("hybrid", include_str!("schedules/hybrid.toml")),
    ("graph", include_str!("schedules/graph.toml")),
    ("blendshape", include_str!("schedules/blendshape.toml")),
    ("rigid", include_str!("schedules/rigid.toml")),
    ("similarity", include_str!("schedules/similarity.toml")),
];
