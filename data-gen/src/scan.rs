//! A scan of a face: what a structured-light scanner would deliver, with the truth that it would not.

use nonrigid::mesh::normals::{NormalWeighting::Area, vertex_normals};
use nonrigid::mesh::{TriangleMesh, Vec3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use crate::FaceRig;
use crate::remesh::Remesh;
use crate::visibility::seen_from;

/// What is scanned and how badly. Lengths in millimetres, angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanOptions {
    /// Expression weights by name; `None` draws three of 0.4 to 1. Unknown names are ignored.
    pub expressions: Option<Vec<(String, f64)>>,
    /// Identity weights; `None` draws them from N(0, `identity_sigma`).
    pub identity: Option<Vec<f64>>,
    /// Standard deviation of drawn identity weights; default 0.8.
    pub identity_sigma: f64,
    /// Largest height of wrinkles that no shape expresses; default 0.8.
    pub detail: f64,
    /// Largest angle of the random rotation; default 12.
    pub rotation: f64,
    /// Largest translation along each axis; default 20.
    pub translation: f64,
    /// Scan points along each side of a template quad, 1 to 12; default 3.
    pub density: usize,
    /// Angles about Y of the cameras, from +Z towards +X; default -30, 0, 30. Empty: everything is seen.
    pub cameras: Vec<f64>,
    /// Distance of the cameras; default 700.
    pub camera_distance: f64,
    /// Steepest angle between surface normal and view ray at which a point is still seen; default 70.
    pub grazing: f64,
    /// Standard deviation of the noise along the view ray; default 0.1.
    pub noise: f64,
    /// Number of holes; default 4.
    pub holes: usize,
    /// Smallest and largest radius of a hole; default 4 to 9.
    pub hole_radius: [f64; 2],
    /// Share of the points that are spikes, 3 to 15 mm along the ray; default 0.001.
    pub spikes: f64,
    /// Number of loose parts that float beside the face; default 2.
    pub loose_parts: usize,
    /// Standard deviation of the landmarks along each axis; default 1.
    pub landmark_noise: f64,
}

impl Default for ScanOptions {
    fn default() -> Self {
        Self {
            expressions: None,
            identity: None,
            identity_sigma: 0.8,
            detail: 0.8,
            rotation: 12.0,
            translation: 20.0,
            density: 3,
            cameras: vec![-30.0, 0.0, 30.0],
            camera_distance: 700.0,
            grazing: 70.0,
            noise: 0.1,
            holes: 4,
            hole_radius: [4.0, 9.0],
            spikes: 0.001,
            loose_parts: 2,
            landmark_noise: 1.0,
        }
    }
}

impl ScanOptions {
    /// The face as it is: no noise, holes, spikes, loose parts, detail, pose or hidden regions, exact landmarks.
    #[must_use]
    pub fn clean() -> Self {
        Self {
            detail: 0.0,
            rotation: 0.0,
            translation: 0.0,
            cameras: Vec::new(),
            noise: 0.0,
            holes: 0,
            spikes: 0.0,
            loose_parts: 0,
            landmark_noise: 0.0,
            ..Self::default()
        }
    }
}

/// A rigid motion from rig to scan coordinates, scan = `rotation` x rig + `translation`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pose {
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// Millimetres.
    pub translation: [f64; 3],
}

impl Pose {
    /// The point in scan coordinates.
    #[must_use]
    pub fn apply(&self, p: &Vec3) -> Vec3 {
        self.rotate(p) + Vec3::from(self.translation)
    }

    fn rotate(&self, p: &Vec3) -> Vec3 {
        Vec3::from(self.rotation.map(|row| Vec3::from(row).dot(p)))
    }
}

/// A simulated scan and everything that is known about it.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanCase {
    /// What the scanner delivers.
    pub scan: TriangleMesh,
    /// Where each template vertex truly is, in scan coordinates, detail included.
    pub truth: Vec<Vec3>,
    /// Whether the scan shows the surface all round the vertex.
    pub observed: Vec<bool>,
    /// Template vertex and noisy position in the scan, for the landmarks whose vertex is observed.
    pub landmarks: Vec<(u32, Vec3)>,
    /// Weight of each of the rig's expressions.
    pub expression_weights: Vec<f64>,
    /// Weight of each of the rig's identity modes.
    pub identity_weights: Vec<f64>,
    /// From the rig's coordinates to the scan's.
    pub pose: Pose,
}

