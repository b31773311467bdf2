//! Generated data: a rig and one scan with its truth on disk, as a first run needs it; the standard cases in memory. All use of
//! `data-gen` is here.

use std::path::{Path, PathBuf};

use anyhow::Result;
use data_gen::{FaceOptions, FaceRig, STANDARD_CASES, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use nonrigid::cli::Failure;
use nonrigid::mesh::Pose;
use nonrigid::mesh::io::{Landmark, Scan, TemplatePoint};
use nonrigid::rig::{Family, Rig, Shape, ShapeSelection};

use crate::scan_bench::BenchCase;

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
    let rig = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
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

/// The standard cases on a template of about `vertices` vertices, scans of about `triangles` triangles; as `data-gen` writes them
/// to files, but for its rounding to 32 bits.
///
/// # Errors
/// When `triangles` is too few for a scan.
pub fn standard_cases(vertices: usize, triangles: usize, seed: u64) -> Result<Vec<BenchCase>> {
    let face = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    let expressions = face.expressions.iter().map(|(name, d)| (name.clone(), Family::Expression, d));
    let identities = face.identities.iter().enumerate().map(|(k, d)| (format!("identity{k:03}"), Family::Identity, d));
    let (mut shapes, mut deltas) = (Vec::new(), Vec::new());
    for (name, family, delta) in expressions.chain(identities) {
        shapes.push(Shape { name, family });
        deltas.extend(delta.iter().flat_map(|d| [d.x as f32, d.y as f32, d.z as f32]));
    }
    let (rig, _) = Rig::new(face.neutral.clone(), Some(face.mesh.clone()), shapes, deltas)?;
    let case = |(k, standard): (usize, &data_gen::StandardCase)| -> Result<BenchCase> {
        let options = ScanOptions { expressions: Some(standard.expressions()), triangles, ..ScanOptions::default() };
        let scan = simulate_scan(&face, &options, seed + k as u64)?;
        let (withheld, identity_modes) = match standard.subject(&face)? {
            Subject::Same { withheld } => (withheld, 0),
            Subject::New { identity_modes } => (Vec::new(), identity_modes),
        };
        let offered = rig.shapes().iter().filter(|s| s.family == Family::Expression).map(|s| s.name.clone());
        let names: Vec<String> = offered.filter(|name| !withheld.contains(name)).collect();
        let landmark = |&(vertex, target): &(u32, _)| Landmark {
            name: vertex.to_string(),
            template: TemplatePoint::Vertex(vertex),
            target,
        };
        Ok(BenchCase {
            name: standard.name.to_owned(),
            template: face.mesh.clone(),
            neutral: standard.withheld.map(|_| face.pose(&[], &scan.identity_weights)),
            shapes: rig.select(ShapeSelection { names: Some(&names), identity_modes })?,
            landmarks: scan.landmarks.iter().map(landmark).collect(),
            scan: Scan { mesh: scan.scan, normals: None, colors: None },
            truth: scan.truth,
            observed: scan.observed,
        })
    };
    STANDARD_CASES.iter().enumerate().map(case).collect()
}
