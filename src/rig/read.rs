//! Rigs from folders, of two layouts, and from files.
//!
//! **Arrays**: `neutral.npy` (V, 3) and/or `template.obj` or `.ply`; `expression_deltas.npy` (K, V, 3) with
//! `expression_names.json`, `identity_deltas.npy` with `identity_names.json`, either of which may be absent;
//! `landmarks_multipie68.json`. Recognised by any of the arrays.
//!
//! **Meshes**: one OBJ or PLY file a shape, named after it. `neutral` is the neutral and `template` gives the polygons;
//! if only one of them is there it does both. The others are whole shapes, or differences: option, or `rig.json` with
//! `{"kind": "full"}` or `{"kind": "delta"}`.
//!
//! **Files**: `.glb` or `.gltf`, whose morph targets are the shapes, or `.npz` with the arrays under the same names.
//!
//! A folder of either layout may have `regions.json`, `{"name": [vertex, ...], ...}`.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{Family, MOTIONLESS_SHARE, Regions, Rig, RigError, RigWarning, Shape, Unlike, first_not_finite, likeness};
use crate::io::{
    Noting, NpyArray, Place, ReadError, check_side_file, extension, read_file, read_npy_points, read_polygon_mesh,
    refuse_unfinished, unpacked_name, without_mark,
};
use crate::mesh::{PolygonMesh, Vec3, bounding_box_diagonal};
use crate::text;

/// What the files of a folder of meshes hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShapeKind {
    /// Positions of the whole shape.
    #[default]
    Full,
    /// Differences to the neutral, in place of positions.
    Delta,
}

/// How to read a rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RigReadOptions {
    /// How many identity modes to read at most; the rest of the file stays unread. Default: all.
    pub identity_modes: usize,
    /// What a folder of meshes holds; default: what `rig.json` says, or else whole shapes.
    pub kind: Option<ShapeKind>,
}

impl Default for RigReadOptions {
    fn default() -> Self {
        Self { identity_modes: usize::MAX, kind: None }
    }
}

impl Rig {
    /// Reads a rig from a folder of either layout, or from a file. Shapes that move nothing are dropped and reported.
    ///
    /// # Errors
    /// When a file is missing or malformed, numbers of vertices or shapes do not fit together (the message has both), or
    /// a coordinate is not finite.
    pub fn read(path: &Path, options: &RigReadOptions) -> Result<(Self, Vec<RigWarning>), RigError> {
        if path.is_file() {
            let (mut rig, warnings) = match extension(path).as_str() {
                "glb" | "gltf" => Self::read_gltf(path)?,
                "npz" => Self::read_npz(path, options.identity_modes)?,
                found => {
                    let supported = "folders, .npz, .glb and .gltf";
                    return Err(
                        ReadError::UnknownExtension { path: path.into(), found: found.into(), supported }.into()
                    );
                }
            };
            rig.keep_identity_modes(options.identity_modes);
            return Ok((rig, warnings));
        }
        let folder = path;
        refuse_unfinished(folder)?;
        check_members(folder)?;
        let read = if is_folder_of_shapes(folder) { read_meshes } else { read_arrays };
        let (mut rig, warnings) = read(folder, options)?;
        let regions = folder.join("regions.json");
        if regions.exists() {
            rig.regions = Some(Regions::read(&regions, rig.neutral.len())?);
        }
        Ok((rig, warnings))
    }

    /// Drops all identity modes but the first `most`.
    fn keep_identity_modes(&mut self, most: usize) {
        let mut modes = 0;
        let keep = |shape: &Shape| {
            modes += usize::from(shape.family == Family::Identity);
            shape.family != Family::Identity || modes <= most
        };
        let keep: Vec<bool> = self.shapes.iter().map(keep).collect();
        self.keep_shapes(&keep);
    }
}

/// Whether a folder holds a mesh a shape, or nothing.
pub(crate) fn is_folder_of_shapes(folder: &Path) -> bool {
    let arrays = ["neutral.npy", "expression_deltas.npy", "identity_deltas.npy"];
    folder.is_dir() && !arrays.iter().any(|name| folder.join(name).exists())
}

/// Refuses a folder with pipes or devices in it among what may be read.
fn check_members(folder: &Path) -> Result<(), ReadError> {
    let fail = |source| ReadError::Io { path: folder.to_owned(), source };
    let paths = std::fs::read_dir(folder).and_then(|entries| entries.map(|e| e.map(|e| e.path())).collect());
    let mut paths: Vec<PathBuf> = paths.map_err(fail)?;
    paths.sort();
    let read = |path: &&PathBuf| ["obj", "ply", "npy", "json"].contains(&&*extension(&unpacked_name(path)));
    paths.iter().filter(read).try_for_each(|path| check_side_file(path))
}

