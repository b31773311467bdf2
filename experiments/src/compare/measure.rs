//! Runs of one variant over all cases in a process of its own, so that its memory is its own. The process prints a line of JSON
//! as it finishes a case; where it ends before its time, that case has failed and another process goes on with the next.

use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;

use anyhow::{Context, Result, bail};
use nonrigid::console::{Failure, Stage};
use nonrigid::registration::{TermFactory, TermKind};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::row::{CompareRow, Score};
use super::variant::Variant;
use crate::scaling::{peak_bytes, reset_peak};
use crate::scan_bench::{BenchCase, BenchRig, case_folders, fit_case, vertex_coincidence};

/// Runs every variant on every case below `cases`, each variant in a process of its own, one after the other, on so many threads.
/// `program` is the `experiments` whose processes they are. `on_row` sees each row as it arrives and ends everything with an error.
///
/// # Errors
/// A [`Failure`]: of loading when rig or cases cannot be read; of the computation when no process can be started or every run
/// fails. The run that fails beside others says so in its row. Whatever `on_row` returns.
pub fn measure(
    program: &Path,
    cases: &Path,
    rig: &Path,
    variants: &[Variant],
    threads: usize,
    on_row: &mut dyn FnMut(&CompareRow) -> Result<()>,
) -> Result<Vec<CompareRow>> {
    let names = read_cases(cases, rig)?.into_iter().map(|case| case.name).collect::<Vec<_>>();
    let mut rows = Vec::with_capacity(variants.len() * names.len());
    for variant in variants {
        let mut first = 0;
        while first < names.len() {
            let run = Run { cases: cases.into(), first, rig: rig.into(), variant: variant.clone() };
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
        let message = format!("every run failed; the first, {} {} on {}: {reason}", row.group, row.name, row.case);
        return Err(Failure::computation(message).into());
    }
    Ok(rows)
}

/// Reads all cases; no two have the same name.
///
/// # Errors
/// A [`Failure`] of loading.
pub(super) fn read_cases(cases: &Path, rig: &Path) -> Result<Vec<BenchCase>> {
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    let read = BenchCase::read_all(cases, &BenchRig::read(rig).map_err(unread)?).map_err(unread)?;
    for (i, case) in read.iter().enumerate() {
        if read[..i].iter().any(|other| other.name == case.name) {
            let message = format!("{}: two cases are called {:?}; rename one", cases.display(), case.name);
            return Err(Failure::loading(message).into());
        }
    }
    Ok(read)
}

/// What a process is told to do: the variant on all cases from the `first`.
#[derive(Serialize, Deserialize)]
struct Run {
    cases: PathBuf,
    first: usize,
    rig: PathBuf,
    variant: Variant,
}

/// What it says of a case.
#[derive(Serialize, Deserialize)]
struct Line {
    row: CompareRow,
    seconds: Option<f64>,
    peak_bytes: Option<u64>,
}

/// Runs in this process what `configuration` says, one line a case on standard output.
///
/// # Errors
/// When the configuration, the rig or a case cannot be read, or nobody reads the lines. A registration that fails is a line.
pub(super) fn run_here(configuration: &str) -> Result<()> {
    let run: Run = from_exact(configuration).map_err(|e| Failure::new(Stage::Arguments, format!("--run: {e:#}")))?;
    let rig = BenchRig::read(&run.rig)?;
    let mut out = io::stdout().lock();
    for folder in case_folders(&run.cases)?.iter().skip(run.first) {
        let line = run.variant.run(&BenchCase::read(folder, &rig)?);
        writeln!(out, "{}", to_exact(&line)?).and_then(|()| out.flush()).context("standard output")?;
    }
    Ok(())
}

impl Variant {
    fn run(&self, case: &BenchCase) -> Line {
        let (mut seconds, mut peak) = (None, None);
        let mut fit = || -> Result<Score> {
            let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
            reset_peak();
            let (result, wall) = fit_case(&self.model, &terms, &self.schedule, case, self.landmarks)?;
            (seconds, peak) = (Some(wall), peak_bytes());
            let (errors, mesh) = case.score(&result.positions)?;
            if !errors.finite {
                bail!("the result is not finite");
            }
            let coincidence = vertex_coincidence(&result);
            Ok(Score { errors, mesh, iterations: Some(result.history.len()), vertex_coincidence: coincidence })
        };
        let (score, error) = fit().map_or_else(|e| (None, Some(format!("{e:#}"))), |score| (Some(score), None));
        Line { row: self.row(&case.name, score, error), seconds, peak_bytes: peak }
    }

    fn row(&self, case: &str, score: Option<Score>, error: Option<String>) -> CompareRow {
        let (group, name, case) = (self.group.clone(), self.name.clone(), case.to_owned());
        CompareRow { group, name, case, score, error, seconds: None, peak_bytes: None }
    }
}

/// Ends with its owner.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Both fail only when it has ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a variant on the cases `names` in a process of its own, at least on the first of them: what ends it early is that case's
/// row, the last one.
fn run_apart(
    program: &Path,
    run: &Run,
    threads: usize,
    names: &[String],
    on_row: &mut dyn FnMut(CompareRow) -> Result<()>,
) -> Result<()> {
    let failed = |what: String| Failure::computation(format!("{}: {what}", program.display()));
    let mut command = Command::new(program);
    command.args(["compare", "--threads", &threads.to_string(), "--run", &to_exact(run)?]);
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
        let reason = match lines.next().map(|line| line.context("its output").and_then(|line| from_exact(&line))) {
            Some(Ok(Line { row, seconds, peak_bytes })) if row.case == *name => {
                on_row(CompareRow { seconds, peak_bytes, ..row })?;
                continue;
            }
            Some(Ok(line)) => format!("another case came, {:?}: have the cases changed meanwhile?", line.row.case),
            Some(Err(e)) => format!("{e:#}"),
            None => {
                let status = process.0.wait().context("the process' end")?;
                let said = said.join().map_or_else(|_| Vec::new(), Result::unwrap_or_default);
                let said = String::from_utf8_lossy(&said);
                let words: Vec<&str> = said.trim_start_matches("error: ").split_whitespace().collect();
                format!("the process ended early ({status}) {}", words.join(" ")).trim_end().to_owned()
            }
        };
        return on_row(run.variant.row(name, None, Some(reason)));
    }
    Ok(())
}

