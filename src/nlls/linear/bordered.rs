//! Sparse Cholesky of the blocks, and the Schur complement of the dense border by a forward solve only.
//!
//! ```text
//!        sparse blocks (n)       border (m)
//!      +---------------------+------------+
//!      | ##   #              |  ########  |
//!      |  ##    #            |  ########  |         H_gg = P' L L' P           sparse Cholesky
//!      | #  ##   #           |  ########  |         Z    = L^-1 P H_gw         forward solve, supernode by supernode
//!      |   #  ##             |  ########  |         z    = L^-1 P g_g          (one more column of Z)
//!      |     #  ##           |  ########  |         S    = H_ww - Z'Z          rank update, dense
//!      |        H_gg         |    H_gw    |         S d_w = -(g_w - Z'z)       dense Cholesky
//!      +---------------------+------------+         L' (P d_g) = -(z + Z d_w)  back substitution
//!      | #################   | ########   |
//!      | ###  H_gw'  #####   |   H_ww     |
//!      +---------------------+------------+
//! ```
//!
//! Why it holds: with `A = H_gg = P' L L' P`, eliminating `d_g` from the first row leaves `S = H_ww - H_gw' A^-1 H_gw`, and
//! `H_gw' A^-1 H_gw = (L^-1 P H_gw)' (L^-1 P H_gw) = Z'Z`: half of the triangular solves of `A^-1 H_gw` are never needed, and
//! S is symmetric by construction.
//!
//! Z is kept in column chunks of fixed width, each stored by rows. The chunks are solved independently (in parallel, when
//! there are threads), each in the same order of operations whatever the number of threads.

use std::ops::Range;
use std::sync::Arc;

use pulp::{Simd, WithSimd};

use super::dense::DenseFactor;
use super::front::ForwardTile;
use super::isotropic::Isotropic;
use super::supernodal::SupernodalFactor;
use super::vector::dot;
use super::{LinearError, LinearSolver, breakdown, check_step, damping_at, same_structure};
use crate::nlls::dense_kernels::{Gram, TILE_ROWS, dispatch, padded, sweep, vectorized};
use crate::nlls::parallel::for_each;
use crate::nlls::{BlockStructure, NormalEquations};

/// Widest chunk of columns of Z that is solved in one go: a multiple of the SIMD width, wide enough for the matrix products to
/// run at speed (56 beats 32 by a tenth on 400 blocks of six), narrow enough to give a border of a hundred to two threads.
const CHUNK: usize = 56;

/// Columns of Z from which on there are two chunks at least, for two threads.
const HALVED: usize = 32;

/// Sparse blocks eliminated first, then the border if there is one: see the head of the source file for the algebra. The order of
/// the blocks and the symbolic analysis are found once, the numeric factor at every solve, in buffers of its own.
///
/// Without a border, equations with the matrix and damping of the last ones, bit for bit, are solved with its factor: where residuals
/// are linear, or a model keeps its Hessian as the local/global steps of as-rigid-as-possible surfaces do, one factorisation
/// serves all steps.
///
/// Beside [`solve`](LinearSolver::solve) the two halves are public, for whoever wants to do something else with the border
/// (bounds on its parameters by a small quadratic program, covariances):
///
/// ```
/// # use std::sync::Arc;
/// # use nonrigid::nlls::{BlockStructure, NormalEquations, linear::BorderedCholesky};
/// # let structure = Arc::new(BlockStructure::new(&[1, 1], [(0, 1)], 1)?);
/// # let mut equations = NormalEquations::new(structure.clone());
/// # equations.blocks.copy_from_slice(&[2.0, 1.0, 2.0]);
/// # equations.cross.copy_from_slice(&[1.0, 0.0]);
/// # equations.border[0] = 4.0;
/// # equations.gradient.copy_from_slice(&[1.0, 2.0, 3.0]);
/// let mut solver = BorderedCholesky::new(&structure);
/// let reduced = solver.reduce(&equations, &[])?;
/// let mut step = [0.0; 3];
/// step[2] = (-reduced.gradient[0] / reduced.matrix[0]).max(-0.5); // any rule for the border's step
/// solver.back_substitute(&mut step);
/// # let residual = 2.0 * step[0] + step[1] + step[2] + 1.0;
/// # assert!(residual.abs() < 1e-14 && step[2] == -0.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct BorderedCholesky {
    structure: Arc<BlockStructure>,
    pub(super) factor: SupernodalFactor,
    /// Of the factor, for what is done while it factorises.
    position: Vec<usize>,
    chunks: Vec<Chunk>,
    pieces: Vec<Piece>,
    schur: Vec<f64>,
    reduced_gradient: Vec<f64>,
    schur_factor: DenseFactor,
    permuted: Vec<f64>,
    weak: usize,
    /// What the factor is of: blocks, then damping. Empty when there is none, or a border.
    factored: Vec<f64>,
    /// For equations that treat the three coordinates of their blocks alike, once there are any.
    isotropic: Option<Isotropic>,
}

