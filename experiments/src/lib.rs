//! Studies on top of `nonrigid`: one file each, which reads like its description.

pub mod first;
mod generated;
pub mod random_pose;
pub mod rig_statistics;
pub mod scan_bench;
pub mod start_bench;
pub mod tables;
