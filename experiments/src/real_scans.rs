//! `real-scans`: scans of real heads, every model on every one, in one picture and one table.
//!
//! Varied: the model. Held: the scan, the rig's shapes, the landmarks where a scan has some, each model's default schedule.
//! Measured, as nobody knows the truth: the share of vertices with an accepted correspondence, distances to the scan,
//! self-intersections, edge stretch.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::io::{self, Scan, write_polygon_mesh};
use nonrigid::landmark;
use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PolygonMesh, Pose, TriangleMesh, Vec3};
use nonrigid::registration::{ModelKind, Quality, RegistrationInput, StepRecord, register};
use nonrigid::render::{Camera, Frame, RgbImage, Scene, Sheet, Style, View, draw_text, render, save_png, text_size};
use nonrigid::rig::{Family, Rig, RigReadOptions, ShapeBasis, ShapeSelection};
use serde::Serialize;

use crate::output::make_output_folder;
use crate::tables::{csv_text, table, write_csv, write_json};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "A scan that is not there says so in its row.\n\n\
    Example, on folders of your own:\n  experiments real-scans --scans SCANS --rig rig --out out/real-scans")]
pub struct Arguments {
    /// Folder of the scans: menpo3d-james, lps-head, standardcyborg-sven
    #[arg(long, value_name = "DIR", default_value = "../shared/data/scans")]
    pub scans: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR", default_value = "../shared/data/ict-facekit/narrow")]
    pub rig: PathBuf,
    /// Identity modes to use, from the first
    #[arg(long, value_name = "K", default_value_t = 40)]
    pub identity_modes: usize,
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = ModelKind::ALL, value_parser = str::parse::<ModelKind>)]
    pub models: Vec<ModelKind>,
    /// Where results, tables and the picture go
    #[arg(long, value_name = "DIR", default_value = "out/real-scans")]
    pub out: PathBuf,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Name and file of each scan; landmarks are beside it, in `landmarks.json`.
pub const SCANS: [(&str, &str); 3] = [
    ("james", "menpo3d-james/james.ply"),
    ("lps-head", "lps-head/lps_head_neckcut.ply"),
    ("sven", "standardcyborg-sven/frame_050.ply"),
];

/// One model on one scan.
#[derive(Debug, Clone, Serialize)]
pub struct RealScanRow {
    /// Scan.
    pub scan: String,
    /// Model name.
    pub model: String,
    /// What came out; `None` where the registration failed.
    pub fit: Option<Fit>,
    /// Why it failed.
    pub error: Option<String>,
    /// Wall time; not part of what is compared.
    #[serde(skip)]
    pub seconds: f64,
}

/// A registration's result in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Fit {
    /// Share of the template's vertices with an accepted correspondence at the end.
    pub accepted: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Distances, folds, self-intersections, stretch.
    #[serde(flatten)]
    pub quality: Quality,
}

/// What all registrations share.
struct Template {
    mesh: PolygonMesh,
    shapes: ShapeBasis,
}

impl Template {
    /// A rig folder's polygons, its expressions but `mouthClose` (a correction of others) and pupils, its first identity modes.
    fn read(folder: &Path, identity_modes: usize) -> Result<Self> {
        let (rig, _) = Rig::read(folder, &RigReadOptions { identity_modes, ..RigReadOptions::default() })?;
        crate::check_millimetres(folder, rig.neutral())?;
        let mesh = rig.mesh().with_context(|| format!("{}: the rig has no template mesh", folder.display()))?.clone();
        let wanted = |name: &str| name != "mouthClose" && !name.starts_with("PupilDilate_");
        let expressions = rig.shapes().iter().filter(|s| s.family != Family::Identity && wanted(&s.name));
        let names: Vec<String> = expressions.map(|s| s.name.clone()).collect();
        let shapes = rig.select(ShapeSelection { names: Some(&names), identity_modes });
        Ok(Self { mesh, shapes: shapes.with_context(|| folder.display().to_string())? })
    }
}

/// A scan and where the template is on it.
struct Target {
    scan: Scan,
    landmarks: Vec<Landmark>,
}

impl Target {
    fn read(path: &Path, template: &PolygonMesh) -> Result<Self> {
        let scan = io::read_scan(path)?;
        crate::check_millimetres(path, &scan.mesh.positions)?;
        let landmarks = path.with_file_name("landmarks.json");
        let landmarks = if landmarks.exists() {
            landmark::read_landmarks(&landmarks, None, template, Some(&scan.mesh))?
        } else {
            Vec::new()
        };
        Ok(Self { scan, landmarks })
    }
}

