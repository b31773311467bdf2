//! What no shape of a rig says: a smooth field, and parts that bend at a joint.

use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::geodesic::{WeightedGraph, distances};
use nonrigid::mesh::{Pose, Vec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::curved::{Wave, extent};
use super::surface::smooth;
use super::{ScanError, ScanOptions, Stream};
use crate::FaceRig;

/// Waves of the smooth field along each axis.
const WAVES: usize = 12;
/// Their lengths, as shares of the subject's extent.
const LENGTHS: [f64; 2] = [0.5, 1.2];
/// Length over which a part begins to turn, as a share of the way from its tip to the joint.
const BAND: f64 = 0.25;

/// A joint: what is nearer to `tip`, along the surface, than `joint` is turns about the joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bend {
    /// Landmark of the rig at the end of the part, such as `wrist_l`.
    pub tip: String,
    /// Landmark at the joint, such as `elbow_l`.
    pub joint: String,
    /// Largest angle; the axis is any across the part.
    pub degrees: f64,
}

impl Bend {
    /// How much of the turn each vertex takes, 0 to 1.
    ///
    /// # Errors
    /// When the rig has no such landmarks, or no way leads from one to the other.
    fn shares(&self, rig: &FaceRig) -> Result<Vec<f64>, ScanError> {
        let vertex = |name: &str| {
            let found = rig.landmarks.iter().find(|l| l.name == name).map(|l| l.vertex);
            found.ok_or_else(|| {
                let known: Vec<&str> = rig.landmarks.iter().map(|l| &*l.name).collect();
                let known = if known.is_empty() { "none".into() } else { known.join(", ") };
                ScanError::Option(format!("bend: no landmark of the rig is called {name:?}; there are {known}"))
            })
        };
        let (tip, joint) = (vertex(&self.tip)?, vertex(&self.joint)?);
        let graph = EdgeGraph::from_triangles(rig.neutral.len(), &rig.mesh.triangulate().triangles);
        let along =
            WeightedGraph::euclidean(&graph, &rig.neutral).map(|graph| distances(&graph, &[tip], f64::INFINITY));
        let along = along.map_err(|e| ScanError::Option(format!("bend: {e}")))?;
        let reach = along[joint as usize];
        if !(reach > 0.0 && reach.is_finite()) {
            let what = format!("bend: no way leads from {:?} to {:?} along the surface", self.tip, self.joint);
            return Err(ScanError::Option(what));
        }
        Ok(along.iter().map(|d| smooth((reach - d) / (BAND * reach) + 0.5)).collect())
    }
}

/// Refuses bends that this rig does not have.
pub(super) fn validate(rig: &FaceRig, options: &ScanOptions) -> Result<(), ScanError> {
    if rig.model.is_some() && (!options.bends.is_empty() || options.field > 0.0) {
        return Err(ScanError::Option("bend, field: the generated face has neither; give a rig of your own".into()));
    }
    options.bends.iter().try_for_each(|bend| bend.shares(rig).map(drop))
}

/// Moves a person, one point per vertex of the rig, by the smooth field and the bends of `options`.
///
/// # Errors
/// As [`validate`].
pub(super) fn deform(rig: &FaceRig, options: &ScanOptions, shape: &mut [Vec3], seed: u64) -> Result<(), ScanError> {
    if options.field > 0.0 {
        let (mut rng, size) = (Stream::Field.of(seed), extent(&rig.neutral));
        // The variance of a wave is half of its squared amplitude; the field's is shared by three axes.
        let amplitude = options.field * (2.0 / (3 * WAVES) as f64).sqrt();
        let field: [Vec<Wave>; 3] =
            [(); 3].map(|()| (0..WAVES).map(|_| Wave::new(LENGTHS.map(|l| l * size), amplitude, &mut rng)).collect());
        for (p, place) in shape.iter_mut().zip(&rig.neutral) {
            *p += Vec3::from_fn(|axis, _| field[axis].iter().map(|w| w.at(place)).sum());
        }
    }
    let mut rng = Stream::Bends.of(seed);
    options.bends.iter().try_for_each(|bend| {
        turn(shape, &bend.shares(rig)?, bend.degrees.to_radians(), &mut rng);
        Ok(())
    })
}

/// Turns each point by its share of an angle of at most `most`, about an axis across the part whose shares are 1, through the place
/// where they fall to 0.
fn turn(shape: &mut [Vec3], shares: &[f64], most: f64, rng: &mut ChaCha8Rng) {
    let mean = |weight: &dyn Fn(f64) -> f64| {
        let sum = shape
            .iter()
            .zip(shares)
            .fold((Vec3::zeros(), 1e-12), |(p, w), (q, share)| (p + q * weight(*share), w + weight(*share)));
        sum.0 / sum.1
    };
    let (joint, part) = (mean(&|share| share * (1.0 - share)), mean(&|share| share));
    let across = (part - joint).cross(&Vec3::from_fn(|_, _| StandardNormal.sample(rng)));
    let axis = across.try_normalize(1e-9).unwrap_or_else(Vec3::x) * (rng.random_range(-1.0..1.0) * most);
    for (p, share) in shape.iter_mut().zip(shares) {
        *p = joint + Pose::rigid(axis * *share, Vec3::zeros()).apply(*p - joint);
    }
}
