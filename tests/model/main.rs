//! Deformation models: laws, references, linearisations, determinism, allocations.

#[path = "../support/dense_covariance.rs"]
mod dense_covariance;
#[path = "../support/projected_gradient.rs"]
mod projected_gradient;
#[path = "../support/reference.rs"]
mod reference;
#[path = "../support/stated_graph.rs"]
mod stated_graph;
#[path = "../support/threads.rs"]
mod threads;
#[path = "../support/zoo.rs"]
mod zoo;

#[allow(dead_code)] // others use the rest
#[path = "../../src/mesh/testing.rs"]
mod sheets;

mod affine_reference;
mod allocations;
mod arap_reference;
mod blendshape_weights;
mod determinism;
mod laws;
mod linearisations;
mod physical;

// What the sheets are made of.
use nonrigid::mesh::{TriangleMesh, Vec3};
