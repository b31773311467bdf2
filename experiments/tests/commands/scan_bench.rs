//! `scan-bench` on generated cases: its rows are those of `run_case`, other programs' results score as they should, and what
//! fails leaves the rest.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use experiments::scan_bench::{BenchCase, BenchRow, CaseSource, LandmarkUse, Variant, measure, run_case, summarize};
use nonrigid::io::{read_polygon_mesh, write_npy, write_npy_points, write_polygon_mesh};
use nonrigid::registration::{ModelKind, TERMS};
use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_experiments");

/// A rig and two cases, of a known and of an unknown person.
struct Data {
    folder: tempfile::TempDir,
}

impl Data {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rig = FaceRig::generate(&FaceOptions { vertices: 1000, ..FaceOptions::default() });
        write_rig(&folder.path().join("rig"), &rig).unwrap();
        for (name, seed) in [("same", 7), ("new", 8)] {
            let case = simulate_scan(&rig, &ScanOptions { triangles: 5000, ..ScanOptions::default() }, seed).unwrap();
            let subject = if name == "same" { Subject::same(&rig, &case) } else { Subject::new(&rig) };
            write_case(&folder.path().join("cases").join(name), &rig, &case, &subject, seed).unwrap();
        }
        Self { folder }
    }

    fn path(&self, inside: &str) -> PathBuf {
        self.folder.path().join(inside)
    }

    fn source(&self) -> CaseSource {
        CaseSource::new(&self.path("cases"), &self.path("rig"))
    }

    fn cases(&self) -> Vec<BenchCase> {
        self.source().read().unwrap()
    }

    /// Runs the command in the folder of the data.
    fn scan_bench(&self, options: &[&str]) -> Output {
        let mut command = Command::new(PROGRAM);
        command.args(["scan-bench", "cases", "--rig", "rig"]).args(options);
        command.current_dir(&self.folder).output().unwrap()
    }

    fn measure(&self, program: &Path, variants: &[Variant]) -> anyhow::Result<Vec<BenchRow>> {
        measure(program, &self.source(), variants, 2, None, &mut |_| Ok(()))
    }
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn rows_are_those_of_the_library_to_the_last_bit() {
    let data = Data::new();
    let mut variants = [ModelKind::Hybrid, ModelKind::Sequential].map(|m| Variant::of_model(m).unwrap());
    variants[1].landmarks = LandmarkUse::Some(9);
    let rows = data.measure(Path::new(PROGRAM), &variants).unwrap();
    assert_eq!(rows.len(), 4);
    let cases = data.cases();
    let runs = variants.iter().flat_map(|v| cases.iter().map(move |case| (v, case)));
    for (row, (variant, case)) in rows.iter().zip(runs) {
        assert_eq!((&*row.group, &row.model, &row.case), ("model", &variant.name, &case.name));
        let (score, ..) = run_case(&variant.model, &TERMS, &variant.schedule, case, variant.landmarks).unwrap();
        assert_eq!(row.score, Some(score));
        assert!(row.seconds.unwrap() > 0.0 && row.error.is_none(), "{row:?}");
        if cfg!(target_os = "linux") {
            // More than the mesh itself, less than a machine.
            assert!((1 << 20..1 << 33).contains(&row.peak_bytes.unwrap()), "{row:?}");
        }
    }
}

#[test]
fn a_run_again_replaces_what_an_earlier_one_has_made_and_nothing_else() {
    let data = Data::new();
    let run = || data.scan_bench(&["--models", "rigid", "--out", "out"]);
    fs::rename(data.path("cases/new"), data.path("new")).unwrap();
    assert!(run().status.success() && run().status.success());
    fs::rename(data.path("new"), data.path("cases/new")).unwrap();
    let mine = data.path("out/new/rigid.obj");
    fs::create_dir(data.path("out/new")).unwrap();
    fs::write(&mine, "mine").unwrap();
    let refused = run();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(3) && said.contains("out/new/rigid.obj: is there"), "{said}");
    assert_eq!(fs::read(&mine).unwrap(), b"mine");
    fs::remove_file(&mine).unwrap();
    assert!(run().status.success());
    // an earlier version has written down that all may be replaced, and no names
    fs::write(data.path("out/experiments.json"), "{ \"version\": 1, \"made_by\": \"experiments\" }\n").unwrap();
    assert!(run().status.success() && run().status.success());
}

