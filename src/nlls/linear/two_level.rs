//! The two-level preconditioner: diagonal blocks, and a coarse problem in which neighbouring blocks move alike.
//!
//! ```text
//!     z = diag(H_ii)^-1 r + Z (Z' H Z)^-1 Z' r        Z: each block takes the value of its aggregate
//! ```
//!
//! The diagonal blocks know which directions the data see at each block; what they miss are smooth changes that cost little
//! because neighbours change alike, and those are what Z spans. Aggregates of a fixed number of blocks bound the condition
//! number whatever the number of blocks is (additive Schwarz with a coarse space of aggregates: B. Smith, P. Bjorstad, W. Gropp,
//! "Domain decomposition", 1996, chapter 2).

use std::collections::VecDeque;
use std::sync::Arc;

use super::supernodal::SupernodalFactor;
use super::vector::{dense_cholesky_solve, dot};
use super::{damping_at, pivot_is_sound};
use crate::nlls::{BlockStructure, NormalEquations};

/// Blocks to an aggregate. Half of it takes a quarter fewer iterations, which do not pay for the larger coarse problem.
const AGGREGATE: usize = 16;

/// Where a block of H is added to the coarse matrix.
#[derive(Debug, Clone, Copy)]
enum Target {
    Straight(usize),
    Transposed(usize),
    /// Inside an aggregate, off the diagonal: both.
    Both(usize),
}

/// Inverted diagonal blocks and the factor of the coarse matrix.
#[derive(Debug)]
pub(super) struct TwoLevel {
    /// Per block.
    aggregate: Vec<usize>,
    /// Whether the block's aggregate has other members.
    in_company: Vec<bool>,
    /// Per slot.
    targets: Vec<Target>,
    /// Where the inverse of each diagonal block starts.
    starts: Vec<usize>,
    inverses: Vec<f64>,
    triangle: Vec<f64>,
    coarse: NormalEquations,
    coarse_damping: Vec<f64>,
    factor: SupernodalFactor,
    permuted: Vec<f64>,
}

impl TwoLevel {
    /// Forms aggregates and analyses the coarse problem; the border of `s` is ignored.
    pub(super) fn analyse(s: &BlockStructure) -> Self {
        let (aggregate, sizes) = aggregates(s);
        let slots = |i: usize| s.row_slots(i).zip(s.row(i).iter().map(move |&j| (i, j)));
        let all = || (0..s.block_count()).flat_map(slots);
        let pairs = all().map(|(_, (i, j))| (aggregate[i], aggregate[j]));
        let thin = BlockStructure::new(&sizes, pairs, 0).expect("proven: aggregates are numbered from 0");
        let slot = |i: usize, j: usize| thin.slot(i, j).expect("proven: the pair was added");
        let target = |(_, (i, j)): (usize, (usize, usize))| {
            let (a, b) = (aggregate[i], aggregate[j]);
            match a.cmp(&b) {
                std::cmp::Ordering::Less => Target::Transposed(slot(b, a)),
                std::cmp::Ordering::Equal if i != j => Target::Both(slot(a, b)),
                _ => Target::Straight(slot(a, b)),
            }
        };
        let targets = all().map(target).collect();
        let mut members = vec![0; sizes.len()];
        aggregate.iter().for_each(|&a| members[a] += 1);
        let mut starts = vec![0];
        for i in 0..s.block_count() {
            starts.push(starts[i] + s.size(i) * s.size(i));
        }
        let largest = (0..s.block_count()).map(|i| s.size(i)).max().unwrap_or(0);
        let thin = Arc::new(thin);
        Self {
            in_company: aggregate.iter().map(|&a| members[a] > 1).collect(),
            aggregate,
            targets,
            inverses: vec![0.0; starts[s.block_count()]],
            starts,
            triangle: vec![0.0; largest * largest],
            coarse_damping: vec![0.0; thin.dimension()],
            permuted: vec![0.0; thin.dimension()],
            factor: SupernodalFactor::analyse(&thin),
            coarse: NormalEquations::new(thin),
        }
    }

