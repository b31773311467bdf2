//! STL, OFF, XYZ and packed meshes: the same mesh in each.

use std::io::Write;
use std::path::{Path, PathBuf};

use data_gen::{FaceOptions, FaceRig};
use nonrigid::io::{PlyOptions, read_mesh_file, read_polygon_mesh, read_scan, write_obj, write_ply};
use nonrigid::mesh::{TriangleMesh, Vec3};

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

pub fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packer.write_all(bytes).unwrap();
    packer.finish().unwrap()
}

/// With coordinates that 32 bits hold.
fn face() -> TriangleMesh {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 1 });
    let mut mesh = rig.mesh.with_positions(rig.neutral.clone()).triangulate();
    mesh.positions.iter_mut().for_each(|p| *p = p.map(|c| f64::from(c as f32)));
    mesh
}

fn corners(mesh: &TriangleMesh) -> Vec<[Vec3; 3]> {
    mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect()
}

pub fn binary_stl(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = b"solid, yet binary".to_vec();
    bytes.resize(80, b' ');
    bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
    for triangle in corners(mesh) {
        bytes.extend([0; 12]);
        triangle.iter().flat_map(|p| p.iter()).for_each(|c| bytes.extend((*c as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii_stl(mesh: &TriangleMesh) -> String {
    let mut text = String::from("solid face of somebody\n");
    for triangle in corners(mesh) {
        text.push_str(" facet normal 0 0 1\n  outer loop\n");
        triangle.iter().for_each(|p| text.push_str(&format!("   vertex {} {} {}\r\n", p.x, p.y, p.z)));
        text.push_str("  endloop\n endfacet\n");
    }
    text + "endsolid face of somebody\n"
}

#[test]
fn a_byte_order_mark_is_no_part_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let header =
        "property float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices";
    let texts = [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_owned()),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".to_owned()),
        ("a.xyz", "0 0 0\n1 0 0\n0 1 0\n".to_owned()),
        (
            "a.ply",
            format!("ply\nformat ascii 1.0\nelement vertex 3\n{header}\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
        ),
        (
            "a.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
                .to_owned(),
        ),
    ];
    for (name, text) in texts {
        let plain = read_mesh_file(&write(folder.path(), name, &text)).unwrap();
        let marked = read_mesh_file(&write(folder.path(), name, format!("\u{feff}{text}"))).unwrap();
        assert_eq!(plain.mesh.positions.len(), 3);
        assert_eq!(marked, plain, "{name}");
    }
}

#[test]
fn a_face_is_the_same_in_every_format_packed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = face();
    let used = mesh.triangles.iter().flatten().map(|v| mesh.positions[*v as usize].map(|c| (c + 0.0).to_bits()).into());
    let used: std::collections::HashSet<[u64; 3]> = used.collect();
    for (name, bytes) in [("a.stl", binary_stl(&mesh)), ("b.stl", ascii_stl(&mesh).into_bytes())] {
        for (name, bytes) in [(name.to_owned(), bytes.clone()), (format!("{name}.gz"), packed(&bytes))] {
            let read = read_scan(&write(folder.path(), &name, bytes)).unwrap().mesh;
            assert!(corners(&read) == corners(&mesh), "{name}");
            assert_eq!(read.positions.len(), used.len(), "{name}: vertices are shared again");
        }
    }
    let mut off = format!("OFF # a face\n\n{} {} 0\n", mesh.positions.len(), mesh.triangles.len());
    mesh.positions.iter().for_each(|p| off.push_str(&format!("{} {} {}\n", p.x, p.y, p.z)));
    mesh.triangles.iter().for_each(|[a, b, c]| off.push_str(&format!("3 {a} {b} {c} 255 0 0\n")));
    assert!(read_scan(&write(folder.path(), "a.off", &off)).unwrap().mesh == mesh);
    assert!(read_scan(&write(folder.path(), "a.OFF.gz", packed(off.as_bytes()))).unwrap().mesh == mesh);

    let (obj, ply) = (folder.path().join("a.obj"), folder.path().join("a.ply"));
    write_obj(&obj, &mesh.clone().into()).unwrap();
    write_ply(&ply, &mesh, PlyOptions::default()).unwrap();
    for path in [obj, ply] {
        let gz = PathBuf::from(format!("{}.gz", path.display()));
        std::fs::write(&gz, packed(&std::fs::read(&path).unwrap())).unwrap();
        assert!(read_mesh_file(&gz).unwrap() == read_mesh_file(&path).unwrap());
    }
}

#[test]
fn points_come_with_what_their_columns_say() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, text: &str| read_scan(&write(folder.path(), name, text)).unwrap();
    let bare = read("a.xyz", "# points\n1 2 3\n\n4;5,6.5\n");
    assert_eq!(bare.mesh.positions, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.5)]);
    assert!(bare.mesh.triangles.is_empty() && bare.normals.is_none() && bare.colors.is_none());
    let normals = read("b.xyz", "// x\n1 2 3 0 0 1\n4 5 6 0 -1 0\n");
    assert_eq!(normals.normals, Some(vec![Vec3::z(), -Vec3::y()]));
    let colours = read("c.xyz", "1 2 3 0 0 255\n4 5 6 7 1 0\n");
    assert_eq!((colours.colors, colours.normals), (Some(vec![[0, 0, 255], [7, 1, 0]]), None));
    let shares = read("d.xyz", "1 2 3 0 0 1\n4 5 6 0.2 0.6 1\n");
    assert_eq!((shares.colors, shares.normals), (Some(vec![[0, 0, 255], [51, 153, 255]]), None));
    let off = read("a.off", "CNOFF 3 1 0\n0 0 0 0 0 1 1.0 0 0.2\n1 0 0 0 0 1 0 0 0.0\n0 1 0 0 0 1 1 255 0\n3 0 1 2\n");
    assert_eq!((off.normals, off.colors), (Some(vec![Vec3::z(); 3]), Some(vec![[255, 0, 51], [0, 0, 0], [1, 255, 0]])));
    let quads =
        read_polygon_mesh(&write(folder.path(), "q.off", "OFF\n4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"))
            .unwrap();
    assert_eq!((quads.starts, quads.corners), (vec![0, 4], vec![0, 1, 2, 3]));
}

#[test]
fn a_packed_file_that_unpacks_to_a_thousand_times_its_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "bomb.obj.gz", packed(&vec![b'\n'; 32 << 20]));
    assert!(std::fs::metadata(&path).unwrap().len() < 50_000);
    let message = read_mesh_file(&path).unwrap_err().to_string();
    assert!(message.contains("bomb.obj.gz") && message.contains("at most 16777216 bytes unpacked"), "{message}");
}
