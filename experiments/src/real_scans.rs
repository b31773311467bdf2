//! `real-scans`: a folder of scans, every model on every one, in one picture and one table.
//!
//! Varied: the model. Held: the scan, the rig's shapes, the landmarks where a scan has some, each model's default schedule.
//! Measured, as nobody knows the truth: the share of vertices with an accepted correspondence, distances to the scan,
//! self-intersections, edge stretch.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use nonrigid::console::{Failure, Stage, say, tell, told};
use nonrigid::io::{self, Scan};
use nonrigid::landmark;
use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PolygonMesh, Pose, TriangleMesh, Vec3};
use nonrigid::registration::{ModelKind, Quality, RegistrationInput, Silent, assess, register};
use nonrigid::render::{
    Camera, Frame, RgbImage, Scene, Sheet, Style, View, draw_text, render, save_png, text_height, text_size,
};
use nonrigid::rig::{Family, Rig, RigReadOptions, ShapeBasis, ShapeSelection};
use serde::Serialize;

use crate::output::{each_once, make_folder, make_output_folder, write_result};
use crate::tables::{csv_field, table, write_csv, write_json};
use crate::{identity_modes, unread};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A scan is a mesh file (.obj, .ply, .stl, .off, .xyz, each also as .gz, .glb, .gltf), in millimetres, and is called as its\n\
    file is, or, where two files have one name, as its path. Its landmarks are beside it: for NAME.ply in\n\
    NAME.landmarks.json, or else in landmarks.json. One that cannot be read says so in its rows.\n\n\
    Examples, on a folder of your own, and on what `data-gen --seed 7 --out out/data` makes:\n  \
    experiments real-scans --scans SCANS --rig rig --out out/real-scans\n  \
    experiments real-scans --scans out/data/cases --rig out/data/rig --models hybrid,graph"
)]
pub struct Arguments {
    /// Folder of the scans, which are in it or in its folders
    #[arg(long, value_name = "DIR")]
    pub scans: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    pub rig: PathBuf,
    /// How many of the rig's identity modes take part [default: 60, or as many as it has]
    #[arg(long, value_name = "K")]
    pub identity_modes: Option<usize>,
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

/// Extensions of the meshes that are read; `.gz` may follow.
const EXTENSIONS: [&str; 7] = ["obj", "ply", "stl", "off", "xyz", "glb", "gltf"];

/// A scan that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanFile {
    /// Of its rows and of its folder of results.
    pub name: String,
    /// The mesh.
    pub path: PathBuf,
}

impl ScanFile {
    /// The landmarks beside it, if there are any.
    #[must_use]
    pub fn landmarks(&self) -> Option<PathBuf> {
        let of_this = format!("{}.landmarks.json", stem(&self.path)?);
        [&of_this, "landmarks.json"].map(|name| self.path.with_file_name(name)).into_iter().find(|path| path.exists())
    }
}

/// Every mesh in `folder` and in its folders, but for that of the rig, by path.
///
/// # Errors
/// When a folder cannot be read.
pub fn scans_in(folder: &Path, rig: &Path) -> std::io::Result<Vec<ScanFile>> {
    let rig = rig.canonicalize().ok();
    let below = |folder: &Path| fs::read_dir(folder)?.map(|e| e.map(|e| e.path())).collect::<std::io::Result<Vec<_>>>();
    let mut paths = below(folder)?;
    let is_rig = |path: &PathBuf| rig.is_some() && path.canonicalize().ok() == rig;
    let folders: Vec<PathBuf> = paths.iter().filter(|path| path.is_dir() && !is_rig(path)).cloned().collect();
    for inner in folders {
        paths.extend(below(&inner)?);
    }
    paths.retain(|path| path.is_file() && stem(path).is_some());
    paths.sort();
    // The shortest names that tell all of them apart.
    let relative = |path: &PathBuf| {
        let parts = path.strip_prefix(folder).unwrap_or(path).components();
        parts.map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
    };
    let stem_of = |path: &PathBuf| stem(path).unwrap_or_default();
    let namings: [&dyn Fn(&PathBuf) -> String; 3] =
        [&stem_of, &|path: &PathBuf| relative(&path.with_file_name(stem_of(path))), &relative];
    let different = |names: &Vec<String>| names.iter().collect::<BTreeSet<_>>().len() == names.len();
    let names = namings.iter().map(|naming| paths.iter().map(naming).collect()).find(different);
    let names = names.unwrap_or_else(|| paths.iter().map(relative).collect());
    Ok(names.into_iter().zip(paths).map(|(name, path)| ScanFile { name, path }).collect())
}

