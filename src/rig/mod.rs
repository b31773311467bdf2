//! A face rig: a neutral mesh and shapes that add to it, with the vertices of equation (4) of Klimov 2020,
//! b_i(w) = n_i + sum_k w_k (s_i^k - n_i).
//!
//! A [`Rig`] is what the files hold, in 32 bits; [`Rig::select`] takes out the shapes that a fit uses, as the slab of
//! 64-bit numbers that the solver reads. Identity modes come from a [`Population`] of meshes by [`ShapePca`]; [`Rig::transfer`] makes a
//! personal rig, [`WeightFitter`] finds the weights of registered meshes. Stands on [`crate::mesh`] and [`crate::nlls`].

mod arkit;
mod basis;
mod companions;
mod error;
mod fit;
mod gltf;
mod likeness;
mod npz;
mod pca;
mod population;
mod read;
mod regions;
mod subdivide;
mod transfer;
mod write;

pub use basis::ShapeBasis;
pub use companions::{Companions, NAMED_LANDMARKS, RigForm};
pub use error::{RigError, RigWarning};
pub use fit::{FittedFrame, WeightFitOptions, WeightFitter};
pub use likeness::{Unlike, check_order};
pub use pca::{COMPONENT_FILES, ShapePca};
pub use population::{Population, PopulationError};
#[cfg(feature = "cli")]
pub(crate) use read::is_folder_of_shapes;
pub use read::{RigReadOptions, ShapeKind, mesh_files};
pub use regions::Regions;
pub use subdivide::SubdivideError;
pub use transfer::{TransferError, TransferOptions};
pub use write::RIG_FILES;

use std::borrow::Cow;
use std::path::Path;

use rayon::prelude::*;

use crate::io::{LARGEST_COORDINATE, Place, ReadError};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3, bounding_box_diagonal, sewn_unless_opened, surface_points};
use crate::text::{self, LONGEST_NAME};

/// A vertex counts as moved, and a shape as one that moves something, beyond this share of the neutral's bounding-box
/// diagonal: a fraction of a micrometre on a face, below what the files' 32 bits resolve.
pub const MOTIONLESS_SHARE: f64 = 1e-6;

/// A shape moves no vertex farther than this many times the neutral's bounding-box diagonal.
pub const FARTHEST_SHARE: f64 = 100.0;

/// What a shape describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Family {
    /// A facial expression: weight 0 is the neutral, 1 the full expression.
    Expression,
    /// A mode of how faces differ, scaled by its standard deviation.
    Identity,
    /// Not known.
    Other,
}

/// Name and family of a shape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shape {
    /// Unique in the rig.
    pub name: String,
    /// What it describes.
    pub family: Family,
}

impl Shape {
    /// Whether its weight is meant to lie between 0 and 1: an expression with one of ARKit's names.
    #[must_use]
    pub fn from_zero_to_one(&self) -> bool {
        self.family != Family::Identity && arkit::from_zero_to_one(&self.name)
    }
}

/// A neutral mesh and the differences of shapes to it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rig {
    neutral: Vec<Vec3>,
    mesh: Option<PolygonMesh>,
    shapes: Vec<Shape>,
    /// Shape by shape, vertex by vertex, x y z: millimetres.
    deltas: Vec<f32>,
    motionless: Vec<String>,
    landmarks: Option<Vec<u32>>,
    regions: Option<Regions>,
}

/// How many identity modes are used where nobody says: the first say most of how people differ. More of them
/// explain other people of the rig's own kind better and those of another kind worse.
pub const IDENTITY_MODES: usize = 60;

/// Which shapes a fit uses.
#[derive(Debug, Clone, Copy, Default)]
pub struct ShapeSelection<'a> {
    /// Names of shapes in the order of their weights; `None` for all that are not identity modes, in the rig's order.
    pub names: Option<&'a [String]>,
    /// How many of the first identity modes follow them.
    pub identity_modes: usize,
}

/// What a shape moves.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ShapeInfo {
    /// Its name.
    pub name: String,
    /// What it describes.
    pub family: Family,
    /// Vertices that move by more than [`MOTIONLESS_SHARE`] of the diagonal.
    pub moved_vertices: usize,
    /// The longest way of a vertex at weight 1, millimetres.
    pub max_displacement: f64,
}

