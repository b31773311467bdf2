//! A whole registration with the default schedule, over the size of the scan.
//!
//! `cargo bench --bench registration`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};
use nonrigid::registration::{ModelKind, RegistrationInput, Silent, register};
use nonrigid::rig::{ShapeBasis, ShapeSelection};
use support::short;

const VERTICES: usize = 2500;

fn shapes(rig: &FaceRig) -> ShapeBasis {
    let selection = ShapeSelection { identity_modes: 20, ..ShapeSelection::default() };
    rig.to_rig().expect("a sound rig").select(selection).expect("so many modes")
}

fn registration(c: &mut Criterion) {
    let rig = FaceRig::generate(&FaceOptions { vertices: VERTICES, identity_modes: 20 });
    let shapes = shapes(&rig);
    let schedule = ModelKind::Hybrid.schedule().expect("comes with the crate");
    let mut group = c.benchmark_group(format!("hybrid registration over scan triangles, {VERTICES} vertices"));
    group.sample_size(10).warm_up_time(Duration::from_millis(1));
    for triangles in [20_000, 80_000, 320_000] {
        let case = simulate_scan(&rig, &ScanOptions { triangles, ..ScanOptions::default() }, 1).expect("seen");
        let landmarks = case.landmark_pairs();
        let input = RegistrationInput {
            shapes: &shapes,
            landmarks: &landmarks,
            ..RegistrationInput::new(&rig.mesh, &case.scan)
        };
        group.bench_function(BenchmarkId::new("triangles", case.scan.triangles.len()), |b| {
            b.iter(|| register(&input, &ModelKind::Hybrid, &schedule, &mut Silent).expect("it succeeds").positions);
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = short(); targets = registration);
criterion_main!(benches);
