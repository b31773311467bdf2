//! Klimov's hybrid: blendshapes inside a deformation graph, both solved together, eqs. (4) to (9) of Klimov 2020; and, with one node
//! or without shapes, rigid, similarity, blendshape, graph and Sumner's graph.
//!
//! ```text
//!     b_i(w) = n_i + sum_k w_k delta_ik                                       (4)
//!     v_i    = sum_j omega_ij ( T_j(b_i - x_j) + x_j )                        (6), (8)   T_j(q) = A_j q + t_j
//!     E_smooth = lambda_graph sum_(i,j) s_ij rho(|T_i(x_j - x_i) + x_i - T_j(0) - x_j|^2)     (7)
//!              + lambda_graph lambda_rotation d^2 sum_j E_rot(A_j)                               affine nodes only
//!              + lambda_blend sum_k (w_k / sigma_k)^2                                    (5), or sparse: [`ShapeBasis::prior`]
//!              + lambda_blend sum_k ((w_k - clamp(w_k, 0, 1)) / sigma_beyond)^2          [`ShapeBasis::with_beyond`]
//! ```
//!
//! `s_ij` is 1 unless a registration [stiffens](Hybrid::stiffen_unseen) what it does not see; `rho` is plain least squares or, where
//! subjects bend at joints, a [robust kernel](Stiffness::kernel). (Klimov 2020; `E_rot`: Sumner et al. 2007, [`NodeTransform::rotation_residuals`].) `A_j` is a rotation, a scaled rotation or
//! any 3 x 3. Rigid and similarity have one node and no shapes, blendshape one node, graph no shapes. `d`, the reach of a node,
//! makes `lambda_rotation` free of units: `d^2` is [`NodeGraph::squared_reach`].
//!
//! Derivatives are forward-mode, but no dual number ever carries a blendshape weight, and none is multiplied once per vertex:
//! duals differentiate the twelve entries of a node's `[A_j t_j]` by the node's tangent, six of them for a rigid node, twelve for
//! an affine one. A vertex is linear in these entries, and `b_i` is linear in `w`:
//!
//! ```text
//!     dv_i/dT_j = omega_ij d[A_j t_j] [b_i - x_j; 1]                     ([`MapJacobians`])
//!     dv_i/dw = Rbar_i B_i,   Rbar_i = sum_j omega_ij A_j,   B_i the constant 3 x nb slab of vertex i
//! ```
//!
//! With `A_s` the (at most three) rows of sample `s`' quadric, `Y_sj = A_s dv_s/dT_j` and `U_s = A_s dv_s/dw`:
//!
//! ```text
//!     H_jk = sum_s Y_sj' Y_sk        H_jw = sum_s Y_sj' U_s        H_ww = sum_s U_s' U_s
//! ```

mod moments;
mod reference;
mod regulariser;
mod resolution;
mod samples;

use std::marker::PhantomData;

use num_dual::DualSVec64;
use pulp::Simd;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::moments::Moments;
use self::reference::Strided;
use self::regulariser::GraphRegulariser;
use self::samples::{Blended, NodeSamples, Structured};
use super::factory::BuiltIn;
use super::transform::{AffineMap, NodeTransform, RigidMotion};
use super::{GraphOptions, NodeGraph, node_options};
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, OptionsError, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::dense_kernels::{Tile, padded, sum_of_products, sweep, vectorized};
use crate::nlls::{Assembly, BlockStructure, Kernel, Manifold, NormalEquations, PointArray, Scalar};
use crate::rig::ShapeBasis;

/// Vertices that one task places.
const CHUNK: usize = 512;

/// Length of a row of derivatives by a node's tangent in [`MapJacobians`]: that of an item's, which has its residual after it.
const fn pitch<const W: usize>() -> usize {
    padded(W + 1)
}

/// How stiff the model is; changed from level to level of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stiffness {
    /// `lambda_graph` of (7), per directed edge.
    pub graph: f64,
    /// Robust kernel of the residuals of (7), scale in millimetres: where an edge's ends disagree by more, the graph gives way.
    pub kernel: Kernel,
    /// `lambda_rotation`: weight of `E_rot` per affine node against (7), dimensionless.
    pub rotation: f64,
    /// `lambda_blend` of (5), per shape.
    pub blend: f64,
}

/// How derivatives are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Linearisation {
    /// Duals of static width per node contribution; blendshapes enter as constant slabs.
    #[default]
    Structured,
    /// The paper's way: every sample differentiated by all of its node and shape parameters, in strides of 16 duals.
    /// Slower the more shapes there are; agrees with `Structured` to rounding.
    Reference,
}

