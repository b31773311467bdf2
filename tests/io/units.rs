//! Inputs in metres, centimetres and micrometres give what they give in millimetres, whether their unit is found or stated.

use crate::support::{Bench, farthest, landmarks_json};
use nonrigid::io::{
    LengthUnit, PlyOptions, PlyPrecision, read_npy_points, read_polygon_mesh, write_npy_points, write_obj, write_ply,
};
use nonrigid::landmark::read_landmark_set;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::rig::{Rig, RigReadOptions};
use serde_json::Value;

/// The bench's inputs in other units: `in/<unit>/` has template.obj, scan.ply, marks.json, truth.npy and the folder rig.
fn bench() -> Bench {
    let bench = Bench::new();
    let (rig, _) = Rig::read(&bench.path("rig"), &RigReadOptions::default()).unwrap();
    for name in ["um", "mm", "cm", "m"] {
        let factor = 1.0 / name.parse::<LengthUnit>().unwrap().millimetres();
        let scaled = |points: &[Vec3]| -> Vec<Vec3> { points.iter().map(|p| p * factor).collect() };
        bench.write(&format!("in/{name}/rig/.keep"), "");
        let path = |file: &str| bench.path(&format!("in/{name}/{file}"));
        let mesh = &bench.rig.mesh;
        write_obj(&path("template.obj"), &mesh.with_positions(scaled(&mesh.positions))).unwrap();
        let mut scan = bench.case.scan.clone();
        scan.positions = scaled(&scan.positions);
        let options = PlyOptions { precision: PlyPrecision::Double, ..PlyOptions::default() };
        write_ply(&path("scan.ply"), &scan, options).unwrap();
        let marks: Vec<(u32, Vec3)> = bench.case.landmarks.iter().map(|(v, p)| (*v, p * factor)).collect();
        bench.write(&format!("in/{name}/marks.json"), landmarks_json(&marks));
        let truth = read_npy_points(&bench.path("case/truth.npy")).unwrap();
        write_npy_points(&path("truth.npy"), &scaled(&truth)).unwrap();
        let mut rig = rig.clone();
        rig.scale(factor);
        rig.write(&path("rig")).unwrap();
    }
    bench
}

fn result(bench: &Bench, name: &str) -> PolygonMesh {
    read_polygon_mesh(&bench.path(name)).unwrap()
}

/// What a command says of units.
fn units(stderr: &str) -> &str {
    stderr.lines().find_map(|line| line.strip_prefix("units: ")).unwrap_or_else(|| panic!("no units in {stderr:?}"))
}

#[test]
fn a_registration_finds_every_unit_and_reports_it() {
    let bench = bench();
    let run = |[template, rig, target]: [&str; 3], more: &str| {
        let line = format!(
            "register --template in/{template}/template.obj --rig in/{rig}/rig --identity-modes 5 --target in/{target}/scan.ply \
             --landmarks in/{target}/marks.json --model blendshape --out r.obj --report r.json {more}"
        );
        let stderr = bench.ends(&line, 0);
        let report = bench.json("r.json");
        (result(&bench, "r.obj").positions, units(&stderr).to_owned(), report["units"].clone())
    };
    let (truth, said, report) = run(["mm", "mm", "mm"], "");
    assert_eq!(
        said,
        "template mm (by its size), target mm (by its size), rig mm (by its size), landmarks mm (as its mesh)"
    );
    assert_eq!(report["landmarks"], serde_json::json!({ "unit": "mm", "by": "mesh" }));
    for inputs in [["cm", "m", "um"], ["m", "cm", "cm"], ["mm", "mm", "m"]] {
        let (positions, said, report) = run(inputs, "");
        for ((input, unit), also) in ["template", "rig", "target"].into_iter().zip(inputs).zip(["", "", "landmarks"]) {
            assert!(said.contains(&format!("{input} {unit} (by its size)")), "{said}");
            assert_eq!(report[input], serde_json::json!({ "unit": unit, "by": "size" }));
            assert!(also.is_empty() || report[also]["unit"] == unit, "{report}");
        }
        // 32 bits of a shape's differences are other bits in another unit
        let off = farthest(&positions, &truth);
        assert!(off < 1e-3, "{inputs:?}: {off}");
    }
    // stated, the template alone otherwise than the rest
    let (positions, said, _) = run(["cm", "mm", "mm"], "--unit mm,template=cm");
    assert!(said.starts_with("template cm (by --unit), target mm (by --unit), "), "{said}");
    assert!(farthest(&positions, &truth) < 1e-3);
    // marks in millimetres on a scan in metres
    std::fs::copy(bench.path("in/mm/marks.json"), bench.path("in/m/marks.json")).unwrap();
    let (positions, said, _) = run(["mm", "mm", "m"], "--unit landmarks=mm");
    assert!(said.ends_with("landmarks mm (by --unit)"), "{said}");
    assert!(farthest(&positions, &truth) < 1e-3);
}

