//! What a deformation did to the mesh itself: stretched edges, flipped triangles, triangles through triangles.

use serde::{Deserialize, Serialize};

use super::percentile::of_sorted;
use super::truth_errors::face_normal;
use super::{EvaluationError, check_count, check_triangles, self_intersections};
use crate::mesh::{PolygonMesh, Vec3};

/// Ratio of edge lengths after to before, over the distinct polygon edges. All 1 without edges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EdgeStretch {
    /// Edges compared; edges of zero or non-finite length before, or non-finite after, are not.
    pub edges: usize,
    /// Smallest ratio.
    pub min: f64,
    /// 1st percentile.
    pub p1: f64,
    /// 5th percentile.
    pub p5: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest ratio.
    pub max: f64,
}

impl EdgeStretch {
    /// Compares the template's edges with those at `deformed`, in the template's vertex order.
    ///
    /// # Errors
    /// When `deformed` has another number of vertices than the template, or a polygon names a vertex that does not exist.
    pub fn new(template: &PolygonMesh, deformed: &[Vec3]) -> Result<Self, EvaluationError> {
        RestEdges::new(template)?.stretch(deformed)
    }
}

/// The distinct edges of a mesh and their lengths, to be compared with those of several deformed ones.
#[derive(Debug, Clone)]
pub struct RestEdges {
    vertices: usize,
    edges: Vec<[u32; 2]>,
    lengths: Vec<f64>,
}

impl RestEdges {
    /// The edges of the template's polygons.
    ///
    /// # Errors
    /// When a polygon names a vertex that does not exist.
    pub fn new(template: &PolygonMesh) -> Result<Self, EvaluationError> {
        let rest = &template.positions;
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
        let lengths = edges.iter().map(|e| length(rest, e)).collect();
        Ok(Self { vertices: rest.len(), edges, lengths })
    }

    /// Each edge once, the lower vertex first, ascending.
    #[must_use]
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// How much they are stretched at `deformed`.
    ///
    /// # Errors
    /// When `deformed` has another number of vertices.
    pub fn stretch(&self, deformed: &[Vec3]) -> Result<EdgeStretch, EvaluationError> {
        check_count("the deformed mesh", self.vertices, deformed.len())?;
        let ratios = self.edges.iter().zip(&self.lengths).map(|(e, rest)| length(deformed, e) / rest);
        let mut ratios: Vec<f64> = ratios.filter(|r| r.is_finite()).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        let at = |percent| of_sorted(&ratios, percent).unwrap_or(1.0);
        Ok(EdgeStretch {
            edges: ratios.len(),
            min: at(0.0),
            p1: at(1.0),
            p5: at(5.0),
            median: at(50.0),
            p95: at(95.0),
            p99: at(99.0),
            max: at(100.0),
        })
    }
}

fn length(positions: &[Vec3], e: &[u32; 2]) -> f64 {
    (positions[e[0] as usize] - positions[e[1] as usize]).norm()
}

/// How sound a deformed mesh is, whatever it was deformed to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeshQuality {
    /// Pairs of triangles that pass through each other, as [`self_intersections`] counts them.
    pub self_intersections: usize,
    /// The same before the deformation: faces may have some by design, at lips and eyelids.
    pub self_intersections_at_rest: usize,
    /// Edge lengths over those before the deformation.
    pub stretch: EdgeStretch,
}

impl MeshQuality {
    /// Compares the template with itself at `deformed`, in the template's vertex order. Polygons are triangulated as
    /// [`PolygonMesh::triangulate`] does.
    ///
    /// # Errors
    /// When `deformed` has another number of vertices than the template, or a polygon names a vertex that does not exist.
    pub fn new(template: &PolygonMesh, deformed: &[Vec3]) -> Result<Self, EvaluationError> {
        let triangles = template.triangulate().triangles;
        let count = |positions| self_intersections(positions, &triangles).map(|pairs| pairs.len());
        let (now, at_rest) = rayon::join(|| count(deformed), || count(&template.positions));
        Self::with_counts(template, deformed, now?, at_rest?)
    }

    /// [`new`](Self::new) where self-intersections have been counted already, `now` and `at_rest`.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_counts(
        template: &PolygonMesh,
        deformed: &[Vec3],
        now: usize,
        at_rest: usize,
    ) -> Result<Self, EvaluationError> {
        let stretch = EdgeStretch::new(template, deformed)?;
        Ok(Self { self_intersections: now, self_intersections_at_rest: at_rest, stretch })
    }
}

