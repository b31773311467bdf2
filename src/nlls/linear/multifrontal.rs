//! Numeric Cholesky factorisation of a sparse matrix whose symbolic factor is known, by fronts.
//!
//! The front of a supernode is what elimination knows of its columns and of the rows below them: entries of the matrix, and
//! what the supernodes before have left for it. Eliminating the columns leaves an update for the parent in the tree,
//!
//! ```text
//!     [ T ]         T T' = A_11,   B T' = A_21        columns of L
//!     [ B ]         U = A_22 - B B'                   the update, a dense lower triangle
//! ```
//!
//! so all arithmetic is on dense blocks as large as the supernode: one Cholesky, one triangular solve and one product each
//! (Duff & Reid 1983; Liu 1992). Updates wait on a stack, in the order of a depth-first walk of the tree.
//!
//! Why not faer's supernodal factorisation, on the same symbolic factor? One thread, paired runs, with supernodes wider than today's; how
//! many times as long it takes:
//!
//! | vertices, nodes, shapes | Gauss-Newton iteration | linear solve | linear solve, with faer's forward solve of the border too |
//! |---|---|---|---|
//! | 5,000, 400, 50 | 1.24 | 1.45 | 1.42 |
//! | 5,000, 400, 0 | 1.27 | 1.51 | 1.48 |
//! | 20,000, 400, 50 | 1.17 | 1.52 | 1.44 |
//! | 20,000, 5,000, 50 | 1.13 | 1.15 | 0.96 |
//! | 20,000, 5,000, 0 | 1.35 | 1.42 | 1.10 |

use pulp::{Simd, WithSimd};

use super::front::{factor_columns, negative_square, update_column, update_len};
use super::layout::Layout;
use crate::nlls::dense_kernels::{add_to, dispatch};

/// The tree of fronts with all memory that a factorisation needs.
#[derive(Debug)]
pub(super) struct Multifrontal {
    /// Supernodes, children before parents, the children of one directly before it.
    fronts: Vec<Front>,
    /// Where in the parents' fronts the rows below go.
    runs: Vec<Run>,
    /// Updates that wait for their parents, those of even depth in the tree and those of odd: a front reads from one stack
    /// and writes to the other.
    updates: [Vec<f64>; 2],
}

/// One supernode's place in the tree.
#[derive(Debug, Clone)]
struct Front {
    supernode: usize,
    /// First column, in permuted order.
    start: usize,
    width: usize,
    /// Rows below the columns.
    below: usize,
    /// Where its columns start in the factor.
    values: usize,
    /// Distance between its columns.
    stride: usize,
    runs: std::ops::Range<usize>,
    /// Number of children: the fronts whose updates are on top of the other stack.
    children: usize,
    /// Number of fronts in its subtree, itself included.
    subtree: usize,
    /// Depth in the tree, modulo 2.
    parity: usize,
}

/// Consecutive rows of an update that are consecutive in the parent's front too.
#[derive(Debug, Clone, Copy)]
struct Run {
    from: u32,
    to: u32,
    length: u32,
}

impl Front {
    /// Entries of its update.
    fn update(&self) -> usize {
        update_len(self.below)
    }
}

/// The children of front `k`, the last first, and where the update of each starts on a stack that ends at `top`.
fn children(fronts: &[Front], k: usize, top: usize) -> impl Iterator<Item = (&Front, usize)> {
    let (mut next, mut start) = (k, top);
    (0..fronts[k].children).map(move |i| {
        next -= if i == 0 { 1 } else { fronts[next].subtree };
        start -= fronts[next].update();
        (&fronts[next], start)
    })
}

