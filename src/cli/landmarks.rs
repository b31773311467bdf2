//! `nonrigid landmarks`.

use std::fmt;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};

use super::units::UnitArguments;
use super::{Failure, Stage, check_file_path, check_plan, meshes, say, warn};
use crate::io::FilePlan;
use crate::landmark;
use crate::landmark::{
    LandmarkCheck, LandmarkError, LandmarkFormat, LandmarkPlace, LandmarkSet, PatientSpace, PlaceKind,
};
use crate::mesh::{PolygonMesh, Vec3, bounding_box_diagonal, surface_points};

/// `nonrigid landmarks` and its subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write landmarks in another format
    #[command(after_help = format!("{FORMATS}{CONVERT_EXAMPLES}"))]
    Convert(Convert),
    /// See whether landmarks fit a mesh: off the surface, coinciding, left and right swapped
    #[command(after_help = format!("{FORMATS}{CHECK_EXAMPLES}"))]
    Check(Check),
    /// Carry landmarks to another mesh, of the same polygons or one that such a mesh was registered onto
    #[command(after_help = format!("{FORMATS}{TRANSFER_EXAMPLES}"))]
    Transfer(Transfer),
}

/// Examples of the whole family.
pub const EXAMPLES: &str = "\
Examples, on what `data-gen --seed 7 --out out/data` makes:
  nonrigid landmarks check out/data/rig/landmarks_multipie68.json --mesh out/data/rig/template.obj
  nonrigid landmarks convert out/data/cases/same_open/landmarks.json picked.mrk.json --unit mm";

const FORMATS: &str = "Landmark files, by extension and content:\n  \
    .json     this project's own; plain {\"name\": vertex, [triangle, u, v] or [x, y, z]}, as Wrap's; Scalismo's\n  \
    .mrk.json 3D Slicer's markups\n  .fcsv     3D Slicer's fiducials\n  .csv      Scalismo's: name,x,y,z\n  \
    .pp       MeshLab's picked points\n  .pts      Menpo's or IDAV Landmark's\n  .lm3      Bosphorus'\n  \
    .ljson    Menpo's, versions 1 to 3\n  .txt      template vertex or name, x y z\n\n\
    Positions of files that say RAS are brought to LPS, as 3D Slicer writes meshes.\n\n";

const CONVERT_EXAMPLES: &str = "\
Examples, on what `data-gen --seed 7 --out out/data` makes: positions for 3D Slicer, and back to points of triangles:
  nonrigid landmarks convert out/data/cases/same_open/landmarks.json picked.mrk.json --unit mm
  nonrigid landmarks convert picked.mrk.json picked.json --mesh out/data/cases/same_open/scan.ply --as face";

const CHECK_EXAMPLES: &str = "\
Example, on what `data-gen --seed 7 --out out/data` makes:
  nonrigid landmarks check out/data/rig/landmarks_multipie68.json --mesh out/data/rig/template.obj";

const TRANSFER_EXAMPLES: &str = "\
Example, on what `data-gen --seed 7 --out out/data` and the first example of `nonrigid register` make:
  nonrigid landmarks transfer out/data/rig/landmarks_multipie68.json on_scan.json \\
      --from out/data/rig/template.obj --to out/data/cases/same_open/scan.ply --registered wrapped.obj";

/// Arguments of `nonrigid landmarks convert`.
#[derive(Debug, Args)]
pub struct Convert {
    /// Landmark file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    #[command(flatten)]
    output: Output,
    /// The mesh that the landmarks are on: needed where formats differ in vertices, triangles and points
    #[arg(long, value_name = "MESH")]
    mesh: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
    /// Space of the output, whatever the format says of it: as meshes in LPS or in RAS need it [default: LPS if the input
    /// says one]
    #[arg(long, value_enum)]
    space: Option<Space>,
}

