//! The header of an NPY file: a Python dictionary with type, order and shape.
//!
//! Our own parser rather than `npyz`'s, whose product of the dimensions overflows on absurd shapes and whose header is
//! allocated and parsed recursively at whatever size the file claims.

use crate::io::error::excerpt;

/// Length of a text at most.
const MOST_LETTERS: usize = 4096;

/// Type of the items of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    Signed,
    Unsigned,
    Float,
    Text,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub kind: Kind,
    pub size: usize,
    pub big: bool,
    pub fortran: bool,
    pub shape: Vec<usize>,
    pub length: usize,
    pub descr: String,
}

/// Parses the Python dictionary `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }`.
/// An error is the offset, what was expected and what was found.
pub(super) fn parse_header(text: &[u8]) -> Result<Header, PythonError> {
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
    let unsupported = |descr: &str| (0, "an array of bool, i1-i8, u1-u8, f2, f4 or f8", format!("type '{descr}'"));
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
        "f2" => (Kind::Float, 2),
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

pub(super) type PythonError = (usize, &'static str, String);

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

pub(super) fn shape_text(shape: &[usize]) -> String {
    if shape.is_empty() {
        return "a single number".to_owned();
    }
    shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ")
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
}
