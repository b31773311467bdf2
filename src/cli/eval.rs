//! `nonrigid eval`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::inputs::{LANDMARKS, TEMPLATE_LANDMARKS, read_landmarks};
use super::units::{UnitArguments, Units};
use super::{Failure, Stage, check_output, check_plan, meshes, say, warn};
use crate::correspondence::ScanError;
use crate::evaluation::{DistanceSummary, EvaluationError, LandmarkErrors, MeshQuality, SurfaceDistances, TruthErrors};
use crate::io::{self, FilePlan, Inputs, Scan};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::registration::WITHIN_MM;
use crate::render::{ColourScale, View, error_sheet, save_png, turn_back};
use crate::rig::check_order;

/// Arguments of `nonrigid eval`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples, on what `data-gen --seed 7 --out out/data` and the first example of `nonrigid register` make:\n  \
    nonrigid eval --result wrapped.obj --template out/data/rig/template.obj --heatmap error.png \\\n      \
    --truth out/data/cases/same_open/truth.npy --observed out/data/cases/same_open/observed.npy\n  \
    nonrigid eval --result wrapped.obj --template out/data/rig/template.obj --target out/data/cases/same_open/scan.ply \\\n      \
    --landmarks out/data/cases/same_open/landmarks.json --json"
)]
pub struct Arguments {
    /// Result to measure: any mesh or .npy in the template's vertex order
    #[arg(long, value_name = "FILE")]
    result: PathBuf,
    /// Template that was registered
    #[arg(long, value_name = "MESH")]
    template: PathBuf,
    /// True position of every template vertex (.npy N x 3, .obj or .ply)
    #[arg(long, value_name = "FILE", conflicts_with = "target")]
    truth: Option<PathBuf>,
    /// Which vertices the scan shows (.npy, N booleans) [default: all]
    #[arg(long, value_name = "FILE", requires = "truth", conflicts_with = "target")]
    observed: Option<PathBuf>,
    /// The scan, a mesh or a point cloud with normals, where there is no truth: surface distances both ways
    #[arg(long, value_name = "MESH")]
    target: Option<PathBuf>,
    /// Landmarks of the scan, best such that had no part in the registration: how far the result's are from them. In any format that
    /// 'nonrigid landmarks' reads
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// What the landmarks' names mean on the template, in any of those formats
    #[arg(long, value_name = "FILE", requires = "landmarks")]
    template_landmarks: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Picture (.png) of the error on the result
    #[arg(long, value_name = "FILE")]
    heatmap: Option<PathBuf>,
}

/// What is printed: distances to the truth, to the scan or to neither, those of landmarks, then what the result is as a mesh.
#[derive(Serialize)]
struct Measured<'a, D> {
    #[serde(flatten)]
    distances: D,
    #[serde(skip_serializing_if = "Option::is_none")]
    landmarks: Option<&'a LandmarkErrors>,
    #[serde(flatten)]
    mesh: &'a MeshQuality,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    a.heatmap.as_deref().map_or(Ok(()), |p| check_output(p, &["png"]))?;
    let of_meshes = [
        ("result", Some(&a.result)),
        ("template", Some(&a.template)),
        ("truth", a.truth.as_ref()),
        ("observed", a.observed.as_ref()),
        ("target", a.target.as_ref()),
        (LANDMARKS, a.landmarks.as_ref()),
        (TEMPLATE_LANDMARKS, a.template_landmarks.as_ref()),
    ];
    let outputs = a.heatmap.iter().map(|path| ("--heatmap", path));
    check_plan(&FilePlan::new().reads_all(meshes(of_meshes)).writes_all(outputs))?;
    if a.truth.is_none() && a.target.is_none() && (a.landmarks.is_none() || a.heatmap.is_some()) {
        let lacking = match a.landmarks {
            None => "nothing to measure the result by: give --truth, --target or --landmarks",
            Some(_) => "--heatmap shows distances to --truth or --target: give one of them",
        };
        return Err(Failure::new(Stage::Arguments, lacking));
    }
    let mut units = a.units.of_given(&[
        ("result", true),
        ("template", true),
        ("truth", a.truth.is_some()),
        ("target", a.target.is_some()),
        ("landmarks", a.landmarks.is_some()),
        ("template-landmarks", a.template_landmarks.is_some()),
    ])?;
    let template = units.read_mesh("template", &a.template)?;
    let positions = units.read_positions("result", &a.result)?;
    same_count("the result", positions.len(), &template)?;
    match check_order(&template, "the template", "the result", &positions) {
        Ok(odd) => odd.iter().for_each(warn),
        // a registration may have failed so far
        Err(error) => warn(error),
    }
    let result = PolygonMesh { positions, ..template.clone() };
    let truth = a.truth.as_ref().map(|path| units.read_positions("truth", path)).transpose()?;
    let scan = a.target.as_ref().map(|path| read_target(&mut units, path)).transpose()?;
    let landmarks = [&a.landmarks, &a.template_landmarks].map(Option::as_deref);
    let of_points = if scan.is_some() { "target" } else { "result" };
    let of_points = (of_points, scan.as_ref().map(|scan| &scan.mesh));
    let landmarks = read_landmarks(landmarks, &Inputs::default(), &mut units, &template, of_points)?;
    units.say();
    let evaluated = Evaluated {
        mesh: MeshQuality::new(&template, &result.positions).map_err(Failure::computation)?,
        landmarks: a.landmarks.as_ref().map(|_| LandmarkErrors::new(&landmarks, &result.positions, WITHIN_MM)),
        result,
        template: &template,
    };
    match (truth, scan) {
        (Some(truth), _) => evaluated.say(a, against_truth(a, &evaluated.result, &truth)?),
        (None, Some(scan)) => evaluated.say(a, against_scan(&evaluated.result, &scan.mesh, scan.normals.as_deref())?),
        (None, None) => {
            evaluated.say(a, Compared { text: String::new(), distances: Nothing {}, per_vertex: Vec::new(), label: "" })
        }
    }
}