#[derive(Debug, Args)]
struct Output {
    /// Landmark file to write
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Its format: native, points, wrap, scalismo, csv, mrk.json, fcsv, pp, pts, lm3, ljson or txt [default: by its extension]
    #[arg(long)]
    format: Option<LandmarkFormat>,
    /// Whether landmarks are vertices, points of triangles or positions [default: as they are, if the format holds that]
    #[arg(long = "as", value_enum)]
    kind: Option<Kind>,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum Space {
    /// Left, posterior, superior: x to the patient's left, y to the back, z up
    Lps,
    /// Right, anterior, superior: x to the patient's right, y to the front, z up
    Ras,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// The nearest vertex of the mesh
    Vertex,
    /// The nearest point of its surface: a triangle and where in it
    Face,
    /// x, y, z
    Position,
}

impl Kind {
    fn example(self) -> LandmarkPlace {
        match self {
            Self::Vertex => LandmarkPlace::Vertex(0),
            Self::Face => LandmarkPlace::Face { triangle: 0, barycentric: [1.0, 0.0, 0.0] },
            Self::Position => LandmarkPlace::Position(Vec3::zeros()),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_possible_value().map_or(Ok(()), |value| f.write_str(value.get_name()))
    }
}

/// How far a landmark moves that is named, as a share of the mesh's size: 2 mm of a face. Where most move farther than the second, 5 mm, they
/// are of something else.
const FAR: f64 = 0.006;
const TOO_FAR: f64 = 0.015;
/// Landmarks that a sentence names.
const SHOWN: usize = 8;

/// Arguments of `nonrigid landmarks check`.
#[derive(Debug, Args)]
pub struct Check {
    /// Landmark file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    /// The mesh that the landmarks are on
    #[arg(long, value_name = "MESH")]
    mesh: PathBuf,
    /// Millimetres off the surface that are allowed
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    tolerance: f64,
    #[command(flatten)]
    units: UnitArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Arguments of `nonrigid landmarks transfer`.
#[derive(Debug, Args)]
pub struct Transfer {
    /// Landmark file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    #[command(flatten)]
    output: Output,
    /// The mesh that the landmarks are on
    #[arg(long, value_name = "MESH")]
    from: PathBuf,
    /// The mesh that they are carried to
    #[arg(long, value_name = "MESH")]
    to: PathBuf,
    /// One of the two registered onto the other, when their polygons differ
    #[arg(long, value_name = "MESH")]
    registered: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
}

/// Runs the command.
pub fn run(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Convert(arguments) => convert(arguments),
        Command::Check(arguments) => check(arguments),
        Command::Transfer(arguments) => transfer(arguments),
    }
}

fn convert(a: &Convert) -> Result<(), Failure> {
    let format = a.output.format(&[("landmarks", Some(&a.input)), ("mesh", a.mesh.as_ref())])?;
    let mut units = a.units.of_given(&[("mesh", a.mesh.is_some()), ("landmarks", true)])?;
    let mesh = a.mesh.as_deref().map(|path| units.read_mesh("mesh", path)).transpose()?;
    let mut set = read_set(&a.input)?;
    units.bring_landmarks("landmarks", &a.input, "mesh", &mut set)?;
    units.say();
    let mut moved = 0.0;
    if let Some(kind) = a.output.kind(&set, format) {
        let Some(mesh) = &mesh else {
            let message = format!("--mesh: needed to write the landmarks of {} as {format}", a.input.display());
            return Err(Failure::new(Stage::Arguments, message));
        };
        let positions = set.positions_on(&a.input, mesh).map_err(Failure::loading)?;
        (set, moved) = set.placed_as(kind, &positions, mesh).map_err(Failure::loading)?;
    }
    let read = describe(&set);
    if let Some(space) = a.space {
        let keeps = matches!(format, LandmarkFormat::SlicerJson | LandmarkFormat::SlicerFcsv);
        let space = if space == Space::Ras { PatientSpace::Ras } else { PatientSpace::Lps };
        set.space = Some(space);
        if !keeps {
            set.map_positions(|p| space.to_lps(p));
        }
    } else if set.space.is_some() {
        set.space = Some(PatientSpace::Lps);
    }
    write(&a.output, &set, format)?;
    let moved = if moved > 0.0 { format!("; moved to the mesh by at most {moved:.3} mm") } else { String::new() };
    say(format_args!("{read} -> {format}{moved}"))
}

fn check(a: &Check) -> Result<(), Failure> {
    if a.tolerance.is_nan() || a.tolerance < 0.0 {
        return Err(Failure::new(Stage::Arguments, "--tolerance: expected millimetres of at least 0"));
    }
    let mut units = a.units.of(&["mesh", "landmarks"])?;
    let mesh = units.read_mesh("mesh", &a.mesh)?;
    let mut set = read_set(&a.input)?;
    units.bring_landmarks("landmarks", &a.input, "mesh", &mut set)?;
    units.say();
    let positions = set.positions_on(&a.input, &mesh).map_err(Failure::loading)?;
    let check = LandmarkCheck::new(&set, &positions, &mesh, a.tolerance)
        .map_err(|e| Failure::loading(format!("{}: {e}", a.mesh.display())))?;
    if a.json {
        say(serde_json::to_string_pretty(&check).map_err(Failure::computation)?)?;
    } else {
        say(describe(&set))?;
        say(&check)?;
    }
    match check.problems() {
        0 => Ok(()),
        n => {
            let problems = if n == 1 { "problem" } else { "problems" };
            Err(Failure::loading(format!("{}: {n} {problems} with {}", a.input.display(), a.mesh.display())))
        }
    }
}

fn transfer(a: &Transfer) -> Result<(), Failure> {
    let inputs = [("landmarks", Some(&a.input)), ("mesh", Some(&a.from)), ("mesh", Some(&a.to))];
    let format = a.output.format(&[&inputs[..], &[("mesh", a.registered.as_ref())]].concat())?;
    let registered = ("registered", a.registered.is_some());
    let mut units = a.units.of_given(&[("from", true), ("to", true), registered, ("landmarks", true)])?;
    let (from, to) = (units.read_mesh("from", &a.from)?, units.read_mesh("to", &a.to)?);
    let via = a.registered.as_deref().map(|path| units.read_mesh("registered", path)).transpose()?;
    let mut set = read_set(&a.input)?;
    units.bring_landmarks("landmarks", &a.input, "from", &mut set)?;
    units.say();
    let (carried, moved) = set.transfer(&a.input, &from, via.as_ref(), &to).map_err(|e| match e {
        LandmarkError::Landmarks(e) => Failure::loading(e),
        e => Failure::loading(format!("{}: {e}", a.to.display())),
    })?;
    check_moved(a, &set, &moved, bounding_box_diagonal(&surface_points(&to.positions, to.corners.iter().copied())))?;
    let carried = a.output.on(carried, format, &to)?;
    write(&a.output, &carried, format)?;
    let farthest = moved.iter().copied().fold(0.0, f64::max);
    say(format_args!("{} -> {format}; moved to a surface by at most {farthest:.3} mm", describe(&set)))
}

/// Names landmarks that were moved far to reach a surface, as over a hole, and refuses them where most were, as by another subject. `size` is
/// that of the mesh.
fn check_moved(a: &Transfer, set: &LandmarkSet, moved: &[f64], size: f64) -> Result<(), Failure> {
    let mut far: Vec<(f64, &str)> = moved.iter().copied().zip(set.landmarks.iter().map(|l| &*l.name)).collect();
    far.sort_by(|a, b| b.0.total_cmp(&a.0));
    far.retain(|(by, _)| *by > FAR * size);
    if far.is_empty() {
        return Ok(());
    }
    let count = far.len();
    let shown: Vec<String> = far.iter().take(SHOWN).map(|(by, name)| format!("{name} by {by:.1} mm")).collect();
    let rest = if count > SHOWN { format!(" and {} more", count - SHOWN) } else { String::new() };
    let list = shown.join(", ") + &rest;
    if far.iter().filter(|(by, _)| *by > TOO_FAR * size).count() * 2 > moved.len() {
        return Err(Failure::loading(format!(
            "{}: most landmarks would move far to reach its surface: {list}; is it the mesh that was registered, and in its place?",
            a.to.display()
        )));
    }
    warn(format_args!("moved far to reach a surface, as over a hole: {list}; look at them"));
    Ok(())
}

/// Landmarks of a file that has some.
fn read_set(path: &Path) -> Result<LandmarkSet, Failure> {
    let set = landmark::read_landmark_set(path).map_err(Failure::loading)?;
    if set.landmarks.is_empty() {
        return Err(Failure::loading(format!("{}: no landmarks", path.display())));
    }
    Ok(set)
}

impl Output {
    /// The format, for an output that can be written and is none of the inputs.
    fn format(&self, inputs: &[(&str, Option<&PathBuf>)]) -> Result<LandmarkFormat, Failure> {
        check_plan(&FilePlan::new().reads_all(meshes(inputs.iter().copied())).writes("OUT", &self.output))?;
        check_file_path(&self.output)?;
        let arguments = |message| Failure::new(Stage::Arguments, message);
        let format = self.format.or_else(|| LandmarkFormat::of_path(&self.output)).ok_or_else(|| {
            arguments(format!("{}: no landmark format has this extension; give --format", self.output.display()))
        })?;
        match self.kind.filter(|kind| !format.holds(&kind.example())) {
            None => Ok(format),
            Some(kind) => Err(arguments(format!("--as {kind}: {format} holds no such places"))),
        }
    }

