//! `nonrigid register`.

use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::bake::{self, BakeArguments};
use super::inputs::{
    FlipArgument, LANDMARKS, MaskArguments, RigArguments, TEMPLATE_LANDMARKS, bounds, read_landmarks, refuse_as_shape,
    rig_files, texture_of,
};
use super::interrupt::Interrupt;
use super::units::UnitArguments;
use super::{
    Failure, Stage, check_output, check_plan, file_name, has_extension, is_gltf, meshes, on_threads, refuse_beside,
    say, warn, warn_of_format, warn_of_materials,
};
use crate::correspondence::VertexMasks;
use crate::io::{self, FilePlan, Inputs, MaterialFiles, write_json};
use crate::registration::{
    DetailReport, InputFile, MOST_ROUNDS, ModelFactory, ModelKind, Quality, RegistrationError, RegistrationInput,
    RegistrationObserver, RegistrationResult, RegistrationStop, Reliability, Report, Schedule, StepRecord, TERMS,
    VertexColors, WITHIN_MM, WarmStart, add_detail, assess, register, scan_colors,
};
use crate::render::{registration_sheet, save_png};
use crate::rig::Regions;
use crate::texture::{BakeInput, Baked};

/// Arguments of `nonrigid register`.
#[derive(Debug, Args)]
#[command(after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes; on files of your own:\n  \
    nonrigid register --template out/data/rig/template.obj --rig out/data/rig \\\n      \
    --target out/data/cases/same_open/scan.ply --landmarks out/data/cases/same_open/landmarks.json \\\n      \
    --out wrapped.obj --report wrapped.json --picture wrapped.png\n  \
    nonrigid register --template face.obj --target scan.ply --rig rig \\\n      \
    --landmarks landmarks.json --out own.obj")]
pub struct Arguments {
    /// Template mesh (.obj, .ply, .stl or .off, also .gz, .glb or .gltf); the result keeps its vertex order, polygons, UVs, groups and materials
    #[arg(long, value_name = "MESH")]
    template: PathBuf,
    /// Scan (.obj, .ply, .stl, .off or .xyz, also .gz, .glb or .gltf): a mesh, or a point cloud with normals (.ply, .off, .xyz)
    #[arg(long, value_name = "MESH")]
    target: PathBuf,
    /// The subject's own neutral: one position per template vertex (.npy N x 3, .obj or .ply) [default: the template]
    #[arg(long, value_name = "FILE")]
    neutral: Option<PathBuf>,
    #[command(flatten)]
    rig: RigArguments,
    /// Landmarks: template vertex or name -> point on the scan, in any format that 'nonrigid landmarks' reads. With fewer than
    /// three, the start is searched all over the scan; where nothing fits, or several poses fit alike, that is an error
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// What the landmarks' names mean on the template, in any of those formats
    #[arg(long, value_name = "FILE", requires = "landmarks")]
    template_landmarks: Option<PathBuf>,
    #[command(flatten)]
    masks: MaskArguments,
    #[command(flatten)]
    units: UnitArguments,
    /// Whether the scan is inside out, its normals facing inwards, and has to be turned over [default: the schedule's, or auto]
    #[arg(long, value_enum, value_name = "WHEN")]
    flip: Option<FlipArgument>,
    #[arg(long, value_parser = str::parse::<ModelKind>,
        help = format!("Deformation model: {} [default: hybrid with --rig or --config, sumner without]", ModelKind::names()))]
    model: Option<ModelKind>,
    /// Schedule (.toml) [default: the model's own]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Bounds of expression weights, such as 0,1 [default: the schedule's, or none]
    #[arg(long, value_name = "MIN,MAX", value_parser = bounds, allow_hyphen_values = true, requires = "rig")]
    expression_bounds: Option<[f64; 2]>,
    /// Bounds of identity weights, such as -3,3 [default: the schedule's, or none]
    #[arg(long, value_name = "MIN,MAX", value_parser = bounds, allow_hyphen_values = true, requires = "rig")]
    identity_bounds: Option<[f64; 2]>,
    /// Go on from where another registration of this template, model and schedule has ended: the --state of the frame before.
    /// Give three landmarks or more: without them the head may have moved too far, and nothing tells
    #[arg(long, value_name = "FILE")]
    warm_start: Option<PathBuf>,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Result (.obj, .ply, .glb or .usda), with the scan's colours at its vertices if the scan has any
    #[arg(long, value_name = "MESH")]
    out: PathBuf,
    /// Divide the result N times (1 to 3) by Catmull and Clark's rules, each polygon of k corners into k quads, and let its vertices go on to
    /// the scan by themselves: for wrinkles that the template is too coarse for
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=MOST_ROUNDS as i64))]
    subdivide: Option<u8>,
    #[command(flatten)]
    bake: BakeArguments,
    /// Report (.json); times go to a second file, *.timing.json
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Picture (.png) of template, scan, result, and result over scan
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Where the registration has ended (.json), for the --warm-start of the next frame
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
}

