//! One Gauss-Newton iteration of the hybrid, over its size and next to the factorisation that it cannot do without.
//!
//! `cargo bench --bench iteration`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::hint::black_box;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, BenchmarkId, Criterion, criterion_group, criterion_main};
use nonrigid::model::Hybrid;
use nonrigid::nlls::linear::BorderedCholesky;
use nonrigid::nlls::{Minimizer, NormalEquations, Options, Problem, Silent, Workspace};
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

/// An iteration, and bare what it cannot do without: factorisation with the forward solve of the border. All on one thread.
fn floor(c: &mut Criterion) {
    let pool = threads(1);
    let face = Face::of_size(5000);
    for data in [Data::PointToPlane, Data::PointToPoint] {
        let mut group = c.benchmark_group(format!("floor, {data:?}, 5000 vertices, 400 nodes"));
        for shapes in [10, 50, 100] {
            let mut step = face.problem(face.hybrid(NODES, shapes), data);
            let id = |what: &str| BenchmarkId::new(what, format!("{shapes} shapes"));
            one_iteration(&mut group, id("iteration"), &pool, &mut step);

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

criterion_group!(name = benches; config = short(); targets = iteration, floor);
criterion_main!(benches);
