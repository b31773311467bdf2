//! `nonrigid measure`.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::{open_rig, read_mask, rig_files};
use super::units::{UnitArguments, Units};
use super::{Failure, check_output, check_output_folder, check_plan, has_extension, meshes, on_threads, say, warn};
use crate::io::{FilePlan, LengthUnit, write_atomically, write_json};
use crate::measurement::{
    AFTER, HeadMotion, Landmarks, MeasurementError, NamedRegion, Plan, Subject, glossary, report,
};
use crate::mesh::{PolygonMesh, Vec3};
use crate::rig::{Companions, Regions, Rig, check_order};

/// Arguments of `nonrigid measure`.
#[derive(Debug, Args)]
#[command(
    after_help = "Landmarks are {\"name\": vertex, ...} with the names that --list prints, or the 68 numbered ones of Multi-PIE/iBUG, which\n\
    lack trichion, glabella, zygion, gonion, alare, sublabiale and pogonion. A measurement whose landmarks are not given has no value, and\n\
    says which are missing.\n\n\
    A face after is measured along the axes of the face before, carried along by the motion of the head: the rigid motion that leaves the\n\
    least sum of displacements. So it does not matter how a head is held, and where nothing moves nothing changes.\n\n\
    A group of an .obj is its polygons; of a region of vertices a triangle counts by a third for each corner in it. So parts add up.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` and the examples of `nonrigid morph` make:\n  \
    nonrigid measure --list\n  \
    nonrigid measure --mesh wrapped.obj --after morphed.obj --rig out/data/rig --csv measurements.csv --report before_after\n  \
    nonrigid measure --mesh wrapped.obj --after morphed.obj --after by_recipe.obj --rig out/data/rig --report plans"
)]
pub struct Arguments {
    /// Face (any format that `register` reads); before, where there is an after
    #[arg(long, value_name = "MESH", required_unless_present = "list")]
    mesh: Option<PathBuf>,
    /// The same vertices after (.obj, .ply or .npy N x 3), once or more: several plans stand beside each other under their files' names
    #[arg(long, value_name = "FILE")]
    after: Vec<PathBuf>,
    /// Take the motion of the head out of the face after first; else displacements and volumes are also those of that motion, which is
    /// said. Nothing else depends on it
    #[arg(long, requires = "after")]
    align: bool,
    /// Landmarks on the mesh, in any format that 'nonrigid landmarks' reads, once or more; names stand before numbers, later files before earlier ones
    /// [default: those of the rig]
    #[arg(long, value_name = "FILE", required_unless_present_any = ["list", "rig"])]
    landmarks: Vec<PathBuf>,
    /// Regions (.json): {"name": [vertex, ...], ...} [default: the groups of an .obj]
    #[arg(long, value_name = "FILE", conflicts_with = "rig")]
    regions: Option<PathBuf>,
    /// Take the regions of this rig, if it has any, and unless others are given its landmarks
    #[arg(long, value_name = "DIR|FILE")]
    rig: Option<PathBuf>,
    /// Mask of a morph (.npy, N numbers from 0 to 1), shown in red over the face in the report
    #[arg(long, value_name = "FILE", requires = "report")]
    mask: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
    /// Everything as JSON: an object, or, of several --after, a list of them, each with its name
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Everything as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Folder for a page (index.html) with front, side and three-quarter pictures, heat maps and tables, and the same as files
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    client: ClientArguments,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print every measurement with its formula and every landmark with its place
    #[arg(long, exclusive = true)]
    list: bool,
}

/// Whose face it is, for the head of a report.
#[derive(Debug, Args)]
pub(super) struct ClientArguments {
    /// The client's name, for the head of the report
    #[arg(long, value_name = "NAME", requires = "report")]
    client: Option<String>,
    /// Date for the head of the report
    #[arg(long, value_name = "DATE", requires = "report")]
    date: Option<String>,
}

impl ClientArguments {
    /// Lines for the head of a report.
    pub(super) fn about(&self) -> Vec<(String, String)> {
        let lines = [("client", &self.client), ("date", &self.date)];
        lines.into_iter().filter_map(|(name, text)| Some((name.to_owned(), text.clone()?))).collect()
    }
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    match &a.mesh {
        Some(mesh) if !a.list => on_threads(a.threads, || measure(a, mesh))?,
        _ => say(glossary().trim_end()),
    }
}

