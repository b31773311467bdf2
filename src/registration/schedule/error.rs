//! What is wrong with a schedule.

use thiserror::Error;

use crate::energy::{OptionsError, nearest_key};
use crate::model::ModelKind;

/// Why a schedule cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScheduleError {
    /// Not TOML, or an unknown key, or a wrong type.
    #[error("{0}")]
    Syntax(String),
    /// A number out of bounds.
    #[error("{field} = {value}, but it must be {bound}")]
    OutOfBounds {
        /// Where, as in the file.
        field: String,
        /// What was given.
        value: f64,
        /// What would do.
        bound: &'static str,
    },
    /// Bounds that leave no value.
    #[error("{field} = [{lower}, {upper}], but no weight lies between the two")]
    Bounds {
        /// Where, as in the file.
        field: String,
        /// The lower bound.
        lower: f64,
        /// The upper bound.
        upper: f64,
    },
    /// A table of options that its model or term does not take.
    #[error("{}", in_table(place, error))]
    Options {
        /// Which table: `model`, `level 2: terms.landmarks`, `then.level 1: model`.
        place: String,
        /// What is wrong with it.
        error: OptionsError,
    },
    /// A kernel's scale out of bounds.
    #[error("{level}: {reason}")]
    Kernel {
        /// Where, as in the file: `level 1`, `then.level 2`.
        level: String,
        /// Field, value and bound.
        reason: String,
    },
    /// Options of a term that there is not.
    #[error("{place}.{name}: there is no such data term; known: {known}")]
    UnknownTerm {
        /// Where, as in the file.
        place: String,
        /// The name.
        name: String,
        /// Names that there are, and the nearest.
        known: String,
    },
    /// No levels.
    #[error("the schedule has no [[{0}]]")]
    NoLevels(String),
    /// A later stage cannot have blendshapes.
    #[error(
        "{field} = \"{model}\", but a later stage deforms the shape that the one before has found and has no blendshapes; \
         name a model without, such as \"graph\""
    )]
    StageModel {
        /// Where, as in the file.
        field: String,
        /// What was given.
        model: ModelKind,
    },
    /// A sequence of one.
    #[error(
        "model 'sequential' needs a second stage, [then] with a model and [[then.level]]; for one stage choose 'blendshape'"
    )]
    NoSecondStage,
    /// In [`Schedule::closed`](super::Schedule::closed).
    #[error("closed: {0}")]
    Closed(Box<ScheduleError>),
}

fn in_table(place: &str, error: &OptionsError) -> String {
    match error {
        OptionsError::OutOfBounds { .. } | OptionsError::Conflict { .. } => format!("{place}.{error}"),
        _ => format!("{place}: {error}"),
    }
}

/// Keys that schedules had, and what stands for them.
const FORMER_KEYS: [(&str, &str); 19] = [
    ("point_kernel", "`kernel` is that of every data term; leave this key out"),
    (
        "test_vertices",
        "`point_to_point` goes to the closest point of the surface, which needs no test; leave this key out",
    ),
    ("lambda_graph", "options of the model stand together: model = { lambda_graph = 1.0 }"),
    ("lambda_blend", "options of the model stand together: model = { lambda_blend = 1.0 }"),
    ("lambda_smooth", "options of the model stand together: model = { lambda_smooth = 1.0 }"),
    ("lambda_rotation", "options of the model stand together: model = { lambda_rotation = 1.0 }"),
    ("point_to_plane", "data terms have tables of their own: terms.point_to_plane = { weight = 1.0 }"),
    ("point_to_point", "data terms have tables of their own: terms.point_to_point = { weight = 1.0 }"),
    ("symmetric", "data terms have tables of their own: terms.symmetric = { weight = 1.0 }"),
    ("scan_to_template", "data terms have tables of their own: terms.scan_to_template = { weight = 1.0 }"),
    ("landmarks", "data terms have tables of their own: terms.landmarks = { weight = 1.0 }"),
    (
        "landmark_kernel",
        "it belongs to the landmarks: terms.landmarks = { weight = 1.0, kernel = { huber = { delta = 3.0 } } }",
    ),
    ("prediction", "data terms have tables of their own: terms.prediction = { weight = 1.0 }"),
    ("seam", "data terms have tables of their own: [terms.seam], and in a level terms.seam = { weight = 0.3 }"),
    ("graph", "options of the model stand in [model], in later stages in [then.model]"),
    ("smooth", "options of the model stand in [model], in later stages in [then.model]"),
    ("arap", "options of the model stand in [model], in later stages in [then.model]"),
    ("affine", "options of the model stand in [model], in later stages in [then.model]"),
    ("linearisation", "it is an option of the model now: [model] linearisation = \"reference\""),
];

/// Keys that have no default, and what to write.
const NEEDED_KEYS: [(&str, &str); 5] = [
    ("steps", "every level says how many steps it takes at most: steps = 5"),
    ("distance_cap", "every level says how long a correspondence may be, millimetres: distance_cap = 12.0"),
    (
        "kernel",
        "every level has a robust kernel of the data terms: kernel = { huber = { delta = 1.0 } }, or kernel = \"none\"",
    ),
    ("model", "a later stage has a model: [then.model] name = \"graph\""),
    ("name", "a later stage's model has a name: [then.model] name = \"graph\""),
];

/// What is wrong with a text, and what to write instead of an unknown key.
pub(super) fn syntax_error(error: &toml::de::Error) -> ScheduleError {
    let mut message = error.to_string().trim_end().to_owned();
    let quoted = |start: &str| error.message().strip_prefix(start).and_then(|rest| rest.split('`').next());
    let advice = |key: Option<&str>, of: &[(&str, &'static str)]| of.iter().find(|a| Some(a.0) == key).map(|a| a.1);
    let former = advice(quoted("unknown field `"), &FORMER_KEYS);
    if let Some(advice) = former.or(advice(quoted("missing field `"), &NEEDED_KEYS)) {
        message += &format!("\n{advice}");
    } else if error.message().contains("expected struct StageModel") {
        message += "\na later stage's model is a table: [then.model] name = \"graph\", and its options beside";
    } else if let Some(key) = nearest_key(error.message()) {
        message += &format!("\ndid you mean `{key}`?");
    }
    ScheduleError::Syntax(message)
}

/// An error unless a number is finite and holds to its bound.
pub(super) fn check(field: String, value: f64, holds: bool, bound: &'static str) -> Result<(), ScheduleError> {
    if holds && value.is_finite() { Ok(()) } else { Err(ScheduleError::OutOfBounds { field, value, bound }) }
}
