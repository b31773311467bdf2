//! glTF files: what is written is read back, what others write is understood, and what is malformed is refused by name.

use std::path::Path;

use base64::Engine as _;
use nonrigid::io::{
    GltfMesh, Motion, parse_gltf, parse_obj, read_gltf, read_polygon_mesh, write_animated_glb, write_glb,
    write_polygon_mesh,
};
use nonrigid::mesh::{PolygonMesh, Pose, Vec3};
use nonrigid::rig::{Rig, RigReadOptions};
use serde_json::{Map, Value, json};

use crate::support::{Bench, farthest, glb_parts};

/// A folded strip: two quads and two triangles, a seam through vertex 1, a corner and a vertex without textures, groups.
const STRIP: &str = "mtllib skin.mtl\nv 0 0 0\nv 10 0 1\nv 10 10 2\nv 0 10 3\nv 20 0 4\nv 20 10 5\nv 30 5 6\nv 99 99 99\n\
    vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0 1\nvt 0.6 0\nvt 1 0\nvt 1 1\n\
    o face\ng left\nusemtl skin\nf 1/1 2/2 3/3 4/4\ng right\nf 2/5 5/6 6/7 3/3\nf 5/6 7 6/7\nf 1/1 4/4 7/2\n";

fn strip() -> PolygonMesh {
    parse_obj(STRIP.as_bytes(), Path::new("strip.obj")).unwrap()
}

fn parse(document: &Value) -> Result<GltfMesh, String> {
    parse_gltf(document.to_string().as_bytes(), Path::new("a.gltf")).map_err(|e| e.to_string())
}

fn data_uri(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Two triangles of a unit square in metres whose shared edge is doubled, and one morph target, "up", of the last vertex.
fn square() -> Value {
    let positions = [0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 0., 0., 1., 1., 0., 0., 1., 0.];
    let mut bytes = floats(&positions);
    bytes.extend([0u8, 1, 2, 3, 4, 5, 0, 0]); // indices at 72
    bytes.extend(floats(&[0.0, 0.0, 0.25])); // sparse value at 80, sparse index at 92
    bytes.extend([5u8, 0, 0, 0]);
    json!({
        "asset": { "version": "2.0" },
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{
            "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "targets": [{ "POSITION": 2 }] }],
            "extras": { "targetNames": ["up"] },
        }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 6 },
            { "bufferView": 1, "componentType": 5121, "type": "SCALAR", "count": 6 },
            { "componentType": 5126, "type": "VEC3", "count": 6, "sparse": { "count": 1,
              "indices": { "bufferView": 3, "componentType": 5121 }, "values": { "bufferView": 2 } } },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 72 },
            { "buffer": 0, "byteOffset": 72, "byteLength": 6 },
            { "buffer": 0, "byteOffset": 80, "byteLength": 12 },
            { "buffer": 0, "byteOffset": 92, "byteLength": 1 },
        ],
        "buffers": [{ "byteLength": bytes.len(), "uri": data_uri(&bytes) }],
    })
}

#[test]
fn topology_textures_and_groups_come_back_exactly() {
    let mesh = strip();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip.glb");
    write_polygon_mesh(&path, &mesh).unwrap();
    let read = read_polygon_mesh(&path).unwrap();
    assert!(farthest(&read.positions, &mesh.positions) < 1e-5);
    assert_eq!((&read.starts, &read.corners), (&mesh.starts, &mesh.corners));
    assert_eq!(read.metadata.corner_uvs, mesh.metadata.corner_uvs);
    assert_eq!(read.metadata.statements, mesh.metadata.statements);
    assert_eq!(read.metadata.material_libraries, mesh.metadata.material_libraries);
    for (a, b) in read.metadata.uvs.iter().zip(&mesh.metadata.uvs) {
        assert!((a[0] - b[0]).abs() < 1e-7 && (a[1] - b[1]).abs() < 1e-7, "{a:?} {b:?}");
    }
    let again = folder.path().join("again.glb");
    write_polygon_mesh(&again, &read).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&again).unwrap());
}

#[test]
fn without_polygons_and_without_textures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let points = parse_obj(b"v 1 2 3\nv 4 5 6\nv 1 2 3\n", Path::new("p.obj")).unwrap();
    let mut bare = strip();
    bare.metadata = Default::default();
    for mesh in [points, bare] {
        write_polygon_mesh(&path, &mesh).unwrap();
        let read = read_polygon_mesh(&path).unwrap();
        assert_eq!((&read.starts, &read.corners, &read.metadata), (&mesh.starts, &mesh.corners, &mesh.metadata));
        assert!(farthest(&read.positions, &mesh.positions) < 1e-5);
    }
}

