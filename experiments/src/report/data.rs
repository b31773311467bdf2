//! The rig and the cases that most studies share: generated, or the user's own.

use std::path::{Path, PathBuf};

use anyhow::Result;
use nonrigid::console::Failure;
use nonrigid::io::files_of_mesh;
use nonrigid::mesh::{Pose, PoseKind, Vec3, closest_pose};
use nonrigid::registration::{InputFile, ModelKind};

use super::effort::Effort;
use crate::generated::write_standard_cases;
use crate::real_scans::{Arguments, ScanFile, scans_in};
use crate::scan_bench::{BenchCase, BenchRig, case_folders};
use crate::unread;

/// Rig and cases.
pub struct Data {
    /// Rig folder.
    pub rig_folder: PathBuf,
    /// Folder of the cases.
    pub cases_folder: PathBuf,
    /// Whether they are made from the seed.
    pub generated: bool,
    /// The rig.
    pub rig: BenchRig,
    /// The cases, by the standard order or by name; at least one.
    pub cases: Vec<BenchCase>,
    /// The user's rig and scans without truth, where there are any.
    pub real: Option<RealScans>,
}

/// Scans without truth, and the rig that goes with them.
#[derive(Debug, Clone)]
pub struct RealScans {
    /// Rig folder.
    pub rig: PathBuf,
    /// Folder of the scans.
    pub folder: PathBuf,
    /// The scans; at least one.
    pub scans: Vec<ScanFile>,
}

impl Data {
    /// Makes rig and standard cases in `folder`.
    ///
    /// # Errors
    /// When something cannot be written or read back.
    pub fn generate(folder: &Path, effort: &Effort, seed: u64) -> Result<Self> {
        write_standard_cases(folder, effort.vertices, effort.triangles, &effort.cases, seed)?;
        let mut data = Self::read(&folder.join("rig"), &folder.join("cases"))?;
        data.cases.sort_by_key(|case| effort.cases.iter().position(|name| *name == case.name));
        data.generated = true;
        Ok(data)
    }

    /// Reads rig and cases.
    ///
    /// # Errors
    /// When something cannot be read.
    pub fn read(rig_folder: &Path, cases_folder: &Path) -> Result<Self> {
        let rig = BenchRig::read(rig_folder).map_err(unread)?;
        let cases = BenchCase::read_all(cases_folder, &rig).map_err(unread)?;
        let (rig_folder, cases_folder) = (rig_folder.to_owned(), cases_folder.to_owned());
        Ok(Self { rig_folder, cases_folder, generated: false, rig, cases, real: None })
    }

    /// The user's own: cases with truth, folders with a `case.json`, anywhere below `scans`; and [`RealScans::find`]. With real scans
    /// alone the cases are those that `generate` makes.
    ///
    /// # Errors
    /// When something cannot be read, or there is neither; as `generate`.
    pub fn of_user(rig: &Path, scans: &Path, generate: impl FnOnce() -> Result<Self>) -> Result<Self> {
        let real = RealScans::find(rig, scans);
        let mut data = match (case_folders(scans), &real) {
            (Err(_), Some(_)) => {
                BenchRig::read(rig).map_err(unread)?;
                generate()?
            }
            _ => Self::read(rig, scans)?,
        };
        data.real = real;
        Ok(data)
    }

    /// The case whose scan is farthest from where a rigid motion takes the neutral: the most extreme expression.
    ///
    /// # Panics
    /// Without cases; there is at least one.
    #[must_use]
    pub fn extreme(&self) -> &BenchCase {
        let size = |case: &BenchCase| {
            let (rest, pose) = (case.rest(), upright(case));
            let way: f64 = rest.iter().zip(&case.truth).map(|(r, t)| (pose.apply(*r) - t).norm_squared()).sum();
            (case.neutral.is_some(), way)
        };
        let farther = |a: &&BenchCase, b: &&BenchCase| {
            let (a, b) = (size(a), size(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        };
        self.cases.iter().max_by(farther).expect("proven: reading refuses a folder without cases")
    }

    /// Every file of rig and cases with its hash.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn hashes(&self) -> Result<Vec<InputFile>> {
        let mut found = Vec::new();
        let mut hash = |role: &'static str, folder: &Path, files: Vec<PathBuf>| -> Result<()> {
            for path in files {
                let mut file = InputFile::hash(role, &path).map_err(|e| unreadable(&path, &e))?;
                file.name = path.strip_prefix(folder).unwrap_or(&path).display().to_string();
                found.push(file);
            }
            Ok(())
        };
        hash("rig", &self.rig_folder, files_below(&self.rig_folder)?)?;
        hash("cases", &self.cases_folder, files_below(&self.cases_folder)?)?;
        if let Some(RealScans { rig, folder, scans }) = &self.real {
            hash("rig of real scans", rig, files_below(rig)?)?;
            let files = scans.iter().flat_map(|s| files_of_mesh(&s.path).into_iter().chain(s.landmarks()));
            hash("real scans", folder, files.collect())?;
        }
        Ok(found)
    }
}

impl RealScans {
    /// What [`scans_in`] finds in `scans/scans`, or else in `scans`, but for cases with truth, which have a `case.json` beside.
    #[must_use]
    pub fn find(rig: &Path, scans: &Path) -> Option<Self> {
        let in_folder = |folder: PathBuf| {
            let mut scans = scans_in(&folder, rig).unwrap_or_default();
            scans.retain(|scan| !scan.path.with_file_name("case.json").exists());
            (!scans.is_empty()).then(|| Self { rig: rig.to_owned(), folder, scans })
        };
        [scans.join("scans"), scans.to_owned()].into_iter().find_map(in_folder)
    }

    /// How `real-scans` registers them with these models.
    #[must_use]
    pub fn arguments(&self, models: Vec<ModelKind>, out: PathBuf) -> Arguments {
        let (scans, rig) = (self.folder.clone(), self.rig.clone());
        Arguments { scans, rig, identity_modes: None, models, out, threads: None }
    }
}

fn unreadable(path: &Path, e: &std::io::Error) -> Failure {
    Failure::loading(format!("{}: {e}", path.display()))
}

/// Every file below a folder, by name.
fn files_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| unreadable(folder, &e))? {
        let path = entry.map_err(|e| unreadable(folder, &e))?.path();
        if path.is_dir() { found.extend(files_below(&path)?) } else { found.push(path) }
    }
    found.sort();
    Ok(found)
}

/// The pose of the person's neutral, or else the template, in the scan: its inverse stands the scan upright for a picture.
#[must_use]
pub fn upright(case: &BenchCase) -> Pose {
    let pairs: Vec<(Vec3, Vec3)> = case.rest().iter().copied().zip(case.truth.iter().copied()).collect();
    closest_pose(&pairs, PoseKind::Rigid).unwrap_or_else(|_| Pose::identity())
}
