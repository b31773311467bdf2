//! `ceres`: its program and ours come to the same costs, and a program that does not is refused.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::skip::skipped;

fn quick(program: &Path, nonrigid: &Path, out: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiments"));
    command.args(["ceres", "--quick", "--program"]).arg(program).arg("--nonrigid").arg(nonrigid).arg("--out").arg(out);
    command.output().unwrap()
}

#[test]
fn costs_agree_with_those_of_ceres() {
    let program = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../build/ceres/ceres_case"));
    let nonrigid = Path::new(env!("CARGO_BIN_EXE_experiments")).with_file_name("nonrigid");
    if !program.exists() || !nonrigid.exists() {
        return skipped("build/ceres/ceres_case or nonrigid is not built (experiments ceres --help)");
    }
    let out = tempfile::tempdir().unwrap();
    let run = quick(program, &nonrigid, out.path());
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{said}");
    // Two numbers of shapes, two kinds of derivatives, three solvers.
    assert_eq!(said.lines().filter(|line| line.contains(" cost ")).count(), 12, "{said}");
    let json: Value = serde_json::from_slice(&fs::read(out.path().join("ceres.json")).unwrap()).unwrap();
    let rows = json["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 4, "{json}");
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap();
        let ratio = number("ceres_seconds_per_iteration") / number("our_seconds_per_iteration");
        assert!((number("ratio") / ratio - 1.0).abs() < 1e-12 && ratio > 0.0, "{row}");
        assert!(number("ceres_iterations") > 3.0 && number("our_iterations") > 3.0, "{row}");
    }
    let registration = &json["registration"];
    let iterations =
        registration["seconds"].as_f64().unwrap() / rows[2]["ceres_seconds_per_iteration"].as_f64().unwrap();
    assert_eq!((rows[2]["shapes"].as_u64(), rows[2]["derivatives"].as_str()), (Some(50), Some("automatic")));
    assert!((registration["ceres_iterations"].as_f64().unwrap() / iterations - 1.0).abs() < 1e-12, "{registration}");
    assert_eq!(fs::read_to_string(out.path().join("ceres.csv")).unwrap().lines().count(), 5);
}

#[cfg(unix)]
#[test]
fn a_program_that_solves_something_else_is_refused() {
    use std::os::unix::fs::PermissionsExt as _;

    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("other");
    let answers = |text: &str, words: &[&str]| {
        fs::write(&program, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let run = quick(&program, &program, &folder.path().join("out"));
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!((run.status.code(), said.matches("error: ").count()), (Some(2), 1), "{said}");
        words.iter().for_each(|word| assert!(said.contains(word), "{said}"));
    };
    let solve = "{\"initial_cost\": 1.0, \"final_cost\": 0.5, \"iterations\": 7, \"seconds_per_iteration\": 0.1}";
    answers(&format!("echo '{solve}'"), &["10 shapes, automatic derivatives", "initial costs differ"]);
    answers("echo nothing", &["not what a solver prints"]);
    answers("echo short of memory >&2; exit 3", &["short of memory", "exit status: 3"]);
}
