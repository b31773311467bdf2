//! Inputs that are made to do harm, or that do it by their shape: names that are more than names, files that come to far more than
//! their length, pipes and devices, meshes that are none of a rig. `docs/src/explanation/reliability.md` states the multiples that are tested here.

use std::fmt::Write as _;
use std::fs;
use std::process::{Command, Output};

use crate::awkward::quads;
use crate::refusal::{COMPUTATION, LOADING, all_hold, refuses};
use crate::support::Bench;
use nonrigid::io::{PlyOptions, parse_gltf, read_polygon_mesh, write_colored_mesh, write_obj, write_ply};
use nonrigid::landmark::{LandmarkFormat, parse_landmark_set, write_landmark_set};
use nonrigid::mesh::{ObjStatement, PolygonMesh, Vec3};
use nonrigid::rig::{Family, Rig, RigReadOptions, Shape};
use nonrigid::text::{LONGEST_NAME, is_hidden};
use serde_json::json;

const PROGRAM: &str = env!("CARGO_BIN_EXE_nonrigid");

/// Names that would be lines, commands or formulas of their own.
const HOSTILE: [&str; 6] = [
    "skin\nv 9 9 9\nf 1 2 3",
    "skin\r\nv 9 9 9",
    "skin\u{2028}v 9 9 9",
    "skin\\",
    "\u{1b}]0;title\u{7}\u{1b}[31m",
    "=cmd()|'/c calc'!A0",
];

/// The half of an ellipsoid of a face's size, as quads.
fn face(n: u32) -> PolygonMesh {
    quads(n, n, |c, r| {
        let [u, v] = [c, r].map(|i| 2.0 * i / f64::from(n - 1) - 1.0);
        Vec3::new(70.0 * u, 100.0 * v, 90.0 * (1.0 - (u * u + v * v) / 2.0).max(0.0).sqrt() + 6.0 * (5.0 * u + v).sin())
    })
}

/// The same with more vertices and polygons.
fn with(mesh: &PolygonMesh, points: &[Vec3], polygons: &[Vec<u32>]) -> PolygonMesh {
    let mut all = mesh.clone();
    let first = mesh.positions.len() as u32;
    all.positions.extend(points);
    for polygon in polygons {
        all.corners.extend(polygon.iter().map(|v| first + v));
        all.starts.push(all.corners.len() as u32);
    }
    all
}

#[test]
fn a_name_in_an_obj_file_is_never_a_line_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    let mesh = face(4);
    for name in HOSTILE {
        let mut named = mesh.clone();
        named.metadata.material_libraries = vec![name.into()];
        named.metadata.statements = vec![
            (0, ObjStatement::Object(name.into())),
            (0, ObjStatement::Material(name.into())),
            (2, ObjStatement::Group(name.into())),
            (9, ObjStatement::Smoothing(name.into())),
        ];
        for colors in [None, Some(&vec![[1u8, 2, 3]; 16][..])] {
            write_colored_mesh(&path, &named, colors).unwrap();
            let read = read_polygon_mesh(&path).unwrap();
            assert_eq!((&read.positions, &read.corners), (&mesh.positions, &mesh.corners), "{name:?}");
            assert_eq!(read.metadata.statements.len(), 4, "{name:?}");
            let text = fs::read_to_string(&path).unwrap();
            assert!(!text.contains(|c: char| c != '\n' && c.is_control() || c == '\u{2028}'), "{name:?}");
        }
    }
    // and ordinary ones are as they were
    for name in ["skin", "left eye (Größe)", "上唇", "a\\b", "50 %"] {
        let mut named = mesh.clone();
        named.metadata.statements = vec![(0, ObjStatement::Material(name.into()))];
        write_obj(&path, &named).unwrap();
        assert_eq!(read_polygon_mesh(&path).unwrap(), named);
    }
}

