//! Normals of faces and vertices, and vertex areas.
//!
//! Counter-clockwise triangles point towards the viewer. A triangle without area and a vertex without triangles get the
//! zero vector, never NaN.

use super::Vec3;

/// How the triangles round a vertex share in its normal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NormalWeighting {
    /// By area: the sum of cross products. Cheapest.
    #[default]
    Area,
    /// By the angle at the vertex, which does not depend on how a flat region is cut into triangles (Thürmer & Wüthrich,
    /// "Computing vertex normals from polygonal facets", 1998).
    Angle,
}

/// The vector scaled to length 1; zero if it has no length or is not finite.
#[inline]
pub(super) fn unit(v: Vec3) -> Vec3 {
    let length = v.norm();
    if length > 0.0 && length.is_finite() { v / length } else { Vec3::zeros() }
}

#[inline]
fn corners(positions: &[Vec3], t: [u32; 3]) -> [Vec3; 3] {
    t.map(|v| positions[v as usize])
}

/// Twice the area times the normal of a triangle.
#[inline]
#[must_use]
pub fn face_cross(positions: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = corners(positions, triangle);
    (b - a).cross(&(c - a))
}

/// Unit normal of every triangle.
///
/// # Panics
/// When a triangle indexes past the positions.
#[must_use]
pub fn face_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    triangles.iter().map(|&t| unit(face_cross(positions, t))).collect()
}

/// Unit normal of every vertex.
///
/// # Panics
/// When a triangle indexes past the positions.
#[must_use]
pub fn vertex_normals(positions: &[Vec3], triangles: &[[u32; 3]], weighting: NormalWeighting) -> Vec<Vec3> {
    let mut normals = vec![Vec3::zeros(); positions.len()];
    vertex_normals_into(positions, triangles, weighting, &mut normals);
    normals
}

/// As [`vertex_normals`], into a buffer of the caller; allocates nothing.
///
/// # Panics
/// When `normals` and `positions` differ in length, or a triangle indexes past them.
pub fn vertex_normals_into(
    positions: &[Vec3],
    triangles: &[[u32; 3]],
    weighting: NormalWeighting,
    normals: &mut [Vec3],
) {
    assert_eq!(normals.len(), positions.len(), "one normal per vertex");
    normals.fill(Vec3::zeros());
    for &t in triangles {
        let cross = face_cross(positions, t);
        match weighting {
            NormalWeighting::Area => t.iter().for_each(|&v| normals[v as usize] += cross),
            NormalWeighting::Angle => {
                let p = corners(positions, t);
                let normal = unit(cross);
                let double_area = cross.norm();
                for i in 0..3 {
                    let (e, f) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
                    normals[t[i] as usize] += normal * double_area.atan2(e.dot(&f));
                }
            }
        }
    }
    normals.iter_mut().for_each(|n| *n = unit(*n));
}

/// Area of every triangle, square millimetres.
///
/// # Panics
/// When a triangle indexes past the positions.
#[must_use]
pub fn face_areas(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<f64> {
    triangles.iter().map(|&t| 0.5 * face_cross(positions, t).norm()).collect()
}

/// A third of the area of the triangles round every vertex, square millimetres; they sum to the surface.
///
/// # Panics
/// When a triangle indexes past the positions.
#[must_use]
pub fn vertex_areas(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; positions.len()];
    for &t in triangles {
        let third = face_cross(positions, t).norm() / 6.0;
        t.iter().for_each(|&v| areas[v as usize] += third);
    }
    areas
}

#[cfg(test)]
mod tests {
    use super::*;
    use NormalWeighting::{Angle, Area};

    fn cube() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let positions = (0..8).map(|i| Vec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        (positions, triangles)
    }

    #[test]
    fn angle_weights_see_the_cube_and_not_its_diagonals() {
        let (positions, triangles) = cube();
        for (p, n) in positions.iter().zip(vertex_normals(&positions, &triangles, Angle)) {
            let outward = (p - Vec3::repeat(0.5)).normalize();
            assert!((n - outward).norm() < 1e-12);
        }
        for (p, n) in positions.iter().zip(vertex_normals(&positions, &triangles, Area)) {
            assert!(n.dot(&(p - Vec3::repeat(0.5))) > 0.0 && (n.norm() - 1.0).abs() < 1e-12);
        }
        let total: f64 = vertex_areas(&positions, &triangles).iter().sum();
        assert!((total - 6.0).abs() < 1e-12);
        assert!((face_areas(&positions, &triangles).iter().sum::<f64>() - 6.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_ever_nan() {
        let positions = vec![Vec3::zeros(), Vec3::x(), Vec3::x() * 2.0, Vec3::y(), Vec3::repeat(f64::NAN)];
        let triangles = [[0, 1, 2], [0, 0, 1], [3, 3, 3]];
        for weighting in [Area, Angle] {
            for n in vertex_normals(&positions, &triangles, weighting) {
                assert_eq!(n, Vec3::zeros());
            }
        }
        let bad = vertex_normals(&positions, &[[0, 1, 4]], Angle);
        assert!(bad.iter().all(|n| *n == Vec3::zeros()));
        assert!(face_normals(&positions, &triangles).iter().all(|n| *n == Vec3::zeros()));
    }
}
