//! `scan-bench`: everything that can be chosen, and other programs, on every case with exact dense ground truth, in one table.
//!
//! Varied, one thing in each group: the model with its default schedule; the robust kernel of the hybrid; its data terms; the
//! program. Held: the case, its shapes and landmarks. Measured: the error against the true position of every template vertex,
//! split into the part along the surface's normal and the part along it; folds; and, each variant in a process of its own,
//! seconds and memory.

pub mod command;
mod external;
mod measure;
mod row;
mod variant;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use nonrigid::evaluation::{ApertureErrors, EvaluationError, MeshQuality, TruthErrors};
use nonrigid::io::{self, Scan};
use nonrigid::landmark;
use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PolygonMesh, Pose, Vec3};
use nonrigid::registration::{
    Level, ModelFactory, RegistrationError, RegistrationInput, RegistrationResult, Schedule, Silent, Stage,
    TermFactory, register_with,
};
use nonrigid::rig::{Regions, Rig, ShapeBasis, ShapeSelection};
use serde::{Deserialize, Serialize};

pub use command::read_schedule;
pub use external::External;
pub use measure::{CaseSource, measure};
pub use row::{BenchRow, BenchSummary, Score, megabytes, summarize, summary_table, table_of, write_rows};
pub use variant::Variant;

/// One case: a scan with the true position of every template vertex.
#[derive(Clone)]
pub struct BenchCase {
    /// Name of its folder.
    pub name: String,
    /// Template polygons and positions.
    pub template: PolygonMesh,
    /// The subject's own neutral, where it is known.
    pub neutral: Option<Vec<Vec3>>,
    /// Regions of the template.
    pub regions: Regions,
    /// The shapes that a fit may use.
    pub shapes: ShapeBasis,
    /// The scan.
    pub scan: Scan,
    /// True vertex positions in the scan's frame, millimetres.
    pub truth: Vec<Vec3>,
    /// Which vertices the scan shows.
    pub observed: Vec<bool>,
    /// Landmarks.
    pub landmarks: Vec<Landmark>,
    /// The rig's 68 landmarks, empty if it has none: where apertures are measured.
    pub rig_landmarks: Vec<u32>,
}

/// What of `case.json` a fit needs.
#[derive(Deserialize)]
struct CaseFile {
    rig_expressions: Vec<String>,
    rig_identity_modes: usize,
}

/// The template and rig that all cases share.
pub struct BenchRig {
    template: PolygonMesh,
    rig: Rig,
}

impl BenchRig {
    /// Reads a rig folder; its polygons are the template.
    pub fn read(folder: &Path) -> Result<Self> {
        let (rig, _) = Rig::read(folder, &nonrigid::rig::RigReadOptions::default())?;
        crate::check_millimetres(folder, rig.neutral())?;
        let template = rig.mesh().with_context(|| format!("{}: the rig has no template mesh", folder.display()))?;
        Ok(Self { template: template.clone(), rig })
    }

    /// The template.
    #[must_use]
    pub fn template(&self) -> &PolygonMesh {
        &self.template
    }

    /// The rig.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// All expressions.
    pub fn expressions(&self) -> Result<ShapeBasis> {
        Ok(self.rig.select(ShapeSelection::default())?)
    }
}

impl BenchCase {
    /// The shape that a fit deforms: the subject's neutral, or else the template.
    #[must_use]
    pub fn rest(&self) -> &[Vec3] {
        self.neutral.as_deref().unwrap_or(&self.template.positions)
    }

