//! Rigid motions and similarities, and the one that best maps points to points.

use nalgebra::{Matrix3, Rotation3, SVD};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Vec3;

/// A similarity `p -> s R p + t`; rigid when `s = 1`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// `s`.
    pub scale: f64,
    /// `R`, a rotation.
    #[serde(serialize_with = "by_rows", deserialize_with = "of_rows")]
    pub rotation: Matrix3<f64>,
    /// `t`, millimetres.
    #[serde(serialize_with = "as_array", deserialize_with = "of_array")]
    pub translation: Vec3,
}

fn by_rows<S: serde::Serializer>(m: &Matrix3<f64>, s: S) -> Result<S::Ok, S::Error> {
    let rows: [[f64; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
    rows.serialize(s)
}

fn as_array<S: serde::Serializer>(v: &Vec3, s: S) -> Result<S::Ok, S::Error> {
    <[f64; 3]>::from(*v).serialize(s)
}

fn of_rows<'de, D: serde::Deserializer<'de>>(d: D) -> Result<Matrix3<f64>, D::Error> {
    let rows = <[[f64; 3]; 3]>::deserialize(d)?;
    Ok(Matrix3::from_fn(|r, c| rows[r][c]))
}

fn of_array<'de, D: serde::Deserializer<'de>>(d: D) -> Result<Vec3, D::Error> {
    <[f64; 3]>::deserialize(d).map(Vec3::from)
}

impl Pose {
    /// The identity.
    #[must_use]
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: Matrix3::identity(), translation: Vec3::zeros() }
    }

    /// A rigid motion: a turn by the length of `turn`, in radians, about its direction, and a translation.
    #[must_use]
    pub fn rigid(turn: Vec3, translation: Vec3) -> Self {
        Self { scale: 1.0, rotation: Rotation3::new(turn).into_inner(), translation }
    }

    /// `s R p + t`.
    #[must_use]
    pub fn apply(&self, p: Vec3) -> Vec3 {
        self.rotation * p * self.scale + self.translation
    }

    /// First `first`, then this.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let (scale, rotation) = (self.scale * first.scale, self.rotation * first.rotation);
        Self { scale, rotation, translation: self.apply(first.translation) }
    }

    /// `R' (p - t) / s`.
    #[must_use]
    pub fn apply_inverse(&self, p: Vec3) -> Vec3 {
        self.rotation.tr_mul(&(p - self.translation)) / self.scale
    }
}

/// Whether a pose may scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseKind {
    /// Rotation and translation.
    #[default]
    Rigid,
    /// Rotation, translation and scale.
    Similarity,
}

/// Why point pairs do not determine a pose.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PoseError {
    /// Too few pairs.
    #[error("{0} point pairs do not determine a pose; at least 3 are needed")]
    TooFew(usize),
    /// All points on one line, or in one point.
    #[error("the {0} point pairs lie on a line, so the rotation about it is unknown; add one off that line")]
    Collinear(usize),
}

/// The pose minimising `sum |s R p_i + t - q_i|^2` (Horn 1987; Umeyama 1991, which never answers with a reflection).
pub fn closest_pose(pairs: &[(Vec3, Vec3)], kind: PoseKind) -> Result<Pose, PoseError> {
    weighted_closest_pose(pairs.iter().map(|&(p, q)| (p, q, 1.0)), kind)
}

/// [`closest_pose`] of (p, q, weight).
pub(crate) fn weighted_closest_pose(
    pairs: impl Iterator<Item = (Vec3, Vec3, f64)> + Clone,
    kind: PoseKind,
) -> Result<Pose, PoseError> {
    let count = pairs.clone().filter(|p| p.2 > 0.0).count();
    if count < 3 {
        return Err(PoseError::TooFew(count));
    }
    let total: f64 = pairs.clone().map(|p| p.2).sum();
    let mean_p: Vec3 = pairs.clone().map(|(p, _, w)| p * w).sum::<Vec3>() / total;
    let mean_q: Vec3 = pairs.clone().map(|(_, q, w)| q * w).sum::<Vec3>() / total;
    let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
    for (p, q, w) in pairs {
        covariance += (q - mean_q) * (p - mean_p).transpose() * w;
        variance += w * (p - mean_p).norm_squared();
    }
    let svd = SVD::new(covariance, true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(PoseError::Collinear(count)) };
    let spread = svd.singular_values[1] > 1e-9 * svd.singular_values[0];
    if !spread {
        return Err(PoseError::Collinear(count));
    }
    let mut signs = Vec3::new(1.0, 1.0, 1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        signs[2] = -1.0;
    }
    let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
    let scale = match kind {
        PoseKind::Rigid => 1.0,
        PoseKind::Similarity => svd.singular_values.dot(&signs) / variance,
    };
    Ok(Pose { scale, rotation, translation: mean_q - rotation * mean_p * scale })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Vec3> {
        vec![
            Vec3::new(1.0, 2.0, 3.0),
            Vec3::new(-4.0, 0.5, 1.0),
            Vec3::new(2.0, -3.0, 0.1),
            Vec3::new(7.0, 1.0, -2.0),
            Vec3::new(0.0, 5.0, 4.0),
        ]
    }

    #[test]
    fn recovers_a_similarity_and_its_inverse_undoes_it() {
        let truth = Pose {
            scale: 1.7,
            rotation: Rotation3::from_euler_angles(0.3, -1.2, 2.8).into_inner(),
            translation: Vec3::new(10.0, -20.0, 3.0),
        };
        let pairs: Vec<_> = points().iter().map(|&p| (p, truth.apply(p))).collect();
        let found = closest_pose(&pairs, PoseKind::Similarity).expect("five points in general position");
        for (p, q) in pairs {
            approx::assert_abs_diff_eq!(found.apply(p), q, epsilon = 1e-11);
            approx::assert_abs_diff_eq!(found.apply_inverse(q), p, epsilon = 1e-11);
        }
        approx::assert_abs_diff_eq!(found.scale, 1.7, epsilon = 1e-12);
    }

    #[test]
    fn never_reflects() {
        let pairs: Vec<_> = points().iter().map(|&p| (p, Vec3::new(-p.x, p.y, p.z))).collect();
        let found = closest_pose(&pairs, PoseKind::Rigid).expect("five points in general position");
        approx::assert_abs_diff_eq!(found.rotation.determinant(), 1.0, epsilon = 1e-12);
    }

    #[test]
    fn too_few_and_collinear_points_are_named() {
        let line: Vec<_> = (0..4).map(|i| (Vec3::x() * i as f64, Vec3::y() * i as f64)).collect();
        assert_eq!(closest_pose(&line, PoseKind::Rigid), Err(PoseError::Collinear(4)));
        assert_eq!(closest_pose(&line[..2], PoseKind::Rigid), Err(PoseError::TooFew(2)));
    }

    #[test]
    fn a_rigid_motion_turns_about_its_vector() {
        let turned = Pose::rigid(Vec3::z() * std::f64::consts::FRAC_PI_2, Vec3::new(5.0, 0.0, 0.0)).apply(Vec3::x());
        approx::assert_abs_diff_eq!(turned, Vec3::new(5.0, 1.0, 0.0), epsilon = 1e-15);
        assert_eq!(Pose::rigid(Vec3::zeros(), Vec3::zeros()), Pose::identity());
    }
}
