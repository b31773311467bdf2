//! `data-gen.json`: what of a folder `data-gen` has made, so that a later run replaces that and nothing else.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use nonrigid::console::Failure;
use nonrigid::io::{read_side_file, write_atomically};
use serde_json::json;

/// Its name.
const NAME: &str = "data-gen.json";

/// Files and folders that belong together, `prefix` and a number each: one that is left of another run would be taken for one of them.
pub(crate) struct Series {
    /// Below the output's folder.
    pub folder: &'static str,
    /// Of the names.
    pub prefixes: &'static [&'static str],
}

pub(crate) const CASES: Series = Series { folder: "cases", prefixes: &["same_", "new_"] };
pub(crate) const SEQUENCE: Series = Series { folder: "sequence", prefixes: &["frame_"] };
pub(crate) const POPULATION: Series = Series { folder: "population", prefixes: &["person_"] };

impl Series {
    /// Whether a file or folder of this name is one of them.
    fn holds(&self, name: &str) -> bool {
        let stem = name.strip_suffix(".obj").unwrap_or(name);
        let is_number = |text: &str| text.len() >= 4 && text.bytes().all(|b| b.is_ascii_digit());
        self.prefixes.iter().any(|prefix| stem.strip_prefix(prefix).is_some_and(is_number))
    }
}

/// Records that a run makes `made` in the folder `out`, files and folders by their paths from there; of each of `series`, it makes all.
///
/// # Errors
/// A [`Failure`] of writing, without a trace, where something stands in the place of one of them that no earlier run has made, where one of a
/// series is left of another run, and where nothing can be written.
pub(crate) fn claim(out: &Path, made: BTreeSet<String>, series: &[&Series]) -> Result<(), Failure> {
    let mut recorded = read(&out.join(NAME))?;
    if let Some(stranger) = made.iter().find(|path| !recorded.contains(*path) && stands(&out.join(path))) {
        return Err(Failure::writing(format!(
            "{}: is there, and no {NAME} lists it as made by an earlier run; move it away, or give another --out",
            out.join(stranger).display()
        )));
    }
    for series in series {
        let left = entries(&out.join(series.folder)).into_iter().find(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            series.holds(&name) && !made.contains(&format!("{}/{name}", series.folder))
        });
        if let Some(left) = left {
            return Err(Failure::writing(format!(
                "{}: is of another run, and would be taken for one of this; move it away, or give another --out",
                left.display()
            )));
        }
    }
    recorded.retain(|path| stands(&out.join(path)));
    recorded.extend(made);
    fs::create_dir_all(out).map_err(|e| Failure::writing(format!("{}: {e}", out.display())))?;
    let text = json!({ "version": 1, "made": recorded });
    write_atomically(&out.join(NAME), |file| writeln!(file, "{text:#}")).map_err(Failure::writing)
}

/// What earlier runs have made; nothing without a record.
fn read(path: &Path) -> Result<BTreeSet<String>, Failure> {
    if !path.exists() {
        return Ok(BTreeSet::new());
    }
    let advice = "move it away, or give another --out";
    let bytes = read_side_file(path).map_err(|e| Failure::writing(format!("{e}; {advice}")))?;
    let made = serde_json::from_slice::<serde_json::Value>(&bytes).ok();
    let made =
        made.filter(|record| record["version"] == 1).and_then(|mut r| serde_json::from_value(r["made"].take()).ok());
    made.ok_or_else(|| Failure::writing(format!("{}: is no record of this program; {advice}", path.display())))
}

/// Whether there is anything that could be lost: a file, or a folder that is not empty.
fn stands(path: &Path) -> bool {
    path.symlink_metadata().is_ok() && !(path.is_dir() && entries(path).is_empty())
}

/// What is in a folder, by name; nothing where there is none.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    found.sort();
    found
}
