//! The embedded deformation graph of Sumner et al. 2007 as it was published: affine nodes `A_j q + t_j`, eq. (7) with `A_j` for
//! `R_j`, and `E_rot`, which keeps every `A_j` near the rotations.

use serde::{Deserialize, Serialize};

use super::factory::BuiltIn;
use super::{
    AffineMotion, GraphDistance, GraphLevel, GraphOptions, Hybrid, Linearisation, NodeGraph, Stiffness, node_options,
};
use crate::energy::{OptionTable, OptionsError};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A deformation graph with affine nodes.
pub type Sumner = Hybrid<AffineMotion, 12>;

/// Sumner's graph on the rest positions `rest`.
#[must_use]
pub fn sumner(rest: Vec<Vec3>, nodes: NodeGraph, lambda_graph: f64, lambda_rotation: f64) -> Sumner {
    let stiffness = Stiffness { graph: lambda_graph, rotation: lambda_rotation, ..Stiffness::default() };
    Hybrid::named("sumner", rest, nodes, ShapeBasis::none(), stiffness)
}

/// `[model]` of Sumner's graph: [`GraphOptions`] whose nodes are affine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SumnerOptions {
    /// Number of nodes.
    pub nodes: usize,
    /// As [`GraphOptions::coarse_nodes`].
    pub coarse_nodes: usize,
    /// Nodes that move each vertex, `K`.
    pub influences: usize,
    /// How distances are measured.
    pub distance: GraphDistance,
    /// As [`GraphOptions::lambda_unseen`].
    pub lambda_unseen: f64,
    /// `structured` (default) or `reference`, the differentiation of Klimov 2020; the same to rounding.
    pub linearisation: Linearisation,
}

impl Default for SumnerOptions {
    fn default() -> Self {
        let GraphOptions { nodes, coarse_nodes, influences, distance, lambda_unseen, linearisation, .. } =
            GraphOptions::default();
        Self { nodes, coarse_nodes, influences, distance, lambda_unseen, linearisation }
    }
}

impl OptionTable for SumnerOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::count("nodes", self.nodes)?;
        OptionsError::count("influences", self.influences)?;
        OptionsError::not_negative("lambda_unseen", self.lambda_unseen)
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<SumnerOptions>("sumner", include_str!("schedules/sumner.toml"), |input| {
        let options = input.options.read::<SumnerOptions>()?;
        let counts = [options.nodes, options.coarse_nodes];
        let (nodes, other_graph) = options.distance.graphs(input, counts, options.influences)?;
        let mut model = sumner(input.rest.positions.clone(), nodes, 0.0, 0.0);
        model.linearisation = options.linearisation;
        model.lambda_unseen = options.lambda_unseen;
        model.other_graph = other_graph;
        Ok(Box::new(model))
    })
    .with_level::<GraphLevel>()
    .on_patch(&["smoothing", "nodes"], |input| {
        let (nodes, lambda) = node_options::on_patch(input)?;
        Ok(Box::new(sumner(input.mesh.positions.clone(), nodes, lambda, PATCH_ROTATION)))
    });

/// `lambda_rotation` of a patch, as in the schedule.
const PATCH_ROTATION: f64 = 10.0;
