//! Conjugate gradients for blocks that x, y and z share, preconditioned by a sparse Cholesky that decouples the coordinates.
//!
//! ```text
//!          x    y    z                                    order the unknowns by coordinate:
//!       [ Hxx  Hxy  Hxz ]            [ P        ]
//!   H = [ Hyx  Hyy  Hyz ]    P(x)I = [    P     ]         P = (Hxx + Hyy + Hzz) / 3,   P = L L'
//!       [ Hzx  Hzy  Hzz ]            [        P ]
//! ```
//!
//! A regulariser that treats the coordinates alike, and data that weigh all directions alike (point-to-point, landmarks), give
//! `H = P (x) I` exactly: then conjugate gradients end after one iteration, and this is the direct solve at the price of a third
//! of the unknowns. Data that see one direction only (point-to-plane) make H differ from it by a factor that is bounded: P is
//! positive definite with H, as a mean of principal submatrices, and `H <= 9 P (x) I`.
//!
//! Why not factorise H: with blocks of `3 k`, the fill of its Cholesky factor has 9 times the entries of L and takes 27 times
//! the arithmetic.

use std::sync::Arc;

use super::sparse::{fill_flattened, flatten};
use super::supernodal::SupernodalFactor;
use super::{LinearError, LinearSolver, Pcg, breakdown, check_step, damping_at, first_non_finite, same_structure};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::linear::Coordinate;
use crate::nlls::{BlockStructure, NormalEquations};

/// One unknown of P with its values for x, y and z; the fourth is padding for SIMD, and zero.
type Lanes = [f64; 4];

/// Conjugate gradients on equations [split by coordinate](BlockStructure::split_by_coordinate): see the head of the source file
/// for the algebra. The ordering and symbolic analysis of P are made once, its numeric factor at every solve.
///
/// Equations that are not split, and a border (as one last block), are taken as one coordinate: P is then H itself.
#[derive(Debug)]
pub struct DecoupledCg {
    structure: Arc<BlockStructure>,
    /// The equations with the border moved into a last block, if there is a border.
    flattened: Option<NormalEquations>,
    /// P without damping.
    mean: NormalEquations,
    /// Mean over the coordinates of the damping.
    mean_damping: Vec<f64>,
    /// Per slot: whether the block of H is not `P (x) I`.
    coupled: Vec<bool>,
    factor: SupernodalFactor,
    right: Vec<Lanes>,
    solution: Vec<Lanes>,
    damping: Vec<Lanes>,
    permuted: Vec<Lanes>,
    gathered: Vec<Lanes>,
    pcg: Pcg,
    iterations: usize,
    weak: usize,
}

impl DecoupledCg {
    /// Analyses the structure. Equations of another structure are analysed when they come.
    #[must_use]
    pub fn new(structure: &Arc<BlockStructure>) -> Self {
        Self::with_pcg(structure, Pcg::default())
    }

    /// The same with other settings of the conjugate gradients than the default ones.
    #[must_use]
    pub fn with_pcg(structure: &Arc<BlockStructure>, pcg: Pcg) -> Self {
        let flattened = (structure.border() > 0).then(|| NormalEquations::new(Arc::new(flatten(structure))));
        let s = flattened.as_ref().map_or(structure, NormalEquations::structure).clone();
        let sizes: Vec<usize> = (0..s.block_count()).map(|i| s.size(i) / s.coordinates()).collect();
        let pairs = (0..s.block_count()).flat_map(|i| s.row(i).iter().map(move |&j| (i, j)));
        let thin = BlockStructure::new(&sizes, pairs, 0).expect("proven: the pairs are those of another structure");
        let mean = NormalEquations::new(Arc::new(thin));
        let factor = SupernodalFactor::analyse(mean.structure());
        let n = mean.structure().dimension();
        Self {
            structure: structure.clone(),
            flattened,
            mean_damping: vec![0.0; n],
            coupled: vec![false; s.slot_count()],
            right: vec![[0.0; 4]; n],
            solution: vec![[0.0; 4]; n],
            damping: vec![[0.0; 4]; n],
            permuted: vec![[0.0; 4]; n],
            gathered: vec![[0.0; 4]; factor.longest_pattern()],
            factor,
            mean,
            pcg,
            iterations: 0,
            weak: 0,
        }
    }

    /// Iterations of the last solve.
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.iterations
    }
}

