//! NumPy arrays: NPY files, and NPZ archives of them. Source: `numpy.lib.format`, versions 1.0 to 3.0.
//!
//! Our own header parser rather than `npyz`'s, whose product of the dimensions overflows on absurd shapes and whose
//! header is allocated and parsed recursively at whatever size the file claims; `npyz` opens the archives.
//! Data come out in C order (last index fastest) whatever order the file has.

use std::fs::File;
use std::io::{BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};

use super::error::excerpt;
use super::{Place, ReadError, WriteError, write_atomically};
use crate::mesh::Vec3;

/// Length of a text at most.
const MOST_LETTERS: usize = 4096;

/// Type of the items of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Bool,
    Signed,
    Unsigned,
    Float,
    Text,
}

#[derive(Debug, Clone, PartialEq)]
struct Header {
    kind: Kind,
    size: usize,
    big: bool,
    fortran: bool,
    shape: Vec<usize>,
    length: usize,
    descr: String,
}

/// An array whose header has been read and checked against the size of the file; the data are read on demand.
pub struct NpyArray<'a> {
    path: PathBuf,
    header: Header,
    reader: Box<dyn Read + 'a>,
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
        let file = File::open(path).map_err(fail)?;
        let metadata = file.metadata().map_err(fail)?;
        if metadata.is_dir() {
            return Err(fail(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
        }
        let size = if metadata.is_file() { Some(metadata.len()) } else { None };
        NpyArray::from_reader(Box::new(BufReader::new(file)), size, path)
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

    fn from_reader(mut reader: Box<dyn Read + 'a>, size: Option<u64>, path: &Path) -> Result<Self, ReadError> {
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
        Ok(Self { path: path.to_owned(), header, reader })
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

    /// All items as `f32`, C order; wider types are rounded.
    ///
    /// # Errors
    /// When the data cannot be read.
    pub fn read_f32(self) -> Result<Vec<f32>, ReadError> {
        self.read_f32_rows(usize::MAX)
    }

    /// The items of the first `rows` entries of the first axis as `f32`, C order. What follows is not read, unless the
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
        let codes = Self { path: self.path, header, reader: self.reader }.read_with(usize::MAX, |b| {
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
        Err(ReadError::malformed(&self.path, Place::File, "an array of bool, i1-i8, u1-u8, f4 or f8", found))
    }

    fn read_with<T: Copy>(mut self, rows: usize, decode: impl Fn(&[u8]) -> T) -> Result<Vec<T>, ReadError> {
        let header = &self.header;
        if header.length == 0 {
            return Ok(Vec::new()); // the product of the other axes need not fit in memory
        }
        let row: usize = header.shape.iter().skip(1).product();
        let kept = row * rows.min(header.shape.first().copied().unwrap_or(1));
        let wanted = if header.fortran { header.length } else { kept };
        // grown as data arrive: an archive's claims about sizes are not trusted
        let mut items = Vec::with_capacity(wanted.min(1 << 20));
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
            Kind::Float if size == 4 => f64::from(f32::from_bits(bits as u32)),
            Kind::Float => f64::from_bits(bits),
        }
    }
}

fn shape_text(shape: &[usize]) -> String {
    if shape.is_empty() {
        return "a single number".to_owned();
    }
    shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ")
}

/// Parses the Python dictionary `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }`.
/// An error is the offset, what was expected and what was found.
fn parse_header(text: &[u8]) -> Result<Header, (usize, &'static str, String)> {
    let mut parser = Python { text, at: 0 };
    let (mut descr, mut fortran, mut shape) = (None, None, None);
    parser.symbol(b'{', "a dictionary { ... }")?;
    while !parser.accept(b'}') {
        let at = parser.at;
        let key = parser.string()?;
        parser.symbol(b':', "a colon after a key")?;
        match key.as_str() {
            "descr" => descr = Some(parser.string()?),
            "fortran_order" => fortran = Some(parser.boolean()?),
            "shape" => shape = Some(parser.tuple()?),
            _ => return Err((at, "the keys 'descr', 'fortran_order', 'shape'", format!("{key:?}"))),
        }
        if !parser.accept(b',') {
            parser.symbol(b'}', "a comma or closing brace")?;
            break;
        }
    }
    let (Some(descr), Some(fortran), Some(shape)) = (descr, fortran, shape) else {
        return Err((0, "the keys 'descr', 'fortran_order', 'shape'", excerpt(text.trim_ascii_end())));
    };
    let unsupported = |descr: &str| (0, "an array of bool, i1-i8, u1-u8, f4 or f8", format!("type '{descr}'"));
    let (big, code) = match descr.split_at_checked(1) {
        Some(("<" | "|", code)) => (false, code),
        Some(("=", code)) => (cfg!(target_endian = "big"), code),
        Some((">", code)) => (true, code),
        _ => return Err(unsupported(&descr)),
    };
    let letters = code.strip_prefix('U').and_then(|n| n.parse().ok()).filter(|n| (1..=MOST_LETTERS).contains(n));
    let (kind, size) = match code {
        "b1" => (Kind::Bool, 1),
        "i1" => (Kind::Signed, 1),
        "i2" => (Kind::Signed, 2),
        "i4" => (Kind::Signed, 4),
        "i8" => (Kind::Signed, 8),
        "u1" => (Kind::Unsigned, 1),
        "u2" => (Kind::Unsigned, 2),
        "u4" => (Kind::Unsigned, 4),
        "u8" => (Kind::Unsigned, 8),
        "f4" => (Kind::Float, 4),
        "f8" => (Kind::Float, 8),
        _ if letters.is_some() => (Kind::Text, 4 * letters.unwrap_or(0)),
        _ => return Err(unsupported(&descr)),
    };
    let length = if shape.contains(&0) { Some(0) } else { shape.iter().try_fold(1usize, |a, &b| a.checked_mul(b)) };
    let Some(length) = length else { return Err((0, "a shape that fits in memory", shape_text(&shape))) };
    Ok(Header { kind, size, big, fortran, shape, length, descr })
}

/// The few Python literals that a header consists of.
struct Python<'a> {
    text: &'a [u8],
    at: usize,
}

type PythonError = (usize, &'static str, String);

impl Python<'_> {
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn fail<T>(&self, expected: &'static str) -> Result<T, PythonError> {
        Err((self.at, expected, excerpt(self.text.get(self.at..).unwrap_or_default().trim_ascii_end())))
    }

    fn accept(&mut self, symbol: u8) -> bool {
        let found = self.peek() == Some(symbol);
        self.at += usize::from(found);
        found
    }

    fn symbol(&mut self, symbol: u8, expected: &'static str) -> Result<(), PythonError> {
        if self.accept(symbol) { Ok(()) } else { self.fail(expected) }
    }

    fn string(&mut self) -> Result<String, PythonError> {
        let expected = "a string in quotes";
        let Some(quote @ (b'\'' | b'"')) = self.peek() else { return self.fail(expected) };
        let rest = &self.text[self.at + 1..];
        let Some(length) = rest.iter().position(|&b| b == quote) else { return self.fail(expected) };
        self.at += length + 2;
        Ok(String::from_utf8_lossy(&rest[..length]).into_owned())
    }

    fn boolean(&mut self) -> Result<bool, PythonError> {
        self.peek();
        for (word, value) in [("True", true), ("False", false)] {
            if self.text[self.at..].starts_with(word.as_bytes()) {
                self.at += word.len();
                return Ok(value);
            }
        }
        self.fail("True or False")
    }

    fn tuple(&mut self) -> Result<Vec<usize>, PythonError> {
        self.symbol(b'(', "a tuple of lengths")?;
        let mut lengths = Vec::new();
        while !self.accept(b')') {
            self.peek();
            let digits = self.text[self.at..].iter().take_while(|b| b.is_ascii_digit()).count();
            let number = std::str::from_utf8(&self.text[self.at..self.at + digits]).ok().and_then(|d| d.parse().ok());
            let Some(number) = number else { return self.fail("a length") };
            self.at += digits;
            self.accept(b'L'); // written by Python 2
            lengths.push(number);
            if !self.accept(b',') {
                self.symbol(b')', "a comma or closing parenthesis")?;
                break;
            }
        }
        if lengths.len() > 32 {
            return self.fail("at most 32 axes");
        }
        Ok(lengths)
    }
}

/// Reads an N x 3 array as points.
///
/// # Errors
/// When the file cannot be read, has another shape, or a coordinate is not finite.
pub fn read_npy_points(path: &Path) -> Result<Vec<Vec3>, ReadError> {
    points(NpyArray::open(path)?)
}

fn points(array: NpyArray<'_>) -> Result<Vec<Vec3>, ReadError> {
    array.expect_shape(&[None, Some(3)])?;
    let path = array.path.clone();
    let values = array.read_f64()?;
    if let Some(i) = values.iter().position(|v| !v.is_finite()) {
        let expected = format!("finite coordinates of point {}", i / 3);
        return Err(ReadError::malformed(&path, Place::File, expected, values[i].to_string()));
    }
    Ok(values.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])).collect())
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