impl Arguments {
    /// The model that is asked for.
    fn model(&self) -> ModelKind {
        self.model.unwrap_or_else(|| ModelKind::usual(self.rig.rig.is_some() || self.config.is_some()))
    }

    /// Every file that is read, with what it is read as.
    pub fn input_paths(&self) -> Vec<(&'static str, PathBuf)> {
        let of_meshes =
            [(TEMPLATE, Some(&self.template)), (TARGET, Some(&self.target)), (NEUTRAL, self.neutral.as_ref())];
        let mut files = meshes(of_meshes);
        if self.bake.asked() {
            files.extend(io::files_of_painted_mesh(&self.target).into_iter().map(|p| (TARGET, p)));
        }
        files.extend(self.materials().reads().map(|p| (TEMPLATE, p.clone())));
        files.extend(self.landmarks.clone().map(|p| (LANDMARKS, p)));
        files.extend(self.template_landmarks.clone().map(|p| (TEMPLATE_LANDMARKS, p)));
        files.extend(self.warm_start.clone().map(|p| (WARM_START, p)));
        files.extend(self.masks.mask.clone().map(|p| (MASK, p)));
        files.extend(self.masks.free_mask.clone().map(|p| (FREE_MASK, p)));
        files.extend(self.config.clone().map(|p| (SCHEDULE, p)));
        files.extend(self.rig.rig.iter().flat_map(|rig| rig_files(rig)));
        files
    }

    /// The template's materials, which go with a result in OBJ unless it shows a texture of its own.
    fn materials(&self) -> MaterialFiles {
        match has_extension(&self.out, "obj") {
            true => MaterialFiles::kept_of(&self.template),
            false => MaterialFiles::default(),
        }
    }

    /// Every file that could be written beside a result.
    pub fn beside(&self, out: &Path) -> Vec<(&'static str, PathBuf)> {
        let mut files = self.bake.output_paths(out);
        for path in self.materials().writes(out) {
            if files.iter().all(|(_, known)| *known != path) {
                files.push(("--out", path));
            }
        }
        files
    }

    /// Every file that is written, with the option that asks for it.
    fn output_paths(&self) -> Vec<(&'static str, PathBuf)> {
        let mut files = vec![("--out", self.out.clone())];
        if let Some(report) = &self.report {
            files.extend([("--report", report.clone()), ("--report", timing_path(report))]);
        }
        files.extend(self.beside(&self.out));
        files.extend(self.picture.clone().map(|p| ("--picture", p)));
        files.extend(self.state.clone().map(|p| ("--state", p)));
        files
    }
}

// What files are read as, in the order of the report.
const TEMPLATE: &str = "template";
const TARGET: &str = "target";
const NEUTRAL: &str = "neutral";
const WARM_START: &str = "warm start";
const MASK: &str = "mask";
const FREE_MASK: &str = "free mask";
const SCHEDULE: &str = "schedule";
const RIG: &str = "rig";
const ROLES: [&str; 10] =
    [TEMPLATE, TARGET, NEUTRAL, LANDMARKS, TEMPLATE_LANDMARKS, WARM_START, MASK, FREE_MASK, SCHEDULE, RIG];

