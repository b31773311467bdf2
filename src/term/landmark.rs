//! Landmarks: named points of the template, at a vertex or inside a face, pulled to known places: `r = v - c`.

use serde::{Deserialize, Serialize};

use super::UNIT;
use super::factory::{BuiltIn, Scheduled, TermLevel};
use crate::energy::{OptionTable, OptionsError, Pointwise, SampleResidual};
use crate::mesh::Vec3;
use crate::nlls::{Kernel, Scalar};

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

/// `[level.terms.landmarks]`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LandmarkLevel {
    /// Weight of each landmark, 1 / square millimetre; times `(sigma_0 / sigma)^2` where it states sigma.
    pub weight: f64,
    /// Robust kernel, scale in millimetres: a landmark that is wrong by much pulls no more than one at the scale.
    pub kernel: Kernel,
}

impl OptionTable for LandmarkLevel {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("weight", self.weight)?;
        OptionsError::kernel(self.kernel)
    }
}

impl Scheduled<3> for Landmarks {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        let LandmarkLevel { weight, kernel } = level.options.read()?;
        self.scale = weight;
        Ok(kernel.scaled(level.unit))
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<LandmarkLevel>("landmarks", |input| {
    let samples = input.landmarks.iter().map(|l| l.sample).collect();
    let targets = input.landmarks.iter().map(|l| l.target).collect();
    let weights = input.landmarks.iter().map(|l| l.weight).collect();
    let residuals = Landmarks { samples, targets, weights, scale: 0.0 };
    Ok(Box::new(Pointwise::new("landmarks", residuals, Kernel::None)))
});
