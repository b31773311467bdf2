//! The standard deviation of landmarks: how files state it, and what it does to start and result.

use std::path::Path;

use crate::awkward::quads;
use crate::support::farthest;
use nalgebra::DMatrix;
use nonrigid::landmark::{Landmark, TemplatePoint, parse_landmarks};
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::{PolygonMesh, Pose, TriangleMesh, Vec3};
use nonrigid::registration::{
    Doubt, ModelKind, RegistrationError, RegistrationInput, RegistrationResult, Schedule, Silent, assess, find_start,
    register,
};

const SIDE: u32 = 9;

/// A bent sheet of quads, 160 mm wide.
fn sheet() -> PolygonMesh {
    quads(SIDE, SIDE, |c, r| {
        let (x, y) = (20.0 * c, 20.0 * r);
        Vec3::new(x, y, 0.002 * x * x + 0.1 * y)
    })
}

/// Landmarks of the sheet in another place, up to 6 mm off, with these deviations.
fn marks(mesh: &PolygonMesh, sigmas: &[Option<f64>]) -> Vec<Landmark> {
    let place = Pose::rigid(Vec3::new(0.1, 0.3, -0.2), Vec3::new(30.0, -10.0, 5.0));
    let mark = |(i, sigma): (usize, &Option<f64>)| {
        let vertex = (7 + i as u32 * 29) % (SIDE * SIDE);
        let off = Vec3::new(6.0 * (i as f64).sin(), 5.0 * (2.0 * i as f64).cos(), 4.0 * (3.0 * i as f64).sin());
        let target = place.apply(mesh.positions[vertex as usize]) + off;
        Landmark { sigma: *sigma, ..Landmark::new(vertex.to_string(), vertex, target) }
    };
    sigmas.iter().enumerate().map(mark).collect()
}

/// Landmarks alone against the Laplacian of free vertices. A rigid start keeps the template's size, with which deviations would grow that
/// landmarks do not state.
fn schedule(start: &str, weight: f64) -> Schedule {
    let text = format!(
        "start = \"{start}\"\nreference_size = 67.0\nreference_vertices = 81\n[search]\nscale_sigma = 0.0\n[model]\nweights = \"uniform\"\n[[level]]\n\
         steps = 2\nmodel = {{ lambda_smooth = 0.7 }}\nterms.point_to_plane = {{ weight = 0.0 }}\n\
         terms.landmarks = {{ weight = {weight:?} }}\nkernel = \"none\"\ndistance_cap = 50.0\nnormal_angle = 80.0\n"
    );
    Schedule::from_toml(&text).unwrap()
}

fn fit(mesh: &PolygonMesh, landmarks: &[Landmark], schedule: &Schedule) -> RegistrationResult {
    let scan = scan(mesh);
    let input = RegistrationInput { landmarks, ..RegistrationInput::new(mesh, &scan) };
    register(&input, &ModelKind::Free, schedule, &mut Silent).unwrap()
}

/// The sheet where its landmarks are.
fn scan(mesh: &PolygonMesh) -> TriangleMesh {
    let place = Pose::rigid(Vec3::new(0.1, 0.3, -0.2), Vec3::new(30.0, -10.0, 5.0));
    let mut scan = mesh.triangulate();
    scan.positions.iter_mut().for_each(|p| *p = place.apply(*p));
    scan
}

/// Length of one of the schedule's millimetres on the sheet.
fn unit(mesh: &PolygonMesh) -> f64 {
    let centre = mesh.positions.iter().sum::<Vec3>() / mesh.positions.len() as f64;
    let squares = mesh.positions.iter().map(|p| (p - centre).norm_squared()).sum::<f64>();
    (squares / mesh.positions.len() as f64).sqrt() / 67.0
}

const MIXED: [Option<f64>; 7] = [Some(0.4), None, Some(3.0), Some(1.0), None, Some(9.0), Some(0.7)];

