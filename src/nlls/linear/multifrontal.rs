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

use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::{Accum, MatMut, Par};

use super::scratch::Scratch;

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
    memory: Scratch,
}

/// One supernode's place in the tree.
#[derive(Debug, Clone)]
struct Front {
    /// First column, in permuted order.
    start: usize,
    width: usize,
    /// Rows below the columns.
    below: usize,
    /// Where its columns start in the factor.
    values: usize,
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
        self.below * self.below
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
    pub(super) fn new(symbolic: &SymbolicSupernodalCholesky<usize>) -> Self {
        let count = symbolic.n_supernodes();
        let (begin, end) = (symbolic.supernode_begin(), symbolic.supernode_end());
        let mut owner = vec![0; end.last().map_or(0, |&n| n)];
        for k in 0..count {
            owner[begin[k]..end[k]].fill(k);
        }
        let parent = |k: usize| symbolic.supernode(k).pattern().first().map(|&row| owner[row]);
        let mut children = vec![Vec::new(); count];
        let mut stack = Vec::new();
        for k in (0..count).rev() {
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
            let (pattern, width) = (symbolic.supernode(k).pattern(), end[k] - begin[k]);
            let first_run = runs.len();
            if let Some(p) = parent(k) {
                let above = symbolic.supernode(p).pattern();
                for (from, &row) in pattern.iter().enumerate() {
                    let to = if row < end[p] {
                        row - begin[p]
                    } else {
                        end[p] - begin[p] + above.binary_search(&row).expect("proven: a parent has its children's rows")
                    };
                    let (from, to) = (from as u32, to as u32);
                    match runs[first_run..].last_mut() {
                        // No run crosses from the parent's columns to the rows below them.
                        Some(run) if run.to + run.length == to && to as usize != end[p] - begin[p] => run.length += 1,
                        _ => runs.push(Run { from, to, length: 1 }),
                    }
                }
            }
            fronts.push(Front {
                start: begin[k],
                width,
                below: pattern.len(),
                values: symbolic.col_ptr_for_val()[k],
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
        let widest = fronts.iter().map(|f| f.width).max().unwrap_or(0);
        let memory = cholesky_in_place_scratch::<f64>(widest, Par::Seq, Default::default());
        Self { fronts, runs, updates: highest.map(|length| vec![0.0; length]), memory: Scratch::new(memory) }
    }

    /// Overwrites the lower triangle of a matrix, laid out like its factor, with the factor: supernode after supernode, each
    /// column-major with its columns' rows first and those below after them.
    ///
    /// # Errors
    /// The column, in permuted order, whose pivot is not positive.
    pub(super) fn factorize(&mut self, factor: &mut [f64]) -> Result<(), usize> {
        let Self { fronts, runs, updates: [even, odd], memory } = self;
        let mut tops = [0; 2];
        for (k, front) in fronts.iter().enumerate() {
            let &Front { width, below, parity, .. } = front;
            let height = width + below;
            let columns = &mut factor[front.values..front.values + height * width];
            let (own, others) = if parity == 0 { (&mut *even, &*odd) } else { (&mut *odd, &*even) };
            let top = tops[1 - parity];
            for (child, start) in children(fronts, k, top) {
                let runs = &runs[child.runs.clone()];
                let split = runs.partition_point(|run| (run.to as usize) < width);
                add_columns(&others[start..], child.below, &runs[..split], runs, |to| to as usize * height, 0, columns);
                tops[1 - parity] = start;
            }

            let whole = MatMut::from_column_major_slice_mut(columns, height, width);
            let (mut triangle, mut rectangle) = whole.split_at_row_mut(width);
            let options = (LltRegularization::default(), Par::Seq, Default::default());
            cholesky_in_place(triangle.as_mut(), options.0, options.1, memory.stack(), options.2)
                .map_err(|LltError::NonPositivePivot { index }| front.start + index)?;
            if below == 0 {
                continue;
            }
            solve_lower_triangular_in_place(triangle.as_ref(), rectangle.as_mut().transpose_mut(), Par::Seq);
            let update = &mut own[tops[parity]..][..front.update()];
            triangular::matmul(
                MatMut::from_column_major_slice_mut(update, below, below),
                BlockStructure::TriangularLower,
                Accum::Replace,
                rectangle.as_ref(),
                BlockStructure::Rectangular,
                rectangle.as_ref().transpose(),
                BlockStructure::Rectangular,
                -1.0,
                Par::Seq,
            );
            for (child, start) in children(fronts, k, top) {
                let runs = &runs[child.runs.clone()];
                let below_columns = &runs[runs.partition_point(|run| (run.to as usize) < width)..];
                let column = |to: u32| (to as usize - width) * below;
                add_columns(&others[start..], child.below, below_columns, below_columns, column, width, update);
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
fn add_columns(
    update: &[f64],
    below: usize,
    columns: &[Run],
    rows: &[Run],
    column: impl Fn(u32) -> usize,
    first: usize,
    out: &mut [f64],
) {
    for (r, run) in columns.iter().enumerate() {
        for c in 0..run.length {
            let from = &update[(run.from + c) as usize * below..][..below];
            let out = &mut out[column(run.to + c)..];
            for (i, rows) in rows[r..].iter().enumerate() {
                // In the diagonal's own run, rows above it hold nothing.
                let skip = if i == 0 { c } else { 0 };
                let (source, length) = ((rows.from + skip) as usize, (rows.length - skip) as usize);
                let target = (rows.to + skip) as usize - first;
                for (o, u) in out[target..target + length].iter_mut().zip(&from[source..source + length]) {
                    *o += u;
                }
            }
        }
    }
}
