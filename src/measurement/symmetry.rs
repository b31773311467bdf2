//! The plane in which a face comes closest to being its own mirror image, and how far from it the face is.
//!
//! Least squares over the surface: with `S` the mirroring in the plane, `q_i` the closest point of the surface to the image `S(p_i)` of
//! vertex `i` and `m_i` the surface's normal there, the plane minimises
//!
//! ```text
//!     sum_i a_i rho( m_i . (S(p_i) - q_i) )
//! ```
//!
//! where `a_i` is the vertex's area and `rho` Tukey's biweight, whose scale follows the residuals' median: what is lopsided does not
//! draw the plane to it. Vertices of the open boundary, and images that come closest to it or to surface that faces elsewhere, do not
//! count. From a start a
//! few steps of closest points as pairs ([`MirrorPlane::of_pairs`]) come near, and Gauss-Newton steps in the plane's three degrees of
//! freedom end it: on a face that is its own mirror image they converge quadratically, to rounding.

use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;
use serde::Serialize;

use super::MeasurementError;
use crate::evaluation::percentile;
use crate::mesh::adjacency::OpenBoundary;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::normals::{NormalWeighting, face_normals, vertex_areas, vertex_normals};
use crate::mesh::{MirrorPlane, TriangleMesh, Vec3, bounding_box_diagonal, sewn};

/// What steers the search; the defaults suit faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SymmetryOptions {
    /// Steps with closest points as pairs, at most.
    pub pair_steps: usize,
    /// Gauss-Newton steps, at most.
    pub steps: usize,
    /// Vertices that the search looks at, about; all count in the result.
    pub samples: usize,
    /// Normals that differ by more than this do not match, degrees.
    pub normal_angle: f64,
}

impl Default for SymmetryOptions {
    fn default() -> Self {
        Self { pair_steps: 30, steps: 60, samples: 20_000, normal_angle: 60.0 }
    }
}

/// The best mirror plane of a surface, and what the mirror image leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct Symmetry {
    /// The plane.
    pub plane: MirrorPlane,
    /// Whether the search came to rest.
    pub converged: bool,
    /// For each vertex by how much the surface there stands out over the mirror image of the other side (negative: falls behind),
    /// millimetres: the distance of its image to the surface. NaN where the image has no counterpart.
    pub offsets: Vec<f64>,
    /// A third of the area of the triangles round each vertex, square millimetres.
    pub areas: Vec<f64>,
}

/// How lopsided a part of a face is, millimetres, over its vertices that have a counterpart; all 0 without any.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Asymmetry {
    /// Vertices that have a counterpart.
    pub vertices: usize,
    /// Vertices that have none: the boundary came between.
    pub without: usize,
    /// Root mean square, weighted by area.
    pub rms: f64,
    /// Median of the magnitudes.
    pub median: f64,
    /// Their 95th percentile.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

