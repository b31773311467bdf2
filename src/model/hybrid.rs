//! Klimov's hybrid: blendshapes inside the deformation graph, both solved together, eqs. (8) and (9) of Klimov 2020.

use super::{AffineMotion, NodeAssembly, NodeGraph, NodeTransform, RigidMotion, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// Blendshapes inside a deformation graph.
pub type Hybrid = NodeAssembly<RigidMotion, 6>;

/// The hybrid model on the rest positions `rest` (the neutral).
#[must_use]
pub fn hybrid(rest: Vec<Vec3>, nodes: NodeGraph, shapes: ShapeBasis, stiffness: Stiffness) -> Hybrid {
    hybrid_of(rest, nodes, shapes, stiffness)
}

/// [`Hybrid`] with the affine nodes of Sumner et al. 2007.
pub type AffineHybrid = NodeAssembly<AffineMotion, 12>;

/// The hybrid model with affine nodes.
#[must_use]
pub fn affine_hybrid(rest: Vec<Vec3>, nodes: NodeGraph, shapes: ShapeBasis, stiffness: Stiffness) -> AffineHybrid {
    hybrid_of(rest, nodes, shapes, stiffness)
}

/// [`hybrid()`] with nodes that move as `T` says, such as [`QuaternionMotion`](super::QuaternionMotion).
#[must_use]
pub fn hybrid_of<T: NodeTransform<W>, const W: usize>(
    rest: Vec<Vec3>,
    nodes: NodeGraph,
    shapes: ShapeBasis,
    stiffness: Stiffness,
) -> NodeAssembly<T, W> {
    NodeAssembly::new("hybrid", rest, nodes, shapes, stiffness)
}
