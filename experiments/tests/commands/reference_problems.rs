//! Minimisers on problems with known answers: what NIST certifies, and what More, Garbow and Hillstrom print.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use experiments::more_garbow_hillstrom::{Found, failures, more_garbow_hillstrom};
use experiments::nist::nist;
use nonrigid::nlls::StopReason;

use crate::closed_stdout::minds_a_full_disk_only;

fn command(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_experiments")).args(arguments).output().unwrap()
}

#[test]
fn levenberg_marquardt_reaches_all_certified_parameters() {
    let rows = nist(None).unwrap();
    assert_eq!(rows.len(), 54);
    for row in &rows {
        let outcome = &row.levenberg_marquardt;
        assert!(outcome.passed(), "{} from start {}: {outcome:?}", row.problem, row.start);
        // Of Lanczos1's residuals, 1e-13, rounding leaves three digits.
        let digits = if row.problem == "Lanczos1" { 1e-2 } else { 1e-9 };
        assert!(outcome.energy_error < digits, "{} from start {}: {outcome:?}", row.problem, row.start);
    }
    let failed: Vec<(&str, usize)> =
        rows.iter().filter(|r| !r.dogleg.passed()).map(|r| (r.problem.as_str(), r.start)).collect();
    assert_eq!(failed, [("BoxBOD", 1)]);
}

#[test]
fn nist_on_the_command_line() {
    let output = command(&["dev", "nist", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((json["passed"].as_u64(), json["total"].as_u64()), (Some(54), Some(54)));
    assert_eq!(json["rows"].as_array().unwrap().len(), 54);
    assert_eq!(json["dogleg"]["failed"], serde_json::json!(["BoxBOD from start 1"]));

    // A missing file, one that is not NIST's, and a misprint.
    let copy = tempfile::tempdir().unwrap();
    let said = |expected: &[&str]| {
        let output = command(&["dev", "nist", "--data", copy.path().to_str().unwrap()]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{error}");
        assert_eq!(error.lines().count(), 1, "{error}");
        expected.iter().for_each(|e| assert!(error.contains(e), "{error}"));
    };
    said(&["Bennett5.dat"]);
    copy_all(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/nist")), copy.path());
    let misra = copy.path().join("Misra1a.dat");
    let text = fs::read_to_string(&misra).unwrap();
    fs::write(&misra, "nothing").unwrap();
    said(&["Misra1a.dat", "b1"]);
    fs::write(&misra, text.replace("2.3894212918E+02", "2.3984212918E+02")).unwrap();
    said(&["Misra1a.dat", "misprint"]);
}

fn copy_all(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::write(to.join(entry.file_name()), fs::read(entry.path()).unwrap()).unwrap();
    }
}

#[test]
fn the_published_minima_of_more_garbow_and_hillstrom() {
    let rows = more_garbow_hillstrom().unwrap();
    assert_eq!(rows.len(), 84);
    let both = |more: &[&'static str]| {
        let mut names = COMMON_FAILURES.to_vec();
        names.extend(more);
        names
    };
    let sorted = |mut names: Vec<String>| {
        names.sort();
        names
    };
    let expected = |more: &[&'static str]| sorted(both(more).into_iter().map(str::to_owned).collect());
    assert_eq!(sorted(failures(&rows, |r| &r.levenberg_marquardt)), expected(&LEVENBERG_MARQUARDT_FAILURES));
    assert_eq!(sorted(failures(&rows, |r| &r.dogleg)), expected(&DOGLEG_FAILURES));
    for row in &rows {
        for outcome in [&row.levenberg_marquardt, &row.dogleg] {
            assert!(outcome.energy.is_finite(), "{}: {outcome:?}", row.name());
            let named =
                matches!(outcome.stop, StopReason::Converged(_) | StopReason::MaxIterations | StopReason::NoDecrease);
            assert!(named, "{}: {outcome:?}", row.name());
            // From the standard starts the lowest minima are the usual ones.
            let usual = outcome.found == Found::Lowest || row.factor != 1.0;
            let exception = ["Freudenstein and Roth", "Gulf research and development"].contains(&row.problem.as_str());
            assert!(usual || exception, "{}: {outcome:?}", row.name());
        }
    }
}

/// Valleys that lead to infinity (Beale, Box, Gulf) and minima that the paper does not print.
const COMMON_FAILURES: [&str; 5] = [
    "5 Beale (2) x 10",
    "6 Jennrich and Sampson (2) x 10",
    "11 Gulf research and development (3) x 1",
    "12 Box three-dimensional (3) x 10",
    "19 Osborne 2 (11) x 10",
];
const LEVENBERG_MARQUARDT_FAILURES: [&str; 1] = ["26 Trigonometric (10) x 10"];
const DOGLEG_FAILURES: [&str; 3] = ["35 Chebyquad (7) x 10", "35 Chebyquad (9) x 10", "35 Chebyquad (10) x 10"];

#[test]
fn a_reader_that_goes_away_is_no_error_and_a_full_disk_is() {
    let lines = [
        "dev more-garbow-hillstrom",
        "dev more-garbow-hillstrom --json",
        "dev nist",
        "dev nist --json",
        "--help",
        "--version",
    ];
    minds_a_full_disk_only(env!("CARGO_BIN_EXE_experiments"), Path::new("."), &lines);
}
