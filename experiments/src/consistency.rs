//! `consistency`: how good a rig is on real subjects, without any truth.
//!
//! A population of faces (or of anything) shares a topology that is not the template's. Each is registered without landmarks. Where
//! a template vertex comes to lie on a face, the closest point, is a place in the population's own topology, a triangle and
//! barycentric coordinates; carried to the population's mean it should be the same place for every face. Measured: the deviation
//! from the median place (by coordinate), root mean square over all faces and over the vertices that lie within `--within` of
//! every face; and how many vertices these are, without which a result that leaves the faces could look consistent.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::evaluation::percentile;
use nonrigid::io::read_polygon_mesh;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::{PoseKind, TriangleMesh, Vec3};
use nonrigid::registration::{
    ModelFactory, ModelKind, RegistrationInput, RegistrationResult, Schedule, Silent, register,
};
use nonrigid::render::{ColourScale, View, error_sheet, save_png};
use nonrigid::rig::{Population, ShapeBasis, ShapeSelection};
use serde::Serialize;

use crate::check_millimetres;
use crate::output::{each_once, make_output_folder, write_result};
use crate::scan_bench::{BenchRig, read_schedule};
use crate::tables::{csv_field, table, write_csv, write_json};
use crate::{identity_modes, unread};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples, on what `data-gen --seed 7 --out out/data --population 12` makes; the second names files of one's own\n  \
    experiments consistency --population out/data/population --rig out/data/rig --models hybrid,graph\n  \
    experiments consistency --population faces.npy --template-of-population face.ply --rig out/data/rig --count 4"
)]
pub struct Arguments {
    /// The population: a folder of meshes of one topology (.obj, .ply), or their vertices stacked in one .npy, N x V x 3, mm
    #[arg(long, value_name = "FACES")]
    population: PathBuf,
    /// A mesh of the population's topology, for .npy
    #[arg(long, value_name = "MESH")]
    template_of_population: Option<PathBuf>,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = [ModelKind::Hybrid, ModelKind::Graph], value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// How many of the rig's identity modes take part [default: 60, or as many as it has]
    #[arg(long, value_name = "N")]
    identity_modes: Option<usize>,
    /// How many faces, evenly spread over the population [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    count: Option<u32>,
    /// A vertex counts if it comes to lie so near to every face
    #[arg(long, value_name = "MM", default_value_t = 3.0, value_parser = length)]
    within: f64,
    /// Schedule (.toml) for every model instead of its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where tables, pictures and meshes go
    #[arg(long, value_name = "DIR", default_value = "out/consistency")]
    out: PathBuf,
    /// Write every result as .obj
    #[arg(long)]
    meshes: bool,
    /// Threads [default: all cores]; results do not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(length) if length > 0.0 && length.is_finite() => Ok(length),
        _ => Err("a positive number of millimetres is needed".to_owned()),
    }
}

