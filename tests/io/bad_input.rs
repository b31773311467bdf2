//! Bad files: every row of the table has to be an error that names the file and says what is wrong, without a panic and
//! without allocating what a header claims.

use std::path::Path;

use data_gen::{FaceOptions, FaceRig};
use nonrigid::io::{NpyArray, Npz, read_npy_points, read_polygon_mesh, read_scan, write_obj};
use nonrigid::landmark::read_landmarks;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::rig::{Rig, RigReadOptions};

use crate::mesh_formats::{binary_stl, packed};

fn quad() -> PolygonMesh {
    let positions = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec();
    PolygonMesh { positions, starts: vec![0, 4], corners: vec![0, 1, 2, 3], ..PolygonMesh::default() }
}

pub fn npy_with(header: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    npy_with(&format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n"), data)
}

fn ply(vertex: &str, faces: &str, body: &[u8]) -> Vec<u8> {
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\n{vertex}{faces}end_header\n").into_bytes();
    bytes.extend(body);
    bytes
}

const XYZ: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
const FACE: &str = "element face 1\nproperty list uchar int vertex_indices\n";
const ASCII: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";

#[test]
fn every_bad_file_is_refused_with_its_name_and_a_reason() {
    let three = [0u8; 36];
    let with = |tail: &[u8]| [&three[..], tail].concat();
    let nan = [&[0u8; 16][..], &f32::NAN.to_le_bytes(), &[0u8; 16]].concat();
    let huge = "element vertex 1000000000000\nproperty float x\nproperty float y\nproperty float z\n";
    let v3 = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let deep = format!("{}{}", "[".repeat(20_000), "]".repeat(20_000));

    let one = TriangleMesh {
        positions: [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Vec3::from).to_vec(),
        triangles: vec![[0, 1, 2]],
    };
    let stl = binary_stl(&one);
    let nan_stl = [&stl[..96], &f32::NAN.to_le_bytes(), &stl[100..]].concat();
    let huge_stl = [&[b' '; 80][..], &u32::MAX.to_le_bytes()].concat();
    let off = |rest: &str| format!("OFF\n{rest}").into_bytes();
    let p3 = "0 0 0\n1 0 0\n0 1 0\n";
    #[rustfmt::skip]
    let table: Vec<(&str, Vec<u8>, &[&str])> = vec![
        ("empty.obj", vec![], &["vertices"]),
        ("garbage.obj", vec![0, 159, 255, 10, 7, 32, 200, 10], &["vertices"]),
        ("word.obj", b"v 0 0 0\nv 1 zero 0\n".to_vec(), &["line 2", "number", "zero"]),
        ("short.obj", b"v 0 0\n".to_vec(), &["line 1", "3 numbers"]),
        ("nan.obj", b"v 0 0 0\n\nv nan 0 0\n".to_vec(), &["line 3", "finite"]),
        ("inf.obj", b"v 0 0 -inf\n".to_vec(), &["line 1", "finite"]),
        ("overflow.obj", b"v 1e999 0 0\n".to_vec(), &["line 1", "finite"]),
        ("past.obj", format!("{v3}f 1 2 4\n").into_bytes(), &["line 4", "from 1 to 3", "found 4"]),
        ("zero.obj", format!("{v3}f 0 1 2\n").into_bytes(), &["line 4", "from 1 to 3", "found 0"]),
        ("before.obj", format!("{v3}f -4 1 2\n").into_bytes(), &["line 4", "found -4"]),
        ("huge_index.obj", format!("{v3}f 1 2 99999999999\n").into_bytes(), &["line 4", "99999999999"]),
        ("uv.obj", format!("{v3}vt 0 0\nf 1/1 2/2 3/1\n").into_bytes(), &["line 5", "texture", "found 2"]),
        ("two.obj", format!("{v3}f 1 2\n").into_bytes(), &["line 4", "3 corners", "found 2"]),
        ("corner.obj", format!("{v3}f 1/1/1/1 2 3\n").into_bytes(), &["line 4"]),
        ("letters.obj", format!("{v3}f a b c\n").into_bytes(), &["line 4", "index"]),
        ("empty.ply", vec![], &["line 1", "ply"]),
        ("garbage.ply", vec![1, 2, 3, 10, 255, 254], &["line 1", "ply"]),
        ("headless.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n".to_vec(), &["line 4", "end_header"]),
        ("format.ply", b"ply\nformat morse 1.0\nend_header\n".to_vec(), &["line 2", "binary_little_endian"]),
        ("type.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\nend_header\n".to_vec(), &["line 4", "real"]),
        ("orphan.ply", b"ply\nproperty float x\nend_header\n".to_vec(), &["line 2", "element"]),
        ("noformat.ply", b"ply\nelement vertex 0\nend_header\n".to_vec(), &["format"]),
        ("negative.ply", b"ply\nformat ascii 1.0\nelement vertex -3\nend_header\n".to_vec(), &["line 3", "-3"]),
        ("flat.ply", ply("element vertex 1\nproperty float x\nproperty float y\n", "", &[0; 8]), &["line 3", "x, y, z"]),
        ("none.ply", ply("element vertex 0\nproperty float x\nproperty float y\nproperty float z\n", "", &[]), &["vertices", "none"]),
        ("huge.ply", ply(huge, "", &three), &["1000000000000 rows", "36 bytes"]),
        ("huge_ascii.ply", format!("{ASCII}end_header\n0 0 0\n").replace("vertex 3", "vertex 999999999999").into_bytes(), &["999999999999 rows", "6 bytes"]),
        ("huge_other.ply", ply(&format!("element x 18446744073709551615\nproperty double a\n{XYZ}"), "", &three), &["18446744073709551615"]),
        ("truncated.ply", ply(XYZ, "", &three[..35]), &["3 rows of element vertex", "35 bytes"]),
        ("no_face.ply", ply(XYZ, FACE, &three), &["1 rows of element face", "0 bytes"]),
        ("half_face.ply", ply(XYZ, FACE, &with(&[3, 0, 0, 0, 0, 1])), &["row 0 of 1 of element face", "5 bytes"]),
        ("long_face.ply", ply(XYZ, &FACE.replace("uchar", "uint"), &with(&[255; 8])), &["row 0 of 1 of element face"]),
        ("minus_face.ply", ply(XYZ, &FACE.replace("uchar", "char"), &with(&[255; 8])), &["length of list", "-1"]),
        ("past.ply", ply(XYZ, FACE, &with(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0])), &["face 0", "from 0 to 2", "found 3"]),
        ("two.ply", ply(XYZ, FACE, &with(&[2, 0, 0, 0, 0, 1, 0, 0, 0])), &["3 corners", "found 2"]),
        ("texture.ply", format!("{ASCII}{FACE}property list uchar float texcoord\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 4 0 0 1 0\n").into_bytes(), &["6 texture coordinates of face 0", "found 4"]),
        ("texture_nan.ply", format!("{ASCII}{FACE}property list uchar float texcoord\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 nan 0 1\n").into_bytes(), &["finite texture coordinates of face 0"]),
        ("list.ply", ply(XYZ, "element face 1\nproperty int a\n", &with(&[0; 4])), &["vertex_indices"]),
        ("strips.ply", ply(XYZ, "element tristrips 1\nproperty list int int vertex_indices\n", &with(&[0; 4])), &["strips"]),
        ("nan.ply", ply(XYZ, "", &nan), &["vertex 1", "finite"]),
        ("short_row.ply", format!("{ASCII}end_header\n0 0 0\n0 0\n0 0 0.000\n").into_bytes(), &["line 9", "property z in row 1"]),
        ("long_row.ply", format!("{ASCII}end_header\n0 0 0\n0 0 0 0\n0 0 0\n").into_bytes(), &["line 9", "end of row 1"]),
        ("word.ply", format!("{ASCII}end_header\n0 0 0\n0 x 0\n0 0 0\n").into_bytes(), &["line 9", "\"x\""]),
        ("missing_row.ply", format!("{ASCII}end_header\n0 0 0\n0.00000 0.000000 0\n").into_bytes(), &["row 2 of 3"]),
        ("empty.npy", vec![], &["NUMPY", "end of the file"]),
        ("garbage.npy", vec![7; 100], &["NUMPY"]),
        ("version.npy", b"\x93NUMPY\x09\x00\x10\x00".to_vec(), &["version"]),
        ("header.npy", npy_with("{'descr': '<f4'", &[]), &["byte"]),
        ("deep.npy", npy_with(&"[".repeat(60_000), &[]), &["dictionary"]),
        ("long_header.npy", [b"\x93NUMPY\x02\x00".as_slice(), &u32::MAX.to_le_bytes()].concat(), &["65536"]),
        ("objects.npy", npy("|O", "(3, 3)", &[0; 36]), &["f4 or f8", "|O"]),
        ("text.npy", npy("<U7", "(3, 3)", &[0; 36]), &["<U7"]),
        ("short.npy", npy("<f4", "(3, 3)", &[0; 35]), &["3 x 3", "35 bytes"]),
        ("huge.npy", npy("<f8", "(1000000000000, 3)", &[0; 8]), &["1000000000000 x 3"]),
        ("absurd.npy", npy("<f8", "(9999999999999, 9999999999999)", &[]), &["fits in memory"]),
        ("shape.npy", npy("<f4", "(3, 2)", &[0; 24]), &["expected an array N x 3, found 3 x 2"]),
        ("rank.npy", npy("<f4", "(6,)", &[0; 24]), &["N x 3", "found 6"]),
        ("nan.npy", npy("<f4", "(1, 3)", &[255; 12]), &["point 0", "finite"]),
        ("garbage.npz", vec![80, 75, 3, 4, 0, 0, 0], &["NPZ"]),
        ("empty.npz", vec![], &["NPZ"]),
        ("empty.json", vec![], &["JSON"]),
        ("garbage.json", b"{\"1\": [1, 2,\n oops]}".to_vec(), &["line 2", "JSON"]),
        ("deep.json", deep.into_bytes(), &["JSON"]),
        ("number.json", b"7".to_vec(), &["object"]),
        ("past.json", b"{\"4\": [1.5, 2, 3]}".to_vec(), &["\"4\"", "below 4", "found 4"]),
        ("name.json", b"{\"nose\": [1.5, 2, 3]}".to_vec(), &["vertex indices", "nose"]),
        ("zero.json", b"{\"01\": [1.5, 2, 3]}".to_vec(), &["vertex indices", "01"]),
        ("arity.json", b"{\"1\": [1.5, 2]}".to_vec(), &["\"1\"", "[x, y, z]", "[1.5, 2]"]),
        ("null.json", b"{\"1\": [1.5, 2, null]}".to_vec(), &["\"1\"", "null"]),
        ("twice.json", b"{\"1\": [1.5, 2, 3], \"1\": [1.5, 2, 3]}".to_vec(), &["once", "\"1\" twice"]),
        ("overflow.json", b"{\"1\": [1e999, 2, 3]}".to_vec(), &["overflow.json"]),
        ("unnamed.json", b"[[1, 2, 3]]".to_vec(), &["template landmark file"]),
        ("no_scan.json", b"{\"1\": [0, 0.2, 0.3]}".to_vec(), &["scan with triangles"]),
        ("empty.stl", vec![], &["solid", "84 bytes", "found 0 bytes"]),
        ("huge.stl", huge_stl, &["214748364834 bytes for 4294967295 triangles", "84 bytes"]),
        ("none.stl", [&[b' '; 80][..], &[0; 4]].concat(), &["triangles", "none"]),
        ("nan.stl", nan_stl, &["byte 96", "finite", "triangle 0"]),
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
        ("faces.off", off(&format!("3 999999999999 0\n{p3}")), &["line 2", "999999999999 faces"]),
        ("endless.off", off("18446744073709551615 18446744073709551615 0\n"), &["vertices"]),
        ("none.off", off("0 0 0\n"), &["line 2", "vertices", "none"]),
        ("short.off", off("3 1 0\n0 0 0\n0 0 1\n"), &["vertex 2 of 3", "end of the file"]),
        ("number.off", off("1 0 0\n0 x 0\n"), &["line 3", "finite number", "\"x\""]),
        ("past.off", off(&format!("3 1 0\n{p3}3 0 1 3\n")), &["line 6", "from 0 to 2", "found 3"]),
        ("minus.off", off(&format!("3 1 0\n{p3}3 0 1 -1\n")), &["line 6", "vertex index", "-1"]),
        ("two.off", off(&format!("3 1 0\n{p3}2 0 1\n")), &["line 6", "3 corners", "found 2"]),
        ("many.off", off(&format!("3 1 0\n{p3}4294967296 0 1 2\n")), &["line 6", "3 corners", "4294967296"]),
        ("empty.xyz", vec![], &["points", "none"]),
        ("two.xyz", b"1 2\n".to_vec(), &["line 1", "3 columns", "found 2"]),
        ("nine.xyz", b"1 2 3 4 5 6 7 8 9\n".to_vec(), &["line 1", "or 6", "found 9"]),
        ("mixed.xyz", b"1 2 3\n1 2 3 0 0 1\n".to_vec(), &["line 2", "3 columns, as in the first line", "found 6"]),
        ("word.xyz", b"1 2 3\n1 2 x\n".to_vec(), &["line 2", "finite number", "\"x\""]),
        ("inf.xyz", b"1 2 1e999\n".to_vec(), &["line 1", "finite"]),
        ("garbage.obj.gz", b"v 0 0 0\n".to_vec(), &["gzip"]),
        ("cut.stl.gz", packed(&stl)[..40].to_vec(), &["gzip"]),
        ("inside.ply.gz", packed(b"plx\n"), &["line 1", "ply"]),
        ("kind.zip.gz", packed(b"x"), &["\"zip.gz\"", ".stl", ".gz"]),
        ("bare.gz", packed(b"x"), &["extension", ".obj"]),
        ("mesh.xls", vec![], &["\"xls\"", ".obj, .ply, .stl, .off and .xyz"]),
        ("mesh", vec![], &["extension", ".obj, .ply"]),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes, hints) in table {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let message = match path.extension().and_then(|e| e.to_str()) {
            Some("npy") => read_npy_points(&path).map(drop),
            Some("npz") => Npz::open(&path).map(drop),
            Some("json") => read_landmarks(&path, None, &quad(), None).map(drop),
            _ => read_scan(&path).map(drop),
        };
        let message = message.expect_err(name).to_string();
        for hint in [&name].into_iter().chain(hints) {
            assert!(message.contains(hint), "{name}: {message:?} lacks {hint:?}");
        }
        assert!(message.len() < 400 + path.as_os_str().len(), "{name}: {message}");
    }
}

