//! Models and terms of one's own that are wrong: the error or the result says which, and how.

use nonrigid::energy::{DataTerm, Options, OptionsError, QuadricField};
use nonrigid::mesh::{MeshError, TriangleMesh, Vec3};
use nonrigid::model::{ModelError, ModelFactory, ModelInput, RegistrationModel};
use nonrigid::registration::{ModelKind, RegistrationError, RegistrationTerm, Silent, TERMS, TermFactory, TermInput};
use nonrigid::registration::{register, register_with};
use nonrigid::term::{Step, TermError, TermLevel};

use crate::laws::small_task;

/// Pulls the first vertex to where it rests, shifted, with a derivative and an energy that are so many times the right ones.
#[derive(Clone, Copy)]
struct Pull {
    derivative: f64,
    energy: f64,
    target: Vec3,
}

const WEIGHT: f64 = 1e6;

impl DataTerm for Pull {
    fn name(&self) -> &str {
        "pull"
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        self.energy * WEIGHT * (positions[0] - self.target).norm_squared()
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        for a in 0..3 {
            let row = std::array::from_fn(|b| f64::from(u8::from(a == b)));
            field.at_mut(0).add(WEIGHT, row, self.derivative * (positions[0][a] - self.target[a]));
        }
        self.energy(positions)
    }
}

impl RegistrationTerm for Pull {
    fn set_level(&mut self, _: &TermLevel<'_>) -> Result<(), OptionsError> {
        Ok(())
    }

    fn update(&mut self, _: &Step<'_>) -> Result<(), MeshError> {
        Ok(())
    }
}

impl TermFactory for Pull {
    fn name(&self) -> &str {
        "pull"
    }

    fn build(&self, input: &TermInput<'_>) -> Result<Box<dyn RegistrationTerm>, TermError> {
        Ok(Box::new(Self { target: input.rest.positions[0] + Vec3::new(0.0, 0.0, 3.0), ..*self }))
    }
}

#[test]
fn a_term_with_a_wrong_derivative_is_remarked_on_and_one_that_is_not_finite_is_named() {
    let task = small_task();
    let schedule = ModelKind::Rigid.schedule().unwrap();
    let registered = |derivative, energy| {
        let pull = Pull { derivative, energy, target: Vec3::zeros() };
        let mut terms = TERMS.to_vec();
        terms.push(&pull);
        register_with(&task.input(), &ModelKind::Rigid, &terms, &schedule, &mut Silent)
    };
    let said = |derivative| {
        let result = registered(derivative, 1.0).unwrap();
        (result.stalled_steps, result.remarks().iter().any(|r| r.contains("derivatives of a model or term")))
    };
    assert_eq!(said(1.0), (0, false));
    let (stalled, remarked) = said(-1.0);
    assert!(stalled > 0 && remarked);
    let error = registered(1.0, f64::INFINITY).unwrap_err().to_string();
    assert_eq!(error, "level 1, step 1: the energy \"pull\" is no longer finite");
}

/// The rigid model, of another mesh.
struct OfAnother;

impl ModelFactory for OfAnother {
    fn name(&self) -> &str {
        "of another"
    }

    fn default_schedule(&self) -> &str {
        ModelKind::Rigid.default_schedule()
    }

    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        ModelKind::Rigid.level_options(given)
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let rest = TriangleMesh { positions: input.rest.positions[..3].to_vec(), triangles: vec![[0, 1, 2]] };
        ModelKind::Rigid.build(&ModelInput { rest: &rest, ..*input })
    }
}

#[test]
fn a_model_of_other_vertices_is_refused() {
    let task = small_task();
    let template = task.template.positions.len();
    let error = register(&task.input(), &OfAnother, &ModelKind::Rigid.schedule().unwrap(), &mut Silent).unwrap_err();
    assert_eq!(error, RegistrationError::VertexCount { what: "model", found: 3, template });
}
