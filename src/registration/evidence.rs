//! What a finished registration shows of itself: numbers that differ between right and wrong results.
//!
//! None of them needs the truth. [`Doubt`](super::Doubt) weighs them into one probability; `experiments silence` measures how
//! far that probability can be believed.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;

use super::{Handedness, Quality, QualityError, RegistrationInput, RegistrationResult};
use crate::correspondence::{ScanSurface, VertexMasks};
use crate::landmark::Landmark;
use crate::mesh::adjacency::{EdgeGraph, OpenBoundary};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::{MeshError, PoseKind, TriangleMesh, Vec3, closest_pose, rms_size, surface_points};

/// Signs of right and wrong. Lengths are shares of the result's size (root mean square distance from its centroid), so that they
/// mean the same for any subject; zero where something does not apply.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// How template and scan cover each other.
    #[serde(flatten)]
    pub coverage: Coverage,
    /// Size of the result: root mean square distance from its centroid, millimetres.
    pub size: f64,
    /// Loss of the searched start, 0 to 1.
    pub start_loss: f64,
    /// Share of the template that the searched start matches; 1 with landmarks.
    pub start_share: f64,
    /// How close the best pose elsewhere comes, as a share of the start's gain.
    pub start_rival: f64,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Root mean square distance of the landmarks from their targets.
    pub landmark_rms: f64,
    /// Largest distance of a landmark from its target; that of a landmark of standard deviation sigma counts `1 / sigma`.
    pub landmark_worst: f64,
    /// How far the landmarks leave the start open: [`LandmarkStart::std_dev`](super::LandmarkStart::std_dev).
    pub landmark_freedom: f64,
    /// Share of the landmarks that contradict the others and took no part.
    pub landmark_suspects: f64,
    /// What tells the result from its mirror image.
    pub handedness: Handedness,
    /// Whether the model has shapes.
    pub shapes: usize,
    /// Mean of `(w_k / sigma_k)^2` over the weights; about 1 for a draw from the prior.
    pub weight_energy: f64,
    /// Largest `|w_k| / sigma_k`.
    pub weight_worst: f64,
    /// Root mean square shift of a vertex by the weights' standard deviations.
    pub weight_uncertainty: f64,
    /// Root mean square distance of the result from what the shapes alone make of it, in the rigid pose nearest to it. Where a model
    /// makes nothing else, what it leaves of the scan in their place: the 90th percentile of the distances to it.
    pub beyond_shapes: f64,
    /// 95th percentile of the same.
    pub beyond_shapes_p95: f64,
    /// Share of flipped triangles.
    pub flipped: f64,
    /// Pairs of triangles that pass through each other beyond those at rest, as a share of the triangles.
    pub intersections: f64,
    /// 99th percentile of edge stretch, as the logarithm.
    pub stretch: f64,
    /// 1st percentile of edge stretch, as minus the logarithm.
    pub squeeze: f64,
    /// Correlation of mean curvature between rest shape and result, over the vertices on the scan: what slides takes on the
    /// curvature of another place.
    pub curvature_kept: f64,
    /// Scale of the start.
    pub scale: f64,
    /// Largest motion of a vertex in the last step.
    pub last_motion: f64,
    /// Directions that nothing observed, as a share of the vertices.
    pub unobserved_directions: f64,
}

/// How template and scan cover each other in a result.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Coverage {
    /// Share of the vertices that lie on the scan and face as it does, of those that the template does not hide.
    pub on_scan: f64,
    /// Share for which the scan ends before it reaches them, or that the mask takes out: nothing is seen there.
    pub unseen: f64,
    /// The rest: the scan has a surface there, but elsewhere or facing elsewhere.
    pub contradicted: f64,
    /// Of the scan's surface that lies over the template: the share that the template is not on.
    pub scan_missed: f64,
    /// Median distance of the vertices on the scan, as a share of the size.
    pub distance: f64,
    /// 90th percentile of the same.
    pub distance_p90: f64,
    /// Mean of one minus the cosine between normals, over the vertices on the scan.
    pub turn: f64,
}

