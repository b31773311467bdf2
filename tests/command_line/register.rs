//! The program on generated data: what it writes, prints and promises.

use std::path::Path;

use crate::awkward::quads;
use crate::closed_stdout::minds_a_full_disk_only;
use crate::support::{Bench, farthest, landmarks_json};
use data_gen::{FaceRig, write_rig};
use nalgebra::{Rotation3, Unit};
use nonrigid::evaluation::{LandmarkErrors, MeshQuality, SurfaceDistances, TruthErrors};
use nonrigid::io::{
    NpyArray, PlyOptions, PlyPrecision, read_npy_mask, read_npy_points, read_polygon_mesh, read_scan, write_npy,
    write_npy_points, write_obj, write_ply, write_polygon_mesh,
};
use nonrigid::landmark::read_landmarks;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::{ModelKind, WITHIN_MM};
use serde_json::Value;
use sha2::{Digest, Sha256};

const TEMPLATE: &str = "--template rig/template.obj";
const FIT: &str = "register --template rig/template.obj --neutral case/neutral.npy --rig rig";
const INPUTS: &str = "--target case/scan.ply --landmarks case/landmarks.json";

fn json(bytes: impl AsRef<[u8]>) -> Value {
    serde_json::from_slice(bytes.as_ref()).unwrap()
}

fn picture(path: &Path) -> image::RgbImage {
    image::open(path).unwrap().to_rgb8()
}

/// Writes what scanning gives without losing a bit.
fn write_scan(path: &Path, scan: &TriangleMesh) {
    write_ply(path, scan, PlyOptions { precision: PlyPrecision::Double, ..PlyOptions::default() }).unwrap();
}

#[test]
fn every_model_keeps_the_templates_topology() {
    let bench = Bench::new();
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    assert!(template.metadata.uvs.len() >= template.positions.len() && template.metadata.statements.len() > 4);
    for model in ModelKind::ALL {
        let printed = bench.done(&format!("{FIT} {INPUTS} --model {model} --out {model}.obj"));
        assert!(
            printed.starts_with(&format!("{model}: ")) && printed.contains(&format!("wrote {model}.obj")),
            "{printed}"
        );
        let mut result = read_polygon_mesh(&bench.path(&format!("{model}.obj"))).unwrap();
        assert_eq!(result.metadata.material_libraries, [format!("{model}.mtl")]);
        result.metadata.material_libraries.clone_from(&template.metadata.material_libraries);
        assert!(farthest(&result.positions, &template.positions) > 1.0, "{model} moves nothing");
        assert_eq!(PolygonMesh { positions: template.positions.clone(), ..result }, template, "{model}");
    }
    bench.done(&format!("{FIT} {INPUTS} --out hybrid.ply"));
    let (ply, obj) =
        (read_polygon_mesh(&bench.path("hybrid.ply")).unwrap(), read_polygon_mesh(&bench.path("hybrid.obj")).unwrap());
    assert_eq!((ply.positions, ply.starts, ply.corners), (obj.positions, obj.starts, obj.corners));
}

#[test]
fn materials_that_stay_behind_are_said() {
    let bench = Bench::new();
    let rows = [("rig/template.obj", "a.glb", true), ("a.glb", "b.obj", true), ("rig/template.obj", "c.obj", false)];
    for (template, out, behind) in rows {
        let arguments =
            format!("register --template {template} {INPUTS} --model rigid --unit landmarks=mm --out {out}");
        let stderr = bench.ends(&arguments, 0);
        assert_eq!(stderr.contains(&format!("stay with {template}")), behind, "{out}: {stderr}");
    }
    // a file that nobody named, and no run of ours made, stays
    bench.write("d.mtl", "mine");
    let stderr = bench.ends(&format!("register --template rig/template.obj {INPUTS} --model rigid --out d.obj"), 3);
    assert!(stderr.contains("d.mtl: is there already"), "{stderr}");
    assert_eq!(bench.read("d.mtl"), b"mine");
    // one that a run of ours made is known when its result was deleted
    std::fs::remove_file(bench.path("c.obj")).unwrap();
    let again = format!("register --template rig/template.obj {INPUTS} --model rigid --out c.obj");
    bench.done(&again);
    std::fs::remove_file(bench.path("c.obj")).unwrap();
    bench.write("c.mtl", [bench.read("c.mtl"), b"# mine\n".to_vec()].concat());
    assert!(bench.ends(&again, 3).contains("c.mtl: is there already"));
    // what a glTF notes of an OBJ's libraries is not beside the result
    assert!(read_polygon_mesh(&bench.path("b.obj")).unwrap().metadata.material_libraries.is_empty());
}

#[test]
fn options_of_shapes_are_said_where_the_model_has_none() {
    let said = |model: &str| {
        let bench = Bench::new();
        let options = "--shapes jawOpen --expression-bounds 0,1 --identity-bounds=-3,3";
        bench.run(&format!("{FIT} {INPUTS} {options} --model {model} --out a.obj")).stderr
    };
    let arap = said("arap");
    for option in ["shapes", "expression-bounds", "identity-bounds"] {
        assert!(arap.contains(&format!("--{option} has no effect: --model arap")), "{arap}");
    }
    assert!(!said("hybrid").contains("no effect"));
}

#[test]
fn a_template_whose_corners_are_all_its_own_stays_together() {
    let bench = Bench::new();
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let corners: Vec<u32> = template.corners.clone();
    let soup = PolygonMesh {
        positions: corners.iter().map(|&v| template.positions[v as usize]).collect(),
        corners: (0..corners.len() as u32).collect(),
        metadata: ObjMetadata::default(),
        ..template
    };
    write_obj(&bench.path("soup.obj"), &soup).unwrap();
    let stderr = bench.ends("register --template soup.obj --target case/scan.ply --out s.obj --report s.json", 0);
    let twice = corners.len() - template.positions.len();
    assert!(stderr.contains(&format!("{twice} vertices of the template stand where another does")), "{stderr}");
    assert_eq!(bench.json("s.json")["template_repair"]["sewn"], twice);
    let result = read_polygon_mesh(&bench.path("s.obj")).unwrap().positions;
    let mut at = vec![None; template.positions.len()];
    for (&v, p) in corners.iter().zip(&result) {
        assert_eq!(*at[v as usize].get_or_insert(p), p, "vertex {v}");
    }
}

