//! The one assembly behind rigid, similarity, graph, blendshape and hybrid: blendshapes inside a deformation graph.
//!
//! ```text
//!     b_i(w) = n_i + sum_k w_k delta_ik                                       (4)
//!     v_i    = sum_j omega_ij ( T_j(b_i - x_j) + x_j )                        (6), (8)   T_j(q) = R_j q + t_j
//!     E_smooth = lambda_graph sum_(i,j) |T_i(x_j - x_i) + x_i - T_j(0) - x_j|^2          (7)
//!              + lambda_blend sum_k (w_k / sigma_k)^2                                    (5)
//! ```
//!
//! (Klimov 2020.) Rigid and similarity have one node and no shapes, blendshape one node, graph no shapes.
//!
//! Derivatives are forward-mode, but no dual number ever carries a blendshape weight: a node's contribution to a vertex is
//! a function of the node's tangent parameters and of `b_i`, nine duals for a rigid node, and `b_i` is linear in `w`:
//!
//! ```text
//!     dv_i/dw = Rbar_i B_i,   Rbar_i = sum_j omega_ij dT_j/dq,   B_i the constant 3 x nb slab of vertex i
//! ```
//!
//! With `A_s` the (at most three) rows of sample `s`' quadric, `Y_sj = A_s dv_s/dT_j` and `U_s = A_s dv_s/dw`:
//!
//! ```text
//!     H_jk = sum_s Y_sj' Y_sk        H_jw = sum_s Y_sj' U_s        H_ww = sum_s U_s' U_s
//! ```

use num_dual::DualSVec64;
use rayon::prelude::*;

use super::NodeGraph;
use super::transform::{AffineMap, NodeTransform};
use crate::energy::{DeformationModel, NamedEnergy, Quadric, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::dense_kernels::{add_outer, rank_update_lower, vectorized};
use crate::nlls::{BlockRow, BlockStructure, Manifold, NormalEquations, PointArray, Scalar};
use crate::rig::ShapeBasis;

/// How stiff the model is; changed from level to level of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stiffness {
    /// `lambda_graph` of (7), per directed edge.
    pub graph: f64,
    /// `lambda_blend` of (5), per shape.
    pub blend: f64,
}

/// How derivatives are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Linearisation {
    /// Duals of static width per node contribution; blendshapes enter as constant slabs.
    #[default]
    Structured,
    /// The paper's way: every sample differentiated by all of its node and shape parameters, in strides of 16 duals.
    /// Slower the more shapes there are; agrees with `Structured` to rounding.
    Reference,
}

/// Blendshapes inside a deformation graph, with node motions of type `T`; `W` is `T`'s tangent dimension plus three.
pub struct NodeAssembly<T, const W: usize> {
    name: &'static str,
    rest: Vec<Vec3>,
    graph: NodeGraph,
    pub(super) shapes: ShapeBasis,
    /// Regulariser weights.
    pub stiffness: Stiffness,
    /// How [`pull_back`](DeformationModel::pull_back) differentiates.
    pub linearisation: Linearisation,
    placed: Placement,
    chunks: Vec<SampleChunk<W>>,
    node_samples: Vec<Vec<NodeSample>>,
    border_partials: Vec<f64>,
    edges: Vec<EdgeJacobian<W>>,
    node_edges: Vec<Vec<NodeEdge>>,
    /// Node maps with their tangents seeded, at the last linearisation.
    seeded: Vec<AffineMap<DualSVec64<W>>>,
    transform: std::marker::PhantomData<T>,
}

/// Everything that follows from `x` alone, kept until `x` changes.
#[derive(Default)]
struct Placement {
    x: Vec<f64>,
    maps: Vec<AffineMap<f64>>,
    blend: Vec<Vec3>,
}

