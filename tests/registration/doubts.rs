//! What a result says of itself.

use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::registration::{ModelKind, RegistrationInput, Reliability, Silent, assess, register};
use nonrigid::rig::{ShapeBasis, ShapeSelection};

/// Models of shapes alone make nothing beyond them: what the shapes lack is what they leave of the scan.
#[test]
fn a_subject_that_the_shapes_do_not_know_is_doubted_whatever_the_model() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 8 });
    let [expressions, all] = [0, 8].map(|identity_modes| {
        let selection = ShapeSelection { identity_modes, ..ShapeSelection::default() };
        rig.to_rig().unwrap().select(selection).unwrap()
    });
    let options = ScanOptions { triangles: 8000, identity: Some(vec![2.0, -2.0, 2.0, -1.5]), ..ScanOptions::default() };
    let case = simulate_scan(&rig, &options, 70).unwrap();
    let landmarks = case.landmark_pairs();
    for model in [ModelKind::Blendshape, ModelKind::Hybrid] {
        let said = |shapes: &ShapeBasis| -> Reliability {
            let input =
                RegistrationInput { shapes, landmarks: &landmarks, ..RegistrationInput::new(&rig.mesh, &case.scan) };
            let schedule = model.schedule().unwrap();
            let result = register(&input, &model, &schedule, &mut Silent).unwrap();
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

/// Whatever the calibration says: it has seen no such results.
#[test]
fn what_is_hardly_shown_or_mostly_contradicted_is_doubted() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 8 });
    let case = simulate_scan(&rig, &ScanOptions { triangles: 8000, ..ScanOptions::default() }, 70).unwrap();
    let landmarks = case.landmark_pairs();
    let count = rig.mesh.positions.len();
    let mut half_turned = case.scan.clone();
    half_turned.triangles.iter_mut().enumerate().filter(|(k, _)| k % 9 < 4).for_each(|(_, t)| t.swap(1, 2));
    // Triangles with corners of their own, none at the place of another, say nothing of how their neighbours face.
    let apart = |(k, v): (usize, &u32)| case.scan.positions[*v as usize] + Vec3::repeat(1e-9 * k as f64);
    half_turned.positions = half_turned.triangles.as_flattened().iter().enumerate().map(apart).collect();
    half_turned.triangles = (0..half_turned.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let nearly_all_masked: Vec<f64> = (0..count).map(|v| if v % 10 == 0 { 1.0 } else { 0.0 }).collect();
    let doubts = |scan: &TriangleMesh, mask: Option<&[f64]>| -> Vec<&'static str> {
        let input = RegistrationInput { landmarks: &landmarks, mask, ..RegistrationInput::new(&rig.mesh, scan) };
        let model = ModelKind::Graph;
        let schedule = model.schedule().unwrap();
        let result = register(&input, &model, &schedule, &mut Silent).unwrap();
        assess(&input, &result).unwrap().1.doubts.iter().map(|doubt| doubt.name()).collect()
    };
    assert!(!doubts(&case.scan, None).iter().any(|doubt| ["little_seen", "contradicted"].contains(doubt)));
    assert!(doubts(&case.scan, Some(&nearly_all_masked)).contains(&"little_seen"));
    assert!(doubts(&half_turned, None).contains(&"contradicted"));
}

/// Teeth and eyeballs that a Laplacian draws into a point, since nothing says how large they are.
#[test]
fn parts_that_fall_together_are_doubted() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 8 });
    let case = simulate_scan(&rig, &ScanOptions { triangles: 8000, ..ScanOptions::default() }, 70).unwrap();
    let landmarks = case.landmark_pairs();
    let mut template = rig.mesh.triangulate();
    let doubts = |template: TriangleMesh, model: ModelKind| -> Vec<&'static str> {
        let template = template.into();
        let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&template, &case.scan) };
        let result = register(&input, &model, &model.schedule().unwrap(), &mut Silent).unwrap();
        assess(&input, &result).unwrap().1.doubts.iter().map(|doubt| doubt.name()).collect()
    };
    assert!(!doubts(template.clone(), ModelKind::Laplacian).contains(&"stretched"));
    // a ball of 22 mm behind each eye, of which the scan shows nothing but what lies before it
    for eye in [36..42_usize, 42..48] {
        let lids: Vec<Vec3> = eye.map(|k| template.positions[rig.landmarks[k].vertex as usize]).collect();
        let centre = lids.iter().sum::<Vec3>() / lids.len() as f64 - Vec3::new(0.0, 0.0, 12.0);
        let first = template.positions.len() as u32;
        let (rings, around) = (8, 12);
        for ring in 0..=rings {
            let polar = std::f64::consts::PI * (f64::from(ring) + 0.01) / (f64::from(rings) + 0.02);
            for k in 0..around {
                let angle = std::f64::consts::TAU * f64::from(k) / f64::from(around);
                let out = Vec3::new(polar.sin() * angle.cos(), polar.cos(), polar.sin() * angle.sin());
                template.positions.push(centre + 11.0 * out);
            }
        }
        for (ring, k) in (0..rings).flat_map(|ring| (0..around).map(move |k| (ring, k))) {
            let at = |ring: u32, k: u32| first + ring * around + k % around;
            let [a, b, c, d] = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            template.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let said = doubts(template, ModelKind::Laplacian);
    assert!(said.contains(&"stretched"), "{said:?}");
}
