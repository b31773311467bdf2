//! The numbers that residuals and manifolds are written in: plain `f64`, or dual numbers that carry derivatives.

use num_dual::DualNum;

/// A double, or a dual number over doubles of a width known at compile time.
///
/// Arithmetic, also with `f64` on the right; `D::from(1.0)` for constants; `x.re()` for the value without its derivatives;
/// `sqrt`, `exp`, `sin_cos`, `powi`, .. as methods. Traps: `sqrt` at 0 and `acos` at 1 have infinite derivatives, so that
/// a norm makes a poor residual (square it, or put it into a [kernel](super::Kernel)); the derivative of `powf` at 0 is NaN for some
/// powers, such as 1.5, that have one there.
pub trait Scalar: DualNum<Primitive = f64> + Copy + Send + Sync {}

impl<D: DualNum<Primitive = f64> + Copy + Send + Sync> Scalar for D {}
