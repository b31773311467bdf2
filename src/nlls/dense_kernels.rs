//! Dense products that assemble normal equations. Row-major, single-threaded, the same bits on every call; instruction
//! sets beyond the build's baseline are used where the processor has them.

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

/// `out += y' u` for `y` of `R` rows, whose first `t` entries count, and `u` of `R` rows of equal length `n`; `out` is
/// `t x n`.
#[inline(always)]
pub fn add_outer<const W: usize, const R: usize>(y: [&[f64; W]; R], u: [&[f64]; R], out: &mut [f64], t: usize) {
    let n = u[0].len();
    let u = u.map(|row| &row[..n]);
    for (i, out) in out.chunks_exact_mut(n).take(t).enumerate() {
        let y = y.map(|row| row[i]);
        for k in 0..n {
            let mut sum = out[k];
            for r in 0..R {
                sum += y[r] * u[r][k];
            }
            out[k] = sum;
        }
    }
}
