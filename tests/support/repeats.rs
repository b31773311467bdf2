//! Runs of one command line that have to leave the same bytes: at 1, 2 and 4 threads.
#![allow(dead_code)] // every test binary uses its own part of this

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Whether a file may differ between equal runs: it holds times, or the machine.
fn of_machine(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.contains(".timing.") || name == "machine.json"
}

/// Every file below `folder` by its path from there, but for what may differ.
pub fn files_of(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(below) = folders.pop() {
        for entry in fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if !of_machine(&path) {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// What a run leaves: files by name, and what it printed.
type Left = (BTreeMap<PathBuf, Vec<u8>>, Vec<u8>);

/// Runs `program` in `folder` with `line`, whose word `OUT` is a new folder of each run and `THREADS` the number of threads,
/// and compares all files that it leaves and, where `stdout` holds, what it prints. Says how many files there are.
pub fn leaves_equal_files(program: &str, folder: &Path, line: &str, stdout: bool) -> usize {
    let mut first: Option<Left> = None;
    for threads in ["1", "2", "4"] {
        let out = folder.join("OUT");
        let _ = fs::remove_dir_all(&out); // there is none before the first run
        fs::create_dir(&out).unwrap();
        let mut command = Command::new(program);
        command.args(line.replace("THREADS", threads).split_whitespace());
        let run = command.current_dir(folder).env("RAYON_NUM_THREADS", threads).output().unwrap();
        assert!(run.status.success(), "{line}\n{}", String::from_utf8_lossy(&run.stderr));
        let found: Left = (files_of(&out), if stdout { run.stdout } else { Vec::new() });
        let Some(first) = &first else {
            first = Some(found);
            continue;
        };
        assert!(first.0.keys().eq(found.0.keys()), "{line}: other files at {threads} threads");
        for (path, bytes) in &found.0 {
            assert!(first.0[path] == *bytes, "{line}: {} differs at {threads} threads", path.display());
        }
        assert!(first.1 == found.1, "{line}: it prints something else at {threads} threads");
    }
    first.map_or(0, |(files, _)| files.len())
}