    /// What a fit is given, all landmarks included.
    #[must_use]
    pub fn input(&self) -> RegistrationInput<'_> {
        RegistrationInput {
            neutral: self.neutral.as_deref(),
            shapes: &self.shapes,
            scan_normals: self.scan.normals.as_deref(),
            landmarks: &self.landmarks,
            regions: Some(&self.regions),
            ..RegistrationInput::new(&self.template, &self.scan.mesh)
        }
    }

    /// Reads a case folder.
    pub fn read(folder: &Path, rig: &BenchRig) -> Result<Self> {
        let path = folder.join("case.json");
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let case: CaseFile = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        let vertices = rig.template.positions.len();
        let points = |file: &str| -> Result<Vec<Vec3>> {
            let path = folder.join(file);
            let points = io::read_npy_points(&path)?;
            crate::check_millimetres(&path, &points)?;
            if points.len() != vertices {
                bail!("{}: {} points, but the template has {vertices} vertices", path.display(), points.len());
            }
            Ok(points)
        };
        let selection = ShapeSelection { names: Some(&case.rig_expressions), identity_modes: case.rig_identity_modes };
        let scan = io::read_scan(&folder.join("scan.ply"))?;
        crate::check_millimetres(&folder.join("scan.ply"), &scan.mesh.positions)?;
        Ok(Self {
            name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            template: rig.template.clone(),
            neutral: if folder.join("neutral.npy").exists() { Some(points("neutral.npy")?) } else { None },
            shapes: rig.rig.select(selection).with_context(|| path.display().to_string())?,
            truth: points("truth.npy")?,
            observed: io::read_npy_mask(&folder.join("observed.npy"), Some(vertices))?,
            landmarks: landmark::read_landmarks(&folder.join("landmarks.json"), None, &rig.template, Some(&scan.mesh))?,
            regions: Regions::of(Some(&rig.rig), &rig.template),
            rig_landmarks: rig.rig.landmarks().unwrap_or_default().to_vec(),
            scan,
        })
    }

    /// Reads every case that [`case_folders`] finds.
    pub fn read_all(folder: &Path, rig: &BenchRig) -> Result<Vec<Self>> {
        case_folders(folder)?.iter().map(|f| Self::read(f, rig)).collect()
    }

    /// Errors of `positions` against the truth; self-intersections and stretch against the subject's neutral, or else the template.
    ///
    /// # Errors
    /// When `positions` are not as many as the template's.
    pub fn score(&self, positions: &[Vec3]) -> Result<(TruthErrors, MeshQuality), EvaluationError> {
        let triangles = self.template.triangulate().triangles;
        let (errors, _) = TruthErrors::new(positions, &self.truth, &self.observed, &triangles)?;
        let rest = self.template.with_positions(self.rest().to_vec());
        Ok((errors, MeshQuality::new(&rest, positions)?))
    }

    /// A result in numbers, and another program's `iterations` are unknown.
    ///
    /// # Errors
    /// As [`score`](Self::score).
    pub fn scored(&self, positions: &[Vec3], iterations: Option<usize>) -> Result<Score, EvaluationError> {
        let (errors, mesh) = self.score(positions)?;
        let apertures = ApertureErrors::new(positions, &self.truth, &self.rig_landmarks);
        let unobserved_vertices = self.observed.len() - errors.observed_vertices;
        Ok(Score { errors, mesh, unobserved_vertices, apertures, iterations })
    }

    /// The same case with scan, truth and landmarks moved by `pose`: what a fit has to undo.
    #[must_use]
    pub fn moved(mut self, pose: &Pose) -> Self {
        let points = self.scan.mesh.positions.iter_mut().chain(&mut self.truth);
        points.chain(self.landmarks.iter_mut().map(|l| &mut l.target)).for_each(|p| *p = pose.apply(*p));
        for normal in self.scan.normals.iter_mut().flatten() {
            *normal = pose.rotation * *normal;
        }
        self
    }
}

/// Every case folder (one with a `case.json`) below `folder`, sorted, or `folder` itself; at least one.
pub fn case_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    if folder.join("case.json").exists() {
        // A case is called as its folder, which `.` does not say.
        let named = if folder.file_name().is_some() { folder.to_owned() } else { folder.canonicalize()? };
        return Ok(vec![named]);
    }
    let mut folders = cases_below(folder)?;
    folders.sort();
    if folders.is_empty() {
        bail!("{}: no case.json in it or in a folder below; give a folder of cases", folder.display());
    }
    Ok(folders)
}

fn cases_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.join("case.json").exists() {
            found.push(path);
        } else if path.is_dir() {
            found.extend(cases_below(&path)?);
        }
    }
    Ok(found)
}

/// How landmarks take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum LandmarkUse {
    /// All, in the start and in the energy.
    All,
    /// All in the start, none in the energy.
    Align,
    /// None: the start is searched.
    None,
    /// This many, spread over the face, in the start and in the energy.
    Some(usize),
}

impl std::str::FromStr for LandmarkUse {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match (s, s.parse()) {
            ("all", _) => Ok(Self::All),
            ("align", _) => Ok(Self::Align),
            ("none", _) => Ok(Self::None),
            (_, Ok(n)) if n >= 3 => Ok(Self::Some(n)),
            _ => Err(format!("'{s}' is neither 'all', 'align' nor 'none', nor a number of at least 3")),
        }
    }
}

