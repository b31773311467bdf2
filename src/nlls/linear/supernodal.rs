//! The sparse factor of the blocks: `P H_gg P' = L L'` in supernodes.
//!
//! The fill-reducing permutation is computed on the graph of *blocks* and expanded, so that every block stays together and
//! the supernodes are at least one block wide. The permuted lower triangle is then laid out once; refilling it is a copy of
//! whole blocks, without an index per value.
//!
//! ```text
//!   supernode s, columns [start, start + width):      L_s = [ T ]  width x width, lower triangular
//!                                                           [ B ]  one row for each index in `pattern`, ascending
//! ```
//!
//! column-major, columns padded (see [`front`](super::front)).

use std::sync::Arc;

use faer::dyn_stack::StackReq;
use faer::sparse::SymbolicSparseColMat;
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};

use super::layout::{Layout, SupernodeLayout};
use super::multifrontal::Multifrontal;
use super::ordering::block_ordering;
use super::scratch::Scratch;
use super::vector::{axpy, dot};
use super::{damping_at, pivot_is_sound};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// Where one stored block goes in the factor's memory.
#[derive(Debug, Clone, Copy)]
struct Placement {
    /// Position of its first value.
    start: usize,
    /// Distance between its columns.
    stride: usize,
    /// The permutation has swapped row and column block.
    transposed: bool,
}

/// Symbolic and numeric factor of `H_gg`.
#[derive(Debug)]
pub(super) struct SupernodalFactor {
    /// `position[i]`: the permuted coordinate of tangent coordinate `i`.
    position: Vec<usize>,
    /// Inverse of `position`.
    coordinate: Vec<usize>,
    placements: Vec<Placement>,
    layout: Layout,
    numeric: Multifrontal,
    factor: Vec<f64>,
    gathered: Vec<f64>,
    gathered_lanes: Vec<Lanes>,
}

impl SupernodalFactor {
    /// Symbolic analysis of the sparse blocks of `structure`; its border is ignored.
    pub(super) fn analyse(structure: &Arc<BlockStructure>) -> Self {
        let s = structure;
        let n = s.sparse_dimension();
        let order = block_ordering(s);
        let mut rank = vec![0; order.len()];
        for (p, &i) in order.iter().enumerate() {
            rank[i] = p;
        }
        let mut starts = vec![0];
        for &i in &order {
            starts.push(starts[starts.len() - 1] + s.size(i));
        }
        let mut position = vec![0; n];
        let mut coordinate = vec![0; n];
        for (p, &i) in order.iter().enumerate() {
            for a in 0..s.size(i) {
                position[s.offset(i) + a] = starts[p] + a;
                coordinate[starts[p] + a] = s.offset(i) + a;
            }
        }

        let mut upper: Vec<Vec<usize>> = vec![Vec::new(); order.len()];
        for i in 0..s.block_count() {
            for &j in s.row(i) {
                upper[rank[i].max(rank[j])].push(rank[i].min(rank[j]));
            }
        }
        let (mut col_starts, mut rows) = (vec![0], Vec::new());
        for p in 0..order.len() {
            upper[p].sort_unstable();
            for c in starts[p]..starts[p + 1] {
                rows.extend(upper[p].iter().flat_map(|&q| starts[q]..starts[q + 1]).filter(|&r| r <= c));
                col_starts.push(rows.len());
            }
        }
        let symbolic = symbolic_cholesky(&SymbolicSparseColMat::new_checked(n, n, col_starts, None, rows));
        let layout = Layout::new(&symbolic);

        // A block's columns lie in one supernode and its rows follow each other there: both come whole.
        let place = |i: usize, j: usize| {
            let (row, col) = (starts[rank[i].max(rank[j])], starts[rank[i].min(rank[j])]);
            let k = layout.owner[col];
            let SupernodeLayout { start, values, stride, .. } = layout.supernodes[k];
            Placement {
                start: values + (col - start) * stride + layout.local_row(k, row),
                stride,
                transposed: rank[i] < rank[j],
            }
        };
        let placements = (0..s.block_count())
            .flat_map(|i| s.row(i).iter().map(move |&j| (i, j)))
            .map(|(i, j)| place(i, j))
            .collect();
        let longest = layout.supernodes.iter().map(|node| node.pattern.len()).max().unwrap_or(0);
        Self {
            position,
            coordinate,
            placements,
            numeric: Multifrontal::new(&layout),
            factor: vec![0.0; layout.len],
            layout,
            gathered: vec![0.0; longest],
            gathered_lanes: Vec::new(),
        }
    }

