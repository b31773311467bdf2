//! Samples that parameters move linearly, as control points of a lattice and affine maps do:
//!
//! ```text
//!     s = c + sum_k X_k h_k            X_k: 3 x H, the parameters of block k row by row
//! ```

use std::collections::BTreeMap;

use crate::energy::{QuadricField, Samples};
use crate::nlls::{Assembly, BlockStructure, NormalEquations};

/// Samples of an item.
const ITEM: usize = 16;

/// What moves each sample, and how it enters the equations.
#[derive(Debug, Default)]
pub(super) struct LinearSamples<const H: usize> {
    items: Vec<Item<H>>,
    assembly: Assembly,
}

/// Samples that the same blocks move.
#[derive(Debug, Default)]
struct Item<const H: usize> {
    samples: Vec<u32>,
    /// `h_k` of the item's blocks in each of them, one sample after the other.
    factors: Vec<[f64; H]>,
}

impl<const H: usize> LinearSamples<H> {
    /// The structure of `blocks` blocks; `moved_by` names the blocks that move a vertex, with their `h_k`, and `also` pairs of blocks that
    /// meet elsewhere. A sample that nothing moves is left out.
    pub fn analyse<I: Iterator<Item = (u32, [f64; H])>>(
        &mut self,
        samples: &Samples,
        blocks: usize,
        moved_by: impl Fn(u32) -> I,
        also: impl IntoIterator<Item = (usize, usize)>,
    ) -> BlockStructure {
        let mut alike: BTreeMap<Vec<u32>, Item<H>> = BTreeMap::new();
        for s in 0..samples.len() {
            let mut factors: BTreeMap<u32, [f64; H]> = BTreeMap::new();
            for &(v, share) in samples.corners(s) {
                for (block, h) in moved_by(v) {
                    let sum = factors.entry(block).or_insert([0.0; H]);
                    sum.iter_mut().zip(h).for_each(|(sum, h)| *sum += share * h);
                }
            }
            if !factors.is_empty() {
                let item = alike.entry(factors.keys().copied().collect()).or_default();
                item.samples.push(s as u32);
                item.factors.extend(factors.values());
            }
        }
        let mut cliques: Vec<Vec<u32>> = Vec::new();
        self.items.clear();
        for (clique, Item { samples, factors }) in alike {
            for (samples, factors) in samples.chunks(ITEM).zip(factors.chunks(ITEM * clique.len())) {
                cliques.push(clique.clone());
                self.items.push(Item { samples: samples.to_vec(), factors: factors.to_vec() });
            }
        }
        let cliques = || cliques.iter().map(Vec::as_slice);
        let pairs = also.into_iter().chain(Assembly::pairs(cliques()));
        let structure = BlockStructure::new(&vec![3 * H; blocks], pairs, 0).expect("proven: all pairs are blocks");
        self.assembly = Assembly::new(cliques(), &structure, |item| 3 * self.items[item].samples.len());
        structure
    }

    /// Adds the quadrics of all samples to the equations.
    pub fn pull_back(&mut self, field: &QuadricField, equations: &mut NormalEquations) {
        let (items, quadrics) = (&self.items, field.quadrics());
        let count = |item: usize| items[item].samples.iter().map(|&s| quadrics[s as usize].rows().len()).sum();
        self.assembly.linearize(
            0,
            count,
            #[inline(always)]
            |item, out| {
                let Item { samples, factors } = &items[item];
                let (mut residuals, mut r) = ([0.0; 3 * ITEM], 0);
                for (&s, factors) in samples.iter().zip(factors.chunks_exact(factors.len() / samples.len())) {
                    let quadric = &quadrics[s as usize];
                    for (row, e) in quadric.rows().iter().zip(quadric.residuals()) {
                        for (slot, h) in factors.iter().enumerate() {
                            let by_axis = out.of_block(slot, r).chunks_exact_mut(H).zip(row);
                            by_axis.for_each(|(y, a)| y.iter_mut().zip(h).for_each(|(y, h)| *y = a * h));
                        }
                        residuals[r] = *e;
                        r += 1;
                    }
                }
                out.set_residuals(&residuals);
            },
        );
        self.assembly.add_to(equations);
    }
}
