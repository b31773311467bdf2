//! Correspondences: for every vertex of the template, the closest point of the scan's surface, and whether to believe it.

use rayon::prelude::*;

use super::{Level, RegistrationError, ScanOptions, StartKind, weighted_closest_pose};
use crate::mesh::adjacency::{EdgeGraph, OpenBoundary};
use crate::mesh::closest_point::{ClosestPoint, ClosestVertices};
use crate::mesh::normals::{NormalWeighting, vertex_normals, vertex_normals_into};
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// A scan prepared for closest-point queries.
#[derive(Debug)]
pub struct ScanSurface {
    mesh: TriangleMesh,
    normals: Vec<Vec3>,
    boundary: OpenBoundary,
    surface: ClosestPoint,
    /// Positions of the vertices that triangles use, and their tree.
    corners: Vec<Vec3>,
    vertices: ClosestVertices,
    reject_boundary: bool,
}

impl ScanSurface {
    /// Prepares a scan. `normals` are the file's own, if it had any: unit length or zero; otherwise they are computed.
    ///
    /// # Errors
    /// When a coordinate is not finite or there is no triangle.
    pub fn new(mesh: TriangleMesh, normals: Option<&[Vec3]>, options: &ScanOptions) -> Result<Self, RegistrationError> {
        let unusable = |e: MeshError| RegistrationError::Scan(e.to_string());
        let surface = ClosestPoint::new(&mesh).map_err(unusable)?;
        let mut used = vec![false; mesh.positions.len()];
        mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        let corners: Vec<Vec3> = mesh.positions.iter().zip(&used).filter(|p| *p.1).map(|p| *p.0).collect();
        let vertices = ClosestVertices::new(&corners).map_err(unusable)?;
        let mut normals = match normals {
            Some(normals) => normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect(),
            None => vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area),
        };
        let edges = EdgeGraph::of(&mesh);
        for _ in 0..options.normal_smoothing {
            normals = smooth_normals(&edges, &normals);
        }
        let boundary = OpenBoundary::of(&mesh);
        Ok(Self { mesh, normals, boundary, surface, corners, vertices, reject_boundary: options.reject_boundary })
    }
}

impl ScanSurface {
    /// The closest point of the surface, if it lies within `reach` and not on the open boundary.
    #[must_use]
    pub fn closest_within(&self, p: Vec3, reach: f64) -> Option<Vec3> {
        let hit = self.surface.query_within(&p, reach * reach)?;
        let corners = self.mesh.triangles[hit.triangle as usize];
        (!self.boundary.holds(hit.triangle as usize, corners, hit.barycentric)).then_some(hit.point)
    }
}

/// Each normal averaged with its neighbours'.
fn smooth_normals(edges: &EdgeGraph, normals: &[Vec3]) -> Vec<Vec3> {
    let average = |i: usize| {
        let sum = edges.neighbours(i).iter().fold(normals[i], |sum, &j| sum + normals[j as usize]);
        sum.try_normalize(0.0).unwrap_or_default()
    };
    (0..normals.len()).into_par_iter().map(average).collect()
}

/// One correspondence per template vertex, in the model's frame.
#[derive(Debug, Clone, Default)]
pub struct Correspondences {
    /// Closest point of the scan's surface.
    pub points: Vec<Vec3>,
    /// Unit normal of the scan there, interpolated between its vertices.
    pub normals: Vec<Vec3>,
    /// Scan vertex nearest to the template's vertex.
    pub nearest_vertices: Vec<Vec3>,
    /// One for an accepted correspondence, zero for a rejected one.
    pub weights: Vec<f64>,
    /// Where the model's shapes predict each vertex, in the rigid pose that fits the accepted ones best.
    pub predictions: Vec<Vec3>,
    /// Points of the scan that close the template's [`Seams`](super::Seams), and where there is one.
    pub seam_points: Vec<Vec3>,
    /// One where [`seam_points`](Self::seam_points) has one.
    pub seam_weights: Vec<f64>,
    template_normals: Vec<Vec3>,
    found: Vec<Found>,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    triangle: Option<u32>,
    corner: Option<u32>,
    point: Vec3,
    normal: Vec3,
    nearest: Vec3,
    accepted: bool,
}

impl Default for Found {
    fn default() -> Self {
        let zero = Vec3::zeros();
        Self { triangle: None, corner: None, point: zero, normal: zero, nearest: zero, accepted: false }
    }
}

impl Correspondences {
    /// Finds the correspondences of `positions`, whose triangles are those of `template`. The last ones serve as hints.
    /// Vertices marked in `ignored` take none.
    pub fn find(
        &mut self,
        scan: &ScanSurface,
        positions: &[Vec3],
        template: &TriangleMesh,
        ignored: &[bool],
        level: &Level,
    ) {
        self.template_normals.resize(positions.len(), Vec3::zeros());
        vertex_normals_into(positions, &template.triangles, NormalWeighting::Area, &mut self.template_normals);
        self.found.resize(positions.len(), Found::default());
        let cosine = level.normal_angle.to_radians().cos();
        let normals = &self.template_normals;
        self.found.par_iter_mut().with_min_len(64).enumerate().for_each(|(i, found)| {
            found.update(scan, positions[i], normals[i], level, cosine);
        });
        self.points.clear();
        self.points.extend(self.found.iter().map(|f| f.point));
        self.normals.clear();
        self.normals.extend(self.found.iter().map(|f| f.normal));
        self.nearest_vertices.clear();
        self.nearest_vertices.extend(self.found.iter().map(|f| f.nearest));
        self.weights.clear();
        self.found.iter_mut().zip(ignored).for_each(|(f, ignored)| f.accepted &= !ignored);
        self.weights.extend(self.found.iter().map(|f| f64::from(u8::from(f.accepted))));
    }

