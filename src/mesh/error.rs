//! What makes a mesh unusable for a computation.

/// A mesh, or numbers given for it, cannot be computed on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has coordinates {position:?}, expected finite ones")]
    NotFinite {
        /// Index of the vertex.
        vertex: usize,
        /// Its coordinates.
        position: [f64; 3],
    },
    /// A face indexes past the vertices.
    #[error("triangle {triangle} has vertex index {index}, expected one below {count}")]
    IndexOutOfRange {
        /// Index of the triangle.
        triangle: usize,
        /// The offending vertex index.
        index: u32,
        /// Number of vertices.
        count: usize,
    },
    /// An edge length is negative or NaN.
    #[error("edge {edge} has length {length}, expected one of at least 0")]
    EdgeLength {
        /// Index of the edge.
        edge: usize,
        /// The offending length.
        length: f64,
    },
    /// A lattice is too fine for the surface.
    #[error("the surface goes through too many cells of {spacing}; choose a larger spacing")]
    TooManyCells {
        /// Side of a cell.
        spacing: f64,
    },
    /// No triangle has an area.
    #[error("no triangle has an area: the corners of each lie on a line")]
    NoArea,
    /// No two triangles have an edge in common.
    #[error("its triangles share no vertices: merge those that stand at one place")]
    Unconnected,
    /// Lengths do not belong to the edges.
    #[error("found {found} edge lengths, expected {expected}")]
    EdgeLengthCount {
        /// Number of lengths.
        found: usize,
        /// Number of edges.
        expected: usize,
    },
}
