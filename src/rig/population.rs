//! A population: many shapes of one topology, such as registered faces of many people, and their common pose.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::likeness::{self, Unlike};
use super::read::mesh_files;
use crate::io::{Noting, NpyArray, ReadError, read_polygon_mesh};
use crate::mesh::{PolygonMesh, Pose, PoseError, PoseKind, Vec3, weighted_closest_pose};

/// Coordinates beyond this are no lengths; below, the fourth powers that alignment needs are far from overflow.
const LARGEST: f64 = 1e30;

/// The alignment ends when a round moves the mean by less than this share of its size, in root mean square.
const SETTLED: f64 = 1e-12;

/// Far more than shapes that have anything in common need: each round shrinks the rest by about the share of the shapes'
/// variance in their squared size.
const MOST_ROUNDS: usize = 1000;

/// Why shapes are no population, or have no principal components.
#[derive(Debug, thiserror::Error)]
pub enum PopulationError {
    /// A folder or a mesh cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Fewer than two shapes.
    #[error("{}{found} {}, expected at least 2: one shape does not vary",
        place(.folder), if *.found == 1 { "mesh" } else { "meshes" })]
    TooFew {
        /// Where they come from, if from files.
        folder: Option<PathBuf>,
        /// How many there are.
        found: usize,
    },
    /// A shape has another number of vertices or polygons than the first.
    #[error("{name}: found {found} {what}, expected {expected} as in {first}")]
    Count {
        /// The shape.
        name: String,
        /// "vertices" or "polygons".
        what: &'static str,
        /// How many it has.
        found: usize,
        /// How many the first has.
        expected: usize,
        /// The first shape.
        first: String,
    },
    /// A polygon joins other vertices than in the first shape.
    #[error(
        "{name}: polygon {polygon} has the vertices {found:?}, expected {expected:?} as in {first}, counted from 0"
    )]
    Polygon {
        /// The shape.
        name: String,
        /// Index of the polygon.
        polygon: usize,
        /// Its vertices.
        found: Vec<u32>,
        /// Those of the first shape's.
        expected: Vec<u32>,
        /// The first shape.
        first: String,
    },
    /// A coordinate is NaN, infinite or absurd.
    #[error("{name}: vertex {vertex} is not finite or beyond 1e30")]
    NotFinite {
        /// The shape.
        name: String,
        /// Index of the vertex.
        vertex: usize,
    },
    /// A shape cannot have the vertices of the first in its order.
    #[error("{name}: does not correspond to {first}, the neutral here: {why}")]
    Unlike {
        /// The shape.
        name: String,
        /// The first shape.
        first: String,
        /// What was seen.
        why: Unlike,
    },
    /// A shape has no pose relative to the mean.
    #[error("{name}: cannot be aligned: {source}")]
    Pose {
        /// The shape.
        name: String,
        /// Why.
        source: PoseError,
    },
    /// The alignment has not come to rest.
    #[error("the alignment has not settled in {rounds} rounds; the meshes have too little in common")]
    NotSettled {
        /// Rounds done.
        rounds: usize,
    },
    /// No components, or more than shapes and vertices can have.
    #[error("{asked} components asked for, expected 1 to {most}: {samples} meshes of {vertices} vertices have no more")]
    Components {
        /// Asked for.
        asked: usize,
        /// Shapes.
        samples: usize,
        /// Vertices of each.
        vertices: usize,
        /// `min(samples - 1, 3 vertices)`.
        most: usize,
    },
    /// Some of the components have no variance.
    #[error(
        "{asked} components asked for, the {samples} meshes vary in {rank} directions only; all others have zero variance"
    )]
    Rank {
        /// Asked for.
        asked: usize,
        /// Shapes.
        samples: usize,
        /// Components with variance.
        rank: usize,
    },
    /// The singular value decomposition did not converge.
    #[error("the singular value decomposition of {samples} meshes did not converge")]
    Decomposition {
        /// Shapes.
        samples: usize,
    },
}