/// A mesh file's name without its extension, nothing for other files.
fn stem(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy();
    let (stem, extension) = match name.rsplit_once('.')? {
        (inner, gz) if gz.eq_ignore_ascii_case("gz") => inner.rsplit_once('.')?,
        plain => plain,
    };
    let known = !stem.is_empty() && EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known));
    known.then(|| stem.to_owned())
}

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
    fn read(folder: &Path, asked: Option<usize>) -> Result<Self> {
        let unread = |e: anyhow::Error| unread(e.context("--rig"));
        let (rig, _) = Rig::read(folder, &RigReadOptions::default()).map_err(|e| unread(e.into()))?;
        let identity_modes = identity_modes(&rig, asked)?;
        Ok(Self::of(&rig, folder, identity_modes).map_err(unread)?)
    }

    fn of(rig: &Rig, folder: &Path, identity_modes: usize) -> Result<Self> {
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
    fn read(file: &ScanFile, template: &PolygonMesh) -> Result<Self> {
        let scan = io::read_scan(&file.path)?;
        crate::check_millimetres(&file.path, &scan.mesh.positions)?;
        let read = |path: PathBuf| landmark::read_landmarks(&path, None, template, Some(&scan.mesh));
        let landmarks = file.landmarks().map(read).transpose()?.unwrap_or_default();
        Ok(Self { scan, landmarks })
    }
}

