//! Does this build compute what it should on this machine? One registration with an expected error, on nothing but formulas: what
//! `nonrigid doctor` runs.
//!
//! Results are the same bits at any number of threads, but not on any processor: instruction sets differ in the order of sums, and
//! mathematical libraries in the last digit of a sine. So every expected number has a tolerance, and every tolerance a reason, said
//! where the check is. Seconds are measured and decide nothing.

mod face;
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
pub const CHECKS: [Check; 2] = [registration::ERROR, registration::SAME_BITS];

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
