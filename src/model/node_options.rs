//! What schedules say to the models made of nodes and blendshapes.

use serde::{Deserialize, Serialize};

use super::gpmm::MOST_SHAPES;
use super::{
    AffineMotion, AngleAxisMotion, GaussianKernel, GpmmOptions, Hybrid, HybridLevel, Linearisation, ModelError,
    ModelInput, NodeGraph, NodeTransform, PatchInput, QuaternionMotion, RegistrationModel, RigidMotion, Stiffness,
};
use crate::energy::{OptionTable, Options, OptionsError};
use crate::mesh::Vec3;
use crate::nlls::Kernel;
use crate::rig::{Family, Shape, ShapeBasis};

/// `[model]` of the hybrid and the graph: how the deformation graph is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraphOptions {
    /// Number of nodes; at most one for three vertices.
    pub nodes: usize,
    /// Number of nodes at levels that say `coarse`; 0 for as many as at the others.
    pub coarse_nodes: usize,
    /// Nodes that move each vertex, `K`.
    pub influences: usize,
    /// How distances are measured.
    pub distance: GraphDistance,
    /// How a node moves.
    pub node: NodeKind,
    /// What the rotation of a rigid node is parametrised by.
    pub rotation: RotationKind,
    /// Stiffness below which the graph does not fall where the scan shows nothing, in the unit of
    /// [`lambda_graph`](GraphLevel::lambda_graph): an edge of (7) counts `(lambda_unseen / lambda_graph)^u` times where that is more
    /// than once, with `u` the share of its nodes' vertices that have no correspondence. What is not seen then keeps the form that
    /// the blendshapes give it and goes where what is seen beside it goes. 0 for a graph that is equally stiff everywhere.
    pub lambda_unseen: f64,
    /// Standard deviation of a subject's width, height and depth (x, y and z of the template) beside what the rig's identity modes know of
    /// them, as a share: three shapes join the rig's where identities are among these. People of another kind than the rig's differ from it in
    /// proportion first. For the hybrid alone.
    pub proportions: f64,
    /// How much stiffer shapes become that a subject needs more of than the rig's own people do: a level's `lambda_blend` counts
    /// `u^distrust` times, with `u` the sum of squares of the identities' weights where the level starts, in units of two standard deviations
    /// above what the rig's own people have, if that is more than one. Such a rig knows people of another kind, and its shapes say wrongly
    /// where a smooth surface has slid to. 0 for never. For the hybrid alone.
    pub distrust: f64,
    /// Number of smooth shapes that join the rig's, if it has any, as in the model `gpmm_rig`: three for each function of the Gaussian
    /// process `smooth`; 0 for none. `lambda_blend` is their prior too. They say how much a subject differs from what its rig knows, and over which
    /// length: along a shaft, where nothing shows how far it has slid, the graph alone would slide on. For the hybrid alone.
    pub smooth_shapes: usize,
    /// The kernel of the smooth shapes.
    pub smooth: GaussianKernel,
    /// `structured` (default) or `reference`, the differentiation of Klimov 2020; the same to rounding.
    pub linearisation: Linearisation,
}

impl Default for GraphOptions {
    fn default() -> Self {
        Self {
            nodes: 400,
            coarse_nodes: 0,
            influences: 4,
            distance: GraphDistance::Surface,
            node: NodeKind::Rigid,
            rotation: RotationKind::Matrix,
            lambda_unseen: 0.0,
            proportions: 0.0,
            distrust: 0.0,
            smooth_shapes: 0,
            smooth: GaussianKernel { sigma: 0.8, length: 14.0 },
            linearisation: Linearisation::Structured,
        }
    }
}

/// Nodes that move a vertex at most: the equations grow with its square.
const MOST_INFLUENCES: usize = 64;

impl OptionTable for GraphOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::count("nodes", self.nodes)?;
        OptionsError::count("influences", self.influences)?;
        if self.influences > MOST_INFLUENCES {
            return Err(OptionsError::Conflict { key: "influences", reason: "it must be at most 64" });
        }
        OptionsError::not_negative("lambda_unseen", self.lambda_unseen)?;
        OptionsError::not_negative("proportions", self.proportions)?;
        OptionsError::not_negative("distrust", self.distrust)?;
        self.smooth.check(["smooth.sigma", "smooth.length"])?;
        if self.smooth_shapes > MOST_SHAPES {
            return Err(OptionsError::Conflict { key: "smooth_shapes", reason: "it must be at most 3000" });
        }
        if self.node == NodeKind::Affine && self.rotation != RotationKind::Matrix {
            return Err(OptionsError::Conflict {
                key: "rotation",
                reason: "affine nodes have no rotation to parametrise; leave it out, or let nodes be rigid",
            });
        }
        Ok(())
    }
}