#[test]
fn a_material_of_a_gltf_file_puts_no_vertices_into_the_result() {
    let folder = tempfile::tempdir().unwrap();
    for name in HOSTILE {
        let document = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0, "name": name }],
            "meshes": [{ "name": name, "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }],
            "materials": [{ "name": name }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3 }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "buffers": [{ "byteLength": 36,
                "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }],
        });
        let mesh = parse_gltf(document.to_string().as_bytes(), "a.gltf".as_ref()).unwrap().mesh;
        assert!(!mesh.metadata.statements.is_empty(), "{name:?}");
        let path = folder.path().join("a.obj");
        write_obj(&path, &mesh).unwrap();
        let read = read_polygon_mesh(&path).unwrap();
        assert_eq!((read.positions, read.corners), (mesh.positions, mesh.corners), "{name:?}");
    }
}

#[test]
fn a_landmark_file_holds_a_name_as_it_is_or_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let formats = [
        ("a.json", LandmarkFormat::Native, true),
        ("a.csv", LandmarkFormat::Csv, false),
        ("a.fcsv", LandmarkFormat::SlicerFcsv, false),
        ("a.pp", LandmarkFormat::MeshLab, false),
        ("a.txt", LandmarkFormat::Text, false),
    ];
    for name in HOSTILE {
        let text = format!("{{{}: [1, 2, 3], \"other\": [4, 5, 6]}}", json!(name));
        let set = parse_landmark_set(text.as_bytes(), "in.json".as_ref()).unwrap();
        for (file, format, any) in &formats {
            let path = folder.path().join(file);
            match write_landmark_set(&path, &set, *format) {
                Err(error) => assert!(!any && error.to_string().contains(file), "{name:?}: {error}"),
                Ok(()) => {
                    let written = fs::read(&path).unwrap();
                    let again = parse_landmark_set(&written, &path).unwrap();
                    assert_eq!(again.landmarks[0].name, name, "{file}");
                    let text = String::from_utf8(written).unwrap();
                    assert!(*any || !name.contains(is_hidden), "{file}: {text}");
                    let formula = |cell: &str| cell.trim_start_matches('"').starts_with('=');
                    assert!(*file != "a.csv" || !text.lines().any(formula), "{text}");
                }
            }
        }
    }
}

/// A rig of `mesh` with shapes of these names that move parts of it.
fn rig(mesh: &PolygonMesh, names: &[&str]) -> Rig {
    let shapes = names.iter().map(|name| Shape { name: (*name).into(), family: Family::Expression }).collect();
    let count = mesh.positions.len();
    let delta = |k: usize, p: &Vec3| [0.0, 0.0, 4.0 * (0.03 * p.y + k as f64).sin()].map(|d| d as f32);
    let deltas = (0..names.len()).flat_map(|k| mesh.positions.iter().flat_map(move |p| delta(k, p))).collect();
    assert!(count > 0);
    Rig::new(mesh.positions.clone(), Some(mesh.clone()), shapes, deltas).unwrap().0
}