/// An NPZ archive: named arrays.
pub struct Npz<R: Read + Seek = BufReader<File>> {
    path: PathBuf,
    archive: npyz::npz::NpzArchive<R>,
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
        let file = File::open(path).map_err(|source| ReadError::io(path, source))?;
        Self::from_reader(BufReader::new(file), path)
    }
}

impl<R: Read + Seek> Npz<R> {
    /// Opens an archive that is read from `reader`; `path` is only named in errors.
    ///
    /// # Errors
    /// As [`Npz::open`].
    pub fn from_reader(reader: R, path: &Path) -> Result<Self, ReadError> {
        match npyz::npz::NpzArchive::new(reader) {
            Ok(archive) => Ok(Self { path: path.to_owned(), archive }),
            Err(e) => Err(ReadError::malformed(path, Place::File, "an NPZ (zip) archive", e.to_string())),
        }
    }

    /// Names of the arrays, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = self.archive.array_names().map(str::to_owned).collect();
        names.sort_unstable();
        names
    }

    /// The array called `name`.
    ///
    /// # Errors
    /// When there is none (the message lists those there are), or as [`NpyArray::open`].
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
        match self.archive.zip_archive().by_name(&npyz::npz::file_name_from_array_name(name)) {
            Ok(entry) => {
                let size = entry.size();
                NpyArray::from_reader(Box::new(entry), Some(size), &inside)
            }
            Err(e) => Err(ReadError::malformed(&inside, Place::File, "a readable archive entry", e.to_string())),
        }
    }

    /// The N x 3 array called `name` as points.
    ///
    /// # Errors
    /// As [`Npz::array`] and [`read_npy_points`].
    pub fn points(&mut self, name: &str) -> Result<Vec<Vec3>, ReadError> {
        points(self.array(name)?)
    }
}

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
pub(super) fn npy_start(descr: &str, shape: &[usize]) -> Vec<u8> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn header(text: &str) -> Result<Header, PythonError> {
        parse_header(text.as_bytes())
    }

    #[test]
    fn headers_of_all_shapes() {
        let h = header("{'descr': '<f4', 'fortran_order': False, 'shape': (6706, 3), }   \n").unwrap();
        assert_eq!((h.shape.as_slice(), h.length, h.size), ([6706, 3].as_slice(), 20118, 4));
        assert_eq!(header("{\"shape\":(),'descr':'>i8','fortran_order':True}").unwrap().length, 1);
        assert_eq!(header("{'descr': '|b1', 'fortran_order': False, 'shape': (5L,)}").unwrap().shape, [5]);
        for bad in ["", "{", "{'descr': '<f4'}", "{'descr': 'O', 'fortran_order': False, 'shape': (1,)}", "[[[[[["] {
            assert!(header(bad).is_err(), "{bad}");
        }
        let huge = "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 99999999999), }";
        assert!(header(huge).is_err());
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
