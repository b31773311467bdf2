//! What is asked of every reader, whatever bytes it gets: no panic, no hang, no more memory than the bytes are worth, and
//! either an error that names the file or something that keeps the reader's promises.
//!
//! The fuzz targets and the test `tests/project/corpus.rs` run these functions.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt::Display;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use nonrigid::io::{
    MeshFile, NpyArray, Npz, parse_gltf, parse_obj, parse_off, parse_ply, parse_stl, parse_xyz, write_obj,
};
use nonrigid::landmark::{LandmarkPlace, LandmarkSet, parse_landmark_set, parse_landmarks, write_landmark_set};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::morph::Recipe;
use nonrigid::registration::{ModelKind, Schedule, TERMS};
use nonrigid::rig::{Rig, RigReadOptions, ShapeSelection};
use nonrigid::text;

/// What is asked of a reader.
pub type Target = fn(&[u8]);

/// All of them, by name.
pub const TARGETS: [(&str, Target); 14] = [
    ("ply", ply),
    ("obj", obj),
    ("stl", stl),
    ("off", off),
    ("xyz", xyz),
    ("gltf", gltf),
    ("npy", npy),
    ("npz", npz),
    ("landmarks", landmarks),
    ("landmark_set", landmark_set),
    ("rig", rig),
    ("schedule", schedule),
    ("recipe", recipe),
    ("text", text),
];

/// An error says which file, and not the whole of it.
fn check_error(error: impl Display, file: &str) {
    let message = error.to_string();
    assert!(message.contains(file), "{message}");
    assert!(message.chars().count() < 2000, "{} bytes: {message}", message.len());
}

fn finite(points: &[Vec3]) -> bool {
    points.iter().all(|p| p.iter().all(|x| x.is_finite()))
}

/// What readers promise of a mesh.
fn check_mesh(mesh: &PolygonMesh) {
    let vertices = mesh.positions.len();
    assert!(vertices > 0 && finite(&mesh.positions));
    assert!(mesh.starts[0] == 0 && mesh.starts.is_sorted() && mesh.starts.last() == Some(&(mesh.corners.len() as u32)));
    assert!(mesh.corners.iter().all(|v| (*v as usize) < vertices));
    assert!((0..mesh.polygon_count()).all(|f| mesh.polygon(f).len() >= 3));
    let uvs = &mesh.metadata.corner_uvs;
    assert!(uvs.is_empty() || uvs.len() == mesh.corners.len());
    assert!(uvs.iter().all(|uv| *uv == u32::MAX || (*uv as usize) < mesh.metadata.uvs.len()));
    assert_eq!(mesh.triangulate().triangles.len(), mesh.corners.len() - 2 * mesh.polygon_count());
}

/// What readers promise of a mesh file with normals and colours.
fn check_mesh_file(file: &MeshFile) {
    check_mesh(&file.mesh);
    let vertices = file.mesh.positions.len();
    assert!(file.normals.as_ref().is_none_or(|n| n.len() == vertices && finite(n)));
    assert!(file.colors.as_ref().is_none_or(|c| c.len() == vertices));
}

/// PLY.
pub fn ply(bytes: &[u8]) {
    match parse_ply(bytes, Path::new("fuzz.ply")) {
        Ok(file) => check_mesh_file(&file),
        Err(e) => check_error(e, "fuzz.ply"),
    }
}

/// OBJ.
pub fn obj(bytes: &[u8]) {
    match parse_obj(bytes, Path::new("fuzz.obj")) {
        Ok(mesh) => {
            check_mesh(&mesh);
            check_written(&mesh);
        }
        Err(e) => check_error(e, "fuzz.obj"),
    }
}

/// Written as OBJ, a mesh is read back: no name of it is a line of its own.
fn check_written(mesh: &PolygonMesh) {
    in_memory(|folder| {
        let path = folder.join("written.obj");
        write_obj(&path, mesh).expect("memory for a small file");
        let again = parse_obj(&std::fs::read(&path).expect("it was written"), &path).expect("what was written is read");
        assert_eq!((&again.positions, &again.starts, &again.corners), (&mesh.positions, &mesh.starts, &mesh.corners));
        let (ours, theirs) = (&mesh.metadata, &again.metadata);
        assert_eq!(theirs.statements.len(), ours.statements.len());
        assert_eq!(theirs.material_libraries.len(), ours.material_libraries.len());
        let _ = std::fs::remove_file(&path); // in memory, and written over by the next
    });
}

