//! What people get wrong, over all commands: one clear error that names the file or the option, the exit code of the stage,
//! nothing on standard output, and no output file that was not there before. And what looks odd but must work.

mod support;

use data_gen::{FaceOptions, FaceRig, write_rig};
use nonrigid::mesh::io::{NpyArray, PlyOptions, read_obj, write_npy, write_npy_points, write_obj, write_ply};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use support::{Bench, files_in, landmarks_json};

const ARGUMENTS: i32 = 1;
const COMPUTATION: i32 = 2;
const WRITING: i32 = 3;
const LOADING: i32 = 4;

/// A schedule that works; rows break it.
const SCHEDULE: &str = "reference_size = 67.0
reference_vertices = 6706
[graph]
nodes = 60
[[level]]
steps = 2
lambda_graph = 1.0
point_to_plane = 1.0
landmarks = 1.0
kernel = { huber = { delta = 3.0 } }
distance_cap = 25.0
normal_angle = 60.0
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

/// The command line of a row: `changes` are options with other values, or with `-` to leave them out.
fn command_line(command: &str, changes: &str) -> String {
    let mut options: Vec<(String, String)> = match command {
        "register" => REGISTER,
        "eval" => EVAL,
        "measure" => MEASURE,
        "rig pca" => RIG_PCA,
        _ => return format!("{command} {changes}"),
    }
    .iter()
    .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
    .collect();
    let words: Vec<&str> = changes.split_whitespace().collect();
    for change in words.chunks(2) {
        options.retain(|o| o.0 != change[0]);
        if change[1] != "-" {
            options.push((change[0].to_owned(), change[1].to_owned()));
        }
    }
    let options: Vec<String> = options.into_iter().map(|(name, value)| format!("{name} {value}")).collect();
    format!("{command} {}", options.join(" "))
}

/// One row: command, changes, exit code, words of the message.
type Row = (&'static str, &'static str, i32, &'static [&'static str]);

fn check(bench: &Bench, &(command, changes, code, words): &Row) {
    // Once without output files and once with older ones.
    for folder in ["new", "old"] {
        let before: Vec<(String, Vec<u8>)> = files_in(&bench.path(folder))
            .into_iter()
            .map(|f| (f.clone(), bench.read(&format!("{folder}/{f}"))))
            .collect();
        let line = command_line(command, changes).replace("OUT", folder);
        let run = bench.run(&line);
        let said = format!("{line}\nexit code {}\n{}", run.code, run.stderr);
        assert_eq!(run.code, code, "{said}");
        let errors: Vec<&str> = run.stderr.lines().filter(|l| l.starts_with("error:")).collect();
        assert_eq!(errors.len(), 1, "{said}");
        for word in words {
            assert!(run.stderr.contains(word), "{said}\nlacks {word:?}");
        }
        for word in ["panicked", "RUST_BACKTRACE", "src/"] {
            assert!(!run.stderr.contains(word), "{said}");
        }
        assert_eq!(run.stdout, "", "{said}");
        let after: Vec<(String, Vec<u8>)> = files_in(&bench.path(folder))
            .into_iter()
            .map(|f| (f.clone(), bench.read(&format!("{folder}/{f}"))))
            .collect();
        assert!(before == after, "{said}\nfiles changed: {:?}", files_in(&bench.path(folder)));
    }
}

