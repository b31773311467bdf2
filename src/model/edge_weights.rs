//! Weights of the edges of a triangulation: what the regularisers on vertex positions are made of.

use serde::{Deserialize, Serialize};

use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::normals::vertex_areas;
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// How edges weigh in a Laplacian. On equilateral triangles all kinds agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeWeights {
    /// `1 / sqrt(3)` each: as if all triangles were equilateral and of one size.
    #[default]
    Uniform,
    /// `(cot alpha + cot beta) / 2` of the angles opposite the edge (Pinkall and Polthier 1993): independent of how the surface
    /// is triangulated. Cotangents beyond 1000 either way count as 1000 (angles of less than 0.06 degrees), triangles
    /// without area not at all.
    Cotangent,
}

/// Cotangent of the largest angle that counts, either way.
pub(super) const LARGEST_COTANGENT: f64 = 1e3;

/// Vertex areas below this part of the mean count as that.
const SMALLEST_AREA: f64 = 1e-3;

/// Cotangents of a triangle's angles at its three corners; zero if it has no area.
pub(super) fn cotangents(positions: &[Vec3], triangle: [u32; 3]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let [a, b, c] = [0, 1, 2].map(|m| positions[triangle[(k + m) % 3] as usize]);
        let (u, v) = (b - a, c - a);
        let (sine, cosine) = (u.cross(&v).norm(), u.dot(&v));
        let longest = u.norm_squared().max(v.norm_squared()).max((c - b).norm_squared());
        let flat = sine <= 1e-12 * longest;
        if flat { 0.0 } else { (cosine / sine).clamp(-LARGEST_COTANGENT, LARGEST_COTANGENT) }
    })
}

/// The edges of a mesh with their weights, and a tie from every unreferenced vertex to the nearest referenced one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WeightedEdges {
    /// Every edge once; edges of the mesh, then ties, unreferenced vertex first.
    pub edges: Vec<[u32; 2]>,
    /// One weight per edge.
    pub weights: Vec<f64>,
    /// How many of the edges belong to the mesh.
    pub of_mesh: usize,
    /// Whether each vertex lies on the open boundary.
    pub boundary: Vec<bool>,
}

impl WeightedEdges {
    /// Negative weights become zero if `clamp` asks for it. A vertex whose weights all vanish gets the uniform weight on all
    /// of its edges, so that nothing falls off the surface.
    ///
    /// A tie weighs like an edge between equilateral triangles, less the longer it is: its weight times its squared length is
    /// at most that of an edge of mean length, so that it turns its anchor no more than another neighbour does.
    pub fn new(mesh: &TriangleMesh, kind: EdgeWeights, clamp: bool) -> Result<Self, MeshError> {
        let count = mesh.positions.len();
        mesh.check()?;
        let uniform = 1.0 / 3f64.sqrt();
        let graph = EdgeGraph::of(mesh);
        let mut edges = graph.edges().to_vec();
        let mut weights = match kind {
            EdgeWeights::Uniform => vec![uniform; edges.len()],
            EdgeWeights::Cotangent => {
                let mut weights = vec![0.0; edges.len()];
                for &triangle in &mesh.triangles {
                    for (k, cotangent) in cotangents(&mesh.positions, triangle).into_iter().enumerate() {
                        if let Some(edge) = graph.find(triangle[(k + 1) % 3], triangle[(k + 2) % 3]) {
                            weights[edge] += 0.5 * cotangent;
                        }
                    }
                }
                if clamp {
                    weights.iter_mut().for_each(|w| *w = w.max(0.0));
                }
                weights
            }
        };
        let lost: Vec<usize> = (0..count)
            .filter(|&v| !graph.edges_at(v).is_empty())
            .filter(|&v| graph.edges_at(v).iter().all(|&e| weights[e as usize] == 0.0))
            .collect();
        for v in lost {
            graph.edges_at(v).iter().for_each(|&e| weights[e as usize] = uniform);
        }

        let of_mesh = edges.len();
        let referenced: Vec<u32> = (0..count as u32).filter(|&v| !graph.neighbours(v as usize).is_empty()).collect();
        let anchors: Vec<Vec3> = referenced.iter().map(|&v| mesh.positions[v as usize]).collect();
        let nearest = ClosestVertices::new(&anchors)?;
        let mean = graph.lengths(&mesh.positions).iter().map(|l| l * l).sum::<f64>() / of_mesh.max(1) as f64;
        for (v, p) in mesh.positions.iter().enumerate().filter(|(v, _)| graph.neighbours(*v).is_empty()) {
            if let Some(anchor) = nearest.query(p) {
                edges.push([v as u32, referenced[anchor.vertex as usize]]);
                weights
                    .push(uniform * if anchor.squared_distance > mean { mean / anchor.squared_distance } else { 1.0 });
            }
        }
        Ok(Self { edges, weights, of_mesh, boundary: graph.boundary_vertices() })
    }

    /// The edges of weight other than zero.
    pub fn joined(&self) -> Vec<[u32; 2]> {
        self.edges.iter().zip(&self.weights).filter(|(_, w)| **w != 0.0).map(|(e, _)| *e).collect()
    }

    /// The edges of the mesh alone.
    pub fn without_ties(&self) -> Self {
        let (edges, weights) = (self.edges[..self.of_mesh].to_vec(), self.weights[..self.of_mesh].to_vec());
        Self { edges, weights, of_mesh: self.of_mesh, boundary: self.boundary.clone() }
    }

