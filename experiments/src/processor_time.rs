//! Processor time: what a study of time measures, whatever else the machine does meanwhile.

use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use cpu_time::ThreadTime;

/// What some work on this thread alone returns, and the seconds of processor time that it took.
///
/// # Errors
/// When the system does not say, or the work is not on one thread.
pub fn cpu_seconds<R>(work: impl FnOnce() -> R) -> Result<(R, f64)> {
    if rayon::current_num_threads() != 1 {
        bail!("processor time is measured on one thread, not on {}", rayon::current_num_threads());
    }
    let begin = ThreadTime::try_now().context("processor time")?;
    let result = work();
    Ok((result, begin.try_elapsed().context("processor time")?.as_secs_f64()))
}

/// What some work returns, and the share of its wall time that the processor was at it. On several threads that is taken for 1: nothing
/// says which of them waited for the others.
///
/// # Errors
/// When the system does not say.
pub fn busy_share<R>(work: impl FnOnce() -> R) -> Result<(R, f64)> {
    if rayon::current_num_threads() != 1 {
        return Ok((work(), 1.0));
    }
    let clock = Instant::now();
    let (result, seconds) = cpu_seconds(work)?;
    Ok((result, (seconds / clock.elapsed().as_secs_f64()).min(1.0)))
}
