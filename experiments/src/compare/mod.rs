//! `compare`: everything that can be chosen, and other programs, on cases with exact dense ground truth, in one table.
//!
//! Varied, one thing in each group: the model with its default schedule; the robust kernel of the hybrid; its data terms; the
//! program (`--external`). Held: the cases, their shapes and landmarks. Measured: what [`scan_bench`](crate::scan_bench) measures,
//! apart from it seconds and memory, each variant in a process of its own.

use std::path::PathBuf;

use anyhow::Result;
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::registration::ModelKind;

use crate::output::make_output_folder;
use crate::scan_bench::LandmarkUse;
use crate::this_program;

mod external;
mod measure;
mod row;
mod variant;

pub use external::External;
pub use measure::measure;
pub use row::{CompareRow, CompareSummary, Score, summarize, summary_table, write_rows};
pub use variant::Variant;

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

/// What to compare.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "experiments compare [OPTIONS] --rig <DIR> <DIR>",
    after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes: in the second, DIR is where another program's results are\n  \
    experiments compare out/data/cases --rig out/data/rig --models hybrid,arap\n  \
    experiments compare out/data/cases --rig out/data/rig --kernels --terms --external other=DIR"
)]
pub struct Arguments {
    /// Folder of cases
    #[arg(value_name = "DIR", required_unless_present = "run")]
    cases: Option<PathBuf>,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR", required_unless_present = "run")]
    rig: Option<PathBuf>,
    /// Models with their default schedules: all, none, or names separated by commas
    #[arg(long, value_name = "LIST", default_value = "all")]
    models: Models,
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
    /// Where the tables go
    #[arg(long, value_name = "DIR", default_value = "out/compare")]
    out: PathBuf,
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
    fn check(&self, variants: &[Variant]) -> Result<(), Failure> {
        let wrong = |what: String| Err(Failure::new(Stage::Arguments, what));
        for (i, variant) in variants.iter().enumerate() {
            if variants[..i].iter().any(|v| (&v.group, &v.name) == (&variant.group, &variant.name)) {
                return wrong(format!("--models names {} twice", variant.name));
            }
        }
        for (i, external) in self.external.iter().enumerate() {
            if self.external[..i].iter().any(|e| e.name == external.name) {
                return wrong(format!("--external names {} twice", external.name));
            }
        }
        if variants.is_empty() && self.external.is_empty() {
            return wrong(
                "--models none without --kernels, --terms or --external leaves nothing to compare".to_owned(),
            );
        }
        Ok(())
    }
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`]: of the arguments; of loading when rig, cases or an external folder cannot be read; of writing; of the
/// computation when every run failed.
pub fn run(a: &Arguments) -> Result<()> {
    if let Some(configuration) = &a.run {
        return measure::run_here(configuration);
    }
    let (Some(folder), Some(rig)) = (&a.cases, &a.rig) else {
        return Err(Failure::new(Stage::Arguments, "DIR and --rig are needed").into());
    };
    let variants = a.variants()?;
    a.check(&variants)?;
    let cases = measure::read_cases(folder, rig)?;
    let external = a.external.iter().map(|e| e.rows(&cases)).collect::<Result<Vec<_>>>()?.concat();
    make_output_folder(&a.out, [("DIR", folder), ("--rig", rig)])?;
    let (threads, total) = (rayon::current_num_threads(), variants.len() * cases.len() + external.len());
    drop(cases); // the processes have their own
    let mut done = 0;
    let mut progress = |row: &CompareRow| {
        done += 1;
        let outcome = match (&row.score, &row.error) {
            (Some(score), _) => format!("rmse {:.3} mm", score.errors.rmse),
            (None, error) => format!("failed: {}", error.as_deref().unwrap_or_default()),
        };
        let cost = [
            row.seconds.map(|s| format!("  {s:.2} s")),
            row.peak_bytes.map(|bytes| format!("  {:.0} MB", row::megabytes(bytes))),
        ];
        let cost = cost.into_iter().flatten().collect::<String>();
        tell(format_args!("{done}/{total}  {:8} {:20} {:16} {outcome}{cost}", row.group, row.name, row.case));
        Ok(())
    };
    let program = this_program()?;
    let mut rows = measure(&program, folder, rig, &variants, threads, &mut progress)?;
    external.iter().try_for_each(progress)?;
    rows.extend(external);
    write_rows(&a.out, &rows, threads)?;
    say(summary_table(&summarize(&rows)))?;
    say(format_args!("compare.csv, compare.json and compare.timing.csv are in {}", a.out.display()))?;
    Ok(())
}
