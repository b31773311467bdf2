//! `real-scans` on a folder of generated scans: what it leaves, and that one failure stops nothing else.

use std::fs;
use std::path::Path;

use crate::threads::on_threads;
use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use experiments::real_scans::{Arguments, RealScanRow, run};
use nonrigid::evaluation::MeshQuality;
use nonrigid::io::{read_polygon_mesh, read_scan, write_polygon_mesh};
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::registration::ModelKind;

/// A rig; a scan with landmarks, one that is no mesh, one that is out of reach.
fn data(folder: &Path) {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 20 });
    write_rig(&folder.join("rig"), &rig).unwrap();
    let options = ScanOptions { triangles: 20_000, ..ScanOptions::default() };
    let case = simulate_scan(&rig, &options, 7).unwrap();
    let [first, third] = ["anna/anna.ply", "cleo.obj"].map(|file| folder.join("scans").join(file));
    let made = folder.join("case");
    write_case(&made, &rig, &case, &Subject::new(&rig), 7).unwrap();
    fs::create_dir_all(first.parent().unwrap()).unwrap();
    fs::write(folder.join("scans/bert.stl"), "no mesh").unwrap();
    fs::copy(made.join("scan.ply"), &first).unwrap();
    fs::copy(made.join("landmarks.json"), first.with_file_name("landmarks.json")).unwrap();
    let scan = read_scan(&first).unwrap().mesh;
    let far = PolygonMesh {
        positions: scan.positions.iter().map(|p| p + Vec3::repeat(1e6)).collect(),
        starts: (0..=scan.triangles.len() as u32).map(|t| 3 * t).collect(),
        corners: scan.triangles.concat(),
        ..PolygonMesh::default()
    };
    write_polygon_mesh(&third, &far).unwrap();
}

fn arguments(folder: &Path, models: &[ModelKind], out: &str) -> Arguments {
    Arguments {
        scans: folder.join("scans"),
        rig: folder.join("rig"),
        identity_modes: Some(5),
        models: models.to_vec(),
        out: folder.join(out),
        threads: None,
    }
}

#[test]
fn one_failure_stops_nothing_else_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    data(folder);
    // Whether a scan a kilometre away is found is none of this test's business.
    let rows = run(&arguments(folder, &[ModelKind::Hybrid, ModelKind::Rigid], "two")).unwrap();
    let of = |scan: &str| rows.iter().filter(|r| r.scan == scan).collect::<Vec<&RealScanRow>>();
    assert_eq!(rows.len(), 6);
    let template = read_polygon_mesh(&folder.join("rig/template.obj")).unwrap();
    for row in of("anna") {
        let fit = row.fit.as_ref().unwrap_or_else(|| panic!("{row:?}"));
        assert!(fit.accepted > 0.5 && fit.iterations > 0 && row.error.is_none(), "{row:?}");
        let mesh = read_polygon_mesh(&folder.join(format!("two/anna/{}.obj", row.model))).unwrap();
        assert_eq!(fit.quality.mesh, MeshQuality::new(&template, &mesh.positions).unwrap());
    }
    let [hybrid, rigid] = of("anna")[..] else { panic!("{rows:?}") };
    let median = |row: &RealScanRow| row.fit.as_ref().unwrap().quality.to_scan.median;
    assert!(median(hybrid) < 0.5 && median(rigid) > 2.0 * median(hybrid), "{rows:?}");
    for row in of("bert") {
        assert!(row.fit.is_none() && row.error.as_ref().unwrap().contains("bert.stl"), "{row:?}");
    }
    for row in of("cleo") {
        assert!(row.fit.is_some() != row.error.is_some(), "{row:?}");
    }

    let csv = fs::read_to_string(folder.join("two/real-scans.csv")).unwrap();
    let header: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    assert_eq!(csv.lines().count(), 7);
    for column in
        ["accepted", "median", "self_intersections", "self_intersections_at_rest", "stretch_p1", "stretch_p99"]
    {
        let at = header.iter().position(|h| *h == column).unwrap_or_else(|| panic!("{column} is missing"));
        let field = csv.lines().nth(1).unwrap().split(',').nth(at).unwrap();
        assert!(field.parse::<f64>().is_ok(), "{column}: {field}");
    }
    assert!(csv.lines().all(|line| line.split(',').count() >= header.len()), "{csv}");
    let json: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("two/real-scans.json")).unwrap()).unwrap();
    assert_eq!(json["rows"].as_array().unwrap().len(), 6);
    assert!(json["rows"][0]["fit"]["self_intersections"].is_u64() && json["rows"][0]["error"].is_null());
    assert!(json["rows"][2]["fit"].is_null() && json["rows"][2]["error"].is_string());
    assert!(fs::read_to_string(folder.join("two/real-scans.timing.csv")).unwrap().lines().count() == 7);
}

#[test]
fn the_same_files_at_any_number_of_threads_and_any_number_of_columns() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    data(folder);
    for (out, threads) in [("one", 1), ("two", 2)] {
        on_threads(threads, || run(&arguments(folder, &[ModelKind::Similarity], out))).unwrap();
    }
    for name in ["real-scans.csv", "real-scans.json", "real-scans.png", "anna/similarity.obj"] {
        assert!(fs::read(folder.join("one").join(name)).unwrap() == fs::read(folder.join("two").join(name)).unwrap());
    }
    // Seven panels a scan: six across and one below.
    let quick = [
        ModelKind::Rigid,
        ModelKind::Similarity,
        ModelKind::Blendshape,
        ModelKind::Flame,
        ModelKind::Gpmm,
        ModelKind::GpmmRig,
    ];
    run(&arguments(folder, &quick, "many")).unwrap();
    // As many modes as a rig has, where nobody asks for a number.
    let few = Arguments { identity_modes: None, ..arguments(folder, &[ModelKind::Rigid], "few") };
    assert!(run(&few).is_ok());
    let more = Arguments { identity_modes: Some(21), ..few };
    let error = run(&more).unwrap_err().to_string();
    assert_eq!(error, "--identity-modes: 21 asked for, the rig has 20");
    let size = |out: &str| {
        let png = fs::read(folder.join(out).join("real-scans.png")).unwrap();
        [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap())) // width and height in IHDR
    };
    let ([_, narrow], [wide, high]) = (size("one"), size("many"));
    assert!((1800..2000).contains(&wide), "{wide}");
    assert!(high > narrow + 400, "{high} {narrow}");
}