fn read_arrays(folder: &Path, options: &RigReadOptions) -> Result<(Rig, Vec<RigWarning>), RigError> {
    let template = ["template.obj", "template.ply"].map(|name| folder.join(name)).into_iter().find(|p| p.exists());
    let mesh = template.as_deref().map(read_polygon_mesh).transpose()?;
    let neutral_path = folder.join("neutral.npy");
    let mut warnings = Vec::new();
    let neutral = match (&mesh, neutral_path.exists()) {
        (Some(mesh), false) => mesh.positions.clone(),
        _ => read_npy_points(&neutral_path)?,
    };
    if let (Some(mesh), Some(path)) = (&mesh, &template) {
        check_count(path, mesh.positions.len(), neutral.len())?;
        let far = mesh.positions.iter().zip(&neutral).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        // two roundings of one number agree to far less than this
        if far > 10.0 * MOTIONLESS_SHARE * bounding_box_diagonal(&neutral) {
            warnings.push(RigWarning::NeutralDiffers { distance: far });
        }
    }
    let read = |family, most| read_family(folder, family, most, neutral.len());
    let noting = Noting::here();
    let (expressions, identities) = rayon::join(
        || Noting::along(noting.as_ref(), || read(Family::Expression, usize::MAX)),
        || Noting::along(noting.as_ref(), || read(Family::Identity, options.identity_modes)),
    );
    let ((mut shapes, mut deltas), (modes, of_modes)) = (expressions?, identities?);
    shapes.extend(modes);
    if deltas.is_empty() {
        deltas = of_modes;
    } else {
        deltas.extend_from_slice(&of_modes);
    }
    let vertices = neutral.len();
    let (mut rig, dropped) = Rig::new(neutral, mesh, shapes, deltas)?;
    warnings.extend(dropped);
    let landmarks_path = folder.join("landmarks_multipie68.json");
    if landmarks_path.exists() {
        let landmarks: Vec<u32> = read_json(&landmarks_path, "an array of vertex indices")?;
        if let Some(v) = landmarks.iter().find(|&&v| v as usize >= vertices) {
            let expected = format!("vertex indices below {vertices}");
            return Err(ReadError::malformed(&landmarks_path, Place::File, expected, v.to_string()).into());
        }
        rig.landmarks = Some(landmarks);
    }
    Ok((rig, warnings))
}

/// The first `most` shapes of one of the two arrays and their displacements; none if there is no such array.
fn read_family(
    folder: &Path,
    family: Family,
    most: usize,
    vertices: usize,
) -> Result<(Vec<Shape>, Vec<f32>), RigError> {
    let stem = if family == Family::Identity { "identity" } else { "expression" };
    let path = folder.join(format!("{stem}_deltas.npy"));
    if !path.exists() {
        return Ok(Default::default());
    }
    let names_path = folder.join(format!("{stem}_names.json"));
    let names: Vec<String> = read_json(&names_path, "an array of names")?;
    let array = NpyArray::open(&path)?;
    array.expect_shape(&[None, None, Some(3)])?;
    let (count, found) = (array.shape()[0], array.shape()[1]);
    check_count(&path, found, vertices)?;
    if count != names.len() {
        let (array, names_file) = (path.display().to_string(), names_path.display().to_string());
        return Err(RigError::NameCount { array, found: count, names: names_file, expected: names.len() });
    }
    let deltas = array.read_f32_rows(most)?;
    if let Some(i) = first_not_finite(&deltas) {
        let what = format!("{}: shape {:?}", path.display(), names[i / (3 * vertices)]);
        return Err(RigError::NotFinite { what, vertex: i / 3 % vertices });
    }
    Ok((names.into_iter().take(most).map(|name| Shape { name, family }).collect(), deltas))
}

fn check_count(path: &Path, found: usize, expected: usize) -> Result<(), RigError> {
    if found == expected {
        return Ok(());
    }
    Err(RigError::VertexCount { what: path.display().to_string(), found, expected })
}

pub(super) fn read_json<T: serde::de::DeserializeOwned>(path: &Path, expected: &str) -> Result<T, ReadError> {
    let bytes = read_file(path)?;
    serde_json::from_slice(without_mark(&bytes))
        .map_err(|e| ReadError::json(path, Place::Line(e.line().max(1)), expected, &e))
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    kind: ShapeKind,
}

