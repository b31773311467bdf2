//! Whether a result could as well be the mirror image of the subject: a scan that was mirrored on its way shows a face, too.
//!
//! Landmarks on both sides tell left from right. Without them the shapes may: let `v` be the result and `v'_i = S v_pi(i)` its
//! mirror image, with `S` a reflection and `pi` the template's own symmetry. Both are fitted by pose and shapes,
//!
//! ```text
//! E(v) = min_w,pose  n/m sum_i |pose(b_i(w)) - v_i|^2 / s^2 + sum_k (w_k / sigma_k)^2
//! ```
//!
//! and `(E(v') - E(v)) / 2` is the logarithm of how much more probable the result is than its mirror image. A known neutral with its
//! own asymmetry says much; a rig whose people are as often skewed to the left as to the right says nothing, and then nothing can
//! be known.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, SymmetricEigen};
use serde::Serialize;

use super::{RegistrationInput, RegistrationResult};
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{MirrorPlane, PoseKind, Vec3, closest_pose};

/// What tells a result from its mirror image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "by", content = "log_odds")]
pub enum Handedness {
    /// Landmarks.
    Landmarks,
    /// The shapes: logarithm of how much more probable the result is than its mirror image, negative if it is less.
    Shapes(f64),
    /// Nothing: the scan may be mirrored.
    Unknown(f64),
    /// The template is not symmetric: its mirror image is something else.
    Template,
}

/// Landmarks from which on they tell left from right.
const LANDMARKS: usize = 4;
/// Log-odds from which on the shapes tell: those of good results of `silence`'s design set speak for their mirror image by 7.3 at most.
const EVIDENT: f64 = 8.0;
/// Vertices that take part, and how many independent ones they stand for (`n` of the head comment).
const SAMPLES: usize = 600;
const INDEPENDENT: f64 = 100.0;
/// Rounds of closest points that find a template's plane of symmetry.
const ROUNDS: usize = 10;
/// `s` of the head comment, and the distance of a template from its mirror image up to which it is symmetric, shares of the size.
const MISFIT: f64 = 0.01;
const SYMMETRIC: f64 = 0.03;

impl Handedness {
    /// Compares a result with its mirror image.
    pub(super) fn of(input: &RegistrationInput<'_>, result: &RegistrationResult, size: f64) -> Self {
        if input.landmarks.len() >= LANDMARKS {
            return Self::Landmarks;
        }
        let Some(pairs) = mirrored_pairs(input, result, size) else { return Self::Template };
        match log_odds(input, result, &pairs, size) {
            Some(odds) if odds.abs() > EVIDENT => Self::Shapes(odds),
            odds => Self::Unknown(odds.unwrap_or(0.0)),
        }
    }

    /// What is to be said of a result that nothing tells from its mirror image.
    #[must_use]
    pub fn remark(self) -> Option<&'static str> {
        matches!(self, Self::Unknown(_)).then_some(
            "left and right: nothing tells them apart here, a mirrored scan would give as good a result; four landmarks would tell",
        )
    }

    /// How probable it is that the scan is mirrored, as log-odds; 0 where that is not known.
    #[must_use]
    pub fn against(self) -> f64 {
        if let Self::Shapes(odds) = self { -odds } else { 0.0 }
    }
}

/// Vertices that the scan shows on both sides, each with its mirror image; `None` if the template has none.
fn mirrored_pairs(
    input: &RegistrationInput<'_>,
    result: &RegistrationResult,
    size: f64,
) -> Option<Vec<(usize, usize)>> {
    let points = &input.template.positions;
    let tree = ClosestVertices::new(points).ok()?;
    let used = input.template.on_surface();
    let used: Vec<usize> = (0..points.len()).filter(|&i| used[i]).collect();
    let few: Vec<Vec3> = used.iter().step_by(used.len() / 200 + 1).map(|&i| points[i]).collect();
    let centre = used.iter().map(|&i| points[i]).sum::<Vec3>() / used.len().max(1) as f64;
    let (plane, away) = symmetry_plane(centre, &few, points, &tree)?;
    let scale = result.start.scale.max(f64::MIN_POSITIVE);
    if away > SYMMETRIC * size / scale {
        return None;
    }
    let all: Vec<usize> = (0..points.len()).filter(|&i| result.accepted[i]).collect();
    let image = |i: usize| tree.query(&plane.reflect(points[i])).map(|c| c.vertex as usize);
    let pairs = all.iter().step_by(all.len() / SAMPLES + 1).filter_map(|&i| Some((i, image(i)?)));
    Some(pairs.filter(|(_, j)| result.accepted[*j]).collect())
}

