//! Normal equations of formulas over a few parameter blocks each.
//!
//! Samples whose blocks are the same set form an *element*, as vertices in one cell of a lattice do. With the rows `A_s` of a
//! sample's quadric and `Y_s = A_s dv_s/dp`, all of an element's rows stand in one dense `Y`, and block row j of H sums
//! `Y_j' Y_k` over the elements that hold j, in fixed order.

use std::collections::BTreeMap;

use num_dual::DualSVec64;
use rayon::prelude::*;

use crate::energy::Quadric;
use crate::mesh::Vec3;
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockRow, BlockStructure, Manifold, NormalEquations, PointArray, Scalar};

const STRIDE: usize = 16;
type Dual = DualSVec64<STRIDE>;

/// Samples of an element, and of a batch, at most: the units of parallel work.
const CHUNK: usize = 128;

/// Formulas numbered from 0, of blocks of type `B`.
pub(super) trait Formula<B: Manifold>: Sync {
    fn evaluate<D: Scalar>(&self, index: usize, p: &[B::Point<D>]) -> [D; 3];
}

/// Which blocks each formula takes; equal lists are kept once.
pub(super) struct Supports {
    lists: Vec<Support>,
    of: Vec<u32>,
}

struct Support {
    /// Blocks in the order in which the formula takes them; some may be named twice.
    blocks: Vec<u32>,
    /// Each block once, ascending.
    distinct: Vec<u32>,
    /// Where in `distinct` each of `blocks` is.
    index: Vec<u32>,
}

impl Supports {
    /// The lists of formulas 0, 1, ..; or the first formula and its block that is not below `block_count`.
    pub(super) fn new(lists: &[Vec<usize>], block_count: usize) -> Result<Self, (usize, usize)> {
        let (mut known, mut found) = (BTreeMap::new(), Self { lists: Vec::new(), of: Vec::new() });
        for (i, list) in lists.iter().enumerate() {
            if let Some(&block) = list.iter().find(|b| **b >= block_count) {
                return Err((i, block));
            }
            let blocks: Vec<u32> = list.iter().map(|&b| b as u32).collect();
            let id = *known.entry(blocks.clone()).or_insert(found.lists.len() as u32);
            found.of.push(id);
            if id as usize == found.lists.len() {
                let distinct = sorted_once(blocks.iter().copied());
                let index = blocks.iter().map(|b| position(&distinct, *b)).collect();
                found.lists.push(Support { blocks, distinct, index });
            }
        }
        Ok(found)
    }

    /// Number of formulas.
    pub(super) fn len(&self) -> usize {
        self.of.len()
    }

    fn of(&self, formula: u32) -> &Support {
        &self.lists[self.of[formula as usize] as usize]
    }

    /// Writes the values of all formulas at `x` to `out`; `scratch` is kept from call to call.
    pub(super) fn evaluate<B: Manifold>(
        &self,
        formula: &impl Formula<B>,
        x: &[f64],
        scratch: &mut Vec<Vec<B::Point<f64>>>,
        out: &mut Vec<Vec3>,
    ) {
        out.resize(self.len(), Vec3::zeros());
        scratch.resize(self.len().div_ceil(CHUNK), Vec::new());
        out.par_chunks_mut(CHUNK).zip(scratch).enumerate().for_each(|(c, (chunk, points))| {
            for (k, value) in chunk.iter_mut().enumerate() {
                let i = c * CHUNK + k;
                points.clear();
                points.extend(self.of(i as u32).blocks.iter().map(|&b| point::<B>(x, b)));
                *value = formula.evaluate(i, points).into();
            }
        });
    }
}

fn sorted_once(blocks: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut blocks: Vec<u32> = blocks.collect();
    blocks.sort_unstable();
    blocks.dedup();
    blocks
}

fn position(blocks: &[u32], block: u32) -> u32 {
    blocks.binary_search(&block).expect("proven: the list was made with this block in it") as u32
}

fn ambient<B: Manifold>(x: &[f64], block: u32) -> &[f64] {
    &x[block as usize * B::AMBIENT..][..B::AMBIENT]
}

fn point<B: Manifold>(x: &[f64], block: u32) -> B::Point<f64> {
    let mut point = B::Point::<f64>::filled(0.0);
    point.as_mut().copy_from_slice(ambient::<B>(x, block));
    point
}

