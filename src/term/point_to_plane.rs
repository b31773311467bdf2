//! Point-to-plane distance, eq. (3) of Klimov 2020 (squared, under the kernel): `r = n . (v - c)`.

use super::along;
use crate::energy::SampleResidual;
use crate::mesh::Vec3;
use crate::nlls::Scalar;

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