#[test]
fn terminals_and_tables_show_names_and_do_not_run_them() {
    let bench = Bench::of_size(300, 1000);
    let mesh = face(12);
    let escape = "\u{1b}]0;title\u{7}\u{9b}31m\u{202e}";
    rig(&mesh, &["=cmd()", "-1+1", escape]).write_npz(&bench.path("odd.npz")).unwrap();
    bench.write("frames/.keep", "");
    write_obj(&bench.path("frames/=frame.obj"), &mesh).unwrap();
    let shown = |run: &crate::support::Run| {
        let all = format!("{}{}", run.stdout, run.stderr);
        assert!(!all.contains(|c: char| is_hidden(c) && c != '\n'), "{all:?}");
        all
    };
    assert!(shown(&bench.run("rig info odd.npz")).contains("\\u{1b}]0;title"));
    let missing = bench.run("rig fit --rig odd.npz --shapes none --meshes frames --out w.csv");
    assert!(missing.code == 4 && shown(&missing).contains("did you mean"));
    let run = bench.run("rig fit --rig odd.npz --meshes frames --out w.csv");
    assert_eq!(run.code, 0, "{}", run.stderr);
    shown(&run);
    let table = bench.text("w.csv");
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let header: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    let cells: Vec<String> =
        reader.records().flat_map(|r| r.unwrap().iter().map(str::to_owned).collect::<Vec<_>>()).collect();
    assert_eq!(header[3..5], ["'=cmd()", "'-1+1"]);
    assert_eq!(cells[0], "'=frame");
    assert!(cells[1..].iter().all(|cell| cell.parse::<f64>().is_ok()), "{table}");
    let long = "x".repeat(5 * LONGEST_NAME);
    let shapes = vec![Shape { name: long.clone(), family: Family::Expression }];
    let deltas = vec![1.0; 3 * mesh.positions.len()];
    let error = Rig::new(mesh.positions.clone(), None, shapes, deltas).unwrap_err().to_string();
    assert!(error.contains("xxx...") && error.len() < 200, "{error}");
    bench.write("long.json", format!("{{\"{long}\": 3}}"));
    let stderr = bench.ends("landmarks check long.json --mesh frames/=frame.obj", 4);
    assert!(stderr.len() < 400, "{stderr}");
}

/// The program under a limit of so many kilobytes of addresses.
fn limited(bench: &Bench, kilobytes: usize, arguments: &str) -> Output {
    Command::new("sh")
        .args(["-c", &format!("ulimit -v {kilobytes} && exec \"$0\" {arguments}"), PROGRAM])
        .current_dir(bench.path(""))
        .output()
        .unwrap()
}

/// A ring of `n` corners as one polygon.
fn ring(n: u32) -> (Vec<Vec3>, Vec<Vec<u32>>) {
    let point = |i: u32| {
        let t = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        Vec3::new(80.0 * t.cos(), 100.0 * t.sin(), 100.0 + 10.0 * (3.0 * t).cos())
    };
    ((0..n).map(point).collect(), vec![(0..n).collect()])
}

/// Without bounds these come to 0.4 to 3.4 GB.
#[cfg(target_os = "linux")]
#[test]
fn memory_follows_the_file_and_not_the_shapes_in_it() {
    let bench = Bench::of_size(300, 1000);
    let face = face(40);
    write_obj(&bench.path("face.obj"), &face).unwrap();
    let (points, polygons) = ring(40_000);
    write_obj(&bench.path("ring.obj"), &with(&face, &points, &polygons)).unwrap();
    let (points, polygons) = ring(2_000);
    write_obj(&bench.path("small_ring.obj"), &with(&face, &points, &polygons)).unwrap();
    let slivers = |k: u32| {
        let y = -100.0 + f64::from(k) / 100.0;
        let z = 60.0 * (0.015 * y).cos();
        [Vec3::new(-75.0, y, z), Vec3::new(75.0, y, z), Vec3::new(75.0, y + 0.01, z)]
    };
    let points: Vec<Vec3> = (0..20_000).flat_map(slivers).collect();
    let polygons: Vec<Vec<u32>> = (0..20_000).map(|k| vec![3 * k, 3 * k + 1, 3 * k + 2]).collect();
    write_obj(&bench.path("slivers.obj"), &with(&face, &points, &polygons)).unwrap();
    let large =
        |k: u32| [[-300.0, 0.0], [300.0, 0.0], [0.0, 300.0]].map(|[x, y]| Vec3::new(x, y, f64::from(k) / 100.0));
    let points: Vec<Vec3> = (0..10_000).flat_map(large).collect();
    write_obj(&bench.path("large.obj"), &with(&face, &points, &polygons[..10_000])).unwrap();
    for arguments in [
        "register --template face.obj --target ring.obj --model rigid --out r.obj",
        "register --template face.obj --target slivers.obj --model rigid --out r.obj",
        "register --template face.obj --target large.obj --unit mm --model rigid --out r.obj",
        "register --template small_ring.obj --target face.obj --model graph --out r.obj",
        "eval --template small_ring.obj --result small_ring.obj --target small_ring.obj",
    ] {
        let run = limited(&bench, 700_000, arguments);
        let said = String::from_utf8_lossy(&run.stderr);
        // what cannot be placed may be refused, by a sentence
        let refused = matches!(run.status.code(), Some(COMPUTATION | LOADING)) && said.contains("error: ");
        assert!(run.status.success() || refused, "{arguments}: {} {said}", run.status);
        assert!(!said.contains("memory"), "{arguments}: {said}");
    }
}

