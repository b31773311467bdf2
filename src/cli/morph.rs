//! `nonrigid morph`.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};

use super::inputs::{RigArguments, bounds, rig_files};
use super::measure::{self, ClientArguments, named_regions, plan_names};
use super::units::{UnitArguments, Units};
use super::{
    Failure, Stage, check_output, check_output_folder, check_plan, materials_for, meshes, on_threads, refuse_beside,
    say, warn, warn_of_format, warn_of_materials,
};
use crate::io::{self, FilePlan, MeshFile, write_atomically};
use crate::landmark::{self, LandmarkFormat, OffTemplate, TemplatePoint, swapped_sides};
use crate::measurement::{Landmarks, Plan, Subject as Measured, report};
use crate::mesh::PolygonMesh;
use crate::morph::{
    MorphError, MorphModel, NO_LANDMARKS, Recipe, RecipeError, ReplayOptions, StepOutcome, Subject, preset,
    preset_names, preset_text, replay,
};
use crate::rig::Regions;

/// Arguments of `nonrigid morph`.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("what").required(true).multiple(false),
    after_help = "A recipe is a TOML file of steps; --print shows that of a preset, to start one's own from. Presets and recipes in\n\
    landmark coordinates run on any mesh with the same landmarks, such as a scan that a template was wrapped onto.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` and the first example of `nonrigid register` make:\n  \
    nonrigid morph --list\n  \
    nonrigid morph --mesh wrapped.obj --rig out/data/rig --preset nose-bridge=2.5 --preset chin-forward=2 \\\n      \
    --out morphed.obj --report report\n  \
    nonrigid morph --print nose-bridge > mine.toml\n  \
    nonrigid morph --mesh wrapped.obj --rig out/data/rig --recipe mine.toml --model arap --out by_recipe.obj"
)]
pub struct Arguments {
    /// Mesh (any format that `register` reads); the result keeps its vertex order, polygons, UVs, groups and materials
    #[arg(long, value_name = "MESH", required_unless_present_any = ["list", "print"])]
    mesh: Option<PathBuf>,
    /// Recipe (.toml)
    #[arg(long, value_name = "FILE", group = "what")]
    recipe: Option<PathBuf>,
    /// Preset and how many millimetres [default: its own]; may be given several times, they are done in order
    #[arg(long, value_name = "NAME[=MM]", group = "what")]
    preset: Vec<String>,
    /// List the presets
    #[arg(long, group = "what")]
    list: bool,
    /// Print a preset's recipe
    #[arg(long, value_name = "PRESET", group = "what")]
    print: Option<String>,
    /// Landmarks of the mesh, in any format that 'nonrigid landmarks' reads; presets need the 68 of Multi-PIE, by number
    /// [default: the rig's]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    #[command(flatten)]
    rig: RigArguments,
    /// Bounds of blendshape weights, such as 0,1
    #[arg(long, value_name = "MIN,MAX", value_parser = bounds, allow_hyphen_values = true, requires = "rig")]
    weight_bounds: Option<[f64; 2]>,
    #[command(flatten)]
    units: UnitArguments,
    /// In place of the recipe's amount: what its displacements are multiplied by
    #[arg(long, value_name = "X", allow_hyphen_values = true, conflicts_with = "preset")]
    amount: Option<f64>,
    /// Only the first N steps of the recipe
    #[arg(long, value_name = "N", conflicts_with = "preset")]
    until: Option<usize>,
    #[arg(long, value_name = "MODEL", value_parser = str::parse::<MorphModel>,
        help = format!("In place of every step's model: {}", MorphModel::names()))]
    model: Option<MorphModel>,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Result (.obj, .ply, .glb or .usda)
    #[arg(long, value_name = "MESH", required_unless_present_any = ["list", "print"])]
    out: Option<PathBuf>,
    /// Folder for every mask: its texture (.png), where it has one, and its weights (.npy); made if it is not there
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Folder for a page (index.html) with front, side and three-quarter pictures before and after, masks, displacements and
    /// measurements, the same as files, and morph.json with what each step did; made if it is not there
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Another recipe, done on the same face and shown beside in the report; may be given several times
    #[arg(long, value_name = "FILE", requires = "report")]
    compare: Vec<PathBuf>,
    #[command(flatten)]
    client: ClientArguments,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.list {
        return list();
    }
    if let Some(name) = &arguments.print {
        return say(preset_text(name).ok_or_else(|| unknown_preset(name))?.trim_end());
    }
    on_threads(arguments.threads, || run_here(arguments))?
}