impl GraphOptions {
    fn smooth_process(&self) -> GpmmOptions {
        GpmmOptions { kernels: vec![self.smooth], rank: self.smooth_shapes.max(1), ..GpmmOptions::default() }
    }

    /// `shapes`, and those that the options add.
    fn with_further(&self, shapes: &ShapeBasis, input: &ModelInput<'_>) -> Result<ShapeBasis, ModelError> {
        let mut all = shapes.clone();
        if self.proportions > 0.0 && shapes.shapes().iter().any(|shape| shape.family == Family::Identity) {
            all = all.joined(&ShapeBasis::proportions(input.rest, self.proportions));
        }
        if self.smooth_shapes > 0 && !shapes.is_empty() {
            all = all.joined(&self.smooth_process().basis(input.rest, input.unit)?);
        }
        Ok(all)
    }
}

/// Distance between nodes and vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraphDistance {
    /// Along the surface's edges: the two lips touch in space without sharing nodes.
    #[default]
    Surface,
    /// Through space.
    Euclidean,
}

impl GraphDistance {
    /// Graphs on the model's rest shape: one of so many nodes, and that of coarse levels, if they have one of their own.
    pub(super) fn graphs(
        self,
        input: &ModelInput<'_>,
        [nodes, coarse]: [usize; 2],
        influences: usize,
    ) -> Result<(NodeGraph, Option<NodeGraph>), ModelError> {
        let vertices = input.rest.surface_points().len();
        let graph = |nodes: usize| {
            let nodes = nodes.min(vertices.div_ceil(3));
            match self {
                Self::Surface => NodeGraph::along_surface(input.rest, nodes, influences),
                Self::Euclidean => NodeGraph::through_space(input.rest, nodes, influences),
            }
        };
        let (fine, coarse) = rayon::join(|| graph(nodes), || (coarse > 0).then(|| graph(coarse)).transpose());
        Ok((fine?, coarse?))
    }
}

/// The motion of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// Rotation and translation (Klimov 2020).
    Rigid,
    /// Any affine map, kept near the rotations by `lambda_rotation` (Sumner et al. 2007).
    Affine,
}

/// The parametrisation of a rigid node's rotation. An affine node has none: to name another than the default for it is an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationKind {
    /// A 3 x 3 matrix with steps from the left, `R <- exp(omega^) R`: [`RigidMotion`](super::RigidMotion).
    #[default]
    Matrix,
    /// A unit quaternion with the same steps: [`QuaternionMotion`](super::QuaternionMotion).
    Quaternion,
    /// The rotation vector itself, `R = exp(r^)`, `r <- r + delta`; for turns well below `2 pi`:
    /// [`AngleAxisMotion`](super::AngleAxisMotion).
    AngleAxis,
}

/// `[model]` of models of one node: the blendshapes, rigid and similarity.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OneNodeOptions {
    /// `structured` (default) or `reference`, the differentiation of Klimov 2020; the same to rounding.
    pub linearisation: Linearisation,
}

impl OptionTable for OneNodeOptions {}

/// `[level.model]` of graphs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraphLevel {
    /// `lambda_graph` of (7), per directed edge.
    pub lambda_graph: f64,
    /// Robust kernel of the edges of (7), its scale in millimetres: where the ends of an edge disagree by more on where one of them
    /// goes, the graph gives way, as at a joint, and stays stiff elsewhere.
    pub kernel: Kernel,
    /// Weight of `E_rot` of Sumner et al. 2007 per affine node, times `lambda_graph` and the square of a node's reach
    /// ([`NodeGraph::squared_reach`]): dimensionless, and a ratio to (7), so that softening `lambda_graph` softens both.
    pub lambda_rotation: f64,
    /// Whether the graph has [`GraphOptions::coarse_nodes`] at this level, which is faster and enough where it is stiff. Not where a
    /// registration goes on from another one's end, whose nodes it keeps.
    pub coarse: bool,
}

impl OptionTable for GraphLevel {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("lambda_graph", self.lambda_graph)?;
        OptionsError::kernel(self.kernel)?;
        OptionsError::not_negative("lambda_rotation", self.lambda_rotation)
    }
}

