//! The search of a start: the template, as a few hundred surfels, is put on the scan in many rotations (spread evenly over all of them
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
//! Whether the winner is right cannot be read off its loss alone: half a face has more than the back of a head. But on smooth
//! things many poses are as good as the best. So a start is refused where its loss is high or a pose elsewhere comes close.

use std::borrow::Cow;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use rayon::prelude::*;

use super::expressions::Expressions;
use super::icp::{FINE_SURFEL, LOOK_REACH, Matching, Problem, SCALE_SIGMA, ScanSurfels};
use super::{OTHER_SIZE, StartFit, StartInput, StartOptions, StartSearch};
use crate::landmark::Landmark;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::normals::face_areas;
use crate::mesh::{Pose, PoseKind, TriangleMesh, Vec3};
use crate::registration::surfels::{Frame, Lattice, Surfel, farthest_points, surfels};
use crate::registration::{RegistrationError, ScanFlip};

/// Size of the scan's surfels in the first look, millimetres.
const COARSE_SURFEL: f64 = 8.0;
/// Surfels of the template in a glance at every pose, in a look at the better ones, in coarse and in fine refinement.
const GLANCE: usize = 24;
const LOOK: usize = 60;
const COARSE: usize = 150;
const FINE: usize = 500;
/// Poses of each rotation that are looked at, and that are kept.
const LOOKED_AT: usize = 16;
const KEPT: usize = 4;
/// Places tried on a scan at most.
const MOST_PLACES: usize = 800;
/// Least cosine between the normals of template and scan at a place.
const FACING: f64 = 0.3;
/// Scan over template in size (root of the surface's area): a scan smaller than the least does not hold the share of the
/// template that a start needs, and one larger than the greatest is no person.
const SIZES: std::ops::RangeInclusive<f64> = 0.35..=9.0;
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
/// Share of its gain below which a rigid start does not keep its own size, either.
const OWN_SIZE: f64 = 0.8;

#[derive(Clone, Copy)]
struct Candidate {
    pose: Pose,
    fit: StartFit,
    given: bool,
}

