//! Blendshapes or PCA components, eqs. (4) and (5) of Klimov 2020, under one rigid motion.

use super::{NodeAssembly, NodeGraph, RigidMotion, Stiffness};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// Linear shapes and a rigid motion.
pub type Blendshape = NodeAssembly<RigidMotion, 6>;

/// The blendshape model on the rest positions `rest` (the neutral).
#[must_use]
pub fn blendshape(rest: Vec<Vec3>, shapes: ShapeBasis, lambda_blend: f64) -> Blendshape {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len());
    NodeAssembly::new("blendshape", rest, graph, shapes, Stiffness { blend: lambda_blend, ..Stiffness::default() })
}

/// The blendshape model without its rigid motion.
#[must_use]
pub fn blendshape_in_place(rest: Vec<Vec3>, shapes: ShapeBasis, lambda_blend: f64) -> Blendshape {
    let graph = NodeGraph::single(super::centroid(&rest), rest.len()).all_fixed();
    NodeAssembly::new("blendshape", rest, graph, shapes, Stiffness { blend: lambda_blend, ..Stiffness::default() })
}