#[test]
fn the_result_is_that_of_dense_normal_equations_with_these_weights() {
    let mesh = sheet();
    let (landmarks, alpha, lambda) = (marks(&mesh, &MIXED), 1.3, 0.7 / 3f64.sqrt());
    let result = fit(&mesh, &landmarks, &schedule("rigid", alpha));
    // (lambda L + alpha W) d = alpha W (c - v0), v0 posed.
    let count = mesh.positions.len();
    let posed: Vec<Vec3> = mesh.positions.iter().map(|&p| result.start.apply(p)).collect();
    let (mut matrix, mut right) = (DMatrix::zeros(count, count), DMatrix::zeros(count, 3));
    for &[i, j] in EdgeGraph::of(&mesh.triangulate()).edges() {
        let (i, j) = (i as usize, j as usize);
        for (a, b, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
            matrix[(a, b)] += sign * lambda;
        }
    }
    for l in &landmarks {
        let TemplatePoint::Vertex(v) = l.template else { panic!("a vertex") };
        let weight = alpha * l.sigma.map_or(1.0, |s| (unit(&mesh) / s).powi(2));
        matrix[(v as usize, v as usize)] += weight;
        let off = (l.target - posed[v as usize]) * weight;
        (0..3).for_each(|c| right[(v as usize, c)] += off[c]);
    }
    let d = matrix.lu().solve(&right).unwrap();
    let expected: Vec<Vec3> = (0..count).map(|i| posed[i] + Vec3::new(d[(i, 0)], d[(i, 1)], d[(i, 2)])).collect();
    let distance = farthest(&result.positions, &expected);
    assert!(distance < 1e-6, "{distance}");
    assert!(farthest(&result.positions, &fit(&mesh, &marks(&mesh, &[None; 7]), &result.schedule).positions) > 0.5);
}

#[test]
fn half_the_deviation_counts_as_four_landmarks_in_start_and_result() {
    let mesh = sheet();
    for start in ["rigid", "similarity"] {
        let schedule = schedule(start, 1.0);
        let mut landmarks = marks(&mesh, &[None; 5]);
        let scale = fit(&mesh, &landmarks, &schedule).start.scale;
        landmarks.extend(vec![landmarks[2].clone(); 3]);
        let repeated = fit(&mesh, &landmarks, &schedule);
        landmarks.truncate(5);
        // A similarity's size is not known before the start, so there all landmarks state their deviation.
        for (i, l) in landmarks.iter_mut().enumerate() {
            l.sigma = (i == 2 || start == "similarity").then_some(if i == 2 { 0.5 } else { 1.0 } * unit(&mesh));
        }
        let weighted = fit(&mesh, &landmarks, &schedule);
        assert!((weighted.start.scale - repeated.start.scale).abs() < 1e-12, "{start}: {scale}");
        assert!((weighted.start.translation - repeated.start.translation).norm() < 1e-9, "{start}");
        if start == "rigid" {
            assert!(farthest(&weighted.positions, &repeated.positions) < 1e-9);
        }
    }
}

#[test]
fn equal_deviations_scale_the_term_and_leave_the_start() {
    let mesh = sheet();
    let sigma = 2.0 * unit(&mesh);
    let weighted = fit(&mesh, &marks(&mesh, &[Some(sigma); 6]), &schedule("rigid", 1.0));
    let scaled = fit(&mesh, &marks(&mesh, &[None; 6]), &schedule("rigid", 0.25));
    assert!((weighted.start.translation - scaled.start.translation).norm() < 1e-10);
    assert!(farthest(&weighted.positions, &scaled.positions) < 1e-10);
    let reference = Schedule {
        sigma: nonrigid::registration::SigmaOptions { landmark: 2.0, ..Default::default() },
        ..schedule("rigid", 1.0)
    };
    let none = fit(&mesh, &marks(&mesh, &[None; 6]), &schedule("rigid", 1.0));
    assert_eq!(fit(&mesh, &marks(&mesh, &[None; 6]), &reference).positions, none.positions);
    assert!(farthest(&fit(&mesh, &marks(&mesh, &[Some(sigma); 6]), &reference).positions, &none.positions) < 1e-10);
}