    /// The area of every vertex, in units of the mesh' area divided by `reference_vertices`. Uniform weights know no areas: all
    /// vertices with edges have the same.
    pub fn areas(&self, mesh: &TriangleMesh, kind: EdgeWeights, reference_vertices: f64) -> Vec<f64> {
        let mut used = vec![false; mesh.positions.len()];
        self.edges[..self.of_mesh].as_flattened().iter().for_each(|&v| used[v as usize] = true);
        let used = used.into_iter().filter(|u| *u).count().max(1) as f64;
        match kind {
            EdgeWeights::Uniform => vec![reference_vertices / used; mesh.positions.len()],
            EdgeWeights::Cotangent => {
                let areas = vertex_areas(&mesh.positions, &mesh.triangles);
                let mean = areas.iter().sum::<f64>() / used;
                let relative = |a: f64| if mean > 0.0 { (a / mean).max(SMALLEST_AREA) } else { 1.0 };
                areas.into_iter().map(|a| relative(a) * reference_vertices / used).collect()
            }
        }
    }

    /// The other end and the weight of every edge at each vertex, ties included; edges in order.
    pub fn stars(&self, vertex_count: usize) -> Vec<Vec<(u32, f64)>> {
        let mut stars = vec![Vec::new(); vertex_count];
        for (&[a, b], &w) in self.edges.iter().zip(&self.weights) {
            stars[a as usize].push((b, w));
            stars[b as usize].push((a, w));
        }
        stars
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet};

    fn uneven() -> TriangleMesh {
        sheet(7, 6, |c, r| {
            let k = (7.0 * r + c) as usize;
            Vec3::new(c + 0.35 * noise(k), r + 0.35 * noise(k + 100), 0.0)
        })
    }

    #[test]
    fn cotangents_are_those_of_the_angles() {
        let p = [Vec3::zeros(), Vec3::new(2.0, 0.0, 0.0), Vec3::new(0.0, 2.0 * 3f64.sqrt(), 0.0)];
        let expected = [0.0, 1.0 / 3f64.sqrt(), 3f64.sqrt()]; // 90, 60, 30 degrees
        for (found, expected) in cotangents(&p, [0, 1, 2]).into_iter().zip(expected) {
            approx::assert_abs_diff_eq!(found, expected, epsilon = 1e-14);
        }
    }

    #[test]
    fn cotangent_weights_integrate_linear_fields_exactly() {
        // sum w |d_i - d_j|^2 = integral of |grad d|^2, and d = g . x has |g|^2 times the area.
        let mesh = uneven();
        let edges = WeightedEdges::new(&mesh, EdgeWeights::Cotangent, false).unwrap();
        assert!(edges.weights.iter().any(|w| *w < 0.0), "the sheet should have obtuse angles");
        let g = Vec3::new(0.3, -1.7, 0.0);
        let dirichlet: f64 = (edges.edges.iter().zip(&edges.weights))
            .map(|(&[a, b], w)| w * g.dot(&(mesh.positions[a as usize] - mesh.positions[b as usize])).powi(2))
            .sum();
        let area: f64 = crate::mesh::normals::face_areas(&mesh.positions, &mesh.triangles).iter().sum();
        approx::assert_relative_eq!(dirichlet, g.norm_squared() * area, max_relative = 1e-12);
        let clamped = WeightedEdges::new(&mesh, EdgeWeights::Cotangent, true).unwrap();
        assert!(clamped.weights.iter().zip(&edges.weights).all(|(c, w)| *c == w.max(0.0)));
    }

    #[test]
    fn kinds_agree_on_equilateral_triangles() {
        let mesh = sheet(6, 6, |c, r| Vec3::new(c - 0.5 * r, r * 0.75f64.sqrt(), 0.0));
        let [uniform, cotangent] =
            [EdgeWeights::Uniform, EdgeWeights::Cotangent].map(|kind| WeightedEdges::new(&mesh, kind, true).unwrap());
        for ((&[a, b], u), c) in uniform.edges.iter().zip(&uniform.weights).zip(&cotangent.weights) {
            let rim = uniform.boundary[a as usize] && uniform.boundary[b as usize];
            assert!(rim || (u - c).abs() < 1e-14, "{a} {b}: {u} {c}");
        }
    }

    #[test]
    fn flat_triangles_weigh_nothing_and_no_vertex_is_lost() {
        // Everything on a line: no triangle has an area.
        let mesh = sheet(4, 3, |c, r| Vec3::new(c + r, 0.0, 0.0));
        let edges = WeightedEdges::new(&mesh, EdgeWeights::Cotangent, true).unwrap();
        assert_eq!(edges.weights, vec![1.0 / 3f64.sqrt(); edges.edges.len()]);
    }

    #[test]
    fn unreferenced_vertices_are_tied_to_the_nearest_referenced_one() {
        let mut mesh = uneven();
        mesh.positions.push(mesh.positions[9] + Vec3::new(0.0, 0.0, 0.1));
        mesh.positions.push(mesh.positions[41] + Vec3::new(30.0, 40.0, 0.0));
        let edges = WeightedEdges::new(&mesh, EdgeWeights::Uniform, true).unwrap();
        assert_eq!(edges.edges[edges.of_mesh..], [[42, 9], [43, 41]]);
        let uniform = 1.0 / 3f64.sqrt();
        assert_eq!(edges.weights[edges.of_mesh], uniform);
        assert!(edges.weights[edges.of_mesh + 1] < uniform * 2.0 / 2500.0);
        mesh.positions[43].x = f64::NAN;
        assert!(matches!(
            WeightedEdges::new(&mesh, EdgeWeights::Uniform, true),
            Err(MeshError::NotFinite { vertex: 43, .. })
        ));
        mesh.positions.truncate(5);
        assert!(matches!(
            WeightedEdges::new(&mesh, EdgeWeights::Uniform, true),
            Err(MeshError::IndexOutOfRange { count: 5, .. })
        ));
    }
}
