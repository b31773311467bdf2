use nonrigid::mesh::io::{read_scan, read_npy_points, read_npy_mask};
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::render::*;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = std::path::Path::new(&args[1]);
    let scan = read_scan(&dir.join("scan.ply")).unwrap().mesh;
    let truth = read_npy_points(&dir.join("truth.npy")).unwrap();
    let seen = read_npy_mask(&dir.join("observed.npy"), None).unwrap();
    let rig_dir = dir.join("../../rig");
    let lm: Vec<usize> = serde_json::from_slice(&std::fs::read(rig_dir.join("landmarks_multipie68.json")).unwrap()).unwrap();
    let size = [900, 1000];
    let frame = Frame::of(&truth);
    let wire = PolygonMesh::from(scan.clone());
    let s = || Scene::new().mesh(&scan, Style::Clay);
    let yes: Vec<Vec3> = truth.iter().zip(&seen).filter(|p| *p.1).map(|p| *p.0).collect();
    let no: Vec<Vec3> = truth.iter().zip(&seen).filter(|p| !*p.1).map(|p| *p.0).collect();
    let mut rows = vec![render(&s(), &Camera::framing(&frame, View::Front, size), size), render(&s(), &Camera::framing(&frame, View::ThreeQuarter, size), size),
        render(&s().points(&yes, [30, 140, 60], 1.5).points(&no, [220, 30, 30], 1.5), &Camera::framing(&frame, View::ThreeQuarter, size), size)];
    let mut close = vec![];
    for (l, h) in [(45, 20.0), (54, 18.0), (33, 25.0), (2, 25.0)] {
        let f = Frame { centre: truth[lm[l]], half: Vec3::new(h, h, 10.0) };
        let yaw = if l == 2 { -50.0 } else { 10.0 };
        close.push(render(&s().wireframe_with(&wire, [40, 60, 90], 1.0), &Camera::framing(&f, View::Angles { yaw, pitch: 0.0 }, size), size));
    }
    let f = Frame { centre: truth[lm[62]], half: Vec3::new(30.0, 30.0, 10.0) };
    rows.push(render(&s().wireframe_with(&wire, [40, 60, 90], 1.0).points(&yes, [30, 140, 60], 2.5).points(&no, [220, 30, 30], 2.5), &Camera::framing(&f, View::Front, size), size));
    save_png(&Sheet::new(&args[1]).row("", rows).row("", close).render(), std::path::Path::new(&args[2])).unwrap();
}
