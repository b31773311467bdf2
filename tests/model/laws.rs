//! Laws that every deformation model obeys: those that come with the crate, and those stated as a formula.

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3};
use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::model::{AffineMotion, Hybrid, graph, graph_of, sumner};
use nonrigid::model::{
    AngleAxisMotion, Autodiff, AutodiffError, NodeGraph, NodeTransform, PositionFunction, QuaternionMotion,
    RigidMotion, Stiffness, Sumner,
};
use nonrigid::nlls::{Euclidean, Kernel, LinearSolverKind, Minimizer, NormalEquations, Options, Problem, Scalar};
use nonrigid::rig::ShapeBasis;
use nonrigid::term::PointToPoint;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::sheets::sheet;
use crate::stated_graph::stated_graph;
use crate::threads::on_threads;
use crate::zoo::{Swirl, Zoo, random_step, terms};

#[test]
fn a_graph_stated_as_a_formula_is_the_graph() {
    let zoo = Zoo::small();
    let (rest, nodes) = (&zoo.mesh.positions, &zoo.nodes);
    let start = random_step(&mut ChaCha8Rng::seed_from_u64(4), 6 * nodes.nodes().len());
    fn run<M: DeformationModel>(model: M, zoo: &Zoo, start: &[f64]) -> (Vec<(String, f64)>, NormalEquations, Vec<f64>) {
        let mut problem = Deformation::new(model, zoo.samples());
        let kernel = Kernel::GemanMcClure { delta: 2.0 };
        problem.terms = terms(&mut ChaCha8Rng::seed_from_u64(5), &zoo.resting(), kernel);
        let x0 = problem.model.rest_parameters();
        let mut x = x0.clone();
        problem.retract(&x0, start, &mut x);
        let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
        problem.linearize(&x, &mut equations);
        let energies = problem.energies(&x);
        let step = Options::gauss_newton().with_max_iterations(1);
        Minimizer::new(step).unwrap().minimize(&mut problem, &mut x);
        (energies, equations, x)
    }
    let (stated, built) = (stated_graph(rest, nodes, 0.7), graph(rest.clone(), nodes.clone(), 0.7));
    let (energies, equations, x) = run(stated, &zoo, &start);
    let (expected_energies, expected, expected_x) = run(built, &zoo, &start);
    assert_eq!(energies.len(), expected_energies.len());
    for ((name, found), (_, expected)) in energies.iter().zip(&expected_energies) {
        approx::assert_relative_eq!(*found, *expected, max_relative = 1e-13);
        assert!(*expected > 0.0, "{name}");
    }
    let largest = expected.to_dense().amax();
    assert!((equations.to_dense() - expected.to_dense()).amax() < 1e-13 * largest);
    let largest = expected.gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    for (found, expected) in equations.gradient.iter().zip(&expected.gradient) {
        assert!((found - expected).abs() < 1e-12 * largest);
    }
    for (found, expected) in x.iter().zip(&expected_x) {
        approx::assert_abs_diff_eq!(*found, *expected, epsilon = 1e-9);
    }
}

#[test]
fn a_block_of_nobodys_stays_where_it_is() {
    let zoo = Zoo::small();
    let swirl = Autodiff::new(Swirl { rest: zoo.mesh.positions.clone() }).unwrap();
    let mut problem = Deformation::new(swirl, zoo.samples());
    problem.terms = terms(&mut ChaCha8Rng::seed_from_u64(5), &zoo.resting(), Kernel::None);
    let mut x = problem.model.rest_parameters();
    let own = x.len() - 2..x.len();
    x[own.clone()].copy_from_slice(&[0.25, -0.5]);
    let before = problem.energy(&x);
    let options = Options::gauss_newton().with_damping_floor(1e-9).with_max_iterations(3);
    let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
    assert!(summary.final_energy < 0.95 * before, "{summary}");
    assert_eq!(x[own], [0.25, -0.5]);
    assert_eq!(summary.unobserved_directions(), 2, "{summary}");
}

