//! How a schedule makes a data term and drives it from level to level.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::correspondence::{Acceptance, Correspondences, ScanSurface, VertexMasks};
use crate::energy::{DataTerm, NoOptions, OptionTable, Options, OptionsError, Pointwise, SampleResidual};
use crate::mesh::{MeshError, Pose, TriangleMesh, Vec3};
use crate::nlls::Kernel;

/// A data term that follows the levels and correspondences of a registration. [`Scheduled`] residuals are one under a
/// [`Kernel`].
pub trait RegistrationTerm: DataTerm {
    /// Takes a level's weights and kernel.
    ///
    /// # Errors
    /// For what it does not know or cannot take.
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<(), OptionsError>;

    /// Takes what a step acts on, before every step.
    ///
    /// # Errors
    /// When a vertex has left the numbers.
    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError>;

    /// Whether [`Step::predictions`] are wanted.
    fn needs_predictions(&self) -> bool {
        false
    }
}

/// A level as a term sees it.
#[derive(Debug, Clone, Copy)]
pub struct TermLevel<'a> {
    /// The term's `[level.terms.NAME]`.
    pub options: &'a Options,
    /// The level's kernel, in the model's unit.
    pub kernel: Kernel,
    /// Turns weights per vertex of the schedule's reference template into weights per vertex of this one.
    pub density: f64,
    /// The model's length of one of the schedule's millimetres.
    pub unit: f64,
}

/// What a step acts on, in the model's frame.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The scan.
    pub scan: &'a ScanSurface,
    /// Where the template's vertices are.
    pub vertices: &'a [Vec3],
    /// The shape that the stage deforms.
    pub rest: &'a TriangleMesh,
    /// What of the template takes part.
    pub masks: &'a VertexMasks,
    /// The closest point of the scan for each vertex.
    pub correspondences: &'a Correspondences,
    /// What a correspondence must keep to be accepted.
    pub accept: Acceptance,
    /// Where the model's shapes predict each vertex, in the rigid pose that fits the accepted ones best; empty unless a term
    /// [needs](RegistrationTerm::needs_predictions) them.
    pub predictions: &'a [Vec3],
}

/// What terms are built from.
#[derive(Debug, Clone, Copy)]
pub struct TermInput<'a> {
    /// The schedule's `[terms.NAME]`.
    pub options: &'a Options,
    /// The landmarks.
    pub landmarks: &'a [TermLandmark],
    /// The template's rest shape, in the model's frame.
    pub rest: &'a TriangleMesh,
    /// The model's length of one of the schedule's millimetres.
    pub unit: f64,
    /// From the model's frame to the scan's: brings what you measured to where the term sees samples by
    /// [`apply_inverse`](Pose::apply_inverse).
    pub frame: Pose,
}

/// A landmark as a term sees it, in the model's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TermLandmark {
    /// The sample that stands for it.
    pub sample: usize,
    /// Where it is on the template at rest.
    pub rest: Vec3,
    /// Where it was seen.
    pub target: Vec3,
    /// 1 for one without a deviation of its own, less for what is known less well, 0 for one that contradicts the others.
    pub weight: f64,
}

/// Builds a data term for a registration. Implement this for your own term.
pub trait TermFactory: Send + Sync {
    /// The term's name in schedules: `[terms.NAME]`, `[level.terms.NAME]`.
    fn name(&self) -> &str;

    /// Reads a schedule's `[terms.NAME]` and fills in what it leaves out. No options unless overridden.
    ///
    /// # Errors
    /// For what the term does not know or cannot take.
    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<NoOptions>()
    }

    /// The same for a `[level.terms.NAME]`; [`TermWeight`] unless overridden.
    ///
    /// # Errors
    /// As [`options`](Self::options).
    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<TermWeight>()
    }

    /// Builds the term.
    ///
    /// # Errors
    /// When the template's geometry does not do.
    fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError>;
}

