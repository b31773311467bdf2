//! What a morph did to a mesh.

use serde::Serialize;

use super::MorphError;
use crate::evaluation::{EdgeStretch, EvaluationError, flipped_triangles};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::{PolygonMesh, Vec3};

/// How far a morph went, how smooth it is, and what it did to edges and triangles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MorphChange {
    /// Longest displacement of a vertex, millimetres.
    pub reached: f64,
    /// Largest difference of the displacements of an edge's ends, millimetres: how smooth the morph is.
    pub largest_jump: f64,
    /// Triangles whose normal turned by more than 90 degrees.
    pub folded: usize,
    /// How much the edges were stretched.
    pub stretch: EdgeStretch,
}

impl MorphChange {
    /// From a mesh to other positions of its vertices.
    ///
    /// # Errors
    /// When the mesh is malformed or the numbers of vertices differ.
    pub fn of(mesh: &PolygonMesh, moved: &[Vec3]) -> Result<Self, MorphError> {
        let unjudged = |e: EvaluationError| MorphError::Evaluation(e.to_string());
        let rest = &mesh.positions;
        let stretch = EdgeStretch::new(mesh, moved).map_err(unjudged)?;
        let displacement: Vec<Vec3> = moved.iter().zip(rest).map(|(m, r)| m - r).collect();
        let edges = EdgeGraph::from_polygons(mesh);
        let jumps = edges.edges().iter().map(|e| (displacement[e[0] as usize] - displacement[e[1] as usize]).norm());
        Ok(Self {
            reached: displacement.iter().map(Vec3::norm).fold(0.0, f64::max),
            largest_jump: jumps.fold(0.0, f64::max),
            folded: flipped_triangles(rest, moved, &mesh.triangulate().triangles).map_err(unjudged)?,
            stretch,
        })
    }
}
