//! `nonrigid morph` as people call it: outputs, and their bytes at any number of threads.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use data_gen::{FaceOptions, FaceRig, write_rig};
use nonrigid::io::{read_mesh_file, read_npy_vector, read_polygon_mesh, write_colored_mesh};
use serde_json::Value;

struct Fixture {
    folder: tempfile::TempDir,
}

static FIXTURE: LazyLock<Fixture> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let rig = FaceRig::generate(&FaceOptions { vertices: 1500, identity_modes: 10 });
    write_rig(&folder.path().join("rig"), &rig).unwrap();
    Fixture { folder }
});

impl Fixture {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn morph(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
        command.current_dir(self.folder.path()).arg("morph").args(arguments).output().unwrap()
    }

    fn done(&self, arguments: &[&str]) -> String {
        let output = self.morph(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{arguments:?}: {said}");
        String::from_utf8(output.stdout).unwrap()
    }
}

const FACE: [&str; 4] = ["--mesh", "rig/template.obj", "--rig", "rig"];

/// An OBJ file without its first line, which names the materials beside it.
fn but_for_the_library(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let (first, rest) = text.split_once('\n').unwrap();
    assert_eq!(first, format!("mtllib {}.mtl", path.file_stem().unwrap().display()));
    rest.to_owned()
}

#[test]
fn presets_leave_mesh_masks_and_report() {
    let f = &*FIXTURE;
    let outputs = ["--out", "one.obj", "--masks", "one-masks", "--report", "one-report"];
    let presets = ["--preset", "nose-bridge=2", "--preset", "cheekbone", "--model", "graph"];
    let said = f.done(&[&FACE[..], &presets, &outputs].concat());
    let [out, masks, report] = ["one.obj", "one-masks", "one-report"].map(|name| f.path(name));
    assert!(said.starts_with("1. nose-bridge (graph in ") && said.lines().count() == 2, "{said}");
    let (before, after) = (read_polygon_mesh(&f.path("rig/template.obj")).unwrap(), read_polygon_mesh(&out).unwrap());
    assert_eq!((&before.corners, &before.metadata.uvs), (&after.corners, &after.metadata.uvs));
    let count = before.positions.len();
    let moved = before.positions.iter().zip(&after.positions).filter(|(a, b)| a != b).count();
    assert!(moved > 20 && moved < count / 2, "{moved}");
    let weights = read_npy_vector(&masks.join("step2-mask1.npy"), Some(count)).unwrap();
    assert!(weights.iter().any(|w| *w > 0.9) && masks.join("step1-mask1.png").exists());
    let steps: Value = serde_json::from_str(&fs::read_to_string(report.join("morph.json")).unwrap()).unwrap();
    assert_eq!(
        (&steps[0]["step"], &steps[0]["model"], &steps[0]["folded"]),
        (&"nose-bridge".into(), &"graph".into(), &0.into())
    );
    let page = fs::read_to_string(report.join("index.html")).unwrap();
    assert!(
        page.contains("1. nose-bridge (graph in ") && page.contains("nasofrontal") && page.contains("data:image/png")
    );
}

#[test]
fn a_printed_preset_is_a_recipe_that_does_the_same() {
    let f = &*FIXTURE;
    assert_eq!(f.done(&["--list"]).lines().count(), 20);
    fs::write(f.path("printed.toml"), f.done(&["--print", "thin-face"])).unwrap();
    let by = |what: [&str; 2], out: &str| {
        f.done(&[&FACE[..], &what, &["--out", out]].concat());
        fs::read(f.path(out)).unwrap()
    };
    assert_eq!(by(["--preset", "thin-face"], "preset.ply"), by(["--recipe", "printed.toml"], "recipe.ply"));
    // A mask that was written is a mask that can be read.
    f.done(&[&FACE[..], &["--preset", "thin-face", "--masks", "written", "--out", "again.ply"]].concat());
    let recipe = "[[step]]\n[[step.mask]]\nweights = \"written/step1-mask1.npy\"\ndisplacement = [0, 0, 1]\n";
    fs::write(f.path("by-weights.toml"), recipe).unwrap();
    let said = f.done(&["--mesh", "rig/template.obj", "--recipe", "by-weights.toml", "--out", "w.obj"]);
    assert!(said.contains("of 1.00 asked"), "{said}");
}

#[test]
fn an_amount_beyond_a_presets_range_is_done_with_a_warning() {
    let output = FIXTURE.morph(&[&FACE[..], &["--preset", "nose-bridge=9", "--out", "far.obj"]].concat());
    let warned = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && warned.contains("made for amounts from -2 to 4, not 9"), "{warned}");
}

