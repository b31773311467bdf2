//! Residuals whose targets the term finds by what it keeps from step to step.

use crate::energy::SampleResidual;
use crate::nlls::Scalar;

/// `residuals` towards what `source` finds. The term's file says how, by [`Scheduled`](super::Scheduled).
#[derive(Debug, Clone, Default)]
pub(super) struct Sourced<T, S> {
    pub residuals: T,
    pub source: S,
}

/// What finds the targets of [`Sourced`] residuals.
pub(super) trait Source: Send + Sync {
    /// [`SampleResidual::measures`].
    const MEASURES: bool;
}

impl<T: SampleResidual<R>, S: Source, const R: usize> SampleResidual<R> for Sourced<T, S> {
    fn len(&self) -> usize {
        self.residuals.len()
    }

    fn sample(&self, m: usize) -> usize {
        self.residuals.sample(m)
    }

    fn weight(&self, m: usize) -> f64 {
        self.residuals.weight(m)
    }

    #[inline(always)]
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; R] {
        self.residuals.residual(m, v)
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; R], [[f64; 3]; R]) {
        self.residuals.linearize(m, v)
    }

    fn measures(&self) -> bool {
        S::MEASURES
    }
}