/// What counts as on the scan, and as over the template, as a share of the size.
const NEAR: f64 = 0.045;
const OVER: f64 = 0.4;
/// A result so near to what the shapes make is made by them alone, as a share of the size.
const NOTHING: f64 = 1e-6;
/// Distance between the points of the scan that are asked, as a share of the size.
const SPACING: f64 = 0.06;
/// Cosine of the widest angle between normals of what is on the scan.
const FACING: f64 = 0.5;

/// What the scan says of each vertex of a result.
pub(super) struct Seen {
    /// Distance to the scan, NaN for vertices that masks take out and for a scan without a surface.
    pub distances: Vec<f64>,
    pub coverage: Coverage,
}

impl Seen {
    /// Compares a result with the scan, both ways; vertices that the template hides are not asked.
    pub fn new(
        input: &RegistrationInput<'_>,
        hidden: &[bool],
        scan: &ScanSurface,
        positions: &[Vec3],
    ) -> Result<Self, QualityError> {
        let mut mesh = input.template.triangulate();
        mesh.positions.copy_from_slice(positions);
        let size = rms_size(&surface_points(positions, input.template.corners.iter().copied()));
        let used = input.template.on_surface();
        let masks = VertexMasks::new(input.mask, input.free_mask, vec![false; positions.len()]);
        let masks = masks.without(|v| !used[v] || hidden[v]);
        let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
        let hits: Vec<_> = (0..positions.len())
            .into_par_iter()
            .map(|i| if masks.data[i] > 0.0 { scan.closest(&positions[i], None, f64::INFINITY) } else { None })
            .collect();
        let mut distances = vec![f64::NAN; positions.len()];
        // What the mask takes out is guessed, like what the scan does not show.
        let masked = |v: &usize| used[*v] && !hidden[*v] && masks.bound[*v] > 0.0 && masks.data[*v] == 0.0;
        let masked = (0..positions.len()).filter(masked).count();
        let (mut near, mut turn, mut unseen, mut asked) = (Vec::new(), 0.0, masked, masked);
        for (i, hit) in hits.iter().enumerate().filter_map(|(i, hit)| Some((i, hit.as_ref()?))) {
            asked += 1;
            distances[i] = (hit.point - positions[i]).norm();
            let cosine = hit.normal.dot(&normals[i]);
            if hit.on_boundary {
                unseen += 1;
            } else if distances[i] <= NEAR * size && cosine >= FACING {
                near.push(distances[i] / size);
                turn += 1.0 - cosine;
            }
        }
        near.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| near.get(((near.len() as f64 * share) as usize).min(near.len().max(1) - 1)).copied();
        let share = |count: usize| count as f64 / asked.max(1) as f64;
        let coverage = Coverage {
            on_scan: share(near.len()),
            unseen: share(unseen),
            contradicted: share(asked - unseen - near.len()),
            scan_missed: scan_missed(scan, &mesh, size)?,
            distance: at(0.5).unwrap_or(0.0),
            distance_p90: at(0.9).unwrap_or(0.0),
            turn: turn / near.len().max(1) as f64,
        };
        Ok(Self { distances, coverage })
    }
}

/// [`Coverage::scan_missed`].
fn scan_missed(scan: &ScanSurface, result: &TriangleMesh, size: f64) -> Result<f64, MeshError> {
    let of_result = || (ClosestPoint::new(result), OpenBoundary::of(result));
    let ((tree, boundary), (points, _)) = rayon::join(of_result, || scan.spread(SPACING * size));
    let tree = tree?;
    let over = |p: &Vec3| {
        let hit = tree.query_within(p, (OVER * size).powi(2))?;
        let t = hit.triangle as usize;
        let past = boundary.holds(t, result.triangles[t], hit.barycentric);
        (!past).then_some(hit.squared_distance.sqrt() > NEAR * size)
    };
    let over: Vec<bool> = points.par_iter().filter_map(|s| over(&s.point)).collect();
    Ok(over.iter().filter(|missed| **missed).count() as f64 / over.len().max(1) as f64)
}

