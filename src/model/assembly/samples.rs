//! The data side of the assembly: samples in chunks of fixed size, each the work of one task, with their Jacobians `Y_sj`
//! and `U_s`, and the sums of their products that make `H`. All orders of summation are fixed.

use pulp::{Simd, WithSimd, bytemuck};

use super::{MapJacobians, NodeGraph, ShapeBasis};
use crate::energy::{Quadric, Samples};
use crate::mesh::Vec3;
use crate::nlls::BlockRow;
use crate::nlls::dense_kernels::{
    OuterProducts, Tile, add_gram, add_to, dispatch, padded, prefetch, sum_of_products, sweep,
};

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
    /// Where the rows of each sample's quadric start; one more for the end of the last.
    row_starts: Vec<u32>,
    /// Where each sample's `Y_sj` start, in rows of `y`.
    y_starts: Vec<u32>,
    /// `Y_sj`: slot by slot of a sample, row by row of its quadric; each padded to [`pitch`], the row's residual after its end.
    y: Vec<f64>,
    /// `[U_s e_s]`: shapes and the residual, rows padded.
    u: Vec<f64>,
}

/// Length of a row of `Y_sj` with the residual after it.
pub(super) const fn pitch<const W: usize>() -> usize {
    padded(W + 1)
}

/// Length of a row of `U_s` with the residual after it.
pub(super) const fn shape_pitch(nb: usize) -> usize {
    if nb == 0 { 0 } else { padded(nb + 1) }
}

struct SampleSlots {
    /// Index in the problem's samples.
    index: u32,
    corners: std::ops::Range<u32>,
    slots: std::ops::Range<u32>,
}

/// One vertex of a sample with its weight, and the slot of each of the vertex' influences.
pub(super) struct Corner {
    pub vertex: u32,
    pub weight: f64,
    pub slots: Vec<u32>,
}

/// What a node has to add up.
pub(super) struct NodeSamples {
    /// The samples that it moves.
    samples: Vec<NodeSample>,
    /// Blocks left of the diagonal: where each starts in the node's block row, and where its pairs end.
    blocks: Vec<(u32, u32)>,
    pairs: Vec<SlotPair>,
}

/// A sample that a node moves: its chunk, index in the chunk and slot within the sample.
#[derive(Clone, Copy)]
struct NodeSample {
    chunk: u32,
    sample: u32,
    slot: u32,
}

/// A sample that two nodes move.
struct SlotPair {
    own: NodeSample,
    other: u32,
}

/// One sample's share of a chunk, for a linearisation to fill.
pub(super) struct SampleJacobian<'a> {
    pub corners: &'a [Corner],
    /// Corners of a sample that comes soon.
    pub later: &'a [Corner],
    /// `Y_sj`, cleared: slot by slot, row by row of the quadric, each padded to [`pitch`].
    pub y: &'a mut [f64],
    /// `U_s`, rows of [`shape_pitch`]; holds anything.
    pub u: &'a mut [f64],
}

