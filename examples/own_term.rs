//! A data term of one's own in a registration: freckles seen in one photograph. Each puts a template vertex on a ray
//! through the camera. The scan says how far away the skin is, but not where along it a vertex belongs; the photograph does.
//!
//! `cargo run --release --example own_term`

use std::error::Error;

use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::energy::{OptionsError, Pointwise, SampleResidual};
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::Vec3;
use nonrigid::nlls::{Kernel, Scalar};
use nonrigid::registration::{
    ModelKind, RegistrationInput, RegistrationTerm, Silent, TERMS, TermFactory, TermInput, register_with,
};
use nonrigid::term::{Scheduled, TermError, TermLevel, TermWeight};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Vertices and unit directions from the camera in which they are seen.
struct Rays {
    camera: Vec3,
    seen: Vec<(usize, Vec3)>,
    weight: f64,
}

impl Scheduled<3> for Rays {
    /// Weighted as a level says, level by level, under a kernel of its own.
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.weight = level.options.read::<TermWeight>()?.weight;
        Ok(Kernel::Huber { delta: 1.0 }.scaled(level.unit))
    }
}

/// `terms.freckles = { weight = 0.5 }` in a level; what was seen is in the scan's frame.
struct Freckles {
    camera: Vec3,
    seen: Vec<(usize, Vec3)>,
}

impl TermFactory for Freckles {
    fn name(&self) -> &str {
        "freckles"
    }

    /// Brings what was seen to the frame in which models solve.
    fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
        let camera = input.frame.apply_inverse(self.camera);
        let seen = self.seen.iter().map(|(v, d)| (*v, input.frame.rotation.tr_mul(d))).collect();
        Ok(Box::new(Pointwise::new("freckles", Rays { camera, seen, weight: 0.0 }, Kernel::None)))
    }
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
    let landmarks = case.landmark_pairs();
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
    let freckles = Freckles { camera, seen };

    let model = ModelKind::Graph;
    let mut schedule = model.schedule()?;
    let mut terms = TERMS.to_vec();
    let triangles = rig.mesh.triangulate().triangles;
    for name in ["without", "with"] {
        if name == "with" {
            terms.push(&freckles);
            for level in &mut schedule.levels {
                let weight = level.term("landmarks").unwrap_or(0.0);
                level.set_term("freckles", weight);
            }
        }
        let result = register_with(&input, &model, &terms, &schedule, &mut Silent)?;
        let (errors, _) = TruthErrors::new(&result.positions, &case.truth, &case.observed, &triangles)?;
        println!(
            "{name} {count} freckles: rmse {:.2} mm, off the surface {:.2} mm, along it {:.2} mm",
            errors.rmse, errors.normal, errors.tangential
        );
    }
    Ok(())
}