#[test]
fn gltf_is_in_metres_unless_someone_knows_better() {
    let bench = bench();
    bench.done("rig convert --rig in/cm/rig --out rig.glb");
    let info = |options: &str| {
        let run = bench.run(&format!("rig info rig.glb --json {options}"));
        let info: Value = serde_json::from_str(&run.stdout).unwrap();
        (info[0]["max_displacement"].as_f64().unwrap(), units(&run.stderr).to_owned())
    };
    let (moved, said) = info("");
    assert_eq!(said, "rig m (as the file says)");
    let expected: Value = serde_json::from_str(&bench.done("rig info rig --json")).unwrap();
    let expected = expected[0]["max_displacement"].as_f64().unwrap();
    assert!((moved / expected - 1.0).abs() < 1e-5, "{moved} {expected}");
    let (small, said) = info("--unit cm");
    assert_eq!(said, "rig cm (by --unit)");
    assert!((100.0 * small / moved - 1.0).abs() < 1e-6, "{small} {moved}");
}

#[test]
fn every_other_command_does_as_well() {
    let bench = bench();
    let same = |mm: &str, other: &str| {
        let (mm, other) = (bench.done(mm), bench.done(other));
        assert_eq!(mm, other);
        mm
    };
    let text = same(
        "eval --result in/mm/truth.npy --template in/mm/template.obj --target in/mm/scan.ply",
        "eval --result in/m/truth.npy --template in/cm/template.obj --target in/um/scan.ply",
    );
    assert!(text.contains("median"), "{text}");
    same(
        "eval --result in/mm/truth.npy --template in/mm/template.obj --truth in/mm/truth.npy",
        "eval --result in/m/truth.npy --template in/cm/template.obj --truth in/m/truth.npy",
    );
    let measure = |unit: &str| {
        format!("measure --mesh in/{unit}/template.obj --landmarks rig/landmarks_anthropometric.json --rig rig")
    };
    same(&measure("mm"), &measure("m"));
    for unit in ["mm", "cm"] {
        bench.done(&format!(
            "morph --mesh in/{unit}/template.obj --landmarks rig/landmarks_multipie68.json --preset nose-bridge=2 --out {unit}.obj"
        ));
        bench.write(&format!("people_{unit}/.keep"), "");
        for (name, source) in [("a", "template.obj"), ("b", "truth.npy")] {
            let positions = match source {
                "truth.npy" => read_npy_points(&bench.path(&format!("in/{unit}/truth.npy"))).unwrap(),
                _ => result(&bench, &format!("in/{unit}/template.obj")).positions,
            };
            write_obj(&bench.path(&format!("people_{unit}/{name}.obj")), &bench.rig.mesh.with_positions(positions))
                .unwrap();
        }
        bench.done(&format!("rig pca --meshes people_{unit} --components 1 --out pca_{unit}"));
        bench.done(&format!("rig transfer --rig in/{unit}/rig --subject in/mm/truth.npy --out own_{unit}.npz"));
        bench.done(&format!("rig fit --rig in/mm/rig --meshes people_{unit} --out fit_{unit}.csv"));
        bench.done(&format!(
            "landmarks transfer in/{unit}/marks.json to_{unit}.json --as position --from people_mm/b.obj \
             --to in/{unit}/template.obj --unit landmarks={unit}"
        ));
    }
    let off = farthest(&result(&bench, "mm.obj").positions, &result(&bench, "cm.obj").positions);
    assert!(off < 1e-9, "morph: {off}");
    let neutral = |folder: &str| read_npy_points(&bench.path(&format!("{folder}/neutral.npy"))).unwrap();
    assert!(farthest(&neutral("pca_mm"), &neutral("pca_cm")) < 1e-9);
    let own = |unit: &str| Rig::read(&bench.path(&format!("own_{unit}.npz")), &RigReadOptions::default()).unwrap().0;
    let (mm, cm) = (own("mm"), own("cm"));
    let deltas = |rig: &Rig| (0..rig.shapes().len()).flat_map(|k| rig.deltas(k).to_vec()).collect::<Vec<f32>>();
    let off = deltas(&mm).iter().zip(deltas(&cm)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 1e-4, "transfer: {off}");
    let fitted = |unit: &str| bench.text(&format!("fit_{unit}.csv"));
    let numbers = |text: &str| -> Vec<f64> { text.split([',', '\n']).filter_map(|cell| cell.parse().ok()).collect() };
    let off = numbers(&fitted("mm")).iter().zip(numbers(&fitted("cm"))).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-9, "fit: {off}");
    let carried = |name: &str| {
        let path = bench.path(name);
        read_landmark_set(&path).unwrap().positions_on(&path, &bench.rig.mesh).unwrap()
    };
    let off = farthest(&carried("to_mm.json"), &carried("to_cm.json"));
    assert!(off < 1e-9, "landmarks: {off}");
}