#[test]
fn targets_and_extras_come_back() {
    let mesh = strip();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let n = mesh.positions.len();
    let sparse = (0..3 * n).map(|i| if i == 4 { 2.5 } else { 0.0 });
    let deltas: Vec<f32> = sparse.chain((0..3 * n).map(|i| i as f32 * 0.37 - 1.0)).chain(vec![0.0; 3 * n]).collect();
    let extras: Map<String, Value> = json!({ "anything": [1, 2] }).as_object().unwrap().clone();
    write_glb(&path, &mesh, &["one", "all", "none"], &deltas, &extras).unwrap();
    let read = read_gltf(&path).unwrap();
    assert_eq!((read.target_names.join(" "), &read.extras), ("one all none".into(), &extras));
    let far = read.target_deltas.iter().zip(&deltas).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-5 && read.target_deltas.len() == deltas.len(), "{far}");
    assert!(write_glb(&path, &mesh, &["one"], &deltas, &extras).unwrap_err().to_string().contains("in 1 targets"));
}

#[test]
fn normals_move_with_what_is_animated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let mesh = parse_obj(b"v 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nf 1 2 3 4\n", Path::new("a.obj")).unwrap();
    // Half a right angle about x.
    let lifted: Vec<f32> = mesh.positions.iter().flat_map(|p| [0.0, 0.0, p.y as f32]).collect();
    let poses = [Pose::identity(); 2];
    let (weights, lost) = ([vec![0.0], vec![1.0]], []);
    let motion = Motion { frames_per_second: 30.0, poses: &poses, weights: &weights, lost: &lost };
    write_animated_glb(&path, &mesh, None, &["lifted"], &lifted, &motion).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let (document, _) = glb_parts(&bytes);
    let target = &document["meshes"][0]["primitives"][0]["targets"][0]["NORMAL"];
    let accessor = &document["accessors"][target.as_u64().unwrap() as usize];
    let expected = [0.0, -0.5f64.sqrt(), 0.5f64.sqrt() - 1.0];
    for (bound, k) in ["min", "max"].iter().flat_map(|bound| (0..3).map(move |k| (bound, k))) {
        let found = accessor[bound][k].as_f64().unwrap();
        assert!((found - expected[k]).abs() < 1e-6, "{accessor}");
    }
}

#[test]
fn a_rig_comes_back_with_families_landmarks_and_regions() {
    let bench = Bench::new();
    let (rig, _) = Rig::read(&bench.path("rig"), &RigReadOptions::default()).unwrap();
    let path = bench.path("rig.glb");
    rig.write_gltf(&path).unwrap();
    let (read, warnings) = Rig::read(&path, &RigReadOptions::default()).unwrap();
    assert_eq!(warnings, []);
    assert_eq!((read.shapes(), read.landmarks(), read.regions()), (rig.shapes(), rig.landmarks(), rig.regions()));
    assert!(rig.landmarks().is_some() && rig.regions().is_some(), "the test needs both");
    assert!(farthest(read.neutral(), rig.neutral()) < 1e-4);
    let (a, b) = (read.mesh().unwrap(), rig.mesh().unwrap());
    assert_eq!((&a.starts, &a.corners, &a.metadata.corner_uvs), (&b.starts, &b.corners, &b.metadata.corner_uvs));
    for k in 0..rig.shapes().len() {
        let far = read.deltas(k).iter().zip(rig.deltas(k)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far < 1e-5, "shape {k}: {far}");
    }
    let (few, _) = Rig::read(&path, &RigReadOptions { identity_modes: 3, kind: None }).unwrap();
    assert_eq!(few.shapes().len(), rig.shapes().len() - 8 + 3);
    assert_eq!(few.deltas(few.shapes().len() - 1), read.deltas(few.shapes().len() - 1));
}

#[test]
fn files_of_others_are_welded_and_their_targets_named() {
    let read = parse(&square()).unwrap();
    assert_eq!(read.mesh.positions.len(), 4);
    assert_eq!(read.mesh.corners, [0, 1, 2, 0, 2, 3]);
    assert_eq!(read.mesh.positions[3], Vec3::new(0.0, 1000.0, 0.0));
    assert_eq!(read.target_names, ["up"]);
    assert_eq!(read.target_deltas, [0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 250.]);
    // a doubled vertex that a target pulls apart stays double
    let mut torn = square();
    torn["bufferViews"][3]["byteOffset"] = json!(75); // the index 3
    assert_eq!(parse(&torn).unwrap().mesh.corners, [0, 1, 2, 3, 2, 4]);
    let mut unnamed = square();
    unnamed["meshes"][0]["extras"] = json!(null);
    assert_eq!(parse(&unnamed).unwrap().target_names, ["target000"]);
}

