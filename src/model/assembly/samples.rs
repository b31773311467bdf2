//! The data side of the assembly: samples in chunks of fixed size, each the work of one task, with their Jacobians `Y_sj`
//! and `U_s`, and the sums of their products that make `H`. All orders of summation are fixed.

use super::{MapJacobian, NodeGraph, ShapeBasis};
use crate::energy::{Quadric, Samples};
use crate::mesh::Vec3;
use crate::nlls::BlockRow;
use crate::nlls::dense_kernels::{add_block, add_outer, rank_update_lower, vectorized};

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
    /// Where the rows of each sample's quadric start; one more for the end of the last.
    row_starts: Vec<u32>,
    /// Where each sample's `Y_sj` start.
    y_starts: Vec<u32>,
    /// `Y_sj`: row by row of a sample's quadric, slot by slot.
    y: Vec<[f64; W]>,
    /// Residual of each row.
    residuals: Vec<f64>,
    /// `U_s`: rows of nb.
    u: Vec<f64>,
    /// `sum_s (dv_s/dw)' g_s`.
    pub g_shapes: Vec<f64>,
}

struct SampleSlots {
    /// Index in the problem's samples.
    index: u32,
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

/// One sample's share of a chunk, for a linearisation to fill.
pub(super) struct SampleJacobian<'a, const W: usize> {
    pub corners: &'a [Corner],
    /// `Y_sj`, cleared: row by row of the quadric, slot by slot.
    pub y: &'a mut [[f64; W]],
    pub slots: usize,
    /// `U_s`, rows of nb; holds anything.
    pub u: &'a mut [f64],
}

/// The chunks of all samples. Adds the pairs of nodes that meet in a sample to `pairs`.
pub(super) fn chunks_of<const W: usize>(
    samples: &Samples,
    graph: &NodeGraph,
    pairs: &mut Vec<(usize, usize)>,
) -> Vec<SampleChunk<W>> {
    let mut chunks = Vec::new();
    for run in neighbours_together(samples, graph).chunks(CHUNK) {
        let mut chunk = SampleChunk::new();
        for &s in run {
            let nodes = chunk.push(s, samples.corners(s as usize), graph);
            for (p, &j) in nodes.iter().enumerate() {
                pairs.extend(nodes[..p].iter().map(|&k| (j as usize, k as usize)));
            }
        }
        chunks.push(chunk);
    }
    chunks
}

/// The samples in an order in which those that the same nodes move follow each other: nodes by breadth-first search along the
/// graph's edges, at each the samples that it moves most. What a node then reads of its samples lies close together.
fn neighbours_together(samples: &Samples, graph: &NodeGraph) -> Vec<u32> {
    let count = graph.nodes().len();
    let from = |j: u32| graph.edges().partition_point(|e| e.0 < j);
    let mut rank = vec![usize::MAX; count];
    let mut queue = Vec::with_capacity(count);
    for seed in 0..count as u32 {
        if rank[seed as usize] != usize::MAX {
            continue;
        }
        let mut next = queue.len();
        rank[seed as usize] = next;
        queue.push(seed);
        while next < queue.len() {
            let j = queue[next];
            next += 1;
            for &(_, k) in graph.edges()[from(j)..].iter().take_while(|e| e.0 == j) {
                if rank[k as usize] == usize::MAX {
                    rank[k as usize] = queue.len();
                    queue.push(k);
                }
            }
        }
    }
    let strongest = |s: u32| {
        let corner = samples.corners(s as usize).first()?;
        let influence = graph.influences(corner.0 as usize).iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(rank[influence.0 as usize])
    };
    let mut order: Vec<u32> = (0..samples.len() as u32).collect();
    order.sort_by_cached_key(|&s| strongest(s));
    order
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
            row_starts: Vec::new(),
            y_starts: Vec::new(),
            y: Vec::new(),
            residuals: Vec::new(),
            u: Vec::new(),
            g_shapes: Vec::new(),
        }
    }

    /// Adds a sample; returns the nodes that move it, ascending.
    fn push(&mut self, index: u32, corners: &[(u32, f64)], graph: &NodeGraph) -> &[u32] {
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
        self.samples.push(SampleSlots { index, corners: first..self.corners.len() as u32, slots, targets: 0 });
        &self.nodes[start as usize..]
    }

    /// Lays out the Jacobians for the rows of the problem's `quadrics`, and has `fill` write those of every sample that has a quadric.
    #[inline(always)]
    pub fn fill(&mut self, quadrics: &[Quadric], nb: usize, mut fill: impl FnMut(SampleJacobian<'_, W>, &Quadric)) {
        let (mut rows, mut blocks) = (0, 0);
        self.row_starts.clear();
        self.y_starts.clear();
        self.residuals.clear();
        for sample in &self.samples {
            let quadric = &quadrics[sample.index as usize];
            self.row_starts.push(rows);
            self.y_starts.push(blocks);
            self.residuals.extend(quadric.residuals());
            rows += quadric.rows().len() as u32;
            blocks += (quadric.rows().len() * sample.slots().len()) as u32;
        }
        self.row_starts.push(rows);
        self.y.clear();
        self.y.resize(blocks as usize, [0.0; W]);
        self.u.resize(rows as usize * nb, 0.0);
        self.g_shapes.clear();
        self.g_shapes.resize(nb, 0.0);
        for (s, sample) in self.samples.iter().enumerate() {
            let quadric = &quadrics[sample.index as usize];
            let count = quadric.rows().len();
            if count == 0 {
                continue;
            }
            let slots = sample.slots().len();
            let y = &mut self.y[self.y_starts[s] as usize..][..count * slots];
            let corners = &self.corners[sample.corners.start as usize..sample.corners.end as usize];
            let u = &mut self.u[self.row_starts[s] as usize * nb..][..count * nb];
            fill(SampleJacobian { corners, y, slots, u: &mut *u }, quadric);
            for (u, e) in u.chunks_exact(nb.max(1)).zip(quadric.residuals()) {
                for (g, u) in self.g_shapes.iter_mut().zip(u) {
                    *g = e.mul_add(*u, *g);
                }
            }
        }
    }

    /// Forward-mode duals through every node's map, then the product rule; blendshapes enter as constant slabs.
    pub fn linearize(&mut self, maps: &[MapJacobian<W>], quadrics: &[Quadric], blended: Blended<'_>) {
        vectorized(
            #[inline(always)]
            || {
                self.fill(
                    quadrics,
                    blended.shapes.len(),
                    #[inline(always)]
                    |sample, quadric| structured(sample, quadric, maps, blended),
                )
            },
        );
    }

    /// `lower(sum_s U_s' U_s)`.
    pub fn border_product(&self, out: &mut [f64]) {
        let rows = self.row_starts.last().map_or(0, |&r| r as usize);
        rank_update_lower(&self.u, rows, self.g_shapes.len(), out);
    }

    fn rows_of(&self, s: usize) -> std::ops::Range<usize> {
        self.row_starts[s] as usize..self.row_starts[s + 1] as usize
    }
}

