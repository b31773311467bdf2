//! Similarity, Sim(3) about the centroid: rotation, translation and one scale; no regulariser.

use super::{NodeAssembly, NodeGraph, SimilarityMotion, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A similarity of the whole template.
pub type Similarity = NodeAssembly<SimilarityMotion, 7>;

/// The similarity model on the rest positions `rest`.
#[must_use]
pub fn similarity(rest: Vec<Vec3>) -> Similarity {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    NodeAssembly::new("similarity", rest, graph, ShapeBasis::none(), Stiffness::default())
}
