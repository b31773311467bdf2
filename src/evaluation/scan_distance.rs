//! Distance to a scan, whether triangles or a point cloud.

use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{MeshError, OrientedPoints, TriangleMesh, Vec3};

/// Measures distances to a scan: to the surface of its triangles or, without any, to the discs of its points with normals
/// ([`OrientedPoints`]).
#[derive(Debug)]
pub enum ScanDistance {
    /// Triangles.
    Triangles(ClosestPoint),
    /// Points with normals.
    Points(OrientedPoints),
}

impl ScanDistance {
    /// Prepares a scan; `normals`, one per vertex, are needed only where there are no triangles.
    ///
    /// # Errors
    /// When a coordinate is not finite or a triangle indexes past the vertices.
    pub fn new(scan: &TriangleMesh, normals: Option<&[Vec3]>) -> Result<Self, MeshError> {
        match normals.filter(|n| scan.triangles.is_empty() && n.len() == scan.positions.len()) {
            Some(normals) => Ok(Self::Points(OrientedPoints::new(&scan.positions, normals, 0)?)),
            None => Ok(Self::Triangles(ClosestPoint::new(scan)?)),
        }
    }

    /// Distance of a point, millimetres; NaN for a scan without any surface.
    #[must_use]
    pub fn of(&self, p: &Vec3) -> f64 {
        match self {
            Self::Triangles(surface) => surface.query(p).map_or(f64::NAN, |c| c.squared_distance.sqrt()),
            Self::Points(points) => points.query(p, None, f64::INFINITY).map_or(f64::NAN, |c| c.distance),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;

    #[test]
    fn a_cloud_measures_what_its_mesh_does() {
        let mesh = sheet(15, 15, |c, r| Vec3::new(c, r, 0.0));
        let cloud = TriangleMesh { triangles: Vec::new(), ..mesh.clone() };
        let on_mesh = ScanDistance::new(&mesh, None).unwrap();
        let on_cloud = ScanDistance::new(&cloud, Some(&[Vec3::z(); 225])).unwrap();
        for p in [Vec3::new(3.3, 7.6, 2.0), Vec3::new(8.5, 8.5, -0.25), Vec3::new(5.0, 5.0, 0.0)] {
            approx::assert_abs_diff_eq!(on_mesh.of(&p), on_cloud.of(&p), epsilon = 1e-12);
        }
        assert_eq!(on_cloud.of(&Vec3::new(7.0, -9.0, 0.0)), 9.0);
        assert!(ScanDistance::new(&cloud, None).unwrap().of(&Vec3::zeros()).is_nan());
    }
}
