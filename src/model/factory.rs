//! How a schedule makes a model and drives it from level to level.

use serde::{Deserialize, Serialize};
use thiserror::Error;

#[cfg(doc)]
use super::Autodiff;
use super::AutodiffError;
use super::on_patch::{BuildOnPatch, BuiltInPatch, PatchFactory};
use crate::energy::{DeformationModel, NoOptions, OptionTable, Options, OptionsError};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::rig::{Regions, ShapeBasis};

/// A deformation model that a schedule can stiffen and soften.
pub trait RegistrationModel: DeformationModel {
    /// Takes the `[level.model]` of a level; `unit` is the model's length of one of the schedule's millimetres.
    ///
    /// # Errors
    /// For what it does not know or cannot take.
    fn set_level(&mut self, options: &Options, unit: f64) -> Result<(), OptionsError>;

    /// Goes over to the resolution that a level's `[level.model]` asks for, and returns the parameters that stand there for the shape at
    /// `x`: the samples are analysed anew then. `None` where it stays as it is.
    fn set_resolution(&mut self, _options: &Options, _x: &[f64]) -> Option<Vec<f64>> {
        None
    }

    /// Takes the parameters at which a level starts, for a model that trusts its shapes the less, the less likely they are. Called after
    /// [`set_level`](Self::set_level).
    fn trust_shapes(&mut self, _x: &[f64]) {}

    /// Takes which vertices have no correspondence, 0 to 1 each, for a model that is stiffer there. Called before every step.
    fn set_unseen(&mut self, _unseen: &[f64]) {}

    /// Writes the shape that the model deforms, before its local motions: where vertices belong, up to a rigid motion, when
    /// nothing is seen of them. The rest shape, unless the model knows better.
    fn prediction(&mut self, _x: &[f64], rest: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(rest);
    }

    /// Names and values of the blendshape weights in `x`, if the model has any: those of the first of the border's coordinates, in
    /// their order.
    fn named_weights(&self, _x: &[f64]) -> Vec<(String, f64)> {
        Vec::new()
    }

    /// How many directions no data fixed at the last linearisation, for a model that knows better than the linear solver, which
    /// counts coordinates that damping alone holds.
    fn unobserved_directions(&self) -> Option<usize> {
        None
    }
}

/// What a model is built from.
#[derive(Debug, Clone, Copy)]
pub struct ModelInput<'a> {
    /// The template's rest shape, centred.
    pub rest: &'a TriangleMesh,
    /// The blendshapes, in the frame of `rest`.
    pub shapes: &'a ShapeBasis,
    /// Named regions of the template, for models that differ by region.
    pub regions: Option<&'a Regions>,
    /// The schedule's `[model]`.
    pub options: &'a Options,
    /// Number of vertices of the template that the schedule's weights are meant for.
    pub reference_vertices: f64,
    /// Length of one of the schedule's millimetres in the frame of `rest`.
    pub unit: f64,
}

impl ModelInput<'_> {
    /// A length of so many of the schedule's millimetres in the frame of `rest`; positive even if the template is one point.
    #[must_use]
    pub fn length(&self, millimetres: f64) -> f64 {
        (millimetres * self.unit).max(f64::MIN_POSITIVE)
    }
}

/// Builds a model for a template. Implement this for your own model to register with it and to see it in `scan_bench`.
pub trait ModelFactory: Send + Sync {
    /// Name on the command line, in tables and in output files.
    fn name(&self) -> &str;

    /// The model's default schedule, a TOML file.
    fn default_schedule(&self) -> &str;

    /// Whether blendshapes are part of the model; of one that needs them they are.
    fn uses_shapes(&self) -> bool {
        self.needs_shapes()
    }

    /// Whether the model can do nothing without blendshapes.
    fn needs_shapes(&self) -> bool {
        false
    }

    /// Whether the schedule must name a second stage.
    fn needs_second_stage(&self) -> bool {
        false
    }

    /// Reads a schedule's `[model]` and fills in what it leaves out. No options unless overridden.
    ///
    /// # Errors
    /// For what the model does not know or cannot take.
    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<NoOptions>()
    }

    /// The same for a `[level.model]`; [`SmoothLevel`] unless overridden.
    ///
    /// # Errors
    /// As [`options`](Self::options).
    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<SmoothLevel>()
    }

    /// Builds the model.
    ///
    /// # Errors
    /// When the template's geometry does not do, or an option.
    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError>;

    /// How morphs make the model, if they can.
    fn on_patch(&self) -> Option<&dyn PatchFactory> {
        None
    }
}

/// A model of the table in `mod.rs`: what [`ModelKind`](super::ModelKind) says of itself.
pub(super) struct BuiltIn {
    pub name: &'static str,
    pub schedule: &'static str,
    pub uses_shapes: bool,
    pub needs_shapes: bool,
    pub needs_second_stage: bool,
    pub options: fn(&Options) -> Result<Options, OptionsError>,
    pub level_options: fn(&Options) -> Result<Options, OptionsError>,
    pub build: fn(&ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError>,
    pub on_patch: Option<BuiltInPatch>,
}

impl BuiltIn {
    /// A model with the options `O` and a [`SmoothLevel`], without shapes and not for patches.
    pub const fn new<O: OptionTable>(
        name: &'static str,
        schedule: &'static str,
        build: fn(&ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError>,
    ) -> Self {
        Self {
            name,
            schedule,
            uses_shapes: false,
            needs_shapes: false,
            needs_second_stage: false,
            options: Options::filled::<O>,
            level_options: Options::filled::<SmoothLevel>,
            build,
            on_patch: None,
        }
    }

    /// With another `[level.model]`.
    pub const fn with_level<L: OptionTable>(self) -> Self {
        Self { level_options: Options::filled::<L>, ..self }
    }

    pub const fn using_shapes(self) -> Self {
        Self { uses_shapes: true, ..self }
    }

    pub const fn needing_shapes(self) -> Self {
        Self { uses_shapes: true, needs_shapes: true, ..self }
    }

    /// For patches too, of whose options it reads `keys`.
    pub const fn on_patch(self, keys: &'static [&'static str], build: BuildOnPatch) -> Self {
        Self { on_patch: Some(BuiltInPatch { by_vertex: false, keys, build }), ..self }
    }

    /// [`on_patch`](Self::on_patch), with vertices as parameters.
    pub const fn on_patch_by_vertex(self, keys: &'static [&'static str], build: BuildOnPatch) -> Self {
        Self { on_patch: Some(BuiltInPatch { by_vertex: true, keys, build }), ..self }
    }

    /// The same model under another name, with a schedule of its own, and not for patches.
    pub const fn scheduled(self, name: &'static str, schedule: &'static str) -> Self {
        Self { name, schedule, on_patch: None, ..self }
    }
}

/// Why a model could not be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ModelError {
    /// The template's geometry cannot be used.
    #[error("template: {0}")]
    Template(#[from] MeshError),
    /// The schedule's `[model]` cannot be used.
    #[error("model: {0}")]
    Options(#[from] OptionsError),
    /// A model of one's own is stated wrongly.
    #[error("model {0}")]
    Autodiff(#[from] AutodiffError),
    /// Anything else that a model of one's own has to say.
    #[error("{0}")]
    Other(String),
}

/// `[level.model]` of models with one regulariser: free vertices, ARAP, per-vertex affine maps, springs, and [`Autodiff`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothLevel {
    /// `lambda_smooth`.
    pub lambda_smooth: f64,
}

impl OptionTable for SmoothLevel {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("lambda_smooth", self.lambda_smooth)
    }
}