#[test]
fn a_few_wild_vertices_make_a_result_doubtful() {
    let bench = Bench::new();
    let mut neutral = bench.rig.neutral.clone();
    neutral.iter_mut().step_by(97).for_each(|p| p.z += 40.0);
    write_npy_points(&bench.path("wild.npy"), &neutral).unwrap();
    let fit = FIT.replace("case/neutral.npy", "wild.npy");
    let stderr = bench.ends(&format!("{fit} {INPUTS} --out wild.obj --report wild.json"), 0);
    assert_eq!(stderr.matches("stand out from their neighbours").count(), 2, "{stderr}"); // the neutral; the result
    let report = bench.json("wild.json");
    assert!(report["error_probability"].as_f64().unwrap() >= 0.5);
    assert_eq!(report["doubts"][0]["sign"], "spikes");
    let [wrong, size] = [&report["wrong_mm"], &report["evidence"]["size"]].map(|length| length.as_f64().unwrap());
    assert!((wrong - 3.0 / 67.0 * size).abs() < 1e-12, "{wrong} {size}");
}

#[test]
fn a_result_is_divided_and_its_finer_vertices_go_to_the_scan() {
    let bench = Bench::new();
    let printed = bench.done(&format!("{FIT} {INPUTS} --subdivide 2 --out fine.obj --report fine.json"));
    assert!(printed.contains("divided: "), "{printed}");
    bench.done("rig subdivide --rig rig --rounds 2 --out finer");
    let modes = |rig: &str| {
        let names = std::fs::read_to_string(bench.path(&format!("{rig}/identity_names.json"))).unwrap();
        serde_json::from_str::<Vec<String>>(&names).unwrap()
    };
    assert!(!modes("rig").is_empty() && modes("finer") == modes("rig"));
    let (fine, rest) = (
        read_polygon_mesh(&bench.path("fine.obj")).unwrap(),
        read_polygon_mesh(&bench.path("finer/template.obj")).unwrap(),
    );
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    assert_eq!(fine.polygon_count(), 4 * template.corners.len());
    assert_eq!((&fine.starts, &fine.corners), (&rest.starts, &rest.corners));
    let libraries = |mesh: &PolygonMesh| mesh.metadata.material_libraries.clone();
    assert_eq!((libraries(&fine), libraries(&rest)), (vec!["fine.mtl".to_owned()], vec!["template.mtl".to_owned()]));
    assert_eq!(fine.metadata.statements, rest.metadata.statements);
    assert_eq!((&fine.metadata.uvs, &fine.metadata.corner_uvs), (&rest.metadata.uvs, &rest.metadata.corner_uvs));
    assert_eq!(fine.metadata.corner_uvs.len(), fine.corners.len());
    let detail = &json(std::fs::read(bench.path("fine.json")).unwrap())["detail"];
    assert_eq!(detail["vertices"], fine.positions.len());
    let median = |when: &str| detail[when]["median_within"].as_f64().unwrap();
    assert!(median("quality") < 0.7 * median("before"), "{detail}");
    let flipped = |when: &str| detail[when]["flipped"].as_u64().unwrap();
    assert!(flipped("quality") <= flipped("before") + 4, "{detail}");
    // The divided rig is a rig: the divided result's rest shape registers with its shapes.
    let fitted = bench.done(&format!(
        "register --template finer/template.obj --rig finer {INPUTS} --model blendshape --out again.obj"
    ));
    assert!(fitted.contains("wrote again.obj"), "{fitted}");
}

#[test]
fn times_and_a_picture_are_written() {
    let bench = Bench::new();
    bench.done(&format!("{FIT} {INPUTS} --threads 1 --out r.obj --report r.json --picture r.png"));
    let timing = bench.json("r.timing.json");
    assert_eq!(timing["threads"], 1);
    assert!(timing["total_seconds"].as_f64().unwrap() > 0.0);
    let sheet = picture(&bench.path("r.png"));
    assert!(sheet.width() >= 800 && sheet.height() >= 400, "{} x {}", sheet.width(), sheet.height());
    let first = *sheet.get_pixel(0, 0);
    let drawn = sheet.pixels().filter(|p| **p != first).count();
    assert!(drawn * 20 > sheet.pixels().len(), "{drawn} pixels differ from the background");
}

#[test]
fn an_unknown_subject_is_explained_by_identity_modes_and_one_with_a_neutral_is_not() {
    let bench = Bench::new();
    let weights = |options: &str| {
        bench.done(&format!("{options} {INPUTS} --model blendshape --out r.obj --report r.json"));
        bench.json("r.json")["weights"].as_array().unwrap().len()
    };
    let expressions = bench.rig.expressions.len();
    let modes = bench.rig.identities.len();
    assert!(modes > 0);
    assert_eq!(weights(FIT), expressions);
    assert_eq!(weights(&FIT.replace(" --neutral case/neutral.npy", "")), expressions + modes);
    assert_eq!(weights(&FIT.replace(" --neutral case/neutral.npy", " --identity-modes 0")), expressions);
}

#[test]
fn the_report_says_what_was_read_done_and_reached() {
    let bench = Bench::new();
    let printed = bench.done(&format!("{FIT} {INPUTS} --identity-modes 2 --out r.obj --report r.json"));
    let report = bench.json("r.json");
    for key in [
        "version",
        "model",
        "inputs",
        "schedule",
        "start",
        "stop",
        "inliers",
        "unobserved_directions",
        "quality",
        "weights",
        "history",
    ] {
        assert!(!report[key].is_null(), "the report has no {key}");
    }
    assert_eq!((report["model"].as_str(), report["stop"].as_str()), (Some("hybrid"), Some("finished")));
    assert_eq!(report["weights"].as_array().unwrap().len(), bench.rig.expressions.len() + 2);
    assert!(report["schedule"]["level"].as_array().unwrap().len() > 1);
    for key in ["to_scan", "median_within", "flipped", "self_intersections", "self_intersections_at_rest", "stretch"] {
        assert!(!report["quality"][key].is_null(), "the quality has no {key}");
    }
    let neutral = read_npy_points(&bench.path("case/neutral.npy")).unwrap();
    let result = read_polygon_mesh(&bench.path("r.obj")).unwrap();
    let quality = MeshQuality::new(&result.with_positions(neutral), &result.positions).unwrap();
    assert_eq!(report["quality"]["self_intersections"], quality.self_intersections);
    assert_eq!(report["quality"]["self_intersections_at_rest"], quality.self_intersections_at_rest);
    assert_eq!(report["quality"]["stretch"]["edges"], quality.stretch.edges);
    let said = format!("self-intersections: {} pairs of triangles (at rest", quality.self_intersections);
    assert!(printed.contains(&said) && printed.contains("edge stretch: median"), "{printed}");
    let last = report["history"].as_array().unwrap().last().unwrap();
    let parts: f64 = last["energies"].as_array().unwrap().iter().map(|e| e[1].as_f64().unwrap()).sum();
    let total = last["energy"].as_f64().unwrap();
    assert!((parts - total).abs() <= 1e-9 * total, "the named energies sum to {parts}, the energy is {total}");
    assert_eq!(last["inliers"], report["inliers"]);

    let inputs = report["inputs"].as_array().unwrap();
    for (role, file) in [
        ("template", "rig/template.obj"),
        ("target", "case/scan.ply"),
        ("neutral", "case/neutral.npy"),
        ("landmarks", "case/landmarks.json"),
        ("rig", "rig/expression_deltas.npy"),
    ] {
        let name = Path::new(file).file_name().unwrap().to_str().unwrap();
        let entry = inputs.iter().find(|i| i["role"] == role && i["name"] == name).unwrap_or_else(|| panic!("{role}"));
        let hash: String = Sha256::digest(bench.read(file)).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(entry["sha256"], Value::from(hash), "{role}");
    }
}

