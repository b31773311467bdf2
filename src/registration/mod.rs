//! Non-rigid registration: from a template, a model and a scan to the scan's shape in the template's topology.

mod builder;
mod colour;
mod detail;
mod doubt;
mod driver;
mod error;
mod evidence;
mod facing;
mod handedness;
mod input;
mod one_surface;
mod reliability;
mod report;
mod rest;
mod result;
mod schedule;
mod start;
mod surfels;
mod untangle;
mod warm_start;

pub use builder::Registration;
pub use colour::{UNSEEN_COLOR, VertexColors, scan_colors};
pub use detail::{Detail, DetailReport, MOST_ROUNDS, add_detail};
pub use doubt::Doubt;
pub use driver::{find_start, register, register_with};
pub use error::RegistrationError;
pub use evidence::{Coverage, Evidence};
pub use facing::ScanFacing;
pub use handedness::Handedness;
pub use input::RegistrationInput;
pub use one_surface::TemplateRepair;
pub use reliability::{Calibration, Reliability, Risk, RiskCurve, WRONG_MM, assess};
pub use report::{InputFile, Quality, QualityError, Report, WITHIN_MM};
pub use result::{NamedWeight, RegistrationObserver, RegistrationResult, RegistrationStop, StepRecord};
pub use schedule::{
    BoundsOptions, KernelScale, Level, Schedule, ScheduleError, SigmaOptions, SolverOptions, Stage, StageModel,
    StepAlgorithm, StopOptions, WarmStartOptions,
};
pub use start::{LandmarkStart, StartFit, StartOptions, StartSearch, SuspectLandmark};
pub use untangle::Untangled;
pub use warm_start::WarmStart;

pub use crate::correspondence::{ScanFlip, ScanOptions};
pub use crate::model::{ModelFactory, ModelInput, ModelKind, RegistrationModel};
pub use crate::nlls::Silent;
pub use crate::term::{RegistrationTerm, TERMS, TermFactory, TermInput};