/// JSON in one line whose numbers come back bit for bit. (`serde_json` reads a long decimal to the unit in the last place.)
fn to_exact(value: &impl Serialize) -> Result<String> {
    fn exact(value: Value) -> Value {
        match value {
            Value::Number(n) if n.is_f64() => json!({ BITS: n.as_f64().map(f64::to_bits) }),
            Value::Array(items) => items.into_iter().map(exact).collect(),
            Value::Object(fields) => fields.into_iter().map(|(key, v)| (key, exact(v))).collect(),
            other => other,
        }
    }
    Ok(exact(serde_json::to_value(value)?).to_string())
}

/// What [`to_exact`] wrote.
fn from_exact<T: DeserializeOwned>(text: &str) -> Result<T> {
    fn number(value: Value) -> Value {
        match value {
            Value::Array(items) => items.into_iter().map(number).collect(),
            Value::Object(fields) => match fields.get(BITS).and_then(Value::as_u64) {
                Some(bits) => f64::from_bits(bits).into(),
                None => fields.into_iter().map(|(key, v)| (key, number(v))).collect(),
            },
            other => other,
        }
    }
    let value = serde_json::from_str(text).with_context(|| format!("not a line of this program: {text:.80}"))?;
    Ok(serde_json::from_value(number(value))?)
}

/// Key of the one field that stands for a number.
const BITS: &str = "bits";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_bit_for_bit() {
        let mut variant = Variant::of_model(nonrigid::registration::ModelKind::Sequential).unwrap();
        // A decimal of 17 digits, a power of ten beyond the exact ones, the least number, negative zero.
        variant.schedule.reference_size = 67.000_000_000_000_01 / 3.0;
        variant.schedule.levels[0].landmarks = 1.234_567_890_123_456_7e-200;
        variant.schedule.levels[1].landmarks = 5e-324;
        variant.schedule.levels[2].landmarks = -0.0;
        let text = to_exact(&variant).unwrap();
        let back: Variant = from_exact(&text).unwrap();
        assert_eq!(back, variant);
        assert!(back.schedule.levels[2].landmarks.is_sign_negative());
        assert_eq!(text.lines().count(), 1);
        let error = from_exact::<Variant>("thread panicked").unwrap_err();
        assert!(error.to_string().contains("thread panicked"), "{error}");
    }
}
