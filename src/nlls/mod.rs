//! Generic nonlinear least squares. Knows nothing of meshes.
pub mod dense_kernels;
mod kernel;
mod normal_equations;
mod problem;
pub mod so3;
mod structure;

pub use kernel::{Kernel, RobustKernel};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use structure::{BlockStructure, StructureError};
