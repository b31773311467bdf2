//! glTF 2.0: meshes with morph targets from `.glb` and `.gltf`, to `.glb`. Source: Khronos Group, "glTF 2.0
//! Specification", ISO/IEC 12113:2022.
//!
//! glTF is in metres with v of texture coordinates downwards, we are in millimetres with v upwards: both are converted on
//! the way in and out. Its numbers have 32 bits; a face that is written and read moves by less than 1e-4 mm.
//!
//! A vertex of glTF has one texture coordinate and there are triangles only. Vertex `i` of ours is vertex `i` of the
//! written file; copies for further texture coordinates follow. Materials are by name, a primitive for each run of
//! polygons. `extras.nonrigid` of the mesh says which vertices they are copies of, how many corners each polygon has
//! (its fan of triangles is in order), and the statements of the OBJ file, so that reading gives the same polygons,
//! texture indices and groups back:
//!
//! ```json
//! "extras": { "targetNames": ["jawOpen"], "nonrigid": { "vertices": 4, "copies": [2, 0], "uvs": [0, 1, 2, 4, 3, -1],
//!             "polygons": [[4, 1], [3, 2]], "statements": [[0, "g", "skin"]], "materialLibraries": [] } }
//! ```
//!
//! (`uvs`: the texture coordinate of each vertex of the file, -1 for none; `polygons`: corners, how many such polygons.)
//!
//! Files of others have no such note. There, vertices of one mesh with the same position and the same displacements in
//! every morph target are one vertex, in the order of the file, because a surface that is cut along its texture's seams
//! cannot be deformed as one. Transforms of nodes are applied; all meshes of the scene become one, and morph targets of the
//! same name one target. A skinned mesh comes in its bind pose; lines, materials' content (but what paints), animations and cameras are left
//! out.
//!
//! The JSON is read with `serde_json`, which is here anyway, into the few fields that a mesh needs: the `gltf` crate brings
//! no check of accessors against their buffers, which is most of the work of reading files that are not trusted.

mod accessor;
mod budget;
mod document;
mod paint;
mod read;
mod topology;
mod write;

use serde_json::{Map, Value};

use crate::mesh::PolygonMesh;

pub(super) use document::files_beside;
pub(super) use read::parse_painted_gltf;
pub use read::{parse_gltf, read_gltf};
pub(super) use write::{Look, write_painted_glb};
pub use write::{Motion, write_animated_glb, write_glb};

const MILLIMETRES_PER_METRE: f64 = 1000.0;

/// What is read from a glTF file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GltfMesh {
    /// Positions in millimetres, polygons, texture coordinates.
    pub mesh: PolygonMesh,
    /// Red, green, blue per vertex, 0-255, sRGB, of `COLOR_0`; white where a part has none.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Names of the morph targets: `extras.targetNames`, or `target000` and so on.
    pub target_names: Vec<String>,
    /// Displacements target by target, vertex by vertex, x y z: millimetres.
    pub target_deltas: Vec<f32>,
    /// What [`write_glb`] was given besides; empty in files of others.
    pub extras: Map<String, Value>,
}
