//! A polygon mesh as an artist's file holds it: any number of corners a face, UVs with seams, groups and materials.

use std::collections::HashMap;

use super::normals::{face_cross, unit};
use super::{TriangleMesh, Vec3, referenced};

/// Vertices and polygons, with whatever an OBJ file says about them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PolygonMesh {
    /// Vertex positions, millimetres.
    pub positions: Vec<Vec3>,
    /// Start of each polygon in `corners`, plus one past the end: polygon `f` is `corners[starts[f]..starts[f + 1]]`.
    pub starts: Vec<u32>,
    /// Vertex index of every polygon corner, counter-clockwise seen from outside.
    pub corners: Vec<u32>,
    /// What the file said besides: carried through to the output untouched.
    pub metadata: ObjMetadata,
}

/// Everything in an OBJ file that is not geometry and must survive a round trip.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjMetadata {
    /// Texture coordinates (`vt`), two each.
    pub uvs: Vec<[f64; 2]>,
    /// Texture index of each corner; empty when no face has any, `u32::MAX` for a corner without one.
    pub corner_uvs: Vec<u32>,
    /// Which corners of a vertex share a normal: those of one number. Empty when no face has any, `u32::MAX` for a corner without one.
    /// So hard edges stay hard on another shape, where the file's own normals (`vn`) mean nothing.
    pub corner_normals: Vec<u32>,
    /// Material libraries (`mtllib`), in order.
    pub material_libraries: Vec<String>,
    /// `o`, `g`, `usemtl` and `s` statements with the polygon before which each stands, in file order.
    pub statements: Vec<(u32, ObjStatement)>,
}

/// A statement that applies to the faces after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ObjStatement {
    /// `o name`
    Object(String),
    /// `g names`
    Group(String),
    /// `usemtl name`
    Material(String),
    /// `s value`
    Smoothing(String),
}

impl ObjStatement {
    /// Keyword and what follows it.
    pub(crate) fn parts(&self) -> (&'static str, &str) {
        match self {
            Self::Object(rest) => ("o", rest),
            Self::Group(rest) => ("g", rest),
            Self::Material(rest) => ("usemtl", rest),
            Self::Smoothing(rest) => ("s", rest),
        }
    }

    /// The statement of a keyword, if it is one of the four.
    pub(crate) fn from_parts(keyword: &str, rest: String) -> Option<Self> {
        match keyword {
            "o" => Some(Self::Object(rest)),
            "g" => Some(Self::Group(rest)),
            "usemtl" => Some(Self::Material(rest)),
            "s" => Some(Self::Smoothing(rest)),
            _ => None,
        }
    }
}

impl PolygonMesh {
    /// Which vertices are of a polygon; all where there is none.
    #[must_use]
    pub fn on_surface(&self) -> Vec<bool> {
        referenced(self.positions.len(), self.corners.iter().copied())
    }

    /// Number of polygons.
    #[must_use]
    pub fn polygon_count(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Corner vertex indices of polygon `f`.
    #[must_use]
    pub fn polygon(&self, f: usize) -> &[u32] {
        &self.corners[self.starts[f] as usize..self.starts[f + 1] as usize]
    }

    /// What each `g` statement says, and the polygons up to the next one.
    pub fn groups(&self) -> impl Iterator<Item = (&str, std::ops::Range<usize>)> {
        let named = self.metadata.statements.iter().filter_map(|(first, statement)| match statement {
            ObjStatement::Group(names) => Some((names.as_str(), *first as usize)),
            _ => None,
        });
        let ends = named.clone().skip(1).map(|g| g.1).chain([self.polygon_count()]);
        named.zip(ends).map(|((names, first), end)| (names, first..end))
    }

    /// Normals of the corners on this shape, by area over the polygons that share one, and the index of each corner's, `u32::MAX` for
    /// none; nothing of a mesh without [`ObjMetadata::corner_normals`].
    #[must_use]
    pub fn corner_normals(&self) -> (Vec<Vec3>, Vec<u32>) {
        let (mut normals, mut of_corner) = (Vec::new(), Vec::with_capacity(self.metadata.corner_normals.len()));
        let mut known: HashMap<(u32, u32), u32> = HashMap::new();
        for f in (0..self.polygon_count()).filter(|_| !self.metadata.corner_normals.is_empty()) {
            let polygon = self.polygon(f);
            let cross: Vec3 = fan(polygon).map(|triangle| face_cross(&self.positions, triangle)).sum();
            for (c, &vertex) in (self.starts[f] as usize..).zip(polygon) {
                let shared = self.metadata.corner_normals.get(c).copied().unwrap_or(u32::MAX);
                if shared == u32::MAX {
                    of_corner.push(u32::MAX);
                    continue;
                }
                let index = *known.entry((vertex, shared)).or_insert_with(|| {
                    normals.push(Vec3::zeros());
                    normals.len() as u32 - 1
                });
                normals[index as usize] += cross;
                of_corner.push(index);
            }
        }
        let safe = |n: Vec3| Some(unit(n)).filter(|n| *n != Vec3::zeros()).unwrap_or_else(Vec3::z);
        normals.iter_mut().for_each(|n| *n = safe(*n));
        (normals, of_corner)
    }

    /// Fan triangulation `(q0, q_i, q_i+1)` of every polygon, in order; vertices are shared with `self`.
    #[must_use]
    pub fn triangulate(&self) -> TriangleMesh {
        TriangleMesh { positions: self.positions.clone(), triangles: self.fan() }
    }

    /// As [`Self::triangulate`], without copying the positions.
    #[must_use]
    pub fn into_triangles(self) -> TriangleMesh {
        TriangleMesh { triangles: self.fan(), positions: self.positions }
    }

    fn fan(&self) -> Vec<[u32; 3]> {
        let mut triangles = Vec::with_capacity(self.corners.len().saturating_sub(2 * self.polygon_count()));
        for f in 0..self.polygon_count() {
            triangles.extend(fan(self.polygon(f)));
        }
        triangles
    }

    /// The same polygons, texture coordinates, groups and materials on other positions.
    ///
    /// # Panics
    /// When the number of positions differs.
    #[must_use]
    pub fn with_positions(&self, positions: Vec<Vec3>) -> Self {
        assert_eq!(positions.len(), self.positions.len(), "positions of another mesh");
        let Self { starts, corners, metadata, .. } = self;
        Self { positions, starts: starts.clone(), corners: corners.clone(), metadata: metadata.clone() }
    }
}

impl From<TriangleMesh> for PolygonMesh {
    fn from(mesh: TriangleMesh) -> Self {
        Self {
            starts: (0..=mesh.triangles.len() as u32).map(|f| 3 * f).collect(),
            corners: mesh.triangles.into_iter().flatten().collect(),
            positions: mesh.positions,
            metadata: ObjMetadata::default(),
        }
    }
}

/// Triangles of a polygon, all from its first corner.
fn fan(q: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    (1..q.len().saturating_sub(1)).map(move |i| [q[0], q[i], q[i + 1]])
}
