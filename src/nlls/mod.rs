//! Generic nonlinear least squares. Knows nothing of meshes.

pub mod linear;
mod normal_equations;
mod problem;
mod structure;

pub use linear::{LinearError, LinearSolver, LinearSolverKind};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use structure::{BlockStructure, StructureError};