/// The hybrid, eq. (8): blendshapes inside a deformation graph, with node motions of type `T`, of tangent dimension `W`: rigid unless
/// stated. The other models of nodes and blendshapes are this one with one node, or without shapes.
pub struct Hybrid<T = RigidMotion, const W: usize = 6> {
    name: &'static str,
    rest: Vec<Vec3>,
    graph: NodeGraph,
    pub(super) shapes: ShapeBasis,
    /// How many of the shapes, the first ones, are a rig's and have weights to report.
    pub(super) reported_shapes: usize,
    /// Regulariser weights.
    pub stiffness: Stiffness,
    /// How [`pull_back`](DeformationModel::pull_back) differentiates.
    pub linearisation: Linearisation,
    /// [`GraphOptions::lambda_unseen`](super::GraphOptions::lambda_unseen).
    pub lambda_unseen: f64,
    /// [`GraphOptions::distrust`](super::GraphOptions::distrust).
    pub distrust: f64,
    /// The graph of the other kind of levels: of the coarse ones, at a fine one. None if all have the same.
    pub(super) other_graph: Option<NodeGraph>,
    /// Whether the graph is that of coarse levels.
    pub(super) coarse: bool,
    placed: Placement,
    samples: NodeSamples,
    assembly: Assembly,
    /// Of the samples, without blendshapes.
    moments: Option<Moments>,
    regulariser: GraphRegulariser<W>,
    /// Node maps with their tangents seeded, at the last linearisation, and their derivatives as numbers.
    seeded: Vec<AffineMap<DualSVec64<W>>>,
    map_jacobians: MapJacobians<W>,
    transform: PhantomData<T>,
}

/// Everything that follows from `x` alone, kept until `x` changes.
#[derive(Default)]
struct Placement {
    x: Vec<f64>,
    maps: Vec<AffineMap<f64>>,
    blend: Vec<Vec3>,
    /// Empty until somebody asks.
    positions: Vec<Vec3>,
}

impl Hybrid {
    /// The hybrid model on the rest positions `rest` (the neutral, millimetres).
    ///
    /// # Panics
    /// If graph, shapes and rest positions do not have the same number of vertices.
    #[must_use]
    pub fn new(rest: Vec<Vec3>, graph: NodeGraph, shapes: ShapeBasis, stiffness: Stiffness) -> Self {
        Self::with_motion(rest, graph, shapes, stiffness)
    }
}

impl<T: NodeTransform<W>, const W: usize> Hybrid<T, W> {
    /// [`Hybrid::new`] with nodes that move as `T` says, such as [`QuaternionMotion`](super::QuaternionMotion) or the
    /// [`AffineMotion`](super::AffineMotion) of Sumner et al. 2007.
    ///
    /// # Panics
    /// If graph, shapes and rest positions do not have the same number of vertices.
    #[must_use]
    pub fn with_motion(rest: Vec<Vec3>, graph: NodeGraph, shapes: ShapeBasis, stiffness: Stiffness) -> Self {
        Self::named("hybrid", rest, graph, shapes, stiffness)
    }

    /// Shapes and graph on the rest positions, under a name of their own in reports.
    pub(super) fn named(
        name: &'static str,
        rest: Vec<Vec3>,
        graph: NodeGraph,
        shapes: ShapeBasis,
        stiffness: Stiffness,
    ) -> Self {
        assert_eq!(graph.vertex_count(), rest.len(), "graph and rest positions must have as many vertices");
        assert!(
            shapes.is_empty() || shapes.vertex_count() == rest.len(),
            "shapes and rest positions must have as many vertices"
        );
        Self {
            name,
            regulariser: GraphRegulariser::new(&graph, &rest),
            rest,
            graph,
            reported_shapes: shapes.len(),
            shapes,
            stiffness,
            linearisation: Linearisation::default(),
            lambda_unseen: 0.0,
            distrust: 0.0,
            other_graph: None,
            coarse: false,
            placed: Placement::default(),
            samples: NodeSamples::default(),
            assembly: Assembly::default(),
            moments: None,
            seeded: Vec::new(),
            map_jacobians: MapJacobians::default(),
            transform: PhantomData,
        }
    }

    /// The deformation graph.
    #[must_use]
    pub fn graph(&self) -> &NodeGraph {
        &self.graph
    }

    /// The blendshapes.
    #[must_use]
    pub fn shapes(&self) -> &ShapeBasis {
        &self.shapes
    }

    /// The rest positions `n_i`.
    #[must_use]
    pub fn rest(&self) -> &[Vec3] {
        &self.rest
    }

