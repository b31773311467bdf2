//! Mesh and array files. Every reader answers bad input with an error that says which file, where, what was
//! expected and what was found; every writer leaves the complete file or none.

#[cfg_attr(not(feature = "pictures"), allow(dead_code))] // morphs use all of it
pub(crate) mod arrays;
mod atomic;
mod error;
mod folder;
mod gltf;
mod gzip;
mod inputs;
mod made;
mod material;
mod material_files;
mod npy;
mod npz;
mod obj;
mod off;
mod pc2;
mod plan;
mod ply;
mod stl;
mod unit;
mod usda;
mod xyz;

use std::path::{Path, PathBuf};

pub use atomic::{sync_files, write_atomically, write_durably, write_json};
pub use error::{Place, ReadError, WriteError, read_side_file, read_text};
pub(crate) use error::{check_side_file, excerpt, extension, read_file, without_mark};
#[cfg(feature = "cli")]
pub(crate) use folder::replace;
pub use folder::{refuse_unfinished, write_folder};
pub use gltf::{GltfMesh, Motion, parse_gltf, read_gltf, write_animated_glb, write_glb};
pub(crate) use gzip::unpacked_name;
pub use inputs::{Input, Inputs, Noting, absolute, sha256, sha256_of_file};
pub use made::{is_made, marked_png};
pub use material::{ImageFile, Material, Paint, Wrap, write_image_materials};
pub use material_files::{Copied, MaterialFiles};
pub use npy::{NpyArray, NpyItem, read_npy_mask, read_npy_points, read_npy_vector, write_npy, write_npy_points};
pub use npz::{Npz, NpzContents};
pub use obj::{parse_obj, write_obj};
pub use off::parse_off;
pub use pc2::write_pc2;
pub use plan::{FilePlan, PlanError, check_files};
pub use ply::{PlyOptions, PlyPrecision, parse_ply, write_ply, write_ply_polygons};
pub use stl::parse_stl;
pub use unit::{BODY_EXTENT, FACE_EXTENT, FaceUnit, KnownUnit, LengthUnit, UnitSource, face_extent};
pub use usda::{Clip, write_usda};
pub use xyz::parse_xyz;

use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};

/// The largest coordinate of a file, in its unit: beyond, squares of areas leave the range of numbers before anything else does.
pub const LARGEST_COORDINATE: f64 = 1e12;

/// Refuses coordinates that are not finite, or beyond [`LARGEST_COORDINATE`]; `path` is named in the error.
///
/// # Errors
/// With the first such vertex.
pub fn check_coordinates(path: &Path, points: &[Vec3]) -> Result<(), ReadError> {
    match points.iter().position(|p| !p.iter().all(|x| x.abs() <= LARGEST_COORDINATE)) {
        None => Ok(()),
        Some(v) => {
            let found = format!("{:?} at vertex {v}", points[v].as_slice());
            let expected = format!("coordinates up to {LARGEST_COORDINATE:e}");
            Err(ReadError::malformed(path, Place::File, expected, found))
        }
    }
}

const READ: &str = ".glb, .gltf, and .obj, .ply, .stl, .off and .xyz, these also packed, as .obj.gz";
const WRITTEN: &str = ".obj, .ply, .glb and .usda";

/// What a mesh file holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshFile {
    /// Vertices and polygons, in the file's unit; no polygons for a point cloud.
    pub mesh: PolygonMesh,
    /// A normal per vertex as in the file, not normalised; zero where the file has none that is finite.
    pub normals: Option<Vec<Vec3>>,
    /// Red, green, blue per vertex, 0-255, sRGB.
    pub colors: Option<Vec<[u8; 3]>>,
}

/// A scanned surface or point cloud, millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scan {
    /// Positions and triangles (polygons are cut into fans); no triangles for a point cloud.
    pub mesh: TriangleMesh,
    /// A normal per vertex as the file gives it: not normalised, zero where unknown.
    pub normals: Option<Vec<Vec3>>,
    /// Red, green, blue per vertex, 0-255, sRGB.
    pub colors: Option<Vec<[u8; 3]>>,
}

