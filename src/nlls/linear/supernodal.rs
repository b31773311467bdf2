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
use super::vector::{axpy_lanes, dot_lanes};
use super::{damping_at, pivot_is_sound};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// Right-hand sides that are solved together: as many as a register holds.
pub(super) const LANES: usize = 4;

/// Where one stored block goes among the columns of its supernode.
#[derive(Debug, Clone, Copy)]
struct Placement {
    slot: usize,
    /// The block's, as it is stored.
    columns: usize,
    /// Position of its first value.
    start: usize,
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
    /// Supernode by supernode.
    placements: Vec<Placement>,
    /// Where those of each supernode start; one more for the end of the last.
    placement_starts: Vec<usize>,
    layout: Layout,
    numeric: Multifrontal,
    factor: Vec<f64>,
    /// Right-hand sides of the longest pattern.
    gathered: Vec<f64>,
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
        let place = |slot: usize, i: usize, j: usize| {
            let (row, col) = (starts[rank[i].max(rank[j])], starts[rank[i].min(rank[j])]);
            let k = layout.owner[col];
            let SupernodeLayout { start, stride, .. } = layout.supernodes[k];
            let start = (col - start) * stride + layout.local_row(k, row);
            (k, Placement { slot, columns: s.size(j), start, transposed: rank[i] < rank[j] })
        };
        let mut placements: Vec<_> = (0..s.block_count())
            .flat_map(|i| s.row_slots(i).zip(s.row(i)).map(move |(slot, &j)| (slot, i, j)))
            .map(|(slot, i, j)| place(slot, i, j))
            .collect();
        placements.sort_by_key(|&(k, _)| k);
        let placement_starts =
            (0..=layout.supernodes.len()).map(|k| placements.partition_point(|&(of, _)| of < k)).collect();
        let placements = placements.into_iter().map(|(_, placement)| placement).collect();
        let longest = layout.supernodes.iter().map(|node| node.pattern.len()).max().unwrap_or(0);
        Self {
            position,
            coordinate,
            placements,
            placement_starts,
            numeric: Multifrontal::new(&layout),
            factor: vec![0.0; layout.len],
            layout,
            gathered: vec![0.0; longest * LANES],
        }
    }

    /// The permuted coordinate of every tangent coordinate.
    pub(super) fn position(&self) -> &[usize] {
        &self.position
    }

    /// Refills the matrix and factorises it. Returns the number of weak pivots, or the tangent coordinate that broke it.
    pub(super) fn factorize(&mut self, equations: &NormalEquations, damping: &[f64]) -> Result<usize, usize> {
        let s = equations.structure();
        let Self { coordinate, placements, placement_starts, layout, numeric, factor, .. } = self;
        let load = |k: usize, matrix: &mut [f64]| {
            let &SupernodeLayout { start, width, stride, .. } = &layout.supernodes[k];
            for p in &placements[placement_starts[k]..placement_starts[k + 1]] {
                let rows = equations.blocks[s.values(p.slot)].chunks_exact(p.columns).enumerate();
                if p.transposed {
                    rows.for_each(|(r, row)| matrix[p.start + r * stride..][..row.len()].copy_from_slice(row));
                } else {
                    for (r, row) in rows {
                        row.iter().enumerate().for_each(|(c, v)| matrix[p.start + c * stride + r] = *v);
                    }
                }
            }
            for (c, &i) in coordinate[start..start + width].iter().enumerate() {
                matrix[c * (stride + 1)] += damping_at(damping, i);
            }
        };
        numeric.factorize(factor, load).map_err(|column| coordinate[column])?;
        let mut weak = 0;
        for k in 0..self.supernode_count() {
            let node = self.supernode(k);
            for c in 0..node.width {
                let i = self.coordinate[node.start + c];
                let damp = damping_at(damping, i);
                let pivot = node.column(c)[c].powi(2);
                if !pivot_is_sound(pivot, equations.diagonal(i), damp, &mut weak) {
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

    /// Solves `L x = b` in place for `L` right-hand sides side by side, [`LANES`] at most; rows are in permuted order.
    pub(super) fn forward<const L: usize>(&mut self, x: &mut [[f64; L]]) {
        let mut gathered = std::mem::take(&mut self.gathered);
        vectorized(
            #[inline(always)]
            || {
                for k in 0..self.supernode_count() {
                    let node = self.supernode(k);
                    let below = &mut gathered.as_chunks_mut::<L>().0[..node.pattern.len()];
                    below.fill([0.0; L]);
                    for c in 0..node.width {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        head[c] = head[c].map(|v| v / column[c]);
                        axpy_lanes(head[c].map(|v| -v), &column[c + 1..node.width], tail);
                        axpy_lanes(head[c], &column[node.width..], below);
                    }
                    for (&row, v) in node.pattern.iter().zip(below) {
                        x[row].iter_mut().zip(v).for_each(|(x, v)| *x -= *v);
                    }
                }
            },
        );
        self.gathered = gathered;
    }

    /// Solves `L' x = b` in place, as [`forward`](Self::forward) does `L x = b`.
    pub(super) fn backward<const L: usize>(&mut self, x: &mut [[f64; L]]) {
        let mut gathered = std::mem::take(&mut self.gathered);
        vectorized(
            #[inline(always)]
            || {
                for k in (0..self.supernode_count()).rev() {
                    let node = self.supernode(k);
                    let below = &mut gathered.as_chunks_mut::<L>().0[..node.pattern.len()];
                    for (&row, v) in node.pattern.iter().zip(&mut *below) {
                        *v = x[row];
                    }
                    for c in (0..node.width).rev() {
                        let column = node.column(c);
                        let (head, tail) = x[node.start..node.start + node.width].split_at_mut(c + 1);
                        let own = dot_lanes(&column[c + 1..node.width], tail);
                        let others = dot_lanes(&column[node.width..], below);
                        for l in 0..L {
                            head[c][l] = (head[c][l] - (own[l] + others[l])) / column[c];
                        }
                    }
                }
            },
        );
        self.gathered = gathered;
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
