//! Scans for the search of a start, made worse: any pose, another size, parts of the surface, turned inside out, with other
//! things in view. Each keeps the true place of every template vertex.

use clap::ValueEnum;
use nonrigid::mesh::normals::{NormalWeighting, face_cross, vertex_normals};
use nonrigid::mesh::{Pose, PoseKind, TriangleMesh, Vec3, closest_pose};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::random_pose::any_pose;
use crate::scan_bench::BenchCase;

/// What is done to a scan. Each is turned by any rotation and moved besides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StartKind {
    /// Nothing.
    Turned,
    /// Another size, 0.8 to 1.25.
    Scaled,
    /// A plane cuts off up to two thirds of its surface.
    Cut,
    /// What is nearest to a point of it is left, down to a third.
    Patch,
    /// Another size, and a plane or a patch.
    ScaledPart,
    /// Its triangles face inwards.
    InsideOut,
    /// The same in part, at another size.
    InsideOutPart,
    /// Points with normals, a fifth of its vertices.
    Cloud,
    /// Such points, their normals inwards.
    InsideOutCloud,
    /// Every triangle faces either way.
    Mixed,
    /// What a camera sees from the side, 50 to 80 degrees from the front.
    Side,
    /// A face of 0.75 to 0.85 of the size.
    Child,
    /// A long neck, shoulders and a crown.
    Bust,
}

impl StartKind {
    /// Its name.
    #[must_use]
    pub fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }

    /// A case of this kind; the same one for the same seed.
    #[must_use]
    pub fn make(self, case: &BenchCase, seed: u64) -> BenchCase {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut case = case.clone();
        let share = rng.random_range(1.0 / 3.0..1.0);
        let scale = match self {
            Self::Scaled | Self::ScaledPart | Self::InsideOutPart => rng.random_range(0.8f64.ln()..1.25f64.ln()).exp(),
            Self::Child => rng.random_range(0.75..0.85),
            _ => 1.0,
        };
        let plane = matches!(self, Self::Cut) || rng.random_bool(0.5);
        match self {
            Self::Cut | Self::Patch | Self::ScaledPart | Self::InsideOutPart => {
                part(&mut case.scan.mesh, share, plane && self != Self::Patch, &mut rng);
            }
            Self::Side => from_the_side(&mut case, &mut rng),
            Self::Bust => bust(&mut case),
            _ => {}
        }
        let in_out = |mesh: &mut TriangleMesh| mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        case.scan.normals = None;
        match self {
            Self::InsideOut | Self::InsideOutPart | Self::InsideOutCloud => in_out(&mut case.scan.mesh),
            Self::Mixed => case.scan.mesh.triangles.iter_mut().for_each(|t| {
                if rng.random_bool(0.5) {
                    t.swap(1, 2);
                }
            }),
            _ => {}
        }
        if matches!(self, Self::Cloud | Self::InsideOutCloud) {
            let mesh = &mut case.scan.mesh;
            let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
            let kept: Vec<usize> =
                (0..mesh.positions.len()).filter(|&v| normals[v] != Vec3::zeros() && rng.random_bool(0.2)).collect();
            mesh.positions = kept.iter().map(|&v| mesh.positions[v]).collect();
            mesh.triangles.clear();
            case.scan.normals = Some(kept.iter().map(|&v| normals[v]).collect());
        }
        case.moved(&Pose { scale, ..any_pose(500.0, &mut rng) })
    }
}

/// Keeps this share of the surface: on one side of a plane, or nearest to a point.
fn part(mesh: &mut TriangleMesh, share: f64, plane: bool, rng: &mut ChaCha8Rng) {
    let direction = any_pose(1.0, rng).translation;
    let point = mesh.positions[mesh.triangles[rng.random_range(0..mesh.triangles.len())][0] as usize];
    let pieces = mesh.triangles.iter().map(|&t| {
        let centre = t.iter().map(|&v| mesh.positions[v as usize]).sum::<Vec3>() / 3.0;
        let far = if plane { centre.dot(&direction) } else { (centre - point).norm() };
        (far, face_cross(&mesh.positions, t).norm(), t)
    });
    let mut pieces: Vec<(f64, f64, [u32; 3])> = pieces.collect();
    pieces.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left = share * pieces.iter().map(|p| p.1).sum::<f64>();
    mesh.triangles = pieces.into_iter().map_while(|(_, area, t)| (left > 0.0).then(|| (left -= area, t).1)).collect();
}

