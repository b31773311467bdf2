//! Point-to-point distance, eq. (2) of Klimov 2020 (squared, under the kernel): `r = v - c`.

use super::UNIT;
use super::factory::{BuiltIn, Scheduled, Step, TermLevel, TermWeight};
use crate::energy::{OptionsError, Pointwise, SampleResidual};
use crate::mesh::{MeshError, Vec3};
use crate::nlls::{Kernel, Scalar};

/// Pulls sample `m` (the m-th of the problem's samples) towards `targets[m]` with weight `scale * weights[m]`.
#[derive(Debug, Clone, Default)]
pub struct PointToPoint {
    /// `c`, millimetres.
    pub targets: Vec<Vec3>,
    /// Confidence in each target; zero switches a sample off.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, changed from level to level.
    pub scale: f64,
}

impl SampleResidual<3> for PointToPoint {
    fn len(&self) -> usize {
        self.targets.len()
    }

    fn sample(&self, m: usize) -> usize {
        m
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

impl Scheduled<3> for PointToPoint {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(level.kernel)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        self.targets.clone_from(&step.correspondences.points);
        self.weights.clone_from(&step.correspondences.weights);
        Ok(())
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<TermWeight>("point_to_point", |_| {
    Ok(Box::new(Pointwise::new("point to point (2)", PointToPoint::default(), Kernel::None)))
});