#[test]
fn an_archive_unpacks_to_so_many_times_its_length_and_no_more() {
    let bench = Bench::of_size(300, 1000);
    let mesh = face(8);
    let bomb = |shapes: usize| -> Vec<u8> {
        let mut archive = zip::write::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let mut array = |name: &str, descr: &str, shape: &str, bytes: &[u8]| {
            let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
            while !(10 + header.len() + 1).is_multiple_of(64) {
                header.push(' ');
            }
            header.push('\n');
            let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
            archive.start_file(name, options).unwrap();
            let start = [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()];
            std::io::Write::write_all(&mut archive, &start.concat()).unwrap();
            std::io::Write::write_all(&mut archive, bytes).unwrap();
        };
        let neutral: Vec<u8> = mesh.positions.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f64::to_le_bytes).collect();
        array("neutral.npy", "<f8", "(64, 3)", &neutral);
        array("expression_deltas.npy", "<f4", &format!("({shapes}, 64, 3)"), &vec![0; shapes * 64 * 12]);
        let names: String = (0..shapes).map(|k| format!("{k:07}")).collect();
        let names: Vec<u8> = names.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
        array("expression_names.npy", "<U7", &format!("({shapes},)"), &names);
        archive.finish().unwrap().into_inner()
    };
    let (large, small) = (bomb(200_000), bomb(10_000));
    assert!(large.len() < 1_000_000, "{}", large.len());
    bench.write("bomb.npz", &large);
    bench.write("small.npz", &small);
    let stderr = bench.ends("rig info bomb.npz", LOADING);
    assert!(stderr.contains("bomb.npz/expression_deltas.npy") && stderr.contains("at most"), "{stderr}");
    bench.done("rig info small.npz");
}

