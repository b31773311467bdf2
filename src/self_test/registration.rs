//! A whole registration: five thousand vertices, forty shapes, the hybrid model with its default schedule.

use std::error::Error;

use super::Check;
use super::face::Face;
use crate::evaluation::TruthErrors;
use crate::mesh::Vec3;
use crate::registration::{ModelKind, RegistrationError, RegistrationInput, Silent, register};

/// Each step chooses closest points anew, and what differs in the last digit may choose another one: of some ten thousands of
/// choices, one would have to lie within some 1e-13 mm of where it turns. `tests/registration/self_test.rs` moves every
/// coordinate by 1e-10 mm, ten thousand times as much as processors differ by, and finds the error to change by less than a
/// tenth of the tolerance.
pub const ERROR: Check = Check {
    what: "hybrid registration of 5016 vertices: rmse against the truth / mm",
    expected: 0.429_594,
    tolerance: 1e-5,
    compute: || registration_rmse(&Face::new()),
};

/// A promise of this program on any one machine.
pub const SAME_BITS: Check = Check {
    what: "the same registration on one thread and on all: coordinates that differ",
    expected: 0.0,
    tolerance: 0.0,
    compute: differing_coordinates,
};

/// Registers a face's template to its scan: root mean square of the vertices' distances from the truth, millimetres.
///
/// # Errors
/// Those of [`register`].
pub fn registration_rmse(face: &Face) -> Result<f64, Box<dyn Error>> {
    let positions = registered(face)?;
    let triangles = face.template.triangulate().triangles;
    let (errors, _) = TruthErrors::new(&positions, &face.truth, &vec![true; positions.len()], &triangles)?;
    Ok(errors.rmse)
}

fn registered(face: &Face) -> Result<Vec<Vec3>, RegistrationError> {
    let input = RegistrationInput {
        shapes: &face.shapes,
        landmarks: &face.landmarks,
        ..RegistrationInput::new(&face.template, &face.scan)
    };
    let model = ModelKind::Hybrid;
    let result = register(&input, &model, &model.schedule()?, &mut Silent)?;
    Ok(result.positions)
}

fn differing_coordinates() -> Result<f64, Box<dyn Error>> {
    let face = Face::new();
    let on = |threads: usize| -> Result<Vec<Vec3>, Box<dyn Error>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(pool.install(|| registered(&face))?)
    };
    let (one, all) = (on(1)?, on(rayon::current_num_threads().max(2))?);
    let coordinates = one.iter().flatten().zip(all.iter().flatten());
    Ok(coordinates.filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64)
}
