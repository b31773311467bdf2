//! Many scans: one [`Job`] for each row of a [`Manifest`], each a process of its own, so that no failure of one reaches another.
//!
//! What is done is known by the hash of everything that went into it, and is not done again; the frames of a sequence follow each
//! other, each [going on](crate::registration::WarmStart) from the one before.

mod job;
mod manifest;
mod plan;
mod run;
mod summary;

pub use job::{Hashes, Job, Record, Start, Status};
pub use manifest::{Columns, Manifest, Row};
pub use plan::{Shard, chains};
pub use run::{Batch, Outcome};
pub use summary::{Summary, SummaryRow};
