//! Seams: where two sheets of the template touch without being joined, as closed lips do.
//!
//! Closest points alone leave a gap between closed lips: their rims roll out of the scanner's sight, and each lip follows its
//! own visible side. But a scan of closed lips has surface *across* the gap, and a scan of open lips has none: at the middle
//! of a gap of width `g` the scan is nearer than `g / 2`, the distance of the lips themselves, only if the lips are closed.

use super::ScanSurface;
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::{ClosestVertex, ClosestVertices};
use crate::mesh::geodesic::{WeightedGraph, distances};
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// How much farther along the surface than through space two vertices of a seam lie.
const DETOUR: f64 = 8.0;

/// The scan spans a gap when it is nearer to the gap's middle than this share of its width.
const SPANNED: f64 = 0.3;

/// Pairs of vertices that touch across a seam of the rest shape.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seams {
    /// Both vertices and their distance in the rest shape.
    pairs: Vec<(u32, u32, f64)>,
}

impl Seams {
    /// For every vertex the nearest vertex within `width` that lies at least eight times as far along the surface.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn find(rest: &TriangleMesh, width: f64) -> Result<Self, MeshError> {
        if width <= 0.0 {
            return Ok(Self::default());
        }
        let graph = WeightedGraph::euclidean(&EdgeGraph::of(rest), &rest.positions)?;
        let tree = ClosestVertices::new(&rest.positions)?;
        let mut near: Vec<ClosestVertex> = Vec::new();
        let mut pairs = Vec::new();
        for (i, p) in rest.positions.iter().enumerate() {
            tree.k_nearest(p, NEIGHBOURS, &mut near);
            near.retain(|c| c.squared_distance <= width * width && c.vertex as usize != i);
            if near.is_empty() {
                continue;
            }
            let along = distances(&graph, &[i as u32], DETOUR * width);
            let across = near.iter().find(|c| along[c.vertex as usize].is_infinite());
            pairs.extend(across.map(|c| (i as u32, c.vertex, c.squared_distance.sqrt())));
        }
        Ok(Self { pairs })
    }

    /// Writes for every vertex the place that closes its seam to the width it has at rest, with weight one, where the scan
    /// spans it; weight zero elsewhere. Gaps wider than `widest` are left alone.
    pub fn targets(
        &self,
        scan: &ScanSurface,
        positions: &[Vec3],
        widest: f64,
        targets: &mut Vec<Vec3>,
        weights: &mut Vec<f64>,
    ) {
        targets.clear();
        targets.resize(positions.len(), Vec3::zeros());
        weights.clear();
        weights.resize(positions.len(), 0.0);
        for &(i, j, rest_gap) in &self.pairs {
            let (a, b) = (positions[i as usize], positions[j as usize]);
            let gap = (a - b).norm();
            let reach = SPANNED * gap;
            if gap <= rest_gap || gap > widest {
                continue;
            }
            if let Some(point) = scan.closest_within((a + b) / 2.0, reach) {
                targets[i as usize] = point + (a - b) * (rest_gap / 2.0 / gap);
                weights[i as usize] = 1.0;
            }
        }
    }
}

/// Vertices looked at on the other side of a seam.
const NEIGHBOURS: usize = 16;
