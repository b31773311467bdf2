//! The motion of a head between two shapes of a face.

use std::fmt;

use nalgebra::Rotation3;

use super::{MeasurementError, Subject};
use crate::mesh::normals::vertex_areas;
use crate::mesh::{PolygonMesh, Pose, PoseError, PoseKind, Vec3, bounding_box_diagonal, weighted_closest_pose};

/// Steps, at most.
const STEPS: usize = 100;
/// A distance below this share of the face's size is none.
const NONE: f64 = 1e-12;
/// A head that moves the surface by less, on average, lies still, millimetres: over a face of 400 cm² it adds 4 ml at most.
const STILL: f64 = 0.1;

/// How a head has moved from one shape of a face to another: what of the change is no change of form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadMotion {
    /// From where the head was to where it is.
    pub pose: Pose,
    /// By how much it is turned, degrees.
    pub turn: f64,
    /// How far its surface is shifted, millimetres: the centre, of the whole.
    pub shift: f64,
    /// How far the points of its surface move, on average, millimetres.
    pub mean: f64,
}

impl HeadMotion {
    /// The rigid motion that leaves the least sum of displacements: what changes alone, up to a quarter of the face, has no part in it.
    ///
    /// # Errors
    /// When the numbers of vertices differ, a coordinate is not finite, there is no surface, or it does not determine a motion.
    pub fn between(mesh: &PolygonMesh, after: &[Vec3]) -> Result<Self, MeasurementError> {
        Subject { after: Some(after), ..Subject::new(mesh) }.check()?;
        let before = &mesh.positions;
        let areas = vertex_areas(before, &mesh.triangulate().triangles);
        let area: f64 = areas.iter().sum();
        if area <= 0.0 {
            return Err(MeasurementError::NoSurface("the mesh"));
        }
        let pose = head_motion(before, after, &areas)?;
        let weighted = || before.iter().zip(&areas);
        let centre = weighted().map(|(p, a)| p * *a).sum::<Vec3>() / area;
        Ok(Self {
            pose,
            turn: Rotation3::from_matrix_unchecked(pose.rotation).angle().to_degrees(),
            shift: (pose.apply(centre) - centre).norm(),
            mean: weighted().map(|(p, a)| a * (pose.apply(*p) - p).norm()).sum::<f64>() / area,
        })
    }

    /// Whether displacements and volumes are those of the motion to a degree that counts.
    #[must_use]
    pub fn counts(&self) -> bool {
        self.mean > STILL
    }

    /// Moves the shape after to where the head was before.
    pub fn undo(&self, after: &mut [Vec3]) {
        after.iter_mut().for_each(|p| *p = self.pose.apply_inverse(*p));
    }
}

impl fmt::Display for HeadMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { turn, shift, .. } = self;
        write!(
            f,
            "the head moved by {turn:.1}° and {shift:.1} mm: displacements and volumes are also those of that motion"
        )
    }
}

/// The rigid motion that leaves the least of the change: with `a_i` the area round vertex `i`, `p_i` where it is before and `q_i` after, it
/// minimises
///
/// ```text
///     sum_i a_i | R p_i + t - q_i |
/// ```
///
/// The distances count, not their squares, so a part that alone has changed does not draw the rest to it: where three quarters of a face
/// have only been moved, it is that motion. Weiszfeld's iteration (1937): least squares with the weights `a_i / | R p_i + t - q_i |` of the step
/// before.
///
/// # Errors
/// When the points do not determine a motion.
pub(super) fn head_motion(before: &[Vec3], after: &[Vec3], areas: &[f64]) -> Result<Pose, PoseError> {
    let size = bounding_box_diagonal(before);
    let mut weights = areas.to_vec();
    let mut motion: Option<Pose> = None;
    for _ in 0..STEPS {
        let pairs = before.iter().zip(after).zip(&weights).map(|((p, q), w)| (*p, *q, *w));
        let next = weighted_closest_pose(pairs, PoseKind::Rigid)?;
        let moved = motion.map_or(f64::INFINITY, |last| {
            size * (next.rotation - last.rotation).norm() + (next.translation - last.translation).norm()
        });
        motion = Some(next);
        if moved <= NONE * size {
            break;
        }
        for ((weight, area), (p, q)) in weights.iter_mut().zip(areas).zip(before.iter().zip(after)) {
            *weight = area / (next.apply(*p) - q).norm().max(NONE * size);
        }
    }
    motion.ok_or(PoseError::TooFew(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_moved_alone_does_not_draw_the_rest() {
        let before: Vec<Vec3> =
            (0..100).map(|k| Vec3::new(f64::from(k % 10), f64::from(k / 10), f64::from(k * k % 7))).collect();
        let areas: Vec<f64> = (0..100).map(|k| 1.0 + f64::from(k % 3)).collect();
        let head = Pose::rigid(Vec3::new(0.3, -0.2, 1.1), Vec3::new(40.0, -3.0, 8.0));
        for share in [0, 10, 25] {
            let chin = |k: usize| if k < share { Vec3::new(1.0, 2.0, -4.0) } else { Vec3::zeros() };
            let after: Vec<Vec3> = before.iter().enumerate().map(|(k, p)| head.apply(p + chin(k))).collect();
            let found = head_motion(&before, &after, &areas).unwrap();
            for p in &before {
                approx::assert_abs_diff_eq!(found.apply(*p), head.apply(*p), epsilon = 1e-8);
            }
        }
    }
}
