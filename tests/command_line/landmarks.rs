//! `nonrigid landmarks` on generated data.

use crate::support::{Bench, farthest};
use nonrigid::io::{PlyOptions, read_polygon_mesh, write_obj, write_ply};
use nonrigid::landmark::{read_landmark_set, read_template_landmarks};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use serde_json::Value;

const NUMBERED: &str = "rig/landmarks_multipie68.json";

fn positions(bench: &Bench, file: &str, mesh: &PolygonMesh) -> Vec<Vec3> {
    let path = bench.path(file);
    read_landmark_set(&path).unwrap().positions_on(&path, mesh).unwrap()
}

#[test]
fn the_68_go_through_every_format() {
    let bench = Bench::new();
    let mesh = &bench.rig.mesh;
    let truth = positions(&bench, NUMBERED, mesh);
    let mut before = NUMBERED.to_owned();
    for file in ["a.mrk.json", "b.pp", "c.fcsv", "d.csv", "e.ljson", "f.pts", "g.lm3", "h.txt", "i.json"] {
        let said = bench.done(&format!("landmarks convert {before} {file} --mesh rig/template.obj"));
        assert!(said.starts_with("68 landmarks, "), "{said}");
        assert!(farthest(&positions(&bench, file, mesh), &truth) < 1e-12, "{file}");
        before = file.to_owned();
    }
    bench.done(&format!("landmarks convert {before} wrap.json --format wrap --mesh rig/template.obj"));
    assert!(farthest(&positions(&bench, "wrap.json", mesh), &truth) < 1e-9);
    bench.done("landmarks convert wrap.json again.json --as vertex --mesh rig/template.obj");
    let again = read_template_landmarks(&bench.path("again.json"), mesh).unwrap();
    assert_eq!(again, read_template_landmarks(&bench.path(NUMBERED), mesh).unwrap());

    bench.done("landmarks convert a.mrk.json ras.fcsv --space ras");
    let ras = bench.text("ras.fcsv");
    assert!(ras.contains("CoordinateSystem = RAS") && farthest(&positions(&bench, "ras.fcsv", mesh), &truth) < 1e-12);
    let said = bench.done("landmarks convert ras.fcsv plain.csv --space ras");
    assert!(said.contains("unit mm, RAS brought to LPS -> csv"), "{said}");
    let turned: Vec<Vec3> = truth.iter().map(|p| Vec3::new(-p.x, -p.y, p.z)).collect();
    assert!(farthest(&positions(&bench, "plain.csv", mesh), &turned) < 1e-12);
    bench.done("landmarks convert d.csv metres.json --unit m");
    let large: Vec<Vec3> = truth.iter().map(|p| p * 1000.0).collect();
    assert!(farthest(&positions(&bench, "metres.json", mesh), &large) < 1e-6);
}

#[test]
fn a_check_finds_what_is_wrong() {
    let bench = Bench::new();
    let check = |file: &str, mesh: &str| {
        let run = bench.run(&format!("landmarks check {file} --mesh {mesh} --json"));
        let json: Value = serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{e}: {}", run.stderr));
        (run.code, json)
    };
    for file in [NUMBERED, "rig/landmarks_anthropometric.json"] {
        let (code, json) = check(file, "rig/template.obj");
        assert_eq!((code, &json["mirrored"]), (0, &Value::Bool(false)), "{json}");
        assert!(json["pairs"].as_u64().unwrap() >= 7);
    }
    let text = bench.done(&format!("landmarks check {NUMBERED} --mesh rig/template.obj"));
    assert!(text.contains("swapped, of 29 pairs: none"), "{text}");

    // All turned round: x against x.
    let flipped: Vec<Vec3> = bench.rig.neutral.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
    write_obj(&bench.path("mirrored.obj"), &bench.rig.mesh.with_positions(flipped)).unwrap();
    bench.done(&format!("landmarks convert {NUMBERED} points.json --format points --as position --mesh mirrored.obj"));
    let (code, json) = check("points.json", "rig/template.obj");
    assert_eq!((code, &json["mirrored"]), (4, &Value::Bool(true)), "{json}");

    // One pair swapped, one landmark off the surface, one twice.
    let set = bench.json(NUMBERED);
    let mut vertices: Vec<i64> = set.as_array().unwrap().iter().map(|v| v.as_i64().unwrap()).collect();
    vertices.swap(36, 45);
    vertices[28] = vertices[27];
    bench.write("wrong.json", format!("{vertices:?}"));
    bench.done("landmarks convert wrong.json wrong.csv --mesh rig/template.obj");
    let csv = bench.text("wrong.csv");
    let moved = |l: &str| if l.starts_with("30,") { "30,0,0,500\n".to_owned() } else { format!("{l}\n") };
    bench.write("wrong.csv", csv.lines().map(moved).collect::<String>());
    let (code, json) = check("wrong.csv", "rig/template.obj");
    assert_eq!(code, 4);
    assert_eq!(json["off"], serde_json::json!(["30"]));
    assert_eq!(json["duplicates"], serde_json::json!([["27", "28"]]));
    assert_eq!(json["swapped"], serde_json::json!([["36", "45"]]));
    assert_eq!(json["mirrored"], Value::Bool(false));
}

