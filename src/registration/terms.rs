//! Which data terms a registration uses; a user's own term joins through [`TermFactory`].

use super::{Correspondences, Level};
use crate::energy::{DataTerm, Pointwise, QuadricField};
use crate::mesh::{Pose, Vec3};
use crate::nlls::Kernel;
use crate::term::{Landmarks, PointToPlane, PointToPoint, ScanToTemplate, Symmetric};

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
    /// Landmarks as (sample, target, relative weight), in the model's frame; weight 1 for those without a deviation.
    pub landmarks: &'a [(usize, Vec3, f64)],
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
    /// The same along the mean of both normals.
    Symmetric,
    /// Distance of the template to planes through points of the scan.
    ScanToTemplate,
    /// Distance to the closest point of the scan's surface.
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
    pub const ALL: [Self; 7] = [
        Self::PointToPlane,
        Self::Symmetric,
        Self::ScanToTemplate,
        Self::PointToPoint,
        Self::Landmarks,
        Self::Prediction,
        Self::Seam,
    ];
}

impl TermFactory for TermKind {
    fn build(&self, input: &TermInput<'_>) -> Box<dyn RegistrationTerm> {
        let pull = |name: &str, towards| {
            let term = Pointwise::new(name, PointToPoint::default(), Kernel::None);
            Box::new(Pull { term, towards })
        };
        match self {
            Self::PointToPlane => Box::new(Pointwise::new("point to plane (3)", PointToPlane::default(), Kernel::None)),
            Self::Symmetric => Box::new(Pointwise::new("symmetric point to plane", Symmetric::default(), Kernel::None)),
            Self::ScanToTemplate => {
                Box::new(Pointwise::new("scan to template", ScanToTemplate::default(), Kernel::None))
            }
            Self::PointToPoint => pull("point to point (2)", Towards::ClosestPoint),
            Self::Prediction => pull("prediction", Towards::Prediction),
            Self::Seam => pull("seams", Towards::Seam),
            Self::Landmarks => {
                let samples = input.landmarks.iter().map(|l| l.0).collect();
                let targets = input.landmarks.iter().map(|l| l.1).collect();
                let weights = input.landmarks.iter().map(|l| l.2).collect();
                let residuals = Landmarks { samples, targets, weights, scale: 0.0 };
                Box::new(Pointwise::new("landmarks", residuals, Kernel::None))
            }
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

impl RegistrationTerm for Pointwise<Symmetric, Kernel, 1> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.scale = level.symmetric * density;
        self.kernel = level.kernel;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        self.residuals.targets.clone_from(&correspondences.points);
        self.residuals.source_normals.clone_from(&correspondences.template_normals);
        self.residuals.target_normals.clone_from(&correspondences.normals);
        self.residuals.weights.clone_from(&correspondences.weights);
    }
}

impl RegistrationTerm for Pointwise<ScanToTemplate, Kernel, 1> {
    fn set_level(&mut self, level: &Level, density: f64) {
        self.residuals.scale = level.scan_to_template * density;
        self.kernel = level.kernel;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        let scale = self.residuals.scale;
        self.residuals.clone_from(&correspondences.from_scan);
        self.residuals.scale = scale;
    }
}

impl RegistrationTerm for Pointwise<Landmarks, Kernel, 3> {
    fn set_level(&mut self, level: &Level, _density: f64) {
        self.residuals.scale = level.landmarks;
        self.kernel = level.landmark_kernel;
    }

    fn update(&mut self, _correspondences: &Correspondences) {}
}

/// Point-to-point towards one of the targets that correspondences come with.
struct Pull {
    term: Pointwise<PointToPoint, Kernel, 3>,
    towards: Towards,
}

enum Towards {
    ClosestPoint,
    Prediction,
    Seam,
}

impl DataTerm for Pull {
    fn name(&self) -> &str {
        self.term.name()
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        self.term.energy(positions)
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        self.term.linearize(positions, field)
    }

    fn residual_variance(&self, positions: &[Vec3]) -> Option<[f64; 2]> {
        match self.towards {
            Towards::ClosestPoint => self.term.residual_variance(positions),
            // Guesses, not measurements.
            Towards::Prediction | Towards::Seam => None,
        }
    }
}

impl RegistrationTerm for Pull {
    fn set_level(&mut self, level: &Level, density: f64) {
        let (weight, kernel) = match self.towards {
            Towards::ClosestPoint => (level.point_to_point, level.kernel),
            Towards::Prediction => (level.prediction, Kernel::None),
            Towards::Seam => (level.seam, Kernel::None),
        };
        self.term.residuals.scale = weight * density;
        self.term.kernel = kernel;
    }

    fn update(&mut self, correspondences: &Correspondences) {
        let PointToPoint { targets, weights, .. } = &mut self.term.residuals;
        match self.towards {
            Towards::ClosestPoint => {
                targets.clone_from(&correspondences.points);
                weights.clone_from(&correspondences.weights);
            }
            Towards::Prediction => {
                targets.clone_from(&correspondences.predictions);
                weights.clone_from(&correspondences.prediction_weights);
            }
            Towards::Seam => {
                targets.clone_from(&correspondences.seam_points);
                weights.clone_from(&correspondences.seam_weights);
            }
        }
    }
}
