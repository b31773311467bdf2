//! Triangles: what distances, normals and pictures are computed on.

use std::borrow::Cow;

use rayon::prelude::*;

use super::{MeshError, Vec3, check_finite};

/// An indexed triangle mesh; without triangles, a point cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions, millimetres.
    pub positions: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The points that triangles have, [`surface_points`](super::surface_points).
    #[must_use]
    pub fn surface_points(&self) -> Cow<'_, [Vec3]> {
        super::surface_points(&self.positions, self.triangles.as_flattened().iter().copied())
    }

    /// An error unless every triangle's vertices exist.
    ///
    /// # Errors
    /// [`MeshError::IndexOutOfRange`], of the first triangle that has another one.
    pub fn check_indices(&self) -> Result<(), MeshError> {
        let count = self.positions.len();
        let outside = |t: &[u32; 3]| t.iter().copied().find(|v| *v as usize >= count);
        let first = self.triangles.par_iter().with_min_len(4096).position_first(|t| outside(t).is_some());
        match first.and_then(|triangle| Some((triangle, outside(&self.triangles[triangle])?))) {
            Some((triangle, index)) => Err(MeshError::IndexOutOfRange { triangle, index, count }),
            None => Ok(()),
        }
    }

    /// An error unless every triangle's vertices exist and every position is finite.
    ///
    /// # Errors
    /// [`MeshError::IndexOutOfRange`] or [`MeshError::NotFinite`], of the first one.
    pub fn check(&self) -> Result<(), MeshError> {
        self.check_indices()?;
        check_finite(&self.positions)
    }
}
