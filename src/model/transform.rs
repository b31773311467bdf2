//! The motions a node can make, each stated once for any dual number.

use nalgebra::{Matrix3, UnitQuaternion as Rotation};

use super::rotation_fit::closest_rotation;
use crate::nlls::{Euclidean, Manifold, QuaternionSe3, Scalar, Se3, Sim3, UnitQuaternion, so3};

/// An affine map `q -> A q + t` with entries of any number type.
#[derive(Debug, Clone, Copy)]
pub struct AffineMap<D> {
    /// `A`, by rows.
    pub linear: [[D; 3]; 3],
    /// `t`.
    pub translation: [D; 3],
}

impl<D: Scalar> AffineMap<D> {
    /// `A q + t`.
    #[inline(always)]
    pub fn apply(&self, q: [D; 3]) -> [D; 3] {
        std::array::from_fn(|a| {
            let row = &self.linear[a];
            row[0] * q[0] + row[1] * q[1] + row[2] * q[2] + self.translation[a]
        })
    }
}

impl AffineMap<f64> {
    fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|r, c| self.linear[r][c])
    }

    /// The rotation nearest to `A`.
    fn rotation(&self) -> Rotation<f64> {
        closest_rotation(&self.matrix(), &Rotation::identity())
    }
}

/// The entries of a matrix by rows, and those that follow.
fn by_rows(matrix: &Matrix3<f64>, then: impl IntoIterator<Item = f64>) -> Vec<f64> {
    matrix.transpose().iter().copied().chain(then).collect()
}

/// A family of affine node motions. `W` is its tangent dimension: the width of the dual numbers that differentiate the twelve
/// entries of `A` and `t`.
pub trait NodeTransform<const W: usize>: Clone + Send + Sync + 'static {
    /// Where the parameters live; its tangent dimension is `W`.
    type Parameters: Manifold;

    /// Parameters of the identity.
    const IDENTITY: &'static [f64];

    /// The map of a point of the manifold.
    fn map<D: Scalar>(point: &[D]) -> AffineMap<D>;

    /// The point whose map has the `A` nearest to that of `map`, and its `t`.
    fn nearest(map: &AffineMap<f64>) -> Vec<f64>;

    /// How far a map's `A` is from a rotation, `E_rot` being the sum of squares: for motions that are free to leave the
    /// rotations; `None` for those that cannot or should not be held near them.
    #[inline(always)]
    fn rotation_residuals<D: Scalar>(_map: &AffineMap<D>) -> Option<[D; 6]> {
        None
    }
}

/// Rotation and translation, `R q + t`.
#[derive(Debug, Clone, Copy)]
pub struct RigidMotion;

impl NodeTransform<6> for RigidMotion {
    type Parameters = Se3;
    const IDENTITY: &'static [f64] = &Se3::IDENTITY;

    #[inline(always)]
    fn map<D: Scalar>(p: &[D]) -> AffineMap<D> {
        AffineMap {
            linear: [[p[0], p[1], p[2]], [p[3], p[4], p[5]], [p[6], p[7], p[8]]],
            translation: [p[9], p[10], p[11]],
        }
    }

    fn nearest(map: &AffineMap<f64>) -> Vec<f64> {
        by_rows(map.rotation().to_rotation_matrix().matrix(), map.translation)
    }
}

/// [`RigidMotion`] with the rotation as a unit quaternion: the same tangent and so, but for rounding, the same steps.
#[derive(Debug, Clone, Copy)]
pub struct QuaternionMotion;

impl NodeTransform<6> for QuaternionMotion {
    type Parameters = QuaternionSe3;
    const IDENTITY: &'static [f64] = &QuaternionSe3::IDENTITY;

    #[inline(always)]
    fn map<D: Scalar>(p: &[D]) -> AffineMap<D> {
        AffineMap { linear: UnitQuaternion::matrix(&[p[0], p[1], p[2], p[3]]), translation: [p[4], p[5], p[6]] }
    }

    fn nearest(map: &AffineMap<f64>) -> Vec<f64> {
        let q = map.rotation();
        [q.w, q.i, q.j, q.k].into_iter().chain(map.translation).collect()
    }
}

/// [`RigidMotion`] with the rotation as a rotation vector, `R = exp(r^)`: six plain numbers `(r, t)`, and steps add to them.
///
/// The minima are those of the other two, the steps are not. Where `|r|` comes near `2 pi`, turns across `r` no longer change R:
/// two directions are lost, and whoever has to turn so far from the rest pose should choose another parametrisation.
#[derive(Debug, Clone, Copy)]
pub struct AngleAxisMotion;

impl NodeTransform<6> for AngleAxisMotion {
    type Parameters = Euclidean<6>;
    const IDENTITY: &'static [f64] = &[0.0; 6];

    #[inline(always)]
    fn map<D: Scalar>(p: &[D]) -> AffineMap<D> {
        AffineMap { linear: so3::exp([p[0], p[1], p[2]]), translation: [p[3], p[4], p[5]] }
    }

    fn nearest(map: &AffineMap<f64>) -> Vec<f64> {
        map.rotation().scaled_axis().iter().copied().chain(map.translation).collect()
    }
}

/// Rotation, translation and uniform scale, `s R q + t`.
#[derive(Debug, Clone, Copy)]
pub struct SimilarityMotion;

impl NodeTransform<7> for SimilarityMotion {
    type Parameters = Sim3;
    const IDENTITY: &'static [f64] = &Sim3::IDENTITY;

    #[inline(always)]
    fn map<D: Scalar>(p: &[D]) -> AffineMap<D> {
        let rigid = RigidMotion::map(p);
        let scale = p[12].exp();
        AffineMap { linear: rigid.linear.map(|row| row.map(|e| e * scale)), ..rigid }
    }

    fn nearest(map: &AffineMap<f64>) -> Vec<f64> {
        let rotation = map.rotation().to_rotation_matrix();
        let scale = rotation.matrix().tr_mul(&map.matrix()).trace() / 3.0;
        by_rows(rotation.matrix(), map.translation.into_iter().chain([scale.max(f64::MIN_POSITIVE).ln()]))
    }
}

/// Any affine map, `A q + t` (Sumner et al. 2007); `E_rot` keeps `A` near the rotations.
#[derive(Debug, Clone, Copy)]
pub struct AffineMotion;

impl NodeTransform<12> for AffineMotion {
    type Parameters = Euclidean<12>;
    const IDENTITY: &'static [f64] = &Se3::IDENTITY;

    #[inline(always)]
    fn map<D: Scalar>(p: &[D]) -> AffineMap<D> {
        RigidMotion::map(p)
    }

    fn nearest(map: &AffineMap<f64>) -> Vec<f64> {
        by_rows(&map.matrix(), map.translation)
    }

    /// `c_1.c_2, c_1.c_3, c_2.c_3, c_1.c_1 - 1, c_2.c_2 - 1, c_3.c_3 - 1` of the columns of `A`: Sumner et al. 2007, `Rot(A)`.
    ///
    /// As printed, each product of two columns counts once, not twice as in the norm `|A'A - I|^2`: away from the rotations the
    /// energy depends a little on how the template lies in its axes.
    #[inline(always)]
    fn rotation_residuals<D: Scalar>(map: &AffineMap<D>) -> Option<[D; 6]> {
        let a = &map.linear;
        let dot = |i: usize, j: usize| a[0][i] * a[0][j] + a[1][i] * a[1][j] + a[2][i] * a[2][j];
        Some([dot(0, 1), dot(0, 2), dot(1, 2), dot(0, 0) - 1.0, dot(1, 1) - 1.0, dot(2, 2) - 1.0])
    }
}