/// Where times go.
fn timing_path(report: &Path) -> PathBuf {
    report.with_extension("timing.json")
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    on_threads(arguments.threads, || run_here(arguments))?
}

fn run_here(a: &Arguments) -> Result<(), Failure> {
    let clock = Instant::now();
    let inputs = Inputs::default();
    if a.model().needs_shapes() && a.rig.rig.is_none() {
        return Err(Failure::new(Stage::Arguments, format!("model '{}' needs blendshapes; give --rig", a.model())));
    }
    let schedule = inputs.reading(SCHEDULE, || read_schedule(a))?;
    check_outputs(a)?;
    let mut units = a.units.of(&["template", "target", "neutral", "rig", "landmarks", "template-landmarks"])?;
    let meshes = || -> Result<_, Failure> {
        let template = inputs.reading(TEMPLATE, || units.read_mesh("template", &a.template))?;
        let painted = inputs.reading(TARGET, || match a.bake.asked() {
            true => units.read_painted_scan("target", &a.target),
            false => units.read_scan("target", &a.target).map(|scan| (scan, None)),
        })?;
        let neutral =
            a.neutral.as_deref().map(|path| inputs.reading(NEUTRAL, || units.read_positions("neutral", path)));
        Ok((template, painted, neutral.transpose()?))
    };
    let own_neutral = a.neutral.is_some();
    let (meshes, rig) = rayon::join(meshes, || inputs.reading(RIG, || a.rig.open(own_neutral)));
    let (mut template, (scan, paint), neutral) = meshes?;
    let painter = match a.bake.asked() {
        true => a.bake.prepare((&a.template, &template), (&a.target, &scan), paint.as_ref())?,
        false => None,
    };
    let materials = a.materials();
    materials.missing.iter().for_each(|(_, told)| warn(told));
    if !a.bake.asked() {
        warn_of_materials(&a.out, &a.template, &template, &materials);
    }
    if is_gltf(&a.template) {
        template.metadata.material_libraries.clear(); // noted from an OBJ, and left beside that
    }
    let subject = neutral.as_deref().map_or(("the template", &template.positions[..]), |n| ("the neutral", n));
    let (shapes, regions) = a.rig.choose(rig?, &mut units, own_neutral, subject)?;
    let regions = regions.unwrap_or_else(|| Regions::of_groups(&template));
    let [mask, free_mask] = a.masks.read(&inputs, &template, &regions)?;
    let landmarks = [&a.landmarks, &a.template_landmarks].map(Option::as_deref);
    let landmarks = read_landmarks(landmarks, &inputs, &mut units, &template, ("target", Some(&scan.mesh)))?;
    let warm_start = a.warm_start.as_deref().map(|path| inputs.reading(WARM_START, || read_state(path))).transpose()?;
    let files = input_files(&inputs);
    units.refuse_misfits()?;
    units.say();
    if let Some(path) = &a.config {
        schedule
            .without_effect(Some(shapes.shapes()))
            .iter()
            .for_each(|said| warn(format_args!("{}: {said}", path.display())));
    }
    let chosen = [
        ("--shapes", a.rig.shapes.is_some()),
        ("--identity-modes", a.rig.identity_modes.is_some()),
        ("--expression-bounds", a.expression_bounds.is_some()),
        ("--identity-bounds", a.identity_bounds.is_some()),
    ];
    for (option, _) in chosen.iter().filter(|(_, given)| *given && !a.model().uses_shapes()) {
        warn(format_args!("{option} has no effect: --model {} has no blendshapes", a.model().name()));
    }
    if shapes.is_empty() && a.model() == ModelKind::Hybrid {
        let why = match a.rig.rig {
            None => "no rig given",
            Some(_) => "nothing of the rig is used (--identity-modes takes modes of it)",
        };
        warn(format_args!(
            "{why}: without blendshapes the hybrid is a graph that stays stiff; --model sumner comes nearer"
        ));
    }
    let input = RegistrationInput {
        neutral: neutral.as_deref(),
        shapes: &shapes,
        scan_normals: scan.normals.as_deref(),
        landmarks: &landmarks,
        mask: mask.as_deref(),
        free_mask: free_mask.as_deref(),
        regions: Some(&regions),
        warm_start: warm_start.as_ref(),
        ..RegistrationInput::new(&template, &scan.mesh)
    };
    let reading = clock.elapsed().as_secs_f64();

    let mut progress = Progress::new(Interrupt::listen()?);
    let failed = |e: RegistrationError| {
        let stage = if e.is_input() { Stage::Loading } else { Stage::Computation };
        Failure::new(stage, e.to_string())
    };
    let result = register(&input, &a.model(), &schedule, &mut progress).map_err(failed)?;
    let coarse = clock.elapsed().as_secs_f64();
    let rounds = a.subdivide.filter(|_| result.stop == RegistrationStop::Finished);
    let detail = rounds.map(|n| add_detail(&input, &result, n, &mut progress)).transpose();
    let detail = detail.map_err(failed)?;
    progress.bar.finish_and_clear();
    let [registering, dividing] = [coarse - reading, clock.elapsed().as_secs_f64() - coarse];

    let (quality, reliability) = assess(&input, &result).map_err(Failure::computation)?;
    // From here on what is written: the finer mesh, if there is one.
    let input = detail.as_ref().map_or(input, |d| d.input(input.scan, input.scan_normals));
    let (template, positions) = (input.template, detail.as_ref().map_or(&result, |d| &d.result).positions.clone());
    let finer = detail.as_ref().map(|d| DetailReport::measure(&input, d)).transpose().map_err(Failure::computation)?;
    let colors = scan.colors.as_deref().map(|colors| scan_colors(&input, &result.scan, colors, &positions)).transpose();
    let colors = colors.map_err(Failure::computation)?;
    let mut registered = template.with_positions(positions);
    let before_texture = clock.elapsed().as_secs_f64();
    let shown = VertexMasks::new(input.mask, input.free_mask, vec![false; template.positions.len()]).data;
    let (faced, normals) = result.scan_facing.apply(&scan.mesh, scan.normals.as_deref());
    let baked = a.bake.bake(&BakeInput {
        template: &registered,
        mask: Some(&shown),
        scan: &faced,
        scan_normals: normals.as_deref(),
        painter: painter.as_ref(),
        sources: painter.as_ref().and_then(|_| result.scan_facing.sources(&scan.mesh)).as_deref(),
    })?;
    let baking_seconds = clock.elapsed().as_secs_f64() - before_texture;
    let report = match &a.report {
        Some(path) => {
            let report = Report::new(a.model().name(), files, &result, quality.clone(), reliability.clone());
            let (regions, free_regions) = (a.masks.regions.clone(), a.masks.free_regions.clone());
            let colors_observed = colors.as_ref().map(VertexColors::observed_count);
            let units = units.known();
            let texture_seen = baked.as_ref().map(Baked::seen_share);
            let detail = finer.clone();
            Some((path, Report { regions, free_regions, units, colors_observed, texture_seen, detail, ..report }))
        }
        None => None,
    };
    // Everything is computed; only writing can still fail, and what is printed is true.
    let of_vertices = colors.as_ref().map(|c| &c.colors[..]);
    let before_images = clock.elapsed().as_secs_f64();
    let image = baked.as_ref().map(|baked| a.bake.write(baked, &a.out, &mut registered)).transpose()?.flatten();
    let unpainted = || materials.write(&a.out, &mut registered).map_err(Failure::writing);
    let copied = image.is_none().then(unpainted).transpose()?;
    let images_seconds = clock.elapsed().as_secs_f64() - before_images;
    match image {
        Some(image) if has_extension(&a.out, "glb") => io::write_textured_glb(&a.out, &registered, &image),
        Some(_) if has_extension(&a.out, "usda") => {
            io::write_textured_usda(&a.out, &registered, &file_name(&bake::color_of(&a.out)))
        }
        _ => io::write_colored_mesh(&a.out, &registered, of_vertices),
    }
    .map_err(Failure::writing)?;
    if let Some(copied) = copied {
        copied.keep();
    }
    if let Some((path, report)) = report {
        write_json(path, &report).map_err(Failure::writing)?;
        let timing = Timing {
            reading_seconds: reading,
            registration_seconds: registering,
            detail_seconds: detail.as_ref().map(|_| dividing),
            texture_seconds: baked.as_ref().map(|_| [baking_seconds, images_seconds]),
            total_seconds: clock.elapsed().as_secs_f64(),
            threads: rayon::current_num_threads(),
        };
        write_json(&timing_path(path), &timing).map_err(Failure::writing)?;
    }
    if let Some(path) = &a.state {
        write_json(path, &result.end).map_err(Failure::writing)?;
    }
    if let Some(path) = &a.picture {
        let percent = 100.0 * reliability.probability;
        let (target, length) = (file_name(&a.target), reliability.wrong_length());
        let title = format!("{} onto {target}; off by over {length}: {percent:.0} %", a.model().name());
        let sheet = registration_sheet(&title, template, &faced, &registered, 480);
        save_png(&sheet, path).map_err(Failure::writing)?;
    }
    warn_of_format(&a.out, template);
    warn_of_inputs(a, &result, scan.colors.is_none() && !a.bake.asked());
    reliability.doubts.iter().for_each(warn);
    if let Some(colors) = &colors {
        let (seen, of) = (colors.observed_count(), colors.colors.len());
        say(format_args!("colour: {seen} of {of} vertices as on the scan, the others' diffused from them"))?;
    }
    baked.as_ref().map_or(Ok(()), |baked| a.bake.report(baked, &a.out))?;
    print_summary(a, &result, &quality, &reliability, clock.elapsed().as_secs_f64())?;
    if let Some(finer) = &finer {
        say(finer)?;
    }
    let last = detail.as_ref().map_or(&result, |d| &d.result);
    if last.stop == RegistrationStop::StoppedByObserver {
        let message = format!("interrupted: {} holds what was reached, not the end", a.out.display());
        return Err(progress.interrupt.failure(message));
    }
    Ok(())
}