#[test]
fn bounds_hold_weights_and_the_report_says_which() {
    let bench = Bench::new();
    let fit = |options: &str| {
        let printed = bench.done(&format!("{FIT} {INPUTS} --identity-modes 2 {options} --out r.obj --report r.json"));
        (printed, bench.json("r.json"))
    };
    let weights = |report: &Value| report["weights"].as_array().unwrap().clone();
    let (printed, report) = fit("");
    assert!(!printed.contains("bound"), "{printed}");
    for weight in weights(&report) {
        assert!(weight["std_dev"].as_f64().unwrap() > 0.0 && weight["at_bound"] == false, "{weight}");
    }
    for options in [
        "--expression-bounds 0,0.25 --identity-bounds=-0.5,0.5",
        "--identity-bounds -0.5,0.5 --expression-bounds 0,0.25",
    ] {
        let (printed, report) = fit(options);
        assert_eq!(report["schedule"]["bounds"]["identity"], serde_json::json!([-0.5, 0.5]));
        let mut held = 0;
        for weight in weights(&report) {
            let identity = weight["name"].as_str().unwrap().starts_with("identity");
            let [lower, upper] = if identity { [-0.5, 0.5] } else { [0.0, 0.25] };
            let value = weight["value"].as_f64().unwrap();
            assert!((lower..=upper).contains(&value), "{weight}");
            assert_eq!(weight["at_bound"], value == lower || value == upper, "{weight}");
            assert_eq!(weight["std_dev"].is_null(), value == lower || value == upper, "{weight}");
            held += usize::from(value == lower || value == upper);
        }
        assert!(
            held > 0 && printed.contains(&format!("{held} of {} weights are at a bound", weights(&report).len())),
            "{printed}"
        );
    }
}

#[test]
fn a_schedule_file_steers_the_run_and_is_reported() {
    let bench = Bench::new();
    let text = "reference_size = 67.0\nreference_vertices = 6706\n[model]\nnodes = 40\n[stop]\nenergy = 0.0\nmotion = 0.0\n\
        [[level]]\nsteps = 3\nmodel = { lambda_graph = 7.0 }\nkernel = { cauchy = { delta = 2.0 } }\ndistance_cap = 20.0\nnormal_angle = 50.0\n";
    bench.write("mine.toml", text);
    let stderr = bench.ends(&format!("{FIT} {INPUTS} --model graph --config mine.toml --out r.obj --report r.json"), 0);
    assert!(!stderr.contains("no effect"), "{stderr}");
    let report = bench.json("r.json");
    assert_eq!(report["history"].as_array().unwrap().len(), 3);
    assert_eq!(report["schedule"]["model"]["nodes"], 40);
    assert_eq!(report["schedule"]["level"][0]["model"]["lambda_graph"], 7.0);
    assert!(report["inputs"].as_array().unwrap().iter().any(|i| i["role"] == "schedule" && i["name"] == "mine.toml"));
    let idle =
        text.replace("nodes = 40", "nodes = 40\ncoarse_nodes = 9").replace("7.0 }", "7.0, lambda_rotation = 2.0 }");
    bench.write("mine.toml", idle);
    let stderr = bench.ends(&format!("{FIT} {INPUTS} --model graph --config mine.toml --out r.obj"), 0);
    for key in ["coarse_nodes has no effect: no level", "lambda_rotation has no effect: rigid"] {
        assert!(stderr.contains(&format!("warning: mine.toml: model: {key}")), "{stderr}");
    }
}

#[test]
fn names_of_a_list_may_have_spaces_after_the_commas() {
    let bench = Bench::new();
    for (option, list) in [("--shapes", "jawOpen, wart"), ("--regions", "nose, wart"), ("--free-regions", "nose ,wart")]
    {
        let run = std::process::Command::new(env!("CARGO_BIN_EXE_nonrigid"))
            .args(format!("{FIT} {INPUTS} --out r.obj").split_whitespace().chain([option, list]))
            .current_dir(bench.path(""))
            .output()
            .unwrap();
        let said = String::from_utf8(run.stderr).unwrap();
        assert!(said.contains("\"wart\"") && !said.contains("jawOpen\"") && !said.contains("\"nose\""), "{said}");
    }
}

