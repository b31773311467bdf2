//! Results of other programs, scored as ours are.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Result;
use nonrigid::console::Failure;
use nonrigid::io;

use super::{BenchCase, BenchRow, Score};

/// Another program's results: for a case called `CASE`, `folder/CASE.obj`, `.ply` or `.npy`, or `folder/CASE/result.obj`,
/// `.ply` or `.npy`, in the template's vertex order, in the scan's frame, millimetres.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct External {
    /// Its name in the table.
    pub name: String,
    /// Where its results are.
    pub folder: PathBuf,
}

impl FromStr for External {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((name, folder)) if !name.trim().is_empty() && !folder.is_empty() => {
                Ok(Self { name: name.trim().to_owned(), folder: folder.into() })
            }
            _ => Err(format!("{text:?} is not NAME=DIR")),
        }
    }
}

impl External {
    /// The files that may hold the result of a case.
    fn candidates(&self, case: &str) -> impl Iterator<Item = PathBuf> {
        let [file, inside] = [self.folder.join(case), self.folder.join(case).join("result")];
        // Appended, not `with_extension`: a case may have a dot in its name.
        [file, inside].into_iter().flat_map(|stem| {
            ["obj", "ply", "npy"].map(|extension| PathBuf::from(format!("{}.{extension}", stem.display())))
        })
    }

    /// A row for every case; one without a result, or with one that cannot be compared, says so.
    ///
    /// # Errors
    /// A [`Failure`] of loading when the folder is not there or holds no case's result.
    pub fn rows(&self, cases: &[BenchCase]) -> Result<Vec<BenchRow>> {
        let (name, folder) = (&self.name, self.folder.display());
        if !self.folder.is_dir() {
            return Err(Failure::loading(format!("--external {name}={folder}: there is no such folder")).into());
        }
        let rows: Vec<(bool, BenchRow)> = cases.iter().map(|case| self.row(case)).collect();
        if !rows.iter().any(|(present, _)| *present) {
            let example = cases.first().map_or("CASE", |case| &case.name);
            return Err(Failure::loading(format!(
                "--external {name}={folder}: no result of any case; looked for {example}.obj, .ply or .npy, \
                 {example}/result.obj, .ply or .npy, and so on"
            ))
            .into());
        }
        Ok(rows.into_iter().map(|(_, row)| row).collect())
    }

    /// Whether there is a file, and what it says.
    fn row(&self, case: &BenchCase) -> (bool, BenchRow) {
        let files: Vec<PathBuf> = self.candidates(&case.name).filter(|path| path.is_file()).collect();
        let scored = match &files[..] {
            [] => Err("no result".to_owned()),
            [file] => score(file, case),
            [one, other, ..] => Err(format!("two results: {} and {}", one.display(), other.display())),
        };
        let row = BenchRow::new("external", &self.name, &case.name, scored);
        (!files.is_empty(), row)
    }
}

fn score(file: &Path, case: &BenchCase) -> Result<Score, String> {
    let positions = if file.extension().is_some_and(|e| e == "npy") {
        io::read_npy_points(file)
    } else {
        io::read_polygon_mesh(file).map(|mesh| mesh.positions)
    };
    // The readers' errors name the file, and refuse numbers that are not finite.
    let positions = positions.map_err(|e| e.to_string())?;
    case.scored(&positions, None).map_err(|e| format!("{}: {e}", file.display()))
}