fn list() -> Result<(), Failure> {
    for name in preset_names() {
        let recipe = known_preset(name)?;
        let [low, high] = recipe.range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        say(format_args!("{name:<18} {:>4} mm ({low} to {high})  {}", recipe.amount, recipe.about))?;
    }
    Ok(())
}

fn run_here(a: &Arguments) -> Result<(), Failure> {
    let (Some(mesh), Some(out)) = (&a.mesh, &a.out) else {
        return Err(Failure::new(Stage::Arguments, "--mesh and --out are needed"));
    };
    check_output(out, &["obj", "ply", "glb", "usda"])?;
    [&a.masks, &a.report].into_iter().flatten().try_for_each(|folder| check_output_folder(folder))?;
    if let Some(amount) = a.amount.filter(|amount| !amount.is_finite()) {
        return Err(Failure::new(Stage::Arguments, format!("--amount: expected a finite number, found {amount}")));
    }
    let jobs = jobs(a)?;
    let others = a.compare.iter().map(|path| Recipe::read(path).map_err(failure)).collect::<Result<Vec<_>, _>>()?;
    warn_of_recipes(a, &jobs, &others);
    check_plan(&plan(a, mesh, out, &jobs, &others))?;
    let inputs = [("mesh", true), ("rig", a.rig.rig.is_some()), ("landmarks", a.landmarks.is_some())];
    let mut units = a.units.of_given(&inputs)?;
    let MeshFile { mesh: before, colors, .. } = units.read_mesh_file("mesh", mesh)?;
    let materials = materials_for(out, mesh, &before);
    let copies: Vec<_> = materials.writes(out).into_iter().map(|path| ("--out", path)).collect();
    refuse_beside(out, copies.clone(), &materials)?;
    let material_files = materials.reads().map(|path| ("mesh", path.clone()));
    check_plan(&plan(a, mesh, out, &jobs, &others).reads_all(material_files).writes_all(copies))?;
    warn_of_materials(out, mesh, &before, &materials);
    let mut mesh = before.clone();
    let rig = a.rig.open(true)?;
    let of_rig = rig.as_ref().and_then(|(rig, _)| rig.landmarks().map(<[u32]>::to_vec));
    let (mut shapes, regions) = a.rig.choose(rig, &mut units, true, ("the mesh", &mesh.positions))?;
    if let Some(bounds) = a.weight_bounds {
        shapes = shapes.with_bounds(|_| bounds);
    }
    let regions = regions.unwrap_or_else(|| Regions::of_groups(&mesh));
    let landmarks = landmarks(a, of_rig.as_deref(), &mesh, &mut units)?;
    units.say();
    let follow = |jobs: &[(Recipe, Option<f64>)], until| -> Result<Vec<StepOutcome>, Failure> {
        let mut mesh = before.clone();
        let mut outcomes: Vec<StepOutcome> = Vec::new();
        for (recipe, amount) in jobs {
            let subject = Subject { mesh: &mesh, landmarks: &landmarks, regions: &regions, shapes: &shapes };
            let options = ReplayOptions { amount: *amount, until, model: a.model };
            outcomes.extend(replay(recipe, &subject, &options).map_err(failure)?);
            if let Some(last) = outcomes.last() {
                mesh.positions.clone_from(&last.positions);
            }
        }
        Ok(outcomes)
    };
    let mut outcomes = follow(&jobs, a.until)?;
    if let Some(last) = outcomes.last() {
        mesh.positions.clone_from(&last.positions);
    }
    let lines: Vec<String> = outcomes.iter().enumerate().map(|(k, outcome)| line(k + 1, outcome)).collect();
    if let Some(folder) = &a.masks {
        write_masks(folder, &outcomes)?;
    }
    if let Some(folder) = &a.report {
        let mut known = Landmarks::default();
        if let (None, Some(rig)) = (&a.landmarks, &a.rig.rig) {
            known = measure::landmarks_of_rig(rig, of_rig.as_deref(), &before)?;
        }
        if known.is_empty() {
            known = Landmarks::among(&landmarks).map_err(measure::failure)?;
        }
        let mut plans = vec![outcomes];
        for other in others {
            plans.push(follow(&[(other, None)], None)?);
        }
        let names =
            plan_names(&[a.recipe.as_ref().unwrap_or(out)].into_iter().chain(&a.compare).cloned().collect::<Vec<_>>());
        let mut about = a.client.about();
        for (name, outcomes) in names.iter().zip(&plans) {
            let head = if plans.len() == 1 { "step".to_owned() } else { format!("{name}, step") };
            for (k, outcome) in outcomes.iter().enumerate() {
                about.push((head.clone(), line(k + 1, outcome)));
                about.extend(doubts(k + 1, outcome).map(|text| ("doubt".to_owned(), text)));
            }
        }
        write_report(folder, &before, &known, &regions, &names, &plans, &about)?;
        outcomes = plans.swap_remove(0);
    }
    let copied = materials.write(out, &mut mesh).map_err(Failure::writing)?;
    io::write_colored_mesh(out, &mesh, colors.as_deref()).map_err(Failure::writing)?;
    copied.keep();
    warn_of_format(out, &before);
    outcomes.iter().enumerate().flat_map(|(k, outcome)| doubts(k + 1, outcome)).for_each(warn);
    lines.iter().try_for_each(say)
}

