//! Similarity, Sim(3) about the centroid: rotation, translation and one scale; no regulariser.

use super::{
    Hybrid, ModelError, ModelFactory, ModelInput, NodeGraph, OneNodeOptions, RegistrationModel, SimilarityMotion,
    Stiffness, node_options,
};
use crate::energy::{NoOptions, Options, OptionsError};
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

pub(super) struct Factory;

impl ModelFactory for Factory {
    fn name(&self) -> &'static str {
        "similarity"
    }

    fn default_schedule(&self) -> &'static str {
        include_str!("schedules/similarity.toml")
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<OneNodeOptions>()
    }

    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<NoOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        node_options::one_node(similarity(input.rest.positions.clone()), input.options)
    }
}
