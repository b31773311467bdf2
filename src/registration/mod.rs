//! Non-rigid registration: from a template, a model and a scan to the scan's shape in the template's topology.

mod builder;
mod colour;
mod correspondence;
mod doubt;
mod driver;
mod error;
mod evidence;
mod facing;
mod handedness;
mod level_term;
mod masks;
mod model_kind;
mod reliability;
mod report;
mod scan;
mod scan_points;
mod schedule;
mod seam;
mod start;
mod surfels;
mod terms;
mod warm_start;

pub use builder::Registration;
pub use colour::{UNSEEN_COLOR, VertexColors, scan_colors};
pub use correspondence::Correspondences;
pub use doubt::Doubt;
pub use driver::{
    NamedWeight, RegistrationInput, RegistrationObserver, RegistrationResult, RegistrationStop, StepRecord, find_start,
    register, register_with,
};
pub use error::RegistrationError;
pub use evidence::{Coverage, Evidence};
pub use facing::{ScanFacing, ScanFlip};
pub use handedness::Handedness;
pub use level_term::LevelTerm;
pub use masks::VertexMasks;
pub use model_kind::{ModelFactory, ModelInput, ModelKind, RegistrationModel};
pub use reliability::{Calibration, Reliability, Risk, RiskCurve, WRONG_MM};
pub use report::{InputFile, Quality, QualityError, Report, WITHIN_MM};
pub use scan::ScanSurface;
pub use scan_points::ScanPoints;
pub use schedule::{
    AffineOptions, BoundsOptions, GraphDistance, GraphOptions, KernelScale, Level, NodeKind, RigidityOptions,
    RotationKind, ScanOptions, Schedule, ScheduleError, SeamOptions, SigmaOptions, SmoothOptions, SolverOptions, Stage,
    StepAlgorithm, StopOptions, WarmStartOptions,
};
pub use seam::Seams;
pub use start::{LandmarkStart, StartFit, StartOptions, StartSearch, SuspectLandmark};
pub use terms::{RegistrationTerm, TermFactory, TermInput, TermKind};
pub use warm_start::WarmStart;

/// The default schedules, by model.
pub const DEFAULT_SCHEDULES: [(&str, &str); 10] = [
    ("hybrid", include_str!("schedules/hybrid.toml")),
    ("sequential", include_str!("schedules/sequential.toml")),
    ("graph", include_str!("schedules/graph.toml")),
    ("sumner", include_str!("schedules/sumner.toml")),
    ("affine", include_str!("schedules/affine.toml")),
    ("blendshape", include_str!("schedules/blendshape.toml")),
    ("free", include_str!("schedules/free.toml")),
    ("arap", include_str!("schedules/arap.toml")),
    ("rigid", include_str!("schedules/rigid.toml")),
    ("similarity", include_str!("schedules/similarity.toml")),
];
