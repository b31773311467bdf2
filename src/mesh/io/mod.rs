//! Mesh, array and landmark files. Every reader answers bad input with an error that says which file, where, what was
//! expected and what was found; every writer leaves the complete file or none.

mod atomic;
mod error;
mod gltf;
mod landmarks;
mod npy;
mod npz;
mod obj;
mod ply;

use std::path::Path;

pub use atomic::write_atomically;
pub use error::{Place, ReadError, WriteError};
pub use gltf::{GltfMesh, parse_gltf, read_gltf, write_glb};
pub use landmarks::{Landmark, TemplatePoint, read_landmarks, read_template_landmarks};
pub use npy::{NpyArray, NpyItem, Npz, read_npy_mask, read_npy_points, read_npy_vector, write_npy, write_npy_points};
pub use npz::NpzContents;
pub use obj::{parse_obj, read_obj, write_obj};
pub use ply::{Ply, PlyOptions, PlyPrecision, parse_ply, read_ply, write_ply, write_ply_polygons};

use super::{PolygonMesh, TriangleMesh, Vec3};
use error::extension;

const SUPPORTED: &str = ".obj, .ply, .glb and .gltf";
const SUPPORTED_OUT: &str = ".obj, .ply and .glb";

/// A scanned surface or point cloud, millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scan {
    /// Positions and triangles (polygons are cut into fans); no triangles for a point cloud.
    pub mesh: TriangleMesh,
    /// A normal per vertex as the file gives it: not normalised, zero where unknown.
    pub normals: Option<Vec<Vec3>>,
    /// Red, green, blue per vertex.
    pub colors: Option<Vec<[u8; 3]>>,
}

/// Reads a polygon mesh by extension: `.obj`, `.ply`, `.glb` or `.gltf` (without its morph targets). There is at least one vertex, coordinates are finite, and faces
/// index vertices.
///
/// # Errors
/// When the file cannot be read or is malformed, or for another extension.
pub fn read_polygon_mesh(path: &Path) -> Result<PolygonMesh, ReadError> {
    match extension(path).as_str() {
        "obj" => read_obj(path),
        "ply" => Ok(read_ply(path)?.mesh),
        "glb" | "gltf" => Ok(read_gltf(path)?.mesh),
        found => Err(ReadError::UnknownExtension { path: path.into(), found: found.into(), supported: SUPPORTED }),
    }
}

/// Reads a scan by extension, as [`read_polygon_mesh`]. There is at least one vertex, coordinates are finite, and triangles index
/// vertices; other flaws of real scans (unreferenced vertices, zero-area and duplicate triangles) are left as they are.
///
/// # Errors
/// As [`read_polygon_mesh`].
pub fn read_scan(path: &Path) -> Result<Scan, ReadError> {
    if extension(path) == "ply" {
        let Ply { mesh, normals, colors } = read_ply(path)?;
        return Ok(Scan { mesh: mesh.into_triangles(), normals, colors });
    }
    Ok(Scan { mesh: read_polygon_mesh(path)?.into_triangles(), normals: None, colors: None })
}

/// Writes a polygon mesh by extension: `.obj` (everything), `.glb` (everything, positions as 32 bits) or `.ply` (positions, as 64
/// bits, and polygons).
///
/// # Errors
/// When the file cannot be written, or for another extension.
pub fn write_polygon_mesh(path: &Path, mesh: &PolygonMesh) -> Result<(), WriteError> {
    match extension(path).as_str() {
        "obj" => write_obj(path, mesh),
        "ply" => {
            let options = PlyOptions { precision: PlyPrecision::Double, ..PlyOptions::default() };
            write_ply_polygons(path, mesh, options)
        }
        "glb" => write_glb(path, mesh, &[], &[], &serde_json::Map::new()),
        found => Err(WriteError::UnknownExtension { path: path.into(), found: found.into(), supported: SUPPORTED_OUT }),
    }
}