/// The scan, the template and everything around them, broken in every way that a row needs.
fn broken() -> Bench {
    let bench = Bench::new();
    bench.write("new/.keep", "");
    for name in ["r.obj", "r.json", "r.timing.json", "r.png", "h.png", "m.json", "m.csv"] {
        bench.write(&format!("old/{name}"), "from last week");
    }
    bench.write("schedule.toml", SCHEDULE);
    bench.write("empty.ply", "");
    bench.write("empty.obj", "");
    bench.write("empty.json", "");
    bench.write("empty.toml", "");
    bench.write("garbage.ply", [0u8, 159, 146, 150, 10, 255, 0, 1]);
    bench.write("garbage.obj", [0u8, 159, 146, 150, 10, 255, 0, 1]);
    bench.write("garbage.npy", [7u8; 200]);
    bench.write("garbage.json", "{\"1\": [oops");
    bench.write("garbage.toml", "steps == many\n");
    bench.write("scan.stl", "solid\n");
    let scan = bench.read("case/scan.ply");
    bench.write("truncated.ply", &scan[..scan.len() / 2]);

    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    bench.write("nan.ply", format!("{header}0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n"));
    bench.write("past.ply", format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"));
    bench.write("no_faces.ply", header.replace("face 1", "face 0") + "0 0 0\n1 0 0\n0 1 0\n");
    bench.write("no_vertices.ply", header.replace("vertex 3", "vertex 0").replace("face 1", "face 0"));
    bench.write("past.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
    bench.write("nan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n");
    bench.write("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    bench.write("triangle.obj", "v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 3\n");
    bench.write("one_point.obj", "v 5 5 5\nv 5 5 5\nv 5 5 5\nf 1 2 3\n");

    // A scan of one triangle far from everything, and the whole scan moved away from its landmarks.
    bench.write("lone.ply", format!("{header}900 0 0\n901 0 0\n900 1 0\n3 0 1 2\n"));
    let mut away = bench.case.scan.clone();
    away.positions.iter_mut().for_each(|p| p.y += 1000.0);
    write_ply(&bench.path("away.ply"), &away, PlyOptions::default()).unwrap();
    let mut inverted = bench.case.scan.clone();
    inverted.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    write_ply(&bench.path("inverted.ply"), &inverted, PlyOptions::default()).unwrap();

    let marks = &bench.case.landmarks;
    bench.write("two.json", landmarks_json(&marks[..2]));
    let mut past = marks.clone();
    past[3].0 = 99_999;
    bench.write("past.json", landmarks_json(&past));
    let line: Vec<(u32, Vec3)> = marks.iter().enumerate().map(|(i, (v, _))| (*v, Vec3::x() * i as f64)).collect();
    bench.write("line.json", landmarks_json(&line));
    bench.write("nan.json", "{\"1\": [1, 2, 3], \"2\": [1, NaN, 3], \"5\": [0, 0, 1.5]}");
    bench.write("huge.json", "{\"1\": [1, 2, 3], \"2\": [1, 1e999, 3], \"5\": [0, 0, 1.5]}");
    bench.write("named.json", "{\"nose_tip\": [1.5, 2, 3], \"chin\": [0, -9.5, 1], \"wart\": [2, 0, 1.5]}");
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
    bench.write("wrap.json", "{\"nose_tip\": [999999, 0.2, 0.3]}");
    bench.write("vertices.json", "{\"nose_tip\": 99999, \"chin\": 3, \"wart\": 5}");

    let vertices = bench.rig.neutral.len();
    write_npy(&bench.path("flat.npy"), &[vertices, 2], &vec![0.0f32; 2 * vertices]).unwrap();
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
    let mut nan = bench.rig.neutral.clone();
    nan[7].y = f64::NAN;
    write_npy_points(&bench.path("nan.npy"), &nan).unwrap();

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
    write_rig(&bench.path("nan_rig"), &bench.rig).unwrap();
    let path = bench.path("nan_rig/expression_deltas.npy");
    let mut deltas = NpyArray::open(&path).unwrap().read_f32().unwrap();
    deltas[3 * vertices + 4] = f32::NAN;
    write_npy(&path, &[bench.rig.expressions.len(), vertices, 3], &deltas).unwrap();
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
        ("odd_nan", odd.replace("v 0 10 ", "v 0 nan ")),
        ("odd_huge", odd.replace("v 0 10 ", "v 0 1e200 ")),
        ("odd_empty", String::new()),
        ("odd_line", (0..9).map(|i| format!("v {i} 0 0\n")).collect::<String>() + &odd[odd.find('f').unwrap()..]),
    ] {
        bench.write(&format!("{folder}/a.obj"), person([1.0, 0.0]));
        bench.write(&format!("{folder}/b.obj"), person([0.0, 1.0]));
        bench.write(&format!("{folder}/c.obj"), mesh);
    }
    bench.write("nothing/readme.txt", "no rig here");
    bench.write("mixed/readme.txt", "");
    write_obj(&bench.path("mixed/neutral.obj"), &bench.rig.mesh).unwrap();
    bench.write("mixed/smile.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    bench.write("odd_kind/rig.json", "{\"kind\": \"halves\"}");
    write_obj(&bench.path("odd_kind/neutral.obj"), &bench.rig.mesh).unwrap();

    for (name, from, to) in [
        ("unknown_key", "steps = 2", "steps = 2\nstepps = 3"),
        ("unknown_table", "[graph]", "[grahp]"),
        ("negative_lambda", "lambda_graph = 1.0", "lambda_graph = -1.0"),
        ("empty_bounds", "[graph]", "[bounds]\nexpression = [1.0, 0.0]\n[graph]"),
        ("nan_bounds", "[graph]", "[bounds]\nidentity = [nan, 3.0]\n[graph]"),
        ("one_bound", "[graph]", "[bounds]\nexpression = [1.0]\n[graph]"),
        ("unknown_bounds", "[graph]", "[bounds]\nexpresion = [0.0, 1.0]\n[graph]"),
        ("no_steps", "steps = 2", "steps = 0"),
        ("negative_steps", "steps = 2", "steps = -2"),
        ("nan_cap", "distance_cap = 25.0", "distance_cap = nan"),
        ("infinite_weight", "point_to_plane = 1.0", "point_to_plane = inf"),
        ("wide_angle", "normal_angle = 60.0", "normal_angle = 200.0"),
        ("no_nodes", "nodes = 60", "nodes = 0"),
        ("affine_quaternion", "nodes = 60", "node = \"affine\"\nrotation = \"quaternion\""),
        ("quaternion", "nodes = 60", "rotation = \"quaternion\""),
        ("unknown_rotation", "nodes = 60", "rotation = \"euler\""),
        ("unknown_algorithm", "[graph]", "[solver]\nalgorithm = \"gradient\"\n[graph]"),
        ("reference", "[graph]", "[solver]\nlinearisation = \"reference\"\n[graph]"),
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
    let then = format!("[then]\nmodel = \"graph\"\n[then.graph]\nnodes = 60\n{level}{level}");
    bench.write("two_stages.toml", format!("{SCHEDULE}{then}"));
    let last = then.rfind("[[then.level]]").unwrap();
    let in_last = |from: &str, to: &str| format!("{}{}", &then[..last], then[last..].replace(from, to));
    for (name, then) in [
        ("then_negative", in_last("lambda_graph = 1.0", "lambda_graph = -1.0")),
        ("then_kernel", in_last("delta = 3.0", "delta = -3.0")),
        ("then_unknown_key", in_last("steps = 2", "stepps = 2")),
        ("then_no_levels", "[then]\nmodel = \"graph\"\nlevel = []\n".to_owned()),
        ("then_no_model", then.replace("model = \"graph\"\n", "")),
        ("then_unknown_model", then.replace("\"graph\"", "\"grahp\"")),
        ("then_shapes", then.replace("\"graph\"", "\"hybrid\"")),
        ("then_no_nodes", then.replace("nodes = 60", "nodes = 0")),
        ("then_start", then.replace("[then.graph]", "start = \"rigid\"\n[then.graph]")),
        ("then_then_no_steps", then.clone() + &then.replace("[then", "[then.then").replace("steps = 2", "steps = 0")),
        ("unknown_node", String::new()),
    ] {
        let first =
            if name == "unknown_node" { SCHEDULE.replace("nodes = 60", "node = \"round\"") } else { SCHEDULE.into() };
        bench.write(&format!("{name}.toml"), first + &then);
    }
    bench
}

#[rustfmt::skip]
const ROWS: &[Row] = &[
    // the template
    ("register", "--template missing.obj", LOADING, &["missing.obj", "cannot be read"]),
    ("register", "--template rig", LOADING, &["rig"]),
    ("register", "--template empty.obj", LOADING, &["empty.obj", "vertices"]),
    ("register", "--template garbage.obj", LOADING, &["garbage.obj"]),
    ("register", "--template nan.obj", LOADING, &["nan.obj", "line 2", "finite"]),
    ("register", "--template past.obj", LOADING, &["past.obj", "line 4", "9"]),
    ("register", "--template points.obj --rig - --neutral - --landmarks -", LOADING, &["template", "no faces"]),
    ("register", "--template one_point.obj --rig - --neutral - --landmarks -", LOADING, &["template", "no area"]),
    ("register", "--template triangle.obj --landmarks -", LOADING, &["neutral", "the template has 3"]),
    ("register", "--template -", ARGUMENTS, &["--template"]),
    // the scan
    ("register", "--target missing.ply", LOADING, &["missing.ply", "cannot be read"]),
    ("register", "--target empty.ply", LOADING, &["empty.ply", "line 1"]),
    ("register", "--target garbage.ply", LOADING, &["garbage.ply", "line 1"]),
    ("register", "--target truncated.ply", LOADING, &["truncated.ply", "bytes"]),
    ("register", "--target nan.ply", LOADING, &["nan.ply", "finite"]),
    ("register", "--target past.ply", LOADING, &["past.ply", "found 7"]),
    ("register", "--target no_vertices.ply", LOADING, &["no_vertices.ply", "vertices"]),
    ("register", "--target no_faces.ply", LOADING, &["scan", "no triangles"]),
    ("register", "--target no_faces.ply", LOADING, &["no normals", "nx, ny, nz"]),
    ("register", "--target cloud.ply", LOADING, &["no normals", "nx, ny, nz"]),
    ("register", "--target scan.stl", LOADING, &["scan.stl", "extension", ".ply"]),
    ("register", "--target lone.ply", COMPUTATION, &["no vertex of the template", "25 mm"]),
    ("register", "--target away.ply", COMPUTATION, &["no vertex of the template", "landmarks"]),
    ("register", "--target inverted.ply", COMPUTATION, &["inside out"]),
    ("register", "--target -", ARGUMENTS, &["--target"]),
    // masks and regions
    ("register", "--mask missing.npy", LOADING, &["missing.npy"]),
    ("register", "--mask garbage.npy", LOADING, &["garbage.npy"]),
    ("register", "--mask short_mask.npy", LOADING, &["short_mask.npy"]),
    ("register", "--mask case/truth.npy", LOADING, &["truth.npy"]),
    ("register", "--mask nan_mask.npy", LOADING, &["nan_mask.npy", "NaN", "vertex 9"]),
    ("register", "--mask negative_mask.npy", LOADING, &["negative_mask.npy", "-0.25", "from 0 to 1"]),
    ("register", "--mask zeros.npy", LOADING, &["every vertex", "above 0"]),
    ("register", "--free-mask short_mask.npy", LOADING, &["short_mask.npy"]),
    ("register", "--free-mask nan_mask.npy", LOADING, &["nan_mask.npy", "NaN", "vertex 9"]),
    ("register", "--free-mask large_mask.npy", LOADING, &["large_mask.npy", "1.5", "from 0 to 1"]),
    ("register", "--free-mask ones.npy", LOADING, &["every vertex", "below 1"]),
    ("register", "--regions nose --free-regions nose", LOADING, &["every vertex"]),
    ("register", "--regions nosee", LOADING, &["--regions", "nosee", "nose, "]),
    ("register", "--free-regions nose,ear", LOADING, &["--free-regions", "\"ear\"", "nose, "]),
    ("register", "--rig past_regions", LOADING, &["regions.json", "\"nose\"", "99999"]),
    ("register", "--rig odd_regions", LOADING, &["regions.json", "line 1"]),
    ("register", "--rig twin_regions", LOADING, &["regions.json", "\"nose\" twice"]),
    // rig, shapes and neutral
    ("register", "--rig missing", LOADING, &["missing"]),
    ("register", "--rig nothing", LOADING, &["nothing", "neutral"]),
    ("register", "--rig other_rig", LOADING, &["rig", "the template has"]),
    ("register", "--rig nameless", LOADING, &["expression_deltas.npy", "54 shapes", "expected 1"]),
    ("register", "--rig nan_rig", LOADING, &["expression_deltas.npy", "browDown_R", "vertex 1", "finite"]),
    ("register", "--shapes jawOpen,jawOpne", LOADING, &["jawOpne", "did you mean \"jawOpen\""]),
    ("register", "--shapes jawOpen,jawOpen", LOADING, &["jawOpen", "twice"]),
    ("register", "--identity-modes 9", LOADING, &["9 identity modes", "8"]),
    ("register", "--identity-modes -1", ARGUMENTS, &["-1"]),
    ("register", "--rig - --shapes jawOpen", ARGUMENTS, &["--rig"]),
    ("register", "--rig - --identity-modes 3", ARGUMENTS, &["--rig"]),
    ("register", "--rig - --model blendshape", ARGUMENTS, &["blendshape", "--rig"]),
    ("register", "--model klimov", ARGUMENTS, &["klimov", "hybrid", "similarity"]),
    ("register", "--neutral short.npy", LOADING, &["neutral", "vertices"]),
    ("register", "--neutral flat.npy", LOADING, &["flat.npy", "N x 3"]),
    ("register", "--neutral nan.npy", LOADING, &["nan.npy", "point 7", "finite"]),
    ("register", "--neutral triangle.obj", LOADING, &["neutral", "3 vertices"]),
    // landmarks
    ("register", "--landmarks missing.json", LOADING, &["missing.json"]),
    ("register", "--landmarks empty.json", LOADING, &["empty.json", "JSON"]),
    ("register", "--landmarks garbage.json", LOADING, &["garbage.json", "line 1"]),
    ("register", "--landmarks past.json", LOADING, &["past.json", "99999"]),
    ("register", "--landmarks line.json", LOADING, &["line"]),
    ("register", "--landmarks nan.json", LOADING, &["nan.json"]),
    ("register", "--landmarks huge.json", LOADING, &["huge.json"]),
    ("register", "--landmarks named.json", LOADING, &["named.json", "nose_tip", "vertex indices"]),
    ("register", "--landmarks named.json --template-landmarks rig/landmarks.json", LOADING, &["named.json", "wart", "rig/landmarks.json"]),
    ("register", "--landmarks named.json --template-landmarks vertices.json", LOADING, &["vertices.json", "nose_tip", "99999"]),
    ("register", "--landmarks named.json --template-landmarks missing.json", LOADING, &["missing.json"]),
    ("register", "--landmarks wrap.json --template-landmarks rig/landmarks.json", LOADING, &["wrap.json", "999999"]),
    ("register", "--landmarks - --template-landmarks rig/landmarks.json", ARGUMENTS, &["--landmarks"]),
    // the schedule
    ("register", "--config missing.toml", LOADING, &["missing.toml"]),
    ("register", "--config empty.toml", LOADING, &["empty.toml", "reference_size"]),
    ("register", "--config garbage.toml", LOADING, &["garbage.toml"]),
    ("register", "--config unknown_key.toml", LOADING, &["unknown_key.toml", "stepps"]),
    ("register", "--config unknown_table.toml", LOADING, &["unknown_table.toml", "grahp"]),
    ("register", "--config negative_lambda.toml", LOADING, &["negative_lambda.toml", "level 1: lambda_graph", "-1"]),
    ("register", "--config no_steps.toml", LOADING, &["no_steps.toml", "level 1: steps", "positive"]),
    ("register", "--config negative_steps.toml", LOADING, &["negative_steps.toml", "-2"]),
    ("register", "--config nan_cap.toml", LOADING, &["nan_cap.toml", "level 1: distance_cap", "NaN"]),
    ("register", "--config infinite_weight.toml", LOADING, &["infinite_weight.toml", "level 1: point_to_plane", "inf"]),
    ("register", "--config wide_angle.toml", LOADING, &["wide_angle.toml", "normal_angle", "180"]),
    ("register", "--config no_nodes.toml", LOADING, &["no_nodes.toml", "graph.nodes"]),
    ("register", "--config no_size.toml", LOADING, &["no_size.toml", "reference_size"]),
    ("register", "--config bad_kernel.toml", LOADING, &["bad_kernel.toml", "level 1", "-3"]),
    ("register", "--config unknown_kernel.toml", LOADING, &["unknown_kernel.toml", "hubert"]),
    ("register", "--config text_for_number.toml", LOADING, &["text_for_number.toml", "two"]),
    ("register", "--config no_levels.toml", LOADING, &["no_levels.toml", "level"]),
    ("register", "--config then_negative.toml", LOADING, &["then_negative.toml", "then.level 2: lambda_graph", "-1"]),
    ("register", "--config then_kernel.toml", LOADING, &["then_kernel.toml", "then.level 2: ", "-3"]),
    ("register", "--config then_unknown_key.toml", LOADING, &["then_unknown_key.toml", "stepps"]),
    ("register", "--config then_no_levels.toml", LOADING, &["then_no_levels.toml", "[[then.level]]"]),
    ("register", "--config then_no_model.toml", LOADING, &["then_no_model.toml", "model"]),
    ("register", "--config then_unknown_model.toml", LOADING, &["then_unknown_model.toml", "grahp", "graph"]),
    ("register", "--config then_shapes.toml", LOADING, &["then_shapes.toml", "then.model", "hybrid", "blendshapes"]),
    ("register", "--config then_no_nodes.toml", LOADING, &["then_no_nodes.toml", "then.graph.nodes"]),
    ("register", "--config then_start.toml", LOADING, &["then_start.toml", "start"]),
    ("register", "--config then_then_no_steps.toml", LOADING, &["then_then_no_steps.toml", "then.then.level 1: steps"]),
    ("register", "--config unknown_node.toml", LOADING, &["unknown_node.toml", "round", "affine"]),
    ("register", "--config affine_quaternion.toml", LOADING, &["affine_quaternion.toml", "graph.rotation", "affine"]),
    ("register", "--config quaternion.toml --model sumner", LOADING, &["graph.rotation", "Sumner's"]),
    ("register", "--config unknown_rotation.toml", LOADING, &["unknown_rotation.toml", "euler", "angle_axis"]),
    ("register", "--config unknown_algorithm.toml", LOADING, &["unknown_algorithm.toml", "gradient", "dogleg"]),
    ("register", "--config reference.toml --model arap", LOADING, &["solver.linearisation", "arap"]),
    ("register", "--model sequential", LOADING, &["sequential", "[then]"]),
    ("register", "--config two_stages.toml --model sequential --rig -", ARGUMENTS, &["sequential", "blendshapes"]),
    ("register", "--config empty_bounds.toml", LOADING, &["empty_bounds.toml", "bounds.expression", "[1, 0]"]),
    ("register", "--config nan_bounds.toml", LOADING, &["nan_bounds.toml", "bounds.identity", "NaN"]),
    ("register", "--config one_bound.toml", LOADING, &["one_bound.toml", "expression"]),
    ("register", "--config unknown_bounds.toml", LOADING, &["unknown_bounds.toml", "expresion"]),
    ("register", "--expression-bounds 1,0", ARGUMENTS, &["--expression-bounds", "between 1 and 0"]),
    ("register", "--expression-bounds 0,nan", ARGUMENTS, &["--expression-bounds", "between 0 and NaN"]),
    ("register", "--expression-bounds inf,inf", ARGUMENTS, &["--expression-bounds", "between inf and inf"]),
    ("register", "--identity-bounds 3", ARGUMENTS, &["--identity-bounds", "two numbers"]),
    ("register", "--identity-bounds -3;3", ARGUMENTS, &["--identity-bounds", "two numbers"]),
    ("register", "--rig - --expression-bounds 0,1", ARGUMENTS, &["--rig"]),
    // outputs and options
    ("register", "--out OUT/r.stl", ARGUMENTS, &["r.stl", ".obj"]),
    ("register", "--out OUT/r", ARGUMENTS, &["/r: cannot write", ".obj"]),
    ("register", "--report OUT/r.xml", ARGUMENTS, &["r.xml", ".json"]),
    ("register", "--picture OUT/r.jpg", ARGUMENTS, &["r.jpg", ".png"]),
    ("register", "--out nowhere/r.obj", WRITING, &["nowhere/r.obj", "no folder"]),
    ("register", "--report nowhere/r.json", WRITING, &["nowhere/r.json", "no folder"]),
    ("register", "--picture nowhere/r.png", WRITING, &["nowhere/r.png", "no folder"]),
    ("register", "--out -", ARGUMENTS, &["--out"]),
    ("register", "--threads 0", ARGUMENTS, &["--threads", "0"]),
    ("register", "--threads many", ARGUMENTS, &["--threads", "many"]),
    ("register", "--stiffness 3", ARGUMENTS, &["--stiffness"]),
    // eval
    ("eval", "--result missing.obj", LOADING, &["missing.obj"]),
    ("eval", "--result triangle.obj", LOADING, &["the result has 3 vertices", "the template has"]),
    ("eval", "--result short.npy", LOADING, &["the result has", "the template has"]),
    ("eval", "--result nan.npy", LOADING, &["nan.npy", "point 7"]),
    ("eval", "--template garbage.obj", LOADING, &["garbage.obj"]),
    ("eval", "--truth flat.npy", LOADING, &["flat.npy", "N x 3"]),
    ("eval", "--truth short.npy", LOADING, &["the truth has", "the template has"]),
    ("eval", "--truth garbage.npy", LOADING, &["garbage.npy", "NUMPY"]),
    ("eval", "--truth case/observed.npy", LOADING, &["observed.npy"]),
    ("eval", "--observed short_mask.npy", LOADING, &["short_mask.npy"]),
    ("eval", "--observed missing.npy", LOADING, &["missing.npy"]),
    ("eval", "--observed case/truth.npy", LOADING, &["truth.npy"]),
    ("eval", "--target case/scan.ply", ARGUMENTS, &["--truth", "--target"]),
    ("eval", "--truth - --observed -", ARGUMENTS, &["--truth"]),
    ("eval", "--truth - --target case/scan.ply", ARGUMENTS, &["--observed", "--target"]),
    ("eval", "--truth - --observed - --target truncated.ply", LOADING, &["truncated.ply"]),
    ("eval", "--truth - --observed - --target no_faces.ply", LOADING, &["no_faces.ply", "triangle"]),
    ("eval", "--truth - --observed - --target cloud.ply", LOADING, &["cloud.ply", "nx, ny, nz"]),
    ("eval", "--heatmap OUT/h.bmp", ARGUMENTS, &["h.bmp", ".png"]),
    ("eval", "--heatmap nowhere/h.png", WRITING, &["nowhere/h.png", "no folder"]),
    // measure
    ("measure", "--mesh missing.obj", LOADING, &["missing.obj"]),
    ("measure", "--mesh empty.obj", LOADING, &["empty.obj", "vertices"]),
    ("measure", "--mesh nan.obj", LOADING, &["nan.obj", "line 2", "finite"]),
    ("measure", "--mesh points.obj --after - --rig - --mask - --landmarks hairline.json", LOADING, &["the mesh has no faces"]),
    ("measure", "--mesh one_point.obj --after - --rig - --mask - --landmarks hairline.json", LOADING, &["the mesh has no faces, or none with an area"]),
    ("measure", "--mesh -", ARGUMENTS, &["--mesh"]),
    ("measure", "--after missing.npy", LOADING, &["missing.npy"]),
    ("measure", "--after short.npy", LOADING, &["short.npy", "the mesh before has", "correspond"]),
    ("measure", "--after triangle.obj", LOADING, &["triangle.obj: 3 vertices", "correspond"]),
    ("measure", "--after shuffled.obj", LOADING, &["shuffled.obj", "polygons"]),
    ("measure", "--after nan.npy", LOADING, &["nan.npy", "point 7", "finite"]),
    ("measure", "--after flat.npy", LOADING, &["flat.npy", "N x 3"]),
    ("measure", "--landmarks missing.json", LOADING, &["missing.json"]),
    ("measure", "--landmarks garbage.json", LOADING, &["garbage.json", "line 1"]),
    ("measure", "--landmarks nosion.json", LOADING, &["nosion.json", "\"nosion\"", "known are trichion, glabella"]),
    ("measure", "--landmarks rig/landmarks.json", LOADING, &["rig/landmarks.json", "no landmark \"brow_L1\""]),
    ("measure", "--landmarks few_numbers.json", LOADING, &["few_numbers.json", "found 3", "all 68"]),
    ("measure", "--landmarks both_names.json", LOADING, &["both_names.json", "menton", "gnathion"]),
    ("measure", "--landmarks past_nasion.json", LOADING, &["past_nasion.json", "nasion", "99999"]),
    ("measure", "--landmarks hairline.json", LOADING, &["nothing can be measured", "only trichion"]),
    ("measure", "--landmarks no_landmarks.json", LOADING, &["no_landmarks.json", "no landmarks"]),
    ("measure", "--landmarks -", ARGUMENTS, &["--landmarks"]),
    ("measure", "--rig - --regions past_of_rig.json", LOADING, &["past_of_rig.json", "\"nose\"", "99999"]),
    ("measure", "--rig - --regions missing.json", LOADING, &["missing.json"]),
    ("measure", "--regions past_of_rig.json", ARGUMENTS, &["--regions", "--rig"]),
    ("measure", "--rig missing", LOADING, &["missing/regions.json"]),
    ("measure", "--mask short_mask.npy", LOADING, &["short_mask.npy"]),
    ("measure", "--mask large_mask.npy", LOADING, &["large_mask.npy", "1.5", "from 0 to 1"]),
    ("measure", "--report -", ARGUMENTS, &["--report"]),
    ("measure", "--json OUT/m.txt", ARGUMENTS, &["m.txt", ".json"]),
    ("measure", "--csv OUT/m.json", ARGUMENTS, &["m.json", ".csv"]),
    ("measure", "--json nowhere/m.json", WRITING, &["nowhere/m.json", "no folder"]),
    ("measure", "--report schedule.toml", WRITING, &["schedule.toml", "not a folder"]),
    ("measure", "--report nowhere/page", WRITING, &["nowhere/page", "no folder"]),
    ("measure", "--threads 0", ARGUMENTS, &["--threads", "0"]),
    // rig info
    ("rig info", "missing", LOADING, &["missing"]),
    ("rig info", "nothing", LOADING, &["nothing", "neutral"]),
    ("rig info", "case/scan.ply", LOADING, &["scan.ply"]),
    ("rig info", "nameless", LOADING, &["expression_names.json", "54 shapes"]),
    ("rig info", "nan_rig", LOADING, &["browDown_R", "finite"]),
    ("rig info", "mixed", LOADING, &["smile.obj", "3 vertices"]),
    ("rig info", "odd_kind", LOADING, &["rig.json", "halves"]),
    ("rig info", "rig --shape-kind half", ARGUMENTS, &["half", "full", "delta"]),
    ("rig info", "", ARGUMENTS, &["DIR"]),
    // rig pca
    ("rig pca", "--meshes missing", LOADING, &["missing", "cannot be read"]),
    ("rig pca", "--meshes people/a.obj", LOADING, &["people/a.obj", "cannot be read"]),
    ("rig pca", "--meshes nothing", LOADING, &["nothing", "found 0 meshes", "at least 2"]),
    ("rig pca", "--meshes alone", LOADING, &["alone", "found 1 mesh,", "at least 2"]),
    ("rig pca", "--meshes odd_vertices", LOADING, &["odd_vertices/c.obj", "10 vertices", "expected 9", "a.obj"]),
    ("rig pca", "--meshes odd_polygons", LOADING, &["odd_polygons/c.obj", "5 polygons", "expected 4", "a.obj"]),
    ("rig pca", "--meshes odd_order", LOADING, &["odd_order/c.obj", "polygon 1", "[2, 5, 4, 1]", "[1, 2, 5, 4]", "a.obj"]),
    ("rig pca", "--meshes odd_nan", LOADING, &["odd_nan/c.obj", "line 4", "finite"]),
    ("rig pca", "--meshes odd_huge", LOADING, &["odd_huge/c.obj", "vertex 3"]),
    ("rig pca", "--meshes odd_empty", LOADING, &["odd_empty/c.obj", "vertices"]),
    ("rig pca", "--meshes odd_line", COMPUTATION, &["odd_line/c.obj", "aligned", "line"]),
    ("rig pca", "--meshes -", ARGUMENTS, &["--meshes"]),
    ("rig pca", "--components 0", ARGUMENTS, &["--components", "0"]),
    ("rig pca", "--components -3", ARGUMENTS, &["-3"]),
    ("rig pca", "--components 4", ARGUMENTS, &["--components", "4 components", "1 to 3", "4 meshes of 9 vertices"]),
    ("rig pca", "--components -", ARGUMENTS, &["--components"]),
    ("rig pca", "--meshes one_way --align none", COMPUTATION, &["--components", "2 components", "1 directions"]),
    ("rig pca", "--meshes nearly_one_way --align none", COMPUTATION, &["--components", "2 components", "only 1"]),
    ("rig pca", "--meshes clones", COMPUTATION, &["2 components", "4 meshes", "0 directions", "zero variance"]),
    ("rig pca", "--align sideways", ARGUMENTS, &["sideways", "rigid", "similarity", "none"]),
    ("rig pca", "--threads 0", ARGUMENTS, &["--threads", "0"]),
    ("rig pca", "--out schedule.toml", WRITING, &["schedule.toml", "not a folder"]),
    ("rig pca", "--out nowhere/rig", WRITING, &["nowhere/rig", "no folder"]),
    ("rig pca", "--out people/../people", ARGUMENTS, &["--out", "--meshes"]),
    ("rig pca", "--out -", ARGUMENTS, &["--out"]),
    ("rig list", "rig", ARGUMENTS, &["list"]),
    ("regsiter", "", ARGUMENTS, &["regsiter"]),
];

#[test]
fn the_rows_would_work_without_their_changes() {
    let bench = broken();
    for command in ["register", "eval", "measure", "rig pca"] {
        bench.done(&command_line(command, "").replace("OUT", "new"));
    }
    assert_eq!(
        files_in(&bench.path("new")),
        [".keep", "h.png", "m.csv", "m.json", "page", "people_rig", "r.json", "r.obj", "r.png", "r.timing.json"]
    );
}

#[test]
fn every_row_is_one_clear_error_and_leaves_no_trace() {
    let bench = broken();
    let failures: Vec<String> = ROWS
        .iter()
        .filter_map(|row| {
            let message = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| check(&bench, row))).err()?;
            Some(message.downcast_ref::<String>().cloned().unwrap_or_default())
        })
        .collect();
    assert!(failures.is_empty(), "{} of {} rows:\n\n{}", failures.len(), ROWS.len(), failures.join("\n\n"));
}

/// Runs a registration that must work and returns the positions, finite all of them.
fn works(bench: &Bench, changes: &str) -> PolygonMesh {
    let line = command_line("register", changes).replace("OUT", "new");
    let run = bench.run(&line);
    assert_eq!(run.code, 0, "{line}\n{}", run.stderr);
    let result = read_obj(&bench.path("new/r.obj")).unwrap();
    assert!(result.positions.iter().all(|p| p.iter().all(|c| c.is_finite())), "{line}");
    result
}

fn near_truth(bench: &Bench, positions: &[Vec3]) -> f64 {
    let pairs = positions.iter().zip(&bench.case.truth).zip(&bench.case.observed).filter(|(_, o)| **o);
    let squares: Vec<f64> = pairs.map(|((a, b), _)| (a - b).norm_squared()).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn flaws_of_real_scans_change_nothing_or_little() {
    let bench = broken();
    let expected = near_truth(&bench, &works(&bench, "--config -").positions);
    let scan = &bench.case.scan;
    let with = |positions: &[Vec3], triangles: &[[u32; 3]]| -> TriangleMesh {
        let mut flawed = scan.clone();
        flawed.positions.extend(positions);
        flawed.triangles.extend(triangles);
        flawed
    };
    let repeated: Vec<[u32; 3]> = scan.triangles.iter().step_by(50).copied().collect();
    let flat: Vec<[u32; 3]> = scan.triangles.iter().step_by(40).map(|t| [t[0], t[1], t[1]]).collect();
    for (what, flawed) in [
        ("unreferenced vertices", with(&[Vec3::zeros(), Vec3::repeat(1e4), Vec3::repeat(-50.0)], &[])),
        ("triangles without area", with(&[], &flat)),
        ("duplicate triangles", with(&[], &repeated)),
    ] {
        write_ply(&bench.path("flawed.ply"), &flawed, PlyOptions::default()).unwrap();
        let found = near_truth(&bench, &works(&bench, "--config - --target flawed.ply").positions);
        assert!(found < 1.1 * expected + 0.05, "{what}: {found} mm, without {expected} mm");
    }
}

#[test]
fn templates_with_loose_vertices_or_several_parts_work_with_every_model() {
    let bench = broken();
    let template = &bench.rig.mesh;
    let mut loose = template.clone();
    loose.positions.push(Vec3::new(0.0, 0.0, 90.0));
    // A second part: a small quad in front of the forehead.
    let mut parts = template.clone();
    let first = parts.positions.len() as u32;
    parts
        .positions
        .extend([[-5.0, 0.0], [5.0, 0.0], [5.0, 8.0], [-5.0, 8.0]].map(|[x, y]| Vec3::new(x, 60.0 + y, 80.0)));
    parts.corners.extend([first, first + 1, first + 2, first + 3]);
    parts.starts.push(parts.corners.len() as u32);
    parts.metadata.corner_uvs.extend([u32::MAX; 4]);
    for (name, mesh) in [("loose", &loose), ("parts", &parts)] {
        write_obj(&bench.path(&format!("{name}.obj")), mesh).unwrap();
        for model in ["hybrid", "graph", "rigid", "similarity"] {
            let changes = format!("--template {name}.obj --rig - --neutral - --model {model}");
            let result = works(&bench, &changes);
            assert_eq!(PolygonMesh { positions: mesh.positions.clone(), ..result.clone() }, *mesh, "{name} {model}");
            // Nobody is left behind or thrown away: the pieces stay near each other.
            let far =
                result.positions[first as usize..].iter().map(|p| (p - result.positions[0]).norm()).fold(0.0, f64::max);
            assert!(far < 400.0, "{name} {model}: {far}");
        }
    }
}

#[test]
fn a_template_of_one_triangle_works_or_says_why_not() {
    let bench = broken();
    // On the scan: it has a surface to lie on.
    let [a, b, c] = bench.case.scan.triangles[0].map(|v| bench.case.scan.positions[v as usize]);
    bench.write(
        "on_scan.obj",
        format!("v {} {} {}\nv {} {} {}\nv {} {} {}\nf 1 2 3\n", a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z),
    );
    let run = bench.run(
        &command_line("register", "--template on_scan.obj --rig - --neutral - --landmarks - --model graph")
            .replace("OUT", "new"),
    );
    match run.code {
        0 => assert!(read_obj(&bench.path("new/r.obj")).unwrap().positions.iter().all(|p| p.norm().is_finite())),
        COMPUTATION | LOADING => assert!(run.stderr.starts_with("error: ") && run.stdout.is_empty(), "{}", run.stderr),
        code => panic!("exit code {code}: {}", run.stderr),
    }
}