#[test]
fn what_is_no_input_is_refused_by_what_is_seen() {
    let bench = Bench::of_size(600, 1000);
    let mesh = face(20);
    let (count, points) = (mesh.positions.len(), &mesh.positions);
    rig(&mesh, &["a", "b"]).write_npz(&bench.path("face.npz")).unwrap();
    let subject = |name: &str, change: &dyn Fn(usize, Vec3) -> Vec3| {
        bench.write(&format!("{name}/.keep"), "");
        let positions = points.iter().enumerate().map(|(i, p)| change(i, *p)).collect();
        write_obj(&bench.path(&format!("{name}/000.obj")), &mesh.with_positions(positions)).unwrap();
    };
    subject("shuffled", &|i, _| points[i * 7 % count]);
    subject("mirrored", &|_, p| Vec3::new(-p.x, p.y, p.z));
    subject("flat", &|_, p| Vec3::new(p.x, p.y, 0.0));
    subject("collapsed", &|i, p| if i % 3 == 0 { points[0] } else { p });
    subject("same", &|_, p| 1.2 * p);
    subject("inches", &|_, p| p / 25.4);
    subject("small", &|_, p| 0.55 * p / 10.0);
    subject("large_number", &|i, p| if i == 5 { Vec3::new(1e30, p.y, p.z) } else { p });
    let written = Rig::new(
        points.clone(),
        Some(mesh.clone()),
        vec![Shape { name: "smile".into(), family: Family::Expression }],
        (0..3 * count).map(|i| if i == 31 { 1e30 } else { 1.0 }).collect(),
    );
    let error = written.unwrap_err().to_string();
    assert!(error.contains("\"smile\"") && error.contains("vertex 10"), "{error}");
    bench.write("deltas/rig.json", "{\"kind\": \"delta\"}");
    write_obj(&bench.path("deltas/neutral.obj"), &mesh).unwrap();
    let far = points.iter().enumerate().map(|(i, _)| Vec3::repeat(if i == 10 { 1e9 } else { 1.0 })).collect();
    write_obj(&bench.path("deltas/smile.obj"), &mesh.with_positions(far)).unwrap();
    bench.write("piped/.keep", "");
    write_obj(&bench.path("piped/neutral.obj"), &mesh).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("piped/smile.obj")).status().unwrap().success());
    bench.write("marks.json", "{\"nasion\": 3, \"menton\": 5, \"pronasale\": 9}");
    // Rows of 20 vertices from left to right, from the chin up; the subject's left is on the side of larger x.
    let paired = |right: u32, left: u32| {
        format!("{{\"nasion\": 310, \"menton\": 70, \"cheilion_right\": {right}, \"cheilion_left\": {left}}}")
    };
    bench.write("paired.json", paired(126, 133));
    bench.write("swapped.json", paired(133, 126));
    bench.write("elsewhere.json", "{\"nasion\": [0, 50, 9000], \"menton\": [0, -70, 60]}");
    let rows: &[(&str, i32, &[&str])] = &[
        ("measure --mesh same/000.obj --landmarks swapped.json", LOADING, &["mirrored", "left and right"]),
        (
            "measure --mesh same/000.obj --landmarks elsewhere.json",
            LOADING,
            &["elsewhere.json", "\"nasion\"", "mm off the mesh", "--unit landmarks"],
        ),
        (
            "register --template shuffled/000.obj --rig face.npz --target same/000.obj --out o.obj",
            LOADING,
            &["face.npz", "the template", "mm rms", "order"],
        ),
        (
            "morph --mesh shuffled/000.obj --rig face.npz --landmarks paired.json --preset chin-forward=1 --out o.obj",
            LOADING,
            &["face.npz", "the mesh", "mm rms", "order"],
        ),
        (
            "rig transfer --rig face.npz --subject shuffled/000.obj --out o.npz",
            LOADING,
            &["shuffled/000.obj", "mm rms", "order"],
        ),
        (
            "rig transfer --rig face.npz --subject mirrored/000.obj --out o.npz",
            LOADING,
            &["mirrored/000.obj", "mirror image"],
        ),
        ("rig transfer --rig face.npz --subject flat/000.obj --out o.npz", LOADING, &["flat/000.obj", "flat", "0.0 %"]),
        (
            "rig transfer --rig face.npz --subject collapsed/000.obj --out o.npz",
            LOADING,
            &["collapsed/000.obj", "no area"],
        ),
        ("rig fit --rig face.npz --meshes shuffled --out o.csv", LOADING, &["shuffled/000.obj", "mm rms"]),
        ("rig fit --rig face.npz --meshes mirrored --out o.csv", LOADING, &["mirrored/000.obj", "mirror image"]),
        ("rig fit --rig face.npz --meshes flat --out o.csv", LOADING, &["flat/000.obj", "flat"]),
        ("measure --mesh inches/000.obj --landmarks marks.json", LOADING, &["in inches it would be", "--unit mesh=in"]),
        ("measure --mesh small/000.obj --landmarks marks.json", LOADING, &["in cm", "in in", "--unit mesh=cm"]),
        (
            "measure --mesh large_number/000.obj --landmarks marks.json",
            LOADING,
            &["large_number/000.obj", "1e12", "vertex 5"],
        ),
        ("rig info deltas", LOADING, &["\"smile\"", "vertex 10"]),
        ("rig info piped", LOADING, &["piped/smile.obj", "a regular file", "a pipe"]),
    ];
    let run = |(arguments, code, words): &(&str, i32, &[&str])| {
        refuses(PROGRAM, &bench.path(""), arguments, *code, words).err()
    };
    let faults: Vec<String> = rows.iter().filter_map(run).collect();
    all_hold(rows.len(), &faults);
    let stderr = bench.ends("rig transfer --rig face.npz --subject same/000.obj --out o.npz", 0);
    assert!(!stderr.contains("warning"), "{stderr}");
    bench.done("measure --mesh same/000.obj --landmarks paired.json");
    bench.done("measure --mesh inches/000.obj --landmarks marks.json --unit in");
    assert!(Rig::read(&bench.path("o.npz"), &RigReadOptions::default()).is_ok());
}

