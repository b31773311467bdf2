//! Does this build compute what it should on this machine? Checks with expected numbers, in some seconds, on nothing but formulas:
//! what `nonrigid doctor` runs.
//!
//! Results are the same bits at any number of threads, but not on any processor: instruction sets differ in the order of sums, and
//! mathematical libraries in the last digit of a sine. So every expected number has a tolerance, and every tolerance a reason, said
//! where the check is. Seconds are measured and decide nothing.

mod certified;
mod equations;
mod face;
mod file;
mod machine;
mod registration;

use std::error::Error;
use std::time::Instant;

use serde::Serialize;

pub use face::Face;
pub use machine::{InstructionSet, Machine};
pub use registration::registration_rmse;

/// A number that is computed here and known beforehand.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// What is computed, with its unit.
    pub what: &'static str,
    /// What it has to be.
    pub expected: f64,
    /// By how much it may differ.
    pub tolerance: f64,
    /// Computes it.
    pub compute: fn() -> Result<f64, Box<dyn Error>>,
}

/// What became of a [`Check`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// What was computed, with its unit.
    pub what: &'static str,
    /// The number; `None` where it could not be computed.
    pub found: Option<f64>,
    /// Why it could not.
    pub error: Option<String>,
    /// What it had to be.
    pub expected: f64,
    /// By how much it could differ.
    pub tolerance: f64,
    /// Whether it differs by no more than that.
    pub ok: bool,
    /// Seconds that it took.
    pub seconds: f64,
}

/// All checks, in the order in which they are worth reading.
pub const CHECKS: [Check; 6] = [
    certified::MGH09,
    equations::DERIVATIVES,
    equations::BORDERED_CHOLESKY,
    registration::ERROR,
    registration::SAME_BITS,
    file::ROUND_TRIP,
];

/// The largest magnitude; NaN if there is a NaN, which [`f64::max`] would pass over.
fn largest(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().fold(0.0, |most: f64, x| if most.is_nan() || most >= x.abs() { most } else { x.abs() })
}

impl Check {
    /// Computes the number and compares, on the threads of the caller's pool.
    #[must_use]
    pub fn run(&self) -> Finding {
        let Self { what, expected, tolerance, compute } = *self;
        let clock = Instant::now();
        let (found, error) = match compute() {
            Ok(number) => (Some(number), None),
            Err(error) => (None, Some(error.to_string())),
        };
        // Written so that NaN is wrong.
        let ok = found.is_some_and(|found| (found - expected).abs() <= tolerance);
        Finding { what, found, error, expected, tolerance, ok, seconds: clock.elapsed().as_secs_f64() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_nan_is_passed_over() {
        assert_eq!(largest([1.0, -3.0, 2.0]), 3.0);
        assert!(largest([1.0, f64::NAN, 2.0]).is_nan() && largest([f64::NAN]).is_nan());
    }
}