#[test]
fn eval_prints_what_the_library_computes_from_truth() {
    let bench = Bench::new();
    bench.done(&format!("{FIT} {INPUTS} --model blendshape --out r.obj"));
    let result = read_polygon_mesh(&bench.path("r.obj")).unwrap();
    let truth = read_npy_points(&bench.path("case/truth.npy")).unwrap();
    let seen = read_npy_mask(&bench.path("case/observed.npy"), None).unwrap();
    let triangles = result.triangulate().triangles;
    let all = vec![true; seen.len()];
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let quality = MeshQuality::new(&template, &result.positions).unwrap();
    for (option, mask) in [("--observed case/observed.npy", &seen), ("", &all)] {
        let (expected, _) = TruthErrors::new(&result.positions, &truth, mask, &triangles).unwrap();
        let command = format!("eval --result r.obj {TEMPLATE} --truth case/truth.npy {option}");
        let printed = bench.done(&format!("{command} --json"));
        assert_eq!(json(printed), merged(&expected, &quality));
        let text = bench.done(&command);
        for number in [expected.rmse, expected.normal, expected.tangential, expected.median, expected.p95, expected.max]
        {
            assert!(text.contains(&format!("{number:.4}")), "{text}: {number}");
        }
        assert!(text.contains(&format!("{} triangles flipped against the truth", expected.flipped)), "{text}");
        let unobserved = expected.unobserved.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.4}"));
        assert_eq!(expected.unobserved.is_some(), mask.contains(&false));
        assert!(text.contains(&format!("; unobserved {unobserved}; ")), "{text}");
        assert!(text.contains(&quality.to_string()), "{text}");
    }
    // The result as an array is the same result.
    write_npy_points(&bench.path("r.npy"), &result.positions).unwrap();
    let by = |file: &str| bench.done(&format!("eval --result {file} {TEMPLATE} --truth case/truth.npy --json"));
    assert_eq!(by("r.npy"), by("r.obj"));
    // The truth itself has no error.
    let none = json(bench.done(&format!("eval --result case/truth.npy {TEMPLATE} --truth case/truth.npy --json")));
    assert_eq!((none["max"].as_f64(), none["flipped"].as_u64()), (Some(0.0), Some(0)));
    // The right half of the face turned into the left one, which the template does not do.
    let mut folded = template.clone();
    folded.positions.iter_mut().for_each(|p| p.x = p.x.abs());
    write_obj(&bench.path("folded.obj"), &folded).unwrap();
    let folded = json(by("folded.obj"));
    assert_eq!(folded["self_intersections_at_rest"], 0, "the generated face has none");
    assert!(folded["self_intersections"].as_u64().unwrap() > 100, "{folded}");
}

#[test]
fn eval_without_truth_measures_both_ways_to_the_scan() {
    let bench = Bench::new();
    bench.done(&format!("{FIT} {INPUTS} --out r.obj"));
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let result = read_polygon_mesh(&bench.path("r.obj")).unwrap();
    let scan = read_scan(&bench.path("case/scan.ply")).unwrap().mesh;
    let between = |from: &[Vec3], to: &TriangleMesh| -> Vec<f64> {
        let surface = ClosestPoint::new(to).unwrap();
        from.iter().map(|p| surface.query(p).unwrap().squared_distance.sqrt()).collect()
    };
    let (forth, back) = (between(&result.positions, &scan), between(&scan.positions, &result.triangulate()));
    let distances = SurfaceDistances::from_distances(&forth, &back, WITHIN_MM);
    let quality = MeshQuality::new(&template, &result.positions).unwrap();
    let command = format!("eval --result r.obj {TEMPLATE} --target case/scan.ply");
    let printed = json(bench.done(&format!("{command} --json")));
    assert_eq!(printed, merged(&distances, &quality));
    let text = bench.done(&command);
    assert!(text.contains(&format!("result to scan: median {:.4}", distances.result_to_scan.median)), "{text}");
    assert!(text.contains(&format!("scan to result: median {:.4}", distances.scan_to_result.median)), "{text}");
    assert!(text.contains(&quality.to_string()), "{text}");
}

/// Alone, and beside what the scan says; of the landmarks of the case, whose truth is the template's vertices.
#[test]
fn eval_measures_landmarks_by_name() {
    let bench = Bench::new();
    bench.done(&format!("{FIT} {INPUTS} --out r.obj"));
    let (template, result) =
        (read_polygon_mesh(&bench.path("rig/template.obj")).unwrap(), read_polygon_mesh(&bench.path("r.obj")).unwrap());
    let landmarks = read_landmarks(&bench.path("case/landmarks.json"), None, &template, None).unwrap();
    let errors = LandmarkErrors::new(&landmarks, &result.positions, WITHIN_MM);
    let command = format!("eval --result r.obj {TEMPLATE} --landmarks case/landmarks.json");
    let alone = json(bench.done(&format!("{command} --json")));
    assert_eq!(alone["landmarks"], json(serde_json::to_string(&errors).unwrap()));
    assert!(alone["self_intersections"].is_u64() && alone["rmse"].is_null(), "{alone}");
    let text = bench.done(&command);
    let summary = errors.summary;
    let expected = format!("{} landmarks: rms {:.4} mm, median {:.4}, ", summary.count, summary.rms, summary.median);
    assert!(text.starts_with(&expected) && text.contains(&format!("({})", errors.each[0].name)), "{text}");
    let beside = json(bench.done(&format!("{command} --target case/scan.ply --json")));
    assert_eq!(beside["landmarks"], alone["landmarks"]);
    assert!(beside["result_to_scan"]["median"].is_f64(), "{beside}");
}

/// The fields of both in one JSON object.
fn merged(a: &impl serde::Serialize, b: &impl serde::Serialize) -> serde_json::Value {
    let [mut a, b] = [serde_json::to_string(a), serde_json::to_string(b)].map(|text| json(text.unwrap()));
    b.as_object().unwrap().iter().for_each(|(key, value)| a[key] = value.clone());
    a
}

#[test]
fn heat_maps_are_pictures_that_show_the_error() {
    let bench = Bench::new();
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let mut bent = template.clone();
    bent.positions.iter_mut().filter(|p| p.x > 20.0).for_each(|p| p.z += 4.0);
    write_obj(&bench.path("bent.obj"), &bent).unwrap();
    for (result, out) in [("rig/template.obj", "none.png"), ("bent.obj", "some.png")] {
        bench.done(&format!("eval --result {result} {TEMPLATE} --truth rig/neutral.npy --heatmap {out}"));
    }
    let (none, some) = (picture(&bench.path("none.png")), picture(&bench.path("some.png")));
    assert!(some.width() >= 640 && some.height() >= 320);
    // Numbers beside the colour bar may make one wider.
    assert_eq!(none.height(), some.height());
    let pixels = (0..none.height()).flat_map(|y| (0..none.width().min(some.width())).map(move |x| (x, y)));
    let different = pixels.filter(|(x, y)| none.get_pixel(*x, *y) != some.get_pixel(*x, *y)).count();
    assert!(different > 5000, "only {different} pixels show the error");
}

