//! NumPy arrays in NPY files. Source: `numpy.lib.format`, versions 1.0 to 3.0.
//!
//! Data come out in C order (last index fastest) whatever order the file has.

mod header;
mod write;

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use super::error::excerpt;
use super::{Place, ReadError, check_coordinates, inputs};
use crate::mesh::Vec3;
use header::{Header, Kind, parse_header, shape_text};

pub(super) use write::npy_start;
pub use write::{NpyItem, write_npy, write_npy_points};

/// An array whose header has been read and checked against the size of the file; the data are read on demand.
pub struct NpyArray<'a> {
    path: PathBuf,
    header: Header,
    reader: Box<dyn Read + 'a>,
    /// Whether the data are known to be as long as the header says: those of a file on disk, not what an archive claims.
    sized: bool,
}

impl std::fmt::Debug for NpyArray<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NpyArray").field("path", &self.path).field("header", &self.header).finish_non_exhaustive()
    }
}

impl NpyArray<'static> {
    /// Opens an NPY file and reads its header.
    ///
    /// # Errors
    /// When the file cannot be read, is not NPY, has a type other than bool, integers or floats, or is too short for the
    /// shape that it claims.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let fail = |source| ReadError::io(path, source);
        let file = inputs::open(path).map_err(fail)?;
        let metadata = file.metadata().map_err(fail)?;
        if metadata.is_dir() {
            return Err(fail(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
        }
        let size = if metadata.is_file() { Some(metadata.len()) } else { None };
        let array = NpyArray::from_reader(Box::new(BufReader::new(file)), size, path)?;
        Ok(Self { sized: size.is_some(), ..array })
    }
}

impl<'a> NpyArray<'a> {
    /// Reads the header of the bytes of an NPY file; `path` is only named in errors.
    ///
    /// # Errors
    /// As [`NpyArray::open`].
    pub fn parse(bytes: &'a [u8], path: &Path) -> Result<Self, ReadError> {
        Self::from_reader(Box::new(bytes), Some(bytes.len() as u64), path)
    }

    pub(super) fn from_reader(
        mut reader: Box<dyn Read + 'a>,
        size: Option<u64>,
        path: &Path,
    ) -> Result<Self, ReadError> {
        let error =
            |byte, expected: &str, found: String| ReadError::malformed(path, Place::Byte(byte), expected, found);
        let mut fill = |buffer: &mut [u8], at: usize, what: &str| {
            reader.read_exact(buffer).map_err(|source| match source.kind() {
                std::io::ErrorKind::UnexpectedEof => error(at, what, "the end of the file".into()),
                _ => ReadError::io(path, source),
            })
        };
        let mut start = [0; 8];
        fill(&mut start, 0, "an NPY file, which starts with \\x93NUMPY")?;
        if &start[..6] != b"\x93NUMPY" {
            return Err(error(0, "an NPY file, which starts with \\x93NUMPY", excerpt(&start[..6])));
        }
        let mut length = [0; 4];
        let (width, data_start) = match start[6] {
            1 => (2, 10),
            2 | 3 => (4, 12),
            version => return Err(error(6, "NPY version 1, 2 or 3", version.to_string())),
        };
        fill(&mut length[..width], 8, "the length of the header")?;
        let header_length = u32::from_le_bytes(length) as usize;
        if header_length > 1 << 16 {
            return Err(error(8, "a header of at most 65536 bytes", header_length.to_string()));
        }
        let mut text = vec![0; header_length];
        fill(&mut text, data_start, &format!("a header of {header_length} bytes"))?;
        let header = parse_header(&text).map_err(|(at, expected, found)| error(data_start + at, expected, found))?;
        let data_start = data_start + header_length;
        let needed = header.length.checked_mul(header.size);
        if let Some(size) = size {
            let left = size.saturating_sub(data_start as u64);
            if needed.is_none_or(|needed| needed as u64 > left) {
                let expected = format!("data of shape {} and type {}", shape_text(&header.shape), header.descr);
                return Err(error(data_start, &expected, format!("{left} bytes")));
            }
        }
        if needed.is_none() {
            return Err(error(data_start, "a shape that fits in memory", shape_text(&header.shape)));
        }
        Ok(Self { path: path.to_owned(), header, reader, sized: false })
    }