/// Runs the command. A scan or model that fails says so in its cells; the others go on.
///
/// # Errors
/// A [`Failure`] when the rig or every scan cannot be read, when something cannot be written, and when every single
/// registration failed.
pub fn run(a: &Arguments) -> Result<Vec<RealScanRow>> {
    say(format_args!("{} scans x {} models, {} threads", SCANS.len(), a.models.len(), rayon::current_num_threads()))?;
    let (rows, picture) = register_all(a)?;
    write(a, &rows, &picture)?;
    if let Some(reason) = rows.iter().all(|r| r.fit.is_none()).then(|| rows.iter().find_map(|r| r.error.as_ref())) {
        let reason = reason.map_or("no model was asked for", String::as_str);
        return Err(Failure::new(Stage::Computation, format!("no registration succeeded: {reason}")).into());
    }
    Ok(rows)
}

/// Registers every scan with every model and leaves the results as OBJ: rows, and a picture of all.
///
/// # Errors
/// A [`Failure`] when the rig or every scan cannot be read, or a result cannot be written.
pub fn register_all(a: &Arguments) -> Result<(Vec<RealScanRow>, RgbImage)> {
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    let template = Template::read(&a.rig, a.identity_modes).map_err(|e| unread(e.context("--rig")))?;
    let targets = SCANS.map(|(name, file)| (name, Target::read(&a.scans.join(file), &template.mesh)));
    if targets.iter().all(|(_, target)| target.is_err()) {
        let looked_for = SCANS.map(|(_, file)| file).join(", ");
        let message =
            format!("{}: none of the scans can be read; looked for {looked_for} (--scans)", a.scans.display());
        return Err(Failure::loading(message).into());
    }
    make_output_folder(&a.out, [("--rig", &a.rig), ("--scans", &a.scans)])?;
    let (mut rows, mut sheet) = (
        Vec::new(),
        Sheet::new("Real scans, every model; self-int: pairs of triangles through each other (in the template)"),
    );
    for (name, target) in targets {
        let (found, panels) = match target {
            Ok(target) => every_model(a, &template, name, &target)?,
            Err(e) => unreadable(a, name, &format!("{e:#}")),
        };
        rows.extend(found);
        for (i, panels) in panels.chunks(ACROSS).enumerate() {
            sheet = sheet.row(if i == 0 { name } else { "" }, panels.to_vec());
        }
    }
    Ok((rows, sheet.render()))
}

/// Registers a scan with every model: rows, and panels of the scan and of every result.
fn every_model(
    a: &Arguments,
    template: &Template,
    name: &str,
    target: &Target,
) -> Result<(Vec<RealScanRow>, Vec<RgbImage>)> {
    let folder = a.out.join(name);
    fs::create_dir_all(&folder).map_err(|e| Failure::writing(format!("{}: {e}", folder.display())))?;
    let mut view: Option<Upright> = None;
    let (mut rows, mut results) = (Vec::new(), Vec::new());
    for model in &a.models {
        let clock = Instant::now();
        let fitted = fit(model, template, target);
        let seconds = clock.elapsed().as_secs_f64();
        let row = |fit, error| RealScanRow { scan: name.into(), model: model.to_string(), fit, error, seconds };
        match fitted {
            Ok((fit, positions, start)) => {
                let mesh = template.mesh.with_positions(positions);
                write_polygon_mesh(&folder.join(format!("{model}.obj")), &mesh).map_err(Failure::writing)?;
                view.get_or_insert_with(|| Upright::new(start, &mesh.positions));
                results.push(Some(mesh.triangulate()));
                tell(format_args!("{name:10} {model:16} median {:.3} mm  {seconds:.2} s", fit.quality.to_scan.median));
                rows.push(row(Some(fit), None));
            }
            Err(e) => {
                let message = format!("{e:#}");
                tell(format_args!("{name:10} {model:16} failed: {message}"));
                results.push(None);
                rows.push(row(None, Some(message)));
            }
        }
    }
    let view = view.unwrap_or_else(|| Upright::new(Pose::identity(), &target.scan.mesh.positions));
    let triangles = target.scan.mesh.triangles.len();
    let of_scan = [format!("{triangles} triangles"), format!("{} landmarks", target.landmarks.len())];
    let mut panels = vec![captioned(view.picture(&target.scan.mesh), "scan", &of_scan)];
    panels.extend(rows.iter().zip(&results).map(|(row, mesh)| match (&row.fit, mesh) {
        (Some(fit), Some(mesh)) => captioned(view.picture(mesh), &row.model, &caption(fit)),
        _ => failed_panel(&row.model, row.error.as_deref().unwrap_or_default()),
    }));
    Ok((rows, panels))
}

