//! Reading what commands are given.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use clap::Args;

use super::units::Units;
use super::{Failure, Stage, file_name, has_extension, same_place, tell, warn};
use crate::io::{self, Inputs};
use crate::landmark::{self, Landmark, LandmarkSet, OffTemplate, PatientSpace};
use crate::mesh::{PolygonMesh, PoseKind, TriangleMesh, Vec3, bounding_box_diagonal, surface_points};
use crate::registration::ScanFlip;
use crate::rig::{
    IDENTITY_MODES, Regions, Rig, RigReadOptions, RigWarning, ShapeBasis, ShapeKind, ShapeSelection,
    is_folder_of_shapes, mesh_files,
};

/// What errors and reports call landmarks, and the file that says what their names mean.
pub const LANDMARKS: &str = "landmarks";
pub const TEMPLATE_LANDMARKS: &str = "template landmarks";

/// The pairs of `--landmarks` and `--template-landmarks`. Points without a unit have that of `mesh`, an input that is known; those on a
/// scan's surface need the scan.
pub fn read_landmarks(
    [scan_landmarks, template_landmarks]: [Option<&Path>; 2],
    inputs: &Inputs,
    units: &mut Units<'_>,
    template: &PolygonMesh,
    (mesh, scan): (&str, Option<&TriangleMesh>),
) -> Result<Vec<Landmark>, Failure> {
    let Some(path) = scan_landmarks else { return Ok(Vec::new()) };
    let mut set = inputs.reading(LANDMARKS, || landmark::read_scan_landmark_set(path)).map_err(Failure::loading)?;
    units.bring_landmarks("landmarks", path, mesh, &mut set)?;
    if set.space == Some(PatientSpace::Ras) {
        tell("landmarks: RAS brought to LPS, the space of 3D Slicer's meshes");
    }
    scan.map_or(Ok(()), |scan| check_span(path, &set, scan))?;
    let mut names = None;
    if let Some(path) = template_landmarks {
        let set = inputs.reading(TEMPLATE_LANDMARKS, || landmark::read_landmark_set(path));
        let mut set = set.map_err(Failure::loading)?;
        units.bring_landmarks("template-landmarks", path, "template", &mut set)?;
        let points = set.on_template(path, template).map_err(Failure::loading)?;
        OffTemplate::of(path, &set, &points, template).map_err(Failure::loading)?.doubt().iter().for_each(warn);
        names = Some((set, path));
    }
    let names = names.as_ref().map(|(set, path)| (set, *path));
    landmark::pair_landmarks((set, path), names, template, scan).map_err(Failure::loading)
}

/// Landmarks that span many times what their mesh does, or next to nothing of it, are in another unit.
fn check_span(path: &Path, set: &LandmarkSet, scan: &TriangleMesh) -> Result<(), Failure> {
    let points: Vec<Vec3> = set.positions().map(|(_, p)| p).collect();
    let surface = match &scan.triangles[..] {
        [] => Cow::Borrowed(&scan.positions[..]),
        triangles => surface_points(&scan.positions, triangles.as_flattened().iter().copied()),
    };
    let [span, whole] = [&points[..], &surface].map(bounding_box_diagonal);
    if points.len() < 3 || (whole / 2000.0..=200.0 * whole).contains(&span) {
        return Ok(());
    }
    let message = format!("{}: the landmarks span {span:.4} mm, their mesh {whole:.1} mm", path.display());
    let unit = if span < whole { "m" } else { "mm" };
    Err(Failure::loading(format!("{message}: state their unit, such as --unit landmarks={unit}")))
}

/// The rig and which of its shapes to use.
#[derive(Debug, Args)]
pub struct RigArguments {
    /// Blendshape rig: a folder of .npy deltas with names, a folder of .obj/.ply shapes, .npz, .glb or .gltf
    #[arg(long, value_name = "DIR")]
    pub rig: Option<PathBuf>,
    /// Expression shapes to use, by name [default: all]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', requires = "rig", value_parser = trimmed)]
    pub shapes: Option<Vec<String>>,
    /// Identity modes to use, from the first [default: 60 or as many as there are for an unknown subject, none beside its own neutral, such as the mesh of a morph]
    #[arg(long, value_name = "K", requires = "rig")]
    pub identity_modes: Option<usize>,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum, requires = "rig")]
    pub shape_kind: Option<ShapeKindArgument>,
}

/// What a file of a rig folder holds.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum ShapeKindArgument {
    /// Whole shapes
    Full,
    /// Differences to the neutral
    Delta,
}

impl RigArguments {
    /// Reads the rig: that needs nothing of other inputs, so that those can be read meanwhile.
    pub fn open(&self, own_neutral: bool) -> Result<Option<OpenRig>, Failure> {
        let most = if own_neutral { 0 } else { IDENTITY_MODES };
        let open = |folder| open_rig(folder, self.identity_modes.unwrap_or(most), self.shape_kind);
        self.rig.as_deref().map(open).transpose()
    }