/// Says what the recipes are not made for, and what has no effect.
fn warn_of_recipes(a: &Arguments, jobs: &[(Recipe, Option<f64>)], others: &[Recipe]) {
    let all = || jobs.iter().map(|(recipe, amount)| (recipe, *amount)).chain(others.iter().map(|other| (other, None)));
    all().flat_map(|(recipe, amount)| recipe.doubts(amount, a.model)).for_each(warn);
    let mut models = all().flat_map(|(recipe, _)| &recipe.step).map(|step| a.model.unwrap_or(step.get_ref().model));
    if models.any(MorphModel::uses_shapes) {
        return;
    }
    let given = [
        ("--shapes", a.rig.shapes.is_some()),
        ("--identity-modes", a.rig.identity_modes.is_some()),
        ("--weight-bounds", a.weight_bounds.is_some()),
    ];
    for (option, _) in given.iter().filter(|(_, given)| *given) {
        warn(format_args!("{option} has no effect: no step's model has blendshapes"));
    }
}

/// Everything that is read and written.
fn plan(a: &Arguments, mesh: &PathBuf, out: &Path, jobs: &[(Recipe, Option<f64>)], others: &[Recipe]) -> FilePlan {
    let recipes = jobs.iter().map(|job| &job.0).chain(others);
    let others = [("recipe", a.recipe.as_ref()), ("landmarks", a.landmarks.as_ref())];
    let mut plan = FilePlan::new()
        .reads_all(meshes([("mesh", Some(mesh))]))
        .reads_all(others.into_iter().filter_map(|(role, path)| Some((role, path?))))
        .reads_all(a.rig.rig.iter().flat_map(|rig| rig_files(rig)))
        .reads_all(a.compare.iter().map(|path| ("recipe", path)))
        .reads_all(recipes.flat_map(Recipe::files).map(|path| ("mask of the recipe", path)))
        .writes("--out", out);
    if let Some(folder) = &a.masks {
        let steps = jobs.iter().flat_map(|(recipe, _)| recipe.step.iter().take(a.until.unwrap_or(usize::MAX)));
        for (k, step) in steps.enumerate() {
            let names = (0..step.get_ref().mask.len()).flat_map(|m| ["png", "npy"].map(|e| mask_name(k, m, e)));
            plan = plan.writes_all(names.map(|name| ("--masks", folder.join(name))));
        }
    }
    if let Some(folder) = &a.report {
        let names = report::FILES.into_iter().chain([STEPS]);
        plan = plan.writes_all(names.map(|name| ("--report", folder.join(name))));
    }
    plan
}