/// Keys of a graph, and of its levels, that say something else than the default and have no effect, and why; with these shapes, if they
/// are known.
pub(crate) fn without_effect<'a>(
    graph: &Options,
    levels: impl Iterator<Item = &'a Options> + Clone,
    shapes: Option<&[Shape]>,
) -> Vec<(&'static str, &'static str)> {
    let usual = Options::of(&GraphOptions::default());
    let other = |key: &str| graph.get(key).is_some_and(|value| Some(value) != usual.get(key));
    let rigid = graph.get("node").is_some_and(|node| Some(node) == usual.get("node"));
    let rotates = levels.clone().any(|level| level.number("lambda_rotation").is_some_and(|lambda| lambda > 0.0));
    let sparse = || levels.clone().filter(|level| level.number("sparse").is_some_and(|scale| scale > 0.0));
    let weighs = |level: &Options| level.number("lambda_blend").is_some_and(|lambda| lambda > 0.0);
    let no_expression = shapes.is_some_and(|shapes| !shapes.iter().any(Shape::from_zero_to_one));
    let said = [
        ("sparse", no_expression && sparse().next().is_some(), "no shape is an expression with one of ARKit's names"),
        ("sparse", !no_expression && sparse().any(|level| !weighs(level)), "lambda_blend is 0 beside it"),
        ("smooth", other("smooth") && !other("smooth_shapes"), "smooth_shapes is 0"),
        (
            "coarse_nodes",
            other("coarse_nodes") && !levels.clone().any(|level| level.flag("coarse")),
            "no level is coarse",
        ),
        ("lambda_rotation", rigid && rotates, "rigid nodes are rotations"),
    ];
    said.into_iter().filter(|(_, idle, _)| *idle).map(|(key, _, why)| (key, why)).collect()
}

/// The hybrid, or the graph where `shapes` is empty, with nodes as `[model]` says.
pub(super) fn build(
    name: &'static str,
    input: &ModelInput<'_>,
    shapes: &ShapeBasis,
) -> Result<Box<dyn RegistrationModel>, ModelError> {
    fn with<T: NodeTransform<W>, const W: usize>(
        name: &'static str,
        input: &ModelInput<'_>,
        shapes: &ShapeBasis,
        options: &GraphOptions,
    ) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let GraphOptions { distance, nodes, coarse_nodes, influences, .. } = *options;
        let graphs = || distance.graphs(input, [nodes, coarse_nodes], influences);
        let (graphs, all_shapes) = rayon::join(graphs, || options.with_further(shapes, input));
        let (nodes, other_graph) = graphs?;
        let rest = input.rest.positions.clone();
        let mut model = Hybrid::<T, W>::named(name, rest, nodes, all_shapes?, Stiffness::default());
        model.reported_shapes = shapes.len();
        model.linearisation = options.linearisation;
        model.lambda_unseen = options.lambda_unseen;
        model.distrust = options.distrust;
        model.other_graph = other_graph;
        Ok(Box::new(model))
    }
    let options = input.options.read::<GraphOptions>()?;
    match (options.node, options.rotation) {
        (NodeKind::Affine, _) => with::<AffineMotion, 12>(name, input, shapes, &options),
        (NodeKind::Rigid, RotationKind::Matrix) => with::<RigidMotion, 6>(name, input, shapes, &options),
        (NodeKind::Rigid, RotationKind::Quaternion) => with::<QuaternionMotion, 6>(name, input, shapes, &options),
        (NodeKind::Rigid, RotationKind::AngleAxis) => with::<AngleAxisMotion, 6>(name, input, shapes, &options),
    }
}

/// The graph of a patch, and its `lambda_graph`.
pub(super) fn on_patch(input: &PatchInput<'_>) -> Result<(NodeGraph, f64), ModelError> {
    let nodes = NodeGraph::on_region(input.mesh, input.held, input.nodes.min(input.moving.div_ceil(2)))?;
    let edge = |e: &(u32, u32)| (nodes.nodes()[e.0 as usize] - nodes.nodes()[e.1 as usize]).norm_squared();
    // A residual of (7) sees the change along its edge: half of the gradient's square, times the edge's.
    let squares: f64 = 0.5 * nodes.edges().iter().map(edge).sum::<f64>();
    let (weight, area) = (input.gradient_weight(), input.vertex_area * input.moving as f64);
    Ok((nodes, if squares > 0.0 { weight * area / squares } else { weight }))
}

/// A model of one node, with the linearisation that `[model]` names.
pub(super) fn one_node<T: NodeTransform<W>, const W: usize>(
    mut model: Hybrid<T, W>,
    options: &Options,
) -> Result<Box<dyn RegistrationModel>, ModelError> {
    model.linearisation = options.read::<OneNodeOptions>()?.linearisation;
    Ok(Box::new(model))
}

