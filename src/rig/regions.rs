//! Named regions of a template: `regions.json` of a rig, `{"name": [vertex, ...], ...}`, or the groups of an OBJ file.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::path::Path;

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};

use super::read::read_json;
use super::write::write_json_line;
use super::{Rig, RigError};
use crate::io::{Place, ReadError, WriteError};
use crate::mesh::PolygonMesh;
use crate::text::{self, LONGEST_NAME};

/// Sets of a template's vertices by name. A vertex may belong to any number of them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Regions {
    vertex_count: usize,
    regions: Vec<(String, Vec<u32>)>,
    /// Of groups of a mesh the polygons of each; otherwise nothing.
    polygons: Vec<Vec<u32>>,
}

impl Regions {
    /// Reads a file of regions of a template with `vertex_count` vertices.
    ///
    /// # Errors
    /// When the file cannot be read or is not of the form above, a name comes twice, or there is no such vertex.
    pub fn read(path: &Path, vertex_count: usize) -> Result<Self, ReadError> {
        let File(regions) = read_json(path, "{\"name\": [vertex, ...], ...}")?;
        Self::checked(path, regions, vertex_count)
    }

    /// Regions of a template with `vertex_count` vertices, by name.
    ///
    /// # Errors
    /// When a name comes twice or there is no such vertex.
    pub fn new(vertex_count: usize, regions: Vec<(String, Vec<u32>)>) -> Result<Self, ReadError> {
        Self::checked(Path::new("regions"), regions, vertex_count)
    }

    /// Vertices of the template.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// Regions of a file.
    ///
    /// # Errors
    /// When a name comes twice or there is no such vertex.
    pub(super) fn checked(
        path: &Path,
        regions: Vec<(String, Vec<u32>)>,
        vertex_count: usize,
    ) -> Result<Self, ReadError> {
        let malformed = |expected: String, found: String| Err(ReadError::malformed(path, Place::File, expected, found));
        let mut known = HashSet::new();
        for (name, vertices) in &regions {
            if name.chars().nth(LONGEST_NAME).is_some() {
                return malformed(
                    format!("names of at most {LONGEST_NAME} letters"),
                    format!("{:?}", text::short(name)),
                );
            }
            if !known.insert(name) {
                return malformed("every region once".into(), format!("{name:?} twice"));
            }
            if let Some(v) = vertices.iter().find(|v| **v as usize >= vertex_count) {
                return malformed(format!("vertex indices below {vertex_count} in region {name:?}"), v.to_string());
            }
        }
        Ok(Self { vertex_count, regions, polygons: Vec::new() })
    }

    /// The regions of a rig or, without any, the groups of a mesh.
    #[must_use]
    pub fn of(rig: Option<&Rig>, mesh: &PolygonMesh) -> Self {
        rig.and_then(Rig::regions).cloned().unwrap_or_else(|| Self::of_groups(mesh))
    }

    /// The groups of a mesh (`g` of an OBJ file, which may name several at once) with the vertices of their polygons.
    #[must_use]
    pub fn of_groups(mesh: &PolygonMesh) -> Self {
        let mut regions: Vec<(String, Vec<u32>)> = Vec::new();
        let mut polygons: Vec<Vec<u32>> = Vec::new();
        let mut known: HashMap<&str, usize> = HashMap::new();
        for (names, of_group) in mesh.groups() {
            for name in names.split_whitespace() {
                let at = *known.entry(name).or_insert(regions.len());
                if at == regions.len() {
                    regions.push((name.to_owned(), Vec::new()));
                    polygons.push(Vec::new());
                }
                regions[at].1.extend(of_group.clone().flat_map(|f| mesh.polygon(f)));
                polygons[at].extend(of_group.clone().map(|f| f as u32));
            }
        }
        for indices in regions.iter_mut().map(|r| &mut r.1).chain(&mut polygons) {
            indices.sort_unstable();
            indices.dedup();
        }
        Self { vertex_count: mesh.positions.len(), regions, polygons }
    }

