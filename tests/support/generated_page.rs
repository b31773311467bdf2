//! Pages of the book that are made of the code. A test makes each anew and compares it with the one in the repository;
//! `NONRIGID_WRITE_PAGES=1` writes it instead.

use std::fs;
use std::path::Path;

/// Compares a page of `docs/src/reference` with what the code gives, or writes it.
pub fn check(repository: &Path, name: &str, text: &str) {
    let path = repository.join("docs/src/reference").join(name);
    if std::env::var_os("NONRIGID_WRITE_PAGES").is_some() {
        fs::write(&path, text).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
    let line = committed.lines().zip(text.lines()).position(|(a, b)| a != b);
    let line = line.unwrap_or(committed.lines().count().min(text.lines().count()));
    assert!(
        committed == text,
        "{name}, line {}: the page is\n  {}\nand the code gives\n  {}\nNONRIGID_WRITE_PAGES=1 in the environment of this test writes it",
        line + 1,
        committed.lines().nth(line).unwrap_or_default(),
        text.lines().nth(line).unwrap_or_default(),
    );
}
