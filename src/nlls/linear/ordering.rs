//! In which order blocks are eliminated: what decides how sparse the factor is.

use std::collections::BTreeSet;

use faer::sparse::SymbolicSparseColMat;
use faer::sparse::linalg::amd;

use super::scratch::Scratch;
use crate::nlls::BlockStructure;

/// Up to so many blocks minimum fill is tried too. On the graph of a face, 400 blocks, its factor takes a sixth less arithmetic
/// than minimum degree's; its own cost grows faster than a factorisation's.
const MINIMUM_FILL_BLOCKS: usize = 1000;

/// An order of elimination that keeps the factor sparse: `order[p]` is the block eliminated as the `p`-th.
pub(super) fn block_ordering(s: &BlockStructure) -> Vec<usize> {
    let degree = minimum_degree(s);
    if s.block_count() > MINIMUM_FILL_BLOCKS {
        return degree;
    }
    let fill = minimum_fill(s);
    if products(s, &fill) < products(s, &degree) { fill } else { degree }
}

/// Products of blocks that a factorisation in this order takes.
fn products(s: &BlockStructure, order: &[usize]) -> usize {
    let mut graph = EliminationGraph::new(s);
    order.iter().map(|&i| graph.eliminate(i).len()).map(|h| h * (h + 1) / 2).sum()
}

/// Greedy minimum fill (Tinney & Walker 1967, scheme 3): next comes the block whose elimination joins the fewest pairs of blocks
/// that are not joined yet; of those the one with the fewest neighbours. Counts are renewed for neighbours of what was
/// eliminated, not for theirs.
fn minimum_fill(s: &BlockStructure) -> Vec<usize> {
    let mut graph = EliminationGraph::new(s);
    let mut keys: Vec<(usize, usize, usize)> = (0..s.block_count()).map(|i| graph.key(i)).collect();
    let mut queue: BTreeSet<_> = keys.iter().copied().collect();
    let mut order = Vec::with_capacity(keys.len());
    while let Some((.., i)) = queue.pop_first() {
        order.push(i);
        for j in graph.eliminate(i) {
            queue.remove(&keys[j]);
            keys[j] = graph.key(j);
            queue.insert(keys[j]);
        }
    }
    order
}

/// The graph of the blocks that are left, as lists and as a table of bits.
struct EliminationGraph {
    neighbours: Vec<Vec<usize>>,
    joined: Vec<u64>,
    words: usize,
}

impl EliminationGraph {
    fn new(s: &BlockStructure) -> Self {
        let n = s.block_count();
        let words = n.div_ceil(64);
        let mut graph = Self { neighbours: vec![Vec::new(); n], joined: vec![0; n * words], words };
        for i in 0..n {
            for &j in s.row(i).iter().filter(|j| **j != i) {
                graph.join(i, j);
                graph.join(j, i);
            }
        }
        graph
    }

    /// Adds `j` to the neighbours of `i`, unless it is one.
    fn join(&mut self, i: usize, j: usize) {
        let word = &mut self.joined[i * self.words + j / 64];
        if *word & (1 << (j % 64)) == 0 {
            *word |= 1 << (j % 64);
            self.neighbours[i].push(j);
        }
    }

    fn row(&self, i: usize) -> &[u64] {
        &self.joined[i * self.words..(i + 1) * self.words]
    }

    /// Twice the pairs of neighbours of `i` that are not joined, the number of its neighbours, and `i`.
    fn key(&self, i: usize) -> (usize, usize, usize) {
        let degree = self.neighbours[i].len();
        let common = |j: &usize| self.row(*j).iter().zip(self.row(i)).map(|(a, b)| (a & b).count_ones()).sum::<u32>();
        let present: u32 = self.neighbours[i].iter().map(common).sum();
        (degree * degree.saturating_sub(1) - present as usize, degree, i)
    }

    /// Takes `i` out and joins its neighbours, which it returns.
    fn eliminate(&mut self, i: usize) -> Vec<usize> {
        let clique = std::mem::take(&mut self.neighbours[i]);
        for &j in &clique {
            self.neighbours[j].retain(|k| *k != i);
            self.joined[j * self.words + i / 64] &= !(1 << (i % 64));
            for &k in clique.iter().filter(|k| **k != j) {
                self.join(j, k);
            }
        }
        clique
    }
}

/// Approximate minimum degree (Amestoy, Davis & Duff 1996) on the graph of blocks.
fn minimum_degree(s: &BlockStructure) -> Vec<usize> {
    let n = s.block_count();
    // Row i of the lower triangle lists columns j <= i: read as a compressed column, it is the upper triangle.
    let mut starts = vec![0];
    let mut rows = Vec::with_capacity(s.slot_count());
    for i in 0..n {
        rows.extend_from_slice(s.row(i));
        starts.push(rows.len());
    }
    let graph = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
    let (mut order, mut inverse) = (vec![0usize; n], vec![0usize; n]);
    let mut memory = Scratch::new(amd::order_scratch::<usize>(n, graph.row_idx().len()));
    amd::order(&mut order, &mut inverse, graph.as_ref(), amd::Control::default(), memory.stack())
        .expect("the index type is as wide as the memory that holds the pattern");
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks on a square grid, each joined to those up to two steps along an axis.
    fn grid(side: usize) -> BlockStructure {
        let at = |x: usize, y: usize| y * side + x;
        let mut pairs = Vec::new();
        for (x, y) in (0..side * side).map(|i| (i % side, i / side)) {
            pairs.extend((1..=2).filter(|d| x + d < side).map(|d| (at(x, y), at(x + d, y))));
            pairs.extend((1..=2).filter(|d| y + d < side).map(|d| (at(x, y), at(x, y + d))));
        }
        BlockStructure::new(&vec![6; side * side], pairs, 0).unwrap()
    }

    #[test]
    fn both_orders_name_every_block_once() {
        let s = grid(9);
        for order in [minimum_fill(&s), minimum_degree(&s)] {
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..81).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_better_of_two_orders_is_taken() {
        for side in [5, 12, 20] {
            let s = grid(side);
            let [chosen, fill, degree] =
                [block_ordering(&s), minimum_fill(&s), minimum_degree(&s)].map(|o| products(&s, &o));
            let given = products(&s, &(0..side * side).collect::<Vec<_>>());
            assert!(chosen == fill.min(degree) && chosen < given, "{chosen} {fill} {degree} {given}");
        }
    }

    #[test]
    fn a_tree_fills_in_nothing() {
        let s = BlockStructure::new(&[1; 7], [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5), (2, 6)], 0).unwrap();
        assert_eq!(products(&s, &minimum_fill(&s)), 6);
    }
}
