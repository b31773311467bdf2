//! What can be wrong with the settings of a solver or a kernel.

use thiserror::Error;

/// A setting outside its bounds: names the field, its value and the bound that it violates.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{field} is {value}, but must be {bound}")]
pub struct OptionError {
    /// The field, such as `"levenberg_marquardt.min_gain"`.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// The violated bound, such as `"in [0, 1)"`.
    pub bound: &'static str,
}

impl OptionError {
    /// `Ok` if `holds`, else an error that names the field, its value and the bound.
    pub fn require(holds: bool, field: &'static str, value: f64, bound: &'static str) -> Result<(), Self> {
        if holds { Ok(()) } else { Err(Self { field, value, bound }) }
    }
}
