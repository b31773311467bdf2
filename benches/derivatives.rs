//! Derivatives: the width of dual numbers, the linearisation of every model, the assembly of blendshapes inside a graph.
//!
//! `cargo bench --bench derivatives`
#![allow(missing_docs)] // of what `criterion_group` makes

#[path = "../tests/support/stated_graph.rs"]
mod stated_graph;
mod support;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nonrigid::energy::{DataTerm, DeformationModel, QuadricField};
use nonrigid::model::{
    Affine, Arap, ArapOptions, ArapSolver, EdgeWeights, Free, FreeOptions, Linearisation, Smoothness, blendshape,
    graph, rigid, similarity, sumner,
};
use nonrigid::nlls::{Manifold, NormalEquations, Problem, Se3};
use num_dual::DualSVec64;
use stated_graph::stated_graph;
use support::{Data, Face, NODES, short};

/// Where four nodes take a vertex, eq. (6), by the first `W` of 32 tangent coordinates: six for each node, eight of shapes.
fn moved<const W: usize>(poses: &[[f64; 12]; 4], b: [f64; 3]) -> [DualSVec64<W>; 3] {
    let seed = |k: usize| {
        let zero = DualSVec64::<W>::from_re(0.0);
        if k < W { zero.derivative(k) } else { zero }
    };
    let mut blended = b.map(DualSVec64::from_re);
    for k in 0..8 {
        for (a, b) in blended.iter_mut().enumerate() {
            *b += seed(24 + k) * (0.3 * (k + a) as f64);
        }
    }
    let mut v = [DualSVec64::from_re(0.0); 3];
    for (j, pose) in poses.iter().enumerate() {
        let tangent: [DualSVec64<W>; 6] = std::array::from_fn(|t| seed(6 * j + t));
        let mut moved = [DualSVec64::from_re(0.0); 12];
        Se3::plus(pose, &tangent, &mut moved);
        for (v, m) in v.iter_mut().zip(Se3::transform(&moved, blended)) {
            *v += m * 0.25;
        }
    }
    v
}

fn dual_width(c: &mut Criterion) {
    let poses: [[f64; 12]; 4] = std::array::from_fn(|j| {
        let mut pose = [0.0; 12];
        let tangent: [f64; 6] = std::array::from_fn(|t| (0.7 * (6 * j + t) as f64).sin());
        Se3::plus(&Se3::IDENTITY, &tangent, &mut pose);
        pose
    });
    let mut group = c.benchmark_group("dual width, a vertex moved by four nodes");
    macro_rules! widths {
        ($($width:literal)*) => {$(
            // Per derivative.
            group.throughput(Throughput::Elements($width));
            group.bench_function(BenchmarkId::new("width", $width), |b| {
                b.iter(|| moved::<$width>(black_box(&poses), black_box([3.0, -2.0, 5.0])));
            });
        )*};
    }
    widths!(3 6 12 16 32);
    group.finish();
}

fn models(face: &Face) -> Vec<(&'static str, Box<dyn DeformationModel>)> {
    let (mesh, rest) = (&face.mesh, &face.mesh.positions);
    let nodes = face.graph(NODES);
    let free = |kind| {
        let options = FreeOptions { kind, weights: EdgeWeights::Cotangent, reference_vertices: 5000.0 };
        Box::new(Free::new(mesh, options, 1.0).expect("a sound mesh"))
    };
    let arap = |solver| {
        let options = ArapOptions { solver, clamp: true };
        Box::new(Arap::new(mesh, options, 1.0).expect("a sound mesh"))
    };
    let stated = stated_graph(rest, &nodes, 1.0);
    vec![
        ("rigid", Box::new(rigid(rest.clone()))),
        ("similarity", Box::new(similarity(rest.clone()))),
        ("blendshape", Box::new(blendshape(rest.clone(), face.shapes(50), 1.0))),
        ("graph", Box::new(graph(rest.clone(), nodes.clone(), 1.0))),
        ("sumner", Box::new(sumner(rest.clone(), nodes, 1.0, 0.1))),
        ("hybrid", Box::new(face.hybrid(NODES, 50))),
        ("free, Laplacian", free(Smoothness::Laplacian)),
        ("free, bi-Laplacian", free(Smoothness::BiLaplacian)),
        ("arap, local and global", arap(ArapSolver::LocalGlobal)),
        ("arap, joint", arap(ArapSolver::Joint)),
        ("affine", Box::new(Affine::new(mesh, 1.0, 1.0).expect("a finite mesh"))),
        ("graph as a formula", Box::new(stated)),
    ]
}

/// Every model; those with nodes have 400, those with shapes 50.
fn linearisation(c: &mut Criterion) {
    let mut group = c.benchmark_group("linearisation over vertices");
    group.sample_size(10);
    for vertices in [1250, 5000, 20_000] {
        let face = Face::of_size(vertices);
        for (name, model) in models(&face) {
            let mut step = face.problem(model, Data::PointToPlane);
            let mut equations = NormalEquations::new(step.problem.structure().clone());
            group.bench_function(BenchmarkId::new(name, vertices), |b| {
                b.iter(|| {
                    let (problem, x) = step.next();
                    problem.linearize(black_box(x), &mut equations)
                });
            });
        }
    }
    group.finish();
}

/// Quadrics to normal equations alone, the hybrid's with 400 nodes: structured, and the paper's way.
fn assembly(c: &mut Criterion) {
    for (name, sizes) in [
        ("assembly over vertices, 50 shapes", [1250, 5000, 20_000].map(|vertices| (vertices, 50))),
        ("assembly over shapes, 5000 vertices", [10, 100, 200].map(|shapes| (5000, shapes))),
    ] {
        let mut group = c.benchmark_group(name);
        group.sample_size(10);
        for (vertices, shapes) in sizes {
            let face = Face::of_size(vertices);
            let mut step = face.problem(face.hybrid(NODES, shapes), Data::PointToPlane);
            let mut equations = NormalEquations::new(step.problem.structure().clone());
            let mut field = QuadricField::default();
            field.reset(step.problem.samples().len());
            let positions = face.mesh.positions.clone();
            step.problem.terms[0].linearize(&positions, &mut field);
            for (way, linearisation) in
                [("structured", Linearisation::Structured), ("reference", Linearisation::Reference)]
            {
                step.problem.model.linearisation = linearisation;
                let size = if name.contains("over vertices") { vertices } else { shapes };
                group.bench_function(BenchmarkId::new(way, size), |b| {
                    b.iter(|| {
                        let (problem, x) = step.next();
                        equations.clear();
                        problem.model.pull_back(black_box(x), &field, &mut equations);
                    });
                });
            }
        }
        group.finish();
    }
}

criterion_group!(name = benches; config = short(); targets = dual_width, linearisation, assembly);
criterion_main!(benches);
