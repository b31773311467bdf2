//! What a deformation did to the mesh itself: stretched edges and flipped triangles.

use serde::Serialize;

use super::percentile::of_sorted;
use super::truth_errors::face_normal;
use super::{EvaluationError, check_count, check_triangles};
use crate::mesh::{PolygonMesh, Vec3};

/// Ratio of edge lengths after to before, over the distinct polygon edges. All 1 without edges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EdgeStretch {
    /// Edges compared; edges of zero or non-finite length before, or non-finite after, are not.
    pub edges: usize,
    /// Smallest ratio.
    pub min: f64,
    /// 5th percentile.
    pub p5: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest ratio.
    pub max: f64,
}

impl EdgeStretch {
    /// Compares the template's edges with those at `deformed`, in the template's vertex order.
    ///
    /// # Errors
    /// When `deformed` has another number of vertices than the template, or a polygon names a vertex that does not exist.
    pub fn new(template: &PolygonMesh, deformed: &[Vec3]) -> Result<Self, EvaluationError> {
        let rest = &template.positions;
        check_count("the deformed mesh", rest.len(), deformed.len())?;
        let mut edges = Vec::with_capacity(template.corners.len());
        for (f, range) in template.starts.windows(2).enumerate() {
            let q = template.corners.get(range[0] as usize..range[1] as usize).unwrap_or(&[]);
            for (i, &a) in q.iter().enumerate() {
                if a as usize >= rest.len() {
                    return Err(EvaluationError::VertexIndex { triangle: f, vertex: a, vertices: rest.len() });
                }
                let b = q[(i + 1) % q.len()];
                edges.push([a.min(b), a.max(b)]);
            }
        }
        edges.sort_unstable();
        edges.dedup();
        let length = |p: &[Vec3], e: &[u32; 2]| (p[e[0] as usize] - p[e[1] as usize]).norm();
        let mut ratios: Vec<f64> =
            edges.iter().map(|e| length(deformed, e) / length(rest, e)).filter(|r| r.is_finite()).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        let at = |percent| of_sorted(&ratios, percent).unwrap_or(1.0);
        Ok(Self { edges: ratios.len(), min: at(0.0), p5: at(5.0), median: at(50.0), p95: at(95.0), max: at(100.0) })
    }
}

/// Number of triangles whose normal turned by more than 90 degrees between `reference` and `deformed`. A rigid motion must
/// be taken out first; degenerate triangles do not count.
///
/// # Errors
/// When the lengths differ or a triangle names a vertex that does not exist.
pub fn flipped_triangles(
    reference: &[Vec3],
    deformed: &[Vec3],
    triangles: &[[u32; 3]],
) -> Result<usize, EvaluationError> {
    check_count("the deformed mesh", reference.len(), deformed.len())?;
    check_triangles(triangles, reference.len())?;
    Ok(triangles.iter().filter(|t| face_normal(reference, t).dot(&face_normal(deformed, t)) < 0.0).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretch_and_flips_of_a_square() {
        let positions = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec();
        let template =
            PolygonMesh { positions, starts: vec![0, 4], corners: vec![0, 1, 2, 3], ..PolygonMesh::default() };
        let wide: Vec<Vec3> = template.positions.iter().map(|p| Vec3::new(3.0 * p.x, p.y, 0.0)).collect();
        let s = EdgeStretch::new(&template, &wide).unwrap();
        assert_eq!((s.edges, s.min, s.median, s.max), (4, 1.0, 2.0, 3.0));
        let triangles = template.triangulate().triangles;
        assert_eq!(flipped_triangles(&template.positions, &wide, &triangles), Ok(0));
        let mirrored: Vec<Vec3> = wide.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
        assert_eq!(flipped_triangles(&template.positions, &mirrored, &triangles), Ok(2));
        assert!(EdgeStretch::new(&template, &wide[1..]).is_err());
        let broken = PolygonMesh { starts: vec![0, 4], corners: vec![0, 1, 9, 3], ..template };
        assert!(EdgeStretch::new(&broken, &wide).is_err());
        assert_eq!(EdgeStretch::new(&PolygonMesh::default(), &[]).unwrap().max, 1.0);
    }
}