fn place(folder: &Option<PathBuf>) -> String {
    folder.as_ref().map_or_else(String::new, |f| format!("{}: found ", f.display()))
}

/// At least two shapes with the same vertices, each with a name for messages; all coordinates are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Population {
    names: Vec<String>,
    samples: Vec<Vec<Vec3>>,
    mesh: Option<PolygonMesh>,
}

impl Population {
    /// `N` shapes of `V` vertices, millimetres; messages call them "shape 0" and so on.
    ///
    /// # Errors
    /// When there are fewer than two, one has another number of vertices than the first, or a coordinate is not finite.
    pub fn new(samples: Vec<Vec<Vec3>>) -> Result<Self, PopulationError> {
        let names = (0..samples.len()).map(|i| format!("shape {i}")).collect();
        Self { names, samples, mesh: None }.checked(None)
    }

    /// Reads every `.obj` and `.ply` file of a folder, or where there are none every `.glb`, in the order of their names.
    ///
    /// # Errors
    /// When a file cannot be read, there are fewer than two, or one has other polygons than the first: both the number of
    /// vertices and the corners of every polygon must be the same. The message names the file.
    pub fn read(folder: &Path) -> Result<Self, PopulationError> {
        let paths: Vec<PathBuf> = mesh_files(folder)?.into_iter().map(|(_, path)| path).collect();
        let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        let [first, others @ ..] = &paths[..] else {
            return Err(PopulationError::TooFew { folder: Some(folder.to_owned()), found: 0 });
        };
        let mesh = read_polygon_mesh(first)?;
        let noting = Noting::here();
        let read = |(path, name): (&PathBuf, &String)| {
            let other = Noting::along(noting.as_ref(), || read_polygon_mesh(path))?;
            same_topology((&names[0], &mesh), (name, &other))?;
            Ok(other.positions)
        };
        let rest: Vec<Result<Vec<Vec3>, PopulationError>> = others.par_iter().zip(&names[1..]).map(read).collect();
        let mut samples = vec![mesh.positions.clone()];
        for positions in rest {
            samples.push(positions?);
        }
        Self { names, samples, mesh: Some(mesh) }.checked(Some(folder))
    }

    /// Reads shapes that are stacked in one array, N x V x 3, of the topology of `mesh`.
    ///
    /// # Errors
    /// When the file cannot be read, has another shape, or holds fewer than two shapes or a number that is not finite.
    pub fn read_npy(path: &Path, mesh: PolygonMesh) -> Result<Self, PopulationError> {
        let array = NpyArray::open(path)?;
        let vertices = mesh.positions.len();
        array.expect_shape(&[None, Some(vertices), Some(3)])?;
        let values = array.read_f64()?;
        let points: Vec<Vec3> = values.chunks_exact(3).map(Vec3::from_column_slice).collect();
        let samples: Vec<Vec<Vec3>> = points.chunks_exact(vertices).map(<[Vec3]>::to_vec).collect();
        let names = (0..samples.len()).map(|i| format!("{}: shape {i}", path.display())).collect();
        Self { names, samples, mesh: Some(mesh) }.checked(Some(path))
    }

    fn checked(self, folder: Option<&Path>) -> Result<Self, PopulationError> {
        if self.samples.len() < 2 {
            return Err(PopulationError::TooFew { folder: folder.map(Path::to_owned), found: self.samples.len() });
        }
        for (name, sample) in self.names.iter().zip(&self.samples) {
            same_count("vertices", (&self.names[0], self.samples[0].len()), (name, sample.len()))?;
            if let Some(vertex) = sample.iter().position(|p| !p.iter().all(|x| x.abs() <= LARGEST)) {
                return Err(PopulationError::NotFinite { name: name.clone(), vertex });
            }
        }
        Ok(self)
    }

