//! Rows of results on the terminal, and as files: what two equal runs have in common apart from what they have not.

use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets};
use nonrigid::console::Failure;
use nonrigid::mesh::io::write_atomically;
use nonrigid::nlls::{Convergence, StopReason};
pub use nonrigid::page::csv_text;
use serde_json::Value;

use crate::scan_bench::{BenchRow, summarize};

/// Writes `name`.csv with all rows, `name`.json with `json`, and `name`.timing.csv with their times.
///
/// # Errors
/// When a file cannot be written.
pub fn write_tables(out: &Path, name: &str, rows: &[BenchRow], json: &Value) -> Result<()> {
    let header = "case,model,rmse,off,slide,median,p95,max,unobserved,flips,self_intersections,\
                  self_intersections_at_rest,stretch_p1,stretch_p99,iterations";
    let lines = rows.iter().map(|r| {
        let (e, m) = (&r.errors, &r.mesh);
        let numbers = [e.rmse, e.off, e.slide, e.median, e.p95, e.max, e.unobserved].map(|x| format!("{x:.6}"));
        format!(
            "{},{},{},{},{},{},{:.6},{:.6},{}",
            r.case,
            r.model,
            numbers.join(","),
            e.flipped,
            m.self_intersections,
            m.self_intersections_at_rest,
            m.stretch.p1,
            m.stretch.p99,
            r.iterations
        )
    });
    write_csv(&out.join(format!("{name}.csv")), header, lines)?;
    write_json(&out.join(format!("{name}.json")), json)?;
    let threads = rayon::current_num_threads();
    let times = rows.iter().map(|r| format!("{},{},{:.4},{threads}", r.case, r.model, r.seconds));
    write_csv(&out.join(format!("{name}.timing.csv")), "case,model,seconds,threads", times)
}

/// Writes a header and lines that are separated by commas already.
///
/// # Errors
/// When the file cannot be written.
pub fn write_csv(path: &Path, header: &str, lines: impl IntoIterator<Item = String>) -> Result<()> {
    let written = write_atomically(path, |file| {
        writeln!(file, "{header}")?;
        lines.into_iter().try_for_each(|line| writeln!(file, "{line}"))
    });
    Ok(written.map_err(Failure::writing)?)
}

/// Writes JSON with a line break at the end.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json(path: &Path, json: &Value) -> Result<()> {
    Ok(write_atomically(path, |file| writeln!(file, "{json:#}")).map_err(Failure::writing)?)
}

/// A table for the terminal: numbers, in all columns but the first, to the right.
#[must_use]
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_HORIZONTAL_ONLY).set_header(header).add_rows(rows);
    table.column_iter_mut().skip(1).for_each(|c| c.set_cell_alignment(CellAlignment::Right));
    table
}

/// Why a minimisation ended, in a word for a table.
#[must_use]
pub fn stop_word(stop: &StopReason) -> &'static str {
    match stop {
        StopReason::Converged(Convergence::Energy) => "energy",
        StopReason::Converged(Convergence::Step) => "step",
        StopReason::Converged(Convergence::Gradient) => "gradient",
        StopReason::MaxIterations => "max. steps",
        StopReason::NoDecrease => "no decrease",
        StopReason::LinearSolverFailed(_) => "singular",
        StopReason::NonFinite => "not finite",
        StopReason::StoppedByObserver => "observer",
        StopReason::InvalidBounds(_) => "bounds",
    }
}

/// Every row of [`scan_bench`](crate::scan_bench::scan_bench): errors in millimetres, seconds.
#[must_use]
pub fn table_of(rows: &[BenchRow]) -> Table {
    let header = [
        "case / mm",
        "model",
        "rmse",
        "off",
        "slide",
        "median",
        "p95",
        "unobserved",
        "flips",
        "self-int.",
        "(at rest)",
        "stretch 1 %",
        "99 %",
        "steps",
        "s",
    ];
    table(
        &header,
        rows.iter().map(|r| {
            let e = &r.errors;
            let mut cells = vec![r.case.clone(), r.model.clone()];
            cells.extend([e.rmse, e.off, e.slide, e.median, e.p95, e.unobserved].map(|x| format!("{x:.3}")));
            cells.extend(
                [e.flipped, r.mesh.self_intersections, r.mesh.self_intersections_at_rest].map(|n| n.to_string()),
            );
            cells.extend([r.mesh.stretch.p1, r.mesh.stretch.p99].map(|x| format!("{x:.2}")));
            cells.extend([r.iterations.to_string(), format!("{:.2}", r.seconds)]);
            cells
        }),
    )
}

/// One line for each model: means and worst over its rows.
#[must_use]
pub fn summary_table(rows: &[BenchRow]) -> Table {
    let header = [
        "model / mm",
        "mean rmse",
        "worst rmse",
        "mean off",
        "mean slide",
        "worst unobserved",
        "worst self-int.",
        "mean s",
    ];
    table(
        &header,
        summarize(rows).into_iter().map(|s| {
            let numbers = [s.mean_rmse, s.worst_rmse, s.mean_off, s.mean_slide, s.worst_unobserved];
            let mut cells = vec![s.model];
            cells.extend(numbers.map(|x| format!("{x:.3}")));
            cells.extend([s.worst_self_intersections.to_string(), format!("{:.2}", s.mean_seconds)]);
            cells
        }),
    )
}
