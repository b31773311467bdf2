//! The dense arithmetic of one front, see [`multifrontal`](super::multifrontal): columns of L, what they take away from the rows
//! below, and the forward solve of many right-hand sides by them.
//!
//! Fronts are column-major with columns padded to a multiple of [`PAD`], so that tiles of registers start at multiples of it and
//! need no ends. What lies above the diagonal is never read for a result and holds anything that is finite.

use pulp::Simd;

use crate::nlls::dense_kernels::{PAD, TILE_ROWS, Tile, padded, sum_of_products, sweep};

/// Overwrites the first `width` columns of a front, `stride` apart, by those of its Cholesky factor.
///
/// # Errors
/// The first column whose pivot is not positive.
#[inline(always)]
pub(super) fn factor_columns<S: Simd>(simd: S, columns: &mut [f64], stride: usize, width: usize) -> Result<(), usize> {
    let mut j = 0;
    while j < width {
        j += match width - j {
            TILE_ROWS.. => factor_panel::<S, TILE_ROWS>(simd, columns, stride, j)?,
            2.. => factor_panel::<S, 2>(simd, columns, stride, j)?,
            _ => factor_panel::<S, 1>(simd, columns, stride, j)?,
        };
    }
    Ok(())
}

/// The `N` columns from `j` on, by the columns before them and by each other; `N` divides [`PAD`]. Returns `N`.
#[inline(always)]
fn factor_panel<S: Simd, const N: usize>(
    simd: S,
    columns: &mut [f64],
    stride: usize,
    j: usize,
) -> Result<usize, usize> {
    let top = j / PAD * PAD;
    let (done, panel) = columns.split_at_mut(j * stride);
    let mut rows = PanelTile::<N> { done, panel, stride, j, top, triangle: None };
    sweep::<S, N>(simd, PAD, &mut rows);
    let mut triangle = Triangle { below: [[0.0; N]; N], inverse: [0.0; N] };
    let mut block = [[0.0; PAD]; N];
    for c in 0..N {
        block[c].copy_from_slice(&rows.panel[c * stride + top..][..PAD]);
    }
    for c in 0..N {
        let pivot = block[c][j - top + c];
        if pivot.is_nan() || pivot <= 0.0 {
            return Err(j + c);
        }
        let root = pivot.sqrt();
        triangle.inverse[c] = 1.0 / root;
        for r in 0..PAD {
            block[c][r] *= triangle.inverse[c];
        }
        for d in c + 1..N {
            let factor = block[c][j - top + d];
            triangle.below[c][d] = factor;
            for r in 0..PAD {
                block[d][r] = (-factor).mul_add(block[c][r], block[d][r]);
            }
        }
        block[c][j - top + c] = root;
        rows.panel[c * stride + top..][..PAD].copy_from_slice(&block[c]);
    }
    rows.triangle = Some(triangle);
    rows.top += PAD;
    sweep::<S, N>(simd, stride - rows.top, &mut rows);
    Ok(N)
}

/// The diagonal block of a panel: `below[c][d]`, row d of column c, and the inverses of its pivots.
struct Triangle<const N: usize> {
    below: [[f64; N]; N],
    inverse: [f64; N],
}

/// Rows of a panel from `top` on: what the columns before take away and, once it is known, the solve with the triangle.
struct PanelTile<'a, const N: usize> {
    done: &'a [f64],
    panel: &'a mut [f64],
    stride: usize,
    j: usize,
    top: usize,
    triangle: Option<Triangle<N>>,
}

impl<const N: usize> Tile for PanelTile<'_, N> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let row = self.top + first;
        let done = self.done.chunks_exact(self.stride);
        let mut sum = sum_of_products::<S, _, N, V>(simd, done.map(|column| (&column[self.j..], &column[row..])));
        for c in 0..N {
            let before = &S::as_simd_f64s(&self.panel[c * self.stride + row..]).0[..V];
            for v in 0..V {
                sum[c][v] = simd.sub_f64s(before[v], sum[c][v]);
            }
        }
        if let Some(Triangle { below, inverse }) = &self.triangle {
            for c in 0..N {
                let inverse = simd.splat_f64s(inverse[c]);
                for v in 0..V {
                    sum[c][v] = simd.mul_f64s(sum[c][v], inverse);
                }
                for d in c + 1..N {
                    let factor = simd.splat_f64s(-below[c][d]);
                    for v in 0..V {
                        sum[d][v] = simd.mul_add_f64s(factor, sum[c][v], sum[d][v]);
                    }
                }
            }
        }
        for c in 0..N {
            let after = &mut S::as_mut_simd_f64s(&mut self.panel[c * self.stride + row..]).0[..V];
            after.copy_from_slice(&sum[c]);
        }
    }
}