/// Keeps what faces a camera 50 to 80 degrees to one side of the face and lies behind nothing that it sees.
fn from_the_side(case: &mut BenchCase, rng: &mut ChaCha8Rng) {
    let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let (sin, cos) = (side * rng.random_range(50f64..80.0).to_radians()).sin_cos();
    let own = face_pose(case);
    let to_camera = own.rotation * Vec3::new(sin, 0.0, cos);
    let mesh = &mut case.scan.mesh;
    let across = to_camera.cross(&(own.rotation * Vec3::y())).normalize();
    let up = across.cross(&to_camera);
    let cell = |p: Vec3| ((p.dot(&across) / 3.0).floor() as i64, (p.dot(&up) / 3.0).floor() as i64);
    let mut nearest = std::collections::HashMap::new();
    for p in &mesh.positions {
        let depth = nearest.entry(cell(*p)).or_insert(f64::NEG_INFINITY);
        *depth = p.dot(&to_camera).max(*depth);
    }
    let positions = &mesh.positions;
    mesh.triangles.retain(|&t| {
        let p = positions[t[0] as usize];
        let normal = face_cross(positions, t);
        normal.dot(&to_camera) > 0.25 * normal.norm() && p.dot(&to_camera) > nearest[&cell(p)] - 10.0
    });
}

/// The similarity that brings the rest shape nearest to the truth.
#[must_use]
pub fn face_pose(case: &BenchCase) -> Pose {
    let pairs: Vec<(Vec3, Vec3)> = case.rest().iter().copied().zip(case.truth.iter().copied()).collect();
    closest_pose(&pairs, PoseKind::Similarity).expect("proven: a template's vertices are not on a line")
}

/// Adds a neck, shoulders and a crown like a truncated cone that widens upwards.
fn bust(case: &mut BenchCase) {
    let rest = case.rest();
    let (low, high) = rest.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.y), h.max(p.y)));
    let pose = face_pose(case);
    let tau = std::f64::consts::TAU;
    let neck = |u: f64, v: f64| {
        let (sin, cos) = (tau * u).sin_cos();
        Vec3::new(52.0 * sin, low + 5.0 - 120.0 * v, 52.0 * cos - 25.0 - 15.0 * v)
    };
    let shoulders = |u: f64, v: f64| {
        let (sin, cos) = (-tau * u).sin_cos();
        Vec3::new(360.0 * v - 180.0, low - 150.0 - 60.0 * sin, 60.0 * cos - 45.0)
    };
    let crown = |u: f64, v: f64| {
        let (sin, cos) = (-tau * u).sin_cos();
        let radius = 78.0 + 45.0 * v;
        Vec3::new(radius * sin, high - 10.0 + 150.0 * v, radius * cos - 70.0 - 60.0 * v)
    };
    let parts = [sheet(60, &neck), sheet(60, &shoulders), sheet(60, &crown)];
    for part in parts {
        let first = case.scan.mesh.positions.len() as u32;
        case.scan.mesh.positions.extend(part.positions.iter().map(|&p| pose.apply(p)));
        case.scan.mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
}

/// `f(u, v)` over the unit square in steps of one in `steps`.
fn sheet(steps: u32, f: &dyn Fn(f64, f64) -> Vec3) -> TriangleMesh {
    let at = |i: u32| f64::from(i) / f64::from(steps);
    let positions = (0..=steps).flat_map(|j| (0..=steps).map(move |i| (i, j))).map(|(i, j)| f(at(i), at(j))).collect();
    let corner = |i: u32, j: u32| j * (steps + 1) + i;
    let cells = (0..steps).flat_map(|j| (0..steps).map(move |i| (i, j)));
    let triangles = cells.flat_map(|(i, j)| {
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        [[a, c, b], [a, d, c]]
    });
    TriangleMesh { positions, triangles: triangles.collect() }
}