    /// The shapes.
    #[must_use]
    pub fn samples(&self) -> &[Vec<Vec3>] {
        &self.samples
    }

    /// Their names in messages: paths, if they come from files.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Multiplies all lengths, to bring them to millimetres.
    pub fn scale(&mut self, factor: f64) {
        let mesh = self.mesh.iter_mut().map(|mesh| &mut mesh.positions);
        self.samples.iter_mut().chain(mesh).flatten().for_each(|p| *p *= factor);
    }

    /// Number of vertices of each.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.samples[0].len()
    }

    /// The first mesh as it was read: polygons, texture coordinates, groups and materials.
    #[must_use]
    pub fn mesh(&self) -> Option<&PolygonMesh> {
        self.mesh.as_ref()
    }

    /// What is odd about each shape as one with the vertices of the first in its order, where a `mesh` says how these hang together:
    /// equal numbers and polygons do not tell.
    ///
    /// # Errors
    /// When one is in another order, or mirrored.
    pub fn doubts(&self, mesh: Option<&PolygonMesh>) -> Result<Vec<String>, PopulationError> {
        let triangles = mesh.map_or_else(Vec::new, |mesh| mesh.triangulate().triangles);
        let first = &self.samples[0];
        let compare = |(name, sample): (&String, &Vec<Vec3>)| match likeness::compare(first, &triangles, sample) {
            Err(why @ (Unlike::Far { .. } | Unlike::Mirrored { .. })) => {
                Err(PopulationError::Unlike { name: name.clone(), first: self.names[0].clone(), why })
            }
            found => {
                let doubts = found.map_or_else(|why| vec![why], |likeness| likeness.doubts);
                Ok(doubts.into_iter().map(|why| format!("{name}: {why}")).collect::<Vec<_>>())
            }
        };
        // each by itself, so that the first of several faults is told
        let compared: Vec<Result<Vec<String>, _>> = self.names.par_iter().zip(&self.samples).map(compare).collect();
        Ok(compared.into_iter().collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// Moves every shape by the rigid motion or similarity that brings it closest to the mean of all, by the vertices that are of a
    /// polygon, and returns how many rounds it took: generalised Procrustes analysis, Gower 1975. Shapes that came from scans lie
    /// as the scans did; what is left after this is shape alone.
    ///
    /// The result lies where the first shape does. A similarity also takes out size: every shape gets the scale that is
    /// best for the mean, whose size (root mean square distance of the vertices from their centroid) is kept at the average
    /// of the shapes' sizes, without which all would shrink to nothing. The same bits at any number of threads.
    ///
    /// # Errors
    /// When a shape lies on a line, or the mean does not come to rest; the population is then of no use any more.
    pub fn align(&mut self, kind: PoseKind) -> Result<usize, PopulationError> {
        let on_surface = self.on_surface();
        let rms = |s: &[Vec3]| rms(chosen(s, &on_surface));
        // About the origin, so that where the scans stood does not cost digits.
        let centroids: Vec<Vec3> = self.samples.par_iter().map(|s| mean_of(chosen(s, &on_surface))).collect();
        self.samples.par_iter_mut().zip(&centroids).for_each(|(s, c)| s.iter_mut().for_each(|p| *p -= c));
        let size = self.samples.iter().map(|s| rms(s)).sum::<f64>() / self.samples.len() as f64;
        let mut mean = self.samples[0].clone();
        for round in 1..=MOST_ROUNDS {
            let mut poses = self.poses_onto(&mean, &on_surface, kind)?;
            let vertices = (0..mean.len()).into_par_iter();
            let at = |v: usize| {
                let moved = poses.iter().zip(&self.samples).map(|(pose, s)| pose.apply(s[v]));
                moved.sum::<Vec3>() / self.samples.len() as f64
            };
            let mut next: Vec<Vec3> = vertices.map(at).collect();
            if kind == PoseKind::Similarity {
                let factor = size / rms(&next);
                next.iter_mut().for_each(|p| *p *= factor);
                for pose in &mut poses {
                    pose.scale *= factor;
                    pose.translation *= factor;
                }
            }
            let moved: Vec<Vec3> = next.iter().zip(&mean).map(|(a, b)| a - b).collect();
            mean = next;
            if rms(&moved) <= SETTLED * size {
                poses.iter_mut().for_each(|pose| pose.translation += centroids[0]);
                let place = |(s, pose): (&mut Vec<Vec3>, &Pose)| s.iter_mut().for_each(|p| *p = pose.apply(*p));
                self.samples.par_iter_mut().zip(&poses).for_each(place);
                return Ok(round);
            }
        }
        Err(PopulationError::NotSettled { rounds: MOST_ROUNDS })
    }

    /// Which vertices count: those of a polygon, or all where nothing is known of polygons.
    pub(super) fn on_surface(&self) -> Vec<bool> {
        self.mesh.as_ref().map_or_else(|| vec![true; self.vertex_count()], PolygonMesh::on_surface)
    }

    /// For each shape the pose that brings it closest to `target`.
    fn poses_onto(&self, target: &[Vec3], on: &[bool], kind: PoseKind) -> Result<Vec<Pose>, PopulationError> {
        let pose = |s: &Vec<Vec3>| {
            let pairs = s.iter().zip(target).zip(on);
            weighted_closest_pose(pairs.map(|((&p, &q), on)| (p, q, f64::from(u8::from(*on)))), kind)
        };
        let poses: Vec<Result<Pose, PoseError>> = self.samples.par_iter().map(pose).collect();
        let named = |(pose, name): (Result<Pose, PoseError>, &String)| {
            pose.map_err(|source| PopulationError::Pose { name: name.clone(), source })
        };
        poses.into_iter().zip(&self.names).map(named).collect()
    }
}

/// A shape's name and something of it.
type Named<'a, T> = (&'a String, T);

