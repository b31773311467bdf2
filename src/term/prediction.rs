//! Where the scan says nothing: `r = v - c`, with `c` where the blendshapes in one rigid pose predict the vertex.
//!
//! For subjects that are rigid as a whole, if at all: a limb that moves is torn off.
//! [`GraphOptions::lambda_unseen`](crate::model::GraphOptions::lambda_unseen) holds to the form instead.

use super::factory::{RegistrationTerm, Scheduled, Step, TermError, TermFactory, TermInput, TermLevel, TermWeight};
use super::guess::Guess;
use crate::energy::{OptionsError, Pointwise};
use crate::mesh::MeshError;
use crate::nlls::Kernel;

/// Pulls vertices without an accepted correspondence to their predictions, without a kernel.
#[derive(Debug, Clone, Default)]
struct Prediction;

impl Scheduled<3> for Guess<Prediction> {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.pull.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(Kernel::None)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        if self.needs_predictions() {
            self.pull.targets.clear();
            self.pull.targets.extend_from_slice(step.predictions);
            self.pull.weights.clone_from(&step.correspondences.unseen);
        }
        Ok(())
    }

    fn needs_predictions(&self) -> bool {
        self.pull.scale > 0.0
    }
}

pub(super) struct Factory;

impl TermFactory for Factory {
    fn name(&self) -> &'static str {
        "prediction"
    }

    fn build(&self, _input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
        Ok(Box::new(Pointwise::new("prediction", Guess::<Prediction>::default(), Kernel::None)))
    }
}