fn measure(a: &Arguments, before: &Path) -> Result<(), Failure> {
    a.json.as_deref().map_or(Ok(()), |p| check_output(p, &["json"]))?;
    a.csv.as_deref().map_or(Ok(()), |p| check_output(p, &["csv"]))?;
    a.report.as_deref().map_or(Ok(()), check_output_folder)?;
    let others = [("regions", a.regions.as_ref()), ("mask", a.mask.as_ref())];
    let plan = FilePlan::new()
        .reads_all(meshes(
            std::iter::once(("mesh", a.mesh.as_ref())).chain(a.after.iter().map(|path| ("after", Some(path)))),
        ))
        .reads_all(a.landmarks.iter().map(|path| ("landmarks", path)))
        .reads_all(a.rig.iter().flat_map(|rig| rig_files(rig)))
        .reads_all(others.into_iter().filter_map(|(role, path)| Some((role, path?))))
        .writes_all(a.json.iter().map(|path| ("--json", path)))
        .writes_all(a.csv.iter().map(|path| ("--csv", path)))
        .writes_all(a.report.iter().flat_map(|folder| report::FILES.map(|name| ("--report", folder.join(name)))));
    check_plan(&plan)?;
    let inputs = [("mesh", true), ("after", !a.after.is_empty()), ("landmarks", !a.landmarks.is_empty())];
    let mut units = a.units.of_given(&inputs)?;
    let mesh = units.read_mesh("mesh", before)?;
    let vertices = mesh.positions.len();
    let rig = a.rig.as_deref().map(|folder| -> Result<(&Path, Rig), Failure> {
        let (rig, _) = open_rig(folder, 0, None)?;
        // in another order, regions and landmarks of the rig would lie anywhere on it
        let at_rig = |e| Failure::loading(format!("{}: {e}", folder.display()));
        rig.check_subject("mesh", &mesh.positions).map_err(at_rig)?;
        Ok((folder, rig))
    });
    let rig = rig.transpose()?;
    let mut after: Vec<Vec<Vec3>> =
        a.after.iter().map(|path| read_after(path, &mesh, &mut units)).collect::<Result<_, _>>()?;
    for (path, after) in a.after.iter().zip(&after) {
        let odd = check_order(&mesh, "the first mesh", "after", after);
        odd.map_err(|e| Failure::loading(format!("{}: {e}", path.display())))?.iter().for_each(warn);
    }
    for (path, after) in a.after.iter().zip(&mut after) {
        let at_after = |e| Failure::loading(format!("{}: {e}", path.display()));
        let motion = HeadMotion::between(&mesh, after).map_err(at_after)?;
        if a.align {
            motion.undo(after);
        } else if motion.counts() {
            warn(format_args!("{}: {motion}; --align takes it out", path.display()));
        }
    }
    let unit = units.of_points("landmarks", "mesh").map_or(LengthUnit::Millimetre, |known| known.unit);
    let landmarks = match &rig {
        Some((folder, rig)) if a.landmarks.is_empty() => landmarks_of_rig(folder, rig.landmarks(), &mesh)?,
        _ => Landmarks::read(&a.landmarks, &mesh, unit).map_err(Failure::loading)?,
    };
    units.say();
    if landmarks.is_empty() {
        let message = match &rig {
            Some((folder, _)) if a.landmarks.is_empty() => {
                format!("{}: the rig has no landmarks; give --landmarks", folder.display())
            }
            _ => {
                let names: Vec<String> = a.landmarks.iter().map(|p| p.display().to_string()).collect();
                format!("{}: no landmarks", names.join(", "))
            }
        };
        return Err(Failure::loading(message));
    }
    landmarks.doubts(&mesh.positions).iter().for_each(warn);
    let mask = a.mask.as_deref().map(|path| read_mask(path, vertices)).transpose()?;
    let regions = match &a.regions {
        Some(path) => Regions::read(path, vertices).map_err(Failure::loading)?,
        None => Regions::of(rig.as_ref().map(|(_, rig)| rig), &mesh),
    };
    let regions = named_regions(&regions);

    let subject = Subject { mesh: &mesh, after: None, landmarks: &landmarks, regions: &regions };
    let names = plan_names(&a.after);
    let plans: Vec<Plan<'_>> = names.iter().zip(&after).map(|(name, positions)| Plan { name, positions }).collect();
    let measured = match &a.report {
        None => subject.compare(&plans),
        Some(folder) => {
            let line = |name: &str, path: &Path| {
                (name.to_owned(), path.file_name().unwrap_or_default().to_string_lossy().into_owned())
            };
            let mut about = a.client.about();
            about.push(line("face", before));
            about.extend(a.after.iter().map(|p| line("after", p)));
            about.extend(a.rig.as_deref().map(|p| line("rig", p)));
            about.extend(a.landmarks.iter().map(|p| line("landmarks", p)));
            about.extend(a.mask.as_deref().map(|p| line("mask", p)));
            let report = report::Report {
                about: &about,
                plans: &plans,
                mask: mask.as_deref(),
                ..report::Report::new("Measurements of a face", subject)
            };
            report::write(folder, &report)
        }
    };
    let measured = measured.map_err(failure)?;
    if let Some(path) = &a.json {
        write_json(path, &measured).map_err(Failure::writing)?;
    }
    if let Some(path) = &a.csv {
        write_atomically(path, |file| file.write_all(measured.to_csv().as_bytes())).map_err(Failure::writing)?;
    }
    say(measured.to_string().trim_end())
}

