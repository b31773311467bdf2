//! The bordered solve, linearisation, and one whole Gauss-Newton iteration.
//!
//! `cargo bench --bench solver`
#![allow(missing_docs)] // of what `criterion_group` makes

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use data_gen::{FaceOptions, FaceRig};
use nonrigid::energy::{Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::Vec3;
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::model::{Hybrid, Linearisation, NodeGraph, Stiffness, hybrid};
use nonrigid::nlls::dense_kernels::{add_outer, rank_update_lower, vectorized};
use nonrigid::nlls::linear::BorderedCholesky;
use nonrigid::nlls::{
    BlockStructure, Kernel, LinearSolverKind, Minimizer, NormalEquations, Options, Problem, Silent, Workspace,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::PointToPlane;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Positive definite equations of 400 blocks of 6 on a 20 x 20 grid, each meeting those up to two steps away.
fn equations(border: usize) -> NormalEquations {
    let side = 20usize;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    // In no order, as farthest-point sampling leaves nodes.
    let mut names: Vec<usize> = (0..side * side).collect();
    names.shuffle(&mut rng);
    let mut pairs = Vec::new();
    for (x, y) in (0..side * side).map(|i| (i % side, i / side)) {
        for (dx, dy) in [(1i64, 0i64), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 1)] {
            let (u, v) = (x as i64 + dx, y as i64 + dy);
            if (0..side as i64).contains(&u) && (0..side as i64).contains(&v) {
                pairs.push((names[y * side + x], names[v as usize * side + u as usize]));
            }
        }
    }
    let structure = Arc::new(BlockStructure::new(&vec![6; side * side], pairs, border).unwrap());
    let mut equations = NormalEquations::new(structure.clone());
    equations.blocks.iter_mut().for_each(|v| *v = rng.random_range(-0.5..0.5));
    equations.cross.iter_mut().for_each(|v| *v = rng.random_range(-0.1..0.1));
    equations.gradient.iter_mut().for_each(|v| *v = rng.random_range(-1.0..1.0));
    for i in 0..structure.block_count() {
        let diagonal = structure.slot(i, i).unwrap();
        for (k, v) in equations.blocks[structure.values(diagonal)].iter_mut().enumerate() {
            *v = if k % 7 == 0 { 60.0 } else { 0.1 };
        }
    }
    for k in 0..border {
        equations.border[k * (border + 1)] = 10.0;
    }
    equations
}

fn bordered_solve(c: &mut Criterion) {
    let mut group = c.benchmark_group("bordered solve, 400 blocks of 6");
    for border in [0, 50, 100] {
        let equations = equations(border);
        let mut solver = LinearSolverKind::Auto.build(equations.structure());
        let mut step = vec![0.0; equations.structure().dimension()];
        group.bench_function(BenchmarkId::new("border", border), |b| {
            b.iter(|| solver.solve(black_box(&equations), &[], &mut step).unwrap());
        });
    }
    group.finish();
}

/// A face under a 400-node hybrid with smooth random shapes, near a target: what a step of a registration solves.
fn face(shapes: usize) -> Deformation<Hybrid, Pointwise<PointToPlane, Kernel, 1>> {
    let rig = FaceRig::generate(&FaceOptions { vertices: 5000, ..FaceOptions::default() });
    let mesh = rig.mesh.triangulate();
    let nodes = NodeGraph::along_surface(&mesh, 400, 4).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut slab = vec![0.0; 3 * mesh.positions.len() * shapes];
    for k in 0..shapes {
        let [frequency, direction] = [0.05, 1.0].map(|s| Vec3::from_fn(|_, _| rng.random_range(-s..s)));
        for (i, p) in mesh.positions.iter().enumerate() {
            for a in 0..3 {
                slab[(3 * i + a) * shapes + k] = (direction[a] * frequency.dot(p).sin()) as f32;
            }
        }
    }
    let names = (0..shapes).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
    let basis = ShapeBasis::new(names, slab);
    let targets: Vec<Vec3> = rig.pose(&[0.5, 0.3], &[1.0, -1.0]);
    let normals = vertex_normals(&targets, &mesh.triangles, NormalWeighting::Area);
    let residuals = PointToPlane { weights: vec![1.0; targets.len()], targets, normals, scale: 1.0 };
    let samples = Samples::vertices(mesh.positions.len());
    let model = hybrid(mesh.positions, nodes, basis, Stiffness { graph: 1.0, blend: 1.0, ..Stiffness::default() });
    let mut problem = Deformation::new(model, samples);
    problem.terms.push(Pointwise::new("point to plane", residuals, Kernel::Huber { delta: 1.0 }));
    problem
}

fn linearisation(c: &mut Criterion) {
    let mut group = c.benchmark_group("linearisation, 5000 vertices, 400 nodes");
    group.sample_size(20);
    for shapes in [10, 50, 100] {
        let mut problem = face(shapes);
        let x = problem.model.rest_parameters();
        let mut equations = NormalEquations::new(problem.structure().clone());
        for (name, kind) in [("structured", Linearisation::Structured), ("reference", Linearisation::Reference)] {
            problem.model.linearisation = kind;
            group.bench_function(BenchmarkId::new(name, format!("{shapes} shapes")), |b| {
                b.iter(|| problem.linearize(black_box(&x), &mut equations));
            });
        }
    }
    group.finish();
}

fn iteration(c: &mut Criterion) {
    let mut group = c.benchmark_group("Gauss-Newton iteration, 5000 vertices, 400 nodes");
    group.sample_size(20);
    let options = Options::gauss_newton().with_max_iterations(1).with_damping_floor(1e-9);
    let minimizer = Minimizer::new(options).unwrap();
    for shapes in [10, 50, 100] {
        let mut problem = face(shapes);
        let start = problem.model.rest_parameters();
        let mut x = start.clone();
        let mut workspace = Workspace::new();
        group.bench_function(BenchmarkId::new("shapes", shapes), |b| {
            b.iter(|| {
                x.copy_from_slice(&start);
                minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut Silent).final_energy
            });
        });
    }
    group.finish();
}

