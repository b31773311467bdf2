//! Generic nonlinear least squares. Knows nothing of meshes.

mod normal_equations;
mod problem;
mod structure;

pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use structure::{BlockStructure, StructureError};
