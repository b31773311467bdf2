//! The first run: it makes its own data and shows one scan of an extreme mouth, registered by three models.
//!
//! Varied: the model. Held: scan, shapes, landmarks and each model's default schedule. Measured: the error against the true
//! position of every template vertex that the scan shows.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use nonrigid::cli::{Failure, say_to};
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::io::write_polygon_mesh;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::{ModelFactory, ModelKind, TermFactory, TermKind};
use nonrigid::render::{Camera, ColourScale, Frame, Scene, Sheet, Style, View, render, save_png};

use crate::generated::{Generated, extreme_mouth};
use crate::scan_bench::{BenchCase, BenchRig, BenchRow, LandmarkUse, run_case};
use crate::tables::write_tables;

/// What is compared, in this order.
const MODELS: [ModelKind; 3] = [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Blendshape];

/// The steps, with seconds for 5,000 vertices on two cores.
const PLAN: [(&str, f64); 5] = [
    ("make a rig and a scan", 1.0),
    ("register: hybrid", 1.2),
    ("register: graph", 1.0),
    ("register: blendshape", 0.5),
    ("measure and draw", 0.4),
];

/// What to run.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Seed of the scan
    #[arg(long, default_value_t = 7)]
    pub seed: u64,
    /// Vertices of the template, about
    #[arg(long, default_value_t = 5000, value_parser = vertex_count)]
    pub vertices: usize,
    /// Where everything goes: data, results, errors, picture
    #[arg(long, value_name = "DIR", default_value = "out/report")]
    pub out: PathBuf,
}

fn vertex_count(text: &str) -> Result<usize, String> {
    let inside = text.parse().ok().filter(|n| (1000..=100_000).contains(n));
    inside.ok_or_else(|| "not a number from 1000 to 100000".to_owned())
}

/// Runs everything and tells `log` about it. Files hold the same bytes at every run and number of threads, except
/// `first.timing.csv`.
///
/// # Errors
/// A [`Failure`] when something cannot be written or read back; anything else is a failed computation.
pub fn run(options: &Options, log: &mut dyn Write) -> Result<Vec<BenchRow>> {
    let Options { seed, vertices, out } = options;
    let clock = Instant::now();
    let data = out.join("data");
    fs::create_dir_all(&data).map_err(|e| Failure::writing(format!("{}: {e}", data.display())))?;

    let scale = *vertices as f64 / 5000.0;
    let plan = PLAN.map(|(name, seconds)| format!("{name} {:.0} s", (seconds * scale).ceil())).join("; ");
    let total = scale * PLAN.iter().map(|s| s.1).sum::<f64>();
    let threads = rayon::current_num_threads();
    say(log, format_args!("One scan of an extreme mouth, registered by three deformation models.\n"))?;
    say(log, format_args!("seed {seed}, threads {threads}, template of about {} vertices\n", grouped(*vertices)))?;
    say(log, format_args!("plan, about {:.0} s: {plan}\n\n", total.ceil()))?;

    let [making, registering @ .., measuring] = PLAN.map(|s| s.0);
    let mut step = Step::start(log, making)?;
    let made = extreme_mouth(&data, *vertices, *seed)?;
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    let rig = BenchRig::read(&made.rig).map_err(unread)?;
    let case = BenchCase::read(&made.case, &rig).map_err(unread)?;
    step.done(log)?;

    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let mut results = Vec::new();
    for (model, name) in MODELS.into_iter().zip(registering) {
        step = Step::start(log, name)?;
        let (row, result) = run_case(&model, &terms, &model.schedule()?, &case, LandmarkUse::All)?;
        let mesh = case.template.with_positions(result.positions);
        write_polygon_mesh(&out.join(format!("{model}.obj")), &mesh).map_err(Failure::writing)?;
        results.push((row, mesh));
        step.done(log)?;
    }

    step = Step::start(log, measuring)?;
    let rows: Vec<BenchRow> = results.iter().map(|r| r.0.clone()).collect();
    let errors = rows.iter().map(|r| format!("{} {:.2} mm", r.model, r.errors.rmse)).collect::<Vec<_>>().join(", ");
    let observed = grouped(case.observed.iter().filter(|o| **o).count());
    let verdict = format!("rmse over {observed} observed vertices: {errors}");
    let json = serde_json::json!({ "seed": seed, "vertices": case.truth.len(), "rows": rows });
    write_tables(out, "first", &rows, &json)?;
    let picture = out.join("first.png");
    draw(&picture, &verdict, &case, &made, &results)?;
    step.done(log)?;

    say(log, format_args!("\n{verdict}\n\n"))?;
    say(log, format_args!("picture  {}\n", picture.display()))?;
    say(log, format_args!("results  {}, as OBJ; errors in first.csv and first.json\n", out.display()))?;
    say(log, format_args!("data     {}\n", data.display()))?;
    say(log, format_args!("took {:.1} s\n\n", clock.elapsed().as_secs_f64()))?;
    say(log, format_args!("{}\n", next_commands(out, &made.rig, &made.case, made.identity_modes)))?;
    Ok(rows)
}