/// A fixed run of samples with their Jacobians: the unit of parallel work.
struct SampleChunk<const W: usize> {
    samples: Vec<SampleSlots>,
    corners: Vec<Corner>,
    /// Node of each slot.
    nodes: Vec<u32>,
    /// For slots `p >= q` of a sample, where in block row `nodes[p]` block (`nodes[p]`, `nodes[q]`) starts.
    targets: Vec<u32>,
    /// Rows of each sample's quadric in use, and where its rows start in `u`.
    row_counts: Vec<u8>,
    row_starts: Vec<u32>,
    /// `Y_sj`: per slot up to three rows; entry `W - 3` and beyond unused.
    y: Vec<[[f64; W]; 3]>,
    /// `(dv_s/dT_j)' g_s` per slot.
    g: Vec<[f64; W]>,
    /// `U_s`: rows of nb.
    u: Vec<f64>,
    /// `sum_s (dv_s/dw)' g_s`.
    g_shapes: Vec<f64>,
}

struct SampleSlots {
    corners: std::ops::Range<u32>,
    slots: std::ops::Range<u32>,
    targets: u32,
}

/// One vertex of a sample with its weight, and the slot of each of the vertex' influences.
struct Corner {
    vertex: u32,
    weight: f64,
    slots: Vec<u32>,
}

/// A sample that a node moves: its chunk, index in the chunk and slot within the sample.
struct NodeSample {
    chunk: u32,
    sample: u32,
    slot: u32,
}

/// Residual of (7) and its derivatives by the tangents of both ends.
#[derive(Clone)]
struct EdgeJacobian<const W: usize> {
    residual: [f64; 3],
    source: [[f64; W]; 3],
    target: [[f64; W]; 3],
}

/// A directed edge at one of its ends; `block` is where the block with the other end starts, if it lies in this row.
struct NodeEdge {
    edge: u32,
    is_source: bool,
    block: Option<u32>,
}

const CHUNK: usize = 512;

impl<T: NodeTransform<W>, const W: usize> NodeAssembly<T, W> {
    /// Shapes and graph on the rest positions `n_i` (millimetres).
    ///
    /// # Panics
    /// If graph, shapes and rest positions do not have the same number of vertices.
    #[must_use]
    pub fn new(
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
            rest,
            graph,
            shapes,
            stiffness,
            linearisation: Linearisation::default(),
            placed: Placement::default(),
            chunks: Vec::new(),
            node_samples: Vec::new(),
            border_partials: Vec::new(),
            edges: Vec::new(),
            node_edges: Vec::new(),
            seeded: Vec::new(),
            transform: std::marker::PhantomData,
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
        &x[self.node_count() * T::Parameters::AMBIENT..]
    }

    /// `b_i(w)`, eq. (4), at `x`: the shape before the graph moves it.
    pub fn blended(&mut self, x: &[f64]) -> &[Vec3] {
        self.place(x);
        &self.placed.blend
    }

    fn node_count(&self) -> usize {
        self.graph.nodes().len()
    }

    fn place(&mut self, x: &[f64]) {
        if self.placed.x == x && !self.placed.maps.is_empty() {
            return;
        }
        self.placed.x.clear();
        self.placed.x.extend_from_slice(x);
        self.placed.maps.clear();
        self.placed.maps.extend((0..self.node_count()).map(|j| T::map(node_parameters::<T, W>(x, j))));
        let (rest, shapes, w) = (&self.rest, &self.shapes, &x[self.graph.nodes().len() * T::Parameters::AMBIENT..]);
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

    /// Seeds every node's map at `x`.
    fn seed_nodes(&mut self, x: &[f64]) {
        self.seeded.clear();
        self.seeded.extend((0..self.node_count()).map(|j| {
            let tangent: [DualSVec64<W>; W] = std::array::from_fn(|t| DualSVec64::from_re(0.0).derivative(t));
            moved_map::<T, W, _>(node_parameters::<T, W>(x, j), &tangent[..W - 3])
        }));
    }

    /// Jacobians of all edges of (7) at the seeded nodes.
    fn linearize_edges(&mut self) {
        let nodes = self.graph.nodes();
        let zero = EdgeJacobian { residual: [0.0; 3], source: [[0.0; W]; 3], target: [[0.0; W]; 3] };
        self.edges.resize(self.graph.edges().len(), zero);
        for (edge, &(i, j)) in self.edges.iter_mut().zip(self.graph.edges()) {
            let (xi, xj) = (nodes[i as usize], nodes[j as usize]);
            let moved = self.seeded[i as usize].apply(std::array::from_fn(|a| DualSVec64::from_re(xj[a] - xi[a])));
            let origin = self.seeded[j as usize].translation;
            for a in 0..3 {
                edge.residual[a] = moved[a].re + xi[a] - origin[a].re - xj[a];
                edge.source[a] = derivatives(&moved[a]);
                edge.target[a] = derivatives(&origin[a]).map(|d| -d);
            }
        }
    }
}

#[inline(always)]
fn node_parameters<T: NodeTransform<W>, const W: usize>(x: &[f64], j: usize) -> &[f64] {
    &x[j * T::Parameters::AMBIENT..(j + 1) * T::Parameters::AMBIENT]
}

/// The map of a node's parameters moved by `tangent`.
#[inline(always)]
fn moved_map<T: NodeTransform<W>, const W: usize, D: Scalar>(parameters: &[f64], tangent: &[D]) -> AffineMap<D> {
    let mut point = <T::Parameters as Manifold>::Point::<D>::filled(D::from(0.0));
    T::Parameters::plus(parameters, tangent, point.as_mut());
    T::map(point.as_ref())
}

#[inline(always)]
fn derivatives<const W: usize>(d: &DualSVec64<W>) -> [f64; W] {
    d.eps.0.map_or([0.0; W], |e| std::array::from_fn(|k| e[k]))
}

impl<T: NodeTransform<W>, const W: usize> DeformationModel for NodeAssembly<T, W> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn vertex_count(&self) -> usize {
        self.rest.len()
    }

