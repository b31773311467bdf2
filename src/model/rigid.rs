//! Rigid motion, SE(3) about the centroid: one node, no shapes, no regulariser.

use super::factory::BuiltIn;
use super::{Hybrid, NodeGraph, OneNodeOptions, RigidMotion, Stiffness, node_options};
use crate::energy::NoOptions;
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

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<OneNodeOptions>("rigid", include_str!("schedules/rigid.toml"), |input| {
        node_options::one_node(rigid(input.rest.positions.clone()), input.options)
    })
    .with_level::<NoOptions>();
