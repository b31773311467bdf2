//! Preconditioned conjugate gradients: `A x = b` for a positive definite A that is known only by what it does to a vector.
//!
//! ```text
//!     z = P^-1 r      q = A p      x += (r'z / p'q) p      r -= (r'z / p'q) q      p <- z + (r'z new / r'z old) p
//! ```
//!
//! (Y. Saad, "Iterative methods for sparse linear systems", 2003, algorithm 9.1.) It minimises the error `|x - x*|` in the norm
//! of A over a growing Krylov space, so it needs as many iterations as `P^-1 A` has distinct eigenvalues: one for `P = A`.

use super::LinearError;
use super::vector::{axpy, dot};

/// Settings and vectors of a conjugate gradient solve; keep it, and nothing is allocated from the second solve of a size on.
///
/// ```
/// use nonrigid::nlls::linear::Pcg;
///
/// let (diagonal, b) = ([4.0, 1.0, 9.0], [1.0, 2.0, 3.0]);
/// let apply = |p: &[f64], out: &mut [f64]| {
///     for i in 0..3 {
///         out[i] = diagonal[i] * p[i] + p.iter().sum::<f64>();
///     }
/// };
/// let jacobi = |r: &[f64], z: &mut [f64]| (0..3).for_each(|i| z[i] = r[i] / (diagonal[i] + 1.0));
/// let mut x = [0.0; 3];
/// Pcg::default().solve(&b, &mut x, apply, jacobi)?;
/// let mut product = [0.0; 3];
/// apply(&x, &mut product);
/// assert!(product.iter().zip(b).all(|(p, b)| (p - b).abs() < 1e-9));
/// # Ok::<(), nonrigid::nlls::LinearError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Pcg {
    /// Done when the residual's norm `sqrt(r' P^-1 r)` has fallen to this share of that of `b`. Default 1e-8: the
    /// energy is then minimal to all digits, as its error is the square of that.
    pub tolerance: f64,
    /// Iterations after which it is given up. Default 1000.
    pub max_iterations: usize,
    residual: Vec<f64>,
    preconditioned: Vec<f64>,
    direction: Vec<f64>,
    product: Vec<f64>,
}

impl Default for Pcg {
    fn default() -> Self {
        Self {
            tolerance: 1e-8,
            max_iterations: 1000,
            residual: Vec::new(),
            preconditioned: Vec::new(),
            direction: Vec::new(),
            product: Vec::new(),
        }
    }
}

impl Pcg {
    /// Sets [`tolerance`](Self::tolerance).
    #[must_use]
    pub fn with_tolerance(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }

    /// Sets [`max_iterations`](Self::max_iterations).
    #[must_use]
    pub fn with_max_iterations(self, max_iterations: usize) -> Self {
        Self { max_iterations, ..self }
    }

    /// Writes the solution of `A x = b` to `x`, starting from zero, and returns the number of iterations. `apply(p, out)`
    /// writes `A p`, `precondition(r, out)` writes `P^-1 r`; both overwrite `out`.
    ///
    /// # Errors
    /// [`LinearError::NoCurvature`] when A or P turns out not to be positive definite, or a value not to be finite;
    /// [`LinearError::NotConverged`]. `x` is unspecified then.
    ///
    /// # Panics
    /// If `b` and `x` differ in length, or the tolerance is not in [0, 1).
    pub fn solve(
        &mut self,
        b: &[f64],
        x: &mut [f64],
        mut apply: impl FnMut(&[f64], &mut [f64]),
        mut precondition: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<usize, LinearError> {
        assert_eq!(b.len(), x.len(), "right-hand side and solution must be of equal length");
        assert!((0.0..1.0).contains(&self.tolerance), "the tolerance is {}, but must be in [0, 1)", self.tolerance);
        let Self { residual: r, preconditioned: z, direction: p, product: q, .. } = self;
        for vector in [&mut *r, &mut *z, &mut *p, &mut *q] {
            vector.resize(b.len(), 0.0);
        }
        x.fill(0.0);
        // Squares of what is very small or large are lost.
        let largest = b.iter().fold(0.0, |max: f64, v| max.max(v.abs()));
        let scale = if largest > 0.0 && !(1e-100..1e100).contains(&largest) { 1.0 / largest } else { 1.0 };
        r.iter_mut().zip(b).for_each(|(r, b)| *r = scale * b);
        precondition(r, z);
        p.copy_from_slice(z);
        let mut square = dot(r, z);
        let enough = self.tolerance * self.tolerance * square;
        // An exact zero is a solved system; a negative or undefined square is a preconditioner that is not one.
        for iteration in 1..=self.max_iterations {
            if square == 0.0 {
                return Ok(iteration - 1);
            }
            apply(p, q);
            let curvature = dot(p, q);
            if !(square > 0.0 && square.is_finite() && curvature > 0.0 && curvature.is_finite()) {
                return Err(LinearError::NoCurvature { iteration });
            }
            let length = square / curvature;
            axpy(length / scale, p, x);
            axpy(-length, q, r);
            precondition(r, z);
            let last = std::mem::replace(&mut square, dot(r, z));
            if (0.0..=enough).contains(&square) {
                return Ok(iteration);
            }
            let conjugate = square / last;
            for (p, z) in p.iter_mut().zip(&*z) {
                *p = z + conjugate * *p;
            }
        }
        if square == 0.0 {
            Ok(self.max_iterations)
        } else {
            Err(LinearError::NotConverged { iterations: self.max_iterations })
        }
    }
}
