//! The scan, prepared for the searches of a registration: triangles or a cloud of points with normals behind one interface.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Arc;

use rayon::prelude::*;
use thiserror::Error;

use super::ScanOptions;
use crate::mesh::adjacency::{EdgeGraph, OpenBoundary};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::normals::{NormalWeighting, face_areas, vertex_normals};
use crate::mesh::{MeshError, OrientedPoints, Pose, TriangleMesh, Vec3, noise};

/// Why a scan cannot be searched.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScanError {
    /// It has neither triangles nor normals.
    #[error(
        "the scan has no triangles and no normals, so its surface is not known; give a mesh, or points that have normals: \
         nx, ny, nz in PLY, columns 4 to 6 in XYZ (point cloud programs compute them)"
    )]
    Empty,
    /// Its normals are not one a vertex.
    #[error("scan: found {normals} normals for {vertices} vertices, expected one each")]
    NormalCount {
        /// Number of normals.
        normals: usize,
        /// Number of vertices.
        vertices: usize,
    },
    /// Its geometry cannot be used.
    #[error("scan: {0}")]
    Mesh(#[from] MeshError),
}

/// A scan prepared for closest-point queries: the surface of its triangles or, without any, of its points with normals
/// ([`OrientedPoints`]). Prepared once, it is searched from any frame ([`seen_from`](Self::seen_from)); copies share it.
///
/// The default has no surface: nothing is found.
#[derive(Clone)]
pub struct ScanSurface {
    /// Near the origin, also where the scan is far from it: boxes have 32 bits.
    surface: Arc<Surface>,
    /// From the frame of whoever asks to that of the surface.
    frame: Pose,
    /// By which its normals are multiplied: -1 where it is turned over.
    side: f64,
    reject_boundary: bool,
    vertices: usize,
}

enum Surface {
    Triangles { tree: ClosestPoint, normals: Vec<Vec3>, noise: Vec<f32>, boundary: OpenBoundary },
    Points(OrientedPoints),
}

/// Triangles that are asked for their area, about.
const SAMPLE_TRIANGLES: usize = 50_000;

/// The closest point of a scan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    /// Triangle or point on which it lies: the hint of the next search.
    pub feature: u32,
    pub point: Vec3,
    /// Weights of the triangle's corners; of a point, 1.
    pub barycentric: [f64; 3],
    /// Unit length, or zero where the scan has none.
    pub normal: Vec3,
    /// Standard deviation along the normal ([`noise()`]).
    pub noise: f64,
    /// Whether the scan ends there.
    pub on_boundary: bool,
}

/// A point of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanSample {
    /// Where it is.
    pub point: Vec3,
    /// Unit normal of the scan there.
    pub normal: Vec3,
    /// Standard deviation along it ([`noise()`]).
    pub noise: f64,
}

impl ScanSurface {
    /// Prepares a scan. `normals` are the file's own, if it had any, one per vertex and of any length; without them those of
    /// the triangles are computed.
    ///
    /// # Errors
    /// When a coordinate is not finite, there are neither triangles nor normals, or not as many normals as vertices.
    pub fn new(mut mesh: TriangleMesh, normals: Option<&[Vec3]>, options: &ScanOptions) -> Result<Self, ScanError> {
        check_normals(&mesh, normals)?;
        let vertices = mesh.positions.len();
        let origin = origin_near(&mesh);
        mesh.positions.iter_mut().for_each(|p| *p -= origin);
        let surface = match normals {
            Some(normals) if mesh.triangles.is_empty() => {
                Surface::Points(OrientedPoints::new(&mesh.positions, normals, options.normal_smoothing)?)
            }
            _ => Surface::of_triangles(mesh, normals, options.normal_smoothing)?,
        };
        let frame = Pose { translation: -origin, ..Pose::identity() };
        let reject_boundary = options.reject_boundary;
        Ok(Self { surface: Arc::new(surface), frame, side: 1.0, reject_boundary, vertices })
    }

