//! What a result says of itself.

use std::ops::ControlFlow;

use crate::start::{basis, expressions};
use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::landmark::Landmark;
use nonrigid::registration::{ModelKind, RegistrationInput, Reliability, StepRecord, assess, register};
use nonrigid::rig::{Family, ShapeBasis};

/// Models of shapes alone make nothing beyond them: what the shapes lack is what they leave of the scan.
#[test]
fn a_subject_that_the_shapes_do_not_know_is_doubted_whatever_the_model() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 8 });
    let identities = rig.identities.iter().enumerate().map(|(k, delta)| (format!("identity{k}"), delta));
    let expressions = expressions(&rig);
    let all = basis(Family::Identity, identities).joined(&expressions);
    let options = ScanOptions { triangles: 8000, identity: Some(vec![2.0, -2.0, 2.0, -1.5]), ..ScanOptions::default() };
    let case = simulate_scan(&rig, &options, 70).unwrap();
    let landmarks: Vec<Landmark> = case.landmarks.iter().map(|(v, p)| Landmark::new(v.to_string(), *v, *p)).collect();
    for model in [ModelKind::Blendshape, ModelKind::Hybrid] {
        let said = |shapes: &ShapeBasis| -> Reliability {
            let input =
                RegistrationInput { shapes, landmarks: &landmarks, ..RegistrationInput::new(&rig.mesh, &case.scan) };
            let schedule = model.schedule().unwrap();
            let result = register(&input, &model, &schedule, &mut |_: &StepRecord| ControlFlow::Continue(())).unwrap();
            assess(&input, &result).unwrap().1
        };
        let (known, unknown) = (said(&all), said(&expressions));
        let beyond = [&known, &unknown].map(|said| said.evidence.beyond_shapes);
        assert!(beyond[1] > 2.0 * beyond[0], "{model}: {beyond:?}");
        assert!(
            unknown.probability > 2.0 * known.probability,
            "{model}: {} {}",
            known.probability,
            unknown.probability
        );
        let doubts: Vec<&str> = unknown.doubts.iter().map(|doubt| doubt.name()).collect();
        assert!(doubts.contains(&"beyond_shapes"), "{model}: {doubts:?}");
    }
}