    /// The blendshape weights `w` in `x`.
    #[must_use]
    pub fn weights<'a>(&self, x: &'a [f64]) -> &'a [f64] {
        weights_in::<T, W>(x, &self.graph)
    }

    /// Stiffens the graph where nothing is seen: each edge of (7) counts `factor^u` times, with `u` the mean over both ends of
    /// the share, by influence, of a node's vertices that are `unseen` (0 to 1 each, one per vertex).
    ///
    /// # Panics
    /// If there is not one share per vertex.
    pub fn stiffen_unseen(&mut self, unseen: &[f64], factor: f64) {
        assert_eq!(unseen.len(), self.rest.len(), "one share per vertex");
        self.regulariser.stiffen(&self.graph, unseen, factor);
    }

    /// `b_i(w)`, eq. (4), at `x`: the shape before the graph moves it.
    pub fn blended(&mut self, x: &[f64]) -> &[Vec3] {
        self.place(x);
        &self.placed.blend
    }

    fn place(&mut self, x: &[f64]) {
        if self.placed.x == x && !self.placed.maps.is_empty() {
            return;
        }
        self.placed.positions.clear();
        self.seeded.clear();
        self.placed.x.clear();
        self.placed.x.extend_from_slice(x);
        self.placed.maps.clear();
        self.placed.maps.extend((0..self.graph.nodes().len()).map(|j| T::map(node_point::<T, W>(x, &self.graph, j))));
        let (rest, shapes, w) = (&self.rest, &self.shapes, weights_in::<T, W>(x, &self.graph));
        self.placed.blend.resize(rest.len(), Vec3::zeros());
        self.placed.blend.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            vectorized(
                #[inline(always)]
                || {
                    for (k, b) in chunk.iter_mut().enumerate() {
                        let i = c * CHUNK + k;
                        *b = shapes.blend(i, rest[i], w);
                    }
                },
            );
        });
    }

    /// Seeds every node's map at `x`, where the nodes are placed.
    fn seed_nodes(&mut self, x: &[f64]) {
        self.place(x);
        if !self.seeded.is_empty() {
            return;
        }
        let tangent: [DualSVec64<W>; W] = std::array::from_fn(|t| DualSVec64::from_re(0.0).derivative(t));
        let graph = &self.graph;
        self.seeded.extend((0..graph.nodes().len()).map(|j| moved_map::<T, W, _>(x, graph, j, &tangent)));
        self.map_jacobians.set(&self.seeded);
    }
}

/// The nodes' maps `[A t]` at some parameters, and the derivatives of their entries by the tangent.
#[derive(Default)]
struct MapJacobians<const W: usize> {
    values: Vec<AffineMap<f64>>,
    /// By node, row of `[A t]` and its column; padded to [`pitch`].
    derivatives: Vec<f64>,
}

impl<const W: usize> MapJacobians<W> {
    fn set(&mut self, seeded: &[AffineMap<DualSVec64<W>>]) {
        self.values.clear();
        self.derivatives.clear();
        for map in seeded {
            self.values.push(AffineMap {
                linear: map.linear.map(|row| row.map(|e| e.re)),
                translation: map.translation.map(|e| e.re),
            });
            for a in 0..3 {
                for entry in map.linear[a].iter().chain([&map.translation[a]]) {
                    self.derivatives.extend(derivatives(entry));
                    self.derivatives.resize(self.derivatives.len() + pitch::<W>() - W, 0.0);
                }
            }
        }
    }

    #[inline(always)]
    fn value(&self, node: usize) -> &AffineMap<f64> {
        &self.values[node]
    }

    /// Derivatives of row `a` of a node's `[A t]`, column by column, padded.
    #[inline(always)]
    fn of_row(&self, node: usize, a: usize) -> &[f64] {
        &self.derivatives[(node * 3 + a) * 4 * pitch::<W>()..][..4 * pitch::<W>()]
    }

    /// Derivatives of entry `a` of a node's `t`.
    #[inline(always)]
    fn of_translation(&self, node: usize, a: usize) -> &[f64; W] {
        self.of_row(node, a)[3 * pitch::<W>()..].first_chunk().expect("proven: the pitch is at least W")
    }

    /// `out += row d(A q + t)`: how the component along `row` of where `q` goes changes with a node's tangent.
    #[inline(always)]
    fn add_pulled_back<S: Simd>(&self, simd: S, node: usize, row: [f64; 3], q: [f64; 3], out: &mut [f64]) {
        let derivatives = &self.derivatives[node * 12 * pitch::<W>()..][..12 * pitch::<W>()];
        let mut factors = [0.0; 12];
        for a in 0..3 {
            for c in 0..3 {
                factors[4 * a + c] = row[a] * q[c];
            }
            factors[4 * a + 3] = row[a];
        }
        sweep::<S, 1>(simd, pitch::<W>(), &mut PullBack::<W> { factors, derivatives, out });
    }
}

