//! Blurs, projected masks and the direct morph over sizes.
//!
//! `cargo bench --bench morph`
#![allow(missing_docs)] // of what `criterion_group` makes

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::morph::*;
use nonrigid::registration::ModelKind;
use nonrigid::render::Projection;
use nonrigid::rig::ShapeBasis;

/// A bumpy closed head of about so many vertices, evenly spread: a cube blown up to an ellipsoid.
fn head(vertices: usize) -> TriangleMesh {
    let side = (vertices as f64 / 6.0).sqrt() as usize;
    let mut mesh = TriangleMesh::default();
    for face in 0..6 {
        let first = mesh.positions.len();
        for (row, column) in (0..side * side).map(|i| (i / side, i % side)) {
            // Equal angles, so that cells are of about one size.
            let t = |k: usize| (std::f64::consts::FRAC_PI_4 * (2.0 * k as f64 / (side - 1) as f64 - 1.0)).tan();
            let sign = if face < 3 { 1.0 } else { -1.0 };
            let mut p = Vec3::repeat(sign);
            (p[(face + 1) % 3], p[(face + 2) % 3]) = (sign * t(column), t(row));
            let p = p.normalize();
            let bumps = 1.0 + 0.02 * (20.0 * p.x).sin() * (25.0 * p.y).sin() * (15.0 * p.z).cos();
            mesh.positions.push(p.component_mul(&Vec3::new(75.0, 110.0, 90.0)) * bumps);
        }
        for (row, column) in (0..(side - 1) * (side - 1)).map(|i| (i / (side - 1), i % (side - 1))) {
            let corner = |r: usize, c: usize| (first + (row + r) * side + column + c) as u32;
            let (a, b, c, d) = (corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

fn disc(size: usize) -> Texture {
    let half = size as f64 / 2.0;
    let circle = Shape::Circle { centre: [half, half], radius: 0.6 * half };
    Region::from(circle).rasterize(size, size, Coordinates::Pixels).unwrap()
}

/// Every pixel another value: the hardest for medians.
fn noise(size: usize) -> Texture {
    let grey = (0..(size * size) as u64).map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 48) as f64 / 65535.0);
    Texture::new(size, size, grey.collect()).unwrap()
}

fn blurs(c: &mut Criterion) {
    let mut group = c.benchmark_group("40 blurs");
    for size in [256, 512, 1024] {
        group.bench_function(BenchmarkId::new("region", size), |b| b.iter(|| disc(black_box(size))));
        let (disc, noise) = (disc(size), noise(size));
        for (name, kind, kernel, texture) in [
            ("mean 13", BlurKind::Mean, 13, &disc),
            ("mean 101", BlurKind::Mean, 101, &disc),
            ("Gaussian 13", BlurKind::Gaussian { sigma: None }, 13, &disc),
            ("median 13", BlurKind::Median, 13, &disc),
            ("median 13 of noise", BlurKind::Median, 13, &noise),
        ] {
            let blur = Blur { kind, kernel, iterations: 40, border: Border::Replicate };
            group.bench_function(BenchmarkId::new(name, size), |b| b.iter(|| blur.apply(black_box(texture)).unwrap()));
        }
    }
    group.finish();
}

fn masks(c: &mut Criterion) {
    let texture = Blur::default().apply(&disc(1024)).unwrap();
    let perspective = Projection::Perspective { vertical_fov: 20.0 };
    let projector = Projector::look(Vec3::new(100.0, 40.0, 700.0), Vec3::zeros(), Vec3::y(), perspective, 1.0).unwrap();
    let mut group = c.benchmark_group("masks");
    for vertices in [10_000, 100_000, 1_000_000] {
        let mesh = head(vertices);
        let size = mesh.positions.len();
        for (name, visibility) in [("through", Visibility::Through), ("visible", Visibility::default())] {
            group.bench_function(BenchmarkId::new(name, size), |b| {
                b.iter(|| projector.weights(black_box(&mesh), &texture, Sampling::Bilinear, visibility).unwrap());
            });
        }
        group.bench_function(BenchmarkId::new("visible everywhere", size), |b| {
            b.iter(|| projector.visible(black_box(&mesh), 0.001).unwrap());
        });
        let weights = projector.weights(&mesh, &texture, Sampling::Bilinear, Visibility::Through).unwrap();
        let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.0, 1.0, 3.0) }];
        let step = MorphStep { pairs, ..MorphStep::default() };
        let mut moved = mesh.positions.clone();
        group.bench_function(BenchmarkId::new("copy", size), |b| {
            b.iter(|| black_box(&mut moved).copy_from_slice(black_box(&mesh.positions)));
        });
        group.bench_function(BenchmarkId::new("morph", size), |b| {
            b.iter(|| step.apply_into(black_box(&mesh.positions), black_box(&mut moved)).unwrap());
        });
    }
    group.finish();
}

/// A handle that is dragged a tenth of a millimetre to and fro: 10,000 vertices move, to a relative change of the energy of 1e-4.
fn dragged(c: &mut Criterion) {
    let mesh = head(40_000);
    let texture = Blur::default().apply(&disc(512)).unwrap();
    let camera = Projection::Orthographic { height: 200.0 };
    let projector = Projector::look(Vec3::new(0.0, 0.0, 700.0), Vec3::zeros(), Vec3::y(), camera, 1.0).unwrap();
    let weights = projector.weights(&mesh, &texture, Sampling::Bilinear, Visibility::default()).unwrap();
    let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.0, 1.0, 3.0) }];
    let step = MorphStep { pairs, ..MorphStep::default() };
    let mut group = c.benchmark_group("dragged handle");
    for model in
        [MorphModel::Energy(ModelKind::Free), MorphModel::Energy(ModelKind::Arap), MorphModel::Energy(ModelKind::Graph)]
    {
        let (none, options) = (Constraints::default(), EnergyOptions { tolerance: 1e-4, ..EnergyOptions::default() });
        let shapes = ShapeBasis::none();
        let mut energy = MorphEnergy::new(&mesh, &step, &none, model, &shapes, &options).unwrap();
        let (_, report) = energy.solve().unwrap();
        let mut far = false;
        group.bench_function(BenchmarkId::new(model.name(), report.moving), |b| {
            b.iter(|| {
                far = !far;
                let displacement = Vec3::new(0.0, 1.0, if far { 3.1 } else { 3.0 });
                energy.set_displacement(0, displacement).unwrap();
                black_box(energy.solve().unwrap())
            });
        });
    }
    group.finish();
}

fn short() -> Criterion {
    Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .sample_size(10)
}

criterion_group! { name = morph; config = short(); targets = blurs, masks, dragged }
criterion_main!(morph);