#[test]
fn nodes_are_applied_and_meshes_joined() {
    let mut document = square();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    document["nodes"] = json!([
        { "children": [1, 2], "scale": [2, 2, 2] },
        { "mesh": 0, "translation": [1, 0, 0], "rotation": [0, 0, half, half], "name": "turned" },
        { "mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "name": "mirrored" },
    ]);
    let read = parse(&document).unwrap();
    let expected = [[2000., 0., 0.], [2000., 2000., 0.], [0., 2000., 0.], [0., 0., 0.]].map(Vec3::from);
    assert!(farthest(&read.mesh.positions[..4], &expected) < 1e-9, "{:?}", read.mesh.positions);
    assert_eq!(read.mesh.positions[5], Vec3::new(-2000.0, 0.0, 0.0));
    assert_eq!(read.mesh.corners[6..], [6, 5, 4, 7, 6, 4]);
    assert_eq!(read.target_names, ["up"]);
    assert_eq!((read.target_deltas[11], read.target_deltas[23]), (500.0, 500.0));
    assert_eq!(read.mesh.groups().count(), 0);
    assert_eq!(read.mesh.metadata.statements.len(), 2);
}

#[test]
fn interleaved_normalised_and_external_buffers_strips_and_fans() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = Vec::new();
    for (p, uv) in [([0f32, 0.], [0u8, 255]), ([1., 0.], [255, 255]), ([0., 1.], [0, 0]), ([1., 1.], [255, 0])] {
        bytes.extend(floats(&[p[0], p[1], 0.0]));
        bytes.extend([uv[0], uv[1], 0, 0]);
    }
    std::fs::write(folder.path().join("the data.bin"), &bytes).unwrap();
    let document = |mode: u32| {
        json!({
            "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "mode": mode, "attributes": { "POSITION": 0, "TEXCOORD_0": 1 } }] }],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4 },
                { "bufferView": 0, "byteOffset": 12, "componentType": 5121, "normalized": true, "type": "VEC2", "count": 4 },
            ],
            "bufferViews": [{ "buffer": 0, "byteLength": 64, "byteStride": 16 }],
            "buffers": [{ "byteLength": 64, "uri": "the%20data.bin" }],
        })
    };
    let path = folder.path().join("a.gltf");
    for (mode, corners) in [(5, [0, 1, 2, 1, 3, 2]), (6, [1, 2, 0, 2, 3, 0])] {
        std::fs::write(&path, document(mode).to_string()).unwrap();
        let mesh = read_polygon_mesh(&path).unwrap();
        assert_eq!(mesh.corners, corners);
        assert_eq!(mesh.positions[3], Vec3::new(1000.0, 1000.0, 0.0));
        assert_eq!(mesh.metadata.uvs, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
    }
}

/// `square()` with the value at a JSON pointer replaced.
fn with(pointer: &str, value: Value) -> Value {
    let mut document = square();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = document.pointer_mut(parent).unwrap_or_else(|| panic!("{pointer}"));
    match parent {
        Value::Array(list) => list[key.parse::<usize>().unwrap()] = value,
        _ => parent[key] = value,
    }
    document
}