/// All samples of one kind with their Jacobians.
pub(super) struct Assembly<B: Manifold> {
    batches: Vec<Batch<B>>,
    /// Per block, the elements that hold it.
    holders: Vec<Vec<Holder>>,
}

/// Elements that are linearised on one thread, and the memory for that.
struct Batch<B: Manifold> {
    elements: Vec<Element>,
    points: Vec<B::Point<Dual>>,
    delta: Vec<Dual>,
}

/// Samples with the same set of blocks.
struct Element {
    blocks: Vec<u32>,
    samples: Vec<u32>,
    /// First row of each sample in `y`, and their number at the end.
    row_starts: Vec<u32>,
    runs: Vec<Run>,
    /// `Y'`: per tangent coordinate of `blocks` one entry for each row, at most three rows for each sample.
    y: Vec<f64>,
    /// `sum_s (dv_s/dp)' g_s`.
    g: Vec<f64>,
}

/// Corners of an element's samples that take the same list of blocks.
struct Run {
    list: u32,
    /// For each tangent coordinate of the list's distinct blocks, which of the element's it is.
    coordinates: Vec<u32>,
    corners: Vec<Corner>,
}

/// A formula's share in a sample; `sample` counts within the element.
struct Corner {
    formula: u32,
    weight: f64,
    sample: u32,
}

/// An element that holds a block in this slot. `targets`: where in the block row the blocks with slots 0 to `slot` start, if
/// they are of this row, that is, at or before the diagonal.
struct Holder {
    batch: u32,
    element: u32,
    slot: u32,
    targets: Vec<u32>,
}

/// A sample and its (vertex, weight) corners.
type WeightedCorners = (u32, Vec<(u32, f64)>);

impl<B: Manifold> Assembly<B> {
    pub(super) fn empty() -> Self {
        Self { batches: Vec::new(), holders: Vec::new() }
    }

    /// Samples as convex combinations (formula, weight).
    pub(super) fn new(supports: &Supports, samples: impl Iterator<Item = Vec<(u32, f64)>>) -> Self {
        let mut sets: BTreeMap<Vec<u32>, Vec<WeightedCorners>> = BTreeMap::new();
        for (s, corners) in samples.enumerate() {
            let blocks = sorted_once(corners.iter().flat_map(|c| supports.of(c.0).distinct.iter().copied()));
            sets.entry(blocks).or_default().push((s as u32, corners));
        }
        let elements = sets.iter().flat_map(|(blocks, samples)| {
            samples.chunks(CHUNK).map(|samples| Element::new::<B>(blocks, samples, supports))
        });
        let (mut batches, mut filled): (Vec<Batch<B>>, usize) = (Vec::new(), CHUNK);
        for element in elements {
            if filled + element.samples.len() > CHUNK {
                let delta = vec![Dual::from_re(0.0); B::TANGENT];
                batches.push(Batch { elements: Vec::new(), points: Vec::new(), delta });
                filled = 0;
            }
            filled += element.samples.len();
            batches.last_mut().expect("proven: pushed above").elements.push(element);
        }
        Self { batches, holders: Vec::new() }
    }

    fn elements(&self) -> impl Iterator<Item = (u32, u32, &Element)> {
        self.batches.iter().enumerate().flat_map(|(b, batch)| {
            batch.elements.iter().enumerate().map(move |(e, element)| (b as u32, e as u32, element))
        })
    }

