//! Meshes: awkward ones made by code, and real ones.

#[path = "../support/awkward.rs"]
mod awkward;

mod awkward_meshes;
mod real_data;
