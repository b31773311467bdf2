//! How much a file may come to in memory, by its length.
//!
//! An accessor has at most the numbers that the bytes of its view are, but any number of nodes, primitives and morph targets
//! can name the same one; a target without an accessor, or whose accessor has no view, has none of its own at all; and parts
//! with targets of other names are still for a stretch of every target of the scene. So a short file could ask for any amount.

use std::cell::Cell;

use serde_json::Value;

use super::document::Loaded;
use crate::io::ReadError;

/// Numbers for each byte of a file. Four bytes are a number mostly: this is every vertex used by a hundred primitives, or 400
/// morph targets of which none moves anything.
const MOST_PER_BYTE: usize = 32;
/// Numbers that any file may have, however short: 8 MB.
const ALWAYS: usize = 1 << 20;
/// Numbers beyond one for each byte, however long the file: 1 GB.
const MOST_BEYOND: usize = 1 << 27;

/// What is left for a file: numbers, or letters of names.
pub(super) struct Budget<'a> {
    file: &'a Loaded<'a>,
    most: usize,
    left: Cell<usize>,
}

impl<'a> Budget<'a> {
    pub fn new(file: &'a Loaded<'a>) -> Self {
        let bytes = file.length();
        let most = bytes + bytes.saturating_mul(MOST_PER_BYTE - 1).clamp(ALWAYS, MOST_BEYOND);
        Self { file, most, left: Cell::new(most) }
    }

    /// Counts numbers, before there is memory for them.
    pub fn spend(&self, numbers: usize, what: &str) -> Result<(), ReadError> {
        match self.left.get().checked_sub(numbers) {
            Some(left) => {
                self.left.set(left);
                Ok(())
            }
            None => {
                let bytes = self.file.length();
                let expected = format!("at most {} numbers from {bytes} bytes, each use counted", self.most);
                self.file.malformed(expected, format!("{numbers} more for {what}"))
            }
        }
    }
}

/// Entries and letters of a JSON value.
pub(super) fn weight(value: &Value) -> usize {
    match value {
        Value::String(text) => 1 + text.len(),
        Value::Array(items) => items.iter().map(weight).sum::<usize>() + 1,
        Value::Object(entries) => entries.iter().map(|(key, value)| key.len() + weight(value)).sum::<usize>() + 1,
        _ => 1,
    }
}
