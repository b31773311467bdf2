//! NPZ archives of NumPy arrays. They are written uncompressed, the arrays in the order given, with no dates, so that the same
//! arrays are the same bytes.

use std::io::{Cursor, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use zip::write::{SimpleFileOptions, ZipWriter};
use zip::{CompressionMethod, DateTime, ZipArchive};

use super::gzip::most_unpacked;
use super::npy::{NpyArray, NpyItem, npy_start, points};
use super::{Place, ReadError, WriteError, read_file, write_atomically};
use crate::mesh::Vec3;

/// An NPZ archive: named arrays.
pub struct Npz<R: Read + Seek = Cursor<Vec<u8>>> {
    path: PathBuf,
    archive: ZipArchive<R>,
    /// Bytes that the arrays still to be read may unpack to.
    left: u64,
}

impl<R: Read + Seek> std::fmt::Debug for Npz<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Npz").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Npz {
    /// Opens an archive.
    ///
    /// # Errors
    /// When the file cannot be read or is not an archive.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Self::from_reader(Cursor::new(read_file(path)?), path)
    }
}

impl<R: Read + Seek> Npz<R> {
    /// Opens an archive that is read from `reader`; `path` is only named in errors.
    ///
    /// # Errors
    /// As [`Npz::open`].
    pub fn from_reader(mut reader: R, path: &Path) -> Result<Self, ReadError> {
        let length = reader.seek(SeekFrom::End(0)).map_err(|source| ReadError::io(path, source))?;
        match ZipArchive::new(reader) {
            Ok(archive) => Ok(Self { path: path.to_owned(), archive, left: most_unpacked(length) }),
            Err(_) => {
                Err(ReadError::malformed(path, Place::File, "an NPZ (zip) archive", "another file, or a part of one"))
            }
        }
    }

    /// Names of the arrays, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            self.archive.file_names().filter_map(|name| Some(name.strip_suffix(".npy")?.to_owned())).collect();
        names.sort_unstable();
        names
    }

    /// The array called `name`.
    ///
    /// # Errors
    /// When there is none (the message lists those there are), the arrays read so far and this one come to more than 200 times the
    /// archive, or as [`NpyArray::open`].
    pub fn array(&mut self, name: &str) -> Result<NpyArray<'_>, ReadError> {
        let names = self.names();
        if !names.iter().any(|n| n == name) {
            let found = if names.is_empty() { "no arrays".to_owned() } else { names.join(", ") };
            return Err(ReadError::malformed(&self.path, Place::File, format!("an array {name:?}"), found));
        }
        // Appended, not joined: a name may look like a path from the root.
        let mut inside = self.path.clone().into_os_string();
        inside.push(format!("/{name}.npy"));
        let inside = PathBuf::from(inside);
        match self.archive.by_name(&format!("{name}.npy")) {
            Ok(entry) => {
                let size = entry.size(); // more is not read, whatever the entry unpacks to
                let Some(left) = self.left.checked_sub(size) else {
                    let expected = format!("at most {} more bytes from an archive of its length", self.left);
                    return Err(ReadError::malformed(&inside, Place::File, expected, size.to_string()));
                };
                self.left = left;
                NpyArray::from_reader(Box::new(entry), Some(size), &inside)
            }
            Err(e) => Err(ReadError::malformed(&inside, Place::File, "a readable archive entry", e.to_string())),
        }
    }

    /// The N x 3 array called `name` as points.
    ///
    /// # Errors
    /// As [`Npz::array`] and [`read_npy_points`](super::read_npy_points).
    pub fn points(&mut self, name: &str) -> Result<Vec<Vec3>, ReadError> {
        points(self.array(name)?)
    }
}

/// Arrays by name, to be written as `.npz`.
#[derive(Debug, Clone, Default)]
pub struct NpzContents {
    arrays: Vec<(String, Vec<u8>)>,
}

impl NpzContents {
    /// No arrays.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an array in C order.
    ///
    /// # Panics
    /// If there are not as many items as the shape has room for.
    #[must_use]
    pub fn with<T: NpyItem>(mut self, name: &str, shape: &[usize], items: &[T]) -> Self {
        assert_eq!(shape.iter().product::<usize>(), items.len(), "{name}: items of another shape");
        let mut bytes = npy_start(T::DESCR, shape);
        items.iter().for_each(|item| item.append(&mut bytes));
        self.arrays.push((name.to_owned(), bytes));
        self
    }

    /// Adds a list of text, as NumPy's `U`.
    #[must_use]
    pub fn with_text(mut self, name: &str, items: &[&str]) -> Self {
        let letters = items.iter().map(|t| t.chars().count()).max().unwrap_or(0).max(1);
        let mut bytes = npy_start(&format!("<U{letters}"), &[items.len()]);
        for item in items {
            let codes = item.chars().map(u32::from).chain(std::iter::repeat(0)).take(letters);
            codes.for_each(|code| code.append(&mut bytes));
        }
        self.arrays.push((name.to_owned(), bytes));
        self
    }

    /// Writes the archive.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        write_atomically(path, |w| {
            let mut zip = ZipWriter::new(w);
            for (name, bytes) in &self.arrays {
                let options = SimpleFileOptions::default()
                    .compression_method(CompressionMethod::Stored)
                    .last_modified_time(DateTime::default())
                    .large_file(bytes.len() > u32::MAX as usize);
                zip.start_file(format!("{name}.npy"), options)?;
                zip.write_all(bytes)?;
            }
            zip.finish()?.flush()
        })
    }
}
