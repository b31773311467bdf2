//! Tests that skip: one line that counts them, after all else that a test program says.

#![allow(unsafe_code)] // the test harness says nothing of its end, the C library does

use std::io::Write as _;
use std::sync::Mutex;

static SKIPPED: Mutex<Vec<String>> = Mutex::new(Vec::new());

unsafe extern "C" {
    fn atexit(call: extern "C" fn()) -> std::ffi::c_int;
}

/// Notes that something was not tested, and why: what is absent. The line comes when the program ends, and past the capture of
/// what passing tests say.
pub fn skipped(why: impl Into<String>) {
    let mut skipped = SKIPPED.lock().unwrap();
    if skipped.is_empty() {
        // SAFETY: the C library calls it once, when `main` is over; it neither unwinds nor ends the process.
        assert_eq!(unsafe { atexit(say) }, 0, "the line at the end cannot be said");
    }
    skipped.push(why.into());
}

extern "C" fn say() {
    let Ok(mut skipped) = SKIPPED.lock() else { return };
    let count = skipped.len();
    skipped.sort();
    skipped.dedup();
    // Nobody is left to be told of an error.
    let _ = writeln!(std::io::stderr(), "skipped {count}: {}", skipped.join("; "));
}
