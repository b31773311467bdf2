//! Runs of one variant over all cases in a process of its own, so that its memory is its own. The process prints a line of JSON
//! as it finishes a case; where it ends before its time, that case has failed and another process goes on with the next.

use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use anyhow::{Context, Result, bail};
use nonrigid::console::{Failure, Stage, told};
use nonrigid::registration::TERMS;
use serde::{Deserialize, Serialize};

use super::{BenchCase, BenchRig, BenchRow, Score, Variant, case_folders, run_case};
use crate::output::write_result;
use crate::process::Process;
use crate::random_pose::random_pose;
use crate::scaling::{peak_bytes, reset_peak};
use crate::unread;

/// Cases in a folder, and what is done to their scans.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CaseSource {
    /// Folder of cases.
    pub cases: PathBuf,
    /// Rig folder; its polygons are the template.
    pub rig: PathBuf,
    /// Degrees that each scan is turned by about a random axis.
    pub turn: f64,
    /// Millimetres that it is moved by in a random direction.
    pub shift: f64,
    /// Seed of both.
    pub seed: u64,
}

impl CaseSource {
    /// The cases as they are.
    #[must_use]
    pub fn new(cases: &Path, rig: &Path) -> Self {
        Self { cases: cases.into(), rig: rig.into(), turn: 0.0, shift: 0.0, seed: 7 }
    }

    /// Reads all cases; no two have the same name.
    ///
    /// # Errors
    /// A [`Failure`] of loading.
    pub fn read(&self) -> Result<Vec<BenchCase>> {
        let read = || self.from(0)?.collect::<Result<Vec<BenchCase>>>();
        let read = read().map_err(unread)?;
        for (i, case) in read.iter().enumerate() {
            if read[..i].iter().any(|other| other.name == case.name) {
                let message = format!("{}: two cases are called {:?}; rename one", self.cases.display(), case.name);
                return Err(Failure::loading(message).into());
            }
        }
        Ok(read)
    }

    /// The cases from the `first`, each read when its turn comes.
    fn from(&self, first: usize) -> Result<impl Iterator<Item = Result<BenchCase>>> {
        let rig = BenchRig::read(&self.rig)?;
        let folders = case_folders(&self.cases)?.into_iter().enumerate().skip(first);
        Ok(folders.map(move |(k, folder)| {
            let case = BenchCase::read(&folder, &rig)?;
            let still = self.turn == 0.0 && self.shift == 0.0;
            Ok(if still { case } else { case.moved(&random_pose(self.turn, self.shift, self.seed, k as u64)) })
        }))
    }
}

/// Runs every variant on every case of `source`, each variant in a process of its own, one after the other, on so many threads.
/// `program` is the `experiments` whose processes they are; results go to `results/CASE/NAME.obj`, whose folders are there.
/// `on_row` sees each row as it arrives and ends everything with an error.
///
/// # Errors
/// A [`Failure`]: of loading when rig or cases cannot be read; of the computation when no process can be started or every run
/// fails. The run that fails beside others says so in its row. Whatever `on_row` returns.
pub fn measure(
    program: &Path,
    source: &CaseSource,
    variants: &[Variant],
    threads: usize,
    results: Option<&Path>,
    on_row: &mut dyn FnMut(&BenchRow) -> Result<()>,
) -> Result<Vec<BenchRow>> {
    let names = source.read()?.into_iter().map(|case| case.name).collect::<Vec<_>>();
    let mut rows = Vec::with_capacity(variants.len() * names.len());
    for variant in variants {
        let mut first = 0;
        while first < names.len() {
            let run =
                Run { source: source.clone(), first, variant: variant.clone(), results: results.map(Path::to_owned) };
            run_apart(program, &run, threads, &names[first..], &mut |row| {
                on_row(&row)?;
                rows.push(row);
                first += 1;
                Ok(())
            })?;
        }
    }
    if let Some(row) = rows.first().filter(|_| rows.iter().all(|r| r.score.is_none())) {
        let reason = row.error.as_deref().unwrap_or_default();
        let message = format!("every run failed; the first, {} {} on {}: {reason}", row.group, row.model, row.case);
        return Err(Failure::computation(message).into());
    }
    Ok(rows)
}

/// What a process is told to do: the variant on all cases from the `first`.
#[derive(Serialize, Deserialize)]
struct Run {
    source: CaseSource,
    first: usize,
    variant: Variant,
    results: Option<PathBuf>,
}

/// What it says of a case.
#[derive(Serialize, Deserialize)]
struct Line {
    row: BenchRow,
    seconds: Option<f64>,
    peak_bytes: Option<u64>,
}

