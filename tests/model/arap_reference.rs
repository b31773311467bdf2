//! As-rigid-as-possible surfaces against libigl's: the same mesh, handles, start and energy, see references/arap_libigl.py.

use nonrigid::energy::{DataTerm, Deformation, Samples};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::model::{Arap, ArapOptions, ArapSolver};
use nonrigid::nlls::{Minimizer, Options, Problem};
use serde_json::Value;

use crate::sheets::sheet;

const SIDE: usize = 32;

fn reference() -> Value {
    serde_json::from_str(include_str!("../references/arap_libigl.json")).expect("a reference in JSON")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn bent() -> TriangleMesh {
    sheet(SIDE, SIDE, |c, r| {
        let x = c - 0.25 * r + 0.2 * (2.1 * c + 4.3 * r).sin();
        let y = r + 0.2 * (3.7 * c - 2.9 * r).sin();
        Vec3::new(x, y, 4.0 * (0.11 * c).sin() + 0.3 * (1.3 * c + 0.4 * r).sin() * (0.9 * r).cos())
    })
}

/// The first row held where it is, the last one turned by 75 degrees and shifted.
fn handles(mesh: &TriangleMesh) -> (Vec<bool>, Vec<Vec3>) {
    let last = SIDE * (SIDE - 1);
    let held = (0..SIDE * SIDE).map(|i| i < SIDE || i >= last).collect();
    let mut places = mesh.positions.clone();
    let centre = places[last..].iter().sum::<Vec3>() / SIDE as f64;
    let turn = nalgebra::Rotation3::from_axis_angle(&Vec3::y_axis(), 75f64.to_radians());
    places[last..].iter_mut().for_each(|p| *p = turn * (*p - centre) + centre + Vec3::new(-6.0, -4.0, 5.0));
    (held, places)
}

fn problem(solver: ArapSolver, clamp: bool) -> Deformation<Arap, Box<dyn DataTerm>> {
    let mesh = bent();
    let (held, places) = handles(&mesh);
    let model = Arap::new(&mesh, ArapOptions { solver, clamp }, 1.0).expect("a sound mesh");
    Deformation::new(model.with_held_at(&held, &places), Samples::vertices(mesh.positions.len()))
}

fn rest(problem: &Deformation<Arap, Box<dyn DataTerm>>) -> Vec<f64> {
    nonrigid::energy::DeformationModel::rest_parameters(&problem.model)
}

#[test]
fn local_global_steps_are_the_papers_alternation() {
    let reference = reference();
    assert!(number(&reference["least_weight"]) < -0.1, "the case should have negative weights");
    let mut problem = problem(ArapSolver::LocalGlobal, false);
    let mut x = rest(&problem);
    approx::assert_relative_eq!(problem.energy(&x), number(&reference["start"]), max_relative = 1e-12);
    let mut steps = 0;
    let mut workspace = nonrigid::nlls::Workspace::new();
    for after in reference["after"].as_array().expect("a list") {
        let until = after["steps"].as_u64().expect("a count");
        let (double, libigl) = (number(&after["double"]), number(&after["libigl"]));
        let minimizer = Minimizer::new(Options::gauss_newton().with_max_iterations(1)).expect("sound options");
        while steps < until {
            let summary = minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut nonrigid::nlls::Silent);
            assert_eq!(summary.records[0].step_scale, 1.0, "a global step was cut short: {summary}");
            steps += 1;
        }
        let energy = problem.energy(&x);
        println!("after {steps}: {energy}, relative difference {:.1e}", energy / double - 1.0);
        approx::assert_relative_eq!(energy, double, max_relative = 1e-9);
        // libigl's rotations are approximate, see the script.
        approx::assert_relative_eq!(energy, libigl, max_relative = 5e-4);
    }
    let mesh = bent();
    let (held, places) = handles(&mesh);
    for (v, p) in problem.vertices(&x).iter().enumerate().filter(|(v, _)| held[*v]) {
        assert_eq!(*p, places[v], "a held vertex must be copied bit for bit");
    }
}

#[test]
fn the_minimum_is_libigls() {
    let expected = number(&reference()["converged"]);
    let mut problem = problem(ArapSolver::Joint, false);
    let mut x = rest(&problem);
    let options = Options::gauss_newton().with_max_iterations(200).with_energy_tolerance(1e-13);
    let summary = Minimizer::new(options).expect("sound options").minimize(&mut problem, &mut x);
    let energy = problem.energy(&x);
    println!("{energy} after {}, libigl {expected}, relative {:.1e}", summary.iterations, energy / expected - 1.0);
    assert!(summary.stop.converged(), "{summary}");
    approx::assert_relative_eq!(energy, expected, max_relative = 1e-6);
}

#[test]
fn joint_steps_need_fewer_iterations_to_the_same_minimum() {
    let run = |solver, iterations| {
        let mut problem = problem(solver, true);
        let mut x = rest(&problem);
        let options = Options::gauss_newton().with_max_iterations(iterations).with_energy_tolerance(0.0);
        let summary = Minimizer::new(options).expect("sound options").minimize(&mut problem, &mut x);
        let energies: Vec<f64> = summary.records.iter().map(|r| r.energy).collect();
        let mut last = summary.initial_energy;
        for energy in &energies {
            assert!(*energy <= last * (1.0 + 1e-14), "{solver:?}: {last} then {energy}");
            last = *energy;
        }
        energies
    };
    let (alternating, joint) = (run(ArapSolver::LocalGlobal, 300), run(ArapSolver::Joint, 60));
    let least = joint[joint.len() - 1].min(alternating[alternating.len() - 1]);
    let within = |energies: &[f64]| energies.iter().position(|e| *e <= 1.001 * least).unwrap_or(energies.len());
    let (slow, fast) = (within(&alternating), within(&joint));
    println!("to 0.1 %: local/global {slow} steps, joint {fast}");
    assert!(fast * 3 < slow, "local/global {slow} steps, joint {fast}");
    approx::assert_relative_eq!(alternating[alternating.len() - 1], joint[joint.len() - 1], max_relative = 0.02);
}
