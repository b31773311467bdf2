//! `nonrigid morph` as people call it: outputs, their bytes at any number of threads, and one clear error for each mistake.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use data_gen::{FaceOptions, FaceRig, write_rig};
use nonrigid::mesh::io::{read_npy_vector, read_polygon_mesh};
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

#[test]
fn presets_leave_mesh_masks_and_report_the_same_at_any_number_of_threads() {
    let f = &*FIXTURE;
    let run = |name: &str, threads: &str| {
        let (out, masks, report) = (format!("{name}.obj"), format!("{name}-masks"), format!("{name}-report"));
        let mut arguments = FACE.to_vec();
        arguments.extend(["--preset", "nose-bridge=2", "--preset", "cheekbone", "--model", "graph", "--out", &out]);
        arguments.extend(["--masks", &masks, "--report", &report, "--threads", threads]);
        let said = f.done(&arguments);
        (said, f.path(&out), f.path(&masks), f.path(&report))
    };
    let (said, out, masks, report) = run("one", "1");
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

    let (again, other, other_masks, other_report) = run("two", "2");
    assert_eq!(said, again);
    assert_eq!(fs::read(&out).unwrap(), fs::read(&other).unwrap());
    for (a, b) in [(&masks, &other_masks), (&report, &other_report)] {
        for entry in fs::read_dir(a).unwrap() {
            let name = entry.unwrap().file_name();
            assert_eq!(fs::read(a.join(&name)).unwrap(), fs::read(b.join(&name)).unwrap(), "{}", name.display());
        }
    }
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
fn mistakes_are_named_and_leave_nothing() {
    let f = &*FIXTURE;
    let recipe = "frame = { origin = [\"30\"], right = [\"36\", \"45\"], up = [\"8\", \"27\"] }\n[[step]]\n[[step.mask]]\n\
                  region = { circle = { centre = [0, 0], radius = 9 } }\ndisplacement = [0, 0, 1]\n";
    fs::write(f.path("recipe.toml"), recipe).unwrap();
    fs::write(f.path("far.toml"), recipe.replace("[0, 0], radius", "[500, 0], radius")).unwrap();
    fs::write(f.path("broken.toml"), "[[step]]\nmodle = \"arap\"\n").unwrap();
    fs::write(
        f.path("png.toml"),
        recipe.replace("region = { circle = { centre = [0, 0], radius = 9 } }", "png = \"no.png\""),
    )
    .unwrap();
    fs::write(f.path("short.npy"), fs::read(f.path("rig/neutral.npy")).unwrap()).unwrap();
    fs::write(f.path("short.toml"), "[[step]]\n[[step.mask]]\nweights = \"short.npy\"\n").unwrap();
    fs::write(f.path("landmarks.json"), "[0, 1, 99999999]").unwrap();
    fs::write(f.path("empty.obj"), "").unwrap();
    fs::write(f.path("file"), "").unwrap();
    let face: &[&str] = &FACE;
    let plain: &[&str] = &["--mesh", "rig/template.obj"];
    let table: &[(&[&str], &[&str], i32, &str)] = &[
        (face, &["--preset", "nose"], 1, "unknown preset 'nose'; there are thin-face"),
        (face, &["--preset", "nose-bridge=two"], 1, "--preset nose-bridge: expected millimetres, found \"two\""),
        (face, &["--preset", "nose-bridge=nan"], 1, "found \"nan\""),
        (face, &["--preset", "nose-bridge", "--recipe", "recipe.toml"], 1, "cannot be used with"),
        (face, &[], 1, "required"),
        (face, &["--preset", "nose-bridge", "--model", "clay"], 1, "unknown model 'clay'; there are direct"),
        (face, &["--preset", "nose-bridge", "--until", "1"], 1, "cannot be used with"),
        (face, &["--recipe", "recipe.toml", "--until", "0"], 1, "--until: recipe.toml has 1 steps"),
        (face, &["--recipe", "recipe.toml", "--until", "2"], 1, "--until: recipe.toml has 1 steps"),
        (plain, &["--preset", "nose-bridge"], 1, "give --landmarks"),
        (plain, &["--preset", "nose-bridge", "--weight-bounds", "0,1"], 1, "--rig"),
        (
            plain,
            &["--recipe", "recipe.toml", "--model", "hybrid", "--landmarks", "rig/landmarks_multipie68.json"],
            2,
            "needs blendshapes",
        ),
        (face, &["--recipe", "far.toml"], 2, "far.toml: line 2: nothing is left to move"),
        (face, &["--recipe", "broken.toml"], 4, "broken.toml: line 2: unknown field `modle`"),
        (face, &["--recipe", "none.toml"], 4, "none.toml: cannot be read"),
        (face, &["--recipe", "png.toml"], 4, "no.png: cannot be read"),
        (face, &["--recipe", "short.toml"], 4, "short.npy"),
        (plain, &["--preset", "nose-bridge", "--landmarks", "landmarks.json"], 4, "99999999"),
        (plain, &["--preset", "nose-bridge", "--landmarks", "none.json"], 4, "none.json: cannot be read"),
        (&["--mesh", "none.obj"], &["--preset", "nose-bridge"], 4, "none.obj: cannot be read"),
        (&["--mesh", "empty.obj"], &["--preset", "nose-bridge"], 4, "empty.obj"),
        (face, &["--preset", "nose-bridge", "--masks", "file"], 3, "file: cannot be written"),
        (face, &["--preset", "nose-bridge", "--report", "no/such/folder"], 3, "there is no folder"),
    ];
    for (mesh, what, code, said) in table {
        let before = listing(f.folder.path());
        let output = f.morph(&[mesh, *what, &["--out", "wrong.obj"]].concat());
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(*code), "{what:?}: {error}");
        assert!(error.contains(said), "{what:?}: {error}");
        assert!(*code == 1 || error.lines().filter(|l| l.starts_with("error:")).count() == 1, "{error}");
        assert!(!error.contains("panicked") && output.stdout.is_empty());
        assert_eq!(listing(f.folder.path()), before, "{what:?}");
    }
    let output = f.morph(&[face, &["--preset", "nose-bridge", "--out", "wrong.stl"]].concat());
    assert_eq!(output.status.code(), Some(1));
    let output = f.morph(&[face, &["--preset", "nose-bridge=9", "--out", "far.obj"]].concat());
    let warned = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && warned.contains("made for -2 to 4 mm, not 9"), "{warned}");
}

/// Files that other tests of this fixture do not write.
fn listing(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> =
        names.filter(|n| n.starts_with("wrong") || n.starts_with("no") || n == "file").collect();
    names.sort();
    names
}
