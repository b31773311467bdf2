//! Triangles: what distances, normals and pictures are computed on.

use super::Vec3;

/// An indexed triangle mesh; without triangles, a point cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions, millimetres.
    pub positions: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}
