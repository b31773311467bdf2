//! Vector kernels with a fixed order of summation: eight running sums, so that the compiler may use SIMD and the bits stay put.

/// `a . b`, both of the same length.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let tail: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(x, y)| x * y).sum();
    let mut sums = [0.0; LANES];
    for (x, y) in a_chunks.zip(b_chunks) {
        for k in 0..LANES {
            sums[k] += x[k] * y[k];
        }
    }
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7])) + tail
}

/// `y += a x`.
#[inline(always)]
pub(super) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}

/// Solves `L L' x = b` in place; `l` is column-major of side `x.len()`, its lower triangle is read.
pub(super) fn dense_cholesky_solve(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for c in 0..n {
        let column = &l[c * n..(c + 1) * n];
        let (head, tail) = x.split_at_mut(c + 1);
        head[c] /= column[c];
        axpy(-head[c], &column[c + 1..], tail);
    }
    for c in (0..n).rev() {
        let column = &l[c * n..(c + 1) * n];
        let (head, tail) = x.split_at_mut(c + 1);
        head[c] = (head[c] - dot(&column[c + 1..], tail)) / column[c];
    }
}
