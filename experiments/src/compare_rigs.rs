//! `compare-rigs`: rigs in numbers, one column each.

use std::path::PathBuf;

use anyhow::Result;
use nonrigid::console::{Failure, say};
use nonrigid::rig::{Rig, RigReadOptions};

use crate::rig_statistics::RigStatistics;
use crate::tables::table;

/// What to compare.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: two generated rigs\n  \
    data-gen --seed 7 --out out/data\n  data-gen --seed 7 --vertices 20000 --out out/fine --cases 0\n  \
    experiments compare-rigs out/data/rig out/fine/rig")]
pub struct Arguments {
    /// Rig folders
    #[arg(value_name = "DIR", required = true)]
    rigs: Vec<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`] when a rig cannot be read.
pub fn run(a: &Arguments) -> Result<()> {
    let statistics = |folder: &PathBuf| -> Result<RigStatistics> {
        let (rig, _) = Rig::read(folder, &RigReadOptions::default()).map_err(Failure::loading)?;
        crate::check_millimetres(folder, rig.neutral()).map_err(Failure::loading)?;
        Ok(RigStatistics::of(&rig).map_err(|e| Failure::loading(format!("{}: {e}", folder.display())))?)
    };
    let all = a.rigs.iter().map(statistics).collect::<Result<Vec<_>>>()?;
    if a.json {
        say(format_args!("{:#}", serde_json::json!(all)))?;
        return Ok(());
    }
    let names: Vec<String> = a.rigs.iter().map(|f| f.display().to_string()).collect();
    let header: Vec<&str> = [""].into_iter().chain(names.iter().map(String::as_str)).collect();
    let columns: Vec<Vec<(String, String)>> = all.iter().map(RigStatistics::rows).collect();
    let longest = columns.iter().max_by_key(|c| c.len()).map_or(&[][..], |c| c);
    let rows = longest.iter().map(|(name, _)| {
        let cell = |c: &Vec<(String, String)>| c.iter().find(|r| r.0 == *name).map_or(String::new(), |r| r.1.clone());
        [name.clone()].into_iter().chain(columns.iter().map(cell)).collect()
    });
    say(table(&header, rows))?;
    Ok(())
}