#[test]
fn malformed_documents_are_refused_with_a_reason() {
    let huge = json!(u64::MAX);
    #[rustfmt::skip]
    let table: Vec<(Value, &str)> = vec![
        (json!({}), "asset.version"),
        (json!([]), "asset.version 2"),
        (with("/asset/version", json!("1.0")), "asset.version 2"),
        (with("/extensionsRequired", json!(["KHR_draco_mesh_compression"])), "without compression, found extensionsRequired \"KHR_draco_mesh_compression\""),
        (with("/scene", json!(7)), "one of 1 scenes"),
        (with("/scenes/0/nodes", json!([3])), "one of 1 nodes"),
        (with("/scenes/0/nodes", json!([0, 0])), "node 0 twice"),
        (with("/nodes/0/children", json!([0])), "node 0 twice"),
        (with("/nodes/0/mesh", json!(2)), "one of 1 meshes"),
        (with("/nodes/0/mesh", json!(null)), "a scene with a mesh"),
        (with("/nodes/0/scale", json!([1e300, 1e300, 1e300])), "finite positions"),
        (with("/nodes/0/rotation", json!([0, 0, 0, 0])), "finite positions"),
        (with("/meshes/0/extras/targetNames", json!(["a", "b"])), "names of 1 morph targets"),
        (with("/meshes/0/extras/targetNames", json!([3])), "names of 1 morph targets"),
        (with("/meshes/0/extras/nonrigid", json!({ "vertices": 6 })), "missing field"),
        (with("/meshes/0/primitives/0/attributes/POSITION", json!("x")), "number of an accessor"),
        (with("/meshes/0/primitives/0/attributes/POSITION", json!(9)), "one of 3 accessors"),
        (with("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(0)), "of type VEC2"),
        (with("/meshes/0/primitives/0/mode", json!(9)), "mode 0 to 6"),
        (with("/meshes/0/primitives/0/material", json!(0)), "one of 0 materials"),
        (with("/accessors/0/count", json!(7)), "7 elements of 12 bytes"),
        (with("/accessors/0/count", huge.clone()), "elements of 12 bytes"),
        (with("/accessors/0/byteOffset", huge.clone()), "elements of 12 bytes"),
        (with("/accessors/0/componentType", json!(5130)), "component type"),
        (with("/accessors/0/type", json!("VEC4")), "of type VEC3"),
        (with("/accessors/0/bufferView", json!(8)), "one of 4 buffer views"),
        (with("/accessors/0/count", json!(5)), "displacements for each of 5 vertices"),
        (with("/accessors/1/count", json!(5)), "three indices each"),
        (with("/accessors/2/count", json!(5)), "sparse indices below 5"),
        (with("/accessors/2/count", huge.clone()), "more for accessor 2"),
        (with("/accessors/2/sparse/count", json!(7)), "at most 6 sparse values"),
        (with("/accessors/2/sparse/count", json!(2)), "2 elements of 1 bytes"),
        (with("/bufferViews/3/byteOffset", json!(90)), "sparse indices below 6"),
        (with("/bufferViews/0/byteLength", huge.clone()), "buffer view 0 inside"),
        (with("/bufferViews/0/byteOffset", huge), "buffer view 0 inside"),
        (with("/bufferViews/0/buffer", json!(1)), "one of 1 buffers"),
        (with("/bufferViews/0/byteStride", json!(0)), "at least 12 bytes apart"),
        (with("/buffers/0/byteLength", json!(1000)), "1000 bytes in buffer 0"),
        (with("/buffers/0/uri", json!(null)), "binary chunk"),
        (with("/buffers/0/uri", json!("data:text/plain,abc")), "base64"),
        (with("/buffers/0/uri", json!("data:;base64,@@")), "base64"),
        (with("/buffers/0/uri", json!("/etc/hostname")), "relative path"),
        (with("/buffers/0/uri", json!("http://example.com/a.bin")), "relative path"),
        (with("/buffers/0/uri", json!("%zz.bin")), "relative path"),
        (with("/buffers/0/uri", json!("none-of-that-name.bin")), "cannot be read"),
    ];
    let mut faults = Vec::new();
    for (document, word) in table {
        match parse(&document) {
            Ok(_) => faults.push(format!("{word}: it was read")),
            Err(message) if message.contains(word) && (message.contains("a.gltf") || word == "cannot be read") => {}
            Err(message) => faults.push(format!("{word}: {message}")),
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let mut nan = square();
    nan["buffers"][0]["uri"] = json!(data_uri(&[255; 96]));
    assert!(parse(&nan).unwrap_err().contains("finite"));
}

#[test]
fn a_container_that_is_cut_anywhere_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    write_polygon_mesh(&path, &strip()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        let message = parse_gltf(&bytes[..length], Path::new("cut.glb")).unwrap_err().to_string();
        assert!(message.contains("cut.glb"), "{message}");
    }
}

#[test]
fn a_note_that_does_not_fit_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    write_polygon_mesh(&path, &strip()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    // of the same length each, so that the container stays whole
    for (from, to) in [
        ("\"copies\":[1", "\"copies\":[0"),
        ("\"copies\":[1", "\"copies\":[9"),
        ("\"vertices\":8", "\"vertices\":7"),
        ("\"polygons\":[[4,2]", "\"polygons\":[[4,3]"),
        ("\"polygons\":[[4,2],[3,2]]", "\"polygons\":[[3,2],[4,2]]"),
        ("\"usemtl\"", "\"usemtk\""),
        ("\"uvs\":[0", "\"uvs\":[?"),
    ] {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap_or_else(|| panic!("{from}"));
        let mut changed = bytes.clone();
        changed[at..at + to.len()].copy_from_slice(to.as_bytes());
        let message = parse_gltf(&changed, Path::new("a.glb")).unwrap_err().to_string();
        assert!(message.contains("extras.nonrigid") || to.contains('?'), "{from}: {message}");
    }
}

/// The square's document with `change`, from a binary chunk of `count` vertices on a line instead of six.
fn of_many(count: usize, change: impl FnOnce(&mut Value)) -> Value {
    let mut document = square();
    let bytes = floats(&(0..3 * count).map(|i| (i / 3) as f32).collect::<Vec<_>>());
    document["bufferViews"][0]["byteLength"] = json!(bytes.len());
    document["buffers"][0] = json!({ "byteLength": bytes.len(), "uri": data_uri(&bytes) });
    document["accessors"] = json!([{ "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": count }]);
    document["meshes"] = json!([{ "primitives": [{ "mode": 0, "attributes": { "POSITION": 0 } }] }]);
    change(&mut document);
    document
}

/// Files of at most a megabyte that ask for gigabytes in every way that the format has.
#[cfg(target_os = "linux")]
#[test]
fn promises_of_gigabytes_are_one_error_and_little_memory() {
    let points = json!({ "mode": 0, "attributes": { "POSITION": 0 } });
    let with_targets = |targets: Value| json!({ "mode": 0, "attributes": { "POSITION": 0 }, "targets": targets });
    let nodes = |count: usize, mesh: fn(usize) -> usize| -> (Value, Value) {
        let nodes = (0..count).map(|i| json!({ "mesh": mesh(i) })).collect();
        (nodes, json!([{ "nodes": (0..count).collect::<Vec<_>>() }]))
    };
    let rows: Vec<(&str, Value, &str)> = vec![
        (
            "no view",
            of_many(10, |d| {
                d["accessors"][0] = json!({ "componentType": 5126, "type": "VEC3", "count": 1_000_000_000 });
            }),
            "more for accessor 0 (POSITION)",
        ),
        (
            "one accessor in many primitives",
            of_many(10_000, |d| d["meshes"][0]["primitives"] = json!(vec![points.clone(); 10_000])),
            "more for accessor 0 (POSITION)",
        ),
        (
            "one accessor in many targets",
            of_many(10_000, |d| {
                d["meshes"][0]["primitives"][0] = with_targets(json!(vec![json!({ "POSITION": 0 }); 20_000]));
            }),
            "more for accessor 0 (POSITION of a morph target)",
        ),
        (
            "targets of nothing",
            of_many(10_000, |d| {
                d["meshes"][0]["primitives"][0] = with_targets(json!(vec![json!({}); 100_000]));
            }),
            "more for a morph target without positions",
        ),
        (
            "one mesh in many nodes",
            of_many(10_000, |d| (d["nodes"], d["scenes"]) = nodes(20_000, |_| 0)),
            "more for accessor 0 (POSITION)",
        ),
        (
            "every mesh with another target",
            of_many(200, |d| {
                let primitive = with_targets(json!([{ "POSITION": 0 }]));
                let mesh =
                    |i: usize| json!({ "primitives": [primitive], "extras": { "targetNames": [format!("t{i}")] } });
                d["meshes"] = (0..2_000).map(mesh).collect();
                (d["nodes"], d["scenes"]) = nodes(2_000, |i| i);
            }),
            "more for the morph targets of all meshes",
        ),
        (
            "one long note in many nodes",
            of_many(10, |d| {
                let statements = json!([[0, "g", "x".repeat(300_000)]]);
                d["meshes"][0]["extras"] = json!({ "nonrigid": { "vertices": 0, "copies": [], "uvs": [], "polygons": [],
                    "statements": statements, "materialLibraries": [] } });
                d["meshes"][0]["primitives"] = json!([]);
                (d["nodes"], d["scenes"]) = nodes(20_000, |_| 0);
            }),
            "more for names and notes of a mesh",
        ),
        (
            "one long name in many primitives",
            of_many(10, |d| {
                d["materials"] = json!([{ "name": "x".repeat(300_000) }]);
                let primitive = json!({ "mode": 0, "material": 0, "attributes": { "POSITION": 0 } });
                d["meshes"][0]["primitives"] = json!(vec![primitive; 5_000]);
            }),
            "more for names of materials",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (name, document, word) in rows {
        let text = document.to_string();
        assert!(text.len() < 1 << 20, "{name}: {} bytes", text.len());
        let path = folder.path().join("promise.gltf");
        std::fs::write(&path, text).unwrap();
        let program = env!("CARGO_BIN_EXE_nonrigid");
        // a gigabyte of addresses, far below what each would come to
        let run = std::process::Command::new("sh")
            .args(["-c", "ulimit -v 1000000 && exec \"$0\" rig info \"$1\"", program])
            .arg(&path)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(4), "{name}: {said}");
        assert!(said.contains("promise.gltf") && said.contains(word) && said.lines().count() == 1, "{name}: {said}");
    }
}

/// What a file may come to leaves room for what people have: a vertex buffer that a hundred primitives share, and morph
/// targets that move hardly anything.
#[test]
fn shared_vertices_and_sparse_targets_are_within_what_a_file_may_come_to() {
    let points = json!({ "mode": 0, "attributes": { "POSITION": 0 } });
    let shared = of_many(20_000, |d| d["meshes"][0]["primitives"] = json!(vec![points.clone(); 100]));
    assert_eq!(parse(&shared).unwrap().mesh.positions.len(), 2_000_000);
    let mesh = PolygonMesh {
        positions: (0..20_000).map(|i| Vec3::new(f64::from(i), 1.0, 2.0)).collect(),
        starts: vec![0],
        ..PolygonMesh::default()
    };
    let names: Vec<String> = (0..100).map(|k| format!("shape{k}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut deltas = vec![0.0; 100 * 60_000];
    deltas.iter_mut().step_by(60_000).for_each(|d| *d = 1.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sparse.glb");
    write_glb(&path, &mesh, &names, &deltas, &Map::new()).unwrap();
    assert_eq!(read_gltf(&path).unwrap().target_deltas, deltas);
}

/// Where looking each thing up among all others would take minutes.
#[test]
fn vertices_at_one_place_and_many_names_take_no_time() {
    let count = 60_000;
    let torn = of_many(count, |d| {
        let moves = floats(&(0..3 * count).map(|i| i as f32).collect::<Vec<_>>());
        d["buffers"][0] = json!({ "byteLength": moves.len(), "uri": data_uri(&moves) });
        d["accessors"] = json!([
            { "componentType": 5126, "type": "VEC3", "count": count },
            { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": count },
        ]);
        d["meshes"][0]["primitives"][0] = json!({ "attributes": { "POSITION": 0 }, "targets": [{ "POSITION": 1 }] });
    });
    assert_eq!(parse(&torn).unwrap().mesh.positions.len(), count);
    let named = of_many(1, |d| {
        let mesh = |m: usize| {
            let names: Vec<String> = (0..30_000).map(|k| format!("{m}_{k}")).collect();
            let primitive = json!({ "mode": 0, "attributes": { "POSITION": 0 }, "targets": vec![json!({}); 30_000] });
            json!({ "primitives": [primitive], "extras": { "targetNames": names } })
        };
        d["meshes"] = json!([mesh(0), mesh(1)]);
        (d["nodes"], d["scenes"]) = (json!([{ "mesh": 0 }, { "mesh": 1 }]), json!([{ "nodes": [0, 1] }]));
    });
    assert_eq!(parse(&named).unwrap().target_names.len(), 60_000);
}

#[test]
fn buffers_in_one_file_are_one() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.bin"), floats(&[1.0, 2.0, 3.0])).unwrap();
    let document = |second: Value| {
        json!({
            "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "mode": 0, "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 1 }],
            "bufferViews": [{ "buffer": 1, "byteLength": 12 }],
            "buffers": [{ "byteLength": 12, "uri": "a.bin" }, second],
        })
    };
    let path = folder.path().join("a.gltf");
    let read = |second: Value| {
        std::fs::write(&path, document(second).to_string()).unwrap();
        read_gltf(&path).map_err(|e| e.to_string())
    };
    let mesh = read(json!({ "byteLength": 12, "uri": "./a.bin" })).unwrap().mesh;
    assert_eq!(mesh.positions, [Vec3::new(1000.0, 2000.0, 3000.0)]);
    let message = read(json!({ "byteLength": 8, "uri": "a.bin" })).unwrap_err();
    assert!(message.contains("12 bytes in every buffer of one file") && message.contains("buffer 1"), "{message}");
}
