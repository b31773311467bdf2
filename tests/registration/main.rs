//! Whole registrations: laws, starts, random cases, the self-test.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;
#[path = "../support/skip.rs"]
mod skip;
#[path = "../support/mod.rs"]
mod support;
#[path = "../support/threads.rs"]
mod threads;

#[allow(dead_code)] // others use the rest
#[path = "../../src/mesh/testing.rs"]
mod sheets;

mod doubts;
mod laws;
mod one_surface;
mod own_parts;
mod random;
mod self_test;
mod start;
mod task;

// What the sheets are made of.
use nonrigid::mesh::{TriangleMesh, Vec3};
