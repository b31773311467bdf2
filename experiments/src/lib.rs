//! Studies on top of `nonrigid`: one file each, which reads like its description.

pub mod compare;
pub mod compare_rigs;
pub mod faulty_scans;
pub mod generated;
pub mod more_garbow_hillstrom;
pub mod nist;
pub mod plots;
pub mod random_pose;
pub mod real_scans;
pub mod remesh;
pub mod report;
pub mod rig_statistics;
pub mod scaling;
pub mod scan_bench;
pub mod scan_bench_command;
pub mod schedule_search;
pub mod solver_case;
pub mod start_bench;
pub mod surgery;
pub mod tables;

/// The file of this program, whose processes measure what needs one of its own.
///
/// # Errors
/// A [`Failure`](nonrigid::cli::Failure) of the computation when the system does not say.
pub fn this_program() -> anyhow::Result<std::path::PathBuf> {
    let program = std::env::current_exe();
    Ok(program.map_err(|e| nonrigid::cli::Failure::computation(format!("this program's own file: {e}")))?)
}
