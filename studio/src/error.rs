//! What goes wrong, in words for the person at the page: what it was, and what to do.

/// A sentence for the person at the page.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Problem(pub String);

/// Says a problem.
pub fn problem(what: impl std::fmt::Display) -> Problem {
    Problem(what.to_string())
}

impl From<rusqlite::Error> for Problem {
    fn from(error: rusqlite::Error) -> Self {
        use rusqlite::ErrorCode::{CannotOpen, DatabaseCorrupt, DiskFull, NotADatabase, ReadOnly};
        let advice = match error.sqlite_error_code() {
            Some(ReadOnly | CannotOpen) => "; may vault.sqlite and its folder be written?",
            Some(NotADatabase | DatabaseCorrupt) => "; put vault.sqlite back from a backup",
            Some(DiskFull) => "; make room on the disk",
            _ => "",
        };
        Self(format!("the vault's database says: {error}{advice}"))
    }
}

impl From<std::io::Error> for Problem {
    fn from(error: std::io::Error) -> Self {
        use std::io::ErrorKind::{NotFound, PermissionDenied, ReadOnlyFilesystem, StorageFull};
        let advice = match error.kind() {
            NotFound => "; was its folder moved or removed?",
            PermissionDenied | ReadOnlyFilesystem => "; may its folder be read and written?",
            StorageFull => "; make room on the disk",
            _ => "",
        };
        Self(format!("the vault's files: {error}{advice}"))
    }
}

impl From<nonrigid::io::ReadError> for Problem {
    fn from(error: nonrigid::io::ReadError) -> Self {
        Self(error.to_string())
    }
}

impl From<nonrigid::io::WriteError> for Problem {
    fn from(error: nonrigid::io::WriteError) -> Self {
        Self(error.to_string())
    }
}
