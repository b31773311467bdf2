//! Everything that a registration takes, owned.

use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::RegistrationInput;
use nonrigid::rig::ShapeBasis;

#[derive(Clone)]
pub struct Task {
    pub template: PolygonMesh,
    pub shapes: ShapeBasis,
    pub scan: TriangleMesh,
    pub scan_normals: Option<Vec<Vec3>>,
    pub landmarks: Vec<Landmark>,
    pub mask: Option<Vec<f64>>,
    pub free_mask: Option<Vec<f64>>,
}

impl Task {
    pub fn input(&self) -> RegistrationInput<'_> {
        RegistrationInput {
            shapes: &self.shapes,
            scan_normals: self.scan_normals.as_deref(),
            landmarks: &self.landmarks,
            mask: self.mask.as_deref(),
            free_mask: self.free_mask.as_deref(),
            ..RegistrationInput::new(&self.template, &self.scan)
        }
    }
}
