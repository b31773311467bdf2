//! `scan-bench`: every model on every case with exact dense ground truth, in one table.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::io::{self, Landmark};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::model::ShapeBasis;
use nonrigid::registration::{
    ModelFactory, Pose, RegistrationInput, RegistrationResult, Schedule, TermFactory, register_with,
};
use serde::{Deserialize, Serialize};

/// One case: a scan with the true position of every template vertex.
pub struct BenchCase {
    /// Name of its folder.
    pub name: String,
    /// Template polygons and positions.
    pub template: PolygonMesh,
    /// The subject's own neutral, where it is known.
    pub neutral: Option<Vec<Vec3>>,
    /// The shapes that a fit may use.
    pub shapes: ShapeBasis,
    /// The scan.
    pub scan: TriangleMesh,
    /// True vertex positions, scan frame.
    pub truth: Vec<Vec3>,
    /// Which vertices the scan shows.
    pub observed: Vec<bool>,
    /// Landmarks.
    pub landmarks: Vec<Landmark>,
}

/// What of `case.json` a fit needs.
#[derive(Deserialize)]
struct CaseFile {
    rig_expressions: Vec<String>,
    rig_identity_modes: usize,
}

/// How landmarks take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LandmarkUse {
    /// All, in the start and in the energy.
    All,
    /// All in the start, none in the energy.
    Align,
    /// This many, spread over the face, in the start and in the energy.
    Some(usize),
}

impl std::str::FromStr for LandmarkUse {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "all" => Ok(Self::All),
            "align" => Ok(Self::Align),
            _ => match s.parse() {
                Ok(n) if n >= 3 => Ok(Self::Some(n)),
                _ => Err(format!("'{s}' is not 'all', 'align' or a number of at least 3")),
            },
        }
    }
}

impl BenchCase {
    /// Reads a case folder.
    pub fn read(dir: &Path, rig: &RigData) -> Result<Self> {
        let name = dir.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let text = std::fs::read_to_string(dir.join("case.json"))
            .with_context(|| format!("{}", dir.join("case.json").display()))?;
        let case: CaseFile =
            serde_json::from_str(&text).with_context(|| format!("{}", dir.join("case.json").display()))?;
        let neutral_path = dir.join("neutral.npy");
        let neutral = if neutral_path.exists() { Some(io::read_npy_points(&neutral_path)?) } else { None };
        let scan = io::read_scan(&dir.join("scan.ply"))?.mesh;
        let landmarks = io::read_landmarks(&dir.join("landmarks.json"), None, &rig.template, Some(&scan))?;
        Ok(Self {
            name,
            neutral,
            shapes: rig.select(&case.rig_expressions, case.rig_identity_modes)?,
            truth: io::read_npy_points(&dir.join("truth.npy"))?,
            observed: io::read_npy_mask(&dir.join("observed.npy"), Some(rig.template.positions.len()))?,
            template: rig.template.clone(),
            landmarks,
            scan,
        })
    }
}

/// provisional
pub struct RigData {
    template: PolygonMesh,
    expr: Vec<f32>,
    names: Vec<String>,
    ids: Vec<f32>,
}
impl RigData {
    /// provisional
    pub fn read(dir: &Path) -> Result<Self> {
        let template = io::read_polygon_mesh(&dir.join("template.obj"))?;
        let names = serde_json::from_str(&std::fs::read_to_string(dir.join("expression_names.json"))?)?;
        Ok(Self {
            template,
            expr: io::NpyArray::open(&dir.join("expression_deltas.npy"))?.read_f32()?,
            names,
            ids: io::NpyArray::open(&dir.join("identity_deltas.npy"))?.read_f32()?,
        })
    }
    fn select(&self, names: &[String], modes: usize) -> Result<ShapeBasis> {
        let n3 = 3 * self.template.positions.len();
        let mut cols: Vec<&[f32]> = vec![];
        let mut all = vec![];
        for n in names {
            let k = self.names.iter().position(|m| m == n).context("shape")?;
            cols.push(&self.expr[k * n3..(k + 1) * n3]);
            all.push(n.clone());
        }
        for k in 0..modes {
            cols.push(&self.ids[k * n3..(k + 1) * n3]);
            all.push(format!("identity{k:03}"));
        }
        let mut d = Vec::with_capacity(n3 * cols.len());
        for r in 0..n3 {
            for c in &cols {
                d.push(f64::from(c[r]));
            }
        }
        let s = vec![1.0; cols.len()];
        Ok(ShapeBasis::new(all, s, d))
    }
}

/// One model on one case.
#[derive(Debug, Clone, Serialize)]
pub struct BenchRow {
    /// Case name.
    pub case: String,
    /// Model name.
    pub model: String,
    /// Errors against the truth.
    #[serde(flatten)]
    pub errors: TruthErrors,
    /// Steps taken.
    pub iterations: usize,
    /// Wall time
    pub seconds: f64,
}

/// Runs one.
pub fn run_case(
    case: &BenchCase,
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    landmarks: LandmarkUse,
) -> Result<(BenchRow, RegistrationResult)> {
    let mut schedule = schedule.clone();
    let mut used = case.landmarks.clone();
    match landmarks {
        LandmarkUse::All => {}
        LandmarkUse::Align => schedule.levels.iter_mut().for_each(|l| l.landmarks = 0.0),
        LandmarkUse::Some(n) => used = spread(&case.landmarks, &case.template, n),
    }
    let input = RegistrationInput {
        template: &case.template,
        neutral: case.neutral.as_deref(),
        shapes: &case.shapes,
        scan: &case.scan,
        scan_normals: None,
        landmarks: &used,
    };
    let start = Instant::now();
    let result = register_with(&input, model, terms, &schedule, &mut |_: &nonrigid::registration::StepRecord| {
        std::ops::ControlFlow::Continue(())
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let (errors, _) =
        TruthErrors::new(&result.positions, &case.truth, &case.observed, &case.template.triangulate().triangles)?;
    Ok((
        BenchRow {
            case: case.name.clone(),
            model: model.name().to_owned(),
            errors,
            iterations: result.history.len(),
            seconds,
        },
        result,
    ))
}

/// `n` landmarks spread over the face: farthest-point order on the template, from the one nearest to the centroid of all.
pub fn spread(landmarks: &[Landmark], template: &PolygonMesh, n: usize) -> Vec<Landmark> {
    let at: Vec<Vec3> = landmarks.iter().map(|l| l.template.position(&template.positions)).collect();
    let mut distance = vec![f64::INFINITY; at.len()];
    let centre = at.iter().sum::<Vec3>() / at.len().max(1) as f64;
    let nearest = |d: &[f64], sign: f64| (0..d.len()).fold(0, |b, i| if sign * d[i] > sign * d[b] { i } else { b });
    let mut next = nearest(&at.iter().map(|p| (p - centre).norm()).collect::<Vec<_>>(), -1.0);
    let mut chosen = Vec::new();
    while chosen.len() < n.min(at.len()) {
        chosen.push(landmarks[next].clone());
        for (d, p) in distance.iter_mut().zip(&at) {
            *d = d.min((p - at[next]).norm());
        }
        next = nearest(&distance, 1.0);
    }
    chosen
}
