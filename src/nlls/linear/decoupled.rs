//! Solves `(P (x) I + D) x = b`: equations that treat the coordinates of space alike, up to a diagonal D.
//!
//! ```text
//!          x    y    z                                    unknowns ordered by coordinate
//!       [ P              ]
//!   H = [      P         ] + D          preconditioner (P + mean over the coordinates of D) (x) I = L L' (x) I
//!       [           P    ]
//! ```
//!
//! Without damping, or with the same in all coordinates, one iteration of conjugate gradients solves it: this is the direct
//! solve with a ninth of the factor's entries and a twenty-seventh of the arithmetic that H taken as a whole would cost.

use std::sync::Arc;

use super::supernodal::SupernodalFactor;
use super::{LinearError, Pcg, damping_at};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// One unknown of P with its values for x, y and z; the fourth is padding for SIMD, and zero.
type Lanes = [f64; 4];

/// Factor of P and vectors.
#[derive(Debug)]
pub(super) struct Decoupled {
    factor: SupernodalFactor,
    /// Mean over the coordinates of the damping.
    mean_damping: Vec<f64>,
    right: Vec<Lanes>,
    solution: Vec<Lanes>,
    damping: Vec<Lanes>,
    permuted: Vec<Lanes>,
    gathered: Vec<Lanes>,
}

impl Decoupled {
    /// Analyses the structure of P.
    pub(super) fn analyse(thin: &Arc<BlockStructure>) -> Self {
        let factor = SupernodalFactor::analyse(thin);
        let n = thin.dimension();
        Self {
            mean_damping: vec![0.0; n],
            right: vec![[0.0; 4]; n],
            solution: vec![[0.0; 4]; n],
            damping: vec![[0.0; 4]; n],
            permuted: vec![[0.0; 4]; n],
            gathered: vec![[0.0; 4]; factor.longest_pattern()],
            factor,
        }
    }

    /// Factorises `p` with the mean damping. Returns the number of weak pivots, or the unknown of P that broke it.
    pub(super) fn factorize(
        &mut self,
        s: &BlockStructure,
        p: &NormalEquations,
        damping: &[f64],
    ) -> Result<usize, usize> {
        to_lanes(s, |i| damping_at(damping, i), &mut self.damping);
        for (mean, lanes) in self.mean_damping.iter_mut().zip(&self.damping) {
            *mean = mean_of(|c| lanes[c], s.coordinates());
        }
        Ok(s.coordinates() * self.factor.factorize(p, &self.mean_damping)?)
    }

    /// Solves for the right-hand side `-gradient`; returns the number of iterations.
    pub(super) fn solve(
        &mut self,
        s: &BlockStructure,
        p: &NormalEquations,
        gradient: &[f64],
        pcg: &mut Pcg,
        step: &mut [f64],
    ) -> Result<usize, LinearError> {
        to_lanes(s, |i| -gradient[i], &mut self.right);
        let (factor, permuted, gathered) = (&self.factor, &mut self.permuted, &mut self.gathered);
        let damping = &self.damping;
        let apply = |x: &[f64], out: &mut [f64]| {
            vectorized(
                #[inline(always)]
                || multiply(p, damping, x.as_chunks().0, out.as_chunks_mut().0),
            );
        };
        let precondition = |r: &[f64], out: &mut [f64]| {
            let (r, out): (&[Lanes], &mut [Lanes]) = (r.as_chunks().0, out.as_chunks_mut().0);
            for (&p, r) in factor.position().iter().zip(r) {
                permuted[p] = *r;
            }
            vectorized(
                #[inline(always)]
                || factor.solve_lanes(permuted, gathered),
            );
            for (&p, out) in factor.position().iter().zip(out) {
                *out = permuted[p];
            }
        };
        let (right, solution) = (self.right.as_flattened(), self.solution.as_flattened_mut());
        let iterations = pcg.solve(right, solution, apply, precondition)?;
        from_lanes(s, &self.solution, step);
        Ok(iterations)
    }
}

/// Mean of `value(0..count)`, exact where all are equal.
#[inline(always)]
pub(super) fn mean_of(value: impl Fn(usize) -> f64, count: usize) -> f64 {
    let first = value(0);
    first + (1..count).map(|c| value(c) - first).sum::<f64>() / count as f64
}

/// `out = (P (x) I + diag(damping)) x`.
#[inline(always)]
fn multiply(p: &NormalEquations, damping: &[Lanes], x: &[Lanes], out: &mut [Lanes]) {
    let s = p.structure();
    for ((out, d), x) in out.iter_mut().zip(damping).zip(x) {
        *out = std::array::from_fn(|n| d[n] * x[n]);
    }
    for i in 0..s.block_count() {
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            let (row, column) = (s.offset(i), s.offset(j));
            for (a, values) in p.blocks[s.values(slot)].chunks_exact(s.size(j)).enumerate() {
                for (b, v) in values.iter().enumerate() {
                    for n in 0..4 {
                        out[row + a][n] += v * x[column + b][n];
                    }
                    if i != j {
                        for n in 0..4 {
                            out[column + b][n] += v * x[row + a][n];
                        }
                    }
                }
            }
        }
    }
}

/// Gathers tangent coordinates into lanes.
fn to_lanes(s: &BlockStructure, value: impl Fn(usize) -> f64, out: &mut [Lanes]) {
    let count = s.coordinates();
    for i in 0..s.block_count() {
        let rows = s.size(i) / count;
        for (a, lanes) in out[s.offset(i) / count..][..rows].iter_mut().enumerate() {
            (0..count).for_each(|c| lanes[c] = value(s.offset(i) + c * rows + a));
        }
    }
}

/// Scatters lanes to tangent coordinates.
fn from_lanes(s: &BlockStructure, lanes: &[Lanes], out: &mut [f64]) {
    let count = s.coordinates();
    for i in 0..s.block_count() {
        let rows = s.size(i) / count;
        for (a, lanes) in lanes[s.offset(i) / count..][..rows].iter().enumerate() {
            (0..count).for_each(|c| out[s.offset(i) + c * rows + a] = lanes[c]);
        }
    }
}