/// What was found wrong with scan and landmarks, and what was done about it.
fn warn_of_inputs(a: &Arguments, result: &RegistrationResult, colorless: bool) {
    result.remarks().iter().for_each(warn);
    if let Some(texture) = texture_of(&a.target).filter(|_| colorless) {
        warn(format_args!(
            "the scan's texture {texture:?} is not used; --bake-texture 2048 brings it to the template's UVs"
        ));
    }
}

fn read_state(path: &Path) -> Result<WarmStart, Failure> {
    let failed = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
    let text = io::read_text(path).map_err(Failure::loading)?;
    serde_json::from_str(&text).map_err(|e| failed(&e))
}

/// What differs from run to run.
#[derive(Serialize)]
struct Timing {
    reading_seconds: f64,
    registration_seconds: f64,
    /// Dividing the result, and the steps of its own that the finer mesh took.
    #[serde(skip_serializing_if = "Option::is_none")]
    detail_seconds: Option<f64>,
    /// Baking, and writing its images.
    #[serde(skip_serializing_if = "Option::is_none")]
    texture_seconds: Option<[f64; 2]>,
    total_seconds: f64,
    threads: usize,
}

/// The schedule, with the bounds that are given besides.
fn read_schedule(a: &Arguments) -> Result<Schedule, Failure> {
    let mut schedule = match &a.config {
        None => a.model().schedule().map_err(Failure::loading)?,
        Some(path) => {
            let failed = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
            let text = io::read_text(path).map_err(Failure::loading)?;
            let schedule = Schedule::from_toml(&text).and_then(|s| s.resolved(&a.model(), &TERMS));
            schedule.map_err(|e| failed(&e))?
        }
    };
    schedule.bounds.expression = a.expression_bounds.or(schedule.bounds.expression);
    schedule.scan.flip = a.flip.map_or(schedule.scan.flip, FlipArgument::flip);
    schedule.bounds.identity = a.identity_bounds.or(schedule.bounds.identity);
    Ok(schedule)
}