#[test]
fn a_landmark_of_huge_deviation_changes_nothing() {
    let mesh = sheet();
    let without = marks(&mesh, &[None, Some(0.8), None, Some(2.0), None]);
    let mut with = without.clone();
    let far = Vec3::new(400.0, -300.0, 250.0);
    let vague = |vertex: u32| Landmark { sigma: Some(1e9), ..Landmark::new(vertex.to_string(), vertex, far) };
    with.push(vague(40));
    for start in ["rigid", "similarity"] {
        let [a, b] = [&without, &with].map(|l| fit(&mesh, l, &schedule(start, 1.0)));
        assert!(farthest(&a.positions, &b.positions) < 1e-6, "{start}");
        let scan = scan(&mesh);
        let input = RegistrationInput { landmarks: &with, ..RegistrationInput::new(&mesh, &scan) };
        let doubts = assess(&input, &b).unwrap().1.doubts;
        assert!(!doubts.iter().any(|d| matches!(d, Doubt::Landmarks { .. })), "{doubts:?}");
    }
    // Nor does it narrow the search of a start.
    let bench = crate::support::Bench::of_size(600, 4000);
    let found = [&[][..], &[vague(40)]].map(|landmarks| {
        let input = RegistrationInput { landmarks, ..RegistrationInput::new(&bench.rig.mesh, &bench.case.scan) };
        find_start(&input, &ModelKind::Rigid.schedule().unwrap()).unwrap()
    });
    assert_eq!(found[0], found[1]);
}

fn parsed(target: &str, names: Option<&str>) -> Result<Vec<Landmark>, String> {
    let names = names.map(|text| (text.as_bytes(), Path::new("names.json")));
    parse_landmarks((target.as_bytes(), Path::new("a.json")), names, &sheet(), None).map_err(|e| e.to_string())
}

#[test]
fn files_state_it_for_either_side() {
    let native = |entry: &str| format!(r#"{{"unit": "cm", "landmarks": [{{"name": "7", {entry}}}]}}"#);
    let target = native(r#""position": [1, 2, 3], "sigma": 0.3"#);
    assert_eq!(parsed(&target, None).unwrap()[0].sigma, Some(3.0));
    let names = native(r#""vertex": 12, "sigma": 0.4"#);
    assert_eq!(parsed(&target, Some(&names)).unwrap()[0].sigma, Some(5.0));
    let unknown = native(r#""position": [1, 2, 3]"#);
    assert_eq!(parsed(&unknown, Some(&names)).unwrap()[0].sigma, Some(4.0));
    assert_eq!(parsed(&unknown, None).unwrap()[0].sigma, None);
    let scalismo = r#"[{"id": "7", "coordinates": [1, 2, 3], "uncertainty": {"stddevs": [2, 2, 2], "pcvectors": []}}]"#;
    assert_eq!(parsed(scalismo, None).unwrap()[0].sigma, Some(2.0));
}

#[test]
fn what_is_no_deviation_is_refused() {
    for sigma in ["0", "-1.5", "\"wide\"", "null"] {
        let text = format!(r#"{{"landmarks": [{{"name": "7", "position": [1, 2, 3], "sigma": {sigma}}}]}}"#);
        let message = parsed(&text, None).unwrap_err();
        assert!(message.contains("a.json") && message.contains("positive \"sigma\" for landmark \"7\""), "{message}");
    }
    for deviations in ["[1, 0, 1]", "[1, -2, 1]", "[1, 1]"] {
        let text = format!(r#"[{{"id": "7", "coordinates": [1, 2, 3], "uncertainty": {{"stddevs": {deviations}}}}}]"#);
        let message = parsed(&text, None).unwrap_err();
        assert!(message.contains("three positive \"stddevs\" for landmark \"7\""), "{message}");
    }
    let mesh = sheet();
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let landmarks = marks(&mesh, &[None, None, None, Some(sigma)]);
        let scan = scan(&mesh);
        let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&mesh, &scan) };
        let error = find_start(&input, &schedule("rigid", 1.0)).unwrap_err();
        assert!(matches!(error, RegistrationError::LandmarkSigma { .. }) && error.is_input(), "{error}");
    }
}
