//! Rows of results as files: what two equal runs have in common apart from what they have not.

use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use nonrigid::cli::Failure;
use nonrigid::mesh::io::write_atomically;
use serde_json::Value;

use crate::scan_bench::BenchRow;

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
