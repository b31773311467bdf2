//! Where a registration starts: by landmarks in closed form, and without them by a search over poses.
//!
//! The search: the template, as a few hundred surfels, is put on the scan in many rotations (spread evenly over all of them
//! by the spiral of Alexa, "Super-Fibonacci spirals", 2022) and at many places, and each pose gets a loss. The best are refined
//! by a robust trimmed ICP (symmetric point-to-plane, Rusinkiewicz 2019; weights of Tukey's biweight on the loss; reach falling
//! from coarse to fine), and the lowest loss wins. The given pose is one of them and wins if it is as good.
//!
//! The loss of a pose is the mean over the template's surfels of
//!
//! ```text
//! min(1, h^2 / reach^2 + (1 - n.m) / (1 - cos 60))
//! ```
//!
//! with `h` the distance to the nearest surfel of the scan along its normal `m`, and `n` the template's normal. A surfel without
//! a match (past an edge or a hole of the scan, facing elsewhere) counts 1, so that neither a perfect fit of a small part nor a
//! poor one of everything wins. The normals' part tells a face from a smooth shoulder or the back of a head.
//!
//! A mouth wide open holds the template's upper half and leaves the jaw where no correspondence finds it. So expressions are
//! tried on the winner, the best first, as long as they help; the start is then the pose of the template nearest to what they
//! make of it, as landmarks would give it.
//!
//! Whether the winner is right cannot be read off its loss alone: half a face has more than the back of a head. But on smooth
//! things many poses are as good as the best. So a start is refused where its loss is high or a pose elsewhere comes close.

mod landmarks;

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::landmarks::{deviation, landmark_pose};
use super::surfels::{Frame, Lattice, Surfel, farthest_points, surfels};
use super::{RegistrationError, ScanFlip};
use crate::landmark::Landmark;
use crate::mesh::adjacency::vertex_triangles;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::normals::face_areas;
use crate::mesh::{MeshError, Pose, PoseError, PoseKind, TriangleMesh, Vec3, closest_pose};
use crate::rig::{Family, ShapeBasis};

/// How a start is searched where fewer than three landmarks give it. Lengths as in [`Schedule`](super::Schedule).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartOptions {
    /// Rotations tried.
    pub rotations: usize,
    /// Distance between the places tried, millimetres.
    pub spacing: f64,
    /// Poses refined coarsely.
    pub coarse: usize,
    /// Poses refined to the end.
    pub fine: usize,
    /// Longest match in the end, millimetres.
    pub reach: f64,
    /// Share of the template's surface that has to be matched.
    pub least_share: f64,
    /// Loss, from 0 to 1, above which a pose is no start.
    pub greatest_loss: f64,
    /// [`StartSearch::rival`] above which a pose is no start, except the given one, which then wins.
    pub greatest_rival: f64,
    /// Prior standard deviation of the logarithm of the size. A rigid start keeps its own size unless the scan's is evidently
    /// another, as a child's; 0 keeps it always.
    pub scale_sigma: f64,
    /// Weight of the expression that moves most, as an open mouth does, in a second start where fewer than 16 landmarks pull; the start is
    /// taken whose shape covers the scan better after two levels, at no more energy. Of expressions with a name of ARKit's; 0 for no
    /// second start.
    pub expression: f64,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self {
            rotations: 600,
            spacing: 20.0,
            coarse: 300,
            fine: 12,
            reach: 8.0,
            least_share: 0.3,
            greatest_loss: 0.7,
            greatest_rival: 0.95,
            scale_sigma: 0.15,
            expression: 0.6,
        }
    }
}

/// How well a pose fits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StartFit {
    /// Mean loss over the template, from 0 to 1.
    pub loss: f64,
    /// Share of the template's surface with a match.
    pub share: f64,
    /// Root mean square distance of the matched part along the scan's normals, millimetres on the template.
    pub residual: f64,
}

/// What the search of a start found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StartSearch {
    /// Poses tried.
    pub tried: usize,
    /// Poses refined.
    pub refined: usize,
    /// Whether the given pose won.
    pub given: bool,
    /// The fit of the start.
    pub fit: StartFit,
    /// The best fit in another place, if there was any.
    pub runner_up: Option<StartFit>,
    /// Expressions that made the start fit better, and their weights.
    pub expression: Vec<(String, f64)>,
    /// Whether the scan fits better turned over: its normals face inwards.
    pub flipped: bool,
}

/// A landmark that does not go with the others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SuspectLandmark {
    /// Its name.
    pub name: String,
    /// How far it is from where the others say, millimetres.
    pub distance: f64,
}

/// What a start by three or more landmarks is worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LandmarkStart {
    /// Root mean square distance of the landmarks that took part, each with its weight, millimetres.
    pub rms: f64,
    /// Predicted root mean square error at the template's vertices, millimetres: from the covariance of the pose, where each
    /// landmark is off by its own deviation and by what people differ.
    pub std_dev: f64,
    /// Landmarks that took no part, as they contradict all their neighbours; the farthest off first.
    pub suspects: Vec<SuspectLandmark>,
    /// Whether a search found a better pose than the landmarks alone, which it tries where they say little.
    pub searched: bool,
}