    /// The permuted coordinate of every tangent coordinate.
    pub(super) fn position(&self) -> &[usize] {
        &self.position
    }

    /// Refills the matrix and factorises it. Returns the number of weak pivots, or the tangent coordinate that broke it.
    pub(super) fn factorize(&mut self, equations: &NormalEquations, damping: &[f64]) -> Result<usize, usize> {
        let s = equations.structure();
        self.factor.fill(0.0);
        for i in 0..s.block_count() {
            for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
                let block = &equations.blocks[s.values(slot)];
                let Placement { start, stride, transposed } = self.placements[slot];
                let columns = s.size(j);
                if transposed {
                    for (r, row) in block.chunks_exact(columns).enumerate() {
                        self.factor[start + r * stride..][..columns].copy_from_slice(row);
                    }
                } else {
                    for (r, row) in block.chunks_exact(columns).enumerate() {
                        for (c, v) in row.iter().enumerate() {
                            self.factor[start + c * stride + r] = *v;
                        }
                    }
                }
            }
            // The diagonal block is the last of its row.
            let diagonal = self.placements[s.row_slots(i).end - 1];
            for a in 0..s.size(i) {
                self.factor[diagonal.start + a * (diagonal.stride + 1)] += damping_at(damping, s.offset(i) + a);
            }
        }
        self.numeric.factorize(&mut self.factor).map_err(|column| self.coordinate[column])?;
        let mut weak = 0;
        for k in 0..self.supernode_count() {
            let node = self.supernode(k);
            for c in 0..node.width {
                let i = self.coordinate[node.start + c];
                let damp = damping_at(damping, i);
                let pivot = node.column(c)[c].powi(2);
                if !pivot_is_sound(pivot, equations.diagonal(i) + damp, damp, &mut weak) {
                    return Err(i);
                }
            }
        }
        Ok(weak)
    }

    /// Numbers that it holds, padding included.
    pub(super) fn len(&self) -> usize {
        self.factor.len()
    }

    /// Number of supernodes.
    pub(super) fn supernode_count(&self) -> usize {
        self.layout.supernodes.len()
    }

    /// Columns `start..start + width` of L.
    pub(super) fn supernode(&self, k: usize) -> Supernode<'_> {
        let &SupernodeLayout { start, width, values, stride, .. } = &self.layout.supernodes[k];
        Supernode { start, width, stride, pattern: self.layout.pattern(k), values: &self.factor[values..] }
    }

    /// Solves `L x = b` in place; `x` is in permuted order.
    pub(super) fn forward(&mut self, x: &mut [f64]) {
        let mut gathered = std::mem::take(&mut self.gathered);
        vectorized(
            #[inline(always)]
            || {
                for k in 0..self.supernode_count() {
                    let node = self.supernode(k);
                    let below = &mut gathered[..node.pattern.len()];
                    below.fill(0.0);
                    for c in 0..node.width {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        head[c] /= column[c];
                        axpy(-head[c], &column[c + 1..node.width], tail);
                        axpy(head[c], &column[node.width..], below);
                    }
                    for (&row, v) in node.pattern.iter().zip(below) {
                        x[row] -= *v;
                    }
                }
            },
        );
        self.gathered = gathered;
    }

    /// Solves `L' x = b` in place; `x` is in permuted order.
    pub(super) fn backward(&mut self, x: &mut [f64]) {
        let mut gathered = std::mem::take(&mut self.gathered);
        vectorized(
            #[inline(always)]
            || {
                for k in (0..self.supernode_count()).rev() {
                    let node = self.supernode(k);
                    let below = &mut gathered[..node.pattern.len()];
                    for (&row, v) in node.pattern.iter().zip(&mut *below) {
                        *v = x[row];
                    }
                    for c in (0..node.width).rev() {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        let sum = dot(&column[c + 1..node.width], tail) + dot(&column[node.width..], below);
                        head[c] = (head[c] - sum) / column[c];
                    }
                }
            },
        );
        self.gathered = gathered;
    }
}

/// Right-hand sides that are solved together; as many as a register holds.
pub(super) type Lanes = [f64; 4];

/// `y += a x`, a number of L times a row of right-hand sides.
#[inline(always)]
fn add_lanes(a: f64, x: &Lanes, y: &mut Lanes) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}

