//! How a person makes an expression: never quite as the rig does.

use std::f64::consts::TAU;

use nonrigid::mesh::Vec3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::face::Site;

/// Plane waves along each axis.
const WAVES: usize = 3;

/// Factors of the rig's displacements along x, y and z that vary slowly over the face: no weights of the rig's expressions
/// reach what comes out, as with real people. Lids keep closing: at the eyes the factors are 1.
pub(super) struct Manner {
    amount: f64,
    /// Per axis: wave vector in the chart and phase.
    waves: [[([f64; 2], f64); WAVES]; 3],
}

impl Manner {
    /// Factors of 1 - `amount` to 1 + `amount`.
    pub fn new(amount: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut wave = || {
            let (sin, cos) = rng.random_range(0.0..TAU).sin_cos();
            let number = TAU / rng.random_range(70.0..160.0);
            ([number * cos, number * sin], rng.random_range(0.0..TAU))
        };
        Self { amount, waves: [0; 3].map(|_| [0; WAVES].map(|_| wave())) }
    }

    pub fn at(&self, site: &Site) -> Vec3 {
        let lid = (site.left_eye.r.min(site.right_eye.r) / 8.0).clamp(0.0, 1.0);
        let strength = self.amount * lid * lid * (3.0 - 2.0 * lid);
        let sine = |([kx, ky], phase): &([f64; 2], f64)| (kx * site.x + ky * site.y + phase).sin();
        Vec3::from_fn(|axis, _| 1.0 + strength * self.waves[axis].iter().map(sine).sum::<f64>() / WAVES as f64)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::face::{Around, FaceModel, eye_point, flatten, site};

    #[test]
    fn factors_vary_within_their_range_leave_the_lids_alone_and_do_not_part_lips() {
        let (model, amount) = (FaceModel::new(0), 0.3);
        let manner = Manner::new(amount, &mut ChaCha8Rng::seed_from_u64(3));
        let places =
            (0..60).flat_map(|i| (0..60).map(move |j| [f64::from(i) * 3.2 - 95.0, f64::from(j) * 3.6 - 135.0]));
        let factors: Vec<Vec3> = places.filter(|p| model.contains(*p)).map(|p| manner.at(&site(p))).collect();
        assert!(factors.len() > 1000);
        for axis in 0..3 {
            let along = || factors.iter().map(|f| f[axis]);
            let (low, high) = (along().fold(f64::MAX, f64::min), along().fold(f64::MIN, f64::max));
            assert!(low >= 1.0 - amount && high <= 1.0 + amount && high - low > 0.5 * amount, "{low} {high}");
        }
        for k in 0..40 {
            let eta = 0.155 * f64::from(k) - 3.1;
            let [x, y] = eye_point(Around { r: 0.0, eta });
            assert_eq!(manner.at(&site(flatten([x, y]))), Vec3::repeat(1.0));
            let lip = |eta: f64| [25.5 * eta.cos(), -68.0 + 4.2 * eta.sin()];
            let [upper, lower] = [lip(eta), lip(-eta)].map(|place| manner.at(&site(place)));
            assert!((upper - lower).norm() < 1e-6, "{upper} {lower}");
        }
    }
}