    /// Vertices of the scan, with or without a surface.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.vertices
    }

    /// Area of the surface that each sample of the scanner stands for: of a cloud a point's, of a mesh that of two triangles, whether
    /// or not they share vertices; their median, as walls and floors may have few.
    #[must_use]
    pub fn sample_area(&self) -> f64 {
        let area = match &*self.surface {
            Surface::Points(points) => points.area() / self.vertices as f64,
            Surface::Triangles { tree, .. } => {
                let each = tree.triangles().len() / SAMPLE_TRIANGLES + 1;
                let chosen: Vec<[u32; 3]> = tree.triangles().step_by(each).collect();
                let mut areas = face_areas(tree.positions(), &chosen);
                areas.retain(|area| *area > 0.0);
                let middle = areas.len() / 2;
                if areas.is_empty() { 0.0 } else { 2.0 * *areas.select_nth_unstable_by(middle, f64::total_cmp).1 }
            }
        };
        area / self.frame.scale.powi(2)
    }

    /// The same surface for whoever asks in another frame, which `pose` takes to the present one.
    #[must_use]
    pub fn seen_from(&self, pose: &Pose) -> Self {
        Self { frame: self.frame.after(pose), ..self.clone() }
    }

    /// The same surface, facing the other way.
    #[must_use]
    pub fn turned_over(self) -> Self {
        Self { side: -self.side, ..self }
    }

    /// The closest point within the square root of `squared_reach`. The answer does not depend on the hint, a
    /// [`Hit::feature`].
    pub(crate) fn closest(&self, p: &Vec3, hint: Option<u32>, squared_reach: f64) -> Option<Hit> {
        let p = self.frame.apply(*p);
        let hit = self.surface.closest(&p, hint, squared_reach * self.frame.scale.powi(2))?;
        let normal = self.frame.rotation.tr_mul(&hit.normal) * self.side;
        let noise = hit.noise / self.frame.scale;
        Some(Hit { point: self.frame.apply_inverse(hit.point), normal, noise, ..hit })
    }

    /// The closest point of the surface, if it lies within `reach` and not on the open boundary.
    #[must_use]
    pub fn closest_within(&self, p: Vec3, reach: f64) -> Option<Vec3> {
        self.closest_hit(p, reach).map(|hit| hit.point)
    }

    /// [`closest_within`](Self::closest_within), with what is known of the scan there.
    pub(crate) fn closest_hit(&self, p: Vec3, reach: f64) -> Option<Hit> {
        // A disc may be nearer than its point.
        let search = if matches!(*self.surface, Surface::Points(_)) { f64::INFINITY } else { reach * reach };
        let hit = self.closest(&p, None, search)?;
        (!hit.on_boundary && (hit.point - p).norm_squared() <= reach * reach).then_some(hit)
    }

    /// Whether correspondences on the open boundary are to be rejected.
    pub(crate) fn rejects_boundary(&self) -> bool {
        self.reject_boundary
    }

    /// Vertices spread evenly over the scan, no two nearer than `spacing` and every other one within `spacing` of them; and the area that
    /// each stands for. The boundary is left out where it is not believed.
    ///
    /// A vertex is taken, in the order of the scan, unless one before it is too near: a choice that does not depend on how the
    /// scan lies in space.
    #[must_use]
    pub fn spread(&self, spacing: f64) -> (Vec<ScanSample>, f64) {
        let (candidates, area) = self.surface.points(self.reject_boundary);
        let frame = &self.frame;
        let placed = |ScanSample { point, normal, noise }| ScanSample {
            point: frame.apply_inverse(point),
            normal: frame.rotation.tr_mul(&normal) * self.side,
            noise: noise / frame.scale,
        };
        let candidates: Vec<ScanSample> = candidates.into_par_iter().map(placed).collect();
        let chosen: Vec<ScanSample> =
            apart(candidates.iter().map(|c| c.point), spacing).into_iter().map(|i| candidates[i]).collect();
        let each = area / frame.scale.powi(2) / chosen.len().max(1) as f64;
        (chosen, each)
    }

    /// What corners or points have, at a point that was found.
    pub(crate) fn mixed(&self, hit: &Hit, of_vertices: &[Vec3]) -> Option<Vec3> {
        let Surface::Triangles { tree, .. } = &*self.surface else { return None };
        let corners = tree.triangle(hit.feature);
        Some(corners.iter().zip(hit.barycentric).map(|(&c, b)| of_vertices[c as usize] * b).sum())
    }

    /// Normals of the file, facing as the surface does.
    pub(crate) fn facing(&self, normal: &Vec3) -> Vec3 {
        normal * self.side
    }
}

impl Default for ScanSurface {
    fn default() -> Self {
        let nothing =
            Surface::of_triangles(TriangleMesh::default(), None, 0).expect("proven: no triangle can be wrong");
        Self { surface: Arc::new(nothing), frame: Pose::identity(), side: 1.0, reject_boundary: true, vertices: 0 }
    }
}

/// In a line: a scan has millions of numbers.
impl std::fmt::Debug for ScanSurface {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (triangles, points) = match &*self.surface {
            Surface::Triangles { tree, .. } => (tree.triangles().len(), tree.positions().len()),
            Surface::Points(points) => (0, points.points().len()),
        };
        let mut shown = f.debug_struct("ScanSurface");
        shown.field("triangles", &triangles).field("points", &points).field("frame", &self.frame);
        shown.field("side", &self.side).field("reject_boundary", &self.reject_boundary).finish()
    }
}

