//! Dense Cholesky factorisation of the whole system, for small problems and for those without sparse blocks.

use std::sync::Arc;

use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::{MatMut, Par};

use super::scratch::Scratch;
use super::vector::dense_cholesky_solve;
use super::{LinearError, LinearSolver, breakdown, check_step, damping_at, pivot_is_sound};
use crate::nlls::{BlockStructure, NormalEquations};

/// `H + diag(damping) = L L'` on one dense square. Memory n^2, time n^3 / 3.
#[derive(Debug)]
pub struct DenseCholesky {
    factor: DenseFactor,
    weak: usize,
}

impl DenseCholesky {
    /// Buffers for problems of this structure (any other structure is adopted when it comes).
    #[must_use]
    pub fn new(structure: &Arc<BlockStructure>) -> Self {
        Self { factor: DenseFactor::new(structure.dimension()), weak: 0 }
    }
}

impl LinearSolver for DenseCholesky {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        let s = equations.structure();
        let (n, sparse, border) = (s.dimension(), s.sparse_dimension(), s.border());
        if self.factor.side() != n {
            self.factor = DenseFactor::new(n);
        }
        let l = self.factor.matrix_mut();
        l.fill(0.0);
        for i in 0..s.block_count() {
            for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
                let block = &equations.blocks[s.values(slot)];
                for c in 0..s.size(j) {
                    let column = (s.offset(j) + c) * n + s.offset(i);
                    for r in 0..s.size(i) {
                        l[column + r] = block[r * s.size(j) + c];
                    }
                }
            }
        }
        for c in 0..sparse {
            l[c * n + sparse..(c + 1) * n].copy_from_slice(&equations.cross[c * border..(c + 1) * border]);
        }
        for c in 0..border {
            for r in c..border {
                l[(sparse + c) * n + sparse + r] = equations.border[r * border + c];
            }
        }
        for (i, d) in damping.iter().enumerate() {
            l[i * n + i] += d;
        }
        self.weak = self
            .factor
            .factorize(|i| equations.diagonal(i), |i| damping_at(damping, i))
            .map_err(|i| breakdown(equations, damping, i))?;
        for (d, g) in step.iter_mut().zip(&equations.gradient) {
            *d = -g;
        }
        self.factor.solve(step);
        check_step(equations, damping, step)
    }

    fn unobserved_pivots(&self) -> usize {
        self.weak
    }

    fn name(&self) -> &'static str {
        "dense Cholesky"
    }
}

/// A dense Cholesky factor in a buffer of its own.
#[derive(Debug)]
pub(super) struct DenseFactor {
    side: usize,
    /// Column-major; the matrix before [`factorize`](Self::factorize), L in the lower triangle after it.
    values: Vec<f64>,
    memory: Scratch,
}

impl DenseFactor {
    pub(super) fn new(side: usize) -> Self {
        let scratch = cholesky_in_place_scratch::<f64>(side, Par::Seq, Default::default());
        Self { side, values: vec![0.0; side * side], memory: Scratch::new(scratch) }
    }

    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Takes matrices of another side, at most that it was made for.
    pub(super) fn set_side(&mut self, side: usize) {
        debug_assert!(side * side <= self.values.len(), "side {side}");
        self.side = side;
    }

    /// The buffer, column-major; fill its lower triangle.
    pub(super) fn matrix_mut(&mut self) -> &mut [f64] {
        &mut self.values[..self.side * self.side]
    }

    /// Factorises what is in the buffer. Returns the number of weak pivots, or the coordinate that broke it. `own` are the diagonal
    /// entries without damping.
    pub(super) fn factorize(
        &mut self,
        own: impl Fn(usize) -> f64,
        damping: impl Fn(usize) -> f64,
    ) -> Result<usize, usize> {
        let n = self.side;
        if n == 0 {
            return Ok(0);
        }
        cholesky_in_place(
            MatMut::from_column_major_slice_mut(&mut self.values[..n * n], n, n),
            LltRegularization::default(),
            Par::Seq,
            self.memory.stack(),
            Default::default(),
        )
        .map_err(|LltError::NonPositivePivot { index }| index)?;
        let mut weak = 0;
        for i in 0..n {
            let pivot = self.values[i * n + i].powi(2);
            if !pivot_is_sound(pivot, own(i), damping(i), &mut weak) {
                return Err(i);
            }
        }
        Ok(weak)
    }

    /// Solves `L L' x = b` in place.
    pub(super) fn solve(&self, x: &mut [f64]) {
        dense_cholesky_solve(&self.values, x);
    }
}
