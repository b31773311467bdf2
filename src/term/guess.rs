//! Pulls towards guesses: point-to-point residuals that say nothing of the noise of the data.

use super::PointToPoint;
use crate::energy::SampleResidual;
use crate::nlls::Scalar;

/// [`PointToPoint`] towards what `source` guesses. Its term's file says how, by [`Scheduled`](super::Scheduled).
#[derive(Debug, Clone, Default)]
pub(super) struct Guess<G> {
    pub pull: PointToPoint,
    pub source: G,
}

impl<G: Send + Sync> SampleResidual<3> for Guess<G> {
    fn len(&self) -> usize {
        self.pull.len()
    }

    fn sample(&self, m: usize) -> usize {
        self.pull.sample(m)
    }

    fn weight(&self, m: usize) -> f64 {
        self.pull.weight(m)
    }

    #[inline(always)]
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
        self.pull.residual(m, v)
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
        self.pull.linearize(m, v)
    }

    fn measures(&self) -> bool {
        false
    }
}
