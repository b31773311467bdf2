//! Conjugate gradients end in the minima of the factorisations, on a hybrid of shapes inside a graph.

use crate::threads::on_threads;
use experiments::generated::{Face, face};
use nonrigid::energy::{Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::model::{Hybrid, NodeGraph, Stiffness};
use nonrigid::nlls::{Kernel, LinearSolverKind, Minimizer, Options, Silent, Summary, Workspace};
use nonrigid::term::PointToPlane;

fn minimum(options: Options, solver: LinearSolverKind, graph_weight: f64, threads: usize) -> (Summary, Vec<f64>) {
    let Face { mesh, shapes, goal } = face(2000, 12, 2.0, 3);
    let nodes = NodeGraph::along_surface(&mesh, 150, 4).unwrap();
    let normals = vertex_normals(&goal, &mesh.triangles, NormalWeighting::Area);
    let (count, stiffness) = (goal.len(), Stiffness { graph: graph_weight, blend: 1.0, ..Stiffness::default() });
    let mut problem = Deformation::new(Hybrid::new(mesh.positions, nodes, shapes, stiffness), Samples::vertices(count));
    let residuals = PointToPlane { targets: goal, normals, weights: vec![1.0; count], scale: 1.0 };
    problem.terms.push(Pointwise::new("point to plane", residuals, Kernel::Huber { delta: 1.0 }));
    let options = options.with_linear_solver(solver).with_max_iterations(200).with_energy_tolerance(1e-12);
    let minimizer = Minimizer::new(options.with_damping_floor(1e-9)).unwrap();
    let mut x = problem.model.rest_parameters();
    let summary = on_threads(threads, || {
        let mut workspace = Workspace::new();
        minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut Silent).clone()
    });
    (summary, x)
}

#[test]
fn the_minimum_is_that_of_the_bordered_factorisation() {
    for options in [Options::gauss_newton(), Options::levenberg_marquardt()] {
        for graph_weight in [100.0, 1.0, 0.07] {
            let (direct, _) = minimum(options, LinearSolverKind::Bordered, graph_weight, 1);
            let (iterated, _) = minimum(options, LinearSolverKind::BlockJacobi, graph_weight, 1);
            assert!(direct.stop.converged() && iterated.stop.converged(), "{direct}\n{iterated}");
            assert_eq!(iterated.linear_solver, "block-Jacobi conjugate gradients");
            assert!(iterated.records.iter().all(|r| r.linear_iterations > 0));
            assert!(direct.records.iter().all(|r| r.linear_iterations == 0));
            let ratio = iterated.final_energy / direct.final_energy;
            assert!((ratio - 1.0).abs() < 1e-8, "graph weight {graph_weight}: {ratio}\n{direct}\n{iterated}");
        }
    }
}

#[test]
fn threads_do_not_change_a_bit_of_a_minimisation() {
    let solve = |threads| minimum(Options::gauss_newton(), LinearSolverKind::BlockJacobi, 1.0, threads).1;
    assert_eq!(solve(1), solve(3));
}