/// The chunks of all samples. Adds the pairs of nodes that meet in a sample to `pairs`.
pub(super) fn chunks_of<const W: usize>(
    samples: &Samples,
    graph: &NodeGraph,
    pairs: &mut Vec<(usize, usize)>,
) -> Vec<SampleChunk<W>> {
    let mut chunks = Vec::new();
    for run in by_strongest_node(samples, graph).chunks(CHUNK) {
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

/// The samples by the node that moves each most: what a node reads of its samples then lies close together.
fn by_strongest_node(samples: &Samples, graph: &NodeGraph) -> Vec<u32> {
    let strongest = |s: u32| {
        let corner = samples.corners(s as usize).first()?;
        graph.influences(corner.0 as usize).iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|influence| influence.0)
    };
    let mut order: Vec<u32> = (0..samples.len() as u32).collect();
    order.sort_by_cached_key(|&s| strongest(s));
    order
}

/// What each of the `free` first nodes has to add up. `position(j, k)`, `j > k`, is where block (`j`, `k`) starts in block row `j`.
pub(super) fn samples_of_nodes<const W: usize>(
    chunks: &[SampleChunk<W>],
    free: usize,
    position: impl Fn(u32, u32) -> u32,
) -> Vec<NodeSamples> {
    let mut samples: Vec<Vec<NodeSample>> = vec![Vec::new(); free];
    let mut pairs: Vec<Vec<(u32, SlotPair)>> = (0..free).map(|_| Vec::new()).collect();
    for (c, chunk) in chunks.iter().enumerate() {
        for (s, sample) in chunk.samples.iter().enumerate() {
            let nodes = &chunk.nodes[sample.slots.start as usize..sample.slots.end as usize];
            for (p, &j) in nodes.iter().enumerate().take_while(|node| (*node.1 as usize) < free) {
                let own = NodeSample { chunk: c as u32, sample: s as u32, slot: p as u32 };
                samples[j as usize].push(own);
                let others = nodes[..p].iter().enumerate();
                pairs[j as usize].extend(others.map(|(q, &k)| (position(j, k), SlotPair { own, other: q as u32 })));
            }
        }
    }
    let by_block = |(samples, mut pairs): (Vec<NodeSample>, Vec<(u32, SlotPair)>)| {
        pairs.sort_by_key(|pair| pair.0);
        let runs = pairs.chunk_by(|a, b| a.0 == b.0);
        let blocks = runs.scan(0, |end, run| {
            *end += run.len() as u32;
            Some((run[0].0, *end))
        });
        NodeSamples { samples, blocks: blocks.collect(), pairs: pairs.into_iter().map(|pair| pair.1).collect() }
    };
    samples.into_iter().zip(pairs).map(by_block).collect()
}

impl<const W: usize> SampleChunk<W> {
    fn new() -> Self {
        Self {
            samples: Vec::new(),
            corners: Vec::new(),
            nodes: Vec::new(),
            row_starts: Vec::new(),
            y_starts: Vec::new(),
            y: Vec::new(),
            u: Vec::new(),
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
        self.samples.push(SampleSlots { index, corners: first..self.corners.len() as u32, slots });
        &self.nodes[start as usize..]
    }

    /// Lays out the Jacobians for the rows of the problem's `quadrics`, and has `fill` write those of every sample that has one.
    #[inline(always)]
    pub fn fill(&mut self, quadrics: &[Quadric], nb: usize, mut fill: impl FnMut(SampleJacobian<'_>, &Quadric)) {
        let (mut rows, mut blocks) = (0, 0);
        self.row_starts.clear();
        self.y_starts.clear();
        for sample in &self.samples {
            self.row_starts.push(rows);
            self.y_starts.push(blocks);
            let count = quadrics[sample.index as usize].rows().len() as u32;
            rows += count;
            blocks += count * (sample.slots.end - sample.slots.start);
        }
        self.row_starts.push(rows);
        self.y_starts.push(blocks);
        let width = shape_pitch(nb);
        self.y.resize(blocks as usize * pitch::<W>(), 0.0);
        self.u.resize(rows as usize * width, 0.0);
        for (s, sample) in self.samples.iter().enumerate() {
            let quadric = &quadrics[sample.index as usize];
            let residuals = quadric.residuals();
            if residuals.is_empty() {
                continue;
            }
            let y = &mut self.y[self.y_starts[s] as usize * pitch::<W>()..self.y_starts[s + 1] as usize * pitch::<W>()];
            let u = &mut self.u[self.row_starts[s] as usize * width..self.row_starts[s + 1] as usize * width];
            let corners_of = |sample: &SampleSlots| sample.corners.start as usize..sample.corners.end as usize;
            let corners = &self.corners[corners_of(sample)];
            let later = self.samples.get(s + SAMPLES_AHEAD).map_or(&[][..], |later| &self.corners[corners_of(later)]);
            y.fill(0.0);
            fill(SampleJacobian { corners, later, y: &mut *y, u: &mut *u }, quadric);
            for (y, e) in y.chunks_exact_mut(pitch::<W>()).zip(residuals.iter().cycle()) {
                y[W] = *e;
            }
            if nb > 0 {
                for (u, e) in u.chunks_exact_mut(width).zip(residuals) {
                    u[nb] = *e;
                }
            }
        }
    }

    /// Forward-mode duals through every node's map, then the product rule; blendshapes enter as constant slabs.
    pub fn linearize(&mut self, maps: &MapJacobians<W>, quadrics: &[Quadric], blended: Blended<'_>) {
        dispatch(Structured { chunk: self, maps, quadrics, blended });
    }

    /// Adds `lower([U e]' [U e])`, whose last row is `sum_s (dv_s/dw)' g_s`.
    pub fn add_border_product(&self, nb: usize, out: &mut [f64]) {
        let rows = self.row_starts.last().map_or(0, |&r| r as usize);
        add_gram([&self.u; 2], [shape_pitch(nb); 2], rows, true, out);
    }

    /// Rows of a node's `Y_sj` at one of its samples.
    #[inline(always)]
    fn rows_of(&self, at: NodeSample) -> std::ops::Range<usize> {
        let s = at.sample as usize;
        let count = (self.row_starts[s + 1] - self.row_starts[s]) as usize;
        let start = self.y_starts[s] as usize + at.slot as usize * count;
        start..start + count
    }
}

struct Structured<'a, const W: usize> {
    chunk: &'a mut SampleChunk<W>,
    maps: &'a MapJacobians<W>,
    quadrics: &'a [Quadric],
    blended: Blended<'a>,
}

impl<const W: usize> WithSimd for Structured<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chunk, maps, quadrics, blended } = self;
        chunk.fill(
            quadrics,
            blended.shapes.len(),
            #[inline(always)]
            |sample, quadric| structured(simd, sample, quadric, maps, blended),
        );
    }
}

