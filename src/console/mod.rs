//! What every program of this project has in common: one clear error with the exit code of its stage, and what is said on stdout and
//! stderr.

mod failure;
mod output;

use std::path::Path;

use crate::io::FilePlan;
use crate::text;

pub use failure::{Failure, Stage, told};
#[cfg(feature = "cli")]
pub use output::answer;
pub use output::{say, say_to, tell};

/// The number that was asked for with `option`, of threads or processes, but at most what this machine has a use for, with a
/// warning: four for each core, and sixteen. More only wait for each other, for minutes.
#[must_use]
pub fn bounded(option: &str, asked: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = (4 * cores).max(16);
    if asked > most {
        warn(format_args!("{option} {asked}: this machine has {cores} cores, so {most} are used"));
    }
    asked.min(most)
}

/// Runs `work` on so many threads, at most a [bounded] number; on all cores without one. On them, not beside them: a loop in parallel
/// that is started from another thread wakes the pool and waits for it every time.
///
/// # Errors
/// At [`Stage::Arguments`], when they cannot be started.
pub fn on_threads<R: Send>(threads: Option<u16>, work: impl FnOnce() -> R + Send) -> Result<R, Failure> {
    let threads = threads.map_or(0, |asked| bounded("--threads", asked.into()));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    Ok(pool.map_err(|e| Failure::new(Stage::Arguments, format!("--threads: {e}")))?.install(work))
}

/// Refuses a plan that would do harm, before anything is written.
///
/// # Errors
/// As [`FilePlan::check`], by stage.
pub fn check_plan(plan: &FilePlan) -> Result<(), Failure> {
    plan.check().map_err(|e| Failure::new(if e.is_clash() { Stage::Arguments } else { Stage::Writing }, e.to_string()))
}

/// Refuses a path for a folder of outputs that is something else, or that leads through something else.
///
/// # Errors
/// At [`Stage::Writing`].
pub fn check_folder_path(path: &Path) -> Result<(), Failure> {
    let there = path.ancestors().find(|above| above.symlink_metadata().is_ok());
    let Some(other) = there.filter(|there| !there.is_dir()) else { return Ok(()) };
    let is = if other.exists() { "a file, not a folder" } else { "a link that leads nowhere" };
    let which = if other == path { "it".to_owned() } else { other.display().to_string() };
    Err(Failure::writing(format!("{}: cannot be written: {which} is {is}", path.display())))
}

/// Prints a warning.
pub fn warn(message: impl std::fmt::Display) {
    tell(format_args!("warning: {}", text::message(&message.to_string())));
}
