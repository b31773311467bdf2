//! Rigid motion, SE(3) about the centroid: one node, no shapes, no regulariser.

use super::{NodeAssembly, NodeGraph, RigidMotion, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A rigid motion of the whole template.
pub type Rigid = NodeAssembly<RigidMotion, 6>;

/// The rigid model on the rest positions `rest`.
#[must_use]
pub fn rigid(rest: Vec<Vec3>) -> Rigid {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    NodeAssembly::new("rigid", rest, graph, ShapeBasis::none(), Stiffness::default())
}