impl Multifrontal {
    pub(super) fn new(layout: &Layout) -> Self {
        let count = layout.supernodes.len();
        let parent = |k: usize| layout.pattern(k).first().map(|&row| layout.owner[row]);
        let mut children = vec![Vec::new(); count];
        let mut stack = Vec::new();
        // Children come before parents. Of a front's, the one whose subtree needs most beyond what it leaves is the first, so the last here
        // (J. Liu, "On the storage requirement in the out-of-core multifrontal method", 1986): least waits at a time.
        let mut needs = vec![0; count];
        for k in 0..count {
            let update = |k: usize| update_len(layout.pattern(k).len());
            children[k].sort_by_key(|&c| needs[c] - update(c));
            let (need, left) =
                children[k].iter().rev().fold((0, 0), |(need, left), &c| (need.max(left + needs[c]), left + update(c)));
            needs[k] = need.max(left + update(k));
            match parent(k) {
                Some(p) => children[p].push(k),
                None => stack.push((k, 0, false)),
            }
        }
        // Depth first, without recursion: a tree may be as deep as it has supernodes.
        let mut order = Vec::with_capacity(count);
        while let Some((k, parity, visited)) = stack.pop() {
            if visited {
                order.push((k, parity));
            } else {
                stack.push((k, parity, true));
                stack.extend(children[k].iter().map(|&c| (c, 1 - parity, false)));
            }
        }

        let (mut fronts, mut runs): (Vec<Front>, Vec<Run>) = (Vec::new(), Vec::new());
        let (mut tops, mut highest) = ([0; 2], [0; 2]);
        for (k, parity) in order {
            let (node, pattern) = (&layout.supernodes[k], layout.pattern(k));
            let first_run = runs.len();
            if let Some(p) = parent(k) {
                for (from, &row) in pattern.iter().enumerate() {
                    let to = layout.local_row(p, row);
                    let (from, to) = (from as u32, to as u32);
                    match runs[first_run..].last_mut() {
                        // No run crosses from the parent's columns to the rows below them.
                        Some(run) if run.to + run.length == to && to as usize != layout.supernodes[p].width => {
                            run.length += 1
                        }
                        _ => runs.push(Run { from, to, length: 1 }),
                    }
                }
            }
            fronts.push(Front {
                supernode: k,
                start: node.start,
                width: node.width,
                below: pattern.len(),
                values: node.values,
                stride: node.stride,
                runs: first_run..runs.len(),
                children: children[k].len(),
                subtree: 1,
                parity,
            });
            let last = fronts.len() - 1;
            let eaten = self::children(&fronts, last, tops[1 - parity]);
            let (subtree, top) =
                eaten.fold((1, tops[1 - parity]), |(sum, _), (child, start)| (sum + child.subtree, start));
            fronts[last].subtree = subtree;
            tops[1 - parity] = top;
            tops[parity] += fronts[last].update();
            highest[parity] = highest[parity].max(tops[parity]);
        }
        Self { fronts, runs, updates: highest.map(|length| vec![0.0; length]) }
    }

    /// Writes the factor of a matrix: supernode after supernode, each column-major with its columns' rows first and those below after
    /// them. `load` writes a supernode's columns of the matrix itself, the lower triangle, where nothing but zeros is yet; they
    /// are still in the cache when they are eliminated.
    ///
    /// # Errors
    /// The column, in permuted order, whose pivot is not positive.
    pub(super) fn factorize(&mut self, factor: &mut [f64], load: impl Fn(usize, &mut [f64])) -> Result<(), usize> {
        dispatch(Factorize { tree: self, factor, load })
    }
}

struct Factorize<'a, L> {
    tree: &'a mut Multifrontal,
    factor: &'a mut [f64],
    load: L,
}

impl<L: Fn(usize, &mut [f64])> WithSimd for Factorize<'_, L> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { tree: Multifrontal { fronts, runs, updates: [even, odd] }, factor, load } = self;
        let mut tops = [0; 2];
        for (k, front) in fronts.iter().enumerate() {
            let &Front { width, below, parity, stride, .. } = front;
            let columns = &mut factor[front.values..];
            columns[..stride * width].fill(0.0);
            load(front.supernode, &mut columns[..stride * width]);
            let (own, others) = if parity == 0 { (&mut *even, &*odd) } else { (&mut *odd, &*even) };
            let top = tops[1 - parity];
            for (child, start) in children(fronts, k, top) {
                let runs = &runs[child.runs.clone()];
                let split = runs.partition_point(|run| (run.to as usize) < width);
                let column = |to: u32| to as usize * stride;
                add_columns(simd, &others[start..], child.below, (&runs[..split], runs), column, 0, columns);
                tops[1 - parity] = start;
            }

            factor_columns(simd, &mut columns[..stride * width], stride, width).map_err(|c| front.start + c)?;
            if below == 0 {
                continue;
            }
            let update = &mut own[tops[parity]..][..front.update()];
            negative_square(simd, columns, stride, width, below, update);
            for (child, start) in children(fronts, k, top) {
                let runs = &runs[child.runs.clone()];
                let below_columns = &runs[runs.partition_point(|run| (run.to as usize) < width)..];
                let column = |to: u32| update_column(below, to as usize - width);
                let runs = (below_columns, below_columns);
                add_columns(simd, &others[start..], child.below, runs, column, width, update);
            }
            tops[parity] += front.update();
        }
        Ok(())
    }
}

/// Adds the columns in the first `runs` of a child's `update`, of `below` rows, to those of its parent: what is below the
/// diagonal, so of the rows in `rows`, which begin with the same runs. `column` says where in `out` a column of the parent
/// starts, and that is its row `first`.
#[inline(always)]
fn add_columns<S: Simd>(
    simd: S,
    update: &[f64],
    below: usize,
    (columns, rows): (&[Run], &[Run]),
    column: impl Fn(u32) -> usize,
    first: usize,
    out: &mut [f64],
) {
    for (r, run) in columns.iter().enumerate() {
        for c in 0..run.length {
            let from = &update[update_column(below, (run.from + c) as usize)..][..below];
            let out = &mut out[column(run.to + c)..];
            for (i, rows) in rows[r..].iter().enumerate() {
                // In the diagonal's own run, rows above it hold nothing.
                let skip = if i == 0 { c } else { 0 };
                let (source, length) = ((rows.from + skip) as usize, (rows.length - skip) as usize);
                let target = (rows.to + skip) as usize - first;
                add_to(simd, &from[source..source + length], &mut out[target..]);
            }
        }
    }
}
