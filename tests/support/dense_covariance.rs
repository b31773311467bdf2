//! Covariance of the border by the inverse of the whole matrix.

use nalgebra::DMatrix;

/// Rows and columns of `h` that are not held, inverted, and the border's part of that.
pub fn dense_covariance(h: &DMatrix<f64>, border: usize, held: &[bool]) -> DMatrix<f64> {
    let n = h.nrows() - border;
    let kept: Vec<usize> = (0..h.nrows()).filter(|&i| i < n || !held[i - n]).collect();
    let inverse = h.select_rows(&kept).select_columns(&kept).try_inverse().unwrap();
    let mut covariance = DMatrix::zeros(border, border);
    for (a, &i) in kept.iter().enumerate().filter(|e| *e.1 >= n) {
        for (b, &j) in kept.iter().enumerate().filter(|e| *e.1 >= n) {
            covariance[(i - n, j - n)] = inverse[(a, b)];
        }
    }
    covariance
}
