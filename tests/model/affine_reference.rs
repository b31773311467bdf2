//! Per-vertex affine maps against trimesh's `nricp_amberg` (`tests/references/nricp_trimesh.py` writes the file that is read
//! here): the same energy and vertices after the same stiffness steps.

use std::f64::consts::PI;

use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::model::Affine;
use nonrigid::nlls::{Kernel, Minimizer, Options, Silent, Workspace};
use nonrigid::term::{Landmarks, PointToPoint};
use serde::Deserialize;

const RINGS: usize = 20;
const SIDES: usize = 24;

#[derive(Deserialize)]
struct Reference {
    gamma: f64,
    scale: f64,
    landmarks: Vec<usize>,
    steps: Vec<Step>,
}

#[derive(Deserialize)]
struct Step {
    ws: f64,
    wl: f64,
    stiffness: f64,
    data: f64,
    landmarks: f64,
    vertices: Vec<[f64; 3]>,
}

/// The surface of the script.
fn surface() -> TriangleMesh {
    let mut points = vec![Vec3::z(), -Vec3::z()];
    let mut triangles = Vec::new();
    let at = |r: usize, s: usize| (2 + r * SIDES + s % SIDES) as u32;
    for r in 0..RINGS {
        let theta = PI * (r + 1) as f64 / (RINGS + 1) as f64;
        for s in 0..SIDES {
            let phi = 2.0 * PI * s as f64 / SIDES as f64;
            points.push(Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()));
        }
    }
    for s in 0..SIDES {
        triangles.extend([[0, at(0, s), at(0, s + 1)], [1, at(RINGS - 1, s + 1), at(RINGS - 1, s)]]);
        for r in 0..RINGS - 1 {
            triangles.extend([[at(r, s), at(r + 1, s), at(r + 1, s + 1)], [at(r, s), at(r + 1, s + 1), at(r, s + 1)]]);
        }
    }
    for p in &mut points {
        let bump = 1.0 + 0.3 * p.x * p.y * p.z;
        *p = Vec3::new(80.0 * p.x * bump + 30.0, 60.0 * p.y * bump - 20.0, 50.0 * p.z * bump + 7.0);
    }
    TriangleMesh { positions: points, triangles }
}

/// The correspondences of the script.
fn targets(points: &[Vec3], step: usize) -> (Vec<Vec3>, Vec<f64>) {
    let target = |p: &Vec3| p + Vec3::from_fn(|a, _| 9.0 * (0.05 * p[(a + 1) % 3] + (a + step) as f64).sin());
    let believed = |i: usize| f64::from(!(7 * i + 3 * step).is_multiple_of(5));
    (points.iter().map(target).collect(), (0..points.len()).map(believed).collect())
}

/// Vertices and energies (stiffness, data, landmarks) after each step.
fn run(reference: &Reference) -> Vec<(Vec<Vec3>, [f64; 3])> {
    let mesh = surface();
    let graph = EdgeGraph::of(&mesh);
    let d = reference.scale;
    let faces = graph.faces_per_edge();
    let weights = graph.lengths(&mesh.positions).into_iter().zip(faces).map(|(l, f)| f64::from(*f) * (d / l).powi(2));
    let model = Affine::new(&mesh, 0.0, 1.0).unwrap();
    let s = model.size();
    let model = Affine::new(&mesh, 0.0, reference.gamma * s / d).unwrap().with_edge_weights(weights.collect());

    let mut problem: Deformation<Affine, Box<dyn DataTerm>> =
        Deformation::new(model, Samples::vertices(mesh.positions.len()));
    let options = Options::gauss_newton().with_max_iterations(1);
    let minimizer = Minimizer::new(options).unwrap();
    let mut workspace = Workspace::new();
    let mut x = problem.model.rest_parameters();
    let at_landmarks: Vec<Vec3> = reference.landmarks.iter().map(|&i| mesh.positions[i]).collect();
    let offset = Vec3::new(2.0, -1.0, 3.0);
    let at_landmarks: Vec<Vec3> = targets(&at_landmarks, 0).0.iter().map(|p| p + offset).collect();
    let mut results = Vec::new();
    for (k, step) in reference.steps.iter().enumerate() {
        let (targets, weights) = targets(&mesh.positions, k);
        let point = PointToPoint { targets, weights, scale: 1.0 };
        let landmarks = Landmarks {
            samples: reference.landmarks.clone(),
            targets: at_landmarks.clone(),
            weights: vec![1.0; at_landmarks.len()],
            scale: step.wl.powi(2),
        };
        problem.terms = vec![
            Box::new(Pointwise::new("data", point, Kernel::None)),
            Box::new(Pointwise::new("landmarks", landmarks, Kernel::None)),
        ];
        problem.model.lambda = (step.ws * d / s).powi(2);
        minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut Silent);
        let energies = problem.energies(&x);
        let of = |name: &str| energies.iter().find(|e| e.0 == name).unwrap().1 / (d * d);
        results.push((problem.vertices(&x).to_vec(), ["affine stiffness", "data", "landmarks"].map(of)));
    }
    results
}

#[test]
fn energies_and_vertices_are_those_of_trimesh_after_every_step() {
    let reference: Reference = serde_json::from_str(include_str!("../references/nricp_trimesh.json")).unwrap();
    assert_eq!(reference.steps.len(), 4);
    let all = run(&reference);
    for (k, (step, (vertices, energies))) in reference.steps.iter().zip(&all).enumerate() {
        let expected = [step.stiffness, step.data, step.landmarks];
        let total: f64 = expected.iter().sum();
        let difference = (energies.iter().sum::<f64>() / total - 1.0).abs();
        let distance =
            vertices.iter().zip(&step.vertices).map(|(v, e)| (v - Vec3::from(*e)).norm()).fold(0.0, f64::max);
        println!(
            "step {k}: {energies:?}, relative difference of E {difference:.1e}, largest distance {distance:.1e} mm"
        );
        assert!(difference < 1e-6, "step {k}: {energies:?}, expected {expected:?}");
        assert!(distance < 1e-6 * reference.scale, "step {k}: {distance} mm");
    }
}