    /// Writes the file that [`Regions::read`] reads.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        write_json_line(path, &InOrder(&self.regions))
    }

    /// Names and vertices, in the order of the file.
    pub(super) fn entries(&self) -> &[(String, Vec<u32>)] {
        &self.regions
    }

    /// Names, in the order of the file.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.regions.iter().map(|r| r.0.as_str())
    }

    /// Vertices of a region, if there is one of that name.
    #[must_use]
    pub fn vertices(&self, name: &str) -> Option<&[u32]> {
        self.regions.iter().find(|r| r.0 == name).map(|r| r.1.as_slice())
    }

    /// Polygons of a region, if it is a group of a mesh.
    #[must_use]
    pub fn polygons(&self, name: &str) -> Option<&[u32]> {
        let at = self.regions.iter().position(|r| r.0 == name)?;
        self.polygons.get(at).map(Vec::as_slice)
    }

    /// The same regions on a mesh of so many vertices, where `vertex` says which each one is there.
    pub(crate) fn on(&self, vertex_count: usize, vertex: impl Fn(u32) -> u32) -> Self {
        let moved = |(name, vertices): &(String, Vec<u32>)| {
            let mut vertices: Vec<u32> = vertices.iter().map(|&v| vertex(v)).collect();
            vertices.sort_unstable();
            vertices.dedup();
            (name.clone(), vertices)
        };
        Self { vertex_count, regions: self.regions.iter().map(moved).collect(), polygons: Vec::new() }
    }

    /// A mask, one number per vertex: 1 in the regions of these names, 0 elsewhere.
    ///
    /// # Errors
    /// When there is no region of a name: the message lists those there are.
    pub fn mask(&self, names: &[String]) -> Result<Vec<f64>, RigError> {
        let mut mask = vec![0.0; self.vertex_count];
        for name in names {
            self.named(name)?.iter().for_each(|&v| mask[v as usize] = 1.0);
        }
        Ok(mask)
    }

    /// Vertices of a region that somebody asked for.
    ///
    /// # Errors
    /// As [`mask`](Self::mask).
    pub fn named(&self, name: &str) -> Result<&[u32], RigError> {
        self.vertices(name).ok_or_else(|| {
            let known = match self.names().collect::<Vec<_>>().join(", ") {
                known if known.is_empty() => "none, neither in a rig's regions.json nor as groups".to_owned(),
                known => known,
            };
            RigError::UnknownRegion { name: name.to_owned(), known }
        })
    }

    /// Of each of so many vertices the product of the `factors` of the regions that it is in; 1 outside of all.
    ///
    /// # Errors
    /// As [`mask`](Self::mask).
    pub(crate) fn products(&self, factors: &BTreeMap<String, f64>, vertices: usize) -> Result<Vec<f64>, RigError> {
        let mut products = vec![1.0; vertices];
        for (name, factor) in factors {
            self.named(name)?.iter().for_each(|v| products[*v as usize] *= factor);
        }
        Ok(products)
    }
}

/// Regions as an object whose entries keep their order.
struct InOrder<'a>(&'a [(String, Vec<u32>)]);

impl serde::Serialize for InOrder<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, vertices)| (name, vertices)))
    }
}

/// The file as it stands, a name that comes twice included.
struct File(Vec<(String, Vec<u32>)>);

impl<'de> Deserialize<'de> for File {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = File;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of named arrays of vertex indices")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<File, M::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(File(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::parse_obj;

    fn read(text: &str) -> Result<Regions, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("regions.json");
        std::fs::write(&path, text).unwrap();
        Regions::read(&path, 5).map_err(|e| e.to_string())
    }

    #[test]
    fn files_give_masks() {
        let regions = read("{\"nose\": [0, 2], \"empty\": [], \"mouth\": [2, 4]}").unwrap();
        assert_eq!(regions.names().collect::<Vec<_>>(), ["nose", "empty", "mouth"]);
        assert_eq!(regions.vertices("mouth"), Some(&[2, 4][..]));
        assert_eq!(regions.mask(&["nose".into(), "mouth".into()]).unwrap(), [1.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(regions.mask(&[]).unwrap(), [0.0; 5]);
        let message = regions.mask(&["nose".into(), "nosee".into()]).unwrap_err().to_string();
        assert!(message.contains("nosee") && message.contains("nose, empty, mouth"), "{message}");
        let message = Regions::default().mask(&["nose".into()]).unwrap_err().to_string();
        assert!(message.contains("known regions: none"), "{message}");
    }

    #[test]
    fn malformed_files_are_named() {
        for (text, word) in [
            ("", "line 1"),
            ("[1, 2]", "named arrays"),
            ("{\"nose\": 3}", "line 1"),
            ("{\"nose\": [-3]}", "-3"),
            ("{\"nose\": [0.5]}", "0.5"),
            ("{\"nose\": [1, 5]}", "below 5 in region \"nose\""),
            ("{\"nose\": [1], \"nose\": [2]}", "\"nose\" twice"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains("regions.json") && message.contains(word), "{text}: {message}");
        }
    }

    #[test]
    fn groups_of_an_obj_are_regions() {
        let text =
            "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 2 2\nf 1 2 3\ng skin lip\nf 1 3 4\ng eye\ng skin\nf 1 4 5\n";
        let regions = Regions::of_groups(&parse_obj(text.as_bytes(), Path::new("t.obj")).unwrap());
        assert_eq!(regions.names().collect::<Vec<_>>(), ["skin", "lip", "eye"]);
        assert_eq!(regions.vertices("skin"), Some(&[0, 2, 3, 4][..]));
        assert_eq!(regions.vertices("lip"), Some(&[0, 2, 3][..]));
        assert_eq!((regions.vertices("eye"), regions.vertices("nose")), (Some(&[][..]), None));
        assert_eq!((regions.polygons("skin"), regions.polygons("lip")), (Some(&[1, 2][..]), Some(&[1][..])));
        assert_eq!((regions.polygons("eye"), regions.polygons("nose")), (Some(&[][..]), None));
    }
}
