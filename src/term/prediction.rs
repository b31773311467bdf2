//! Where the scan says nothing: `r = v - c`, with `c` where the blendshapes in one rigid pose predict the vertex.
//!
//! For subjects that are rigid as a whole, if at all: a limb that moves is torn off.
//! [`GraphOptions::lambda_unseen`](crate::model::GraphOptions::lambda_unseen) holds to the form instead.

use super::PointToPoint;
use super::factory::{BuiltIn, Scheduled, Step, TermLevel, TermWeight};
use super::sourced::{Source, Sourced};
use crate::energy::{OptionsError, Pointwise};
use crate::mesh::MeshError;
use crate::nlls::Kernel;

/// Pulls vertices without an accepted correspondence to their predictions, without a kernel.
#[derive(Debug, Clone, Default)]
struct Prediction;

impl Source for Prediction {
    const MEASURES: bool = false;
}

impl Scheduled<3> for Sourced<PointToPoint, Prediction> {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.residuals.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(Kernel::None)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        if self.needs_predictions() {
            self.residuals.targets.clear();
            self.residuals.targets.extend_from_slice(step.predictions);
            self.residuals.weights.clone_from(&step.correspondences.unseen);
        }
        Ok(())
    }

    fn needs_predictions(&self) -> bool {
        self.residuals.scale > 0.0
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<TermWeight>("prediction", |_| {
    Ok(Box::new(Pointwise::new("prediction", Sourced::<PointToPoint, Prediction>::default(), Kernel::None)))
});