/// Vertices of no polygon have no say in sizes, units and poses: the result has the same bits.
#[test]
fn vertices_of_no_polygon_change_nothing() {
    let bench = Bench::of_size(300, 1000);
    let template = face(24);
    let mut scan = template.clone();
    scan.positions.iter_mut().for_each(|p| *p = Vec3::new(1.05 * p.x, p.y + 3.0, p.z - 2.0));
    let loose: Vec<Vec3> = (0..100_000).map(|i| Vec3::repeat(f64::from(i % 7000) - 3500.0)).collect();
    write_obj(&bench.path("template.obj"), &template).unwrap();
    write_ply(&bench.path("scan.ply"), &scan.triangulate(), PlyOptions::default()).unwrap();
    write_ply(&bench.path("loose.ply"), &with(&scan, &loose, &[]).triangulate(), PlyOptions::default()).unwrap();
    let result = |scan: &str| {
        bench.done(&format!("register --template template.obj --target {scan} --model similarity --out r.obj"));
        bench.read("r.obj")
    };
    assert!(result("scan.ply") == result("loose.ply"));
    write_obj(&bench.path("loose.obj"), &with(&template, &loose[..500], &[])).unwrap();
    bench.done("register --template loose.obj --target scan.ply --model rigid --out l.obj --report l.json");
    let of_loose = read_polygon_mesh(&bench.path("l.obj")).unwrap().positions;
    bench.done("register --template template.obj --target scan.ply --model rigid --out t.obj");
    let far = crate::support::farthest(&of_loose[..576], &read_polygon_mesh(&bench.path("t.obj")).unwrap().positions);
    assert!(far < 1e-3, "{far} mm");
}

#[test]
fn a_thousand_threads_are_as_many_as_are_of_use() {
    let bench = Bench::of_size(300, 1000);
    write_obj(&bench.path("face.obj"), &face(20)).unwrap();
    let run = |threads: usize| {
        let line =
            format!("register --template face.obj --target face.obj --model rigid --out r.obj --threads {threads}");
        let stderr = bench.ends(&line, 0);
        (bench.read("r.obj"), stderr)
    };
    let (one, quiet) = run(1);
    let (many, said) = run(1000);
    assert!(one == many && !quiet.contains("warning") && said.contains("warning: --threads 1000: this machine has"));
}

#[cfg(target_os = "linux")]
#[test]
fn folders_and_files_need_not_be_unicode() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt as _;
    let bench = Bench::of_size(300, 1000);
    let folder = bench.path("").join(OsStr::from_bytes(b"caf\xe9"));
    fs::create_dir(&folder).unwrap();
    let template = folder.join(OsStr::from_bytes(b"t\xe9.obj"));
    write_obj(&template, &face(20)).unwrap();
    write_obj(&folder.join("scan.obj"), &face(20)).unwrap();
    let mut list = String::from("target,model\n");
    writeln!(list, "scan.obj,rigid").unwrap();
    fs::write(folder.join("list.csv"), list).unwrap();
    let run = |arguments: &[&OsStr]| {
        let output = Command::new(PROGRAM).args(arguments).current_dir(bench.path("")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let (list, out) = (folder.join("list.csv"), folder.join("out"));
    let all: [&OsStr; 6] =
        ["batch".as_ref(), list.as_ref(), "--out".as_ref(), out.as_ref(), "--template".as_ref(), template.as_ref()];
    run(&all);
    assert!(out.join("scan.obj").is_file());
}
