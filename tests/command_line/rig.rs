//! `nonrigid rig convert` and `nonrigid rig fit` on generated data.

use std::path::Path;

use crate::support::{Bench, farthest};
use data_gen::{Motion, ScanOptions};
use nonrigid::io::{write_npy_points, write_obj};
use nonrigid::mesh::{Pose, Vec3};
use nonrigid::rig::{Family, Rig, RigReadOptions};
use serde_json::Value;

/// The forms of a rig, as `--out` and further options say them.
const FORMS: [(&str, &str); 4] = [("npy", ""), ("shapes", " --format shapes"), ("rig.npz", ""), ("rig.glb", "")];

fn read(path: &Path) -> Rig {
    let (rig, warnings) = Rig::read(path, &RigReadOptions::default()).unwrap();
    assert_eq!(warnings, [], "{}", path.display());
    rig
}

/// What forms on the way have not kept.
#[derive(Default, Clone, Copy)]
struct Lost {
    families: bool,
    landmarks: bool,
    groups: bool,
    materials: bool,
    named: bool,
}

fn lost_in(form: &str) -> Lost {
    match form {
        "shapes" => Lost { families: true, landmarks: true, ..Lost::default() },
        "rig.npz" => Lost { groups: true, named: true, ..Lost::default() },
        "rig.glb" => Lost { materials: true, named: true, ..Lost::default() },
        _ => Lost::default(),
    }
}

/// `rig` is `original`, but for what was lost, and for the 32 bits of a metre that a .glb has.
fn assert_same(rig: &Rig, original: &Rig, lost: Lost, what: &str) {
    let (a, b) = (rig.mesh().unwrap(), original.mesh().unwrap());
    assert!(farthest(rig.neutral(), original.neutral()) < if what.contains("glb") { 1e-4 } else { 1e-12 }, "{what}");
    assert_eq!(
        (&a.starts, &a.corners, &a.metadata.corner_uvs),
        (&b.starts, &b.corners, &b.metadata.corner_uvs),
        "{what}"
    );
    for (a, b) in a.metadata.uvs.iter().zip(&b.metadata.uvs) {
        assert!((a[0] - b[0]).abs() < 1e-7 && (a[1] - b[1]).abs() < 1e-7, "{what}");
    }
    let groups = if lost.groups { 0 } else { b.metadata.statements.len() };
    assert_eq!(a.metadata.statements.len(), groups, "{what}");
    assert_eq!(rig.regions(), original.regions(), "{what}");
    assert_eq!(rig.landmarks(), original.landmarks().filter(|_| !lost.landmarks), "{what}");
    let names = |rig: &Rig| {
        let mut names: Vec<String> = rig.shapes().iter().map(|s| s.name.clone()).collect();
        names.sort();
        names
    };
    assert_eq!(names(rig), names(original), "{what}");
    let tolerance = if what.contains("glb") { 1e-5 } else { 1e-12 };
    for (k, shape) in rig.shapes().iter().enumerate() {
        let of = original.find(&shape.name).unwrap();
        let identity = [shape.family, original.shapes()[of].family].map(|f| f == Family::Identity);
        assert_eq!(identity[0], identity[1] && !lost.families, "{what}: {}", shape.name);
        let far = rig.deltas(k).iter().zip(original.deltas(of)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far < tolerance, "{what}: {} by {far}", shape.name);
    }
}

