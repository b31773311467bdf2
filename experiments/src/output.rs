//! The folder that a study writes its results to.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use nonrigid::console::{Failure, Stage, check_folder_path, check_plan};
use nonrigid::io::{FilePlan, read_side_file, write_atomically, write_json, write_obj};
use nonrigid::mesh::{PolygonMesh, Vec3};
use serde::{Deserialize, Serialize};

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

/// Writes the result of a registration, OBJ. Its materials are names alone: the template's libraries are not beside it.
///
/// # Errors
/// A [`Failure`] of writing.
pub fn write_result(path: &Path, template: &PolygonMesh, positions: Vec<Vec3>) -> Result<PolygonMesh, Failure> {
    let mut mesh = template.with_positions(positions);
    mesh.metadata.material_libraries.clear();
    write_obj(path, &mesh).map_err(Failure::writing)?;
    Ok(mesh)
}

/// Says in a folder of results what of it this program may replace: files as it writes them, and these folders.
const MARK: &str = "experiments.json";

/// What [`MARK`] holds.
#[derive(Serialize, Deserialize)]
struct Mark {
    version: u32,
    made_by: String,
    /// By their paths from there.
    #[serde(default)]
    folders: BTreeSet<String>,
}

/// What files are called that this program writes beside folders.
const WRITTEN: [&str; 10] = ["csv", "html", "json", "npy", "obj", "png", "py", "svg", "tex", "toml"];

/// Makes the folder of results, once [`check_output_folder`] has nothing against it, and writes down that `folders` in it are this
/// program's.
///
/// # Errors
/// As [`check_output_folder`]; a [`Failure`] of writing.
pub fn make_output_folder<'a>(
    out: &Path,
    reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>,
    folders: &[String],
) -> Result<()> {
    check_output_folder(out, reads, folders)?;
    let mut made = made_before(out)?.unwrap_or_default();
    made.retain(|folder| out.join(folder).exists());
    made.extend(folders.iter().cloned());
    make_folder(out)?;
    let mark = Mark { version: 2, made_by: "experiments".to_owned(), folders: made };
    Ok(write_json(&out.join(MARK), &mark).map_err(Failure::writing)?)
}

/// Makes a folder, if it is not there.
///
/// # Errors
/// A [`Failure`] of writing.
pub fn make_folder(path: &Path) -> Result<()> {
    Ok(fs::create_dir_all(path).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?)
}

/// Refuses a folder of results that has a file or folder in it that is read, and what would be replaced and no earlier run has made:
/// a file as this program writes them, where there is no mark, and anything in one of `folders` that the mark does not list. A log may
/// be there.
///
/// # Errors
/// A [`Failure`] of the arguments that names the clash, or of writing that names what is there.
pub fn check_output_folder<'a>(
    out: &Path,
    reads: impl IntoIterator<Item = (&'a str, &'a PathBuf)>,
    folders: &[String],
) -> Result<()> {
    check_plan(&FilePlan::new().reads_all(reads).writes_in("--out", out))?;
    check_folder_path(out)?;
    let made = made_before(out)?;
    let written = |path: &Path| path.extension().is_some_and(|extension| WRITTEN.iter().any(|of| extension == *of));
    let is_made = |folder: &str| {
        let above = Path::new(folder).ancestors();
        made.as_ref().is_some_and(|made| above.into_iter().any(|path| made.contains(&*path.to_string_lossy())))
    };
    let beside = entries(out).into_iter().filter(|path| made.is_none() && path.is_file() && written(path));
    let inside = folders.iter().filter(|folder| !is_made(folder)).filter_map(|folder| file_in(&out.join(folder)));
    match beside.chain(inside).min() {
        None => Ok(()),
        Some(path) => Err(Failure::writing(format!(
            "{}: is there, and no {MARK} in {} says that an earlier run made it; move it away, or give another --out",
            path.display(),
            out.display()
        ))
        .into()),
    }
}

/// The folders that earlier runs have made in a folder of results; `None` without a mark. The mark of a version that named none says
/// that all may be replaced, so that its folders go on.
fn made_before(out: &Path) -> Result<Option<BTreeSet<String>>, Failure> {
    let path = out.join(MARK);
    if !path.exists() {
        return Ok(None);
    }
    let bytes =
        read_side_file(&path).map_err(|e| Failure::writing(format!("{e}; move it away, or give another --out")))?;
    let Ok(mark) = serde_json::from_slice::<Mark>(&bytes) else { return Ok(None) };
    let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    Ok(match mark.version {
        _ if mark.made_by != "experiments" => None,
        1 => Some(entries(out).iter().filter(|path| path.is_dir()).filter_map(name).collect()),
        2 => Some(mark.folders),
        _ => None,
    })
}

/// The first file that is anywhere in a folder, or stands in its place.
fn file_in(path: &Path) -> Option<PathBuf> {
    match path.symlink_metadata() {
        Err(_) => None,
        Ok(found) if found.is_dir() => entries(path).iter().find_map(|path| file_in(path)),
        Ok(_) => Some(path.to_owned()),
    }
}

/// What is in a folder, by name; nothing where there is none.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    found.sort();
    found
}
