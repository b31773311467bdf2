//! The command line: arguments and messages only. Everything else is in the library.

mod animate;
mod bake;
pub mod batch;
mod completions;
mod doctor;
mod eval;
mod inputs;
mod interrupt;
mod landmarks;
mod measure;
mod morph;
mod register;
mod rig;
mod rig_convert;
mod rig_fit;
mod rig_pca;
mod rig_subdivide;
mod rig_transfer;
mod units;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};

use crate::io::{MaterialFiles, files_of_mesh};
use crate::mesh::{ObjStatement, PolygonMesh};

use crate::console::{Failure, Stage, answer, bounded, check_folder_path, check_plan, on_threads, say, tell, warn};

/// Deform meshes by nonlinear least squares: wrap a template onto a scan, judge the result, change it by masks.
#[derive(Debug, Parser)]
#[command(name = "nonrigid", version, about, max_term_width = 110, after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Exit codes: 0 done, 1 arguments, 2 computation, 3 writing, 4 loading, 130 interrupted,
143 terminated.
Lengths are millimetres; units of inputs are found, or stated by --unit. `nonrigid COMMAND --help` ends with examples of
that command. In a checkout, `nonrigid` is `cargo run --release --`, and `data-gen`, which makes the examples' files,
`cargo run --release -p data-gen --`.

Examples, on what `data-gen --seed 7 --out out/data` makes:
  nonrigid doctor
  nonrigid register --template out/data/rig/template.obj --rig out/data/rig \\
      --target out/data/cases/same_open/scan.ply --landmarks out/data/cases/same_open/landmarks.json --out wrapped.obj
  nonrigid eval --result wrapped.obj --template out/data/rig/template.obj --truth out/data/cases/same_open/truth.npy";

#[derive(Debug, Subcommand)]
enum Command {
    /// Wrap a template onto a scan; the result has the scan's shape and the template's topology.
    Register(Box<register::Arguments>),
    /// Wrap a template onto many scans, listed in a table.
    Batch(Box<batch::Arguments>),
    /// Make one animated file of the frames of a sequence.
    Animate(animate::Arguments),
    /// Measure a result against ground truth, or against the scan where there is none.
    Eval(eval::Arguments),
    /// Change a face by masks: presets in millimetres, or a recipe.
    Morph(Box<morph::Arguments>),
    /// Measure a face, or what a change did to it: distances, angles, ratios, symmetry, areas, volumes.
    Measure(measure::Arguments),
    /// Convert landmark files, check landmarks on a mesh, carry them to another one.
    #[command(subcommand, after_help = landmarks::EXAMPLES)]
    Landmarks(landmarks::Command),
    /// Look into a blendshape rig, make or convert one, fit its weights.
    #[command(subcommand, after_help = rig::EXAMPLES)]
    Rig(rig::Command),
    /// Show what this build runs on, and compute in some seconds whether it computes what it should.
    Doctor(doctor::Arguments),
    /// Print a script that completes commands and options in a shell.
    Completions(completions::Arguments),
}

/// The whole command line, as clap knows it.
#[must_use]
pub fn command() -> clap::Command {
    Cli::command()
}

/// How this command line is started again, for each scan of a batch.
#[derive(Debug, Clone)]
pub struct Program {
    /// The program.
    pub path: PathBuf,
    /// What stands before a command.
    pub first: Vec<OsString>,
}

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    let path = std::env::current_exe().unwrap_or_else(|_| "nonrigid".into()); // what cannot be started says so
    run(std::env::args_os(), &Program { path, first: Vec::new() })
}

/// Runs a command line, the program's name first.
#[must_use]
pub fn run(arguments: impl IntoIterator<Item = OsString>, program: &Program) -> ExitCode {
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(e) => return answer(&e),
    };
    let outcome = match cli.command {
        Command::Register(arguments) => register::run(&arguments),
        Command::Batch(arguments) => batch::run(&arguments, program),
        Command::Animate(arguments) => animate::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Morph(arguments) => morph::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Landmarks(command) => landmarks::run(&command),
        Command::Rig(command) => rig::run(&command),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

/// Refuses an output whose extension has no writer, whose folder is not there, or that is itself a folder.
fn check_output(path: &Path, extensions: &[&str]) -> Result<(), Failure> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    if !extensions.contains(&extension.as_str()) {
        let message = format!("{}: cannot write '.{extension}', only .{}", path.display(), extensions.join(" and ."));
        return Err(Failure::new(Stage::Arguments, message));
    }
    check_file_path(path)
}

/// Refuses an output file whose folder is not there, or that is itself a folder.
fn check_file_path(path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Err(Failure::writing(format!("{}: cannot be written: it is a folder, not a file", path.display())));
    }
    check_parent(path)
}

