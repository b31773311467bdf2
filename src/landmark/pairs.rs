//! Landmarks of a template paired with points in the scan's space.
//!
//! The **target** file holds the scan's side: names, and points in space, or on the scan's surface as Wrap writes them. The
//! **template** file says what the names mean: vertices, points of triangles, or points in space; those of plain JSON are
//! snapped to the nearest vertex, those of other formats to the closest point of the surface. Without a template file the
//! names have to be vertex indices of the template. Triangle indices refer to the fan triangulation of the polygons,
//! [`PolygonMesh::triangulate`]. Landmarks come in the order of the target file. Where either
//! file gives a deviation, the pair has one: of two, the root of the sum of their squares, for either point may be off.

use std::collections::HashMap;
use std::path::Path;

use super::json::wrong_entry;
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, PatientSpace, Place, ReadError, Side, parse, read_side};
use crate::io::read_file;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3, bounding_box_diagonal, surface_points};

/// A point fixed to the template.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TemplatePoint {
    /// A vertex.
    Vertex(u32),
    /// A point inside a triangle: the sum of `weights` times the corners' positions.
    Face {
        /// Vertex indices.
        corners: [u32; 3],
        /// Not negative, sum 1.
        weights: [f64; 3],
    },
}

impl TemplatePoint {
    /// Where the point is when the template's vertices are at `positions`.
    ///
    /// # Panics
    /// When `positions` has fewer vertices than the template.
    #[must_use]
    pub fn position(&self, positions: &[Vec3]) -> Vec3 {
        match self {
            Self::Vertex(v) => positions[*v as usize],
            Self::Face { corners, weights } => {
                let [a, b, c] = corners.map(|v| positions[v as usize]);
                a * weights[0] + b * weights[1] + c * weights[2]
            }
        }
    }

    /// The vertices that the point depends on, and their shares.
    pub fn corners(&self) -> impl Iterator<Item = (u32, f64)> {
        let (corners, weights) = match *self {
            Self::Vertex(v) => ([v; 3], [1.0, 0.0, 0.0]),
            Self::Face { corners, weights } => (corners, weights),
        };
        corners.into_iter().zip(weights).filter(|c| c.1 != 0.0)
    }
}

/// One pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Its name in the files.
    pub name: String,
    /// On the template.
    pub template: TemplatePoint,
    /// In the scan's space, millimetres.
    pub target: Vec3,
    /// Standard deviation of where it is, along each axis, millimetres; `None` if it is not known.
    pub sigma: Option<f64>,
}

impl Landmark {
    /// A vertex of the template, and where it is in the scan's space, millimetres; no deviation is known.
    #[must_use]
    pub fn new(name: impl Into<String>, vertex: u32, target: Vec3) -> Self {
        Self { name: name.into(), template: TemplatePoint::Vertex(vertex), target, sigma: None }
    }

    /// What it counts next to a landmark of deviation `reference`, which is that of landmarks without their own:
    /// `(reference / sigma)^2`, the ratio of their inverse variances; 1 without a deviation.
    #[must_use]
    pub fn weight(&self, reference: f64) -> f64 {
        self.sigma.map_or(1.0, |sigma| (reference / sigma).powi(2))
    }
}

