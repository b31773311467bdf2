//! Writing NPY files, version 1.0.

use std::io::Write;
use std::path::Path;

use super::header::shape_text;
use crate::io::{WriteError, write_atomically};
use crate::mesh::Vec3;

/// What can be written as an NPY item.
pub trait NpyItem: Copy {
    /// NumPy's type string.
    const DESCR: &'static str;
    /// Appends the item's bytes, little endian.
    fn append(self, bytes: &mut Vec<u8>);
}

impl NpyItem for f32 {
    const DESCR: &'static str = "<f4";
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.to_le_bytes());
    }
}

impl NpyItem for f64 {
    const DESCR: &'static str = "<f8";
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.to_le_bytes());
    }
}

impl NpyItem for u32 {
    const DESCR: &'static str = "<u4";
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.to_le_bytes());
    }
}

impl NpyItem for bool {
    const DESCR: &'static str = "|b1";
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.push(u8::from(self));
    }
}

/// Writes an array in C order as NPY 1.0.
///
/// # Errors
/// When the file cannot be written, or `items` is not as long as the product of `shape`.
pub fn write_npy<T: NpyItem>(path: &Path, shape: &[usize], items: &[T]) -> Result<(), WriteError> {
    if shape.iter().try_fold(1usize, |a, &b| a.checked_mul(b)) != Some(items.len()) || shape.len() > 32 {
        return Err(WriteError::data(path, format!("items for shape {}", shape_text(shape)), items.len().to_string()));
    }
    let start = npy_start(T::DESCR, shape);
    write_atomically(path, |w| {
        w.write_all(&start)?;
        let mut bytes = Vec::with_capacity(1 << 16);
        for chunk in items.chunks(1 << 13) {
            bytes.clear();
            chunk.iter().for_each(|item| item.append(&mut bytes));
            w.write_all(&bytes)?;
        }
        Ok(())
    })
}

/// Everything before the items: at most 32 axes.
pub(in crate::io) fn npy_start(descr: &str, shape: &[usize]) -> Vec<u8> {
    let comma = if shape.len() == 1 { "," } else { "" };
    let lengths: Vec<String> = shape.iter().map(usize::to_string).collect();
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}{comma}), }}", lengths.join(", "));
    // data start at a multiple of 64
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat()
}

/// Writes points as an N x 3 array of `f64`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_npy_points(path: &Path, points: &[Vec3]) -> Result<(), WriteError> {
    let items: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    write_npy(path, &[points.len(), 3], &items)
}
