//! Conjugate gradients on the bordered equations, preconditioned by their diagonal: for graphs too large to factor.
//!
//! ```text
//!          [ H_11               |      ]
//!          [      H_22          |      ]      every block on the diagonal of H and the border's square by its own Cholesky
//!      P = [           ...      |      ]      factor (block Jacobi); over the blocks a coarse level besides, in which aggregates
//!          [ -------------------+----- ]      of neighbours change alike, see `two_level.rs`
//!          [                    | H_ww ]
//! ```
//!
//! Nothing fills in, so memory is little more than that of the equations. The coarse level is what makes the method usable: what
//! block Jacobi alone leaves is smooth over the graph, and on a hybrid's it takes 116, 247, 609 and more than 1000 iterations to
//! 1e-8 with 200, 1000, 5000 and 20,000 nodes; with the coarse level, to 1e-6, 84, 99, 138 and 204 with 400, 1000, 5000, 20,000.
//!
//! Products are with the assembled H, not with `J' W J`. Take a node of a hybrid with K = 4 influences, one for each hundred
//! vertices: it meets 14 others, so a product reads 7 blocks twice and the diagonal's, 36 numbers each, and 6 rows of the m
//! shapes: `540 + 6 m` = 840 with 50 shapes. Its hundred vertices have a row of `6 K + m` numbers each in J if one residual is a
//! vertex (point-to-plane), and J is read twice: `200 (24 + m)` = 14,800, three times that for point-to-point. H is needed for its
//! diagonal in any case.
//!
//! Only the lower triangle of H is stored. A block row gathers its own blocks, and through an index made once those below the
//! diagonal in its column, transposed: every entry of the product is one sum in one order. Products with the border, `H_gw' x_g`,
//! are summed over parts of fixed size, then over the parts. So the bits are the same at any number of threads.

use std::ops::Range;
use std::sync::Arc;

use super::dense::DenseFactor;
use super::two_level::TwoLevel;
use super::vector::{axpy, dot};
use super::{LinearError, LinearSolver, Pcg, breakdown, cause, check_step, damping_at, same_structure};
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// [`LinearSolver::name`] of [`BlockJacobi`].
pub(in crate::nlls) const BLOCK_JACOBI: &str = "block-Jacobi conjugate gradients";

/// Block rows to a part: enough work for a thread to be worth asking, few enough to spread 400 nodes.
const PART: usize = 32;

/// Preconditioned conjugate gradients on blocks and border as they are: see the head of the source file.
///
/// The number of iterations grows as the regulariser that joins neighbours outweighs what holds each of them. Weak pivots are those
/// of each block with all others held, which the factorisations' count exceeds. A direction that only damping holds moves with its
/// neighbours, as far as the tolerance sees it.
///
/// It does not eliminate the blocks. A step that runs into a bound of the border, and the border's covariance, are therefore computed
/// by a [`BorderedCholesky`](super::BorderedCholesky) that the minimiser makes, with that one's memory and time on top: with 50,000
/// nodes and 50 shapes 2 GB. The minimiser makes it as soon as a problem has bounds; its memory is touched at the first such step.
#[derive(Debug)]
pub struct BlockJacobi {
    structure: Arc<BlockStructure>,
    below: Below,
    blocks: TwoLevel,
    border: DenseFactor,
    /// `H_gw' x_g` of each part.
    partial: Vec<f64>,
    right: Vec<f64>,
    pcg: Pcg,
    iterations: usize,
    weak: usize,
}

/// The stored blocks of each block column below the diagonal.
#[derive(Debug)]
struct Below {
    starts: Vec<usize>,
    /// Block row and slot, rows ascending.
    blocks: Vec<(usize, usize)>,
}

impl Below {
    fn new(s: &BlockStructure) -> Self {
        let n = s.block_count();
        let off_diagonal = || (0..n).flat_map(|i| s.row_slots(i).zip(s.row(i)).map(move |(slot, &j)| (i, j, slot)));
        let mut starts = vec![0; n + 1];
        off_diagonal().filter(|(i, j, _)| i != j).for_each(|(_, j, _)| starts[j + 1] += 1);
        for j in 0..n {
            starts[j + 1] += starts[j];
        }
        let (mut next, mut blocks) = (starts.clone(), vec![(0, 0); starts[n]]);
        for (i, j, slot) in off_diagonal().filter(|(i, j, _)| i != j) {
            blocks[next[j]] = (i, slot);
            next[j] += 1;
        }
        Self { starts, blocks }
    }