    /// Moves [`predictions`](Self::predictions), as the model wrote them, into the rigid pose that fits `positions` best
    /// where correspondences were accepted.
    pub fn pose_predictions(&mut self, positions: &[Vec3]) {
        let pairs = self.predictions.iter().zip(positions).zip(&self.weights).map(|((&p, &v), &w)| (p, v, w));
        if let Ok(pose) = weighted_closest_pose(pairs, StartKind::Rigid) {
            self.predictions.iter_mut().for_each(|p| *p = pose.apply(*p));
        } else {
            self.predictions.copy_from_slice(positions);
        }
    }

    /// Tests whether the scan's vertices lie nearer to the template's than chance would have it, see
    /// [`VertexCoincidence`].
    #[must_use]
    pub fn vertex_coincidence(&self, scan: &ScanSurface) -> VertexCoincidence {
        let accepted: Vec<usize> = (0..self.found.len()).filter(|&i| self.found[i].accepted).collect();
        let to_nearest = |p: &Vec3| scan.vertices.query(p).map_or(f64::INFINITY, |c| c.squared_distance.sqrt());
        let mut spacing: Vec<f64> = accepted.iter().map(|&i| to_nearest(&self.found[i].point)).collect();
        let observed = spacing.clone();
        spacing.sort_unstable_by(f64::total_cmp);
        let offset = CONTROL_OFFSET * spacing.get(spacing.len() / 2).copied().unwrap_or(0.0);
        let nearer = accepted.par_iter().zip(&observed).filter_map(|(&i, &observed)| {
            let found = &self.found[i];
            let u = found.normal.cross(&Vec3::ith(found.normal.iamin(), 1.0)).normalize();
            let (sin, cos) = (GOLDEN_ANGLE * i as f64).sin_cos();
            let aside = found.point + (u * cos + found.normal.cross(&u) * sin) * offset;
            let hit = scan.surface.query_from(&aside, found.triangle?)?;
            let corners = scan.mesh.triangles[hit.triangle as usize];
            let on_rim = scan.boundary.holds(hit.triangle as usize, corners, hit.barycentric);
            (!on_rim).then(|| observed < to_nearest(&hit.point))
        });
        let outcomes: Vec<bool> = nearer.collect();
        VertexCoincidence { nearer: outcomes.iter().filter(|&&n| n).count(), of: outcomes.len() }
    }

    /// Whether any correspondence was accepted.
    #[must_use]
    pub fn any(&self) -> bool {
        self.weights.iter().any(|&w| w > 0.0)
    }

    /// Share of accepted correspondences.
    #[must_use]
    pub fn inlier_share(&self) -> f64 {
        self.weights.iter().filter(|&&w| w > 0.0).count() as f64 / self.weights.len().max(1) as f64
    }
}

/// How far aside the control points of [`VertexCoincidence`] lie, in median distances to the nearest scan vertex.
const CONTROL_OFFSET: f64 = 3.0;

/// Directions that spread evenly, radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// A paired sign test: is the scan vertex nearest to a template vertex' place on the scan nearer than the one nearest to a
/// control point beside it?
///
/// The vertices of a real scan lie anywhere on its surface, so pulling the template to the nearest one only holds it where it
/// is: measured, that doubles the sliding. A scan whose vertices *are* displaced template vertices (made from a registered
/// mesh, or retopologised to the template) says where they belong, and the pull is worth following. The test tells the two
/// apart before the pull is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct VertexCoincidence {
    /// Pairs in which the template's place wins.
    pub nearer: usize,
    /// All pairs.
    pub of: usize,
}

impl VertexCoincidence {
    /// Standard deviations by which the share of wins exceeds one half.
    #[must_use]
    pub fn significance(&self) -> f64 {
        (2.0 * self.nearer as f64 - self.of as f64) / (self.of as f64).sqrt().max(1.0)
    }

    /// Whether scan vertices say where template vertices belong: beyond five standard deviations.
    #[must_use]
    pub fn is_evident(&self) -> bool {
        self.significance() > 5.0
    }
}

impl Found {
    fn update(&mut self, scan: &ScanSurface, position: Vec3, normal: Vec3, level: &Level, cosine: f64) {
        self.accepted = false;
        let cap = level.distance_cap * level.distance_cap;
        let hit = match self.triangle {
            Some(hint) => scan.surface.query_from_within(&position, hint, cap),
            None => scan.surface.query_within(&position, cap),
        };
        let Some(hit) = hit else { return };
        self.triangle = Some(hit.triangle);
        self.point = hit.point;
        let corners = scan.mesh.triangles[hit.triangle as usize];
        let interpolated: Vec3 = corners.iter().zip(hit.barycentric).map(|(&v, b)| scan.normals[v as usize] * b).sum();
        let Some(scan_normal) = interpolated.try_normalize(0.0) else { return };
        self.normal = scan_normal;
        let on_rim = scan.reject_boundary && scan.boundary.holds(hit.triangle as usize, corners, hit.barycentric);
        self.accepted = !on_rim && scan_normal.dot(&normal) > cosine;
        if self.accepted && level.point_to_point > 0.0 {
            // The last one bounds the search.
            let limit = self.corner.map_or(f64::INFINITY, |c| (scan.corners[c as usize] - position).norm_squared());
            if let Some(found) = scan.vertices.query_within(&position, limit) {
                self.corner = Some(found.vertex);
                self.nearest = scan.corners[found.vertex as usize];
            }
        }
    }
}