struct PullBack<'a, const W: usize> {
    factors: [f64; 12],
    derivatives: &'a [f64],
    out: &'a mut [f64],
}

impl<const W: usize> Tile for PullBack<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let entries = self.derivatives.chunks_exact(pitch::<W>());
        let terms = self.factors.iter().zip(entries).map(|(factor, d)| (std::slice::from_ref(factor), &d[first..]));
        let [sum] = sum_of_products::<S, _, 1, V>(simd, terms);
        let out = &mut S::as_mut_simd_f64s(&mut self.out[first..]).0[..V];
        for v in 0..V {
            out[v] = simd.add_f64s(out[v], sum[v]);
        }
    }
}

/// Where the parameters of node `j` lie in `x`.
#[inline(always)]
fn node_range<T: NodeTransform<W>, const W: usize>(j: usize) -> std::ops::Range<usize> {
    j * T::Parameters::AMBIENT..(j + 1) * T::Parameters::AMBIENT
}

/// The blendshape weights in `x`.
fn weights_in<'a, T: NodeTransform<W>, const W: usize>(x: &'a [f64], graph: &NodeGraph) -> &'a [f64] {
    &x[graph.free_nodes() * T::Parameters::AMBIENT..]
}

/// Node `j` at `x`.
#[inline(always)]
fn node_point<'a, T: NodeTransform<W>, const W: usize>(x: &'a [f64], graph: &NodeGraph, j: usize) -> &'a [f64] {
    if j < graph.free_nodes() { &x[node_range::<T, W>(j)] } else { T::IDENTITY }
}

/// The map of node `j` at `x`, moved by `tangent` unless it is fixed.
#[inline(always)]
fn moved_map<T: NodeTransform<W>, const W: usize, D: Scalar>(
    x: &[f64],
    graph: &NodeGraph,
    j: usize,
    tangent: &[D],
) -> AffineMap<D> {
    let mut point = <T::Parameters as Manifold>::Point::<D>::filled(D::from(0.0));
    if j < graph.free_nodes() {
        T::Parameters::plus(&x[node_range::<T, W>(j)], tangent, point.as_mut());
    } else {
        point.as_mut().iter_mut().zip(T::IDENTITY).for_each(|(p, i)| *p = D::from(*i));
    }
    T::map(point.as_ref())
}

#[inline(always)]
fn derivatives<const W: usize>(d: &DualSVec64<W>) -> [f64; W] {
    d.eps.0.map_or([0.0; W], |e| std::array::from_fn(|k| e[k]))
}