#[test]
fn a_block_that_does_not_exist_is_named() {
    struct Wrong;
    impl PositionFunction for Wrong {
        type Block = Euclidean<1>;

        fn name(&self) -> &'static str {
            "wrong"
        }

        fn rest_blocks(&self) -> Vec<[f64; 1]> {
            vec![[0.0]; 5]
        }

        fn vertex_blocks(&self) -> Vec<Vec<usize>> {
            (0..9).map(|vertex| vec![0, vertex]).collect()
        }

        fn position<D: Scalar>(&self, _: usize, p: &[[D; 1]]) -> [D; 3] {
            [p[0][0]; 3]
        }
    }
    let error = Autodiff::new(Wrong).err().unwrap();
    let AutodiffError::BlockOutOfRange { index, block, blocks, .. } = error;
    assert_eq!((index, block, blocks), (5, 5, 5));
    assert_eq!(error.to_string(), "wrong: vertex 5 names block 5, but there are 5 blocks");
}

/// The numbers of a rotation.
type Parametrisation = fn(&Rotation3<f64>) -> Vec<f64>;

fn matrix(rotation: &Rotation3<f64>) -> Vec<f64> {
    rotation.matrix().transpose().as_slice().to_vec()
}

fn quaternion(rotation: &Rotation3<f64>) -> Vec<f64> {
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(rotation);
    vec![q.w, q.i, q.j, q.k]
}

fn rotation_vector(rotation: &Rotation3<f64>) -> Vec<f64> {
    nalgebra::UnitQuaternion::from_rotation_matrix(rotation).scaled_axis().as_slice().to_vec()
}

/// Parameters of nodes at `centres` that all move as `p -> rotation p + shift`.
fn moved_nodes(
    rest: &[f64],
    centres: &[Vec3],
    by: Parametrisation,
    rotation: &Rotation3<f64>,
    shift: Vec3,
) -> Vec<f64> {
    let mut x = rest.to_vec();
    let turned = by(rotation);
    for (node, centre) in x.chunks_exact_mut(turned.len() + 3).zip(centres) {
        let (r, t) = node.split_at_mut(turned.len());
        r.copy_from_slice(&turned);
        t.copy_from_slice((rotation * centre + shift - centre).as_slice());
    }
    x
}

#[test]
fn a_rigid_motion_costs_nothing_and_moves_every_vertex_rigidly() {
    let zoo = Zoo::small();
    let (rest, nodes, basis) = (zoo.mesh.positions.clone(), zoo.nodes.clone(), zoo.basis.clone());
    let centres = nodes.nodes().to_vec();
    let stiffness = Stiffness { graph: 5.0, rotation: 5.0, blend: 5.0, ..Stiffness::default() };
    let shift = Vec3::new(30.0, -80.0, 12.0);
    let half_turn = Rotation3::from_axis_angle(&nalgebra::Unit::new_normalize(Vec3::new(0.3, -1.0, 0.6)), PI);
    let parts = ["graph smoothness (7)", "node rotation (Sumner)", "blendshape prior (5)"];
    let by_quaternion =
        Hybrid::<QuaternionMotion, 6>::with_motion(rest.clone(), nodes.clone(), basis.clone(), stiffness);
    let by_vector = Hybrid::<AngleAxisMotion, 6>::with_motion(rest.clone(), nodes.clone(), basis.clone(), stiffness);
    let models: [(Box<dyn DeformationModel>, Parametrisation, &[&str]); 5] = [
        (Box::new(Hybrid::new(rest.clone(), nodes.clone(), basis.clone(), stiffness)), matrix, &[parts[0], parts[2]]),
        (Box::new(by_quaternion), quaternion, &[parts[0], parts[2]]),
        (Box::new(by_vector), rotation_vector, &[parts[0], parts[2]]),
        (
            Box::new(Hybrid::<AffineMotion, 12>::with_motion(rest.clone(), nodes.clone(), basis, stiffness)),
            matrix,
            &parts,
        ),
        (Box::new(sumner(rest.clone(), nodes, 5.0, 5.0)), matrix, &parts[..2]),
    ];
    for (model, by, parts) in models {
        let mut problem: Deformation<_, Box<dyn DataTerm>> = Deformation::new(model, zoo.samples());
        for rotation in [Rotation3::from_euler_angles(0.4, -2.0, 1.1), half_turn] {
            let x = moved_nodes(&problem.model.rest_parameters(), &centres, by, &rotation, shift);
            let energies = problem.energies(&x);
            assert_eq!(energies.iter().map(|e| e.0.as_str()).collect::<Vec<_>>(), parts);
            // Squares of rounding errors, E_rot's times 5 * 5 * reach^2.
            assert!(energies.iter().all(|e| e.1 < 1e-21), "{energies:?}");
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            problem.linearize(&x, &mut equations);
            let scale = equations.to_dense().amax();
            assert!(equations.gradient.iter().all(|g| g.abs() < 1e-12 * scale), "{:?}", equations.gradient);
            for (v, n) in problem.vertices(&x).iter().zip(&rest) {
                approx::assert_abs_diff_eq!(*v, rotation * n + shift, epsilon = 1e-11);
            }
        }
    }
}

