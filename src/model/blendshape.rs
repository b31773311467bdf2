//! Blendshapes or PCA components, eqs. (4) and (5) of Klimov 2020, under one rigid motion.

use serde::{Deserialize, Serialize};

use super::factory::BuiltIn;
use super::{Hybrid, NodeGraph, OneNodeOptions, RigidMotion, Stiffness, node_options};
use crate::energy::{OptionTable, OptionsError};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// Linear shapes and a rigid motion.
pub type Blendshape = Hybrid<RigidMotion, 6>;

/// The blendshape model on the rest positions `rest` (the neutral).
#[must_use]
pub fn blendshape(rest: Vec<Vec3>, shapes: ShapeBasis, lambda_blend: f64) -> Blendshape {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    Hybrid::named("blendshape", rest, graph, shapes, Stiffness { blend: lambda_blend, ..Stiffness::default() })
}

/// The blendshape model without its rigid motion.
#[must_use]
pub fn blendshape_in_place(rest: Vec<Vec3>, shapes: ShapeBasis, lambda_blend: f64) -> Blendshape {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len()).all_fixed();
    Hybrid::named("blendshape", rest, graph, shapes, Stiffness { blend: lambda_blend, ..Stiffness::default() })
}

/// `[level.model]` of blendshapes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlendshapeLevel {
    /// `lambda_blend` of (5), per shape.
    pub lambda_blend: f64,
}

impl OptionTable for BlendshapeLevel {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("lambda_blend", self.lambda_blend)
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<OneNodeOptions>("blendshape", include_str!("schedules/blendshape.toml"), |input| {
        let model = blendshape(input.rest.positions.clone(), input.shapes.clone(), 0.0);
        node_options::one_node(model, input.options)
    })
    .with_level::<BlendshapeLevel>()
    .needing_shapes()
    .on_patch(&["prior"], |input| {
        Ok(Box::new(blendshape_in_place(input.mesh.positions.clone(), input.shapes.clone(), input.shape_weight())))
    });