/// Where an update of `below` rows has row 0 of its column `c`. Of the rows above the diagonal it has those in the [`PAD`] of the
/// diagonal alone.
pub(super) fn update_column(below: usize, c: usize) -> usize {
    let (before, within) = (c / PAD * PAD, c % PAD);
    // columns of `padded(below)`, `padded(below) - PAD` and so on numbers, PAD of each
    let start = before * (2 * padded(below) + PAD - before) / 2;
    start + within * (padded(below) - before) - before
}

/// Numbers of an update of `below` rows.
pub(super) fn update_len(below: usize) -> usize {
    padded(below) * (padded(below) + PAD) / 2
}

/// `out = -B B'`, its lower triangle, for the `below` rows of a front under its `width` columns: see [`update_column`]. `columns` has
/// [`PAD`] numbers after its end.
#[inline(always)]
pub(super) fn negative_square<S: Simd>(
    simd: S,
    columns: &[f64],
    stride: usize,
    width: usize,
    below: usize,
    out: &mut [f64],
) {
    for j in (0..below).step_by(TILE_ROWS) {
        let top = j / PAD * PAD;
        let out = &mut out[update_column(below, j) + top..];
        sweep::<S, TILE_ROWS>(simd, padded(below) - top, &mut SquareTile { columns, stride, width, below, j, out });
    }
}

struct SquareTile<'a> {
    columns: &'a [f64],
    stride: usize,
    width: usize,
    below: usize,
    j: usize,
    out: &'a mut [f64],
}

impl Tile for SquareTile<'_> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let top = self.j / PAD * PAD;
        let from = |row: usize| self.columns[self.width + row..].chunks(self.stride).take(self.width);
        let columns = from(self.j).zip(from(top + first));
        let sum = sum_of_products::<S, _, TILE_ROWS, V>(simd, columns);
        for c in 0..TILE_ROWS {
            if self.j + c < self.below {
                let start = c * (padded(self.below) - top) + first;
                let out = &mut S::as_mut_simd_f64s(&mut self.out[start..]).0[..V];
                for v in 0..V {
                    out[v] = simd.neg_f64s(sum[c][v]);
                }
            }
        }
    }
}

/// Solves `L x = x` for the columns of one front and takes what they contribute from the rows below, for right-hand sides side by
/// side: rows of `x`, permuted, are `pitch` long.
pub(super) struct ForwardTile<'a> {
    /// Columns of L, with [`PAD`] numbers after their end.
    pub columns: &'a [f64],
    pub stride: usize,
    pub width: usize,
    /// First row of `x` that the columns belong to.
    pub start: usize,
    /// The rows below.
    pub pattern: &'a [usize],
    pub x: &'a mut [f64],
    pub pitch: usize,
}