impl std::fmt::Display for MeshQuality {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let EdgeStretch { min, p1, median, p99, max, .. } = self.stretch;
        write!(
            f,
            "self-intersections: {} pairs of triangles (at rest {}); edge stretch: median {median:.3}, 1 % below {p1:.3}, \
             1 % above {p99:.3}, {min:.3} to {max:.3}",
            self.self_intersections, self.self_intersections_at_rest
        )
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
    RestNormals::new(reference, triangles.to_vec())?.flipped(deformed)
}

/// The triangles of a mesh and their normals, to be compared with those of several deformed ones.
#[derive(Debug, Clone)]
pub struct RestNormals {
    vertices: usize,
    triangles: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
}

impl RestNormals {
    /// The triangles at `reference`.
    ///
    /// # Errors
    /// When a triangle names a vertex that does not exist.
    pub fn new(reference: &[Vec3], triangles: Vec<[u32; 3]>) -> Result<Self, EvaluationError> {
        check_triangles(&triangles, reference.len())?;
        let normals = triangles.iter().map(|t| face_normal(reference, t)).collect();
        Ok(Self { vertices: reference.len(), triangles, normals })
    }

    /// [`flipped_triangles`] at `deformed`.
    ///
    /// # Errors
    /// When `deformed` has another number of vertices.
    pub fn flipped(&self, deformed: &[Vec3]) -> Result<usize, EvaluationError> {
        check_count("the deformed mesh", self.vertices, deformed.len())?;
        let turned = self.triangles.iter().zip(&self.normals).filter(|(t, n)| n.dot(&face_normal(deformed, t)) < 0.0);
        Ok(turned.count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_folded_over_its_diagonal_lies_on_itself() {
        let template = square();
        let mut folded = template.positions.clone();
        folded[3] = Vec3::new(1.5, 0.25, 0.0);
        let quality = MeshQuality::new(&template, &folded).unwrap();
        assert_eq!((quality.self_intersections, quality.self_intersections_at_rest), (1, 0));
        let back = MeshQuality::new(&template.with_positions(folded.clone()), &template.positions).unwrap();
        assert_eq!((back.self_intersections, back.self_intersections_at_rest), (0, 1));
        assert_eq!(quality.stretch, EdgeStretch::new(&template, &folded).unwrap());
        let text = quality.to_string();
        assert!(text.contains("1 pairs of triangles (at rest 0)") && text.contains("edge stretch: median"), "{text}");
        assert!(MeshQuality::new(&template, &folded[1..]).is_err());
    }

    #[test]
    fn percentiles_of_stretch_are_those_of_the_edges() {
        // One polygon of 201 edges round a circle, then laid on a line.
        let angle = |i: usize| std::f64::consts::TAU * i as f64 / 201.0;
        let positions = (0..201).map(|i| Vec3::new(angle(i).cos(), angle(i).sin(), 0.0)).collect();
        let ring =
            PolygonMesh { positions, starts: vec![0, 201], corners: (0..201).collect(), ..PolygonMesh::default() };
        let side = 2.0 * (angle(1) / 2.0).sin();
        // Along a line: edge i from vertex i to i + 1 is i times as long; the one that closes it is the sum of all.
        let mut x = 0.0;
        let line: Vec<Vec3> = (0..201)
            .map(|i| {
                x += side * i as f64;
                Vec3::new(x, 0.0, 0.0)
            })
            .collect();
        let stretch = EdgeStretch::new(&ring, &line).unwrap();
        let expected = [1.0, 3.0, 11.0, 101.0, 191.0, 199.0, 20_100.0];
        let found = [stretch.min, stretch.p1, stretch.p5, stretch.median, stretch.p95, stretch.p99, stretch.max];
        assert!(found.iter().zip(expected).all(|(f, e)| (f / e - 1.0).abs() < 1e-9), "{found:?}");
    }

    fn square() -> PolygonMesh {
        let positions = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec();
        PolygonMesh { positions, starts: vec![0, 4], corners: vec![0, 1, 2, 3], ..PolygonMesh::default() }
    }

    #[test]
    fn stretch_and_flips_of_a_square() {
        let template = square();
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