fn say(log: &mut dyn Write, text: std::fmt::Arguments<'_>) -> Result<()> {
    Ok(say_to(log, text)?)
}

/// A step that the log shows while it runs.
struct Step {
    clock: Instant,
}

impl Step {
    fn start(log: &mut dyn Write, name: &str) -> Result<Self> {
        say(log, format_args!("{name:24}"))?;
        Ok(Self { clock: Instant::now() })
    }

    fn done(self, log: &mut dyn Write) -> Result<()> {
        say(log, format_args!("{:5.1} s\n", self.clock.elapsed().as_secs_f64()))
    }
}

/// With commas between thousands.
fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let comma = |(i, c): (usize, char)| [(i > 0 && (digits.len() - i).is_multiple_of(3)).then_some(','), Some(c)];
    digits.chars().enumerate().flat_map(comma).flatten().collect()
}

/// What to type next, as it works from the same folder.
fn next_commands(out: &Path, rig: &Path, case: &Path, identity_modes: usize) -> String {
    let quoted = |path: PathBuf| {
        let text = path.display().to_string();
        if text.contains(char::is_whitespace) { format!("\"{text}\"") } else { text }
    };
    let (rig_folder, template) = (quoted(rig.to_owned()), quoted(rig.join("template.obj")));
    let modes = match identity_modes.min(40) {
        0 => String::new(),
        n => format!(" --identity-modes {n}"),
    };
    format!(
        "look closer:\n  \
         cargo run --release -- eval --result {} --template {template} --truth {} --observed {} --heatmap {}\n  \
         cargo run --release -p experiments -- scan-bench {} --rig {rig_folder} --out {}\n\n\
         your own scan, in a folder YOUR_SCAN with scan.ply and landmarks.json ({} is one):\n  \
         cargo run --release -- register --template {template} --rig {rig_folder}{modes} \
         --target YOUR_SCAN/scan.ply --landmarks YOUR_SCAN/landmarks.json --out {} --picture {}",
        quoted(out.join("hybrid.obj")),
        quoted(case.join("truth.npy")),
        quoted(case.join("observed.npy")),
        quoted(out.join("hybrid-error.png")),
        quoted(case.parent().unwrap_or(case).to_owned()),
        quoted(out.join("scan-bench")),
        quoted(case.to_owned()),
        quoted(out.join("wrapped.obj")),
        quoted(out.join("wrapped.png")),
    )
}

/// Width and height of a panel, pixels.
const PANEL: [u32; 2] = [292, 360];
const LANDMARK: [u8; 3] = [206, 48, 40];

