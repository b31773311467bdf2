//! Rows of results, their summary, and both as files and on the terminal.

use std::path::Path;

use anyhow::Result;
use comfy_table::Table;
use nonrigid::evaluation::{ApertureErrors, MeshQuality, TruthErrors};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::tables::{csv_field, grouped, table, write_csv, write_json};

/// One variant, or another program's result, on one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchRow {
    /// Case name.
    pub case: String,
    /// Name in the group: of the model, the kernel, the term or the program.
    pub model: String,
    /// What is varied; `external` for another program's result.
    pub group: String,
    /// What came out; `None` where nothing did.
    #[serde(flatten)]
    pub score: Option<Score>,
    /// Why nothing did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Wall time of the registration; not part of what is compared.
    #[serde(skip)]
    pub seconds: Option<f64>,
    /// Greatest memory of the process during the registration, the case included, where the system says; not part of what is
    /// compared.
    #[serde(skip)]
    pub peak_bytes: Option<u64>,
}

impl BenchRow {
    /// Without seconds and memory.
    #[must_use]
    pub fn new(group: &str, model: &str, case: &str, scored: Result<Score, String>) -> Self {
        let (score, error) = scored.map_or_else(|e| (None, Some(e)), |score| (Some(score), None));
        let [case, model, group] = [case, model, group].map(str::to_owned);
        Self { case, model, group, score, error, seconds: None, peak_bytes: None }
    }
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
    /// Vertices that the scan does not show.
    pub unobserved_vertices: usize,
    /// Lids and lips against the truth.
    #[serde(flatten)]
    pub apertures: ApertureErrors,
    /// Steps taken; another program's are unknown.
    pub iterations: Option<usize>,
}

/// One variant over its cases. Means and worst are over the cases with a result, zero without any: look at `failed` first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchSummary {
    /// What is varied.
    pub group: String,
    /// Name in the group.
    pub model: String,
    /// Cases.
    pub cases: usize,
    /// Cases without a result.
    pub failed: usize,
    /// Mean of the rmse, millimetres.
    pub mean_rmse: f64,
    /// Largest rmse.
    pub worst_rmse: f64,
    /// Mean of the part along the normal.
    pub mean_normal: f64,
    /// Mean of the part along the surface.
    pub mean_tangential: f64,
    /// Mean of the 95th percentile.
    pub mean_p95: f64,
    /// Mean error of how far the eyes are open, where the rig has the 68 landmarks.
    pub mean_eye_aperture: Option<f64>,
    /// The same of the lips.
    pub mean_lip_aperture: Option<f64>,
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

impl BenchSummary {
    /// The rmse of every case with a result, of the rows that it sums up.
    #[must_use]
    pub fn errors(&self, rows: &[BenchRow]) -> Vec<f64> {
        let of = rows.iter().filter(|r| (&r.group, &r.model) == (&self.group, &self.model));
        of.filter_map(|r| Some(r.score.as_ref()?.errors.rmse)).collect()
    }
}

/// Summaries by group and name, in the order of the rows.
#[must_use]
pub fn summarize(rows: &[BenchRow]) -> Vec<BenchSummary> {
    let groups = grouped(rows.iter().map(|row| ([row.group.as_str(), &row.model], row)));
    groups.into_iter().map(|(key, rows)| summary(key, &rows)).collect()
}

