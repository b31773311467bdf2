//! Going on from where another registration has ended: the frames of a sequence differ little, so the parameters of one are a
//! better start for the next than the rest shape, no start has to be searched, and fewer steps do.

use serde::{Deserialize, Serialize};

use super::RegistrationError;
use crate::io::sha256;
use crate::mesh::{PolygonMesh, Pose, PoseKind, Vec3, weighted_closest_pose};

/// Where a registration has ended, and another one, of the same template with the same model and schedule, can go on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WarmStart {
    /// Name of the model.
    pub model: String,
    /// A hash of the template's number of vertices and its polygons; where it is empty nothing is checked.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub template: String,
    /// Pose of the model's frame in the scan's.
    pub pose: Pose,
    /// The parameters of the model, none where it starts at rest; of the first one, for schedules of several stages.
    pub parameters: Vec<f64>,
}

impl WarmStart {
    /// A model at rest in a pose, of any template.
    #[must_use]
    pub fn at_rest(model: String, pose: Pose) -> Self {
        Self { model, template: String::new(), pose, parameters: Vec::new() }
    }

    /// Whether it is of a template with this [`fingerprint`].
    pub(super) fn check_template(&self, template: &str) -> Result<(), RegistrationError> {
        if self.template.is_empty() || self.template == template {
            return Ok(());
        }
        let other = "it is of a template with other polygons, or vertices in another order".to_owned();
        Err(RegistrationError::WarmStart(other))
    }

    /// Whether these can be the parameters of a model.
    pub(super) fn check(&self, model: &str, parameters: usize) -> Result<(), RegistrationError> {
        let wrong = |what: String| Err(RegistrationError::WarmStart(what));
        if self.model != model {
            return wrong(format!("it is of the model '{}', this registration's is '{model}'", self.model));
        }
        if !self.parameters.is_empty() && self.parameters.len() != parameters {
            let found = self.parameters.len();
            return wrong(format!(
                "it has {found} parameters, the model has {parameters}: it is of another template or schedule"
            ));
        }
        let numbers = self.parameters.iter().chain(&self.pose.translation).chain(&self.pose.rotation);
        let turn = (self.pose.rotation.tr_mul(&self.pose.rotation) - nalgebra::Matrix3::identity()).norm();
        if !numbers.clone().all(|x| x.is_finite()) || self.pose.scale.is_nan() || self.pose.scale <= 0.0 || turn > 1e-6
        {
            return wrong("it holds a number that is not finite, or no rotation".to_owned());
        }
        Ok(())
    }

    /// The pose that brings landmarks, here (where they are in the model's frame, on the scan, weight), closest: the head may have moved
    /// farther than correspondences reach. Fewer than three leave the pose as it is.
    pub(super) fn pose_by(&self, landmarks: &[(Vec3, Vec3, f64)]) -> Pose {
        let moved = landmarks.iter().map(|&(p, q, weight)| (self.pose.apply(p), q, weight));
        match weighted_closest_pose(moved, PoseKind::Rigid) {
            Ok(motion) => motion.after(&self.pose),
            Err(_) => self.pose,
        }
    }
}

/// What tells templates apart whose vertices are not the same: a hash of their number and of the polygons.
pub(super) fn fingerprint(template: &PolygonMesh) -> String {
    let numbers = std::iter::once(template.positions.len() as u32)
        .chain([&template.starts, &template.corners].into_iter().flatten().copied());
    let bytes: Vec<u8> = numbers.flat_map(u32::to_le_bytes).collect();
    sha256(&bytes)[..16].to_owned()
}
