//! Deform meshes by nonlinear least squares.
pub mod mesh;
pub mod nlls;
pub mod rig;
