//! What lies beside a rig that is read and no [`Rig`] holds: landmarks by name, and materials of its mesh. It goes along where the rig,
//! or one that is made of it, is written.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{Family, Rig, ShapePca};
use crate::io::{MaterialFiles, WriteError, read_file, write_json, write_obj};
use crate::mesh::ObjStatement;

/// Files of a rig's folder that no [`Rig`] holds: vertices by the names of landmarks, as `measure` and `register` read them.
pub const NAMED_LANDMARKS: [&str; 2] = ["landmarks.json", "landmarks_anthropometric.json"];

/// The 68 landmarks, which a [`Rig`] holds where it reads a folder of arrays.
const NUMBERED_LANDMARKS: &str = "landmarks_multipie68.json";

/// How a rig is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RigForm {
    /// [`Rig::write`]: a folder of arrays.
    Arrays,
    /// [`Rig::write_meshes`]: a folder of one mesh a shape.
    Meshes,
    /// [`Rig::write_npz`].
    Npz,
    /// [`Rig::write_gltf`].
    Gltf,
}

impl RigForm {
    /// The mesh of the neutral in a folder of this form, which materials go beside; none of a form that is one file.
    #[must_use]
    pub fn mesh_in(self, folder: &Path) -> Option<PathBuf> {
        match self {
            Self::Arrays => Some(folder.join("template.obj")),
            Self::Meshes => Some(folder.join("neutral.obj")),
            Self::Npz | Self::Gltf => None,
        }
    }
}

/// What goes along with a rig.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Companions {
    /// The mesh file whose materials go along; empty for none.
    pub mesh: PathBuf,
    /// Files of landmarks and what is in them; `None` of one that cannot be read.
    pub landmarks: Vec<(PathBuf, Option<Vec<u8>>)>,
}

impl Companions {
    /// What lies beside a rig that is read from `path`; nothing unless that is a folder.
    #[must_use]
    pub fn of(path: &Path) -> Self {
        let there = |names: &[&str]| -> Vec<PathBuf> {
            names.iter().map(|name| path.join(name)).filter(|file| file.is_file()).collect()
        };
        let landmarks = there(&[NUMBERED_LANDMARKS, NAMED_LANDMARKS[0], NAMED_LANDMARKS[1]]).into_iter();
        Self {
            mesh: there(&["template.obj", "neutral.obj"]).into_iter().next().unwrap_or_default(),
            landmarks: landmarks.map(|file| (file.clone(), read_file(&file).ok())).collect(),
        }
    }

    /// The materials that a rig has where it is written to `path`.
    #[must_use]
    pub fn materials(&self, rig: &Rig, path: &Path, form: RigForm) -> MaterialFiles {
        match (form.mesh_in(path), rig.mesh()) {
            (Some(_), Some(mesh)) if !self.mesh.as_os_str().is_empty() => MaterialFiles::of(&self.mesh, mesh),
            _ => MaterialFiles::default(),
        }
    }

    /// Without landmarks in space, which do not lie on another neutral; and what is to be said of those.
    #[must_use]
    pub fn of_vertices(&self) -> (Self, Vec<String>) {
        let (kept, left): (Vec<_>, Vec<_>) =
            self.landmarks.iter().cloned().partition(|(path, text)| is_numbered(path) || vertices(text).is_some());
        let told =
            |(path, _): &(PathBuf, _)| format!("{}: not taken along, since not all of it are vertices", path.display());
        (Self { landmarks: kept, ..self.clone() }, left.iter().map(told).collect())
    }

