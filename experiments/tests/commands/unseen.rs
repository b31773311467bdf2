//! `unseen`: a view that shows nothing of a face is a row that says so.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use experiments::generated::write_standard_cases;
use nonrigid::io::{read_npy_mask, read_npy_points, write_npy};

fn unseen(folder: &Path, views: &str) -> Output {
    let line = format!("unseen cases --rig rig --models rigid --views {views} --out {views}");
    Command::new(env!("CARGO_BIN_EXE_experiments")).args(line.split(' ')).current_dir(folder).output().unwrap()
}

#[test]
fn a_view_that_shows_nothing_leaves_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_standard_cases(folder, 1000, 5000, &["same_smile"], 7).unwrap();
    // Only the side counts that the view `half` cuts off.
    let observed = folder.join("cases/same_smile/observed.npy");
    let places = read_npy_points(&folder.join("rig/neutral.npy")).unwrap();
    let side: Vec<bool> =
        read_npy_mask(&observed, None).unwrap().iter().zip(&places).map(|(seen, p)| *seen && p.x > 30.0).collect();
    write_npy(&observed, &[side.len()], &side).unwrap();

    let run = unseen(folder, "whole,half");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let table = fs::read_to_string(folder.join("whole,half/unseen.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3);
    assert!(rows[1][1] == "whole" && rows[1][3].is_empty() && rows[1][5].parse::<f64>().unwrap() > 0.0, "{table}");
    assert!(rows[2][1] == "half" && rows[2][3].contains("no vertex is observed"), "{table}");
    assert!(table.ends_with(",0,,,0,0,0,0\n"), "{table}");

    let run = unseen(folder, "half");
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{said}");
    assert!(said.contains("every run failed; the first, rigid on same_smile, half: no vertex is observed"), "{said}");
    assert!(folder.join("half/unseen.csv").exists());
}
