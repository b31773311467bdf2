//! Seams: where a surface was cut, for texture coordinates or normals, so that its vertices stand more than once.

use std::collections::HashMap;

use super::TriangleMesh;
use super::adjacency::EdgeGraph;

/// The first of the vertices with which each vertex is one point of the surface: itself, but along seams. A seam is a pair of edges of
/// the open boundary that run in opposite directions between the same places, bit for bit; so lips that touch exactly are one, too.
///
/// # Panics
/// When a triangle indexes past the vertices.
#[must_use]
pub fn sewn(mesh: &TriangleMesh) -> Vec<u32> {
    let mut first: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let graph = EdgeGraph::of(mesh);
    let boundary = graph.boundary_edges();
    let on_boundary = |a: u32, b: u32| boundary.binary_search(&[a.min(b), a.max(b)]).is_ok();
    let sides = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let sides: Vec<[u32; 2]> = sides.filter(|[a, b]| on_boundary(*a, *b)).collect();
    let place = |v: u32| super::place(&mesh.positions[v as usize]);
    let mut at: HashMap<_, Vec<[u32; 2]>> = HashMap::new();
    for &[a, b] in &sides {
        at.entry([place(a), place(b)]).or_default().push([a, b]);
    }
    for &[a, b] in &sides {
        for &[c, d] in at.get(&[place(b), place(a)]).into_iter().flatten() {
            join(&mut first, a, d);
            join(&mut first, b, c);
        }
    }
    for v in 0..first.len() {
        first[v] = root(&first, v as u32); // lower ones are roots already
    }
    first
}

/// The lowest vertex of those that are joined to one.
fn root(first: &[u32], mut v: u32) -> u32 {
    while first[v as usize] != v {
        v = first[v as usize];
    }
    v
}

fn join(first: &mut [u32], a: u32, b: u32) {
    let [a, b] = [root(first, a), root(first, b)];
    first[a.max(b) as usize] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Vec3;

    #[test]
    fn only_edges_that_run_in_opposite_directions_are_a_seam() {
        // two squares side by side, each with vertices of its own along the edge that they share
        let at = |x: f64, y: f64| Vec3::new(x, y, 0.0);
        let square = |x: f64| [at(x, 0.0), at(x + 1.0, 0.0), at(x + 1.0, 1.0), at(x, 1.0)];
        let two = |x: f64| TriangleMesh {
            positions: [square(0.0), square(x)].concat(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        };
        assert_eq!(sewn(&two(1.0)), [0, 1, 2, 3, 1, 5, 6, 2]);
        // apart, and on one another, where the edges run in the same direction
        assert_eq!(sewn(&two(5.0)), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(sewn(&two(0.0)), [0, 1, 2, 3, 4, 5, 6, 7]);
    }
}