    /// Writes a rig with these [`materials`](Self::materials) and landmarks, and the [components](ShapePca::write_components) that it
    /// was made of, if any. Returns what is to be said of that: what the form does not hold.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(
        &self,
        rig: &Rig,
        pca: Option<&ShapePca>,
        path: &Path,
        form: RigForm,
        materials: &MaterialFiles,
    ) -> Result<Vec<String>, WriteError> {
        match (form, pca) {
            (RigForm::Arrays, Some(pca)) => pca.write_with(rig, path),
            (RigForm::Arrays, None) => rig.write(path),
            (RigForm::Meshes, _) => rig.write_meshes(path),
            (RigForm::Npz, _) => rig.write_npz(path),
            (RigForm::Gltf, _) => rig.write_gltf(path),
        }?;
        let mut notes = Vec::new();
        let mut lost = |what: String| notes.push(format!("{}: this form of a rig holds no {what}", path.display()));
        let meshes = form == RigForm::Meshes;
        if meshes && rig.shapes().iter().any(|s| s.family == Family::Identity) {
            lost("families: identity modes are shapes like all others there".to_owned());
        }
        if meshes && rig.landmarks().is_some() {
            lost("landmarks".to_owned());
        }
        if pca.is_some() && form != RigForm::Arrays {
            lost("components with their standard deviations".to_owned());
        }
        let named = || self.landmarks.iter().filter(|(path, _)| !is_numbered(path));
        if form.mesh_in(path).is_none() && named().next().is_some() {
            let names: Vec<_> =
                named().map(|(path, _)| path.file_name().unwrap_or_default().to_string_lossy()).collect();
            lost(format!("named landmarks: {}", names.join(", ")));
        }
        if form == RigForm::Npz && rig.mesh().is_some_and(|m| !m.metadata.statements.is_empty()) {
            lost("groups and materials".to_owned());
        }
        let is_material = |(_, statement): &(u32, ObjStatement)| matches!(statement, ObjStatement::Material(_));
        let has_materials = rig.mesh().is_some_and(|mesh| mesh.metadata.statements.iter().any(is_material));
        if form == RigForm::Gltf && has_materials && !self.mesh.as_os_str().is_empty() {
            lost("colours and images of materials, their names alone".to_owned());
        }
        if let Some(file) = form.mesh_in(path) {
            bring_materials(rig, &file, materials)?;
            let (kept, left) = self.of_vertices();
            notes.extend(left);
            for (of_rig, text) in kept.landmarks.iter().filter(|(path, _)| !is_numbered(path)) {
                write_json(&file.with_file_name(of_rig.file_name().unwrap_or_default()), &vertices(text))?;
            }
        }
        Ok(notes)
    }
}

fn is_numbered(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == NUMBERED_LANDMARKS)
}

/// Landmarks that all are vertices.
fn vertices(text: &Option<Vec<u8>>) -> Option<BTreeMap<String, u32>> {
    serde_json::from_slice(text.as_deref()?).ok()
}

/// Copies materials beside the mesh of a rig that was written to `out`, which then names them.
fn bring_materials(rig: &Rig, out: &Path, materials: &MaterialFiles) -> Result<(), WriteError> {
    let Some(mesh) = rig.mesh().filter(|_| !materials.is_empty()) else { return Ok(()) };
    let mut mesh = mesh.with_positions(rig.neutral().to_vec());
    let copied = materials.write(out, &mut mesh)?;
    write_obj(out, &mesh)?;
    copied.keep();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;
    use crate::mesh::{PolygonMesh, Vec3};
    use crate::rig::RigReadOptions;

    #[test]
    fn what_no_rig_holds_goes_along() {
        let folder = tempfile::tempdir().unwrap();
        let [from, to] = ["from", "to"].map(|name| folder.path().join(name));
        let mut mesh = PolygonMesh::from(sheet(3, 2, |x, y| Vec3::new(100.0 * x, 100.0 * y, 1.0)));
        Rig::new(mesh.positions.clone(), Some(mesh.clone()), Vec::new(), Vec::new()).unwrap().0.write(&from).unwrap();
        mesh.metadata.material_libraries = vec!["template.mtl".to_owned()];
        write_obj(&from.join("template.obj"), &mesh).unwrap();
        std::fs::write(from.join("template.mtl"), "newmtl skin\n").unwrap();
        std::fs::write(from.join("landmarks.json"), r#"{"tip": 3}"#).unwrap();
        std::fs::write(from.join("landmarks_anthropometric.json"), r#"{"nasion": [1.0, 2.0, 3.0]}"#).unwrap();

        let (rig, _) = Rig::read(&from, &RigReadOptions::default()).unwrap();
        let companions = Companions::of(&from);
        let materials = companions.materials(&rig, &to, RigForm::Arrays);
        let notes = companions.write(&rig, None, &to, RigForm::Arrays, &materials).unwrap();
        assert_eq!(notes.len(), 1, "{notes:?}");
        assert!(notes[0].contains("landmarks_anthropometric.json: not taken along"), "{notes:?}");
        let text = |name: &str| std::fs::read_to_string(to.join(name)).unwrap();
        assert_eq!(text("template.mtl"), "newmtl skin\n");
        assert!(text("template.obj").starts_with("mtllib template.mtl\n"));
        assert!(text("landmarks.json").contains(r#""tip": 3"#));
        assert!(!to.join("landmarks_anthropometric.json").exists());

        let file = folder.path().join("rig.npz");
        let notes = companions.write(&rig, None, &file, RigForm::Npz, &MaterialFiles::default()).unwrap();
        assert!(notes[0].contains("no named landmarks: landmarks.json, landmarks_anthropometric.json"), "{notes:?}");
    }
}
