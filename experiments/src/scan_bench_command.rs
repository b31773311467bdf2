//! `scan-bench` on the command line: what it reads, writes and prints.

use std::fs;
use std::path::PathBuf;

use anyhow::Result;
use nonrigid::console::{Failure, say, tell};
use nonrigid::mesh::io::write_polygon_mesh;
use nonrigid::registration::{ModelFactory, ModelKind, Schedule, TermFactory, TermKind};

use crate::output::make_output_folder;
use crate::random_pose::{finite, random_pose};
use crate::scan_bench::{BenchCase, BenchRig, LandmarkUse, Scheduled, scan_bench, summarize};
use crate::tables::{summary_table, table_of, write_tables};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    experiments scan-bench out/data/cases --rig out/data/rig\n  \
    experiments scan-bench out/data/cases --rig out/data/rig --models hybrid,arap --landmarks none --out out/hybrid-and-arap")]
pub struct Arguments {
    /// Folder of cases
    #[arg(value_name = "DIR")]
    cases: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Where results, tables and timings go
    #[arg(long, value_name = "DIR", default_value = "out/scan-bench")]
    out: PathBuf,
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = ModelKind::ALL, value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// Schedule (.toml) for every model instead of its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Landmarks: all, align (for the start only), none (the start is searched), or how many
    #[arg(long, default_value = "all", value_parser = str::parse::<LandmarkUse>)]
    landmarks: LandmarkUse,
    /// Turn every scan by this many degrees about a random axis
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, value_parser = finite, allow_negative_numbers = true)]
    turn: f64,
    /// Move every scan by this many millimetres in a random direction
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = finite, allow_negative_numbers = true)]
    shift: f64,
    /// Use each scan's dual mesh: the same surface without its vertices, which may be the template's own, displaced
    #[arg(long)]
    remesh: bool,
    /// Seed of the random poses
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`] when something cannot be read or written; anything else is a failed registration.
pub fn run(a: &Arguments) -> Result<()> {
    let reads =
        [("DIR", &a.cases), ("--rig", &a.rig)].into_iter().chain(a.config.iter().map(|path| ("--config", path)));
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    let rig = BenchRig::read(&a.rig).map_err(unread)?;
    let mut cases = BenchCase::read_all(&a.cases, &rig).map_err(unread)?;
    if a.remesh {
        cases = cases.into_iter().map(BenchCase::remeshed).collect();
    }
    if a.turn != 0.0 || a.shift != 0.0 {
        say(format_args!("every scan turned by {} degrees and moved by {} mm, seed {}", a.turn, a.shift, a.seed))?;
        let moved = |(i, case): (usize, BenchCase)| case.moved(&random_pose(a.turn, a.shift, a.seed, i as u64));
        cases = cases.into_iter().enumerate().map(moved).collect();
    }
    say(format_args!("{} cases x {} models, {} threads", cases.len(), a.models.len(), rayon::current_num_threads()))?;
    let scheduled = a.models.iter().map(|model| {
        let schedule = match &a.config {
            None => model.schedule()?,
            Some(path) => {
                let unread = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
                let text = fs::read_to_string(path).map_err(|e| unread(&e))?;
                Schedule::from_toml(&text).map_err(|e| unread(&e))?
            }
        };
        Ok(Scheduled { model, schedule })
    });
    let scheduled: Vec<Scheduled<'_>> = scheduled.collect::<Result<_>>()?;
    make_output_folder(&a.out, reads)?;
    let models: Vec<&dyn ModelFactory> = scheduled.iter().map(|m| m as &dyn ModelFactory).collect();
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let rows = scan_bench(&models, &terms, &cases, a.landmarks, |row, case, result| {
        let folder = a.out.join(&row.case);
        fs::create_dir_all(&folder).map_err(|e| Failure::writing(format!("{}: {e}", folder.display())))?;
        let mesh = case.template.with_positions(result.positions.clone());
        write_polygon_mesh(&folder.join(format!("{}.obj", row.model)), &mesh).map_err(Failure::writing)?;
        tell(format_args!("{:16} {:12} rmse {:.3} mm  {:.2} s", row.case, row.model, row.errors.rmse, row.seconds));
        Ok(())
    })?;
    let json = serde_json::json!({ "rows": rows, "summary": summarize(&rows) });
    write_tables(&a.out, "scan-bench", &rows, &json)?;
    say(table_of(&rows))?;
    say(summary_table(&rows))?;
    say(format_args!("results, scan-bench.csv and scan-bench.json are in {}", a.out.display()))?;
    Ok(())
}