/// Searches the start; `given`, the pose that wins where it is as good, is the identity unless landmarks know better.
pub(super) fn search_start(
    input: &StartInput<'_>,
    kind: PoseKind,
    options: &StartOptions,
    given: Option<&Pose>,
) -> Result<(Pose, StartSearch), RegistrationError> {
    let discs = input.scan.triangles.is_empty().then(|| discs(input.scan, input.scan_normals.unwrap_or_default()));
    let (scan, scan_normals) = match &discs {
        Some((mesh, normals)) => (mesh, Some(&normals[..])),
        None => (input.scan, input.scan_normals),
    };
    let input = &StartInput { scan: &without_far(scan), scan_normals, ..*input };
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
    let (pose, search) = match input.flip {
        ScanFlip::Yes => search(true)?,
        ScanFlip::No => search(false)?,
        ScanFlip::Auto => {
            let as_given = search(false)?;
            if as_given.1.fit.loss > EVIDENT {
                let over = search(true)?;
                let tried = as_given.1.tried + over.1.tried;
                let turned = over.1.fit.gain() > as_given.1.fit.gain() / options.greatest_rival;
                let best = if turned { over } else { as_given };
                (best.0, StartSearch { tried, ..best.1 })
            } else {
                as_given
            }
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

/// A point cloud as triangles: one in the tangent plane of each point that has a normal, as wide as points lie apart, with the
/// point's normal at its corners.
fn discs(cloud: &TriangleMesh, normals: &[Vec3]) -> (TriangleMesh, Vec<Vec3>) {
    let (centres, normals): (Vec<Vec3>, Vec<Vec3>) =
        cloud.positions.iter().zip(normals).filter(|(_, n)| n.norm_squared() > 0.0).unzip();
    let Ok(tree) = ClosestVertices::new(&centres) else { return Default::default() };
    let to_nearest = tree.neighbourhoods(2, |_, found| found.last().map_or(0.0, |f| f.squared_distance.sqrt()));
    let mut mesh = TriangleMesh::default();
    for ((p, n), apart) in centres.iter().zip(&normals).zip(to_nearest) {
        let u = n.cross(&Vec3::ith(n.iamin(), 1.0)).normalize() * apart;
        let w = n.cross(&u) / n.norm();
        let first = mesh.positions.len() as u32;
        let (sin, cos) = (2.0 * std::f64::consts::PI / 3.0).sin_cos();
        mesh.positions.extend([p + u, p + u * cos + w * sin, p + u * cos - w * sin]);
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    let of_corners = normals.iter().flat_map(|n| [*n; 3]).collect();
    (mesh, of_corners)
}

/// Both surfaces as surfels, in the scan's frame.
struct Surfels {
    frame: Frame,
    template: Vec<Surfel>,
    scan: ScanSurfels,
    /// As [`Problem`] has them.
    landmarks: Vec<(Vec3, Vec3, f64)>,
}

impl Surfels {
    /// Of the scan divided by `factor`.
    fn of(input: &StartInput<'_>, factor: f64, flipped: bool) -> Result<Self, RegistrationError> {
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
        input.cancel.check()?;
        let fine = of_scan(FINE_SURFEL);
        input.cancel.check()?;
        if even.is_empty() {
            return Err(RegistrationError::Template(NO_NORMALS.into()));
        }
        if coarse.is_empty() || fine.is_empty() {
            return Err(RegistrationError::Scan(NO_NORMALS.into()));
        }
        let points: Vec<Vec3> = fine.iter().map(|s| s.point).collect();
        let local = |(p, l): &(Vec3, &Landmark)| {
            let vagueness = l.sigma.unwrap_or(0.0) / (frame.unit * LOOK_REACH);
            let most = LANDMARK_WEIGHT.min(MOST_LANDMARKS / input.landmarks.len() as f64);
            let weight = most / (1.0 + vagueness * vagueness);
            // Vaguer than the reach of the look, a landmark says nothing about where to look.
            (vagueness <= 1.0).then(|| ((p - input.centre) / input.unit, frame.to_local(l.target), weight))
        };
        Ok(Self {
            frame,
            template: farthest_points(&even, medoid(&even), FINE, 0.0).iter().map(|&i| even[i]).collect(),
            scan: ScanSurfels {
                lattice: Lattice::new(&coarse, COARSE_SURFEL, LOOK_REACH),
                coarse,
                tree: ClosestVertices::new(&points).map_err(|e| RegistrationError::Scan(e.to_string()))?,
                fine,
            },
            landmarks: input.landmarks.iter().filter_map(local).collect(),
        })
    }
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
    let Surfels { frame, template, scan, landmarks } = Surfels::of(input, factor, flipped)?;
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
    let ends = refined(&problem, poses, (factor == 1.0).then_some(given), options);
    cancel.check()?;
    let refined = ends.len();
    let mut ends = distinct(&problem, ends, usize::MAX, options.greatest_rival);
    if kind == PoseKind::Rigid && (ends[0].pose.scale * factor).ln().abs() <= OTHER_SIZE {
        ends = of_own_size(&mut problem, ends, 1.0 / factor, options);
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

/// How surfels find each other in the end.
fn fine(reach: f64) -> Matching {
    Matching { count: FINE, reach, exact: true }
}

/// Where the best of the poses, and the given one, go by themselves.
fn refined(problem: &Problem<'_>, poses: Vec<Pose>, given: Option<Pose>, options: &StartOptions) -> Vec<Candidate> {
    let coarse = Matching { count: COARSE, reach: LOOK_REACH, exact: false };
    let coarsely = |mut pose: Pose| {
        problem.descend(&mut pose, coarse, 12, 0.5);
        Candidate { pose, fit: problem.fit(&pose, coarse), given: false }
    };
    let ends = poses.into_par_iter().map(coarsely).collect();
    let mut chosen = distinct(problem, ends, options.fine, options.greatest_rival);
    chosen.extend(given.map(|pose| Candidate { pose, fit: problem.fit(&pose, coarse), given: true }));
    let finely = |mut c: Candidate| {
        for share in [2.5, 1.75, 1.25, 1.0] {
            problem.descend(&mut c.pose, fine(share * options.reach), 8, 0.05);
        }
        Candidate { fit: problem.fit(&c.pose, fine(options.reach)), ..c }
    };
    chosen.into_par_iter().map(finely).collect()
}

/// The ends of poses held at the template's own size, `scale` here, if the best of them fits nearly as well. The others are held to it
/// too: of any size, they fit a part of the scan that is as small as they like.
fn of_own_size(problem: &mut Problem<'_>, ends: Vec<Candidate>, scale: f64, options: &StartOptions) -> Vec<Candidate> {
    let freest = std::mem::replace(&mut problem.kind, PoseKind::Rigid);
    let held = |c: &Candidate| {
        let mut pose = Pose { scale, ..c.pose };
        problem.descend(&mut pose, fine(options.reach), 8, 0.05);
        Candidate { pose, fit: problem.fit(&pose, fine(options.reach)), given: c.given }
    };
    let own = distinct(problem, ends.par_iter().map(held).collect(), usize::MAX, options.greatest_rival);
    if own[0].fit.gain() >= OWN_SIZE * ends[0].fit.gain() {
        return own;
    }
    problem.kind = freest;
    ends
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
    let gain = |c: &Candidate| c.fit.gain() / if c.given { greatest_rival } else { 1.0 };
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
