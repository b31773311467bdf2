//! Watching a minimisation, and stopping it.

use std::ops::ControlFlow;

use super::IterationRecord;

/// Sees every iteration. A closure is an observer:
///
/// ```
/// use std::ops::ControlFlow;
/// use nonrigid::nlls::{IterationRecord, Observer};
///
/// fn watch(_: &mut impl Observer) {}
///
/// watch(&mut |record: &IterationRecord| {
///     println!("{} {}", record.iteration, record.energy);
///     if record.energy < 1e-3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
/// });
/// ```
pub trait Observer {
    /// Called after every iteration, accepted or not. `Break` ends the run with
    /// [`StopReason::StoppedByObserver`](super::StopReason::StoppedByObserver) and the parameters as they are.
    fn on_iteration(&mut self, record: &IterationRecord) -> ControlFlow<()>;
}

impl<F: FnMut(&IterationRecord) -> ControlFlow<()>> Observer for F {
    fn on_iteration(&mut self, record: &IterationRecord) -> ControlFlow<()> {
        self(record)
    }
}

/// The observer that watches nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn on_iteration(&mut self, _: &IterationRecord) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}
