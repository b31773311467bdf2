//! Seams: where a surface was cut, for texture coordinates or normals, so that its vertices stand more than once.

use std::collections::HashMap;

use super::adjacency::EdgeGraph;
use super::{TriangleMesh, Vec3, place, rms_size};

/// The first of the vertices with which each vertex is one point of the surface: itself, but along seams. A seam is a pair of edges of
/// the open boundary that run in opposite directions between the same places, bit for bit, whose ends may each be `one`; so lips that
/// touch exactly are one, too, unless that says otherwise.
///
/// # Panics
/// When a triangle indexes past the vertices.
#[must_use]
pub fn sewn(mesh: &TriangleMesh, one: impl Fn(u32, u32) -> bool) -> Vec<u32> {
    let mut first: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let place = first_at_place(&mesh.positions);
    if place == first {
        return first;
    }
    let graph = EdgeGraph::of(mesh);
    let boundary = graph.boundary_edges();
    let on_boundary = |a: u32, b: u32| boundary.binary_search(&[a.min(b), a.max(b)]).is_ok();
    let sides = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let sides: Vec<[u32; 2]> = sides.filter(|[a, b]| on_boundary(*a, *b)).collect();
    let between = |a: u32, b: u32| [place[a as usize], place[b as usize]];
    let mut at: HashMap<_, Vec<[u32; 2]>> = HashMap::new();
    for &[a, b] in &sides {
        at.entry(between(a, b)).or_default().push([a, b]);
    }
    for &[a, b] in &sides {
        for &[c, d] in at.get(&between(b, a)).into_iter().flatten() {
            for (v, w) in [(a, d), (b, c)] {
                if one(v, w) {
                    join(&mut first, v, w);
                }
            }
        }
    }
    for v in 0..first.len() {
        first[v] = root(&first, v as u32); // lower ones are roots already
    }
    first
}

/// [`sewn`], but for seams that a shape opens: one of so many moves vertices at one place apart, by more than a ten-thousandth of the
/// surface's size, 0.01 mm on a face, which is rounding. `displacement` is that of a vertex by a shape at weight one.
pub(crate) fn sewn_unless_opened(
    mesh: &TriangleMesh,
    shapes: usize,
    displacement: impl Fn(usize, u32) -> Vec3,
) -> Vec<u32> {
    let rounding = 1e-4 * rms_size(&mesh.surface_points());
    sewn(mesh, |v, w| (0..shapes).all(|k| (displacement(k, v) - displacement(k, w)).norm() <= rounding))
}

/// The first of the vertices at each one's place, bit for bit.
pub(crate) fn first_at_place(positions: &[Vec3]) -> Vec<u32> {
    let mut at = HashMap::with_capacity(positions.len());
    (0..).zip(positions).map(|(v, p)| *at.entry(place(p)).or_insert(v)).collect()
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

    #[test]
    fn only_edges_that_run_in_opposite_directions_are_a_seam() {
        // two squares side by side, each with vertices of its own along the edge that they share
        let at = |x: f64, y: f64| Vec3::new(x, y, 0.0);
        let square = |x: f64| [at(x, 0.0), at(x + 1.0, 0.0), at(x + 1.0, 1.0), at(x, 1.0)];
        let two = |x: f64| TriangleMesh {
            positions: [square(0.0), square(x)].concat(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        };
        let all = |_, _| true;
        assert_eq!(sewn(&two(1.0), all), [0, 1, 2, 3, 1, 5, 6, 2]);
        // apart, and on one another, where the edges run in the same direction
        assert_eq!(sewn(&two(5.0), all), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(sewn(&two(0.0), all), [0, 1, 2, 3, 4, 5, 6, 7]);
        // and where one end of the edge is none
        assert_eq!(sewn(&two(1.0), |v, w| v.min(w) != 2), [0, 1, 2, 3, 1, 5, 6, 7]);
    }
}
