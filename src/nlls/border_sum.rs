//! What rows add to the border of normal equations: `U' U` and `U' e`.

use super::dense_kernels::{GRAM_ROWS, Gram, dispatch, vectorized};

/// Sums over the rows of a group of chunks of an [`Assembly`](super::Assembly). Rows are filled a few at a time, in f64, and added while
/// they are in the cache.
#[derive(Debug)]
pub(super) struct BorderSum {
    /// `U' U`, its lower triangle, rows and columns padded; of U as it is stored.
    pub square: Vec<f64>,
    /// `U' e`, of U as it was filled.
    pub gradient: Vec<f64>,
    /// Rows that are not added yet come first.
    pending: Vec<f64>,
    /// `e` of those rows.
    residuals: Vec<f64>,
}

impl BorderSum {
    /// For rows that are padded to `width`.
    pub fn new(width: usize) -> Self {
        let pending = vec![0.0; width * GRAM_ROWS];
        Self { square: vec![0.0; width * width], gradient: vec![0.0; width], pending, residuals: Vec::new() }
    }

    pub fn clear(&mut self) {
        self.square.fill(0.0);
        self.gradient.fill(0.0);
        self.residuals.clear();
    }

    /// Whether so many more rows are to wait until those before are added.
    #[inline(always)]
    pub fn is_full_for(&self, rows: usize) -> bool {
        self.residuals.len() + rows > GRAM_ROWS
    }

    /// Rows, and their residuals, to be filled.
    #[inline(always)]
    pub fn next_rows(&mut self, rows: usize) -> (&mut [f64], &mut [f64]) {
        let (width, first) = (self.gradient.len(), self.residuals.len());
        let last = first + rows;
        self.residuals.resize(last, 0.0);
        if self.pending.len() < last * width {
            self.pending.resize(last * width, 0.0); // an item of very many rows
        }
        (&mut self.pending[first * width..last * width], &mut self.residuals[first..])
    }

    /// Adds the rows that were filled, and stores them, rounded, at the beginning of `u`. Returns the rest of that.
    pub fn add_rows<'a>(&mut self, u: &'a mut [f32]) -> &'a mut [f32] {
        let (width, rows) = (self.gradient.len(), self.residuals.len());
        let (u, rest) = u.split_at_mut(rows * width);
        if width > 0 {
            let pending = &mut self.pending[..rows * width];
            let each = pending.chunks_exact_mut(width).zip(u.chunks_exact_mut(width));
            for ((row, u), e) in each.zip(&self.residuals) {
                let gradient = &mut self.gradient;
                vectorized(
                    #[inline(always)]
                    || {
                        for ((x, u), g) in row.iter_mut().zip(&mut *u).zip(&mut *gradient) {
                            *g = e.mul_add(*x, *g);
                            *u = *x as f32;
                            *x = f64::from(*u);
                        }
                    },
                );
            }
            let (a, out) = (&*pending, &mut self.square[..]);
            dispatch(Gram { a, b: a, a_width: width, b_width: width, rows, lower: true, out });
        }
        self.residuals.clear();
        rest
    }
}