#[test]
fn the_command_leaves_the_same_tables_at_any_number_of_threads() {
    let data = Data::new();
    for threads in ["1", "2"] {
        let options = ["--models", "rigid,blendshape", "--terms", "--threads", threads, "--out", threads];
        let run = data.scan_bench(&options);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{said}");
        assert!(said.lines().count() == 24 && said.contains("\n24/24  term"), "{said}");
        let table = String::from_utf8(run.stdout).unwrap();
        for name in ["model: rigid", "model: blendshape", "term: symmetric", "term: without seam"] {
            assert_eq!(table.lines().filter(|l| l.contains(name)).count(), 1, "{name}: {table}");
        }
    }
    for file in ["scan-bench.csv", "scan-bench.json", "new/rigid.obj", "same/term-symmetric.obj"] {
        assert!(fs::read(data.path("1").join(file)).unwrap() == fs::read(data.path("2").join(file)).unwrap(), "{file}");
    }
    let read = |file: &str| -> Vec<Vec<String>> {
        let text = fs::read_to_string(data.path("2").join(file)).unwrap();
        text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let (rows, times) = (read("scan-bench.csv"), read("scan-bench.timing.csv"));
    assert_eq!((rows.len(), times.len()), (25, 25));
    assert!(rows.iter().all(|r| r.len() == rows[0].len()) && times.iter().all(|t| t.len() == times[0].len()));
    let at = |name: &str| rows[0].iter().position(|h| h == name).unwrap_or_else(|| panic!("no column {name}"));
    let json = json(&data.path("2/scan-bench.json"));
    for ((row, time), json) in rows[1..].iter().zip(&times[1..]).zip(json["rows"].as_array().unwrap()) {
        assert_eq!(row[..3], time[..3]);
        assert_eq!(row[..3], ["case", "model", "group"].map(|key| json[key].as_str().unwrap().to_owned()));
        for (column, key) in
            [("rmse", "rmse"), ("normal", "normal"), ("tangential", "tangential"), ("p95", "p95"), ("max", "max")]
        {
            assert_eq!(row[at(column)], format!("{:.6}", json[key].as_f64().unwrap()));
        }
        assert_eq!(row[at("flips")], json["flipped"].to_string());
        assert_eq!(row[at("iterations")], json["iterations"].to_string());
        assert_eq!(row[at("error")], "");
        assert!(time[3].parse::<f64>().unwrap() > 0.0 && time[5] == "2", "{time:?}");
    }
    // A result is what its row says.
    let (case, row) = (&data.cases()[0], json["rows"].as_array().unwrap()[2].clone());
    let result = read_polygon_mesh(&data.path("2/new/blendshape.obj")).unwrap();
    assert!(result.metadata.material_libraries.is_empty(), "no file of materials is beside it");
    let (errors, _) = case.score(&result.positions).unwrap();
    assert_eq!((row["case"].as_str(), row["model"].as_str()), (Some("new"), Some("blendshape")));
    assert!((errors.rmse - row["rmse"].as_f64().unwrap()).abs() < 1e-9, "{} {row}", errors.rmse);
    // Each term does something: what differs in the schedule differs in the result.
    let rmse = |name: &str| rows.iter().filter(|r| r[1] == name).map(|r| r[at("rmse")].clone()).collect::<Vec<_>>();
    for name in [
        "symmetric",
        "point_to_point",
        "without scan_to_template",
        "without landmarks",
        "without beyond",
        "without lambda_unseen",
    ] {
        assert_ne!(rmse(name), rmse("default"), "{name}");
    }
}

#[test]
fn another_programs_results_score_as_they_should() {
    let data = Data::new();
    let cases = data.cases();
    for folder in ["truth", "start", "bad/new"] {
        fs::create_dir_all(data.path(folder)).unwrap();
    }
    for case in &cases {
        write_npy_points(&data.path("truth").join(format!("{}.npy", case.name)), &case.truth).unwrap();
        let start = data.path("start").join(&case.name);
        fs::create_dir_all(&start).unwrap();
        write_polygon_mesh(&start.join("result.obj"), &case.template).unwrap();
    }
    // A vertex too few, and no result for the other case.
    write_npy_points(&data.path("bad/new/result.npy"), &cases[0].truth[1..]).unwrap();
    let externals = ["--external", "truth=truth", "--external", "start=start", "--external", "bad=bad"];
    let run = data.scan_bench(&[&["--models", "none"], &externals[..]].concat());
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let json = json(&data.path("out/scan-bench/scan-bench.json"));
    let rows: Vec<BenchRow> = serde_json::from_value(json["rows"].clone()).unwrap();
    assert_eq!(rows.len(), 6);
    for (row, case) in rows.iter().zip(cases.iter().cycle()) {
        assert_eq!((&*row.group, &row.case), ("external", &case.name));
        match (row.model.as_str(), row.case.as_str()) {
            ("truth", _) => {
                let e = &row.score.as_ref().unwrap().errors;
                assert_eq!(
                    (e.rmse, e.max, e.normal, e.tangential, e.unobserved.unwrap_or(0.0), e.flipped),
                    (0.0, 0.0, 0.0, 0.0, 0.0, 0)
                );
            }
            ("start", _) => {
                let squares = case.template.positions.iter().zip(&case.truth).map(|(p, t)| (p - t).norm_squared());
                let seen: Vec<f64> = squares.zip(&case.observed).filter(|(_, o)| **o).map(|(s, _)| s).collect();
                let rmse = (seen.iter().sum::<f64>() / seen.len() as f64).sqrt();
                let score = row.score.as_ref().unwrap();
                assert!(rmse > 1.0 && (score.errors.rmse / rmse - 1.0).abs() < 1e-12, "{} {rmse}", score.errors.rmse);
                assert_eq!(score.iterations, None);
            }
            ("bad", "new") => {
                let error = row.error.as_ref().unwrap();
                let count = cases[0].truth.len();
                let expected = format!("has {} vertices where {count} were expected", count - 1);
                assert!(error.contains("result.npy") && error.contains(&expected), "{error}");
            }
            _ => assert_eq!((row.score.as_ref(), row.error.as_deref()), (None, Some("no result"))),
        }
    }
    let summary = summarize(&rows);
    assert_eq!(summary.iter().map(|s| s.failed).collect::<Vec<_>>(), [0, 0, 2]);
    assert_eq!(fs::read_to_string(data.path("out/scan-bench/scan-bench.timing.csv")).unwrap().lines().count(), 1);
    assert!(String::from_utf8_lossy(&run.stdout).contains("2 of 2"));

    // A number that is none, and a case with two results.
    let mut items: Vec<f64> = cases[0].truth.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    items[4] = f64::NAN;
    write_npy(&data.path("bad/new/result.npy"), &[cases[0].truth.len(), 3], &items).unwrap();
    fs::create_dir_all(data.path("bad/same")).unwrap();
    for file in ["bad/same.npy", "bad/same/result.npy"] {
        write_npy_points(&data.path(file), &cases[1].truth).unwrap();
    }
    assert!(data.scan_bench(&["--models", "none", "--external", "bad=bad"]).status.success());
    let rows = self::json(&data.path("out/scan-bench/scan-bench.json"));
    let error = |i: usize| rows["rows"][i]["error"].as_str().unwrap_or_else(|| panic!("{rows}"));
    assert!(error(0).contains("result.npy") && error(0).contains("finite coordinates of point 1"), "{rows}");
    assert!(error(1).starts_with("two results: ") && error(1).contains("same.npy"), "{rows}");
}

#[test]
fn one_case_is_enough_and_no_unseen_vertex_has_no_error() {
    let data = Data::new();
    let count = data.cases()[0].truth.len();
    write_npy(&data.path("cases/new/observed.npy"), &[count], &vec![true; count]).unwrap();
    for (folder, case) in [(data.path("."), "cases/new"), (data.path("cases/new"), ".")] {
        let mut command = Command::new(PROGRAM);
        command.args(["scan-bench", case, "--models", "rigid", "--rig"]).arg(data.path("rig"));
        let run = command.arg("--out").arg(data.path("one")).current_dir(folder).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let table = fs::read_to_string(data.path("one/scan-bench.csv")).unwrap();
        let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
        let at = rows[0].iter().position(|column| *column == "unobserved").unwrap();
        assert!(rows.len() == 2 && rows[1][0] == "new" && rows[1][at].is_empty(), "{table}");
        assert!(rows[1][at - 1].parse::<f64>().unwrap() > 0.0, "{table}");
        assert!(data.path("one/new/rigid.obj").exists());
    }
}

#[test]
fn a_cause_is_told_once() {
    let error = CaseSource::new(Path::new("nowhere"), Path::new("no_rig")).read().map(drop).unwrap_err().to_string();
    assert!(error.starts_with("no_rig: cannot be read") && error.matches("(os error").count() == 1, "{error}");
}

#[test]
fn a_variant_that_fails_leaves_the_others() {
    let data = Data::new();
    let rigid = Variant::of_model(ModelKind::Rigid).unwrap();
    // One stage, where its model needs two.
    let (name, schedule) = ("one stage".to_owned(), Variant::of_model(ModelKind::Blendshape).unwrap().schedule);
    let broken = Variant { name, model: ModelKind::Sequential, schedule, ..rigid.clone() };
    let rows = data.measure(Path::new(PROGRAM), &[broken.clone(), rigid.clone()]).unwrap();
    assert_eq!(rows.len(), 4);
    for row in &rows[..2] {
        assert!(row.score.is_none() && row.error.as_ref().unwrap().contains("needs a second stage"), "{row:?}");
    }
    assert!(rows[2..].iter().all(|r| r.score.is_some() && r.error.is_none()), "{rows:?}");
    let summary = summarize(&rows);
    assert_eq!(summary.iter().map(|s| (s.failed, s.cases)).collect::<Vec<_>>(), [(2, 2), (0, 2)]);

    let error = data.measure(Path::new(PROGRAM), &[broken]).unwrap_err().to_string();
    assert!(error.starts_with("every run failed; the first, model one stage on new: "), "{error}");
    // Whoever takes the rows may end it.
    let mut stop = |_: &BenchRow| anyhow::bail!("enough");
    let stopped = measure(Path::new(PROGRAM), &data.source(), &[rigid], 1, None, &mut stop).unwrap_err();
    assert_eq!(stopped.to_string(), "enough");
}

#[test]
fn a_scan_without_landmarks_is_no_start_that_was_missed() {
    let data = Data::new();
    // a plate, on which no face is found
    let plate = (0..1600).map(|i| format!("v {} {} 0\n", 3 * (i % 40), 3 * (i / 40))).collect::<String>();
    let quads = (0..1600).filter(|i| i % 40 < 39 && i / 40 < 39);
    let quads = quads.map(|i| format!("f {} {} {} {}\n", i + 1, i + 2, i + 42, i + 41)).collect::<String>();
    fs::write(data.path("plate.obj"), plate + &quads).unwrap();
    let mut command = Command::new(PROGRAM);
    command.args(["dev", "start-bench", "plate.obj", "--rig", "rig", "--turns", "0"]).current_dir(data.path("."));
    let run = command.output().unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && said.contains("no start found") && said.contains("0 of 0 within"), "{said}");
}

