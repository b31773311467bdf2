//! Studies on top of `nonrigid`.
pub mod scan_bench;