#[test]
fn the_graph_is_stiffer_where_more_is_unseen_and_gives_way_by_its_kernel_and_its_derivatives_follow() {
    let zoo = Zoo::small();
    let count = zoo.vertex_count();
    let mut energies = Vec::new();
    for kernel in [Kernel::None, Kernel::Cauchy { delta: 0.5 }] {
        let stiffness = Stiffness { graph: 5.0, kernel, ..Stiffness::default() };
        let model = Hybrid::new(zoo.mesh.positions.clone(), zoo.nodes.clone(), zoo.basis.clone(), stiffness);
        let mut problem: Deformation<_, Box<dyn DataTerm>> = Deformation::new(model, zoo.samples());
        let rest = problem.model.rest_parameters();
        let tangent = random_step(&mut ChaCha8Rng::seed_from_u64(5), problem.structure().dimension());
        let mut x = rest.clone();
        problem.retract(&rest, &tangent, &mut x);
        let mut energy = |unseen: f64, factor: f64| {
            problem.model.stiffen_unseen(&vec![unseen; count], factor);
            problem.energies(&x)[0].1
        };
        let plain = energy(0.0, 100.0);
        assert!(plain > 0.1);
        for (unseen, factor, times) in [(1.0, 1.0, 1.0), (1.0, 100.0, 100.0), (0.5, 100.0, 10.0), (0.0, 7.0, 1.0)] {
            approx::assert_relative_eq!(energy(unseen, factor), times * plain, max_relative = 1e-12);
        }
        energies.push(plain);
        let some: Vec<f64> = (0..count).map(|i| f64::from(u8::from(i % 3 == 0 || 2 * i > count))).collect();
        problem.model.stiffen_unseen(&some, 30.0);
        let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
        problem.linearize(&x, &mut equations);
        for k in 0..tangent.len() {
            let mut at = |h: f64| {
                let (mut step, mut moved) = (vec![0.0; tangent.len()], x.clone());
                step[k] = h;
                problem.retract(&x, &step, &mut moved);
                problem.energy(&moved)
            };
            let slope = (at(1e-5) - at(-1e-5)) / 4e-5;
            approx::assert_relative_eq!(equations.gradient[k], slope, max_relative = 1e-6, epsilon = 1e-5);
        }
    }
    assert!(energies[1] < 0.9 * energies[0], "{energies:?}");
}

/// Two stiff halves, one of which is turned by a right angle about the line between them. Least squares spread the bend.
#[test]
fn a_graph_with_a_kernel_bends_at_a_joint() {
    let mesh = sheet(4, 40, |r, c| Vec3::new(c, r, 0.0));
    let rest = mesh.positions.clone();
    let bent = |p: &Vec3| if p.x > 20.0 { Vec3::new(20.0, p.y, p.x - 20.0) } else { *p };
    let places: Vec<Vec3> = rest.iter().map(bent).collect();
    let far = |kernel: Kernel| {
        let nodes = NodeGraph::along_surface(&mesh, 20, 4).unwrap();
        let stiffness = Stiffness { graph: 10.0, kernel, ..Stiffness::default() };
        let model = Hybrid::new(rest.clone(), nodes, ShapeBasis::none(), stiffness);
        let mut problem = Deformation::new(model, Samples::vertices(rest.len()));
        let targets = PointToPoint { targets: places.clone(), weights: vec![1.0; rest.len()], scale: 0.1 };
        problem.terms = vec![Pointwise::new("places", targets, Kernel::None)];
        let mut x = problem.model.rest_parameters();
        let options = Options::gauss_newton().with_max_iterations(50).with_damping_floor(1e-9);
        Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
        let squares = problem.vertices(&x).iter().zip(&places).map(|(v, p)| (v - p).norm_squared());
        (squares.sum::<f64>() / rest.len() as f64).sqrt()
    };
    let (spread, joint) = (far(Kernel::None), far(Kernel::Cauchy { delta: 0.2 }));
    assert!(spread > 0.5 && joint < 0.4 * spread, "{spread} mm without, {joint} mm with");
}

