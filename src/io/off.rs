//! OFF, Geomview's object file format, ascii: polygons, and normals (`N`) and colours (`C`) of vertices. Source:
//! <http://www.geomview.org/docs/html/OFF.html>.
//!
//! Colours and texture coordinates of faces and vertices past those are skipped. No unit is stated.

use std::path::Path;

use super::error::{excerpt, without_mark};
use super::{MeshFile, Place, ReadError};
use crate::mesh::Vec3;

/// Bytes that a vertex `0 0 0` and a face `3 0 1 2` take at least, with the end of the line before.
const SHORTEST: [usize; 2] = [6, 8];

/// Parses the bytes of an OFF file; `path` is only named in errors.
///
/// # Errors
/// When the file is malformed: the message names the line. Counts that the file is too short for are refused before anything
/// is allocated.
pub fn parse_off(bytes: &[u8], path: &Path) -> Result<MeshFile, ReadError> {
    let mut lines = Lines { lines: without_mark(bytes).split(|&b| b == b'\n'), path, number: 0, words: Vec::new() };
    lines.advance("OFF")?;
    let keyword = String::from_utf8_lossy(lines.words.first().copied().unwrap_or_default()).into_owned();
    let kind = keyword.strip_suffix("OFF").map(|k| k.strip_prefix("ST").unwrap_or(k));
    let (colours, normals) = match kind {
        Some("") => (false, false),
        Some("C") => (true, false),
        Some("N") => (false, true),
        Some("CN") => (true, true),
        _ => return Err(lines.error("OFF, COFF, NOFF or CNOFF", excerpt(keyword.as_bytes()))),
    };
    lines.words.remove(0);
    if lines.words.is_empty() {
        lines.advance("numbers of vertices, faces and edges")?;
    }
    let mut counts = [0_usize; 2];
    for (i, (count, shortest)) in counts.iter_mut().zip(SHORTEST).enumerate() {
        let what = ["vertices", "faces"][i];
        *count = lines.whole(i, &format!("the number of {what}"))?;
        if count.saturating_mul(shortest) > bytes.len() {
            return Err(lines.error(format!("{count} {what}"), format!("a file of {} bytes", bytes.len())));
        }
    }
    let [vertices, faces] = counts;
    if vertices == 0 {
        return Err(lines.error("vertices", "none"));
    }

    let mut file = MeshFile::default();
    let mut all_normals = Vec::new();
    let mut all_colours = Vec::new();
    for v in 0..vertices {
        lines.advance(&format!("vertex {v} of {vertices}"))?;
        file.mesh.positions.push(lines.vector(0)?);
        if normals {
            all_normals.push(lines.vector(3)?);
        }
        if colours {
            all_colours.push(lines.colour(if normals { 6 } else { 3 })?);
        }
    }
    file.mesh.starts.push(0);
    for f in 0..faces {
        lines.advance(&format!("face {f} of {faces}"))?;
        let corners = lines.whole(0, "a number of corners")?;
        if corners < 3 || corners >= lines.words.len() {
            let expected = format!("at least 3 corners, as many as the line has ({})", lines.words.len() - 1);
            return Err(lines.error(expected, corners.to_string()));
        }
        for c in 1..=corners {
            let index = lines.whole(c, "a vertex index")?;
            if index >= vertices {
                return Err(lines.error(format!("a vertex index from 0 to {}", vertices - 1), index.to_string()));
            }
            file.mesh.corners.push(index as u32);
        }
        file.mesh.starts.push(file.mesh.corners.len() as u32);
    }
    file.normals = normals.then_some(all_normals);
    file.colors = colours.then_some(all_colours);
    Ok(file)
}

struct Lines<'a, I> {
    lines: I,
    path: &'a Path,
    number: usize,
    /// Of the line.
    words: Vec<&'a [u8]>,
}

impl<'a, I: Iterator<Item = &'a [u8]>> Lines<'a, I> {
    /// Goes to the next line that holds something but a comment.
    fn advance(&mut self, what: &str) -> Result<(), ReadError> {
        loop {
            self.number += 1;
            let Some(line) = self.lines.next() else { return Err(self.error(what, "the end of the file")) };
            let line = line.split(|&b| b == b'#').next().unwrap_or_default();
            self.words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
            if !self.words.is_empty() {
                return Ok(());
            }
        }
    }

    fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError::malformed(self.path, Place::Line(self.number), expected, found)
    }

    fn word(&self, i: usize) -> &'a [u8] {
        self.words.get(i).copied().unwrap_or_default()
    }

    fn whole(&self, i: usize, what: &str) -> Result<usize, ReadError> {
        let parsed = std::str::from_utf8(self.word(i)).ok().and_then(|w| w.parse::<usize>().ok());
        parsed.ok_or_else(|| self.error(what, excerpt(self.word(i))))
    }

    fn number(&self, i: usize) -> Result<f64, ReadError> {
        let parsed = std::str::from_utf8(self.word(i)).ok().and_then(|w| w.parse::<f64>().ok());
        parsed.filter(|x| x.is_finite()).ok_or_else(|| self.error("a finite number", excerpt(self.word(i))))
    }

    fn vector(&self, first: usize) -> Result<Vec3, ReadError> {
        Ok(Vec3::new(self.number(first)?, self.number(first + 1)?, self.number(first + 2)?))
    }

    /// Red, green, blue: 0 to 1 where one is written with a point, else 0 to 255.
    fn colour(&self, first: usize) -> Result<[u8; 3], ReadError> {
        let whole = (first..first + 3).all(|i| !self.word(i).contains(&b'.'));
        let scale = if whole { 1.0 } else { 255.0 };
        let channels = self.vector(first)?;
        Ok(channels.map(|c| (c * scale).round().clamp(0.0, 255.0) as u8).into())
    }
}