#[inline(always)]
fn structured<S: Simd, const W: usize>(
    simd: S,
    sample: SampleJacobian<'_>,
    quadric: &Quadric,
    maps: &MapJacobians<W>,
    Blended { graph, shapes, vertices }: Blended<'_>,
) {
    let (nb, rows) = (shapes.len(), quadric.rows());
    for corner in sample.later {
        let slab = shapes.vertex(corner.vertex as usize);
        (0..slab.len()).step_by(16).for_each(|at| prefetch(slab, at));
    }
    for (c, corner) in sample.corners.iter().enumerate() {
        let i = corner.vertex as usize;
        // Rbar_i, scaled by the corner's weight.
        let mut rbar = [[0.0; 3]; 3];
        for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
            let (map, weight) = (maps.value(j as usize), corner.weight * omega);
            let q = (vertices[i] - graph.nodes()[j as usize]).into();
            for a in 0..3 {
                for b in 0..3 {
                    rbar[a][b] += weight * map.linear[a][b];
                }
            }
            for (r, row) in rows.iter().enumerate() {
                let at = (slot as usize * rows.len() + r) * pitch::<W>();
                let y = &mut sample.y[at..at + pitch::<W>()];
                maps.add_pulled_back(simd, j as usize, row.map(|e| weight * e), q, y);
            }
        }
        if nb > 0 {
            let slab = shapes.vertex(i);
            for (u, row) in sample.u.chunks_exact_mut(shape_pitch(nb)).zip(rows) {
                let direction = times(row, &rbar);
                if c == 0 {
                    shape_row::<false>(&mut u[..nb], direction, slab);
                } else {
                    shape_row::<true>(&mut u[..nb], direction, slab);
                }
            }
        }
    }
}

/// Adds to a node's block row the products `Y_sj' Y_sk` and `Y_sj' U_s` of its `samples`.
pub(super) fn fill_row<const W: usize>(chunks: &[SampleChunk<W>], samples: &NodeSamples, row: BlockRow<'_>, nb: usize) {
    dispatch(FillRow { chunks, samples, row, nb });
}

struct FillRow<'a, const W: usize> {
    chunks: &'a [SampleChunk<W>],
    samples: &'a NodeSamples,
    row: BlockRow<'a>,
    nb: usize,
}

/// Rows of Y and U that [`fill_row`] gathers before it multiplies them.
const BATCH: usize = 96;

/// How many samples before a sample its shapes are fetched.
const SAMPLES_AHEAD: usize = 3;