/// What Gauss-Newton does from nodes all turned by `start`: energy and vertices after each step.
fn steps_with<T: NodeTransform<6>>(
    zoo: &Zoo,
    shapes: bool,
    by: Parametrisation,
    start: &Rotation3<f64>,
) -> Vec<(f64, Vec<Vec3>)> {
    let (rest, nodes) = (zoo.mesh.positions.clone(), zoo.nodes.clone());
    let model = if shapes {
        Hybrid::<T, 6>::with_motion(rest, nodes, zoo.basis.clone(), zoo.stiffness)
    } else {
        graph_of::<T, 6>(rest, nodes, 0.7)
    };
    let mut problem = Deformation::new(model, zoo.samples());
    let further = Rotation3::from_euler_angles(0.3, -0.2, 0.4);
    let places: Vec<Vec3> = zoo.resting().iter().map(|p| further * start * p).collect();
    problem.terms = terms(&mut ChaCha8Rng::seed_from_u64(7), &places, Kernel::Huber { delta: 1.0 });
    let centres = problem.model.graph().nodes().to_vec();
    let mut x = moved_nodes(&problem.model.rest_parameters(), &centres, by, start, Vec3::zeros());
    let minimizer = Minimizer::new(Options::gauss_newton().with_max_iterations(1).with_damping_floor(1e-9)).unwrap();
    let step = |_| {
        let energy = minimizer.minimize(&mut problem, &mut x).final_energy;
        (energy, problem.vertices(&x).to_vec())
    };
    (0..40).map(step).collect()
}

#[test]
fn quaternions_take_the_steps_of_matrices_and_rotation_vectors_arrive_where_they_do() {
    let zoo = Zoo::small();
    let apart = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    for shapes in [false, true] {
        for start in [Rotation3::identity(), Rotation3::from_euler_angles(0.4, -1.5, 1.1)] {
            let by_matrix = steps_with::<RigidMotion>(&zoo, shapes, matrix, &start);
            let by_quaternion = steps_with::<QuaternionMotion>(&zoo, shapes, quaternion, &start);
            let by_vector = steps_with::<AngleAxisMotion>(&zoo, shapes, rotation_vector, &start);
            let worst = by_matrix.iter().zip(&by_quaternion).map(|(a, b)| apart(&a.1, &b.1)).fold(0.0, f64::max);
            let [first, last] = [0, 39].map(|k| [by_matrix[k].0, by_vector[k].0]);
            let (energy, distance) = ((last[0] - last[1]).abs() / last[0], apart(&by_matrix[39].1, &by_vector[39].1));
            println!(
                "shapes {shapes}: quaternions {worst:e}; vectors {first:?} to {last:?}, {energy:e}, {distance:e} mm"
            );
            // Derivatives by shapes are rounded to f32, which tells numbers apart that differ in their last bit.
            let (distances, energies) = if shapes { (1e-6, 1e-9) } else { (1e-9, 1e-11) };
            assert!(worst < distances, "{worst:e}");
            for ((a, _), (b, _)) in by_matrix.iter().zip(&by_quaternion) {
                assert!((a - b).abs() < energies * a, "{a} {b}");
            }
            assert!(energy < 1e-10 && distance < 1e-5, "{energy:e} {distance:e}");
        }
    }
    // From elsewhere than the identity, where all derivatives are alike, the steps are others.
    let turn = Rotation3::from_euler_angles(0.4, -1.5, 1.1);
    let [a, b] = [
        steps_with::<RigidMotion>(&zoo, false, matrix, &turn),
        steps_with::<AngleAxisMotion>(&zoo, false, rotation_vector, &turn),
    ];
    assert!(apart(&a[0].1, &b[0].1) > 1e-6);
}

