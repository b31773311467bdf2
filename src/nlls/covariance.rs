//! How well the data determine the border's coordinates.

use super::linear::{BorderedCholesky, LinearError, inverse_of_reduced};
use super::{NormalEquations, Problem};

/// The covariance of the border's coordinates `w` at a minimum `x`, for residuals of unit variance: `S^-1`, `nb x nb`, with the
/// Schur complement of the undamped Gauss-Newton Hessian of E/2
///
/// ```text
///     S = H_ww - H_gw' H_gg^-1 H_gw        Cov(w) = sigma^2 S^-1 = sigma^2 (H^-1)_ww
/// ```
///
/// (C. Bishop, "Pattern recognition and machine learning", 2006, section 4.4, Laplace's approximation.) It is the same for any
/// linear solver. Multiply by the variance `sigma^2` of a residual of weight one: 1 if the weights are `1 / sigma_m^2`, or
/// estimated from the residuals of the data, `sum_m alpha_m rho'_m |r_m|^2 / (number of residuals - number of parameters)`.
/// Regularisers count as observations of that same variance; where they are strong, this is what is left to know about `w` after
/// data and prior, more than the scatter of repeated fits.
///
/// Coordinates at a [bound](Problem::border_bounds) are taken as known: their rows and columns are zero, and the others' are
/// those of the problem without them.
///
/// Linearises once. To reuse buffers see [`Workspace::border_covariance`](super::Workspace::border_covariance).
///
/// # Errors
/// [`LinearError`] names the first coordinate that nothing observes, or that is not finite.
///
/// # Panics
/// If `x` does not have [`Problem::parameter_len`] entries, or the problem's bounds are not [valid](super::BorderBounds::validate).
pub fn border_covariance<P: Problem + ?Sized>(
    problem: &mut P,
    x: &[f64],
) -> Result<nalgebra::DMatrix<f64>, LinearError> {
    let structure = problem.structure().clone();
    covariance_with(
        problem,
        x,
        &mut NormalEquations::new(structure.clone()),
        &mut BorderedCholesky::new(&structure),
        0.0,
    )
}

/// The same with buffers of the caller's, and `floor` times the diagonal as damping of the sparse blocks.
pub(super) fn covariance_with<P: Problem + ?Sized>(
    problem: &mut P,
    x: &[f64],
    equations: &mut NormalEquations,
    elimination: &mut BorderedCholesky,
    floor: f64,
) -> Result<nalgebra::DMatrix<f64>, LinearError> {
    assert_eq!(x.len(), problem.parameter_len(), "x must hold the ambient coordinates of all parameters");
    problem.linearize(x, equations);
    let mut damping = Vec::new();
    if floor > 0.0 {
        damping.resize(equations.structure().dimension(), 0.0);
        equations.copy_diagonal(&mut damping);
        let largest = damping.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        damping.iter_mut().for_each(|h| *h = floor * h.max(floor * largest));
        damping[equations.structure().sparse_dimension()..].fill(0.0);
    }
    let bounds = problem.border_bounds();
    let held = |k: usize| bounds.is_some_and(|b| b.at_bound(x, k));
    inverse_of_reduced(elimination, equations, &damping, held)
}
