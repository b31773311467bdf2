//! Command lines that a program has to refuse, as rows of a table: the exit code of the stage, one clear error that names what
//! is wrong and where, and not one file that appeared or changed.

#![allow(dead_code)] // every test binary uses its own part of this

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

pub const ARGUMENTS: i32 = 1;
pub const COMPUTATION: i32 = 2;
pub const WRITING: i32 = 3;
pub const LOADING: i32 = 4;

/// Length and time of every file and folder below `folder`: a file that is written again, or renamed over, differs.
fn traces(folder: &Path) -> BTreeMap<PathBuf, (u64, SystemTime)> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let metadata = path.symlink_metadata().unwrap();
        if metadata.is_dir() {
            found.extend(traces(&path));
        }
        found.insert(path, (metadata.len(), metadata.modified().unwrap()));
    }
    found
}

/// Runs `program` in `folder` with arguments separated by spaces: what it prints on stdout, or what is wrong with how it refuses them.
pub fn refuses(program: &str, folder: &Path, arguments: &str, code: i32, words: &[&str]) -> Result<String, String> {
    let before = traces(folder);
    let output = Command::new(program).args(arguments.split_whitespace()).current_dir(folder).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let mut faults = Vec::new();
    if output.status.code() != Some(code) {
        faults.push(format!("{} instead of {code}", output.status));
    }
    let errors = stderr.lines().filter(|line| line.starts_with("error: ")).count();
    if errors != 1 {
        faults.push(format!("{errors} errors"));
    }
    faults.extend(words.iter().filter(|w| !stderr.contains(**w)).map(|w| format!("lacks {w:?}")));
    let inner = ["panicked", "RUST_BACKTRACE", "src/", "unwrap"];
    faults.extend(inner.iter().filter(|w| stderr.contains(**w)).map(|w| format!("says {w:?}")));
    let after = traces(folder);
    let changed = after.iter().filter(|(path, trace)| before.get(*path) != Some(trace)).map(|(path, _)| path);
    let lost = before.keys().filter(|path| !after.contains_key(*path));
    faults.extend(changed.chain(lost).map(|path| format!("{} changed", path.display())));
    if faults.is_empty() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{arguments}\n  {}\n{stderr}", faults.join("\n  ")))
}

/// Fails with all that is wrong with any row.
pub fn all_hold(rows: usize, faults: &[String]) {
    assert!(faults.is_empty(), "{} of {rows} rows:\n\n{}", faults.len(), faults.join("\n\n"));
}