impl StartSearch {
    /// How close the best pose elsewhere comes: its gain (one minus the loss) over that of the start. Measured: up to 0.8 for
    /// right starts, from 0.93 for wrong ones.
    #[must_use]
    pub fn rival(&self) -> f64 {
        self.runner_up.map_or(0.0, |other| (1.0 - other.loss) / (1.0 - self.fit.loss).max(f64::MIN_POSITIVE))
    }
}

/// The template and scan that a start is searched for.
pub(super) struct StartInput<'a> {
    /// The template, its centroid at the origin.
    pub template: &'a TriangleMesh,
    /// Vertices that find no scan.
    pub ignored: &'a [bool],
    /// Where the centroid was.
    pub centre: Vec3,
    /// Length of one of the schedule's millimetres.
    pub unit: f64,
    /// Shapes on the template's vertices, or none.
    pub shapes: &'a ShapeBasis,
    /// The scan and its own normals.
    pub scan: &'a TriangleMesh,
    pub scan_normals: Option<&'a [Vec3]>,
    /// Points of the template, as given, and the landmarks that say where they are on the scan.
    pub landmarks: &'a [(Vec3, &'a Landmark)],
    /// Deviation of a landmark without its own, as long as the template's.
    pub sigma: f64,
    /// Whether the scan may be, or is, inside out.
    pub flip: ScanFlip,
    /// What ends the search.
    pub cancel: Cancel<'a>,
}

/// A flag that another thread sets to end a search.
#[derive(Clone, Copy)]
pub(super) struct Cancel<'a>(pub Option<&'a AtomicBool>);

impl Cancel<'_> {
    pub(super) fn is_set(self) -> bool {
        self.0.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// # Errors
    /// [`RegistrationError::Cancelled`] once it is set.
    pub(super) fn check(self) -> Result<(), RegistrationError> {
        if self.is_set() { Err(RegistrationError::Cancelled) } else { Ok(()) }
    }
}

/// Where a registration starts.
pub(super) struct Start {
    pub pose: Pose,
    /// Where it was searched.
    pub search: Option<StartSearch>,
    /// Where three or more landmarks gave it.
    pub by_landmarks: Option<LandmarkStart>,
}

impl Start {
    /// From the model's frame, which has the template's `centre` at its origin, to the scan's.
    pub fn frame(&self, centre: Vec3) -> Pose {
        Pose { translation: self.pose.apply(centre), ..self.pose }
    }
}

/// The start of a registration: by three or more landmarks in closed form, otherwise by search. Where the landmarks leave much
/// of the pose open, it is searched as well, and the better one counts.
pub(super) fn find_start(
    input: &StartInput<'_>,
    kind: PoseKind,
    options: &StartOptions,
) -> Result<Start, RegistrationError> {
    if input.landmarks.len() < 3 {
        let (pose, search) = search_start(input, kind, options, None)?;
        return Ok(Start { pose, search: Some(search), by_landmarks: None });
    }
    let (pose, suspects) = match landmark_pose(input, kind, options) {
        Ok(found) => found,
        // On a line, they leave a turn open.
        Err(RegistrationError::Start(PoseError::Collinear(count))) => {
            let (pose, search) = search_start(input, kind, options, None).map_err(|e| match e {
                RegistrationError::Cancelled => e,
                _ => PoseError::Collinear(count).into(),
            })?;
            return Ok(Start { pose, search: Some(search), by_landmarks: None });
        }
        Err(e) => return Err(e),
    };
    let trusted: Vec<(Vec3, &Landmark)> = (0..input.landmarks.len())
        .filter(|i| !suspects.iter().any(|s| s.0 == *i))
        .map(|i| input.landmarks[i])
        .collect();
    let deviation = deviation(input, &trusted, &pose);
    let mut start = Start { pose, search: None, by_landmarks: None };
    if deviation > VAGUE * input.unit * pose.scale {
        let of_trusted = StartInput { landmarks: &trusted, ..*input };
        // Where nothing fits, the landmarks still say what they say.
        if let Ok((pose, search)) = search_start(&of_trusted, kind, options, Some(&pose)) {
            if !search.given {
                start.pose = pose;
            }
            start.search = Some(search);
        }
        input.cancel.check()?;
    }
    let away = |(p, l): &(Vec3, &Landmark)| (start.pose.apply(*p) - l.target).norm();
    let weight = |l: &Landmark| l.weight(start.pose.scale * input.sigma);
    let total: f64 = trusted.iter().map(|t| weight(t.1)).sum();
    let rms = (trusted.iter().map(|t| weight(t.1) * away(t).powi(2)).sum::<f64>() / total).sqrt();
    let named = |&(i, distance): &(usize, f64)| {
        let name = input.landmarks[i].1.name.clone();
        SuspectLandmark { name, distance }
    };
    let searched = start.search.as_ref().is_some_and(|search| !search.given);
    start.by_landmarks =
        Some(LandmarkStart { rms, std_dev: deviation, suspects: suspects.iter().map(named).collect(), searched });
    Ok(start)
}