impl<T: NodeTransform<W>, const W: usize> DeformationModel for Hybrid<T, W> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn vertex_count(&self) -> usize {
        self.rest.len()
    }

    fn parameter_len(&self) -> usize {
        self.graph.free_nodes() * T::Parameters::AMBIENT + self.shapes.len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.parameter_len()];
        for j in 0..self.graph.free_nodes() {
            x[node_range::<T, W>(j)].copy_from_slice(T::IDENTITY);
        }
        x
    }

    fn border_bounds(&self) -> Option<(&[f64], &[f64])> {
        self.shapes.bounds()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.rest.len(), "samples were made for another template");
        self.assembly = Assembly::default(); // its memory serves the next one
        self.samples = NodeSamples::new(samples, &self.graph);
        let edges = self.regulariser.items::<T>(&self.graph);
        let items = || self.samples.all_nodes();
        let pairs = Assembly::pairs(items().chain(edges.iter().map(Vec::as_slice)));
        let structure = BlockStructure::new(&vec![W; self.graph.free_nodes()], pairs, self.shapes.len())
            .expect("proven: all pairs are nodes of the graph");
        let Self { regulariser, samples, .. } = &mut *self;
        let of_samples = || Assembly::new(samples.all_nodes(), &structure, |_| 3);
        (self.assembly, ()) = rayon::join(of_samples, || regulariser.analyse(&edges, &structure));
        let at_rest = Blended { graph: &self.graph, shapes: &self.shapes, vertices: &self.rest };
        self.moments = self.shapes.is_empty().then(|| Moments::new(&self.samples, at_rest, &structure));
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.place(x);
        let Placement { maps, blend, positions, .. } = &mut self.placed;
        if positions.is_empty() {
            positions.resize(self.rest.len(), Vec3::zeros());
            let graph = &self.graph;
            positions.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
                vectorized(
                    #[inline(always)]
                    || {
                        for (k, v) in chunk.iter_mut().enumerate() {
                            let i = c * CHUNK + k;
                            for &(j, omega) in graph.influences(i) {
                                let x_j = graph.nodes()[j as usize];
                                *v += (Vec3::from(maps[j as usize].apply((blend[i] - x_j).into())) + x_j) * omega;
                            }
                        }
                    },
                );
            });
        }
        out.clone_from(positions);
    }

    fn pull_back(&mut self, x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.seed_nodes(x);
        let (samples, quadrics) = (&self.samples, field.quadrics());
        let blended = Blended { graph: &self.graph, shapes: &self.shapes, vertices: &self.placed.blend };
        match self.linearisation {
            Linearisation::Structured => {
                let moments = self.moments.as_mut();
                if moments.is_some_and(|m| m.add_to(samples, field, &self.map_jacobians, equations)) {
                    return;
                }
                let rows = Structured { samples, maps: &self.map_jacobians, quadrics, blended };
                self.assembly.linearize_by(self.shapes.len(), &mut Vec::new(), &rows);
            }
            Linearisation::Reference => {
                let rows = Strided { samples, x, quadrics, blended, transform: self.transform };
                self.assembly.linearize_by(self.shapes.len(), &mut Vec::new(), &rows);
            }
        }
        self.assembly.add_to(equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.place(x);
        self.regulariser.energy::<T>(&self.graph, &self.placed.maps, &self.stiffness, out);
        if !self.shapes.is_empty() {
            let sum: f64 = self.weights(x).iter().enumerate().map(|(k, w)| self.shapes.prior(k, *w)[0]).sum();
            out.push(("blendshape prior (5)", self.stiffness.blend * sum));
        }
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.seed_nodes(x);
        let nodes = (self.seeded.as_slice(), &self.map_jacobians);
        self.regulariser.add_to::<T>(&self.graph, nodes, &self.stiffness, equations);
        let (nb, lambda) = (self.shapes.len(), self.stiffness.blend);
        let start = equations.structure().sparse_dimension();
        for (k, w) in self.weights(x).iter().enumerate() {
            let [_, slope, curvature] = self.shapes.prior(k, *w);
            equations.border[k * nb + k] += lambda * curvature;
            equations.gradient[start + k] += lambda * slope;
        }
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        let n = self.graph.free_nodes();
        for j in 0..n {
            let range = node_range::<T, W>(j);
            T::Parameters::plus(&x[range.clone()], &step[j * W..(j + 1) * W], &mut out[range.clone()]);
            T::Parameters::normalize(&mut out[range]);
        }
        for k in 0..self.shapes.len() {
            out[n * T::Parameters::AMBIENT + k] = x[n * T::Parameters::AMBIENT + k] + step[n * W + k];
        }
    }
}

/// `[level.model]` of the hybrid.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HybridLevel {
    /// `lambda_graph` of (7), per directed edge.
    pub lambda_graph: f64,
    /// As [`GraphLevel::kernel`](super::GraphLevel::kernel).
    pub kernel: Kernel,
    /// `lambda_blend` of (5), per shape.
    pub lambda_blend: f64,
    /// Scale of the sparse prior of expressions whose weights are meant to lie between 0 and 1, which stands for theirs in (5)
    /// ([`ShapeBasis::prior`]): a face makes few of them at a time, and many small ones explain what else the rig misses. 0 for (5).
    pub sparse: f64,
    /// As [`GraphLevel::lambda_rotation`](super::GraphLevel::lambda_rotation).
    pub lambda_rotation: f64,
    /// As [`GraphLevel::coarse`](super::GraphLevel::coarse).
    pub coarse: bool,
}

impl OptionTable for HybridLevel {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("lambda_graph", self.lambda_graph)?;
        OptionsError::kernel(self.kernel)?;
        OptionsError::not_negative("lambda_blend", self.lambda_blend)?;
        OptionsError::not_negative("sparse", self.sparse)?;
        OptionsError::not_negative("lambda_rotation", self.lambda_rotation)
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<GraphOptions>("hybrid", include_str!("../schedules/hybrid.toml"), |input| {
        node_options::build("hybrid", input, input.shapes)
    })
    .with_level::<HybridLevel>()
    .using_shapes()
    .on_patch(&["smoothing", "nodes", "prior"], |input| {
        let (nodes, graph) = node_options::on_patch(input)?;
        let stiffness = Stiffness { graph, blend: input.shape_weight(), ..Stiffness::default() };
        Ok(Box::new(Hybrid::new(input.mesh.positions.clone(), nodes, input.shapes.clone(), stiffness)))
    });
