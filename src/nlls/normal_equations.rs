//! The bordered normal equations `H d = -g` of one Gauss-Newton step.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use nalgebra_sparse::{CooMatrix, CscMatrix};

use super::BlockStructure;
use super::linear::{Coordinate, dot};

/// Gradient and Gauss-Newton Hessian of **half** the energy, `E / 2`:
///
/// ```text
///     g = J' W r        H = J' W J        W = diag(alpha rho'(|r|^2))
///
///     [ H_gg   H_gw ] [ d_g ]     [ g_g ]
///     [ H_gw'  H_ww ] [ d_w ] = - [ g_w ]
/// ```
///
/// All buffers are allocated once, by [`new`](Self::new), and refilled by every linearisation.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    structure: Arc<BlockStructure>,
    /// Lower triangle of `H_gg`: dense row-major blocks at [`BlockStructure::values`].
    pub blocks: Vec<f64>,
    /// `H_gw`, row-major, [`BlockStructure::sparse_dimension`] rows of [`BlockStructure::border`] columns.
    pub cross: Vec<f64>,
    /// `H_ww`, a full symmetric square of side [`BlockStructure::border`]; only its lower triangle (row >= column, row-major) is read.
    pub border: Vec<f64>,
    /// `g`, sparse coordinates first, then the border.
    pub gradient: Vec<f64>,
}

/// One block row of the equations, borrowed for writing: disjoint from all others, so rows can be filled in parallel.
#[derive(Debug)]
pub struct BlockRow<'a> {
    /// Values of the row's blocks, in the order of [`BlockStructure::row`].
    pub blocks: &'a mut [f64],
    /// The row's part of `H_gw`, row-major.
    pub cross: &'a mut [f64],
    /// The row's part of the gradient.
    pub gradient: &'a mut [f64],
}

impl NormalEquations {
    /// Zero equations of the given structure.
    #[must_use]
    pub fn new(structure: Arc<BlockStructure>) -> Self {
        let (sparse, border) = (structure.sparse_dimension(), structure.border());
        Self {
            blocks: vec![0.0; structure.value_count()],
            cross: vec![0.0; sparse * border],
            border: vec![0.0; border * border],
            gradient: vec![0.0; sparse + border],
            structure,
        }
    }

    /// The sparsity pattern.
    #[must_use]
    pub fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    /// Sets every value to zero.
    pub fn clear(&mut self) {
        self.blocks.fill(0.0);
        self.cross.fill(0.0);
        self.border.fill(0.0);
        self.gradient.fill(0.0);
    }

    /// Values of one stored block, row-major.
    pub fn block_mut(&mut self, slot: usize) -> &mut [f64] {
        &mut self.blocks[self.structure.values(slot)]
    }

    /// Diagonal entry `i` of `H`, tangent coordinates numbered as in the gradient.
    ///
    /// # Panics
    /// If `i` is not less than [`BlockStructure::dimension`].
    #[must_use]
    pub fn diagonal(&self, i: usize) -> f64 {
        let s = &self.structure;
        match Coordinate::of(s, i) {
            Coordinate::Border { index } => self.border[index * (s.border() + 1)],
            // The diagonal block is the last of its row.
            Coordinate::Block { block, component } => {
                self.blocks[s.values(s.row_slots(block).end - 1)][component * (s.size(block) + 1)]
            }
        }
    }

    /// Writes the diagonal of `H` to `out`, [`BlockStructure::dimension`] values.
    pub fn copy_diagonal(&self, out: &mut [f64]) {
        let s = &self.structure;
        let (sparse, border) = out.split_at_mut(s.sparse_dimension());
        for i in 0..s.block_count() {
            let block = &self.blocks[s.values(s.row_slots(i).end - 1)];
            for a in 0..s.size(i) {
                sparse[s.offset(i) + a] = block[a * (s.size(i) + 1)];
            }
        }
        for (r, d) in border.iter_mut().enumerate() {
            *d = self.border[r * (s.border() + 1)];
        }
    }

