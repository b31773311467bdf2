//! Conjugate gradients for blocks that x, y and z share evenly, preconditioned by what the equations turn out to be.
//!
//! ```text
//!          x    y    z
//!       [ Hxx  Hxy  Hxz ]          data that weigh all directions alike (point-to-point, landmarks) and a regulariser
//!   H = [ Hyx  Hyy  Hyz ]          that treats the coordinates alike: H = P (x) I exactly
//!       [ Hzx  Hzy  Hzz ]          data that see some directions only (point-to-plane): H couples the coordinates
//! ```
//!
//! In the first case a sparse Cholesky factor of P, a third of the size, makes one iteration the exact solve. In the second P
//! is a poor guide, since it spreads over all directions what the data say of one: the iterations grow without bound as the
//! regulariser fades (50 for a stiff face, 600 for a soft one). There the preconditioner has two levels, the diagonal blocks and a
//! coarse problem of aggregates, and needs about 50 iterations whatever the stiffness.
//!
//! Why not factorise H: with blocks of `3 k`, its Cholesky factor has 9 times the entries of that of P and takes 27 times the
//! arithmetic.

use std::sync::Arc;

use super::decoupled::{Decoupled, mean_of};
use super::sparse::{fill_flattened, flatten};
use super::two_level::TwoLevel;
use super::{Coordinate, LinearError, LinearSolver, Pcg, breakdown, cause, check_step, damping_at, same_structure};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// Conjugate gradients on equations [split by coordinate](BlockStructure::split_by_coordinate): see the head of the source file.
/// Orderings and symbolic analyses are made once, when equations first need them.
///
/// Equations that are not split, and a border (as one last block), are taken as one coordinate: P is then H itself.
#[derive(Debug)]
pub struct SplitCg {
    structure: Arc<BlockStructure>,
    /// The equations with the border moved into a last block, if there is a border.
    flattened: Option<NormalEquations>,
    /// P, the mean of the coordinates' own parts of H, without damping.
    mean: NormalEquations,
    /// Per slot: whether the block of H is not `P (x) I`.
    coupled: Vec<bool>,
    decoupled: Option<Decoupled>,
    two_level: Option<TwoLevel>,
    right: Vec<f64>,
    pcg: Pcg,
    iterations: usize,
    weak: usize,
}

impl SplitCg {
    /// Buffers for a structure. Equations of another structure are analysed when they come.
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
        Self {
            structure: structure.clone(),
            flattened,
            mean: NormalEquations::new(Arc::new(thin)),
            coupled: vec![false; s.slot_count()],
            decoupled: None,
            two_level: None,
            right: vec![0.0; s.dimension()],
            pcg,
            iterations: 0,
            weak: 0,
        }
    }
}

impl LinearSolver for SplitCg {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        if !same_structure(equations.structure(), &self.structure) {
            *self = Self::with_pcg(equations.structure(), std::mem::take(&mut self.pcg));
        }
        if let Some(flattened) = &mut self.flattened {
            fill_flattened(equations, flattened);
        }
        let h = self.flattened.as_ref().unwrap_or(equations);
        let s = h.structure();
        let broken = |i: usize| breakdown(equations, damping, i);
        let pcg = &mut self.pcg;
        let solved = if split(h, &mut self.mean, &mut self.coupled) {
            let two_level = self.two_level.get_or_insert_with(|| TwoLevel::analyse(s));
            self.weak = two_level.factorize(h, damping).map_err(broken)?;
            self.right.iter_mut().zip(&equations.gradient).for_each(|(b, g)| *b = -g);
            let (mean, coupled) = (&self.mean, &self.coupled);
            let apply = |x: &[f64], out: &mut [f64]| {
                vectorized(
                    #[inline(always)]
                    || multiply(h, mean, coupled, damping, x, out),
                );
            };
            pcg.solve(&self.right, step, apply, |r, z| two_level.apply(s, r, z))
        } else {
            let thin = self.mean.structure();
            let decoupled = self.decoupled.get_or_insert_with(|| Decoupled::analyse(thin));
            let weak = decoupled.factorize(s, &self.mean, damping);
            self.weak = weak.map_err(|i| broken(first_coordinate(s, thin, i)))?;
            decoupled.solve(s, &self.mean, &equations.gradient, pcg, step)
        };
        self.iterations = solved.map_err(|error| cause(equations, damping, error))?;
        check_step(equations, damping, step)
    }

    fn weak_pivots(&self) -> usize {
        self.weak
    }

    fn iterations(&self) -> Option<usize> {
        Some(self.iterations)
    }

    fn name(&self) -> &'static str {
        "conjugate gradients"
    }
}

