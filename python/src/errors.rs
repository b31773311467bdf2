//! Errors of the library as Python exceptions, by kind, and the one way in which this module computes.

use std::any::Any;
use std::error::Error;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    nonrigid,
    ComputationError,
    PyRuntimeError,
    "The inputs are sound, but the computation on them did not succeed: no start was found, nothing overlaps, no step lowers the energy."
);

/// What the operating system said, if that is why.
fn of_system<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a io::Error> {
    let mut at = Some(error);
    while let Some(error) = at {
        if let Some(found) = error.downcast_ref::<io::Error>() {
            return Some(found);
        }
        at = error.source();
    }
    None
}

fn os_error(error: &(dyn Error + 'static), source: &io::Error) -> PyErr {
    match source.raw_os_error() {
        // Python finds the class by the number: FileNotFoundError, PermissionError, ...
        Some(number) => PyOSError::new_err((number, error.to_string())),
        None => PyErr::from(io::Error::new(source.kind(), error.to_string())),
    }
}

/// Inputs that cannot be used: `OSError` if the system could not read or write them, otherwise `ValueError`.
pub fn input(error: impl Error + 'static) -> PyErr {
    match of_system(&error) {
        Some(source) => os_error(&error, source),
        None => value(error),
    }
}

/// A computation that failed, or `OSError`.
pub fn computation(error: impl Error + 'static) -> PyErr {
    match of_system(&error) {
        Some(source) => os_error(&error, source),
        None => ComputationError::new_err(error.to_string()),
    }
}

/// `ValueError`.
pub fn value(message: impl ToString) -> PyErr {
    PyValueError::new_err(message.to_string())
}

fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}

/// Runs `work` on threads of its own, as many as asked for or one a core.
pub fn on_threads<R: Send>(threads: Option<usize>, work: impl FnOnce() -> PyResult<R> + Send) -> PyResult<R> {
    if threads.is_some_and(|n| !(1..=1024).contains(&n)) {
        return Err(value("threads: give a number from 1 to 1024, or None for one a core"));
    }
    let in_pool = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
        pool.map_err(|e| ComputationError::new_err(format!("threads: {e}")))?.install(work)
    };
    guarded(in_pool)
}

/// Runs `work` here. A panic, which is a bug, ends here.
pub fn guarded<R>(work: impl FnOnce() -> PyResult<R>) -> PyResult<R> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let message = format!("a bug in nonrigid, please report it with what led to it: {}", said(&*panic));
        Err(ComputationError::new_err(message))
    })
}

/// [`on_threads`] besides this one, which looks for Ctrl-C meanwhile; the work sees that it is to stop.
pub fn interruptible<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    work: impl FnOnce(&AtomicBool) -> PyResult<R> + Send,
) -> PyResult<R> {
    let stop = AtomicBool::new(false);
    let stopped = &stop;
    std::thread::scope(|scope| {
        let thread = scope.spawn(move || on_threads(threads, || work(stopped)));
        let mut interrupted = None;
        while !thread.is_finished() {
            if let Err(error) = py.check_signals() {
                stop.store(true, Ordering::Relaxed);
                interrupted.get_or_insert(error);
            }
            py.detach(|| std::thread::sleep(Duration::from_millis(20)));
        }
        let ended = || ComputationError::new_err("a thread of nonrigid has ended; please report it");
        let outcome = thread.join().unwrap_or_else(|_| Err(ended()));
        interrupted.map_or(outcome, Err)
    })
}

/// [`on_threads`] without the interpreter's lock.
pub fn compute<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    work: impl FnOnce() -> PyResult<R> + Send,
) -> PyResult<R> {
    py.detach(|| on_threads(threads, work))
}