impl LinearSolver for DecoupledCg {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        if !same_structure(equations.structure(), &self.structure) {
            *self = Self::with_pcg(equations.structure(), std::mem::take(&mut self.pcg));
        }
        if let Some(flattened) = &mut self.flattened {
            fill_flattened(equations, flattened);
        }
        let h = self.flattened.as_ref().unwrap_or(equations);
        let s = h.structure();
        split(h, &mut self.mean, &mut self.coupled);
        to_lanes(s, |i| -equations.gradient[i], &mut self.right);
        to_lanes(s, |i| damping_at(damping, i), &mut self.damping);
        let count = s.coordinates();
        for (mean, lanes) in self.mean_damping.iter_mut().zip(&self.damping) {
            *mean = mean_of(|c| lanes[c], count);
        }
        let weak = self.factor.factorize(&self.mean, &self.mean_damping);
        self.weak = count * weak.map_err(|i| breakdown(equations, damping, coordinate(s, self.mean.structure(), i)))?;

        let (factor, permuted, gathered) = (&self.factor, &mut self.permuted, &mut self.gathered);
        let (mean, coupled, lanes_damping) = (&self.mean, &self.coupled, &self.damping);
        let apply = |p: &[f64], out: &mut [f64]| {
            let (p, out) = (p.as_chunks().0, out.as_chunks_mut().0);
            vectorized(
                #[inline(always)]
                || multiply(h, mean, coupled, lanes_damping, p, out),
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
        self.iterations = self.pcg.solve(right, solution, apply, precondition).map_err(|error| {
            let not_finite = first_non_finite(equations, damping);
            not_finite.map_or(error, |i| LinearError::NonFinite { at: Coordinate::of(equations.structure(), i) })
        })?;
        from_lanes(s, &self.solution, step);
        check_step(equations, damping, step)
    }

    fn weak_pivots(&self) -> usize {
        self.weak
    }

    fn name(&self) -> &'static str {
        "decoupled conjugate gradients"
    }
}

/// Mean of `value(0..count)`, exact where all are equal.
#[inline(always)]
fn mean_of(value: impl Fn(usize) -> f64, count: usize) -> f64 {
    let first = value(0);
    first + (1..count).map(|c| value(c) - first).sum::<f64>() / count as f64
}

/// Fills P, and finds the blocks of H that differ from `P (x) I`.
fn split(h: &NormalEquations, mean: &mut NormalEquations, coupled: &mut [bool]) {
    let s = h.structure().clone();
    let count = s.coordinates();
    let thin = mean.structure().clone();
    for i in 0..s.block_count() {
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            let (block, columns) = (&h.blocks[s.values(slot)], s.size(j));
            let (rows, thin_columns) = (thin.size(i), thin.size(j));
            let out = &mut mean.blocks[thin.values(slot)];
            for a in 0..rows {
                for b in 0..thin_columns {
                    let same = |c: usize| block[(c * rows + a) * columns + c * thin_columns + b];
                    out[a * thin_columns + b] = mean_of(same, count);
                }
            }
            let expected = |r: usize, c: usize| {
                let same = r / rows == c / thin_columns;
                if same { out[(r % rows) * thin_columns + c % thin_columns] } else { 0.0 }
            };
            coupled[slot] = block
                .chunks_exact(columns)
                .enumerate()
                .any(|(r, row)| row.iter().enumerate().any(|(c, v)| *v != expected(r, c)));
        }
    }
}

/// `out = (H + diag(damping)) x`.
#[inline(always)]
fn multiply(
    h: &NormalEquations,
    mean: &NormalEquations,
    coupled: &[bool],
    damping: &[Lanes],
    x: &[Lanes],
    out: &mut [Lanes],
) {
    let (s, thin) = (h.structure(), mean.structure());
    for ((out, d), x) in out.iter_mut().zip(damping).zip(x) {
        *out = std::array::from_fn(|n| d[n] * x[n]);
    }
    for i in 0..s.block_count() {
        let (row, rows) = (thin.offset(i), thin.size(i));
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            let (column, columns) = (thin.offset(j), thin.size(j));
            if coupled[slot] {
                let block = &h.blocks[s.values(slot)];
                for (r, values) in block.chunks_exact(s.size(j)).enumerate() {
                    let (c, a) = (r / rows, row + r % rows);
                    for (k, v) in values.iter().enumerate() {
                        let (d, b) = (k / columns, column + k % columns);
                        out[a][c] += v * x[b][d];
                        if i != j {
                            out[b][d] += v * x[a][c];
                        }
                    }
                }
            } else {
                let block = &mean.blocks[thin.values(slot)];
                for (a, values) in block.chunks_exact(columns).enumerate() {
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

/// The tangent coordinate of H (its first coordinate of space) that unknown `i` of P stands for.
fn coordinate(s: &BlockStructure, thin: &BlockStructure, i: usize) -> usize {
    match Coordinate::of(thin, i) {
        Coordinate::Block { block, component } => s.offset(block) + component,
        Coordinate::Border { index } => s.sparse_dimension() + index,
    }
}