    fn of(&self, j: usize) -> &[(usize, usize)] {
        &self.blocks[self.starts[j]..self.starts[j + 1]]
    }
}

impl BlockJacobi {
    /// Residual to which the default solver goes, as a share of the first: see [`Pcg::tolerance`]. The step's energy is then minimal
    /// to about ten digits, more than the quadratic model is worth.
    pub const TOLERANCE: f64 = 1e-6;

    /// Iterations after which the default solver gives up.
    pub const MAX_ITERATIONS: usize = 10_000;

    /// Buffers and the gather index for a structure. Equations of another structure are analysed when they come.
    #[must_use]
    pub fn new(structure: &Arc<BlockStructure>) -> Self {
        let pcg = Pcg::default().with_tolerance(Self::TOLERANCE).with_max_iterations(Self::MAX_ITERATIONS);
        Self::with_pcg(structure, pcg)
    }

    /// The same with other settings of the conjugate gradients than the default ones.
    #[must_use]
    pub fn with_pcg(structure: &Arc<BlockStructure>, pcg: Pcg) -> Self {
        let s = structure;
        Self {
            structure: s.clone(),
            below: Below::new(s),
            blocks: TwoLevel::analyse(s),
            border: DenseFactor::new(s.border()),
            partial: vec![0.0; s.block_count().div_ceil(PART) * s.border()],
            right: vec![0.0; s.dimension()],
            pcg,
            iterations: 0,
            weak: 0,
        }
    }

    /// Factorises the diagonal. Returns the number of weak pivots, or the tangent coordinate that broke it.
    fn precondition(&mut self, h: &NormalEquations, damping: &[f64]) -> Result<usize, usize> {
        let (n, m) = (self.structure.sparse_dimension(), self.structure.border());
        let weak = self.blocks.factorize(h, damping)?;
        let square = self.border.matrix_mut();
        for r in 0..m {
            for c in 0..=r {
                square[c * m + r] = h.border[r * m + c];
            }
            square[r * (m + 1)] += damping_at(damping, n + r);
        }
        let damping = |k: usize| damping_at(damping, n + k);
        let border = self.border.factorize(|k| h.border[k * (m + 1)], damping);
        Ok(weak + border.map_err(|k| n + k)?)
    }
}

impl LinearSolver for BlockJacobi {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        if !same_structure(equations.structure(), &self.structure) {
            *self = Self::with_pcg(equations.structure(), std::mem::take(&mut self.pcg));
        }
        self.weak = self.precondition(equations, damping).map_err(|i| breakdown(equations, damping, i))?;
        self.right.iter_mut().zip(&equations.gradient).for_each(|(b, g)| *b = -g);
        let Self { structure: s, below, blocks, border, partial, right, pcg, .. } = self;
        let n = s.sparse_dimension();
        let multiply = |x: &[f64], out: &mut [f64]| {
            let (out_g, out_w) = out.split_at_mut(n);
            for_each_part(s, 0..s.block_count(), out_g, partial, &|rows, out, partial| {
                vectorized(
                    #[inline(always)]
                    || multiply_rows(equations, below, damping, rows.clone(), x, out, partial),
                );
            });
            multiply_border(equations, damping, &x[n..], partial, out_w);
        };
        let precondition = |r: &[f64], z: &mut [f64]| {
            let (z_g, z_w) = z.split_at_mut(n);
            blocks.apply(s, &r[..n], z_g);
            z_w.copy_from_slice(&r[n..]);
            border.solve(z_w);
        };
        let solved = pcg.solve(right, step, multiply, precondition);
        self.iterations = solved.map_err(|error| cause(equations, damping, error))?;
        check_step(equations, damping, step)
    }

    fn unobserved_pivots(&self) -> usize {
        self.weak
    }

    fn iterations(&self) -> Option<usize> {
        Some(self.iterations)
    }

    fn name(&self) -> &'static str {
        BLOCK_JACOBI
    }
}

