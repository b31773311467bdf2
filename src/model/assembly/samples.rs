//! The data side of the assembly: samples in chunks of fixed size, each the work of one task, with their Jacobians `Y_sj`
//! and `U_s`, and the sums of their products that make `H`. All orders of summation are fixed.

use num_dual::DualSVec64;

use super::{AffineMap, NodeGraph, ShapeBasis, derivatives};
use crate::energy::{Quadric, Samples};
use crate::mesh::Vec3;
use crate::nlls::BlockRow;
use crate::nlls::dense_kernels::{add_outer, vectorized};

/// Samples (and vertices) that one task works on.
pub(super) const CHUNK: usize = 512;

/// What a sample's position is made of: blended vertices, moved by the graph.
#[derive(Clone, Copy)]
pub(super) struct Blended<'a> {
    pub graph: &'a NodeGraph,
    pub shapes: &'a ShapeBasis,
    /// `b_i(w)`.
    pub vertices: &'a [Vec3],
}

/// A fixed run of samples with their Jacobians.
pub(super) struct SampleChunk<const W: usize> {
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
    pub u: Vec<f64>,
    /// `sum_s (dv_s/dw)' g_s`.
    pub g_shapes: Vec<f64>,
}

struct SampleSlots {
    corners: std::ops::Range<u32>,
    slots: std::ops::Range<u32>,
    targets: u32,
}

impl SampleSlots {
    fn slots(&self) -> std::ops::Range<usize> {
        self.slots.start as usize..self.slots.end as usize
    }
}

/// One vertex of a sample with its weight, and the slot of each of the vertex' influences.
pub(super) struct Corner {
    pub vertex: u32,
    pub weight: f64,
    pub slots: Vec<u32>,
}

/// A sample that a node moves: its chunk, index in the chunk and slot within the sample.
pub(super) struct NodeSample {
    chunk: u32,
    sample: u32,
    slot: u32,
}

/// One sample's share of a chunk, cleared, for a linearisation to fill.
pub(super) struct SampleJacobian<'a, const W: usize> {
    pub corners: &'a [Corner],
    /// `Y_sj` by slot.
    pub y: &'a mut [[[f64; W]; 3]],
    /// `(dv_s/dT_j)' g_s` by slot.
    pub g: &'a mut [[f64; W]],
    /// `U_s`, rows of nb.
    pub u: &'a mut [f64],
    /// To be added to, by all samples of the chunk: `sum_s (dv_s/dw)' g_s`.
    pub g_shapes: &'a mut [f64],
}

/// The chunks of all samples. Adds the pairs of nodes that meet in a sample to `pairs`.
pub(super) fn chunks_of<const W: usize>(
    samples: &Samples,
    graph: &NodeGraph,
    pairs: &mut Vec<(usize, usize)>,
) -> Vec<SampleChunk<W>> {
    let mut chunks = Vec::new();
    for first in (0..samples.len()).step_by(CHUNK) {
        let mut chunk = SampleChunk::new();
        for s in first..(first + CHUNK).min(samples.len()) {
            let nodes = chunk.push(samples.corners(s), graph);
            for (p, &j) in nodes.iter().enumerate() {
                pairs.extend(nodes[..p].iter().map(|&k| (j as usize, k as usize)));
            }
        }
        chunks.push(chunk);
    }
    chunks
}