    /// Length of each axis.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.header.shape
    }

    /// Fails unless the shape is `expected`; `None` stands for any length.
    ///
    /// # Errors
    /// A message such as "expected an array N x 3, found 6706 x 2".
    pub fn expect_shape(&self, expected: &[Option<usize>]) -> Result<(), ReadError> {
        let fits = |(have, want): (&usize, &Option<usize>)| want.is_none_or(|want| want == *have);
        if self.header.shape.len() == expected.len() && self.header.shape.iter().zip(expected).all(fits) {
            return Ok(());
        }
        let names = ["N", "M", "K"];
        let axis = |(i, want): (usize, &Option<usize>)| {
            want.map_or_else(|| names.get(i).unwrap_or(&"any").to_string(), |want| want.to_string())
        };
        let expected: Vec<String> = expected.iter().enumerate().map(axis).collect();
        let expected = format!("an array {}", expected.join(" x "));
        Err(ReadError::malformed(&self.path, Place::File, expected, shape_text(&self.header.shape)))
    }

    /// All items as `f64`, C order; integers beyond 2^53 are rounded.
    ///
    /// # Errors
    /// When the data cannot be read.
    pub fn read_f64(self) -> Result<Vec<f64>, ReadError> {
        self.expect_numbers()?;
        let decode = decoder(&self.header);
        self.read_with(usize::MAX, decode)
    }

    /// The items of the first `rows` entries of the first axis as `f32`, C order; wider types are rounded. What follows is not read, unless the
    /// file is in Fortran order.
    ///
    /// # Errors
    /// When the data cannot be read.
    pub fn read_f32_rows(self, rows: usize) -> Result<Vec<f32>, ReadError> {
        self.expect_numbers()?;
        if self.header.kind == Kind::Float && self.header.size == 4 {
            let big = self.header.big;
            return self.read_with(rows, move |b| {
                let bytes = [b[0], b[1], b[2], b[3]];
                if big { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) }
            });
        }
        let decode = decoder(&self.header);
        self.read_with(rows, move |b| decode(b) as f32)
    }

    /// All items as truth values, C order; integers are true unless 0.
    ///
    /// # Errors
    /// When the data cannot be read, or are floats.
    pub fn read_bool(self) -> Result<Vec<bool>, ReadError> {
        self.expect_numbers()?;
        if self.header.kind == Kind::Float {
            let found = format!("type {}", self.header.descr);
            return Err(ReadError::malformed(&self.path, Place::File, "an array of bool or integers", found));
        }
        self.read_with(usize::MAX, |b| b.iter().any(|&byte| byte != 0))
    }

    /// All items of an array of text (`U`), C order.
    ///
    /// # Errors
    /// When the data cannot be read, are numbers, or are no Unicode.
    pub fn read_text(self) -> Result<Vec<String>, ReadError> {
        let malformed = |expected: &str, found: String| ReadError::malformed(&self.path, Place::File, expected, found);
        if self.header.kind != Kind::Text {
            return Err(malformed("an array of text, U", format!("type {}", self.header.descr)));
        }
        let (big, letters, count) = (self.header.big, self.header.size / 4, self.header.length);
        let not_unicode = malformed("Unicode", "something else".into());
        // letters as numbers along a further axis
        let mut header = Header { kind: Kind::Unsigned, size: 4, length: count.saturating_mul(letters), ..self.header };
        header.shape.insert(if header.fortran { 0 } else { header.shape.len() }, letters);
        if header.fortran && header.shape.len() > 2 {
            return Err(ReadError::malformed(
                &self.path,
                Place::File,
                "a list of text",
                shape_text(&header.shape[1..]),
            ));
        }
        header.fortran = false;
        let codes = Self { header, ..self }.read_with(usize::MAX, |b| {
            let bytes = [b[0], b[1], b[2], b[3]];
            if big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
        })?;
        let text = |item: &[u32]| -> Option<String> {
            let end = item.iter().rposition(|&c| c != 0).map_or(0, |last| last + 1);
            item[..end].iter().map(|&c| char::from_u32(c)).collect()
        };
        codes.chunks_exact(letters).map(text).collect::<Option<_>>().ok_or(not_unicode)
    }

    fn expect_numbers(&self) -> Result<(), ReadError> {
        if self.header.kind != Kind::Text {
            return Ok(());
        }
        let found = format!("type '{}'", self.header.descr);
        Err(ReadError::malformed(&self.path, Place::File, "an array of bool, i1-i8, u1-u8, f2, f4 or f8", found))
    }

    fn read_with<T: Copy>(mut self, rows: usize, decode: impl Fn(&[u8]) -> T) -> Result<Vec<T>, ReadError> {
        let header = &self.header;
        if header.length == 0 {
            return Ok(Vec::new()); // the product of the other axes need not fit in memory
        }
        let row: usize = header.shape.iter().skip(1).product();
        let kept = row * rows.min(header.shape.first().copied().unwrap_or(1));
        let wanted = if header.fortran { header.length } else { kept };
        // else grown as data arrive
        let mut items = Vec::with_capacity(if self.sized { wanted } else { wanted.min(1 << 20) });
        let mut buffer = vec![0; (1 << 16) / header.size * header.size];
        while items.len() < wanted {
            let bytes = ((wanted - items.len()) * header.size).min(buffer.len());
            self.reader.read_exact(&mut buffer[..bytes]).map_err(|source| match source.kind() {
                std::io::ErrorKind::UnexpectedEof => ReadError::malformed(
                    &self.path,
                    Place::File,
                    format!("{} items of type {}", header.length, header.descr),
                    format!("the end of the data near item {}", items.len()),
                ),
                _ => ReadError::io(&self.path, source),
            })?;
            items.extend(buffer[..bytes].chunks_exact(header.size).map(&decode));
        }
        if header.fortran && header.shape.len() > 1 {
            items = transpose(&items, &header.shape);
        }
        items.truncate(kept);
        Ok(items)
    }
}

