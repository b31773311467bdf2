//! Running jobs, several at once, each in a process of its own.

use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::{Hashes, Job, Record, Start, Status};
use crate::mesh::io::{WriteError, write_atomically};

/// How and where jobs run.
#[derive(Debug, Clone)]
pub struct Batch {
    /// The program, and what stands before a job's own arguments.
    pub program: PathBuf,
    /// Its first arguments.
    pub command: Vec<OsString>,
    /// Where outputs go: `NAME.FORMAT`, `NAME.json`, `NAME.png`, and folders `log` and `state`.
    pub folder: PathBuf,
    /// Extension of results.
    pub format: String,
    /// Whether pictures are made.
    pub pictures: bool,
    /// Jobs at once.
    pub at_once: usize,
    /// Threads of each.
    pub threads: usize,
    /// Whether what is done is done again.
    pub again: bool,
}

/// What came of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Its index.
    pub job: usize,
    /// What is known of it.
    pub record: Record,
    /// Whether it was done before.
    pub before: bool,
    /// How long it ran.
    pub seconds: f64,
}

/// What a process left.
struct Ended {
    error: Option<String>,
    interrupted: bool,
}

/// The exit code of a program that ended because it was asked to.
const INTERRUPTED: i32 = 130;

impl Batch {
    /// Runs chains of jobs; the jobs of a chain follow each other, each that [may](Job::goes_on) from where the one before has ended. `finished` is called
    /// after every job, in the order in which they end; `stop` is asked before each. Outcomes by index of the job, without those
    /// that were not begun or were interrupted.
    ///
    /// # Errors
    /// When the program cannot be started, or what is known of a job cannot be written: what is wrong with one scan is in its
    /// [`Record`].
    pub fn run(
        &self,
        jobs: &[Job],
        chains: &[Vec<usize>],
        stop: &(dyn Fn() -> bool + Sync),
        finished: &(dyn Fn(&Outcome) + Sync),
    ) -> Result<Vec<Outcome>, WriteError> {
        for folder in [self.folder.clone(), self.folder.join("log"), self.folder.join("state")] {
            std::fs::create_dir_all(&folder).map_err(|source| WriteError::Io { path: folder, source })?;
        }
        let hashes = Hashes::default();
        let next = AtomicUsize::new(0);
        let outcomes = Mutex::new(Vec::new());
        let worker = || -> Result<(), WriteError> {
            while let Some(chain) = chains.get(next.fetch_add(1, Ordering::Relaxed)) {
                let mut previous: Option<(usize, Record)> = None;
                for &k in chain {
                    if stop() {
                        return Ok(());
                    }
                    let before = previous.as_ref().filter(|(_, r)| r.status == Status::Done && jobs[k].goes_on);
                    let before = before.and_then(|(job, record)| Some((&jobs[*job], record.key.as_deref()?)));
                    let Some(outcome) = self.job(k, &jobs[k], before, &hashes)? else { return Ok(()) };
                    finished(&outcome);
                    previous = Some((k, outcome.record.clone()));
                    outcomes.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(outcome);
                }
            }
            Ok(())
        };
        let ended: Vec<Result<(), WriteError>> = std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.at_once.max(1)).map(|_| scope.spawn(worker)).collect();
            workers.into_iter().map(|w| w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
        });
        ended.into_iter().collect::<Result<(), _>>()?;
        let mut outcomes = outcomes.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        outcomes.sort_by_key(|outcome| outcome.job);
        Ok(outcomes)
    }

    /// Where what is known of a job is kept.
    #[must_use]
    pub fn record(&self, job: &Job) -> PathBuf {
        self.folder.join("log").join(format!("{}.json", job.name))
    }

    fn state(&self, job: &Job) -> PathBuf {
        self.folder.join("state").join(format!("{}.json", job.name))
    }

    /// Names of what a job writes; the report first.
    fn outputs(&self, name: &str) -> Vec<String> {
        let extensions = ["json", &self.format].into_iter().chain(self.pictures.then_some("png"));
        let mut names: Vec<String> = extensions.map(|e| format!("{name}.{e}")).collect();
        names.push(format!("state/{name}.json"));
        names
    }

    /// Runs a job unless it is done; `None` if it was interrupted.
    fn job(
        &self,
        index: usize,
        job: &Job,
        before: Option<(&Job, &str)>,
        hashes: &Hashes,
    ) -> Result<Option<Outcome>, WriteError> {
        let clock = Instant::now();
        let key = job.key(before.map(|b| b.1), hashes);
        let path = self.record(job);
        let known = Record::read(&path).filter(|_| !self.again);
        if let Some(record) = known.filter(|record| key.as_ref().is_some_and(|key| record.holds(key, &self.folder))) {
            return Ok(Some(Outcome { job: index, record, before: true, seconds: 0.0 }));
        }
        self.clear(job);
        let mut start = if before.is_some() { Start::Warm } else { Start::Cold };
        let mut ended = self.process(job, before.map(|b| b.0))?;
        if start == Start::Warm && !ended.interrupted && (ended.error.is_some() || self.is_doubtful(job)) {
            self.clear(job);
            start = Start::ColdAgain;
            ended = self.process(job, None)?;
        }
        if ended.interrupted {
            self.clear(job);
            return Ok(None);
        }
        let status = if ended.error.is_none() { Status::Done } else { Status::Failed };
        if status == Status::Failed {
            self.clear(job);
        }
        let outputs = Record::hashes(&self.folder, &self.outputs(&job.name));
        let record = Record { key, status, start, error: ended.error, outputs };
        write_atomically(&path, |file| Ok(serde_json::to_writer_pretty(file, &record)?))?;
        Ok(Some(Outcome { job: index, record, before: false, seconds: clock.elapsed().as_secs_f64() }))
    }

    /// Takes away what an earlier run has left: outputs that stand there are those of this run.
    fn clear(&self, job: &Job) {
        let timing = format!("{}.timing.json", job.name);
        for name in self.outputs(&job.name).into_iter().chain([timing]) {
            let _ = std::fs::remove_file(self.folder.join(name)); // usually there is none
        }
        let _ = std::fs::remove_file(self.record(job));
    }

    fn is_doubtful(&self, job: &Job) -> bool {
        let report = std::fs::read(self.folder.join(format!("{}.json", job.name)));
        let report: Option<serde_json::Value> = report.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        report.is_some_and(|report| report["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty()))
    }

    fn process(&self, job: &Job, before: Option<&Job>) -> Result<Ended, WriteError> {
        let arguments = match &job.arguments {
            Ok(arguments) => arguments,
            Err(message) => return Ok(Ended { error: Some(message.clone()), interrupted: false }),
        };
        let path = self.folder.join("log").join(format!("{}.txt", job.name));
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| WriteError::Io { path, source }
        };
        let log = File::create(&path).map_err(failed(&path))?;
        let mut command = Command::new(&self.program);
        command.args(&self.command).args(arguments).arg("--threads").arg(self.threads.to_string());
        let out = |extension: &str| self.folder.join(format!("{}.{extension}", job.name));
        command.arg("--out").arg(out(&self.format)).arg("--report").arg(out("json"));
        command.arg("--state").arg(self.state(job));
        if self.pictures {
            command.arg("--picture").arg(out("png"));
        }
        if let Some(before) = before {
            command.arg("--warm-start").arg(self.state(before));
        }
        let both = log.try_clone().map_err(failed(&path))?;
        command.stdin(Stdio::null()).stdout(both).stderr(log);
        let status = command.status().map_err(failed(&self.program))?;
        let error = (!status.success()).then(|| {
            let said = std::fs::read_to_string(&path).unwrap_or_default();
            let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
            error.map_or_else(|| format!("ended by {status} (out of memory?)"), str::to_owned)
        });
        Ok(Ended { error, interrupted: status.code() == Some(INTERRUPTED) })
    }
}
