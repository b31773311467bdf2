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

/// Says in a folder of results that this program may replace what is in it.
const MARK: &str = "experiments.json";
const MARKED: &str = "{ \"version\": 1, \"made_by\": \"experiments\" }\n";

/// What files are called that this program writes.
const WRITTEN: [&str; 8] = ["csv", "html", "json", "npy", "obj", "png", "svg", "toml"];

/// Makes the folder of results, once [`check_output_folder`] has nothing against it.
///
/// # Errors
/// As [`check_output_folder`]; a [`Failure`] of writing.
pub fn make_output_folder<'a>(out: &Path, reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>) -> Result<()> {
    check_output_folder(out, reads)?;
    make_folder(out)?;
    write_file(&out.join(MARK), MARKED)
}

/// Makes a folder, if it is not there.
///
/// # Errors
/// A [`Failure`] of writing.
pub fn make_folder(path: &Path) -> Result<()> {
    Ok(fs::create_dir_all(path).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?)
}

/// Refuses a folder of results that has a file or folder in it that is read, or a file as this program writes them and no mark of an
/// earlier run. A log may be there.
///
/// # Errors
/// A [`Failure`] of the arguments that names the clash, or of writing that names what is there.
pub fn check_output_folder<'a>(out: &Path, reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>) -> Result<()> {
    check_plan(&FilePlan::new().reads_all(reads).writes_in("--out", out))?;
    if fs::read_to_string(out.join(MARK)).is_ok_and(|text| text == MARKED) {
        return Ok(());
    }
    let entries = fs::read_dir(out).into_iter().flatten().flatten().map(|entry| entry.path());
    let written = |path: &Path| path.extension().is_some_and(|extension| WRITTEN.iter().any(|of| extension == *of));
    let strangers = entries.filter(|path| path.is_file() && written(path));
    match strangers.min() {
        None => Ok(()),
        Some(path) => Err(Failure::writing(format!(
            "{}: is there, and no {MARK} beside it says that an earlier run made the folder; move it away, or give another --out",
            path.display()
        ))
        .into()),
    }
}
