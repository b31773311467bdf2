//! `start-bench`: in how many poses is the start found without landmarks?
//!
//! Varied: the pose of the scan. Held: the scan, the template's rest shape, the schedule. Measured: turn and distance at the
//! template's centroid between the start that is searched and the one by all landmarks.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use nonrigid::mesh::io::{self, Landmark, Scan};
use nonrigid::mesh::{PolygonMesh, Pose, Vec3};
use nonrigid::registration::{RegistrationInput, Schedule, StartSearch, find_start};
use nonrigid::rig::ShapeBasis;

use crate::scan_bench::{BenchCase, BenchRig};

/// A scan whose pose the landmarks tell.
pub struct StartCase {
    /// Name.
    pub name: String,
    /// The template's rest shape.
    pub template: PolygonMesh,
    /// The scan.
    pub scan: Scan,
    /// Its shapes.
    pub shapes: ShapeBasis,
    /// Landmarks that give the reference.
    pub landmarks: Vec<Landmark>,
}

impl StartCase {
    /// A scan with its landmarks.
    pub fn read(scan: &Path, landmarks: Option<&PathBuf>, rig: &BenchRig) -> Result<Self> {
        let template = rig.template();
        let name = scan.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let scan = io::read_scan(scan)?;
        let landmarks = match landmarks {
            Some(path) => io::read_landmarks(path, None, template, Some(&scan.mesh))?,
            None => Vec::new(),
        };
        Ok(Self { name, template: template.clone(), shapes: rig.expressions()?, scan, landmarks })
    }
}

impl From<BenchCase> for StartCase {
    fn from(case: BenchCase) -> Self {
        let template = match case.neutral {
            Some(neutral) => case.template.with_positions(neutral),
            None => case.template,
        };
        Self { name: case.name, template, shapes: case.shapes, scan: case.scan, landmarks: case.landmarks }
    }
}

/// What came out.
pub struct StartRow {
    /// Turn against the start by landmarks, degrees.
    pub turn: f64,
    /// Distance of the template's centroid to where the landmarks put it, millimetres.
    pub distance: f64,
    /// The start.
    pub pose: Pose,
    /// The search.
    pub search: StartSearch,
    /// Wall time.
    pub seconds: f64,
}

/// Searches the start of the case moved by `moved`.
pub fn start_case(case: &StartCase, moved: &Pose, schedule: &Schedule) -> Result<StartRow> {
    let mut scan = case.scan.mesh.clone();
    scan.positions.iter_mut().for_each(|p| *p = moved.apply(*p));
    let mut normals = case.scan.normals.clone();
    normals.iter_mut().flatten().for_each(|n| *n = moved.rotation * *n);
    let landmarks: Vec<Landmark> =
        case.landmarks.iter().map(|l| Landmark { target: moved.apply(l.target), ..l.clone() }).collect();
    let without = RegistrationInput {
        shapes: &case.shapes,
        scan_normals: normals.as_deref(),
        ..RegistrationInput::new(&case.template, &scan)
    };
    let clock = Instant::now();
    let (pose, search) = find_start(&without, schedule)?;
    let seconds = clock.elapsed().as_secs_f64();
    let search = search.expect("proven: no landmarks were given");
    let (turn, distance) = if landmarks.len() < 3 {
        (f64::NAN, f64::NAN)
    } else {
        let (reference, _) = find_start(&RegistrationInput { landmarks: &landmarks, ..without }, schedule)?;
        let cosine = 0.5 * ((reference.rotation.transpose() * pose.rotation).trace() - 1.0);
        let centre = case.template.positions.iter().sum::<Vec3>() / case.template.positions.len() as f64;
        (cosine.clamp(-1.0, 1.0).acos().to_degrees(), (reference.apply(centre) - pose.apply(centre)).norm())
    };
    Ok(StartRow { turn, distance, pose, search, seconds })
}