#[test]
fn rig_info_lists_what_each_layout_holds() {
    let bench = Bench::new();
    let info = json(bench.done("rig info rig --json"));
    let list = info.as_array().unwrap();
    let expressions = bench.rig.expressions.len();
    assert_eq!(list.len(), expressions + 8);
    assert_eq!((&list[0]["name"], &list[0]["family"]), (&"browDown_L".into(), &"expression".into()));
    assert_eq!(list[expressions]["family"], "identity");
    for (entry, (name, delta)) in list.iter().zip(&bench.rig.expressions) {
        let largest = delta.iter().map(|d| d.norm()).fold(0.0, f64::max);
        assert!((entry["max_displacement"].as_f64().unwrap() - largest).abs() < 1e-5, "{name}");
    }
    let text = bench.done("rig info rig");
    assert!(text.starts_with(&format!("{} vertices, {} shapes\n", bench.rig.neutral.len(), expressions + 8)), "{text}");
    assert!(bench.rig.expressions.iter().all(|e| text.contains(&e.0)));

    // The same expressions as one mesh a shape: whole shapes, differences that say so themselves, and by option.
    let at = |positions: Vec<Vec3>| PolygonMesh { positions, ..bench.rig.mesh.clone() };
    for folder in ["full", "delta", "told"] {
        bench.write(&format!("{folder}/keep.txt"), "");
        write_obj(&bench.path(&format!("{folder}/neutral.obj")), &bench.rig.mesh).unwrap();
        for (name, delta) in &bench.rig.expressions {
            let whole = bench.rig.neutral.iter().zip(delta).map(|(n, d)| n + d).collect();
            let shape = if folder == "full" { whole } else { delta.clone() };
            write_obj(&bench.path(&format!("{folder}/{name}.obj")), &at(shape)).unwrap();
        }
    }
    bench.write("delta/rig.json", "{\"kind\": \"delta\"}");
    write_obj(&bench.path("full/still.obj"), &bench.rig.mesh).unwrap();
    let run = bench.run("rig info full --json");
    assert!(run.code == 0 && run.stderr.starts_with("warning: ") && run.stderr.contains("\"still\""), "{}", run.stderr);
    let mut expected = list[..expressions].to_vec();
    expected.sort_by_key(|e| e["name"].as_str().unwrap().to_owned());
    for (command, found) in [
        ("full", json(run.stdout)),
        ("delta", json(bench.done("rig info delta --json"))),
        ("told", json(bench.done("rig info told --shape-kind delta --json"))),
    ] {
        let found = found.as_array().unwrap();
        assert_eq!(found.len(), expressions, "{command}");
        for (a, b) in found.iter().zip(&expected) {
            assert_eq!((&a["name"], &a["family"]), (&b["name"], &"other".into()), "{command}");
            let [far, near] = [a, b].map(|e| e["max_displacement"].as_f64().unwrap());
            assert!((far - near).abs() < 1e-5, "{command} {}: {far} {near}", a["name"]);
        }
    }
    // And it can be registered with: the differences are those of the arrays, in another order.
    let arguments = format!("{INPUTS} --model blendshape --neutral case/neutral.npy {TEMPLATE}");
    bench.done(&format!("register {arguments} --rig rig --out arrays.obj"));
    bench.done(&format!("register {arguments} --rig delta --out meshes.obj"));
    let [arrays, meshes] =
        ["arrays", "meshes"].map(|n| read_polygon_mesh(&bench.path(&format!("{n}.obj"))).unwrap().positions);
    assert!(farthest(&arrays, &meshes) < 1e-6, "{}", farthest(&arrays, &meshes));
}

/// A bumpy sheet of 15 x 15 vertices with UVs and a group, differing in three ways from its like.
fn sheet(weights: [f64; 3]) -> PolygonMesh {
    let place = |i: f64| i / 7.0 - 1.0;
    let mut mesh = quads(15, 15, |c, r| {
        let (x, y) = (place(c), place(r));
        let depth = 15.0 * (3.0 * x).cos() * (2.0 * y).cos() + 6.0 * (5.0 * x * y + x).sin();
        let ways = [4.0 * (x * x - y), 3.0 * (2.0 * x + y).sin(), 2.0 * x * y];
        let moved: f64 = ways.iter().zip(weights).map(|(way, w)| way * w).sum();
        Vec3::new(50.0 * x, 50.0 * y, depth + moved)
    });
    mesh.metadata.uvs = (0..15 * 15).map(|i| [i % 15, i / 15].map(|k| place(f64::from(k)))).collect();
    mesh.metadata.corner_uvs.clone_from(&mesh.corners);
    mesh.metadata.statements.push((0, ObjStatement::Group("skin".into())));
    mesh
}

#[test]
fn rig_pca_makes_a_rig_that_register_reads() {
    let bench = Bench::new();
    bench.write("meshes/readme.txt", "not a mesh");
    let random = |i: usize| ((i as f64 + 1.0) * 78.233).sin() * 43_758.545;
    let number = |i: usize| 2.0 * random(i).rem_euclid(1.0) - 1.0;
    for i in 0..14 {
        let mut mesh = sheet([0, 1, 2].map(|k| number(10 * i + k)));
        // As scans lie: anywhere. The first one stays, and with it the rig.
        if i > 0 {
            let turn = Rotation3::from_euler_angles(number(10 * i + 3), number(10 * i + 4), number(10 * i + 5));
            let shift = Vec3::new(number(10 * i + 6), number(10 * i + 7), number(10 * i + 8)) * 300.0;
            mesh.positions.iter_mut().for_each(|p| *p = turn * *p + shift);
        }
        let path = bench.path(&format!("meshes/{i:02}.{}", if i % 5 == 4 { "ply" } else { "obj" }));
        write_polygon_mesh(&path, &mesh).unwrap();
    }
    let printed = bench.done("rig pca --meshes meshes --components 3 --out pca");
    assert!(printed.starts_with("14 meshes of 225 vertices, aligned by rigid motions"), "{printed}");
    let last = printed.lines().find(|l| l.starts_with("identity002")).unwrap();
    let together: f64 = last.split_whitespace().last().unwrap().parse().unwrap();
    assert!(together > 99.5, "{printed}");
    assert!(printed.ends_with("wrote pca\n"), "{printed}");
    let files = crate::support::files_in(&bench.path("pca"));
    let expected = [
        "components.npy",
        "identity_deltas.npy",
        "identity_names.json",
        "neutral.npy",
        "standard_deviations.npy",
        "template.obj",
    ];
    assert_eq!(files, expected);
    // The mean has everything of the first mesh but its positions; modes are components by standard deviations.
    let template = read_polygon_mesh(&bench.path("pca/template.obj")).unwrap();
    let first = read_polygon_mesh(&bench.path("meshes/00.obj")).unwrap();
    assert_eq!(first.with_positions(template.positions.clone()), template);
    assert_eq!(read_npy_points(&bench.path("pca/neutral.npy")).unwrap(), template.positions);
    let numbers = |name: &str| NpyArray::open(&bench.path(name)).unwrap().read_f64().unwrap();
    let (components, modes) = (numbers("pca/components.npy"), numbers("pca/identity_deltas.npy"));
    let sigmas = numbers("pca/standard_deviations.npy");
    assert_eq!((components.len(), modes.len(), sigmas.len()), (3 * 225 * 3, 3 * 225 * 3, 3));
    for (i, (c, m)) in components.iter().zip(&modes).enumerate() {
        assert!((c * sigmas[i / 675] - m).abs() < 1e-5, "{i}");
    }
    let info = json(bench.done("rig info pca --json"));
    assert!(info.as_array().unwrap().len() == 3 && info[0]["family"] == "identity", "{info}");

    // A person who was not among them, wrapped with the modes alone.
    let person = sheet([0.4, -0.7, 0.6]);
    write_scan(&bench.path("scan.ply"), &person.triangulate());
    let marks: Vec<(u32, Vec3)> = [0, 14, 112, 210, 224].map(|v| (v, person.positions[v as usize])).to_vec();
    bench.write("marks.json", landmarks_json(&marks));
    let fit = "register --template pca/template.obj --target scan.ply --landmarks marks.json --model";
    bench.done(&format!("{fit} blendshape --rig pca --identity-modes 3 --out wrapped.obj"));
    bench.done(&format!("{fit} rigid --out rigid.obj"));
    let off = |name: &str| farthest(&read_polygon_mesh(&bench.path(name)).unwrap().positions, &person.positions);
    assert!(off("wrapped.obj") < 0.3 && off("rigid.obj") > 2.0, "{} {}", off("wrapped.obj"), off("rigid.obj"));

    // In the same folder again; and not aligned, where pose is most of what differs.
    bench.done("rig pca --meshes meshes --components 5 --align similarity --out pca");
    assert_eq!(numbers("pca/standard_deviations.npy").len(), 5);
    bench.done("rig pca --meshes meshes --components 2 --align none --out rig2");
    assert!(numbers("rig2/standard_deviations.npy")[0] > 20.0 * sigmas[0]);
    assert_eq!(crate::support::files_in(&bench.path("pca")), expected);
}