#[test]
fn the_rotation_energy_of_an_affine_map_is_sumners() {
    // One node on two vertices one millimetre away: reach 1. Columns (1, 2, 0), (0, 1, 0), (0, 0, 3):
    // (c1.c2)^2 = 4, (c1.c1 - 1)^2 = 16, (c3.c3 - 1)^2 = 64.
    let rest = vec![Vec3::x(), -Vec3::y()];
    let mut model = sumner(rest, NodeGraph::single(Vec3::zeros(), 2), 0.5, 3.0);
    let mut energies = Vec::new();
    model.regulariser_energy(&[1.0, 0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 3.0, 7.0, 8.0, 9.0], &mut energies);
    assert_eq!(energies, [("node rotation (Sumner)", 0.5 * 3.0 * (4.0 + 16.0 + 64.0))]);
}

/// A sheet of 9 x 9 vertices at spacing `unit`.
fn small_sheet(unit: f64) -> TriangleMesh {
    sheet(9, 9, |c, r| Vec3::new(c, r, 0.1 * ((9.0 * r + c) % 4.0)) * unit)
}

/// The graph with affine nodes, all turned by `start`, pulled towards `targets`, until nothing changes.
fn pulled(
    mesh: &TriangleMesh,
    nodes: NodeGraph,
    targets: Vec<Vec3>,
    rotation: f64,
    start: &Rotation3<f64>,
) -> (Sumner, Vec<f64>) {
    let count = mesh.positions.len();
    let mut problem = Deformation::new(sumner(mesh.positions.clone(), nodes, 0.5, rotation), Samples::vertices(count));
    let residuals = PointToPoint { targets, weights: vec![1.0; count], scale: 1.0 };
    problem.terms.push(Pointwise::new("point", residuals, Kernel::None));
    let centres = problem.model.graph().nodes().to_vec();
    let mut x = moved_nodes(&problem.model.rest_parameters(), &centres, matrix, start, Vec3::zeros());
    let options = Options::levenberg_marquardt().with_max_iterations(200).with_damping_floor(1e-9);
    let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
    assert!(summary.final_energy.is_finite() && summary.final_energy <= summary.initial_energy, "{summary}");
    (problem.model, x)
}

/// Largest `|A'A - I|` of any node.
fn farthest_from_rotation(x: &[f64]) -> f64 {
    let of = |node: &[f64]| {
        let a = Matrix3::from_row_slice(&node[..9]);
        (a.transpose() * a - Matrix3::identity()).amax()
    };
    x.chunks_exact(12).map(of).fold(0.0, f64::max)
}

#[test]
fn affine_nodes_prefer_rotations_the_more_the_weightier_and_in_any_unit() {
    let stretch = |p: &Vec3| Vec3::new(1.3 * p.x + 0.2 * p.y, p.y, p.z);
    let mut found: Vec<[f64; 2]> = Vec::new();
    for rotation in [0.0, 0.1, 1.0, 100.0] {
        let distance = |unit: f64| {
            let mesh = small_sheet(unit);
            let nodes = NodeGraph::along_surface(&mesh, 12, 3).unwrap();
            let targets = mesh.positions.iter().map(stretch).collect();
            farthest_from_rotation(&pulled(&mesh, nodes, targets, rotation, &Rotation3::identity()).1)
        };
        found.push([1.0, 1.0 / 1024.0].map(distance));
    }
    println!("{found:?}");
    for pair in found.windows(2) {
        assert!(pair[1][0] < pair[0][0], "{found:?}");
    }
    // Without the energy the stretch is followed; with most of it, hardly.
    assert!(found[0][0] > 0.6 && found[3][0] < 0.05, "{found:?}");
    assert!(found.iter().all(|[large, small]| (large - small).abs() < 1e-6), "{found:?}");
}

