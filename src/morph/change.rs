//! What a morph did to a mesh.

use serde::Serialize;

use super::MorphError;
use crate::evaluation::{EdgeStretch, EvaluationError, RestEdges, RestNormals};
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

/// Longest edge, as a multiple of its length before, that is no tear.
pub(super) const TORN: f64 = 2.0;

impl MorphChange {
    /// Whether the surface folds or tears: a triangle turned over, or an edge is drawn to more than twice its length.
    #[must_use]
    pub fn tears(&self) -> bool {
        self.folded > 0 || self.stretch.max > TORN
    }

    /// From a mesh to other positions of its vertices.
    ///
    /// # Errors
    /// When the mesh is malformed or the numbers of vertices differ.
    pub fn of(mesh: &PolygonMesh, moved: &[Vec3]) -> Result<Self, MorphError> {
        Unmoved::new(mesh)?.change(moved)
    }
}

/// A mesh that is morphed again and again: what all comparisons with it have in common.
#[derive(Debug, Clone)]
pub(super) struct Unmoved {
    pub positions: Vec<Vec3>,
    edges: RestEdges,
    normals: RestNormals,
}

impl Unmoved {
    pub fn new(mesh: &PolygonMesh) -> Result<Self, MorphError> {
        let edges = RestEdges::new(mesh).map_err(unjudged)?;
        let normals = RestNormals::new(&mesh.positions, mesh.triangulate().triangles).map_err(unjudged)?;
        Ok(Self { positions: mesh.positions.clone(), edges, normals })
    }

    /// What became of it at other positions of its vertices.
    pub fn change(&self, moved: &[Vec3]) -> Result<MorphChange, MorphError> {
        let stretch = self.edges.stretch(moved).map_err(unjudged)?;
        let displacement: Vec<Vec3> = moved.iter().zip(&self.positions).map(|(m, r)| m - r).collect();
        let jump = |e: &[u32; 2]| (displacement[e[0] as usize] - displacement[e[1] as usize]).norm();
        Ok(MorphChange {
            reached: displacement.iter().map(Vec3::norm).fold(0.0, f64::max),
            largest_jump: self.edges.edges().iter().map(jump).fold(0.0, f64::max),
            folded: self.normals.flipped(moved).map_err(unjudged)?,
            stretch,
        })
    }
}

fn unjudged(e: EvaluationError) -> MorphError {
    MorphError::Evaluation(e.to_string())
}
