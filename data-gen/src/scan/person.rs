//! Who is scanned, doing what, and where: weights by name or drawn, and the pose.

use nonrigid::mesh::Vec3;
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::{ScanError, ScanOptions};
use crate::FaceRig;

/// Expressions by name: what they consist of; a name without `_L` or `_R` stands for both sides.
pub const PRESETS: [(&str, &[(&str, f64)]); 8] = [
    ("neutral", &[]),
    ("open", &[("jawOpen", 1.0), ("mouthStretch", 0.6), ("browOuterUp", 0.7), ("eyeWide", 0.8)]),
    ("smile", &[("mouthSmile", 1.0), ("cheekSquint", 0.8), ("eyeSquint", 0.7)]),
    ("blink", &[("eyeBlink", 1.0), ("mouthPucker", 0.9), ("browDown", 0.8)]),
    ("shout", &[("jawOpen", 0.9), ("mouthLowerDown", 0.7), ("noseSneer", 0.6)]),
    (
        "asym",
        &[("mouthLeft", 0.8), ("noseSneer_L", 1.0), ("eyeBlink_R", 1.0), ("cheekPuff_L", 0.8), ("browInnerUp", 0.5)],
    ),
    ("sad", &[("mouthFrown", 0.9), ("browInnerUp", 1.0), ("mouthShrugLower", 0.5)]),
    ("surprise", &[("jawOpen", 0.5), ("eyeWide", 1.0), ("browInnerUp", 0.8), ("browOuterUp", 0.8)]),
];

/// Correctives, which mean nothing alone: never drawn at random, never among the shapes that a fit gets.
pub(crate) const CORRECTIVES: [&str; 1] = ["mouthClose"];

/// The full names that `name` stands for among `known` ones: itself, or both its sides.
///
/// # Errors
/// When there are none; the message lists the known names.
pub fn resolve_shapes<'a>(known: &[&'a str], name: &str) -> Result<Vec<&'a str>, ScanError> {
    let sides = [format!("{name}_L"), format!("{name}_R")];
    let exact = known.iter().copied().filter(|k| *k == name);
    let twins = known.iter().copied().filter(|k| sides.iter().any(|side| side == k));
    let found: Vec<&str> = exact.chain(twins).collect();
    if found.is_empty() {
        return Err(ScanError::Option(format!("no expression is called {name:?}; there are {}", known.join(", "))));
    }
    Ok(found)
}

pub(super) fn expression_weights(
    rig: &FaceRig,
    options: &ScanOptions,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<f64>, ScanError> {
    let names: Vec<&str> = rig.expressions.iter().map(|e| &*e.0).collect();
    let mut weights = vec![0.0; names.len()];
    if let Some(wanted) = &options.expressions {
        for (name, weight) in wanted {
            for full in resolve_shapes(&names, name)? {
                names.iter().zip(&mut weights).filter(|n| *n.0 == full).for_each(|n| *n.1 = *weight);
            }
        }
    } else {
        let mut order: Vec<usize> = (0..names.len()).filter(|k| !CORRECTIVES.contains(&names[*k])).collect();
        order.shuffle(rng);
        for k in order.into_iter().take(3) {
            weights[k] = rng.random_range(0.4..1.0);
        }
    }
    Ok(weights)
}

pub(super) fn identity_weights(rig: &FaceRig, options: &ScanOptions, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut draw = || -> f64 {
        let normal: f64 = StandardNormal.sample(rng);
        normal * options.identity_sigma
    };
    let modes = 0..rig.identities.len();
    match &options.identity {
        None => modes.map(|_| draw()).collect(),
        Some(wanted) => modes.map(|k| wanted.get(k).copied().unwrap_or(0.0)).collect(),
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
    /// By an angle in radians about an axis of unit length.
    #[must_use]
    pub fn new(axis: Vec3, angle: f64, translation: Vec3) -> Self {
        // Rodrigues' formula, column by column.
        let (sin, cos) = angle.sin_cos();
        let turn = |p: Vec3| p * cos + axis.cross(&p) * sin + axis * (axis.dot(&p) * (1.0 - cos));
        let columns = [turn(Vec3::x()), turn(Vec3::y()), turn(Vec3::z())];
        let rotation = [0, 1, 2].map(|row| columns.map(|c| c[row]));
        Self { rotation, translation: [translation.x, translation.y, translation.z] }
    }

    /// The point in scan coordinates.
    #[must_use]
    pub fn apply(&self, p: &Vec3) -> Vec3 {
        self.rotate(p) + Vec3::from(self.translation)
    }

    /// The direction in scan coordinates.
    #[must_use]
    pub fn rotate(&self, p: &Vec3) -> Vec3 {
        Vec3::from(self.rotation.map(|row| Vec3::from(row).dot(p)))
    }

    pub(super) fn random(options: &ScanOptions, rng: &mut ChaCha8Rng) -> Self {
        let axis = Vec3::from_fn(|_, _| StandardNormal.sample(rng)).try_normalize(1e-9).unwrap_or_else(Vec3::y);
        let angle = rng.random_range(-1.0..1.0) * options.rotation.to_radians();
        Self::new(axis, angle, Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * options.translation)
    }
}
