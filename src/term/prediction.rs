//! Prediction: where the scan says nothing, vertices stay with what the blendshapes predict, `r = v - P b`, with the rigid
//! pose `P` and the blended shape `b` of the last step.

use crate::energy::SampleResidual;
use crate::mesh::Vec3;
use crate::nlls::Scalar;

/// Holds sample `m` (the m-th of the problem's samples) near `targets[m]` with weight `scale * weights[m]`.
#[derive(Debug, Clone, Default)]
pub struct Prediction {
    /// `P b`, millimetres.
    pub targets: Vec<Vec3>,
    /// One where the scan says nothing, zero where it does.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, changed from level to level.
    pub scale: f64,
}

impl SampleResidual<3> for Prediction {
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
}