/// Text of a file, where it goes: one field of a table and no formula, one line, nothing hidden, no markup.
pub fn text(bytes: &[u8]) {
    let name = &*String::from_utf8_lossy(bytes);
    let field = text::csv_field(name);
    let inner = match field.strip_prefix('"').and_then(|f| f.strip_suffix('"')) {
        Some(inner) => {
            assert!(!inner.replace("\"\"", "").contains('"'), "{field:?}");
            inner.replace("\"\"", "\"")
        }
        None => {
            assert!(!field.contains([',', '"', '\n', '\r']), "{field:?}");
            field
        }
    };
    assert!(!inner.starts_with(['=', '+', '-', '@', '\t', '\r']) || name.parse::<f64>().is_ok(), "{inner:?}");
    if !name.contains(|c: char| c.is_control() && !matches!(c, '\n' | '\r' | '\t')) {
        assert_eq!(text::from_csv_field(&inner), name);
    }
    for line in [text::visible(name), text::short(name)] {
        assert!(!line.contains(text::is_hidden), "{line:?}");
    }
    assert!(!text::message(name).contains(|c| text::is_hidden(c) && c != '\n' && c != '\t'));
    let line = text::obj_line(name);
    assert!(!line.contains(|c: char| c.is_control()) && !line.ends_with('\\'), "{line:?}");
    assert!(!text::html(name).contains(['<', '>', '"']));
    let quoted = text::json(serde_json::Value::from(name).to_string());
    assert!(!quoted.contains(text::is_hidden));
    assert_eq!(serde_json::from_str::<serde_json::Value>(&quoted).expect("it is JSON"), name);
}

/// STL.
pub fn stl(bytes: &[u8]) {
    match parse_stl(bytes, Path::new("fuzz.stl")) {
        Ok(mesh) => {
            check_mesh(&mesh);
            assert!(mesh.polygon_count() > 0);
        }
        Err(e) => check_error(e, "fuzz.stl"),
    }
}

/// OFF.
pub fn off(bytes: &[u8]) {
    match parse_off(bytes, Path::new("fuzz.off")) {
        Ok(file) => check_mesh_file(&file),
        Err(e) => check_error(e, "fuzz.off"),
    }
}

/// XYZ.
pub fn xyz(bytes: &[u8]) {
    match parse_xyz(bytes, Path::new("fuzz.xyz")) {
        Ok(file) => {
            check_mesh_file(&file);
            assert!(file.normals.is_none() || file.colors.is_none());
        }
        Err(e) => check_error(e, "fuzz.xyz"),
    }
}

/// glTF: a container or JSON as it is, or JSON and the binary chunk of a container that is made of them.
pub fn gltf(bytes: &[u8]) {
    let files = files(bytes);
    let container = (!bytes.starts_with(b"glTF")).then(|| files.get(1).map(|binary| container_of(files[0], binary)));
    let bytes = container.flatten().unwrap_or_else(|| bytes.to_vec());
    // buffers beside it are in a folder that is not there
    match parse_gltf(&bytes, Path::new("fuzz.folder/fuzz.gltf")) {
        Ok(gltf) => {
            check_mesh(&gltf.mesh);
            check_written(&gltf.mesh);
            let (names, vertices) = (&gltf.target_names, gltf.mesh.positions.len());
            assert_eq!(gltf.target_deltas.len(), 3 * vertices * names.len());
            assert!(gltf.target_deltas.iter().all(|d| d.is_finite()));
            assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
        }
        Err(e) => check_error(e, "fuzz.folder"),
    }
}

