//! How good a registered mesh is: against a known truth, and against the scan alone.
//!
//! [`TruthErrors`] needs the true position of every vertex, [`LandmarkErrors`] that of a few points, [`SurfaceDistances`] only distances
//! between the two surfaces, [`MeshQuality`] (self-intersections, edge stretch) and [`flipped_triangles`] only the mesh before and after;
//! [`ApertureErrors`] says how far lids and lips are open against the truth. Surface distance alone misleads: a mesh can lie on the scan
//! to 0.1 mm and slide along it by 10 mm.

mod apertures;
mod deformation;
mod landmark_errors;
mod percentile;
mod scan_distance;
mod self_intersections;
mod surface_distances;
mod truth_errors;

pub use apertures::ApertureErrors;
pub use deformation::{EdgeStretch, MeshQuality, RestEdges, RestNormals, flipped_triangles};
pub use landmark_errors::{LandmarkError, LandmarkErrors};
pub use percentile::percentile;
pub use scan_distance::ScanDistance;
pub use self_intersections::self_intersections;
pub use surface_distances::{DistanceSummary, SurfaceDistances};
pub use truth_errors::{TruthErrors, VertexErrors};

/// Why an evaluation was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EvaluationError {
    /// No vertex is observed.
    #[error("no vertex is observed, so there is nothing to measure")]
    NothingObserved,
    /// The truth is not known everywhere.
    #[error("the truth is not finite at vertex {vertex}")]
    NotFinite {
        /// The first such vertex.
        vertex: usize,
    },
    /// Two arrays that describe the same vertices differ in length.
    #[error("{what} has {found} vertices where {expected} were expected; both must have the template's vertex order")]
    VertexCount {
        /// Which array is wrong.
        what: &'static str,
        /// Length expected.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} refers to vertex {vertex}, but there are {vertices} vertices")]
    VertexIndex {
        /// Index of the triangle.
        triangle: usize,
        /// The index it holds.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
}

fn check_count(what: &'static str, expected: usize, found: usize) -> Result<(), EvaluationError> {
    if expected == found { Ok(()) } else { Err(EvaluationError::VertexCount { what, expected, found }) }
}

fn check_triangles(triangles: &[[u32; 3]], vertices: usize) -> Result<(), EvaluationError> {
    for (triangle, t) in triangles.iter().enumerate() {
        if let Some(&vertex) = t.iter().find(|v| **v as usize >= vertices) {
            return Err(EvaluationError::VertexIndex { triangle, vertex, vertices });
        }
    }
    Ok(())
}
