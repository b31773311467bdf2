//! Polygon meshes, what can be computed on them, and the files they come from. Millimetres throughout.

pub mod adjacency;
pub mod closest_point;
mod error;
pub mod geodesic;
pub mod io;
mod mirror_plane;
pub mod normals;
mod oriented_points;
mod polygon_mesh;
mod pose;
pub mod srgb;
#[cfg(test)]
pub(crate) mod testing;
mod triangle_mesh;

pub use error::MeshError;
pub use mirror_plane::MirrorPlane;
pub use oriented_points::{ClosestDisc, OrientedPoints};
pub use polygon_mesh::{ObjMetadata, ObjStatement, PolygonMesh};
pub(crate) use pose::weighted_closest_pose;
pub use pose::{Pose, PoseError, PoseKind, closest_pose};
pub use triangle_mesh::TriangleMesh;

/// A point or vector in space, millimetres.
pub type Vec3 = nalgebra::Vector3<f64>;

/// Lowest and highest corner of the axis-parallel box round `points`; `None` without points.
#[must_use]
pub fn bounding_box(points: &[Vec3]) -> Option<(Vec3, Vec3)> {
    let first = *points.first()?;
    Some(points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p))))
}

/// Length of the diagonal of the axis-parallel box round `points`, 0 without points.
#[must_use]
pub fn bounding_box_diagonal(points: &[Vec3]) -> f64 {
    bounding_box(points).map_or(0.0, |(low, high)| (high - low).norm())
}