#[test]
fn every_form_of_a_rig_becomes_every_other() {
    let bench = Bench::new();
    let original = read(&bench.path("rig"));
    assert!(original.landmarks().is_some() && original.regions().is_some(), "the test needs both");
    let identities = original.shapes().iter().filter(|s| s.family == Family::Identity).count();
    assert!(identities > 0 && identities < original.shapes().len());
    let anthropometric = bench.read("rig/landmarks_anthropometric.json");
    let json = |bytes: &[u8]| serde_json::from_slice::<serde_json::Value>(bytes).unwrap();
    for (from, from_options) in FORMS {
        bench.write(&format!("from_{from}/.keep"), "");
        let first = format!("from_{from}/{from}");
        let said = bench.run(&format!("rig convert --rig rig --out {first}{from_options}"));
        assert_eq!(said.code, 0, "{}", said.stderr);
        let before = lost_in(from);
        for (kind, lost) in [
            ("families", before.families),
            ("landmarks", before.landmarks),
            ("groups and materials", before.groups),
            ("colours and images of materials, their names alone", before.materials),
            ("named landmarks: landmarks.json, landmarks_anthropometric.json", before.named),
        ] {
            let told = said.stderr.contains(&format!("{first}: this form of a rig holds no {kind}"));
            assert_eq!(told, lost, "{first}, {kind}: {}", said.stderr);
        }
        assert_same(&read(&bench.path(&first)), &original, before, from);
        for (to, to_options) in FORMS {
            let second = format!("from_{from}/to_{to}");
            let stderr = bench.ends(&format!("rig convert --rig {first} --out {second}{to_options}"), 0);
            let after = lost_in(to);
            // what is gone already is not lost again
            let lines = [
                after.families && !before.families,
                after.landmarks && !before.landmarks,
                after.groups && !before.groups,
                // those of .npz went with the groups
                after.materials && !before.materials && !before.groups,
                after.named && !before.named,
            ];
            let lines = lines.iter().filter(|lost| **lost).count();
            let warned = stderr.lines().filter(|line| line.starts_with("warning: ")).count();
            assert_eq!(warned, lines, "{first} to {second}: {stderr}");
            let lost = Lost {
                families: before.families || after.families,
                landmarks: before.landmarks || after.landmarks,
                groups: before.groups || after.groups,
                materials: before.materials || after.materials,
                named: before.named || after.named,
            };
            let named = bench.path(&second).join("landmarks_anthropometric.json");
            let same = !lost.named && std::fs::read(named).is_ok_and(|b| json(&b) == json(&anthropometric));
            assert_eq!(same, !lost.named, "{from} to {to}");
            assert_same(&read(&bench.path(&second)), &original, lost, &format!("{from} to {to}"));
        }
    }
    // a result among its shapes would be one of them
    let folder = "from_npy/to_shapes";
    let of_rig = format!("--template {folder}/neutral.obj --rig {folder} --out {folder}");
    bench.write("one.csv", "scan,name\ncase/scan.ply,one\n");
    for line in [format!("register {of_rig}/one.obj --target case/scan.ply"), format!("batch one.csv {of_rig}")] {
        let stderr = bench.ends(&line, 1);
        assert!(stderr.contains("would become a shape of the rig"), "{stderr}");
    }
    // the same again, over what is there
    let before = bench.read("from_npy/to_shapes/jawOpen.obj");
    bench.done("rig convert --rig from_npy/npy --out from_npy/to_shapes --format shapes");
    assert!(bench.read("from_npy/to_shapes/jawOpen.obj") == before);
}

/// Frames of a person who is not the rig's neutral, with a moving head.
struct Sequence {
    bench: Bench,
    /// Weights by frame.
    weights: Vec<(String, Vec<f64>)>,
    poses: Vec<Pose>,
}

impl Sequence {
    /// Frames 0, 1, 4, 5 and 9 of ten a second: the others are missing. Weights are those of the motion, times `strength`.
    fn new(strength: f64) -> Self {
        let bench = Bench::new();
        let motion = Motion::new(&bench.rig, &ScanOptions::default(), 1.0, 5).unwrap();
        let person: Vec<f64> = (0..8).map(|k| (1.7 * k as f64).sin()).collect();
        write_npy_points(&bench.path("person.npy"), &bench.rig.pose(&[], &person)).unwrap();
        bench.write("frames/notes.txt", "not a frame");
        let (mut weights, mut poses) = (Vec::new(), Vec::new());
        for frame in [0, 1, 4, 5, 9] {
            let seconds = 0.1 * f64::from(frame);
            let w: Vec<f64> = motion.weights(seconds).iter().map(|w| strength * w).collect();
            let pose = motion.pose(seconds);
            let positions = bench.rig.pose(&w, &person).into_iter().map(|p| pose.apply(p)).collect();
            let name = format!("{frame:04}");
            write_obj(&bench.path(&format!("frames/{name}.obj")), &bench.rig.mesh.with_positions(positions)).unwrap();
            weights.push((name, w));
            poses.push(pose);
        }
        Self { bench, weights, poses }
    }

