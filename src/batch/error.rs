//! Why a batch does not run.

use std::path::PathBuf;

use crate::io::{PlanError, WriteError};

/// Why a batch does not run, or not to its end; what is wrong with one scan is in its [`Record`](super::Record).
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// It would write over what it reads, or over itself.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// Frames of a sequence cannot become one animated file.
    #[error("sequence {sequence:?} cannot be animated: {why}")]
    Frames {
        /// Name of the sequence.
        sequence: String,
        /// Why, and what to do.
        why: String,
    },
    /// Something cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Another batch writes there.
    #[error(
        "{}: another batch writes here, {who}; wait for its end, or give another folder (if it is gone, delete {})",
        folder.display(),
        lock.display()
    )]
    Taken {
        /// The folder of results.
        folder: PathBuf,
        /// The other batch.
        who: String,
        /// Its lock.
        lock: PathBuf,
    },
    /// Another batch took the folder over while this one did not move.
    #[error("{}: another batch took this folder over while this one stood still", .0.display())]
    Lost(PathBuf),
    /// Files stand where results would go, and are none.
    #[error(
        "{}: is there, and no record of an earlier batch lists it{}; move it away, or give another folder",
        file.display(),
        if *others == 0 { String::new() } else { format!(" (nor {others} more)") }
    )]
    Stranger {
        /// The first of them.
        file: PathBuf,
        /// How many more there are.
        others: usize,
    },
    /// A result is not as it was made.
    #[error("{}: was changed since it was made, and stays; to have it made anew, move it away or delete it", .0.display())]
    Changed(PathBuf),
}

impl BatchError {
    /// Whether other arguments would help, not another place to write to.
    #[must_use]
    pub fn is_clash(&self) -> bool {
        match self {
            Self::Plan(error) => error.is_clash(),
            Self::Frames { .. } => true,
            _ => false,
        }
    }
}
