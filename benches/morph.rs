//! Blurs, projected masks and the direct morph over sizes.
//!
//! `cargo bench --bench morph`
#![allow(missing_docs)] // of what `criterion_group` makes

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::morph::*;
use nonrigid::render::Projection;

/// A bumpy closed head of about so many vertices.
fn head(vertices: usize) -> TriangleMesh {
    let rows = (vertices as f64 / 2.0).sqrt() as usize;
    let columns = 2 * rows;
    let place = |row: usize, column: usize| {
        let (polar, around) = (row as f64 / (rows - 1) as f64, column as f64 / columns as f64);
        let (s, c) = (std::f64::consts::PI * (0.001 + 0.998 * polar)).sin_cos();
        let (y, x) = (std::f64::consts::TAU * around).sin_cos();
        let bumps = 1.0 + 0.03 * (40.0 * around).sin() * (25.0 * polar).sin();
        Vec3::new(75.0 * s * x, 110.0 * c, 90.0 * s * y) * bumps
    };
    let at = |row: usize, column: usize| (row * columns + column % columns) as u32;
    let cells = (0..rows - 1).flat_map(|row| (0..columns).map(move |column| (row, column)));
    TriangleMesh {
        positions: (0..rows * columns).map(|i| place(i / columns, i % columns)).collect(),
        triangles: cells
            .flat_map(|(r, c)| {
                let (a, b, d, e) = (at(r, c), at(r, c + 1), at(r + 1, c + 1), at(r + 1, c));
                [[a, b, d], [a, d, e]]
            })
            .collect(),
    }
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

fn short() -> Criterion {
    Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .sample_size(10)
}

criterion_group! { name = morph; config = short(); targets = blurs, masks }
criterion_main!(morph);
