//! What makes a face impossible to measure.

use std::path::PathBuf;

use crate::io::{ReadError, WriteError};
use crate::mesh::{MeshError, PoseError};

/// Why nothing was measured, or not written.
#[derive(Debug, thiserror::Error)]
pub enum MeasurementError {
    /// A name that is no landmark.
    #[error("there is no landmark {name:?}; known are {known}, and the 68 numbered ones (0 to 67)")]
    UnknownLandmark {
        /// The name.
        name: String,
        /// Those there are.
        known: String,
    },
    /// One place under two names.
    #[error("{0:?} and {1:?} are names of one landmark; give one of them")]
    SameLandmark(String, String),
    /// Numbered landmarks, but not Multi-PIE's.
    #[error("found {found} of the numbered landmarks 0 to 67; numbers mean something only if all 68 are there")]
    Numbered {
        /// How many there are.
        found: usize,
    },
    /// Left and right are exchanged.
    #[error(
        "{0} is mirrored, or its left and right landmarks are exchanged: left, up and front make no face; mirror it back, or exchange \
         the names"
    )]
    Mirrored(&'static str),
    /// A landmark, region or triangle names a vertex that does not exist.
    #[error("{what} has vertex {vertex}, expected one below {vertices}")]
    NoSuchVertex {
        /// Landmark or region.
        what: String,
        /// The vertex.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A region names a polygon that does not exist.
    #[error("region {region:?} has polygon {polygon}, expected one below {polygons}")]
    NoSuchPolygon {
        /// The region.
        region: String,
        /// The polygon.
        polygon: u32,
        /// Number of polygons.
        polygons: usize,
    },
    /// Before and after have nothing in common that says how the head has moved.
    #[error("how the head has moved from before to after is not known: {0}")]
    Motion(#[from] PoseError),
    /// Numbers per vertex of another mesh.
    #[error("{what} has {found} vertices, the mesh has {expected}; they must correspond")]
    VertexCount {
        /// What has them.
        what: &'static str,
        /// How many it has.
        found: usize,
        /// Vertices of the mesh.
        expected: usize,
    },
    /// A weight is not from 0 to 1.
    #[error("{what}: {value} at vertex {vertex}, expected a number from 0 to 1")]
    Weight {
        /// What has it.
        what: &'static str,
        /// Index of the vertex.
        vertex: usize,
        /// Its weight.
        value: f64,
    },
    /// A coordinate is not finite, or a triangle indexes past the vertices.
    #[error("{what}: {source}")]
    Mesh {
        /// Before or after.
        what: &'static str,
        /// What is wrong with it.
        source: MeshError,
    },
    /// There is no surface.
    #[error("{0} has no faces, or none with an area: there is no surface to measure")]
    NoSurface(&'static str),
    /// Every measurement lacks a landmark.
    #[error("nothing can be measured: of the landmarks that the measurements need, only {given} are given")]
    NothingMeasured {
        /// Landmarks that are given.
        given: String,
    },
    /// A file could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// What a file says cannot be used.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<MeasurementError>,
    },
    /// A picture could not be made into a file.
    #[error("cannot encode a picture as PNG: {0}")]
    Picture(#[from] image::ImageError),
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl MeasurementError {
    /// Whether writing failed, rather than what was given being wrong.
    #[must_use]
    pub fn is_writing(&self) -> bool {
        matches!(self, Self::Write(_) | Self::Picture(_))
    }
}