/// Scans `rig`. Everything random comes from `seed`; each stage draws from a stream of its own, so that one option does not
/// change what the others draw.
#[must_use]
pub fn simulate_scan(rig: &FaceRig, options: &ScanOptions, seed: u64) -> ScanCase {
    let stream = |number: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number);
        rng
    };
    let expression_weights = expression_weights(rig, options, &mut stream(1));
    let identity_weights = identity_weights(rig, options, &mut stream(2));
    let pose = random_pose(options, &mut stream(3));

    let coarse_triangles = rig.mesh.triangulate().triangles;
    let face: Vec<Vec3> = rig.pose(&expression_weights, &identity_weights).iter().map(|p| pose.apply(p)).collect();
    let face_normals = vertex_normals(&face, &coarse_triangles, Area);
    let fine = Remesh::new(&rig.mesh, options.density.clamp(1, 12), &mut stream(4));
    let mut points = fine.positions(&rig.mesh, &face, &face_normals);
    let normals = vertex_normals(&points, &fine.triangles, Area);

    // Detail is a function of the place on the neutral face, so that truth and scan carry the same.
    let wrinkles = Wrinkles::new(options.detail, &mut stream(5));
    let rest_normals = vertex_normals(&rig.neutral, &coarse_triangles, Area);
    let rest = fine.positions(&rig.mesh, &rig.neutral, &rest_normals);
    for (p, (n, r)) in points.iter_mut().zip(normals.iter().zip(&rest)) {
        *p += n * wrinkles.height(r);
    }
    let lifted = |((p, n), r): ((&Vec3, &Vec3), &Vec3)| p + n * wrinkles.height(r);
    let truth: Vec<Vec3> = face.iter().zip(&face_normals).zip(&rig.neutral).map(lifted).collect();

    // Visibility: the camera that sees a point most squarely measures it.
    let centre = truth.iter().sum::<Vec3>() / truth.len().max(1) as f64;
    let least = options.grazing.to_radians().cos();
    let mut best: Vec<Option<(f64, Vec3)>> = vec![None; points.len()];
    for angle in &options.cameras {
        let (sin, cos) = angle.to_radians().sin_cos();
        let eye = centre + Vec3::new(sin, 0.0, cos) * options.camera_distance.max(300.0);
        let cosines = seen_from(eye, &points, &normals, &fine.triangles, 2.0);
        for (v, cosine) in cosines.into_iter().enumerate() {
            if let Some(cosine) = cosine
                && cosine > least
                && best[v].is_none_or(|(known, _)| cosine > known)
            {
                best[v] = Some((cosine, (eye - points[v]).normalize()));
            }
        }
    }
    if options.cameras.is_empty() {
        best = normals.iter().map(|n| Some((1.0, *n))).collect();
    }
    let mut kept: Vec<bool> = best.iter().map(Option::is_some).collect();
    punch_holes(&mut kept, &points, options, &mut stream(6));
    let observed = fine.rings.iter().map(|ring| !ring.is_empty() && ring.iter().all(|v| kept[*v as usize])).collect();

    // Measure.
    let mut rng = stream(7);
    let mut spikes = stream(8);
    for (p, seen) in points.iter_mut().zip(&best) {
        let noise: f64 = StandardNormal.sample(&mut rng);
        let spike = spikes.random::<f64>() < options.spikes;
        let height = spikes.random_range(3.0..15.0) * if spikes.random::<bool>() { 1.0 } else { -1.0 };
        if let Some((_, ray)) = seen {
            *p += ray * (noise * options.noise + if spike { height } else { 0.0 });
        }
    }
    let mut triangles: Vec<[u32; 3]> =
        fine.triangles.iter().copied().filter(|t| t.iter().all(|v| kept[*v as usize])).collect();
    add_loose_parts(&mut points, &mut triangles, centre, options, &mut stream(9));
    let scan = shuffled(&points, &triangles, &mut stream(10));

    let observed: Vec<bool> = observed;
    let mut rng = stream(11);
    let mut landmarks = Vec::new();
    for landmark in &rig.landmarks {
        let noise = Vec3::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let v = landmark.vertex as usize;
        if observed.get(v) == Some(&true) {
            landmarks.push((landmark.vertex, truth[v] + noise * options.landmark_noise));
        }
    }
    ScanCase { scan, truth, observed, landmarks, expression_weights, identity_weights, pose }
}

fn expression_weights(rig: &FaceRig, options: &ScanOptions, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut weights = vec![0.0; rig.expressions.len()];
    if let Some(wanted) = &options.expressions {
        for (weight, (name, _)) in weights.iter_mut().zip(&rig.expressions) {
            *weight = wanted.iter().rev().find(|w| w.0 == *name).map_or(0.0, |w| w.1);
        }
    } else {
        let mut order: Vec<usize> = (0..weights.len()).collect();
        order.shuffle(rng);
        for k in order.into_iter().take(3) {
            weights[k] = rng.random_range(0.4..1.0);
        }
    }
    weights
}