impl Surface {
    fn of_triangles(mesh: TriangleMesh, normals: Option<&[Vec3]>, smoothing: usize) -> Result<Self, MeshError> {
        let rest = || {
            let mut normals = match normals {
                Some(normals) => normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect(),
                None => vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area),
            };
            let edges = EdgeGraph::of(&mesh);
            for _ in 0..smoothing {
                normals = smooth_normals(&edges, &normals);
            }
            let noise = noise(&mesh.positions, &normals, |i| edges.neighbours(i));
            (normals, noise, OpenBoundary::of_edges(&edges, &mesh.triangles))
        };
        let (tree, (normals, noise, boundary)) = rayon::join(|| ClosestPoint::new(&mesh), rest);
        Ok(Self::Triangles { tree: tree?, normals, noise, boundary })
    }

    fn closest(&self, p: &Vec3, hint: Option<u32>, squared_reach: f64) -> Option<Hit> {
        match self {
            Self::Triangles { tree, normals, noise, boundary } => {
                let hit = tree.query_from_within(p, hint.unwrap_or(u32::MAX), squared_reach)?;
                let corners = tree.triangle(hit.triangle);
                let normal: Vec3 = corners.iter().zip(hit.barycentric).map(|(&v, b)| normals[v as usize] * b).sum();
                let noise = corners.iter().zip(hit.barycentric).map(|(&v, b)| f64::from(noise[v as usize]) * b).sum();
                Some(Hit {
                    feature: hit.triangle,
                    point: hit.point,
                    barycentric: hit.barycentric,
                    normal: normal.try_normalize(0.0).unwrap_or_default(),
                    noise,
                    on_boundary: boundary.holds(hit.triangle as usize, corners, hit.barycentric),
                })
            }
            Self::Points(points) => {
                let hit = points.query(p, hint, squared_reach)?;
                let (feature, point, normal, noise) =
                    (hit.index, hit.point, hit.normal, points.noise(hit.index as usize));
                Some(Hit { feature, point, barycentric: [1.0, 0.0, 0.0], normal, noise, on_boundary: hit.beyond_edge })
            }
        }
    }

    /// All points with a normal, without the boundary if that is not believed; and the area.
    fn points(&self, without_boundary: bool) -> (Vec<ScanSample>, f64) {
        match self {
            Self::Triangles { tree, normals, noise, boundary } => {
                let inside = used(tree).filter(|&v| !(without_boundary && boundary.vertices()[v]));
                let positions = tree.positions();
                let area = face_areas(positions, &tree.triangles().collect::<Vec<_>>()).iter().sum();
                let sample = |v| ScanSample { point: positions[v], normal: normals[v], noise: f64::from(noise[v]) };
                (inside.map(sample).filter(|s| s.normal != Vec3::zeros()).collect(), area)
            }
            Self::Points(points) => {
                let inside = (0..points.points().len()).filter(|&i| !(without_boundary && points.on_edge(i)));
                let sample =
                    |i| ScanSample { point: points.points()[i], normal: points.normals()[i], noise: points.noise(i) };
                (inside.map(sample).collect(), points.area())
            }
        }
    }
}

/// A point near the scan: near the triangles or, without any, the points. The origin is near enough for a scan within some eight times
/// its size; others come near it by a multiple of a power of two, so that no digit is lost and no vertex feels another one.
fn origin_near(mesh: &TriangleMesh) -> Vec3 {
    let corners = mesh.triangles.iter().flatten().filter_map(|&v| mesh.positions.get(v as usize));
    let points: Box<dyn Iterator<Item = &Vec3>> =
        if mesh.triangles.is_empty() { Box::new(mesh.positions.iter()) } else { Box::new(corners) };
    let ends = points.map(|p| (*p, *p)).reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)));
    let Some((low, high)) = ends else { return Vec3::zeros() };
    let grid = (16.0 * (high - low).amax()).log2().ceil().exp2();
    let near = (low * 0.5 + high * 0.5).map(|x| (x / grid).round() * grid);
    // what is not finite is named by the tree
    if near.iter().all(|x| x.is_finite()) { near } else { Vec3::zeros() }
}

