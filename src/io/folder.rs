//! Folders of files that belong together, such as a rig: all of them or none.
//!
//! Files are written aside first, where a full disk or a kill does no harm. A new folder then takes its name in one step. Into one
//! that is there they are moved one by one, and while that lasts it holds a file `.unfinished`: who reads such folders refuses one
//! with that name.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use super::{Place, ReadError, WriteError};

/// The file that marks a folder whose files are being moved in.
const UNFINISHED: &str = ".unfinished";

/// Calls `fill` with an empty folder, and gives what it has written there to `folder`: made if it is not there, in a folder that
/// is. Other files of it are left alone. `fill` makes files, no folders.
///
/// # Errors
/// When something cannot be made, or `fill` returns an error: nothing has changed then. When a file cannot be moved in the end,
/// the folder stays marked as unfinished.
pub fn write_folder(folder: &Path, fill: impl FnOnce(&Path) -> Result<(), WriteError>) -> Result<(), WriteError> {
    let fail = |path: &Path| {
        let path = path.to_owned();
        move |source| WriteError::Io { path, source }
    };
    let there = folder.is_dir();
    let aside = if there { beside(&folder.join("folder")) } else { beside(folder) };
    fs::create_dir(&aside).map_err(fail(folder))?;
    let aside = Aside(aside);
    // errors name the files by what they are to be
    fill(&aside.0).map_err(|error| error.moved(&aside.0, folder))?;
    if !there {
        return fs::rename(&aside.0, folder).map_err(fail(folder));
    }
    let mut files: Vec<PathBuf> = fs::read_dir(&aside.0)
        .and_then(|entries| entries.map(|e| e.map(|e| e.path())).collect())
        .map_err(fail(folder))?;
    files.sort();
    let mark = folder.join(UNFINISHED);
    fs::write(&mark, "").map_err(fail(&mark))?;
    for file in files {
        let target = folder.join(file.file_name().unwrap_or_default());
        replace(&file, &target).map_err(fail(&target))?;
    }
    fs::remove_file(&mark).map_err(fail(&mark))
}

/// Puts a file in the place of another one, whose permissions are kept and to which links are followed, as
/// [`write_atomically`](super::write_atomically) does.
pub(crate) fn replace(file: &Path, target: &Path) -> std::io::Result<()> {
    let target = target.canonicalize().unwrap_or_else(|_| target.to_owned());
    if let Ok(existing) = fs::metadata(&target) {
        if existing.is_dir() {
            return Err(std::io::ErrorKind::IsADirectory.into());
        }
        fs::set_permissions(file, existing.permissions())?;
    }
    fs::rename(file, &target)
}

/// Refuses a folder whose files were being moved in when the program that did it ended.
///
/// # Errors
/// When it is one.
pub fn refuse_unfinished(folder: &Path) -> Result<(), ReadError> {
    if folder.join(UNFINISHED).exists() {
        let found = format!("one whose writer ended in the middle, as {UNFINISHED} in it says: write it again");
        return Err(ReadError::malformed(folder, Place::File, "a whole folder", found));
    }
    Ok(())
}

/// A hidden name of its own beside `path`, cut so that it is no longer than others.
pub(super) fn beside(path: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut cut = name.len().min(40);
    while !name.is_char_boundary(cut) {
        cut -= 1;
    }
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    path.with_file_name(format!(".{}.{}-{number}.tmp", &name[..cut], std::process::id()))
}

/// A folder that vanishes with what is in it.
struct Aside(PathBuf);

impl Drop for Aside {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0); // it may have got its name
    }
}

#[cfg(test)]
mod tests {
    use super::super::write_atomically;
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_is_whole_or_as_it_was() {
        use std::io::Write as _;
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("rig");
        let write = |aside: &Path, name: &str, text: &str| {
            write_atomically(&aside.join(name), |file| file.write_all(text.as_bytes()))
        };
        let failing = |aside: &Path| {
            write(aside, "a", "new")?;
            write(&aside.join("none"), "b", "new")
        };
        let error = write_folder(&folder, failing).unwrap_err().to_string();
        assert!(error.contains(&format!("{}", folder.join("none/b").display())), "{error}");
        assert!(names(root.path()).is_empty());
        write_folder(&folder, |aside| write(aside, "a", "old")).unwrap();
        fs::write(folder.join("mine"), "").unwrap();
        write_folder(&folder, failing).unwrap_err();
        assert_eq!(
            (names(&folder), fs::read(folder.join("a")).unwrap()),
            (vec!["a".into(), "mine".into()], b"old".into())
        );
        refuse_unfinished(&folder).unwrap();
        write_folder(&folder, |aside| write(aside, "a", "new")).unwrap();
        assert_eq!(
            (names(&folder), fs::read(folder.join("a")).unwrap()),
            (vec!["a".into(), "mine".into()], b"new".into())
        );
        fs::create_dir(folder.join("b")).unwrap();
        let both = |aside: &Path| write(aside, "a", "newer").and_then(|()| write(aside, "b", "newer"));
        write_folder(&folder, both).unwrap_err();
        assert!(refuse_unfinished(&folder).unwrap_err().to_string().contains("write it again"));
        fs::remove_dir(folder.join("b")).unwrap();
        write_folder(&folder, both).unwrap();
        refuse_unfinished(&folder).unwrap();
        assert_eq!(names(root.path()), ["rig"]);
    }
}
