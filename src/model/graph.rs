//! The embedded deformation graph of Sumner et al. 2007 with rigid nodes, eqs. (6) and (7) of Klimov 2020.
//! With the paper's own affine nodes: [`sumner`](super::sumner()).

use super::{NodeAssembly, NodeGraph, NodeTransform, RigidMotion, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A deformation graph.
pub type Graph = NodeAssembly<RigidMotion, 6>;

/// The graph model on the rest positions `rest`.
#[must_use]
pub fn graph(rest: Vec<Vec3>, nodes: NodeGraph, lambda_graph: f64) -> Graph {
    graph_of(rest, nodes, lambda_graph)
}

/// [`graph()`] with nodes that move as `T` says, such as [`QuaternionMotion`](super::QuaternionMotion).
#[must_use]
pub fn graph_of<T: NodeTransform<W>, const W: usize>(
    rest: Vec<Vec3>,
    nodes: NodeGraph,
    lambda_graph: f64,
) -> NodeAssembly<T, W> {
    let stiffness = Stiffness { graph: lambda_graph, ..Stiffness::default() };
    NodeAssembly::new("graph", rest, nodes, ShapeBasis::none(), stiffness)
}
