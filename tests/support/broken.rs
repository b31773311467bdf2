//! Everything that the program reads, broken in every way that a row of a table needs.
#![allow(dead_code)] // every test binary uses its own part of this

use data_gen::{FaceOptions, FaceRig, write_rig};
use nonrigid::io::{PlyOptions, write_npy, write_npy_points, write_obj, write_ply, write_polygon_mesh};
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::registration::{ModelFactory as _, ModelKind};
use nonrigid::rig::{Family, Rig, RigReadOptions, Shape};

use super::support::{Bench, landmarks_json};

/// A schedule that works; rows break it.
const SCHEDULE: &str = "reference_size = 67.0
reference_vertices = 6706
[model]
nodes = 60
[[level]]
steps = 2
distance_cap = 25.0
normal_angle = 60.0
kernel = { huber = { delta = 3.0 } }
model = { lambda_graph = 1.0 }
terms.point_to_plane = { weight = 1.0 }
terms.landmarks = { weight = 1.0 }
";

/// A command with options that work.
const REGISTER: &[(&str, &str)] = &[
    ("--template", "rig/template.obj"),
    ("--target", "case/scan.ply"),
    ("--neutral", "case/neutral.npy"),
    ("--rig", "rig"),
    ("--landmarks", "case/landmarks.json"),
    ("--config", "schedule.toml"),
    ("--out", "OUT/r.obj"),
    ("--report", "OUT/r.json"),
    ("--picture", "OUT/r.png"),
];
const EVAL: &[(&str, &str)] = &[
    ("--result", "case/truth.npy"),
    ("--template", "rig/template.obj"),
    ("--truth", "case/truth.npy"),
    ("--observed", "case/observed.npy"),
    ("--heatmap", "OUT/h.png"),
];
const MEASURE: &[(&str, &str)] = &[
    ("--mesh", "rig/template.obj"),
    ("--after", "case/truth.npy"),
    ("--landmarks", "rig/landmarks_anthropometric.json"),
    ("--rig", "rig"),
    ("--mask", "ones.npy"),
    ("--json", "OUT/m.json"),
    ("--csv", "OUT/m.csv"),
    ("--report", "OUT/page"),
];
const RIG_PCA: &[(&str, &str)] = &[("--meshes", "people"), ("--components", "2"), ("--out", "OUT/people_rig")];

const MORPH: &[(&str, &str)] = &[
    ("--mesh", "rig/template.obj"),
    ("--landmarks", "rig/landmarks_multipie68.json"),
    ("--recipe", "recipe.toml"),
    ("--out", "OUT/morphed.obj"),
    ("--masks", "OUT/masks"),
    ("--report", "OUT/morph_page"),
];

/// Names without dashes stand for what is given without one.
const LANDMARKS_CONVERT: &[(&str, &str)] =
    &[("INPUT", "rig/landmarks_multipie68.json"), ("OUTPUT", "OUT/points.csv"), ("--mesh", "rig/template.obj")];
const LANDMARKS_CHECK: &[(&str, &str)] = &[("INPUT", "rig/landmarks_multipie68.json"), ("--mesh", "rig/template.obj")];
const LANDMARKS_TRANSFER: &[(&str, &str)] = &[
    ("INPUT", "rig/landmarks_multipie68.json"),
    ("OUTPUT", "OUT/carried.json"),
    ("--from", "rig/template.obj"),
    ("--to", "subject.obj"),
];
const RIG_CONVERT: &[(&str, &str)] = &[("--rig", "rig"), ("--out", "OUT/rig.glb")];
const RIG_TRANSFER: &[(&str, &str)] = &[("--rig", "rig"), ("--subject", "subject.obj"), ("--out", "OUT/me.npz")];
const RIG_FIT: &[(&str, &str)] =
    &[("--rig", "rig"), ("--shapes", "jawOpen"), ("--meshes", "frames"), ("--out", "OUT/weights.csv")];

/// A recipe that works; rows break it.
const RECIPE: &str = "frame = { origin = [\"30\"], right = [\"36\", \"45\"], up = [\"8\", \"27\"] }
[[step]]
[[step.mask]]
region = { circle = { centre = [0, 0], radius = 9 } }
displacement = [0, 0, 1]
";