impl Rig {
    /// A rig from its parts: `deltas` shape by shape, vertex by vertex, x y z. Shapes that move nothing are dropped and
    /// reported.
    ///
    /// # Errors
    /// When lengths do not fit, a number is not finite, a displacement is longer than [`FARTHEST_SHARE`] allows, a name comes twice or
    /// is longer than [`LONGEST_NAME`], or a polygon mesh has another number of vertices.
    pub fn new(
        neutral: Vec<Vec3>,
        mesh: Option<PolygonMesh>,
        shapes: Vec<Shape>,
        deltas: Vec<f32>,
    ) -> Result<(Self, Vec<RigWarning>), RigError> {
        let width = 3 * neutral.len();
        if let Some(mesh) = mesh.as_ref().filter(|m| m.positions.len() != neutral.len()) {
            let (found, expected) = (mesh.positions.len(), neutral.len());
            return Err(RigError::VertexCount { what: "the polygon mesh".into(), found, expected });
        }
        if let Some(v) = neutral.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(RigError::NotFinite { what: "the neutral".into(), vertex: v });
        }
        if deltas.len() != width * shapes.len() {
            let what = format!("the differences of {} shapes", shapes.len());
            let (found, expected) = (deltas.len() / 3, width / 3 * shapes.len());
            return Err(RigError::VertexCount { what, found, expected });
        }
        let mut names: Vec<&str> = shapes.iter().map(|s| s.name.as_str()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(RigError::DuplicateName { name: pair[0].to_owned() });
        }
        if let Some(i) = first_not_finite(&deltas) {
            let what = format!("shape {:?}", shapes[i / width].name);
            return Err(RigError::NotFinite { what, vertex: i % width / 3 });
        }
        if let Some(shape) = shapes.iter().find(|s| s.name.chars().nth(LONGEST_NAME).is_some()) {
            return Err(RigError::LongName { name: text::short(&shape.name).into_owned() });
        }
        let mut rig = Self { neutral, mesh, shapes, deltas, motionless: Vec::new(), landmarks: None, regions: None };
        rig.check_lengths()?;
        let warnings = rig.drop_motionless();
        Ok((rig, warnings))
    }

    /// Refuses displacements that no neutral of this size has.
    fn check_lengths(&self) -> Result<(), RigError> {
        let size = bounding_box_diagonal(&self.surface_points());
        // a neutral that is one point has no size to compare with
        let most = if size > 0.0 { FARTHEST_SHARE * size } else { LARGEST_COORDINATE };
        let too_long = |k| Some((k, lengths(self.deltas(k)).position(|length| length > most)?));
        let Some((k, vertex)) = (0..self.shapes.len()).into_par_iter().find_map_first(too_long) else { return Ok(()) };
        let displacement = [0, 1, 2].map(|axis| f64::from(self.deltas(k)[3 * vertex + axis]));
        Err(RigError::Displacement { shape: self.shapes[k].name.clone(), vertex, displacement, size })
    }

    /// What a vertex moves by that does not count as moving, millimetres.
    fn motionless_below(&self) -> f64 {
        MOTIONLESS_SHARE * bounding_box_diagonal(&self.surface_points())
    }

    fn drop_motionless(&mut self) -> Vec<RigWarning> {
        let threshold = self.motionless_below();
        let moves = |k| lengths(self.deltas(k)).any(|length| length > threshold);
        let keep: Vec<bool> = (0..self.shapes.len()).into_par_iter().map(moves).collect();
        self.motionless = self.keep_shapes(&keep).into_iter().map(|shape| shape.name).collect();
        self.deltas.shrink_to_fit();
        self.motionless.iter().map(|name| RigWarning::Motionless { name: name.clone() }).collect()
    }

    /// Keeps the shapes that are marked and returns the others.
    fn keep_shapes(&mut self, keep: &[bool]) -> Vec<Shape> {
        let width = 3 * self.neutral.len();
        let (mut kept, mut dropped) = (Vec::new(), Vec::new());
        for (k, shape) in std::mem::take(&mut self.shapes).into_iter().enumerate() {
            if !keep[k] {
                dropped.push(shape);
                continue;
            }
            if kept.len() < k {
                self.deltas.copy_within(k * width..(k + 1) * width, kept.len() * width);
            }
            kept.push(shape);
        }
        self.deltas.truncate(kept.len() * width);
        self.shapes = kept;
        dropped
    }

    /// Multiplies all lengths, to bring them to millimetres.
    pub fn scale(&mut self, factor: f64) {
        if factor == 1.0 {
            return;
        }
        let mesh = self.mesh.iter_mut().flat_map(|mesh| &mut mesh.positions);
        self.neutral.iter_mut().chain(mesh).for_each(|p| *p *= factor);
        self.deltas.iter_mut().for_each(|d| *d = (f64::from(*d) * factor) as f32);
    }

    /// Positions of the neutral, millimetres.
    #[must_use]
    pub fn neutral(&self) -> &[Vec3] {
        &self.neutral
    }

    /// The neutral's positions without vertices that no polygon uses: what has a size and a unit.
    #[must_use]
    pub fn surface_points(&self) -> Cow<'_, [Vec3]> {
        surface_points(&self.neutral, self.mesh.iter().flat_map(|mesh| mesh.corners.iter().copied()))
    }

    /// The polygons, if the rig came with them; their positions are those of the mesh file.
    #[must_use]
    pub fn mesh(&self) -> Option<&PolygonMesh> {
        self.mesh.as_ref()
    }

    /// Names and families, without the shapes that move nothing.
    #[must_use]
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Names of the shapes that move nothing and were dropped.
    #[must_use]
    pub fn motionless(&self) -> &[String] {
        &self.motionless
    }

    /// Vertex indices of the rig's 68 Multi-PIE/iBUG landmarks, if it came with them.
    #[must_use]
    pub fn landmarks(&self) -> Option<&[u32]> {
        self.landmarks.as_deref()
    }

    /// Named regions of the rig's vertices, if it came with them.
    #[must_use]
    pub fn regions(&self) -> Option<&Regions> {
        self.regions.as_ref()
    }

    /// The same with landmarks, as vertex indices: the 68 of Multi-PIE/iBUG, in their order.
    ///
    /// # Errors
    /// When one is no vertex.
    pub fn with_landmarks(mut self, landmarks: Vec<u32>) -> Result<Self, RigError> {
        if let Some(vertex) = landmarks.iter().find(|v| **v as usize >= self.neutral.len()) {
            let expected = format!("vertex indices below {}", self.neutral.len());
            return Err(ReadError::malformed(Path::new("landmarks"), Place::File, expected, vertex.to_string()).into());
        }
        self.landmarks = Some(landmarks);
        Ok(self)
    }

    /// The same with named regions.
    ///
    /// # Errors
    /// When they are those of another number of vertices.
    pub fn with_regions(mut self, regions: Regions) -> Result<Self, RigError> {
        let (found, expected) = (regions.vertex_count(), self.neutral.len());
        if found != expected {
            return Err(RigError::VertexCount { what: "the regions".into(), found, expected });
        }
        self.regions = Some(regions);
        Ok(self)
    }

    /// Differences of shape `k` to the neutral, vertex by vertex, x y z: millimetres.
    ///
    /// # Panics
    /// When there is no shape `k`.
    #[must_use]
    pub fn deltas(&self, k: usize) -> &[f32] {
        let width = 3 * self.neutral.len();
        &self.deltas[k * width..(k + 1) * width]
    }

    /// The first of the vertices with which each one is a point of the surface: itself, but along [seams](crate::mesh::sewn) of the neutral
    /// that no shape opens and whose sides are together in `positions` as well.
    pub(crate) fn seams(&self, positions: &[Vec3]) -> Vec<u32> {
        let Some(mesh) = &self.mesh else { return (0..self.neutral.len() as u32).collect() };
        let mesh = TriangleMesh { positions: self.neutral.clone(), ..mesh.triangulate() };
        let shapes = self.shapes.len();
        sewn_unless_opened(&mesh, shapes + 1, |k, v| match v as usize {
            v if k == shapes => positions[v] - self.neutral[v],
            v => Vec3::from_fn(|axis, _| f64::from(self.deltas(k)[3 * v + axis])),
        })
    }

    /// Index of a shape.
    ///
    /// # Errors
    /// When there is none of that name: the message suggests the most similar one and lists all.
    pub fn find(&self, name: &str) -> Result<usize, RigError> {
        if let Some(k) = self.shapes.iter().position(|s| s.name == name) {
            return Ok(k);
        }
        if self.motionless.iter().any(|m| m == name) {
            return Err(RigError::MotionlessShape { name: name.to_owned() });
        }
        let known: Vec<&str> = self.shapes.iter().map(|s| s.name.as_str()).collect();
        let closest = text::most_similar(name, known.iter().copied()).unwrap_or_default().to_owned();
        Err(RigError::UnknownShape { name: name.to_owned(), closest, known: known.join(", ") })
    }

    /// How many identity modes it has.
    #[must_use]
    pub fn identity_modes(&self) -> usize {
        self.shapes.iter().filter(|shape| shape.family == Family::Identity).count()
    }

    /// How many identity modes a fit uses where nobody says: [`IDENTITY_MODES`] or as many as there are for an unknown subject; none
    /// beside the subject's own neutral, or where the shapes that are named hold modes.
    #[must_use]
    pub fn usual_identity_modes(&self, names: Option<&[String]>, own_neutral: bool) -> usize {
        let is_mode = |name: &String| self.shapes.iter().any(|s| s.name == *name && s.family == Family::Identity);
        let named = names.is_some_and(|names| names.iter().any(is_mode));
        if own_neutral || named { 0 } else { self.identity_modes().min(IDENTITY_MODES) }
    }

    /// Takes out the shapes that a fit uses.
    ///
    /// # Errors
    /// When a name is unknown or comes twice, or there are fewer identity modes.
    pub fn select(&self, selection: ShapeSelection<'_>) -> Result<ShapeBasis, RigError> {
        let of_family = |identity: bool| {
            (0..self.shapes.len()).filter(move |&k| (self.shapes[k].family == Family::Identity) == identity)
        };
        let mut chosen: Vec<usize> = match selection.names {
            None => of_family(false).collect(),
            Some(names) => names.iter().map(|name| self.find(name)).collect::<Result<_, _>>()?,
        };
        let modes: Vec<usize> = of_family(true).take(selection.identity_modes).collect();
        if modes.len() < selection.identity_modes {
            return Err(RigError::IdentityModes { asked: selection.identity_modes, found: modes.len() });
        }
        chosen.extend(modes);
        let mut seen = vec![false; self.shapes.len()];
        for &k in &chosen {
            if std::mem::replace(&mut seen[k], true) {
                return Err(RigError::DuplicateName { name: self.shapes[k].name.clone() });
            }
        }
        let nb = chosen.len();
        let mut slab = vec![0.0; 3 * self.neutral.len() * nb];
        // a few rows at a time, so that the part of the slab being filled stays in the cache
        const ROWS: usize = 48;
        slab.par_chunks_mut((ROWS * nb).max(1)).enumerate().for_each(|(block, rows)| {
            for (column, &k) in chosen.iter().enumerate() {
                let deltas = &self.deltas(k)[block * ROWS..];
                for (row, &delta) in rows.chunks_exact_mut(nb).zip(deltas) {
                    row[column] = delta;
                }
            }
        });
        let shapes = chosen.into_iter().map(|k| self.shapes[k].clone()).collect();
        Ok(ShapeBasis::new(shapes, slab))
    }

    /// What each shape moves.
    #[must_use]
    pub fn info(&self) -> Vec<ShapeInfo> {
        let threshold = self.motionless_below();
        let info = |(k, shape): (usize, &Shape)| {
            let (mut moved_vertices, mut max_displacement) = (0, 0.0f64);
            for length in lengths(self.deltas(k)) {
                moved_vertices += usize::from(length > threshold);
                max_displacement = max_displacement.max(length);
            }
            ShapeInfo { name: shape.name.clone(), family: shape.family, moved_vertices, max_displacement }
        };
        self.shapes.iter().enumerate().map(info).collect()
    }
}