/// What each step did, in the folder of the report.
const STEPS: &str = "morph.json";

fn mask_name(step: usize, mask: usize, extension: &str) -> String {
    format!("step{}-mask{}.{extension}", step + 1, mask + 1)
}

/// The largest value of each vertex.
fn largest(all: impl Iterator<Item = Vec<f64>>) -> Option<Vec<f64>> {
    all.reduce(|a, b| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect())
}

fn write_report(
    folder: &Path,
    before: &PolygonMesh,
    known: &Landmarks,
    regions: &Regions,
    names: &[String],
    plans: &[Vec<StepOutcome>],
    about: &[(String, String)],
) -> Result<(), Failure> {
    let regions = named_regions(regions);
    let subject = Measured { mesh: before, after: None, landmarks: known, regions: &regions };
    let mut shapes: Vec<Plan<'_>> = Vec::new();
    for (name, outcomes) in names.iter().zip(plans) {
        let positions = outcomes.last().map_or(&before.positions, |last| &last.positions);
        shapes.push(Plan { name, positions });
    }
    let mask = largest(plans.iter().flatten().map(StepOutcome::coverage));
    let protected = largest(plans.iter().flatten().map(|outcome| outcome.protected.clone()));
    let page = report::Report {
        about,
        plans: &shapes,
        mask: mask.as_deref(),
        protected: protected.as_deref(),
        ..report::Report::new("A face, morphed", subject)
    };
    let steps: Vec<_> = plans[0].iter().map(|outcome| &outcome.report).collect();
    let text = serde_json::to_string_pretty(&steps).map_err(Failure::computation)?;
    let besides = |aside: &Path| write_atomically(&aside.join(STEPS), |file| writeln!(file, "{text}"));
    report::write_with(folder, &page, besides).map(drop).map_err(measure::failure)
}

/// What is to be done, and by how much.
fn jobs(a: &Arguments) -> Result<Vec<(Recipe, Option<f64>)>, Failure> {
    if let Some(path) = &a.recipe {
        let recipe = Recipe::read(path).map_err(failure)?;
        if a.until.is_some_and(|until| until == 0 || until > recipe.step.len()) {
            let message = format!("--until: {} has {} steps", path.display(), recipe.step.len());
            return Err(Failure::new(Stage::Arguments, message));
        }
        return Ok(vec![(recipe, a.amount)]);
    }
    a.preset.iter().map(|text| requested_preset(text)).collect()
}

/// `NAME` or `NAME=MM`.
fn requested_preset(text: &str) -> Result<(Recipe, Option<f64>), Failure> {
    let (name, amount) = text.split_once('=').map_or((text, None), |(name, amount)| (name, Some(amount)));
    let recipe = known_preset(name)?;
    let Some(amount) = amount else { return Ok((recipe, None)) };
    let Some(amount) = amount.parse::<f64>().ok().filter(|a| a.is_finite()) else {
        let message = format!("--preset {name}: expected millimetres, found {amount:?}");
        return Err(Failure::new(Stage::Arguments, message));
    };
    Ok((recipe, Some(amount)))
}

fn known_preset(name: &str) -> Result<Recipe, Failure> {
    preset(name).ok_or_else(|| unknown_preset(name))?.map_err(failure)
}