/// Runs the command. A scan or model that fails says so in its cells; the others go on.
///
/// # Errors
/// A [`Failure`] when the rig or every scan cannot be read, when something cannot be written, and when every single
/// registration failed.
pub fn run(a: &Arguments) -> Result<Vec<RealScanRow>> {
    each_once("--models", &a.models)?;
    let scans = scans_in(&a.scans, &a.rig)
        .map_err(|e| Failure::loading(format!("--scans {}: cannot be read: {e}", a.scans.display())))?;
    if scans.is_empty() {
        let read = EXTENSIONS.join(", .");
        let message = format!("--scans {}: no mesh in it or in its folders; read are .{read}", a.scans.display());
        return Err(Failure::loading(message).into());
    }
    say(format_args!("{} scans x {} models, {} threads", scans.len(), a.models.len(), rayon::current_num_threads()))?;
    let (rows, picture) = register_all(a, &scans)?;
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
pub fn register_all(a: &Arguments, scans: &[ScanFile]) -> Result<(Vec<RealScanRow>, RgbImage)> {
    let template = Template::read(&a.rig, a.identity_modes)?;
    let targets: Vec<_> = scans.iter().map(|file| Target::read(file, &template.mesh)).collect();
    if let (true, Some(Err(first))) = (targets.iter().all(Result::is_err), targets.first()) {
        let message = format!("--scans {}: none of the scans can be read; {}", a.scans.display(), told(first));
        return Err(Failure::loading(message).into());
    }
    let folders: Vec<String> = scans.iter().map(|scan| scan.name.clone()).collect();
    make_output_folder(&a.out, [("--rig", &a.rig), ("--scans", &a.scans)], &folders)?;
    let (mut rows, mut sheet) = (
        Vec::new(),
        Sheet::new("Real scans, every model; self-int: pairs of triangles through each other (in the template)"),
    );
    for (ScanFile { name, .. }, target) in scans.iter().zip(targets) {
        let (found, panels) = match target {
            Ok(target) => every_model(a, &template, name, &target)?,
            Err(e) => unreadable(a, name, &told(&e)),
        };
        rows.extend(found);
        for (i, panels) in panels.chunks(ACROSS).enumerate() {
            sheet = sheet.row(if i == 0 { name.as_str() } else { "" }, panels.to_vec());
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
    make_folder(&folder)?;
    let mut view: Option<Upright> = None;
    let (mut rows, mut results) = (Vec::new(), Vec::new());
    for model in &a.models {
        let clock = Instant::now();
        let fitted = fit(model, template, target);
        let seconds = clock.elapsed().as_secs_f64();
        let row = |fit, error| RealScanRow { scan: name.into(), model: model.to_string(), fit, error, seconds };
        match fitted {
            Ok((fit, positions, start)) => {
                let mesh = write_result(&folder.join(format!("{model}.obj")), &template.mesh, positions)?;
                view.get_or_insert_with(|| Upright::new(start, &mesh.positions));
                results.push(Some(mesh.triangulate()));
                tell(format_args!("{name:10} {model:16} median {:.3} mm  {seconds:.2} s", fit.quality.to_scan.median));
                rows.push(row(Some(fit), None));
            }
            Err(e) => {
                let message = told(&e);
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
    let result = register(&input, model, &model.schedule()?, &mut Silent)?;
    if !result.positions.iter().all(|p| p.iter().all(|x| x.is_finite())) {
        bail!("the result is not finite");
    }
    let fit = Fit {
        accepted: result.history.last().map_or(0.0, |h| h.inliers),
        iterations: result.history.len(),
        quality: assess(&input, &result)?.0,
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
/// Height of a line of text, and from one to the next.
const FONT: u32 = 17;
const LINE: u32 = 21;
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
        draw_text(
            &mut panel,
            6,
            i64::from(PANEL[1] + 8 + i as u32 * LINE),
            line,
            text_height(line, FONT, PANEL[0] - 12),
            INK,
        );
    }
    panel
}

fn failed_panel(title: &str, message: &str) -> RgbImage {
    let mut picture = RgbImage::new(PANEL[0], PANEL[1]);
    picture.fill(245);
    let across = (PANEL[0] - 12) / text_size("n", FONT)[0];
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
        let error = csv_field(r.error.as_deref().unwrap_or_default());
        format!("{},{},{numbers},{error}", csv_field(&r.scan), r.model)
    });
    write_csv(&a.out.join("real-scans.csv"), &header, lines)?;
    write_json(&a.out.join("real-scans.json"), &serde_json::json!({ "rows": rows }))?;
    let threads = rayon::current_num_threads();
    let times = rows.iter().map(|r| format!("{},{},{:.4},{threads}", csv_field(&r.scan), r.model, r.seconds));
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
    fn every_mesh_is_found_one_level_deep_and_named_apart() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let write = |name: &str| {
            fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
            fs::write(folder.join(name), "").unwrap();
        };
        let names = || scans_in(folder, &folder.join("rig")).unwrap().into_iter().map(|f| f.name).collect::<Vec<_>>();
        ["b/two.GLB", "one.ply.gz", "notes.txt", ".ply", "b/deep/three.ply", "rig/template.obj"]
            .iter()
            .for_each(|name| write(name));
        assert_eq!(names(), ["two", "one"]);
        write("a/one.stl");
        assert_eq!(names(), ["a/one", "b/two", "one"]);
        write("a/one.obj");
        assert_eq!(names(), ["a/one.obj", "a/one.stl", "b/two.GLB", "one.ply.gz"]);

        // Landmarks of its own go before those of the folder.
        let landmarks = |name: &str| {
            let of = ScanFile { name: String::new(), path: folder.join(name) }.landmarks();
            of.map(|path| path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned())
        };
        ["landmarks.json", "one.landmarks.json"].iter().for_each(|name| write(name));
        assert_eq!(landmarks("one.ply.gz").as_deref(), Some("one.landmarks.json"));
        assert_eq!(landmarks("two.ply").as_deref(), Some("landmarks.json"));
        assert_eq!(landmarks("a/one.obj"), None);
        assert!(scans_in(&folder.join("nowhere"), folder).is_err());
    }

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
