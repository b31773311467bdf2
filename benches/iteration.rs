//! One Gauss-Newton iteration of the hybrid, over its size and next to the kernels that it cannot do without.
//!
//! `cargo bench --bench iteration`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::hint::black_box;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, BenchmarkId, Criterion, criterion_group, criterion_main};
use nonrigid::model::Hybrid;
use nonrigid::nlls::dense_kernels::{add_gram, add_outer_products, padded};
use nonrigid::nlls::linear::BorderedCholesky;
use nonrigid::nlls::{Minimizer, NormalEquations, Options, Problem, Silent, Workspace};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};
use support::{Data, Face, NODES, Step, short};

fn threads(count: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(count).build().expect("a pool of threads")
}

/// Linearise, solve, try the step: from the same start each time.
fn one_iteration(
    group: &mut BenchmarkGroup<'_, WallTime>,
    id: BenchmarkId,
    pool: &ThreadPool,
    step: &mut Step<Hybrid>,
) {
    let options = Options::gauss_newton().with_max_iterations(1).with_damping_floor(1e-9);
    let minimizer = Minimizer::new(options).expect("options in bounds");
    let mut workspace = Workspace::new();
    let mut x = Vec::new();
    group.bench_function(id, |b| {
        b.iter(|| {
            let (problem, start) = step.next();
            x.clear();
            x.extend_from_slice(start);
            pool.install(|| minimizer.minimize_with(problem, &mut x, &mut workspace, &mut Silent).final_energy)
        });
    });
}

/// On all cores.
fn iteration(c: &mut Criterion) {
    let pool = threads(0);
    let mut group = c.benchmark_group("iteration over vertices, 400 nodes, 50 shapes");
    for vertices in [1250, 2500, 5000, 10_000, 20_000] {
        let face = Face::of_size(vertices);
        let mut step = face.problem(face.hybrid(NODES, 50), Data::PointToPlane);
        one_iteration(&mut group, BenchmarkId::new("vertices", vertices), &pool, &mut step);
    }
    group.finish();
    let mut group = c.benchmark_group("iteration over shapes, 5000 vertices, 400 nodes");
    let face = Face::of_size(5000);
    for shapes in [0, 25, 50, 100, 200] {
        let mut step = face.problem(face.hybrid(NODES, shapes), Data::PointToPlane);
        one_iteration(&mut group, BenchmarkId::new("shapes", shapes), &pool, &mut step);
    }
    group.finish();
}

/// An iteration, and bare what it cannot do without: the border's rank update, the products of nodes and shapes, factorisation with
/// the forward solve of the border. The iteration over the sum of these three is the price of everything else: data terms,
/// derivatives, the energy of the step. All on one thread.
fn floor(c: &mut Criterion) {
    let pool = threads(1);
    let face = Face::of_size(5000);
    for data in [Data::PointToPlane, Data::PointToPoint] {
        let mut group = c.benchmark_group(format!("floor, {data:?}, 5000 vertices, 400 nodes"));
        for shapes in [10, 50, 100] {
            let mut step = face.problem(face.hybrid(NODES, shapes), data);
            let id = |what: &str| BenchmarkId::new(what, format!("{shapes} shapes"));
            one_iteration(&mut group, id("iteration"), &pool, &mut step);

            let mut rng = ChaCha8Rng::seed_from_u64(9);
            let rows = face.mesh.positions.len() * data.rows();
            let width = padded(shapes);
            let u: Vec<f64> = (0..rows * width).map(|_| rng.random_range(-1.0..1.0)).collect();
            let mut border = vec![0.0; width * width];
            group.bench_function(id("border rank update"), |b| {
                b.iter(|| add_gram([black_box(&u), &u], [width; 2], rows, true, &mut border));
            });

            let gathered = rows_of_nodes(&step, data);
            let longest = gathered.iter().map(Vec::len).max().unwrap_or(0);
            let y: Vec<f64> = (0..longest * padded(6)).map(|_| rng.random_range(-1.0..1.0)).collect();
            let y: Vec<&[f64]> = y.chunks_exact(padded(6)).collect();
            let mut gathered_u: Vec<&[f64]> = Vec::with_capacity(longest);
            let mut cross = vec![0.0; gathered.len() * 6 * shapes];
            group.bench_function(id("gathered cross products"), |b| {
                b.iter(|| {
                    for (rows, out) in black_box(&gathered).iter().zip(cross.chunks_exact_mut(6 * shapes)) {
                        gathered_u.clear();
                        gathered_u.extend(rows.iter().map(|&at| &u[at as usize * width..][..width]));
                        add_outer_products::<6>(&y[..rows.len()], &gathered_u, shapes, out);
                    }
                });
            });

            let mut equations = NormalEquations::new(step.problem.structure().clone());
            let (problem, x) = step.next();
            problem.linearize(x, &mut equations);
            let damping = vec![1e-6; equations.structure().dimension()];
            let mut solver = BorderedCholesky::new(equations.structure());
            group.bench_function(id("factorisation and forward solve"), |b| {
                b.iter(|| {
                    let reduce = || solver.reduce(black_box(&equations), &damping).map(|r| r.gradient[0]);
                    pool.install(reduce).expect("damped")
                });
            });
        }
        group.finish();
    }
}

/// The rows of residuals that each node moves.
fn rows_of_nodes(step: &Step<Hybrid>, data: Data) -> Vec<Vec<u32>> {
    let graph = step.problem.model.graph();
    let mut rows = vec![Vec::new(); graph.nodes().len()];
    for i in 0..graph.vertex_count() {
        for &(j, _) in graph.influences(i) {
            rows[j as usize].extend((0..data.rows()).map(|r| (i * data.rows() + r) as u32));
        }
    }
    rows
}

criterion_group!(name = benches; config = short(); targets = iteration, floor);
criterion_main!(benches);
