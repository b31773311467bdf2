use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::render::*;
fn main() {
    let n: usize = std::env::args().nth(1).map_or(5000, |a| a.parse().unwrap());
    let rig = data_gen::FaceRig::generate(&data_gen::FaceOptions { vertices: n, ..Default::default() });
    let (flat, pos, mesh) = (rig.places.clone(), rig.neutral.clone(), rig.mesh.clone());
    let quads: Vec<[u32; 4]> = mesh.corners.chunks(4).map(|q| [q[0], q[1], q[2], q[3]]).collect();
    println!("{} vertices {} quads", flat.len(), quads.len());
    let tri = mesh.triangulate();
    let frame = Frame::of(&pos);
    let size = if n < 10000 { [640, 760] } else { [800, 960] };
    let eyes = rig.eyeballs(&[]);
    let ball = |k: usize| {
        let e = eyes[k];
        sphere(e.centre.into(), e.radius)
    };
    let mut panels = vec![];
    let mut wires = vec![];
    for view in [View::Front, View::Angles { yaw: 35.0, pitch: 5.0 }, View::Side] {
        let cam = Camera::framing(&frame, view, size);
        let s = || {
            Scene::new()
                .mesh(&tri, Style::Clay)
                .mesh(&ball(0), Style::Solid([235, 235, 240]))
                .mesh(&ball(1), Style::Solid([235, 235, 240]))
        };
        panels.push(render(&s(), &cam, size));
        wires.push(render(&s().wireframe(&mesh), &cam, size));
    }
    let mut close = vec![];
    let mut close_w = vec![];
    for (cx, cy, h, yaw, pitch) in [
        (0.0, -60.0, 38.0, 0.0, 0.0),
        (0.0, -50.0, 38.0, 40.0, -15.0),
        (25.0, 5.0, 32.0, 10.0, 0.0),
        (25.0, 5.0, 32.0, 60.0, 10.0),
    ] {
        let f = Frame { centre: Vec3::new(cx, cy, -5.0), half: Vec3::new(h, h, 10.0) };
        let cam = Camera::framing(&f, View::Angles { yaw, pitch }, [600, 600]);
        close.push(render(
            &Scene::new()
                .mesh(&tri, Style::Clay)
                .mesh(&ball(0), Style::Solid([235, 235, 240]))
                .mesh(&ball(1), Style::Solid([235, 235, 240])),
            &cam,
            [600, 600],
        ));
        close_w.push(render(
            &Scene::new().mesh(&tri, Style::Clay).mesh(&ball(0), Style::Solid([235, 235, 240])).wireframe(&mesh),
            &cam,
            [600, 600],
        ));
    }
    let sheet = Sheet::new("face").row("", panels);
    let sheet = if n < 10000 { sheet.row("", wires).row("", close_w) } else { sheet.row("", close) };
    save_png(&sheet.render(), std::path::Path::new("/tmp/face.png")).unwrap();
    let fm = PolygonMesh { positions: flat.iter().map(|f| Vec3::new(f[0], f[1], 0.0)).collect(), ..mesh.clone() };
    let frame = Frame::of(&fm.positions);
    let size = [1400, 1600];
    let cam = Camera::framing(&frame, View::Front, size);
    save_png(&render(&Scene::new().wireframe(&fm), &cam, size), std::path::Path::new("/tmp/flat.png")).unwrap();
    let mut bad = 0;
    for q in &quads {
        let p = q.map(|v| flat[v as usize]);
        for k in 0..4 {
            let (a, b, c) = (p[k], p[(k + 1) % 4], p[(k + 2) % 4]);
            if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0.0 {
                bad += 1;
            }
        }
    }
    println!("{bad} bad corners");
}
pub fn sphere(c: [f64; 3], r: f64) -> nonrigid::mesh::TriangleMesh {
    let n = 48;
    let m = 24;
    let mut p = vec![];
    let mut t = vec![];
    for j in 0..=m {
        for i in 0..n {
            let a = i as f64 / n as f64 * 6.283185307;
            let b = j as f64 / m as f64 * 3.14159265;
            p.push(Vec3::new(c[0] + r * b.sin() * a.cos(), c[1] + r * b.sin() * a.sin(), c[2] + r * b.cos()));
        }
    }
    for j in 0..m {
        for i in 0..n {
            let q = |i: usize, j: usize| (j * n + i % n) as u32;
            t.push([q(i, j), q(i, j + 1), q(i + 1, j + 1)]);
            t.push([q(i, j), q(i + 1, j + 1), q(i + 1, j)]);
        }
    }
    nonrigid::mesh::TriangleMesh { positions: p, triangles: t }
}