impl Symmetry {
    /// Finds the plane from a start or, without one, from the three principal planes of the surface, of which the best wins.
    ///
    /// # Errors
    /// When the mesh is malformed or has no surface. `what` names it in the message.
    pub fn find(
        mesh: &TriangleMesh,
        start: Option<MirrorPlane>,
        options: &SymmetryOptions,
        what: &'static str,
    ) -> Result<Self, MeasurementError> {
        let surface = ClosestPoint::new(mesh).map_err(|source| MeasurementError::Mesh { what, source })?;
        let areas = vertex_areas(&mesh.positions, &mesh.triangles);
        if areas.iter().sum::<f64>() <= 0.0 {
            return Err(MeasurementError::NoSurface(what));
        }
        // A seam of texture coordinates is no boundary. Of vertices that are one point the first has all of its triangles.
        let first = sewn(mesh, |_, _| true);
        let triangles = mesh.triangles.iter().map(|t| t.map(|v| first[v as usize])).collect();
        let mesh = &TriangleMesh { positions: mesh.positions.clone(), triangles };
        let search = Search {
            surface,
            boundary: OpenBoundary::of(mesh),
            faces: face_normals(&mesh.positions, &mesh.triangles),
            normals: vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Angle),
            step: mesh.positions.len().div_ceil(options.samples.max(1)),
            size: bounding_box_diagonal(&mesh.surface_points()),
            cosine: options.normal_angle.to_radians().cos(),
            areas: vertex_areas(&mesh.positions, &mesh.triangles),
            mesh,
        };
        let starts = start.map_or_else(|| search.principal_planes().to_vec(), |plane| vec![plane]);
        let found = starts.into_iter().map(|plane| search.refined(plane, options));
        let best = found.min_by(|a, b| a.2.total_cmp(&b.2));
        let (plane, converged, _) = best.ok_or(MeasurementError::NoSurface(what))?;
        let offset = |m: &Match| m.offset().signum() * (m.image - m.closest).norm();
        let matches = search.matches(&plane, 1);
        let offsets = first.iter().map(|&v| matches[v as usize].as_ref().map_or(f64::NAN, offset)).collect();
        Ok(Self { plane, converged, offsets, areas })
    }

    /// How lopsided the part of these vertices is.
    ///
    /// # Panics
    /// When there is no such vertex.
    #[must_use]
    pub fn of(&self, vertices: impl IntoIterator<Item = usize>) -> Asymmetry {
        let (mut magnitudes, mut squares, mut area, mut without) = (Vec::new(), 0.0, 0.0, 0);
        for v in vertices {
            let offset = self.offsets[v];
            if offset.is_nan() {
                without += 1;
                continue;
            }
            magnitudes.push(offset.abs());
            squares += self.areas[v] * offset * offset;
            area += self.areas[v];
        }
        let at = |percent| percentile(&magnitudes, percent).unwrap_or(0.0);
        let rms = if area > 0.0 { (squares / area).sqrt() } else { 0.0 };
        Asymmetry { vertices: magnitudes.len(), without, rms, median: at(50.0), p95: at(95.0), max: at(100.0) }
    }
}

/// A step that moves the plane by less, as a share of the size, is rest.
const STILL: f64 = 1e-4;

/// The image of a vertex, and where it belongs.
struct Match {
    vertex: usize,
    image: Vec3,
    closest: Vec3,
    /// Of the surface at `closest`.
    normal: Vec3,
}

impl Match {
    fn offset(&self) -> f64 {
        self.normal.dot(&(self.image - self.closest))
    }
}

struct Search<'a> {
    mesh: &'a TriangleMesh,
    surface: ClosestPoint,
    boundary: OpenBoundary,
    faces: Vec<Vec3>,
    normals: Vec<Vec3>,
    areas: Vec<f64>,
    /// Every so many vertices one is looked at.
    step: usize,
    size: f64,
    cosine: f64,
}