#[inline(always)]
fn structured<const W: usize>(
    sample: SampleJacobian<'_, W>,
    quadric: &Quadric,
    maps: &[MapJacobian<W>],
    Blended { graph, shapes, vertices }: Blended<'_>,
) {
    let nb = shapes.len();
    for (c, corner) in sample.corners.iter().enumerate() {
        let i = corner.vertex as usize;
        // Rbar_i, scaled by the corner's weight.
        let mut rbar = [[0.0; 3]; 3];
        for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
            let (map, slot, weight) = (&maps[j as usize], slot as usize, corner.weight * omega);
            let q = (vertices[i] - graph.nodes()[j as usize]).into();
            for a in 0..3 {
                for b in 0..3 {
                    rbar[a][b] += weight * map.value.linear[a][b];
                }
            }
            for (r, row) in quadric.rows().iter().enumerate() {
                map.add_pulled_back(row.map(|e| weight * e), q, &mut sample.y[r * sample.slots + slot]);
            }
        }
        if nb > 0 {
            let slab = shapes.vertex(i);
            for (u, row) in sample.u.chunks_exact_mut(nb).zip(quadric.rows()) {
                if c == 0 {
                    u.fill(0.0);
                }
                add_shape_row(u, times(row, &rbar), slab);
            }
        }
    }
}

/// Rows of Y and U that [`fill_row`] multiplies at a time.
const BATCH: usize = 4;

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
    let mut y: [&[f64; W]; BATCH] = [&[0.0; W]; BATCH];
    let mut u: [&[f64]; BATCH] = [&[]; BATCH];
    let mut batched = 0;
    for at in samples {
        let chunk = &chunks[at.chunk as usize];
        let (s, p) = (at.sample as usize, at.slot as usize);
        let rows = chunk.rows_of(s);
        if rows.is_empty() {
            continue;
        }
        let sample = &chunk.samples[s];
        let slots = sample.slots();
        let of_sample = &chunk.y[chunk.y_starts[s] as usize..][..rows.len() * slots.len()];
        let targets = &chunk.targets[sample.targets as usize + p * (p + 1) / 2..][..=p];
        for (of_row, e) in of_sample.chunks_exact(slots.len()).zip(&chunk.residuals[rows.clone()]) {
            for t in 0..W {
                row.gradient[t] = e.mul_add(of_row[p][t], row.gradient[t]);
            }
            for (other, &target) in of_row.iter().zip(targets) {
                add_block(&mut row.blocks[target as usize..][..W * W], [&of_row[p]], [other], 1.0);
            }
        }
        if nb > 0 {
            for (r, at) in rows.enumerate() {
                y[batched] = &of_sample[r * slots.len() + p];
                u[batched] = &chunk.u[at * nb..][..nb];
                batched += 1;
                if batched == BATCH {
                    add_outer(y, u, row.cross);
                    batched = 0;
                }
            }
        }
    }
    for (y, u) in y.iter().zip(u).take(batched) {
        add_outer([y], [u], row.cross);
    }
}

#[inline(always)]
fn times(row: &[f64; 3], m: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|b| row[0] * m[0][b] + row[1] * m[1][b] + row[2] * m[2][b])
}

/// `out += c' slab` for a `3 x nb` slab.
#[inline(always)]
fn add_shape_row(out: &mut [f64], c: [f64; 3], slab: &[f32]) {
    let nb = out.len();
    let (s0, rest) = slab.split_at(nb);
    let (s1, s2) = rest.split_at(nb);
    for k in 0..nb {
        let [d0, d1, d2] = [s0[k], s1[k], s2[k]].map(f64::from);
        out[k] = c[2].mul_add(d2, c[1].mul_add(d1, c[0].mul_add(d0, out[k])));
    }
}