/// Deviation of a pose by landmarks above which it is searched as well, millimetres at the template's vertices.
const VAGUE: f64 = 8.0;

/// Sizes of the scan's surfels in the first look and in the end, millimetres.
const COARSE_SURFEL: f64 = 8.0;
const FINE_SURFEL: f64 = 4.0;
/// Surfels of the template in a glance at every pose, in a look at the better ones, in coarse and in fine refinement.
const GLANCE: usize = 24;
const LOOK: usize = 60;
const COARSE: usize = 150;
const FINE: usize = 500;
/// Poses of each rotation that are looked at, and that are kept.
const LOOKED_AT: usize = 16;
const KEPT: usize = 4;
/// Reach of the first look and of the coarse refinement, millimetres.
const LOOK_REACH: f64 = 20.0;
/// Places tried on a scan at most.
const MOST_PLACES: usize = 800;
/// Least cosine between the normals of template and scan at a place.
const FACING: f64 = 0.3;
/// Poses nearer than this, millimetres at the template's surfels, are one.
const SAME: f64 = 20.0;
/// One minus the cosine of 60 degrees.
const WIDEST_TURN: f64 = 0.5;
/// Scan over template in size (root of the surface's area): a scan smaller than the least does not hold the share of the
/// template that a start needs, and one larger than the greatest is no person.
const SIZES: std::ops::RangeInclusive<f64> = 0.35..=9.0;
/// Prior standard deviation of a similarity's scale where none is stated, and that of a surfel's distance, millimetres.
const SCALE_SIGMA: f64 = 0.15;
const SCALE_NOISE: f64 = 1.0;
/// Scales at which the search looks.
const LOOK_SCALES: [f64; 2] = [0.87, 1.05];

/// Parts of a scan farther from its middle than this many times the median distance are none of it.
const FAR: f64 = 20.0;
/// Weight of a landmark in the search, as a share of the template; less by its variance next to the squared reach of the look.
const LANDMARK_WEIGHT: f64 = 0.1;
/// Weight of all of them at most.
const MOST_LANDMARKS: f64 = 0.5;
/// Loss below which a scan is not tried inside out.
const EVIDENT: f64 = 0.5;
/// Logarithm of the scale below which a rigid start keeps its own size, unless its gain then falls below this share.
const OTHER_SIZE: f64 = 0.12;
const OWN_SIZE: f64 = 0.8;
/// Lever arm that turns radians into millimetres where a step is measured.
const ARM: f64 = 67.0;

/// The scan, in its frame and the schedule's millimetres.
struct ScanSurfels {
    coarse: Vec<Surfel>,
    lattice: Lattice,
    fine: Vec<Surfel>,
    tree: ClosestVertices,
}

/// What is put on the scan.
struct Problem<'a> {
    /// Surfels of the template about its centroid, spread: any first part of them covers all of it.
    template: Vec<Surfel>,
    scan: &'a ScanSurfels,
    /// Landmarks: on the template, about its centroid; on the scan; and their weight, as a share of the template.
    landmarks: &'a [(Vec3, Vec3, f64)],
    kind: PoseKind,
    /// Prior standard deviation of the scale's logarithm.
    scale_sigma: f64,
    cancel: Cancel<'a>,
}

/// How surfels find each other.
#[derive(Clone, Copy)]
struct Matching {
    /// How many of the template's.
    count: usize,
    reach: f64,
    /// Exact nearest surfels and the distance along the normal, or the lattice's and the distance in space.
    exact: bool,
}

#[derive(Clone, Copy)]
struct Match {
    point: Vec3,
    normal: Vec3,
    /// Distance along `normal`.
    height: f64,
    /// Below 1.
    loss: f64,
}