    fn parameter_len(&self) -> usize {
        self.node_count() * T::Parameters::AMBIENT + self.shapes.len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.parameter_len()];
        for j in 0..self.node_count() {
            x[j * T::Parameters::AMBIENT..(j + 1) * T::Parameters::AMBIENT].copy_from_slice(T::IDENTITY);
        }
        x
    }

    fn attach(&mut self, samples: &Samples) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.rest.len(), "samples were made for another template");
        // Nodes of each sample, ascending, and the slot of each corner's influences.
        self.chunks = Vec::new();
        let mut pairs: Vec<(usize, usize)> = self.graph.edges().iter().map(|e| (e.0 as usize, e.1 as usize)).collect();
        for first in (0..samples.len()).step_by(CHUNK) {
            let mut chunk = SampleChunk::new();
            for s in first..(first + CHUNK).min(samples.len()) {
                chunk.push(samples.corners(s), &self.graph);
                let slots = &chunk.samples[chunk.samples.len() - 1].slots;
                let nodes = &chunk.nodes[slots.start as usize..slots.end as usize];
                for (p, &j) in nodes.iter().enumerate() {
                    pairs.extend(nodes[..p].iter().map(|&k| (j as usize, k as usize)));
                }
            }
            self.chunks.push(chunk);
        }
        pairs.sort_unstable();
        pairs.dedup();
        let structure = BlockStructure::new(&vec![W - 3; self.node_count()], pairs, self.shapes.len())
            .expect("proven: all pairs are nodes of the graph");

        let position = |row: u32, col: u32| {
            let k = structure.row(row as usize).binary_search(&(col as usize)).expect("proven: the pair was added");
            (k * (W - 3) * (W - 3)) as u32
        };
        self.node_samples = (0..self.node_count()).map(|_| Vec::new()).collect();
        for (c, chunk) in self.chunks.iter_mut().enumerate() {
            for (s, sample) in chunk.samples.iter_mut().enumerate() {
                sample.targets = chunk.targets.len() as u32;
                let nodes = &chunk.nodes[sample.slots.start as usize..sample.slots.end as usize];
                for (p, &j) in nodes.iter().enumerate() {
                    chunk.targets.extend(nodes[..=p].iter().map(|&k| position(j, k)));
                    let entry = NodeSample { chunk: c as u32, sample: s as u32, slot: p as u32 };
                    self.node_samples[j as usize].push(entry);
                }
            }
        }
        self.node_edges = (0..self.node_count()).map(|_| Vec::new()).collect();
        for (e, &(i, j)) in self.graph.edges().iter().enumerate() {
            for (at, other, is_source) in [(i, j, true), (j, i, false)] {
                let block = (other < at).then(|| position(at, other));
                self.node_edges[at as usize].push(NodeEdge { edge: e as u32, is_source, block });
            }
        }
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.place(x);
        let (graph, placed) = (&self.graph, &self.placed);
        out.resize(self.rest.len(), Vec3::zeros());
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            for (k, v) in chunk.iter_mut().enumerate() {
                let i = c * CHUNK + k;
                let b = placed.blend[i];
                *v = Vec3::zeros();
                for &(j, omega) in graph.influences(i) {
                    let x_j = graph.nodes()[j as usize];
                    *v += (Vec3::from(placed.maps[j as usize].apply((b - x_j).into())) + x_j) * omega;
                }
            }
        });
    }

    fn pull_back(&mut self, x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.place(x);
        self.seed_nodes(x);
        let nb = self.shapes.len();
        let (graph, shapes, blend, seeded) = (&self.graph, &self.shapes, &self.placed.blend, &self.seeded);
        self.border_partials.resize(self.chunks.len() * nb * nb, 0.0);
        let partials = self.border_partials.par_chunks_mut((nb * nb).max(1));
        let chunks = self.chunks.par_iter_mut().zip(field.quadrics().par_chunks(CHUNK));
        let linearisation = self.linearisation;
        let fill = |chunk: &mut SampleChunk<W>, quadrics: &[Quadric]| match linearisation {
            Linearisation::Structured => chunk.linearize(seeded, quadrics, graph, shapes, blend),
            Linearisation::Reference => chunk.linearize_reference::<T>(x, quadrics, graph, shapes, blend),
        };
        if nb == 0 {
            chunks.for_each(|(chunk, quadrics)| fill(chunk, quadrics));
        } else {
            chunks.zip(partials).for_each(|((chunk, quadrics), partial)| {
                fill(chunk, quadrics);
                rank_update_lower(&chunk.u, chunk.u.len() / nb, nb, partial);
            });
        }

        let border_start = equations.structure().sparse_dimension();
        for (c, chunk) in self.chunks.iter().enumerate() {
            let partial = &self.border_partials[c * nb * nb..(c + 1) * nb * nb];
            equations.border.iter_mut().zip(partial).for_each(|(h, p)| *h += p);
            equations.gradient[border_start..].iter_mut().zip(&chunk.g_shapes).for_each(|(g, p)| *g += p);
        }
        let (chunks, node_samples) = (&self.chunks, &self.node_samples);
        equations.for_each_block_row(&|j, row| {
            vectorized(
                #[inline(always)]
                || fill_row(chunks, &node_samples[j], row, nb),
            );
        });
    }

    fn border_bounds(&self) -> Option<(&[f64], &[f64])> {
        self.shapes.bounds()
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.place(x);
        if !self.graph.edges().is_empty() {
            let mut sum = 0.0;
            for &(i, j) in self.graph.edges() {
                let (xi, xj) = (self.graph.nodes()[i as usize], self.graph.nodes()[j as usize]);
                let moved: Vec3 = self.placed.maps[i as usize].apply((xj - xi).into()).into();
                let residual = moved + xi - Vec3::from(self.placed.maps[j as usize].translation) - xj;
                sum += residual.norm_squared();
            }
            out.push(("graph smoothness (7)", self.stiffness.graph * sum));
        }
        if !self.shapes.is_empty() {
            let w = &x[self.node_count() * T::Parameters::AMBIENT..];
            let sum: f64 = w.iter().zip(self.shapes.sigmas()).map(|(w, s)| (w / s) * (w / s)).sum();
            out.push(("blendshape prior (5)", self.stiffness.blend * sum));
        }
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.seed_nodes(x);
        self.linearize_edges();
        let (edges, node_edges, lambda) = (&self.edges, &self.node_edges, self.stiffness.graph);
        equations.for_each_block_row(&|j, row| {
            let diagonal = row.blocks.len() - (W - 3) * (W - 3);
            for at in &node_edges[j] {
                let edge = &edges[at.edge as usize];
                let (own, other) =
                    if at.is_source { (&edge.source, &edge.target) } else { (&edge.target, &edge.source) };
                for r in 0..3 {
                    add_block(&mut row.blocks[diagonal..], &own[r], &own[r], lambda);
                    if let Some(block) = at.block {
                        add_block(&mut row.blocks[block as usize..], &own[r], &other[r], lambda);
                    }
                    for t in 0..W - 3 {
                        row.gradient[t] += lambda * own[r][t] * edge.residual[r];
                    }
                }
            }
        });
        let (nb, lambda) = (self.shapes.len(), self.stiffness.blend);
        let start = equations.structure().sparse_dimension();
        for (k, (w, sigma)) in self.weights(x).iter().zip(self.shapes.sigmas()).enumerate() {
            let weight = lambda / (sigma * sigma);
            equations.border[k * nb + k] += weight;
            equations.gradient[start + k] += weight * w;
        }
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        let n = self.node_count();
        for j in 0..n {
            let range = j * T::Parameters::AMBIENT..(j + 1) * T::Parameters::AMBIENT;
            T::Parameters::plus(&x[range.clone()], &step[j * (W - 3)..(j + 1) * (W - 3)], &mut out[range.clone()]);
            T::Parameters::normalize(&mut out[range]);
        }
        for k in 0..self.shapes.len() {
            out[n * T::Parameters::AMBIENT + k] = x[n * T::Parameters::AMBIENT + k] + step[n * (W - 3) + k];
        }
    }
}

