//! Many scans: one [`Job`] for each row of a [`Manifest`], each a process of its own, so that no failure of one reaches another.
//!
//! What is done is known by the hash of everything that went into it, and is not done again; the frames of a sequence follow each
//! other, each [going on](crate::registration::WarmStart) from the one before, and become one animated file at their end.
//!
//! A [`Plan`] holds everything that is decided before anything runs, and is the one way to run a batch, whoever asks for it. It keeps
//! to these rules: nothing that is read is written; results are made aside and replace older ones only when they are whole; a file
//! that no record of a batch lists is neither replaced nor deleted; one batch at a time writes into a folder, or parts of one.
//!
//! Who has machines of its own for the jobs [takes](Held::take) the folder, has others [run them](run_jobs), and [writes](Held::finish)
//! the summary.

mod animate;
mod animation;
mod error;
mod job;
mod lock;
mod manifest;
mod plan;
mod run;
mod shard;
mod summary;

pub use animation::Animation;
pub use error::BatchError;
pub use job::{Hashes, Job, Kept, Record, Start, Status};
pub use lock::Holder;
pub use manifest::{Columns, Manifest, Row};
pub use plan::Plan;
pub use run::{Batch, Finished, Held, Outcome, Timing, run_jobs};
pub use shard::{Shard, chains};
pub use summary::{Summary, SummaryRow};