#[cfg(unix)]
#[test]
fn a_process_that_dies_fails_one_case() {
    use std::os::unix::fs::PermissionsExt as _;
    let data = Data::new();
    // Ends at once where it should begin with the first case, and is itself after that.
    let program = data.path("dies");
    let script = format!(
        "#!/bin/sh\ncase \"$*\" in *'\"first\":0'*) echo 'error: out of' memory >&2; kill -9 $$;; esac\nexec '{PROGRAM}' \"$@\"\n"
    );
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let rows = data.measure(&program, &[Variant::of_model(ModelKind::Rigid).unwrap()]).unwrap();
    assert_eq!(rows.iter().map(|r| r.case.as_str()).collect::<Vec<_>>(), ["new", "same"]);
    let error = rows[0].error.as_ref().unwrap();
    assert!(error.contains("signal: 9") && error.ends_with("out of memory"), "{error}");
    assert!(rows[1].score.is_some(), "{rows:?}");

    fs::write(&program, "#!/bin/sh\necho what is this\n").unwrap();
    let error = data.measure(&program, &[Variant::of_model(ModelKind::Rigid).unwrap()]).unwrap_err().to_string();
    assert!(error.contains("not a line of this program: what is this"), "{error}");
    let error = data.measure(&data.path("nowhere"), &[Variant::of_model(ModelKind::Rigid).unwrap()]).unwrap_err();
    assert!(error.to_string().contains("nowhere: cannot be started"), "{error}");
}