impl Problem<'_> {
    #[inline]
    fn find(&self, point: Vec3, normal: Vec3, how: Matching) -> Option<Match> {
        let at = if how.exact {
            &self.scan.fine[self.scan.tree.query_within(&point, 4.0 * how.reach * how.reach)?.vertex as usize]
        } else {
            &self.scan.coarse[self.scan.lattice.near(point)?]
        };
        let away = point - at.point;
        let height = away.dot(&at.normal);
        let squared = away.norm_squared();
        let distance = if how.exact {
            let aside = (squared - height * height).max(0.0).sqrt();
            // The way to the nearest point of a surface is along its normal, except past its edge.
            if aside > 1.5 * FINE_SURFEL + 0.5 * height.abs() {
                return None;
            }
            height * height
        } else {
            squared
        };
        let loss = distance / (how.reach * how.reach) + (1.0 - normal.dot(&at.normal)) / WIDEST_TURN;
        (loss < 1.0).then_some(Match { point: at.point, normal: at.normal, height, loss })
    }

    fn fit(&self, pose: &Pose, how: Matching) -> StartFit {
        let (mut loss, mut matched, mut squares) = (0.0, 0, 0.0);
        let template = &self.template[..how.count.min(self.template.len())];
        for s in template {
            match self.find(pose.apply(s.point), pose.rotation * s.normal, how) {
                Some(m) => {
                    loss += m.loss;
                    matched += 1;
                    squares += m.height * m.height;
                }
                None => loss += 1.0,
            }
        }
        let count = template.len() as f64;
        let mut total = count;
        for (p, q, share) in self.landmarks {
            let weight = share * count;
            loss += weight * ((pose.apply(*p) - q).norm_squared() / (LOOK_REACH * LOOK_REACH)).min(1.0);
            total += weight;
        }
        StartFit {
            loss: loss / total,
            share: f64::from(matched) / count,
            residual: (squares / f64::from(matched.max(1))).sqrt() / pose.scale,
        }
    }

    /// One step of trimmed ICP; how far it moved, or `None` where nothing holds the template.
    fn step(&self, pose: &mut Pose, how: Matching) -> Option<f64> {
        let mut hessian = SMatrix::<f64, 7, 7>::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        let mut add = |row: SVector<f64, 7>, r: f64, w: f64| {
            hessian.syger(w, &row, &row, 1.0);
            gradient.axpy(w * r, &row, 1.0);
        };
        let row = |arm: Vec3, m: Vec3| {
            let turn = arm.cross(&m);
            SVector::<f64, 7>::from([turn.x, turn.y, turn.z, m.x, m.y, m.z, arm.dot(&m)])
        };
        let count = how.count.min(self.template.len());
        let mut matched = 0;
        for s in &self.template[..count] {
            let (arm, normal) = (pose.rotation * s.point * pose.scale, pose.rotation * s.normal);
            let point = arm + pose.translation;
            if let Some(m) = self.find(point, normal, how) {
                let between = (normal + m.normal).normalize();
                add(row(arm, between), (point - m.point).dot(&between), (1.0 - m.loss).powi(2));
                matched += 1;
            }
        }
        for (p, q, share) in self.landmarks {
            let arm = pose.rotation * p * pose.scale;
            let away = arm + pose.translation - q;
            for axis in 0..3 {
                add(row(arm, Vec3::ith(axis, 1.0)), away[axis], share * count as f64);
            }
        }
        if matched < 6 {
            return None;
        }
        if self.kind == PoseKind::Similarity {
            let stiffness = SCALE_NOISE * SCALE_NOISE * count as f64 / (self.scale_sigma * self.scale_sigma);
            let mut scale = SVector::<f64, 7>::zeros();
            scale[6] = 1.0;
            add(scale, pose.scale.ln(), stiffness);
        } else {
            for i in 0..7 {
                (hessian[(i, 6)], hessian[(6, i)]) = (0.0, 0.0);
            }
            (hessian[(6, 6)], gradient[6]) = (1.0, 0.0);
        }
        for i in 0..6 {
            hessian[(i, i)] *= 1.0 + 1e-6;
        }
        let step = -hessian.cholesky()?.solve(&gradient);
        let turn = step.fixed_rows::<3>(0).into_owned();
        let shift = step.fixed_rows::<3>(3).into_owned();
        let shorter = (0.4 / turn.norm()).min(LOOK_REACH / shift.norm()).min(0.2 / step[6].abs()).min(1.0);
        pose.rotation = Rotation3::new(turn * shorter).into_inner() * pose.rotation;
        pose.translation += shift * shorter;
        pose.scale *= (step[6] * shorter).exp();
        Some(shorter * (turn.norm() * ARM + shift.norm() + step[6].abs() * ARM))
    }

    /// Trimmed ICP until it moves less than `still`, for `steps` at most.
    fn descend(&self, pose: &mut Pose, how: Matching, steps: usize, still: f64) {
        for _ in 0..steps {
            if self.cancel.is_set() || self.step(pose, how).is_none_or(|moved| moved < still) {
                break;
            }
        }
    }

    /// Whether two poses are one.
    fn same(&self, a: &Pose, b: &Pose) -> bool {
        self.template.iter().take(16).all(|s| (a.apply(s.point) - b.apply(s.point)).norm() < SAME)
    }
}

#[derive(Clone, Copy)]
struct Candidate {
    pose: Pose,
    fit: StartFit,
    given: bool,
}