#[test]
fn affine_nodes_stand_alone_coincide_and_turn_by_pi() {
    let mesh = small_sheet(1.0);
    let half_turn = Rotation3::from_axis_angle(&Vec3::y_axis(), PI);
    let further = Rotation3::from_euler_angles(0.3, -0.2, 0.4);
    let place = |p: &Vec3| further * half_turn * p + Vec3::new(1.0, 2.0, 3.0);
    let targets: Vec<Vec3> = mesh.positions.iter().map(place).collect();
    let coincident = {
        let nodes = vec![mesh.positions[40]; 3];
        let influences =
            (0..81).map(|i| (0..3).map(|j| (j, [0.2, 0.3, 0.5][(i + j as usize) % 3])).collect::<Vec<_>>());
        NodeGraph::from_influences(nodes, influences)
    };
    let graphs =
        [NodeGraph::along_surface(&mesh, 1, 4).unwrap(), coincident, NodeGraph::along_surface(&mesh, 12, 3).unwrap()];
    for graph in graphs {
        let nodes = graph.nodes().len();
        let (mut model, x) = pulled(&mesh, graph, targets.clone(), 0.1, &half_turn);
        let mut moved = Vec::new();
        model.positions(&x, &mut moved);
        let distance = moved.iter().zip(&targets).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        println!("{nodes} nodes: {distance} {}", farthest_from_rotation(&x));
        assert!(distance < 1e-6, "{nodes} nodes: {distance}");
        assert!(farthest_from_rotation(&x) < 1e-6, "{nodes} nodes: {x:?}");
    }
    // All vertices in one point: nothing to be weighed by, and nothing breaks.
    let point = TriangleMesh { positions: vec![Vec3::x(); 81], ..mesh };
    let graph = NodeGraph::along_surface(&point, 4, 3).unwrap();
    let (mut model, x) = pulled(&point, graph, vec![Vec3::y(); 81], 1.0, &Rotation3::identity());
    let mut moved = Vec::new();
    model.positions(&x, &mut moved);
    assert!(moved.iter().all(|p| (p - Vec3::y()).norm() < 1e-6), "{moved:?}");
}

#[test]
fn an_affine_map_of_the_whole_template_costs_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let zoo = Zoo::small();
    let (rest, mut model) = (&zoo.mesh.positions, zoo.affine());
    let linear = nalgebra::Matrix3::from_fn(|_, _| rng.random_range(-2.0..2.0));
    let shift = Vec3::new(30.0, -80.0, 12.0);
    let mut x = model.rest_parameters();
    for rows in x.chunks_exact_mut(12) {
        let old = nalgebra::Matrix3x4::from_row_slice(rows);
        let mut new = linear * old;
        let mut translation = new.column_mut(3);
        translation += shift;
        rows.copy_from_slice(new.transpose().as_slice());
    }
    let (mut energies, mut moved) = (Vec::new(), Vec::new());
    model.regulariser_energy(&x, &mut energies);
    assert_eq!(energies, [("affine stiffness", 0.0)]);
    model.positions(&x, &mut moved);
    for (v, n) in moved.iter().zip(rest) {
        approx::assert_abs_diff_eq!(*v, linear * n + shift, epsilon = 1e-11);
    }
    // One map that differs does cost.
    x[12] += 0.5;
    energies.clear();
    model.regulariser_energy(&x, &mut energies);
    assert!(energies[0].1 > 0.1, "{energies:?}");
}

#[test]
fn affine_maps_reach_the_same_minimum_whatever_solves_the_equations() {
    let zoo = Zoo::small();
    let solve = |solver: LinearSolverKind, threads: usize| {
        let mut problem = Deformation::new(zoo.affine(), zoo.samples());
        problem.terms = terms(&mut ChaCha8Rng::seed_from_u64(6), &zoo.resting(), Kernel::Huber { delta: 1.0 });
        let mut x = problem.model.rest_parameters();
        let minimizer = Minimizer::new(Options::gauss_newton().with_linear_solver(solver)).expect("options in bounds");
        let summary = on_threads(threads, || minimizer.minimize(&mut problem, &mut x));
        assert!(summary.stop.converged(), "{summary}");
        (problem.vertices(&x).to_vec(), summary.linear_solver)
    };
    let (direct, name) = solve(LinearSolverKind::Auto, 1);
    assert_eq!(name, "sparse Cholesky");
    let (iterated, _) = solve(LinearSolverKind::BlockJacobi, 1);
    for (a, b) in iterated.iter().zip(&direct) {
        assert!((a - b).norm() < 1e-6, "{a} {b}");
    }
    assert!(iterated == solve(LinearSolverKind::BlockJacobi, 2).0, "other bits at two threads");
}
