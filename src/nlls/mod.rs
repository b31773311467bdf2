//! Generic nonlinear least squares. Knows nothing of meshes.

mod error;
mod kernel;
pub mod linear;
pub mod minimizer;
mod normal_equations;
mod problem;
mod structure;

pub use error::OptionError;
pub use kernel::{Kernel, RobustKernel, Scaled, check_kernel, mad_scale};
pub use linear::{LinearError, LinearSolver, LinearSolverKind};
pub use minimizer::{
    Algorithm, Convergence, GaussNewton, IterationRecord, LevenbergMarquardt, Minimizer, Observer, Options,
    ProblemSize, Silent, StageTimes, StopReason, Summary, Workspace,
};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use structure::{BlockStructure, StructureError};
