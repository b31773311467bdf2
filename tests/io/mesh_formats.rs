//! STL, OFF, XYZ and packed meshes: the same mesh in each, and what is wrong with malformed files.

use std::io::Write;
use std::path::{Path, PathBuf};

use data_gen::{FaceOptions, FaceRig};
use nonrigid::mesh::io::{PlyOptions, read_mesh_file, read_polygon_mesh, read_scan, write_obj, write_ply};
use nonrigid::mesh::{TriangleMesh, Vec3};

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn packed(bytes: &[u8]) -> Vec<u8> {
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

fn binary_stl(mesh: &TriangleMesh) -> Vec<u8> {
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
    let off = read("a.off", "CNOFF 3 1 0\n0 0 0 0 0 1 1.0 0 0.2\n1 0 0 0 0 1 0 0 0.0\n0 1 0 0 0 1 1 255 0\n3 0 1 2\n");
    assert_eq!((off.normals, off.colors), (Some(vec![Vec3::z(); 3]), Some(vec![[255, 0, 51], [0, 0, 0], [1, 255, 0]])));
    let quads =
        read_polygon_mesh(&write(folder.path(), "q.off", "OFF\n4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"))
            .unwrap();
    assert_eq!((quads.starts, quads.corners), (vec![0, 4], vec![0, 1, 2, 3]));
}

#[test]
fn every_bad_file_is_refused_with_its_name_and_a_reason() {
    let tetra = TriangleMesh {
        positions: [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Vec3::from).to_vec(),
        triangles: vec![[0, 1, 2]],
    };
    let stl = binary_stl(&tetra);
    let mut nan = stl.clone();
    nan[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut huge = vec![b' '; 84];
    huge[80..].copy_from_slice(&u32::MAX.to_le_bytes());
    let off = |rest: &str| format!("OFF\n{rest}").into_bytes();
    let v3 = "0 0 0\n1 0 0\n0 1 0\n";
    #[rustfmt::skip]
    let table: Vec<(&str, Vec<u8>, &[&str])> = vec![
        ("empty.stl", vec![], &["solid", "84 bytes", "found 0 bytes"]),
        ("huge.stl", huge, &["214748364834 bytes for 4294967295 triangles", "84 bytes"]),
        ("none.stl", [&[b' '; 80][..], &[0; 4]].concat(), &["triangles", "none"]),
        ("nan.stl", nan, &["byte 96", "finite", "triangle 0"]),
        ("ascii_none.stl", b"solid x\nendsolid x\n".to_vec(), &["triangles", "none"]),
        ("word.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 zero 0\n".to_vec(), &["line 4", "finite coordinate", "zero"]),
        ("short.stl", b"solid x\nvertex 0 0\n".to_vec(), &["line 2", "finite coordinate", "nothing"]),
        ("two.stl", b"solid x\nvertex 0 0 0\nvertex 0 0 1\nendfacet\n".to_vec(), &["line 4", "3 vertices", "found 2"]),
        ("cut.stl", b"solid x\nvertex 0 0 0\nvertex 0 0 1\n".to_vec(), &["endfacet", "end of the file"]),
        ("keyword.stl", b"solid x\nfoo\n".to_vec(), &["line 2", "facet", "foo"]),
        ("empty.off", vec![], &["OFF", "end of the file"]),
        ("word.off", b"OFFSET\n".to_vec(), &["line 1", "COFF", "OFFSET"]),
        ("binary.off", b"OFF BINARY\n1 1 1\n".to_vec(), &["line 1", "number of vertices", "BINARY"]),
        ("four.off", b"4OFF\n".to_vec(), &["line 1", "4OFF"]),
        ("huge.off", off("1000000000000 0 0\n0 0 0\n"), &["line 2", "1000000000000 vertices", "bytes"]),
        ("faces.off", off(&format!("3 999999999999 0\n{v3}")), &["line 2", "999999999999 faces"]),
        ("endless.off", off("18446744073709551615 18446744073709551615 0\n"), &["vertices"]),
        ("none.off", off("0 0 0\n"), &["line 2", "vertices", "none"]),
        ("short.off", off("3 1 0\n0 0 0\n0 0 1\n"), &["vertex 2 of 3", "end of the file"]),
        ("number.off", off("1 0 0\n0 x 0\n"), &["line 3", "finite number", "\"x\""]),
        ("past.off", off(&format!("3 1 0\n{v3}3 0 1 3\n")), &["line 6", "from 0 to 2", "found 3"]),
        ("minus.off", off(&format!("3 1 0\n{v3}3 0 1 -1\n")), &["line 6", "vertex index", "-1"]),
        ("two.off", off(&format!("3 1 0\n{v3}2 0 1\n")), &["line 6", "3 corners", "found 2"]),
        ("many.off", off(&format!("3 1 0\n{v3}4294967296 0 1 2\n")), &["line 6", "3 corners", "4294967296"]),
        ("empty.xyz", vec![], &["points", "none"]),
        ("two.xyz", b"1 2\n".to_vec(), &["line 1", "3 columns", "found 2"]),
        ("nine.xyz", b"1 2 3 4 5 6 7 8 9\n".to_vec(), &["line 1", "or 6", "found 9"]),
        ("mixed.xyz", b"1 2 3\n1 2 3 0 0 1\n".to_vec(), &["line 2", "3 columns, as in the first line", "found 6"]),
        ("word.xyz", b"1 2 3\n1 2 x\n".to_vec(), &["line 2", "finite number", "\"x\""]),
        ("inf.xyz", b"1 2 1e999\n".to_vec(), &["line 1", "finite"]),
        ("garbage.obj.gz", b"v 0 0 0\n".to_vec(), &["gzip"]),
        ("cut.stl.gz", packed(&stl)[..40].to_vec(), &["gzip"]),
        ("inside.ply.gz", packed(b"plx\n"), &["line 1", "ply"]),
        ("kind.zip.gz", packed(b"x"), &["\"zip\"", ".stl", ".gz"]),
        ("bare.gz", packed(b"x"), &["extension", ".obj"]),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes, hints) in table {
        let path = write(folder.path(), name, bytes);
        let message = read_scan(&path).map(drop).expect_err(name).to_string();
        for hint in [&name].into_iter().chain(hints) {
            assert!(message.contains(hint), "{name}: {message:?} lacks {hint:?}");
        }
        assert!(message.len() < 400 + path.as_os_str().len(), "{name}: {message}");
    }
}

#[test]
fn cutting_or_breaking_a_file_anywhere_never_panics() {
    use nonrigid::mesh::io::{parse_off, parse_stl, parse_xyz};
    let path = Path::new("a");
    let files: [&[u8]; 3] = [
        b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
        b"CNOFF\n3 1 0\n0 0 0 0 0 1 1 0 0\n1 0 0 0 0 1 0 0 0\n0 1 0 0 0 1 1 255 0\n3 0 1 2 0.5\n",
        b"1 2 3 0 0 1\n4 5 6 0 -1 0\n",
    ];
    for file in files {
        for cut in 0..file.len() {
            for replaced in [None, Some(0), Some(b'\n'), Some(b' '), Some(b'9'), Some(b'-'), Some(0xff)] {
                let mut bytes = file.to_vec();
                match replaced {
                    None => bytes.truncate(cut),
                    Some(byte) => bytes[cut] = byte,
                }
                let _ = (parse_stl(&bytes, path), parse_off(&bytes, path), parse_xyz(&bytes, path));
            }
        }
    }
}

#[test]
fn a_packed_file_that_unpacks_to_a_thousand_times_its_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "bomb.obj.gz", packed(&vec![b'\n'; 32 << 20]));
    assert!(std::fs::metadata(&path).unwrap().len() < 50_000);
    let message = read_mesh_file(&path).unwrap_err().to_string();
    assert!(message.contains("bomb.obj.gz") && message.contains("at most 16777216 bytes unpacked"), "{message}");
}
