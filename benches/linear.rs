//! Linear solvers: factorisation over nodes, the solve of a border over its width.
//!
//! `cargo bench --bench linear`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nonrigid::model::graph;
use nonrigid::nlls::{BlockStructure, LinearSolverKind, NormalEquations, Problem};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{Data, Face, short};

/// Numeric factorisation and one solve of a face's graph; analysis of its pattern alone.
fn factorisation(c: &mut Criterion) {
    let face = Face::of_size(20_000);
    let mut group = c.benchmark_group("factorisation over nodes");
    for nodes in [100, 200, 400, 800, 1600] {
        let model = graph(face.mesh.positions.clone(), face.graph(nodes), 1.0);
        let mut step = face.problem(model, Data::PointToPlane);
        let mut equations = NormalEquations::new(step.problem.structure().clone());
        let (problem, x) = step.next();
        problem.linearize(x, &mut equations);
        let structure = equations.structure().clone();
        let damping = vec![1e-6; structure.dimension()];
        let mut solution = vec![0.0; structure.dimension()];
        let mut solver = LinearSolverKind::Bordered.build(&structure);
        group.bench_function(BenchmarkId::new("factorise and solve", nodes), |b| {
            b.iter(|| solver.solve(black_box(&equations), &damping, &mut solution).expect("damped"));
        });
        group.bench_function(BenchmarkId::new("analyse", nodes), |b| {
            b.iter(|| LinearSolverKind::Bordered.build(black_box(&structure)));
        });
    }
    group.finish();
}

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
    let mut group = c.benchmark_group("bordered solve over the border, 400 blocks of 6");
    for border in [0, 25, 50, 100, 200] {
        let equations = equations(border);
        let mut solver = LinearSolverKind::Bordered.build(equations.structure());
        let mut step = vec![0.0; equations.structure().dimension()];
        group.bench_function(BenchmarkId::new("border", border), |b| {
            b.iter(|| solver.solve(black_box(&equations), &[], &mut step).expect("positive definite"));
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = short(); targets = factorisation, bordered_solve);
criterion_main!(benches);
