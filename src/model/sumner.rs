//! The embedded deformation graph of Sumner et al. 2007 as it was published: affine nodes `A_j q + t_j`, eq. (7) with `A_j` for
//! `R_j`, and `E_rot`, which keeps every `A_j` near the rotations.

use super::{AffineMotion, NodeAssembly, NodeGraph, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A deformation graph with affine nodes.
pub type Sumner = NodeAssembly<AffineMotion, 12>;

/// Sumner's graph on the rest positions `rest`.
#[must_use]
pub fn sumner(rest: Vec<Vec3>, nodes: NodeGraph, lambda_graph: f64, lambda_rotation: f64) -> Sumner {
    let stiffness = Stiffness { graph: lambda_graph, rotation: lambda_rotation, ..Stiffness::default() };
    NodeAssembly::new("sumner", rest, nodes, ShapeBasis::none(), stiffness)
}
