//! All jobs in one table: CSV, a page, and lines for a terminal.

use std::borrow::Cow;
use std::fmt::{self, Write as _};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::animation::AllTold;
use super::job::read_json;
use super::{Batch, Job, Outcome, Record, Start, Status};
use crate::{page, text};

/// What is known of one scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SummaryRow {
    /// Its name.
    pub name: String,
    /// `done`, `doubtful`, `failed`, or `pending`: not run yet.
    pub status: Cow<'static, str>,
    /// `cold`, `warm` or `cold again`.
    pub start: Cow<'static, str>,
    /// Probability that the error exceeds 3 mm on a face, the same share of the size on other subjects.
    pub probability: Option<f64>,
    /// Share of the template's vertices with a correspondence.
    pub inliers: Option<f64>,
    /// Share of the vertices near the scan.
    pub near: Option<f64>,
    /// Their median distance, millimetres.
    pub median: Option<f64>,
    /// Flipped triangles.
    pub flipped: Option<u64>,
    /// What makes it doubtful, or why it failed.
    pub note: String,
}

/// A row for each job.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// In the manifest's order.
    pub rows: Vec<SummaryRow>,
}

const HEADER: [&str; 9] =
    ["name", "status", "start", "error_probability", "inliers", "near", "median_mm", "flipped", "note"];

impl Summary {
    /// What is known of jobs by what has just come of them, or else by their records, and by their reports in a folder.
    #[must_use]
    pub fn of(batch: &Batch, jobs: &[Job], outcomes: &[Outcome]) -> Self {
        let mut records = vec![None; jobs.len()];
        outcomes.iter().for_each(|outcome| records[outcome.job] = Some(&outcome.record));
        let mut told = AllTold::default();
        let row = |(job, record)| SummaryRow::of(batch, job, record).with(told.of(batch, job));
        Self { rows: jobs.iter().zip(records).map(row).collect() }
    }

    /// How many rows have this status.
    #[must_use]
    pub fn count(&self, status: &str) -> usize {
        self.rows.iter().filter(|row| row.status == status).count()
    }

    /// As CSV.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = HEADER.join(",") + "\n";
        for row in &self.rows {
            let cells: Vec<String> = row.cells(|x| x.to_string()).iter().map(|cell| text::csv_field(cell)).collect();
            text += &(cells.join(",") + "\n");
        }
        text
    }

    /// As a page, with the pictures of those rows that have one beside it.
    #[must_use]
    pub fn to_html(&self, pictured: &dyn Fn(&str) -> bool) -> String {
        let mut body = "<h1>Registered scans</h1>\n".to_owned();
        let caption = "error_probability: that the error exceeds 3 mm on a face, the same share of the size on other subjects; inliers: vertices with a correspondence; near: vertices within 3 mm of the scan; median: their distance";
        body += &page::table(caption, &HEADER, self.rows.iter().map(|row| row.cells(short)));
        for row in self.rows.iter().filter(|row| pictured(&row.name)) {
            let name = text::html(&row.name);
            let link = row.name.replace('%', "%25").replace('#', "%23").replace('?', "%3F");
            let _ = writeln!(
                body,
                "<figure><img alt=\"{name}\" src=\"{}.png\"><figcaption>{name}: {}</figcaption></figure>",
                text::html(&link),
                row.status
            );
        }
        page::document("Registered scans", "td:last-child,th:last-child{text-align:left}", &body)
    }
}

/// A line for each row, in columns.
impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines: Vec<Vec<String>> = vec![HEADER.map(str::to_owned).to_vec()];
        lines.extend(self.rows.iter().map(|row| row.cells(short)));
        let width = |column: usize| lines.iter().map(|l| l[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..HEADER.len() - 1).map(width).collect();
        for line in &lines {
            for (cell, width) in line.iter().zip(&widths) {
                write!(f, "{cell:width$}  ")?;
            }
            writeln!(f, "{}", line[HEADER.len() - 1])?;
        }
        Ok(())
    }
}

/// The note of a result whose report says that its mirror image would be as good.
const UNSAID: &str = "left and right: nothing tells them apart here";

/// Parts of a note, of those that say something.
fn joined(parts: [String; 2]) -> String {
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
}

fn short(x: f64) -> String {
    format!("{x:.3}")
}

impl SummaryRow {
    fn of(batch: &Batch, job: &Job, record: Option<&Record>) -> Self {
        let name = job.name.clone();
        let known = Record::read(&batch.record(job));
        let Some(record) = record.or(known.as_ref()) else {
            return match batch.broken_record(&name) {
                Some(note) => Self { name, status: "failed".into(), start: "cold".into(), note, ..Self::default() },
                None => Self { name, status: "pending".into(), ..Self::default() },
            };
        };
        let start = match record.start {
            Start::Cold => "cold",
            Start::Warm => "warm",
            Start::ColdAgain => "cold again",
        };
        if record.status == Status::Failed {
            let kept = known.as_ref().is_some_and(|known| !known.outputs.is_empty());
            let kept = if kept { "; what an earlier run has made is still there" } else { "" };
            let note = record.error.clone().unwrap_or_default() + kept;
            return Self { name, status: "failed".into(), start: start.into(), note, ..Self::default() };
        }
        let report = read_json(&batch.folder.join(format!("{name}.json"))).filter(Value::is_object);
        let Some(report) = report else {
            let note = format!("{name}.json, its report, cannot be read; delete it, and the scan is done again");
            return Self { name, status: "doubtful".into(), start: start.into(), note, ..Self::default() };
        };
        let doubts: Vec<&str> =
            report["doubts"].as_array().into_iter().flatten().filter_map(|doubt| doubt["sign"].as_str()).collect();
        let unsaid = report["evidence"]["handedness"]["by"] == "unknown";
        let parts = [doubts.join(" "), if unsaid { UNSAID.to_owned() } else { String::new() }];
        let quality = &report["quality"];
        Self {
            status: if doubts.is_empty() { "done" } else { "doubtful" }.into(),
            start: start.into(),
            probability: report["error_probability"].as_f64(),
            inliers: report["inliers"].as_f64(),
            near: quality["to_scan"]["share_within"].as_f64(),
            median: quality["median_within"].as_f64(),
            flipped: quality["flipped"].as_u64(),
            note: joined(parts),
            name,
        }
    }

    /// With what is wrong with it as a frame of a sequence: one that is lost there is doubtful.
    fn with(mut self, told: Option<(String, bool)>) -> Self {
        if let Some((note, lost)) = told.filter(|_| self.status != "pending") {
            if lost && self.status == "done" {
                self.status = "doubtful".into();
            }
            self.note = joined([self.note, note]);
        }
        self
    }

    fn cells(&self, number: impl Fn(f64) -> String) -> Vec<String> {
        let number = |x: Option<f64>| x.map(&number).unwrap_or_default();
        vec![
            self.name.clone(),
            self.status.clone().into_owned(),
            self.start.clone().into_owned(),
            number(self.probability),
            number(self.inliers),
            number(self.near),
            number(self.median),
            self.flipped.map_or_else(String::new, |n| n.to_string()),
            self.note.clone(),
        ]
    }
}
