//! `silence`: how often a registration is wrong and does not say so, and how far its probability of error can be believed.
//!
//! Varied: what is wrong with scan, landmarks or rig ([`KINDS`]), person and expression. Held: each model's default schedule.
//! Measured: the error against the true vertices that the scan shows, and what the result says of itself.
//!
//! Two sets, apart in seeds, in people and in kinds. *Design*: the kinds marked so, seeds from `DESIGN_SEED`, the cases of a
//! folder at even places; the calibration is fitted on it and nothing else. *Test*: all kinds, seeds from `TEST_SEED`, the cases
//! at odd places; it is run to see what holds, never searched.

mod calibrate;
mod degradation;

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use nonrigid::console::{Failure, say};
use nonrigid::io::FilePlan;
use nonrigid::registration::{
    Handedness, ModelFactory, ModelKind, RegistrationInput, Reliability, Schedule, Silent, assess, register,
};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use crate::generated::{ScanOptions, Shot, Studio};
use crate::output::{each_once, make_output_folder};
use crate::scan_bench::{BenchCase, BenchRig, case_folders, read_schedule};
use crate::tables::{csv_field, table, write_csv, write_json};
use crate::unread;
pub use degradation::{KINDS, Kind, Trial};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  experiments silence --runs 2\n  \
    experiments silence --cases scanner-bench --rig ict-facekit/narrow\n  \
    experiments silence --set design --calibrate src/registration/reliability.toml")]
pub struct Arguments {
    /// Which set
    #[arg(long, value_enum, default_value_t = Set::Test)]
    set: Set,
    /// Runs of each kind on generated faces
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// A folder of cases with ground truth, each registered with every kind as well
    #[arg(long, value_name = "DIR", requires = "rig")]
    cases: Option<PathBuf>,
    /// Their rig
    #[arg(long, value_name = "DIR", requires = "cases")]
    rig: Option<PathBuf>,
    /// Runs of each kind on these cases
    #[arg(long, default_value_t = 8, requires = "cases", value_parser = clap::value_parser!(u32).range(1..=1000))]
    case_runs: u32,
    /// Kinds to run, by name [default: all of the set]
    #[arg(long, value_delimiter = ';', value_name = "A;B")]
    kinds: Vec<String>,
    /// Vertices of the generated template, about
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1000..=100_000))]
    vertices: u32,
    /// Schedule (.toml) of the hybrid instead of its default
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Fit the calibration on these runs, of the design set, and write it here: a new file, or one that this has written
    #[arg(long, value_name = "FILE")]
    calibrate: Option<PathBuf>,
    /// Where the tables go
    #[arg(long, value_name = "DIR", default_value = "out/silence")]
    out: PathBuf,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Which seeds, kinds and cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Set {
    /// What the calibration is fitted on
    Design,
    /// What it is judged by
    Test,
}

/// The tables.
const WRITTEN: [&str; 2] = ["silence.csv", "silence.json"];
/// Seeds of the two sets count from here.
const DESIGN_SEED: u64 = 10_000;
const TEST_SEED: u64 = 90_000;

/// Error above which a result is bad, millimetres.
pub const BAD: f64 = 3.0;

/// One registration.
#[derive(Debug, Clone, Serialize)]
pub struct SilenceRow {
    /// What is wrong.
    pub kind: &'static str,
    /// Whether the calibration may have seen the kind.
    pub design_kind: bool,
    /// Whether a refusal is a fault.
    pub solvable: bool,
    /// `generated`, or the name of a case.
    pub case: String,
    /// Seed of everything random.
    pub seed: u64,
    /// The model.
    pub model: String,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Root mean square error over the true vertices that the scan shows, millimetres; `None` where there is no result.
    pub rmse: Option<f64>,
    /// What the result says of itself.
    pub reliability: Option<Reliability>,
    /// Why there is no result.
    pub error: Option<String>,
}

/// What came of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Right, and no doubt.
    Good,
    /// Right, and doubted.
    GoodDoubted,
    /// Wrong, and it says so.
    BadDoubted,
    /// Wrong, and nothing tells.
    BadSilent,
    /// A mirrored scan, and the result says that nothing tells it from its mirror image.
    Undetermined,
    /// An error that says why.
    Refused,
}

const VERDICTS: [(Verdict, &str); 6] = [
    (Verdict::Good, "good"),
    (Verdict::GoodDoubted, "good, doubted"),
    (Verdict::BadDoubted, "bad, doubted"),
    (Verdict::BadSilent, "bad, silent"),
    (Verdict::Undetermined, "mirrored, said unknown"),
    (Verdict::Refused, "refused"),
];

impl Verdict {
    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        VERDICTS.iter().find(|v| v.0 == self).map_or("", |v| v.1)
    }
}

