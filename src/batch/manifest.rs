//! The list of what is to be done: a CSV file with a row for each scan.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use crate::io::{Place, ReadError, unpacked_name};
use crate::text::is_hidden;

/// Which columns a manifest may have besides `name` and `sequence`: options of the command that each row runs.
#[derive(Debug, Clone, Default)]
pub struct Columns {
    /// Names of options, without dashes.
    pub options: Vec<String>,
    /// Those of them that are paths: relative to the manifest's folder.
    pub paths: Vec<String>,
    /// The one that every row must have: the scan.
    pub required: String,
}

/// A scan to be registered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// Its line in the manifest, from 1.
    pub line: usize,
    /// Name of its outputs, unique.
    pub name: String,
    /// The sequence whose next frame it is.
    pub sequence: Option<String>,
    /// Option and value, by the order of the columns; empty cells are left out. Paths need not be Unicode: that of the manifest's
    /// folder may be anything.
    pub options: Vec<(String, OsString)>,
}

/// Rows of a CSV file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Manifest {
    /// In the file's order.
    pub rows: Vec<Row>,
}

impl Manifest {
    /// Reads a manifest: comma, semicolon or tab between cells, a line of column names first, lines that start with `#` or have empty
    /// cells alone skipped.
    ///
    /// A row without `name` has that of its scan's file, or, where several files have one name, of folder and file.
    ///
    /// # Errors
    /// When the file cannot be read, has no rows, an unknown column, a column twice or none for the scan; when a row has too many
    /// or too few cells or no scan, or a name is none for a file or comes twice. The message has the line.
    pub fn read(path: &Path, columns: &Columns) -> Result<Self, ReadError> {
        let text = std::fs::read_to_string(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
        Self::parse(&text, path, columns)
    }

    /// Parses a manifest's text; its paths are relative to the folder of `path`.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(text: &str, path: &Path, columns: &Columns) -> Result<Self, ReadError> {
        let (skipped, text) = without_blank_start(text.trim_start_matches('\u{feff}'));
        let wrong = |line: usize, expected: &str, found: String| {
            ReadError::malformed(path, if line == 0 { Place::File } else { Place::Line(line) }, expected, found)
        };
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(delimiter(text))
            .comment(Some(b'#'))
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(text.as_bytes());
        let first = skipped + 1;
        let header = reader.headers().map_err(|e| wrong(first, "column names", e.to_string()))?.clone();
        let known = |name: &str| ["name", "sequence"].contains(&name) || columns.options.iter().any(|o| o == name);
        for (k, name) in header.iter().enumerate() {
            if !known(name) {
                let expected = format!("columns name, sequence and {}", columns.options.join(", "));
                return Err(wrong(first, &expected, format!("{name:?}")));
            }
            if header.iter().take(k).any(|other| other == name) {
                return Err(wrong(first, "every column once", format!("{name:?} twice")));
            }
        }
        if !header.iter().any(|name| name == columns.required) {
            let expected = format!("a column {:?}", columns.required);
            let found = header.iter().collect::<Vec<_>>().join(", ");
            let found = if found.is_empty() { "nothing".to_owned() } else { format!("only {found}") };
            return Err(wrong(first, &expected, found));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut rows: Vec<(Row, Option<String>)> = Vec::new();
        for record in reader.records() {
            let line_at = |position: Option<&csv::Position>| position.map_or(0, |p| skipped + line_of(text, p));
            let record = record.map_err(|e| wrong(line_at(e.position()), "cells", e.to_string()))?;
            // as spreadsheets leave them below a table
            if record.iter().all(str::is_empty) {
                continue;
            }
            let line = line_at(record.position());
            if record.len() != header.len() {
                let expected = format!("{} cells, one for each column", header.len());
                return Err(wrong(line, &expected, record.len().to_string()));
            }
            let mut row = Row { line, name: String::new(), sequence: None, options: Vec::new() };
            let mut name = None;
            for (column, cell) in header.iter().zip(&record).filter(|(_, cell)| !cell.is_empty()) {
                match column {
                    "name" => name = Some(cell.to_owned()),
                    "sequence" => row.sequence = Some(cell.to_owned()),
                    _ if columns.paths.iter().any(|p| p == column) => {
                        row.options.push((column.to_owned(), folder.join(cell).into()));
                    }
                    _ => row.options.push((column.to_owned(), cell.into())),
                }
            }
            if !row.options.iter().any(|(column, _)| *column == columns.required) {
                return Err(wrong(line, &format!("a {}", columns.required), "an empty cell".to_owned()));
            }
            rows.push((row, name));
        }
        if rows.is_empty() {
            return Err(wrong(0, "a row for each scan below the column names", "none".to_owned()));
        }
        let mut manifest = Self { rows: named(rows, &columns.required) };
        manifest.check_names(&wrong)?;
        manifest.rows.shrink_to_fit();
        Ok(manifest)
    }

    fn check_names(&self, wrong: &dyn Fn(usize, &str, String) -> ReadError) -> Result<(), ReadError> {
        let mut lines: HashMap<String, usize> = HashMap::new();
        for row in &self.rows {
            let name = &row.name;
            let bad = |name: &str| {
                name.is_empty() || name.contains(['/', '\\', ':']) || name.contains(is_hidden) || name.starts_with('.')
            };
            let ends = |ending: &str| name.to_lowercase().ends_with(ending);
            if bad(name) || name.eq_ignore_ascii_case("summary") || ends(".timing") || ends(".sequence") {
                let expected =
                    "a name that files can have, not \"summary\" and without \".timing\" or \".sequence\" at its end";
                return Err(wrong(row.line, expected, format!("{name:?}")));
            }
            if let Some(sequence) = row.sequence.as_ref().filter(|sequence| bad(sequence)) {
                return Err(wrong(row.line, "a sequence's name that files can have", format!("{sequence:?}")));
            }
            // some file systems know no case
            if let Some(first) = lines.insert(name.to_lowercase(), row.line) {
                let found = format!("{name:?}, as in line {first} (give a column \"name\")");
                return Err(wrong(row.line, "a name of its own for each row", found));
            }
        }
        Ok(())
    }
}

/// The line of what is read at a position: comments and empty lines may stand before it.
fn line_of(text: &str, position: &csv::Position) -> usize {
    let rest = text.get(position.byte() as usize..).unwrap_or_default();
    position.line() as usize + rest.lines().take_while(|line| line.is_empty() || line.starts_with('#')).count()
}

/// How many lines before that of the column names hold nothing, and what follows them.
fn without_blank_start(text: &str) -> (usize, &str) {
    let is_blank =
        |line: &&str| line.starts_with('#') || line.trim_matches([',', ';', '\t', ' ', '\r', '\n']).is_empty();
    let blank: Vec<&str> = text.split_inclusive('\n').take_while(is_blank).collect();
    (blank.len(), &text[blank.iter().map(|line| line.len()).sum()..])
}

/// The separator that the first line has most of.
fn delimiter(text: &str) -> u8 {
    let first = text.lines().find(|line| !line.starts_with('#')).unwrap_or_default();
    let count = |d: u8| first.bytes().filter(|b| *b == d).count();
    [b'\t', b';', b','].into_iter().max_by_key(|d| count(*d)).unwrap_or(b',')
}

fn named(rows: Vec<(Row, Option<String>)>, scan: &str) -> Vec<Row> {
    let path = |row: &Row| row.options.iter().find(|(column, _)| column == scan).map(|(_, path)| PathBuf::from(path));
    let stem = |row: &Row| {
        let file = path(row).and_then(|p| Some(unpacked_name(&p).file_stem()?.to_string_lossy().into_owned()));
        file.unwrap_or_default()
    };
    let mut count: HashMap<String, usize> = HashMap::new();
    for (row, name) in &rows {
        *count.entry(name.clone().unwrap_or_else(|| stem(row))).or_default() += 1;
    }
    let name_of = |row: &Row| {
        let stem = stem(row);
        let folder = path(row).and_then(|p| p.parent()?.file_name().map(|n| n.to_string_lossy().into_owned()));
        match folder {
            Some(folder) if count.get(&stem).is_some_and(|&n| n > 1) => format!("{folder}_{stem}"),
            _ => stem,
        }
    };
    rows.into_iter().map(|(row, name)| Row { name: name.unwrap_or_else(|| name_of(&row)), ..row }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Manifest, String> {
        let list = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let columns = Columns {
            options: list(&["target", "landmarks", "model"]),
            paths: list(&["target", "landmarks"]),
            required: "target".into(),
        };
        Manifest::parse(text, Path::new("in/list.csv"), &columns).map_err(|e| e.to_string())
    }

    #[test]
    fn rows_are_read_and_named() {
        let text = "target,sequence,model,name\n# the first take\n\na/scan.ply,x,arap,\n\"b, c/scan.ply\",x,,\n/d/e.obj.gz,,,last\n";
        let rows = parse(text).unwrap().rows;
        let names: Vec<&str> = rows.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["a_scan", "b, c_scan", "last"]);
        assert_eq!(rows[0].options, [("target".into(), "in/a/scan.ply".into()), ("model".into(), "arap".into())]);
        assert_eq!((rows[0].line, rows[1].sequence.as_deref(), &rows[2].sequence), (4, Some("x"), &None));
        assert_eq!(rows[2].options[0].1, "/d/e.obj.gz");
        assert_eq!(parse("target;model\nann.001.ply;arap\n").unwrap().rows[0].name, "ann.001");
        let rows = parse("\n#scans\n;;\ntarget;model;name\nann.ply;arap;\n;;\n;\n").unwrap().rows;
        assert_eq!((rows.len(), rows[0].line, &*rows[0].name), (1, 5, "ann"));
        assert_eq!(parse("\u{feff}target\tmodel\na.ply\tarap\n").unwrap().rows[0].options.len(), 2);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, words) in [
            ("", "expected a column \"target\", found nothing"),
            ("\n,\n\nlandmarks\na.json\n", "line 4: expected a column \"target\", found only landmarks"),
            ("\ntarget,model\n\na.ply\n", "line 4: expected 2 cells, one for each column, found 1"),
            ("target\n", "none"),
            ("target,colour\na.ply,red\n", "\"colour\""),
            ("target,target\na.ply,b.ply\n", "\"target\" twice"),
            ("landmarks\na.json\n", "a column \"target\""),
            ("target,model\na.ply\n", "line 2"),
            ("target,model\na.ply,arap\n,arap\n", "line 3"),
            ("target\na/a.ply\na/a.obj\n", "line 3: expected a name of its own"),
            ("target,name\na.ply,x\nb.ply,X\n", "as in line 2"),
            ("target,name\na.ply,../x\n", "\"../x\""),
            ("target,name\na.ply,Summary\n", "\"Summary\""),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains("list.csv") && message.contains(words), "{text:?}: {message}");
        }
    }
}
