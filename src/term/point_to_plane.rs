//! Point-to-plane distance, eq. (3) of Klimov 2020 (squared, under the kernel): `r = n . (v - c)`.

use serde::{Deserialize, Serialize};

use super::along;
use super::factory::{BuiltIn, Scheduled, Step, TermLevel};
use crate::energy::{OptionTable, OptionsError, Pointwise, SampleResidual};
use crate::mesh::{MeshError, Vec3};
use crate::nlls::{Kernel, Scalar};

/// Pulls sample `m` towards the plane through `targets[m]` with unit normal `normals[m]`, weight `scale * weights[m]`.
#[derive(Debug, Clone, Default)]
pub struct PointToPlane {
    /// `c`, millimetres.
    pub targets: Vec<Vec3>,
    /// `n`, unit length.
    pub normals: Vec<Vec3>,
    /// Confidence in each target; zero switches a sample off.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, changed from level to level.
    pub scale: f64,
}

impl SampleResidual<1> for PointToPlane {
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
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 1] {
        let (c, n) = (self.targets[m], self.normals[m]);
        [along(v, c, n)]
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; 1], [[f64; 3]; 1]) {
        (self.residual(m, v), [self.normals[m].into()])
    }
}

/// `[level.terms.point_to_plane]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneWeight {
    /// Weight per accepted vertex: 1 unless stated.
    pub weight: f64,
}

impl Default for PlaneWeight {
    fn default() -> Self {
        Self { weight: 1.0 }
    }
}

impl OptionTable for PlaneWeight {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("weight", self.weight)
    }
}

impl Scheduled<1> for PointToPlane {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.scale = level.options.read::<PlaneWeight>()?.weight * level.density;
        Ok(level.kernel)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        self.targets.clone_from(&step.correspondences.points);
        self.normals.clone_from(&step.correspondences.normals);
        self.weights.clone_from(&step.correspondences.weights);
        Ok(())
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<PlaneWeight>("point_to_plane", |_| {
    Ok(Box::new(Pointwise::new("point to plane (3)", PointToPlane::default(), Kernel::None)))
});
