//! Errors of the library as Python exceptions, by kind, and the one way in which this module computes.

use std::any::Any;
use std::error::Error;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
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

/// `OSError` of a message that names the file first and has the system's number: as Python's own, whose class is found by the number
/// (`FileNotFoundError`, ...), with the file besides.
pub fn os_error(message: &str) -> PyErr {
    let Some((before, (number, after))) = message
        .split_once(" (os error ")
        .and_then(|(before, rest)| Some((before, rest.split_once(')')?)))
        .and_then(|(before, (number, after))| Some((before, (number.parse::<i32>().ok()?, after))))
    else {
        return PyOSError::new_err(message.to_owned());
    };
    let number = if cfg!(unix) { number } else { of_kind(io::Error::from_raw_os_error(number).kind()) };
    let verb = [": cannot be read: ", ": cannot be written: "].into_iter().find_map(|verb| before.find(verb));
    match verb.map(|at| before.split_at(at)) {
        Some((file, why)) => {
            PyOSError::new_err((number, format!("{}{after}", why.trim_start_matches(": ")), file.to_owned()))
        }
        None => PyOSError::new_err((number, format!("{before}{after}"))),
    }
}

/// The number that C has for what another system numbers otherwise.
fn of_kind(kind: io::ErrorKind) -> i32 {
    match kind {
        io::ErrorKind::NotFound => 2,
        io::ErrorKind::PermissionDenied => 13,
        io::ErrorKind::AlreadyExists => 17,
        io::ErrorKind::NotADirectory => 20,
        io::ErrorKind::IsADirectory => 21,
        io::ErrorKind::StorageFull => 28,
        _ => 5,
    }
}

fn told(error: &(dyn Error + 'static), otherwise: impl FnOnce(String) -> PyErr) -> PyErr {
    use io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
    let message = in_python(&error.to_string());
    match of_system(error) {
        // what is in a file, or its name, is wrong
        Some(source) if matches!(source.kind(), InvalidData | InvalidInput | UnexpectedEof) => value(message),
        Some(_) => os_error(&message),
        None => otherwise(message),
    }
}

/// What the library says, with arguments where it names options of the command line.
pub fn in_python(text: &str) -> String {
    let mut parts = text.split("--");
    let mut told = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let begins = told.chars().last().is_none_or(|c| " ('\"".contains(c));
        let end = part.find(|c: char| !(c.is_ascii_lowercase() || c == '-')).unwrap_or(part.len());
        if begins && part.starts_with(|c: char| c.is_ascii_lowercase()) {
            told += &part[..end].replace('-', "_");
            told += &part[end..];
        } else {
            told += "--";
            told += part;
        }
    }
    told
}

/// Inputs that cannot be used: `OSError` if the system could not read or write them, otherwise `ValueError`.
pub fn input(error: impl Error + 'static) -> PyErr {
    told(&error, value)
}

/// A computation that failed, or `OSError`.
pub fn computation(error: impl Error + 'static) -> PyErr {
    told(&error, ComputationError::new_err::<String>)
}

/// `ValueError`.
pub fn value(message: impl ToString) -> PyErr {
    PyValueError::new_err(message.to_string())
}

fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}

/// The system gives no more threads.
pub fn no_thread(error: impl Error) -> PyErr {
    ComputationError::new_err(format!("threads: {error}"))
}

/// Runs `work` on threads of its own, as many as asked for or one a core.
pub fn on_threads<R: Send>(threads: Option<usize>, work: impl FnOnce() -> PyResult<R> + Send) -> PyResult<R> {
    if threads.is_some_and(|n| !(1..=1024).contains(&n)) {
        return Err(value("threads: give a number from 1 to 1024, or None for one a core"));
    }
    let in_pool = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
        pool.map_err(no_thread)?.install(work)
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
        let thread = std::thread::Builder::new().spawn_scoped(scope, move || on_threads(threads, || work(stopped)));
        let thread = thread.map_err(no_thread)?;
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

/// [`on_threads`] besides this one, which looks for Ctrl-C meanwhile and then leaves the work, which ends by itself and is heard of no
/// more: for what cannot be stopped and writes nothing.
pub fn abandonable<R: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    work: impl FnOnce() -> PyResult<R> + Send + 'static,
) -> PyResult<R> {
    let (to_here, from_there) = channel();
    std::thread::Builder::new().spawn(move || to_here.send(on_threads(threads, work))).map_err(no_thread)?;
    let from_there = Mutex::new(from_there);
    loop {
        let outcome = py.detach(|| {
            let from_there = from_there.lock().unwrap_or_else(PoisonError::into_inner);
            from_there.recv_timeout(Duration::from_millis(20))
        });
        match outcome {
            Ok(outcome) => return outcome,
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(ComputationError::new_err("a thread of nonrigid has ended; please report it"));
            }
        }
    }
}

/// [`on_threads`] without the interpreter's lock.
pub fn compute<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    work: impl FnOnce() -> PyResult<R> + Send,
) -> PyResult<R> {
    py.detach(|| on_threads(threads, work))
}
