//! One clear error, and the exit code that says at which stage it happened.

use std::error::Error;
use std::fmt;
use std::process::ExitCode;

use super::tell;
use crate::text::message;

/// The stage at which a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Options that make no sense.
    Arguments = 1,
    /// The computation.
    Computation = 2,
    /// Writing results.
    Writing = 3,
    /// Reading inputs.
    Loading = 4,
    /// Not a failure of its own: Ctrl-C ended the command before its time.
    Interrupted = 130,
    /// The same by SIGTERM.
    Terminated = 143,
}

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    stage: Stage,
    message: String,
}

/// An error with its causes, but for those that it tells itself.
pub fn told(error: impl AsRef<dyn Error + Send + Sync>) -> String {
    let first: &dyn Error = error.as_ref();
    let causes = std::iter::successors(Some(first), |cause: &&dyn Error| (*cause).source());
    causes.map(ToString::to_string).fold(String::new(), |said, cause| match said.as_str() {
        "" => cause,
        _ if said.ends_with(&cause) => said,
        _ => format!("{said}: {cause}"),
    })
}

impl Failure {
    /// A failure with its message.
    pub fn new(stage: Stage, message: impl Into<String>) -> Self {
        Self { stage, message: message.into() }
    }

    /// For `map_err` at a loading step.
    pub fn loading(error: impl fmt::Display) -> Self {
        Self::new(Stage::Loading, error.to_string())
    }

    /// For `map_err` at a computing step.
    pub fn computation(error: impl fmt::Display) -> Self {
        Self::new(Stage::Computation, error.to_string())
    }

    /// For `map_err` at a writing step.
    pub fn writing(error: impl fmt::Display) -> Self {
        Self::new(Stage::Writing, error.to_string())
    }

    /// The stage at which it happened.
    #[must_use]
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The process' exit code.
    #[must_use]
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.stage as u8)
    }

    /// Says it on stderr and gives the exit code.
    #[must_use]
    pub fn report(&self) -> ExitCode {
        let asked = matches!(self.stage, Stage::Interrupted | Stage::Terminated);
        let kind = if asked { "warning" } else { "error" };
        tell(format_args!("{kind}: {}", message(&self.message)));
        self.exit_code()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}