    /// Inverts the diagonal blocks of `h + diag(damping)` and factorises the coarse matrix. Returns the number of weak pivots,
    /// or the tangent coordinate that broke it.
    pub(super) fn factorize(&mut self, h: &NormalEquations, damping: &[f64]) -> Result<usize, usize> {
        let s = h.structure();
        let mut weak = 0;
        for i in 0..s.block_count() {
            let mut own = 0;
            self.invert(h, damping, i, &mut own)?;
            // A block that is an aggregate of its own is counted with the coarse matrix.
            weak += if self.in_company[i] { own } else { 0 };
        }
        self.coarse.clear();
        let thin = self.coarse.structure().clone();
        for i in 0..s.block_count() {
            for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
                let (block, columns) = (&h.blocks[s.values(slot)], s.size(j));
                let (straight, transposed) = match self.targets[slot] {
                    Target::Straight(slot) => (Some(slot), None),
                    Target::Transposed(slot) => (None, Some(slot)),
                    Target::Both(slot) => (Some(slot), Some(slot)),
                };
                if let Some(slot) = straight {
                    let out = &mut self.coarse.blocks[thin.values(slot)];
                    out.iter_mut().zip(block).for_each(|(c, h)| *c += h);
                }
                if let Some(slot) = transposed {
                    let (out, rows) = (&mut self.coarse.blocks[thin.values(slot)], s.size(i));
                    for (a, row) in block.chunks_exact(columns).enumerate() {
                        row.iter().enumerate().for_each(|(b, h)| out[b * rows + a] += h);
                    }
                }
            }
        }
        self.coarse_damping.fill(0.0);
        for i in 0..s.block_count() {
            let out = &mut self.coarse_damping[thin.offset(self.aggregate[i])..][..s.size(i)];
            out.iter_mut().enumerate().for_each(|(a, d)| *d += damping_at(damping, s.offset(i) + a));
        }
        let member = |k: usize| {
            let a = (0..thin.block_count()).rfind(|&a| thin.offset(a) <= k).unwrap_or(0);
            let i = self.aggregate.iter().position(|&b| b == a).unwrap_or(0);
            s.offset(i) + k - thin.offset(a)
        };
        Ok(weak + self.factor.factorize(&self.coarse, &self.coarse_damping).map_err(member)?)
    }

    /// Inverts diagonal block `i`.
    fn invert(&mut self, h: &NormalEquations, damping: &[f64], i: usize, weak: &mut usize) -> Result<(), usize> {
        let s = h.structure();
        let n = s.size(i);
        let block = &h.blocks[s.values(s.row_slots(i).end - 1)];
        let l = &mut self.triangle[..n * n];
        l.copy_from_slice(block);
        // Symmetric, so row-major is column-major; column by column.
        for c in 0..n {
            let damp = damping_at(damping, s.offset(i) + c);
            let own = block[c * (n + 1)];
            let pivot = own + damp - (0..c).map(|k| l[k * n + c] * l[k * n + c]).sum::<f64>();
            if !pivot_is_sound(pivot, own, damp, weak) {
                return Err(s.offset(i) + c);
            }
            l[c * (n + 1)] = pivot.sqrt();
            for r in c + 1..n {
                let sum: f64 = (0..c).map(|k| l[k * n + r] * l[k * n + c]).sum();
                l[c * n + r] = (l[c * n + r] - sum) / l[c * (n + 1)];
            }
        }
        let inverse = &mut self.inverses[self.starts[i]..self.starts[i + 1]];
        inverse.fill(0.0);
        for (c, column) in inverse.chunks_exact_mut(n).enumerate() {
            column[c] = 1.0;
            dense_cholesky_solve(l, column);
        }
        Ok(())
    }

    /// `z = P^-1 r`.
    pub(super) fn apply(&mut self, s: &BlockStructure, r: &[f64], z: &mut [f64]) {
        let Self { aggregate, starts, inverses, coarse, factor, permuted, .. } = self;
        let offset = |i: usize| coarse.structure().offset(aggregate[i]);
        let fine = || {
            for i in 0..s.block_count() {
                let n = s.size(i);
                let own = s.offset(i)..s.offset(i) + n;
                let inverse = &inverses[starts[i]..starts[i + 1]];
                for (z, row) in z[own.clone()].iter_mut().zip(inverse.chunks_exact(n)) {
                    *z = dot(row, &r[own.clone()]);
                }
            }
        };
        let solve_coarse = || {
            permuted.fill(0.0);
            for i in 0..s.block_count() {
                for a in 0..s.size(i) {
                    permuted[factor.position()[offset(i) + a]] += r[s.offset(i) + a];
                }
            }
            factor.forward::<1>(permuted.as_chunks_mut().0);
            factor.backward::<1>(permuted.as_chunks_mut().0);
        };
        rayon::join(fine, solve_coarse);
        for i in 0..s.block_count() {
            for a in 0..s.size(i) {
                z[s.offset(i) + a] += permuted[factor.position()[offset(i) + a]];
            }
        }
    }
}