/// Searches the start; `given`, the pose that wins where it is as good, is the identity unless landmarks know better.
fn search_start(
    input: &StartInput<'_>,
    kind: PoseKind,
    options: &StartOptions,
    given: Option<&Pose>,
) -> Result<(Pose, StartSearch), RegistrationError> {
    let near = without_far(input.scan);
    let input = &StartInput { scan: &near, ..*input };
    let size = |mesh: &TriangleMesh| face_areas(&mesh.positions, &mesh.triangles).iter().sum::<f64>().sqrt();
    let usable = |size: f64| size.is_finite() && size > 0.0;
    let (scan, template) = (size(input.scan), size(input.template));
    if !usable(template) {
        return Err(RegistrationError::Template(NO_AREA.into()));
    }
    if !usable(scan) {
        return Err(RegistrationError::Scan(NO_AREA.into()));
    }
    let ratio = scan / template;
    // Powers of ten that bring the scan to the template's size; a rigid start has only the first.
    let powers = if kind == PoseKind::Rigid { 0..=0 } else { -6..=6 };
    let factors: Vec<f64> = powers.map(|k| 10f64.powi(k)).filter(|f| SIZES.contains(&(ratio / f))).collect();
    let search = |flipped: bool| -> Result<(Pose, StartSearch), RegistrationError> {
        let each = factors.iter().map(|&f| search_at(input, f, kind, options, flipped, given));
        let found = each.collect::<Result<Vec<_>, _>>()?;
        let best = found.into_iter().min_by(|a, b| a.1.fit.loss.total_cmp(&b.1.fit.loss));
        best.ok_or(RegistrationError::Size { ratio })
    };
    let gain = |found: &(Pose, StartSearch)| 1.0 - found.1.fit.loss;
    let (pose, search) = match input.flip {
        ScanFlip::Yes => search(true)?,
        ScanFlip::No => search(false)?,
        ScanFlip::Auto => {
            let (as_given, mut tried) = (search(false)?, 0);
            let best = if as_given.1.fit.loss > EVIDENT {
                let over = search(true)?;
                tried = if gain(&over) > gain(&as_given) / options.greatest_rival {
                    as_given.1.tried
                } else {
                    over.1.tried
                };
                if gain(&over) > gain(&as_given) / options.greatest_rival { over } else { as_given }
            } else {
                as_given
            };
            (best.0, StartSearch { tried: best.1.tried + tried, ..best.1 })
        }
    };
    if search.fit.share < options.least_share || search.fit.loss > options.greatest_loss {
        return Err(RegistrationError::NoStart { tried: search.tried, fit: search.fit });
    }
    if !search.given && search.rival() > options.greatest_rival {
        return Err(RegistrationError::AmbiguousStart { search: Box::new(search) });
    }
    Ok((pose, search))
}

/// A point cloud as triangles for the search: one in the tangent plane of each point that has a normal, as wide as points lie
/// apart, with the point's normal at its corners.
pub(super) fn discs(cloud: &TriangleMesh, normals: &[Vec3]) -> (TriangleMesh, Vec<Vec3>) {
    let mut mesh = TriangleMesh::default();
    let mut of_corners = Vec::new();
    let points = || cloud.positions.iter().zip(normals).filter(|(_, n)| n.norm_squared() > 0.0);
    let centres: Vec<Vec3> = points().map(|p| *p.0).collect();
    let Ok(tree) = ClosestVertices::new(&centres) else { return (mesh, of_corners) };
    let mut found = Vec::new();
    for (p, n) in points() {
        tree.k_nearest(p, 2, &mut found);
        let apart = found.last().map_or(0.0, |f| f.squared_distance.sqrt());
        let u = n.cross(&Vec3::ith(n.iamin(), 1.0)).normalize() * apart;
        let w = n.cross(&u) / n.norm();
        let first = mesh.positions.len() as u32;
        let (sin, cos) = (2.0 * std::f64::consts::PI / 3.0).sin_cos();
        mesh.positions.extend([p + u, p + u * cos + w * sin, p + u * cos - w * sin]);
        mesh.triangles.push([first, first + 1, first + 2]);
        of_corners.extend([*n; 3]);
    }
    (mesh, of_corners)
}

/// What is wrong with a mesh that no pose can be searched for.
const NO_AREA: &str = "its surface has no area, or a coordinate is not finite";

/// The scan without triangles that lie far out, as stray points of a scanner do: they would decide its frame and size.
fn without_far(scan: &TriangleMesh) -> Cow<'_, TriangleMesh> {
    let median = |mut x: Vec<f64>| {
        let middle = x.len() / 2;
        *x.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let centres: Vec<Vec3> =
        scan.triangles.iter().map(|t| t.iter().map(|&v| scan.positions[v as usize]).sum::<Vec3>() / 3.0).collect();
    let middle = Vec3::from_fn(|axis, _| median(centres.iter().map(|c| c[axis]).collect()));
    let limit = FAR * median(centres.iter().map(|c| (c - middle).norm()).collect());
    let is_near = |t: &[u32; 3]| t.iter().all(|&v| (scan.positions[v as usize] - middle).norm() <= limit);
    let triangles: Vec<[u32; 3]> = scan.triangles.iter().copied().filter(is_near).collect();
    // A single triangle has no size to be far by.
    if triangles.is_empty() || triangles.len() == scan.triangles.len() {
        return Cow::Borrowed(scan);
    }
    Cow::Owned(TriangleMesh { positions: scan.positions.clone(), triangles })
}

