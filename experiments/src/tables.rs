//! Rows of results on the terminal, and as files: what two equal runs have in common apart from what they have not.

use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets};
use nonrigid::cli::Failure;
use nonrigid::mesh::io::write_atomically;
use serde_json::Value;

use crate::scan_bench::{BenchRow, summarize};

/// Writes `name`.csv with all rows, `name`.json with `json`, and `name`.timing.csv with their times.
///
/// # Errors
/// When a file cannot be written.
pub fn write_tables(out: &Path, name: &str, rows: &[BenchRow], json: &Value) -> Result<()> {
    let header = "case,model,rmse,off,slide,median,p95,max,unobserved,flips,iterations";
    let csv = write_atomically(&out.join(format!("{name}.csv")), |file| {
        writeln!(file, "{header}")?;
        for r in rows {
            let e = &r.errors;
            let numbers = [e.rmse, e.off, e.slide, e.median, e.p95, e.max, e.unobserved].map(|x| format!("{x:.6}"));
            writeln!(file, "{},{},{},{},{}", r.case, r.model, numbers.join(","), e.flipped, r.iterations)?;
        }
        Ok(())
    });
    csv.map_err(Failure::writing)?;
    write_atomically(&out.join(format!("{name}.json")), |file| writeln!(file, "{json:#}")).map_err(Failure::writing)?;
    let timing = write_atomically(&out.join(format!("{name}.timing.csv")), |file| {
        writeln!(file, "case,model,seconds,threads")?;
        rows.iter().try_for_each(|r| {
            writeln!(file, "{},{},{:.4},{}", r.case, r.model, r.seconds, rayon::current_num_threads())
        })
    });
    Ok(timing.map_err(Failure::writing)?)
}

/// A table of text, the first column to the left and the others to the right.
#[must_use]
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_HORIZONTAL_ONLY).set_header(header).add_rows(rows);
    table.column_iter_mut().skip(1).for_each(|c| c.set_cell_alignment(CellAlignment::Right));
    table
}

/// Every row of [`scan_bench`](crate::scan_bench::scan_bench): errors in millimetres, seconds.
#[must_use]
pub fn table_of(rows: &[BenchRow]) -> Table {
    let header = ["case / mm", "model", "rmse", "off", "slide", "median", "p95", "unobserved", "flips", "steps", "s"];
    table(
        &header,
        rows.iter().map(|r| {
            let e = &r.errors;
            let mut cells = vec![r.case.clone(), r.model.clone()];
            cells.extend([e.rmse, e.off, e.slide, e.median, e.p95, e.unobserved].map(|x| format!("{x:.3}")));
            cells.extend([e.flipped.to_string(), r.iterations.to_string(), format!("{:.2}", r.seconds)]);
            cells
        }),
    )
}

/// One line for each model: means and worst over its rows.
#[must_use]
pub fn summary_table(rows: &[BenchRow]) -> Table {
    let header = ["model / mm", "mean rmse", "worst rmse", "mean off", "mean slide", "worst unobserved", "mean s"];
    table(
        &header,
        summarize(rows).into_iter().map(|s| {
            let numbers = [s.mean_rmse, s.worst_rmse, s.mean_off, s.mean_slide, s.worst_unobserved];
            let mut cells = vec![s.model];
            cells.extend(numbers.map(|x| format!("{x:.3}")));
            cells.push(format!("{:.2}", s.mean_seconds));
            cells
        }),
    )
}