/// Calls `work` for runs of up to [`PART`] block rows, in parallel and without allocating, with the run's share of `out` and its
/// slice of `partial`, one border for each part.
fn for_each_part(
    s: &BlockStructure,
    rows: Range<usize>,
    out: &mut [f64],
    partial: &mut [f64],
    work: &(impl Fn(Range<usize>, &mut [f64], &mut [f64]) + Sync),
) {
    let parts = rows.len().div_ceil(PART);
    if parts <= 1 {
        if !rows.is_empty() {
            work(rows, out, partial);
        }
        return;
    }
    let left = parts / 2;
    let middle = rows.start + left * PART;
    let (out_left, out_right) = out.split_at_mut(s.offset(middle) - s.offset(rows.start));
    let (partial_left, partial_right) = partial.split_at_mut(partial.len() / parts * left);
    rayon::join(
        || for_each_part(s, rows.start..middle, out_left, partial_left, work),
        || for_each_part(s, middle..rows.end, out_right, partial_right, work),
    );
}

/// `out = (H_gg + D) x_g + H_gw x_w` of some block rows, `partial = H_gw' x_g` of these.
#[inline(always)]
fn multiply_rows(
    h: &NormalEquations,
    below: &Below,
    damping: &[f64],
    rows: Range<usize>,
    x: &[f64],
    out: &mut [f64],
    partial: &mut [f64],
) {
    let s = h.structure();
    let (n, m) = (s.sparse_dimension(), s.border());
    let first = s.offset(rows.start);
    partial.fill(0.0);
    for i in rows {
        let own = s.offset(i)..s.offset(i + 1);
        let out = &mut out[own.start - first..own.end - first];
        for (a, out) in own.clone().zip(&mut *out) {
            *out = damping_at(damping, a) * x[a];
        }
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            let (block, x) = (&h.blocks[s.values(slot)], &x[s.offset(j)..s.offset(j + 1)]);
            match (s.size(i), s.size(j)) {
                (6, 6) => add_product::<6>(block, x, out),
                (12, 12) => add_product::<12>(block, x, out),
                (_, columns) => {
                    for (out, row) in out.iter_mut().zip(block.chunks_exact(columns)) {
                        *out += dot(row, x);
                    }
                }
            }
        }
        for &(j, slot) in below.of(i) {
            let (block, x) = (&h.blocks[s.values(slot)], &x[s.offset(j)..s.offset(j + 1)]);
            match (s.size(j), s.size(i)) {
                (6, 6) => add_transposed::<6>(block, x, out),
                (12, 12) => add_transposed::<12>(block, x, out),
                (_, columns) => {
                    for (x, row) in x.iter().zip(block.chunks_exact(columns)) {
                        axpy(*x, row, out);
                    }
                }
            }
        }
        if m > 0 {
            for ((a, out), row) in own.clone().zip(out).zip(h.cross[own.start * m..own.end * m].chunks_exact(m)) {
                *out += dot(row, &x[n..]);
                axpy(x[a], row, partial);
            }
        }
    }
}

/// `out += A x`, A row-major of side N.
#[inline(always)]
fn add_product<const N: usize>(block: &[f64], x: &[f64], out: &mut [f64]) {
    let x: &[f64; N] = x.try_into().expect("proven: matched sizes");
    for (out, row) in out.iter_mut().zip(block.chunks_exact(N)) {
        let mut sums = [0.0; 2];
        for k in 0..N {
            sums[k % 2] = row[k].mul_add(x[k], sums[k % 2]);
        }
        *out += sums[0] + sums[1];
    }
}

/// `out += A' x`, A row-major of side N.
#[inline(always)]
fn add_transposed<const N: usize>(block: &[f64], x: &[f64], out: &mut [f64]) {
    let out: &mut [f64; N] = out.try_into().expect("proven: matched sizes");
    let mut sum = *out;
    for (x, row) in x.iter().zip(block.chunks_exact(N)) {
        for k in 0..N {
            sum[k] = x.mul_add(row[k], sum[k]);
        }
    }
    *out = sum;
}

/// `out = (H_ww + D) x_w + sum of the parts' H_gw' x_g`.
fn multiply_border(h: &NormalEquations, damping: &[f64], x: &[f64], partial: &[f64], out: &mut [f64]) {
    let (n, m) = (h.structure().sparse_dimension(), h.structure().border());
    for (k, (out, x)) in out.iter_mut().zip(x).enumerate() {
        *out = damping_at(damping, n + k) * x;
    }
    // The lower triangle and, off the diagonal, its transpose.
    for r in 0..m {
        let row = &h.border[r * m..=r * m + r];
        out[r] += dot(row, &x[..=r]);
        axpy(x[r], &row[..r], &mut out[..r]);
    }
    for part in partial.chunks_exact(m.max(1)) {
        axpy(1.0, part, out);
    }
}