/// The command line of a row: `changes` are options with other values, or with `-` to leave them out.
pub fn command_line(command: &str, changes: &str) -> String {
    let mut options: Vec<(String, String)> = match command {
        "register" => REGISTER,
        "eval" => EVAL,
        "measure" => MEASURE,
        "morph" => MORPH,
        "rig pca" => RIG_PCA,
        "rig convert" => RIG_CONVERT,
        "rig transfer" => RIG_TRANSFER,
        "rig fit" => RIG_FIT,
        "landmarks convert" => LANDMARKS_CONVERT,
        "landmarks check" => LANDMARKS_CHECK,
        "landmarks transfer" => LANDMARKS_TRANSFER,
        _ => return format!("{command} {changes}"),
    }
    .iter()
    .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
    .collect();
    let words: Vec<&str> = changes.split_whitespace().collect();
    for change in words.chunks(2) {
        match options.iter_mut().find(|o| o.0 == change[0]) {
            Some(option) => option.1 = change[1].to_owned(),
            None => options.push((change[0].to_owned(), change[1].to_owned())),
        }
    }
    let given = options.into_iter().filter(|(_, value)| value != "-");
    let options: Vec<String> =
        given.map(|(name, value)| if name.starts_with('-') { format!("{name} {value}") } else { value }).collect();
    format!("{command} {}", options.join(" "))
}

