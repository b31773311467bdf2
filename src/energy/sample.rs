//! Where data terms act: a vertex, or a fixed convex combination of up to three vertices.

use thiserror::Error;

use crate::mesh::Vec3;
use crate::mesh::rows::Rows;

/// Why a sample could not be added.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SampleError {
    /// A corner names a vertex that does not exist.
    #[error("sample refers to vertex {vertex}, but the template has {count} vertices (0 to {})", count.saturating_sub(1))]
    VertexOutOfRange {
        /// The vertex asked for.
        vertex: usize,
        /// Number of vertices.
        count: usize,
    },
    /// The weights are no convex combination.
    #[error("sample weights {0:?} must be finite, not negative, and sum to 1")]
    NotConvex(Vec<f64>),
}

/// The fixed set of points on the template whose positions data terms see.
///
/// The set decides the sparsity of the normal equations, so it is fixed before the first linearisation; correspondences
/// come and go without touching it.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    vertex_count: usize,
    corners: Rows<(u32, f64)>,
}

impl Samples {
    /// One sample per vertex, in vertex order.
    #[must_use]
    pub fn vertices(vertex_count: usize) -> Self {
        Self { vertex_count, corners: (0..vertex_count as u32).map(|v| [(v, 1.0)]).collect() }
    }

    /// Adds the convex combination `corners` of (vertex, weight) and returns the sample's index. Corners of weight zero
    /// are dropped.
    pub fn push(&mut self, corners: &[(u32, f64)]) -> Result<usize, SampleError> {
        if let Some(&(vertex, _)) = corners.iter().find(|c| c.0 as usize >= self.vertex_count) {
            return Err(SampleError::VertexOutOfRange { vertex: vertex as usize, count: self.vertex_count });
        }
        let sum: f64 = corners.iter().map(|c| c.1).sum();
        let convex = corners.iter().all(|c| c.1 >= 0.0) && (sum - 1.0).abs() < 1e-6;
        if !convex {
            return Err(SampleError::NotConvex(corners.iter().map(|c| c.1).collect()));
        }
        self.corners.push(corners.iter().copied().filter(|c| c.1 > 0.0));
        Ok(self.len() - 1)
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of vertices of the template.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// The (vertex, weight) corners of sample `s`.
    #[must_use]
    pub fn corners(&self, s: usize) -> &[(u32, f64)] {
        self.corners.row(s)
    }

    /// Position of sample `s` for the given vertex positions.
    #[must_use]
    pub fn position(&self, s: usize, vertices: &[Vec3]) -> Vec3 {
        match self.corners(s) {
            [(v, _)] => vertices[*v as usize],
            corners => corners.iter().map(|&(v, w)| vertices[v as usize] * w).sum(),
        }
    }

    /// Writes the positions of all samples to `out`.
    pub fn positions(&self, vertices: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend((0..self.len()).map(|s| self.position(s, vertices)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_past_the_vertices_is_named() {
        let mut samples = Samples::vertices(4);
        let error = samples.push(&[(1, 0.5), (4, 0.5)]).unwrap_err();
        assert_eq!(error, SampleError::VertexOutOfRange { vertex: 4, count: 4 });
        assert_eq!(error.to_string(), "sample refers to vertex 4, but the template has 4 vertices (0 to 3)");
        // Also at weight zero: the caller means another template.
        assert!(samples.push(&[(1, 1.0), (9, 0.0)]).is_err());
        assert_eq!(samples, Samples::vertices(4));
    }

    #[test]
    fn weights_that_are_no_convex_combination_are_quoted() {
        let mut samples = Samples::vertices(4);
        for weights in [[0.5, 0.4], [1.5, -0.5], [f64::INFINITY, 0.0], [0.0, 0.0], [0.5, 0.500_002]] {
            let error = samples.push(&[(0, weights[0]), (1, weights[1])]).unwrap_err();
            assert_eq!(error, SampleError::NotConvex(weights.to_vec()));
        }
        let error = samples.push(&[(0, f64::NAN), (1, 1.0)]).unwrap_err();
        assert_eq!(error.to_string(), "sample weights [NaN, 1.0] must be finite, not negative, and sum to 1");
        assert_eq!(samples.push(&[]), Err(SampleError::NotConvex(Vec::new())));
        assert_eq!(samples, Samples::vertices(4));
    }

    #[test]
    fn samples_lie_where_their_corners_put_them() {
        let mut samples = Samples::vertices(3);
        assert_eq!(samples.push(&[(0, 0.25), (1, 0.75), (2, 0.0)]), Ok(3));
        assert_eq!(samples.corners(3), [(0, 0.25), (1, 0.75)]);
        assert_eq!((samples.len(), samples.is_empty()), (4, false));
        let vertices = [Vec3::zeros(), Vec3::new(4.0, 8.0, 0.0), Vec3::z()];
        let mut positions = vec![Vec3::x(); 9];
        samples.positions(&vertices, &mut positions);
        assert_eq!(positions, [vertices[0], vertices[1], vertices[2], Vec3::new(3.0, 6.0, 0.0)]);
    }
}
