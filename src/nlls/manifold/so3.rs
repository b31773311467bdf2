//! Rotations as 3x3 matrices, nine numbers row by row.
//!
//! Rodrigues' formula, `exp(omega^) = cos(theta) I + A omega^ + B omega omega'` with `theta = |omega|`, `A = sin(theta) / theta`
//! and `B = (1 - cos(theta)) / theta^2`. A and B are functions of `theta^2`: near zero they are evaluated by their series,
//! because the square root that gives theta has no derivative there.

use nalgebra::Matrix3;

use super::{Manifold, Scalar};

/// Below this `theta^2` the series are used; their remainder is then under 1e-17.
const SERIES: f64 = 1e-2;

/// Rotations by matrix: `R <- exp(omega^) R`.
#[derive(Debug, Clone, Copy)]
pub struct So3;

impl Manifold for So3 {
    const AMBIENT: usize = 9;
    const TANGENT: usize = 3;
    type Point<D: Scalar> = [D; 9];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        let rotation: &[f64; 9] = x.first_chunk().expect("a rotation matrix has nine entries");
        out[..9].copy_from_slice(exp_times([delta[0], delta[1], delta[2]], rotation).as_flattened());
    }

    fn normalize(x: &mut [f64]) {
        orthonormalize(x.first_chunk_mut().expect("a rotation matrix has nine entries"));
    }

    /// `R R' = I`, and R is no reflection.
    fn contains(x: &[f64], tolerance: f64) -> bool {
        let r = Matrix3::from_row_slice(&x[..9]);
        let defect = (r * r.transpose() - Matrix3::identity()).amax();
        // Half of it is how far `normalize` moves.
        defect <= 2.0 * tolerance && r.determinant() > 0.0
    }
}

/// `(sin(theta) / theta, (1 - cos(theta)) / theta^2)` from `t = theta^2`, smooth at 0.
fn rodrigues<D: Scalar>(t: D) -> (D, D) {
    if t.re() < SERIES {
        let series = |c: [f64; 5]| (((t * c[4] + c[3]) * t + c[2]) * t + c[1]) * t + c[0];
        (
            series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0]),
            series([0.5, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40_320.0, 1.0 / 3_628_800.0]),
        )
    } else {
        let theta = t.sqrt();
        let half = (theta * 0.5).sin();
        (theta.sin() / theta, half * half * 2.0 / t)
    }
}

/// The rotation `exp(omega^)` by the angle `|omega|` (radians) about omega, right-handed, as rows.
pub fn exp<D: Scalar>(omega: [D; 3]) -> [[D; 3]; 3] {
    let [x, y, z] = omega;
    let t = x * x + y * y + z * z;
    let (a, b) = rodrigues(t);
    let cos = -(b * t) + 1.0;
    let (xy, xz, yz) = (b * x * y, b * x * z, b * y * z);
    [
        [cos + b * x * x, xy - a * z, xz + a * y],
        [xy + a * z, cos + b * y * y, yz - a * x],
        [xz - a * y, yz + a * x, cos + b * z * z],
    ]
}

/// `exp(omega^) R` as rows; `r` row-major. At omega = 0 the derivative of `exp(omega) R p` is `-[R p]x`.
pub fn exp_times<D: Scalar>(omega: [D; 3], r: &[f64; 9]) -> [[D; 3]; 3] {
    exp(omega).map(|row| std::array::from_fn(|c| row[0] * r[c] + row[1] * r[3 + c] + row[2] * r[6 + c]))
}

/// `R p`; R row-major.
pub fn rotate<D: Scalar>(r: &[D; 9], p: [D; 3]) -> [D; 3] {
    std::array::from_fn(|i| r[3 * i] * p[0] + r[3 * i + 1] * p[1] + r[3 * i + 2] * p[2])
}

/// The nearest rotation to a matrix that is nearly one, by Newton's iteration for the polar factor, `R <- R + (I - R R') R / 2`.
/// A matrix that is orthonormal to rounding is left as it is.
pub fn orthonormalize(r: &mut [f64; 9]) {
    const ROUNDING: f64 = 4.0 * f64::EPSILON;
    for _ in 0..8 {
        let mut defect = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| r[3 * i + k] * r[3 * j + k]).sum();
                defect[i][j] = if i == j { 1.0 - product } else { -product };
            }
        }
        if defect.as_flattened().iter().all(|e| e.abs() <= ROUNDING) {
            return;
        }
        let old = *r;
        for i in 0..3 {
            for j in 0..3 {
                r[3 * i + j] += 0.5 * (0..3).map(|k| defect[i][k] * old[3 * k + j]).sum::<f64>();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};
    use num_dual::DualSVec64;

    use super::*;

    #[test]
    fn exp_agrees_with_nalgebra_on_both_branches() {
        for length in [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.0, 3.0, 6.0] {
            let omega = Vector3::new(1.0, -2.0, 0.5).normalize() * length;
            let ours: [[f64; 3]; 3] = exp([omega.x, omega.y, omega.z]);
            let theirs = Rotation3::new(omega);
            for i in 0..3 {
                for j in 0..3 {
                    assert!((ours[i][j] - theirs[(i, j)]).abs() < 4e-16, "{length}: {ours:?} {theirs}");
                }
            }
        }
    }

    #[test]
    fn derivative_at_zero_is_minus_the_cross_product_matrix() {
        let p = [0.3, -1.2, 2.5];
        let omega = [0, 1, 2].map(|i| DualSVec64::<3>::from(0.0).derivative(i));
        let rows = exp_times(omega, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let expected = [[0.0, p[2], -p[1]], [-p[2], 0.0, p[0]], [p[1], -p[0], 0.0]];
        for i in 0..3 {
            let moved = rows[i][0] * p[0] + rows[i][1] * p[1] + rows[i][2] * p[2];
            assert_eq!(moved.re, p[i]);
            let eps = moved.eps.0.expect("a derivative");
            for j in 0..3 {
                assert_eq!(eps[j], expected[i][j], "row {i}, column {j}");
            }
        }
    }

    #[test]
    fn many_steps_do_not_drift() {
        let mut r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let mut next = r;
        for k in 0..100_000 {
            So3::plus(&r, &[0.3, (k as f64).sin(), -0.2], &mut next);
            So3::normalize(&mut next);
            r = next;
        }
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| r[3 * i + k] * r[3 * j + k]).sum();
                assert!((product - f64::from(i == j)).abs() < 2e-15);
            }
        }
    }
}
