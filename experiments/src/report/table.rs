//! Tables that studies write, and that claims and the page read again: CSV for people and programs, JSON beside it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use nonrigid::text::from_csv_field;
use serde_json::{Map, Value};

use crate::output::write_file;
use crate::tables::{csv_field, write_json};

/// Rows of text under named columns.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Names of the columns.
    pub header: Vec<String>,
    /// Rows, as long as the header.
    pub rows: Vec<Vec<String>>,
}

/// A number as tables hold it: six decimals, none where they would be zeros, nothing where there is no number.
#[must_use]
pub fn number(value: f64) -> String {
    match value {
        v if !v.is_finite() => String::new(),
        v if v == 0.0 || (v.abs() > 0.5 && (v - v.round()).abs() < 5e-7) => format!("{v:.0}"),
        v if v.abs() < 1e-3 => format!("{v:.6e}"),
        v => format!("{v:.6}"),
    }
}

/// A number as people read it, the same wherever it stands: the three leading digits of what a table holds.
#[must_use]
pub fn shown(value: f64) -> String {
    if value.is_infinite() {
        return if value > 0.0 { "infinite" } else { "-infinite" }.to_owned();
    }
    shown_cell(&number(value))
}

/// A cell as people read it: a number with a decimal point as [`shown`], all else as it is.
#[must_use]
pub fn shown_cell(cell: &str) -> String {
    match cell.parse::<f64>() {
        Ok(v) if v.is_finite() && cell.contains('.') => match v.abs() {
            0.0 => "0".to_owned(),
            a if a < 1e-3 => format!("{v:.1e}"),
            a => format!("{v:.*}", (2 - a.log10().floor() as i32).clamp(0, 5) as usize),
        },
        _ => cell.to_owned(),
    }
}

/// So many of something: `1 case`, `2 cases`.
#[must_use]
pub fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

impl Table {
    /// A table without rows.
    #[must_use]
    pub fn new(header: &[&str]) -> Self {
        Self { header: header.iter().map(ToString::to_string).collect(), rows: Vec::new() }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// When it is not as long as the header.
    pub fn push(&mut self, row: Vec<String>) {
        assert_eq!(row.len(), self.header.len(), "a row as long as the header {:?}", self.header);
        self.rows.push(row);
    }

    /// The table as people read it, as LaTeX of the package booktabs.
    #[must_use]
    pub fn latex(&self) -> String {
        let escape = |text: &str| {
            text.chars().fold(String::new(), |mut out, c| {
                match c {
                    '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
                    '\\' => out.push_str("\\textbackslash{}"),
                    '~' => out.push_str("\\textasciitilde{}"),
                    '^' => out.push_str("\\textasciicircum{}"),
                    _ => out.push(c),
                }
                out
            })
        };
        let line = |cells: &mut dyn Iterator<Item = String>| {
            cells.map(|c| escape(&c)).collect::<Vec<_>>().join(" & ") + " \\\\\n"
        };
        // A column without letters is one of numbers, to the right.
        let number = |k: usize| self.rows.iter().all(|row| row[k].is_empty() || row[k].parse::<f64>().is_ok());
        let columns: String = (0..self.header.len()).map(|k| if number(k) { 'r' } else { 'l' }).collect();
        let head = line(&mut self.header.iter().map(|name| name.replace('_', " ")));
        let rows: String = self.rows.iter().map(|row| line(&mut row.iter().map(|cell| shown_cell(cell)))).collect();
        format!("\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}\n")
    }

    /// Writes `name`.csv and `name`.json into a folder.
    ///
    /// # Errors
    /// When one cannot be written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<()> {
        let line = |cells: &[String]| cells.iter().map(|c| csv_field(c)).collect::<Vec<_>>().join(",") + "\n";
        let text: String = std::iter::once(&self.header).chain(&self.rows).map(|r| line(r)).collect();
        write_file(&folder.join(format!("{name}.csv")), text)?;
        let value = |cell: &String| match cell.parse::<f64>() {
            Ok(v) if v.is_finite() => serde_json::json!(v),
            _ if cell.is_empty() => Value::Null,
            _ => Value::String(cell.clone()),
        };
        let object = |row: &Vec<String>| -> Value {
            self.header.iter().cloned().zip(row.iter().map(value)).collect::<Map<_, _>>().into()
        };
        write_json(&folder.join(format!("{name}.json")), &self.rows.iter().map(object).collect())
    }