impl Evidence {
    /// Gathers what a result shows.
    #[must_use]
    pub fn new(input: &RegistrationInput<'_>, result: &RegistrationResult, quality: &Quality) -> Self {
        let corners = || input.template.corners.iter().copied();
        let size = rms_size(&surface_points(&result.positions, corners())).max(f64::MIN_POSITIVE);
        let triangles = input.template.triangulate().triangles;
        let of_triangles = |count: usize| count as f64 / triangles.len().max(1) as f64;
        let search = result.start_search.as_ref();
        let sigma = result.schedule.sigma.landmark * size / result.schedule.reference_size;
        let prior = |k: usize| result.schedule.sigma.of(input.shapes.shapes()[k].family);
        let ratios: Vec<f64> = result.weights.iter().enumerate().map(|(k, w)| w.value.abs() / prior(k)).collect();
        let beyond = match beyond_shapes(input, result).map(|distance| distance / size) {
            [rms, _] if rms < NOTHING && !result.weights.is_empty() => [quality.coverage.distance_p90; 2],
            beyond => beyond,
        };
        let grown = intersections_grown(result, quality);
        let landmark =
            |l: &Landmark| (l.weight(sigma), (l.template.position(&result.positions) - l.target).norm() / size);
        let by_landmarks = result.start_landmarks.as_ref();
        let suspects = by_landmarks.map_or(&[][..], |l| &l.suspects[..]);
        let trusted = input.landmarks.iter().filter(|l| !suspects.iter().any(|s| s.name == l.name));
        let landmarks: Vec<(f64, f64)> = trusted.map(landmark).collect();
        let total: f64 = landmarks.iter().map(|l| l.0).sum();
        let squares: f64 = landmarks.iter().map(|(w, d)| w * d * d).sum();
        Self {
            coverage: quality.coverage,
            size,
            start_loss: search.map_or(0.0, |s| s.fit.loss),
            start_share: search.map_or(1.0, |s| s.fit.share),
            start_rival: search.map_or(0.0, |s| s.rival()),
            landmarks: input.landmarks.len(),
            landmark_rms: if total > 0.0 { (squares / total).sqrt() } else { 0.0 },
            landmark_worst: landmarks.iter().map(|(w, d)| w.sqrt() * d).fold(0.0, f64::max),
            landmark_freedom: by_landmarks.map_or(0.0, |l| (l.std_dev / size).min(1.0)),
            landmark_suspects: suspects.len() as f64 / input.landmarks.len().max(1) as f64,
            handedness: Handedness::of(input, result, size),
            shapes: result.weights.len(),
            weight_energy: ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len().max(1) as f64,
            weight_worst: ratios.iter().copied().fold(0.0, f64::max),
            weight_uncertainty: weight_uncertainty(input, result) / size,
            beyond_shapes: beyond[0],
            beyond_shapes_p95: beyond[1],
            flipped: of_triangles(quality.flipped),
            intersections: of_triangles(grown),
            stretch: quality.mesh.stretch.p99.max(f64::MIN_POSITIVE).ln(),
            squeeze: -quality.mesh.stretch.p1.max(1e-3).ln(),
            curvature_kept: curvature_kept(input, result),
            scale: result.start.scale,
            last_motion: result.history.last().map_or(0.0, |h| h.motion) / result.schedule.reference_size,
            unobserved_directions: result.unobserved_directions as f64 / result.positions.len().max(1) as f64,
        }
    }
}

/// Pairs of triangles that cross beyond those at rest, as the last step left them: taking them apart does not make a result right.
pub(super) fn intersections_grown(result: &RegistrationResult, quality: &Quality) -> usize {
    let left = result.untangled.map_or(quality.mesh.self_intersections, |u| u.before);
    left.saturating_sub(quality.mesh.self_intersections_at_rest)
}

