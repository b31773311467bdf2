//! Morphs by recipes, measurements and evaluations.

use std::path::PathBuf;

use nonrigid::correspondence::ScanError;
use nonrigid::evaluation::{MeshQuality, SurfaceDistances, TruthErrors};
use nonrigid::io::LengthUnit;
use nonrigid::landmark::{LandmarkFormat, OffTemplate, TemplatePoint, swapped_sides};
use nonrigid::measurement::{self, HeadMotion, NamedRegion};
use nonrigid::mesh::PolygonMesh;
use nonrigid::morph::{
    self, MorphModel, NO_LANDMARKS, Recipe, RecipeError, ReplayOptions, Subject, preset, preset_names, preset_text,
    replay,
};
use nonrigid::registration::WITHIN_MM;
use nonrigid::rig::{Regions, ShapeBasis, ShapeSelection, check_order};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use serde::Serialize;

use crate::arrays;
use crate::errors::{abandonable, computation, compute, guarded, input, value};
use crate::inputs::{Landmarks, to_toml};
use crate::mesh::Mesh;
use crate::rig::Rig;

/// Name, default millimetres, smallest and largest, and what it does, of each preset.
#[pyfunction]
fn presets() -> PyResult<Vec<(String, f64, Option<[f64; 2]>, String, String)>> {
    let known = preset_names().into_iter().map(|name| {
        let recipe = preset(name).ok_or_else(|| value("no such preset"))?.map_err(input)?;
        let text = preset_text(name).unwrap_or_default();
        Ok((name.to_owned(), recipe.amount, recipe.range, recipe.about.clone(), text))
    });
    known.collect()
}

fn recipe_error(error: RecipeError) -> PyErr {
    match error {
        RecipeError::Impossible { error: morph::MorphError::UnknownLandmark { ref known, .. }, .. }
            if known == NO_LANDMARKS =>
        {
            value(format!("{error}; give landmarks, or a rig that has them"))
        }
        error if error.is_input() => input(error),
        error => computation(error),
    }
}

fn recipe(py: Python<'_>, kind: &str, given: &Bound<'_, PyAny>) -> PyResult<Recipe> {
    match kind {
        "preset" => {
            let name: String = given.extract()?;
            let unknown = || value(format!("unknown preset {name:?}; there are {}", preset_names().join(", ")));
            preset(&name).ok_or_else(unknown)?.map_err(input)
        }
        "file" => {
            let path: PathBuf = given.extract()?;
            compute(py, Some(1), || Recipe::read(&path).map_err(recipe_error))
        }
        _ => {
            let keys = to_toml("recipe", given)?.ok_or_else(|| value("recipe: no keys"))?;
            let text = toml::to_string(&keys).map_err(|e| value(format!("recipe: {e}")))?;
            guarded(|| Recipe::from_text(&text, "recipe").map_err(recipe_error))
        }
    }
}

/// Names of landmarks and where they are on a mesh: those given, or else a rig's; and which of them lie off it.
fn places(
    landmarks: &[Py<Landmarks>],
    unit: Option<LengthUnit>,
    rig: Option<&Rig>,
    mesh: &Mesh,
) -> PyResult<(Vec<(String, TemplatePoint)>, Vec<String>)> {
    let mut off = OffTemplate::none();
    if landmarks.is_empty() {
        let of_rig = rig.and_then(|r| r.rig.landmarks()).unwrap_or_default().iter().enumerate();
        return Ok((of_rig.map(|(k, v)| (k.to_string(), TemplatePoint::Vertex(*v))).collect(), Vec::new()));
    }
    let mut points = Vec::new();
    for landmarks in landmarks.iter().map(Py::get) {
        let (mut set, _) = landmarks.in_millimetres(unit, mesh)?;
        set.format = LandmarkFormat::Native; // positions are points of the surface, as where they are measured
        let of_set = set.on_template(&landmarks.path, mesh.polygons()).map_err(input)?;
        off.extend(OffTemplate::of(&landmarks.path, &set, &of_set, mesh.polygons()).map_err(input)?);
        points.extend(of_set);
    }
    let positions = &mesh.polygons().positions;
    let placed: Vec<_> = points.iter().map(|(name, point)| (name.as_str(), point.position(positions))).collect();
    let doubts = off.doubt().into_iter().chain(swapped_sides(&placed)).collect();
    Ok((points, doubts))
}