    /// Fits to a .csv and a .json, which have to agree; frames with their weights, and the JSON.
    fn fit(&self, options: &str) -> (Vec<(String, Vec<f64>)>, Value) {
        let line = format!("rig fit --rig rig --neutral person.npy --meshes frames {options}");
        let said = self.bench.done(&format!("{line} --out weights.csv"));
        assert!(said.starts_with("5 frames, "), "{said}");
        self.bench.done(&format!("{line} --out weights.json"));
        let json = self.bench.json("weights.json");
        let text = String::from_utf8(self.bench.read("weights.csv")).unwrap();
        let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let head = rows.next().unwrap();
        let names: Vec<&str> = json["shapes"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
        assert_eq!((&head[..3], &head[3..]), (&["frame", "rms_mm", "max_mm"][..], &names[..]));
        let frames = json["frames"].as_array().unwrap();
        let rows: Vec<Vec<&str>> = rows.collect();
        assert_eq!(rows.len(), frames.len());
        let read = |(row, frame): (&Vec<&str>, &Value)| {
            let numbers: Vec<f64> = row[1..].iter().map(|n| n.parse().unwrap()).collect();
            let weights: Vec<f64> = frame["weights"].as_array().unwrap().iter().map(|w| w.as_f64().unwrap()).collect();
            assert_eq!((row[0], numbers[0]), (frame["name"].as_str().unwrap(), frame["rms"].as_f64().unwrap()));
            assert_eq!((numbers[1], &numbers[2..]), (frame["max"].as_f64().unwrap(), &weights[..]));
            assert_eq!(frame["converged"], true);
            (row[0].to_owned(), weights)
        };
        (rows.iter().zip(frames).map(read).collect(), json)
    }

    /// The largest difference to the true weights, which frames of the same names have.
    fn far_from(&self, fitted: &[(String, Vec<f64>)], truth: impl Fn(f64) -> f64) -> f64 {
        let names = |list: &[(String, Vec<f64>)]| list.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
        assert_eq!(names(fitted), names(&self.weights));
        let pairs = fitted.iter().zip(&self.weights).flat_map(|(a, b)| a.1.iter().zip(&b.1));
        pairs.map(|(a, b)| (a - truth(*b)).abs()).fold(0.0, f64::max)
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
}

#[test]
fn weights_and_poses_of_a_sequence_come_back() {
    let sequence = Sequence::new(1.0);
    let moved = sequence.weights.iter().flat_map(|f| &f.1).copied().fold(0.0, f64::max);
    assert!(moved > 0.3, "{moved}");
    let (fitted, json) = sequence.fit("");
    let far = sequence.far_from(&fitted, |w| w);
    assert!(far < 1e-3, "{far}");
    for (frame, pose) in json["frames"].as_array().unwrap().iter().zip(&sequence.poses) {
        assert!(frame["max"].as_f64().unwrap() < 1e-3, "{frame}");
        let off = Vec3::from_column_slice(&numbers(&frame["pose"]["translation"])) - pose.translation;
        let rows = frame["pose"]["rotation"].as_array().unwrap().iter().flat_map(numbers);
        let turned = rows.zip(pose.rotation.transpose().iter()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off.norm() < 1e-2 && turned < 1e-4 && frame["pose"]["scale"] == 1.0, "{frame}");
    }
    let (fitted, json) = sequence.fit("--align similarity");
    assert!(sequence.far_from(&fitted, |w| w) < 1e-3);
    assert!((json["frames"][4]["pose"]["scale"].as_f64().unwrap() - 1.0).abs() < 1e-4);
    // without a pose the moving head is not explained
    let (_, json) = sequence.fit("--align none");
    assert!(json["frames"][4]["rms"].as_f64().unwrap() > 0.5, "{}", json["frames"][4]["rms"]);
}

#[test]
fn bounds_of_weights_hold_and_chosen_shapes_are_fitted_alone() {
    let sequence = Sequence::new(-1.0);
    let (fitted, _) = sequence.fit("");
    assert!(fitted.iter().flat_map(|f| &f.1).all(|w| (0.0..=1.0).contains(w)));
    let (fitted, _) = sequence.fit("--bounds -1,0");
    let far = sequence.far_from(&fitted, |w| w);
    assert!(far < 1e-3, "{far}");
    let (fitted, _) = sequence.fit("--bounds -0.25,0.125");
    assert!(fitted.iter().flat_map(|f| &f.1).all(|w| (-0.25..=0.125).contains(w)));
    assert!(fitted.iter().flat_map(|f| &f.1).any(|w| *w == -0.25), "no weight is at its bound");
    let (fitted, json) = sequence.fit("--shapes mouthLeft,jawOpen --bounds -1,1");
    assert_eq!(json["shapes"], serde_json::json!(["mouthLeft", "jawOpen"]));
    assert!(fitted.iter().all(|f| f.1.len() == 2));
}

#[test]
fn colours_that_stay_in_a_gltf_are_said() {
    let bench = Bench::new();
    bench.done("rig convert --rig rig --out ours.glb");
    let template = bench.text("rig/template.obj");
    bench.write("rig/template.obj", template.replacen("mtllib", "#", 1));
    bench.done("rig convert --rig rig --out theirs.glb"); // as of other programs, no library is noted
    for (out, rig, said) in [
        ("a", "theirs.glb", true),
        ("b.glb", "theirs.glb", true),
        ("b.npz", "theirs.glb", false),
        ("c", "ours.glb", false),
    ] {
        let stderr = bench.ends(&format!("rig convert --rig {rig} --out {out}"), 0);
        assert_eq!(stderr.contains("their colours and images stay with theirs.glb"), said, "{out}: {stderr}");
    }
}

#[test]
fn components_keep_the_materials_of_the_first_mesh() {
    let bench = Bench::new();
    bench.write("people/face.mtl", bench.read("rig/face.mtl"));
    for (name, weight) in [("a", -1.0), ("b", 0.0), ("c", 1.0)] {
        let person = bench.rig.mesh.with_positions(bench.rig.pose(&[], &[weight, 0.3 * weight * weight]));
        write_obj(&bench.path(&format!("people/{name}.obj")), &person).unwrap();
    }
    for _ in 0..2 {
        bench.done("rig pca --meshes people --components 2 --out modes");
        let template = bench.text("modes/template.obj");
        assert!(
            template.starts_with("mtllib template.mtl\n") && template.contains("usemtl lips"),
            "{}",
            &template[..200]
        );
        assert!(bench.read("modes/template.mtl") == bench.read("rig/face.mtl"));
    }
    bench.write("other/template.mtl", "mine");
    let stderr = bench.ends("rig pca --meshes people --components 2 --out other", 3);
    assert!(stderr.contains("template.mtl: is there already"), "{stderr}");
    let stderr = bench.ends("rig convert --rig rig --out other", 3);
    assert!(stderr.contains("template.mtl: is there already"), "{stderr}");
    assert!(bench.read("other/template.mtl") == b"mine" && !bench.path("other/neutral.npy").exists());
}

#[test]
fn a_subject_with_an_expression_is_no_neutral() {
    let bench = Bench::new();
    let (_, jaw) = bench.rig.expressions.iter().find(|(name, _)| name == "jawOpen").unwrap();
    for (weight, said) in [(0.0, false), (0.8, true)] {
        let modes = |v: usize| 1.5 * bench.rig.identities[0][v] - bench.rig.identities[1][v];
        let subject = (0..jaw.len()).map(|v| bench.rig.neutral[v] + modes(v) + weight * jaw[v]);
        write_obj(&bench.path("subject.obj"), &bench.rig.mesh.with_positions(subject.collect())).unwrap();
        let stderr = bench.ends("rig transfer --rig rig --subject subject.obj --out me.npz", 0);
        assert_eq!(stderr.contains("the subject looks like \"jawOpen\" of 0."), said, "{weight}: {stderr}");
    }
}