/// Template, scan and results from an angle, landmarks and errors from the front, polygons at the mouth: one column each.
/// All in the rig's coordinates, where the face is upright.
fn draw(
    path: &Path,
    title: &str,
    case: &BenchCase,
    made: &Generated,
    results: &[(BenchRow, PolygonMesh)],
) -> Result<()> {
    let upright = |points: &[Vec3]| points.iter().map(|p| made.pose.apply_inverse(*p)).collect::<Vec<_>>();
    let truth = upright(&case.truth);
    let rest = case.neutral.as_ref().unwrap_or(&case.template.positions);
    let template = case.template.with_positions(rest.clone());
    let scan = TriangleMesh { positions: upright(&case.scan.mesh.positions), ..case.scan.mesh.clone() };
    let meshes: Vec<PolygonMesh> = results.iter().map(|(_, m)| m.with_positions(upright(&m.positions))).collect();

    let triangles = case.template.triangulate().triangles;
    let errors = results.iter().map(|(_, mesh)| {
        let (_, errors) = TruthErrors::new(&mesh.positions, &case.truth, &case.observed, &triangles)?;
        Ok(errors.observed_distance(&case.observed))
    });
    let errors: Vec<Vec<f64>> = errors.collect::<Result<_>>()?;
    let scale = ColourScale::for_magnitudes(&errors.concat(), "distance to the truth", "mm");

    let panel = |scene: &Scene, frame: &Frame, view: View| render(scene, &Camera::framing(frame, view, PANEL), PANEL);
    let face = Frame::of(&truth).union(Frame::of(rest)).scaled(0.9);
    let angle = View::Angles { yaw: 32.0, pitch: 4.0 };
    let clay = |mesh: &TriangleMesh| Scene::new().mesh(mesh, Style::Clay);
    let wired = |mesh: &PolygonMesh| clay(&mesh.triangulate()).wireframe(mesh);

    let mut faces = vec![panel(&wired(&template), &face, angle), panel(&clay(&scan), &face, angle)];
    faces.extend(meshes.iter().map(|m| panel(&clay(&m.triangulate()), &face, angle)));

    let marks = case.landmarks.iter().map(|l| l.template.position(rest)).collect::<Vec<_>>();
    let targets = upright(&case.landmarks.iter().map(|l| l.target).collect::<Vec<_>>());
    let lifted = |points: &[Vec3]| points.iter().map(|p| p + 3.0 * Vec3::z()).collect::<Vec<_>>(); // clear of the skin
    let marked = |mesh: &TriangleMesh, points: &[Vec3]| {
        panel(&clay(mesh).points(&lifted(points), LANDMARK, 2.6), &face, View::Front)
    };
    let mut heat = vec![marked(&template.triangulate(), &marks), marked(&scan, &targets)];
    heat.extend(meshes.iter().zip(errors).map(|(mesh, values)| {
        panel(&Scene::new().mesh(&mesh.triangulate(), Style::Values(values, scale.clone())), &face, View::Front)
    }));

    let lips =
        |positions: &[Vec3]| made.mouth.iter().filter_map(|v| positions.get(*v as usize)).copied().collect::<Vec<_>>();
    let open = Frame::of(&lips(&truth)).scaled(1.35);
    let mut mouths = vec![
        panel(&wired(&template), &Frame::of(&lips(rest)).at_scale_of(open), View::Front),
        panel(&clay(&scan), &open, View::Front),
    ];
    mouths.extend(meshes.iter().map(|m| panel(&wired(m), &open, View::Front)));

    let headings = results.iter().map(|(row, _)| format!("{} {:.2} mm", row.model, row.errors.rmse));
    let headings: Vec<String> = ["template".to_owned(), "scan".to_owned()].into_iter().chain(headings).collect();
    let headings: Vec<&str> = headings.iter().map(String::as_str).collect();
    let sheet = Sheet::new(title).columns(&headings).colour_bar(&scale);
    Ok(save_png(&sheet.row("", faces).row("", heat).row("", mouths).render(), path).map_err(Failure::writing)?)
}