    /// Pairs of blocks that meet, the greater first.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        self.elements().flat_map(|(_, _, element)| {
            let blocks = &element.blocks;
            (0..blocks.len()).flat_map(move |p| (0..p).map(move |q| (blocks[p] as usize, blocks[q] as usize)))
        })
    }

    /// Finds the places of all blocks in the normal equations.
    pub(super) fn attach(&mut self, structure: &BlockStructure) {
        let mut holders: Vec<Vec<Holder>> = (0..structure.block_count()).map(|_| Vec::new()).collect();
        for (batch, element, e) in self.elements() {
            for (p, &j) in e.blocks.iter().enumerate() {
                let start = |k: u32| {
                    let at = structure.row(j as usize).binary_search(&(k as usize));
                    (at.expect("proven: the pair was added") * B::TANGENT * B::TANGENT) as u32
                };
                let targets = e.blocks[..=p].iter().map(|&k| start(k)).collect();
                holders[j as usize].push(Holder { batch, element, slot: p as u32, targets });
            }
        }
        self.holders = holders;
    }

    /// Differentiates all samples at `x`. `quadric` gives the quadric of a sample, whose number of rows must not depend on the
    /// value that it is handed: that of the sample's only formula.
    pub(super) fn linearize(
        &mut self,
        formula: &impl Formula<B>,
        supports: &Supports,
        x: &[f64],
        quadric: &(impl Fn(usize, [f64; 3]) -> Quadric + Sync),
    ) {
        self.batches.par_iter_mut().for_each(|batch| {
            let Batch { elements, points, delta } = batch;
            for element in elements {
                vectorized(
                    #[inline(always)]
                    || element.linearize::<B>(formula, supports, x, quadric, points, delta),
                );
            }
        });
    }

    /// Adds `scale` times what was linearised last to the normal equations.
    pub(super) fn add_to(&self, equations: &mut NormalEquations, scale: f64) {
        equations.for_each_block_row(&|j, mut row| {
            vectorized(
                #[inline(always)]
                || {
                    let BlockRow { blocks, gradient, .. } = &mut row;
                    for holder in &self.holders[j] {
                        let element = &self.batches[holder.batch as usize].elements[holder.element as usize];
                        element.add_products(holder, scale, blocks, B::TANGENT);
                        let own = &element.g[holder.slot as usize * B::TANGENT..];
                        gradient.iter_mut().zip(own).for_each(|(sum, g)| *sum += scale * g);
                    }
                },
            );
        });
    }
}

impl Element {
    fn new<B: Manifold>(blocks: &[u32], samples: &[(u32, Vec<(u32, f64)>)], supports: &Supports) -> Self {
        let mut runs: BTreeMap<u32, Vec<Corner>> = BTreeMap::new();
        for (sample, (_, corners)) in samples.iter().enumerate() {
            for &(formula, weight) in corners {
                let corner = Corner { formula, weight, sample: sample as u32 };
                runs.entry(supports.of[formula as usize]).or_default().push(corner);
            }
        }
        let runs = runs.into_iter().map(|(list, corners)| {
            let slots = supports.lists[list as usize].distinct.iter().map(|&b| position(blocks, b));
            let coordinates =
                slots.flat_map(|s| (0..B::TANGENT as u32).map(move |t| s * B::TANGENT as u32 + t)).collect();
            Run { list, coordinates, corners }
        });
        let width = blocks.len() * B::TANGENT;
        Self {
            blocks: blocks.to_vec(),
            samples: samples.iter().map(|s| s.0).collect(),
            row_starts: vec![0; samples.len() + 1],
            runs: runs.collect(),
            y: vec![0.0; width * 3 * samples.len()],
            g: vec![0.0; width],
        }
    }

    fn rows(&self) -> usize {
        self.row_starts[self.samples.len()] as usize
    }

    #[inline(always)]
    fn linearize<B: Manifold>(
        &mut self,
        formula: &impl Formula<B>,
        supports: &Supports,
        x: &[f64],
        quadric: &impl Fn(usize, [f64; 3]) -> Quadric,
        points: &mut Vec<B::Point<Dual>>,
        delta: &mut [Dual],
    ) {
        for (k, &s) in self.samples.iter().enumerate() {
            self.row_starts[k + 1] = self.row_starts[k] + quadric(s as usize, [0.0; 3]).rows().len() as u32;
        }
        let (rows, width) = (self.rows(), self.g.len());
        self.y[..width * rows].fill(0.0);
        self.g.fill(0.0);
        for run in &self.runs {
            let support = &supports.lists[run.list as usize];
            for (stride, coordinates) in run.coordinates.chunks(STRIDE).enumerate() {
                seed::<B>(support, stride * STRIDE, x, points, delta);
                for corner in &run.corners {
                    let first = self.row_starts[corner.sample as usize] as usize;
                    if self.row_starts[corner.sample as usize + 1] as usize == first {
                        continue;
                    }
                    let v = formula.evaluate(corner.formula as usize, points);
                    let jacobian = v.map(|v| v.eps.0.map_or([0.0; STRIDE], |e| e.into()));
                    let quadric = quadric(self.samples[corner.sample as usize] as usize, v.map(|v| v.re));
                    let along = |row: &[f64; 3]| -> [f64; STRIDE] {
                        let [a, b, c] = row.map(|r| corner.weight * r);
                        std::array::from_fn(|k| a * jacobian[0][k] + b * jacobian[1][k] + c * jacobian[2][k])
                    };
                    for (r, row) in quadric.rows().iter().enumerate() {
                        for (y, &at) in along(row).iter().zip(coordinates) {
                            self.y[at as usize * rows + first + r] += y;
                        }
                    }
                    for (g, &at) in along(&quadric.gradient()).iter().zip(coordinates) {
                        self.g[at as usize] += g;
                    }
                }
            }
        }
    }

