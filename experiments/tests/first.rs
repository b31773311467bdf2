//! The first run: what it leaves, that it leaves the same every time, and how it fails.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use experiments::first::{Options, run};
use experiments::scan_bench::{BenchCase, BenchRig, BenchRow, LandmarkUse, run_case};
use nonrigid::registration::{ModelFactory, ModelKind, TermFactory, TermKind};

fn first(out: &Path, threads: usize) -> (Vec<BenchRow>, String) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let options = Options { seed: 7, vertices: 1000, out: out.to_owned() };
    let mut log = Vec::new();
    let rows = pool.install(|| run(&options, &mut log)).unwrap();
    (rows, String::from_utf8(log).unwrap())
}

/// Every file below `folder` by its path from there.
fn files(folder: &Path, below: &Path, found: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(below).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(folder, &path, found);
        } else {
            found.insert(path.strip_prefix(folder).unwrap().display().to_string(), fs::read(&path).unwrap());
        }
    }
}

#[test]
fn a_first_run_leaves_the_same_files_at_every_run_and_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let runs = [("one", 1), ("two", 2), ("one", 2)].map(|(name, threads)| {
        let (out, mut found) = (folder.path().join(name), BTreeMap::new());
        let (rows, log) = first(&out, threads);
        files(&out, &out, &mut found);
        found.remove("first.timing.csv").expect("times, in a file of their own");
        (rows, log, found)
    });
    let (rows, log, found) = &runs[0];
    for (_, _, other) in &runs[1..] {
        let differing: Vec<&String> = found.keys().filter(|name| found.get(*name) != other.get(*name)).collect();
        assert!(differing.is_empty() && found.len() == other.len(), "{differing:?}");
    }
    for name in ["first.png", "first.json", "first.csv", "hybrid.obj", "graph.obj", "blendshape.obj"] {
        assert!(found.contains_key(name), "{name} is missing");
    }
    assert!(found["first.png"].starts_with(b"\x89PNG"));

    // What it says: plan, one line of errors, where the picture is, and a command for one's own scan at the end.
    assert!(log.contains("seed 7") && log.contains("threads 1") && log.contains("plan, about"), "{log}");
    let verdict = log.lines().find(|line| line.starts_with("rmse over")).unwrap();
    for row in rows {
        assert!(verdict.contains(&format!("{} {:.2} mm", row.model, row.errors.rmse)), "{verdict}");
        assert!(row.errors.finite && row.errors.rmse < 8.0, "{row:?}");
    }
    assert_eq!(rows.iter().map(|r| r.model.as_str()).collect::<Vec<_>>(), ["hybrid", "graph", "blendshape"]);
    assert!(log.contains(&folder.path().join("one/first.png").display().to_string()));
    assert!(log.lines().last().unwrap().contains("-- register --template") && log.contains("YOUR_SCAN/scan.ply"));
}

#[test]
fn scan_bench_reads_what_a_first_run_made_and_finds_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, _) = first(folder.path(), 2);
    let data = folder.path().join("data");
    let cases = BenchCase::read_all(&data.join("cases"), &BenchRig::read(&data.join("rig")).unwrap()).unwrap();
    assert_eq!(cases.len(), 1);
    assert!(cases[0].neutral.is_some() && cases[0].name == "same_open");
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let schedule = ModelKind::Hybrid.schedule().unwrap();
    let (row, _) = run_case(&ModelKind::Hybrid, &terms, &schedule, &cases[0], LandmarkUse::All).unwrap();
    assert_eq!(row.errors, rows[0].errors);
}

fn experiments(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_experiments")).args(arguments).current_dir(folder).output().unwrap()
}

#[test]
fn failures_have_one_clear_message_and_the_code_of_their_stage() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, case) = ("data/rig", "data/cases/same_open");
    first(folder.path(), 2);
    fs::write(folder.path().join("file"), "").unwrap();
    fs::write(folder.path().join("bad.toml"), "levels = 3").unwrap();
    fs::create_dir_all(folder.path().join("taken/first.png")).unwrap();
    let expect = |arguments: &[&str], code: i32, says: &str| {
        let output = experiments(arguments, folder.path());
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
        assert!(text.starts_with("error: ") && text.contains(says), "{arguments:?}: {text}");
        assert_eq!(text.matches("error:").count(), 1, "{arguments:?}: {text}");
    };
    expect(&["--vertices", "10"], 1, "1000 to 100000");
    expect(&["--threads", "0"], 1, "--threads");
    expect(&["--seed", "1", "scan-bench", "data", "--rig", rig], 1, "--seed");
    expect(&["--out", "file/below"], 3, "file/below");
    expect(&["--vertices", "1000", "--out", "taken"], 3, "first.png");
    expect(&["scan-bench", "data", "--rig", rig, "--out", "file"], 3, "file");
    expect(&["scan-bench", "data", "--rig", "nowhere", "--out", "bench"], 4, "nowhere");
    expect(&["scan-bench", "nowhere", "--rig", rig, "--out", "bench"], 4, "nowhere");
    expect(&["scan-bench", "data", "--rig", rig, "--out", "bench", "--config", "bad.toml"], 4, "bad.toml");
    let landmarks = folder.path().join(case).join("landmarks.json");
    fs::write(&landmarks, r#"{"1": [0, 0, 0], "2": [1, 1, 1], "3": [2, 2, 2]}"#).unwrap();
    expect(&["scan-bench", "data", "--rig", rig, "--out", "bench", "--models", "rigid"], 4, "on a line");
    fs::remove_file(landmarks).unwrap();
    expect(&["scan-bench", "data", "--rig", rig, "--out", "bench"], 4, "landmarks.json");

    let help = experiments(&["--help"], folder.path());
    let text = String::from_utf8(help.stdout).unwrap();
    assert!(
        help.status.success() && ["scan-bench", "--seed", "--threads", "--out"].iter().all(|t| text.contains(t)),
        "{text}"
    );
}