/// A triangle of the mesh with this vertex, and u and v at its place in it.
fn corner_of(triangles: &[[u32; 3]], vertex: u32) -> (usize, f64, f64) {
    let triangle = triangles.iter().position(|t| t.contains(&vertex)).unwrap();
    match triangles[triangle].iter().position(|v| *v == vertex).unwrap() {
        0 => (triangle, 1.0, 0.0),
        1 => (triangle, 0.0, 1.0),
        _ => (triangle, 0.0, 0.0),
    }
}

#[test]
fn all_forms_of_landmarks_mean_the_same() {
    let bench = Bench::new();
    let scan = read_scan(&bench.path("case/scan.ply")).unwrap().mesh;
    let template = bench.rig.mesh.triangulate();
    let name = |v: u32| &bench.rig.landmarks.iter().find(|l| l.vertex == v).unwrap().name;
    // Where a scan triangle has its point two to one to one between the corners, near the landmark.
    let on_scan: Vec<(u32, usize, Vec3)> = bench
        .case
        .landmarks
        .iter()
        .map(|(vertex, near)| {
            let middle = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| scan.positions[v as usize]);
                a * 0.5 + b * 0.25 + c * 0.25
            };
            let distance = |t: &usize| (middle(&scan.triangles[*t]) - near).norm();
            let t = (0..scan.triangles.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
            (*vertex, t, middle(&scan.triangles[t]))
        })
        .collect();
    let object = |entries: Vec<String>| format!("{{{}}}", entries.join(", "));
    let points: Vec<(u32, Vec3)> = on_scan.iter().map(|(v, _, p)| (*v, *p)).collect();
    bench.write("vertices.json", landmarks_json(&points));
    let named = |(v, p): &(u32, Vec3)| format!("\"{}\": [{:?}, {:?}, {:?}]", name(*v), p.x, p.y, p.z);
    bench.write("named.json", object(points.iter().map(named).collect()));
    let wrap = |(v, t, _): &(u32, usize, Vec3)| format!("\"{}\": [{t}, 0.5, 0.25]", name(*v));
    bench.write("wrap.json", object(on_scan.iter().map(wrap).collect()));
    let corner = |(v, _): &(u32, Vec3)| {
        let (t, a, b) = corner_of(&template.triangles, *v);
        format!("\"{}\": [{t}, {a:?}, {b:?}]", name(*v))
    };
    bench.write("corners.json", object(points.iter().map(corner).collect()));
    let near = |(v, _): &(u32, Vec3)| {
        let p = bench.rig.neutral[*v as usize];
        format!("\"{}\": [{:?}, {:?}, {:?}]", name(*v), p.x + 0.01, p.y - 0.01, p.z + 0.01)
    };
    bench.write("snapped.json", object(points.iter().map(near).collect()));

    let fit = |landmarks: &str| -> Vec<Vec3> {
        bench.done(&format!("{FIT} --target case/scan.ply --landmarks {landmarks} --out r.obj"));
        read_polygon_mesh(&bench.path("r.obj")).unwrap().positions
    };
    let expected = fit("vertices.json");
    for form in [
        "named.json --template-landmarks rig/landmarks.json",
        "wrap.json --template-landmarks rig/landmarks.json",
        "wrap.json --template-landmarks corners.json",
        "named.json --template-landmarks snapped.json",
    ] {
        let distance = farthest(&fit(form), &expected);
        assert!(distance < 1e-6, "{form}: {distance}");
    }
}

