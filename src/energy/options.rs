//! Options that a schedule hands to models and terms: tables of TOML, read and checked by those whom they belong to.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use toml::{Table, Value};

use crate::nlls::{Kernel, OptionError};
use crate::text::most_similar;

/// A table of options as a schedule holds it.
///
/// ```
/// use nonrigid::energy::{OptionTable, Options, OptionsError};
/// use serde::{Deserialize, Serialize};
///
/// #[derive(Default, Serialize, Deserialize)]
/// #[serde(deny_unknown_fields, default)]
/// struct Spring { stiffness: f64 }
///
/// impl OptionTable for Spring {
///     fn check(&self) -> Result<(), OptionsError> {
///         OptionsError::not_negative("stiffness", self.stiffness)
///     }
/// }
///
/// let options = Options::new().with("stiffness", 2.5);
/// assert_eq!(options.read::<Spring>()?.stiffness, 2.5);
/// let error = Options::new().with("stifness", 2.5).read::<Spring>().err().unwrap();
/// assert!(error.to_string().ends_with("did you mean `stiffness`?"));
/// # Ok::<(), OptionsError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Options(Table);

/// What a table of options holds: a `struct` with a default for each key, which refuses unknown ones.
pub trait OptionTable: Serialize + DeserializeOwned + Default {
    /// Checks the values against their bounds.
    ///
    /// # Errors
    /// With the first that is out of bounds.
    fn check(&self) -> Result<(), OptionsError> {
        Ok(())
    }
}

/// Why a table of options cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum OptionsError {
    /// An unknown key or a wrong type.
    #[error("{0}")]
    Table(String),
    /// A value that cannot be.
    #[error("{key} = {value}, but it must be {bound}")]
    OutOfBounds {
        /// The key.
        key: String,
        /// What was given.
        value: f64,
        /// What would do.
        bound: &'static str,
    },
    /// A kernel's scale or exponent out of bounds.
    #[error("kernel: {0}")]
    Kernel(#[from] OptionError),
    /// Values that do not go together.
    #[error("{key}: {reason}")]
    Conflict {
        /// The key.
        key: &'static str,
        /// Why not.
        reason: &'static str,
    },
}

/// Greatest count that options may ask for: a slip of the pen would seem to hang.
const MOST: usize = 1_000_000;

impl Options {
    /// No options.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// All options of `table`, as they are.
    ///
    /// # Panics
    /// If it is no table of TOML, as of a tuple.
    #[must_use]
    pub fn of(table: &impl Serialize) -> Self {
        Self(Table::try_from(table).expect("options are a table of TOML"))
    }

    /// The same with one option set.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<Value>) -> Self {
        self.set(key, value);
        self
    }

    /// Sets an option.
    pub fn set(&mut self, key: &str, value: impl Into<Value>) {
        self.0.insert(key.to_owned(), value.into());
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Names of the options that are set, in alphabetical order.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// An option as it stands.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.0.get(key)
    }

    /// A number, if it is set.
    #[must_use]
    pub fn number(&self, key: &str) -> Option<f64> {
        let value = self.0.get(key)?;
        value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
    }

    /// Whether an option is set to `true`.
    #[must_use]
    pub fn flag(&self, key: &str) -> bool {
        self.0.get(key).and_then(Value::as_bool).unwrap_or(false)
    }

    /// The options as `T`, checked; those that are not set have their defaults.
    ///
    /// # Errors
    /// For an unknown key, with the nearest known one, a wrong type, or a value out of bounds.
    pub fn read<T: OptionTable>(&self) -> Result<T, OptionsError> {
        let parse = |table: Table| Value::Table(table).try_into::<T>();
        let table = parse(self.0.clone()).map_err(|e| {
            // messages of a wrong type do not say whose
            let is_wrong = |(key, value): &(&String, &Value)| {
                parse(Table::from_iter([((*key).clone(), (*value).clone())])).is_err()
            };
            let wrong = self.0.iter().find(is_wrong).filter(|_| !e.message().starts_with("unknown field"));
            OptionsError::table(&wrong.map_or(e.message().to_owned(), |(key, _)| format!("{key}: {}", e.message())))
        })?;
        table.check()?;
        Ok(table)
    }

    /// The same options with all defaults of `T` filled in.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn filled<T: OptionTable>(&self) -> Result<Self, OptionsError> {
        Ok(Self::of(&self.read::<T>()?))
    }
}

