//! Parameter blocks that are not plain vectors: how a tangent step moves them.
//!
//! Rotations move from the left, `R <- exp(omega^) R`, and derivatives are taken at omega = 0, where
//! `d(exp(omega) p) / domega = -[p]x`. All rotational manifolds share this tangent, so a problem may change its
//! parametrisation without changing its normal equations.

use super::Scalar;

mod check;
mod euclidean;
mod quaternion;
mod rigid;
pub mod so3;

pub use check::check_manifold;
pub use euclidean::Euclidean;
pub use quaternion::UnitQuaternion;
pub use rigid::{QuaternionSe3, Se3, Sim3};
pub use so3::So3;

/// A smooth manifold, embedded in numbers. The type is a name only: points are slices of `AMBIENT` doubles.
///
/// ```
/// use nonrigid::nlls::{Manifold, Scalar, check_manifold};
///
/// /// The unit circle (cos a, sin a); a step adds to the angle.
/// struct Circle;
///
/// impl Manifold for Circle {
///     const AMBIENT: usize = 2;
///     const TANGENT: usize = 1;
///     type Point<D: Scalar> = [D; 2];
///
///     fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
///         let (sin, cos) = delta[0].sin_cos();
///         out[0] = cos * x[0] - sin * x[1];
///         out[1] = sin * x[0] + cos * x[1];
///     }
///
///     fn normalize(x: &mut [f64]) {
///         let norm = x[0].hypot(x[1]);
///         x.iter_mut().for_each(|v| *v /= norm);
///     }
/// }
///
/// check_manifold::<Circle>(&[0.6, 0.8]).unwrap();
/// ```
pub trait Manifold: 'static {
    /// Numbers that a point takes.
    const AMBIENT: usize;
    /// Numbers that a step takes.
    const TANGENT: usize;
    /// A step adds to the point, number by number: such blocks may have [bounds](super::ResidualProblemBuilder::set_bounds).
    const PLAIN: bool = false;
    /// A point as an array, `[D; AMBIENT]`.
    type Point<D: Scalar>: PointArray<D>;

    /// Writes `x` moved by the tangent step `delta` to `out`. Must be differentiable at `delta = 0`, where it is the identity.
    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]);

    /// Puts a point that has drifted off by rounding back on the manifold.
    fn normalize(_x: &mut [f64]) {}

    /// Whether `x` is a point of the manifold up to `tolerance`, a share of its largest entry or of 1: as it stands, whether
    /// [`normalize`](Self::normalize) moves no entry farther. To be written where that leaves something else alone.
    fn contains(x: &[f64], tolerance: f64) -> bool {
        let mut normal = x.to_vec();
        Self::normalize(&mut normal);
        let size = x.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
        normal.iter().zip(x).all(|(a, b)| (a - b).abs() <= tolerance * size)
    }
}

/// Arrays `[D; N]` as storage of a point.
pub trait PointArray<D>: AsRef<[D]> + AsMut<[D]> + Copy + Send + Sync {
    /// The array filled with one value.
    fn filled(value: D) -> Self;
}

impl<D: Copy + Send + Sync, const N: usize> PointArray<D> for [D; N] {
    fn filled(value: D) -> Self {
        [value; N]
    }
}