/// The plane in which a few points of a template come nearest to it, and how near: by closest points, from those across the axes, its own
/// and those in which it is given, since a template may be turned.
fn symmetry_plane(centre: Vec3, few: &[Vec3], points: &[Vec3], tree: &ClosestVertices) -> Option<(MirrorPlane, f64)> {
    let spread: Matrix3<f64> = few.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let own = SymmetricEigen::new(spread).eigenvectors;
    let images = |plane: &MirrorPlane| -> Vec<(Vec3, Vec3, f64)> {
        few.iter().filter_map(|p| Some((*p, points[tree.query(&plane.reflect(*p))?.vertex as usize], 1.0))).collect()
    };
    let settled = |normal: Vec3| {
        let mut plane = MirrorPlane::new(centre, normal)?;
        let mut pairs = images(&plane);
        for _ in 0..ROUNDS {
            plane = MirrorPlane::of_pairs(pairs.iter().copied())?;
            pairs = images(&plane);
        }
        let square = pairs.iter().map(|(p, q, _)| (plane.reflect(*p) - q).norm_squared()).sum::<f64>();
        Some((plane, (square / pairs.len() as f64).sqrt()))
    };
    let normals = (0..3).flat_map(|axis| [Vec3::ith(axis, 1.0), own.column(axis).into_owned()]);
    normals.filter_map(settled).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// `(E(v') - E(v)) / 2`; `None` where too little is shown.
fn log_odds(
    input: &RegistrationInput<'_>,
    result: &RegistrationResult,
    pairs: &[(usize, usize)],
    size: f64,
) -> Option<f64> {
    // without shapes nothing says how people differ
    if pairs.len() < 50 || input.shapes.is_empty() {
        return None;
    }
    let count = input.shapes.len();
    let precision = INDEPENDENT / (pairs.len() as f64 * (MISFIT * size / result.start.scale).powi(2));
    let mut rows = DMatrix::<f64>::zeros(3 * pairs.len(), count);
    for (r, (i, _)) in pairs.iter().enumerate() {
        (0..count).for_each(|k| rows.fixed_view_mut::<3, 1>(3 * r, k).copy_from(&input.shapes.displacement(*i, k)));
    }
    let mut normal = rows.tr_mul(&rows) * precision;
    for (k, shape) in input.shapes.shapes().iter().enumerate() {
        normal[(k, k)] += result.schedule.sigma.of(shape.family).powi(-2);
    }
    let factor = Cholesky::new(normal)?;
    let rest = input.rest_positions();
    let energy = |targets: &[Vec3]| -> Option<f64> {
        let mut weights = DVector::<f64>::zeros(count);
        let mut energy = 0.0;
        for _ in 0..4 {
            let moved = &rows * &weights;
            let blend = |r: usize, i: usize| rest[i] + Vec3::new(moved[3 * r], moved[3 * r + 1], moved[3 * r + 2]);
            let at: Vec<(Vec3, Vec3)> =
                pairs.iter().zip(targets).enumerate().map(|(r, ((i, _), t))| (blend(r, *i), *t)).collect();
            let pose = closest_pose(&at, PoseKind::Similarity).ok()?;
            let away = pairs.iter().zip(targets).flat_map(|((i, _), t)| {
                let d: [f64; 3] = (pose.apply_inverse(*t) - rest[*i]).into();
                d
            });
            let away = DVector::from_iterator(3 * pairs.len(), away);
            weights = factor.solve(&(rows.tr_mul(&away) * precision));
            let left = &away - &rows * &weights;
            let prior = input.shapes.shapes().iter().zip(weights.iter());
            let prior: f64 = prior.map(|(shape, w)| (w / result.schedule.sigma.of(shape.family)).powi(2)).sum();
            energy = precision * left.norm_squared() + prior;
        }
        Some(energy)
    };
    let given: Vec<Vec3> = pairs.iter().map(|(i, _)| result.positions[*i]).collect();
    let mirrored: Vec<Vec3> =
        pairs.iter().map(|(_, j)| result.positions[*j].component_mul(&Vec3::new(-1.0, 1.0, 1.0))).collect();
    Some((energy(&mirrored)? - energy(&given)?) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Pose;
    use crate::mesh::testing::sheet;

    #[test]
    fn a_template_has_its_plane_however_it_lies() {
        let height = |x: f64, y: f64| {
            25.0 * (-(x * x + (y - 5.0).powi(2)) / 150.0).exp() - 0.012 * x * x - 0.008 * y * y - 1e-4 * y.powi(3)
        };
        let face = sheet(81, 91, |c, r| {
            let (x, y) = (2.0 * c - 80.0, 2.0 * r - 90.0);
            Vec3::new(x, y, height(x, y))
        });
        for turn in [Vec3::zeros(), Vec3::z() * 0.1, Vec3::new(0.4, -0.7, 0.3), Vec3::new(-1.2, 0.2, 0.8)] {
            let pose = Pose::rigid(turn, Vec3::new(5.0, 40.0, -9.0));
            let points: Vec<Vec3> = face.positions.iter().map(|p| pose.apply(*p)).collect();
            let few: Vec<Vec3> = points.iter().step_by(40).copied().collect();
            let tree = ClosestVertices::new(&points).unwrap();
            let centre = points.iter().sum::<Vec3>() / points.len() as f64;
            let (plane, away) = symmetry_plane(centre, &few, &points, &tree).unwrap();
            let across = plane.normal.dot(&(pose.rotation * Vec3::x())).abs();
            // to a vertex, of which there is one every 2 mm
            assert!(across > 0.999 && away < 2.0, "{turn}: {across}, {away} mm");
        }
    }
}
