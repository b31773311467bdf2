//! The same files at 1, 2 and 4 threads and from run to run: every command of `nonrigid`, with every model.

use crate::repeats::leaves_equal_files;
use crate::support::Bench;
use nonrigid::io::write_obj;
use nonrigid::morph::MorphModel;
use nonrigid::registration::ModelKind;

const PROGRAM: &str = env!("CARGO_BIN_EXE_nonrigid");
const OUTPUTS: &str = "--out OUT/r.obj --report OUT/r.json --picture OUT/r.png --threads THREADS";

#[test]
fn registrations_leave_the_same_files_with_every_model() {
    let bench = Bench::new();
    let fit = "register --template rig/template.obj --neutral case/neutral.npy --rig rig --target case/scan.ply";
    for model in ModelKind::ALL {
        let line = format!("{fit} --landmarks case/landmarks.json --model {model} {OUTPUTS}");
        assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, false), 4, "{model}");
    }
    // With a start that is searched, identity modes and bounds.
    let line = format!("{fit} --identity-modes 5 --expression-bounds 0,1 {OUTPUTS}");
    assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, false), 4);
}

#[test]
fn all_other_commands_print_and_leave_the_same() {
    let bench = Bench::new();
    let eval = "eval --result case/neutral.npy --template rig/template.obj --json --heatmap OUT/h.png";
    for line in [
        format!("{eval} --truth case/truth.npy --observed case/observed.npy"),
        format!("{eval} --target case/scan.ply"),
    ] {
        assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, true), 1);
    }
    assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), "rig info rig --json", true), 0);
    for k in 0..6 {
        bench.write(&format!("people/{k}.obj"), {
            let height = |i: usize| ((k * i) as f64 * 0.37).sin();
            let vertices = (0..2000).map(|i| format!("v {} {} {}\n", i % 40, i / 40, height(i)));
            vertices.collect::<String>() + "f 1 2 42 41\n"
        });
    }
    for align in ["rigid", "similarity", "none"] {
        let line = format!("rig pca --meshes people --components 3 --align {align} --out OUT/rig --threads THREADS");
        assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, true), 6, "{align}");
    }
}

#[test]
fn morphs_measurements_and_converters_print_and_leave_the_same() {
    let bench = Bench::new();
    let face = "--mesh rig/template.obj --rig rig";
    let morph = format!("morph {face} --identity-modes 5 --preset nose-tip --preset cheekbone");
    for model in MorphModel::all() {
        let outputs = "--out OUT/m.obj --masks OUT/masks --report OUT/page --threads THREADS";
        let line = format!("{morph} --model {} {outputs}", model.name());
        assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, true), 12, "{}", model.name());
    }
    bench.write("frames/.keep", "");
    for k in 0..3 {
        let positions = bench.rig.pose(&[0.2 * f64::from(k); 10], &[0.5]);
        let frame = bench.rig.mesh.with_positions(positions);
        write_obj(&bench.path(&format!("frames/{k}.obj")), &frame).unwrap();
    }
    let subject = bench.rig.mesh.with_positions(bench.case.truth.clone());
    write_obj(&bench.path("subject.obj"), &subject).unwrap();
    let landmarks = "--landmarks rig/landmarks_anthropometric.json";
    let fit = "rig fit --rig rig --meshes frames";
    let carry = "landmarks transfer rig/landmarks_multipie68.json OUT/points.json --from rig/template.obj";
    for (line, files) in [
        (
            format!(
                "measure {face} --after case/neutral.npy {landmarks} --json OUT/m.json --csv OUT/m.csv --report OUT/page --threads THREADS"
            ),
            7,
        ),
        ("rig convert --rig rig --out OUT/rig.glb".to_owned(), 1),
        ("rig convert --rig rig --out OUT/rig.npz".to_owned(), 1),
        ("rig transfer --rig rig --subject case/neutral.npy --out OUT/me.glb".to_owned(), 1),
        ("rig convert --rig rig --out OUT/shapes --format shapes".to_owned(), bench.rig.expressions.len() + 8 + 6),
        (format!("{fit} --out OUT/weights.csv"), 1),
        (format!("{fit} --align similarity --bounds -1,1 --out OUT/weights.json"), 1),
        (format!("{carry} --to subject.obj"), 1),
        (format!("{carry} --to case/scan.ply --registered subject.obj"), 1),
        ("landmarks convert rig/landmarks_multipie68.json OUT/points.csv --mesh rig/template.obj".to_owned(), 1),
    ] {
        assert_eq!(leaves_equal_files(PROGRAM, &bench.path(""), &line, true), files, "{line}");
    }
}
