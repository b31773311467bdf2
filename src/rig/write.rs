//! Rigs to folders, in the layout of arrays that [`Rig::read`] describes.

use std::io::Write;
use std::path::Path;

use super::{Family, Rig};
use crate::mesh::io::{WriteError, write_atomically, write_npy, write_npy_points, write_obj};

impl Rig {
    /// Writes `template.obj` (if there are polygons), `neutral.npy` in 64 bits, and for each family that has shapes its
    /// deltas and names; shapes of no known family go with the expressions. The folder has to be there. Other files in it
    /// are left alone.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), WriteError> {
        if let Some(mesh) = &self.mesh {
            write_obj(&folder.join("template.obj"), &mesh.with_positions(self.neutral.clone()))?;
        }
        write_npy_points(&folder.join("neutral.npy"), &self.neutral)?;
        if let Some(landmarks) = &self.landmarks {
            write_json(&folder.join("landmarks_multipie68.json"), landmarks)?;
        }
        for (stem, identity) in [("expression", false), ("identity", true)] {
            let chosen: Vec<usize> =
                (0..self.shapes.len()).filter(|&k| (self.shapes[k].family == Family::Identity) == identity).collect();
            if chosen.is_empty() {
                continue;
            }
            let names: Vec<&str> = chosen.iter().map(|&k| self.shapes[k].name.as_str()).collect();
            let deltas: Vec<f32> = chosen.iter().flat_map(|&k| self.deltas(k)).copied().collect();
            let shape = [chosen.len(), self.neutral.len(), 3];
            write_npy(&folder.join(format!("{stem}_deltas.npy")), &shape, &deltas)?;
            write_json(&folder.join(format!("{stem}_names.json")), &names)?;
        }
        Ok(())
    }
}

fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), WriteError> {
    write_atomically(path, |w| {
        serde_json::to_writer(&mut *w, value)?;
        w.write_all(b"\n")
    })
}

#[cfg(test)]
mod tests {
    use super::super::{RigReadOptions, Shape};
    use super::*;
    use crate::mesh::testing::{noise, sheet};
    use crate::mesh::{PolygonMesh, Vec3};

    #[test]
    fn what_is_written_is_read_back() {
        let mesh = PolygonMesh::from(sheet(3, 2, |x, y| Vec3::new(10.0 * x, 10.0 * y, 0.1)));
        let shapes = [("smile", Family::Expression), ("identity000", Family::Identity), ("jaw", Family::Expression)]
            .map(|(name, family)| Shape { name: name.into(), family });
        let deltas = (0..3 * 18).map(|i| noise(i) as f32).collect();
        let (rig, _) = Rig::new(mesh.positions.clone(), Some(mesh), shapes.to_vec(), deltas).unwrap();
        let folder = tempfile::tempdir().unwrap();
        rig.write(folder.path()).unwrap();
        let (read, warnings) = Rig::read(folder.path(), &RigReadOptions::default()).unwrap();
        assert_eq!(warnings, []);
        let names: Vec<&str> = read.shapes().iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["smile", "jaw", "identity000"]);
        assert_eq!((read.neutral(), read.mesh()), (rig.neutral(), rig.mesh()));
        for (k, original) in [0, 2, 1].into_iter().enumerate() {
            assert_eq!(read.deltas(k), rig.deltas(original));
        }
        assert!(rig.write(&folder.path().join("nowhere")).is_err());
    }
}