/// One registration: its numbers, positions and start.
fn fit(model: &ModelKind, template: &Template, target: &Target) -> Result<(Fit, Vec<Vec3>, Pose)> {
    let input = RegistrationInput {
        shapes: &template.shapes,
        scan_normals: target.scan.normals.as_deref(),
        landmarks: &target.landmarks,
        ..RegistrationInput::new(&template.mesh, &target.scan.mesh)
    };
    let result = register(&input, model, &model.schedule()?, &mut |_: &StepRecord| ControlFlow::Continue(()))?;
    if !result.positions.iter().all(|p| p.iter().all(|x| x.is_finite())) {
        bail!("the result is not finite");
    }
    let fit = Fit {
        accepted: result.history.last().map_or(0.0, |h| h.inliers),
        iterations: result.history.len(),
        quality: Quality::measure(&input, &result.positions)?,
    };
    Ok((fit, result.positions, result.start))
}

fn unreadable(a: &Arguments, name: &str, message: &str) -> (Vec<RealScanRow>, Vec<RgbImage>) {
    tell(format_args!("{name:10} cannot be read: {message}"));
    let row = |model: &ModelKind| RealScanRow {
        scan: name.into(),
        model: model.to_string(),
        fit: None,
        error: Some(message.to_owned()),
        seconds: 0.0,
    };
    (a.models.iter().map(row).collect(), vec![failed_panel("scan", message)])
}

/// Panels side by side at most; more go to a further row.
const ACROSS: usize = 6;
/// Width and height of a picture, pixels.
const PANEL: [u32; 2] = [300, 340];
const FONT: u32 = 2;
const LINE: u32 = 20;
const INK: [u8; 3] = [32, 36, 44];
const RED: [u8; 3] = [178, 40, 34];

/// The head as it stands in the template's frame, seen from the front.
struct Upright {
    pose: Pose,
    camera: Camera,
}

impl Upright {
    /// With the template placed on the scan by `pose`, and framed so that `points` fill the picture.
    fn new(pose: Pose, points: &[Vec3]) -> Self {
        let points: Vec<Vec3> = points.iter().map(|p| pose.apply_inverse(*p)).collect();
        Self { pose, camera: Camera::framing(&Frame::of(&points).scaled(0.95), View::Front, PANEL) }
    }

    fn picture(&self, mesh: &TriangleMesh) -> RgbImage {
        let positions = mesh.positions.iter().map(|p| self.pose.apply_inverse(*p)).collect();
        let mesh = TriangleMesh { positions, triangles: mesh.triangles.clone() };
        render(&Scene::new().mesh(&mesh, Style::Clay), &self.camera, PANEL)
    }
}

fn caption(fit: &Fit) -> [String; 4] {
    let Quality { to_scan, mesh, .. } = &fit.quality;
    [
        format!("{:.0} % accepted", 100.0 * fit.accepted),
        format!("median {:.2} mm", to_scan.median),
        format!("self-int {}({})", mesh.self_intersections, mesh.self_intersections_at_rest),
        format!("stretch {:.2}-{:.2}", mesh.stretch.p1, mesh.stretch.p99),
    ]
}

/// A picture over its title and caption.
fn captioned(picture: RgbImage, title: &str, lines: &[String]) -> RgbImage {
    let mut panel = RgbImage::new(PANEL[0], PANEL[1] + 8 + 5 * LINE);
    panel.fill(255);
    picture.enumerate_pixels().for_each(|(x, y, pixel)| panel.put_pixel(x, y, *pixel));
    for (i, line) in [title].into_iter().chain(lines.iter().map(String::as_str)).enumerate() {
        draw_text(&mut panel, 6, i64::from(PANEL[1] + 8 + i as u32 * LINE), line, FONT, INK);
    }
    panel
}

