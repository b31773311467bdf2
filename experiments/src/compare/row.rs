//! Rows of the comparison, their summary, and both as files and on the terminal.

use std::path::Path;

use anyhow::Result;
use comfy_table::Table;
use nonrigid::evaluation::{MeshQuality, TruthErrors};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::tables::{csv_text, table, write_csv, write_json};

/// One variant, or another program's result, on one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CompareRow {
    /// What is varied; `external` for another program's result.
    pub group: String,
    /// Name in the group.
    pub name: String,
    /// Case name.
    pub case: String,
    /// What came out; `None` where nothing did.
    pub score: Option<Score>,
    /// Why nothing did.
    pub error: Option<String>,
    /// Wall time of the registration; not part of what is compared.
    #[serde(skip)]
    pub seconds: Option<f64>,
    /// Greatest memory of the process during the registration, the case included, where the system says; not part of what is
    /// compared.
    #[serde(skip)]
    pub peak_bytes: Option<u64>,
}

/// A result in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Errors against the truth.
    #[serde(flatten)]
    pub errors: TruthErrors,
    /// Self-intersections and edge stretch against the rest shape: the subject's neutral, or else the template.
    #[serde(flatten)]
    pub mesh: MeshQuality,
    /// Steps taken; another program's are unknown.
    pub iterations: Option<usize>,
}

/// One variant over its cases. Means and worst are over the cases with a result, zero without any: look at `failed` first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompareSummary {
    /// What is varied.
    pub group: String,
    /// Name in the group.
    pub name: String,
    /// Cases.
    pub cases: usize,
    /// Cases without a result.
    pub failed: usize,
    /// Mean of the rmse, millimetres.
    pub mean_rmse: f64,
    /// Largest rmse.
    pub worst_rmse: f64,
    /// Mean of the part along the normal.
    pub mean_off: f64,
    /// Mean of the part along the surface.
    pub mean_slide: f64,
    /// Mean of the 95th percentile.
    pub mean_p95: f64,
    /// Largest rmse over unobserved vertices.
    pub worst_unobserved: f64,
    /// Most flipped triangles.
    pub worst_flips: usize,
    /// Most self-intersections.
    pub worst_self_intersections: usize,
    /// Mean number of steps, where it is known.
    pub mean_iterations: Option<f64>,
    /// Mean wall time; not part of what is compared.
    #[serde(skip)]
    pub mean_seconds: Option<f64>,
    /// Greatest memory; not part of what is compared.
    #[serde(skip)]
    pub peak_bytes: Option<u64>,
}

/// Summaries by group and name, in the order of the rows.
#[must_use]
pub fn summarize(rows: &[CompareRow]) -> Vec<CompareSummary> {
    let mut order: Vec<[&str; 2]> = Vec::new();
    for row in rows {
        let key = [row.group.as_str(), &row.name];
        if !order.contains(&key) {
            order.push(key);
        }
    }
    order.into_iter().map(|key| summary(key, rows)).collect()
}