/// Item order from "first index fastest" to "last index fastest".
fn transpose<T: Copy>(items: &[T], shape: &[usize]) -> Vec<T> {
    let mut strides = vec![1; shape.len()];
    for axis in 1..shape.len() {
        strides[axis] = strides[axis - 1] * shape[axis - 1];
    }
    let mut index = vec![0; shape.len()];
    let mut at = 0;
    let mut out = Vec::with_capacity(items.len());
    for _ in 0..items.len() {
        out.push(items[at]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            at += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            at -= strides[axis] * shape[axis];
            index[axis] = 0;
        }
    }
    out
}

/// Turns the bytes of one item into a number; the caller passes exactly `size` bytes.
fn decoder(header: &Header) -> impl Fn(&[u8]) -> f64 + use<> {
    let (kind, size, big) = (header.kind, header.size, header.big);
    move |b| {
        // little-endian, zero-extended
        let mut bytes = [0; 8];
        for i in 0..size {
            bytes[i] = if big { b[size - 1 - i] } else { b[i] };
        }
        let bits = u64::from_le_bytes(bytes);
        match kind {
            Kind::Bool | Kind::Unsigned | Kind::Text => bits as f64,
            Kind::Signed => {
                let unused = 64 - 8 * size as u32;
                (((bits << unused) as i64) >> unused) as f64
            }
            Kind::Float if size == 2 => half(bits as u16),
            Kind::Float if size == 4 => f64::from(f32::from_bits(bits as u32)),
            Kind::Float => f64::from_bits(bits),
        }
    }
}

/// A number of 16 bits, binary16 of IEEE 754: a sign, five bits of exponent and ten of fraction.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff);
    let size = match i32::from(bits >> 10 & 0x1f) {
        0 => fraction * 2f64.powi(-24),
        31 if fraction > 0.0 => f64::NAN,
        31 => f64::INFINITY,
        exponent => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// Reads an N x 3 array as points.
///
/// # Errors
/// When the file cannot be read, has another shape, or a coordinate is not finite.
pub fn read_npy_points(path: &Path) -> Result<Vec<Vec3>, ReadError> {
    points(NpyArray::open(path)?)
}

pub(super) fn points(array: NpyArray<'_>) -> Result<Vec<Vec3>, ReadError> {
    array.expect_shape(&[None, Some(3)])?;
    let path = array.path.clone();
    let values = array.read_f64()?;
    if let Some(i) = values.iter().position(|v| !v.is_finite()) {
        let expected = format!("finite coordinates of point {}", i / 3);
        return Err(ReadError::malformed(&path, Place::File, expected, values[i].to_string()));
    }
    let points: Vec<Vec3> = values.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])).collect();
    check_coordinates(&path, &points)?;
    Ok(points)
}

/// Reads a one-dimensional array of numbers, of length `length` if that is given.
///
/// # Errors
/// When the file cannot be read or has another shape.
pub fn read_npy_vector(path: &Path, length: Option<usize>) -> Result<Vec<f64>, ReadError> {
    let array = NpyArray::open(path)?;
    array.expect_shape(&[length])?;
    array.read_f64()
}

/// Reads a one-dimensional array of truth values, of length `length` if that is given.
///
/// # Errors
/// When the file cannot be read, has another shape, or holds floats.
pub fn read_npy_mask(path: &Path, length: Option<usize>) -> Result<Vec<bool>, ReadError> {
    let array = NpyArray::open(path)?;
    array.expect_shape(&[length])?;
    array.read_bool()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_16_bits() {
        // as numpy.float16 has them
        for (bits, number) in [
            (0x0000, 0.0),
            (0x0001, 2f64.powi(-24)),
            (0x03ff, 1023.0 * 2f64.powi(-24)),
            (0x0400, 2f64.powi(-14)),
            (0x3555, 0.333_251_953_125),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0xfc00, f64::NEG_INFINITY),
        ] {
            assert_eq!(half(bits), number, "{bits:#x}");
        }
        assert!(half(0x7e00).is_nan());
    }

    #[test]
    fn fortran_order_is_turned() {
        assert_eq!(transpose(&[1, 4, 2, 5, 3, 6], &[2, 3]), [1, 2, 3, 4, 5, 6]);
        let shape = [2, 3, 4];
        let c: Vec<usize> = (0..24).collect();
        let mut fortran = vec![0; 24];
        for (i, &item) in c.iter().enumerate() {
            let (a, b, d) = (i / 12, i / 4 % 3, i % 4);
            fortran[a + 2 * (b + 3 * d)] = item;
        }
        assert_eq!(transpose(&fortran, &shape), c);
    }
}
