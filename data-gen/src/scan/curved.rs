//! The surface of a rig that is a mesh and no formula: curved PN triangles (Vlachos et al. 2001) through its posed vertices, with a
//! relief of waves. A scanner sees this, and not the mesh.

use std::f64::consts::TAU;

use nonrigid::mesh::normals::{NormalWeighting::Angle, vertex_normals};
use nonrigid::mesh::{Pose, Vec3, bounding_box};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::deformation::deform;
use super::{ScanError, ScanOptions, Solid, Stream};
use crate::FaceRig;

/// Lengths of waves are for a face of this extent, millimetres, and grow with the mesh.
pub(super) const FACE: f64 = 220.0;
/// Edges of the refined surface, millimetres on a face.
const EDGE: f64 = 0.6;
/// Parts along each side of a triangle at most.
const MOST_PARTS: usize = 12;

/// A plane wave: wave vector, phase, amplitude.
pub(super) struct Wave(Vec3, f64, f64);

impl Wave {
    pub fn new(lengths: [f64; 2], amplitude: f64, rng: &mut ChaCha8Rng) -> Self {
        let up: f64 = rng.random_range(-1.0..1.0);
        let (sin, cos) = rng.random_range(0.0..TAU).sin_cos();
        let level = (1.0 - up * up).sqrt();
        let number = TAU / rng.random_range(lengths[0]..lengths[1]);
        Self(Vec3::new(cos * level, up, sin * level) * number, rng.random_range(0.0..TAU), amplitude)
    }

    pub fn at(&self, p: &Vec3) -> f64 {
        self.2 * (self.0.dot(p) + self.1).sin()
    }
}

/// Largest extent of points along an axis.
pub(super) fn extent(points: &[Vec3]) -> f64 {
    bounding_box(points).map_or(0.0, |(low, high)| (high - low).max())
}

/// The person that these weights make, posed: the expression in a manner of their own, deformed, and with skin of their own.
///
/// # Errors
/// As [`deform`].
pub(super) fn person(
    rig: &FaceRig,
    options: &ScanOptions,
    [expressions, identity]: [&[f64]; 2],
    pose: Pose,
    seed: u64,
) -> Result<Solid, ScanError> {
    let scale = extent(&rig.neutral) / FACE;
    let neutral = rig.pose(&[], identity);
    let mut rng = Stream::Manner.of(seed);
    let manner: [[Wave; 3]; 3] =
        [0; 3].map(|_| [0; 3].map(|_| Wave::new([70.0 * scale, 160.0 * scale], options.manner / 3.0, &mut rng)));
    let shape =
        rig.pose(expressions, identity).into_iter().zip(&neutral).zip(&rig.neutral).map(|((p, rest), place)| {
            let factor = Vec3::from_fn(|axis, _| 1.0 + manner[axis].iter().map(|w| w.at(place)).sum::<f64>());
            rest + (p - rest).component_mul(&factor)
        });
    let mut shape: Vec<Vec3> = shape.collect();
    deform(rig, options, &mut shape, seed)?;
    shape.iter_mut().for_each(|p| *p = pose.apply(*p));
    let mut rng = Stream::Detail.of(seed);
    let skin = options.wrinkles.skin;
    let mut relief: Vec<Wave> = (0..5).map(|_| Wave::new([9.0 * scale, 20.0 * scale], 0.10 * skin, &mut rng)).collect();
    relief.extend((0..8).map(|_| Wave::new([2.5 * scale, 6.0 * scale], 0.035 * skin, &mut rng)));
    let height = |place: &Vec3| options.detail * relief.iter().map(|w| w.at(place)).sum::<f64>().tanh();

    let triangles = rig.mesh.triangulate().triangles;
    let normals = vertex_normals(&shape, &triangles, Angle);
    let truth = shape.iter().zip(&normals).zip(&rig.neutral).map(|((p, n), place)| p + n * height(place)).collect();
    let longest = triangles
        .iter()
        .map(|t| (0..3).map(|k| (shape[t[k] as usize] - shape[t[(k + 1) % 3] as usize]).norm()).sum::<f64>() / 3.0);
    let mean = longest.sum::<f64>() / triangles.len().max(1) as f64;
    let parts = ((mean / (EDGE * scale)).ceil() as usize).clamp(1, MOST_PARTS);
    let patches: Vec<Vec<Vec3>> = triangles
        .par_iter()
        .map(|t| {
            let corners = t.map(|v| v as usize);
            let places = corners.map(|v| rig.neutral[v]);
            let patch = Patch::new(corners.map(|v| shape[v]), corners.map(|v| normals[v]));
            let on = |w: [f64; 3]| {
                let place: Vec3 = (0..3).map(|k| places[k] * w[k]).sum();
                patch.at(w) + patch.normal(w) * height(&place)
            };
            lattice(parts).map(on).collect()
        })
        .collect();
    let each = (parts + 1) * (parts + 2) / 2;
    let inside = |patch: usize| split(parts).map(move |t| t.map(|k| (patch * each + k) as u32));
    let refined = (0..patches.len()).flat_map(inside).collect();
    let positions: Vec<Vec3> = patches.into_iter().flatten().collect();
    Ok(Solid { skin_points: positions.len(), positions, triangles: refined, truth })
}