    /// Takes out of the rig the shapes that are asked for, and as many identity modes as are usual if the subject's own neutral is known
    /// or is not; with the rig's regions, if it has any. `subject`, what they are to deform, has the rig's vertices.
    pub fn choose(
        &self,
        open: Option<OpenRig>,
        units: &mut Units<'_>,
        own_neutral: bool,
        (what, subject): (&'static str, &[Vec3]),
    ) -> Result<(ShapeBasis, Option<Regions>), Failure> {
        let (Some(folder), Some(open)) = (&self.rig, open) else { return Ok((ShapeBasis::none(), None)) };
        let rig = bring_rig(folder, open, units)?;
        let names = self.shapes.as_deref();
        let identity_modes = self.identity_modes.unwrap_or_else(|| rig.usual_identity_modes(names, own_neutral));
        let selection = ShapeSelection { names, identity_modes };
        let selected = rig.select_for(selection, what, subject);
        let (shapes, odd) = selected.map_err(|e| Failure::loading(format!("{}: {e}", folder.display())))?;
        odd.iter().for_each(warn);
        Ok((shapes, rig.regions().cloned()))
    }
}

/// Refuses a mesh in a folder that is read as a rig of shapes: it would be one of them the next time.
pub fn refuse_as_shape(rig: Option<&Path>, folder: &Path, what: &str) -> Result<(), Failure> {
    match rig.filter(|rig| same_place(rig, folder) && is_folder_of_shapes(rig)) {
        None => Ok(()),
        Some(rig) => {
            let message = format!("{what}: a mesh in {} would become a shape of the rig", rig.display());
            Err(Failure::new(Stage::Arguments, format!("{message}; give another folder")))
        }
    }
}

/// Where on the template the scan counts.
#[derive(Debug, Args)]
pub struct MaskArguments {
    /// Weight of what the scan says at each template vertex (.npy, N numbers from 0 to 1) [default: 1 everywhere]
    #[arg(long, value_name = "FILE")]
    pub mask: Option<PathBuf>,
    /// How free each template vertex is (.npy, N numbers from 0 to 1): 1 follows smoothness alone, as bags of eyes and mouth
    /// should [default: 0 everywhere]
    #[arg(long, value_name = "FILE")]
    pub free_mask: Option<PathBuf>,
    /// Look at the scan only in these regions of the rig (regions.json) or, without any, groups of the template
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', value_parser = trimmed)]
    pub regions: Vec<String>,
    /// Regions or groups that follow smoothness alone
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', value_parser = trimmed)]
    pub free_regions: Vec<String>,
}

impl MaskArguments {
    /// The mask and the free mask: files and regions together, where regions of the rig come before groups of the template.
    pub fn read(
        &self,
        inputs: &Inputs,
        template: &PolygonMesh,
        regions: &Regions,
    ) -> Result<[Option<Vec<f64>>; 2], Failure> {
        let vertices = template.positions.len();
        let region_mask = |option: &str, names: &[String]| -> Result<Option<Vec<f64>>, Failure> {
            let mask = (!names.is_empty()).then(|| regions.mask(names)).transpose();
            mask.map_err(|e| Failure::loading(format!("{option}: {e}")))
        };
        let read = |role: &str, path: &Option<PathBuf>| {
            path.as_deref().map(|p| inputs.reading(role, || read_mask(p, vertices))).transpose()
        };
        Ok([
            combined(read("mask", &self.mask)?, region_mask("--regions", &self.regions)?, |a, b| a * b),
            combined(read("free mask", &self.free_mask)?, region_mask("--free-regions", &self.free_regions)?, f64::max),
        ])
    }
}

fn combined(a: Option<Vec<f64>>, b: Option<Vec<f64>>, with: impl Fn(f64, f64) -> f64) -> Option<Vec<f64>> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.into_iter().zip(b).map(|(a, b)| with(a, b)).collect()),
        (a, b) => a.or(b),
    }
}

/// Whether a scan is turned over.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum FlipArgument {
    /// Where it fits the template better so
    Auto,
    /// Always
    Yes,
    /// Never
    No,
}

impl FlipArgument {
    /// The same for the library.
    pub fn flip(self) -> ScanFlip {
        match self {
            Self::Auto => ScanFlip::Auto,
            Self::Yes => ScanFlip::Yes,
            Self::No => ScanFlip::No,
        }
    }
}

/// The image beside a mesh file that paints it, if it names one.
pub fn texture_of(path: &Path) -> Option<String> {
    let is_image = |file: &&PathBuf| *file != path && !["mtl", "bin"].iter().any(|ending| has_extension(file, ending));
    io::files_of_painted_mesh(path).iter().find(is_image).map(|image| file_name(image))
}

