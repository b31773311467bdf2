//! In which order blocks are eliminated: what decides how sparse the factor is.

use faer::sparse::SymbolicSparseColMat;
use faer::sparse::linalg::amd;

use super::scratch::Scratch;
use crate::nlls::BlockStructure;
use crate::nlls::dense_kernels::vectorized;

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
    vectorized(
        #[inline(always)]
        || {
            let mut clique = Vec::new();
            order.iter().map(|&i| graph.eliminate(i, &mut clique)).map(|h| h * (h + 1) / 2).sum()
        },
    )
}

/// Greedy minimum fill (Tinney & Walker 1967, scheme 3): next comes the block whose elimination joins the fewest pairs of blocks
/// that are not joined yet; of those the one with the fewest neighbours. Counts are renewed for neighbours of what was
/// eliminated, not for theirs.
fn minimum_fill(s: &BlockStructure) -> Vec<usize> {
    let mut graph = EliminationGraph::new(s);
    vectorized(
        #[inline(always)]
        || {
            // A search of all is cheaper than a queue for as few as these.
            let mut left: Vec<(usize, usize, usize)> = (0..s.block_count()).map(|i| graph.key(i)).collect();
            let mut at: Vec<usize> = (0..left.len()).collect();
            let (mut order, mut clique) = (Vec::with_capacity(left.len()), Vec::new());
            while let Some((next, &(.., i))) = left.iter().enumerate().min_by_key(|(_, key)| **key) {
                left.swap_remove(next);
                if let Some(moved) = left.get(next) {
                    at[moved.2] = next;
                }
                order.push(i);
                graph.eliminate(i, &mut clique);
                for &j in &clique {
                    left[at[j]] = graph.key(j);
                }
            }
            order
        },
    )
}

/// The graph of the blocks that are left, as a table of bits.
struct EliminationGraph {
    joined: Vec<u64>,
    words: usize,
}

impl EliminationGraph {
    fn new(s: &BlockStructure) -> Self {
        let n = s.block_count();
        let words = n.div_ceil(64);
        let mut joined = vec![0; n * words];
        for i in 0..n {
            for &j in s.row(i).iter().filter(|j| **j != i) {
                joined[i * words + j / 64] |= 1 << (j % 64);
                joined[j * words + i / 64] |= 1 << (i % 64);
            }
        }
        Self { joined, words }
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &[u64] {
        &self.joined[i * self.words..(i + 1) * self.words]
    }

    /// Twice the pairs of neighbours of `i` that are not joined, the number of its neighbours, and `i`.
    #[inline(always)]
    fn key(&self, i: usize) -> (usize, usize, usize) {
        let own = self.row(i);
        let (mut degree, mut present) = (0_usize, 0);
        for_each_bit(own, |j| {
            degree += 1;
            present += own.iter().zip(self.row(j)).map(|(a, b)| (a & b).count_ones() as usize).sum::<usize>();
        });
        (degree * degree.saturating_sub(1) - present, degree, i)
    }

    /// Takes `i` out and joins its neighbours, which it leaves in `clique`; returns how many they are.
    #[inline(always)]
    fn eliminate(&mut self, i: usize, clique: &mut Vec<usize>) -> usize {
        clique.clear();
        for_each_bit(self.row(i), |j| clique.push(j));
        for &j in &*clique {
            for word in 0..self.words {
                self.joined[j * self.words + word] |= self.joined[i * self.words + word];
            }
            for gone in [i, j] {
                self.joined[j * self.words + gone / 64] &= !(1 << (gone % 64));
            }
        }
        clique.len()
    }
}

/// Calls `visit` with the index of every bit that is set, ascending.
#[inline(always)]
fn for_each_bit(words: &[u64], mut visit: impl FnMut(usize)) {
    for (k, &word) in words.iter().enumerate() {
        let mut rest = word;
        while rest != 0 {
            visit(k * 64 + rest.trailing_zeros() as usize);
            rest &= rest - 1;
        }
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