fn container_of(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        let size = chunk.len().next_multiple_of(4);
        bytes.extend((size as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
        bytes.resize(bytes.len() + size - chunk.len(), b' ');
    }
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    bytes
}

/// NPY, read as numbers, as fewer rows of them and as truth values.
pub fn npy(bytes: &[u8]) {
    let parse = || NpyArray::parse(bytes, Path::new("fuzz.npy"));
    let array = match parse() {
        Ok(array) => array,
        Err(e) => return check_error(e, "fuzz.npy"),
    };
    let items = if array.shape().contains(&0) { 0 } else { array.shape().iter().product() };
    assert!(items <= bytes.len());
    assert_eq!(array.read_f64().map(|read| read.len()).ok(), Some(items));
    let rows = parse().and_then(|array| array.read_f32_rows(2));
    assert!(rows.is_ok_and(|read| read.len() <= items));
    match parse().and_then(NpyArray::read_bool) {
        Ok(read) => assert_eq!(read.len(), items),
        Err(e) => check_error(e, "fuzz.npy"),
    }
}

/// NPZ: the bytes as an archive, or as the content of an entry of a sound one whose size is what the first bytes claim.
pub fn npz(bytes: &[u8]) {
    let archive = match bytes.split_first_chunk::<5>() {
        Some(([b'e', size @ ..], content)) => zip_of(&[("a.npy", content, u32::from_le_bytes(*size))]),
        _ => bytes.to_vec(),
    };
    let mut npz = match Npz::from_reader(Cursor::new(archive), Path::new("fuzz.npz")) {
        Ok(npz) => npz,
        Err(e) => return check_error(e, "fuzz.npz"),
    };
    for name in npz.names() {
        if let Err(e) = npz.array(&name).and_then(NpyArray::read_f64) {
            check_error(e, "fuzz.npz");
        }
    }
    assert!(npz.array("no such name").is_err());
}

/// A zip archive of stored entries: name, content, and the size that it claims to have, or 0 for its own.
fn zip_of(entries: &[(&str, &[u8], u32)]) -> Vec<u8> {
    let (mut zip, mut directory) = (Vec::new(), Vec::new());
    for (name, content, size) in entries {
        let length = content.len() as u32;
        let claimed = if *size == 0 { length } else { *size };
        let crc = !content.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 })
        });
        // Version, flags, method, time, date; then sizes and the lengths of name and extra field.
        let mut common = Vec::new();
        [20u16, 0, 0, 0, 33].iter().for_each(|v| common.extend(v.to_le_bytes()));
        [crc, length, claimed].iter().for_each(|v| common.extend(v.to_le_bytes()));
        [name.len() as u16, 0].iter().for_each(|v| common.extend(v.to_le_bytes()));
        let at = zip.len() as u32;
        directory.extend([b"PK\x01\x02\x14\x00", &common[..], &[0; 10], &at.to_le_bytes(), name.as_bytes()].concat());
        zip.extend([b"PK\x03\x04", &common[..], name.as_bytes(), content].concat());
    }
    let count = (entries.len() as u16).to_le_bytes();
    let (start, length) = (zip.len() as u32, directory.len() as u32);
    zip.extend(directory);
    zip.extend([b"PK\x05\x06\0\0\0\0", &count[..], &count].concat());
    [length, start].iter().for_each(|v| zip.extend(v.to_le_bytes()));
    zip.extend([0, 0]);
    zip
}

/// The separator between the files of [`gltf`], [`landmarks`] and [`rig`].
const NEXT_FILE: &[u8] = b"\n===\n";

/// Parts between [`NEXT_FILE`]s.
fn files(bytes: &[u8]) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    let mut rest = bytes;
    while let Some(at) = rest.windows(NEXT_FILE.len()).position(|w| w == NEXT_FILE) {
        parts.push(&rest[..at]);
        rest = &rest[at + NEXT_FILE.len()..];
    }
    parts.push(rest);
    parts
}

