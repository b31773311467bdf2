//! Tables of a schedule that hold for all of its levels.

use serde::{Deserialize, Serialize};

use super::ScheduleError;
use crate::nlls::LinearSolverKind;
use crate::rig::{Family, Shape};

/// How a registration runs that goes on from another one's end ([`WarmStart`](crate::registration::WarmStart)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmStartOptions {
    /// Steps of a level at most, in the first stage. All levels stay: on generated sequences (15 frames a second, the hybrid), two
    /// steps of each level give 0.71 mm where a cold start's five give 0.79, in little more than half the time; leaving out
    /// the four stiffest levels instead gives 0.97, since the graph then takes what belongs to the blendshapes.
    pub steps: usize,
}

impl Default for WarmStartOptions {
    fn default() -> Self {
        Self { steps: 2 }
    }
}

/// How the energy of each set of correspondences is minimised: by one step, which never raises it. Steps that would are
/// shortened and tried again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverOptions {
    /// `gauss_newton` (default), `levenberg_marquardt` or `dogleg`.
    pub algorithm: StepAlgorithm,
    /// What solves the normal equations: `auto` (default, [by size](crate::nlls::linear::choose)), `dense`, `bordered` or
    /// `block_jacobi`.
    pub linear_solver: LinearSolverKind,
}

/// Which step is taken, with the settings of [`nlls`](crate::nlls::Options).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepAlgorithm {
    /// A full step, halved until the energy falls.
    #[default]
    GaussNewton,
    /// A damped step. The damping is relative to the curvature; it carries on from step to step of a level, as what it knows of the
    /// energy's shape outlives the correspondences, and starts anew with each level, whose weights make another energy.
    LevenbergMarquardt,
    /// A step within a trust region, whose radius carries on and starts anew as the damping does.
    Dogleg,
}

/// When a level ends early: after a step that does no more than this.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StopOptions {
    /// Relative fall of the energy in a step, at its correspondences.
    pub energy: f64,
    /// Motion of any vertex in a step, millimetres.
    pub motion: f64,
}

impl Default for StopOptions {
    fn default() -> Self {
        Self { energy: 0.01, motion: 0.25 }
    }
}

/// Standard deviations of what is known beforehand: `sigma_k` of (5) by family of shapes, and where landmarks are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SigmaOptions {
    /// Expression blendshapes, whose weights lie between 0 and 1.
    pub expression: f64,
    /// Identity modes, scaled to standard deviation one by the rig.
    pub identity: f64,
    /// How far beyond 0 and 1 the weight of an expression lies that is meant to lie between: one with a name of ARKit's
    /// ([`Shape::from_zero_to_one`](crate::rig::Shape::from_zero_to_one)). Nothing unless stated.
    ///
    /// Without it, expressions of both signs explain how a person differs from the rig.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beyond: Option<f64>,
    /// `sigma_0` of a landmark that states none, millimetres. One that states `sigma` counts `(sigma_0 / sigma)^2` times the
    /// [level's weight](crate::term::LandmarkLevel) and, next to the others, as much in the start.
    ///
    /// A constant and not, say, the median of what a file states, so that landmarks that are all vague hold the template less
    /// against the scan, and one more landmark does not change what the others count. But landmarks that [scatter](super::super::LandmarkStart::scatter) by more
    /// than twice as much count less.
    pub landmark: f64,
}

impl Default for SigmaOptions {
    fn default() -> Self {
        Self { expression: 1.0, identity: 1.0, beyond: None, landmark: 1.0 }
    }
}

impl SigmaOptions {
    /// `sigma_k` of a shape of the given family; shapes of unknown family count as expressions.
    #[must_use]
    pub fn of(&self, family: Family) -> f64 {
        match family {
            Family::Identity => self.identity,
            Family::Expression | Family::Other => self.expression,
        }
    }

    /// `sigma_beyond` of a shape, infinite for none.
    #[must_use]
    pub fn beyond(&self, shape: &Shape) -> f64 {
        self.beyond.filter(|_| shape.from_zero_to_one()).unwrap_or(f64::INFINITY)
    }
}

/// Bounds `[l, u]` of the weights by family of shapes, held exactly; free without.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoundsOptions {
    /// Expression blendshapes; `[0, 1]` for weights as an animator sets them.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "crate::io::arrays::optional_array")]
    pub expression: Option<[f64; 2]>,
    /// Identity modes, in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "crate::io::arrays::optional_array")]
    pub identity: Option<[f64; 2]>,
}

impl BoundsOptions {
    /// Bounds of a shape of the given family; shapes of unknown family count as expressions.
    #[must_use]
    pub fn of(&self, family: Family) -> [f64; 2] {
        let bounds = match family {
            Family::Identity => self.identity,
            Family::Expression | Family::Other => self.expression,
        };
        bounds.unwrap_or([f64::NEG_INFINITY, f64::INFINITY])
    }

    /// Checks one pair.
    pub(super) fn validate(field: &str, bounds: Option<[f64; 2]>) -> Result<(), ScheduleError> {
        let Some([lower, upper]) = bounds else { return Ok(()) };
        // Written so that NaN fails.
        if lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY {
            return Ok(());
        }
        Err(ScheduleError::Bounds { field: field.to_owned(), lower, upper })
    }
}
