//! The frame of landmarks on a face, in which a mask needs no camera.

use serde::{Deserialize, Serialize};

use super::{MorphError, Projector};
use crate::mesh::{MirrorPlane, Vec3};

/// Which landmarks make a frame. Numbered landmarks are named "0", "1", ... as [`read_template_landmarks`] does.
///
/// [`read_template_landmarks`]: crate::landmark::read_template_landmarks
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct FrameSpec {
    /// The origin is the mean of these, at least one.
    pub origin: Vec<String>,
    /// x points from the first to the second.
    pub right: [String; 2],
    /// y points from the first to the second, as far as it is perpendicular to x.
    pub up: [String; 2],
    /// The unit of length; without it the frame is in the mesh's own millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<FrameScale>,
}

/// A unit of length that grows with the face: between two landmarks there are so many frame millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct FrameScale {
    /// The two landmarks.
    pub between: [String; 2],
    /// Their distance in the frame, positive.
    pub millimetres: f64,
}

/// Origin, axes and unit of length; z points out of the face where x points to the viewer's right and y up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkFrame {
    origin: Vec3,
    axes: [Vec3; 3],
    /// Millimetres of the mesh to a millimetre of the frame.
    unit: f64,
}

impl LandmarkFrame {
    /// The frame of landmarks at these places of the mesh, millimetres.
    ///
    /// # Errors
    /// When a landmark is missing or not finite, two of them coincide, or x and y have one direction.
    pub fn new(spec: &FrameSpec, landmarks: &[(String, Vec3)]) -> Result<Self, MorphError> {
        let find = |name: &String| match landmarks.iter().find(|(known, _)| known == name) {
            Some((_, place)) if place.iter().all(|c| c.is_finite()) => Ok(*place),
            Some(_) => Err(MorphError::Frame("a landmark's coordinates are not finite")),
            None => Err(MorphError::unknown_landmark(name, landmarks.iter().map(|(name, _)| name.as_str()))),
        };
        let between = |[from, to]: &[String; 2]| -> Result<Vec3, MorphError> { Ok(find(to)? - find(from)?) };
        let places = spec.origin.iter().map(find).collect::<Result<Vec<_>, _>>()?;
        if places.is_empty() {
            return Err(MorphError::Frame("its origin is the mean of at least one landmark"));
        }
        let origin = places.iter().sum::<Vec3>() / places.len() as f64;
        let (right, up) = (between(&spec.right)?, between(&spec.up)?);
        let x = right.try_normalize(1e-9).ok_or(MorphError::Frame("the two landmarks of x coincide"))?;
        let z = x.cross(&up).try_normalize(1e-6 * up.norm());
        let z = z.ok_or(MorphError::Frame("the two landmarks of y coincide or lie along x"))?;
        let unit = match &spec.scale {
            None => 1.0,
            Some(FrameScale { between: pair, millimetres }) => {
                let distance = between(pair)?.norm();
                if distance <= 1e-9 {
                    return Err(MorphError::Frame("the two landmarks of the scale coincide"));
                }
                if !(*millimetres > 0.0 && millimetres.is_finite()) {
                    let what = "the distance that sets a frame's scale";
                    return Err(MorphError::Option { what, value: *millimetres, expected: "positive millimetres" });
                }
                distance / millimetres
            }
        };
        Ok(Self { origin, axes: [x, z.cross(&x), z], unit })
    }

    /// The origin, millimetres of the mesh.
    #[must_use]
    pub fn origin(&self) -> Vec3 {
        self.origin
    }

    /// The unit vectors of x, y and z.
    #[must_use]
    pub fn axes(&self) -> [Vec3; 3] {
        self.axes
    }

    /// The place of frame coordinates, frame millimetres.
    #[must_use]
    pub fn point(&self, [x, y, z]: [f64; 3]) -> Vec3 {
        self.origin + self.vector([x, y, z])
    }

    /// A displacement given in the frame, frame millimetres.
    #[must_use]
    pub fn vector(&self, [x, y, z]: [f64; 3]) -> Vec3 {
        (self.axes[0] * x + self.axes[1] * y + self.axes[2] * z) * self.unit
    }

    /// A vector given along the frame's axes, millimetres of the mesh.
    #[must_use]
    pub fn direction(&self, [x, y, z]: [f64; 3]) -> Vec3 {
        self.axes[0] * x + self.axes[1] * y + self.axes[2] * z
    }

    /// The same frame about another origin, millimetres of the mesh.
    #[must_use]
    pub fn at(&self, origin: Vec3) -> Self {
        Self { origin, ..*self }
    }

    /// The frame turned by degrees: `yaw` about y, so that z, towards the viewer, turns to x, then `pitch` about the new x, so that z
    /// turns to y. A face is seen from its left at a yaw of 90, from above at a pitch of 90.
    #[must_use]
    pub fn turned(&self, yaw: f64, pitch: f64) -> Self {
        let [x, y, z] = self.axes;
        let (s, c) = yaw.to_radians().sin_cos();
        let (x, z) = (x * c - z * s, z * c + x * s);
        let (s, c) = pitch.to_radians().sin_cos();
        Self { axes: [x, y * c - z * s, z * c + y * s], ..*self }
    }

    /// The plane x = 0.
    #[must_use]
    pub fn mirror_plane(&self) -> MirrorPlane {
        MirrorPlane { point: self.origin, normal: self.axes[0] }
    }

    /// The parallel projection along -z of a texture that covers the box from `low` to `high`, frame millimetres in x and y: a region
    /// drawn with [`Coordinates::Box`](super::Coordinates::Box) of the same corners lies where it was drawn.
    ///
    /// # Errors
    /// When the corners are not finite or the box has no area.
    pub fn projector(&self, low: [f64; 2], high: [f64; 2]) -> Result<Projector, MorphError> {
        let [of_mesh_low, of_mesh_high] = [low, high].map(|corner| corner.map(|c| c * self.unit));
        Projector::of_frame(self.axes, self.origin, of_mesh_low, of_mesh_high).map_err(|error| match error {
            MorphError::Covered { .. } => MorphError::Covered { low, high }, // as it was asked for
            other => other,
        })
    }
}
