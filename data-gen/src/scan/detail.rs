//! Relief that no shape expresses: wrinkles where faces have them, and the structure of skin, as a height over the flat face.

use std::f64::consts::TAU;

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::WrinkleMix;
use crate::Flat;
use crate::face::{EYEBALL, bell, fade};

/// A plane wave: wave vector, phase, amplitude.
type Wave = ([f64; 2], f64, f64);

/// The relief of one person.
pub(super) struct Detail {
    height: f64,
    mix: WrinkleMix,
    /// Phases of the lines.
    phases: [f64; 8],
    waves: Vec<Wave>,
}

impl Detail {
    /// At most `height` millimetres up or down.
    pub fn new(height: f64, mix: WrinkleMix, rng: &mut ChaCha8Rng) -> Self {
        let phases = std::array::from_fn(|_| rng.random_range(0.0..TAU));
        let mut wave = |short: f64, long: f64, amplitude: f64| {
            let (sin, cos) = rng.random_range(0.0..TAU).sin_cos();
            let number = TAU / rng.random_range(short..long);
            ([number * cos, number * sin], rng.random_range(0.0..TAU), amplitude)
        };
        let mut waves: Vec<Wave> = (0..5).map(|_| wave(9.0, 20.0, 0.10)).collect();
        waves.extend((0..8).map(|_| wave(2.5, 6.0, 0.035)));
        Self { height, mix, phases, waves }
    }

    /// Millimetres along the surface's normal, outwards.
    pub fn height(&self, [u, v]: Flat) -> f64 {
        if self.height == 0.0 {
            return 0.0;
        }
        let mix = &self.mix;
        let relief = mix.skin * self.skin(u, v)
            - mix.forehead * self.forehead(u, v)
            - mix.crows_feet * self.crows_feet(u, v)
            - mix.folds * self.folds(u, v);
        self.height * relief.tanh()
    }

    fn skin(&self, u: f64, v: f64) -> f64 {
        self.waves.iter().map(|([a, b], phase, amplitude)| amplitude * (a * u + b * v + phase).sin()).sum()
    }

    /// Grooves that wave across, each deep in places only.
    fn forehead(&self, u: f64, v: f64) -> f64 {
        let window = bell(u, 36.0) * fade((v - 30.0) / 6.0) * fade((68.0 - v) / 7.0);
        if window < 1e-4 {
            return 0.0;
        }
        let p = &self.phases;
        let along = TAU / 8.5 * v + 0.9 * (u / 13.0 + p[0]).sin() + p[1];
        let depth = 0.65 + 0.35 * (u / 9.0 + v / 6.0 + p[2]).sin();
        0.9 * window * depth * groove(along)
    }

    /// A fan of grooves from each outer corner.
    fn crows_feet(&self, u: f64, v: f64) -> f64 {
        let (x, y) = (u.abs() - 41.0, v - 0.5);
        let distance = x.hypot(y);
        if distance > 35.0 || x < 0.0 {
            return 0.0;
        }
        let angle = y.atan2(x);
        let window = bell(distance - 14.0, 4.5) * bell(angle, 0.55) * fade((x - 5.0) / 2.0);
        0.8 * window * groove(9.0 * angle + self.phases[if u > 0.0 { 3 } else { 4 }])
    }

    /// From the nose's wings down past the mouth's corners, and along the lower rims of the sockets.
    fn folds(&self, u: f64, v: f64) -> f64 {
        let x = u.abs();
        let side = usize::from(u > 0.0);
        let line = 22.5 + 0.36 * (-42.0 - v) + 0.8 * (v / 7.0 + self.phases[5 + side]).sin();
        let nose = bell(x - line, 1.7) * fade((-40.0 - v) / 5.0) * fade((v + 84.0) / 6.0);
        let (a, b) = (x - EYEBALL.0[0], 1.35 * v);
        let rim = a.hypot(b) + 0.7 * (a / 6.0 + self.phases[7]).sin() - 18.5;
        let eye = bell(rim, 1.4) * fade((-v - 6.0) / 3.0) * bell(a + 4.0, 12.0);
        0.8 * nose + 0.6 * eye
    }
}

/// Narrow valleys with broad ridges between.
fn groove(phase: f64) -> f64 {
    let c = 0.5 + 0.5 * phase.cos();
    c * c * c
}
