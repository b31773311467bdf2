//! What can go wrong with a file: which file, where in it, what was expected, what was found.

use std::fmt;
use std::path::{Path, PathBuf};

/// Where in a file something was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    File,
    /// A line, counted from 1.
    Line(usize),
    /// A byte, counted from 0.
    Byte(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File => Ok(()),
            Self::Line(line) => write!(f, ": line {line}"),
            Self::Byte(byte) => write!(f, ": byte {byte}"),
        }
    }
}

/// A file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The operating system refused: the file is missing, a folder, not readable.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// No reader for this kind of file.
    #[error("{}: unknown file extension {found:?}; supported are {supported}", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// Its extension, empty if it has none.
        found: String,
        /// What can be read.
        supported: &'static str,
    },
    /// The content is not what the format, or the caller, asks for.
    #[error("{}{place}: expected {expected}, found {found}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line or byte.
        place: Place,
        /// What should have been there.
        expected: String,
        /// What was there.
        found: String,
    },
}

impl ReadError {
    /// The file that could not be read.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. } | Self::UnknownExtension { path, .. } | Self::Malformed { path, .. } => path,
        }
    }

    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// A JSON text that is none, or not the expected one; without the parser's own words for where and what it wanted.
    pub(crate) fn json(path: &Path, place: Place, expected: &str, error: &serde_json::Error) -> Self {
        use serde_json::error::Category;
        let found = match error.classify() {
            Category::Eof => "its end".to_owned(),
            Category::Syntax => format!("other text in column {}", error.column()),
            _ => error.to_string().split(" at line ").next().unwrap_or_default().to_owned(),
        };
        Self::malformed(path, place, expected, found)
    }

    /// The same, with what names the file.
    pub(super) fn named_by(self, by: &str) -> Self {
        match self {
            Self::Io { path, source } => {
                Self::Io { path, source: std::io::Error::new(source.kind(), format!("{source} ({by})")) }
            }
            Self::Malformed { path, place, expected, found } => {
                Self::Malformed { path, place, expected: format!("{expected} ({by})"), found }
            }
            other => other,
        }
    }

    /// A content error, for readers of other formats that stand on this floor. What a file says at great length is cut.
    #[must_use]
    pub fn malformed(path: &Path, place: Place, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), place, expected: cut(expected.into()), found: cut(found.into()) }
    }
}

/// A file could not be written; nothing was left behind and an older file of that name is untouched.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system refused: no such folder, no space, not permitted.
    #[error("{}: cannot be written: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// No writer for this kind of file.
    #[error("{}: unknown file extension {found:?}; supported are {supported}", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// Its extension, empty if it has none.
        found: String,
        /// What can be written.
        supported: &'static str,
    },
    /// The data do not fit the format, or each other.
    #[error("{}: cannot be written: expected {expected}, found {found}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// What the format needs.
        expected: String,
        /// What was given.
        found: String,
    },
}

impl WriteError {
    /// Data that do not fit, for writers of other formats that stand on this floor. What they say at great length is cut.
    #[must_use]
    pub fn data(path: &Path, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Data { path: path.to_owned(), expected: cut(expected.into()), found: cut(found.into()) }
    }

    /// The same of a file that was made in folder `aside` to be one of `folder`.
    pub(super) fn moved(mut self, aside: &Path, folder: &Path) -> Self {
        let (Self::Io { path, .. } | Self::UnknownExtension { path, .. } | Self::Data { path, .. }) = &mut self;
        if let Ok(name) = path.strip_prefix(aside) {
            *path = if name.as_os_str().is_empty() { folder.to_owned() } else { folder.join(name) };
        }
        self
    }

    /// Refuses `what` unless there is none, or one for each vertex.
    pub(super) fn check_count(path: &Path, what: &str, found: Option<usize>, vertices: usize) -> Result<(), Self> {
        match found.filter(|&f| f != vertices) {
            None => Ok(()),
            Some(found) => Err(Self::data(path, format!("{what} for each of {vertices} vertices"), found.to_string())),
        }
    }
}

/// At most so many characters of what a message says of a file.
const LONGEST: usize = 800;

fn cut(text: String) -> String {
    match text.char_indices().nth(LONGEST) {
        None => text,
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

/// Text of a file for a message: quoted, cut after 40 characters.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(160)]);
    if bytes.is_empty() {
        return "nothing".to_owned();
    }
    let cut: String = text.chars().take(40).collect();
    if cut.len() < text.len() || bytes.len() > 160 { format!("{:?}...", cut) } else { format!("{cut:?}") }
}

/// Refuses what is no regular file, for files that another file or a folder names: to open a pipe waits for who writes it, and a
/// device has no end.
pub(crate) fn check_side_file(path: &Path) -> Result<(), ReadError> {
    let metadata = std::fs::metadata(path).map_err(|source| ReadError::io(path, source))?;
    if metadata.is_file() {
        return Ok(());
    }
    let found = if metadata.is_dir() { "a folder" } else { "a pipe or device" };
    Err(ReadError::malformed(path, Place::File, "a regular file", found))
}

/// The bytes of a file that another file or a folder names, or that a program marks its folders with.
///
/// # Errors
/// When it cannot be read, or is no regular file, such as a pipe: nobody may ever write to it.
pub fn read_side_file(path: &Path) -> Result<Vec<u8>, ReadError> {
    check_side_file(path).and_then(|()| read_file(path))
}

/// Reads a whole file, naming it in the error.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, ReadError> {
    super::inputs::read(path).map_err(|source| ReadError::io(path, source))
}

/// Reads a whole file of text.
///
/// # Errors
/// When it cannot be read, or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    let bytes = read_file(path)?;
    let text = std::str::from_utf8(without_mark(&bytes));
    text.map(str::to_owned).map_err(|e| ReadError::io(path, std::io::Error::new(std::io::ErrorKind::InvalidData, e)))
}

/// Text without the byte order mark that some editors begin it with.
pub(crate) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The extension in lower case, empty if there is none.
pub(crate) fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}