/// The tangent coordinate of H, in its first coordinate of space, that unknown `i` of P stands for.
fn first_coordinate(s: &BlockStructure, thin: &BlockStructure, i: usize) -> usize {
    match Coordinate::of(thin, i) {
        Coordinate::Block { block, component } => s.offset(block) + component,
        Coordinate::Border { index } => s.sparse_dimension() + index,
    }
}

/// Fills P, finds the blocks of H that differ from `P (x) I`, and says whether there are any.
fn split(h: &NormalEquations, mean: &mut NormalEquations, coupled: &mut [bool]) -> bool {
    let s = h.structure();
    let count = s.coordinates();
    let thin = mean.structure().clone();
    for i in 0..s.block_count() {
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            let (block, columns) = (&h.blocks[s.values(slot)], s.size(j));
            let (rows, thin_columns) = (thin.size(i), thin.size(j));
            let out = &mut mean.blocks[thin.values(slot)];
            for a in 0..rows {
                for b in 0..thin_columns {
                    let own = |c: usize| block[(c * rows + a) * columns + c * thin_columns + b];
                    out[a * thin_columns + b] = mean_of(own, count);
                }
            }
            coupled[slot] = block.chunks_exact(columns).enumerate().any(|(r, row)| {
                let expected = &out[(r % rows) * thin_columns..][..thin_columns];
                row.chunks_exact(thin_columns).enumerate().any(|(c, values)| {
                    if c == r / rows { values != expected } else { values.iter().any(|v| *v != 0.0) }
                })
            });
        }
    }
    coupled.contains(&true)
}

/// `out = (H + diag(damping)) x`.
#[inline(always)]
fn multiply(
    h: &NormalEquations,
    mean: &NormalEquations,
    coupled: &[bool],
    damping: &[f64],
    x: &[f64],
    out: &mut [f64],
) {
    let (s, thin) = (h.structure(), mean.structure());
    for (i, (out, x)) in out.iter_mut().zip(x).enumerate() {
        *out = damping_at(damping, i) * x;
    }
    for i in 0..s.block_count() {
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            if coupled[slot] {
                add_products(&h.blocks[s.values(slot)], s.offset(i), s.offset(j), s.size(j), x, out);
            } else {
                let (rows, columns) = (thin.size(i), thin.size(j));
                for c in 0..s.coordinates() {
                    let (row, column) = (s.offset(i) + c * rows, s.offset(j) + c * columns);
                    add_products(&mean.blocks[thin.values(slot)], row, column, columns, x, out);
                }
            }
        }
    }
}

/// Adds what the block at (`row`, `column`) and, off the diagonal, its transpose make of `x`.
#[inline(always)]
fn add_products(block: &[f64], row: usize, column: usize, columns: usize, x: &[f64], out: &mut [f64]) {
    for (a, values) in block.chunks_exact(columns).enumerate() {
        let across = &x[column..column + columns];
        out[row + a] += values.iter().zip(across).map(|(v, x)| v * x).sum::<f64>();
        if row != column {
            let x = x[row + a];
            out[column..column + columns].iter_mut().zip(values).for_each(|(out, v)| *out += v * x);
        }
    }
}
