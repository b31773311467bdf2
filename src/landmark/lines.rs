//! Lines of a text file, their fields and numbers, and errors that name the line.

use std::path::Path;

use super::{Place, ReadError};
use crate::io::excerpt;
use crate::mesh::Vec3;

/// Lines that hold something, trimmed.
pub(super) struct Lines<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    path: &'a Path,
}

/// One of them.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    pub(super) text: &'a str,
    number: usize,
    path: &'a Path,
}

impl<'a> Lines<'a> {
    pub(super) fn new(text: &'a str, path: &'a Path) -> Self {
        Self { lines: text.lines().enumerate(), path }
    }

    /// The next line, which has to be there.
    pub(super) fn expect(&mut self, what: &str) -> Result<Line<'a>, ReadError> {
        self.next().ok_or_else(|| ReadError::malformed(self.path, Place::File, what, "the end of the file"))
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        let path = self.path;
        let filled = |(i, text): (usize, &'a str)| Line { text: text.trim(), number: i + 1, path };
        self.lines.by_ref().map(filled).find(|line| !line.text.is_empty())
    }
}

impl Line<'_> {
    pub(super) fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError::malformed(self.path, Place::Line(self.number), expected, found)
    }

    /// The line is not `expected`.
    pub(super) fn wrong(&self, expected: impl Into<String>) -> ReadError {
        self.error(expected, excerpt(self.text.as_bytes()))
    }

    /// No fields past the last column, unless they are empty.
    pub(super) fn check_width(&self, fields: &[String], columns: usize) -> Result<(), ReadError> {
        let filled = fields.len() - fields.iter().rev().take_while(|f| f.is_empty()).count();
        if filled <= columns {
            return Ok(());
        }
        let expected = format!("at most {columns} fields, with points in decimals, not commas");
        Err(self.error(expected, format!("{filled} fields")))
    }

    /// Three finite coordinates.
    pub(super) fn point(&self, fields: &[impl AsRef<str>]) -> Result<Vec3, ReadError> {
        if fields.len() != 3 {
            return Err(self.error("three coordinates", fields.len().to_string()));
        }
        let mut point = Vec3::zeros();
        for (coordinate, field) in point.iter_mut().zip(fields) {
            let field = field.as_ref();
            *coordinate = match field.parse::<f64>() {
                Ok(value) if value.is_finite() => value,
                Ok(_) => return Err(self.error("a finite coordinate", excerpt(field.as_bytes()))),
                Err(_) => return Err(self.error("a coordinate", excerpt(field.as_bytes()))),
            };
        }
        Ok(point)
    }
}

/// The fields of a line with commas, trimmed. Between quotation marks a comma is text, and two marks are one.
pub(super) fn split_quoted(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    let mut marks = line.chars().peekable();
    while let Some(c) = marks.next() {
        match c {
            '"' if quoted && marks.next_if_eq(&'"').is_some() => {
                fields.last_mut().into_iter().for_each(|f| f.push('"'))
            }
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            c => fields.last_mut().into_iter().for_each(|f| f.push(c)),
        }
    }
    fields.iter().map(|f| f.trim().to_owned()).collect()
}