/// The samples that each node moves. Tells the chunks where their blocks lie: `position(j, k)`, `j >= k`, is where block
/// (`j`, `k`) starts in block row `j`.
pub(super) fn samples_of_nodes<const W: usize>(
    chunks: &mut [SampleChunk<W>],
    node_count: usize,
    position: impl Fn(u32, u32) -> u32,
) -> Vec<Vec<NodeSample>> {
    let mut of_nodes: Vec<Vec<NodeSample>> = (0..node_count).map(|_| Vec::new()).collect();
    for (c, chunk) in chunks.iter_mut().enumerate() {
        for (s, sample) in chunk.samples.iter_mut().enumerate() {
            sample.targets = chunk.targets.len() as u32;
            let nodes = &chunk.nodes[sample.slots()];
            for (p, &j) in nodes.iter().enumerate() {
                chunk.targets.extend(nodes[..=p].iter().map(|&k| position(j, k)));
                of_nodes[j as usize].push(NodeSample { chunk: c as u32, sample: s as u32, slot: p as u32 });
            }
        }
    }
    of_nodes
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

    /// Adds a sample; returns the nodes that move it, ascending.
    fn push(&mut self, corners: &[(u32, f64)], graph: &NodeGraph) -> &[u32] {
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
        &self.nodes[start as usize..]
    }

    /// Clears the Jacobians, and has `fill` write those of every sample that has a quadric.
    #[inline(always)]
    pub fn fill(&mut self, quadrics: &[Quadric], nb: usize, mut fill: impl FnMut(SampleJacobian<'_, W>, &Quadric)) {
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
        for (s, quadric) in quadrics.iter().enumerate() {
            if quadric.rows().is_empty() {
                continue;
            }
            let sample = &self.samples[s];
            let (y, g) = (&mut self.y[sample.slots()], &mut self.g[sample.slots()]);
            y.fill([[0.0; W]; 3]);
            g.fill([0.0; W]);
            let corners = &self.corners[sample.corners.start as usize..sample.corners.end as usize];
            let u = &mut self.u[self.row_starts[s] as usize * nb..][..quadric.rows().len() * nb];
            fill(SampleJacobian { corners, y, g, u, g_shapes: &mut self.g_shapes }, quadric);
        }
    }

    /// Duals of static width per node contribution; blendshapes enter as constant slabs.
    pub fn linearize(&mut self, seeded: &[AffineMap<DualSVec64<W>>], quadrics: &[Quadric], blended: Blended<'_>) {
        vectorized(
            #[inline(always)]
            || {
                self.fill(
                    quadrics,
                    blended.shapes.len(),
                    #[inline(always)]
                    |sample, quadric| structured(sample, quadric, seeded, blended),
                )
            },
        );
    }
}

#[inline(always)]
fn structured<const W: usize>(
    sample: SampleJacobian<'_, W>,
    quadric: &Quadric,
    seeded: &[AffineMap<DualSVec64<W>>],
    Blended { graph, shapes, vertices }: Blended<'_>,
) {
    let nb = shapes.len();
    for corner in sample.corners {
        let i = corner.vertex as usize;
        // Rbar_i, scaled by the corner's weight.
        let mut rbar = [[0.0; 3]; 3];
        for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
            let q = vertices[i] - graph.nodes()[j as usize];
            let q = std::array::from_fn(|a| DualSVec64::from_re(q[a]).derivative(W - 3 + a));
            let v = seeded[j as usize].apply(q);
            let jacobian = v.map(|v| derivatives(&v).map(|d| corner.weight * omega * d));
            for a in 0..3 {
                for b in 0..3 {
                    rbar[a][b] += jacobian[a][W - 3 + b];
                }
            }
            for (y, row) in sample.y[slot as usize].iter_mut().zip(quadric.rows()) {
                add_product(y, row, &jacobian);
            }
            add_product(&mut sample.g[slot as usize], &quadric.gradient, &jacobian);
        }
        if nb > 0 {
            let slab = shapes.vertex(i);
            for (u, row) in sample.u.chunks_exact_mut(nb).zip(quadric.rows()) {
                add_shape_row(u, times(row, &rbar), slab);
            }
            add_shape_row(sample.g_shapes, times(&quadric.gradient, &rbar), slab);
        }
    }
}

/// Adds to a node's block row the products `Y_sj' Y_sk` and `Y_sj' U_s` of its `samples`.
pub(super) fn fill_row<const W: usize>(
    chunks: &[SampleChunk<W>],
    samples: &[NodeSample],
    row: BlockRow<'_>,
    nb: usize,
) {
    vectorized(
        #[inline(always)]
        || fill_row_inline(chunks, samples, row, nb),
    );
}

#[inline(always)]
fn fill_row_inline<const W: usize>(chunks: &[SampleChunk<W>], samples: &[NodeSample], row: BlockRow<'_>, nb: usize) {
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

/// `block += scale left right'`, the first `W - 3` entries of each.
#[inline(always)]
pub(super) fn add_block<const W: usize>(block: &mut [f64], left: &[f64; W], right: &[f64; W], scale: f64) {
    for (row, l) in block.chunks_exact_mut(W - 3).zip(&left[..W - 3]) {
        for (h, r) in row.iter_mut().zip(&right[..W - 3]) {
            *h += scale * l * r;
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