/// The scan, the template and everything around them, broken in every way that a row needs.
pub fn broken() -> Bench {
    let bench = Bench::new();
    bench.write("new/.keep", "");
    for name in
        "r.obj r.json r.timing.json r.png h.png m.json m.csv morphed.obj points.csv carried.json rig.glb me.npz \
                 weights.csv"
            .split_whitespace()
    {
        bench.write(&format!("old/{name}"), "from last week");
    }
    bench.write("schedule.toml", SCHEDULE);
    bench.write("empty.obj", "");
    bench.write("empty.json", "");
    bench.write("empty.toml", "");
    bench.write("garbage.obj", [0u8, 159, 146, 150, 10, 255, 0, 1]);
    bench.write("garbage.toml", "steps == many\n");
    let scan = bench.read("case/scan.ply");
    bench.write("truncated.ply", &scan[..scan.len() / 2]);

    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    bench.write("no_faces.ply", header.replace("face 1", "face 0") + "0 0 0\n1 0 0\n0 1 0\n");
    bench.write("nan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n");
    bench.write("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    bench.write("triangle.obj", "v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n");
    bench.write("apart.obj", "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 101 0 0\nv 1 100 0\nv 101 100 0\nf 1 2 3\nf 4 6 5\n");
    bench.write("one_point.obj", "v 5 5 5\nv 5 5 5\nv 5 5 5\nf 1 2 3\n");

    // A scan of one triangle far from everything, and the whole scan moved away from its landmarks.
    bench.write("lone.ply", format!("{header}900 0 0\n901 0 0\n900 1 0\n3 0 1 2\n"));
    let mut away = bench.case.scan.clone();
    away.positions.iter_mut().for_each(|p| p.y += 1000.0);
    write_ply(&bench.path("away.ply"), &away, PlyOptions::default()).unwrap();
    let mut inverted = bench.case.scan.clone();
    inverted.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    write_ply(&bench.path("inverted.ply"), &inverted, PlyOptions::default()).unwrap();

    let scan = PolygonMesh::from(bench.case.scan.clone());
    let in_mm = scan.with_positions(scan.positions.iter().map(|p| p * 1000.0).collect());
    write_polygon_mesh(&bench.path("in_mm.glb"), &in_mm).unwrap();

    let marks = &bench.case.landmarks;
    let turned: Vec<(u32, Vec3)> = marks.iter().map(|(v, p)| (*v, Vec3::new(-p.x, -p.y, p.z))).collect();
    bench.write("turned.json", landmarks_json(&turned));
    bench.write("two.json", landmarks_json(&marks[..2]));
    let line: Vec<(u32, Vec3)> = marks.iter().enumerate().map(|(i, (v, _))| (*v, Vec3::x() * i as f64)).collect();
    bench.write("line.json", landmarks_json(&line));
    bench.write("scans.csv", "target\ncase/scan.ply\n");
    bench.write("no_rows.csv", "target\n# nobody\n");
    bench.write("odd_column.csv", "target,colour\ncase/scan.ply,red\n");
    bench.write("odd_row.csv", "target,model\ncase/scan.ply,rigid\ncase/scan.ply\n");
    bench.write("one_name.csv", "target,name\na.ply,ann\nb.ply,Ann\n");
    let pose = "{\"scale\": 1, \"rotation\": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], \"translation\": [0, 0, 0]}";
    for (name, model) in [("of_arap", "arap"), ("of_another", "hybrid")] {
        let state = format!("{{\"model\": \"{model}\", \"pose\": {pose}, \"parameters\": [1, 2, 3]}}");
        bench.write(&format!("{name}.json"), state);
    }
    bench.write("in_metres.json", "{\"format\": \"nonrigid landmarks\", \"unit\": \"m\", \"landmarks\": []}");
    for (name, factor) in [("a", 1.0), ("b", 0.1)] {
        let positions = bench.rig.neutral.iter().map(|p| p * factor).collect();
        bench.write(&format!("two_units/{name}.keep"), "");
        write_obj(&bench.path(&format!("two_units/{name}.obj")), &bench.rig.mesh.with_positions(positions)).unwrap();
    }
    bench.write("named.json", "{\"nose_tip\": [1.5, 2, 3], \"chin\": [0, -9.5, 1], \"wart\": [2, 0, 1.5]}");
    bench.write("wrap.json", "{\"nose_tip\": [999999, 0.2, 0.3]}");
    bench.write("nosion.json", "{\"nasion\": 1, \"nosion\": 2}");
    bench.write("few_numbers.json", "[1, 2, 3]");
    bench.write("both_names.json", "{\"menton\": 1, \"gnathion\": 2}");
    bench.write("hairline.json", "{\"trichion\": 1}");
    bench.write("past_nasion.json", "{\"nasion\": 99999, \"menton\": 5}");
    bench.write("past_of_rig.json", "{\"nose\": [1, 99999]}");
    bench.write("no_landmarks.json", "{}");
    let shuffled = bench.rig.mesh.corners.iter().rev().copied().collect();
    write_obj(
        &bench.path("shuffled.obj"),
        &PolygonMesh { corners: shuffled, metadata: Default::default(), ..bench.rig.mesh.clone() },
    )
    .unwrap();

    bench.write("mm.json", "{\"unit\": \"mm\", \"landmarks\": [{\"name\": \"left eye\", \"position\": [1, 2, 3]}]}");
    bench.write("sharp.json", "{\"#nose_tip\": [1.5, 2, 3]}");
    write_obj(&bench.path("subject.obj"), &bench.rig.mesh.with_positions(bench.case.truth.clone())).unwrap();
    broken_rigs_and_frames(&bench);

    bench.write("recipe.toml", RECIPE);
    bench.write("far.toml", RECIPE.replace("[0, 0], radius", "[500, 0], radius"));
    bench.write("frameless.toml", RECIPE.lines().skip(1).collect::<Vec<_>>().join("\n"));
    bench.write("misspelt.toml", "[[step]]\nmodle = \"arap\"\n");
    let region = "region = { circle = { centre = [0, 0], radius = 9 } }";
    bench.write("picture.toml", RECIPE.replace(region, "png = \"garbage.obj\""));
    bench.write("no_picture.toml", RECIPE.replace(region, "png = \"missing.png\""));
    bench.write("short_weights.toml", RECIPE.replace(region, "weights = \"short_mask.npy\""));
    bench.write("large_weights.toml", RECIPE.replace(region, "weights = \"large_mask.npy\""));
    bench.write("backwards.toml", format!("range = [2, 1]\n{RECIPE}"));
    bench.write("no_region.toml", RECIPE.replace(region, "parts = [\"beak\"]"));
    bench.write("past_pin.toml", format!("{RECIPE}[[step.pin]]\nvertex = 99999\nby = [0, 0, 1]\n"));

    bench.write("vertices.json", "{\"nose_tip\": 99999, \"chin\": 3, \"wart\": 5}");

    let vertices = bench.rig.neutral.len();
    write_npy(&bench.path("short_mask.npy"), &[vertices - 1], &vec![true; vertices - 1]).unwrap();
    write_npy_points(&bench.path("short.npy"), &bench.rig.neutral[1..]).unwrap();
    for (name, value) in [("nan", f64::NAN), ("negative", -0.25), ("large", 1.5)] {
        let mut mask = vec![1.0; vertices];
        mask[9] = value;
        write_npy(&bench.path(&format!("{name}_mask.npy")), &[vertices], &mask).unwrap();
    }
    write_npy(&bench.path("zeros.npy"), &[vertices], &vec![0.0f32; vertices]).unwrap();
    write_npy(&bench.path("ones.npy"), &[vertices], &vec![1.0f32; vertices]).unwrap();
    bench.write("cloud.ply", {
        let normal = "property float nx\nproperty float ny\nproperty float nz\nelement face 0";
        header.replace("element face 1", normal) + "0 0 0 0 0 0\n1 0 0 0 0 0\n0 1 0 0 0 nan\n"
    });

    let other = FaceRig::generate(&FaceOptions { vertices: 1300, identity_modes: 0 });
    write_rig(&bench.path("other_rig"), &other).unwrap();
    write_rig(&bench.path("nameless"), &bench.rig).unwrap();
    for (name, regions) in [
        ("past_regions", "{\"nose\": [1, 99999]}"),
        ("odd_regions", "[[1, 2], [3]]"),
        ("twin_regions", "{\"nose\": [1], \"nose\": [2]}"),
    ] {
        write_rig(&bench.path(name), &bench.rig).unwrap();
        bench.write(&format!("{name}/regions.json"), regions);
    }
    bench.write("nameless/expression_names.json", "[\"jawOpen\"]");
    let person = |weights: [f64; 2]| -> String {
        let vertex = |i: u32| {
            let (x, y) = (f64::from(i % 3), f64::from(i / 3));
            format!("v {} {} {}\n", 10.0 * x, 10.0 * y, weights[0] * x * x + weights[1] * (y - x * y))
        };
        (0..9).map(vertex).collect::<String>() + "f 1 2 5 4\nf 2 3 6 5\nf 4 5 8 7\nf 5 6 9 8\n"
    };
    let people = ["a", "b", "c", "d"].map(|name| format!("{name}.obj"));
    for (folder, weights) in [
        ("people", [[1.0, 0.0], [-0.5, 0.5], [0.3, 0.9], [0.0, -1.0]]),
        ("one_way", [[1.0, 0.0], [-0.5, 0.0], [0.3, 0.0], [0.0, 0.0]]),
        ("nearly_one_way", [[1.0, 0.0], [-0.5, 1e-9], [0.3, 1e-9], [0.0, -1e-9]]),
        ("clones", [[1.0, 0.5]; 4]),
    ] {
        people.iter().zip(weights).for_each(|(name, w)| bench.write(&format!("{folder}/{name}"), person(w)));
    }
    bench.write("alone/a.obj", person([1.0, 0.0]));
    let odd = person([0.2, 0.1]);
    for (folder, mesh) in [
        ("odd_vertices", format!("v 1 2 3\n{odd}")),
        ("odd_polygons", odd.replace("f 2 3 6 5\n", "f 2 3 6\nf 2 6 5\n")),
        ("odd_order", odd.replace("f 2 3 6 5\n", "f 3 6 5 2\n")),
        ("odd_huge", odd.replace("v 0 10 ", "v 0 1e200 ")),
        ("odd_line", (0..9).map(|i| format!("v {i} 0 0\n")).collect::<String>() + &odd[odd.find('f').unwrap()..]),
    ] {
        bench.write(&format!("{folder}/a.obj"), person([1.0, 0.0]));
        bench.write(&format!("{folder}/b.obj"), person([0.0, 1.0]));
        bench.write(&format!("{folder}/c.obj"), mesh);
    }
    for name in ["folder.obj", "folder.json", "folder.png", "folder.csv", "folder.glb"] {
        bench.write(&format!("{name}/.keep"), "");
    }
    bench.write("nothing/readme.txt", "no rig here");
    bench.write("odd_kind/rig.json", "{\"kind\": \"halves\"}");
    write_obj(&bench.path("odd_kind/neutral.obj"), &bench.rig.mesh).unwrap();

    let tissue = ModelKind::Fem.default_schedule();
    bench.write("unknown_region.toml", tissue.replace("[model]", "[model]\nmodulus = { beak = 2.0 }"));
    for (name, from, to) in [
        ("unknown_key", "steps = 2", "steps = 2\nstepps = 3"),
        ("unknown_table", "[model]", "[modle]"),
        ("unknown_option", "nodes = 60", "noeds = 60"),
        ("unknown_term", "terms.landmarks", "terms.landmark"),
        ("former_key", "steps = 2", "steps = 2\nlambda_graph = 1.0"),
        ("negative_lambda", "lambda_graph = 1.0", "lambda_graph = -1.0"),
        ("empty_bounds", "[model]", "[bounds]\nexpression = [1.0, 0.0]\n[model]"),
        ("nan_bounds", "[model]", "[bounds]\nidentity = [nan, 3.0]\n[model]"),
        ("one_bound", "[model]", "[bounds]\nexpression = [1.0]\n[model]"),
        ("unknown_bounds", "[model]", "[bounds]\nexpresion = [0.0, 1.0]\n[model]"),
        ("no_steps", "steps = 2", "steps = 0"),
        ("huge_steps", "steps = 2", "steps = 1000001"),
        ("huge_influences", "nodes = 60", "influences = 9000000000000000000"),
        ("no_cap", "distance_cap = 25.0\n", ""),
        ("nan_cap", "distance_cap = 25.0", "distance_cap = nan"),
        ("negative_sampling", "distance_cap = 25.0", "distance_cap = 25.0\nsampling = -1.0"),
        ("infinite_weight", "point_to_plane = { weight = 1.0 }", "point_to_plane = { weight = inf }"),
        ("wide_angle", "normal_angle = 60.0", "normal_angle = 200.0"),
        ("no_nodes", "nodes = 60", "nodes = 0"),
        ("affine_quaternion", "nodes = 60", "node = \"affine\"\nrotation = \"quaternion\""),
        ("quaternion", "nodes = 60", "rotation = \"quaternion\""),
        ("unknown_rotation", "nodes = 60", "rotation = \"euler\""),
        ("unknown_algorithm", "[model]", "[solver]\nalgorithm = \"gradient\"\n[model]"),
        ("reference", "nodes = 60", "linearisation = \"reference\""),
        ("no_size", "reference_size = 67.0", "reference_size = 0.0"),
        ("bad_kernel", "delta = 3.0", "delta = -3.0"),
        ("unknown_kernel", "huber", "hubert"),
        ("text_for_number", "steps = 2", "steps = \"two\""),
        ("no_levels", &SCHEDULE[SCHEDULE.find("[[level]]").unwrap()..], "level = []\n"),
    ] {
        assert!(SCHEDULE.contains(from), "{name}");
        // An empty list of levels is a key of the top table.
        let text = if name == "no_levels" {
            format!("level = []\n{}", SCHEDULE.replace(from, ""))
        } else {
            SCHEDULE.replacen(from, to, 1)
        };
        bench.write(&format!("{name}.toml"), text);
    }
    let level = SCHEDULE[SCHEDULE.find("[[level]]").unwrap()..].replace("[[level]]", "[[then.level]]");
    let then = format!("[then.model]\nname = \"graph\"\nnodes = 60\n{level}{level}");
    bench.write("two_stages.toml", format!("{SCHEDULE}{then}"));
    let last = then.rfind("[[then.level]]").unwrap();
    let in_last = |from: &str, to: &str| format!("{}{}", &then[..last], then[last..].replace(from, to));
    for (name, then) in [
        ("then_negative", in_last("lambda_graph = 1.0", "lambda_graph = -1.0")),
        ("then_no_levels", "[then]\nlevel = []\nmodel = { name = \"graph\" }\n".to_owned()),
        ("then_no_model", then.replace("name = \"graph\"\n", "")),
        ("then_unknown_model", then.replace("\"graph\"", "\"grahp\"")),
        ("then_shapes", then.replace("\"graph\"", "\"hybrid\"")),
        ("then_start", then.replace("[then.model]", "[then]\nstart = \"rigid\"\n[then.model]")),
        ("then_then_no_steps", then.clone() + &then.replace("[then", "[then.then").replace("steps = 2", "steps = 0")),
        ("unknown_node", String::new()),
    ] {
        let first =
            if name == "unknown_node" { SCHEDULE.replace("nodes = 60", "node = \"round\"") } else { SCHEDULE.into() };
        bench.write(&format!("{name}.toml"), first + &then);
    }
    one_file_under_two_names(&bench);
    bench
}

/// Rigs in files, and sequences of frames.
fn broken_rigs_and_frames(bench: &Bench) {
    let (rig, _) = Rig::read(&bench.path("rig"), &RigReadOptions::default()).unwrap();
    rig.write_gltf(&bench.path("me.glb")).unwrap();
    rig.write_npz(&bench.path("me.npz")).unwrap();
    bench.write("plain_file", "no folder");
    let positions = rig.neutral().to_vec();
    let shape = |name: &str| vec![Shape { name: name.into(), family: Family::Expression }];
    let deltas: Vec<f32> = (0..3 * positions.len()).map(|i| (i as f32 * 0.37).sin()).collect();
    let (slash, _) = Rig::new(positions.clone(), rig.mesh().cloned(), shape("brow/up"), deltas.clone()).unwrap();
    slash.write_npz(&bench.path("slash.npz")).unwrap();
    let (bare, _) = Rig::new(positions.clone(), None, shape("smile"), deltas).unwrap();
    bare.write_npz(&bench.path("no_polygons.npz")).unwrap();
    let (still, _) = Rig::new(positions.clone(), rig.mesh().cloned(), Vec::new(), Vec::new()).unwrap();
    still.write_npz(&bench.path("no_shapes.npz")).unwrap();
    let modes = vec![Shape { name: "identity000".into(), family: Family::Identity }];
    let (modes, _) = Rig::new(positions.clone(), rig.mesh().cloned(), modes, rig.deltas(0).to_vec()).unwrap();
    modes.write_npz(&bench.path("modes.npz")).unwrap();
    for (name, by) in [("a", 1), ("b", 1), ("c", 7)] {
        let places = (0..positions.len()).map(|i| positions[i * by % positions.len()]).collect();
        bench.write("shuffled_people/.keep", "");
        write_obj(&bench.path(&format!("shuffled_people/{name}.obj")), &bench.rig.mesh.with_positions(places)).unwrap();
    }
    bench.write("stranger/old.obj", "v 0 0 0\n");

    let flat = vec![Vec3::repeat(7.0); positions.len()];
    for (folder, positions) in [("frames", &bench.case.truth), ("frames_at_a_point", &flat)] {
        bench.write(&format!("{folder}/.keep"), "");
        write_obj(&bench.path(&format!("{folder}/000.obj")), &bench.rig.mesh.with_positions(positions.clone()))
            .unwrap();
    }
    let frame = bench.text("frames/000.obj");
    bench.write("frames_twice/000.obj", &frame);
    bench.write("frames_twice/000.ply", "ply\n");
    bench.write("frames_short/000.obj", &frame);
    bench.write("frames_short/001.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
}

/// Files that are inputs of a command and would be its outputs, too.
fn one_file_under_two_names(bench: &Bench) {
    let link = |file: &str, name: &str| {
        let path = bench.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::hard_link(bench.path(file), path).unwrap();
    };
    link("rig/template.obj", "hard.obj");
    link("case/truth.npy", "linked.png");
    link("rig/regions.json", "linked.json");
    link("rig/landmarks.json", "hard.json");
    link("people/a.obj", "rig_of_links/template.obj");
    #[cfg(unix)]
    for (target, name) in [("rig/template.obj", "soft.obj"), (".", "here")] {
        std::os::unix::fs::symlink(target, bench.path(name)).unwrap();
    }
    let (mesh, landmarks) = (bench.read("people/a.obj"), bench.read("case/landmarks.json"));
    for name in ["neutral.obj", "smile.obj"] {
        bench.write(&format!("rig_in_links/{name}"), &mesh);
    }
    link("rig_in_links/neutral.obj", "rig_of_links/neutral.obj");
    bench.write("times.timing.json", &landmarks);
    bench.write("page/measurements.json", &landmarks);
    bench.write("has_timing.timing.json/.keep", "");
    let buffer = "{\"asset\": {\"version\": \"2.0\"}, \"buffers\": [{\"uri\": \"in_two.json\", \"byteLength\": 4}]}";
    bench.write("in_two.gltf", buffer);
    bench.write("in_two.json", "four");
    let region = "region = { circle = { centre = [0, 0], radius = 9 } }";
    bench.write("own_mask.toml", RECIPE.replace(region, "png = \"own_masks/step1-mask1.png\""));
    bench.write("own_masks/step1-mask1.png", "");
    write_rig(&bench.path("rig_unfinished"), &bench.rig).unwrap();
    bench.write("rig_unfinished/.unfinished", "");

    bench.write("own.csv", "target\nlone.ply\n");
    bench.write("lone.json", &landmarks);
    bench.write("marks.csv", "target,landmarks\nlone.ply,lone.json\n");
    bench.write("clash/summary.csv", "target\n../case/scan.ply\n");
    bench.write("strangers/scan.json", "mine");
}