fn identity_weights(rig: &FaceRig, options: &ScanOptions, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut draw = |_| -> f64 {
        let normal: f64 = StandardNormal.sample(rng);
        normal * options.identity_sigma
    };
    let drawn = (0..rig.identities.len()).map(&mut draw).collect::<Vec<f64>>();
    match &options.identity {
        None => drawn,
        Some(wanted) => (0..drawn.len()).map(|k| wanted.get(k).copied().unwrap_or(0.0)).collect(),
    }
}

fn random_pose(options: &ScanOptions, rng: &mut ChaCha8Rng) -> Pose {
    let axis = Vec3::from_fn(|_, _| StandardNormal.sample(rng)).try_normalize(1e-9).unwrap_or_else(Vec3::y);
    let angle = rng.random_range(-1.0..1.0) * options.rotation.to_radians();
    let translation = Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * options.translation;
    // Rodrigues' formula, column by column.
    let (sin, cos) = angle.sin_cos();
    let turn = |p: Vec3| p * cos + axis.cross(&p) * sin + axis * (axis.dot(&p) * (1.0 - cos));
    let columns = [turn(Vec3::x()), turn(Vec3::y()), turn(Vec3::z())];
    let rotation = [0, 1, 2].map(|row| columns.map(|c| c[row]));
    Pose { rotation, translation: [translation.x, translation.y, translation.z] }
}

/// A sum of plane waves, sharpened to folds, fading in and out over the face.
struct Wrinkles {
    waves: Vec<(Vec3, f64)>,
    fade: Vec<(Vec3, f64)>,
    height: f64,
}

impl Wrinkles {
    fn new(height: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut wave = |short: f64, long: f64| {
            let direction: Vec3 = Vec3::from_fn(|_, _| StandardNormal.sample(rng));
            let length = rng.random_range(short..long);
            let direction = direction.try_normalize(1e-9).unwrap_or_else(Vec3::x);
            (direction * (std::f64::consts::TAU / length), rng.random_range(0.0..std::f64::consts::TAU))
        };
        Self {
            waves: (0..4).map(|_| wave(9.0, 18.0)).collect(),
            fade: (0..4).map(|_| wave(50.0, 90.0)).collect(),
            height,
        }
    }

    /// Height above the smooth face, at most `self.height` either way.
    fn height(&self, rest: &Vec3) -> f64 {
        let sine = |(k, phase): &(Vec3, f64)| (k.dot(rest) + phase).sin();
        let folds: f64 = self.waves.iter().zip(&self.fade).map(|(w, f)| sine(w) * (0.5 + 0.5 * sine(f))).sum();
        self.height * (0.9 * folds).tanh()
    }
}

fn punch_holes(kept: &mut [bool], points: &[Vec3], options: &ScanOptions, rng: &mut ChaCha8Rng) {
    let seen: Vec<usize> = (0..kept.len()).filter(|v| kept[*v]).collect();
    if seen.is_empty() {
        return;
    }
    let (small, large) = (options.hole_radius[0], options.hole_radius[1].max(options.hole_radius[0]));
    for _ in 0..options.holes {
        let centre = points[seen[rng.random_range(0..seen.len())]];
        let radius = small + (large - small) * rng.random::<f64>();
        for (keep, p) in kept.iter_mut().zip(points) {
            *keep &= (p - centre).norm() > radius;
        }
    }
}

/// Small crumpled patches, 30 to 70 mm in front of or beside the face.
fn add_loose_parts(
    points: &mut Vec<Vec3>,
    triangles: &mut Vec<[u32; 3]>,
    centre: Vec3,
    options: &ScanOptions,
    rng: &mut ChaCha8Rng,
) {
    const SIDE: u32 = 4;
    for _ in 0..options.loose_parts {
        let angle = rng.random_range(-1.3..1.3f64);
        let away = Vec3::new(angle.sin(), rng.random_range(-0.6..0.6), angle.cos());
        let middle = centre + away * rng.random_range(110.0..150.0);
        let first = points.len() as u32;
        for j in 0..SIDE {
            for i in 0..SIDE {
                let mut jitter = || rng.random_range(-0.7..0.7);
                let offset = Vec3::new(f64::from(i) * 2.0 + jitter(), f64::from(j) * 2.0 + jitter(), jitter());
                points.push(middle + offset);
            }
        }
        for j in 0..SIDE - 1 {
            for i in 0..SIDE - 1 {
                let a = first + j * SIDE + i;
                triangles.extend([[a, a + 1, a + 1 + SIDE], [a, a + 1 + SIDE, a + SIDE]]);
            }
        }
    }
}