    /// The curvature `d' H d` along a tangent direction, summed in a fixed order.
    #[must_use]
    pub fn quadratic_form(&self, d: &[f64]) -> f64 {
        let s = &self.structure;
        let (d_g, d_w) = d.split_at(s.sparse_dimension());
        let m = s.border();
        let mut sum = 0.0;
        for i in 0..s.block_count() {
            let d_i = &d_g[s.offset(i)..s.offset(i) + s.size(i)];
            for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
                let d_j = &d_g[s.offset(j)..s.offset(j) + s.size(j)];
                let block = &self.blocks[s.values(slot)];
                // Points in space have many small blocks, for which a call each is too much.
                let product = if let ([_, _, _], [_, _, _]) = (d_i, d_j) {
                    let [left, right] = [d_i, d_j].map(Vector3::from_column_slice);
                    left.dot(&(Matrix3::from_row_slice(block) * right))
                } else {
                    d_i.iter().zip(block.chunks_exact(s.size(j))).map(|(x, row)| x * dot(row, d_j)).sum()
                };
                sum += if i == j { product } else { 2.0 * product };
            }
            if m > 0 {
                for (x, row) in d_i.iter().zip(self.cross[s.offset(i) * m..].chunks_exact(m)) {
                    sum += 2.0 * x * dot(row, d_w);
                }
            }
        }
        for r in 0..m {
            let row = &self.border[r * m..(r + 1) * m];
            sum += d_w[r] * (2.0 * dot(&row[..r], &d_w[..r]) + row[r] * d_w[r]);
        }
        sum
    }

    /// Calls `fill(i, row)` for every block row, in parallel and without allocating. Each row is written by one call only,
    /// so the result does not depend on the number of threads.
    pub fn for_each_block_row(&mut self, fill: &(impl Fn(usize, BlockRow<'_>) + Sync)) {
        let n = self.structure.block_count();
        let sparse = self.structure.sparse_dimension();
        let rows =
            BlockRow { blocks: &mut self.blocks, cross: &mut self.cross, gradient: &mut self.gradient[..sparse] };
        split_rows(&self.structure, 0..n, rows, fill);
    }

    /// `H` as a dense symmetric matrix, for tests and diagnostics.
    #[must_use]
    pub fn to_dense(&self) -> nalgebra::DMatrix<f64> {
        let n = self.structure.dimension();
        let mut h = nalgebra::DMatrix::zeros(n, n);
        self.for_each_lower(|r, c, v| {
            h[(r, c)] = v;
            h[(c, r)] = v;
        });
        h
    }

    /// `H` as a sparse symmetric matrix, both triangles, rows and columns numbered as the gradient, for other solvers: what is stored
    /// is an entry, zeros included.
    ///
    /// ```
    /// # use std::sync::Arc;
    /// # use nonrigid::nlls::{BlockStructure, NormalEquations};
    /// # let mut equations = NormalEquations::new(Arc::new(BlockStructure::new(&[1, 1], [(0, 1)], 1)?));
    /// # equations.blocks.copy_from_slice(&[2.0, 1.0, 2.0]);
    /// # equations.border[0] = 4.0;
    /// # equations.gradient.copy_from_slice(&[3.0, 3.0, 4.0]);
    /// let cholesky = nalgebra_sparse::factorization::CscCholesky::factor(&equations.to_csc())?;
    /// let step = cholesky.solve(&-nalgebra::DVector::from_column_slice(&equations.gradient));
    /// assert!((step.add_scalar(1.0)).amax() < 1e-15);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn to_csc(&self) -> CscMatrix<f64> {
        let n = self.structure.dimension();
        let mut h = CooMatrix::new(n, n);
        self.for_each_lower(|r, c, v| {
            h.push(r, c, v);
            if r != c {
                h.push(c, r, v);
            }
        });
        CscMatrix::from(&h)
    }

    /// Calls `entry(row, column, value)` once for each stored entry of the lower triangle of `H`.
    fn for_each_lower(&self, mut entry: impl FnMut(usize, usize, f64)) {
        let s = &self.structure;
        let (n, m) = (s.sparse_dimension(), s.border());
        for i in 0..s.block_count() {
            for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
                for (a, row) in self.blocks[s.values(slot)].chunks_exact(s.size(j)).enumerate() {
                    let width = if i == j { a + 1 } else { row.len() };
                    row[..width].iter().enumerate().for_each(|(b, v)| entry(s.offset(i) + a, s.offset(j) + b, *v));
                }
            }
        }
        for k in 0..m {
            (0..n).for_each(|c| entry(n + k, c, self.cross[c * m + k]));
            (0..=k).for_each(|c| entry(n + k, n + c, self.border[k * m + c]));
        }
    }
}

/// Halves the range of rows until one is left; `rayon::join` works on the stack, so nothing is allocated.
fn split_rows(
    s: &BlockStructure,
    range: std::ops::Range<usize>,
    rows: BlockRow<'_>,
    fill: &(impl Fn(usize, BlockRow<'_>) + Sync),
) {
    match range.len() {
        0 => {}
        1 => fill(range.start, rows),
        n => {
            let mid = range.start + n / 2;
            let values = s.row_values(mid).start - s.row_values(range.start).start;
            let coords = s.offset(mid) - s.offset(range.start);
            let (b0, b1) = rows.blocks.split_at_mut(values);
            let (c0, c1) = rows.cross.split_at_mut(coords * s.border());
            let (g0, g1) = rows.gradient.split_at_mut(coords);
            rayon::join(
                || split_rows(s, range.start..mid, BlockRow { blocks: b0, cross: c0, gradient: g0 }, fill),
                || split_rows(s, mid..range.end, BlockRow { blocks: b1, cross: c1, gradient: g1 }, fill),
            );
        }
    }
}
