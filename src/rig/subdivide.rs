//! A rig on a finer mesh: neutral and shapes divided alike by Catmull and Clark's rules, which are linear.

use super::{Regions, Rig, RigError, RigWarning};
use crate::mesh::{Subdivision, Vec3};

/// A rig cannot be divided.
#[derive(Debug, thiserror::Error)]
pub enum SubdivideError {
    /// The rig has no polygons.
    #[error("the rig has no polygons, which are what is divided; add a template")]
    NoPolygons,
    /// More vertices than an index can count.
    #[error("the finer rig has more vertices than can be counted; fewer rounds")]
    TooFine,
    /// The shapes of the finer rig do not do.
    #[error(transparent)]
    Rig(#[from] RigError),
}

impl Rig {
    /// Divides the rig's mesh `rounds` times, each polygon of `k` corners into `k` quads. Its vertices come first and keep their
    /// order, so landmarks stay; a region has the new vertices that are mostly its own. Shapes that move nothing any more are dropped
    /// and reported.
    ///
    /// # Errors
    /// When the rig has no polygons, or the result is too large.
    pub fn subdivided(&self, rounds: u8) -> Result<(Self, Vec<RigWarning>), SubdivideError> {
        let mesh = self.mesh().ok_or(SubdivideError::NoPolygons)?;
        let mut mesh = mesh.with_positions(self.neutral().to_vec());
        let vector = |d: &[f32]| Vec3::new(f64::from(d[0]), f64::from(d[1]), f64::from(d[2]));
        let mut shapes: Vec<Vec<Vec3>> =
            (0..self.shapes().len()).map(|k| self.deltas(k).chunks_exact(3).map(vector).collect()).collect();
        let count = mesh.positions.len();
        let share = |vertices: &[u32]| {
            let mut share = vec![0.0; count];
            vertices.iter().for_each(|&v| share[v as usize] = 1.0);
            share
        };
        let of_region = |r: &Regions| {
            r.names().map(|name| (name.to_owned(), share(r.vertices(name).unwrap_or_default()))).collect::<Vec<_>>()
        };
        let mut regions: Vec<(String, Vec<f64>)> = self.regions().into_iter().flat_map(of_region).collect();
        let mut first = self.seams(self.neutral());
        for _ in 0..rounds {
            let division = Subdivision::new(&mesh, &first).ok_or(SubdivideError::TooFine)?;
            first = division.first();
            mesh = division.mesh(&mesh.positions);
            shapes.iter_mut().for_each(|s| *s = division.apply(s));
            regions.iter_mut().for_each(|(_, r)| *r = division.apply(r));
        }
        let deltas = shapes.iter().flatten().flat_map(|d| [d.x as f32, d.y as f32, d.z as f32]).collect();
        let vertices = mesh.positions.len();
        let (mut rig, warnings) = Self::new(mesh.positions.clone(), Some(mesh), self.shapes().to_vec(), deltas)?;
        if let Some(landmarks) = self.landmarks() {
            rig = rig.with_landmarks(landmarks.to_vec())?;
        }
        if self.regions().is_some() {
            // rounding may leave a little less than a half
            let own = |share: &Vec<f64>| (0..vertices as u32).filter(|&v| share[v as usize] > 0.5 - 1e-9).collect();
            let regions = regions.iter().map(|(name, share)| (name.clone(), own(share))).collect();
            rig = rig.with_regions(Regions::new(vertices, regions).map_err(RigError::from)?)?;
        }
        Ok((rig, warnings))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Family, Shape};
    use super::*;
    use crate::mesh::PolygonMesh;
    use crate::mesh::testing::sheet;

    fn rig() -> Rig {
        let mesh = PolygonMesh::from(sheet(4, 4, |c, r| Vec3::new(c, r, 0.1 * c * r)));
        let shape = |name: &str| Shape { name: name.into(), family: Family::Expression };
        let deltas =
            |k: f64| mesh.positions.iter().flat_map(move |p| [0.0, (0.01 * k * p.x) as f32, (0.02 * p.y * p.y) as f32]);
        let deltas = [1.0, 3.0].into_iter().flat_map(deltas).collect();
        let (neutral, shapes) = (mesh.positions.clone(), vec![shape("smile"), shape("frown")]);
        let regions = Regions::new(16, vec![("left".into(), (0..16).filter(|v| v % 4 < 2).collect())]).unwrap();
        let (rig, _) = Rig::new(neutral, Some(mesh), shapes, deltas).unwrap();
        rig.with_landmarks(vec![5; 68]).unwrap().with_regions(regions).unwrap()
    }

    #[test]
    fn a_shape_of_the_finer_rig_is_the_finer_mesh_of_the_shape() {
        let coarse = rig();
        let (fine, warnings) = coarse.subdivided(2).unwrap();
        assert!(warnings.is_empty());
        assert_eq!(fine.landmarks(), coarse.landmarks());
        for k in 0..2 {
            let moved = |rig: &Rig| -> Vec<Vec3> {
                let d = rig.deltas(k).chunks_exact(3);
                rig.neutral().iter().zip(d).map(|(p, d)| p + Vec3::new(d[0].into(), d[1].into(), d[2].into())).collect()
            };
            let mut mesh = coarse.mesh().unwrap().with_positions(moved(&coarse));
            for _ in 0..2 {
                let own: Vec<u32> = (0..mesh.positions.len() as u32).collect();
                mesh = Subdivision::new(&mesh, &own).unwrap().mesh(&mesh.positions);
            }
            for (a, b) in moved(&fine).iter().zip(&mesh.positions) {
                assert!((a - b).norm() < 1e-6, "{a} {b}");
            }
        }
        let left = fine.regions().unwrap().vertices("left").unwrap();
        let xs: Vec<f64> = left.iter().map(|&v| fine.neutral()[v as usize].x).collect();
        assert!(left.len() > 40 && xs.iter().all(|x| *x < 1.6), "{xs:?}");
    }

    #[test]
    fn a_rig_without_polygons_is_refused() {
        let (neutral, shape) = (vec![Vec3::zeros(), Vec3::x()], Shape { name: "a".into(), family: Family::Other });
        let (rig, _) = Rig::new(neutral, None, vec![shape], vec![0.1; 6]).unwrap();
        assert!(matches!(rig.subdivided(1), Err(SubdivideError::NoPolygons)));
    }
}
