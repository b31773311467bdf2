//! The embedded deformation graph of Sumner et al. 2007 with rigid nodes, eqs. (6) and (7) of Klimov 2020.
//! With the paper's own affine nodes: [`sumner`](super::sumner()).

use super::factory::BuiltIn;
use super::{GraphLevel, GraphOptions, Hybrid, NodeGraph, NodeTransform, RigidMotion, Stiffness, node_options};
use crate::energy::{Options, OptionsError};
use crate::mesh::Vec3;
use crate::rig::ShapeBasis;

/// A deformation graph.
pub type Graph = Hybrid<RigidMotion, 6>;

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
) -> Hybrid<T, W> {
    let stiffness = Stiffness { graph: lambda_graph, ..Stiffness::default() };
    Hybrid::named("graph", rest, nodes, ShapeBasis::none(), stiffness)
}

pub(super) const MODEL: BuiltIn = BuiltIn {
    options,
    ..BuiltIn::new::<GraphOptions>("graph", include_str!("schedules/graph.toml"), |input| {
        node_options::build("graph", input, &ShapeBasis::none())
    })
    .with_level::<GraphLevel>()
    .on_patch(&["smoothing", "nodes"], |input| {
        let (nodes, lambda) = node_options::on_patch(input)?;
        Ok(Box::new(graph(input.mesh.positions.clone(), nodes, lambda)))
    })
};

fn options(given: &Options) -> Result<Options, OptionsError> {
    let options = given.read::<GraphOptions>()?;
    for (key, given) in [
        ("smooth_shapes", options.smooth_shapes > 0),
        ("proportions", options.proportions > 0.0),
        ("distrust", options.distrust > 0.0),
    ] {
        if given {
            return Err(OptionsError::Conflict { key, reason: "the graph has no shapes; the hybrid has" });
        }
    }
    Ok(Options::of(&options))
}