/// The border's system after the sparse blocks are eliminated, `S d_w = -r`.
#[derive(Debug, Clone, Copy)]
pub struct ReducedSystem<'a> {
    /// `S = H_ww - Z'Z` with the border's damping on its diagonal, a full symmetric row-major square. Its inverse is, up to
    /// the residual variance, the covariance of the border's parameters.
    pub matrix: &'a [f64],
    /// `r = g_w - Z'z`.
    pub gradient: &'a [f64],
}

/// Some columns of `[Z z]`.
#[derive(Debug)]
struct Chunk {
    columns: Range<usize>,
    /// Row-major, permuted rows, padded.
    values: Vec<f64>,
}

/// Product of two chunks, `Z_a' Z_b` with a >= b, row-major, rows and columns padded.
#[derive(Debug)]
struct Piece {
    a: usize,
    b: usize,
    values: Vec<f64>,
}

impl BorderedCholesky {
    /// Analyses the structure. Equations of another structure are analysed when they come.
    #[must_use]
    pub fn new(structure: &Arc<BlockStructure>) -> Self {
        let factor = SupernodalFactor::analyse(structure);
        let (n, m) = (structure.sparse_dimension(), structure.border());
        let least = if m + 1 > HALVED { 2 } else { 1 };
        let width = padded((m + 1).div_ceil((m + 1).div_ceil(CHUNK).max(least)));
        let count = (m + 1).div_ceil(width);
        let chunks: Vec<Chunk> = (0..count)
            .map(|k| {
                let columns = k * width..((k + 1) * width).min(m + 1);
                Chunk { values: vec![0.0; n * padded(columns.len())], columns }
            })
            .collect();
        let width = |k: usize| padded(chunks[k].columns.len());
        let pieces = (0..count)
            .flat_map(|a| (0..=a).map(move |b| (a, b)))
            .map(|(a, b)| Piece { a, b, values: vec![0.0; width(a) * width(b)] })
            .collect();
        Self {
            structure: structure.clone(),
            position: factor.position().to_vec(),
            factor,
            chunks,
            pieces,
            schur: vec![0.0; m * m],
            reduced_gradient: vec![0.0; m],
            schur_factor: DenseFactor::new(m),
            permuted: vec![0.0; n],
            weak: 0,
            factored: Vec::with_capacity(if m == 0 { structure.value_count() + n } else { 0 }),
            isotropic: None,
        }
    }

    /// Numbers in the factor of the sparse blocks.
    #[must_use]
    pub fn factor_numbers(&self) -> usize {
        self.factor.len()
    }

    /// Analyses the structure, if it is another one.
    fn adopt(&mut self, structure: &Arc<BlockStructure>) {
        if !same_structure(structure, &self.structure) {
            *self = Self::new(structure);
        }
    }

