//! What people get wrong with `nonrigid`, over all its commands.

#[path = "support/broken.rs"]
mod broken;
#[path = "support/refusal.rs"]
mod refusal;
mod support;

use broken::{broken, command_line};
use refusal::{ARGUMENTS, COMPUTATION, LOADING, WRITING, all_hold, refuses};
use support::files_in;

/// One row: command, changes to its options that work, exit code, words of the message.
type Row = (&'static str, &'static str, i32, &'static [&'static str]);

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
    ("register", "--target huge.ply", LOADING, &["huge.ply", "1000000000000 rows"]),
    ("register", "--target huge_binary.ply", LOADING, &["huge_binary.ply", "1000000000000 rows"]),
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
    ("register", "--neutral huge.npy", LOADING, &["huge.npy", "1000000000000 x 3"]),
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
    ("register", "--config huge_steps.toml", LOADING, &["huge_steps.toml", "level 1: steps", "at most 1000000"]),
    ("register", "--config huge_nodes.toml", LOADING, &["huge_nodes.toml", "graph.nodes", "at most 1000000"]),
    ("register", "--config huge_influences.toml", LOADING, &["huge_influences.toml", "graph.influences", "at most 1000000"]),
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
    ("register", "--out folder.obj", WRITING, &["folder.obj", "is a folder"]),
    ("register", "--report folder.json", WRITING, &["folder.json", "is a folder"]),
    ("register", "--picture folder.png", WRITING, &["folder.png", "is a folder"]),
    ("register", "--out rig/template.obj", ARGUMENTS, &["--out", "rig/template.obj", "template"]),
    ("register", "--out case/../case/scan.ply", ARGUMENTS, &["--out", "scan.ply", "target"]),
    ("register", "--report case/landmarks.json", ARGUMENTS, &["--report", "case/landmarks.json", "landmarks"]),
    ("register", "--report rig/regions.json", ARGUMENTS, &["--report", "rig/regions.json", "rig"]),
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
    ("eval", "--heatmap folder.png", WRITING, &["folder.png", "is a folder"]),
    ("eval", "--heatmap nowhere/h.png", WRITING, &["nowhere/h.png", "no folder"]),
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
    for command in ["register", "eval", "rig pca"] {
        bench.done(&command_line(command, "").replace("OUT", "new"));
    }
    assert_eq!(
        files_in(&bench.path("new")),
        [".keep", "h.png", "people_rig", "r.json", "r.obj", "r.png", "r.timing.json"]
    );
}

#[test]
fn every_row_is_one_clear_error_and_leaves_no_trace() {
    let bench = broken();
    let mut faults = Vec::new();
    for &(command, changes, code, words) in ROWS {
        // Once without output files and once with older ones.
        for folder in ["new", "old"] {
            let line = command_line(command, changes);
            match refuses(env!("CARGO_BIN_EXE_nonrigid"), &bench.path(""), &line.replace("OUT", folder), code, words) {
                Ok(stdout) if stdout.is_empty() => {}
                Ok(stdout) => faults.push(format!("{line}\n  prints {stdout:?}")),
                Err(fault) => faults.push(fault),
            }
            if !line.contains("OUT") {
                break;
            }
        }
    }
    all_hold(ROWS.len(), &faults);
}