impl<const W: usize> WithSimd for FillRow<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chunks, samples, mut row, nb } = self;
        let mut first = 0;
        for &(block, end) in &samples.blocks {
            let pairs = &samples.pairs[first..end as usize];
            first = end as usize;
            let block = &mut row.blocks[block as usize..][..W * W];
            sweep::<S, W>(simd, pitch::<W>(), &mut BlockTile::<W> { chunks, pairs, block });
        }

        let (mut y, mut u): ([&[f64]; BATCH], [&[f64]; BATCH]) = ([&[]; BATCH], [&[]; BATCH]);
        let mut batched = 0;
        let (pitch, width) = (pitch::<W>(), shape_pitch(nb));
        for &at in &samples.samples {
            let chunk = &chunks[at.chunk as usize];
            let u_start = chunk.row_starts[at.sample as usize] as usize;
            for (r, k) in chunk.rows_of(at).enumerate() {
                y[batched] = &chunk.y[k * pitch..][..pitch];
                u[batched] = &chunk.u[(u_start + r) * width..][..width];
                batched += 1;
                if batched == BATCH {
                    multiply::<S, W>(simd, &y, &u, &mut row, nb);
                    batched = 0;
                }
            }
        }
        multiply::<S, W>(simd, &y[..batched], &u[..batched], &mut row, nb);
    }
}

/// Adds the products of rows of `y` with themselves and with rows of `u`.
#[inline(always)]
fn multiply<S: Simd, const W: usize>(simd: S, y: &[&[f64]], u: &[&[f64]], row: &mut BlockRow<'_>, nb: usize) {
    let diagonal = row.blocks.len() - W * W;
    let (block, gradient) = (&mut row.blocks[diagonal..], &mut *row.gradient);
    sweep::<S, W>(simd, pitch::<W>(), &mut DiagonalTile::<W> { y, block, gradient });
    if nb > 0 {
        OuterProducts::<W> { left: y, right: u, n: nb, out: row.cross }.with_simd(simd);
    }
}

/// `Y_sj' Y_sk` of a block.
struct BlockTile<'a, const W: usize> {
    chunks: &'a [SampleChunk<W>],
    pairs: &'a [SlotPair],
    block: &'a mut [f64],
}

impl<const W: usize> Tile for BlockTile<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let rows = self.pairs.iter().flat_map(|pair| {
            let chunk = &self.chunks[pair.own.chunk as usize];
            let other = NodeSample { slot: pair.other, ..pair.own };
            let rows = chunk.rows_of(pair.own).zip(chunk.rows_of(other));
            rows.map(|(own, other)| (&chunk.y[own * pitch::<W>()..], &chunk.y[other * pitch::<W>() + first..]))
        });
        let sum = sum_of_products::<S, W, V>(simd, rows);
        for (row, sum) in self.block.chunks_exact_mut(W).zip(&sum) {
            add_to(simd, bytemuck::cast_slice(sum), &mut row[first.min(W)..]);
        }
    }
}

/// `Y_sj' [Y_sj e_s]`: the diagonal block and the gradient.
struct DiagonalTile<'a, const W: usize> {
    y: &'a [&'a [f64]],
    block: &'a mut [f64],
    gradient: &'a mut [f64],
}

impl<const W: usize> Tile for DiagonalTile<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let sum = sum_of_products::<S, W, V>(simd, self.y.iter().map(|y| (*y, &y[first..])));
        for (t, sum) in sum.iter().enumerate() {
            add_to(simd, bytemuck::cast_slice(sum), &mut self.block[t * W..][..W][first.min(W)..]);
            if (first..first + V * S::F64_LANES).contains(&W) {
                self.gradient[t] += bytemuck::cast_slice::<S::f64s, f64>(sum)[W - first];
            }
        }
    }
}

#[inline(always)]
fn times(row: &[f64; 3], m: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|b| row[0] * m[0][b] + row[1] * m[1][b] + row[2] * m[2][b])
}

/// `out = c' slab` for a `3 x nb` slab, or its sum with `out`.
#[inline(always)]
fn shape_row<const ADD: bool>(out: &mut [f64], c: [f64; 3], slab: &[f32]) {
    let nb = out.len();
    let (s0, rest) = slab.split_at(nb);
    let (s1, s2) = rest.split_at(nb);
    for k in 0..nb {
        let [d0, d1, d2] = [s0[k], s1[k], s2[k]].map(f64::from);
        let before = if ADD { out[k] } else { 0.0 };
        out[k] = c[2].mul_add(d2, c[1].mul_add(d1, c[0].mul_add(d0, before)));
    }
}
