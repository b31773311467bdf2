//! Points that must be at their targets exactly: an augmented Lagrangian round any minimiser.
//!
//! ```text
//! minimise E + mu sum_m |s_m - (p_m + u_m)|^2,    then    u_m <- u_m + p_m - s_m
//! ```
//!
//! (M. R. Hestenes, "Multiplier and gradient methods", 1969; scaled form, as in S. Boyd et al., "Distributed optimization and
//! statistical learning via ADMM", 2011, section 3.1.1.) Each round divides the distance by about `mu` over the stiffness that
//! pulls at the pin.

use super::{MorphError, PlacedPoint};
use crate::energy::Samples;
use crate::mesh::Vec3;
use crate::term::Landmarks;

/// Pins hold to this share of the bounding box' diagonal.
pub const PIN_TOLERANCE: f64 = 1e-10;

/// `mu`, against handles of weight 1.
const PIN_WEIGHT: f64 = 1e6;

/// Rounds at most.
const ROUNDS: usize = 40;

/// A round that leaves more than this share of the distance, many times over, is getting nowhere.
const SLOW: f64 = 0.9;

/// The pins' term with its multipliers.
pub(super) struct PinTerm {
    names: Vec<String>,
    targets: Vec<Vec3>,
    /// With `p_m + u_m` as targets.
    landmarks: Landmarks,
    /// Millimetres.
    tolerance: f64,
    rounds: usize,
    last: f64,
}

impl PinTerm {
    /// No pins yet.
    pub fn new(tolerance: f64) -> Self {
        let landmarks = Landmarks { scale: PIN_WEIGHT, ..Landmarks::default() };
        Self { names: Vec::new(), targets: Vec::new(), landmarks, tolerance, rounds: 0, last: f64::INFINITY }
    }

    /// Pins a sample.
    pub fn push(&mut self, pin: &PlacedPoint, sample: usize) {
        self.names.push(pin.name.clone());
        self.targets.push(pin.target);
        self.landmarks.samples.push(sample);
        self.landmarks.targets.push(pin.target);
        self.landmarks.weights.push(1.0);
    }

    /// The term, its targets moved by the multipliers.
    pub fn landmarks(&self) -> &Landmarks {
        &self.landmarks
    }

    /// After a minimisation that led to `vertices`: the largest distance if the pins hold; if not, the targets move for the next one.
    ///
    /// # Errors
    /// When the pins come no nearer.
    pub fn update(&mut self, samples: &Samples, vertices: &[Vec3]) -> Result<Option<f64>, MorphError> {
        let place = |m: usize| samples.position(self.landmarks.samples[m], vertices);
        let misses: Vec<Vec3> = (0..self.targets.len()).map(|m| self.targets[m] - place(m)).collect();
        let distance = misses.iter().map(|miss| miss.norm()).fold(0.0, f64::max);
        if distance <= self.tolerance {
            (self.rounds, self.last) = (0, f64::INFINITY);
            return Ok(Some(distance));
        }
        self.rounds += 1;
        if self.rounds >= ROUNDS || (self.rounds > 3 && distance > SLOW * self.last) {
            let far = (0..misses.len()).max_by(|a, b| misses[*a].norm().total_cmp(&misses[*b].norm()));
            let name = far.map_or_else(String::new, |m| self.names[m].clone());
            (self.rounds, self.last) = (0, f64::INFINITY);
            return Err(MorphError::PinOutOfReach { name, distance });
        }
        self.last = distance;
        self.landmarks.targets.iter_mut().zip(&misses).for_each(|(target, miss)| *target += miss);
        Ok(None)
    }
}
