//! Which data terms a registration uses; a user's own term joins through [`TermFactory`].

use super::{Correspondences, Level, Pose};
use crate::energy::{DataTerm, Pointwise, SampleResidual};
use crate::mesh::Vec3;
use crate::nlls::{Kernel, Scalar};
use crate::term::{Landmarks, PointToPlane, PointToPoint, Prediction};

/// A data term that follows the levels and correspondences of a registration.
pub trait RegistrationTerm: DataTerm {
    /// Takes a level's weights and kernel, lengths already in the model's unit. `density` turns weights per vertex of
    /// the schedule's reference template into weights per vertex of this one.
    fn set_level(&mut self, level: &Level, density: f64);

    /// Takes new correspondences, one per vertex.
    fn update(&mut self, correspondences: &Correspondences);
}

/// What terms are built from.
#[derive(Debug, Clone, Copy)]
pub struct TermInput<'a> {
    /// Landmarks as (sample, target), in the model's frame.
    pub landmarks: &'a [(usize, Vec3)],
    /// From the model's frame to the scan's: brings what you measured to where the term sees samples by
    /// [`apply_inverse`](Pose::apply_inverse).
    pub frame: Pose,
}

/// Builds a data term for a registration. Implement this for your own term.
pub trait TermFactory: Send + Sync {
    /// Builds the term.
    fn build(&self, input: &TermInput<'_>) -> Box<dyn RegistrationTerm>;
}

/// The terms that come with the crate. Which of them take part is a matter of the schedule's weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TermKind {
    /// Distance to the plane through the closest point of the scan's surface.
    PointToPlane,
    /// Distance to the nearest scan vertex.
    PointToPoint,
    /// Distance to landmarks.
    Landmarks,
    /// Where nothing is accepted, distance to the blendshapes' prediction in the fitted rigid pose.
    Prediction,
    /// Where the scan spans a seam of the template, distance to the point that closes it.
    Seam,
}

impl TermKind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::PointToPlane, Self::PointToPoint, Self::Landmarks, Self::Prediction, Self::Seam];
}

impl TermFactory for TermKind {
    fn build(&self, input: &TermInput<'_>) -> Box<dyn RegistrationTerm> {
        match self {
            Self::PointToPlane => Box::new(Pointwise::new("point to plane (3)", PointToPlane::default(), Kernel::None)),
            Self::PointToPoint => Box::new(Pointwise::new("point to point (2)", PointToPoint::default(), Kernel::None)),
            Self::Landmarks => {
                let (samples, targets): (Vec<_>, Vec<_>) = input.landmarks.iter().copied().unzip();
                let weights = vec![1.0; samples.len()];
                let residuals = Landmarks { samples, targets, weights, scale: 0.0 };
                Box::new(Pointwise::new("landmarks", residuals, Kernel::None))
            }
            Self::Prediction => Box::new(Pointwise::new("prediction", Prediction::default(), Kernel::None)),
            Self::Seam => Box::new(Pointwise::new("seams", SeamPull::default(), Kernel::None)),
        }
    }
}

impl RegistrationTerm for Pointwise<PointToPlane, Kernel, 1> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.scale = level.point_to_plane * density;
        self.kernel = level.kernel;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        self.residuals.targets.clone_from(&correspondences.points);
        self.residuals.normals.clone_from(&correspondences.normals);
        self.residuals.weights.clone_from(&correspondences.weights);
    }
}

impl RegistrationTerm for Pointwise<PointToPoint, Kernel, 3> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.scale = level.point_to_point * density;
        self.kernel = level.point_kernel.unwrap_or(level.kernel);
    }

    fn update(&mut self, correspondences: &Correspondences) {
        self.residuals.targets.clone_from(&correspondences.nearest_vertices);
        self.residuals.weights.clone_from(&correspondences.weights);
    }
}

impl RegistrationTerm for Pointwise<Landmarks, Kernel, 3> {
    fn set_level(&mut self, level: &Level, _density: f64) {
        self.residuals.scale = level.landmarks;
    }

    fn update(&mut self, _correspondences: &Correspondences) {}
}

impl RegistrationTerm for Pointwise<Prediction, Kernel, 3> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.scale = level.prediction * density;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        self.residuals.targets.clone_from(&correspondences.predictions);
        self.residuals.weights.clear();
        self.residuals.weights.extend(correspondences.weights.iter().map(|w| 1.0 - w));
    }
}

/// [`PointToPoint`] towards the points that close seams.
#[derive(Debug, Clone, Default)]
struct SeamPull(PointToPoint);

impl SampleResidual<3> for SeamPull {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn sample(&self, m: usize) -> usize {
        self.0.sample(m)
    }

    fn weight(&self, m: usize) -> f64 {
        self.0.weight(m)
    }

    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
        self.0.residual(m, v)
    }
}

impl RegistrationTerm for Pointwise<SeamPull, Kernel, 3> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.0.scale = level.seam * density;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        self.residuals.0.targets.clone_from(&correspondences.seam_points);
        self.residuals.0.weights.clone_from(&correspondences.seam_weights);
    }
}
