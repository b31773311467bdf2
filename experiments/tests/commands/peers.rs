//! `peers`: other programs are scored as ours are, and what fails leaves the rest. The programs stand in for Python: what the real ones
//! make of a case is tried where they are installed.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Output};

use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use serde_json::Value;

fn peers(folder: &Path, python: &str, timeout: &str) -> Output {
    fs::write(folder.join("python"), python).unwrap();
    fs::set_permissions(folder.join("python"), fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiments"));
    command.args([
        "peers",
        "cases",
        "--rig",
        "rig",
        "--models",
        "rigid",
        "--methods",
        "scipy-map,meshmonk",
        "--out",
        "out",
    ]);
    command.args(["--python", "./python", "--timeout", timeout]).current_dir(folder).output().unwrap()
}

#[test]
fn other_programs_are_scored_as_ours_are_and_a_failure_is_a_row() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, ..FaceOptions::default() });
    write_rig(&folder.join("rig"), &rig).unwrap();
    let case = simulate_scan(&rig, &ScanOptions { triangles: 5000, ..ScanOptions::default() }, 7).unwrap();
    write_case(&folder.join("cases/one"), &rig, &case, &Subject::new(&rig), 7).unwrap();

    // One knows the truth, the other is not there. Arguments: script, method, case, result.
    let python = "#!/bin/sh\nif [ $2 = meshmonk ]; then echo 'not installed: meshmonk' >&2; exit 1; fi\n\
                  cp cases/one/truth.npy $4\necho 'some words'\necho '{\"seconds\": 1.5, \"peak_bytes\": 5000000}'\n";
    let run = peers(folder, python, "60");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let json: Value = serde_json::from_slice(&fs::read(folder.join("out/peers.json")).unwrap()).unwrap();
    let rows = json["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["model"].as_str().unwrap()).collect();
    assert_eq!(names, ["rigid", "scipy-map", "meshmonk"]);
    assert!(rows[0]["rmse"].as_f64().unwrap() > 1.0 && rows[1]["rmse"].as_f64().unwrap() < 1e-6, "{json}");
    assert!(rows[2]["error"].as_str().unwrap().contains("not installed: meshmonk"), "{json}");
    let times = fs::read_to_string(folder.join("out/peers.timing.csv")).unwrap();
    assert!(times.contains("one,scipy-map,peer,1.5000,5.000,"), "{times}");
    assert!(fs::read_to_string(folder.join("out/peers.svg")).unwrap().contains("scipy-map"));

    // Too slow, and nothing at all: the tables are there, the command has failed.
    let run = peers(folder, "#!/bin/sh\nexec sleep 30\n", "1");
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.code() == Some(2) && said.contains("over 1 s"), "{said}");
    assert!(fs::read_to_string(folder.join("out/peers.csv")).unwrap().contains("over 1 s"));
}
