//! Studies on small generated cases, called as a library.

#[path = "../../../tests/support/real_data.rs"]
mod real_data;
#[path = "../../../tests/support/skip.rs"]
mod skip;
#[path = "../../../tests/support/threads.rs"]
mod threads;

mod real_scans;
mod scan_bench;
mod silence;
