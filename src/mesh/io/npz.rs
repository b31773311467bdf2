//! Writing NPZ archives: uncompressed, the arrays in the order given, with no dates, so that the same arrays are the same bytes.

use std::io::Write;
use std::path::Path;

use npyz::zip::write::{FileOptions, ZipWriter};
use npyz::zip::{CompressionMethod, DateTime};

use super::npy::npy_start;
use super::{NpyItem, WriteError, write_atomically};

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
                let options = FileOptions::default()
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
