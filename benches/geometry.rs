//! Closest points, self-intersections, distances along surfaces, and reading of files, on a generated face and a scan of it.
//!
//! `cargo bench --bench geometry`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use data_gen::{FaceOptions, FaceRig, ScanCase, ScanOptions, simulate_scan};
use nonrigid::evaluation::self_intersections;
use nonrigid::mesh::Vec3;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::geodesic::{WeightedGraph, farthest_point_sampling, nearest_sources, share_nodes};
use nonrigid::mesh::io::{PlyOptions, read_obj, read_ply, write_obj, write_ply};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals_into};
use support::short;

fn face() -> (FaceRig, ScanCase) {
    let rig = FaceRig::generate(&FaceOptions { vertices: 5000, ..FaceOptions::default() });
    let case = simulate_scan(&rig, &ScanOptions::default(), 1).unwrap();
    (rig, case)
}

fn closest_point(c: &mut Criterion) {
    let (rig, _) = face();
    let mut group = c.benchmark_group("closest points of 5000 over triangles");
    for triangles in [20_000, 80_000, 320_000] {
        let case = simulate_scan(&rig, &ScanOptions { triangles, ..ScanOptions::default() }, 1).unwrap();
        let (queries, size) = (case.truth, case.scan.triangles.len());
        group.bench_function(BenchmarkId::new("build", size), |b| {
            b.iter(|| ClosestPoint::new(black_box(&case.scan)).unwrap());
        });
        let tree = ClosestPoint::new(&case.scan).unwrap();
        let hints: Vec<u32> = queries.iter().map(|p| tree.query(p).unwrap().triangle).collect();
        group.bench_function(BenchmarkId::new("without hint", size), |b| {
            b.iter(|| queries.iter().map(|p| tree.query(p).unwrap().squared_distance).sum::<f64>());
        });
        for (name, offset) in [("with hint", Vec3::zeros()), ("with hint, moved 2 mm", Vec3::new(0.5, -1.0, 1.7))] {
            let query = |(p, &hint): (&Vec3, &u32)| tree.query_from(&(p + offset), hint).unwrap().squared_distance;
            group.bench_function(BenchmarkId::new(name, size), |b| {
                b.iter(|| queries.iter().zip(&hints).map(query).sum::<f64>());
            });
        }
    }
    group.finish();
}

fn self_intersection(c: &mut Criterion) {
    let rig = FaceRig::generate(&FaceOptions { vertices: 51_000, ..FaceOptions::default() });
    let mesh = rig.mesh.triangulate();
    let open = &rig.expressions[0].1; // any of them: lips and eyelids come close to each other
    let moved: Vec<Vec3> = mesh.positions.iter().zip(open).map(|(p, d)| p + d).collect();
    let mut group = c.benchmark_group(format!("self-intersections of {} triangles", mesh.triangles.len()));
    for (name, positions) in [("at rest", &mesh.positions), ("an expression", &moved)] {
        group.bench_function(name, |b| {
            b.iter(|| self_intersections(black_box(positions), &mesh.triangles).unwrap().len());
        });
    }
    group.finish();
}

fn surface(c: &mut Criterion) {
    let (rig, _) = face();
    let mesh = rig.mesh.triangulate();
    let mut group = c.benchmark_group(format!("surface of {} vertices", mesh.positions.len()));
    group.bench_function("edge graph", |b| b.iter(|| EdgeGraph::of(black_box(&mesh))));
    let edges = EdgeGraph::of(&mesh);
    let graph = WeightedGraph::euclidean(&edges, &mesh.positions).unwrap();
    let components = edges.components();
    let counts = share_nodes(&components.sizes(), 400);
    group.bench_function("400 farthest points", |b| {
        b.iter(|| farthest_point_sampling(black_box(&graph), &components, &counts));
    });
    let sources = farthest_point_sampling(&graph, &components, &counts).nodes;
    group.bench_function("5 nearest of 400 sources", |b| {
        b.iter(|| nearest_sources(black_box(&graph), &sources, 5));
    });
    let mut normals = mesh.positions.clone();
    for (name, weighting) in [("angle", NormalWeighting::Angle), ("area", NormalWeighting::Area)] {
        group.bench_function(format!("vertex normals by {name}"), |b| {
            b.iter(|| vertex_normals_into(black_box(&mesh.positions), &mesh.triangles, weighting, &mut normals));
        });
    }
    group.finish();
}

fn files(c: &mut Criterion) {
    let (rig, case) = face();
    let folder = tempfile::tempdir().unwrap();
    let (ply, obj) = (folder.path().join("scan.ply"), folder.path().join("template.obj"));
    write_ply(&ply, &case.scan, PlyOptions::default()).unwrap();
    write_obj(&obj, &rig.mesh).unwrap();
    let mut group = c.benchmark_group("files");
    group.bench_function(format!("read PLY, {} triangles", case.scan.triangles.len()), |b| {
        b.iter(|| read_ply(black_box(&ply)).unwrap());
    });
    group.bench_function(format!("read OBJ, {} polygons", rig.mesh.polygon_count()), |b| {
        b.iter(|| read_obj(black_box(&obj)).unwrap());
    });
    group.finish();
}

criterion_group!(name = benches; config = short(); targets = closest_point, self_intersection, surface, files);
criterion_main!(benches);