    /// As what landmarks have to be written, if not as they are.
    fn kind(&self, set: &LandmarkSet, format: LandmarkFormat) -> Option<PlaceKind> {
        match self.kind {
            Some(Kind::Vertex) => Some(PlaceKind::Vertex),
            Some(Kind::Face) => Some(PlaceKind::Face),
            Some(Kind::Position) => Some(PlaceKind::Position),
            None if set.landmarks.iter().all(|l| format.holds(&l.place)) => None,
            None if format == LandmarkFormat::Wrap => Some(PlaceKind::Face),
            None => Some(PlaceKind::Position),
        }
    }

    fn on(&self, set: LandmarkSet, format: LandmarkFormat, mesh: &PolygonMesh) -> Result<LandmarkSet, Failure> {
        let Some(kind) = self.kind(&set, format) else { return Ok(set) };
        let positions = set.positions_on(&self.output, mesh).map_err(Failure::loading)?;
        Ok(set.placed_as(kind, &positions, mesh).map_err(Failure::loading)?.0)
    }
}

/// Writes landmarks and says what the format leaves out.
fn write(output: &Output, set: &LandmarkSet, format: LandmarkFormat) -> Result<(), Failure> {
    landmark::write_landmark_set(&output.output, set, format).map_err(Failure::writing)?;
    let lost = |what: &str| warn(format!("{}: {format} holds no {what}", output.output.display()));
    if !set.missing.is_empty() {
        warn(format!("not placed, and left out: {}", set.missing.join(", ")));
    }
    if !format.holds_sigma() && set.landmarks.iter().any(|l| l.sigma.is_some()) {
        lost("standard deviations");
    }
    if !format.holds_names() && set.landmarks.iter().zip(0..).any(|(l, i): (_, usize)| l.name != i.to_string()) {
        lost("names; its points are numbered in their order");
    }
    if set.unit.is_none() && matches!(format, LandmarkFormat::SlicerJson | LandmarkFormat::SlicerFcsv) {
        warn("the landmarks state no unit; 3D Slicer takes them as millimetres (give --unit)");
    }
    Ok(())
}

/// Number, format, unit and space of what was read.
fn describe(set: &LandmarkSet) -> String {
    let unit = set.unit.map_or_else(|| "no unit stated".to_owned(), |unit| format!("unit {unit}"));
    let space = match set.space {
        Some(PatientSpace::Ras) => ", RAS brought to LPS",
        Some(PatientSpace::Lps) => ", LPS",
        None => "",
    };
    format!("{} landmarks, {}, {unit}{space}", set.landmarks.len(), set.format)
}