/// Landmarks, and after a separator what their names mean on the template.
pub fn landmarks(bytes: &[u8]) {
    let positions = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec();
    let quad = PolygonMesh { positions, starts: vec![0, 4], corners: vec![0, 1, 2, 3], ..PolygonMesh::default() };
    // Its second triangle is of another file: no reader lets it through, a caller may.
    let scan = TriangleMesh { positions: quad.positions.clone(), triangles: vec![[0, 1, 2], [1, 2, 9]] };
    let files = files(bytes);
    let names = files.get(1).map(|bytes| (*bytes, Path::new("fuzz.names.json")));
    for scan in [None, Some(&scan)] {
        match parse_landmarks((files[0], Path::new("fuzz.json")), names, &quad, scan) {
            Ok(all) => {
                for landmark in all {
                    assert!(finite(&[landmark.target, landmark.template.position(&quad.positions)]));
                }
            }
            Err(e) => check_error(e, "fuzz."),
        }
    }
}

/// Names that stand for the formats of landmark files, and one that leaves it to the content.
const LANDMARK_FILES: [&str; 10] = [
    "fuzz.json",
    "fuzz.mrk.json",
    "fuzz.fcsv",
    "fuzz.csv",
    "fuzz.pp",
    "fuzz.pts",
    "fuzz.lm3",
    "fuzz.ljson",
    "fuzz.txt",
    "fuzz.landmarks",
];

/// A landmark file of any format: after one character, 0 to 9, that says of which. What is read can be written in the same
/// format, if that is one that holds it, and read again.
pub fn landmark_set(bytes: &[u8]) {
    let Some((digit, bytes)) = bytes.split_first() else { return };
    let name = LANDMARK_FILES[usize::from(digit.wrapping_sub(b'0')) % LANDMARK_FILES.len()];
    match parse_landmark_set(bytes, Path::new(name)) {
        Ok(set) => {
            check_landmarks(&set);
            in_memory(|folder| {
                let path = folder.join(name);
                match write_landmark_set(&path, &set, set.format) {
                    Ok(()) => {
                        let again = parse_landmark_set(&std::fs::read(&path).expect("it was written"), &path);
                        assert_eq!(again.map(|s| s.landmarks.len()).ok(), Some(set.landmarks.len()));
                        let _ = std::fs::remove_file(&path); // in memory, and written over by the next
                    }
                    Err(e) => check_error(e, name),
                }
            });
        }
        Err(e) => check_error(e, name),
    }
}

/// What readers promise of landmarks.
fn check_landmarks(set: &LandmarkSet) {
    let names = set.landmarks.iter().map(|l| &l.name).chain(&set.missing);
    assert_eq!(names.collect::<BTreeSet<_>>().len(), set.landmarks.len() + set.missing.len());
    for landmark in &set.landmarks {
        assert!(landmark.sigma.is_none_or(|s| s > 0.0 && s.is_finite()));
        match landmark.place {
            LandmarkPlace::Position(p) => assert!(finite(&[p])),
            LandmarkPlace::Face { barycentric: w, .. } => {
                assert!(w.iter().all(|x| *x >= 0.0) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-5, "{w:?}");
            }
            LandmarkPlace::Vertex(_) => {}
        }
    }
}

/// What the files of a rig folder are called: of arrays, and of meshes.
const RIG_FILES: [&[&str]; 2] = [
    &[
        "template.obj",
        "neutral.npy",
        "expression_deltas.npy",
        "expression_names.json",
        "identity_deltas.npy",
        "identity_names.json",
        "landmarks_multipie68.json",
        "regions.json",
    ],
    &["neutral.obj", "smile.obj", "jaw.ply", "template.obj", "rig.json", "regions.json"],
];

/// The arrays of a rig's archive.
const RIG_ARRAYS: [&str; 11] = [
    "neutral.npy",
    "expression_deltas.npy",
    "expression_names.npy",
    "identity_deltas.npy",
    "identity_names.npy",
    "polygon_starts.npy",
    "corners.npy",
    "uvs.npy",
    "corner_uvs.npy",
    "landmarks_multipie68.npy",
    "region_nose.npy",
];

/// A folder in memory, where the system has one; removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let memory = Path::new("/dev/shm");
        let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let name = format!("fuzz-{}-{:?}", std::process::id(), std::thread::current().id());
        let folder = parent.join(name);
        std::fs::create_dir_all(&folder).expect("a folder to write to");
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0); // what is left is in memory and named after this program
    }
}