/// The referenced points in random order, and the triangles too: order carries no hint of the correspondence.
fn shuffled(points: &[Vec3], triangles: &[[u32; 3]], rng: &mut ChaCha8Rng) -> TriangleMesh {
    let mut used = vec![false; points.len()];
    triangles.iter().flatten().for_each(|v| used[*v as usize] = true);
    let mut order: Vec<usize> = (0..points.len()).filter(|v| used[*v]).collect();
    order.shuffle(rng);
    let mut renamed = vec![0u32; points.len()];
    for (new, old) in order.iter().enumerate() {
        renamed[*old] = new as u32;
    }
    let mut triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|v| renamed[v as usize])).collect();
    triangles.shuffle(rng);
    TriangleMesh { positions: order.into_iter().map(|v| points[v]).collect(), triangles }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FaceOptions;

    fn rig() -> FaceRig {
        FaceRig::generate(&FaceOptions::default())
    }

    fn nearest(p: &Vec3, points: &[Vec3]) -> f64 {
        points.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn no_scan_vertex_is_a_template_vertex() {
        let rig = rig();
        for options in [ScanOptions::default(), ScanOptions::clean()] {
            let case = simulate_scan(&rig, &options, 3);
            assert_eq!(case.truth.len(), rig.neutral.len());
            assert!(case.truth.iter().all(|p| nearest(p, &case.scan.positions) > 1e-9));
        }
    }

    #[test]
    fn observed_vertices_lie_on_the_scan_and_others_do_not_count() {
        let rig = rig();
        let case = simulate_scan(&rig, &ScanOptions::default(), 4);
        let share = case.observed.iter().filter(|o| **o).count() as f64 / case.observed.len() as f64;
        assert!(share > 0.8 && share < 1.0, "{share}");
        let frontal = ScanOptions { cameras: vec![0.0], grazing: 50.0, ..ScanOptions::default() };
        let fewer = simulate_scan(&rig, &frontal, 4).observed.iter().filter(|o| **o).count() as f64;
        assert!(fewer < 0.85 * share * case.observed.len() as f64, "{fewer}");
        let far = case.truth.iter().zip(&case.observed).filter(|(_, o)| **o);
        assert!(far.map(|(p, _)| nearest(p, &case.scan.positions)).all(|d| d < 5.0));
        assert!(case.landmarks.len() > 15);
        for (v, p) in &case.landmarks {
            assert!((p - case.truth[*v as usize]).norm() < 6.0);
        }
    }

    #[test]
    fn equal_seeds_give_equal_bits_and_others_do_not() {
        let rig = rig();
        let bits = |case: &ScanCase| -> Vec<u64> {
            let positions = case.scan.positions.iter().chain(&case.truth).chain(case.landmarks.iter().map(|l| &l.1));
            positions.flat_map(|p| [p.x, p.y, p.z]).map(f64::to_bits).collect()
        };
        let options = ScanOptions::default();
        let (a, b, c) =
            (simulate_scan(&rig, &options, 7), simulate_scan(&rig, &options, 7), simulate_scan(&rig, &options, 8));
        assert_eq!(bits(&a), bits(&b));
        assert_eq!(a.scan.triangles, b.scan.triangles);
        assert_ne!(bits(&a), bits(&c));
        let quiet = simulate_scan(&rig, &ScanOptions { noise: 0.0, ..options }, 7);
        assert_eq!((quiet.truth, quiet.scan.triangles), (a.truth, a.scan.triangles), "streams are independent");
    }

    #[test]
    fn a_clean_scan_is_the_rig_in_its_own_place() {
        let rig = rig();
        let options = ScanOptions {
            expressions: Some(vec![("jawOpen".into(), 0.5), ("nonsense".into(), 1.0)]),
            identity: Some(vec![1.0]),
            ..ScanOptions::clean()
        };
        let case = simulate_scan(&rig, &options, 1);
        let expected = rig.pose(&case.expression_weights, &case.identity_weights);
        let largest = case.truth.iter().zip(&expected).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(largest < 1e-9, "{largest}");
        assert_eq!((case.expression_weights[0], case.identity_weights[0], case.identity_weights[1]), (0.5, 1.0, 0.0));
        assert!(case.observed.iter().all(|o| *o));
    }

    #[test]
    fn extreme_options_do_not_panic() {
        let rig = FaceRig::generate(&FaceOptions { vertices: 0 });
        let options = ScanOptions {
            cameras: vec![180.0],
            grazing: 0.0,
            holes: 50,
            hole_radius: [9.0, 1.0],
            spikes: 1.0,
            density: 0,
            ..ScanOptions::default()
        };
        let _ = simulate_scan(&rig, &options, u64::MAX);
    }
}
