//! A data term of one's own in a registration: freckles seen in one photograph. Each puts a template vertex on a ray
//! through the camera. The scan says how far away the skin is, but not where along it a vertex belongs; the photograph does.
//!
//! `cargo run --release --example own_term`

use std::error::Error;
use std::ops::ControlFlow;

use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::energy::SampleResidual;
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::Vec3;
use nonrigid::mesh::io::{Landmark, TemplatePoint};
use nonrigid::nlls::{Kernel, Scalar};
use nonrigid::registration::{
    LevelTerm, ModelFactory, ModelKind, RegistrationInput, RegistrationTerm, StepRecord, TermFactory, TermInput,
    TermKind, register_with,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Vertices and unit directions from the camera in which they are seen.
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

fn main() -> Result<(), Box<dyn Error>> {
    let rig = FaceRig::generate(&FaceOptions { vertices: 2500, ..FaceOptions::default() });
    let case = simulate_scan(&rig, &ScanOptions::default(), 4)?;
    let mark = |(v, p): &(u32, Vec3)| Landmark {
        name: v.to_string(),
        template: TemplatePoint::Vertex(*v),
        target: *p,
        sigma: None,
    };
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
    let seen: Vec<(usize, Vec3)> = seen.collect();
    let count = seen.len();
    // The term: brought to the frame in which models solve, under a kernel, weighted like landmarks level by level.
    let freckles = move |input: &TermInput<'_>| -> Box<dyn RegistrationTerm> {
        let camera = input.frame.apply_inverse(camera);
        let seen = seen.iter().map(|(v, d)| (*v, input.frame.rotation.tr_mul(d))).collect();
        let rays = Rays { camera, seen, weight: 0.0 };
        let kernel = Kernel::Huber { delta: 1.0 };
        Box::new(LevelTerm::new("freckles", rays, kernel, |term, level, _| term.residuals.weight = level.landmarks))
    };

    let model = ModelKind::Graph;
    let schedule = model.schedule()?;
    let mut terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let triangles = rig.mesh.triangulate().triangles;
    for (name, own) in [("without", None), ("with", Some(&freckles))] {
        terms.extend(own.map(|f| f as &dyn TermFactory));
        let mut steps = |_: &StepRecord| ControlFlow::Continue(());
        let result = register_with(&input, &model, &terms, &schedule, &mut steps)?;
        let (errors, _) = TruthErrors::new(&result.positions, &case.truth, &case.observed, &triangles)?;
        println!(
            "{name} {count} freckles: rmse {:.2} mm, off the surface {:.2} mm, along it {:.2} mm",
            errors.rmse, errors.off, errors.slide
        );
    }
    Ok(())
}