fn unknown_preset(name: &str) -> Failure {
    let message = format!("unknown preset '{name}'; there are {}", preset_names().join(", "));
    Failure::new(Stage::Arguments, message)
}

fn failure(error: RecipeError) -> Failure {
    let missing = match &error {
        RecipeError::Impossible { error: MorphError::UnknownLandmark { known, .. }, .. } if known == NO_LANDMARKS => {
            Some("--landmarks")
        }
        RecipeError::Impossible { error: MorphError::Shapes { found: 0, .. }, .. } => Some("--rig"),
        _ => None,
    };
    match missing {
        Some(option) => Failure::new(Stage::Arguments, format!("{error}; give {option}")),
        None if error.is_input() => Failure::loading(error),
        None => Failure::computation(error),
    }
}

/// Those that are given, or else the 68 of the rig: in its folder, or `of_rig`.
fn landmarks(
    a: &Arguments,
    of_rig: Option<&[u32]>,
    mesh: &PolygonMesh,
    units: &mut Units<'_>,
) -> Result<Vec<(String, TemplatePoint)>, Failure> {
    let in_folder = || Some(a.rig.rig.as_ref()?.join(RIG_LANDMARKS)).filter(|path| path.exists());
    let Some(path) = a.landmarks.clone().or_else(in_folder) else {
        let numbered = of_rig.unwrap_or_default().iter().enumerate();
        return Ok(numbered.map(|(n, vertex)| (n.to_string(), TemplatePoint::Vertex(*vertex))).collect());
    };
    let mut set = landmark::read_landmark_set(&path).map_err(Failure::loading)?;
    units.bring_landmarks("landmarks", &path, "mesh", &mut set)?;
    set.format = LandmarkFormat::Native; // positions are points of the surface, as where they are measured
    let points = set.on_template(&path, mesh).map_err(Failure::loading)?;
    OffTemplate::of(&path, &set, &points, mesh).map_err(Failure::loading)?.doubt().iter().for_each(warn);
    let placed: Vec<_> = points.iter().map(|(name, point)| (&**name, point.position(&mesh.positions))).collect();
    swapped_sides(&placed).iter().for_each(warn);
    Ok(points)
}

/// A rig's 68 landmarks.
const RIG_LANDMARKS: &str = "landmarks_multipie68.json";

fn write_masks(folder: &Path, outcomes: &[StepOutcome]) -> Result<(), Failure> {
    let write = |aside: &Path| {
        for (k, outcome) in outcomes.iter().enumerate() {
            for (m, mask) in outcome.masks.iter().enumerate() {
                if let Some(texture) = &mask.texture {
                    texture.write_png(&aside.join(mask_name(k, m, "png")))?;
                }
                mask.weights.write_npy(&aside.join(mask_name(k, m, "npy")))?;
            }
        }
        Ok(())
    };
    io::write_folder(folder, write).map_err(Failure::writing)
}

/// [`StepReport::doubts`](crate::morph::StepReport::doubts) with the step's number.
fn doubts(number: usize, outcome: &StepOutcome) -> impl Iterator<Item = String> {
    outcome.report.doubts().into_iter().map(move |doubt| format!("step {number} {doubt}"))
}

fn line(number: usize, outcome: &StepOutcome) -> String {
    let r = &outcome.report;
    let steps = r.energy.as_ref().map_or_else(String::new, |e| format!(" in {} steps", e.iterations));
    format!(
        "{number}. {} ({}{steps}): {} vertices, at most {:.2} mm of {:.2} asked, {:.3} mm across an edge, {} folded, edges {:.2} to {:.2}",
        if r.step.is_empty() { "step" } else { &r.step },
        r.model.name(),
        r.moving,
        r.change.reached,
        r.asked,
        r.change.largest_jump,
        r.change.folded,
        r.change.stretch.min,
        r.change.stretch.max,
    )
}
