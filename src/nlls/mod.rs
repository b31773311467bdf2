//! Generic nonlinear least squares. Knows nothing of meshes.

mod check;
mod error;
mod kernel;
pub mod linear;
pub mod manifold;
pub mod minimizer;
mod normal_equations;
mod parallel;
mod problem;
mod residual;
mod scalar;
mod structure;

pub use check::{GradientCheck, GradientEntry, GradientReport, HessianReport, check_gradient, check_hessian};
pub use error::OptionError;
pub use kernel::{Kernel, RobustKernel, Scaled, check_kernel, mad_scale};
pub use linear::{LinearError, LinearSolver, LinearSolverKind};
pub use manifold::{Euclidean, Manifold, PointArray, Se3, Sim3, So3, UnitQuaternion, check_manifold, so3};
pub use minimizer::{
    Algorithm, Convergence, GaussNewton, IterationRecord, LevenbergMarquardt, Minimizer, Observer, Options,
    ProblemSize, Silent, StageTimes, StopReason, Summary, Workspace,
};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use residual::{
    BlockId, BlockList, Family, FamilyId, ProblemError, Residual, ResidualProblem, ResidualProblemBuilder,
};
pub use scalar::Scalar;
pub use structure::{BlockStructure, StructureError};
