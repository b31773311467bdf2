//! The rotation closest to a matrix: the local step of as-rigid-as-possible deformation.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion};

use crate::mesh::Vec3;

/// Newton steps before the singular value decomposition takes over.
const NEWTON_STEPS: usize = 8;

/// The proper rotation `R` (det +1) that maximises `tr(R'A)`: it minimises `sum_k w_k |e_k - R n_k|^2` for
/// `A = sum_k w_k e_k n_k'`.
///
/// Newton's method from `guess`, with `R <- R exp(omega^)` and, for `P = R'A`,
///
/// ```text
///     (tr(P) 1 - (P + P')/2) omega = (P_32 - P_23, P_13 - P_31, P_21 - P_12)
/// ```
///
/// A stationary point with a positive definite matrix on the left is the maximum over all rotations (it has no other local
/// ones). Where Newton's method does not get there in a few steps, or the maximum is not unique, the singular value
/// decomposition answers (Kabsch 1976; Umeyama 1991). The result depends on `guess` by rounding only, unless the maximum is
/// not unique. A matrix that is zero or not finite gives the identity.
pub(super) fn closest_rotation(a: &Matrix3<f64>, guess: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let largest = a.amax();
    if largest <= 0.0 || !a.iter().all(|v| v.is_finite()) {
        return UnitQuaternion::identity();
    }
    let a = a / largest;
    newton(&a, guess).unwrap_or_else(|| by_singular_values(&a))
}

fn newton(a: &Matrix3<f64>, guess: &UnitQuaternion<f64>) -> Option<UnitQuaternion<f64>> {
    let mut q = *guess;
    for _ in 0..NEWTON_STEPS {
        let p = q.to_rotation_matrix().matrix().tr_mul(a);
        let trace = p.trace();
        let h = Matrix3::from_diagonal_element(trace) - (p + p.transpose()) * 0.5;
        let s = Vec3::new(p.m32 - p.m23, p.m13 - p.m31, p.m21 - p.m12);
        // The trace of h is twice that of p; leading minors say whether h is positive definite, and by how much.
        let minor = h.m11 * h.m22 - h.m12 * h.m12;
        let determinant = h.determinant();
        if trace <= 0.0 || h.m11 <= 0.0 || minor <= 0.0 || determinant <= 1e-9 * trace.powi(3) {
            return None;
        }
        let omega = adjugate(&h) * s / determinant;
        q = UnitQuaternion::new_normalize(q.into_inner() * Quaternion::from_parts(1.0, omega * 0.5));
        // Convergence is quadratic at least: the next step would be of order |omega|^2.
        if omega.norm_squared() < 1e-18 {
            return Some(q);
        }
    }
    None
}

/// Determinant times inverse of a symmetric matrix.
fn adjugate(h: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (h.column(0), h.column(1), h.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

fn by_singular_values(a: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let svd = a.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else { return UnitQuaternion::identity() };
    // Singular values descend: a reflection is undone where it costs least.
    let sign = (u * v).determinant().signum();
    let r = u * Matrix3::from_diagonal(&Vec3::new(1.0, 1.0, sign)) * v;
    UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(r))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::noise;

    fn random_matrix(k: usize) -> Matrix3<f64> {
        Matrix3::from_fn(|r, c| noise(9 * k + 3 * r + c))
    }

    fn score(a: &Matrix3<f64>, q: &UnitQuaternion<f64>) -> f64 {
        q.to_rotation_matrix().matrix().tr_mul(a).trace()
    }

    /// `tr(R'A)` at its maximum: the singular values, the least with the determinant's sign.
    fn best(a: &Matrix3<f64>) -> f64 {
        let s = a.singular_values();
        s[0] + s[1] + s[2] * a.determinant().signum()
    }

    #[test]
    fn the_maximum_is_reached_from_any_guess() {
        let mut by_newton = 0;
        for k in 0..400 {
            // Some nearly flat, some nearly on a line, some mirrored.
            let squash = Vec3::new(1.0, [1.0, 0.3, 1e-3][k % 3], [1.0, -1e-2, 0.0, 1e-5][k % 4]);
            let a = random_matrix(k) * Matrix3::from_diagonal(&squash) * 1e-3f64.powi(k as i32 % 3 - 1);
            let guess = UnitQuaternion::from_euler_angles(noise(k) * 3.0, noise(k + 7) * 3.0, noise(k + 9) * 3.0);
            let found = [UnitQuaternion::identity(), guess].map(|g| closest_rotation(&a, &g));
            for q in &found {
                approx::assert_relative_eq!(score(&a, q), best(&a), max_relative = 1e-12);
                approx::assert_abs_diff_eq!(q.norm(), 1.0, epsilon = 1e-15);
            }
            let again = newton(&(a / a.amax()), &found[0]);
            by_newton += usize::from(again.is_some());
        }
        assert!(by_newton > 200, "Newton's method answered {by_newton} of 400");
    }

    #[test]
    fn a_rotation_is_its_own_closest() {
        for k in 0..50 {
            let r = UnitQuaternion::from_euler_angles(noise(k) * 3.0, noise(k + 50), noise(k + 90) * 3.0);
            let found = closest_rotation(r.to_rotation_matrix().matrix(), &UnitQuaternion::identity());
            assert!(
                found.angle_to(&r) < 1e-14 || found.angle_to(&r) > std::f64::consts::TAU - 1e-2,
                "{}",
                found.angle_to(&r)
            );
        }
    }

    #[test]
    fn lines_points_and_nonsense_give_a_rotation() {
        let turn = UnitQuaternion::from_euler_angles(1.0, 2.0, 0.5);
        let (n, e) = (Vec3::new(1.0, 2.0, -1.0), Vec3::new(-2.0, 0.0, 3.0));
        let line = closest_rotation(&(e * n.transpose()), &turn);
        approx::assert_abs_diff_eq!(line * n.normalize(), e.normalize(), epsilon = 1e-12);
        // Turned by half a turn: the maximum is not unique in its axis.
        let back = closest_rotation(&(-n * n.transpose()), &UnitQuaternion::identity());
        approx::assert_abs_diff_eq!(back * n, -n, epsilon = 1e-12);
        for a in [Matrix3::zeros(), Matrix3::from_element(f64::NAN), Matrix3::from_element(f64::INFINITY)] {
            assert_eq!(closest_rotation(&a, &turn), UnitQuaternion::identity());
        }
    }
}
