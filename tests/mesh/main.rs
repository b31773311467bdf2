//! Meshes: awkward ones made by code, and real ones.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;
#[path = "../support/skip.rs"]
mod skip;

mod awkward_meshes;
mod real_meshes;