#[test]
fn a_landmark_inside_a_face_pulls_the_face() {
    let bench = Bench::new();
    let triangles = bench.rig.mesh.triangulate().triangles;
    // Middles of triangles whose vertices are observed, and where they truly are.
    let chosen: Vec<usize> = (0..triangles.len())
        .step_by(triangles.len() / 24)
        .filter(|t| triangles[*t].iter().all(|v| bench.case.observed[*v as usize]))
        .collect();
    assert!(chosen.len() > 12);
    let third = 1.0 / 3.0;
    let middle = |t: usize, at: &[Vec3]| triangles[t].iter().map(|v| at[*v as usize]).sum::<Vec3>() * third;
    let list = |entry: &dyn Fn(usize) -> String| {
        let entries: Vec<String> = chosen.iter().map(|&t| format!("\"p{t}\": {}", entry(t))).collect();
        format!("{{{}}}", entries.join(", "))
    };
    let target = |t: usize| {
        let p = middle(t, &bench.case.truth);
        format!("[{:?}, {:?}, {:?}]", p.x, p.y, p.z)
    };
    bench.write("targets.json", list(&target));
    bench.write("faces.json", list(&|t| format!("[{t}, {third}, {third}]")));
    // Landmarks that outweigh the scan.
    bench.write(
        "pull.toml",
        "reference_size = 67.0\nreference_vertices = 6706\n[[level]]\nsteps = 10\nmodel = { lambda_graph = 0.1 }\nterms.point_to_plane = { weight = 1e-6 }\n\
         terms.landmarks = { weight = 1e4 }\nkernel = { huber = { delta = 3.0 } }\ndistance_cap = 25.0\nnormal_angle = 60.0\n",
    );
    bench.done(
        "register --template rig/template.obj --target case/scan.ply --landmarks targets.json --template-landmarks faces.json \
         --model graph --config pull.toml --out r.obj",
    );
    let result = read_polygon_mesh(&bench.path("r.obj")).unwrap().positions;
    for &t in &chosen {
        let distance = (middle(t, &result) - middle(t, &bench.case.truth)).norm();
        assert!(distance < 0.01, "triangle {t}: {distance}");
    }
}

#[test]
fn a_moved_scan_gives_the_moved_result() {
    let bench = Bench::new();
    let axis = Unit::new_normalize(Vec3::new(0.3, -0.8, 0.5));
    let turn = Rotation3::from_axis_angle(&axis, 25f64.to_radians());
    let shift = Vec3::new(2.0, 5.0, -4.0).normalize() * 60.0;
    let moved = |p: &Vec3| turn * p + shift;
    let still = |p: &Vec3| *p;
    let fit = |place: &dyn Fn(&Vec3) -> Vec3| -> Vec<Vec3> {
        let scan = TriangleMesh {
            positions: bench.case.scan.positions.iter().map(place).collect(),
            triangles: bench.case.scan.triangles.clone(),
        };
        write_scan(&bench.path("scan.ply"), &scan);
        let landmarks: Vec<(u32, Vec3)> = bench.case.landmarks.iter().map(|(v, p)| (*v, place(p))).collect();
        bench.write("landmarks.json", landmarks_json(&landmarks));
        bench.done(&format!("{FIT} --target scan.ply --landmarks landmarks.json --out r.obj"));
        read_polygon_mesh(&bench.path("r.obj")).unwrap().positions
    };
    let expected: Vec<Vec3> = fit(&still).iter().map(moved).collect();
    let distance = farthest(&fit(&moved), &expected);
    assert!(distance < 1e-6, "{distance}");
}

/// Everything in another unit of length.
fn scaled_rig(rig: &FaceRig, unit: f64) -> FaceRig {
    let mut rig = rig.clone();
    let shapes = rig.expressions.iter_mut().flat_map(|e| &mut e.1).chain(rig.identities.iter_mut().flatten());
    shapes.chain(&mut rig.neutral).chain(&mut rig.mesh.positions).for_each(|p| *p *= unit);
    rig
}

#[test]
fn lengths_scale_with_the_model() {
    let mut bench = Bench::new();
    // Rounding must not decide between equals, so the face may not be its own mirror image.
    let crooked: Vec<Vec3> = (0..bench.rig.neutral.len())
        .map(|i| bench.rig.neutral[i] + Vec3::new(1.7, 2.3, 3.1).map(|f| 0.2 * (f * i as f64).sin()))
        .collect();
    bench.rig.neutral.clone_from(&crooked);
    bench.rig.mesh.positions = crooked;
    let fit = |name: &str, unit: f64, model: &str| -> Vec<Vec3> {
        write_rig(&bench.path(name), &scaled_rig(&bench.rig, unit)).unwrap();
        let mut scan = bench.case.scan.clone();
        scan.positions.iter_mut().for_each(|p| *p *= unit);
        write_scan(&bench.path(&format!("{name}/scan.ply")), &scan);
        let landmarks: Vec<(u32, Vec3)> = bench.case.landmarks.iter().map(|(v, p)| (*v, p * unit)).collect();
        bench.write(&format!("{name}/marks.json"), landmarks_json(&landmarks));
        bench.done(&format!(
            "register --template {name}/template.obj --rig {name} --identity-modes 5 --target {name}/scan.ply \
             --landmarks {name}/marks.json --model {model} --unit mm --out r.obj"
        ));
        read_polygon_mesh(&bench.path("r.obj")).unwrap().positions.iter().map(|p| p / unit).collect()
    };
    // As if metres were millimetres; the graph, because 32 bits of a shape's differences are other bits in metres.
    let distance = farthest(&fit("metres", 1e-3, "graph"), &fit("millimetres", 1.0, "graph"));
    assert!(distance < 1e-6, "graph in metres: {distance}");
    // A unit of 1024 mm only moves the exponents.
    let distance = farthest(&fit("large", 1.0 / 1024.0, "hybrid"), &fit("small", 1.0, "hybrid"));
    assert!(distance < 1e-9, "hybrid in units of 1024 mm: {distance}");
}

#[test]
fn help_and_version_are_successes() {
    let bench = Bench::new();
    assert!(bench.done("--version").contains(env!("CARGO_PKG_VERSION")));
    assert!(bench.done("--help").contains("Exit codes"));
    for command in ["register", "eval", "rig info", "rig pca"] {
        assert!(bench.done(&format!("{command} --help")).contains("Usage"), "{command}");
    }
}

/// Writes the scan's vertices with normals, and no faces.
fn write_cloud(bench: &Bench, name: &str) {
    let scan = &bench.case.scan;
    let normals = vertex_normals(&scan.positions, &scan.triangles, NormalWeighting::Area);
    let cloud = TriangleMesh { triangles: Vec::new(), ..scan.clone() };
    let options = PlyOptions { normals: Some(&normals), precision: PlyPrecision::Double, ..PlyOptions::default() };
    write_ply(&bench.path(name), &cloud, options).unwrap();
}