/// Reads the landmarks of `target`, resolved through the file `names` if there is one.
///
/// `scan` is needed for targets given as points on its triangles.
///
/// # Errors
/// When a file cannot be read or is malformed; on indices out of range, numbers that are not finite,
/// duplicate names, and names that the template file (or, without one, the template) does not have. The message names
/// the landmark. Too few landmarks are not an error here.
pub fn read_landmarks(
    target: &Path,
    names: Option<&Path>,
    template: &PolygonMesh,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<Landmark>, ReadError> {
    let bytes = read_file(target)?;
    let names = names.map(|path| Ok::<_, ReadError>((read_file(path)?, path))).transpose()?;
    parse_landmarks((&bytes, target), names.as_ref().map(|(bytes, path)| (&bytes[..], *path)), template, scan)
}

/// The bytes of a file, and its path, which says by its extension which format to expect, and is named in errors.
pub type Source<'a> = (&'a [u8], &'a Path);

/// Parses the landmarks of `target`, resolved through `names` if there are any.
///
/// # Errors
/// As [`read_landmarks`].
pub fn parse_landmarks(
    (bytes, target): Source<'_>,
    names: Option<Source<'_>>,
    template: &PolygonMesh,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<Landmark>, ReadError> {
    let set = parse(bytes, target, Side::Target)?;
    let names = names.map(|(bytes, path)| Ok((parse(bytes, path, Side::Template)?, path))).transpose()?;
    pair_landmarks((set, target), names.as_ref().map(|(set, path)| (set, *path)), template, scan)
}

/// Pairs the landmarks of a scan, as [`read_scan_landmark_set`](super::read_scan_landmark_set) reads them, with those of the template
/// of the same names. The paths are those that errors name.
///
/// # Errors
/// As [`read_landmarks`], but for those of reading.
pub fn pair_landmarks(
    (set, target): (LandmarkSet, &Path),
    names: Option<(&LandmarkSet, &Path)>,
    template: &PolygonMesh,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<Landmark>, ReadError> {
    let named = set.named;
    let count = set.landmarks.len() + set.missing.len();
    scan.map_or(Ok(()), |scan| check_space(&set, target, scan))?;
    let points = on_scan(set, target, scan)?;
    let Some(names) = names else {
        if !named {
            let expected = "named points, or a template landmark file that says which vertices the points belong to";
            return Err(ReadError::malformed(target, Place::File, expected, "an array of points"));
        }
        let vertices = template.positions.len();
        return points
            .into_iter()
            .map(|(name, point, sigma)| {
                let plain = name == "0" || !(name.starts_with('0') || name.starts_with('+'));
                let index = if plain { name.parse::<u32>().ok() } else { None };
                match index {
                    Some(v) if (v as usize) < vertices => {
                        Ok(Landmark { name, template: TemplatePoint::Vertex(v), target: point, sigma })
                    }
                    Some(_) => Err(out_of_range(target, &name, "template vertex", name.clone(), vertices)),
                    None => {
                        let expected = "names that are template vertex indices (or a template landmark file)";
                        Err(ReadError::malformed(target, Place::File, expected, format!("{name:?}")))
                    }
                }
            })
            .collect();
    };
    let (set, names) = names;
    let known = set.on_template(names, template)?;
    if !named && count != known.len() {
        let expected = format!("{} points, as many as {} has", known.len(), names.display());
        return Err(ReadError::malformed(target, Place::File, expected, count.to_string()));
    }
    let own = set.landmarks.iter().map(|l| l.sigma);
    let by_name: HashMap<&str, (TemplatePoint, Option<f64>)> =
        known.iter().zip(own).map(|((name, point), sigma)| (name.as_str(), (*point, sigma))).collect();
    points
        .into_iter()
        .map(|(name, point, sigma)| match by_name.get(name.as_str()) {
            Some(&(template, own)) => {
                let sigma = sigma.zip(own).map(|(a, b)| a.hypot(b)).or(sigma).or(own);
                Ok(Landmark { name, template, target: point, sigma })
            }
            None => {
                let list: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
                let expected = format!("landmarks that {} names: {}", names.display(), list.join(", "));
                Err(ReadError::malformed(target, Place::File, expected, format!("{name:?}")))
            }
        })
        .collect()
}

/// Reads a template landmark file: names and points in the order of the file.
///
/// # Errors
/// As [`read_landmarks`].
pub fn read_template_landmarks(path: &Path, template: &PolygonMesh) -> Result<Vec<(String, TemplatePoint)>, ReadError> {
    read_side(path, Side::Template)?.on_template(path, template)
}

impl LandmarkSet {
    /// Names and points fixed to a template, in the order of the file; `path` is named in errors.
    ///
    /// # Errors
    /// On indices out of range, and a template without vertices.
    pub fn on_template(&self, path: &Path, template: &PolygonMesh) -> Result<Vec<(String, TemplatePoint)>, ReadError> {
        let in_space = |l: &super::PlacedLandmark| matches!(l.place, LandmarkPlace::Position(_));
        let to_surface = self.format != LandmarkFormat::Points && self.landmarks.iter().any(in_space);
        let on_triangles = self.landmarks.iter().any(|l| matches!(l.place, LandmarkPlace::Face { .. }));
        let mesh = if on_triangles || to_surface { template.triangulate() } else { TriangleMesh::default() };
        let broken =
            |e: crate::mesh::MeshError| ReadError::malformed(path, Place::File, "a sound template", e.to_string());
        let surface = if to_surface { Some(ClosestPoint::new(&mesh).map_err(broken)?) } else { None };
        let (vertices, on_surface) = (template.positions.len(), template.on_surface());
        let place = |name: &str, place: &LandmarkPlace| match place {
            LandmarkPlace::Vertex(v) => match u32::try_from(*v) {
                Ok(vertex) if (vertex as usize) < vertices => Ok(TemplatePoint::Vertex(vertex)),
                _ => Err(out_of_range(path, name, "template vertex", v.to_string(), vertices)),
            },
            LandmarkPlace::Face { triangle, barycentric } => {
                let corners = corners(*triangle, &mesh.triangles, "template triangle", name, path)?;
                Ok(TemplatePoint::Face { corners, weights: *barycentric })
            }
            LandmarkPlace::Position(p) => {
                if let Some(closest) = surface.as_ref().and_then(|s| s.query(p)) {
                    let corners = mesh.triangles[closest.triangle as usize];
                    return Ok(TemplatePoint::Face { corners, weights: closest.barycentric });
                }
                match nearest_vertex(&template.positions, &on_surface, *p) {
                    Some(nearest) => Ok(TemplatePoint::Vertex(nearest)),
                    None => Err(ReadError::malformed(path, Place::File, "a template with vertices", "none")),
                }
            }
        };
        self.landmarks.iter().map(|l| Ok((l.name.clone(), place(&l.name, &l.place)?))).collect()
    }
}

/// A position farther from a template than this share of its size is on another mesh, or in another unit.
const OTHER_MESH: f64 = 0.05;
/// A position farther from a template than this share of its size, a millimetre of a face, is worth a word.
const WORTH_A_WORD: f64 = 0.003;

/// Positions that lie off the template that they were placed on: names, and distances in millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OffTemplate(Vec<(String, f64)>);

impl OffTemplate {
    /// None.
    #[must_use]
    pub const fn none() -> Self {
        Self(Vec::new())
    }

    /// The positions of `set`, which was read from `path`, that lie off the template; `points` are its places
    /// [there](LandmarkSet::on_template).
    ///
    /// # Errors
    /// When one lies farther off than a twentieth of the template's size.
    pub fn of(
        path: &Path,
        set: &LandmarkSet,
        points: &[(String, TemplatePoint)],
        template: &PolygonMesh,
    ) -> Result<Self, ReadError> {
        let in_space = set.landmarks.iter().zip(points).filter_map(|(landmark, (name, point))| {
            let LandmarkPlace::Position(p) = landmark.place else { return None };
            Some((name.clone(), (point.position(&template.positions) - p).norm()))
        });
        let mut off: Vec<(String, f64)> = in_space.collect();
        if off.is_empty() {
            return Ok(Self(off));
        }
        let surface = surface_points(&template.positions, template.corners.iter().copied());
        let size = bounding_box_diagonal(&surface);
        if let Some((name, distance)) = off.iter().find(|(_, distance)| *distance > OTHER_MESH * size) {
            let expected = "landmarks of this mesh, and in its unit (--unit landmarks=mm)";
            let found = format!("{name:?} {distance:.0} mm off the mesh");
            return Err(ReadError::malformed(path, Place::File, expected, found));
        }
        // points of plain JSON are vertices, which lie beside them
        off.retain(|(_, distance)| set.format != LandmarkFormat::Points && *distance > WORTH_A_WORD * size);
        Ok(Self(off))
    }

    /// These and those.
    pub fn extend(&mut self, others: Self) {
        self.0.extend(others.0);
    }

    /// What is to be said of them.
    #[must_use]
    pub fn doubt(&self) -> Option<String> {
        let (name, distance) = self.0.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let many = if self.0.len() == 1 { "landmark lies" } else { "landmarks lie" };
        let count = self.0.len();
        Some(format!("{count} {many} off the mesh, {name} by {distance:.1} mm: the closest point of the mesh is taken"))
    }
}

/// Vertices of a scan that are asked where it is, about.
const ASKED: usize = 20_000;
/// How far landmarks lie off a scan of another space at least, as a share of its size, and how many times nearer they are to it in their own.
const OFF_SCAN: f64 = 0.03;
const NEARER: f64 = 4.0;

/// Refuses landmarks that lie off their scan and, turned between LPS and RAS, on it.
fn check_space(set: &LandmarkSet, path: &Path, scan: &TriangleMesh) -> Result<(), ReadError> {
    let points: Vec<Vec3> = set.positions().map(|(_, p)| p).collect();
    let size = bounding_box_diagonal(&scan.positions);
    let asked = || scan.positions.iter().step_by(scan.positions.len() / ASKED + 1);
    let off = |space: PatientSpace| {
        let squared = |p: &Vec3| asked().map(|q| (q - space.to_lps(*p)).norm_squared()).fold(f64::INFINITY, f64::min);
        (points.iter().map(squared).sum::<f64>() / points.len() as f64).sqrt()
    };
    let here = off(PatientSpace::Lps);
    if points.len() < 3 || here < OFF_SCAN * size || NEARER * off(PatientSpace::Ras) > here {
        return Ok(());
    }
    let expected = "landmarks in the scan's space, LPS or RAS (`nonrigid landmarks convert FILE landmarks.json --space ras` turns them)";
    let brought = if set.space == Some(PatientSpace::Ras) { ", brought from RAS to LPS" } else { "" };
    let found = format!("landmarks{brought}, {here:.0} mm off the scan, and on it with x and y negated");
    Err(ReadError::malformed(path, Place::File, expected, found))
}

/// The nearest vertex of those on the surface, the first of equals.
pub(super) fn nearest_vertex(positions: &[Vec3], on_surface: &[bool], p: Vec3) -> Option<u32> {
    let vertices = positions.iter().zip(on_surface).zip(0..).filter(|((_, on), _)| **on);
    let squared = vertices.map(|((q, _), v)| ((q - p).norm_squared(), v));
    squared.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, v)| v)
}

/// Names, points in space and deviations of the landmarks of a scan.
fn on_scan(
    set: LandmarkSet,
    path: &Path,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<(String, Vec3, Option<f64>)>, ReadError> {
    let needs_scan = |name: &str, what: &str| {
        let expected = format!("points [x, y, z], or a scan with triangles for {what}");
        ReadError::malformed(path, Place::File, expected, format!("{name:?} as {what}"))
    };
    let plain = matches!(set.format, LandmarkFormat::Points | LandmarkFormat::Wrap);
    let on_surface = |name: &str, place: LandmarkPlace| match place {
        LandmarkPlace::Position(p) => Ok(p),
        LandmarkPlace::Vertex(v) if plain => {
            let points = "`nonrigid landmarks convert --mesh SCAN --as position` makes these of the scan's vertices";
            Err(wrong_entry(path, name, &format!("{} ({points})", Side::Target.entry()), v.to_string()))
        }
        LandmarkPlace::Vertex(v) => {
            let scan = scan.ok_or_else(|| needs_scan(name, "a vertex"))?;
            let position = usize::try_from(v).ok().and_then(|v| scan.positions.get(v));
            position
                .copied()
                .ok_or_else(|| out_of_range(path, name, "scan vertex", v.to_string(), scan.positions.len()))
        }
        LandmarkPlace::Face { triangle, barycentric: weights } => {
            let scan = scan.filter(|s| !s.triangles.is_empty());
            let scan = scan.ok_or_else(|| needs_scan(name, "[triangle, u, v]"))?;
            let corners = corners(triangle, &scan.triangles, "scan triangle", name, path)?;
            if let Some(v) = corners.iter().find(|&&v| v as usize >= scan.positions.len()) {
                return Err(out_of_range(path, name, "scan vertex", v.to_string(), scan.positions.len()));
            }
            Ok(TemplatePoint::Face { corners, weights }.position(&scan.positions))
        }
    };
    set.landmarks.into_iter().map(|l| on_surface(&l.name, l.place).map(|p| (l.name, p, l.sigma))).collect()
}

fn corners(triangle: u64, triangles: &[[u32; 3]], what: &str, name: &str, path: &Path) -> Result<[u32; 3], ReadError> {
    let found = usize::try_from(triangle).ok().and_then(|t| triangles.get(t));
    found.copied().ok_or_else(|| out_of_range(path, name, what, triangle.to_string(), triangles.len()))
}

fn out_of_range(path: &Path, name: &str, what: &str, index: String, count: usize) -> ReadError {
    let expected = format!("a {what} index below {count} for landmark {name:?}");
    ReadError::malformed(path, Place::File, expected, index)
}