/// How far each vertex moves.
fn lengths(deltas: &[f32]) -> impl Iterator<Item = f64> {
    deltas.chunks_exact(3).map(|d| Vec3::new(f64::from(d[0]), f64::from(d[1]), f64::from(d[2])).norm())
}

/// Index of the first number that is not finite.
fn first_not_finite(numbers: &[f32]) -> Option<usize> {
    /// Numbers between two branches; one after each takes several times as long.
    const BLOCK: usize = 1024;
    let finite = |block: &[f32]| block.iter().fold(true, |all, x| all & x.is_finite());
    let before = BLOCK * numbers.par_chunks(BLOCK).position_first(|block| !finite(block))?;
    Some(before + numbers[before..].iter().position(|x| !x.is_finite())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(name: &str, family: Family) -> Shape {
        Shape { name: name.into(), family }
    }

    fn rig() -> (Rig, Vec<RigWarning>) {
        let neutral = vec![Vec3::zeros(), Vec3::new(100.0, 0.0, 0.0)];
        let shapes = vec![
            shape("jawOpen", Family::Expression),
            shape("still", Family::Expression),
            shape("id0", Family::Identity),
            shape("id1", Family::Identity),
        ];
        #[rustfmt::skip]
        let deltas = vec![
            1.0, 2.0, 3.0,   4.0, 5.0, 6.0,
            0.0, 1e-5, 0.0,  0.0, 0.0, 0.0,
            7.0, 0.0, 0.0,   0.0, 0.0, 0.0,
            0.0, 0.0, 0.0,   0.0, 9.0, 0.0,
        ];
        Rig::new(neutral, None, shapes, deltas).unwrap()
    }

    #[test]
    fn the_slab_has_the_chosen_shapes_in_their_order() {
        let (rig, warnings) = rig();
        assert_eq!(warnings, [RigWarning::Motionless { name: "still".into() }]);
        let selected = rig.select(ShapeSelection { identity_modes: 1, ..ShapeSelection::default() }).unwrap();
        let rows = |selected: &ShapeBasis, i: usize| selected.vertex(i).next().unwrap().1.to_vec();
        assert_eq!(rows(&selected, 0), [1.0, 7.0, 2.0, 0.0, 3.0, 0.0]);
        assert_eq!(rows(&selected, 1), [4.0, 0.0, 5.0, 0.0, 6.0, 0.0]);
        let names = ["id1".to_owned(), "jawOpen".to_owned()];
        let selected = rig.select(ShapeSelection { names: Some(&names), ..ShapeSelection::default() }).unwrap();
        assert_eq!(rows(&selected, 1), [0.0, 4.0, 9.0, 5.0, 0.0, 6.0]);
    }

    #[test]
    fn an_unknown_subject_gets_modes_and_one_with_a_neutral_of_its_own_none() {
        let (rig, _) = rig();
        assert_eq!(rig.usual_identity_modes(None, false), 2);
        assert_eq!(rig.usual_identity_modes(None, true), 0);
        let [expression, mode] = ["jawOpen".to_owned(), "id1".to_owned()];
        assert_eq!(rig.usual_identity_modes(Some(std::slice::from_ref(&expression)), false), 2);
        assert_eq!(rig.usual_identity_modes(Some(&[expression, mode]), false), 0);
        let modes = (0..70).map(|k| shape(&format!("id{k}"), Family::Identity)).collect();
        let (rich, _) = Rig::new(vec![Vec3::zeros(), Vec3::x()], None, modes, vec![1.0; 70 * 6]).unwrap();
        assert_eq!((rich.identity_modes(), rich.usual_identity_modes(None, false)), (70, IDENTITY_MODES));
    }

    #[test]
    fn wrong_choices_are_named() {
        let (rig, _) = rig();
        let select = |names: &[&str], identity_modes| {
            let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
            rig.select(ShapeSelection { names: Some(&names), identity_modes }).unwrap_err().to_string()
        };
        let message = select(&["jawopn"], 0);
        assert!(message.contains("jawopn") && message.contains("did you mean \"jawOpen\""), "{message}");
        assert!(select(&["still"], 0).contains("moves nothing"));
        assert!(select(&["jawOpen", "jawOpen"], 0).contains("twice"));
        assert!(select(&["id0"], 1).contains("twice"));
        assert!(select(&[], 3).contains("3 identity modes"));
    }

    #[test]
    fn info_counts_and_measures() {
        let info = rig().0.info();
        assert_eq!((info[1].moved_vertices, info[1].max_displacement), (1, 7.0));
        assert_eq!(info[0].max_displacement, 77f64.sqrt());
    }
}