/// Whether two paths lead to one file or folder that is there.
fn same_place(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// The files of meshes that are read, each as one thing.
fn meshes<'r, 'p>(meshes: impl IntoIterator<Item = (&'r str, Option<&'p PathBuf>)>) -> Vec<(&'r str, PathBuf)> {
    let given = meshes.into_iter().filter_map(|(role, path)| Some((role, path?)));
    given.flat_map(|(role, path)| files_of_mesh(path).into_iter().map(move |path| (role, path))).collect()
}

/// Refuses a folder for outputs that is something else, or that would take more than one new folder.
///
/// # Errors
/// At [`Stage::Writing`].
pub fn check_output_folder(path: &Path) -> Result<(), Failure> {
    check_folder_path(path)?;
    if path.is_dir() { Ok(()) } else { check_parent(path) }
}

fn check_parent(path: &Path) -> Result<(), Failure> {
    // The parent of a bare file name is the empty path.
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        let message = format!("{}: cannot be written: there is no folder {}", path.display(), folder.display());
        return Err(Failure::new(Stage::Writing, message));
    }
    Ok(())
}

/// The materials of a mesh that was read from `path`, to be copied beside what is made of it: `out`, an OBJ file. What is missing of
/// them is said.
fn materials_for(out: &Path, path: &Path, mesh: &PolygonMesh) -> MaterialFiles {
    if !has_extension(out, "obj") {
        return MaterialFiles::default();
    }
    let files = MaterialFiles::of(path, mesh);
    files.missing.iter().for_each(|(_, told)| warn(told));
    files
}

/// Refuses to overwrite files beside an output that are [somebody else's](MaterialFiles::is_foreign).
fn refuse_beside<'a>(
    out: &Path,
    files: impl IntoIterator<Item = (&'a str, PathBuf)>,
    materials: &MaterialFiles,
) -> Result<(), Failure> {
    match files.into_iter().find(|(_, path)| materials.is_foreign(out, path)) {
        None => Ok(()),
        Some((option, path)) => {
            let message = format!("{}: is there already, and would be overwritten ({option})", path.display());
            Err(Failure::writing(format!("{message}; move it away, or give another name")))
        }
    }
}

/// Says what of a mesh the format of a file does not hold.
fn warn_of_format(out: &Path, mesh: &PolygonMesh) {
    let metadata = &mesh.metadata;
    let has = |of: fn(&ObjStatement) -> bool| metadata.statements.iter().any(|(_, statement)| of(statement));
    let normals = (!metadata.corner_normals.is_empty(), "hard edges");
    let materials = (has(|s| matches!(s, ObjStatement::Material(_))), "materials");
    let groups = (has(|s| matches!(s, ObjStatement::Group(_) | ObjStatement::Object(_))), "groups");
    let smoothing = (has(|s| matches!(s, ObjStatement::Smoothing(_))), "smoothing groups");
    let listed = |of: &[(bool, &'static str)]| {
        of.iter().filter(|(is, _)| *is).map(|(_, what)| *what).collect::<Vec<_>>().join(", ")
    };
    let (out, extension) = (out.display(), out.extension().unwrap_or_default().to_ascii_lowercase());
    match extension.to_str() {
        Some("ply") => match listed(&[groups, materials, smoothing, normals]) {
            lost if lost.is_empty() => {}
            lost => warn(format_args!("{out}: PLY holds no {lost}; .obj and .usda do")),
        },
        Some("glb") => match listed(&[groups, smoothing, normals]) {
            noted if noted.is_empty() => {}
            noted => warn(format_args!(
                "{out}: {noted} are in a note that other programs do not read; .obj and .usda hold them"
            )),
        },
        _ => {}
    }
}

/// Says what a result loses of the materials of the mesh that was read from `path`: what is not in `taken` goes from OBJ to OBJ alone.
fn warn_of_materials(out: &Path, path: &Path, mesh: &PolygonMesh, taken: &MaterialFiles) {
    let metadata = &mesh.metadata;
    let named = metadata.statements.iter().any(|(_, s)| matches!(s, ObjStatement::Material(_)));
    let has_files = !metadata.material_libraries.is_empty() || is_gltf(path);
    // that PLY has no materials is said
    if named && has_files && *taken == MaterialFiles::default() && !has_extension(out, "ply") {
        let (out, path) = (out.display(), path.display());
        warn(format_args!(
            "{out}: materials are names alone; their colours and images stay with {path}: they go along from .obj to .obj"
        ));
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}

fn is_gltf(path: &Path) -> bool {
    has_extension(path, "glb") || has_extension(path, "gltf")
}
