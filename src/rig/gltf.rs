//! Rigs in glTF: a mesh whose morph targets are the shapes. Families, landmarks and regions go into `extras`.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Family, Regions, Rig, RigError, RigWarning, Shape};
use crate::io::{GltfMesh, Place, ReadError, WriteError, read_gltf, write_glb};
use crate::mesh::PolygonMesh;

/// What a rig has beside its mesh and the differences of its shapes.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct Extras {
    families: Vec<Family>,
    #[serde(skip_serializing_if = "Option::is_none")]
    landmarks: Option<Vec<u32>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    regions: Option<Vec<(String, Vec<u32>)>>,
}

impl Rig {
    /// Writes a `.glb` file: the neutral, and a morph target for each shape, with `extras.targetNames`. Positions are
    /// rounded to 32 bits of a metre.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_gltf(&self, path: &Path) -> Result<(), WriteError> {
        let extras = Extras {
            families: self.shapes.iter().map(|s| s.family).collect(),
            landmarks: self.landmarks.clone(),
            regions: self.regions.as_ref().map(|r| r.entries().to_vec()),
        };
        let extras = match serde_json::to_value(&extras) {
            Ok(Value::Object(extras)) => extras,
            _ => Map::new(), // a struct of lists is an object
        };
        let names: Vec<&str> = self.shapes.iter().map(|s| s.name.as_str()).collect();
        let mesh = match &self.mesh {
            Some(mesh) => mesh.with_positions(self.neutral.clone()),
            None => PolygonMesh { positions: self.neutral.clone(), starts: vec![0], ..PolygonMesh::default() },
        };
        write_glb(path, &mesh, &names, &self.deltas, &extras)
    }

    /// Reads a `.glb` or `.gltf` file. Shapes are of no known family, unless [`write_gltf`](Self::write_gltf) has said.
    ///
    /// # Errors
    /// When the file cannot be read or is malformed.
    pub(super) fn read_gltf(path: &Path) -> Result<(Self, Vec<RigWarning>), RigError> {
        let GltfMesh { mesh, target_names, target_deltas, extras, .. } = read_gltf(path)?;
        let malformed = |expected: &str, found: String| ReadError::malformed(path, Place::File, expected, found);
        let extras: Extras = serde_json::from_value(Value::Object(extras))
            .map_err(|e| malformed("families, landmarks and regions in extras.nonrigid.extras", e.to_string()))?;
        let (shapes, families) = (target_names.len(), extras.families.len());
        if families != 0 && families != shapes {
            return Err(malformed(&format!("families of {shapes} shapes"), families.to_string()).into());
        }
        let count = mesh.positions.len();
        let family = |k: usize| extras.families.get(k).copied().unwrap_or(Family::Other);
        let shapes = target_names.into_iter().enumerate().map(|(k, name)| Shape { name, family: family(k) }).collect();
        let neutral = mesh.positions.clone();
        let (mut rig, warnings) =
            Rig::new(neutral, Some(mesh).filter(|m| m.polygon_count() > 0), shapes, target_deltas)?;
        if let Some(v) = extras.landmarks.iter().flatten().find(|&&v| v as usize >= count) {
            return Err(malformed(&format!("landmarks below {count}"), v.to_string()).into());
        }
        rig.landmarks = extras.landmarks;
        rig.regions = extras.regions.map(|regions| Regions::checked(path, regions, count)).transpose()?;
        Ok((rig, warnings))
    }
}
