//! Closest points, self-intersections, distances along surfaces, and reading of files, on a generated face and a scan of it;
//! beside kiddo and ply-rs-bw, which one would use otherwise.
//!
//! `cargo bench --bench geometry`
#![allow(missing_docs)] // of what `criterion_group` makes

mod support;

use std::fs::File;
use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use data_gen::{FaceOptions, FaceRig, ScanCase, ScanOptions, simulate_scan};
use nonrigid::evaluation::self_intersections;
use nonrigid::io::{PlyOptions, read_mesh_file, read_polygon_mesh, write_obj, write_ply};
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::closest_point::{ClosestPoint, ClosestVertices};
use nonrigid::mesh::geodesic::{WeightedGraph, farthest_point_sampling, nearest_sources, share_nodes};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals_into};
use nonrigid::mesh::{TriangleMesh, Vec3};
use ply_rs_bw::ply::{BeginList, PropertyAccessResult};
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
            let query = |(p, &hint): (&Vec3, &u32)| {
                tree.query_from_within(&(p + offset), hint, f64::INFINITY).unwrap().squared_distance
            };
            group.bench_function(BenchmarkId::new(name, size), |b| {
                b.iter(|| queries.iter().zip(&hints).map(query).sum::<f64>());
            });
        }
    }
    group.finish();
}

/// Closest vertices against kiddo's k-d tree, which decides no ties.
fn closest_vertex(c: &mut Criterion) {
    let (rig, case) = face();
    let queries = case.truth;
    let mut group = c.benchmark_group("closest vertices of 5000");
    for triangles in [20_000, 320_000] {
        let case = simulate_scan(&rig, &ScanOptions { triangles, ..ScanOptions::default() }, 1).unwrap();
        let positions = case.scan.positions;
        let points: Vec<[f64; 3]> = positions.iter().map(|p| (*p).into()).collect();
        let size = points.len();
        group.bench_function(BenchmarkId::new("build", size), |b| b.iter(|| ClosestVertices::new(&positions).unwrap()));
        group.bench_function(BenchmarkId::new("build, kiddo", size), |b| {
            b.iter(|| kiddo::ImmutableKdTree::new_from_slice(&points).unwrap());
        });
        let ours = ClosestVertices::new(&positions).unwrap();
        group.bench_function(BenchmarkId::new("query", size), |b| {
            b.iter(|| queries.iter().map(|p| ours.query(p).unwrap().squared_distance).sum::<f64>());
        });
        let theirs = kiddo::ImmutableKdTree::new_from_slice(&points).unwrap();
        let nearest = |p: &Vec3| {
            let query: [f64; 3] = (*p).into();
            theirs.query(&query).nearest_one::<kiddo::SquaredEuclidean<f64>>().execute().distance
        };
        group.bench_function(BenchmarkId::new("query, kiddo", size), |b| {
            b.iter(|| queries.iter().map(nearest).sum::<f64>());
        });
        for p in &queries {
            assert!((ours.query(p).unwrap().squared_distance - nearest(p)).abs() < 1e-9);
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
        b.iter(|| read_mesh_file(black_box(&ply)).unwrap());
    });
    group.bench_function(format!("read OBJ, {} polygons", rig.mesh.polygon_count()), |b| {
        b.iter(|| read_polygon_mesh(black_box(&obj)).unwrap());
    });
    group.finish();
}

/// A vertex or a face as `ply-rs-bw` fills it: into fields, the fastest that it offers.
#[derive(Default)]
struct Row {
    position: [f32; 3],
    corners: Vec<i32>,
}

impl ply_rs_bw::ply::PropertyAccess for Row {
    fn new() -> Self {
        Self::default()
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        match name {
            "x" => self.position[0] = value,
            "y" => self.position[1] = value,
            "z" => self.position[2] = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    fn begin_list_int(&mut self, _: &str, _: usize) -> BeginList<'_, i32> {
        BeginList::Fill(&mut self.corners)
    }
}

/// Five million triangles from a binary PLY, against `ply-rs-bw`.
fn big_ply(c: &mut Criterion) {
    const SIDE: u32 = 1582;
    let grid = |i: u32| Vec3::new(f64::from(i % SIDE), f64::from(i / SIDE), f64::from(i % 7));
    let corner = |i: u32| [[i, i + 1, i + SIDE], [i + 1, i + SIDE + 1, i + SIDE]];
    let cells = (0..SIDE * (SIDE - 1)).filter(|i| (i + 1) % SIDE != 0);
    let mesh =
        TriangleMesh { positions: (0..SIDE * SIDE).map(grid).collect(), triangles: cells.flat_map(corner).collect() };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.ply");
    write_ply(&path, &mesh, PlyOptions::default()).unwrap();
    let mut group = c.benchmark_group(format!("binary PLY of {} triangles", mesh.triangles.len()));
    group.sample_size(10);
    group.bench_function("read", |b| b.iter(|| read_mesh_file(black_box(&path)).unwrap()));
    group.bench_function("read, ply-rs-bw", |b| {
        b.iter(|| {
            let ply = ply_rs_bw::parser::Parser::<Row>::new().read_ply(&mut File::open(&path).unwrap()).unwrap();
            assert_eq!(ply.payload["face"].len(), mesh.triangles.len());
            ply
        });
    });
    group.finish();
}

criterion_group!(
    name = benches;
    config = short();
    targets = closest_point, closest_vertex, self_intersection, surface, files, big_ply
);
criterion_main!(benches);
