//! Data terms: one file each. Each is a residual of one sample's position; see [`SampleResidual`](crate::energy::SampleResidual).

mod factory;
mod landmark;
mod point_to_plane;
mod point_to_point;
mod prediction;
mod scan_points;
mod scan_to_template;
mod seam;
mod sourced;
mod symmetric;

pub use factory::{
    RegistrationTerm, Scheduled, Step, TermError, TermFactory, TermInput, TermLandmark, TermLevel, TermWeight,
};
pub use landmark::{LandmarkLevel, Landmarks};
pub use point_to_plane::{PlaneWeight, PointToPlane};
pub use point_to_point::PointToPoint;
pub use scan_points::ScanPoints;
pub use scan_to_template::ScanToTemplate;
pub use seam::{SeamOptions, Seams};
pub use symmetric::Symmetric;

/// The terms that come with the crate. Which of them take part is a matter of the schedule's weights.
pub const TERMS: [&dyn TermFactory; 7] = [
    &point_to_plane::TERM,
    &symmetric::TERM,
    &scan_to_template::TERM,
    &point_to_point::TERM,
    &landmark::TERM,
    &prediction::TERM,
    &seam::TERM,
];

use crate::mesh::Vec3;
use crate::nlls::Scalar;

/// `(v - c) . n`: the distance of `v` from the plane through `c` with normal `n`.
#[inline(always)]
fn along<D: Scalar>(v: [D; 3], c: Vec3, n: Vec3) -> D {
    (v[0] - c[0]) * n[0] + (v[1] - c[1]) * n[1] + (v[2] - c[2]) * n[2]
}

/// Derivatives of `v` by itself.
const UNIT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::SampleResidual;

    /// The same residual, differentiated by dual numbers.
    struct ByDuals<'a, T>(&'a T);

    impl<T: SampleResidual<R>, const R: usize> SampleResidual<R> for ByDuals<'_, T> {
        fn len(&self) -> usize {
            self.0.len()
        }
        fn sample(&self, m: usize) -> usize {
            self.0.sample(m)
        }
        fn weight(&self, m: usize) -> f64 {
            self.0.weight(m)
        }
        fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; R] {
            self.0.residual(m, v)
        }
    }

    fn same<T: SampleResidual<R>, const R: usize>(term: &T) {
        let v = [0.3, -1.7, 2.9];
        assert_eq!(term.linearize(0, v), ByDuals(term).linearize(0, v));
    }

    #[test]
    fn what_terms_say_of_their_derivatives_is_what_dual_numbers_find() {
        let (c, n, o) = (Vec3::new(0.1, 0.7, -2.0), Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.0, 1.0, 0.0));
        let ([targets, normals, other], weights, scale) = ([vec![c], vec![n], vec![o]], vec![1.0], 2.0);
        same(&PointToPoint { targets: targets.clone(), weights: weights.clone(), scale });
        same(&Landmarks { samples: vec![0], targets: targets.clone(), weights: weights.clone(), scale });
        same(&PointToPlane { targets: targets.clone(), normals: normals.clone(), weights: weights.clone(), scale });
        let [source_normals, target_normals] = [other, normals.clone()];
        same(&Symmetric { targets: targets.clone(), source_normals, target_normals, weights: weights.clone(), scale });
        same(&ScanToTemplate { samples: vec![0], targets, normals, weights, scale });
    }
}