impl<T: NodeTransform<W>, const W: usize> RegistrationModel for Hybrid<T, W> {
    /// Which of them there are is the factory's business.
    fn set_level(&mut self, options: &Options, unit: f64) -> Result<(), OptionsError> {
        let lambda = |key: &str| options.number(key).unwrap_or(0.0);
        let kernel =
            options.get("kernel").map(|kernel| Options::new().with("kernel", kernel.clone()).read::<HybridLevel>());
        self.stiffness = Stiffness {
            graph: lambda("lambda_graph"),
            kernel: kernel.transpose()?.map_or(Kernel::None, |level| level.kernel.scaled(unit)),
            rotation: lambda("lambda_rotation"),
            blend: lambda("lambda_blend") * unit * unit,
        };
        self.shapes.set_sparse(lambda("sparse"));
        Ok(())
    }

    fn set_resolution(&mut self, options: &Options, x: &[f64]) -> Option<Vec<f64>> {
        if options.flag("coarse") == self.coarse {
            return None;
        }
        let other = self.other_graph.take()?;
        let (before, parameters) = self.exchange_graph(other, x);
        self.other_graph = Some(before);
        self.coarse = !self.coarse;
        Some(parameters)
    }

    fn trust_shapes(&mut self, x: &[f64]) {
        self.stiffness.blend *= self.shapes().unlikeliness(self.weights(x)).max(1.0).powf(self.distrust);
    }

    fn set_unseen(&mut self, unseen: &[f64]) {
        let graph = self.stiffness.graph;
        self.stiffen_unseen(unseen, if graph > 0.0 { (self.lambda_unseen / graph).max(1.0) } else { 1.0 });
    }

    fn prediction(&mut self, x: &[f64], _rest: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(self.blended(x));
    }

    fn named_weights(&self, x: &[f64]) -> Vec<(String, f64)> {
        let named = self.shapes().shapes().iter().map(|s| s.name.clone()).zip(self.weights(x).iter().copied());
        named.take(self.reported_shapes).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::DeformationModel as _;
    use crate::mesh::testing::{noise, sheet};
    use crate::model::{ModelFactory as _, ModelKind};

    #[test]
    fn further_shapes_join_a_rig_and_are_not_reported() {
        let rest = sheet(9, 9, |c, r| Vec3::new(c, r, 0.1 * (c - r)));
        let shapes_of = |family: Family| {
            let name = |k: usize| Shape { name: format!("mode_{k}"), family };
            ShapeBasis::new((0..2).map(name).collect(), (0..2 * 3 * 81).map(|i| noise(i) as f32).collect())
        };
        let (rig, expressions) = (shapes_of(Family::Identity), shapes_of(Family::Expression));
        let smooth = |count: i64| Options::new().with("nodes", 9).with("smooth_shapes", count);
        let proportions = |share: f64| Options::new().with("nodes", 9).with("proportions", share);
        let build = |shapes: &ShapeBasis, options: &Options| {
            let options = &ModelKind::Hybrid.options(options).unwrap();
            let input = ModelInput { rest: &rest, shapes, options, reference_vertices: 81.0, unit: 1.0, regions: None };
            ModelKind::Hybrid.build(&input).unwrap()
        };
        let without = build(&rig, &smooth(0));
        let names = |model: &dyn RegistrationModel| model.named_weights(&model.rest_parameters());
        for (options, further) in [(smooth(6), 6), (proportions(0.02), 3)] {
            let with = build(&rig, &options);
            assert_eq!(with.parameter_len(), without.parameter_len() + further);
            assert_eq!(names(&*with).iter().map(|w| w.0.as_str()).collect::<Vec<_>>(), ["mode_0", "mode_1"]);
            assert_eq!(names(&*with), names(&*without));
        }
        // Somebody whose neutral is known has known proportions.
        assert_eq!(build(&expressions, &proportions(0.02)).parameter_len(), without.parameter_len());
        let bad = [
            (smooth(3001), "smooth_shapes: it must"),
            (smooth(6).with("smooth", toml::toml! { sigma = -1.0 length = 7.0 }), "smooth.sigma"),
            (proportions(-0.1), "proportions"),
        ];
        for (options, start) in bad {
            let error = ModelKind::Hybrid.options(&options).err().unwrap().to_string();
            assert!(error.starts_with(start), "{error}");
        }
        let none = ShapeBasis::none();
        assert_eq!(build(&none, &smooth(6)).parameter_len(), build(&none, &smooth(0)).parameter_len());
        for (options, key) in [
            (smooth(6), "smooth_shapes"),
            (proportions(0.02), "proportions"),
            (Options::new().with("distrust", 5.0), "distrust"),
        ] {
            let error = ModelKind::Graph.options(&options).err().unwrap().to_string();
            assert!(error.starts_with(&format!("{key}: the graph has no shapes")), "{error}");
        }
    }
}