/// The scan, which must have a surface to measure by.
fn read_target(units: &mut Units<'_>, path: &Path) -> Result<Scan, Failure> {
    let scan = units.read_scan("target", path)?;
    let directed = scan.normals.iter().flatten().any(|n| n.norm_squared() > 0.0);
    if scan.mesh.triangles.is_empty() && !directed {
        return Err(Failure::loading(format!("{}: {}", path.display(), ScanError::Empty)));
    }
    Ok(scan)
}

/// A result, and what needs neither truth nor scan.
struct Evaluated<'a> {
    result: PolygonMesh,
    template: &'a PolygonMesh,
    mesh: MeshQuality,
    landmarks: Option<LandmarkErrors>,
}

/// A result compared with a truth or a scan.
struct Compared<D> {
    /// Lines, each with its end.
    text: String,
    distances: D,
    /// Distance of each vertex.
    per_vertex: Vec<f64>,
    label: &'static str,
}

#[derive(Serialize)]
struct Nothing {}

impl Evaluated<'_> {
    /// Prints all, and draws the heatmap.
    fn say(&self, a: &Arguments, compared: Compared<impl Serialize>) -> Result<(), Failure> {
        let Compared { text, distances, per_vertex, label } = compared;
        if let Some(path) = &a.heatmap {
            let scale = ColourScale::for_magnitudes(&per_vertex, label, "mm");
            let name = a.result.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let turn = turn_back(&self.template.positions, &self.result.positions);
            let turned = self.result.with_positions(self.result.positions.iter().map(|p| turn * p).collect());
            let shown = [(&*name, &turned, &*per_vertex)];
            let sheet = error_sheet(label, &shown, &scale, &[View::Front, View::ThreeQuarter], 640);
            save_png(&sheet, path).map_err(Failure::writing)?;
        }
        if a.json {
            let measured = Measured { distances, landmarks: self.landmarks.as_ref(), mesh: &self.mesh };
            return say(serde_json::to_string_pretty(&measured).map_err(Failure::computation)?);
        }
        let landmarks = self.landmarks.as_ref().map(|errors| {
            let DistanceSummary { count, rms, median, max, .. } = errors.summary;
            let worst = errors.each.first().map_or_else(String::new, |worst| format!(" ({})", worst.name));
            format!("{count} landmarks: rms {rms:.4} mm, median {median:.4}, max {max:.4}{worst}\n")
        });
        say(format!("{text}{}{}", landmarks.unwrap_or_default(), self.mesh))
    }
}

fn against_truth(a: &Arguments, result: &PolygonMesh, truth: &[Vec3]) -> Result<Compared<TruthErrors>, Failure> {
    same_count("the truth", truth.len(), result)?;
    let observed = match &a.observed {
        Some(path) => io::read_npy_mask(path, Some(truth.len())).map_err(Failure::loading)?,
        None => vec![true; truth.len()],
    };
    let triangles = result.triangulate().triangles;
    let measured = TruthErrors::new(&result.positions, truth, &observed, &triangles);
    let (errors, vertices) = measured.map_err(|e| match (&e, &a.observed) {
        (EvaluationError::NothingObserved, Some(path)) => Failure::loading(format!("{}: {e}", path.display())),
        _ => Failure::computation(e),
    })?;
    let text = format!(
        "rmse {:.4} mm (normal {:.4}, tangential {:.4}), median {:.4}, p95 {:.4}, max {:.4}; unobserved {}; {} triangles flipped against the truth\n",
        errors.rmse,
        errors.normal,
        errors.tangential,
        errors.median,
        errors.p95,
        errors.max,
        errors.unobserved.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.4}")),
        errors.flipped
    );
    let per_vertex = vertices.observed_distance(&observed);
    Ok(Compared { text, distances: errors, per_vertex, label: "distance to the truth" })
}

fn against_scan(
    result: &PolygonMesh,
    scan: &TriangleMesh,
    normals: Option<&[Vec3]>,
) -> Result<Compared<SurfaceDistances>, Failure> {
    let (fit, to_scan) = SurfaceDistances::between(result, scan, normals, WITHIN_MM).map_err(Failure::computation)?;
    let (forth, back) = (&fit.result_to_scan, &fit.scan_to_result);
    let text = format!(
        "result to scan: median {:.4} mm, p95 {:.4}, max {:.4}, {:.1} % within {WITHIN_MM} mm\n\
         scan to result: median {:.4} mm, p95 {:.4}, max {:.4}\n",
        forth.median,
        forth.p95,
        forth.max,
        100.0 * forth.share_within,
        back.median,
        back.p95,
        back.max
    );
    Ok(Compared { text, distances: fit, per_vertex: to_scan, label: "distance to the scan" })
}

fn same_count(what: &str, found: usize, template: &PolygonMesh) -> Result<(), Failure> {
    let expected = template.positions.len();
    if found == expected {
        return Ok(());
    }
    Err(Failure::loading(format!("{what} has {found} vertices, the template has {expected}; they must correspond")))
}