    /// Solves equations without a border.
    fn solve_blocks(
        &mut self,
        equations: &NormalEquations,
        damping: &[f64],
        step: &mut [f64],
    ) -> Result<(), LinearError> {
        if Isotropic::fits(equations, damping) {
            let isotropic = self.isotropic.get_or_insert_with(|| Isotropic::new(equations.structure()));
            isotropic.solve(equations, damping, step)?;
            self.weak = isotropic.weak();
            return check_step(equations, damping, step);
        }
        let matrix = || equations.blocks.iter().chain(damping);
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        if self.factored.len() != matrix().count() || !self.factored.iter().zip(matrix()).all(same) {
            self.factored.clear();
            let weak = self.factor.factorize(equations, damping);
            self.weak = weak.map_err(|i| breakdown(equations, damping, i))?;
            self.factored.extend(matrix());
        }
        for (&p, g) in self.position.iter().zip(&equations.gradient) {
            self.permuted[p] = -g;
        }
        self.factor.forward::<1>(self.permuted.as_chunks_mut().0);
        self.factor.backward::<1>(self.permuted.as_chunks_mut().0);
        for (&p, d) in self.position.iter().zip(&mut *step) {
            *d = self.permuted[p];
        }
        check_step(equations, damping, step)
    }

    /// Eliminates the sparse blocks and returns the border's system.
    ///
    /// # Errors
    /// [`LinearError`] when the damped `H_gg` is not numerically positive definite, or not finite.
    pub fn reduce(&mut self, equations: &NormalEquations, damping: &[f64]) -> Result<ReducedSystem<'_>, LinearError> {
        self.adopt(equations.structure());
        self.factored.clear();
        let (n, m) = (self.structure.sparse_dimension(), self.structure.border());
        let Self { factor, chunks, position, .. } = self;
        let load = || chunks.iter_mut().for_each(|chunk| chunk.load(equations, position));
        let (weak, ()) = rayon::join(|| factor.factorize(equations, damping), load);
        self.weak = weak.map_err(|i| breakdown(equations, damping, i))?;

        let factor = &self.factor;
        for_each(&mut self.chunks, 1, &|_, chunk| chunk.forward(factor));
        let chunks = &self.chunks;
        for_each(&mut self.pieces, 1, &|_, piece| piece.multiply(&chunks[piece.a], &chunks[piece.b], n));

        for r in 0..m {
            for c in 0..=r {
                self.schur[r * m + c] = equations.border[r * m + c];
            }
            self.schur[r * m + r] += damping_at(damping, n + r);
        }
        self.reduced_gradient.copy_from_slice(&equations.gradient[n..]);
        for piece in &self.pieces {
            let (rows, columns) = (&self.chunks[piece.a].columns, &self.chunks[piece.b].columns);
            for (r, row) in rows.clone().zip(piece.values.chunks_exact(padded(columns.len()))) {
                for (c, v) in columns.clone().zip(row) {
                    if r == m && c < m {
                        self.reduced_gradient[c] -= v;
                    } else if r < m && c <= r {
                        self.schur[r * m + c] -= v;
                    }
                }
            }
        }
        for r in 0..m {
            for c in 0..r {
                self.schur[c * m + r] = self.schur[r * m + c];
            }
        }
        Ok(self.reduced())
    }

    /// The border's system as the last [`reduce`](Self::reduce) left it.
    #[must_use]
    pub fn reduced(&self) -> ReducedSystem<'_> {
        ReducedSystem { matrix: &self.schur, gradient: &self.reduced_gradient }
    }

    /// Completes a step whose border part is given: reads `d_w` from the end of `step`, writes `d_g` to its beginning. Uses
    /// the factor and the Z of the last [`reduce`](Self::reduce).
    pub fn back_substitute(&mut self, step: &mut [f64]) {
        let n = self.structure.sparse_dimension();
        let m = self.structure.border();
        let (d_g, d_w) = step.split_at_mut(n);
        self.permuted.fill(0.0);
        for chunk in &self.chunks {
            // The last column, z, has weight one.
            let mut weights = [0.0; CHUNK];
            for (k, c) in chunk.columns.clone().enumerate() {
                weights[k] = if c == m { 1.0 } else { d_w[c] };
            }
            let width = padded(chunk.columns.len());
            let permuted = &mut self.permuted;
            vectorized(
                #[inline(always)]
                || {
                    for (x, row) in permuted.iter_mut().zip(chunk.values.chunks_exact(width)) {
                        *x -= dot(row, &weights[..width]);
                    }
                },
            );
        }
        self.factor.backward::<1>(self.permuted.as_chunks_mut().0);
        for (&p, d) in self.position.iter().zip(d_g) {
            *d = self.permuted[p];
        }
    }
}