/// The landmarks of a rig at `path`, and of its folder; `numbered` are its own.
pub(super) fn landmarks_of_rig(
    path: &Path,
    numbered: Option<&[u32]>,
    mesh: &PolygonMesh,
) -> Result<Landmarks, Failure> {
    if path.is_file() && numbered.is_some() {
        warn(format_args!(
            "{}: a rig in one file has the 68 numbered landmarks alone; those by name, which are more and stand before them, are in \
             landmarks_anthropometric.json of a rig's folder: give that as --landmarks",
            path.display()
        ));
    }
    Landmarks::of_rig(&Companions::of(path).landmarks, numbered, mesh).map_err(Failure::loading)
}

/// What shapes after are called: after their files, where there are several; files of one name by their whole paths.
pub(super) fn plan_names(files: &[PathBuf]) -> Vec<String> {
    if files.len() < 2 {
        return files.iter().map(|_| AFTER.to_owned()).collect();
    }
    let stem = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = |path: &PathBuf| {
        let alone = files.iter().filter(|other| stem(other) == stem(path)).count() == 1;
        if alone { stem(path) } else { path.display().to_string() }
    };
    files.iter().map(name).collect()
}

/// Regions as measurements take them.
pub(super) fn named_regions(regions: &Regions) -> Vec<NamedRegion<'_>> {
    let named = |name| NamedRegion {
        name,
        vertices: regions.vertices(name).unwrap_or_default(),
        polygons: regions.polygons(name),
    };
    regions.names().map(named).collect()
}

pub(super) fn failure(error: MeasurementError) -> Failure {
    if error.is_writing() { Failure::writing(error) } else { Failure::loading(error) }
}

/// The vertices after; a mesh has to have the polygons of the one before.
fn read_after(path: &Path, mesh: &PolygonMesh, units: &mut Units<'_>) -> Result<Vec<Vec3>, Failure> {
    let same_count = |found: usize| {
        let expected = mesh.positions.len();
        if found == expected {
            return Ok(());
        }
        let message =
            format!("{}: {found} vertices, the mesh before has {expected}; they must correspond", path.display());
        Err(Failure::loading(message))
    };
    if has_extension(path, "npy") {
        let positions = units.read_positions("after", path)?;
        return same_count(positions.len()).map(|()| positions);
    }
    let after = units.read_mesh("after", path)?;
    same_count(after.positions.len())?;
    if (&after.starts, &after.corners) != (&mesh.starts, &mesh.corners) {
        let message =
            format!("{}: its polygons are not those of the mesh before; they must correspond", path.display());
        return Err(Failure::loading(message));
    }
    Ok(after.positions)
}
