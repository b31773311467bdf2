//! The program: what it writes, what it refuses, and how it says so.

use std::path::Path;
use std::process::{Command, Output};

use nonrigid::io::{read_npy_mask, read_npy_points, read_scan};
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::rig::{Rig, RigReadOptions};

use crate::closed_stdout::minds_a_full_disk_only;
use crate::repeats::leaves_equal_files;

fn run(folder: &Path, arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_data-gen"));
    command.current_dir(folder).args(arguments.split_whitespace()).output().unwrap()
}

fn done(folder: &Path, arguments: &str) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

const SMALL: &str = "--seed 7 --out data --vertices 1000 --identity-modes 6 --triangles 5000";

#[test]
fn six_cases_by_default_and_one_of_them_alone_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let said = done(folder.path(), SMALL);
    assert!(said.starts_with("seed 7\n") && said.contains("[6/6]"), "{said}");
    let data = folder.path().join("data");
    let (rig, warnings) = Rig::read(&data.join("rig"), &RigReadOptions::default()).unwrap();
    assert!(warnings.is_empty() && rig.landmarks().unwrap().len() == 68);
    let vertices = rig.mesh().unwrap().positions.len();
    for name in ["same_blink", "same_open", "same_smile", "new_asym", "new_neutral", "new_open"] {
        let case = data.join("cases").join(name);
        assert_eq!(read_npy_points(&case.join("truth.npy")).unwrap().len(), vertices);
        assert_eq!(case.join("neutral.npy").exists(), name.starts_with("same"));
        let observed = read_npy_mask(&case.join("observed.npy"), Some(vertices)).unwrap();
        let file = json(&case.join("case.json"));
        assert_eq!(file["observed"].as_u64().unwrap() as usize, observed.iter().filter(|o| **o).count());
        let scan = read_scan(&case.join("scan.ply")).unwrap().mesh;
        assert_eq!(file["triangles"].as_u64().unwrap() as usize, scan.triangles.len());
        assert_eq!(file["rig_identity_modes"], if name.starts_with("same") { 0 } else { 2 });
    }
    let open = json(&data.join("cases/same_open/case.json"));
    assert_eq!(open["expression"]["eyeWide_R"], 0.8);
    assert!(open["withhold"].as_array().unwrap().iter().any(|n| n == "mouthStretch_L"));
    assert!(!open["rig_expressions"].as_array().unwrap().iter().any(|n| n == "mouthStretch_L" || n == "jawForward"));

    let alone = SMALL.replace("data", "alone") + " --case new_asym --threads 3";
    done(folder.path(), &alone);
    let file = |root: &str, name: &str| {
        let case = if name.ends_with("deltas.npy") { "rig" } else { "cases/new_asym" };
        std::fs::read(folder.path().join(root).join(case).join(name)).unwrap()
    };
    for name in ["scan.ply", "truth.npy", "case.json", "landmarks.json", "expression_deltas.npy"] {
        assert!(file("data", name) == file("alone", name), "{name}");
    }
}

