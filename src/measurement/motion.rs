//! The motion of a head between two shapes of a face.

use crate::mesh::{Pose, PoseError, PoseKind, Vec3, bounding_box_diagonal, weighted_closest_pose};

/// Steps, at most.
const STEPS: usize = 100;
/// A distance below this share of the face's size is none.
const NONE: f64 = 1e-12;

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