/// Numbers from 0 to 1, one per vertex.
pub fn read_mask(path: &Path, vertices: usize) -> Result<Vec<f64>, Failure> {
    let mask = io::read_npy_vector(path, Some(vertices)).map_err(Failure::loading)?;
    match mask.iter().position(|m| !(0.0..=1.0).contains(m)) {
        None => Ok(mask),
        Some(v) => {
            let message = format!("{}: expected numbers from 0 to 1, found {} at vertex {v}", path.display(), mask[v]);
            Err(Failure::loading(message))
        }
    }
}

/// Every file that a rig could be read from. What cannot be read is named itself: reading it says what is wrong.
pub fn rig_files(rig: &Path) -> Vec<(&'static str, PathBuf)> {
    if !rig.is_dir() {
        return io::files_of_mesh(rig).into_iter().map(|p| ("rig", p)).collect();
    }
    let inside: std::io::Result<Vec<PathBuf>> =
        std::fs::read_dir(rig).and_then(|entries| entries.map(|e| e.map(|e| e.path())).collect());
    let Ok(mut inside) = inside else { return vec![("rig", rig.to_owned())] };
    inside.retain(|p| !p.is_dir());
    inside.sort();
    inside.into_iter().map(|p| ("rig", p)).collect()
}

/// A rig as its files have it, and what to warn of.
pub type OpenRig = (Rig, Vec<RigWarning>);

/// The rig that a command is about.
#[derive(Debug, Args)]
pub struct RigInput {
    /// The rig: a folder of .npy deltas with names, a folder of .obj/.ply shapes, .npz, .glb or .gltf
    #[arg(long = "rig", value_name = "DIR|FILE")]
    pub path: PathBuf,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum)]
    shape_kind: Option<ShapeKindArgument>,
}

impl RigInput {
    /// Reads it and so many of its identity modes, and prints its warnings.
    pub fn read(&self, modes: usize, units: &mut Units<'_>) -> Result<Rig, Failure> {
        read_rig(&self.path, modes, self.shape_kind, units)
    }
}

/// Reads a rig and prints its warnings.
pub fn read_rig(
    folder: &Path,
    modes: usize,
    kind: Option<ShapeKindArgument>,
    units: &mut Units<'_>,
) -> Result<Rig, Failure> {
    bring_rig(folder, open_rig(folder, modes, kind)?, units)
}

pub fn open_rig(folder: &Path, modes: usize, kind: Option<ShapeKindArgument>) -> Result<OpenRig, Failure> {
    if kind.is_some() && folder.exists() && !is_folder_of_shapes(folder) {
        warn(format_args!("--shape-kind has no effect: {} is no folder of .obj or .ply shapes", folder.display()));
    }
    let kind = kind.map(|k| match k {
        ShapeKindArgument::Full => ShapeKind::Full,
        ShapeKindArgument::Delta => ShapeKind::Delta,
    });
    Rig::read(folder, &RigReadOptions { identity_modes: modes, kind }).map_err(Failure::loading)
}

fn bring_rig(folder: &Path, (mut rig, warnings): OpenRig, units: &mut Units<'_>) -> Result<Rig, Failure> {
    warnings.iter().for_each(warn);
    units.bring_rig(folder, &mut rig)?;
    Ok(rig)
}

/// The meshes of a folder of frames, each with its name.
pub fn frames(folder: &Path) -> Result<Vec<(String, PathBuf)>, Failure> {
    let files = mesh_files(folder).map_err(Failure::loading)?;
    if files.is_empty() {
        return Err(Failure::loading(format!("{}: found no .obj, .ply or .glb", folder.display())));
    }
    Ok(files)
}

/// A name of a list, which may have spaces after its commas.
pub fn trimmed(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("a name is missing; is there a comma too many?".to_owned()),
        name => Ok(name.to_owned()),
    }
}

/// Two numbers between which a weight may lie.
pub fn bounds(text: &str) -> Result<[f64; 2], String> {
    let pair = text.split_once(',').and_then(|(a, b)| Some([a.trim().parse().ok()?, b.trim().parse().ok()?]));
    let Some([lower, upper]) = pair else {
        return Err("give two numbers with a comma between them, such as 0,1".to_owned());
    };
    // Written so that NaN fails.
    if lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY {
        return Ok([lower, upper]);
    }
    Err(format!("no weight lies between {lower} and {upper}"))
}

/// What is taken out of meshes, or fitted besides their shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Align {
    /// Rotation and translation; size stays one of the ways in which meshes differ
    Rigid,
    /// Rotation, translation and size
    Similarity,
    /// Nothing: the meshes are aligned already
    None,
}

impl Align {
    /// The same for the library.
    pub fn pose(self) -> Option<PoseKind> {
        match self {
            Self::Rigid => Some(PoseKind::Rigid),
            Self::Similarity => Some(PoseKind::Similarity),
            Self::None => None,
        }
    }
}