/// `block += scale left right'`, the first `W - 3` entries of each.
#[inline(always)]
fn add_block<const W: usize>(block: &mut [f64], left: &[f64; W], right: &[f64; W], scale: f64) {
    for (row, l) in block.chunks_exact_mut(W - 3).zip(&left[..W - 3]) {
        for (h, r) in row.iter_mut().zip(&right[..W - 3]) {
            *h += scale * l * r;
        }
    }
}

/// Node `j`'s block row: sums its samples in fixed order.
#[inline(always)]
fn fill_row<const W: usize>(chunks: &[SampleChunk<W>], samples: &[NodeSample], row: BlockRow<'_>, nb: usize) {
    for at in samples {
        let chunk = &chunks[at.chunk as usize];
        let s = at.sample as usize;
        let rows = chunk.row_counts[s] as usize;
        if rows == 0 {
            continue;
        }
        let sample = &chunk.samples[s];
        let (first, p) = (sample.slots.start as usize, at.slot as usize);
        let own = &chunk.y[first + p];
        let targets = &chunk.targets[sample.targets as usize + p * (p + 1) / 2..][..=p];
        for (q, &target) in targets.iter().enumerate() {
            let other = &chunk.y[first + q];
            for r in 0..rows {
                add_block(&mut row.blocks[target as usize..], &own[r], &other[r], 1.0);
            }
        }
        for (g, add) in row.gradient.iter_mut().zip(&chunk.g[first + p]) {
            *g += add;
        }
        if nb > 0 {
            let u = &chunk.u[chunk.row_starts[s] as usize * nb..];
            match rows {
                1 => add_outer([&own[0]], [&u[..nb]], row.cross, W - 3),
                2 => add_outer([&own[0], &own[1]], [&u[..nb], &u[nb..2 * nb]], row.cross, W - 3),
                _ => add_outer(
                    [&own[0], &own[1], &own[2]],
                    [&u[..nb], &u[nb..2 * nb], &u[2 * nb..3 * nb]],
                    row.cross,
                    W - 3,
                ),
            }
        }
    }
}

