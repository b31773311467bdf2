//! Files: round trips, formats, units, colour, and what is malformed.

#[path = "../support/mod.rs"]
mod support;
#[path = "../support/threads.rs"]
mod threads;

#[allow(dead_code)] // others use the rest
#[path = "../../src/mesh/testing.rs"]
mod sheets;

mod bad_input;
mod colour;
mod gltf;
mod mesh_formats;
mod round_trips;
mod texture;
mod units;

// What the sheets are made of.
use nonrigid::mesh::{TriangleMesh, Vec3};
