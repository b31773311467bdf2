//! Polygon meshes and what can be computed on them. Millimetres throughout.

use std::borrow::Cow;

use rayon::prelude::*;

pub mod adjacency;
mod ambient_occlusion;
pub mod closest_point;
mod error;
pub mod geodesic;
mod inner_layer;
mod mirror_plane;
mod noise;
pub mod normals;
mod oriented_points;
mod polygon_mesh;
mod pose;
pub mod rows;
mod seam;
mod spikes;
pub mod srgb;
mod subdivide;
pub mod surface_lattice;
#[cfg(test)]
pub(crate) mod testing;
mod triangle_mesh;

pub use ambient_occlusion::hidden_vertices;
pub use error::MeshError;
pub(crate) use inner_layer::shape_gradients;
pub use inner_layer::{InnerLayer, determinant};
pub use mirror_plane::MirrorPlane;
pub use noise::noise;
pub use oriented_points::{ClosestDisc, OrientedPoints};
pub use polygon_mesh::{ObjMetadata, ObjStatement, PolygonMesh};
pub(crate) use pose::weighted_closest_pose;
pub use pose::{Pose, PoseError, PoseKind, closest_pose};
pub use seam::sewn;
pub(crate) use seam::{first_at_place, sewn_unless_opened};
pub use spikes::spikes;
pub use subdivide::Subdivision;
pub use triangle_mesh::TriangleMesh;

/// A point or vector in space, millimetres.
pub type Vec3 = nalgebra::Vector3<f64>;

/// What points at one place have in common, bit for bit; the two zeros are one.
pub(crate) fn place(p: &Vec3) -> [u64; 3] {
    p.map(|x| (x + 0.0).to_bits()).into()
}

/// An error unless every position is finite.
///
/// # Errors
/// [`MeshError::NotFinite`], of the first that is not.
pub fn check_finite(positions: &[Vec3]) -> Result<(), MeshError> {
    match positions.par_iter().with_min_len(4096).position_first(|p| !p.iter().all(|c| c.is_finite())) {
        Some(vertex) => Err(MeshError::NotFinite { vertex, position: positions[vertex].into() }),
        None => Ok(()),
    }
}

/// Which of `count` vertices are corners of something; all of them where nothing has corners, as in a cloud.
#[must_use]
pub fn referenced(count: usize, corners: impl IntoIterator<Item = u32>) -> Vec<bool> {
    let mut referenced = vec![false; count];
    let mut any = false;
    for corner in corners {
        any = true;
        referenced.get_mut(corner as usize).into_iter().for_each(|r| *r = true);
    }
    if any { referenced } else { vec![true; count] }
}

/// The points that are [`referenced`]: what has a size, a place and a unit. Files hold others too, such as all pixels of a depth
/// frame.
#[must_use]
pub fn surface_points(points: &[Vec3], corners: impl IntoIterator<Item = u32>) -> Cow<'_, [Vec3]> {
    let referenced = referenced(points.len(), corners);
    if referenced.iter().all(|r| *r) {
        return Cow::Borrowed(points);
    }
    Cow::Owned(points.iter().zip(referenced).filter_map(|(p, r)| r.then_some(*p)).collect())
}

/// Root mean square distance of `points` from their centroid, 0 without points.
#[must_use]
pub fn rms_size(points: &[Vec3]) -> f64 {
    let count = points.len().max(1) as f64;
    let centre = points.iter().sum::<Vec3>() / count;
    (points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / count).sqrt()
}

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
