//! Vector kernels with a fixed order of summation: eight running sums, so that the compiler may use SIMD and the bits stay put.

/// `a . b`, both of the same length.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let [product] = dot_lanes(a, b.as_chunks().0);
    product
}

/// `y += a x`.
#[inline(always)]
pub(super) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    axpy_lanes([a], x, y.as_chunks_mut().0);
}

/// [`dot`] with each of `L` vectors side by side.
#[inline(always)]
pub(super) fn dot_lanes<const L: usize>(a: &[f64], b: &[[f64; L]]) -> [f64; L] {
    let add = |sum: &mut [f64; L], a: f64, b: &[f64; L]| sum.iter_mut().zip(b).for_each(|(s, b)| *s += a * b);
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let (mut sums, mut rest) = ([[0.0; L]; 8], [0.0; L]);
    for (a, b) in a_rest.iter().zip(b_rest) {
        add(&mut rest, *a, b);
    }
    for (a, b) in a.iter().zip(b) {
        for k in 0..8 {
            add(&mut sums[k], a[k], &b[k]);
        }
    }
    std::array::from_fn(|l| {
        let sum = |k: usize| sums[k][l] + sums[k + 4][l];
        (sum(0) + sum(1)) + (sum(2) + sum(3)) + rest[l]
    })
}

/// [`axpy`] with a factor for each of `L` vectors side by side.
#[inline(always)]
pub(super) fn axpy_lanes<const L: usize>(a: [f64; L], x: &[f64], y: &mut [[f64; L]]) {
    for (y, x) in y.iter_mut().zip(x) {
        y.iter_mut().zip(a).for_each(|(y, a)| *y += a * x);
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