/// No options.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoOptions {}

impl OptionTable for NoOptions {}

impl OptionsError {
    /// From a message such as "unknown field `stepps`, expected one of `steps`, `kernel`", with the nearest name.
    fn table(message: &str) -> Self {
        let message = message.trim_end();
        Self::Table(match nearest_key(message) {
            Some(key) => format!("{message}; did you mean `{key}`?"),
            None => message.to_owned(),
        })
    }

    fn require(holds: bool, key: &str, value: f64, bound: &'static str) -> Result<(), Self> {
        if holds && value.is_finite() {
            return Ok(());
        }
        Err(Self::OutOfBounds { key: key.to_owned(), value, bound })
    }

    /// Refuses a value that is not above zero and finite.
    ///
    /// # Errors
    /// With the key.
    pub fn positive(key: &str, value: f64) -> Result<(), Self> {
        Self::require(value > 0.0, key, value, "positive and finite")
    }

    /// Refuses a value below zero, and one that is not finite.
    ///
    /// # Errors
    /// With the key.
    pub fn not_negative(key: &str, value: f64) -> Result<(), Self> {
        Self::require(value >= 0.0, key, value, "zero or positive, and finite")
    }

    /// Refuses a kernel whose scale or exponent is out of bounds.
    ///
    /// # Errors
    /// With what is out of bounds.
    pub fn kernel(kernel: Kernel) -> Result<(), Self> {
        Ok(kernel.validate()?)
    }

    /// Refuses zero and counts that only cost time and memory.
    ///
    /// # Errors
    /// With the key.
    pub fn count(key: &str, value: usize) -> Result<(), Self> {
        Self::require(value > 0, key, value as f64, "positive and finite")?;
        Self::require(value <= MOST, key, value as f64, "at most 1000000")
    }
}

/// The key most like the unknown one of a message such as "unknown field `stepps`, expected one of `steps`, `kernel`".
#[must_use]
pub fn nearest_key(message: &str) -> Option<&str> {
    // Every second piece is a name.
    let mut names = message.split('`').skip(1).step_by(2);
    let unknown = names.next().filter(|_| message.starts_with("unknown field"))?;
    most_similar(unknown, names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Default, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Pull {
        weight: f64,
        nodes: usize,
        kernel: Kernel,
    }

    impl OptionTable for Pull {
        fn check(&self) -> Result<(), OptionsError> {
            OptionsError::not_negative("weight", self.weight)
        }
    }

    #[test]
    fn what_is_not_set_has_its_default_and_what_is_wrong_is_named() {
        let options = Options::new().with("weight", 3);
        let pull = Pull { weight: 3.0, nodes: 0, kernel: Kernel::None };
        assert_eq!(options.read::<Pull>(), Ok(pull));
        let filled = options.filled::<Pull>().unwrap();
        assert_eq!(
            (filled.number("weight"), filled.number("nodes"), options.number("nodes")),
            (Some(3.0), Some(0.0), None)
        );
        assert_eq!(filled.filled::<Pull>(), Ok(filled));
        let wrong = |key: &str, value: Value| Options::new().with(key, value).read::<Pull>().unwrap_err().to_string();
        let message = wrong("wieght", 1.0.into());
        assert!(message.contains("`wieght`") && message.ends_with("did you mean `weight`?"), "{message}");
        assert_eq!(wrong("weight", (-1.0).into()), "weight = -1, but it must be zero or positive, and finite");
        assert_eq!(wrong("weight", f64::NAN.into()), "weight = NaN, but it must be zero or positive, and finite");
        assert!(
            wrong("nodes", "many".into()).starts_with("nodes: ") && wrong("nodes", 2.5.into()).starts_with("nodes: ")
        );
        assert!(Options::new().with("anything", 1).read::<NoOptions>().is_err());
    }

    #[test]
    fn counts_are_bounded_from_both_sides() {
        assert!(OptionsError::count("nodes", 1).is_ok() && OptionsError::count("nodes", MOST).is_ok());
        assert!(OptionsError::count("nodes", 0).is_err() && OptionsError::count("nodes", MOST + 1).is_err());
    }
}