/// Outputs that could not be written, or would overwrite what is read, are refused before the work is done.
fn check_outputs(a: &Arguments) -> Result<(), Failure> {
    check_output(&a.out, &["obj", "ply", "glb", "usda"])?;
    a.picture.as_deref().map_or(Ok(()), |p| check_output(p, &["png"]))?;
    a.report.as_deref().map_or(Ok(()), |p| check_output(p, &["json"]))?;
    a.state.as_deref().map_or(Ok(()), |p| check_output(p, &["json"]))?;
    refuse_as_shape(a.rig.rig.as_deref(), a.out.parent().unwrap_or(Path::new("")), "--out")?;
    check_plan(&FilePlan::new().reads_all(a.input_paths()).writes_all(a.output_paths()))?;
    refuse_beside(&a.out, a.beside(&a.out), &a.materials())
}

/// What was read, as the report says it.
fn input_files(inputs: &Inputs) -> Vec<InputFile> {
    let mut files = inputs.files();
    files.sort_by_key(|input| ROLES.iter().position(|role| *role == input.role));
    files.into_iter().map(InputFile::from).collect()
}

fn print_summary(
    a: &Arguments,
    result: &RegistrationResult,
    quality: &Quality,
    reliability: &Reliability,
    seconds: f64,
) -> Result<(), Failure> {
    let inliers = result.history.last().map_or(0.0, |h| h.inliers);
    say(format_args!(
        "{}: {} steps in {seconds:.2} s, {:.0} % of the vertices accepted",
        a.model().name(),
        result.history.len(),
        100.0 * inliers
    ))?;
    say(format_args!(
        "distance to the scan: {:.1} % of the vertices within {WITHIN_MM} mm, their median {:.3} mm; {} triangles flipped against the rest shape",
        100.0 * quality.to_scan.share_within,
        quality.median_within,
        quality.flipped
    ))?;
    if let Some(untangled) = result.untangled.filter(|u| u.after < u.before) {
        say(untangled)?;
    }
    say(quality.mesh)?;
    let percent = 100.0 * reliability.probability;
    reliability.evidence.handedness.remark().map_or(Ok(()), say)?;
    say(format_args!("probability that the error exceeds {}: {percent:.0} %", reliability.wrong_length()))?;
    let held = result.weights.iter().filter(|w| w.at_bound).count();
    if held > 0 {
        say(format_args!("{held} of {} weights are at a bound", result.weights.len()))?;
    }
    say(format_args!("wrote {}", a.out.display()))
}

/// A progress bar on a terminal, nothing when piped; ends the registration when Ctrl-C asks for it.
struct Progress {
    bar: ProgressBar,
    interrupt: Interrupt,
}

impl Progress {
    fn new(interrupt: Interrupt) -> Self {
        let bar = if std::io::stderr().is_terminal() { ProgressBar::new(0) } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len}  {msg}") {
            bar.set_style(style);
        }
        Self { bar, interrupt }
    }
}

impl RegistrationObserver for Progress {
    fn on_start(&mut self, _levels: usize, steps: usize) {
        self.bar.set_length(steps as u64);
    }

    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self.bar.inc(1);
        self.bar.set_message(format!(
            "level {}  {:.0} % accepted  moved {:.2} mm",
            record.level + 1,
            100.0 * record.inliers,
            record.motion
        ));
        if self.interrupt.asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
