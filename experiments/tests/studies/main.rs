//! Studies on small generated cases, called as a library.

mod real_scans;
mod scan_bench;
mod silence;