/// Adds `a . x` of every lane to four running sums, as one would wait for itself.
#[inline(always)]
fn sum_lanes(a: &[f64], x: &[Lanes], sums: &mut [Lanes; 4]) {
    let (a_fours, x_fours) = (a.chunks_exact(4), x.chunks_exact(4));
    for (a, x) in a_fours.remainder().iter().zip(x_fours.remainder()) {
        add_lanes(*a, x, &mut sums[0]);
    }
    for (a, x) in a_fours.zip(x_fours) {
        for k in 0..4 {
            add_lanes(a[k], &x[k], &mut sums[k]);
        }
    }
}

impl SupernodalFactor {
    /// [`forward`](Self::forward) for several right-hand sides.
    pub(super) fn forward_lanes(&mut self, x: &mut [Lanes]) {
        let mut gathered = std::mem::take(&mut self.gathered_lanes);
        gathered.resize(self.gathered.len(), Lanes::default());
        vectorized(
            #[inline(always)]
            || {
                for k in 0..self.supernode_count() {
                    let node = self.supernode(k);
                    let below = &mut gathered[..node.pattern.len()];
                    below.fill(Lanes::default());
                    for c in 0..node.width {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        let solved = head[c].map(|v| v / column[c]);
                        head[c] = solved;
                        tail.iter_mut().zip(&column[c + 1..]).for_each(|(y, l)| add_lanes(-l, &solved, y));
                        below.iter_mut().zip(&column[node.width..]).for_each(|(y, l)| add_lanes(*l, &solved, y));
                    }
                    for (&row, v) in node.pattern.iter().zip(below) {
                        add_lanes(-1.0, v, &mut x[row]);
                    }
                }
            },
        );
        self.gathered_lanes = gathered;
    }

    /// [`backward`](Self::backward) for several right-hand sides.
    pub(super) fn backward_lanes(&mut self, x: &mut [Lanes]) {
        let mut gathered = std::mem::take(&mut self.gathered_lanes);
        gathered.resize(self.gathered.len(), Lanes::default());
        vectorized(
            #[inline(always)]
            || {
                for k in (0..self.supernode_count()).rev() {
                    let node = self.supernode(k);
                    let below = &mut gathered[..node.pattern.len()];
                    for (&row, v) in node.pattern.iter().zip(&mut *below) {
                        *v = x[row];
                    }
                    for c in (0..node.width).rev() {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        let mut sums = [Lanes::default(); 4];
                        sum_lanes(&column[c + 1..node.width], tail, &mut sums);
                        sum_lanes(&column[node.width..], below, &mut sums);
                        for lane in 0..head[c].len() {
                            let sum = (sums[0][lane] + sums[1][lane]) + (sums[2][lane] + sums[3][lane]);
                            head[c][lane] = (head[c][lane] - sum) / column[c];
                        }
                    }
                }
            },
        );
        self.gathered_lanes = gathered;
    }
}

/// A run of columns of L that share their pattern.
#[derive(Debug, Clone, Copy)]
pub(super) struct Supernode<'a> {
    /// First column, in permuted order.
    pub start: usize,
    /// Number of columns.
    pub width: usize,
    /// Rows below the triangle, ascending, in permuted order.
    pub pattern: &'a [usize],
    /// Distance between its columns.
    pub stride: usize,
    /// Its columns, and what comes after them.
    pub values: &'a [f64],
}

impl<'a> Supernode<'a> {
    fn column(&self, c: usize) -> &'a [f64] {
        &self.values[c * self.stride..][..self.width + self.pattern.len()]
    }
}

/// Elimination tree, column counts and supernodes of the matrix whose upper triangle is given.
fn symbolic_cholesky(upper: &SymbolicSparseColMat<usize>) -> supernodal::SymbolicSupernodalCholesky<usize> {
    let n = upper.ncols();
    let mut tree = vec![0isize; n];
    let mut counts = vec![0usize; n];
    let mut memory = Scratch::new(StackReq::any_of(&[
        simplicial::prefactorize_symbolic_cholesky_scratch::<usize>(n, upper.row_idx().len()),
        supernodal::factorize_supernodal_symbolic_cholesky_scratch::<usize>(n),
    ]));
    let stack = memory.stack();
    let tree = simplicial::prefactorize_symbolic_cholesky(&mut tree, &mut counts, upper.as_ref(), stack);
    supernodal::factorize_supernodal_symbolic_cholesky(
        upper.as_ref(),
        tree,
        &counts,
        memory.stack(),
        SymbolicSupernodalParams::default(),
    )
    .expect("the index type is as wide as the memory that holds the factor")
}
