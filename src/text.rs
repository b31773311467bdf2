//! Text that came from a file, where it goes into another file or onto a terminal: names of materials, groups, shapes, landmarks,
//! regions, files. What could be taken for more than text there is written so that it is not; ordinary names (spaces, umlauts,
//! CJK) stay as they are.
//!
//! | where | what | how |
//! |---|---|---|
//! | terminals, pictures of text | control characters, marks of direction | shown as `\u{1b}` ([`visible`], [`lines`]) |
//! | messages | long names and messages | cut with `...` ([`short`], [`message`]) |
//! | OBJ | line breaks, other control characters, `\` at the end, which continues a line | percent-encoded ([`obj_line`]) |
//! | CSV | separators, quotation marks, line breaks | quotation marks round it, RFC 4180 ([`csv_field`]) |
//! | | `=`, `+`, `-`, `@`, tab first, which tables take for formulas; numbers stay numbers | a `'` before it |
//! | | other control characters | shown as `\u{1b}` |
//! | HTML, SVG, XML | `&`, `<`, `>`, quotation marks; control characters | entities; shown as `\u{1b}` ([`html`]) |
//! | JSON | quotation marks, control characters | escaped by the writer; marks of direction too ([`json`]) |
//!
//! NPY, NPZ and glTF hold names as they are: nothing there is found by its letters.

use std::borrow::Cow;
use std::cmp::Ordering;

/// Letters of a name of a shape, landmark or region at most; readers refuse longer ones.
pub const LONGEST_NAME: usize = 1000;

/// Letters of a name in a message or table.
const SHORT: usize = 80;
/// Letters of a whole message.
const MESSAGE: usize = 3000;

/// The known name that differs from `name` in the fewest letters; the first of equals.
pub fn most_similar<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known.into_iter().min_by_key(|k| edit_distance(k, name))
}

/// The order of names in which numbers count by their value: `f2` before `f10`.
pub fn natural(a: &str, b: &str) -> Ordering {
    let parts = |text: &str| -> Vec<(bool, usize, String)> {
        let chunks = text.as_bytes().chunk_by(|x, y| x.is_ascii_digit() == y.is_ascii_digit());
        let part = |chunk: &[u8]| {
            let is_number = chunk[0].is_ascii_digit();
            let text = String::from_utf8_lossy(chunk).into_owned();
            let text = if is_number { text.trim_start_matches('0').to_owned() } else { text };
            // a longer number is a larger one
            (!is_number, if is_number { text.len() } else { 0 }, text)
        };
        chunks.map(part).collect()
    };
    parts(a).cmp(&parts(b)).then_with(|| a.cmp(b))
}

/// Levenshtein's distance, letters compared without case.
fn edit_distance(a: &str, b: &str) -> usize {
    let [a, b] = [a, b].map(|s| s.to_lowercase().chars().collect::<Vec<char>>());
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

/// Whether a character is not to be seen, or moves what is: control characters, line separators, marks of direction.
#[must_use]
pub fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
        || matches!(c, '\u{feff}' | '\u{fff9}'..='\u{fffb}')
}

fn replaced(text: &str, is_bad: impl Fn(char) -> bool, write: impl Fn(char, &mut String)) -> Cow<'_, str> {
    if !text.contains(&is_bad) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 8);
    text.chars().for_each(|c| if is_bad(c) { write(c, &mut out) } else { out.push(c) });
    Cow::Owned(out)
}

/// `\n`, `\t`, or the number of the character.
fn show(c: char, out: &mut String) {
    match c {
        '\n' | '\r' | '\t' => out.extend(c.escape_default()),
        _ => out.extend(c.escape_unicode()),
    }
}

/// One line: hidden characters shown by their number.
#[must_use]
pub fn visible(text: &str) -> Cow<'_, str> {
    replaced(text, is_hidden, show)
}

/// Several lines: [`visible`], but for line feeds and tabs.
#[must_use]
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| is_hidden(c) && c != '\n' && c != '\t', show)
}

fn cut(text: Cow<'_, str>, most: usize) -> Cow<'_, str> {
    match text.char_indices().nth(most) {
        None => text,
        Some((end, _)) => Cow::Owned(format!("{}...", &text[..end])),
    }
}

/// A name in a message or table: visible, and cut if it is very long.
#[must_use]
pub fn short(name: &str) -> Cow<'_, str> {
    match name.char_indices().nth(SHORT) {
        None => visible(name),
        Some((end, _)) => Cow::Owned(format!("{}...", visible(&name[..end]))),
    }
}

/// A message: [`lines`], of which those after the first are indented, so that none passes for a message of its own; cut if it
/// is very long.
#[must_use]
pub fn message(text: &str) -> String {
    cut(lines(text), MESSAGE).trim_end().replace('\n', "\n  ")
}

/// The rest of a line of an OBJ file.
#[must_use]
pub fn obj_line(text: &str) -> Cow<'_, str> {
    let encode = |c: char, out: &mut String| {
        c.encode_utf8(&mut [0; 4]).bytes().for_each(|b| *out += &format!("%{b:02X}"));
    };
    let line = replaced(text, |c| c.is_control() || matches!(c, '\u{2028}' | '\u{2029}'), encode);
    match line.strip_suffix('\\') {
        Some(start) => Cow::Owned(format!("{start}%5C")),
        None => line,
    }
}

