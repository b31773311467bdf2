//! Which files were read, and the SHA-256 of the bytes that were read: taken while a reader reads, so that a file that is deleted
//! or replaced afterwards neither fails nor gives the hash of another one, and a pipe is read once.
//!
//! All readers of this crate open files by [`open`] or [`read`]. What they read is noted for the thread that asked for it by
//! [`Inputs::reading`]; who reads on other threads takes [`Noting::here`] along.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use sha2::{Digest, Sha256};

thread_local! {
    static NOTING: RefCell<Option<Noting>> = const { RefCell::new(None) };
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Input {
    /// What it was read as.
    pub role: String,
    /// Where it is, in whatever folder one works later.
    pub path: PathBuf,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}

/// Notes of the files that are read.
#[derive(Debug, Clone, Default)]
pub struct Inputs(Arc<Mutex<Vec<Input>>>);

impl Inputs {
    /// Notes what `work` reads on this thread, as read in this role.
    pub fn reading<R>(&self, role: &str, work: impl FnOnce() -> R) -> R {
        Noting { inputs: self.clone(), role: role.to_owned() }.during(work)
    }

    /// What was read: roles in the order in which they came, the files of each by path.
    #[must_use]
    pub fn files(&self) -> Vec<Input> {
        let noted = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut roles: Vec<&str> = Vec::new();
        for input in &noted {
            if !roles.contains(&input.role.as_str()) {
                roles.push(&input.role);
            }
        }
        let mut files = Vec::with_capacity(noted.len());
        for role in roles {
            let mut of_role: Vec<Input> = noted.iter().filter(|input| input.role == role).cloned().collect();
            of_role.sort();
            of_role.dedup();
            files.extend(of_role);
        }
        files
    }
}

/// Where a thread notes what it reads.
#[derive(Debug, Clone)]
pub struct Noting {
    inputs: Inputs,
    role: String,
}

impl Noting {
    /// This thread's, if it notes anything.
    #[must_use]
    pub fn here() -> Option<Self> {
        NOTING.with_borrow(Clone::clone)
    }

    /// Notes what `work` reads on this thread as another thread does: what that has [here](Self::here).
    pub fn along<R>(noting: Option<&Self>, work: impl FnOnce() -> R) -> R {
        match noting {
            Some(noting) => noting.during(work),
            None => work(),
        }
    }

    /// Notes what `work` reads on this thread.
    pub fn during<R>(&self, work: impl FnOnce() -> R) -> R {
        /// Puts back what was there, also when `work` panics.
        struct Before(Option<Noting>);
        impl Drop for Before {
            fn drop(&mut self) {
                NOTING.set(self.0.take());
            }
        }
        let _before = Before(NOTING.replace(Some(self.clone())));
        work()
    }

    fn note(&self, path: PathBuf, sha256: String) {
        let input = Input { role: self.role.clone(), path, sha256 };
        self.inputs.0.lock().unwrap_or_else(PoisonError::into_inner).push(input);
    }
}

/// A file that is being read. When it is dropped, the hash of all of it is noted: a regular file's rest is read for that.
#[derive(Debug)]
pub(crate) struct OpenFile {
    file: File,
    noted: Option<(Noting, PathBuf, Sha256)>,
}

/// Opens a file, to be read from its start to its end.
pub(crate) fn open(path: &Path) -> io::Result<OpenFile> {
    let noted = Noting::here().map(|noting| (noting, absolute(path), Sha256::new()));
    Ok(OpenFile { file: File::open(path)?, noted })
}

/// The bytes of a file.
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let Some(noting) = Noting::here() else { return std::fs::read(path) };
    let bytes = std::fs::read(path)?;
    noting.note(absolute(path), sha256(&bytes));
    Ok(bytes)
}

/// A path that holds in any working folder; an empty one stays empty.
#[must_use]
pub fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// SHA-256, hexadecimal.
#[must_use]
pub fn sha256(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// SHA-256 of what a regular file holds, hexadecimal.
///
/// # Errors
/// When it cannot be read, or is a pipe or a device: those can be read but once, or never end.
pub fn sha256_of_file(path: &Path) -> io::Result<String> {
    // before it is opened: that of a pipe waits for a writer
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is no regular file, which is needed here because it is read more than once"));
    }
    let mut hash = Sha256::new();
    io::copy(&mut File::open(path)?, &mut Hashing(&mut hash))?;
    Ok(hexadecimal(&hash.finalize()))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

struct Hashing<'a>(&'a mut Sha256);

impl io::Write for Hashing<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl OpenFile {
    pub(crate) fn metadata(&self) -> io::Result<std::fs::Metadata> {
        self.file.metadata()
    }
}

impl Read for OpenFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        if let Some((_, _, hash)) = &mut self.noted {
            hash.update(&buffer[..count]);
        }
        Ok(count)
    }
}

impl Drop for OpenFile {
    fn drop(&mut self) {
        let Some((noting, path, mut hash)) = self.noted.take() else { return };
        if self.file.metadata().is_ok_and(|m| m.is_file()) && io::copy(&mut self.file, &mut Hashing(&mut hash)).is_err()
        {
            return; // a file without a hash is no input: whoever needs it finds none
        }
        noting.note(path, hexadecimal(&hash.finalize()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_read_is_noted_however_much_of_it_and_by_whom_it_was_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        std::fs::write(&path, "some bytes").unwrap();
        let inputs = Inputs::default();
        read(&path).unwrap(); // nobody asked
        inputs.reading("whole", || read(&path).unwrap());
        inputs.reading("part", || {
            let mut start = [0; 4];
            open(&path).unwrap().read_exact(&mut start).unwrap();
            let here = Noting::here().unwrap();
            std::thread::scope(|scope| scope.spawn(move || here.during(|| read(&path).unwrap())).join().unwrap());
        });
        let other = folder.path().join("b.txt");
        std::fs::write(&other, "").unwrap();
        inputs.reading("whole", || read(&other).unwrap());
        let files = inputs.files();
        let hash = sha256(b"some bytes");
        let found: Vec<_> =
            files.iter().map(|f| (&f.role[..], f.path.file_name().unwrap().to_str().unwrap())).collect();
        assert_eq!(found, [("whole", "a.txt"), ("whole", "b.txt"), ("part", "a.txt")]);
        assert!(files[0].sha256 == hash && files[2].sha256 == hash && files[1].sha256 == sha256(b""));
        assert_eq!(sha256_of_file(&files[0].path).unwrap(), hash);
        assert!(sha256_of_file(folder.path()).is_err());
        assert!(Noting::here().is_none());
    }
}
