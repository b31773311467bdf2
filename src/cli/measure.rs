//! `nonrigid measure`.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::read_mask;
use super::units::{UnitArguments, Units};
use super::{Failure, check_output, check_output_folder, check_plan, meshes, on_threads, say};
use crate::measurement::{Landmarks, MeasurementError, NamedRegion, Subject, glossary, report};
use crate::mesh::io::{FilePlan, LengthUnit, write_atomically};
use crate::mesh::{PolygonMesh, PoseKind, Vec3, closest_pose};
use crate::rig::Regions;

/// Arguments of `nonrigid measure`.
#[derive(Debug, Args)]
#[command(
    after_help = "Landmarks are {\"name\": vertex, ...} with the names that --list prints, or the 68 numbered ones of Multi-PIE/iBUG, which have\n\
    neither trichion nor glabella. A measurement whose landmarks are not given has no value, and says which are missing.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` and the examples of `nonrigid morph` make:\n  \
    nonrigid measure --list\n  \
    nonrigid measure --mesh wrapped.obj --after morphed.obj --rig out/data/rig \\\n      \
    --landmarks out/data/rig/landmarks_multipie68.json \\\n      \
    --landmarks out/data/rig/landmarks_anthropometric.json --csv measurements.csv --report before_after"
)]
pub struct Arguments {
    /// Face (any format that `register` reads); before, where there is an after
    #[arg(long, value_name = "MESH", required_unless_present = "list")]
    mesh: Option<PathBuf>,
    /// The same vertices after (.obj, .ply or .npy N x 3)
    #[arg(long, value_name = "FILE")]
    after: Option<PathBuf>,
    /// Move the face after onto the one before first, by the rigid motion that fits all vertices best; else displacements and
    /// volumes are also those of the head's motion
    #[arg(long, requires = "after")]
    align: bool,
    /// Landmarks on the mesh, in any format that 'nonrigid landmarks' reads, once or more; names stand before numbers, later files before earlier ones
    #[arg(long, value_name = "FILE", required_unless_present = "list")]
    landmarks: Vec<PathBuf>,
    /// Regions (.json): {"name": [vertex, ...], ...} [default: the groups of an .obj]
    #[arg(long, value_name = "FILE", conflicts_with = "rig")]
    regions: Option<PathBuf>,
    /// Take the regions of this rig, its regions.json
    #[arg(long, value_name = "DIR")]
    rig: Option<PathBuf>,
    /// Mask of a morph (.npy, N numbers from 0 to 1), shown in red over the face in the report
    #[arg(long, value_name = "FILE", requires = "report")]
    mask: Option<PathBuf>,
    #[command(flatten)]
    units: UnitArguments,
    /// Everything as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Everything as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Folder for a page (index.html) with front, side and three-quarter pictures, heat maps and tables, and the same as files
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print every measurement with its formula and every landmark with its place
    #[arg(long, exclusive = true)]
    list: bool,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    match &a.mesh {
        Some(mesh) if !a.list => on_threads(a.threads.map(usize::from), || measure(a, mesh))?,
        _ => say(glossary().trim_end()),
    }
}

fn measure(a: &Arguments, before: &Path) -> Result<(), Failure> {
    a.json.as_deref().map_or(Ok(()), |p| check_output(p, &["json"]))?;
    a.csv.as_deref().map_or(Ok(()), |p| check_output(p, &["csv"]))?;
    a.report.as_deref().map_or(Ok(()), check_output_folder)?;
    let regions_path = a.regions.clone().or_else(|| a.rig.as_ref().map(|folder| folder.join("regions.json")));
    let others = [("regions", regions_path.as_ref()), ("mask", a.mask.as_ref())];
    let plan = FilePlan::new()
        .reads_all(meshes([("mesh", a.mesh.as_ref()), ("after", a.after.as_ref())]))
        .reads_all(a.landmarks.iter().map(|path| ("landmarks", path)))
        .reads_all(others.into_iter().filter_map(|(role, path)| Some((role, path?))))
        .writes_all(a.json.iter().map(|path| ("--json", path)))
        .writes_all(a.csv.iter().map(|path| ("--csv", path)))
        .writes_all(a.report.iter().flat_map(|folder| report::FILES.map(|name| ("--report", folder.join(name)))));
    check_plan(&plan)?;
    let mut units = a.units.of(&["mesh", "after", "landmarks"])?;
    let mesh = units.read_mesh("mesh", before)?;
    let vertices = mesh.positions.len();
    let mut after = a.after.as_deref().map(|path| read_after(path, &mesh, &mut units)).transpose()?;
    if let Some(after) = after.as_mut().filter(|_| a.align) {
        let pairs: Vec<(Vec3, Vec3)> = after.iter().copied().zip(mesh.positions.iter().copied()).collect();
        let pose = closest_pose(&pairs, PoseKind::Rigid).map_err(|e| Failure::computation(format!("--align: {e}")))?;
        after.iter_mut().for_each(|p| *p = pose.apply(*p));
    }
    let unit = units.of_points("landmarks", "mesh").map_or(LengthUnit::Millimetre, |known| known.unit);
    let landmarks = Landmarks::read(&a.landmarks, &mesh, unit).map_err(Failure::loading)?;
    units.say();
    if landmarks.is_empty() {
        let names: Vec<String> = a.landmarks.iter().map(|p| p.display().to_string()).collect();
        return Err(Failure::loading(format!("{}: no landmarks", names.join(", "))));
    }
    let mask = a.mask.as_deref().map(|path| read_mask(path, vertices)).transpose()?;
    let regions = match regions_path {
        Some(path) => Regions::read(&path, vertices).map_err(Failure::loading)?,
        None => Regions::of_groups(&mesh),
    };
    let regions = named_regions(&regions);

    let subject = Subject { mesh: &mesh, after: after.as_deref(), landmarks: &landmarks, regions: &regions };
    let measured = match &a.report {
        None => subject.measure(),
        Some(folder) => {
            let line = |name: &str, path: &Path| {
                (name.to_owned(), path.file_name().unwrap_or_default().to_string_lossy().into_owned())
            };
            let mut about = vec![line("face", before)];
            about.extend(a.after.as_deref().map(|p| line("after", p)));
            about.extend(a.landmarks.iter().map(|p| line("landmarks", p)));
            about.extend(a.mask.as_deref().map(|p| line("mask", p)));
            let report = report::Report {
                about: &about,
                mask: mask.as_deref(),
                ..report::Report::new("Measurements of a face", subject)
            };
            report::write(folder, &report)
        }
    };
    let measured = measured.map_err(failure)?;
    if let Some(path) = &a.json {
        report::write_json(path, &measured).map_err(Failure::writing)?;
    }
    if let Some(path) = &a.csv {
        write_atomically(path, |file| file.write_all(measured.to_csv().as_bytes())).map_err(Failure::writing)?;
    }
    say(measured.to_string().trim_end())
}

/// Regions as measurements take them.
pub(super) fn named_regions(regions: &Regions) -> Vec<NamedRegion<'_>> {
    let named = |name| NamedRegion { name, vertices: regions.vertices(name).unwrap_or_default() };
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
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
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