impl<const W: usize> SampleChunk<W> {
    fn new() -> Self {
        Self {
            samples: Vec::new(),
            corners: Vec::new(),
            nodes: Vec::new(),
            targets: Vec::new(),
            row_counts: Vec::new(),
            row_starts: Vec::new(),
            y: Vec::new(),
            g: Vec::new(),
            u: Vec::new(),
            g_shapes: Vec::new(),
        }
    }

    fn push(&mut self, corners: &[(u32, f64)], graph: &NodeGraph) {
        let mut nodes: Vec<u32> =
            corners.iter().flat_map(|c| graph.influences(c.0 as usize).iter().map(|i| i.0)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let first = self.corners.len() as u32;
        for &(vertex, weight) in corners {
            let slot = |j: u32| nodes.binary_search(&j).expect("proven: the node was collected above") as u32;
            let slots = graph.influences(vertex as usize).iter().map(|i| slot(i.0)).collect();
            self.corners.push(Corner { vertex, weight, slots });
        }
        let start = self.nodes.len() as u32;
        self.nodes.extend(nodes);
        let slots = start..self.nodes.len() as u32;
        self.samples.push(SampleSlots { corners: first..self.corners.len() as u32, slots, targets: 0 });
        self.row_counts.push(0);
        self.row_starts.push(0);
        self.y.resize(self.nodes.len(), [[0.0; W]; 3]);
        self.g.resize(self.nodes.len(), [0.0; W]);
    }

    /// Fills `Y`, `U` and the gradients of the chunk's samples at `x`.
    fn linearize(
        &mut self,
        seeded: &[AffineMap<DualSVec64<W>>],
        quadrics: &[Quadric],
        graph: &NodeGraph,
        shapes: &ShapeBasis,
        blend: &[Vec3],
    ) {
        vectorized(
            #[inline(always)]
            || self.linearize_inline(seeded, quadrics, graph, shapes, blend),
        );
    }

    #[inline(always)]
    fn linearize_inline(
        &mut self,
        seeded: &[AffineMap<DualSVec64<W>>],
        quadrics: &[Quadric],
        graph: &NodeGraph,
        shapes: &ShapeBasis,
        blend: &[Vec3],
    ) {
        let nb = shapes.len();
        self.begin(quadrics, nb);
        for (s, quadric) in quadrics.iter().enumerate() {
            if quadric.rows().is_empty() {
                continue;
            }
            let sample = &self.samples[s];
            let slots = sample.slots.start as usize..sample.slots.end as usize;
            self.y[slots.clone()].fill([[0.0; W]; 3]);
            self.g[slots.clone()].fill([0.0; W]);
            for corner in &self.corners[sample.corners.start as usize..sample.corners.end as usize] {
                let i = corner.vertex as usize;
                // Rbar_i, scaled by the corner's weight.
                let mut rbar = [[0.0; 3]; 3];
                for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
                    let x_j = graph.nodes()[j as usize];
                    let q = blend[i] - x_j;
                    let q = std::array::from_fn(|a| DualSVec64::from_re(q[a]).derivative(W - 3 + a));
                    let v = seeded[j as usize].apply(q);
                    let jacobian = v.map(|v| derivatives(&v).map(|d| corner.weight * omega * d));
                    for a in 0..3 {
                        for b in 0..3 {
                            rbar[a][b] += jacobian[a][W - 3 + b];
                        }
                    }
                    let (y, g) = (&mut self.y[slots.start + slot as usize], &mut self.g[slots.start + slot as usize]);
                    for (y, row) in y.iter_mut().zip(quadric.rows()) {
                        add_product(y, row, &jacobian);
                    }
                    add_product(g, &quadric.gradient, &jacobian);
                }
                if nb > 0 {
                    let slab = shapes.vertex(i);
                    let u = &mut self.u[self.row_starts[s] as usize * nb..];
                    for (u, row) in u.chunks_exact_mut(nb).zip(quadric.rows()) {
                        add_shape_row(u, times(row, &rbar), slab);
                    }
                    add_shape_row(&mut self.g_shapes, times(&quadric.gradient, &rbar), slab);
                }
            }
        }
    }

