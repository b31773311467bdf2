//! Generated data, as a first run needs it: a rig and one scan with its truth, on disk. All use of `data-gen` is here.

use std::path::{Path, PathBuf};

use anyhow::Result;
use data_gen::{FaceOptions, FaceRig, STANDARD_CASES, ScanOptions, simulate_scan, write_case, write_rig};
use nonrigid::cli::Failure;
use nonrigid::mesh::Pose;

/// Where the data is, and what the files do not say.
pub struct Generated {
    /// Rig folder.
    pub rig: PathBuf,
    /// Folder of the one case.
    pub case: PathBuf,
    /// From the rig's coordinates to the scan's: pictures are taken in the rig's.
    pub pose: Pose,
    /// Template vertices of the mouth's landmarks.
    pub mouth: Vec<u32>,
    /// Number of the rig's identity modes.
    pub identity_modes: usize,
}

/// Makes a rig of about `vertices` vertices and the first standard case, a mouth wide open under raised brows of a person whose
/// neutral is known, and writes them to `folder`/rig and `folder`/cases/same_open.
///
/// # Errors
/// When a file cannot be written.
pub fn extreme_mouth(folder: &Path, vertices: usize, seed: u64) -> Result<Generated> {
    let rig = face_rig(vertices);
    let [standard, ..] = STANDARD_CASES;
    let options = ScanOptions { expressions: Some(standard.expressions()), ..ScanOptions::default() };
    let scan = simulate_scan(&rig, &options, seed)?;

    let (rig_folder, case_folder) = (folder.join("rig"), folder.join("cases").join(standard.name));
    let unwritten = |e: anyhow::Error| Failure::writing(format!("{e:#}"));
    write_rig(&rig_folder, &rig).map_err(unwritten)?;
    write_case(&case_folder, &rig, &scan, &standard.subject(&rig)?, seed).map_err(unwritten)?;
    let mouth = rig.landmarks.iter().skip(48).map(|l| l.vertex).collect(); // 48 to 67 of the 68 are the mouth
    Ok(Generated { rig: rig_folder, case: case_folder, pose: scan.pose, mouth, identity_modes: rig.identities.len() })
}

/// Writes a rig of about `vertices` vertices and all standard cases to `folder`/rig and `folder`/cases; returns both folders.
///
/// # Errors
/// When a file cannot be written.
pub fn standard_cases(folder: &Path, vertices: usize, seed: u64) -> Result<(PathBuf, PathBuf)> {
    let rig = face_rig(vertices);
    let (rig_folder, cases) = (folder.join("rig"), folder.join("cases"));
    let unwritten = |e: anyhow::Error| Failure::writing(format!("{e:#}"));
    write_rig(&rig_folder, &rig).map_err(unwritten)?;
    for (standard, seed) in STANDARD_CASES.iter().zip(seed..) {
        let options = ScanOptions { expressions: Some(standard.expressions()), ..ScanOptions::default() };
        let scan = simulate_scan(&rig, &options, seed)?;
        write_case(&cases.join(standard.name), &rig, &scan, &standard.subject(&rig)?, seed).map_err(unwritten)?;
    }
    Ok((rig_folder, cases))
}

fn face_rig(vertices: usize) -> FaceRig {
    FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() })
}
