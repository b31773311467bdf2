//! `nonrigid eval`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::units::UnitArguments;
use super::{Failure, Stage, check_output, check_plan, meshes, say};
use crate::correspondence::ScanError;
use crate::evaluation::{MeshQuality, ScanDistance, SurfaceDistances, TruthErrors};
use crate::io;
use crate::io::FilePlan;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::registration::WITHIN_MM;
use crate::render::{ColourScale, View, error_sheet, save_png};

/// Arguments of `nonrigid eval`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples, on what `data-gen --seed 7 --out out/data` and the first example of `nonrigid register` make:\n  \
    nonrigid eval --result wrapped.obj --template out/data/rig/template.obj --heatmap error.png \\\n      \
    --truth out/data/cases/same_open/truth.npy --observed out/data/cases/same_open/observed.npy\n  \
    nonrigid eval --result wrapped.obj --template out/data/rig/template.obj --target out/data/cases/same_open/scan.ply --json"
)]
pub struct Arguments {
    /// Result to measure: any mesh or .npy in the template's vertex order
    #[arg(long, value_name = "FILE")]
    result: PathBuf,
    /// Template that was registered
    #[arg(long, value_name = "MESH")]
    template: PathBuf,
    /// True position of every template vertex (.npy N x 3, .obj or .ply)
    #[arg(long, value_name = "FILE", conflicts_with = "target", required_unless_present = "target")]
    truth: Option<PathBuf>,
    /// Which vertices the scan shows (.npy, N booleans) [default: all]
    #[arg(long, value_name = "FILE", requires = "truth", conflicts_with = "target")]
    observed: Option<PathBuf>,
    /// The scan, a mesh or a point cloud with normals, where there is no truth: surface distances both ways
    #[arg(long, value_name = "MESH")]
    target: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Picture (.png) of the error on the result
    #[arg(long, value_name = "FILE")]
    heatmap: Option<PathBuf>,
}

/// What is printed: distances to the truth or to the scan, then what the result is as a mesh.
#[derive(Serialize)]
struct Measured<D> {
    #[serde(flatten)]
    distances: D,
    #[serde(flatten)]
    mesh: MeshQuality,
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
    ];
    let outputs = a.heatmap.iter().map(|path| ("--heatmap", path));
    check_plan(&FilePlan::new().reads_all(meshes(of_meshes)).writes_all(outputs))?;
    let mut units = a.units.of(&["result", "template", "truth", "target"])?;
    let template = units.read_mesh("template", &a.template)?;
    let positions = units.read_positions("result", &a.result)?;
    same_count("the result", positions.len(), &template)?;
    let result = PolygonMesh { positions, ..template.clone() };
    let (text, json, per_vertex, label) = match (&a.truth, &a.target) {
        (Some(truth), _) => against_truth(a, &template, &result, &units.read_positions("truth", truth)?)?,
        (None, Some(target)) => {
            let scan = units.read_scan("target", target)?;
            let directed = scan.normals.iter().flatten().any(|n| n.norm_squared() > 0.0);
            if scan.mesh.triangles.is_empty() && !directed {
                return Err(Failure::loading(format!("{}: {}", target.display(), ScanError::Empty)));
            }
            against_scan(&template, &result, &scan.mesh, scan.normals.as_deref())?
        }
        (None, None) => return Err(Failure::new(Stage::Arguments, "give --truth or --target")),
    };
    units.say();
    if let Some(path) = &a.heatmap {
        let scale = ColourScale::for_magnitudes(&per_vertex, label, "mm");
        let name = a.result.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let sheet =
            error_sheet(label, &[(&name, &result, &per_vertex)], &scale, &[View::Front, View::ThreeQuarter], 640);
        save_png(&sheet, path).map_err(Failure::writing)?;
    }
    say(if a.json { json } else { text })
}

type Outcome = (String, String, Vec<f64>, &'static str);

fn against_truth(
    a: &Arguments,
    template: &PolygonMesh,
    result: &PolygonMesh,
    truth: &[Vec3],
) -> Result<Outcome, Failure> {
    same_count("the truth", truth.len(), result)?;
    let observed = match &a.observed {
        Some(path) => io::read_npy_mask(path, Some(truth.len())).map_err(Failure::loading)?,
        None => vec![true; truth.len()],
    };
    let triangles = result.triangulate().triangles;
    let (errors, vertices) =
        TruthErrors::new(&result.positions, truth, &observed, &triangles).map_err(Failure::computation)?;
    let mesh = MeshQuality::new(template, &result.positions).map_err(Failure::computation)?;
    let text = format!(
        "rmse {:.4} mm (normal {:.4}, tangential {:.4}), median {:.4}, p95 {:.4}, max {:.4}; unobserved {:.4}; {} flipped triangles\n{mesh}",
        errors.rmse,
        errors.normal,
        errors.tangential,
        errors.median,
        errors.p95,
        errors.max,
        errors.unobserved,
        errors.flipped
    );
    Ok((
        text,
        to_json(&Measured { distances: errors, mesh })?,
        vertices.observed_distance(&observed),
        "distance to the truth",
    ))
}

fn against_scan(
    template: &PolygonMesh,
    result: &PolygonMesh,
    scan: &TriangleMesh,
    normals: Option<&[Vec3]>,
) -> Result<Outcome, Failure> {
    let on_scan = ScanDistance::new(scan, normals).map_err(Failure::computation)?;
    let on_result = ScanDistance::new(&result.triangulate(), None).map_err(Failure::computation)?;
    let to_scan: Vec<f64> = distances(&on_scan, &result.positions);
    let fit = Measured {
        distances: SurfaceDistances::from_distances(&to_scan, &distances(&on_result, &scan.positions), WITHIN_MM),
        mesh: MeshQuality::new(template, &result.positions).map_err(Failure::computation)?,
    };
    let (forth, back) = (&fit.distances.result_to_scan, &fit.distances.scan_to_result);
    let text = format!(
        "result to scan: median {:.4} mm, p95 {:.4}, max {:.4}, {:.1} % within {WITHIN_MM} mm\n\
         scan to result: median {:.4} mm, p95 {:.4}, max {:.4}\n\
         {}",
        forth.median,
        forth.p95,
        forth.max,
        100.0 * forth.share_within,
        back.median,
        back.p95,
        back.max,
        fit.mesh
    );
    Ok((text, to_json(&fit)?, to_scan, "distance to the scan"))
}

fn distances(surface: &ScanDistance, points: &[Vec3]) -> Vec<f64> {
    points.iter().map(|p| surface.of(p)).collect()
}

fn same_count(what: &str, found: usize, template: &PolygonMesh) -> Result<(), Failure> {
    let expected = template.positions.len();
    if found == expected {
        return Ok(());
    }
    Err(Failure::loading(format!("{what} has {found} vertices, the template has {expected}; they must correspond")))
}

fn to_json(value: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string_pretty(value).map_err(Failure::computation)
}