    /// Reads a table from CSV.
    ///
    /// # Errors
    /// When it cannot be read, or a row is not as long as the header.
    pub fn read(path: &Path) -> Result<Self> {
        let place = || path.display().to_string();
        let mut reader = csv::Reader::from_path(path).with_context(place)?;
        let header = reader.headers().with_context(place)?.iter().map(str::to_owned).collect();
        let rows = reader.records().map(|r| Ok(r?.iter().map(|cell| from_csv_field(cell).to_owned()).collect()));
        Ok(Self { header, rows: rows.collect::<Result<_>>().with_context(place)? })
    }

    /// Index of a column.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn column(&self, name: &str) -> Result<usize> {
        match self.header.iter().position(|h| h == name) {
            Some(k) => Ok(k),
            None => bail!("no column {name:?}; there are {}", self.header.join(", ")),
        }
    }

    /// The numbers of a column in the rows that hold all of these (column, text) pairs; not a number where there is none.
    ///
    /// # Errors
    /// When a column does not exist.
    pub fn numbers(&self, holding: &[(&str, &str)], column: &str) -> Result<Vec<f64>> {
        let k = self.column(column)?;
        Ok(self.find(holding)?.iter().map(|(_, row)| row[k].parse().unwrap_or(f64::NAN)).collect())
    }

    /// Rows that hold all of these (column, text) pairs, with their line in the file, from 2.
    ///
    /// # Errors
    /// When a column does not exist.
    pub fn find(&self, holding: &[(&str, &str)]) -> Result<Vec<(usize, &[String])>> {
        let wanted: Vec<(usize, &str)> =
            holding.iter().map(|(c, v)| Ok((self.column(c)?, *v))).collect::<Result<_>>()?;
        let fits = |row: &[String]| wanted.iter().all(|(k, v)| row[*k] == *v);
        Ok(self.rows.iter().enumerate().map(|(k, r)| (k + 2, &r[..])).filter(|(_, r)| fits(r)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_comes_back_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut table = Table::new(&["name", "rmse", "note"]);
        table.push(vec!["a, b".into(), number(1.5), "say \"no\"".into()]);
        table.push(vec!["c".into(), number(f64::NAN), String::new()]);
        table.write(folder.path(), "t").unwrap();
        let read = Table::read(&folder.path().join("t.csv")).unwrap();
        assert_eq!(read, table);
        let json: Value = serde_json::from_slice(&std::fs::read(folder.path().join("t.json")).unwrap()).unwrap();
        assert_eq!(
            json,
            serde_json::json!([{ "name": "a, b", "rmse": 1.5, "note": "say \"no\"" }, { "name": "c", "rmse": null, "note": null }])
        );
        assert_eq!(read.numbers(&[("name", "a, b")], "rmse").unwrap(), [1.5]);
        assert!(read.numbers(&[("name", "c")], "rmse").unwrap()[0].is_nan());
        assert_eq!(read.find(&[("name", "c")]).unwrap()[0].0, 3);
        assert!(read.find(&[("nothing", "c")]).is_err());
    }

    #[test]
    fn latex_is_aligned_and_escaped() {
        let mut table = Table::new(&["name", "self_intersections"]);
        table.push(vec!["50 % of a_b".into(), number(1.2345)]);
        assert_eq!(
            table.latex(),
            "\\begin{tabular}{lr}\n\\toprule\nname & self intersections \\\\\n\\midrule\n50 \\% of a\\_b & 1.23 \\\\\n\\bottomrule\n\\end{tabular}\n"
        );
    }

    #[test]
    fn a_number_is_rounded_once_for_all() {
        let cells = ["1.234567", "0.012345", "1234.500000", "400", "a < b", "1.2345e-5"].map(shown_cell);
        assert_eq!(cells, ["1.23", "0.0123", "1234", "400", "a < b", "1.2e-5"]);
        for value in [0.6925, 0.692_499_9, 1.5, 12.345_678, -0.25, 7.0, 0.0] {
            assert_eq!(shown(value), shown_cell(&number(value)));
        }
        assert_eq!([1.5, 0.7, f64::INFINITY].map(shown), ["1.50", "0.700", "infinite"]);
        assert_eq!([counted(1, "case"), counted(2, "case")], ["1 case", "2 cases"]);
    }

    #[test]
    fn numbers_are_short_and_whole() {
        let numbers = [0.0, 12.0, 1.999_999_99, 0.25, 1e-7, f64::INFINITY].map(number);
        assert_eq!(numbers, ["0", "12", "2", "0.250000", "1.000000e-7", ""]);
    }
}
