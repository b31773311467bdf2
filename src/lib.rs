//! Deform meshes by nonlinear least squares.
pub mod evaluation;
pub mod mesh;
pub mod nlls;
pub mod render;