/// The aggregate of each block, and the block size of each aggregate. Grown breadth first over blocks of equal size that meet;
/// crumbs join a neighbour.
fn aggregates(s: &BlockStructure) -> (Vec<usize>, Vec<usize>) {
    let n = s.block_count();
    let mut neighbours = vec![Vec::new(); n];
    for i in 0..n {
        for &j in s.row(i).iter().filter(|&&j| j != i && s.size(j) == s.size(i)) {
            neighbours[i].push(j);
            neighbours[j].push(i);
        }
    }
    let mut aggregate = vec![usize::MAX; n];
    let mut members = Vec::new();
    let mut queued = vec![usize::MAX; n];
    let mut queue = VecDeque::new();
    for seed in 0..n {
        if aggregate[seed] != usize::MAX {
            continue;
        }
        let (own, mut count) = (members.len(), 0);
        queue.clear();
        queue.push_back(seed);
        while let Some(i) = queue.pop_front().filter(|_| count < AGGREGATE) {
            aggregate[i] = own;
            count += 1;
            for &j in &neighbours[i] {
                if aggregate[j] == usize::MAX && queued[j] != own {
                    queued[j] = own;
                    queue.push_back(j);
                }
            }
        }
        members.push(count);
    }
    let is_crumb = |a: usize| members[a] < AGGREGATE / 3;
    for i in (0..n).filter(|&i| is_crumb(aggregate[i])).collect::<Vec<_>>() {
        if let Some(&j) = neighbours[i].iter().find(|&&j| !is_crumb(aggregate[j])) {
            aggregate[i] = aggregate[j];
        }
    }
    // Numbered by their first block.
    let mut number = vec![usize::MAX; members.len()];
    let mut sizes = Vec::new();
    for (i, a) in aggregate.iter_mut().enumerate() {
        if number[*a] == usize::MAX {
            number[*a] = sizes.len();
            sizes.push(s.size(i));
        }
        *a = number[*a];
    }
    (aggregate, sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aggregates_hold_neighbours_of_one_size() {
        // A 20 x 20 grid of blocks, the right half larger, and a block that meets nothing.
        let sizes: Vec<usize> = (0..401).map(|i| if i % 20 < 10 { 3 } else { 6 }).collect();
        let grid = (0..400).flat_map(|i| [(i, i + 1, i % 20 < 19), (i, i + 20, i < 380)]);
        let pairs: Vec<(usize, usize)> = grid.filter(|p| p.2).map(|p| (p.0, p.1)).collect();
        let s = BlockStructure::new(&sizes, pairs.iter().copied(), 0).unwrap();
        let (aggregate, coarse) = aggregates(&s);
        assert!((0..401).all(|i| coarse[aggregate[i]] == s.size(i)));
        for a in 0..coarse.len() {
            let members: Vec<usize> = (0..401).filter(|&i| aggregate[i] == a).collect();
            assert!(members == [400] || (AGGREGATE / 3..2 * AGGREGATE + 8).contains(&members.len()), "{members:?}");
            let mut reached = vec![members[0]];
            for k in 0..members.len() {
                assert!(k < reached.len(), "{members:?} do not hang together");
                for &(i, j) in &pairs {
                    for (i, j) in [(i, j), (j, i)] {
                        if i == reached[k] && aggregate[j] == a && !reached.contains(&j) {
                            reached.push(j);
                        }
                    }
                }
            }
        }
        assert!((20..40).contains(&coarse.len()), "{}", coarse.len());
    }
}