    /// Adds `scale Y_j' Y_k` to block row j for all slots k up to that of j.
    #[inline(always)]
    fn add_products(&self, holder: &Holder, scale: f64, blocks: &mut [f64], tangent: usize) {
        if self.rows() == 0 {
            return;
        }
        let columns = (holder.slot as usize + 1) * tangent;
        for a in (0..tangent - tangent % 3).step_by(3) {
            for c in (0..columns - columns % 3).step_by(3) {
                self.add_tile::<3, 3>(holder, scale, blocks, tangent, a, c);
            }
            for c in columns - columns % 3..columns {
                self.add_tile::<3, 1>(holder, scale, blocks, tangent, a, c);
            }
        }
        for a in tangent - tangent % 3..tangent {
            for c in (0..columns - columns % 3).step_by(3) {
                self.add_tile::<1, 3>(holder, scale, blocks, tangent, a, c);
            }
            for c in columns - columns % 3..columns {
                self.add_tile::<1, 1>(holder, scale, blocks, tangent, a, c);
            }
        }
    }

    /// The part for `A` of the holder's coordinates from `a` on and `C` of the element's from `c` on.
    #[inline(always)]
    fn add_tile<const A: usize, const C: usize>(
        &self,
        holder: &Holder,
        scale: f64,
        blocks: &mut [f64],
        tangent: usize,
        a: usize,
        c: usize,
    ) {
        let rows = self.rows();
        let y = |coordinate: usize| &self.y[coordinate * rows..][..rows];
        let own = holder.slot as usize * tangent + a;
        let products = products::<A, C>(|i| y(own + i), |k| y(c + k));
        for (i, row) in products.iter().enumerate() {
            for (k, value) in row.iter().enumerate() {
                let (block, column) = ((c + k) / tangent, (c + k) % tangent);
                blocks[holder.targets[block] as usize + (a + i) * tangent + column] += scale * value;
            }
        }
    }
}

/// The blocks of `support` at `x`, with tangent coordinates `first` to `first + STRIDE` of its distinct blocks seeded.
#[inline(always)]
fn seed<B: Manifold>(support: &Support, first: usize, x: &[f64], points: &mut Vec<B::Point<Dual>>, delta: &mut [Dual]) {
    points.clear();
    for (&block, &index) in support.blocks.iter().zip(&support.index) {
        for (t, delta) in delta.iter_mut().enumerate() {
            let coordinate = index as usize * B::TANGENT + t;
            *delta = Dual::from_re(0.0);
            if (first..first + STRIDE).contains(&coordinate) {
                *delta = delta.derivative(coordinate - first);
            }
        }
        let mut point = B::Point::<Dual>::filled(Dual::from_re(0.0));
        B::plus(ambient::<B>(x, block), delta, point.as_mut());
        points.push(point);
    }
}

/// Inner products of `A` with `C` vectors of equal length, over four lanes.
#[inline(always)]
fn products<'a, const A: usize, const C: usize>(
    left: impl Fn(usize) -> &'a [f64],
    right: impl Fn(usize) -> &'a [f64],
) -> [[f64; C]; A] {
    const LANES: usize = 4;
    let (left, right): ([_; A], [_; C]) = (std::array::from_fn(left), std::array::from_fn(right));
    let (left, left_rest) = (left.map(|v| v.as_chunks::<LANES>().0), left.map(|v| v.as_chunks::<LANES>().1));
    let (right, right_rest) = (right.map(|v| v.as_chunks::<LANES>().0), right.map(|v| v.as_chunks::<LANES>().1));
    let mut lanes = [[[0.0; LANES]; C]; A];
    for r in 0..left[0].len() {
        for a in 0..A {
            for c in 0..C {
                for l in 0..LANES {
                    lanes[a][c][l] += left[a][r][l] * right[c][r][l];
                }
            }
        }
    }
    let mut sums = lanes.map(|row| row.map(|[a, b, c, d]| (a + b) + (c + d)));
    for r in 0..left_rest[0].len() {
        for a in 0..A {
            for c in 0..C {
                sums[a][c] += left_rest[a][r] * right_rest[c][r];
            }
        }
    }
    sums
}
