//! Rows of results on the terminal, and as files: what two equal runs have in common apart from what they have not.

use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use comfy_table::{CellAlignment, Table, presets};
use nonrigid::console::Failure;
use nonrigid::io::write_atomically;
use nonrigid::nlls::{Convergence, StopReason};
pub use nonrigid::text::csv_field;
use serde_json::Value;

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

/// [`nonrigid::io::write_json`] with the exit code of what cannot be written.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json(path: &Path, json: &Value) -> Result<()> {
    Ok(nonrigid::io::write_json(path, json).map_err(Failure::writing)?)
}

/// A table for the terminal: numbers, in all columns but the first, to the right.
#[must_use]
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_HORIZONTAL_ONLY).set_header(header).add_rows(rows);
    table.column_iter_mut().skip(1).for_each(|c| c.set_cell_alignment(CellAlignment::Right));
    table
}

/// Items by key, keys in the order in which they first come.
#[must_use]
pub fn grouped<K: PartialEq, V>(items: impl IntoIterator<Item = (K, V)>) -> Vec<(K, Vec<V>)> {
    let mut groups: Vec<(K, Vec<V>)> = Vec::new();
    for (key, item) in items {
        match groups.iter_mut().find(|group| group.0 == key) {
            Some(group) => group.1.push(item),
            None => groups.push((key, vec![item])),
        }
    }
    groups
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