impl LandmarkUse {
    /// The landmarks and schedule of a run.
    fn apply(self, case: &BenchCase, schedule: &Schedule) -> (Vec<Landmark>, Schedule) {
        let mut schedule = schedule.clone();
        let landmarks = match self {
            Self::All => case.landmarks.clone(),
            Self::None => Vec::new(),
            Self::Some(n) => spread(&case.landmarks, &case.template, n),
            Self::Align => {
                each_level(&mut schedule, |level| level.set_term("landmarks", 0.0));
                case.landmarks.clone()
            }
        };
        (landmarks, schedule)
    }
}

/// Changes the levels of all stages.
pub fn each_level(schedule: &mut Schedule, mut change: impl FnMut(&mut Level)) {
    schedule.levels.iter_mut().for_each(&mut change);
    schedule.closed.iter_mut().flat_map(|closed| &mut closed.levels).for_each(&mut change);
    let mut stage = schedule.then.as_deref_mut();
    while let Some(Stage { levels, then, .. }) = stage {
        levels.iter_mut().for_each(&mut change);
        stage = then.as_deref_mut();
    }
}

/// `n` landmarks spread over the face: the one nearest to the middle of all, then always the farthest from those chosen.
fn spread(landmarks: &[Landmark], template: &PolygonMesh, n: usize) -> Vec<Landmark> {
    let at: Vec<Vec3> = landmarks.iter().map(|l| l.template.position(&template.positions)).collect();
    let middle = at.iter().sum::<Vec3>() / at.len().max(1) as f64;
    let mut next = (0..at.len()).min_by(|&a, &b| (at[a] - middle).norm().total_cmp(&(at[b] - middle).norm()));
    let mut distance = vec![f64::INFINITY; at.len()];
    let mut chosen = Vec::new();
    while let Some(i) = next.filter(|_| chosen.len() < n) {
        chosen.push(landmarks[i].clone());
        distance.iter_mut().zip(&at).for_each(|(d, p)| *d = d.min((p - at[i]).norm()));
        // The first of equals, so that the choice is the same everywhere.
        next = (0..at.len()).rev().max_by(|&a, &b| distance[a].total_cmp(&distance[b])).filter(|&i| distance[i] > 0.0);
    }
    chosen
}

/// Registers one model with its schedule to one case: the result, and how many seconds it took.
pub fn fit_case(
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    case: &BenchCase,
    landmarks: LandmarkUse,
) -> Result<(RegistrationResult, f64), RegistrationError> {
    let (landmarks, schedule) = landmarks.apply(case, schedule);
    let input = RegistrationInput { landmarks: &landmarks, ..case.input() };
    let clock = Instant::now();
    let result = register_with(&input, model, terms, &schedule, &mut Silent)?;
    Ok((result, clock.elapsed().as_secs_f64()))
}

/// Runs one model with its schedule on one case: its score, the result, and how many seconds that took.
///
/// # Errors
/// When the registration fails.
pub fn run_case(
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    case: &BenchCase,
    landmarks: LandmarkUse,
) -> Result<(Score, RegistrationResult, f64)> {
    let (result, seconds) = fit_case(model, terms, schedule, case, landmarks)
        .with_context(|| format!("{} on {}", model.name(), case.name))?;
    Ok((case.scored(&result.positions, Some(result.history.len()))?, result, seconds))
}

/// Every model, each with its own default schedule, on every case, in this process. Your own [`ModelFactory`] or [`TermFactory`]
/// lands in the same table.
///
/// # Errors
/// When a registration fails.
pub fn scan_bench(
    models: &[&dyn ModelFactory],
    terms: &[&dyn TermFactory],
    cases: &[BenchCase],
    landmarks: LandmarkUse,
) -> Result<Vec<BenchRow>> {
    let mut rows = Vec::new();
    for case in cases {
        for &model in models {
            let (score, _, seconds) =
                run_case(model, terms, &Schedule::from_toml(model.default_schedule())?, case, landmarks)?;
            let row = BenchRow::new("model", model.name(), &case.name, Ok(score));
            rows.push(BenchRow { seconds: Some(seconds), ..row });
        }
    }
    Ok(rows)
}
