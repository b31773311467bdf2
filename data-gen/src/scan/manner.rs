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
