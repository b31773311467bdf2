//! The boundary between the solver and whatever is being solved.

use std::sync::Arc;

use super::{BlockStructure, BorderBounds, NormalEquations};

/// A nonlinear least-squares problem `min E(x)`, `E(x) = sum_m alpha_m rho(|r_m(x)|^2)` (no factor 1/2).
///
/// `x` holds the *ambient* coordinates of all parameters (a rotation matrix takes nine), a step holds the *tangent*
/// coordinates (a rotation takes three): sparse blocks first, then the dense border, as [`BlockStructure`] lays them out.
///
/// Two implementors ship with the crate: [`ResidualProblem`](super::ResidualProblem) for any residuals over any parameter
/// blocks, and [`Deformation`](crate::energy::Deformation) for deformation models with data terms.
pub trait Problem {
    /// Sparsity of the normal equations; fixed for the life of the problem.
    fn structure(&self) -> &Arc<BlockStructure>;

    /// Number of ambient coordinates in `x`.
    fn parameter_len(&self) -> usize;

    /// The energy at `x`. Called for step trials, so it should cost much less than [`linearize`](Self::linearize).
    fn energy(&mut self, x: &[f64]) -> f64;

    /// Fills `equations` (overwriting what was there) with gradient and Gauss-Newton Hessian of `E / 2` at `x` and returns `E(x)`.
    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64;

    /// Writes `x` moved by the tangent `step` to `out`.
    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]);

    /// Bounds of the border's coordinates, if they are plain numbers and have any; fixed while a minimisation runs.
    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        None
    }
}