impl Tile for ForwardTile<'_> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let (width, stride, pitch) = (self.width, self.stride, self.pitch);
        let own = self.start * pitch + first;
        for j in (0..width).step_by(TILE_ROWS) {
            let known = (0..j).map(|k| (&self.columns[k * stride + j..], &self.x[own + k * pitch..]));
            let mut sum = sum_of_products::<S, _, TILE_ROWS, V>(simd, known);
            for r in 0..TILE_ROWS {
                if j + r < width {
                    let x = &mut S::as_mut_simd_f64s(&mut self.x[own + (j + r) * pitch..]).0[..V];
                    let column = &self.columns[(j + r) * stride + j..][..TILE_ROWS];
                    let inverse = simd.splat_f64s(1.0 / column[r]);
                    for v in 0..V {
                        sum[r][v] = simd.mul_f64s(simd.sub_f64s(x[v], sum[r][v]), inverse);
                    }
                    for d in r + 1..TILE_ROWS {
                        let factor = simd.splat_f64s(column[d]);
                        for v in 0..V {
                            sum[d][v] = simd.mul_add_f64s(factor, sum[r][v], sum[d][v]);
                        }
                    }
                    x.copy_from_slice(&sum[r]);
                }
            }
        }
        for (b, rows) in self.pattern.chunks(TILE_ROWS).enumerate() {
            let left = width + b * TILE_ROWS;
            let solved = (0..width).map(|k| (&self.columns[k * stride + left..], &self.x[own + k * pitch..]));
            let sum = sum_of_products::<S, _, TILE_ROWS, V>(simd, solved);
            for r in 0..TILE_ROWS {
                if let Some(&row) = rows.get(r) {
                    let x = &mut S::as_mut_simd_f64s(&mut self.x[row * pitch + first..]).0[..V];
                    for v in 0..V {
                        x[v] = simd.sub_f64s(x[v], sum[r][v]);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nlls::dense_kernels::dispatch;
    use nalgebra::DMatrix;
    use pulp::WithSimd;

    struct Factor<'a> {
        columns: &'a mut [f64],
        stride: usize,
        width: usize,
        below: usize,
        update: &'a mut [f64],
        x: &'a mut [f64],
        pitch: usize,
    }

    impl WithSimd for Factor<'_> {
        type Output = Result<(), usize>;

        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let Self { columns, stride, width, below, update, x, pitch } = self;
            factor_columns(simd, &mut columns[..stride * width], stride, width)?;
            negative_square(simd, columns, stride, width, below, update);
            let pattern: Vec<usize> = (0..below).map(|r| width + 2 * r).collect();
            let columns = &*columns;
            let mut tile = ForwardTile { columns, stride, width, start: 0, pattern: &pattern, x, pitch };
            sweep::<S, TILE_ROWS>(simd, pitch, &mut tile);
            Ok(())
        }
    }

    #[test]
    fn a_front_of_any_shape_is_factored_squared_and_solved_with() {
        for (width, below) in [(1, 0), (6, 0), (6, 3), (7, 8), (8, 1), (13, 30), (18, 17), (48, 25)] {
            let n = width + below;
            let a = DMatrix::from_fn(n, n, |r, c| ((r * 7 + c * 3) as f64 * 0.37).sin());
            let h = &a * a.transpose() + DMatrix::identity(n, n) * n as f64;
            let l = h.clone().cholesky().unwrap().l();
            let stride = padded(n);
            let mut columns = vec![0.0; stride * width + PAD];
            for c in 0..width {
                for r in c..n {
                    columns[c * stride + r] = h[(r, c)];
                }
            }
            let mut update = vec![f64::NAN; update_len(below)];
            let pitch = 32;
            let rows = width + 2 * below;
            let rhs = DMatrix::from_fn(rows, pitch, |r, c| (r as f64 - 0.3 * c as f64).cos());
            let mut x: Vec<f64> = rhs.transpose().iter().copied().collect();
            let (columns_mut, x_mut) = (&mut columns, &mut x);
            let front = Factor { columns: columns_mut, stride, width, below, update: &mut update, x: x_mut, pitch };
            dispatch(front).unwrap();
            for c in 0..width {
                for r in c..n {
                    approx::assert_relative_eq!(columns[c * stride + r], l[(r, c)], epsilon = 1e-12);
                }
            }
            let b = l.view((width, 0), (below, width));
            let square = b * b.transpose();
            for c in 0..below {
                for r in c..below {
                    let found = update[update_column(below, c) + r];
                    approx::assert_relative_eq!(found, -square[(r, c)], epsilon = 1e-12);
                }
            }
            let solved = l.view((0, 0), (width, width)).solve_lower_triangular(&rhs.rows(0, width)).unwrap();
            let taken = b * &solved;
            for c in 0..pitch {
                for r in 0..width {
                    approx::assert_relative_eq!(x[r * pitch + c], solved[(r, c)], epsilon = 1e-12);
                }
                for r in 0..below {
                    let row = width + 2 * r;
                    approx::assert_relative_eq!(x[row * pitch + c], rhs[(row, c)] - taken[(r, c)], epsilon = 1e-12);
                }
            }
        }
    }

    #[test]
    fn the_first_pivot_that_is_not_positive_is_named() {
        for bad in 0..13 {
            for value in [-1.0, 0.0, f64::NAN] {
                let mut columns = vec![0.0; 16 * 13 + PAD];
                (0..13).for_each(|c| columns[c * 17] = 1.0);
                columns[bad * 17] = value;
                let (stride, width) = (16, 13);
                let (update, x): (&mut [f64], &mut [f64]) = (&mut [], &mut []);
                let front = Factor { columns: &mut columns, stride, width, below: 0, update, x, pitch: 0 };
                assert_eq!(dispatch(front), Err(bad));
            }
        }
    }
}
