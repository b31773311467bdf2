//! Deform meshes by nonlinear least squares.
pub mod cli;
pub mod energy;
pub mod evaluation;
pub mod mesh;
pub mod model;
pub mod nlls;
pub mod registration;
pub mod render;
pub mod rig;
pub mod term;