/// What a model made of the population. Lengths are millimetres, on the population's mean.
#[derive(Debug, Clone, Serialize)]
pub struct ConsistencyRow {
    /// Model.
    pub model: String,
    /// Faces that were registered, of all.
    pub faces: [usize; 2],
    /// Root mean square deviation from the median place.
    pub rms: Option<f64>,
    /// Median deviation.
    pub median: Option<f64>,
    /// Root mean square deviation of the worst face.
    pub worst: Option<f64>,
    /// Share of the template's vertices that count.
    pub counted: f64,
    /// Median over faces of the median distance of a template vertex to its face.
    pub distance: Option<f64>,
    /// Faces without a result: number and reason.
    pub failed: Vec<(usize, String)>,
    /// Root mean square deviation of every template vertex; none where it does not count.
    #[serde(skip)]
    pub by_vertex: Vec<Option<f64>>,
    /// Seconds a face; not part of what is compared.
    #[serde(skip)]
    pub seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`]: of the arguments; of loading; of writing; of the computation when no face could be registered.
pub fn run(a: &Arguments) -> Result<()> {
    each_once("--models", &a.models)?;
    let rig = BenchRig::read(&a.rig).map_err(unread)?;
    let shapes = shapes_of(&rig, a.identity_modes)?;
    let (population, names) = population_of(a)?;
    let config = a.config.as_ref().map(|path| read_schedule(path)).transpose()?;
    let reads = [("--population", &a.population), ("--rig", &a.rig)].into_iter();
    let reads = reads.chain(a.template_of_population.iter().map(|path| ("--template-of-population", path)));
    make_output_folder(&a.out, reads.chain(a.config.iter().map(|path| ("--config", path))), &[])?;
    say(format_args!("{} faces x {} models, {} shapes", names.len(), a.models.len(), shapes.len()))?;
    let mut rows = Vec::new();
    for model in &a.models {
        let schedule = config.clone().map_or_else(|| model.schedule(), Ok)?;
        rows.push(row_of(*model, &schedule, &rig, &shapes, (&population, &names), a)?);
    }
    write_results(a, &rig, &rows)?;
    say(rows_table(&rows))?;
    say(format_args!("consistency.csv, .json and .png are in {}", a.out.display()))?;
    if rows.iter().all(|row| row.faces[0] < 2) {
        return Err(Failure::computation("no model has registered two faces: nothing to compare").into());
    }
    Ok(())
}

fn shapes_of(rig: &BenchRig, asked: Option<usize>) -> Result<ShapeBasis> {
    let identity_modes = identity_modes(rig.rig(), asked)?;
    Ok(rig.rig().select(ShapeSelection { identity_modes, ..ShapeSelection::default() })?)
}

/// The faces to register with the numbers that they have in the population: the meshes as they lie, and their mean, aligned.
fn population_of(a: &Arguments) -> Result<(Faces, Vec<usize>)> {
    let stacked = a.population.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy"));
    let mut population = match (&a.template_of_population, stacked) {
        (None, false) => Population::read(&a.population).map_err(Failure::loading)?,
        (Some(path), true) => {
            let mesh = read_polygon_mesh(path).map_err(Failure::loading)?;
            Population::read_npy(&a.population, mesh).map_err(Failure::loading)?
        }
        (None, true) => {
            let message =
                "--population: an .npy holds vertices alone; --template-of-population says how they are joined";
            return Err(Failure::new(Stage::Arguments, message).into());
        }
        (Some(_), false) => {
            let message = "--template-of-population goes with an .npy; a folder's meshes have a topology of their own";
            return Err(Failure::new(Stage::Arguments, message).into());
        }
    };
    check_millimetres(&a.population, &population.samples()[0]).map_err(unread)?;
    let triangles = population.mesh().map(|mesh| mesh.triangulate().triangles).unwrap_or_default();
    if triangles.is_empty() {
        return Err(Failure::loading("the population's meshes have no polygons").into());
    }
    let all = population.samples().len();
    let count = a.count.map_or(all, |count| (count as usize).min(all));
    let chosen: Vec<usize> = (0..count).map(|i| i * (all - 1) / (count - 1)).collect();
    let mesh = |i: &usize| TriangleMesh { positions: population.samples()[*i].clone(), triangles: triangles.clone() };
    let faces = chosen.iter().map(mesh).collect();
    population.align(PoseKind::Rigid).map_err(Failure::computation)?;
    let at = |v: usize| population.samples().iter().map(|s| s[v]).sum::<Vec3>() / all as f64;
    let mean = (0..population.vertex_count()).map(at).collect();
    Ok((Faces { faces, mean }, chosen))
}

struct Faces {
    faces: Vec<TriangleMesh>,
    /// The mean of all of the population, in its topology.
    mean: Vec<Vec3>,
}

fn row_of(
    model: ModelKind,
    schedule: &Schedule,
    rig: &BenchRig,
    shapes: &ShapeBasis,
    (population, names): (&Faces, &[usize]),
    a: &Arguments,
) -> Result<ConsistencyRow> {
    let none = ShapeBasis::none();
    let shapes = if model.uses_shapes() { shapes } else { &none };
    let clock = Instant::now();
    let (mut places, mut failed) = (Vec::new(), Vec::new());
    for (face, &name) in population.faces.iter().zip(names) {
        let input = RegistrationInput { shapes, ..RegistrationInput::new(rig.template(), face) };
        match register(&input, &model, schedule, &mut Silent) {
            Ok(result) => {
                if a.meshes {
                    let path = a.out.join(format!("{model}_{name:02}.obj"));
                    write_result(&path, rig.template(), result.positions.clone())?;
                }
                let found = places_on(face, &population.mean, &result)?;
                tell(format_args!("{model} {name}: {:.3} mm from the face", found.median_distance()));
                places.push(found);
            }
            Err(e) => {
                tell(format_args!("{model} {name}: {e}"));
                failed.push((name, e.to_string()));
            }
        }
    }
    let row = deviations(model.name(), &places, a.within);
    let seconds = clock.elapsed().as_secs_f64() / names.len() as f64;
    Ok(ConsistencyRow { faces: [places.len(), names.len()], failed, seconds, ..row })
}

/// Where the template's vertices come to lie on one face.
struct Places {
    /// On the population's mean.
    on_mean: Vec<Vec3>,
    /// Distances to the face.
    distances: Vec<f64>,
}

impl Places {
    fn median_distance(&self) -> f64 {
        percentile(&self.distances, 50.0).unwrap_or(f64::NAN)
    }
}

fn places_on(face: &TriangleMesh, mean: &[Vec3], result: &RegistrationResult) -> Result<Places> {
    let surface = ClosestPoint::new(face)?;
    let closest = |p: &Vec3| {
        let hit = surface.query(p).ok_or_else(|| Failure::computation("a face without triangles"))?;
        let corners = face.triangles[hit.triangle as usize];
        let place = corners.iter().zip(hit.barycentric).map(|(&v, b)| mean[v as usize] * b).sum();
        Ok((place, hit.squared_distance.sqrt()))
    };
    let found: Result<Vec<(Vec3, f64)>> = result.positions.iter().map(closest).collect();
    let (on_mean, distances) = found?.into_iter().unzip();
    Ok(Places { on_mean, distances })
}

/// Deviations from the median place, over vertices that lie near every face.
fn deviations(model: &str, places: &[Places], within: f64) -> ConsistencyRow {
    let vertices = places.first().map_or(0, |p| p.on_mean.len());
    let counts = |v: &usize| places.len() > 1 && places.iter().all(|p| p.distances[*v] < within);
    let counted: Vec<usize> = (0..vertices).filter(counts).collect();
    let median_place = |&v: &usize| {
        let axis = |x: usize| {
            let values: Vec<f64> = places.iter().map(|p| p.on_mean[v][x]).collect();
            percentile(&values, 50.0).unwrap_or(f64::NAN)
        };
        Vec3::new(axis(0), axis(1), axis(2))
    };
    let middles: Vec<Vec3> = counted.iter().map(median_place).collect();
    let of_face = |p: &Places| -> Vec<f64> {
        counted.iter().zip(&middles).map(|(&v, middle)| (p.on_mean[v] - middle).norm()).collect()
    };
    let by_face: Vec<Vec<f64>> = places.iter().map(of_face).collect();
    let rms = |values: &[f64]| {
        let mean = values.iter().map(|d| d * d).sum::<f64>() / values.len() as f64;
        mean.is_finite().then(|| mean.sqrt())
    };
    let all = by_face.concat();
    let mut by_vertex = vec![None; vertices];
    for (k, &v) in counted.iter().enumerate() {
        by_vertex[v] = rms(&by_face.iter().map(|face| face[k]).collect::<Vec<_>>());
    }
    let distances: Vec<f64> = places.iter().map(Places::median_distance).collect();
    ConsistencyRow {
        model: model.to_owned(),
        faces: [places.len(); 2],
        rms: rms(&all),
        median: percentile(&all, 50.0),
        worst: by_face.iter().filter_map(|face| rms(face)).reduce(f64::max),
        counted: counted.len() as f64 / vertices.max(1) as f64,
        distance: percentile(&distances, 50.0),
        failed: Vec::new(),
        by_vertex,
        seconds: 0.0,
    }
}

/// Tables, and the deviation of every vertex as colour on the template, grey where it does not count.
fn write_results(a: &Arguments, rig: &BenchRig, rows: &[ConsistencyRow]) -> Result<()> {
    let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.6}"));
    write_csv(
        &a.out.join("consistency.csv"),
        "model,registered,faces,rms,median,worst,counted,distance,failed",
        rows.iter().map(|r| {
            let failed: Vec<String> = r.failed.iter().map(|(face, why)| format!("{face}: {why}")).collect();
            let [rms, median, worst, distance] = [r.rms, r.median, r.worst, r.distance].map(number);
            let [registered, faces] = r.faces;
            let failed = csv_field(&failed.join("; "));
            format!("{},{registered},{faces},{rms},{median},{worst},{:.6},{distance},{failed}", r.model, r.counted)
        }),
    )?;
    write_json(&a.out.join("consistency.json"), &serde_json::json!({ "within": a.within, "rows": rows }))?;
    let values: Vec<Vec<f64>> =
        rows.iter().map(|r| r.by_vertex.iter().map(|d| d.unwrap_or(f64::NAN)).collect()).collect();
    let seen: Vec<f64> = values.iter().flatten().copied().filter(|d| d.is_finite()).collect();
    let scale = ColourScale::for_magnitudes(&seen, "deviation", "mm");
    let columns = rows.iter().zip(&values).filter(|(_, values)| !values.is_empty());
    let columns: Vec<_> = columns.map(|(row, values)| (row.model.as_str(), rig.template(), &values[..])).collect();
    let sheet = error_sheet("consistency of correspondence", &columns, &scale, &[View::Front, View::ThreeQuarter], 420);
    Ok(save_png(&sheet, a.out.join("consistency.png")).map_err(Failure::writing)?)
}

fn rows_table(rows: &[ConsistencyRow]) -> comfy_table::Table {
    let number = |x: Option<f64>, digits: usize| x.map_or_else(|| "none".to_owned(), |x| format!("{x:.digits$}"));
    let header = ["model", "faces", "rms mm", "median", "worst face", "vertices", "distance", "s a face"];
    table(
        &header,
        rows.iter().map(|r| {
            vec![
                r.model.clone(),
                format!("{} of {}", r.faces[0], r.faces[1]),
                number(r.rms, 2),
                number(r.median, 2),
                number(r.worst, 2),
                format!("{:.0} %", 100.0 * r.counted),
                number(r.distance, 3),
                format!("{:.2}", r.seconds),
            ]
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of four vertices, and where three vertices come to lie on it.
    fn places(slide: f64, off: f64) -> Places {
        let on_mean = [0.2, 0.5, 0.8].map(|x| Vec3::new(x + slide, 0.5, 0.0)).to_vec();
        Places { on_mean, distances: vec![0.1, 0.2, off] }
    }

    #[test]
    fn deviation_is_that_from_the_median_place_of_vertices_near_every_face() {
        let row = deviations("graph", &[places(0.0, 0.1), places(0.3, 9.0), places(-0.6, 0.1)], 3.0);
        let expected = ((0.0 + 0.09 + 0.36) / 3.0_f64).sqrt();
        assert!((row.rms.unwrap() - expected).abs() < 1e-12, "{row:?}");
        assert!((row.median.unwrap() - 0.3).abs() < 1e-12 && (row.worst.unwrap() - 0.6).abs() < 1e-12);
        assert!((row.counted - 2.0 / 3.0).abs() < 1e-12 && row.by_vertex[2].is_none());
        assert!((row.distance.unwrap() - 0.1).abs() < 1e-12);
    }

    #[test]
    fn one_face_has_nothing_to_agree_with() {
        let row = deviations("graph", &[places(0.0, 0.1)], 3.0);
        assert_eq!((row.rms, row.median, row.worst, row.counted), (None, None, None, 0.0));
    }
}
