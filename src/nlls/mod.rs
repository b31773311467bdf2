//! Generic nonlinear least squares. Knows nothing of meshes.
pub mod dense_kernels;
mod kernel;
pub mod linear;
mod normal_equations;
mod problem;
pub mod so3;
mod structure;
mod tmp_gn;

pub use kernel::{Kernel, RobustKernel};
pub use linear::{LinearError, LinearSolver, LinearSolverKind};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use structure::{BlockStructure, StructureError};
pub use tmp_gn::*;