/// Indices of points that are taken in their order unless one before is nearer than `spacing`.
fn apart(points: impl Iterator<Item = Vec3>, spacing: f64) -> Vec<usize> {
    // Cells twice as wide: what is too near is in a point's own, or in those on the side where it lies in it.
    let cell = |x: f64| {
        let at = x / (2.0 * spacing);
        let side = if at - at.floor() < 0.5 { -1 } else { 1 };
        [at.floor() as i64, (at.floor() as i64).saturating_add(side)]
    };
    /// After the last point of a cell.
    const NONE: u32 = u32::MAX;
    let mut last: HashMap<[i64; 3], u32, BuildHasherDefault<CellHasher>> = HashMap::default();
    let mut taken: Vec<(usize, Vec3, u32)> = Vec::new(); // with the one before it in its cell
    for (index, p) in points.enumerate() {
        let cells = [cell(p.x), cell(p.y), cell(p.z)];
        let of = |k: usize| [cells[0][k & 1], cells[1][k >> 1 & 1], cells[2][k >> 2]];
        let near = |k: usize| {
            let mut next = last.get(&of(k)).copied().unwrap_or(NONE);
            while next != NONE && (taken[next as usize].1 - p).norm() >= spacing {
                next = taken[next as usize].2;
            }
            next != NONE
        };
        if !(0..8).any(near) {
            let before = last.insert(of(0), taken.len() as u32).unwrap_or(NONE);
            taken.push((index, p, before));
        }
    }
    taken.into_iter().map(|t| t.0).collect()
}

/// Spreads the numbers of a cell; the standard library's hasher withstands attackers and takes five times as long.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut number = [0; 8];
            number[..chunk.len()].copy_from_slice(chunk);
            self.0 = (self.0.rotate_left(23) ^ u64::from_le_bytes(number)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        }
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }
}

/// Refuses a scan that has no surface.
pub(crate) fn check_normals(mesh: &TriangleMesh, normals: Option<&[Vec3]>) -> Result<(), ScanError> {
    let vertices = mesh.positions.len();
    if let Some(normals) = normals.filter(|n| n.len() != vertices) {
        return Err(ScanError::NormalCount { normals: normals.len(), vertices });
    }
    let directed = normals.is_some_and(|normals| normals.iter().any(|n| n.norm_squared() > 0.0));
    if mesh.triangles.is_empty() && !directed { Err(ScanError::Empty) } else { Ok(()) }
}

/// Vertices that triangles use, ascending.
fn used(mesh: &ClosestPoint) -> impl Iterator<Item = usize> + use<> {
    let mut used = vec![false; mesh.positions().len()];
    mesh.triangles().flatten().for_each(|v| used[v as usize] = true);
    used.into_iter().enumerate().filter(|u| u.1).map(|u| u.0)
}