/// Runs `work` with this thread's folder.
fn in_memory(work: impl FnOnce(&Path)) {
    thread_local!(static FOLDER: RefCell<Option<Folder>> = const { RefCell::new(None) });
    FOLDER.with_borrow_mut(|folder| work(&folder.get_or_insert_with(Folder::new).0));
}

/// A rig: after one byte that says whether it is an archive (2) and else of which layout, its files one after another; an
/// empty one is missing.
pub fn rig(bytes: &[u8]) {
    let Some((layout, bytes)) = bytes.split_first() else { return };
    let files = files(bytes);
    let there = |names: &'static [&'static str]| names.iter().zip(&files).filter(|(_, bytes)| !bytes.is_empty());
    in_memory(|folder| {
        let (path, written) = if *layout == 2 {
            let entries: Vec<(&str, &[u8], u32)> = there(&RIG_ARRAYS).map(|(name, bytes)| (*name, *bytes, 0)).collect();
            (folder.join("rig.npz"), vec![("rig.npz", zip_of(&entries))])
        } else {
            let names = RIG_FILES[usize::from(layout & 1)];
            (folder.to_owned(), there(names).map(|(name, bytes)| (*name, bytes.to_vec())).collect())
        };
        for (name, bytes) in &written {
            std::fs::write(folder.join(name), bytes).expect("memory for a small file");
        }
        match Rig::read(&path, &RigReadOptions::default()) {
            Ok((rig, _)) => check_rig(&rig),
            Err(e) => {
                let message = e.to_string();
                assert!(!message.is_empty() && message.len() < 4000, "{} bytes: {message}", message.len());
            }
        }
        for (name, _) in &written {
            std::fs::remove_file(folder.join(name)).expect("it was written");
        }
    });
}

fn check_rig(rig: &Rig) {
    let vertices = rig.neutral().len();
    assert!(finite(rig.neutral()) && rig.info().len() == rig.shapes().len());
    for k in 0..rig.shapes().len() {
        assert!(rig.deltas(k).len() == 3 * vertices && rig.deltas(k).iter().all(|d| d.is_finite()));
        assert_eq!(rig.find(&rig.shapes()[k].name).ok(), Some(k));
    }
    assert!(rig.landmarks().is_none_or(|l| l.iter().all(|v| (*v as usize) < vertices)));
    if let Some(mesh) = rig.mesh() {
        check_mesh(mesh);
    }
    if let Some(regions) = rig.regions() {
        let names: Vec<String> = regions.names().map(str::to_owned).collect();
        assert_eq!(regions.mask(&names).map(|mask| mask.len()).ok(), Some(vertices));
    }
    let selection = ShapeSelection { identity_modes: 1, ..ShapeSelection::default() };
    if let Ok(basis) = rig.select(selection) {
        assert!(basis.is_empty() || basis.vertex_count() == vertices);
    }
}

/// A schedule; one that is accepted reads back from what it is written as.
pub fn schedule(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Schedule::from_toml(text) {
        Ok(schedule) => {
            let written = toml::to_string(&schedule).expect("a schedule is TOML");
            // Tables that models and terms have not looked at may hold NaN, which equals nothing.
            let again = Schedule::from_toml(&written).expect("what was written is read");
            assert_eq!(toml::to_string(&again).expect("a schedule is TOML"), written);
            for model in ModelKind::ALL {
                if let Ok(resolved) = schedule.resolved(&model, &TERMS) {
                    assert_eq!(resolved.resolved(&model, &TERMS).as_ref(), Ok(&resolved), "{model}: {written}");
                }
            }
        }
        Err(e) => assert!(!e.to_string().is_empty()),
    }
}

/// A recipe of a morph.
pub fn recipe(bytes: &[u8]) {
    match Recipe::from_text(&String::from_utf8_lossy(bytes), "fuzz.toml") {
        Ok(recipe) => {
            assert!(!recipe.step.is_empty() && recipe.amount.is_finite());
            assert!(recipe.step.iter().all(|step| !step.get_ref().mask.is_empty()));
        }
        Err(e) => {
            check_error(&e, "fuzz.toml");
            assert!(!e.to_string().contains('\n'), "{e}");
        }
    }
}
