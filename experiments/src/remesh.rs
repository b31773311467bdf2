//! The same scan without its vertices: what is left of an advantage that comes from where they lie.
//!
//! The scans of some benchmarks contain the displaced vertices of the very template that is registered to them. The dual mesh
//! has none of them: a vertex inside each triangle, a fan round each inner vertex.

use nonrigid::mesh::adjacency::{EdgeGraph, vertex_triangles};
use nonrigid::mesh::{TriangleMesh, Vec3};

/// The dual of `mesh`, on its surface: vertex `t` is the centroid of triangle `t`. Vertices on the open boundary or where the
/// mesh is not a manifold have no face, so every boundary shrinks by half a triangle.
#[must_use]
pub fn dual(mesh: &TriangleMesh) -> TriangleMesh {
    let at = |v: u32| mesh.positions[v as usize];
    let positions: Vec<Vec3> = mesh.triangles.iter().map(|t| t.iter().map(|v| at(*v)).sum::<Vec3>() / 3.0).collect();
    let around = vertex_triangles(mesh.positions.len(), &mesh.triangles);
    let boundary = EdgeGraph::of(mesh).boundary_vertices();
    let mut triangles = Vec::new();
    for v in (0..mesh.positions.len()).filter(|v| !boundary[*v]) {
        if let Some(ring) = ring(v as u32, around.row(v), &mesh.triangles) {
            triangles.extend(ring.windows(2).skip(1).map(|w| [ring[0], w[0], w[1]]));
        }
    }
    TriangleMesh { positions, triangles }
}

/// The triangles round a vertex in the order of their winding, if they form one closed fan.
fn ring(vertex: u32, triangles: &[u32], all: &[[u32; 3]]) -> Option<Vec<u32>> {
    // From each triangle the walk leaves over the edge (vertex, out) and enters over (vertex, in).
    let sides = |t: u32| {
        let corners = all[t as usize];
        let k = corners.iter().position(|c| *c == vertex)?;
        Some((corners[(k + 1) % 3], corners[(k + 2) % 3]))
    };
    let mut ring = vec![*triangles.first()?];
    while ring.len() < triangles.len() {
        let (_, out) = sides(ring[ring.len() - 1])?;
        let next = triangles.iter().find(|t| sides(**t).is_some_and(|s| s.0 == out))?;
        if ring.contains(next) {
            return None;
        }
        ring.push(*next);
    }
    (sides(ring[ring.len() - 1])?.1 == sides(ring[0])?.0).then_some(ring)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bumpy grid of `n` by `n` vertices.
    fn grid(n: u32) -> TriangleMesh {
        let at = |i: u32| Vec3::new((i % n) as f64, (i / n) as f64, ((i * 7) % 5) as f64 * 0.1);
        let cells = (0..n - 1).flat_map(|r| (0..n - 1).map(move |c| r * n + c));
        let triangles = cells.flat_map(|i| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]]).collect();
        TriangleMesh { positions: (0..n * n).map(at).collect(), triangles }
    }

    #[test]
    fn every_inner_vertex_becomes_a_fan_that_faces_the_same_way() {
        let mesh = grid(6);
        let dual = dual(&mesh);
        assert_eq!(dual.positions.len(), mesh.triangles.len());
        // Valence six: four triangles for each of the 16 inner vertices.
        assert_eq!(dual.triangles.len(), 16 * 4);
        for t in &dual.triangles {
            let [a, b, c] = t.map(|v| dual.positions[v as usize]);
            assert!((b - a).cross(&(c - a)).z > 0.0);
        }
        let nearest = |p: &Vec3| mesh.positions.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min);
        assert!(dual.positions.iter().all(|p| nearest(p) > 0.4));
    }

    #[test]
    fn what_is_no_fan_gets_no_face() {
        // Two triangles that touch in a vertex only.
        let positions = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), -Vec3::x(), -Vec3::y()];
        let mesh = TriangleMesh { positions, triangles: vec![[0, 1, 2], [0, 3, 4]] };
        assert!(dual(&mesh).triangles.is_empty());
    }
}