#[test]
fn sequences_are_cases_with_weights() {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &format!("{SMALL} --frames 3 --fps 5 --preset smile"));
    let sequence = folder.path().join("data/sequence");
    let table = std::fs::read_to_string(sequence.join("weights.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(rows.len(), 4);
    assert!(rows.iter().all(|r| r.len() == rows[0].len()) && rows[0][..2] == ["frame", "time"]);
    let smile = rows[0].iter().position(|n| *n == "mouthSmile_L").unwrap();
    let weights: Vec<f64> = rows[1..].iter().map(|r| r[smile].parse().unwrap()).collect();
    assert!(weights[0] == 0.0 && weights[0] < weights[1] && weights[1] < weights[2] && weights[2] < 1.0, "{weights:?}");
    let neutral = |frame: &str| std::fs::read(sequence.join(frame).join("neutral.npy")).unwrap();
    assert_eq!(neutral("frame_0000"), neutral("frame_0002"));
    let scan = |frame: &str| std::fs::read(sequence.join(frame).join("scan.ply")).unwrap();
    assert_ne!(scan("frame_0000"), scan("frame_0001"));
    assert_eq!(json(&sequence.join("frame_0002/case.json"))["expression"]["mouthSmile_L"], weights[2]);
}

#[test]
fn frames_of_a_sequence_are_seen_by_one_camera_and_cut_at_one_end() {
    let folder = tempfile::tempdir().unwrap();
    let still = "--scanner frame --keep 0.6 --rotation 0 --translation 0 --fps 1000 --holes 0";
    done(folder.path(), &format!("{SMALL} --frames 4 {still}"));
    let observed = |frame: usize| {
        read_npy_mask(&folder.path().join(format!("data/sequence/frame_{frame:04}/observed.npy")), None).unwrap()
    };
    let first = observed(0);
    for frame in 1..4 {
        let same = first.iter().zip(observed(frame)).filter(|(a, b)| **a == *b).count();
        assert!(same as f64 > 0.9 * first.len() as f64, "frame {frame}: {same} of {}", first.len());
    }
}

/// Of the observed vertices of a case, the mean and the largest distance of their true places to the scan; and how many they are.
fn distances(case: &Path) -> (f64, f64, usize) {
    let scan = ClosestPoint::new(&read_scan(&case.join("scan.ply")).unwrap().mesh).unwrap();
    let observed = read_npy_mask(&case.join("observed.npy"), None).unwrap();
    let truth = read_npy_points(&case.join("truth.npy")).unwrap();
    let seen = truth.iter().zip(&observed).filter(|(_, seen)| **seen);
    let found: Vec<f64> = seen.map(|(p, _)| (scan.query(p).unwrap().point - p).norm()).collect();
    (found.iter().sum::<f64>() / found.len() as f64, found.iter().copied().fold(0.0, f64::max), found.len())
}

#[test]
fn depth_cameras_scan_the_generated_face_and_any_rig() {
    let folder = tempfile::tempdir().unwrap();
    // Coarse scans of a fine face: what tells is that the scan is where the truth is.
    let small = SMALL.replace("5000", "20000");
    done(folder.path(), &format!("{small} --case new_open --scanner fused"));
    let (mean, most, fused) = distances(&folder.path().join("data/cases/new_open"));
    assert!(mean < 0.3 && most < 4.0 && fused > 700, "{mean} {most} {fused}");
    done(folder.path(), &format!("{small} --case new_open --scanner frame"));
    let (mean, most, frame) = distances(&folder.path().join("data/cases/new_open"));
    assert!(mean < 0.3 && most < 4.0 && 300 < frame && frame < fused, "{mean} {most} {frame} {fused}");

    // People of the rig that was just written, and that is not written again.
    let rig = folder.path().join("data/rig/expression_deltas.npy");
    let before = std::fs::metadata(&rig).unwrap().modified().unwrap();
    let people = "--seed 9 --out people --rig data/rig --cases 2 --triangles 20000";
    for scanner in ["fused", "frame"] {
        let said = done(folder.path(), &format!("{people} --scanner {scanner}"));
        assert!(said.contains("data/rig: ") && !folder.path().join("people/rig").exists(), "{said}");
        for name in ["same_0000", "new_0001"] {
            let case = folder.path().join("people/cases").join(name);
            let (mean, most, count) = distances(&case);
            assert!(mean < 0.3 && most < 4.0 && count > 300, "{scanner} {name}: {mean} {most} {count}");
            assert!(json(&case.join("landmarks.json")).as_object().unwrap().len() > 20);
        }
    }
    assert_eq!(std::fs::metadata(&rig).unwrap().modified().unwrap(), before);
}

#[test]
fn a_run_replaces_what_an_earlier_one_made_and_mixes_no_two_sets() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let small = format!("{SMALL} --frames 2 --population 2 --contact-sheet");
    done(folder.path(), &small);
    // What is beside the results is the user's, and stays; what an earlier run made is replaced.
    let notes = data.join("rig/notes.txt");
    std::fs::write(&notes, "mine").unwrap();
    let person = || std::fs::read(data.join("population/person_0001.obj")).unwrap();
    let before = person();
    done(folder.path(), &small.replace("--seed 7", "--seed 50"));
    assert!(person() != before && std::fs::read_to_string(&notes).unwrap() == "mine");
    // A smaller set would leave some of the larger one.
    for (fewer, left) in
        [("--frames 1", "sequence/frame_0001"), ("--cases 0 --population 1", "population/person_0001.obj")]
    {
        let output = run(folder.path(), &format!("{SMALL} {fewer}"));
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(3) && said.contains(left), "{said}");
    }
    // Nor do shapes of families stay that the rig has none of any more.
    done(folder.path(), &format!("{SMALL} --cases 0").replace("--identity-modes 6", "--identity-modes 0"));
    assert!(!data.join("rig/identity_deltas.npy").exists() && !data.join("rig/identity_names.json").exists());
    // What is gone since is not on record any more: what comes to stand there is the user's.
    let picture = data.join("contact_sheet.png");
    std::fs::remove_file(&picture).unwrap();
    done(folder.path(), &format!("{SMALL} --cases 0"));
    std::fs::write(&picture, "mine").unwrap();
    let output = run(folder.path(), &format!("{SMALL} --cases 0 --contact-sheet"));
    assert!(output.status.code() == Some(3) && std::fs::read_to_string(&picture).unwrap() == "mine");
}

#[test]
fn help_has_examples_and_exit_codes() {
    let folder = tempfile::tempdir().unwrap();
    let help = done(folder.path(), "--help");
    assert!(help.contains("Examples:") && help.contains("Exit codes") && help.contains("--camera"));
}

#[test]
fn a_reader_that_goes_away_is_no_error_and_a_full_disk_is() {
    let folder = tempfile::tempdir().unwrap();
    let small = format!("{SMALL} --case same_open");
    minds_a_full_disk_only(env!("CARGO_BIN_EXE_data-gen"), folder.path(), &[&small, "--help"]);
    // The files were still wanted.
    assert!(folder.path().join("data/cases/same_open/truth.npy").exists());
}

#[test]
fn equal_runs_leave_equal_files_at_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let program = env!("CARGO_BIN_EXE_data-gen");
    let small = "--seed 7 --out OUT --vertices 1000 --identity-modes 6 --triangles 5000 --threads THREADS";
    for (options, files) in [
        ("--population 3 --contact-sheet --case same_open --case new_asym", 29),
        ("--frames 2 --preset smile", 26),
        ("--case new_open --scanner fused", 18),
    ] {
        assert_eq!(leaves_equal_files(program, folder.path(), &format!("{small} {options}"), false), files);
    }
}