#[test]
fn a_point_cloud_with_normals_is_a_target() {
    // Points as dense as a scanner's: between those of a coarse cloud, planes say little of the surface.
    let bench = Bench::of_size(3000, 40_000);
    write_cloud(&bench, "cloud.ply");
    let rmse = |target: &str| {
        let options = format!("--target {target} --landmarks case/landmarks.json --picture r.png --report r.json");
        let printed = bench.done(&format!("{FIT} {options} --out r.obj"));
        assert!(printed.contains("% of the vertices accepted"), "{printed}");
        let truth = "--truth case/truth.npy --observed case/observed.npy";
        let errors = json(bench.done(&format!("eval --result r.obj {TEMPLATE} {truth} --json")));
        errors["rmse"].as_f64().unwrap()
    };
    let (mesh, quality) = (rmse("case/scan.ply"), bench.json("r.json")["quality"].clone());
    let (cloud, of_cloud) = (rmse("cloud.ply"), bench.json("r.json")["quality"].clone());
    assert!(cloud < 1.2 * mesh + 0.05, "mesh {mesh} mm, cloud {cloud} mm");
    let median = |quality: &Value| quality["median_within"].as_f64().unwrap();
    assert!((median(&quality) - median(&of_cloud)).abs() < 0.1, "{quality}\n{of_cloud}");
    let drawn = picture(&bench.path("r.png"));
    assert!(drawn.pixels().filter(|p| p.0 == [86, 140, 196]).count() > 1000, "no points of the scan in the picture");
    let fit = |target: &str| {
        let line = format!("eval --result case/truth.npy {TEMPLATE} --target {target} --json --heatmap {target}.png");
        json(bench.done(&line))
    };
    bench.write("case/keep", "");
    let (on_mesh, on_cloud) = (fit("case/scan.ply"), fit("cloud.ply"));
    for (way, number) in [("result_to_scan", "median"), ("scan_to_result", "median"), ("result_to_scan", "p90")] {
        let [a, b] = [&on_mesh, &on_cloud].map(|v| v[way][number].as_f64().unwrap());
        assert!((a - b).abs() < 0.1 + 0.1 * a, "{way} {number}: {a} {b}");
    }
}

#[test]
fn masks_and_regions_say_where_the_scan_counts() {
    let bench = Bench::new();
    let vertices = bench.rig.neutral.len();
    let of = |name: &str| &bench.rig.regions.iter().find(|r| r.0 == name).unwrap().1;
    let in_nose = |value: f64, other: f64| {
        let mut mask = vec![other; vertices];
        of("nose").iter().for_each(|&v| mask[v as usize] = value);
        mask
    };
    write_npy(&bench.path("nose.npy"), &[vertices], &in_nose(1.0, 0.0)).unwrap();
    write_npy(&bench.path("not_nose.npy"), &[vertices], &in_nose(0.0, 1.0)).unwrap();
    write_npy(&bench.path("half.npy"), &[vertices], &vec![0.5f32; vertices]).unwrap();
    write_npy(&bench.path("ones.npy"), &[vertices], &vec![true; vertices]).unwrap();
    let fit = |options: &str| {
        bench.done(&format!("{FIT} {INPUTS} {options} --out r.obj --report r.json"));
        (read_polygon_mesh(&bench.path("r.obj")).unwrap().positions, bench.json("r.json"))
    };
    let (plain, plain_report) = fit("");
    assert_eq!(plain_report["regions"], Value::Array(Vec::new()));
    assert_eq!(fit("--mask ones.npy").0, plain);
    // A file and a painted region are the same; so are both at once.
    let (masked, report) = fit("--mask nose.npy");
    assert!(farthest(&masked, &plain) > 0.5);
    assert!(report["inputs"].as_array().unwrap().iter().any(|i| i["role"] == "mask" && i["name"] == "nose.npy"));
    // All of the nose but what the template hides there.
    let asked = |report: &Value| report["quality"]["to_scan"]["count"].as_u64().unwrap() as usize;
    let (in_nose, nose) = (asked(&report), of("nose").len());
    assert!(in_nose <= nose && 10 * in_nose > 8 * nose, "{in_nose} of {nose}");
    assert!(asked(&plain_report) <= vertices);
    let (region, report) = fit("--regions nose");
    assert_eq!(region, masked);
    assert_eq!(report["regions"], serde_json::json!(["nose"]));
    assert_eq!(fit("--regions nose,chin --mask nose.npy").0, masked);
    // Half of everything is less, against the same stiffness.
    assert!(farthest(&fit("--mask half.npy").0, &plain) > 1e-3);
    let (free, report) = fit("--free-mask not_nose.npy");
    assert!(report["inputs"].as_array().unwrap().iter().any(|i| i["role"] == "free mask"));
    assert!(farthest(&free, &masked) > 1e-3, "free vertices have no prediction either");
    let (free_region, report) = fit("--free-regions nose");
    assert_eq!(
        (&report["free_regions"], &report["regions"]),
        (&serde_json::json!(["nose"]), &Value::Array(Vec::new()))
    );
    assert!(farthest(&free_region, &plain) > 1e-3);
    assert_eq!(asked(&report), asked(&plain_report) - in_nose);
}

#[test]
fn without_a_rigs_regions_the_templates_groups_are_regions() {
    let bench = Bench::new();
    let mut text = String::new();
    for p in &bench.rig.mesh.positions {
        text.push_str(&format!("v {:?} {:?} {:?}\n", p.x, p.y, p.z));
    }
    for f in 0..bench.rig.mesh.polygon_count() {
        if f == 0 || f == bench.rig.mesh.polygon_count() / 2 {
            text.push_str(if f == 0 { "g first all\n" } else { "g second all\n" });
        }
        let corners: Vec<String> = bench.rig.mesh.polygon(f).iter().map(|v| (v + 1).to_string()).collect();
        text.push_str(&format!("f {}\n", corners.join(" ")));
    }
    bench.write("grouped.obj", text);
    let fit = |options: &str| {
        let line = format!("register --template grouped.obj {INPUTS} --model graph {options} --out r.obj");
        bench.done(&line);
        read_polygon_mesh(&bench.path("r.obj")).unwrap().positions
    };
    let plain = fit("");
    assert_eq!(fit("--regions all"), plain);
    assert_eq!(fit("--regions first,second"), plain);
    assert!(farthest(&fit("--regions second"), &plain) > 0.5);
    let stderr = bench.ends(&format!("register --template grouped.obj {INPUTS} --regions third --out r.obj"), 4);
    assert!(stderr.contains("third") && stderr.contains("first, all, second"), "{stderr}");
}

#[test]
fn a_reader_that_goes_away_is_no_error_and_a_full_disk_is() {
    let bench = Bench::new();
    let lines = ["rig info rig", "rig info rig --json", "--help", "register --help"];
    minds_a_full_disk_only(env!("CARGO_BIN_EXE_nonrigid"), &bench.path(""), &lines);
}