/// Each normal averaged with its neighbours'.
fn smooth_normals(edges: &EdgeGraph, normals: &[Vec3]) -> Vec<Vec3> {
    let average = |i: usize| {
        let sum = edges.neighbours(i).iter().fold(normals[i], |sum, &j| sum + normals[j as usize]);
        sum.try_normalize(0.0).unwrap_or_default()
    };
    (0..normals.len()).into_par_iter().map(average).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{self, sheet};

    fn cloud(mesh: &TriangleMesh) -> ScanSurface {
        let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
        let points = TriangleMesh { triangles: Vec::new(), ..mesh.clone() };
        ScanSurface::new(points, Some(&normals), &ScanOptions::default()).unwrap()
    }

    #[test]
    fn triangles_and_their_vertices_answer_alike() {
        let mesh = sheet(31, 31, |c, r| Vec3::new(0.5 * c, 0.5 * r, 0.002 * (c - 15.0).powi(2)));
        let (on_mesh, on_cloud) =
            (ScanSurface::new(mesh.clone(), None, &ScanOptions::default()).unwrap(), cloud(&mesh));
        for i in 0..400 {
            let p = Vec3::new(f64::from(i % 20) - 2.3, f64::from(i / 20) - 2.4, 1.0);
            let [a, b] = [&on_mesh, &on_cloud].map(|s| s.closest(&p, None, f64::INFINITY).unwrap());
            let depth = p.x.min(15.0 - p.x).min(p.y).min(15.0 - p.y);
            if depth.abs() > 1.0 {
                assert_eq!((a.on_boundary, b.on_boundary), (depth < 0.0, depth < 0.0), "{p}");
            }
            if depth > 1.0 {
                assert!((a.point - b.point).norm() < 0.02, "{p}: {} {}", a.point, b.point);
                assert!(a.normal.dot(&b.normal) > 0.999, "{p}");
                let [a, b] = [&on_mesh, &on_cloud].map(|s| s.closest_within(p, 1.2));
                assert!((a.unwrap() - b.unwrap()).norm() < 0.02, "{p}");
            }
            assert!(on_cloud.closest_within(p + Vec3::z() * 3.0, 1.0).is_none());
        }
    }

    #[test]
    fn a_sample_has_an_area_whatever_the_scan_is_made_of() {
        let mesh = sheet(31, 31, |c, r| Vec3::new(0.5 * c, 0.5 * r, 0.0));
        let corners = mesh.triangles.as_flattened();
        let mut with_floor = mesh.clone();
        with_floor.positions.extend([Vec3::zeros(), Vec3::x() * 900.0, Vec3::y() * 900.0]);
        with_floor.triangles.push([961, 962, 963]);
        let soup = TriangleMesh {
            positions: corners.iter().map(|&c| mesh.positions[c as usize]).collect(),
            triangles: (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        };
        for scan in [mesh.clone(), with_floor, soup] {
            let scan = ScanSurface::new(scan, None, &ScanOptions::default()).unwrap();
            approx::assert_relative_eq!(scan.sample_area(), 0.25, max_relative = 1e-9);
            let twice = Pose { scale: 2.0, ..Pose::identity() };
            approx::assert_relative_eq!(scan.seen_from(&twice).sample_area(), 0.0625, max_relative = 1e-9);
        }
        approx::assert_relative_eq!(cloud(&mesh).sample_area(), 0.25, max_relative = 0.2);
    }

    #[test]
    fn whoever_asks_in_another_frame_finds_the_same_points_there() {
        // uneven, so that no two neighbours of a point are equally near
        let uneven = |c: f64, r: f64, seed: usize| 0.05 * testing::noise((31.0 * r + c) as usize + seed);
        let place =
            |c, r| Vec3::new(0.5 * c + uneven(c, r, 0), 0.5 * r + uneven(c, r, 5000), 0.01 * (c - 15.0).powi(2));
        let mesh = sheet(31, 31, place);
        let far = Vec3::new(4e9, -5e9, 3e9);
        let pose = Pose { scale: 2.5, ..Pose::rigid(Vec3::new(0.3, -1.1, 0.7), far) };
        let placed = |mesh: &TriangleMesh| TriangleMesh {
            positions: mesh.positions.iter().map(|p| pose.apply(*p)).collect(),
            ..mesh.clone()
        };
        let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
        let turned: Vec<Vec3> = normals.iter().map(|n| pose.rotation * n).collect();
        for triangles in [mesh.triangles.clone(), Vec::new()] {
            let mesh = TriangleMesh { triangles, ..mesh.clone() };
            let of = |mesh, normals| ScanSurface::new(mesh, Some(normals), &ScanOptions::default()).unwrap();
            let (here, there) = (of(mesh.clone(), &normals[..]), of(placed(&mesh), &turned).seen_from(&pose));
            let over = there.clone().turned_over();
            for i in 0..100 {
                let p = Vec3::new(f64::from(i % 10) * 1.7 - 0.9, f64::from(i / 10) * 1.6 - 0.8, 0.7);
                let [a, b, c] = [&here, &there, &over].map(|s| s.closest(&p, None, 9.0).unwrap());
                assert!((a.point - b.point).norm() < 1e-5 && (a.normal - b.normal).norm() < 1e-5, "{p}: {a:?} {b:?}");
                assert_eq!((a.on_boundary, c.normal), (b.on_boundary, -b.normal));
                assert!(there.closest(&p, None, 1e-4).is_none());
            }
            let ((a, area), (b, same)) = (here.spread(1.3), there.spread(1.3));
            assert!(a.len() == b.len() && (area - same).abs() < 1e-5 && a.len() > 60, "{} {}", a.len(), b.len());
            let near = |a: &ScanSample, b: &ScanSample| {
                (a.point - b.point).norm() < 1e-5
                    && (a.normal - b.normal).norm() < 1e-5
                    && (a.noise - b.noise).abs() < 1e-5
            };
            assert!(a.iter().zip(&b).all(|(a, b)| near(a, b)));
        }
    }

    #[test]
    fn a_scan_without_a_surface_is_refused() {
        let points = TriangleMesh { positions: vec![Vec3::zeros(); 2], triangles: Vec::new() };
        let refused = |normals: Option<&[Vec3]>| {
            ScanSurface::new(points.clone(), normals, &ScanOptions::default()).unwrap_err().to_string()
        };
        assert!(refused(None).contains("nx, ny, nz"));
        assert!(refused(Some(&[Vec3::zeros(); 2])).contains("nx, ny, nz"));
        assert!(refused(Some(&[Vec3::z(); 3])).contains("3 normals for 2 vertices"));
    }
}
