//! Rigs in one NPZ archive, the arrays of the folder layout under the same names:
//!
//! | array | |
//! |---|---|
//! | `neutral` (V, 3) | positions, millimetres |
//! | `expression_deltas` (K, V, 3), `expression_names` (K) | shapes, and the same for `identity_...` |
//! | `polygon_starts` (F + 1), `corners` (C) | polygon `f` is `corners[polygon_starts[f]:polygon_starts[f + 1]]` |
//! | `uvs` (T, 2), `corner_uvs` (C) | texture coordinates and those of the corners, 2^32 - 1 for none |
//! | `landmarks_multipie68` (68), `region_NAME` (n) | vertices |
//!
//! All but `neutral` may be absent. Groups and materials are not kept.

use std::path::Path;

use super::{Family, Regions, Rig, RigError, RigWarning, Shape};
use crate::io::{Npz, NpzContents, Place, ReadError, WriteError};
use crate::mesh::PolygonMesh;

/// Whether an array has one of the names above.
fn is_of_a_rig(name: &str) -> bool {
    let whole = ["neutral", "polygon_starts", "corners", "uvs", "corner_uvs", "landmarks_multipie68"];
    let of_shapes = ["expression_deltas", "expression_names", "identity_deltas", "identity_names"];
    name.starts_with("region_") || whole.contains(&name) || of_shapes.contains(&name)
}

impl Rig {
    /// Writes an `.npz` archive with the arrays above; shapes of no known family go with the expressions.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_npz(&self, path: &Path) -> Result<(), WriteError> {
        let vertices = self.neutral.len();
        let neutral: Vec<f64> = self.neutral.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
        let mut contents = NpzContents::new().with("neutral", &[vertices, 3], &neutral);
        for (stem, chosen) in self.stems() {
            let names: Vec<&str> = chosen.iter().map(|&k| self.shapes[k].name.as_str()).collect();
            let deltas: Vec<f32> = chosen.iter().flat_map(|&k| self.deltas(k)).copied().collect();
            contents = contents
                .with(&format!("{stem}_deltas"), &[chosen.len(), vertices, 3], &deltas)
                .with_text(&format!("{stem}_names"), &names);
        }
        if let Some(mesh) = &self.mesh {
            contents = contents.with("polygon_starts", &[mesh.starts.len()], &mesh.starts).with(
                "corners",
                &[mesh.corners.len()],
                &mesh.corners,
            );
            if !mesh.metadata.corner_uvs.is_empty() {
                let uvs = &mesh.metadata.uvs;
                contents = contents.with("uvs", &[uvs.len(), 2], uvs.as_flattened()).with(
                    "corner_uvs",
                    &[mesh.corners.len()],
                    &mesh.metadata.corner_uvs,
                );
            }
        }
        if let Some(landmarks) = &self.landmarks {
            contents = contents.with("landmarks_multipie68", &[landmarks.len()], landmarks);
        }
        for (name, of_region) in self.regions.iter().flat_map(Regions::entries) {
            contents = contents.with(&format!("region_{name}"), &[of_region.len()], of_region);
        }
        contents.write(path)
    }

    /// Reads an `.npz` archive with the arrays above.
    ///
    /// # Errors
    /// When the file cannot be read, or arrays do not fit together.
    pub(super) fn read_npz(path: &Path, identity_modes: usize) -> Result<(Self, Vec<RigWarning>), RigError> {
        let mut npz = Npz::open(path)?;
        let arrays = npz.names();
        let has = |name: &str| arrays.iter().any(|a| a == name);
        let neutral = npz.points("neutral")?;
        let vertices = neutral.len();
        let (mut shapes, mut deltas) = (Vec::new(), Vec::new());
        for (stem, family, most) in
            [("expression", Family::Expression, usize::MAX), ("identity", Family::Identity, identity_modes)]
        {
            let (of_deltas, of_names) = (format!("{stem}_deltas"), format!("{stem}_names"));
            if !has(&of_deltas) {
                continue;
            }
            let names = npz.array(&of_names)?.read_text()?;
            let array = npz.array(&of_deltas)?;
            array.expect_shape(&[Some(names.len()), Some(vertices), Some(3)])?;
            let read = array.read_f32_rows(most)?;
            if deltas.is_empty() {
                deltas = read
            } else {
                deltas.extend(read)
            }
            shapes.extend(names.into_iter().take(most).map(|name| Shape { name, family }));
        }
        let mut indices = |name: &str, limit: usize, none: bool| -> Result<Vec<u32>, ReadError> {
            let array = npz.array(name)?;
            array.expect_shape(&[None])?;
            let values = array.read_f64()?;
            let fits =
                |v: &f64| v.fract() == 0.0 && *v >= 0.0 && (*v < limit as f64 || none && *v == f64::from(u32::MAX));
            match values.iter().find(|v| !fits(v)) {
                None => Ok(values.into_iter().map(|v| v as u32).collect()),
                Some(v) => {
                    let (expected, found) = (format!("whole numbers below {limit} in array {name:?}"), v.to_string());
                    Err(ReadError::malformed(path, Place::File, expected, found))
                }
            }
        };
        let mut mesh = None;
        if has("polygon_starts") {
            let corners = indices("corners", vertices, false)?;
            let starts = indices("polygon_starts", corners.len() + 1, false)?;
            let whole = starts.first() == Some(&0) && starts.last() == Some(&(corners.len() as u32));
            if !whole || starts.windows(2).any(|pair| pair[1] < pair[0].saturating_add(3)) {
                let expected = format!("polygon_starts from 0 to {}, at least 3 apart", corners.len());
                return Err(ReadError::malformed(path, Place::File, expected, "others").into());
            }
            mesh = Some(PolygonMesh { positions: neutral.clone(), starts, corners, ..PolygonMesh::default() });
        }
        let mut regions = Vec::new();
        for array in &arrays {
            if let Some(name) = array.strip_prefix("region_") {
                regions.push((name.to_owned(), indices(array, vertices, false)?));
            }
        }
        let landmarks =
            has("landmarks_multipie68").then(|| indices("landmarks_multipie68", vertices, false)).transpose()?;
        if let Some(mesh) = mesh.as_mut().filter(|_| has("corner_uvs")) {
            let corner_uvs = indices("corner_uvs", u32::MAX as usize, true)?;
            let array = npz.array("uvs")?;
            array.expect_shape(&[None, Some(2)])?;
            let uvs: Vec<[f64; 2]> = array.read_f64()?.as_chunks().0.to_vec();
            let known = |uv: &u32| *uv == u32::MAX || (*uv as usize) < uvs.len();
            if corner_uvs.len() != mesh.corners.len()
                || !corner_uvs.iter().all(known)
                || !uvs.iter().flatten().all(|x| x.is_finite())
            {
                let expected = format!("corner_uvs of {} corners that index finite uvs", mesh.corners.len());
                return Err(ReadError::malformed(path, Place::File, expected, "others").into());
            }
            (mesh.metadata.uvs, mesh.metadata.corner_uvs) = (uvs, corner_uvs);
        }
        let (mut rig, mut warnings) = Rig::new(neutral, mesh, shapes, deltas)?;
        let unread: Vec<String> = arrays.iter().filter(|name| !is_of_a_rig(name)).cloned().collect();
        if !unread.is_empty() {
            warnings.push(RigWarning::UnreadArrays { names: unread });
        }
        rig.landmarks = landmarks;
        rig.regions = (!regions.is_empty()).then(|| Regions::checked(path, regions, vertices)).transpose()?;
        Ok((rig, warnings))
    }
}