/// The search on the scan divided by `factor`.
fn search_at(
    input: &StartInput<'_>,
    factor: f64,
    kind: PoseKind,
    options: &StartOptions,
    flipped: bool,
    given: Option<&Pose>,
) -> Result<(Pose, StartSearch), RegistrationError> {
    let cancel = input.cancel;
    cancel.check()?;
    let frame = Frame::principal(input.scan, input.unit * factor);
    let own = Frame { origin: Vec3::zeros(), axes: Matrix3::identity(), unit: input.unit };
    let even = surfels(input.template, None, input.ignored, own, FINE_SURFEL);
    let of_scan = |size: f64| {
        let mut surfels = surfels(input.scan, input.scan_normals, &[], frame, size);
        if flipped {
            surfels.iter_mut().for_each(|s| s.normal = -s.normal);
        }
        surfels
    };
    let coarse = of_scan(COARSE_SURFEL);
    cancel.check()?;
    let fine = of_scan(FINE_SURFEL);
    cancel.check()?;
    if even.is_empty() {
        return Err(RegistrationError::Template(NO_NORMALS.into()));
    }
    if coarse.is_empty() || fine.is_empty() {
        return Err(RegistrationError::Scan(NO_NORMALS.into()));
    }
    let template: Vec<Surfel> = farthest_points(&even, medoid(&even), FINE, 0.0).iter().map(|&i| even[i]).collect();
    let points: Vec<Vec3> = fine.iter().map(|s| s.point).collect();
    let local = |(p, l): &(Vec3, &Landmark)| {
        let vagueness = l.sigma.unwrap_or(0.0) / (frame.unit * LOOK_REACH);
        let most = LANDMARK_WEIGHT.min(MOST_LANDMARKS / input.landmarks.len() as f64);
        let weight = most / (1.0 + vagueness * vagueness);
        // Vaguer than the reach of the look, a landmark says nothing about where to look.
        (vagueness <= 1.0).then(|| ((p - input.centre) / input.unit, frame.to_local(l.target), weight))
    };
    let landmarks: Vec<_> = input.landmarks.iter().filter_map(local).collect();
    let scan = ScanSurfels {
        lattice: Lattice::new(&coarse, COARSE_SURFEL, LOOK_REACH),
        coarse,
        tree: ClosestVertices::new(&points).map_err(|e| RegistrationError::Scan(e.to_string()))?,
        fine,
    };
    let scales = kind == PoseKind::Similarity || options.scale_sigma > 0.0;
    let freest = if scales { PoseKind::Similarity } else { PoseKind::Rigid };
    let scale_sigma = if options.scale_sigma > 0.0 { options.scale_sigma } else { SCALE_SIGMA };
    let mut problem = Problem { template, scan: &scan, landmarks: &landmarks, kind: freest, scale_sigma, cancel };
    let from = given.copied().unwrap_or_else(Pose::identity);
    let given = Pose {
        scale: from.scale / factor,
        rotation: frame.axes.tr_mul(&from.rotation),
        translation: frame.to_local(from.apply(input.centre)),
    };
    let (tried, poses) = look(&problem, &given, options);
    cancel.check()?;
    let coarse = Matching { count: COARSE, reach: LOOK_REACH, exact: false };
    let refined: Vec<Candidate> = poses
        .into_par_iter()
        .map(|mut pose| {
            problem.descend(&mut pose, coarse, 12, 0.5);
            Candidate { pose, fit: problem.fit(&pose, coarse), given: false }
        })
        .collect();
    let mut chosen = distinct(&problem, refined, options.fine, options.greatest_rival);
    if factor == 1.0 {
        chosen.push(Candidate { pose: given, fit: problem.fit(&given, coarse), given: true });
    }
    let fine = |reach: f64| Matching { count: FINE, reach, exact: true };
    let ends: Vec<Candidate> = chosen
        .into_par_iter()
        .map(|mut c| {
            for share in [2.5, 1.75, 1.25, 1.0] {
                problem.descend(&mut c.pose, fine(share * options.reach), 8, 0.05);
            }
            Candidate { fit: problem.fit(&c.pose, fine(options.reach)), ..c }
        })
        .collect();
    cancel.check()?;
    let refined = ends.len();
    let mut ends = distinct(&problem, ends, usize::MAX, options.greatest_rival);
    if kind == PoseKind::Rigid && (ends[0].pose.scale * factor).ln().abs() <= OTHER_SIZE {
        // Rivals too: of any size, they fit a part of the scan that is as small as they like.
        problem.kind = kind;
        let of_own_size = |c: &Candidate| {
            let mut pose = Pose { scale: 1.0 / factor, ..c.pose };
            problem.descend(&mut pose, fine(options.reach), 8, 0.05);
            Candidate { pose, fit: problem.fit(&pose, fine(options.reach)), given: c.given }
        };
        let own = distinct(&problem, ends.par_iter().map(of_own_size).collect(), usize::MAX, options.greatest_rival);
        if 1.0 - own[0].fit.loss >= OWN_SIZE * (1.0 - ends[0].fit.loss) {
            ends = own;
        } else {
            problem.kind = freest;
        }
    }
    let Candidate { mut pose, given, .. } = ends[0];
    problem.descend(&mut pose, fine(options.reach), 100, 1e-7);
    let fit = problem.fit(&pose, fine(options.reach));
    let expression = Expressions::new(&problem, input)?.find(&problem, &mut pose, options.reach, input)?;
    let found = Pose {
        scale: factor * pose.scale,
        rotation: frame.axes * pose.rotation,
        translation: frame.origin + frame.axes * pose.translation * frame.unit,
    };
    let found = Pose { translation: found.apply(-input.centre), ..found };
    let runner_up = ends.get(1).map(|e| e.fit);
    Ok((found, StartSearch { tried, refined, given, fit, runner_up, expression, flipped }))
}

