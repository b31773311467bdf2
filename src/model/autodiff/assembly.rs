//! Formulas over a few parameter blocks each, as items of the assembler.
//!
//! Samples whose blocks are the same set form an *element*, as vertices in one cell of a lattice do: one item with the rows of all of
//! them, so that blocks are seeded once for many formulas.

use std::collections::BTreeMap;
use std::marker::PhantomData;

use num_dual::DualSVec64;
use pulp::Simd;
use rayon::prelude::*;

use crate::energy::Quadric;
use crate::mesh::Vec3;
use crate::nlls::{Assembly, BlockStructure, FillRows, ItemRows, Manifold, NormalEquations, PointArray, Scalar};

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
pub(super) struct FormulaAssembly<B: Manifold> {
    elements: Vec<Element>,
    assembly: Assembly,
    scratch: Vec<Scratch<B>>,
}

/// What an element is linearised in.
pub(super) struct Scratch<B: Manifold> {
    points: Vec<B::Point<Dual>>,
    delta: Vec<Dual>,
    /// First row of each sample, and their number at the end.
    row_starts: Vec<usize>,
    residuals: Vec<f64>,
}

impl<B: Manifold> Default for Scratch<B> {
    fn default() -> Self {
        Self { points: Vec::new(), delta: Vec::new(), row_starts: Vec::new(), residuals: Vec::new() }
    }
}

/// Samples with the same set of blocks: an item.
struct Element {
    blocks: Vec<u32>,
    samples: Vec<u32>,
    runs: Vec<Run>,
}

/// Corners of an element's samples that take the same list of blocks.
struct Run {
    list: u32,
    /// For each of the list's distinct blocks, which of the element's it is.
    slots: Vec<u32>,
    corners: Vec<Corner>,
}

/// A formula's share in a sample; `sample` counts within the element.
struct Corner {
    formula: u32,
    weight: f64,
    sample: u32,
}

/// A sample and its (vertex, weight) corners.
type WeightedCorners = (u32, Vec<(u32, f64)>);

impl<B: Manifold> FormulaAssembly<B> {
    /// Samples as convex combinations (formula, weight).
    pub(super) fn new(supports: &Supports, samples: impl Iterator<Item = Vec<(u32, f64)>>) -> Self {
        let mut sets: BTreeMap<Vec<u32>, Vec<WeightedCorners>> = BTreeMap::new();
        for (s, corners) in samples.enumerate() {
            let blocks = sorted_once(corners.iter().flat_map(|c| supports.of(c.0).distinct.iter().copied()));
            sets.entry(blocks).or_default().push((s as u32, corners));
        }
        let elements = sets
            .iter()
            .flat_map(|(blocks, samples)| samples.chunks(CHUNK).map(|samples| Element::new(blocks, samples, supports)));
        Self { elements: elements.collect(), assembly: Assembly::default(), scratch: Vec::new() }
    }

    /// The blocks of each item.
    pub(super) fn items(&self) -> impl Iterator<Item = &[u32]> {
        self.elements.iter().map(|e| &e.blocks[..])
    }

    /// Finds the places of all blocks in the normal equations.
    pub(super) fn analyse(&mut self, structure: &BlockStructure) {
        let elements = &self.elements;
        self.assembly =
            Assembly::new(elements.iter().map(|e| &e.blocks[..]), structure, |e| 3 * elements[e].samples.len());
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
        let rows = Rows { elements: &self.elements, formula, supports, x, quadric, blocks: PhantomData };
        self.assembly.linearize_by(0, &mut self.scratch, &rows);
    }

    /// Adds what was linearised last to the normal equations.
    pub(super) fn add_to(&self, equations: &mut NormalEquations) {
        self.assembly.add_to(equations);
    }
}

impl Element {
    fn new(blocks: &[u32], samples: &[WeightedCorners], supports: &Supports) -> Self {
        let mut runs: BTreeMap<u32, Vec<Corner>> = BTreeMap::new();
        for (sample, (_, corners)) in samples.iter().enumerate() {
            for &(formula, weight) in corners {
                let corner = Corner { formula, weight, sample: sample as u32 };
                runs.entry(supports.of[formula as usize]).or_default().push(corner);
            }
        }
        let runs = runs.into_iter().map(|(list, corners)| {
            let slots = supports.lists[list as usize].distinct.iter().map(|&b| position(blocks, b));
            Run { list, slots: slots.collect(), corners }
        });
        Self { blocks: blocks.to_vec(), samples: samples.iter().map(|s| s.0).collect(), runs: runs.collect() }
    }
}

/// The rows of elements: `A_s dv_s/dp` of every sample.
struct Rows<'a, B, F, Q> {
    elements: &'a [Element],
    formula: &'a F,
    supports: &'a Supports,
    x: &'a [f64],
    quadric: &'a Q,
    blocks: PhantomData<fn() -> B>,
}

impl<B: Manifold, F: Formula<B>, Q: Fn(usize, [f64; 3]) -> Quadric + Sync> FillRows for Rows<'_, B, F, Q> {
    type Scratch = Scratch<B>;

    fn count(&self, item: usize) -> usize {
        self.elements[item].samples.iter().map(|&s| (self.quadric)(s as usize, [0.0; 3]).rows().len()).sum()
    }

    #[inline(always)]
    fn fill<S: Simd>(&self, _: S, item: usize, scratch: &mut Scratch<B>, rows: &mut ItemRows<'_>) {
        let element = &self.elements[item];
        let Scratch { points, delta, row_starts, residuals } = scratch;
        delta.resize(B::TANGENT, Dual::from_re(0.0));
        residuals.clear();
        residuals.resize(rows.count(), 0.0);
        row_starts.clear();
        let mut count = 0;
        for &s in &element.samples {
            row_starts.push(count);
            count += (self.quadric)(s as usize, [0.0; 3]).rows().len();
        }
        row_starts.push(count);
        for run in &element.runs {
            let support = &self.supports.lists[run.list as usize];
            for first in (0..run.slots.len() * B::TANGENT).step_by(STRIDE) {
                seed::<B>(support, first, self.x, points, delta);
                for corner in &run.corners {
                    let own = row_starts[corner.sample as usize]..row_starts[corner.sample as usize + 1];
                    if own.is_empty() {
                        continue;
                    }
                    let v = self.formula.evaluate(corner.formula as usize, points);
                    let jacobian = v.map(|v| v.eps.0.map_or([0.0; STRIDE], |e| e.into()));
                    let sample = element.samples[corner.sample as usize] as usize;
                    let quadric = (self.quadric)(sample, v.map(|v| v.re));
                    residuals[own.clone()].copy_from_slice(quadric.residuals());
                    for (r, row) in own.zip(quadric.rows()) {
                        let [a, b, c] = row.map(|r| corner.weight * r);
                        for k in 0..STRIDE.min(run.slots.len() * B::TANGENT - first) {
                            let along = a * jacobian[0][k] + b * jacobian[1][k] + c * jacobian[2][k];
                            let (block, t) = ((first + k) / B::TANGENT, (first + k) % B::TANGENT);
                            rows.of_block(run.slots[block] as usize, r)[t] += along;
                        }
                    }
                }
            }
        }
        rows.set_residuals(residuals);
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
