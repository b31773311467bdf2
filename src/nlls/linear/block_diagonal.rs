//! Inverses of the diagonal blocks of H, what preconditioners start from.

use super::vector::{dense_cholesky_solve, dot};
use super::{damping_at, pivot_is_sound};
use crate::nlls::{BlockStructure, NormalEquations};

/// `(H_ii + D_ii)^-1` of every sparse block, by Cholesky's method.
#[derive(Debug)]
pub(super) struct BlockDiagonal {
    /// Where the inverse of each block starts.
    starts: Vec<usize>,
    inverses: Vec<f64>,
    triangle: Vec<f64>,
}

impl BlockDiagonal {
    pub(super) fn new(s: &BlockStructure) -> Self {
        let mut starts = vec![0];
        for i in 0..s.block_count() {
            starts.push(starts[i] + s.size(i) * s.size(i));
        }
        let largest = (0..s.block_count()).map(|i| s.size(i)).max().unwrap_or(0);
        Self { inverses: vec![0.0; starts[s.block_count()]], starts, triangle: vec![0.0; largest * largest] }
    }

    /// Inverts the diagonal blocks of `h + diag(damping)`. Returns the number of weak pivots in blocks that `counted` says yes
    /// to, or the tangent coordinate that broke it.
    pub(super) fn invert(
        &mut self,
        h: &NormalEquations,
        damping: &[f64],
        counted: impl Fn(usize) -> bool,
    ) -> Result<usize, usize> {
        let mut weak = 0;
        for i in 0..h.structure().block_count() {
            let mut own = 0;
            self.invert_block(h, damping, i, &mut own)?;
            weak += if counted(i) { own } else { 0 };
        }
        Ok(weak)
    }

    fn invert_block(&mut self, h: &NormalEquations, damping: &[f64], i: usize, weak: &mut usize) -> Result<(), usize> {
        let s = h.structure();
        let n = s.size(i);
        let block = &h.blocks[s.values(s.row_slots(i).end - 1)];
        let l = &mut self.triangle[..n * n];
        l.copy_from_slice(block);
        // Symmetric, so row-major is column-major; column by column.
        for c in 0..n {
            let damp = damping_at(damping, s.offset(i) + c);
            let diagonal = block[c * (n + 1)] + damp;
            let pivot = diagonal - (0..c).map(|k| l[k * n + c] * l[k * n + c]).sum::<f64>();
            if !pivot_is_sound(pivot, diagonal, damp, weak) {
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

    /// `z = (H_ii + D_ii)^-1 r` for the coordinates of block `i`.
    #[inline(always)]
    pub(super) fn apply(&self, i: usize, r: &[f64], z: &mut [f64]) {
        let inverse = &self.inverses[self.starts[i]..self.starts[i + 1]];
        for (z, row) in z.iter_mut().zip(inverse.chunks_exact(r.len())) {
            *z = dot(row, r);
        }
    }
}