/// A term of the table in `mod.rs`.
pub(super) struct BuiltIn {
    pub name: &'static str,
    pub options: fn(&Options) -> Result<Options, OptionsError>,
    pub level_options: fn(&Options) -> Result<Options, OptionsError>,
    pub build: fn(&TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError>,
}

impl BuiltIn {
    /// A term without options but the `[level.terms.NAME]` `L`.
    pub const fn new<L: OptionTable>(
        name: &'static str,
        build: fn(&TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError>,
    ) -> Self {
        Self { name, options: Options::filled::<NoOptions>, level_options: Options::filled::<L>, build }
    }
}

impl TermFactory for BuiltIn {
    fn name(&self) -> &str {
        self.name
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        (self.options)(given)
    }

    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        (self.level_options)(given)
    }

    fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
        (self.build)(input)
    }
}

/// Why a term could not be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TermError {
    /// The template's geometry cannot be used.
    #[error("template: {0}")]
    Template(#[from] MeshError),
    /// The schedule's `[terms.NAME]` cannot be used.
    #[error("terms: {0}")]
    Options(#[from] OptionsError),
}

/// `[level.terms.NAME]` of most terms.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TermWeight {
    /// `alpha`; 0 switches the term off.
    pub weight: f64,
}

impl OptionTable for TermWeight {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("weight", self.weight)
    }
}

/// Residuals of single samples that follow a schedule: with a kernel, a [`RegistrationTerm`].
///
/// ```
/// use nonrigid::energy::{OptionsError, Pointwise, SampleResidual};
/// use nonrigid::nlls::{Kernel, Scalar};
/// use nonrigid::term::{RegistrationTerm, Scheduled, TermError, TermFactory, TermInput, TermLevel, TermWeight};
///
/// /// Keeps vertices above a floor: r = y - height where y is below it.
/// struct AboveFloor { vertices: usize, height: f64, weight: f64 }
///
/// impl SampleResidual<1> for AboveFloor {
///     fn len(&self) -> usize { self.vertices }
///     fn sample(&self, m: usize) -> usize { m }
///     fn weight(&self, _m: usize) -> f64 { self.weight }
///     fn residual<D: Scalar>(&self, _m: usize, v: [D; 3]) -> [D; 1] {
///         [if v[1].re() < self.height { v[1] - self.height } else { D::from(0.0) }]
///     }
/// }
///
/// impl Scheduled<1> for AboveFloor {
///     fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
///         self.weight = level.options.read::<TermWeight>()?.weight * level.density;
///         Ok(level.kernel)
///     }
/// }
///
/// /// `terms.floor = { weight = 2.0 }` in a level.
/// struct Floor;
///
/// impl TermFactory for Floor {
///     fn name(&self) -> &str { "floor" }
///     fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
///         let residuals = AboveFloor { vertices: input.rest.positions.len(), height: -80.0, weight: 0.0 };
///         Ok(Box::new(Pointwise::new("floor", residuals, Kernel::None)))
///     }
/// }
/// ```
pub trait Scheduled<const R: usize>: SampleResidual<R> {
    /// Takes a level's weights and returns the kernel.
    ///
    /// # Errors
    /// For what it does not know or cannot take.
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError>;

    /// Takes what a step acts on; nothing unless overridden.
    ///
    /// # Errors
    /// When a vertex has left the numbers.
    fn update(&mut self, _step: &Step<'_>) -> Result<(), MeshError> {
        Ok(())
    }

    /// Whether [`Step::predictions`] are wanted.
    fn needs_predictions(&self) -> bool {
        false
    }
}

impl<T: Scheduled<R>, const R: usize> RegistrationTerm for Pointwise<T, Kernel, R> {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<(), OptionsError> {
        self.kernel = self.residuals.set_level(level)?;
        Ok(())
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        self.residuals.update(step)
    }

    fn needs_predictions(&self) -> bool {
        self.residuals.needs_predictions()
    }
}
