//! Small meshes for unit tests.

use super::{TriangleMesh, Vec3};

/// A grid of `columns` x `rows` vertices, row by row, at `place(column, row)`; the normals point along column x row.
pub fn sheet(columns: usize, rows: usize, place: impl Fn(f64, f64) -> Vec3) -> TriangleMesh {
    let positions = (0..rows * columns).map(|i| place((i % columns) as f64, (i / columns) as f64)).collect();
    let corner = |c: usize, r: usize| (r * columns + c) as u32;
    let quads = (0..(rows - 1) * (columns - 1)).map(|q| (q % (columns - 1), q / (columns - 1)));
    let halves = quads.flat_map(|(c, r)| {
        let (a, b, d, e) = (corner(c, r), corner(c + 1, r), corner(c + 1, r + 1), corner(c, r + 1));
        [[a, b, d], [a, d, e]]
    });
    TriangleMesh { positions, triangles: halves.collect() }
}

/// Two meshes as one, unconnected.
pub fn side_by_side(a: &TriangleMesh, b: &TriangleMesh) -> TriangleMesh {
    let first = a.positions.len() as u32;
    let shifted = b.triangles.iter().map(|t| t.map(|v| v + first));
    TriangleMesh {
        positions: a.positions.iter().chain(&b.positions).copied().collect(),
        triangles: a.triangles.iter().copied().chain(shifted).collect(),
    }
}

/// Numbers in [-1, 1) that look random and are always the same.
pub fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
