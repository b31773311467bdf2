//! Rigid motion, SE(3) about the centroid: one node, no shapes, no regulariser.

use super::{
    Hybrid, ModelError, ModelFactory, ModelInput, NodeGraph, OneNodeOptions, RegistrationModel, RigidMotion, Stiffness,
    node_options,
};
use crate::energy::{NoOptions, Options, OptionsError};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A rigid motion of the whole template.
pub type Rigid = Hybrid<RigidMotion, 6>;

/// The rigid model on the rest positions `rest`.
#[must_use]
pub fn rigid(rest: Vec<Vec3>) -> Rigid {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    Hybrid::named("rigid", rest, graph, ShapeBasis::none(), Stiffness::default())
}

pub(super) struct Factory;

impl ModelFactory for Factory {
    fn name(&self) -> &'static str {
        "rigid"
    }

    fn default_schedule(&self) -> &'static str {
        include_str!("schedules/rigid.toml")
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<OneNodeOptions>()
    }

    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<NoOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        node_options::one_node(rigid(input.rest.positions.clone()), input.options)
    }
}
