//! The lattice of control points round a surface.

use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::surface_lattice::{POINTS, SurfaceLattice, places};
use nonrigid::mesh::{TriangleMesh, Vec3, bounding_box};

use crate::sheets::{noise, sheet, side_by_side};

fn bumpy() -> TriangleMesh {
    sheet(9, 8, |c, r| Vec3::new(c, r, 0.7 * noise((9.0 * r + c) as usize)))
}

#[test]
fn weights_reproduce_constants_lines_and_squares() {
    // Where control points rest is not kept: it follows from the lattice, half a cell from the corners of its cells.
    let mesh = bumpy();
    let spacing = 1.7;
    let lattice = SurfaceLattice::new(&mesh, spacing).unwrap();
    let low = bounding_box(&mesh.positions).unwrap().0;
    for (v, p) in mesh.positions.iter().enumerate() {
        let cell = (p - low).map(|x| (x / spacing).floor());
        let (mut sum, mut mean, mut square) = (0.0, Vec3::zeros(), Vec3::zeros());
        for ((_, w), k) in lattice.of(v as u32).zip(places()) {
            let at = low + (cell + Vec3::from(k.map(|k| k as f64 - 0.5))) * spacing;
            sum += w;
            mean += at * w;
            square += at.component_mul(&at) * w;
        }
        approx::assert_relative_eq!(sum, 1.0, max_relative = 1e-14);
        approx::assert_abs_diff_eq!(mean, *p, epsilon = 1e-12);
        let quarter = Vec3::from_element(spacing * spacing / 4.0);
        approx::assert_abs_diff_eq!(square, p.component_mul(p) + quarter, epsilon = 1e-11);
    }
}

#[test]
fn parts_that_touch_share_nothing_and_neighbours_do() {
    let mesh = side_by_side(&bumpy(), &bumpy());
    let lattice = SurfaceLattice::new(&mesh, 2.0).unwrap();
    assert_eq!(lattice.control_points(), 2 * SurfaceLattice::new(&bumpy(), 2.0).unwrap().control_points());
    let points = |v: u32| lattice.of(v).map(|p| p.0).collect::<Vec<_>>();
    assert!(points(3).iter().all(|k| !points(72 + 3).contains(k)));
    // However coarse the triangles: cells between two vertices have control points too.
    for [a, b] in EdgeGraph::of(&mesh).edges() {
        assert!(points(*a).iter().any(|k| points(*b).contains(k)), "{a} {b}");
    }
    let fine = SurfaceLattice::new(&mesh, 0.2).unwrap();
    let joined: Vec<[u32; 2]> = fine.patches().iter().flat_map(|p| p.windows(2).map(|w| [w[0], w[1]])).collect();
    assert_eq!(EdgeGraph::from_pairs(fine.control_points(), &joined).components().count(), 2);
}

#[test]
fn loose_vertices_and_broken_triangles_have_their_control_points() {
    let mut mesh = bumpy();
    mesh.positions.extend([Vec3::new(4.1, 4.1, 90.0), Vec3::new(50.0, 0.0, 0.0)]);
    mesh.triangles.extend([[3, 3, 4], [73, 73, 73]]);
    let lattice = SurfaceLattice::new(&mesh, 2.0).unwrap();
    let of = |v: u32| lattice.of(v).collect::<Vec<_>>();
    let distance = |v: &u32| (mesh.positions[*v as usize] - mesh.positions[72]).norm();
    let nearest = (0..72).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
    assert_eq!(of(72), of(nearest));
    assert_eq!(of(73).len(), POINTS);
    assert!(of(73).iter().all(|p| !of(0).iter().any(|q| p.0 == q.0)));
}