fn same_count(what: &'static str, first: Named<'_, usize>, other: Named<'_, usize>) -> Result<(), PopulationError> {
    if first.1 == other.1 {
        return Ok(());
    }
    let (name, first_name) = (other.0.clone(), first.0.clone());
    Err(PopulationError::Count { name, what, found: other.1, expected: first.1, first: first_name })
}

fn same_topology(first: Named<'_, &PolygonMesh>, other: Named<'_, &PolygonMesh>) -> Result<(), PopulationError> {
    let ((first_name, a), (name, b)) = (first, other);
    same_count("vertices", (first_name, a.positions.len()), (name, b.positions.len()))?;
    same_count("polygons", (first_name, a.polygon_count()), (name, b.polygon_count()))?;
    let Some(polygon) = (0..a.polygon_count()).find(|&f| a.polygon(f) != b.polygon(f)) else { return Ok(()) };
    let [expected, found] = [a, b].map(|m| m.polygon(polygon).to_owned());
    Err(PopulationError::Polygon { name: name.clone(), polygon, found, expected, first: first_name.clone() })
}

fn chosen<'a>(points: &'a [Vec3], which: &'a [bool]) -> impl Iterator<Item = &'a Vec3> {
    points.iter().zip(which).filter(|(_, chosen)| **chosen).map(|(p, _)| p)
}

fn mean_of<'a>(points: impl Iterator<Item = &'a Vec3>) -> Vec3 {
    let (sum, count) = points.fold((Vec3::zeros(), 0usize), |(sum, count), p| (sum + p, count + 1));
    sum / count.max(1) as f64
}

/// Root mean square of the lengths.
fn rms<'a>(vectors: impl Iterator<Item = &'a Vec3>) -> f64 {
    let (sum, count) = vectors.fold((0.0, 0usize), |(sum, count), v| (sum + v.norm_squared(), count + 1));
    (sum / count.max(1) as f64).sqrt()
}
