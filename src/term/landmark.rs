//! Landmarks: named points of the template, at a vertex or inside a face, pulled to known places: `r = v - c`.

use super::UNIT;
use crate::energy::SampleResidual;
use crate::mesh::Vec3;
use crate::nlls::Scalar;

/// Pulls sample `samples[m]` towards `targets[m]` with weight `weights[m] * scale`.
#[derive(Debug, Clone, Default)]
pub struct Landmarks {
    /// Sample of each landmark.
    pub samples: Vec<usize>,
    /// `c`, millimetres.
    pub targets: Vec<Vec3>,
    /// Weight of each landmark next to the others: `(sigma_0 / sigma)^2` for one of standard deviation `sigma`, where one of
    /// `sigma_0` has weight 1.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, 1 / square millimetre, changed from level to level.
    pub scale: f64,
}

impl SampleResidual<3> for Landmarks {
    fn len(&self) -> usize {
        self.samples.len()
    }

    fn sample(&self, m: usize) -> usize {
        self.samples[m]
    }

    fn weight(&self, m: usize) -> f64 {
        self.scale * self.weights[m]
    }

    #[inline(always)]
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
        let c = self.targets[m];
        std::array::from_fn(|a| v[a] - c[a])
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
        (self.residual(m, v), UNIT)
    }
}