fn summary(key: [&str; 2], rows: &[CompareRow]) -> CompareSummary {
    let rows: Vec<&CompareRow> = rows.iter().filter(|r| [r.group.as_str(), &r.name] == key).collect();
    let scores: Vec<&Score> = rows.iter().filter_map(|r| r.score.as_ref()).collect();
    let mean = |of: fn(&Score) -> f64| mean(scores.iter().map(|s| of(s))).unwrap_or(0.0);
    let worst = |of: fn(&Score) -> f64| scores.iter().map(|s| of(s)).fold(0.0, f64::max);
    let most = |of: fn(&Score) -> usize| scores.iter().map(|s| of(s)).max().unwrap_or(0);
    CompareSummary {
        group: key[0].to_owned(),
        name: key[1].to_owned(),
        cases: rows.len(),
        failed: rows.len() - scores.len(),
        mean_rmse: mean(|s| s.errors.rmse),
        worst_rmse: worst(|s| s.errors.rmse),
        mean_off: mean(|s| s.errors.off),
        mean_slide: mean(|s| s.errors.slide),
        mean_p95: mean(|s| s.errors.p95),
        worst_unobserved: worst(|s| s.errors.unobserved),
        worst_flips: most(|s| s.errors.flipped),
        worst_self_intersections: most(|s| s.mesh.self_intersections),
        mean_iterations: self::mean(scores.iter().filter_map(|s| s.iterations).map(|n| n as f64)),
        mean_seconds: self::mean(rows.iter().filter_map(|r| r.seconds)),
        peak_bytes: rows.iter().filter_map(|r| r.peak_bytes).max(),
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// One line a variant: errors in millimetres, seconds, megabytes. Without a result on any case, that is all it says.
#[must_use]
pub fn summary_table(summaries: &[CompareSummary]) -> Table {
    let header = [
        "variant / mm",
        "mean rmse",
        "worst rmse",
        "mean off",
        "mean slide",
        "mean p95",
        "worst flips",
        "worst self-int.",
        "mean steps",
        "mean s",
        "peak MB",
        "failed",
    ];
    let line = |s: &CompareSummary| {
        let mut cells = vec![format!("{}: {}", s.group, s.name)];
        if s.failed == s.cases {
            cells.extend(vec![String::new(); header.len() - 2]);
        } else {
            let numbers = [s.mean_rmse, s.worst_rmse, s.mean_off, s.mean_slide, s.mean_p95];
            cells.extend(numbers.map(|x| format!("{x:.3}")));
            cells.extend([s.worst_flips, s.worst_self_intersections].map(|n| n.to_string()));
            let known = |x: Option<f64>, decimals: usize| x.map_or(String::new(), |x| format!("{x:.decimals$}"));
            cells.extend([known(s.mean_iterations, 1), known(s.mean_seconds, 2)]);
            cells.push(known(s.peak_bytes.map(megabytes), 0));
        }
        cells.push(if s.failed == 0 { String::new() } else { format!("{} of {}", s.failed, s.cases) });
        cells
    };
    table(&header, summaries.iter().map(line))
}

/// Writes `compare.csv` and `compare.json`, which are the same in every equal run, and `compare.timing.csv`, which is not.
///
/// # Errors
/// When a file cannot be written.
pub fn write_rows(out: &Path, rows: &[CompareRow], threads: usize) -> Result<()> {
    let header = "group,name,case,rmse,off,slide,median,p95,max,unobserved,flips,self_intersections,\
                  self_intersections_at_rest,stretch_p1,stretch_p99,iterations,error";
    let key = |r: &CompareRow| [&r.group, &r.name, &r.case].map(|text| csv_text(text)).join(",");
    let lines = rows.iter().map(|r| {
        let error = r.error.as_deref().map_or(String::new(), csv_text);
        let numbers = r.score.as_ref().map_or_else(|| vec![String::new(); 14], numbers);
        format!("{},{},{error}", key(r), numbers.join(","))
    });
    write_csv(&out.join("compare.csv"), header, lines)?;
    let times = rows.iter().filter_map(|r| {
        let peak = r.peak_bytes.map_or(String::new(), |bytes| format!("{:.3}", megabytes(bytes)));
        Some(format!("{},{:.4},{peak},{threads}", key(r), r.seconds?))
    });
    write_csv(&out.join("compare.timing.csv"), "group,name,case,seconds,peak_mb,threads", times)?;
    write_json(&out.join("compare.json"), &json!({ "rows": rows, "summary": summarize(rows) }))
}

/// What `compare.csv` has of a result, in its order.
fn numbers(s: &Score) -> Vec<String> {
    let (e, m) = (&s.errors, &s.mesh);
    let mut cells: Vec<String> = Vec::new();
    cells.extend([e.rmse, e.off, e.slide, e.median, e.p95, e.max, e.unobserved].map(|x| format!("{x:.6}")));
    cells.extend([e.flipped, m.self_intersections, m.self_intersections_at_rest].map(|n| n.to_string()));
    cells.extend([m.stretch.p1, m.stretch.p99].map(|x| format!("{x:.6}")));
    cells.push(s.iterations.map_or(String::new(), |n| n.to_string()));
    cells
}

pub(super) fn megabytes(bytes: u64) -> f64 {
    1e-6 * bytes as f64
}
