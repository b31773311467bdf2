//! Dense products that assemble normal equations. Row-major, single-threaded, the same bits on every call; instruction
//! sets beyond the build's baseline are used where the processor has them. Products are fused with the sums that they go to, so
//! results do not depend on the width of its registers; a processor that cannot do that (x86 before 2013) is slow.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, MatMut, MatRef, Par};

/// `lower(c) = lower(a' a)` for `a` of `rows x n`; `c` is `n x n`, its strict upper triangle is left alone.
pub fn rank_update_lower(a: &[f64], rows: usize, n: usize, c: &mut [f64]) {
    if n == 0 {
        return;
    }
    let a = MatRef::from_row_major_slice(&a[..rows * n], rows, n);
    let c = MatMut::from_row_major_slice_mut(&mut c[..n * n], n, n);
    triangular::matmul(
        c,
        BlockStructure::TriangularLower,
        Accum::Replace,
        a.transpose(),
        BlockStructure::Rectangular,
        a,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
}

/// Runs `work` compiled for the best instruction set that this processor has.
#[inline]
pub fn vectorized<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// `out += y' u` for `R` rows of `y` and of `u`; `out` is `W x n`, row-major, `n` the length of a row of `u`.
#[inline(always)]
pub fn add_outer<const W: usize, const R: usize>(y: [&[f64; W]; R], u: [&[f64]; R], out: &mut [f64]) {
    let n = u.first().map_or(0, |row| row.len());
    let u = u.map(|row| &row[..n]);
    for (i, out) in out.chunks_exact_mut(n.max(1)).take(W).enumerate() {
        let y = y.map(|row| row[i]);
        for k in 0..n {
            let mut sum = out[k];
            for r in 0..R {
                sum = y[r].mul_add(u[r][k], sum);
            }
            out[k] = sum;
        }
    }
}

/// `block += scale sum_r left_r right_r'` for `R` rows; `block` is `W x W`, row-major.
#[inline(always)]
pub fn add_block<const W: usize, const R: usize>(
    block: &mut [f64],
    left: [&[f64; W]; R],
    right: [&[f64; W]; R],
    scale: f64,
) {
    for (i, row) in block.chunks_exact_mut(W).take(W).enumerate() {
        for r in 0..R {
            let l = scale * left[r][i];
            for j in 0..W {
                row[j] = l.mul_add(right[r][j], row[j]);
            }
        }
    }
}