fn failed_panel(title: &str, message: &str) -> RgbImage {
    let mut picture = RgbImage::new(PANEL[0], PANEL[1]);
    picture.fill(245);
    let across = (PANEL[0] - 12) / text_size(" ", FONT)[0];
    for (i, line) in wrapped(message, across as usize).iter().enumerate() {
        draw_text(&mut picture, 6, 40 + i64::from(LINE) * i as i64, line, FONT, RED);
    }
    captioned(picture, title, &["failed".to_owned()])
}

/// Lines of at most `width` characters, broken at spaces; longer words are cut.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let characters: Vec<char> = word.chars().collect();
        for piece in characters.chunks(width.max(1)) {
            match lines.last_mut() {
                Some(line) if line.chars().count() + 1 + piece.len() <= width => {
                    line.push(' ');
                    line.extend(piece);
                }
                _ => lines.push(piece.iter().collect()),
            }
        }
    }
    lines
}

fn write(a: &Arguments, rows: &[RealScanRow], picture: &RgbImage) -> Result<()> {
    let header = format!("scan,model,{},error", COLUMNS.join(","));
    let lines = rows.iter().map(|r| {
        let numbers = r.fit.as_ref().map_or_else(|| ",".repeat(9), |fit| numbers(fit, 6).join(","));
        format!("{},{},{numbers},{}", r.scan, r.model, csv_text(r.error.as_deref().unwrap_or_default()))
    });
    write_csv(&a.out.join("real-scans.csv"), &header, lines)?;
    write_json(&a.out.join("real-scans.json"), &serde_json::json!({ "rows": rows }))?;
    let threads = rayon::current_num_threads();
    let times = rows.iter().map(|r| format!("{},{},{:.4},{threads}", r.scan, r.model, r.seconds));
    write_csv(&a.out.join("real-scans.timing.csv"), "scan,model,seconds,threads", times)?;
    let path = a.out.join("real-scans.png");
    save_png(picture, &path).map_err(Failure::writing)?;

    let header = [
        "scan / mm",
        "model",
        "accepted",
        "median",
        "median < 3",
        "share < 3",
        "flips",
        "self-int.",
        "(at rest)",
        "stretch 1 %",
        "99 %",
        "steps",
        "s",
    ];
    let cells = |r: &RealScanRow| {
        let numbers = r.fit.as_ref().map_or_else(|| vec!["failed".into()], |fit| numbers(fit, 3));
        let mut cells = [vec![r.scan.clone(), r.model.clone()], numbers].concat();
        cells.resize(header.len() - 1, String::new());
        cells.push(format!("{:.2}", r.seconds));
        cells
    };
    say(table(&header, rows.iter().map(cells)))?;
    say(format_args!("picture  {}", path.display()))?;
    say(format_args!("results, real-scans.csv and real-scans.json are in {}", a.out.display()))?;
    Ok(())
}

/// Columns of [`numbers`].
pub const COLUMNS: [&str; 10] = [
    "accepted",
    "median",
    "median_within",
    "share_within",
    "flips",
    "self_intersections",
    "self_intersections_at_rest",
    "stretch_p1",
    "stretch_p99",
    "iterations",
];

/// What the tables say of a fit, in the order of [`COLUMNS`].
#[must_use]
pub fn numbers(fit: &Fit, decimals: usize) -> Vec<String> {
    let Quality { to_scan, median_within, flipped, mesh, .. } = &fit.quality;
    let real = |x: f64| format!("{x:.decimals$}");
    vec![
        real(fit.accepted),
        real(to_scan.median),
        real(*median_within),
        real(to_scan.share_within),
        flipped.to_string(),
        mesh.self_intersections.to_string(),
        mesh.self_intersections_at_rest.to_string(),
        real(mesh.stretch.p1),
        real(mesh.stretch.p99),
        fit.iterations.to_string(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_messages_are_wrapped_and_long_words_cut() {
        assert_eq!(wrapped("one three five", 9), ["one three", "five"]);
        assert_eq!(wrapped("a/very/long/path here", 6), ["a/very", "/long/", "path", "here"]);
        assert!(wrapped("", 6).is_empty());
    }

    #[test]
    fn failed_and_captioned_panels_are_of_one_size() {
        let failed = failed_panel("graph", &"no surface within reach ".repeat(40));
        let shown = captioned(RgbImage::new(PANEL[0], PANEL[1]), "scan", &[]);
        assert_eq!(failed.dimensions(), shown.dimensions());
        assert!(failed.pixels().any(|p| p.0 == RED) && !shown.pixels().any(|p| p.0 == RED));
    }
}