    /// Counts rows and clears what is accumulated.
    fn begin(&mut self, quadrics: &[Quadric], nb: usize) {
        let mut rows = 0;
        for (s, quadric) in quadrics.iter().enumerate() {
            self.row_counts[s] = quadric.rows().len() as u8;
            self.row_starts[s] = rows;
            rows += quadric.rows().len() as u32;
        }
        self.u.clear();
        self.u.resize(rows as usize * nb, 0.0);
        self.g_shapes.clear();
        self.g_shapes.resize(nb, 0.0);
    }

    /// The paper's way: each sample's position is differentiated by the tangents of all of its nodes and by all shape
    /// weights at once, in strides of [`STRIDE`] duals.
    fn linearize_reference<T: NodeTransform<W>>(
        &mut self,
        x: &[f64],
        quadrics: &[Quadric],
        graph: &NodeGraph,
        shapes: &ShapeBasis,
        blend: &[Vec3],
    ) {
        const STRIDE: usize = 16;
        type Dual = DualSVec64<STRIDE>;
        let (nb, tangent) = (shapes.len(), W - 3);
        let w = &x[graph.nodes().len() * T::Parameters::AMBIENT..];
        self.begin(quadrics, nb);
        for (s, quadric) in quadrics.iter().enumerate() {
            if quadric.rows().is_empty() {
                continue;
            }
            let sample = &self.samples[s];
            let slots = sample.slots.start as usize..sample.slots.end as usize;
            self.y[slots.clone()].fill([[0.0; W]; 3]);
            self.g[slots.clone()].fill([0.0; W]);
            let of_nodes = slots.len() * tangent;
            for first in (0..of_nodes + nb).step_by(STRIDE) {
                let seed = |k: usize, value: f64| {
                    let d = Dual::from_re(value);
                    if (first..first + STRIDE).contains(&k) { d.derivative(k - first) } else { d }
                };
                let mut v = [Dual::from_re(0.0); 3];
                for corner in &self.corners[sample.corners.start as usize..sample.corners.end as usize] {
                    let i = corner.vertex as usize;
                    let slab = shapes.vertex(i);
                    let mut b: [Dual; 3] = std::array::from_fn(|a| Dual::from_re(blend[i][a]));
                    for k in 0..nb {
                        let w_k = seed(of_nodes + k, w[k]) - w[k];
                        for a in 0..3 {
                            b[a] += w_k * slab[a * nb + k];
                        }
                    }
                    for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
                        let seeds: [Dual; W] = std::array::from_fn(|t| {
                            if t < tangent { seed(slot as usize * tangent + t, 0.0) } else { Dual::from_re(0.0) }
                        });
                        let map = moved_map::<T, W, _>(node_parameters::<T, W>(x, j as usize), &seeds[..tangent]);
                        let x_j = graph.nodes()[j as usize];
                        let moved = map.apply(std::array::from_fn(|a| b[a] - x_j[a]));
                        for a in 0..3 {
                            v[a] += (moved[a] + x_j[a]) * (omega * corner.weight);
                        }
                    }
                }
                let jacobian = v.map(|v| derivatives(&v));
                for k in first..(first + STRIDE).min(of_nodes + nb) {
                    let column = [jacobian[0][k - first], jacobian[1][k - first], jacobian[2][k - first]];
                    let along = |row: &[f64; 3]| row[0] * column[0] + row[1] * column[1] + row[2] * column[2];
                    if k < of_nodes {
                        let slot = slots.start + k / tangent;
                        for (r, row) in quadric.rows().iter().enumerate() {
                            self.y[slot][r][k % tangent] = along(row);
                        }
                        self.g[slot][k % tangent] = along(&quadric.gradient);
                    } else {
                        for (r, row) in quadric.rows().iter().enumerate() {
                            self.u[(self.row_starts[s] as usize + r) * nb + k - of_nodes] = along(row);
                        }
                        self.g_shapes[k - of_nodes] += along(&quadric.gradient);
                    }
                }
            }
        }
    }
}

/// `out += row jacobian` over the tangent columns.
#[inline(always)]
fn add_product<const W: usize>(out: &mut [f64; W], row: &[f64; 3], jacobian: &[[f64; W]; 3]) {
    for t in 0..W - 3 {
        out[t] += row[0] * jacobian[0][t] + row[1] * jacobian[1][t] + row[2] * jacobian[2][t];
    }
}

#[inline(always)]
fn times(row: &[f64; 3], m: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|b| row[0] * m[0][b] + row[1] * m[1][b] + row[2] * m[2][b])
}

/// `out += c' slab` for a `3 x nb` slab.
#[inline(always)]
fn add_shape_row(out: &mut [f64], c: [f64; 3], slab: &[f64]) {
    let nb = out.len();
    let (s0, rest) = slab.split_at(nb);
    let (s1, s2) = rest.split_at(nb);
    for k in 0..nb {
        out[k] += c[0] * s0[k] + c[1] * s1[k] + c[2] * s2[k];
    }
}
