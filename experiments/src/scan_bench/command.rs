//! `scan-bench` on the command line: what it reads, writes and prints.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::registration::{ModelKind, Schedule};

use super::measure::run_here;
use super::{
    BenchRow, CaseSource, External, LandmarkUse, Variant, measure, megabytes, summarize, summary_table, table_of,
    write_rows,
};
use crate::output::{each_once, make_folder, make_output_folder};
use crate::random_pose::finite;
use crate::this_program;

/// Models to run.
#[derive(Debug, Clone)]
struct Models(Vec<ModelKind>);

impl std::str::FromStr for Models {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self(ModelKind::ALL.to_vec())),
            "none" => Ok(Self(Vec::new())),
            list => list.split(',').map(str::parse).collect::<Result<_, _>>().map(Self),
        }
    }
}

/// What to run.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "experiments scan-bench [OPTIONS] --rig <DIR> <DIR>",
    after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes: in the last, DIR is where another program's results are\n  \
    experiments scan-bench out/data/cases --rig out/data/rig\n  \
    experiments scan-bench out/data/cases --rig out/data/rig --models hybrid,arap --landmarks none --out out/hybrid-and-arap\n  \
    experiments scan-bench out/data/cases --rig out/data/rig --kernels --terms --external other=DIR"
)]
pub struct Arguments {
    /// Folder of cases, or of one
    #[arg(value_name = "DIR", required_unless_present = "run")]
    cases: Option<PathBuf>,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR", required_unless_present = "run")]
    rig: Option<PathBuf>,
    /// Where results, tables and timings go
    #[arg(long, value_name = "DIR", default_value = "out/scan-bench")]
    out: PathBuf,
    /// Models with their default schedules: all, none, or names separated by commas
    #[arg(long, value_name = "LIST", default_value = "all")]
    models: Models,
    /// Schedule (.toml) for every model instead of its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The hybrid with each robust kernel, too
    #[arg(long)]
    kernels: bool,
    /// The hybrid with other data terms and without some, too
    #[arg(long)]
    terms: bool,
    /// Another program's results, too: for each case DIR/CASE.obj, .ply or .npy, or DIR/CASE/result.obj, .ply or .npy, in the
    /// template's vertex order and the scan's frame
    #[arg(long, value_name = "NAME=DIR", value_parser = str::parse::<External>)]
    external: Vec<External>,
    /// Landmarks: all, align (for the start only), none (the start is searched), or how many
    #[arg(long, default_value = "all", value_parser = str::parse::<LandmarkUse>)]
    landmarks: LandmarkUse,
    /// Turn every scan by this many degrees about a random axis
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, value_parser = finite, allow_negative_numbers = true)]
    turn: f64,
    /// Move every scan by this many millimetres in a random direction
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = finite, allow_negative_numbers = true)]
    shift: f64,
    /// Seed of the random poses
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Run this variant here and print its lines
    #[arg(long, hide = true, value_name = "JSON")]
    run: Option<String>,
}

impl Arguments {
    fn variants(&self) -> Result<Vec<Variant>> {
        let mut variants = Variant::models(&self.models.0)?;
        if let Some(path) = &self.config {
            let schedule = read_schedule(path)?;
            variants.iter_mut().for_each(|v| v.schedule = schedule.clone());
        }
        if self.kernels {
            variants.extend(Variant::kernels()?);
        }
        if self.terms {
            variants.extend(Variant::terms()?);
        }
        variants.iter_mut().for_each(|v| v.landmarks = self.landmarks);
        Ok(variants)
    }

    /// What is wrong with the options, if anything.
    fn check(&self) -> Result<(), Failure> {
        let models = &self.models.0;
        each_once("--models", models)?;
        each_once("--external", &self.external.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        if models.is_empty() && !self.kernels && !self.terms && self.external.is_empty() {
            let message = "--models none without --kernels, --terms or --external leaves nothing to run";
            return Err(Failure::new(Stage::Arguments, message));
        }
        if models.is_empty() && self.config.is_some() {
            let message = "--config: has no effect with --models none; leave one of them out";
            return Err(Failure::new(Stage::Arguments, message));
        }
        Ok(())
    }
}

/// Reads a schedule.
///
/// # Errors
/// A [`Failure`] of loading.
pub fn read_schedule(path: &Path) -> Result<Schedule> {
    let unread = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
    let text = fs::read_to_string(path).map_err(|e| unread(&e))?;
    Ok(Schedule::from_toml(&text).map_err(|e| unread(&e))?)
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`]: of the arguments; of loading when rig, cases, a schedule or an external folder cannot be read; of writing; of the
/// computation when every run failed.
pub fn run(a: &Arguments) -> Result<()> {
    if let Some(configuration) = &a.run {
        return run_here(configuration);
    }
    let (Some(folder), Some(rig)) = (&a.cases, &a.rig) else {
        return Err(Failure::new(Stage::Arguments, "DIR and --rig are needed").into());
    };
    a.check()?;
    let source = CaseSource { turn: a.turn, shift: a.shift, seed: a.seed, ..CaseSource::new(folder, rig) };
    let cases = source.read()?;
    if let LandmarkUse::Some(asked) = a.landmarks
        && let Some(case) = cases.iter().find(|case| case.landmarks.len() < asked)
    {
        let message = format!("--landmarks {asked}: {} has {}; give fewer, or all", case.name, case.landmarks.len());
        return Err(Failure::new(Stage::Arguments, message).into());
    }
    let variants = a.variants()?;
    let external = a.external.iter().map(|e| e.rows(&cases)).collect::<Result<Vec<_>>>()?.concat();
    let reads = [("DIR", folder), ("--rig", rig)].into_iter().chain(a.config.iter().map(|path| ("--config", path)));
    let of_cases = cases.iter().filter(|_| !variants.is_empty()).map(|case| case.name.clone());
    let folders: Vec<String> = of_cases.collect();
    make_output_folder(&a.out, reads, &folders)?;
    folders.iter().try_for_each(|folder| make_folder(&a.out.join(folder)))?;
    if a.turn != 0.0 || a.shift != 0.0 {
        say(format_args!("every scan turned by {} degrees and moved by {} mm, seed {}", a.turn, a.shift, a.seed))?;
    }
    let (threads, total) = (rayon::current_num_threads(), variants.len() * cases.len() + external.len());
    say(format_args!("{} cases x {} variants, {threads} threads", cases.len(), variants.len() + a.external.len()))?;
    drop(cases); // the processes have their own
    let mut done = 0;
    let mut progress = |row: &BenchRow| {
        done += 1;
        let outcome = match (&row.score, &row.error) {
            (Some(score), _) => format!("rmse {:.3} mm", score.errors.rmse),
            (None, error) => format!("failed: {}", error.as_deref().unwrap_or_default()),
        };
        let cost = [
            row.seconds.map(|s| format!("  {s:.2} s")),
            row.peak_bytes.map(|bytes| format!("  {:.0} MB", megabytes(bytes))),
        ];
        let cost = cost.into_iter().flatten().collect::<String>();
        tell(format_args!("{done}/{total}  {:8} {:20} {:16} {outcome}{cost}", row.group, row.model, row.case));
        Ok(())
    };
    let mut rows = measure(&this_program()?, &source, &variants, threads, Some(&a.out), &mut progress)?;
    external.iter().try_for_each(progress)?;
    rows.extend(external);
    write_rows(&a.out, "scan-bench", &rows, threads)?;
    say(table_of(&rows))?;
    say(summary_table(&summarize(&rows)))?;
    say(format_args!("results, scan-bench.csv and scan-bench.json are in {}", a.out.display()))?;
    Ok(())
}