impl LinearSolver for BorderedCholesky {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        self.adopt(equations.structure());
        if self.structure.border() == 0 {
            return self.solve_blocks(equations, damping, step);
        }
        self.reduce(equations, damping)?;
        let (n, m) = (self.structure.sparse_dimension(), self.structure.border());
        // The square is symmetric, so row-major is column-major.
        self.schur_factor.matrix_mut().copy_from_slice(&self.schur);
        self.weak += self
            .schur_factor
            .factorize(|i| equations.diagonal(n + i), |i| damping_at(damping, n + i))
            .map_err(|i| breakdown(equations, damping, n + i))?;
        for i in 0..m {
            step[n + i] = -self.reduced_gradient[i];
        }
        self.schur_factor.solve(&mut step[n..]);
        self.back_substitute(step);
        check_step(equations, damping, step)
    }

    fn unobserved_pivots(&self) -> usize {
        self.weak
    }

    fn elimination(&mut self) -> Option<&mut BorderedCholesky> {
        Some(self)
    }

    fn name(&self) -> &'static str {
        if self.structure.border() == 0 { "sparse Cholesky" } else { "bordered Cholesky" }
    }
}

impl Chunk {
    /// Copies this chunk's columns of `P [H_gw g_g]`.
    fn load(&mut self, equations: &NormalEquations, position: &[usize]) {
        let m = equations.structure().border();
        let (count, width) = (self.columns.len(), padded(self.columns.len()));
        let from_cross = self.columns.start..self.columns.end.min(m);
        for (i, &p) in position.iter().enumerate() {
            let row = &mut self.values[p * width..(p + 1) * width];
            row[..from_cross.len()].copy_from_slice(&equations.cross[i * m..][from_cross.clone()]);
            if self.columns.end > m {
                row[count - 1] = equations.gradient[i];
            }
        }
    }

    /// Solves `L Z = Z` in place.
    fn forward(&mut self, factor: &SupernodalFactor) {
        dispatch(Forward { factor, pitch: padded(self.columns.len()), x: &mut self.values });
    }
}

struct Forward<'a> {
    factor: &'a SupernodalFactor,
    x: &'a mut [f64],
    pitch: usize,
}

impl WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { factor, x, pitch } = self;
        for k in 0..factor.supernode_count() {
            let node = factor.supernode(k);
            let mut tile = ForwardTile {
                columns: node.values,
                stride: node.stride,
                width: node.width,
                start: node.start,
                pattern: node.pattern,
                x: &mut *x,
                pitch,
            };
            sweep::<S, TILE_ROWS>(simd, pitch, &mut tile);
        }
    }
}

impl Piece {
    /// `values = Z_a' Z_b`; of a diagonal piece the lower triangle only.
    fn multiply(&mut self, a: &Chunk, b: &Chunk, n: usize) {
        self.values.fill(0.0);
        let [a_width, b_width] = [a, b].map(|chunk| padded(chunk.columns.len()));
        let (lower, out) = (self.a == self.b, &mut self.values[..]);
        dispatch(Gram { a: &a.values, b: &b.values, a_width, b_width, rows: n, lower, out });
    }
}
