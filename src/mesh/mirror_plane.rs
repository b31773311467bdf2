//! A plane of symmetry, and the one that best maps points on points.

use nalgebra::{Matrix3, SymmetricEigen};
use serde::Serialize;

use super::Vec3;

/// A plane in which things are mirrored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MirrorPlane {
    /// A point of the plane, millimetres.
    pub point: Vec3,
    /// Unit length; of a face, towards the subject's left where landmarks or a start say which side that is.
    pub normal: Vec3,
}

impl Serialize for MirrorPlane {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Arrays {
            point_mm: [f64; 3],
            normal: [f64; 3],
        }
        Arrays { point_mm: self.point.into(), normal: self.normal.into() }.serialize(serializer)
    }
}

impl MirrorPlane {
    /// The plane through a point, perpendicular to `normal`; `None` when a number is not finite or the normal is 0.
    #[must_use]
    pub fn new(point: Vec3, normal: Vec3) -> Option<Self> {
        let plane = Self { point, normal: normal.try_normalize(1e-12)? };
        (plane.point + plane.normal).iter().all(|c| c.is_finite()).then_some(plane)
    }

    /// Signed distance to the plane, positive on the side that the normal points to, millimetres.
    #[must_use]
    pub fn height(&self, p: Vec3) -> f64 {
        self.normal.dot(&(p - self.point))
    }

    /// The mirror image of a point.
    #[must_use]
    pub fn reflect(&self, p: Vec3) -> Vec3 {
        p - self.normal * (2.0 * self.height(p))
    }

    /// The mirror image of a direction.
    #[must_use]
    pub fn reflect_direction(&self, d: Vec3) -> Vec3 {
        d - self.normal * (2.0 * self.normal.dot(&d))
    }

    /// The plane that minimises `sum w |S(p) - q|^2` over pairs (p, q) and their weights w, where `S` mirrors; a point of the
    /// midline is a pair with itself. `None` when the pairs do not fix it.
    ///
    /// With `c` the weighted mean of all p and q, the plane goes through `c`, and the sum is that of `|p - q|^2` plus `4 n' M n`
    /// with `M = sum w (p - c)(q - c)'`: the normal is the eigenvector of the symmetric part of `M` that has the least
    /// eigenvalue.
    #[must_use]
    pub fn of_pairs(pairs: impl Iterator<Item = (Vec3, Vec3, f64)> + Clone) -> Option<Self> {
        let total: f64 = pairs.clone().map(|p| p.2).sum();
        let point = pairs.clone().map(|(p, q, w)| (p + q) * (0.5 * w)).sum::<Vec3>() / total;
        let mut m = Matrix3::zeros();
        for (p, q, w) in pairs {
            let product = (p - point) * (q - point).transpose() * (0.5 * w);
            m += product + product.transpose();
        }
        if !(total > 0.0 && m.iter().all(|x| x.is_finite())) {
            return None;
        }
        let eigen = SymmetricEigen::new(m);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let [least, next, _] = order.map(|k| eigen.eigenvalues[k]);
        let fixed = next - least > 1e-6 * eigen.eigenvalues.amax();
        fixed.then(|| Self { point, normal: eigen.eigenvectors.column(order[0]).normalize() })
    }

    /// The same plane with its normal towards `direction`.
    #[must_use]
    pub fn towards(self, direction: Vec3) -> Self {
        if self.normal.dot(&direction) < 0.0 { Self { normal: -self.normal, ..self } } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_give_their_plane_and_one_of_them_its_bisector() {
        let plane = MirrorPlane { point: Vec3::new(1.0, -2.0, 3.0), normal: Vec3::new(2.0, -1.0, 0.5).normalize() };
        let points = [[4.0, 1.0, 0.0], [0.0, 7.0, 2.0], [-3.0, 2.0, 9.0], [5.0, 5.0, -1.0]].map(Vec3::from);
        let found = MirrorPlane::of_pairs(points.iter().map(|p| (*p, plane.reflect(*p), 1.0))).unwrap();
        approx::assert_abs_diff_eq!(found.towards(plane.normal).normal, plane.normal, epsilon = 1e-13);
        approx::assert_abs_diff_eq!(plane.height(found.point), 0.0, epsilon = 1e-13);
        let one = MirrorPlane::of_pairs([(Vec3::zeros(), Vec3::new(0.0, 6.0, 0.0), 2.0)].into_iter()).unwrap();
        approx::assert_abs_diff_eq!(one.reflect(Vec3::zeros()), Vec3::new(0.0, 6.0, 0.0), epsilon = 1e-14);
        // Points of the midline alone: a plane through them, if they do not lie on a line.
        let midline = |points: &[[f64; 3]]| {
            MirrorPlane::of_pairs(
                points.iter().map(|p| (Vec3::from(*p), Vec3::from(*p), 1.0)).collect::<Vec<_>>().into_iter(),
            )
        };
        approx::assert_abs_diff_eq!(
            midline(&[[0., 1., 0.], [0., 2., 1.], [0., 0., 4.]]).unwrap().normal.x.abs(),
            1.0,
            epsilon = 1e-12
        );
        assert_eq!(midline(&[[0., 1., 0.], [0., 2., 0.], [0., 5., 0.]]), None);
        assert_eq!(midline(&[]), None);
    }
}