/// Step by step, behind what is doubtful in words: positions, report (JSON), and of each mask its name and weights.
type Steps<'py> = Vec<(Bound<'py, PyArray2<f64>>, String, Vec<(String, Bound<'py, PyArray1<f64>>)>)>;

#[pyfunction]
#[pyo3(signature = (mesh, recipes, landmarks, unit, rig, shapes, identity_modes, bounds, until, model, threads))]
fn morph_mesh<'py>(
    py: Python<'py>,
    mesh: Py<Mesh>,
    recipes: Vec<(String, Bound<'py, PyAny>, Option<f64>)>,
    landmarks: Vec<Py<Landmarks>>,
    unit: Option<&str>,
    rig: Option<Py<Rig>>,
    shapes: Option<Vec<String>>,
    identity_modes: usize,
    bounds: Option<[f64; 2]>,
    until: Option<usize>,
    model: Option<&str>,
    threads: Option<usize>,
) -> PyResult<(Vec<String>, Steps<'py>)> {
    let unit = crate::mesh::unit(unit)?;
    let model = model.map(str::parse::<MorphModel>).transpose().map_err(value)?;
    let recipes = recipes.iter().map(|(kind, given, amount)| Ok((recipe(py, kind, given)?, *amount)));
    let recipes = recipes.collect::<PyResult<Vec<_>>>()?;
    if let Some(until) = until
        && recipes.iter().any(|(recipe, _)| until == 0 || until > recipe.step.len())
    {
        return Err(value(format!("until: {until}; the recipe has {} steps", recipes[0].0.step.len())));
    }
    if until.is_some() && recipes.len() > 1 {
        return Err(value("until: counts the steps of one recipe; there are several"));
    }
    let mut notes: Vec<String> = recipes.iter().flat_map(|(recipe, amount)| recipe.doubts(*amount, model)).collect();
    let mut models = recipes.iter().flat_map(|(recipe, _)| &recipe.step).map(|s| model.unwrap_or(s.get_ref().model));
    if !models.any(MorphModel::uses_shapes) {
        let given =
            [("shapes", shapes.is_some()), ("identity_modes", identity_modes > 0), ("weight_bounds", bounds.is_some())];
        let idle = given.into_iter().filter(|(_, given)| *given);
        notes.extend(idle.map(|(option, _)| format!("{option} has no effect: no step's model has blendshapes")));
    }
    let (outcomes, of_landmarks) = abandonable(py, threads, move || {
        let (mesh, rig) = (mesh.get(), rig.as_ref().map(Py::get));
        let mut basis = match rig {
            None => ShapeBasis::none(),
            Some(rig) => {
                let selection = ShapeSelection { names: shapes.as_deref(), identity_modes };
                rig.rig.select_for(selection, "the mesh", &mesh.polygons().positions).map_err(input)?.0
            }
        };
        if let Some(bounds) = bounds {
            basis = basis.with_bounds(|_| bounds);
        }
        let (points, of_landmarks) = places(&landmarks, unit, rig, mesh)?;
        let mut moved: PolygonMesh = mesh.polygons().clone();
        let regions = Regions::of(rig.map(|r| &r.rig), &moved);
        let mut outcomes = Vec::new();
        for (recipe, amount) in &recipes {
            let subject = Subject { mesh: &moved, landmarks: &points, regions: &regions, shapes: &basis };
            let options = ReplayOptions { amount: *amount, until, model };
            outcomes.extend(replay(recipe, &subject, &options).map_err(recipe_error)?);
            if let Some(last) = outcomes.last() {
                moved.positions.clone_from(&last.positions);
            }
        }
        Ok((outcomes, of_landmarks))
    })?;
    notes.extend(of_landmarks);
    let step = |outcome: morph::StepOutcome| {
        let report = serde_json::to_string(&outcome.report).map_err(value)?;
        let masks = outcome.masks.into_iter().map(|mask| (mask.name, mask.weights.into_values().into_pyarray(py)));
        Ok((arrays::from_points(py, &outcome.positions)?, report, masks.collect()))
    };
    for (k, outcome) in outcomes.iter().enumerate() {
        notes.extend(outcome.report.doubts().into_iter().map(|doubt| format!("step {} {doubt}", k + 1)));
    }
    Ok((notes, outcomes.into_iter().map(step).collect::<PyResult<_>>()?))
}

/// Everything as JSON, as CSV, and in words, and what is to be said of `after`, the landmarks and the head's motion.
#[pyfunction]
#[pyo3(signature = (mesh, after, landmarks, unit, rig, regions, align))]
fn measure_mesh(
    py: Python<'_>,
    mesh: Py<Mesh>,
    after: Option<PyReadonlyArray2<'_, f64>>,
    landmarks: Vec<Py<Landmarks>>,
    unit: Option<&str>,
    rig: Option<Py<Rig>>,
    regions: Option<Vec<(String, Vec<u32>)>>,
    align: bool,
) -> PyResult<(String, String, String, Vec<String>)> {
    let unit = crate::mesh::unit(unit)?;
    let mut after = after.map(|a| arrays::points("after", &a)).transpose()?;
    abandonable(py, None, move || {
        let (mesh, rig) = (mesh.get(), rig.as_ref().map(Py::get));
        if let Some(rig) = rig {
            rig.rig.check_subject("the mesh", &mesh.polygons().positions).map_err(input)?;
        }
        let polygons = mesh.polygons();
        let mut notes = Vec::new();
        if let Some(after) = &after {
            let odd = check_order(polygons, "the first mesh", "after", after).map_err(input)?;
            notes.extend(odd.iter().map(ToString::to_string));
        }
        let mut known = match rig.filter(|_| landmarks.is_empty()) {
            Some(rig) => measurement::Landmarks::of_rig(&rig.companions.landmarks, rig.rig.landmarks(), polygons)
                .map_err(input)?,
            None => measurement::Landmarks::default(),
        };
        for landmarks in landmarks.iter().map(Py::get) {
            let (set, _) = landmarks.in_millimetres(unit, mesh)?;
            known.add_set(&landmarks.path, set, polygons).map_err(input)?;
        }
        let regions = match regions {
            Some(regions) => Regions::new(polygons.positions.len(), regions).map_err(input)?,
            None => Regions::of(rig.map(|r| &r.rig), polygons),
        };
        notes.extend(known.doubts(&polygons.positions));
        if let Some(after) = &mut after {
            let motion = HeadMotion::between(polygons, after).map_err(input)?;
            if align {
                motion.undo(after);
            } else if motion.counts() {
                notes.push(format!("{motion}; align=True takes it out"));
            }
        }
        let named = |name| NamedRegion {
            name,
            vertices: regions.vertices(name).unwrap_or_default(),
            polygons: regions.polygons(name),
        };
        let regions: Vec<NamedRegion<'_>> = regions.names().map(named).collect();
        let subject =
            measurement::Subject { mesh: polygons, after: after.as_deref(), landmarks: &known, regions: &regions };
        let measured = subject.measure().map_err(input)?;
        let json = serde_json::to_string(&measured).map_err(value)?;
        Ok((json, measured.to_csv(), measured.to_string(), notes))
    })
}

/// Every measurement with its formula and landmarks.
#[pyfunction]
fn glossary() -> String {
    measurement::glossary()
}

/// Distances to the truth or to the scan, then what the result is as a mesh.
#[derive(Serialize)]
struct Measured<D> {
    #[serde(flatten)]
    distances: D,
    #[serde(flatten)]
    mesh: MeshQuality,
}

fn result_of(template: &Mesh, positions: &PyReadonlyArray2<'_, f64>) -> PyResult<PolygonMesh> {
    let positions = arrays::points("result", positions)?;
    let (found, expected) = (positions.len(), template.polygons().positions.len());
    if found != expected {
        return Err(value(format!(
            "the result has {found} vertices, the template has {expected}; they must correspond"
        )));
    }
    Ok(template.polygons().with_positions(positions))
}

/// Errors against the truth, as JSON, and the distance of every vertex that the scan shows.
#[pyfunction]
fn evaluate_truth<'py>(
    py: Python<'py>,
    result: PyReadonlyArray2<'_, f64>,
    template: Py<Mesh>,
    truth: PyReadonlyArray2<'_, f64>,
    observed: Option<PyReadonlyArray1<'_, bool>>,
) -> PyResult<(String, Bound<'py, PyArray1<f64>>)> {
    let (result, truth) = (result_of(template.get(), &result)?, arrays::points("truth", &truth)?);
    let observed = observed.map_or_else(|| vec![true; truth.len()], |o| o.as_array().to_vec());
    let (text, distances) = abandonable(py, None, move || {
        let triangles = result.triangulate().triangles;
        let (errors, vertices) = TruthErrors::new(&result.positions, &truth, &observed, &triangles).map_err(input)?;
        let mesh = MeshQuality::new(template.get().polygons(), &result.positions).map_err(input)?;
        let text = serde_json::to_string(&Measured { distances: errors, mesh }).map_err(value)?;
        Ok((text, vertices.observed_distance(&observed)))
    })?;
    Ok((text, distances.into_pyarray(py)))
}