/// Barycentric coordinates of a triangle's lattice, row by row.
fn lattice(parts: usize) -> impl Iterator<Item = [f64; 3]> {
    (0..=parts).flat_map(move |j| {
        (0..=parts - j).map(move |i| {
            let [u, v] = [i, j].map(|k| k as f64 / parts as f64);
            [1.0 - u - v, u, v]
        })
    })
}

/// The triangles of that lattice.
fn split(parts: usize) -> impl Iterator<Item = [usize; 3]> {
    let row = move |j: usize| j * (parts + 1) - j * (j.max(1) - 1) / 2;
    (0..parts).flat_map(move |j| {
        (0..parts - j).flat_map(move |i| {
            let (a, b) = (row(j) + i, row(j + 1) + i);
            let down = (i + 1 < parts - j).then_some([a + 1, b + 1, b]);
            std::iter::once([a, a + 1, b]).chain(down)
        })
    })
}

/// A cubic Bézier triangle: control points b300, b030, b003, b210, b120, b021, b012, b102, b201, b111.
struct Patch {
    control: [Vec3; 10],
    normals: [Vec3; 3],
}

impl Patch {
    fn new(p: [Vec3; 3], normals: [Vec3; 3]) -> Self {
        // A third of the way along the edge, in the tangent plane of its start.
        let toward = |i: usize, j: usize| (2.0 * p[i] + p[j] - normals[i] * (p[j] - p[i]).dot(&normals[i])) / 3.0;
        let edges = [toward(0, 1), toward(1, 0), toward(1, 2), toward(2, 1), toward(2, 0), toward(0, 2)];
        let (e, v) = (edges.iter().sum::<Vec3>() / 6.0, (p[0] + p[1] + p[2]) / 3.0);
        let [a, b, c, d, f, g] = edges;
        Self { control: [p[0], p[1], p[2], a, b, c, d, f, g, e + (e - v) / 2.0], normals }
    }

    fn at(&self, [w, u, v]: [f64; 3]) -> Vec3 {
        let basis = [
            w * w * w,
            u * u * u,
            v * v * v,
            3.0 * w * w * u,
            3.0 * w * u * u,
            3.0 * u * u * v,
            3.0 * u * v * v,
            3.0 * w * v * v,
            3.0 * w * w * v,
            6.0 * w * u * v,
        ];
        self.control.iter().zip(basis).map(|(p, b)| p * b).sum()
    }

    /// Between those of the corners, so that neighbours agree along their edge.
    fn normal(&self, w: [f64; 3]) -> Vec3 {
        let sum: Vec3 = (0..3).map(|k| self.normals[k] * w[k]).sum();
        sum.try_normalize(1e-9).unwrap_or(self.normals[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_goes_through_its_corners_and_bulges_as_a_ball_does() {
        let corners = [[0.0, 0.0], [0.2, 0.0], [0.05, 0.2]].map(|[x, y]| Vec3::new(x, y, 1.0).normalize());
        let patch = Patch::new(corners, corners);
        for (k, p) in corners.iter().enumerate() {
            let mut w = [0.0; 3];
            w[k] = 1.0;
            assert!((patch.at(w) - p).norm() < 1e-12);
        }
        let flat = corners.iter().sum::<Vec3>().norm() / 3.0;
        let middle = patch.at([1.0 / 3.0; 3]).norm();
        assert!(1.0 - flat > 6e-3 && (1.0 - middle).abs() < 1e-3, "{flat} {middle}");
        let parts = 5;
        let count = lattice(parts).count();
        let triangles: Vec<[usize; 3]> = split(parts).collect();
        assert_eq!((count, triangles.len()), (21, 25));
        let flat: Vec<[f64; 3]> = lattice(parts).collect();
        for t in triangles {
            let [a, b, c] = t.map(|k| [flat[k][1], flat[k][2]]);
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            assert!((area - 0.04).abs() < 1e-12, "{t:?} {area}");
        }
    }
}