impl SilenceRow {
    /// What came of it.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let Some((rmse, reliability)) = self.rmse.zip(self.reliability.as_ref()) else { return Verdict::Refused };
        let unknown = matches!(reliability.evidence.handedness, Handedness::Unknown(_));
        match (rmse > BAD, reliability.is_doubtful()) {
            (true, _) if unknown && self.kind.starts_with("mirrored") => Verdict::Undetermined,
            (false, false) => Verdict::Good,
            (false, true) => Verdict::GoodDoubted,
            (true, true) => Verdict::BadDoubted,
            (true, false) => Verdict::BadSilent,
        }
    }
}

/// How many of some rows came to what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Results of at most [`BAD`], and those of them that are doubted.
    pub good: [usize; 2],
    /// Results of more, and those of them that are not doubted.
    pub bad: [usize; 2],
    /// Runs that can be solved, and those of them that were refused.
    pub solvable: [usize; 2],
}

impl Counts {
    /// Counts rows.
    #[must_use]
    pub fn of<'a>(rows: impl IntoIterator<Item = &'a SilenceRow>) -> Self {
        let mut counts = Self::default();
        for row in rows {
            let verdict = row.verdict();
            let is = |v: &[Verdict]| usize::from(v.contains(&verdict));
            counts.good[0] += is(&[Verdict::Good, Verdict::GoodDoubted]);
            counts.good[1] += is(&[Verdict::GoodDoubted]);
            counts.bad[0] += is(&[Verdict::BadDoubted, Verdict::BadSilent]);
            counts.bad[1] += is(&[Verdict::BadSilent]);
            counts.solvable[0] += usize::from(row.solvable);
            counts.solvable[1] += usize::from(row.solvable) * is(&[Verdict::Refused]);
        }
        counts
    }

    /// Shares of good results doubted, of bad ones silent, of solvable runs refused.
    #[must_use]
    pub fn shares(&self) -> [f64; 3] {
        let share = |[all, some]: [usize; 2]| some as f64 / all.max(1) as f64;
        [share(self.good), share(self.bad), share(self.solvable)]
    }
}

/// Where scans come from.
pub struct Sources {
    studio: Studio,
    cases: Vec<BenchCase>,
    /// Of the hybrid; other models have their defaults.
    schedule: Schedule,
}

impl Sources {
    /// Generated faces of about `vertices` vertices, and cases.
    ///
    /// # Errors
    /// When the rig cannot be made.
    pub fn new(vertices: usize, cases: Vec<BenchCase>) -> Result<Self> {
        Ok(Self { studio: Studio::new(vertices)?, cases, schedule: ModelKind::Hybrid.schedule()? })
    }

    fn person(&self, seed: u64, known: bool) -> Result<BenchCase> {
        let scan = ScanOptions { triangles: 20_000, ..ScanOptions::default() };
        let known = known || seed.is_multiple_of(3);
        self.studio.shoot(&Shot { name: "generated".into(), scan, known, withheld: Vec::new(), seed })
    }

    /// The case of a job.
    fn case(&self, job: &Job) -> Result<BenchCase> {
        job.case.map_or_else(|| self.person(job.seed, false), |k| Ok(self.cases[k].clone()))
    }

    /// Another person's case than that of a job; one whose neutral is `known`, if there is one.
    fn other(&self, job: &Job, known: bool) -> Result<BenchCase> {
        let Some(place) = job.case else { return self.person(job.seed + 500_000, known) };
        let next = |k: usize| &self.cases[(place + k) % self.cases.len()];
        let fits = (1..self.cases.len()).map(next).find(|case| !known || case.neutral.is_some());
        Ok(fits.unwrap_or(next(1)).clone())
    }
}

/// One registration to be run.
#[derive(Debug, Clone, Copy)]
pub struct Job {
    /// What is wrong.
    pub kind: &'static Kind,
    case: Option<usize>,
    seed: u64,
}

impl std::fmt::Debug for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// The registrations of a set: `runs` of each kind on generated faces, `case_runs` on the cases.
#[must_use]
pub fn jobs(set: Set, runs: u64, cases: usize, case_runs: u64) -> Vec<Job> {
    let first = if set == Set::Design { DESIGN_SEED } else { TEST_SEED };
    let of_set = |k: &usize| k % 2 == usize::from(set == Set::Test);
    let places: Vec<usize> = (0..cases).filter(of_set).collect();
    let kinds = KINDS.iter().enumerate().filter(|(_, kind)| set == Set::Test || kind.design);
    let mut jobs = Vec::new();
    for (k, kind) in kinds {
        let seed = first + 100 * k as u64;
        jobs.extend((0..runs).map(|run| Job { kind, case: None, seed: seed + run }));
        let on_case = |run: u64| Job { kind, case: Some(places[run as usize % places.len()]), seed: seed + 50 + run };
        jobs.extend((0..if places.is_empty() { 0 } else { case_runs }).map(on_case));
    }
    jobs
}

