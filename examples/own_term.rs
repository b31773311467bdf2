//! A data term of one's own in a registration: freckles seen in one photograph. Each puts a template vertex on a ray
//! through the camera. The scan says how far away the skin is, but not where along it a vertex belongs; the photograph does.
//!
//! `cargo run --release --example own_term`

use std::error::Error;
use std::ops::ControlFlow;

use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::energy::{DataTerm, Pointwise, QuadricField, SampleResidual};
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::Vec3;
use nonrigid::mesh::io::{Landmark, TemplatePoint};
use nonrigid::nlls::{Kernel, Scalar};
use nonrigid::registration::{
    Correspondences, Level, ModelFactory, ModelKind, RegistrationInput, RegistrationTerm, StepRecord, TermFactory,
    TermInput, TermKind, register_with,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Vertices and unit directions from the camera in which they are seen.
#[derive(Clone)]
struct Rays {
    camera: Vec3,
    seen: Vec<(usize, Vec3)>,
    weight: f64,
}

impl SampleResidual<3> for Rays {
    fn len(&self) -> usize {
        self.seen.len()
    }

    /// Vertex v is sample v.
    fn sample(&self, m: usize) -> usize {
        self.seen[m].0
    }

    fn weight(&self, _m: usize) -> f64 {
        self.weight
    }

    /// What of v - camera is not along the ray.
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
        let (o, d) = (self.camera, self.seen[m].1);
        let q: [D; 3] = std::array::from_fn(|a| v[a] - o[a]);
        let along = q[0] * d[0] + q[1] * d[1] + q[2] * d[2];
        std::array::from_fn(|a| q[a] - along * d[a])
    }
}

/// The residuals under a kernel, following the levels of a schedule.
struct Freckles(Pointwise<Rays, Kernel, 3>);

impl DataTerm for Freckles {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        self.0.energy(positions)
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        self.0.linearize(positions, field)
    }
}

impl RegistrationTerm for Freckles {
    fn set_level(&mut self, level: &Level, _density: f64) {
        self.0.residuals.weight = level.landmarks;
    }

    fn update(&mut self, _correspondences: &Correspondences) {}
}

/// The photograph, in the scan's frame.
struct Photograph(Rays);

impl TermFactory for Photograph {
    fn build(&self, input: &TermInput<'_>) -> Box<dyn RegistrationTerm> {
        let mut rays = self.0.clone();
        rays.camera = input.frame.apply_inverse(rays.camera);
        rays.seen.iter_mut().for_each(|(_, d)| *d = input.frame.rotation.tr_mul(d));
        Box::new(Freckles(Pointwise::new("freckles", rays, Kernel::Huber { delta: 1.0 })))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let rig = FaceRig::generate(&FaceOptions { vertices: 2500, ..FaceOptions::default() });
    let case = simulate_scan(&rig, &ScanOptions::default(), 4)?;
    let mark = |(v, p): &(u32, Vec3)| Landmark { name: v.to_string(), template: TemplatePoint::Vertex(*v), target: *p };
    let landmarks: Vec<Landmark> = case.landmarks.iter().map(mark).collect();
    let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&rig.mesh, &case.scan) };

    // Every 20th vertex that the scan shows is a freckle, seen from 700 mm to within 0.3 mm.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let camera = Vec3::new(0.0, 0.0, 700.0);
    let visible = (0..case.truth.len()).filter(|&v| case.observed[v]).step_by(20);
    let seen = visible.map(|v| {
        let error = Vec3::from_fn(|_, _| rng.random_range(-0.3..0.3));
        (v, (case.truth[v] + error - camera).normalize())
    });
    let photograph = Photograph(Rays { camera, seen: seen.collect(), weight: 0.0 });

    let model = ModelKind::Graph;
    let schedule = model.schedule()?;
    let mut terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let triangles = rig.mesh.triangulate().triangles;
    for (name, own) in [("without", None), ("with", Some(&photograph))] {
        terms.extend(own.map(|p| p as &dyn TermFactory));
        let mut steps = |_: &StepRecord| ControlFlow::Continue(());
        let result = register_with(&input, &model, &terms, &schedule, &mut steps)?;
        let (errors, _) = TruthErrors::new(&result.positions, &case.truth, &case.observed, &triangles)?;
        let count = photograph.0.seen.len();
        println!(
            "{name} {count} freckles: rmse {:.2} mm, off the surface {:.2} mm, along it {:.2} mm",
            errors.rmse, errors.off, errors.slide
        );
    }
    Ok(())
}
