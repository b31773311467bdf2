//! The folder that a study writes its results to.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use nonrigid::console::{Failure, Stage, check_plan};
use nonrigid::io::{FilePlan, write_atomically};

/// Refuses a list that names something twice: its results would stand in the same place.
///
/// # Errors
/// A [`Failure`] of the arguments that names it.
pub fn each_once<T: PartialEq + std::fmt::Display>(option: &str, list: &[T]) -> Result<(), Failure> {
    match list.iter().enumerate().find(|(i, item)| list[..*i].contains(item)) {
        Some((_, item)) => Err(Failure::new(Stage::Arguments, format!("{option} names {item} twice"))),
        None => Ok(()),
    }
}

/// Writes a file.
///
/// # Errors
/// A [`Failure`] of writing.
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    Ok(write_atomically(path, |file| file.write_all(content.as_ref())).map_err(Failure::writing)?)
}

/// Makes the folder of results, unless a file or folder that is read is in it.
///
/// # Errors
/// A [`Failure`] of the arguments that names the clash, or of writing.
pub fn make_output_folder<'a>(out: &Path, reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>) -> Result<()> {
    check_output_folder(out, reads)?;
    make_folder(out)
}

/// Makes a folder, if it is not there.
///
/// # Errors
/// A [`Failure`] of writing.
pub fn make_folder(path: &Path) -> Result<()> {
    Ok(fs::create_dir_all(path).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?)
}

/// Refuses a folder of results that has a file or folder in it that is read.
///
/// # Errors
/// A [`Failure`] of the arguments that names the clash.
pub fn check_output_folder<'a>(out: &Path, reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>) -> Result<()> {
    Ok(check_plan(&FilePlan::new().reads_all(reads).writes_in("--out", out))?)
}

/// Refuses a folder where one of these files stands that no earlier run of the same has written: one that did left `mark` there, JSON
/// with this key.
///
/// # Errors
/// A [`Failure`] of writing that names the file.
pub fn refuse_strangers(out: &Path, (mark, key): (&str, &str), names: &[String]) -> Result<()> {
    let marked = fs::read(out.join(mark)).ok();
    let marked: Option<serde_json::Value> = marked.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    if marked.is_some_and(|value| value.get(key).is_some()) {
        return Ok(());
    }
    match names.iter().map(|name| out.join(name)).find(|path| path.exists()) {
        None => Ok(()),
        Some(path) => {
            let message = format!(
                "{}: is there, and {mark} does not say that an earlier run wrote it; move it away, or give another --out",
                path.display()
            );
            Err(Failure::new(Stage::Writing, message).into())
        }
    }
}