/// Reads a mesh file by extension: `.obj`, `.ply`, `.stl`, `.off` or `.xyz`, packed if `.gz` follows, `.glb` or `.gltf` (without its
/// morph targets). There is at least one vertex, coordinates are finite, and faces index vertices.
///
/// # Errors
/// When the file cannot be read or is malformed, or for another extension.
pub fn read_mesh_file(path: &Path) -> Result<MeshFile, ReadError> {
    if matches!(extension(path).as_str(), "glb" | "gltf") {
        let GltfMesh { mesh, colors, .. } = read_gltf(path)?;
        check_coordinates(path, &mesh.positions)?;
        return Ok(MeshFile { colors, ..mesh.into() });
    }
    let parse: fn(&[u8], &Path) -> Result<MeshFile, ReadError> = match gzip::inner_extension(path).as_str() {
        "obj" => obj::parse_obj_file,
        "ply" => parse_ply,
        "stl" => |bytes, path| parse_stl(bytes, path).map(MeshFile::from),
        "off" => parse_off,
        "xyz" => parse_xyz,
        inner => {
            let found = if gzip::is_packed(path) { format!("{inner}.gz") } else { inner.to_owned() };
            return Err(ReadError::UnknownExtension { path: path.into(), found, supported: READ });
        }
    };
    let file = parse(&gzip::read_unpacked(path)?, path)?;
    check_coordinates(path, &file.mesh.positions)?;
    Ok(file)
}

/// Every file that reading a mesh opens: itself and, of glTF, the buffers beside it. What cannot be read yet, or is a pipe, is named
/// alone; reading it says what is wrong.
#[must_use]
pub fn files_of_mesh(path: &Path) -> Vec<PathBuf> {
    let mut files = vec![path.to_owned()];
    if matches!(extension(path).as_str(), "glb" | "gltf") && path.is_file() {
        files.extend(std::fs::read(path).map(|bytes| gltf::files_beside(&bytes, path, false)).unwrap_or_default());
    }
    files
}

/// Every file that [`read_painted_scan`] opens: those of [`files_of_mesh`], material libraries and images.
#[must_use]
pub fn files_of_painted_mesh(path: &Path) -> Vec<PathBuf> {
    let mut files = vec![path.to_owned()];
    if !path.is_file() {
        return files;
    }
    if matches!(extension(path).as_str(), "glb" | "gltf") {
        files.extend(std::fs::read(path).map(|bytes| gltf::files_beside(&bytes, path, true)).unwrap_or_default());
        return files;
    }
    match gzip::inner_extension(path).as_str() {
        "obj" => files.extend(material::files_of_paint(path, &libraries_named_in(path))),
        "ply" => {
            let images = ply::texture_files(&gzip::read_unpacked(path).unwrap_or_default());
            files.extend(images.iter().map(|(_, name)| material::named_beside(path, name)));
        }
        _ => {}
    }
    files
}

/// What the `mtllib` statements of an OBJ file name; nothing if it cannot be read.
fn libraries_named_in(path: &Path) -> Vec<String> {
    let bytes = gzip::read_unpacked(path).unwrap_or_default();
    let lines = bytes.split(|b| *b == b'\n').filter_map(|line| line.trim_ascii().strip_prefix(b"mtllib"));
    lines.map(|name| String::from_utf8_lossy(name.trim_ascii()).into_owned()).collect()
}

impl From<PolygonMesh> for MeshFile {
    fn from(mesh: PolygonMesh) -> Self {
        Self { mesh, normals: None, colors: None }
    }
}

/// Reads a polygon mesh by extension.
///
/// # Errors
/// As [`read_mesh_file`].
pub fn read_polygon_mesh(path: &Path) -> Result<PolygonMesh, ReadError> {
    Ok(read_mesh_file(path)?.mesh)
}

/// Colours as bytes, of numbers from 0 to 1 or, where most that are not 0 are above 1, from 0 to 255: lights that are brighter than white
/// do not make the rest black.
fn color_bytes<T: Copy + Into<f64>>(colors: &[[T; 3]]) -> Vec<[u8; 3]> {
    let values = || colors.as_flattened().iter().map(|&c| c.into());
    let (above, below) = (values().filter(|c| *c > 1.0).count(), values().filter(|c| *c > 0.0 && *c <= 1.0).count());
    let whole = if above > below { 1.0 } else { 255.0 };
    colors.iter().map(|c| c.map(|c| (c.into() * whole).round() as u8)).collect() // `as` saturates, NaN gives 0
}