/// Root mean square and 95th percentile of the distance between the result and what the shapes alone make, over the accepted
/// vertices, to which it is posed rigidly.
fn beyond_shapes(input: &RegistrationInput<'_>, result: &RegistrationResult) -> [f64; 2] {
    let weights: Vec<f64> = result.weights.iter().map(|w| w.value).collect();
    let blended = |i: usize| match weights.len() == input.shapes.len() {
        true => input.shapes.blend(i, input.rest_positions()[i], &weights),
        false => input.rest_positions()[i],
    };
    let shown: Vec<(Vec3, Vec3)> = (0..result.positions.len())
        .filter(|&i| result.accepted[i])
        .map(|i| (blended(i), result.positions[i]))
        .collect();
    // A start that scales is part of the pose.
    let kind = if result.start.scale == 1.0 { PoseKind::Rigid } else { PoseKind::Similarity };
    let Ok(pose) = closest_pose(&shown, kind) else { return [0.0; 2] };
    let mut apart: Vec<f64> = shown.iter().map(|(a, b)| (pose.apply(*a) - b).norm()).collect();
    apart.sort_unstable_by(f64::total_cmp);
    let rms = (apart.iter().map(|d| d * d).sum::<f64>() / apart.len().max(1) as f64).sqrt();
    [rms, apart[apart.len() * 95 / 100]]
}

/// Root mean square over the vertices of `sqrt(sum_k dev_k^2 |B_ik|^2)`, as if the weights were independent.
fn weight_uncertainty(input: &RegistrationInput<'_>, result: &RegistrationResult) -> f64 {
    let count = input.shapes.len();
    if count == 0 || result.weights.len() != count {
        return 0.0;
    }
    let variances: Vec<f64> = result.weights.iter().map(|w| w.std_dev.unwrap_or(0.0).powi(2)).collect();
    let vertex = |i: usize| -> f64 {
        let of = |(shapes, slab): (Range<usize>, &[f32])| -> f64 {
            let rows = slab.chunks_exact(shapes.len());
            rows.flat_map(|row| row.iter().zip(&variances[shapes.clone()]).map(|(d, v)| f64::from(*d).powi(2) * v))
                .sum()
        };
        input.shapes.vertex(i).map(of).sum()
    };
    let sums: Vec<f64> = (0..result.positions.len()).into_par_iter().map(vertex).collect();
    (sums.iter().sum::<f64>() / sums.len().max(1) as f64).sqrt()
}

/// [`Evidence::curvature_kept`]. Curvature: the height of a vertex over the mean of its neighbours, along its normal.
fn curvature_kept(input: &RegistrationInput<'_>, result: &RegistrationResult) -> f64 {
    let mut mesh = input.template.triangulate();
    let edges = EdgeGraph::of(&mesh);
    let mut heights = |positions: &[Vec3]| -> Vec<f64> {
        mesh.positions.copy_from_slice(positions);
        let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
        let height = |i: usize| {
            let round = edges.neighbours(i);
            let mean = round.iter().map(|&j| positions[j as usize]).sum::<Vec3>() / round.len().max(1) as f64;
            normals[i].dot(&(positions[i] - mean))
        };
        (0..positions.len()).map(height).collect()
    };
    let (rest, end) = (heights(input.rest_positions()), heights(&result.positions));
    let shown: Vec<usize> = (0..end.len()).filter(|&i| result.accepted[i]).collect();
    let mean = |h: &[f64]| shown.iter().map(|&i| h[i]).sum::<f64>() / shown.len().max(1) as f64;
    let (a, b) = (mean(&rest), mean(&end));
    let sums = shown.iter().fold([0.0; 3], |[ab, aa, bb], &i| {
        let (x, y) = (rest[i] - a, end[i] - b);
        [ab + x * y, aa + x * x, bb + y * y]
    });
    if sums[1] * sums[2] > 0.0 { sums[0] / (sums[1] * sums[2]).sqrt() } else { 0.0 }
}