/// Runs in this process what `configuration` says, one line a case on standard output.
///
/// # Errors
/// When the configuration, the rig or a case cannot be read, or nobody reads the lines. A registration that fails is a line.
pub(super) fn run_here(configuration: &str) -> Result<()> {
    let run: Run =
        read_line(configuration).map_err(|e| Failure::new(Stage::Arguments, format!("--run: {}", told(&e))))?;
    let mut out = io::stdout().lock();
    for case in run.source.from(run.first)? {
        let line = run.variant.run(&case?, run.results.as_deref());
        writeln!(out, "{}", serde_json::to_string(&line)?).and_then(|()| out.flush()).context("standard output")?;
    }
    Ok(())
}

impl Variant {
    fn run(&self, case: &BenchCase, results: Option<&Path>) -> Line {
        let (mut seconds, mut peak) = (None, None);
        let mut fit = || -> Result<Score> {
            reset_peak();
            let (score, result, wall) = run_case(&self.model, &TERMS, &self.schedule, case, self.landmarks)?;
            (seconds, peak) = (Some(wall), peak_bytes());
            if !score.errors.finite {
                bail!("the result is not finite");
            }
            if let Some(results) = results {
                let path = results.join(&case.name).join(format!("{}.obj", self.file_stem()));
                write_result(&path, &case.template, result.positions)?;
            }
            Ok(score)
        };
        let row = BenchRow::new(&self.group, &self.name, &case.name, fit().map_err(|e| told(&e)));
        Line { row, seconds, peak_bytes: peak }
    }
}

/// Runs a variant on the cases `names` in a process of its own, at least on the first of them: what ends it early is that case's
/// row, the last one.
fn run_apart(
    program: &Path,
    run: &Run,
    threads: usize,
    names: &[String],
    on_row: &mut dyn FnMut(BenchRow) -> Result<()>,
) -> Result<()> {
    let failed = |what: String| Failure::computation(format!("{}: {what}", program.display()));
    let mut command = Command::new(program);
    command.args(["scan-bench", "--threads", &threads.to_string(), "--run", &serde_json::to_string(run)?]);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = Process(command.spawn().map_err(|e| failed(format!("cannot be started: {e}")))?);
    let (Some(out), Some(mut err)) = (process.0.stdout.take(), process.0.stderr.take()) else {
        return Err(failed("has no output".to_owned()).into());
    };
    // Read beside the lines: a process whose standard error is full would wait for ever.
    let said = thread::spawn(move || {
        let mut said = Vec::new();
        err.read_to_end(&mut said).map(|_| said)
    });
    let mut lines = BufReader::new(out).lines();
    for name in names {
        let reason = match lines.next().map(|line| line.context("its output").and_then(|line| read_line(&line))) {
            Some(Ok(Line { row, seconds, peak_bytes })) if row.case == *name => {
                on_row(BenchRow { seconds, peak_bytes, ..row })?;
                continue;
            }
            Some(Ok(line)) => format!("another case came, {:?}: have the cases changed meanwhile?", line.row.case),
            Some(Err(e)) => told(&e),
            None => {
                let status = process.0.wait().context("the process' end")?;
                let said = said.join().map_or_else(|_| Vec::new(), Result::unwrap_or_default);
                let said = String::from_utf8_lossy(&said);
                let words: Vec<&str> = said.trim_start_matches("error: ").split_whitespace().collect();
                format!("the process ended early ({status}) {}", words.join(" ")).trim_end().to_owned()
            }
        };
        return on_row(BenchRow::new(&run.variant.group, &run.variant.name, name, Err(reason)));
    }
    Ok(())
}

/// What this program wrote as JSON, whose numbers come back bit for bit.
fn read_line<'a, T: Deserialize<'a>>(text: &'a str) -> Result<T> {
    serde_json::from_str(text).with_context(|| format!("not a line of this program: {text:.80}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_bit_for_bit() {
        let mut variant = Variant::of_model(nonrigid::registration::ModelKind::Sequential).unwrap();
        // A decimal of 17 digits, a power of ten beyond the exact ones, the least number, negative zero.
        variant.schedule.reference_size = 67.000_000_000_000_01 / 3.0;
        variant.schedule.levels[0].model.set("lambda_blend", 1.234_567_890_123_456_7e-200);
        variant.schedule.levels[1].model.set("lambda_blend", 5e-324);
        variant.schedule.levels[2].model.set("lambda_blend", -0.0);
        let text = serde_json::to_string(&variant).unwrap();
        let back: Variant = read_line(&text).unwrap();
        assert_eq!(back, variant);
        assert!(back.schedule.levels[2].model.number("lambda_blend").unwrap().is_sign_negative());
        assert_eq!(text.lines().count(), 1);
        let error = read_line::<Variant>("thread panicked").unwrap_err();
        assert!(error.to_string().contains("thread panicked"), "{error}");
    }
}