#[test]
fn plans_stand_beside_each_other_and_a_tear_is_in_the_report() {
    let f = &*FIXTURE;
    let chin = f.done(&["--print", "chin-forward"]);
    fs::write(f.path("mild.toml"), &chin).unwrap();
    let wild = chin.replace("amount = 3.0", "amount = 60.0") + "\n[[step.protect]]\nparts = [\"nose\"]\n";
    fs::write(f.path("wild.toml"), &wild).unwrap();
    let arguments = ["--recipe", "mild.toml", "--compare", "wild.toml", "--out", "mild.obj", "--report", "beside"];
    let client = ["--client", "A. <Miller>", "--date", "2026-05-04"];
    f.done(&[&FACE[..], &arguments, &client].concat());
    f.done(&[&FACE[..], &["--recipe", "mild.toml", "--out", "alone.obj"]].concat());
    assert_eq!(but_for_the_library(&f.path("mild.obj")), but_for_the_library(&f.path("alone.obj")));
    let page = fs::read_to_string(f.path("beside/index.html")).unwrap();
    for part in
        ["<th>mild</th>", "<th>wild</th>", "<b>doubt</b> step 1 folds", "Blue: protected", "lower lip to E-line"]
    {
        assert!(page.contains(part), "{part}");
    }
    assert!(page.contains("A. &lt;Miller&gt;") && page.contains("2026-05-04") && page.contains("@media print"));
    let same = f.morph(&[&FACE[..], &["--recipe", "mild.toml", "--compare", "mild.obj", "--out", "x.obj"]].concat());
    let said = String::from_utf8_lossy(&same.stderr);
    assert!(!same.status.success() && said.contains("--report"), "{said}");
}

#[test]
fn colours_of_vertices_go_along_into_every_format() {
    let f = &*FIXTURE;
    let mesh = read_polygon_mesh(&f.path("rig/template.obj")).unwrap();
    let colors: Vec<[u8; 3]> = (0..mesh.positions.len()).map(|v| [(v % 251) as u8, 7, 200]).collect();
    write_colored_mesh(&f.path("painted.obj"), &mesh, Some(&colors)).unwrap();
    for out in ["painted_out.obj", "painted_out.ply", "painted_out.glb", "painted_out.usda"] {
        f.done(&["--mesh", "painted.obj", "--rig", "rig", "--preset", "nose-tip", "--out", out]);
        match out.ends_with("usda") {
            true => assert!(fs::read_to_string(f.path(out)).unwrap().contains("primvars:displayColor")),
            false => assert_eq!(read_mesh_file(&f.path(out)).unwrap().colors.as_ref(), Some(&colors), "{out}"),
        }
    }
}

#[test]
fn what_is_doubtful_or_without_effect_is_said() {
    let f = &*FIXTURE;
    let warned = |arguments: &[&str]| {
        let output = f.morph(&[&FACE[..], arguments].concat());
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let nose = f.done(&["--print", "nose-tip"]);
    fs::write(f.path("nose.toml"), &nose).unwrap();
    fs::write(
        f.path("few.toml"),
        nose.replace("[[step]]", "[[step]]\nmodel = \"arap\"\nenergy = { max_iterations = 2 }"),
    )
    .unwrap();
    let quiet = warned(&["--recipe", "nose.toml", "--out", "q.ply"]);
    assert!(!quiet.contains("no effect") && !quiet.contains("settled") && !quiet.contains("is made for"), "{quiet}");
    for (arguments, said) in [
        (&["--recipe", "few.toml"][..], "step 1 ended after 2 steps before its energy had settled"),
        (&["--recipe", "nose.toml", "--amount", "40"], "nose.toml is made for amounts from -2 to 3, not 40"),
        (&["--recipe", "nose.toml", "--weight-bounds", "0,1"], "--weight-bounds has no effect"),
        (&["--recipe", "nose.toml", "--shapes", "jawOpen"], "--shapes has no effect"),
        (&["--recipe", "nose.toml", "--shape-kind", "full"], "--shape-kind has no effect: rig"),
        (&["--recipe", "few.toml", "--model", "direct"], "few.toml: line 13: max_iterations has no effect"),
    ] {
        let found = warned(&[arguments, &["--out", "q.ply"]].concat());
        assert!(found.contains(said), "{said}: {found}");
        assert!(!found.contains("folds 0"), "{found}");
    }
}

#[test]
fn a_file_of_somebody_else_beside_the_result_stays() {
    let f = &*FIXTURE;
    fs::write(f.path("z.mtl"), "mine").unwrap();
    let refused = f.morph(&[&FACE[..], &["--preset", "nose-tip", "--out", "z.obj"]].concat());
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(3) && said.contains("z.mtl: is there already"), "{said}");
    assert_eq!(fs::read_to_string(f.path("z.mtl")).unwrap(), "mine");
    // those of the run before are replaced
    for _ in 0..2 {
        f.done(&[&FACE[..], &["--preset", "nose-tip", "--out", "zz.obj"]].concat());
    }
}