#[test]
fn landmarks_are_carried_by_polygons_and_by_closest_points() {
    let bench = Bench::new();
    let mesh = &bench.rig.mesh;
    write_obj(&bench.path("wrapped.obj"), &mesh.with_positions(bench.case.truth.clone())).unwrap();
    let truth = positions(&bench, NUMBERED, &mesh.with_positions(bench.case.truth.clone()));
    let carry = "landmarks transfer rig/landmarks_multipie68.json";
    bench.done(&format!("{carry} same.pp --from rig/template.obj --to wrapped.obj"));
    assert!(farthest(&positions(&bench, "same.pp", mesh), &truth) < 1e-9);

    let scan = "case/scan.ply";
    bench.done(&format!("{carry} on_scan.pp --from rig/template.obj --to {scan} --registered wrapped.obj"));
    let on_scan = positions(&bench, "on_scan.pp", mesh);
    let near = on_scan.iter().zip(&truth).filter(|(a, b)| (*a - *b).norm() < 1.0).count();
    assert!(near > 50, "{near} of 68 within a millimetre");

    let back = "landmarks transfer same.pp back.json --registered wrapped.obj --to rig/template.obj --as vertex";
    bench.done(&format!("{back} --from {scan}"));
    let again = read_template_landmarks(&bench.path("back.json"), mesh).unwrap();
    let expected = read_template_landmarks(&bench.path(NUMBERED), mesh).unwrap();
    assert!(again.iter().zip(&expected).filter(|(a, b)| a.1 == b.1).count() >= 66);

    let stderr = bench.ends(&format!("{carry} x.pp --from rig/template.obj --to {scan}"), 4);
    assert!(stderr.contains("do not correspond"), "{stderr}");

    // over a hole they move, and onto another place none of them belongs
    let TriangleMesh { mut positions, mut triangles } = read_polygon_mesh(&bench.path(scan)).unwrap().triangulate();
    triangles.retain(|t| t.iter().all(|v| (positions[*v as usize] - truth[30]).norm() > 15.0));
    for (file, shift) in [("holed.ply", Vec3::zeros()), ("elsewhere.ply", Vec3::new(0.0, 90.0, 40.0))] {
        positions.iter_mut().for_each(|p| *p += shift);
        let mesh = TriangleMesh { positions: positions.clone(), triangles: triangles.clone() };
        write_ply(&bench.path(file), &mesh, PlyOptions::default()).unwrap();
    }
    let onto = |mesh: &str, code| {
        bench.ends(&format!("{carry} y.pp --from rig/template.obj --to {mesh} --registered wrapped.obj"), code)
    };
    let said = onto("holed.ply", 0);
    assert!(said.contains("moved far to reach a surface, as over a hole: 30 by "), "{said}");
    let refused = onto("elsewhere.ply", 4);
    assert!(
        refused.contains("elsewhere.ply: most landmarks would move far") && refused.contains(" more; is it"),
        "{refused}"
    );
}

#[test]
fn mistakes_have_their_own_exit_codes() {
    let bench = Bench::new();
    for (arguments, code, hint) in [
        (format!("landmarks convert {NUMBERED} out.xml"), 1, "--format"),
        (format!("landmarks convert {NUMBERED} out.json --format morse"), 1, "morse"),
        (format!("landmarks convert {NUMBERED} out.json --unit inch"), 1, "inch"),
        (format!("landmarks convert {NUMBERED} out.json --as face"), 1, "--mesh"),
        (format!("landmarks convert {NUMBERED} out.pp"), 1, "--mesh: needed"),
        (format!("landmarks convert {NUMBERED} no/out.json"), 3, "no folder"),
        ("landmarks convert none.pp out.json".into(), 4, "none.pp"),
        (format!("landmarks check {NUMBERED} --mesh none.obj"), 4, "none.obj"),
    ] {
        let stderr = bench.ends(&arguments, code);
        assert!(stderr.contains(hint), "{arguments}: {stderr}");
    }
}