#[test]
fn missing_files_and_folders_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["none.obj", "none.ply"] {
        let message = read_polygon_mesh(&folder.path().join(name)).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("No such file"), "{message}");
    }
    std::fs::create_dir(folder.path().join("folder.npy")).unwrap();
    assert!(NpyArray::open(&folder.path().join("folder.npy")).is_err());
    assert!(Npz::open(&folder.path().join("folder.npy")).is_err());
}

#[test]
fn landmarks_that_do_not_fit_together() {
    let folder = tempfile::tempdir().unwrap();
    let run = |target: &str, names: &str, scan: Option<&TriangleMesh>| {
        std::fs::write(folder.path().join("target.json"), target).unwrap();
        std::fs::write(folder.path().join("names.json"), names).unwrap();
        let names = folder.path().join("names.json");
        let result = read_landmarks(&folder.path().join("target.json"), Some(&names), &quad(), scan);
        result.map(drop).unwrap_err().to_string()
    };
    let scan = quad().triangulate();
    let rows = [
        (run(r#"{"ear": [1.5, 0, 0]}"#, r#"{"nose": 1, "chin": 2}"#, None), ["target.json", "nose, chin", "\"ear\""]),
        (run("[[1, 2, 3]]", "[1, 2]", None), ["target.json", "2 points", "found 1"]),
        (run("[[1, 2, 3]]", "[4]", None), ["names.json", "below 4", "found 4"]),
        (run("[[1, 2, 3]]", "[-1]", None), ["names.json", "below 4", "found -1"]),
        (run("[[1, 2, 3]]", "[1.5]", None), ["names.json", "vertex index", "1.5"]),
        (run(r#"{"a": [1.5, 0, 0]}"#, r#"{"a": [2, 0.1, 0.1]}"#, None), ["names.json", "triangle", "found 2"]),
        (run(r#"{"a": [1.5, 0, 0]}"#, r#"{"a": "left"}"#, None), ["names.json", "\"a\"", "a string"]),
        (run(r#"{"a": [1.5, 0, 0]}"#, r#"{"a": 1, "a": 2}"#, None), ["names.json", "once", "twice"]),
        (run(r#"{"a": [9, 0.1, 0.1]}"#, r#"{"a": 1}"#, Some(&scan)), ["target.json", "below 2", "found 9"]),
    ];
    for (message, hints) in rows {
        for hint in hints {
            assert!(message.contains(hint), "{message:?} lacks {hint:?}");
        }
    }
}

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    std::fs::write(folder.join(name), bytes).unwrap();
}

#[test]
fn rigs_whose_files_do_not_fit_together() {
    let read = |files: &[(&str, Vec<u8>)]| {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, bytes)| write(folder.path(), name, bytes));
        Rig::read(folder.path(), &RigReadOptions::default())
    };
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let neutral = ("neutral.npy", npy("<f4", "(2, 3)", &floats(&[0.0, 0.0, 0.0, 1.0, 1.0, 1.0])));
    let deltas = |shape: &str, values: &[f32]| ("expression_deltas.npy", npy("<f4", shape, &floats(values)));
    let names = |text: &str| ("expression_names.json", text.as_bytes().to_vec());
    let obj = |text: &str| text.as_bytes().to_vec();

    let good = read(&[neutral.clone(), deltas("(1, 2, 3)", &[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), names("[\"a\"]")]);
    let (rig, warnings) = good.unwrap();
    assert!(warnings.is_empty() && rig.mesh().is_none() && rig.shapes().len() == 1);

    type Files = Vec<(&'static str, Vec<u8>)>;
    let table: Vec<(Files, &[&str])> = vec![
        (vec![], &["neutral.obj", "no mesh"]),
        (vec![("jaw.obj", obj("v 0 0 0\n"))], &["neutral.obj", "1 other"]),
        (
            vec![neutral.clone(), deltas("(1, 3, 3)", &[0.0; 9]), names("[\"a\"]")],
            &["expression_deltas.npy", "found 3 vertices", "expected 2"],
        ),
        (
            vec![neutral.clone(), deltas("(1, 2, 3)", &[0.0; 6]), names("[\"a\", \"b\"]")],
            &["expression_deltas.npy", "found 1 shapes", "expected 2", "expression_names.json"],
        ),
        (vec![neutral.clone(), deltas("(1, 6)", &[0.0; 6]), names("[\"a\"]")], &["N x M x 3", "1 x 6"]),
        (vec![neutral.clone(), deltas("(1, 2, 3)", &[0.0; 6])], &["expression_names.json"]),
        (vec![neutral.clone(), deltas("(1, 2, 3)", &[0.0; 6]), names("{}")], &["names.json", "array of names"]),
        (
            vec![neutral.clone(), deltas("(1, 2, 3)", &[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0]), names("[\"a\"]")],
            &["expression_deltas.npy", "\"a\"", "vertex 1", "finite"],
        ),
        (vec![neutral.clone(), deltas("(2, 2, 3)", &[1.0; 12]), names("[\"a\", \"a\"]")], &["\"a\"", "twice"]),
        (vec![neutral.clone(), ("template.obj", obj("v 0 0 0\n"))], &["template.obj", "found 1", "expected 2"]),
        (vec![neutral, ("landmarks_multipie68.json", obj("[0, 2]"))], &["landmarks", "below 2", "found 2"]),
        (
            vec![("neutral.obj", obj("v 0 0 0\nv 1 1 1\n")), ("jaw.obj", obj("v 0 0 0\n"))],
            &["jaw.obj", "found 1", "expected 2"],
        ),
        (vec![("neutral.obj", obj("v 0 0 0\n")), ("rig.json", obj("{\"kind\": \"odd\"}"))], &["rig.json", "delta"]),
    ];
    for (files, hints) in table {
        let message = read(&files).map(drop).unwrap_err().to_string();
        for hint in hints {
            assert!(message.contains(hint), "{message:?} lacks {hint:?}");
        }
    }
}

#[test]
fn a_folder_of_meshes_is_a_rig_of_whole_shapes_or_of_differences() {
    let folder = tempfile::tempdir().unwrap();
    let face = "f 1 2 3\n";
    write(folder.path(), "neutral.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}"));
    write(folder.path(), "b.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0.5\n{face}"));
    write(folder.path(), "a.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}"));
    let (rig, warnings) = Rig::read(folder.path(), &RigReadOptions::default()).unwrap();
    assert_eq!(rig.shapes().len(), 1);
    assert!(warnings[0].to_string().contains("\"a\""));
    assert_eq!(rig.deltas(0), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
    write(folder.path(), "rig.json", "{\"kind\": \"delta\"}");
    write(folder.path(), "a.obj", format!("v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\n{face}"));
    write(folder.path(), "b.obj", format!("v 0 0 0\nv 0 0 0\nv 0 0 0.5\n{face}"));
    let (rig, warnings) = Rig::read(folder.path(), &RigReadOptions::default()).unwrap();
    assert_eq!((rig.shapes().len(), warnings.len()), (2, 0));
    assert_eq!(rig.deltas(1), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
}

#[test]
fn a_mesh_of_a_folder_that_is_no_shape_of_its_neutral_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let face = FaceRig::generate(&FaceOptions { vertices: 600, ..FaceOptions::default() });
    let rig = face.to_rig().unwrap();
    let neutral = &face.mesh.positions;
    let opened = rig.shapes().iter().position(|shape| shape.name == "jawOpen").unwrap();
    let (displacements, _) = rig.deltas(opened).as_chunks::<3>();
    let displacements: Vec<Vec3> = displacements.iter().map(|d| Vec3::from(d.map(f64::from))).collect();
    let shape: Vec<Vec3> = neutral.iter().zip(&displacements).map(|(n, d)| n + d).collect();
    let mesh = |positions: &[Vec3]| face.mesh.with_positions(positions.to_vec());
    write_obj(&folder.path().join("neutral.obj"), &face.mesh).unwrap();
    let read = |positions: &[Vec3]| {
        write_obj(&folder.path().join("jawOpen.obj"), &mesh(positions)).unwrap();
        Rig::read(folder.path(), &RigReadOptions::default()).map(|(_, odd)| odd).map_err(|e| e.to_string())
    };
    write(folder.path(), "._jawOpen.obj", b"what macOS keeps beside a file on other disks");
    assert_eq!(read(&shape).unwrap(), []);
    let beside: Vec<Vec3> = shape.iter().map(|p| p + Vec3::new(250.0, 0.0, 0.0)).collect();
    let in_metres: Vec<Vec3> = shape.iter().map(|p| p / 1000.0).collect();
    let mut reversed = shape.clone();
    reversed.reverse();
    for (what, positions, hint) in [
        ("beside", beside, "250.0 mm beside the neutral"),
        ("in metres", in_metres, "0.00 times as large"),
        ("in another order", reversed, "the rig's vertices in the rig's order"),
        ("differences", displacements, "{\"kind\": \"delta\"}"),
    ] {
        let message = read(&positions).unwrap_err();
        assert!(message.contains("\"jawOpen\"") && message.contains(hint), "{what}: {message}");
    }
    let mut spike = shape;
    spike[7] += Vec3::new(0.0, 0.0, 60.0);
    assert!(read(&spike).unwrap()[0].to_string().contains("stand out"));
}