/// So many registrations of the test set on generated faces: all kinds in turn, or some of them spread over all.
#[must_use]
pub fn some_jobs(count: usize) -> Vec<Job> {
    let rounds = count.div_ceil(KINDS.len());
    let all = jobs(Set::Test, rounds as u64, 0, 0);
    // Round by round: the first run of every kind, then the second.
    let by_round: Vec<Job> = (0..rounds).flat_map(|round| all.iter().skip(round).step_by(rounds).copied()).collect();
    let step = (by_round.len() as f64 / count as f64).max(1.0);
    (0..count).map(|k| by_round[(k as f64 * step) as usize]).collect()
}

/// Does one.
///
/// # Errors
/// When a scan cannot be made.
pub fn run_job(sources: &Sources, job: &Job) -> Result<SilenceRow> {
    let other = |known| sources.other(job, known);
    let mut rng = ChaCha8Rng::seed_from_u64(job.seed);
    // Three of ten have few landmarks, two none.
    let few: f64 = rng.random();
    let every = rng.random_range(3..8);
    let mut trial = Trial { case: sources.case(job)?, model: ModelKind::Hybrid, other: &other, rng };
    if few < 0.2 {
        trial.case.landmarks.clear();
    } else if few < 0.5 {
        trial.case.landmarks = trial.case.landmarks.into_iter().step_by(every).collect();
    }
    (job.kind.apply)(&mut trial).with_context(|| job.kind.name)?;
    let input: RegistrationInput<'_> = trial.case.input();
    let mut row = SilenceRow {
        kind: job.kind.name,
        design_kind: job.kind.design,
        solvable: job.kind.solvable,
        case: trial.case.name.clone(),
        seed: job.seed,
        model: trial.model.name().to_owned(),
        landmarks: input.landmarks.len(),
        rmse: None,
        reliability: None,
        error: None,
    };
    let schedule = match trial.model {
        ModelKind::Hybrid => sources.schedule.clone(),
        other => other.schedule()?,
    };
    match register(&input, &trial.model, &schedule, &mut Silent) {
        Ok(result) => {
            row.reliability = Some(assess(&input, &result)?.1);
            row.rmse = Some(trial.case.score(&result.positions)?.0.rmse);
        }
        Err(e) => row.error = Some(e.to_string()),
    }
    Ok(row)
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`] of loading or writing, or when a scan cannot be made.
pub fn run(a: &Arguments) -> Result<()> {
    let cases = match (&a.cases, &a.rig) {
        (Some(folder), Some(rig)) => {
            let rig = BenchRig::read(rig).map_err(unread)?;
            let read = |f: &PathBuf| BenchCase::read(f, &rig);
            let folders = case_folders(folder).map_err(unread)?;
            folders.iter().map(read).collect::<Result<_>>().map_err(unread)?
        }
        _ => Vec::new(),
    };
    for name in &a.kinds {
        if !KINDS.iter().any(|kind| kind.name == name) {
            let names = KINDS.map(|kind| kind.name).join("; ");
            let message = format!("--kinds: no kind {name:?}; there are {names}");
            return Err(Failure::new(nonrigid::console::Stage::Arguments, message).into());
        }
    }
    each_once("--kinds", &a.kinds)?;
    let mut jobs = jobs(a.set, u64::from(a.runs), cases.len(), u64::from(a.case_runs));
    jobs.retain(|job| a.kinds.is_empty() || a.kinds.iter().any(|name| name == job.kind.name));
    let given = [("--cases", &a.cases), ("--rig", &a.rig), ("--config", &a.config)];
    let reads = given.into_iter().filter_map(|(option, path)| Some((option, path.as_ref()?)));
    if let Some(path) = &a.calibrate {
        let plan = FilePlan::new().reads_all(reads.clone());
        let plan = plan.writes_all(WRITTEN.map(|name| ("--out", a.out.join(name)))).writes("--calibrate", path);
        calibrate::check(path, &plan, a.set, jobs.len())?;
    }
    make_output_folder(&a.out, reads, &[])?;
    let mut sources = Sources::new(a.vertices as usize, cases)?;
    if let Some(path) = &a.config {
        sources.schedule = read_schedule(path)?;
    }
    let rows: Result<Vec<SilenceRow>> = jobs.par_iter().with_max_len(1).map(|job| run_job(&sources, job)).collect();
    let rows = rows?;
    write(a, &rows)?;
    say(summary(&rows))?;
    say(totals(&rows))?;
    say(table(
        &["mean probability", "share of bad results", "results"],
        diagram(&rows).into_iter().map(|(p, bad, n)| vec![format!("{p:.3}"), format!("{bad:.3}"), n.to_string()]),
    ))?;
    say(format_args!("bad: more than {BAD} mm; silence.csv and silence.json are in {}", a.out.display()))?;
    if let Some(path) = &a.calibrate {
        calibrate::write(path, &rows)?;
        say(format_args!("wrote {}; it takes effect when the library is built again", path.display()))?;
    }
    Ok(())
}

fn write(a: &Arguments, rows: &[SilenceRow]) -> Result<()> {
    let header = "kind,design_kind,solvable,case,seed,model,landmarks,verdict,rmse,probability,doubts,error";
    let number = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:.6}"));
    let lines = rows.iter().map(|r| {
        let doubts: Vec<&str> = r.reliability.iter().flat_map(|r| r.doubts.iter().map(|d| d.name())).collect();
        let cells = [
            csv_field(r.kind),
            r.design_kind.to_string(),
            r.solvable.to_string(),
            csv_field(&r.case),
            r.seed.to_string(),
            r.model.clone(),
            r.landmarks.to_string(),
            csv_field(r.verdict().name()),
            number(r.rmse),
            number(r.reliability.as_ref().map(|r| r.probability)),
            doubts.join(" "),
            csv_field(r.error.as_deref().unwrap_or_default()),
        ];
        cells.join(",")
    });
    let [csv, json] = WRITTEN.map(|name| a.out.join(name));
    write_csv(&csv, header, lines)?;
    write_json(&json, &serde_json::json!({ "set": a.set, "rows": rows }))
}

/// Mean probability and share of bad results in each band of the probability, with how many results it holds: what a calibrated
/// probability makes equal.
#[must_use]
pub fn diagram(rows: &[SilenceRow]) -> Vec<(f64, f64, usize)> {
    let results: Vec<(f64, bool)> =
        rows.iter().filter_map(|r| Some((r.reliability.as_ref()?.probability, r.rmse? > BAD))).collect();
    let band = |ends: [f64; 2]| {
        let of: Vec<_> = results.iter().filter(|r| (ends[0]..ends[1]).contains(&r.0)).collect();
        let count = of.len() as f64;
        let bad = of.iter().filter(|r| r.1).count() as f64;
        (of.iter().map(|r| r.0).sum::<f64>() / count, bad / count, of.len())
    };
    let bands = [[0.0, 0.02], [0.02, 0.1], [0.1, 0.3], [0.3, 0.6], [0.6, 0.9], [0.9, 1.01]];
    bands.map(band).into_iter().filter(|b| b.2 > 0).collect()
}

/// A row for each kind: how many came to what.
fn summary(rows: &[SilenceRow]) -> comfy_table::Table {
    let header: Vec<&str> =
        ["kind", "kept apart"].into_iter().chain(VERDICTS.map(|v| v.1)).chain(["rmse / mm"]).collect();
    let of_kind = |kind: &&Kind| rows.iter().any(|r| r.kind == kind.name);
    table(
        &header,
        KINDS.iter().filter(of_kind).map(|kind| {
            let of: Vec<&SilenceRow> = rows.iter().filter(|r| r.kind == kind.name).collect();
            let mut cells = vec![kind.name.to_owned(), if kind.design { "" } else { "yes" }.to_owned()];
            cells.extend(VERDICTS.map(|(v, _)| match of.iter().filter(|r| r.verdict() == v).count() {
                0 => String::new(),
                n => n.to_string(),
            }));
            let mut errors: Vec<f64> = of.iter().filter_map(|r| r.rmse).collect();
            errors.sort_by(f64::total_cmp);
            let ends = errors.first().zip(errors.last()).map(|(a, b)| format!("{a:.1} to {b:.1}"));
            cells.push(ends.unwrap_or_default());
            cells
        }),
    )
}

/// The three shares, of all rows, of the kinds that the calibration has seen, and of the others.
fn totals(rows: &[SilenceRow]) -> comfy_table::Table {
    let groups = [("all", &[true, false][..]), ("kinds of the design", &[true]), ("kinds kept apart", &[false])];
    table(
        &["", "runs", "bad, silent", "good, doubted", "solvable, refused"],
        groups.into_iter().map(|(name, of)| {
            let rows: Vec<&SilenceRow> = rows.iter().filter(|r| of.contains(&r.design_kind)).collect();
            let counts = Counts::of(rows.iter().copied());
            let share =
                |[all, some]: [usize; 2]| format!("{some} of {all} ({:.1} %)", 100.0 * some as f64 / all.max(1) as f64);
            let shares = [counts.bad, counts.good, counts.solvable].map(share);
            [name.to_owned(), rows.len().to_string()].into_iter().chain(shares).collect()
        }),
    )
}
