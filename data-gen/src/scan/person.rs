//! Who is scanned, doing what, and where: weights by name or drawn, and the pose.

use nonrigid::mesh::{Pose, Vec3};
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

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
        let known = if known.is_empty() { "none: --cases draws people without them".into() } else { known.join(", ") };
        return Err(ScanError::Option(format!("no expression is called {name:?}; there are {known}")));
    }
    Ok(found)
}

/// The weight of each of the rig's expressions, given some by name; of two equal names the later counts.
pub(crate) fn weights_by_name(rig: &FaceRig, wanted: &[(String, f64)]) -> Result<Vec<f64>, ScanError> {
    let names: Vec<&str> = rig.expressions.iter().map(|e| &*e.0).collect();
    let mut weights = vec![0.0; names.len()];
    for (name, weight) in wanted {
        for full in resolve_shapes(&names, name)? {
            names.iter().zip(&mut weights).filter(|n| *n.0 == full).for_each(|n| *n.1 = *weight);
        }
    }
    Ok(weights)
}

/// Three of `count` weights, at random from `least` to 1; the others 0.
pub(crate) fn random_weights(count: usize, least: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(rng);
    let mut weights = vec![0.0; count];
    for k in order.into_iter().take(3) {
        weights[k] = rng.random_range(least..1.0);
    }
    weights
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

pub(super) fn random_pose(options: &ScanOptions, rng: &mut ChaCha8Rng) -> Pose {
    let axis = Vec3::from_fn(|_, _| StandardNormal.sample(rng)).try_normalize(1e-9).unwrap_or_else(Vec3::y);
    let angle = rng.random_range(-1.0..1.0) * options.rotation.to_radians();
    Pose::rigid(axis * angle, Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * options.translation)
}
