//! The motions a node can make, each stated once for any dual number.

use num_dual::DualNum;

use crate::nlls::so3;

/// An affine map `q -> A q + t` with entries of any number type.
#[derive(Debug, Clone, Copy)]
pub struct AffineMap<D> {
    /// `A`, by rows.
    pub linear: [[D; 3]; 3],
    /// `t`.
    pub translation: [D; 3],
}

impl<D: DualNum<Primitive = f64> + Copy> AffineMap<D> {
    /// `A q + t`.
    #[inline(always)]
    pub fn apply(&self, q: [D; 3]) -> [D; 3] {
        std::array::from_fn(|a| {
            let row = &self.linear[a];
            row[0] * q[0] + row[1] * q[1] + row[2] * q[2] + self.translation[a]
        })
    }
}

/// A family of node motions with `W - 3` tangent parameters (`W` counts the three coordinates of the moved point too:
/// the width of the dual numbers that differentiate `A q + t`).
pub trait NodeTransform<const W: usize>: Clone + Send + Sync + 'static {
    /// Number of stored parameters.
    const AMBIENT: usize;

    /// Parameters of the identity.
    fn identity(out: &mut [f64]);

    /// The map at `parameters` moved by `tangent`; derivatives are taken at `tangent = 0`.
    fn map<D: DualNum<Primitive = f64> + Copy>(parameters: &[f64], tangent: &[D]) -> AffineMap<D>;

    /// Writes `parameters` moved by `step` to `out`.
    fn retract(parameters: &[f64], step: &[f64], out: &mut [f64]);
}

/// Rotation and translation, SE(3): nine numbers of `R` by rows and three of `t`; `R <- exp(omega^) R`, `t <- t + tau`.
#[derive(Debug, Clone, Copy)]
pub struct RigidMotion;

impl NodeTransform<9> for RigidMotion {
    const AMBIENT: usize = 12;

    fn identity(out: &mut [f64]) {
        out.copy_from_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    }

    #[inline(always)]
    fn map<D: DualNum<Primitive = f64> + Copy>(p: &[f64], tangent: &[D]) -> AffineMap<D> {
        AffineMap {
            linear: so3::exp_times([tangent[0], tangent[1], tangent[2]], rotation(p)),
            translation: std::array::from_fn(|a| tangent[3 + a] + p[9 + a]),
        }
    }

    fn retract(p: &[f64], step: &[f64], out: &mut [f64]) {
        out[..9].copy_from_slice(&so3::retract(rotation(p), [step[0], step[1], step[2]]));
        for a in 0..3 {
            out[9 + a] = p[9 + a] + step[3 + a];
        }
    }
}

/// Rotation, translation and uniform scale, Sim(3): `R`, `t`, then `log s`; the map is `s R q + t`.
#[derive(Debug, Clone, Copy)]
pub struct SimilarityMotion;

impl NodeTransform<10> for SimilarityMotion {
    const AMBIENT: usize = 13;

    fn identity(out: &mut [f64]) {
        RigidMotion::identity(&mut out[..12]);
        out[12] = 0.0;
    }

    #[inline(always)]
    fn map<D: DualNum<Primitive = f64> + Copy>(p: &[f64], tangent: &[D]) -> AffineMap<D> {
        let scale = (tangent[6] + p[12]).exp();
        let rigid = RigidMotion::map(&p[..12], &tangent[..6]);
        AffineMap { linear: rigid.linear.map(|row| row.map(|e| e * scale)), translation: rigid.translation }
    }

    fn retract(p: &[f64], step: &[f64], out: &mut [f64]) {
        RigidMotion::retract(&p[..12], &step[..6], &mut out[..12]);
        out[12] = p[12] + step[6];
    }
}

fn rotation(p: &[f64]) -> &[f64; 9] {
    p[..9].try_into().expect("proven: nine of at least twelve parameters")
}
