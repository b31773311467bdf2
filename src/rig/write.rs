//! Rigs to folders, in the layouts that [`Rig::read`] describes.

use std::io::Write;
use std::path::Path;

use super::{Family, Rig};
use crate::io::{WriteError, write_atomically, write_folder, write_npy, write_npy_points, write_obj};
use crate::mesh::{PolygonMesh, Vec3};
use crate::text;

/// What [`Rig::write`] can write.
pub const RIG_FILES: [&str; 8] = [
    "template.obj",
    "neutral.npy",
    "landmarks_multipie68.json",
    "regions.json",
    "expression_deltas.npy",
    "expression_names.json",
    "identity_deltas.npy",
    "identity_names.json",
];

impl Rig {
    /// Writes `template.obj` (if there are polygons), `neutral.npy` in 64 bits, and for each family that has shapes its
    /// deltas and names; shapes of no known family go with the expressions. Regions go into `regions.json`. Material
    /// libraries are not copied ([`MaterialFiles`](crate::io::MaterialFiles) does), and not named. The folder is
    /// made if it is not there; other files in it are left alone. It gets all files or none ([`write_folder`]).
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), WriteError> {
        write_folder(folder, |aside| self.write_into(aside))
    }

    /// [`write`](Self::write) into a folder that is there, file by file.
    pub(super) fn write_into(&self, folder: &Path) -> Result<(), WriteError> {
        if let Some(mesh) = &self.mesh {
            write_obj(&folder.join("template.obj"), &without_libraries(mesh, &self.neutral))?;
        }
        write_npy_points(&folder.join("neutral.npy"), &self.neutral)?;
        if let Some(landmarks) = &self.landmarks {
            write_json_line(&folder.join("landmarks_multipie68.json"), landmarks)?;
        }
        if let Some(regions) = &self.regions {
            regions.write(&folder.join("regions.json"))?;
        }
        for (stem, chosen) in self.stems() {
            let names: Vec<&str> = chosen.iter().map(|&k| self.shapes[k].name.as_str()).collect();
            let deltas: Vec<f32> = chosen.iter().flat_map(|&k| self.deltas(k)).copied().collect();
            let shape = [chosen.len(), self.neutral.len(), 3];
            write_npy(&folder.join(format!("{stem}_deltas.npy")), &shape, &deltas)?;
            write_json_line(&folder.join(format!("{stem}_names.json")), &names)?;
        }
        Ok(())
    }

    /// A file of the folder that [`write`](Self::write), or [`write_meshes`](Self::write_meshes) if `meshes`, would leave there
    /// and [`Rig::read`] would take for a part of the rig: another rig's. The first by name; none where there is no folder.
    #[must_use]
    pub fn stranger_in(&self, folder: &Path, meshes: bool) -> Option<String> {
        let mut written: Vec<String> = self.regions.iter().map(|_| "regions.json".to_owned()).collect();
        if meshes {
            written.push("neutral.obj".to_owned());
            written.extend(self.shapes.iter().map(|s| format!("{}.obj", s.name)));
        } else {
            written.push("neutral.npy".to_owned());
            written.extend(self.mesh.iter().map(|_| "template.obj".to_owned()));
            written.extend(self.landmarks.iter().map(|_| "landmarks_multipie68.json".to_owned()));
            written.extend(self.stems().map(|(stem, _)| format!("{stem}_deltas.npy")));
        }
        let is_read = |name: &str| match name.rsplit_once('.') {
            Some((stem, "obj" | "ply")) => meshes || stem == "template",
            Some((stem, "npy")) => stem == "neutral" || stem.ends_with("_deltas"),
            _ => name == "regions.json" || name == "landmarks_multipie68.json" && !meshes,
        };
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
        names.filter(|name| is_read(name) && !written.contains(name)).min()
    }

    /// Shapes by the files that they go to, without empty ones; shapes of no known family go with the expressions.
    pub(super) fn stems(&self) -> impl Iterator<Item = (&'static str, Vec<usize>)> {
        [("expression", false), ("identity", true)].into_iter().filter_map(|(stem, identity)| {
            let of_stem = |k: &usize| (self.shapes[*k].family == Family::Identity) == identity;
            let chosen: Vec<usize> = (0..self.shapes.len()).filter(of_stem).collect();
            (!chosen.is_empty()).then_some((stem, chosen))
        })
    }

    /// Writes one OBJ file a shape, named after it, whole shapes, with `neutral.obj`, `rig.json` and, if there are any,
    /// `regions.json`. Families and landmarks are not kept. The folder is made if it is not there, and gets all files or none.
    ///
    /// # Errors
    /// When a name is none for a file, or differs from another by case alone, or a file cannot be written.
    pub fn write_meshes(&self, folder: &Path) -> Result<(), WriteError> {
        let mut names: Vec<String> = self.shapes.iter().map(|s| s.name.to_lowercase()).collect();
        names.extend(["neutral", "template"].map(str::to_owned));
        names.sort_unstable();
        let bad = |name: &str| {
            let file = Path::new(name).file_name().is_some_and(|f| f == name);
            !file || name.contains(['/', '\\', ':']) || name.contains(text::is_hidden) || name.starts_with('.')
        };
        if let Some(shape) = self.shapes.iter().find(|s| bad(&s.name)) {
            return Err(WriteError::data(
                folder,
                "shapes whose names can be those of files",
                format!("{:?}", shape.name),
            ));
        }
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(WriteError::data(
                folder,
                "names that differ by more than case",
                format!("{:?} twice", pair[0]),
            ));
        }
        write_folder(folder, |aside| self.write_meshes_into(aside))
    }

    fn write_meshes_into(&self, folder: &Path) -> Result<(), WriteError> {
        let mesh = match &self.mesh {
            Some(mesh) => without_libraries(mesh, &self.neutral),
            None => PolygonMesh { positions: self.neutral.clone(), starts: vec![0], ..PolygonMesh::default() },
        };
        write_obj(&folder.join("neutral.obj"), &mesh)?;
        for (k, shape) in self.shapes.iter().enumerate() {
            let moved = |(n, d): (&Vec3, &[f32])| n + Vec3::new(f64::from(d[0]), f64::from(d[1]), f64::from(d[2]));
            let positions = self.neutral.iter().zip(self.deltas(k).chunks_exact(3)).map(moved).collect();
            write_obj(&folder.join(format!("{}.obj", shape.name)), &mesh.with_positions(positions))?;
        }
        write_json_line(&folder.join("rig.json"), &serde_json::json!({ "kind": "full" }))?;
        self.regions.as_ref().map_or(Ok(()), |regions| regions.write(&folder.join("regions.json")))
    }
}

/// The neutral with its polygons and the names of its materials; their libraries are not where it will be.
fn without_libraries(mesh: &PolygonMesh, neutral: &[Vec3]) -> PolygonMesh {
    let mut mesh = mesh.with_positions(neutral.to_vec());
    mesh.metadata.material_libraries.clear();
    mesh
}

/// Writes a value as JSON on one line: of lists as long as these nobody wants a line for each entry.
pub(super) fn write_json_line(path: &Path, value: &impl serde::Serialize) -> Result<(), WriteError> {
    write_atomically(path, |w| {
        w.write_all(text::json(serde_json::to_string(value)?).as_bytes())?;
        w.write_all(b"\n")
    })
}

#[cfg(test)]
mod tests {
    use super::super::{RigReadOptions, Shape};
    use super::*;
    use crate::mesh::testing::{noise, sheet};

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
        assert!(rig.write(&folder.path().join("no/where")).is_err());
    }
}