fn read_meshes(folder: &Path, options: &RigReadOptions) -> Result<(Rig, Vec<RigWarning>), RigError> {
    let rig_file = folder.join("rig.json");
    let stated = if rig_file.exists() {
        let file: RigFile = read_json(&rig_file, "{\"kind\": \"full\"} or {\"kind\": \"delta\"}")?;
        Some(file.kind)
    } else {
        None
    };
    let kind = options.kind.or(stated).unwrap_or_default();

    let mut files = files_of(folder, &["obj", "ply"])?;
    let mut take = |name: &str| files.iter().position(|(stem, _)| stem == name).map(|i| files.remove(i).1);
    let (neutral_path, template_path) = (take("neutral"), take("template"));
    let Some(base_path) = neutral_path.as_ref().or(template_path.as_ref()) else {
        let expected = "neutral.obj, template.obj (or .ply), or arrays such as neutral.npy";
        let found = if files.is_empty() { "no mesh".to_owned() } else { format!("only {} other meshes", files.len()) };
        return Err(ReadError::malformed(folder, Place::File, expected, found).into());
    };
    let base = read_polygon_mesh(base_path)?;
    let neutral = base.positions.clone();
    let mesh = match template_path.as_ref().filter(|_| neutral_path.is_some()) {
        None => base,
        Some(path) => {
            let mesh = read_polygon_mesh(path)?;
            check_count(path, mesh.positions.len(), neutral.len())?;
            PolygonMesh { positions: neutral.clone(), ..mesh }
        }
    };
    let noting = Noting::here();
    let read: Vec<Result<Vec<f32>, RigError>> =
        files.par_iter().map(|(_, path)| Noting::along(noting.as_ref(), || read_shape(path, kind, &neutral))).collect();
    let mut deltas = Vec::with_capacity(3 * neutral.len() * files.len());
    for shape in read {
        deltas.extend(shape?);
    }
    let shapes = files.into_iter().map(|(name, _)| Shape { name, family: Family::Other }).collect();
    let triangles = mesh.triangulate().triangles;
    let (rig, mut warnings) = Rig::new(neutral, Some(mesh), shapes, deltas)?;
    let odd = |(k, shape): (usize, &Shape)| odd_shape(&shape.name, rig.neutral(), &triangles, rig.deltas(k));
    // each by itself, so that the first of several faults is told
    let odd: Vec<Result<Vec<RigWarning>, RigError>> = rig.shapes().par_iter().enumerate().map(odd).collect();
    warnings.extend(odd.into_iter().collect::<Result<Vec<_>, _>>()?.concat());
    Ok((rig, warnings))
}

/// The OBJ and PLY files of a folder, packed or not, or where there are none its GLB files: each with its name without extensions, by
/// name, numbers by their value.
///
/// # Errors
/// When the folder cannot be read, or two files have one name.
pub fn mesh_files(folder: &Path) -> Result<Vec<(String, PathBuf)>, ReadError> {
    let files = files_of(folder, &["obj", "ply"])?;
    if files.is_empty() { files_of(folder, &["glb"]) } else { Ok(files) }
}

fn files_of(folder: &Path, formats: &[&str]) -> Result<Vec<(String, PathBuf)>, ReadError> {
    refuse_unfinished(folder)?;
    let fail = |source| ReadError::Io { path: folder.to_owned(), source };
    let mut files: Vec<(String, PathBuf)> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        // macOS leaves `._NAME` beside each file on other disks
        if path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b".")) {
            continue;
        }
        let unpacked = unpacked_name(&path);
        if let (true, Some(stem)) = (formats.contains(&&*extension(&unpacked)), unpacked.file_stem()) {
            files.push((stem.to_string_lossy().into_owned(), path));
        }
    }
    files.sort_by(|a, b| text::natural(&a.0, &b.0).then_with(|| a.cmp(b)));
    if let Some(((_, first), (name, second))) = files.iter().zip(files.iter().skip(1)).find(|(a, b)| a.0 == b.0) {
        let expected = format!("one file called {name:?} in its folder");
        return Err(ReadError::malformed(second, Place::File, expected, format!("{} as well", first.display())));
    }
    Ok(files)
}

/// What is odd about a shape as one of the neutral's, whose displacements are given.
///
/// # Errors
/// When it can be none: its vertices are in another order or in another unit, or fall together, or it stands beside the neutral.
fn odd_shape(
    name: &str,
    neutral: &[Vec3],
    triangles: &[[u32; 3]],
    displacements: &[f32],
) -> Result<Vec<RigWarning>, RigError> {
    let (each, _) = displacements.as_chunks::<3>();
    let moved = |(n, d): (&Vec3, &[f32; 3])| n + Vec3::from(d.map(f64::from));
    let shape: Vec<Vec3> = neutral.iter().zip(each).map(moved).collect();
    let of_shape = |why| RigError::ShapeUnlike { name: name.to_owned(), why };
    if let Some(beside) = likeness::beside(neutral, &shape) {
        return Err(of_shape(beside));
    }
    let doubts = match likeness::compare(neutral, triangles, &shape) {
        Ok(likeness) => likeness.doubts,
        // what turns by more than a right angle faces backwards
        Err(why @ Unlike::Folded { .. }) => vec![why],
        Err(why) => return Err(of_shape(why)),
    };
    match doubts.iter().find(|why| matches!(why, Unlike::Size { .. })) {
        Some(why) => Err(of_shape(*why)),
        None => Ok(doubts.into_iter().map(|why| RigWarning::ShapeUnlike { name: name.to_owned(), why }).collect()),
    }
}

fn read_shape(path: &Path, kind: ShapeKind, neutral: &[Vec3]) -> Result<Vec<f32>, RigError> {
    let positions = read_polygon_mesh(path)?.positions;
    check_count(path, positions.len(), neutral.len())?;
    let delta = |(p, n): (&Vec3, &Vec3)| {
        let d = if kind == ShapeKind::Delta { *p } else { p - n };
        [d.x as f32, d.y as f32, d.z as f32]
    };
    Ok(positions.iter().zip(neutral).flat_map(delta).collect())
}
