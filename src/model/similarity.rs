//! Similarity, Sim(3) about the centroid: rotation, translation and one scale; no regulariser.

use super::factory::BuiltIn;
use super::{Hybrid, NodeGraph, OneNodeOptions, SimilarityMotion, Stiffness, node_options};
use crate::energy::NoOptions;
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A similarity of the whole template.
pub type Similarity = Hybrid<SimilarityMotion, 7>;

/// The similarity model on the rest positions `rest`.
#[must_use]
pub fn similarity(rest: Vec<Vec3>) -> Similarity {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    Hybrid::named("similarity", rest, graph, ShapeBasis::none(), Stiffness::default())
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<OneNodeOptions>("similarity", include_str!("schedules/similarity.toml"), |input| {
        node_options::one_node(similarity(input.rest.positions.clone()), input.options)
    })
    .with_level::<NoOptions>();
