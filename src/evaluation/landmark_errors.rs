//! Distances from a result's landmarks to where they are in the scan.

use serde::Serialize;

use super::DistanceSummary;
use crate::landmark::Landmark;
use crate::mesh::Vec3;

/// How far the landmarks of a result are from where somebody placed them: the usual measure of correspondence on a scan without truth,
/// as long as they had no part in the registration. What it measures includes how exactly they were placed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LandmarkErrors {
    /// Of their distances, millimetres.
    pub summary: DistanceSummary,
    /// Each of them, the farthest first.
    pub each: Vec<LandmarkError>,
}

/// One landmark.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LandmarkError {
    /// Its name.
    pub name: String,
    /// From the result's to the scan's, millimetres.
    pub distance: f64,
}

impl LandmarkErrors {
    /// Of a result at `positions`, which are in the scan's space; `within` is the threshold of `share_within`, millimetres.
    ///
    /// # Panics
    /// When a landmark is on a vertex that `positions` does not have.
    #[must_use]
    pub fn new(landmarks: &[Landmark], positions: &[Vec3], within: f64) -> Self {
        let error = |landmark: &Landmark| LandmarkError {
            name: landmark.name.clone(),
            distance: (landmark.template.position(positions) - landmark.target).norm(),
        };
        let mut each: Vec<LandmarkError> = landmarks.iter().map(error).collect();
        let distances: Vec<f64> = each.iter().map(|e| e.distance).collect();
        each.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        Self { summary: DistanceSummary::new(&distances, within), each }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_from_the_results_points_and_the_farthest_is_first() {
        let positions = [Vec3::zeros(), Vec3::x(), Vec3::y()];
        let landmark = |name: &str, vertex, target| Landmark::new(name, vertex, target);
        let landmarks = [landmark("near", 1, Vec3::x() * 4.0), landmark("far", 2, Vec3::y() - Vec3::z() * 4.0)];
        let errors = LandmarkErrors::new(&landmarks, &positions, 3.5);
        assert_eq!(
            errors.each.iter().map(|e| (&*e.name, e.distance)).collect::<Vec<_>>(),
            [("far", 4.0), ("near", 3.0)]
        );
        assert_eq!((errors.summary.rms, errors.summary.max, errors.summary.share_within), (12.5f64.sqrt(), 4.0, 0.5));
    }
}
