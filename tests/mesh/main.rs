//! Meshes: awkward ones made by code, and real ones.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;
#[path = "../support/skip.rs"]
mod skip;

#[path = "../../src/mesh/testing.rs"]
mod sheets;

mod awkward_meshes;
mod inner_layer;
mod real_meshes;
mod surface_lattice;

// What the sheets are made of.
use nonrigid::mesh::{TriangleMesh, Vec3};
