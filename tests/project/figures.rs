//! Every figure of README and book is that of its table in docs/figures: `scripts/figures-of-docs --check`.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::skip::skipped;

/// What is wrong with the pages below a folder; `None` without a Python.
fn faults(root: &Path) -> Option<String> {
    let script = root.join("scripts/figures-of-docs");
    let Ok(said) = Command::new("python3").arg(script).arg("--check").output() else {
        skipped("the figures of the documentation were not compared: there is no python3");
        return None;
    };
    let faults = String::from_utf8_lossy(&said.stderr).into_owned();
    assert_eq!(said.status.code(), Some(if faults.is_empty() { 0 } else { 2 }), "{faults}");
    Some(faults)
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    if from.is_dir() {
        for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
            copy(&entry.path(), &to.join(entry.file_name()));
        }
    } else {
        fs::copy(from, to).unwrap();
    }
}

#[test]
fn every_figure_of_the_documentation_is_that_of_its_table() {
    let faults = faults(Path::new(env!("CARGO_MANIFEST_DIR")));
    assert!(faults.iter().all(String::is_empty), "{}", faults.unwrap());
}

#[test]
fn a_figure_that_is_changed_by_hand_is_found() {
    let (root, folder) = (Path::new(env!("CARGO_MANIFEST_DIR")), tempfile::tempdir().unwrap());
    for part in ["README.md", "Cargo.toml", "scripts/figures-of-docs", "docs/figures", "docs/src"] {
        copy(&root.join(part), &folder.path().join(part));
    }
    let changed = |file: &str, change: &dyn Fn(&str) -> String| {
        let (path, before) = (folder.path().join(file), fs::read_to_string(root.join(file)).unwrap());
        let after = change(&before);
        assert_ne!(before, after, "{file}");
        fs::write(&path, after).unwrap();
        let faults = faults(folder.path());
        fs::write(&path, before).unwrap();
        faults
    };
    let another_digit = |text: &str, at: usize| {
        let digit = if text[at..].starts_with('9') { "8" } else { "9" };
        format!("{}{digit}{}", &text[..at], &text[at + 1..])
    };
    let in_prose = |text: &str| another_digit(text, text.find("<!-- six-scans.hybrid").unwrap() - 1);
    let in_a_table = |text: &str| another_digit(text, text.find(" |\n| klimov2020").unwrap() - 1);
    let in_a_block = |text: &str| another_digit(text, text.find(" % of the vertices").unwrap() - 1);
    let no_number = |text: &str| text.replacen("<!-- six-scans.hybrid", "about <!-- six-scans.hybrid", 1);
    type Change<'a> = &'a dyn Fn(&str) -> String;
    let cases: [(&str, &str, Change<'_>); 6] = [
        ("docs/src/explanation/sliding.md", "its table says", &in_prose),
        ("docs/src/explanation/sliding.md", "stands behind no number", &no_number),
        ("README.md", "its table says", &in_a_table),
        ("docs/src/tutorials/artist.md", "its table says", &in_a_block),
        ("docs/src/introduction.md", "comes from no table", &|text| format!("{text}\nIt is wrong by 0.5 mm.\n")),
        ("docs/figures/six-scans.csv", "its table says", &|text| text.replacen("\nhybrid,", "\nhybrid,9", 1)),
    ];
    for (file, said, change) in cases {
        let Some(faults) = changed(file, change) else { return };
        assert!(faults.contains(said), "{file}: {faults}");
        assert!(file.ends_with(".csv") || faults.contains(file), "{file}: {faults}");
    }
}
