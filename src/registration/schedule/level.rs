//! One level of a schedule.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::correspondence::Acceptance;
use crate::energy::Options;
use crate::nlls::Kernel;

/// One level: a stiffness, a kernel scale, and what counts as a correspondence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Level {
    /// Steps of the solver at most, each with new correspondences.
    pub steps: usize,
    /// Longest correspondence, millimetres.
    pub distance_cap: f64,
    /// Largest angle between the normals of a correspondence, degrees; 60 by default.
    #[serde(default = "normal_angle")]
    pub normal_angle: f64,
    /// Whether the template's rim (`scan.template_rim`) stays out of the correspondences; true by default. Levels that begin near the
    /// scan gain by it.
    #[serde(default = "yes")]
    pub reject_rim: bool,
    /// Whether only about every fourth vertex takes a correspondence, no two of them neighbours, each for itself and for neighbours that
    /// take none: faster, and enough where the model is stiff. Of a template whose quarter is under a thousand all do.
    #[serde(default)]
    pub thinned: bool,
    /// Vertices closer together than what the scanner resolves say one thing several times: where a vertex stands for less surface than
    /// so many samples of the scan, it counts the root of the ratio. 0 (default): all count alike.
    #[serde(default)]
    pub sampling: f64,
    /// Standard deviation of the scan's noise at which what it shows counts half, millimetres; 0.3 by default. Where neighbours lie at heights
    /// of their own ([`noise`](crate::mesh::noise())), as in hair, shapes and smoothness say more. 0: all of the scan counts alike.
    #[serde(default = "noise")]
    pub noise: f64,
    /// Robust kernel of the data terms, in the unit that [`scale`](Self::scale) says.
    pub kernel: Kernel,
    /// What the scale of [`kernel`](Self::kernel) counts: `fixed` (default) or `mad`.
    #[serde(default)]
    pub scale: KernelScale,
    /// How stiff the model is, as its own documentation has it: `HybridLevel` and the like of [`model`](crate::model).
    #[serde(default)]
    pub model: Options,
    /// Weights of data terms by name ([`term`](crate::term)): `terms.landmarks = { weight = 0.5 }`. Without any,
    /// `point_to_plane` has weight 1 and the others 0.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<String, Options>,
}

fn normal_angle() -> f64 {
    60.0
}

fn noise() -> f64 {
    0.3
}

fn yes() -> bool {
    true
}

/// One step of point-to-plane without a kernel, up to 5 mm and 60 degrees, and no regulariser.
impl Default for Level {
    fn default() -> Self {
        Self {
            steps: 1,
            distance_cap: 5.0,
            normal_angle: normal_angle(),
            reject_rim: true,
            thinned: false,
            sampling: 0.0,
            noise: noise(),
            kernel: Kernel::None,
            scale: KernelScale::Fixed,
            model: Options::new(),
            terms: BTreeMap::new(),
        }
    }
}

impl Level {
    /// The level with an option of the model set.
    #[must_use]
    pub fn with_model(mut self, key: &str, value: f64) -> Self {
        self.model.set(key, value);
        self
    }

    /// The level with the weight of a term set.
    #[must_use]
    pub fn with_term(mut self, term: &str, weight: f64) -> Self {
        self.set_term(term, weight);
        self
    }

    /// The weight of a term, where it is stated.
    #[must_use]
    pub fn term(&self, term: &str) -> Option<f64> {
        self.terms.get(term)?.number("weight")
    }

    /// Sets the weight of a term.
    pub fn set_term(&mut self, term: &str, weight: f64) {
        self.terms.entry(term.to_owned()).or_default().set("weight", weight);
    }

    /// What a pair must keep to be accepted, for a model whose length of a millimetre is `unit`.
    #[must_use]
    pub fn acceptance(&self, unit: f64) -> Acceptance {
        Acceptance { distance: self.distance_cap * unit, angle: self.normal_angle, noise: self.noise * unit }
    }
}

/// What the scale of a level's kernel counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KernelScale {
    /// Millimetres.
    #[default]
    Fixed,
    /// Robust standard deviations of the residuals ([`mad_scale`](crate::nlls::mad_scale)), found anew at each step from the distances of
    /// the accepted vertices to their planes: `{ tukey = { delta = 4.685 } }` keeps 95 % of the efficiency of plain least squares
    /// on Gaussian noise of any size. The kernel of [landmarks](crate::term::LandmarkLevel) stays in millimetres.
    Mad,
}