/// Vertices of the template near its surfels, and the triangles round them: what shapes deform.
struct Expressions {
    vertices: Vec<usize>,
    triangles: Vec<Vec<[u32; 3]>>,
}

/// Vertices on which expressions are tried.
const EXPRESSION: usize = 300;
/// Weights at which they are.
const EXPRESSION_WEIGHTS: [f64; 2] = [0.5, 1.0];
/// Expressions at most, and the share of the loss that each has to take away.
const MOST_EXPRESSIONS: usize = 3;
const EXPRESSION_GAIN: f64 = 0.1;

impl Expressions {
    fn new(problem: &Problem<'_>, input: &StartInput<'_>) -> Result<Self, RegistrationError> {
        let unusable = |e: MeshError| RegistrationError::Template(e.to_string());
        let tree = ClosestVertices::new(&input.template.positions).map_err(unusable)?;
        let spread = problem.template.iter().take(EXPRESSION);
        let nearest = spread.filter_map(|s| tree.query(&(s.point * input.unit))).map(|c| c.vertex as usize);
        let round = vertex_triangles(input.template.positions.len(), &input.template.triangles);
        let vertices: Vec<usize> = nearest.filter(|&v| !round.row(v).is_empty()).collect();
        let triangles = vertices.iter().map(|&v| {
            let all = round.row(v).iter().map(|&t| input.template.triangles[t as usize]);
            all.collect()
        });
        Ok(Self { triangles: triangles.collect(), vertices })
    }

    /// The surfels of the template with shapes of the given weights.
    fn surfels(&self, input: &StartInput<'_>, weights: &[f64]) -> Vec<Surfel> {
        let at = |v: usize| input.shapes.blend(v, input.template.positions[v], weights) / input.unit;
        let surfel = |(&v, round): (&usize, &Vec<[u32; 3]>)| {
            let cross = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| at(v as usize));
                (b - a).cross(&(c - a))
            };
            let normal = round.iter().map(cross).sum::<Vec3>().try_normalize(0.0).unwrap_or_default();
            Surfel { point: at(v), normal, area: 1.0 }
        };
        self.vertices.iter().zip(&self.triangles).map(surfel).collect()
    }

    /// Tries expressions one after another, each with the pose that suits it. Where any helps, `pose` becomes that of the
    /// template nearest to what they make of it.
    fn find(
        &self,
        problem: &Problem<'_>,
        pose: &mut Pose,
        reach: f64,
        input: &StartInput<'_>,
    ) -> Result<Vec<(String, f64)>, RegistrationError> {
        let shapes = input.shapes.shapes();
        let fitted = |weights: &[f64], mut pose: Pose| {
            if problem.cancel.is_set() {
                return (f64::INFINITY, pose);
            }
            let deformed = Problem { template: self.surfels(input, weights), ..*problem };
            let exact = |reach: f64| Matching { count: EXPRESSION, reach, exact: true };
            deformed.descend(&mut pose, Matching { count: EXPRESSION, reach: LOOK_REACH, exact: false }, 4, 0.05);
            deformed.descend(&mut pose, exact(1.5 * reach), 4, 0.05);
            (deformed.fit(&pose, exact(reach)).loss, pose)
        };
        let mut weights = vec![0.0; shapes.len()];
        let mut best = fitted(&weights, *pose);
        for _ in 0..MOST_EXPRESSIONS {
            let trials = (0..shapes.len()).filter(|&k| shapes[k].family != Family::Identity && weights[k] == 0.0);
            let trials: Vec<(usize, f64)> = trials.flat_map(|k| EXPRESSION_WEIGHTS.map(|w| (k, w))).collect();
            let ends: Vec<(f64, Pose)> = trials
                .par_iter()
                .map(|&(k, w)| {
                    let mut tried = weights.clone();
                    tried[k] = w;
                    fitted(&tried, best.1)
                })
                .collect();
            problem.cancel.check()?;
            let better = (0..ends.len()).min_by(|&a, &b| ends[a].0.total_cmp(&ends[b].0));
            let Some(i) = better.filter(|&i| ends[i].0 < (1.0 - EXPRESSION_GAIN) * best.0) else { break };
            weights[trials[i].0] = trials[i].1;
            best = ends[i];
        }
        let used: Vec<usize> = (0..shapes.len()).filter(|&k| weights[k] != 0.0).collect();
        if !used.is_empty() {
            let seen = (0..input.template.positions.len()).filter(|&v| !input.ignored[v]);
            let pair = |v: usize| {
                let rest = input.template.positions[v];
                (rest / input.unit, best.1.apply(input.shapes.blend(v, rest, &weights) / input.unit))
            };
            *pose = closest_pose(&seen.map(pair).collect::<Vec<_>>(), problem.kind)?;
        }
        Ok(used.into_iter().map(|k| (shapes[k].name.clone(), weights[k])).collect())
    }
}

const NO_NORMALS: &str = "its surface is folded everywhere, so that it faces nowhere";