/// What an iteration cannot do without, bare: the border's rank update, the products of nodes and shapes, factorisation with the
/// forward solve of the border. Vertices, nodes and influences are those of [`face`].
fn floor(c: &mut Criterion) {
    const NODES: usize = 400;
    const INFLUENCES: usize = 4;
    let mut group = c.benchmark_group("floor of an iteration, 5000 vertices, 400 nodes");
    group.sample_size(20);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for shapes in [10, 50, 100] {
        let mut problem = face(shapes);
        let rows = problem.samples().len();
        let u: Vec<f64> = (0..rows * shapes).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut border = vec![0.0; shapes * shapes];
        group.bench_function(BenchmarkId::new("rank update", format!("{shapes} shapes")), |b| {
            b.iter(|| rank_update_lower(black_box(&u), rows, shapes, &mut border));
        });
        let y: Vec<[f64; 6]> = (0..rows).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
        let mut cross = vec![0.0; 6 * shapes];
        let of_node = rows * INFLUENCES / NODES / 4 * 4;
        group.bench_function(BenchmarkId::new("cross products", format!("{shapes} shapes")), |b| {
            b.iter(|| {
                vectorized(|| {
                    for node in 0..NODES {
                        for s in (0..of_node).step_by(4) {
                            let at: [usize; 4] = std::array::from_fn(|k| (node * of_node / INFLUENCES + s + k) % rows);
                            add_outer(at.map(|i| &y[i]), at.map(|i| &u[i * shapes..(i + 1) * shapes]), &mut cross);
                        }
                    }
                });
            });
        });
        let x = problem.model.rest_parameters();
        let mut equations = NormalEquations::new(problem.structure().clone());
        problem.linearize(&x, &mut equations);
        let damping = vec![1e-6; equations.structure().dimension()];
        let mut solver = BorderedCholesky::new(equations.structure());
        group.bench_function(BenchmarkId::new("factorisation and forward solve", format!("{shapes} shapes")), |b| {
            b.iter(|| solver.reduce(black_box(&equations), &damping).map(|r| r.gradient[0]).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, bordered_solve, linearisation, iteration, floor);
criterion_main!(benches);
