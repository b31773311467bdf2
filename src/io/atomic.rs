//! Writing a file so that a reader sees the old content or the new one, never half of it: everything goes to a temporary
//! file in the same folder, which then takes the target's name.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::WriteError;
use super::folder::beside;
use crate::text;

/// Calls `fill` on a buffered temporary file beside `path` and renames it to `path`.
///
/// A symbolic link is followed, an existing file's permissions are kept, and what is not a regular file (a pipe, a
/// terminal) is written directly.
///
/// # Errors
/// When the file cannot be created, written or renamed, or `fill` returns an error: nothing is left behind then and an
/// existing file of that name is untouched.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), WriteError> {
    let mut fill = Some(fill);
    fill_and_rename(path, false, &mut |writer| fill.take().expect("proven: it is called once")(writer))
}

/// [`write_atomically`] of what is to be whole after a power cut, too: it reaches the disk before it has its name. That takes some
/// milliseconds.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_durably(
    path: &Path,
    mut fill: impl FnMut(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), WriteError> {
    fill_and_rename(path, true, &mut fill)
}

/// Waits until files are on the disk. All at once: the disk does so in hardly more time than for one.
///
/// # Errors
/// When one cannot be opened, or the disk fails.
pub fn sync_files(paths: &[PathBuf]) -> Result<(), WriteError> {
    // it may be a copy of a file that must not be written; where that is no matter, it is opened to be read
    let open = |path: &PathBuf| OpenOptions::new().read(true).write(cfg!(not(unix))).open(path);
    let sync = |path: &PathBuf| {
        let synced = open(path).and_then(|file| sync_file(&file));
        synced.map_err(|source| WriteError::Io { path: path.clone(), source })
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = paths.iter().map(|path| scope.spawn(move || sync(path))).collect();
        threads.into_iter().try_for_each(|t| t.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Writes a value as JSON, indented, with a line break at the end.
///
/// # Errors
/// When the file cannot be written: see [`write_atomically`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), WriteError> {
    write_atomically(path, |file| writeln!(file, "{}", text::json(serde_json::to_string_pretty(value)?)))
}

/// Waits until a file is on the disk, where the file system knows how.
fn sync_file(file: &File) -> std::io::Result<()> {
    use std::io::ErrorKind::{InvalidInput, Unsupported};
    file.sync_all().or_else(|e| if [InvalidInput, Unsupported].contains(&e.kind()) { Ok(()) } else { Err(e) })
}

/// [`write_atomically`], compiled once.
fn fill_and_rename(
    path: &Path,
    sync: bool,
    fill: &mut dyn FnMut(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), WriteError> {
    let fail = |source| WriteError::Io { path: path.to_owned(), source };
    let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let existing = std::fs::metadata(&target).ok();
    if existing.as_ref().is_some_and(|m| !m.is_file() && !m.is_dir()) {
        let mut writer = BufWriter::new(OpenOptions::new().write(true).open(&target).map_err(fail)?);
        return fill(&mut writer).and_then(|()| writer.flush()).map_err(fail);
    }
    if existing.as_ref().is_some_and(std::fs::Metadata::is_dir) {
        return Err(fail(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
    }
    let (temporary, file) = create_beside(&target).map_err(fail)?;
    let result = (|| {
        let mut writer = BufWriter::with_capacity(1 << 16, file);
        fill(&mut writer)?;
        writer.flush()?;
        let file = writer.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        if let Some(existing) = &existing {
            file.set_permissions(existing.permissions())?;
        }
        if sync {
            sync_file(&file)?;
        }
        drop(file);
        std::fs::rename(&temporary, &target)
    })();
    result.map_err(|source| {
        let _ = std::fs::remove_file(&temporary); // the first error is the one to report
        fail(source)
    })
}

fn create_beside(target: &Path) -> std::io::Result<(PathBuf, File)> {
    if target.file_name().is_none() {
        return Err(std::io::ErrorKind::InvalidFilename.into());
    }
    loop {
        let temporary = beside(target);
        match OpenOptions::new().write(true).create_new(true).open(&temporary) {
            Ok(file) => return Ok((temporary, file)),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn replaces_the_file_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        for text in ["old", "new"] {
            write_atomically(&path, |w| w.write_all(text.as_bytes())).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        std::fs::write(&path, "old").unwrap();
        let error = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(std::io::Error::other("disk on fire"))
        });
        let message = error.unwrap_err().to_string();
        assert!(message.contains("a.txt") && message.contains("disk on fire"), "{message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(names(folder.path()), ["a.txt"]);
        assert!(write_atomically(&folder.path().join("none/a.txt"), |_| Ok(())).is_err());
        assert!(write_atomically(folder.path(), |_| Ok(())).is_err());
        assert_eq!(names(folder.path()), ["a.txt"]);
    }
}