impl Search<'_> {
    /// The images of every `step`-th vertex; nothing where they have no counterpart.
    fn matches(&self, plane: &MirrorPlane, step: usize) -> Vec<Option<Match>> {
        let of = |vertex: usize| {
            if self.areas[vertex] <= 0.0 || self.boundary.vertices()[vertex] {
                return None;
            }
            let image = plane.reflect(self.mesh.positions[vertex]);
            let found = self.surface.query(&image)?;
            let triangle = found.triangle as usize;
            let corners = self.mesh.triangles[triangle];
            let facing = plane.reflect_direction(self.normals[vertex]);
            let at: Vec3 = corners.iter().zip(found.barycentric).map(|(v, b)| self.normals[*v as usize] * b).sum();
            let matching = facing.dot(&at) > self.cosine * at.norm();
            let normal = self.faces[triangle];
            (matching && !self.boundary.holds(triangle, corners, found.barycentric)).then_some(Match {
                vertex,
                image,
                closest: found.point,
                normal,
            })
        };
        let vertices: Vec<usize> = (0..self.areas.len()).step_by(step).collect();
        vertices.into_par_iter().map(of).collect()
    }

    /// Planes through the surface's centre of area, perpendicular to its principal axes.
    fn principal_planes(&self) -> [MirrorPlane; 3] {
        let weighted = || self.mesh.positions.iter().zip(&self.areas).filter(|(_, a)| **a > 0.0);
        let total: f64 = self.areas.iter().sum();
        let point = weighted().map(|(p, a)| p * *a).sum::<Vec3>() / total;
        let spread: Matrix3<f64> = weighted().map(|(p, a)| (p - point) * (p - point).transpose() * *a).sum();
        let axes = SymmetricEigen::new(spread).eigenvectors;
        [0, 1, 2].map(|k| MirrorPlane { point, normal: axes.column(k).into_owned() })
    }

    /// The plane that a start leads to, whether the search came to rest, and its loss: the median offset over the samples, where
    /// those without a counterpart count as far away.
    fn refined(&self, start: MirrorPlane, options: &SymmetryOptions) -> (MirrorPlane, bool, f64) {
        let mut plane = start;
        for _ in 0..options.pair_steps {
            let matches: Vec<Match> = self.matches(&plane, self.step).into_iter().flatten().collect();
            let weights = self.weights(&matches);
            let pairs = matches.iter().zip(&weights).map(|(m, w)| (self.mesh.positions[m.vertex], m.closest, *w));
            let Some(next) = MirrorPlane::of_pairs(pairs) else { break };
            let next = next.towards(plane.normal);
            let moved = (next.normal - plane.normal).norm() + plane.height(next.point).abs() / self.size;
            plane = next;
            if moved < STILL {
                break;
            }
        }
        let mut converged = false;
        for _ in 0..options.steps {
            let matches: Vec<Match> = self.matches(&plane, self.step).into_iter().flatten().collect();
            let weights = self.weights(&matches);
            let Some((next, moved)) = self.gauss_newton(&plane, &matches, &weights) else { break };
            plane = next;
            // On a face that is not quite its own image, matches change to and fro in the end.
            converged = moved < STILL;
            if moved < 1e-13 {
                break;
            }
        }
        let of = |m: &Option<Match>| m.as_ref().map_or(self.size, |m| m.offset().abs());
        let matches = self.matches(&plane, self.step);
        let of_surface = matches.iter().zip(self.areas.iter().step_by(self.step)).filter(|(_, area)| **area > 0.0);
        let offsets: Vec<f64> = of_surface.map(|(m, _)| of(m)).collect();
        (plane, converged, percentile(&offsets, 50.0).unwrap_or(f64::INFINITY))
    }

    /// Area times Tukey's weight, its scale from the median of the offsets.
    fn weights(&self, matches: &[Match]) -> Vec<f64> {
        let offsets: Vec<f64> = matches.iter().map(|m| m.offset().abs()).collect();
        let deviation = 1.4826 * percentile(&offsets, 50.0).unwrap_or(0.0);
        let scale = 4.685 * deviation.max(1e-9 * self.size);
        let weight = |(m, offset): (&Match, &f64)| {
            let t = 1.0 - (offset / scale).powi(2);
            if t > 0.0 { self.areas[m.vertex] * t * t } else { 0.0 }
        };
        matches.iter().zip(&offsets).map(weight).collect()
    }

    /// One step in two tilts of the normal, radians, and the shift along it, in units of the size; with the length of the step.
    ///
    /// With `x = p - point`: `dS(p) = -2 ((d . x) n + (n . x) d)` for a change `d` of the normal, `2 s n` for a shift by `s`.
    fn gauss_newton(&self, plane: &MirrorPlane, matches: &[Match], weights: &[f64]) -> Option<(MirrorPlane, f64)> {
        let n = plane.normal;
        // The centre of what counts, on the plane: tilts then hardly shift it.
        let total: f64 = weights.iter().sum();
        let centre: Vec3 =
            matches.iter().zip(weights).map(|(m, w)| self.mesh.positions[m.vertex] * *w).sum::<Vec3>() / total;
        let point = centre - n * plane.height(centre);
        let least = n.iamin();
        let mut axis = Vec3::zeros();
        axis[least] = 1.0;
        let a = n.cross(&axis).try_normalize(1e-9)?;
        let b = n.cross(&a);
        let (mut hessian, mut gradient) = (Matrix3::zeros(), Vec3::zeros());
        for (m, w) in matches.iter().zip(weights) {
            let x = self.mesh.positions[m.vertex] - point;
            let (across, out) = (m.normal.dot(&n), n.dot(&x));
            let tilt = |d: Vec3| -2.0 * (across * d.dot(&x) + out * m.normal.dot(&d)) / self.size;
            let row = Vec3::new(tilt(a), tilt(b), 2.0 * across);
            hessian += row * row.transpose() * *w;
            gradient += row * (w * m.offset() / self.size);
        }
        // A sphere has no best plane: what the surface leaves open stays.
        hessian += Matrix3::identity() * (1e-12 * hessian.trace());
        let step = hessian.cholesky()?.solve(&-gradient);
        if !step.iter().all(|s| s.is_finite()) {
            return None;
        }
        let normal = (n + a * step[0] + b * step[1]).normalize();
        Some((MirrorPlane { point: point + n * (self.size * step[2]), normal }, step.norm()))
    }
}
