//! The similarity of a vertex' star, as Laplacian surface editing fits it to the positions (Sorkine et al. 2004, eqs. (5), (6)).
//!
//! ```text
//!     T = s + h^  minimises  sum_(k in the star) |T n_k + t - v_k|^2
//! ```
//!
//! It is a similarity to first order in its turn, so it is linear in `v`: with `p_k` the members of the star about their mean,
//!
//! ```text
//!     s = sum_k p_k.v_k / sum_k |p_k|^2        h = D^-1 sum_k p_k x v_k        D = sum_k (|p_k|^2 1 - p_k p_k')
//! ```
//!
//! (their `(A'A)^-1 A'` without a matrix). Large turns it gets wrong, as the paper says. So [`Frames::Current`] first turns the star by the
//! best rotation for `v`, `p_k <- R p_k`, and takes `T` round it. Then `h = 0`, and `s R` is the best of all similarities; the turn's
//! derivative is exact with `D = sum_k (p_k.v_k 1 - v_k p_k')`.

use nalgebra::{Matrix3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::rotation_fit::closest_rotation;
use crate::mesh::Vec3;

/// What the similarities are linearised round.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frames {
    /// Every star's best rotation now.
    #[default]
    Current,
    /// The rest shape: the paper's linear system.
    Rest,
}

/// Part of the trace of `D` added to its diagonal: stars on a line turn freely round it.
const TURN_FLOOR: f64 = 1e-12;

/// A vertex and its neighbours.
pub(super) struct Star {
    pub members: Vec<u32>,
    /// Rest positions about their mean.
    rest: Vec<Vec3>,
    /// `1 / sum |rest|^2`; 0 if they all lie in one point.
    compactness: f64,
}

#[derive(Clone, Copy)]
pub(super) struct StarFit {
    quaternion: UnitQuaternion<f64>,
    /// Of `quaternion`.
    rotation: Matrix3<f64>,
    scale: f64,
    turn: Vec3,
    /// `D^-1`; zero where there is none.
    inverse: Matrix3<f64>,
}

impl Star {
    pub fn new(i: usize, neighbours: &[(u32, f64)], n: &[Vec3]) -> Self {
        let members: Vec<u32> = std::iter::once(i as u32).chain(neighbours.iter().map(|s| s.0)).collect();
        let mean = members.iter().map(|&k| n[k as usize]).sum::<Vec3>() / members.len() as f64;
        let rest: Vec<Vec3> = members.iter().map(|&k| n[k as usize] - mean).collect();
        let spread: f64 = rest.iter().map(Vec3::norm_squared).sum();
        Self { members, rest, compactness: if spread > 0.0 { 1.0 / spread } else { 0.0 } }
    }
}

impl StarFit {
    pub fn identity() -> Self {
        Self {
            quaternion: UnitQuaternion::identity(),
            rotation: Matrix3::identity(),
            scale: 1.0,
            turn: Vec3::zeros(),
            inverse: Matrix3::zeros(),
        }
    }

    /// `T delta`.
    pub fn apply(&self, delta: Vec3) -> Vec3 {
        let turned = self.rotation * delta;
        turned * self.scale + self.turn.cross(&turned)
    }

    /// `d(T delta)/dv_k` as a function of which member of the star `k` is.
    pub fn derivative<'a>(
        &'a self,
        star: &'a Star,
        frames: Frames,
        delta: Vec3,
    ) -> impl Fn(usize) -> Matrix3<f64> + 'a {
        let turned = self.rotation * delta;
        let lever = match frames {
            Frames::Current => turned * self.scale,
            Frames::Rest => turned,
        };
        // ds R delta + d omega x lever, with d omega = D^-1 sum_k p_k x dv_k
        let by_turn = -lever.cross_matrix() * self.inverse;
        move |member| {
            let p = self.rotation * star.rest[member];
            turned * (p * star.compactness).transpose() + by_turn * p.cross_matrix()
        }
    }

    pub fn update(&mut self, star: &Star, frames: Frames, v: &[Vec3]) {
        let pairs = || star.members.iter().map(|&k| v[k as usize]).zip(&star.rest);
        // The mean of `rest` is zero: so `v` need not be centred, but for rounding.
        let origin = v[star.members[0] as usize];
        let spread: Matrix3<f64> = pairs().map(|(v, p)| (v - origin) * p.transpose()).sum();
        if frames == Frames::Current {
            self.quaternion = closest_rotation(&spread, &self.quaternion);
            self.rotation = self.quaternion.to_rotation_matrix().into_inner();
        }
        // sum (v p') R'
        let s = spread * self.rotation.transpose();
        self.scale = if star.compactness > 0.0 { s.trace() * star.compactness } else { 1.0 };
        let own = match frames {
            Frames::Current => (s + s.transpose()) * 0.5,
            Frames::Rest => star.rest.iter().map(|p| p * p.transpose()).sum(),
        };
        let d = Matrix3::from_diagonal_element(own.trace() * (1.0 + TURN_FLOOR)) - own;
        self.inverse = d.cholesky().map_or_else(Matrix3::zeros, |factor| factor.inverse());
        self.turn = match frames {
            Frames::Current => Vec3::zeros(),
            // sum p x v
            Frames::Rest => self.inverse * Vec3::new(s.m32 - s.m23, s.m13 - s.m31, s.m21 - s.m12),
        };
    }
}
