//! Polygon meshes, what can be computed on them, and the files they come from. Millimetres throughout.

mod polygon_mesh;
mod triangle_mesh;

pub use polygon_mesh::{ObjMetadata, ObjStatement, PolygonMesh};
pub use triangle_mesh::TriangleMesh;

/// A point or vector in space, millimetres.
pub type Vec3 = nalgebra::Vector3<f64>;
