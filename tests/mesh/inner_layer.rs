//! The layer of tissue under a surface.

use std::collections::BTreeMap;

use nonrigid::mesh::normals::face_areas;
use nonrigid::mesh::{InnerLayer, MeshError, TriangleMesh, Vec3, determinant};

use crate::sheets::{noise, sheet, side_by_side};

fn bowl() -> TriangleMesh {
    sheet(9, 8, |c, r| {
        let k = (9.0 * r + c) as usize;
        let (x, y) = (c - 4.0 + 0.2 * noise(k), r - 3.5 + 0.2 * noise(k + 100));
        Vec3::new(x, y, 0.05 * (x * x + y * y))
    })
}

fn volume(layer: &InnerLayer) -> f64 {
    layer.tetrahedra.iter().map(|&t| determinant(&layer.nodes, t) / 6.0).sum()
}

#[test]
fn a_flat_layer_is_area_times_thickness() {
    let mut mesh = bowl();
    mesh.positions.iter_mut().for_each(|p| p.z = 0.0);
    let area: f64 = face_areas(&mesh.positions, &mesh.triangles).iter().sum();
    let layer = InnerLayer::new(&mesh, 0.7).unwrap();
    assert_eq!((layer.tetrahedra.len(), layer.ties.len()), (3 * mesh.triangles.len(), 0));
    approx::assert_relative_eq!(volume(&layer), 0.7 * area, max_relative = 1e-12);
    for (v, below) in layer.below.iter().enumerate() {
        let below = layer.nodes[below.unwrap() as usize];
        approx::assert_abs_diff_eq!(below, mesh.positions[v] - Vec3::z() * 0.7, epsilon = 1e-12);
    }
}

/// Every side of a tetrahedron is that of one other, turned round, or lies on the outside.
#[test]
fn neighbouring_prisms_agree_on_their_diagonals_and_nothing_is_inside_out() {
    for reversed in [false, true] {
        let mut mesh = bowl();
        if reversed {
            mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        let layer = InnerLayer::new(&mesh, 0.5).unwrap();
        assert!(layer.tetrahedra.iter().all(|&t| determinant(&layer.nodes, t) > 0.0));
        let below = layer.nodes[layer.below[40].unwrap() as usize];
        assert_eq!(below.z < mesh.positions[40].z, !reversed, "inside is where normals do not point");
        let mut sides: BTreeMap<[u32; 3], i32> = BTreeMap::new();
        for &[a, b, c, d] in &layer.tetrahedra {
            for side in [[a, c, b], [a, b, d], [b, c, d], [c, a, d]] {
                let mut sorted = side;
                sorted.sort_unstable();
                let turns = (0..3).filter(|&k| side[k] > side[(k + 1) % 3]).count();
                *sides.entry(sorted).or_default() += if turns == 1 { 1 } else { -1 };
            }
        }
        // Both surfaces, and two triangles under each edge of the rim.
        let open = sides.values().filter(|s| s.abs() == 1).count();
        let rim = 2 * (8 + 7);
        assert_eq!(open, 2 * mesh.triangles.len() + 2 * rim);
        assert!(sides.values().all(|s| s.abs() <= 1));
    }
}

#[test]
fn a_layer_thicker_than_the_bend_is_thinner_there_and_sound() {
    let mut mesh = bowl();
    mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let layer = InnerLayer::new(&mesh, 30.0).unwrap();
    assert_eq!(layer.tetrahedra.len(), 3 * 2 * 8 * 7);
    assert!(layer.tetrahedra.iter().all(|&t| determinant(&layer.nodes, t) > 0.0));
    let deepest = (0..72).map(|v| (layer.nodes[layer.below[v].unwrap() as usize] - layer.nodes[v]).norm());
    assert!(deepest.fold(0.0, f64::max) < 30.0);
}

#[test]
fn what_has_no_prism_is_tied_to_the_nearest_that_has() {
    let mut mesh = side_by_side(&bowl(), &sheet(3, 3, |c, r| Vec3::new(c + 30.0, r, 0.0)));
    let n = mesh.positions.len() as u32;
    mesh.positions.extend([Vec3::new(31.0, 1.0, 0.5), Vec3::new(-60.0, 4.0, 1.0), mesh.positions[75]]);
    mesh.positions.extend([Vec3::zeros(), Vec3::x() * 2.0, Vec3::x() * 5.0].map(|p| p + Vec3::z() * 9.0));
    mesh.triangles.extend([[n + 3, n + 4, n + 5], [3, 3, 4], mesh.triangles[5]]);
    let layer = InnerLayer::new(&mesh, 0.5).unwrap();
    assert_eq!(layer.tetrahedra.len(), 3 * (mesh.triangles.len() - 3));
    assert_eq!(layer.ties.iter().map(|t| t[0]).collect::<Vec<_>>(), (n..n + 6).collect::<Vec<_>>());
    assert!(layer.ties.iter().all(|&t| determinant(&layer.nodes, t) > 1e-3));
    assert!(layer.ties[0][1..].iter().all(|&k| layer.nodes[k as usize].x > 25.0));
    assert_eq!(layer, InnerLayer::new(&mesh, 0.5).unwrap());
}

#[test]
fn one_triangle_has_a_prism_and_none_is_an_error() {
    let one = TriangleMesh { positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y()], triangles: vec![[0, 1, 2]] };
    approx::assert_relative_eq!(volume(&InnerLayer::new(&one, 3.0).unwrap()), 1.5, max_relative = 1e-12);
    let flat = TriangleMesh { positions: vec![Vec3::zeros(), Vec3::x(), Vec3::x() * 2.0], ..one.clone() };
    assert_eq!(InnerLayer::new(&flat, 1.0), Err(MeshError::NoArea));
    assert_eq!(InnerLayer::new(&TriangleMesh::default(), 1.0), Err(MeshError::NoArea));
    let outside = TriangleMesh { triangles: vec![[0, 1, 3]], ..one };
    assert!(matches!(InnerLayer::new(&outside, 1.0), Err(MeshError::IndexOutOfRange { index: 3, .. })));
}