/// The surfel with the least sum of distances to all others.
fn medoid(surfels: &[Surfel]) -> usize {
    let few: Vec<Vec3> = surfels.iter().step_by(surfels.len() / 500 + 1).map(|s| s.point).collect();
    let sum = |p: Vec3| few.iter().map(|q| (p - q).norm()).sum::<f64>();
    let sums: Vec<f64> = surfels.iter().map(|s| sum(s.point)).collect();
    (0..sums.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b])).unwrap_or(0)
}

/// The best, no two the same. The given pose wins if it is as good, up to `greatest_rival`.
fn distinct(problem: &Problem<'_>, mut candidates: Vec<Candidate>, most: usize, greatest_rival: f64) -> Vec<Candidate> {
    let gain = |c: &Candidate| (1.0 - c.fit.loss) / if c.given { greatest_rival } else { 1.0 };
    candidates.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    let mut kept: Vec<Candidate> = Vec::new();
    for c in candidates {
        if kept.len() < most && !kept.iter().any(|k| problem.same(&k.pose, &c.pose)) {
            kept.push(c);
        }
    }
    kept
}

/// Tries all rotations at all places; how many there were, and the best of them.
fn look(problem: &Problem<'_>, given: &Pose, options: &StartOptions) -> (usize, Vec<Pose>) {
    let anchor = problem.template[0];
    let places = farthest_points(&problem.scan.coarse, 0, MOST_PLACES, options.spacing);
    let start = (Vec3::zeros(), Vec3::zeros(), 0.0);
    let add = |(p, q, total): (Vec3, Vec3, f64), (at, target, share): &(Vec3, Vec3, f64)| {
        let weight = share / LANDMARK_WEIGHT;
        (p + at * weight, q + target * weight, total + weight)
    };
    let (p, q, total) = problem.landmarks.iter().fold(start, add);
    let sorted = |poses: Vec<Pose>, surfels: usize, most: usize| -> Vec<Candidate> {
        let how = Matching { count: surfels, reach: LOOK_REACH, exact: false };
        let fitted = poses.into_iter().map(|pose| Candidate { fit: problem.fit(&pose, how), pose, given: false });
        let mut fitted: Vec<Candidate> = fitted.collect();
        fitted.sort_by(|a, b| a.fit.loss.total_cmp(&b.fit.loss));
        fitted.truncate(most);
        fitted
    };
    let poses = |rotation: Matrix3<f64>| -> Vec<Pose> {
        let onto = |p: Vec3, q: Vec3, scale: f64| Pose { scale, rotation, translation: q - rotation * p * scale };
        let scales: &[f64] = if problem.kind == PoseKind::Similarity { &LOOK_SCALES } else { &[1.0] };
        if total > 0.0 {
            return scales.iter().map(|&scale| onto(p / total, q / total, scale)).collect();
        }
        let normal = rotation * anchor.normal;
        let facing = places.iter().map(|&i| &problem.scan.coarse[i]).filter(|s| s.normal.dot(&normal) > FACING);
        facing.flat_map(|s| scales.iter().map(|&scale| onto(anchor.point, s.point, scale))).collect()
    };
    let best: Vec<(usize, Vec<Candidate>)> = rotations(given, options.rotations)
        .into_par_iter()
        .map(|rotation| {
            if problem.cancel.is_set() {
                return (0, Vec::new());
            }
            let all = poses(rotation);
            let tried = all.len();
            let better = sorted(all, GLANCE, LOOKED_AT).into_iter().map(|c| c.pose).collect();
            (tried, sorted(better, LOOK, KEPT))
        })
        .collect();
    let tried = best.iter().map(|b| b.0).sum();
    let mut all: Vec<Candidate> = best.into_iter().flat_map(|b| b.1).collect();
    all.sort_by(|a, b| a.fit.loss.total_cmp(&b.fit.loss));
    (tried, all.into_iter().take(options.coarse).map(|c| c.pose).collect())
}

/// The given rotation, it turned about the template's vertical, and `count` rotations spread evenly.
fn rotations(given: &Pose, count: usize) -> Vec<Matrix3<f64>> {
    let about_vertical =
        (0..12).map(|k| Rotation3::from_axis_angle(&Vec3::y_axis(), f64::from(k) * 30f64.to_radians()));
    let mut all: Vec<Matrix3<f64>> = about_vertical.map(|r| given.rotation * r.into_inner()).collect();
    // Alexa 2022: phi = sqrt 2, psi the real root of psi^4 = psi + 4.
    let (phi, psi) = (std::f64::consts::SQRT_2, 1.533_751_168_755_204_3);
    for i in 0..count {
        let s = i as f64 + 0.5;
        let (t, d) = (s / count as f64, std::f64::consts::TAU * s);
        let (r, rest) = (t.sqrt(), (1.0 - t).sqrt());
        let (alpha, beta) = (d / phi, d / psi);
        let q = nalgebra::Quaternion::new(r * alpha.sin(), r * alpha.cos(), rest * beta.sin(), rest * beta.cos());
        all.push(UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner());
    }
    all
}
