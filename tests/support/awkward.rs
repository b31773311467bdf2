//! Meshes that real files hold sooner or later, made by code and known by name.
#![allow(dead_code)] // every test binary uses its own part of this

use nonrigid::mesh::{PolygonMesh, Vec3};

/// Vertices and polygons.
fn mesh<P: AsRef<[u32]>>(positions: Vec<Vec3>, polygons: impl IntoIterator<Item = P>) -> PolygonMesh {
    with_polygons(PolygonMesh { positions, starts: vec![0], ..PolygonMesh::default() }, polygons)
}

/// A sheet of quads, `columns` by `rows` vertices, at `place(column, row)`.
pub fn quads(columns: u32, rows: u32, place: impl Fn(f64, f64) -> Vec3) -> PolygonMesh {
    let positions = (0..columns * rows).map(|i| place(f64::from(i % columns), f64::from(i / columns))).collect();
    let first = (0..(columns - 1) * (rows - 1)).map(|q| q + q / (columns - 1));
    mesh(positions, first.map(|a| [a, a + 1, a + columns + 1, a + columns]))
}

/// A wavy sheet of quads of `size` millimetres a side, `columns` by `rows` vertices.
pub fn sheet(columns: u32, rows: u32, size: f64) -> PolygonMesh {
    quads(columns, rows, |x, y| Vec3::new(x, y, 1.5 * (0.7 * x).sin() * (0.9 * y + 0.3).cos()) * size)
}

/// The sheet that others are changes of: 63 vertices, about 80 by 60 mm.
pub fn plain() -> PolygonMesh {
    sheet(9, 7, 10.0)
}

fn mapped(mut mesh: PolygonMesh, map: impl Fn(Vec3) -> Vec3) -> PolygonMesh {
    mesh.positions.iter_mut().for_each(|p| *p = map(*p));
    mesh
}

/// Both meshes, side by side in one.
fn joined(mut a: PolygonMesh, b: &PolygonMesh) -> PolygonMesh {
    let (first, corners) = (a.positions.len() as u32, a.corners.len() as u32);
    a.positions.extend(&b.positions);
    a.corners.extend(b.corners.iter().map(|v| v + first));
    a.starts.extend(b.starts.iter().skip(1).map(|s| s + corners));
    a
}

fn with_polygons<P: AsRef<[u32]>>(mut mesh: PolygonMesh, polygons: impl IntoIterator<Item = P>) -> PolygonMesh {
    for polygon in polygons {
        mesh.corners.extend(polygon.as_ref());
        mesh.starts.push(mesh.corners.len() as u32);
    }
    mesh
}

fn polygons(mesh: &PolygonMesh) -> Vec<Vec<u32>> {
    (0..mesh.polygon_count()).map(|f| mesh.polygon(f).to_vec()).collect()
}

/// Each polygon with vertices of its own: nothing is joined, every vertex has doubles.
fn soup(of: &PolygonMesh) -> PolygonMesh {
    let positions = of.corners.iter().map(|&v| of.positions[v as usize]).collect();
    PolygonMesh { positions, corners: (0..of.corners.len() as u32).collect(), ..of.clone() }
}

/// A band with one half twist: one side, one boundary.
fn moebius() -> PolygonMesh {
    let around = 40;
    let place = |i: u32| {
        let (turn, across) = (std::f64::consts::TAU * f64::from(i / 3) / f64::from(around), f64::from(i % 3) - 1.0);
        let radius = 40.0 + 10.0 * across * (turn / 2.0).cos();
        Vec3::new(radius * turn.cos(), radius * turn.sin(), 10.0 * across * (turn / 2.0).sin())
    };
    let vertex = |k: u32, j: u32| if k < around { 3 * k + j } else { 2 - j };
    let quads = (0..around)
        .flat_map(|k| (0..2).map(move |j| [vertex(k, j), vertex(k + 1, j), vertex(k + 1, j + 1), vertex(k, j + 1)]));
    mesh((0..3 * around).map(place).collect(), quads)
}

/// An octahedron with every face cut in four, on the sphere; wound inwards.
fn inward_ball() -> PolygonMesh {
    let (rings, around) = (7, 12);
    let place = |i: u32| {
        let polar = std::f64::consts::PI * f64::from(i / around + 1) / f64::from(rings + 1);
        let turn = std::f64::consts::TAU * f64::from(i % around) / f64::from(around);
        Vec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos()) * 40.0
    };
    let mut positions: Vec<Vec3> = (0..rings * around).map(place).collect();
    positions.extend([Vec3::z() * 40.0, Vec3::z() * -40.0]);
    let [top, bottom] = [rings * around, rings * around + 1];
    let next = |k: u32| (k + 1) % around;
    let mut faces: Vec<Vec<u32>> = Vec::new();
    for k in 0..around {
        let last = (rings - 1) * around;
        faces.extend([vec![top, next(k), k], vec![bottom, last + k, last + next(k)]]);
        faces.extend(
            (0..rings - 1).map(|r| r * around).map(|r| vec![r + k, r + next(k), r + around + next(k), r + around + k]),
        );
    }
    mesh(positions, faces)
}