/// What programs for tables take for the beginning of a formula.
fn begins_formula(text: &str) -> bool {
    text.starts_with(['=', '+', '-', '@', '\t', '\r', '\u{ff1d}', '\u{ff0b}', '\u{ff0d}', '\u{ff20}'])
}

/// Text as one field of a CSV line.
#[must_use]
pub fn csv_field(text: &str) -> String {
    let shown = replaced(text, |c| c.is_control() && !matches!(c, '\n' | '\r' | '\t'), show);
    let guard = if begins_formula(shown.trim_start_matches('\'')) && shown.parse::<f64>().is_err() { "'" } else { "" };
    if shown.contains([',', ';', '"', '\n', '\r', '\t']) {
        format!("\"{guard}{}\"", shown.replace('"', "\"\""))
    } else {
        format!("{guard}{shown}")
    }
}

/// What [`csv_field`] was given, of a field without its quotation marks.
#[must_use]
pub fn from_csv_field(field: &str) -> &str {
    field.strip_prefix('\'').filter(|rest| begins_formula(rest.trim_start_matches('\''))).unwrap_or(field)
}

/// Text in HTML, SVG or XML, in attributes too.
#[must_use]
pub fn html(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\n' | '\t' => out.push(c),
            c if is_hidden(c) => show(c, &mut out),
            c => out.push(c),
        }
    }
    out
}

/// JSON whose strings have no hidden characters: the writer escapes the first 32, this the others.
#[must_use]
pub fn json(written: String) -> String {
    let escape = |c: char, out: &mut String| *out += &format!("\\u{:04x}", u32::from(c));
    match replaced(&written, |c| is_hidden(c) && c > ' ', escape) {
        Cow::Owned(escaped) => escaped,
        Cow::Borrowed(_) => written,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ORDINARY: [&str; 7] = ["", "face", "left eye", "Größe (mm)", "上唇", "a_b-c.d/e", "50 %"];
    const HOSTILE: [&str; 9] = [
        "a\nv 1 2 3",
        "a\r\nv 1 2 3",
        "\u{1b}[31mred\u{1b}]0;title\u{7}",
        "\u{9b}31m",
        "gpj\u{202e}.obj",
        "a\u{2028}b",
        "a\\",
        "nul\0",
        "\u{7f}",
    ];

    #[test]
    fn numbers_in_names_count_by_their_value() {
        let mut names = ["f10", "g", "f2", "f1", "f", "f02b", "f2b", "10", "9", "Äf", "f1a10", "f1a9"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["9", "10", "f", "f1", "f1a9", "f1a10", "f2", "f02b", "f2b", "f10", "g", "Äf"]);
    }

    #[test]
    fn ordinary_names_stay() {
        for name in ORDINARY {
            assert_eq!([visible(name), lines(name), short(name), obj_line(name)], [name; 4]);
            assert_eq!((csv_field(name), html(name)), (name.to_owned(), name.to_owned()));
        }
        assert_eq!(json("\"ä上\"\n".to_owned()), "\"ä上\"\n");
    }

    #[test]
    fn nothing_hidden_is_left() {
        for name in HOSTILE {
            for shown in [visible(name), short(name), csv_field(name).into(), obj_line(name)] {
                let left = shown.chars().find(|c| c.is_control() && !matches!(c, '\n' | '\r'));
                assert_eq!(left, None, "{name:?}");
            }
            assert!(!visible(name).contains(is_hidden) && !html(name).contains(|c| is_hidden(c) && c != '\n'));
            assert!(!obj_line(name).contains(['\n', '\r', '\u{2028}']) && !obj_line(name).ends_with('\\'), "{name:?}");
            let written = json(serde_json::to_string(name).unwrap());
            assert!(!written.contains(is_hidden), "{written:?}");
            assert_eq!(serde_json::from_str::<String>(&written).unwrap(), name);
        }
        assert_eq!(obj_line("a\nv 1 2 3"), "a%0Av 1 2 3");
        assert_eq!(visible("\u{1b}[1m\n"), "\\u{1b}[1m\\n");
    }

    #[test]
    fn messages_keep_to_their_lines_and_length() {
        assert_eq!(message("a\nerror: b\n"), "a\n  error: b");
        let long = "x".repeat(5000);
        assert_eq!(short(&long).len(), SHORT + 3);
        assert_eq!(message(&long).len(), MESSAGE + 3);
    }

    /// RFC 4180, by another reader; formulas are none, and come back as they were.
    #[test]
    fn fields_are_fields_and_no_formulas() {
        let formulas =
            ["=cmd()", "+a", "-a", "@a", "\tx", "'=a", "''=a", "'a", "-1", "+1e5", "-", "=1+1,\"b\"", "\u{ff1d}a"];
        for text in formulas.into_iter().chain(ORDINARY).chain(["a,b", "a\"b", "a\nb", "a;b"]) {
            let line = format!("{},x\n", csv_field(text));
            let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
            let record = reader.records().next().unwrap().unwrap();
            assert_eq!(record.len(), 2, "{text:?}");
            assert_eq!(from_csv_field(&record[0]), text);
            assert!(!begins_formula(&record[0]) || text.parse::<f64>().is_ok(), "{text:?}");
        }
        assert_eq!(["-1", "-1.5e-3"].map(csv_field), ["-1", "-1.5e-3"]);
    }
}
