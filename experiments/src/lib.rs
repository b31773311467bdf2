//! Studies on top of `nonrigid`: one file each, which reads like its description.

use nonrigid::io::{FaceUnit, LengthUnit, face_extent};

pub mod ceres;
pub mod compare_rigs;
pub mod consistency;
pub mod flicker;
pub mod generated;
pub mod more_garbow_hillstrom;
pub mod nist;
pub mod output;
pub mod peers;
pub mod plots;
pub mod process;
mod processor_time;
pub mod random_pose;
pub mod real_scans;
pub mod report;
pub mod rig_statistics;
pub mod scaling;
pub mod scan_bench;
pub mod schedule_search;
pub mod silence;
pub mod solver_case;
pub mod start_bench;
pub mod start_cases;
pub mod statistics;
pub mod surgery;
pub mod tables;
pub mod unseen;

/// Refuses what has the size of a face in another unit than millimetres, in which all data of studies are.
///
/// # Errors
/// The message names the file and the unit.
pub fn check_millimetres(path: &std::path::Path, points: &[nonrigid::mesh::Vec3]) -> anyhow::Result<()> {
    match FaceUnit::of(face_extent(points)) {
        FaceUnit::One(LengthUnit::Millimetre) | FaceUnit::Unknown => Ok(()),
        FaceUnit::One(unit) | FaceUnit::Likely(unit, _) | FaceUnit::Either(unit, _) => {
            anyhow::bail!("{}: expected millimetres, found the size of a face in {unit}", path.display())
        }
    }
}

/// What could not be read.
fn unread(error: anyhow::Error) -> nonrigid::console::Failure {
    nonrigid::console::Failure::loading(nonrigid::console::told(error))
}

/// How many identity modes of a rig take part: those that are asked for, or as many as usual.
///
/// # Errors
/// A [`Failure`](nonrigid::console::Failure) of the arguments when the rig has fewer.
fn identity_modes(rig: &nonrigid::rig::Rig, asked: Option<usize>) -> Result<usize, nonrigid::console::Failure> {
    let has = rig.identity_modes();
    match asked {
        Some(asked) if asked > has => {
            let message = format!("--identity-modes: {asked} asked for, the rig has {has}");
            Err(nonrigid::console::Failure::new(nonrigid::console::Stage::Arguments, message))
        }
        _ => Ok(asked.unwrap_or_else(|| rig.usual_identity_modes(None, false))),
    }
}

/// Which shapes of a rig are expressions, and which identity modes.
fn families(rig: &nonrigid::rig::Rig) -> (Vec<usize>, Vec<usize>) {
    let expression = |k: &usize| rig.shapes()[*k].family != nonrigid::rig::Family::Identity;
    (0..rig.shapes().len()).partition(expression)
}

/// Adds a shape of a rig to points, one for each vertex.
fn add_shape(points: &mut [nonrigid::mesh::Vec3], rig: &nonrigid::rig::Rig, shape: usize, weight: f64) {
    for (p, d) in points.iter_mut().zip(rig.deltas(shape).chunks_exact(3)) {
        *p += nonrigid::mesh::Vec3::new(d[0].into(), d[1].into(), d[2].into()) * weight;
    }
}

/// The file of this program, whose processes measure what needs one of its own.
///
/// # Errors
/// A [`Failure`](nonrigid::console::Failure) of the computation when the system does not say.
pub fn this_program() -> anyhow::Result<std::path::PathBuf> {
    let program = std::env::current_exe();
    Ok(program.map_err(|e| nonrigid::console::Failure::computation(format!("this program's own file: {e}")))?)
}