/// Triangles, quads and an octagon in one sheet.
fn mixed() -> PolygonMesh {
    let sheet = plain();
    let mut all: Vec<Vec<u32>> = Vec::new();
    for (f, q) in polygons(&sheet).into_iter().enumerate() {
        // Four quads round the vertex in the middle of the first 2 x 2 become one octagon; that vertex is left over.
        match f {
            0 => all.push(vec![0, 1, 2, 11, 20, 19, 18, 9]),
            1 | 8 | 9 => {}
            _ if f % 3 == 0 => all.extend([vec![q[0], q[1], q[2]], vec![q[0], q[2], q[3]]]),
            _ => all.push(q),
        }
    }
    mesh(sheet.positions, all)
}

/// All of them, by name.
pub fn awkward() -> Vec<(&'static str, PolygonMesh)> {
    let away = |k: u32| Vec3::new(f64::from(k % 10), f64::from(k / 10), 0.0) * 70.0;
    let fifty = (1..50).fold(sheet(4, 4, 10.0), |all, k| joined(all, &mapped(sheet(4, 4, 10.0), |p| p + away(k))));
    let mut isolated = plain();
    isolated.positions.extend([Vec3::repeat(5.0), Vec3::new(0.0, 0.0, 300.0), Vec3::new(-1e4, 0.0, 0.0)]);
    let mut twice = plain();
    twice.positions.extend_from_within(..);
    let doubles: Vec<[u32; 4]> = (0..6).map(|k| [63 + k, 64 + k, 73 + k, 72 + k]).collect();
    let mut needles = plain();
    let tip = needles.positions.len() as u32;
    needles.positions.extend([Vec3::new(40.0, 30.0, 1e-9), Vec3::new(40.0, 30.0, 900.0)]);
    let line = (0..63).map(|i| Vec3::new(1.0, 2.0, -0.5) * f64::from(i)).collect();
    let turned = polygons(&plain()).into_iter().rev().step_by(4).map(|q| q.into_iter().rev().collect::<Vec<u32>>());
    let wing = |x: f64, z: f64| Vec3::new(x, 30.0, z);
    let mut book = plain();
    book.positions.extend([wing(35.0, 40.0), wing(45.0, 40.0), wing(35.0, -40.0), wing(45.0, -40.0)]);
    let tied = mapped(plain(), |p| Vec3::new(-p.x, -p.y, p.z));
    let mut bow = joined(plain(), &tied);
    bow.corners.iter_mut().filter(|v| **v == 63).for_each(|v| *v = 0);
    vec![
        ("plain", plain()),
        ("single triangle", mesh(vec![Vec3::zeros(), Vec3::x() * 30.0, Vec3::y() * 40.0], [[0, 1, 2]])),
        ("isolated vertices", isolated),
        ("duplicate vertices, joined by nothing", soup(&plain())),
        ("duplicate vertices, some faces on each", with_polygons(twice, doubles)),
        ("duplicate faces", with_polygons(plain(), polygons(&plain()).into_iter().step_by(3))),
        ("faces of both windings", with_polygons(plain(), turned)),
        ("zero-area triangles", with_polygons(plain(), [[0, 1, 1], [5, 5, 5], [0, 4, 8]])),
        ("needle triangles", with_polygons(needles, [[0, 62, tip], [30, 31, tip + 1], [31, 30, tip]])),
        ("non-manifold edge", with_polygons(book, [[30, 31, 64, 63], [30, 31, 66, 65]])),
        ("non-manifold vertex", bow),
        ("moebius strip", moebius()),
        ("two components", joined(plain(), &mapped(plain(), |p| p + Vec3::new(20.0, 100.0, 30.0)))),
        ("fifty components", fifty),
        ("inward winding", inward_ball()),
        ("mixed polygons", mixed()),
        ("scale 1e6", mapped(plain(), |p| p * 1e6)),
        ("scale 1e-6", mapped(plain(), |p| p * 1e-6)),
        ("offset 1e7", mapped(plain(), |p| p + Vec3::new(1e7, -1e7, 1e7))),
        ("coplanar", mapped(plain(), |p| Vec3::new(p.x, p.y, 0.0))),
        ("collinear", mesh(line, polygons(&plain()))),
        ("one point", mapped(plain(), |_| Vec3::new(1.0, 2.0, 3.0))),
        ("no faces", PolygonMesh { starts: vec![0], corners: Vec::new(), ..plain() }),
        ("empty", PolygonMesh { starts: vec![0], ..PolygonMesh::default() }),
    ]
}

/// Length of the diagonal and distance of the farthest corner from the origin: what rounding is measured by.
pub fn extent(mesh: &PolygonMesh) -> (f64, f64) {
    let far = mesh.positions.iter().map(|p| p.norm()).fold(0.0, f64::max);
    (nonrigid::mesh::bounding_box_diagonal(&mesh.positions), far)
}
