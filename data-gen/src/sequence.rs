//! Sequences: one person's expressions and head moving smoothly from frame to frame.

use std::f64::consts::{PI, TAU};
use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use nonrigid::io::write_atomically;
use nonrigid::mesh::{Pose, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::scan::{random_weights, weights_by_name};
use crate::{FaceRig, ScanOptions};

/// Seconds from one key expression to the next, and of the slowest turn of the head.
const KEY: f64 = 0.6;
const SWAY: f64 = 4.0;
/// Apart from the streams of a scan.
const STREAM: u64 = 100;

/// How a person moves: key expressions from neutral on, eased into each other, and a swaying head.
pub struct Motion {
    options: ScanOptions,
    names: Vec<String>,
    /// Weights of all expressions, every [`KEY`] seconds.
    keys: Vec<Vec<f64>>,
    /// Amplitude (degrees or millimetres, about or along x, y, z), angular frequency and phase of the head's motion.
    sways: Vec<([f64; 6], f64, f64)>,
}

impl Motion {
    /// A motion of `seconds`; `options` say who moves and how far the head may turn and go. Given expressions are the
    /// motion's peak, reached and left again and again; otherwise each key is another expression of three shapes.
    ///
    /// # Errors
    /// When `options` name an expression that the rig does not have.
    pub fn new(rig: &FaceRig, options: &ScanOptions, seconds: f64, seed: u64) -> Result<Self, crate::ScanError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        let names: Vec<String> = rig.expressions.iter().map(|e| e.0.clone()).collect();
        let count = (seconds.clamp(0.0, 1e5) / KEY).ceil() as usize + 2;
        let peak = options.expressions.as_deref().map(|wanted| weights_by_name(rig, wanted)).transpose()?;
        let mut keys = vec![vec![0.0; names.len()]];
        for at in 1..count {
            keys.push(if let Some(peak) = &peak {
                let strength = if at % 2 == 1 { 1.0 } else { rng.random_range(0.0..0.3) };
                peak.iter().map(|weight| weight * strength).collect()
            } else {
                random_weights(names.len(), 0.3, &mut rng)
            });
        }
        let mut identity_rng = ChaCha8Rng::seed_from_u64(seed);
        identity_rng.set_stream(STREAM + 1);
        let mut options = options.clone();
        if options.identity.is_none() {
            use rand_distr::{Distribution, StandardNormal};
            let mut draw = || -> f64 { StandardNormal.sample(&mut identity_rng) };
            options.identity = Some((0..rig.identities.len()).map(|_| options.identity_sigma * draw()).collect());
        }
        options.shared_seed = options.shared_seed.or(Some(seed));
        let mut sway = |share: f64, slow: f64| {
            let (turn, way) = (options.rotation, options.translation);
            let reach = |most: f64| share * most * rng.random_range(-1.0..1.0) / 3f64.sqrt();
            let amplitudes = [turn, turn, turn, way, way, way].map(reach);
            (amplitudes, TAU / (slow * rng.random_range(0.7..1.3)), rng.random_range(0.0..TAU))
        };
        let sways = vec![sway(0.6, SWAY), sway(0.3, 0.5 * SWAY), sway(0.1, 0.25 * SWAY)];
        Ok(Self { options, names, keys, sways })
    }

    /// Weight of each of the rig's expressions after `seconds`.
    #[must_use]
    pub fn weights(&self, seconds: f64) -> Vec<f64> {
        let at = (seconds / KEY).clamp(0.0, (self.keys.len() - 2) as f64);
        let key = (at as usize).min(self.keys.len() - 2);
        let ease = 0.5 - 0.5 * (PI * (at - key as f64)).cos();
        self.keys[key].iter().zip(&self.keys[key + 1]).map(|(a, b)| a + ease * (b - a)).collect()
    }

    /// The head's pose after `seconds`.
    #[must_use]
    pub fn pose(&self, seconds: f64) -> Pose {
        let mut sum = [0.0; 6];
        for (amplitudes, frequency, phase) in &self.sways {
            let wave = (frequency * seconds + phase).sin();
            sum.iter_mut().zip(amplitudes).for_each(|(s, a)| *s += a * wave);
        }
        let turn = Vec3::new(sum[0], sum[1], sum[2]).map(f64::to_radians);
        Pose::rigid(turn, Vec3::new(sum[3], sum[4], sum[5]))
    }

    /// What is scanned after `seconds`: the same person, seen by the same cameras and cut at the same end.
    #[must_use]
    pub fn options(&self, seconds: f64) -> ScanOptions {
        let expressions = self.names.iter().cloned().zip(self.weights(seconds)).collect();
        ScanOptions { expressions: Some(expressions), pose: Some(self.pose(seconds)), ..self.options.clone() }
    }
}

/// Writes `weights.csv`: frame, time in seconds, and every expression's weight.
///
/// # Errors
/// When the file cannot be written.
pub fn write_weights(path: &Path, rig: &FaceRig, frames: &[(f64, Vec<f64>)]) -> Result<()> {
    let written = write_atomically(path, |file| {
        write!(file, "frame,time")?;
        rig.expressions.iter().try_for_each(|(name, _)| write!(file, ",{name}"))?;
        for (frame, (time, weights)) in frames.iter().enumerate() {
            write!(file, "\n{frame},{time}")?;
            weights.iter().try_for_each(|weight| write!(file, ",{weight}"))?;
        }
        writeln!(file)
    });
    Ok(written?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FaceOptions;

    #[test]
    fn motion_begins_neutral_and_stays_smooth_and_within_bounds() {
        let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 3 });
        let options = ScanOptions::default();
        let motion = Motion::new(&rig, &options, 4.0, 5).unwrap();
        assert!(motion.weights(0.0).iter().all(|w| *w == 0.0));
        let mut moved: f64 = 0.0;
        for frame in 0..400 {
            let (t, later) = (0.01 * f64::from(frame), 0.01 * f64::from(frame + 1));
            let (a, b) = (motion.weights(t), motion.weights(later));
            assert!(a.iter().all(|w| (0.0..=1.0).contains(w)));
            // An eased step of 1 in 0.6 s moves by at most pi / 2 / 0.6 a second.
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 0.027));
            let (a, b) = (motion.pose(t), motion.pose(later));
            let p = Vec3::new(0.0, 0.0, 100.0);
            assert!((a.apply(p) - b.apply(p)).norm() < 2.0);
            assert!(a.translation.amax() <= options.translation);
            assert!(((a.rotation * p).normalize().z).acos() <= options.rotation.to_radians());
            moved = moved.max((a.apply(p) - motion.pose(0.0).apply(p)).norm());
        }
        assert!(moved > 1.0, "{moved}");
        assert!(motion.weights(0.6).iter().filter(|w| **w > 0.0).count() == 3);
        let other = motion.options(2.0);
        assert_eq!(other.identity, motion.options(0.0).identity);
        assert_eq!(other.shared_seed, Some(5));
    }

    #[test]
    fn given_expressions_are_the_peak() {
        let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 3 });
        let options =
            |name: &str| ScanOptions { expressions: Some(vec![(name.into(), 0.8)]), ..ScanOptions::default() };
        let motion = Motion::new(&rig, &options("jawOpen"), 4.0, 5).unwrap();
        let jaw = rig.expressions.iter().position(|e| e.0 == "jawOpen").unwrap();
        assert!((motion.weights(0.6)[jaw] - 0.8).abs() < 1e-12);
        assert!(motion.weights(1.2)[jaw] < 0.3);
        assert!(Motion::new(&rig, &options("jawClose"), 4.0, 5).is_err());
    }
}