/// Reads a scan by extension. Flaws of real scans (unreferenced vertices, zero-area and duplicate triangles) are left as they
/// are.
///
/// # Errors
/// As [`read_mesh_file`].
pub fn read_scan(path: &Path) -> Result<Scan, ReadError> {
    let MeshFile { mesh, normals, colors } = read_mesh_file(path)?;
    Ok(Scan { mesh: mesh.into_triangles(), normals, colors })
}

/// [`read_scan`] with what its triangles are painted with, if the file says so: the materials of OBJ and glTF, the `TextureFile` of PLY.
///
/// # Errors
/// As [`read_mesh_file`], and when a material library or an image of a material that is used cannot be read.
pub fn read_painted_scan(path: &Path) -> Result<(Scan, Option<Paint>), ReadError> {
    if matches!(extension(path).as_str(), "glb" | "gltf") {
        let (GltfMesh { mesh, colors, .. }, paint) = gltf::parse_painted_gltf(&read_file(path)?, path)?;
        check_coordinates(path, &mesh.positions)?;
        return Ok((Scan { mesh: mesh.into_triangles(), normals: None, colors }, Some(paint)));
    }
    if gzip::inner_extension(path) == "ply" {
        let bytes = gzip::read_unpacked(path)?; // once: it may be a pipe
        let MeshFile { mesh, normals, colors } = parse_ply(&bytes, path)?;
        check_coordinates(path, &mesh.positions)?;
        let paint = material::paint_of_ply(path, &ply::texture_files(&bytes), &mesh)?;
        return Ok((Scan { mesh: mesh.into_triangles(), normals, colors }, paint));
    }
    let MeshFile { mesh, normals, colors } = read_mesh_file(path)?;
    let paint = material::paint_of_obj(path, &mesh)?;
    Ok((Scan { mesh: mesh.into_triangles(), normals, colors }, paint))
}

/// Writes a polygon mesh by extension: `.obj` (everything), `.glb` (everything, positions as 32 bits) or `.ply` (positions, as 64
/// bits, and polygons).
///
/// # Errors
/// When the file cannot be written, or for another extension.
pub fn write_polygon_mesh(path: &Path, mesh: &PolygonMesh) -> Result<(), WriteError> {
    write_colored_mesh(path, mesh, None)
}

/// [`write_polygon_mesh`] with red, green, blue per vertex, 0-255 in sRGB: `red`, `green`, `blue` in `.ply`; after the coordinates in
/// `.obj`, from 0 to 1; as light ([`srgb`](crate::mesh::srgb)), which the format asks for, in `COLOR_0` of `.glb`.
///
/// # Errors
/// As [`write_polygon_mesh`], and when the colours are not one per vertex.
pub fn write_colored_mesh(path: &Path, mesh: &PolygonMesh, colors: Option<&[[u8; 3]]>) -> Result<(), WriteError> {
    match extension(path).as_str() {
        "obj" => obj::write_colored_obj(path, mesh, colors),
        "ply" => write_ply_polygons(path, mesh, PlyOptions { colors, precision: PlyPrecision::Double, normals: None }),
        "glb" => write_look(path, mesh, gltf::Look { colors, ..gltf::Look::default() }),
        "usda" => {
            let frames = std::slice::from_ref(&mesh.positions);
            write_usda(path, mesh, colors, &Clip { frames, frames_per_second: 1.0, lost: &[] }, None)
        }
        found => Err(WriteError::UnknownExtension { path: path.into(), found: found.into(), supported: WRITTEN }),
    }
}

/// Writes a mesh as `.glb` with a texture, a PNG file, which it holds.
///
/// # Errors
/// As [`write_glb`].
pub fn write_textured_glb(path: &Path, mesh: &PolygonMesh, png: &[u8]) -> Result<(), WriteError> {
    write_look(path, mesh, gltf::Look { png: Some(png), ..gltf::Look::default() })
}

/// Writes a mesh as `.usda`, whose materials show a texture: an image of this name in the same folder.
///
/// # Errors
/// As [`write_usda`].
pub fn write_textured_usda(path: &Path, mesh: &PolygonMesh, image: &str) -> Result<(), WriteError> {
    let frames = std::slice::from_ref(&mesh.positions);
    write_usda(path, mesh, None, &Clip { frames, frames_per_second: 1.0, lost: &[] }, Some(image))
}

fn write_look(path: &Path, mesh: &PolygonMesh, look: gltf::Look<'_>) -> Result<(), WriteError> {
    gltf::write_painted_glb(path, mesh, look, &[], &[], &serde_json::Map::new())
}