fn summary(key: [&str; 2], rows: &[&BenchRow]) -> BenchSummary {
    let scores: Vec<&Score> = rows.iter().filter_map(|r| r.score.as_ref()).collect();
    let mean = |of: fn(&Score) -> f64| mean(scores.iter().map(|s| of(s))).unwrap_or(0.0);
    let worst = |of: fn(&Score) -> f64| scores.iter().map(|s| of(s)).fold(0.0, f64::max);
    let most = |of: fn(&Score) -> usize| scores.iter().map(|s| of(s)).max().unwrap_or(0);
    BenchSummary {
        group: key[0].to_owned(),
        model: key[1].to_owned(),
        cases: rows.len(),
        failed: rows.len() - scores.len(),
        mean_rmse: mean(|s| s.errors.rmse),
        worst_rmse: worst(|s| s.errors.rmse),
        mean_normal: mean(|s| s.errors.normal),
        mean_tangential: mean(|s| s.errors.tangential),
        mean_p95: mean(|s| s.errors.p95),
        mean_eye_aperture: self::mean(scores.iter().filter_map(|s| s.apertures.eye_aperture)),
        mean_lip_aperture: self::mean(scores.iter().filter_map(|s| s.apertures.lip_aperture)),
        worst_unobserved: worst(|s| s.errors.unobserved.unwrap_or(0.0)),
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

/// One line a variant: errors in millimetres, `eyes` and `lips` those of how far they are open, seconds, megabytes. Without a result on any case, that is all it says.
#[must_use]
pub fn summary_table(summaries: &[BenchSummary]) -> Table {
    let header = [
        "variant / mm",
        "mean rmse",
        "worst rmse",
        "mean normal",
        "mean tangential",
        "mean p95",
        "eyes",
        "lips",
        "worst flips",
        "worst self-int.",
        "mean steps",
        "mean s",
        "peak MB",
        "failed",
    ];
    let line = |s: &BenchSummary| {
        let mut cells = vec![format!("{}: {}", s.group, s.model)];
        if s.failed == s.cases {
            cells.extend(vec![String::new(); header.len() - 2]);
        } else {
            let numbers = [s.mean_rmse, s.worst_rmse, s.mean_normal, s.mean_tangential, s.mean_p95];
            let known = |x: Option<f64>, decimals: usize| x.map_or(String::new(), |x| format!("{x:.decimals$}"));
            cells.extend(numbers.map(|x| format!("{x:.3}")));
            cells.extend([s.mean_eye_aperture, s.mean_lip_aperture].map(|x| known(x, 3)));
            cells.extend([s.worst_flips, s.worst_self_intersections].map(|n| n.to_string()));
            cells.extend([known(s.mean_iterations, 1), known(s.mean_seconds, 2)]);
            cells.push(known(s.peak_bytes.map(megabytes), 0));
        }
        cells.push(if s.failed == 0 { String::new() } else { format!("{} of {}", s.failed, s.cases) });
        cells
    };
    table(&header, summaries.iter().map(line))
}

/// The columns of [`cells`].
const COLUMNS: [&str; 15] = [
    "rmse",
    "normal",
    "tangential",
    "median",
    "p95",
    "max",
    "unobserved",
    "flips",
    "self_intersections",
    "self_intersections_at_rest",
    "stretch_p1",
    "stretch_p99",
    "eye_aperture",
    "lip_aperture",
    "iterations",
];

/// A result as text, numbers with so many decimals; without one nothing.
fn cells(score: Option<&Score>, decimals: usize) -> Vec<String> {
    let Some(score) = score else { return vec![String::new(); COLUMNS.len()] };
    let Score { errors: e, mesh: m, apertures, iterations, .. } = score;
    let number = |x: f64| format!("{x:.decimals$}");
    let mut cells = [e.rmse, e.normal, e.tangential, e.median, e.p95, e.max].map(number).to_vec();
    cells.push(score.errors.unobserved.map_or(String::new(), number));
    cells.extend([e.flipped, m.self_intersections, m.self_intersections_at_rest].map(|n| n.to_string()));
    cells.extend([m.stretch.p1, m.stretch.p99].map(number));
    cells.extend([apertures.eye_aperture, apertures.lip_aperture].map(|x| x.map_or(String::new(), number)));
    cells.push(iterations.map_or(String::new(), |n| n.to_string()));
    cells
}

/// Every row: errors in millimetres, seconds.
#[must_use]
pub fn table_of(rows: &[BenchRow]) -> Table {
    let header = [&["case / mm", "model"][..], &COLUMNS, &["s"]].concat();
    let line = |r: &BenchRow| {
        let seconds = r.seconds.map_or(String::new(), |s| format!("{s:.2}"));
        [vec![r.case.clone(), r.model.clone()], cells(r.score.as_ref(), 3), vec![seconds]].concat()
    };
    table(&header, rows.iter().map(line))
}

/// Writes `NAME.csv` and `NAME.json`, which are the same in every equal run, and `NAME.timing.csv`, which is not.
///
/// # Errors
/// When a file cannot be written.
pub fn write_rows(out: &Path, name: &str, rows: &[BenchRow], threads: usize) -> Result<()> {
    let key = |r: &BenchRow| [&r.case, &r.model, &r.group].map(|text| csv_field(text)).join(",");
    let lines = rows.iter().map(|r| {
        let error = r.error.as_deref().map_or(String::new(), csv_field);
        format!("{},{},{error}", key(r), cells(r.score.as_ref(), 6).join(","))
    });
    write_csv(&out.join(format!("{name}.csv")), &format!("case,model,group,{},error", COLUMNS.join(",")), lines)?;
    let times = rows.iter().filter_map(|r| {
        let peak = r.peak_bytes.map_or(String::new(), |bytes| format!("{:.3}", megabytes(bytes)));
        Some(format!("{},{:.4},{peak},{threads}", key(r), r.seconds?))
    });
    write_csv(&out.join(format!("{name}.timing.csv")), "case,model,group,seconds,peak_mb,threads", times)?;
    write_json(&out.join(format!("{name}.json")), &json!({ "rows": rows, "summary": summarize(rows) }))
}

/// Millions of bytes.
#[must_use]
pub fn megabytes(bytes: u64) -> f64 {
    1e-6 * bytes as f64
}
