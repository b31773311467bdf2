//! Rotations as unit quaternions (w, x, y, z), with the same left tangent as the matrices.

use super::{Manifold, Scalar};

/// Unit quaternions: `q <- (cos(theta/2), sin(theta/2) omega / theta) q`, so that `R(q) <- exp(omega^) R(q)`.
#[derive(Debug, Clone, Copy)]
pub struct UnitQuaternion;

impl Manifold for UnitQuaternion {
    const AMBIENT: usize = 4;
    const TANGENT: usize = 3;
    type Point<D: Scalar> = [D; 4];

    fn plus<D: Scalar>(q: &[f64], omega: &[D], out: &mut [D]) {
        let [x, y, z] = [omega[0] * 0.5, omega[1] * 0.5, omega[2] * 0.5];
        let t = x * x + y * y + z * z;
        // cos and sin(h) / h of the half angle h, from t = h^2; by series where h has no derivative.
        let (cos, sinc) = if t.re() < 1e-2 {
            let series = |c: [f64; 6]| ((((t * c[5] + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0];
            (
                series([1.0, -0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0]),
                series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0]),
            )
        } else {
            let h = t.sqrt();
            (h.cos(), h.sin() / h)
        };
        let [x, y, z] = [sinc * x, sinc * y, sinc * z];
        out[0] = cos * q[0] - x * q[1] - y * q[2] - z * q[3];
        out[1] = cos * q[1] + x * q[0] + y * q[3] - z * q[2];
        out[2] = cos * q[2] + y * q[0] + z * q[1] - x * q[3];
        out[3] = cos * q[3] + z * q[0] + x * q[2] - y * q[1];
    }

    fn normalize(q: &mut [f64]) {
        let square: f64 = q.iter().map(|v| v * v).sum();
        if (square - 1.0).abs() > 4.0 * f64::EPSILON {
            let norm = square.sqrt();
            q.iter_mut().for_each(|v| *v /= norm);
        }
    }
}

impl UnitQuaternion {
    /// `R(q) p` for a unit quaternion.
    pub fn rotate<D: Scalar>(q: &[D; 4], p: [D; 3]) -> [D; 3] {
        let [w, v] = [[q[0]; 3], [q[1], q[2], q[3]]];
        let cross =
            |a: [D; 3], b: [D; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let u = cross(v, p).map(|c| c * 2.0);
        let vu = cross(v, u);
        std::array::from_fn(|i| p[i] + w[i] * u[i] + vu[i])
    }

    /// `R(q)` of a unit quaternion, as rows.
    pub fn matrix<D: Scalar>(q: &[D; 4]) -> [[D; 3]; 3] {
        let [w, x, y, z] = *q;
        let [xx, yy, zz] = [x * x, y * y, z * z];
        let [xy, xz, yz] = [x * y, x * z, y * z];
        let [wx, wy, wz] = [w * x, w * y, w * z];
        let (off, on) = (|product: D| product * 2.0, |squares: D| -(squares * 2.0) + 1.0);
        [
            [on(yy + zz), off(xy - wz), off(xz + wy)],
            [off(xy + wz), on(xx + zz), off(yz - wx)],
            [off(xz - wy), off(yz + wx), on(xx + yy)],
        ]
    }
}

#[cfg(test)]
mod tests {
    use num_dual::DualSVec64;

    use super::super::{So3, so3};
    use super::*;

    /// The row-major matrix of a unit quaternion.
    fn matrix(q: &[f64; 4]) -> [f64; 9] {
        let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| UnitQuaternion::rotate(q, e));
        std::array::from_fn(|k| columns[k % 3][k / 3])
    }

    #[test]
    fn the_matrix_rotates_as_the_quaternion_does() {
        let mut q = [0.3, -0.5, 0.1, 0.9];
        UnitQuaternion::normalize(&mut q);
        for (a, b) in UnitQuaternion::matrix(&q).as_flattened().iter().zip(matrix(&q)) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn derivatives_of_a_rotated_point_are_those_of_the_matrix() {
        let mut q = [0.3, -0.5, 0.1, 0.9];
        UnitQuaternion::normalize(&mut q);
        let p = [0.4, 2.0, -1.5];
        let omega = [0, 1, 2].map(|i| DualSVec64::<3>::from(0.0).derivative(i));
        let (mut by_quaternion, mut by_matrix) = ([omega[0]; 4], [omega[0]; 9]);
        UnitQuaternion::plus(&q, &omega, &mut by_quaternion);
        So3::plus(&matrix(&q), &omega, &mut by_matrix);
        let a = UnitQuaternion::rotate(&by_quaternion, p.map(DualSVec64::from));
        let b = so3::rotate(&by_matrix, p.map(DualSVec64::from));
        for i in 0..3 {
            assert!((a[i].re - b[i].re).abs() < 1e-15);
            assert!((a[i].eps.0.unwrap() - b[i].eps.0.unwrap()).amax() < 1e-15);
        }
    }

    #[test]
    fn finite_steps_agree_with_the_matrix() {
        let mut q = [0.3, -0.5, 0.1, 0.9];
        UnitQuaternion::normalize(&mut q);
        for length in [1e-8, 0.05, 0.199, 0.201, 1.5, 3.0] {
            let omega = [0.6 * length, 0.0, -0.8 * length];
            let (mut moved, mut expected) = ([0.0; 4], [0.0; 9]);
            UnitQuaternion::plus(&q, &omega, &mut moved);
            So3::plus(&matrix(&q), &omega, &mut expected);
            for (a, b) in matrix(&moved).iter().zip(expected) {
                assert!((a - b).abs() < 1e-15);
            }
        }
    }
}
