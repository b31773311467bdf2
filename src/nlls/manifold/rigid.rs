//! Rigid motions and similarities, with rotation and translation moved separately.

use super::{Manifold, Scalar, UnitQuaternion, so3, so3::So3};

/// `p -> R p + t`. Point: R row-major, then t. Step: (omega, tau), `R <- exp(omega^) R`, `t <- t + tau`.
///
/// This is the product SO(3) x R^3: tau is a translation in the outer frame that does not depend on omega, which keeps the
/// derivatives of nodes sparse and free of coupling.
#[derive(Debug, Clone, Copy)]
pub struct Se3;

impl Manifold for Se3 {
    const AMBIENT: usize = 12;
    const TANGENT: usize = 6;
    type Point<D: Scalar> = [D; 12];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        So3::plus(x, delta, out);
        for i in 0..3 {
            out[9 + i] = delta[3 + i] + x[9 + i];
        }
    }

    fn normalize(x: &mut [f64]) {
        So3::normalize(x);
    }

    fn contains(x: &[f64], tolerance: f64) -> bool {
        So3::contains(x, tolerance)
    }
}

impl Se3 {
    /// The identity.
    pub const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];

    /// `R p + t`.
    pub fn transform<D: Scalar>(x: &[D; 12], p: [D; 3]) -> [D; 3] {
        let rotation: &[D; 9] = x.first_chunk().expect("twelve entries begin with nine");
        let moved = so3::rotate(rotation, p);
        std::array::from_fn(|i| moved[i] + x[9 + i])
    }
}

/// [`Se3`] with the rotation as a unit quaternion. Point: q = (w, x, y, z), then t. Step: that of [`Se3`].
#[derive(Debug, Clone, Copy)]
pub struct QuaternionSe3;

impl Manifold for QuaternionSe3 {
    const AMBIENT: usize = 7;
    const TANGENT: usize = 6;
    type Point<D: Scalar> = [D; 7];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        UnitQuaternion::plus(&x[..4], &delta[..3], &mut out[..4]);
        for i in 0..3 {
            out[4 + i] = delta[3 + i] + x[4 + i];
        }
    }

    fn normalize(x: &mut [f64]) {
        UnitQuaternion::normalize(&mut x[..4]);
    }
}

impl QuaternionSe3 {
    /// The identity.
    pub const IDENTITY: [f64; 7] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
}

/// `p -> e^s R p + t`. Point: R row-major, t, then the log scale s. Step: (omega, tau, sigma), `s <- s + sigma`.
#[derive(Debug, Clone, Copy)]
pub struct Sim3;

impl Manifold for Sim3 {
    const AMBIENT: usize = 13;
    const TANGENT: usize = 7;
    type Point<D: Scalar> = [D; 13];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        Se3::plus(x, delta, out);
        out[12] = delta[6] + x[12];
    }

    fn normalize(x: &mut [f64]) {
        So3::normalize(x);
    }

    fn contains(x: &[f64], tolerance: f64) -> bool {
        So3::contains(x, tolerance)
    }
}

impl Sim3 {
    /// The identity.
    pub const IDENTITY: [f64; 13] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];

    /// `e^s R p + t`.
    pub fn transform<D: Scalar>(x: &[D; 13], p: [D; 3]) -> [D; 3] {
        let scale = x[12].exp();
        let rotation: &[D; 9] = x.first_chunk().expect("thirteen entries begin with nine");
        let moved = so3::rotate(rotation, p);
        std::array::from_fn(|i| scale * moved[i] + x[9 + i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms() {
        let x = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 10.0, 20.0, 30.0, 2.0_f64.ln()];
        let pose: &[f64; 12] = x.first_chunk().unwrap();
        assert_eq!(Se3::transform(pose, [1.0, 2.0, 3.0]), [8.0, 21.0, 33.0]);
        assert_eq!(Sim3::transform(&x, [1.0, 2.0, 3.0]), [6.0, 22.0, 36.0]);
    }
}