/// Distances to the scan both ways, as JSON, and that of every vertex.
#[pyfunction]
fn evaluate_scan<'py>(
    py: Python<'py>,
    result: PyReadonlyArray2<'_, f64>,
    template: Py<Mesh>,
    scan: Py<Mesh>,
) -> PyResult<(String, Bound<'py, PyArray1<f64>>)> {
    let result = result_of(template.get(), &result)?;
    let (text, distances) = abandonable(py, None, move || {
        let scan = scan.get();
        let surface = scan.polygons().triangulate();
        let normals = scan.file.normals.as_deref();
        if surface.triangles.is_empty() && !normals.iter().copied().flatten().any(|n| n.norm_squared() > 0.0) {
            return Err(input(ScanError::Empty));
        }
        let (distances, to_scan) = SurfaceDistances::between(&result, &surface, normals, WITHIN_MM).map_err(input)?;
        let mesh = MeshQuality::new(template.get().polygons(), &result.positions).map_err(input)?;
        Ok((serde_json::to_string(&Measured { distances, mesh }).map_err(value)?, to_scan))
    })?;
    Ok((text, distances.into_pyarray(py)))
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(presets, module)?)?;
    module.add_function(wrap_pyfunction!(morph_mesh, module)?)?;
    module.add_function(wrap_pyfunction!(measure_mesh, module)?)?;
    module.add_function(wrap_pyfunction!(glossary, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate_truth, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate_scan, module)?)
}
