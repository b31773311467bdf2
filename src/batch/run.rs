//! Running jobs, several at once, each in a process of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::job::{InputHash, read_json};
use super::lock::{HIDDEN, Lock};
use super::plan::{self, SUMMARY};
use super::{Animation, BatchError, Hashes, Job, Kept, Plan, Record, Row, Shard, Start, Status, Summary, animation};
use crate::io::{WriteError, replace, sync_files, write_atomically, write_durably};

/// How and where jobs run.
#[derive(Debug, Clone)]
pub struct Batch {
    /// The program.
    pub program: PathBuf,
    /// What stands before a command's name.
    pub command: Vec<OsString>,
    /// Where outputs go: `NAME.FORMAT`, `NAME.json`, `NAME.png`, and folders `log`, `state` and `sequences`.
    pub folder: PathBuf,
    /// Extension of results.
    pub format: String,
    /// Whether pictures are made.
    pub pictures: bool,
    /// What becomes of sequences besides.
    pub animation: Option<Animation>,
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

/// What came of a batch.
#[derive(Debug, Clone)]
pub struct Finished {
    /// By index of the job, without those that were not begun or were interrupted.
    pub outcomes: Vec<Outcome>,
    /// All jobs, those of other parts and earlier runs included.
    pub summary: Summary,
    /// Sequences of this part that have no animated file, and why.
    pub not_animated: Vec<(String, String)>,
    /// What differs from run to run.
    pub timing: Timing,
}

/// Times of a batch.
#[derive(Debug, Clone, Serialize)]
pub struct Timing {
    /// Scans that this run did.
    pub scans: usize,
    /// Scans that were done before.
    pub before: usize,
    /// From start to end.
    pub seconds: f64,
    /// Threads that it had.
    pub cores: usize,
    /// Speed.
    pub scans_per_core_minute: f64,
    /// By name.
    pub seconds_of_scans: Vec<(String, f64)>,
}

/// What a process left.
pub(super) struct Ended {
    pub error: Option<String>,
    pub interrupted: bool,
}

/// Whether a program ended because it was asked to, by Ctrl-C or SIGTERM: as it says, or by the signal itself.
fn was_asked_to_end(status: ExitStatus) -> bool {
    const ASKED: [i32; 2] = [130, 143];
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt as _;
        if status.signal().is_some_and(|signal| ASKED.contains(&(128 + signal))) {
            return true;
        }
    }
    status.code().is_some_and(|code| ASKED.contains(&code))
}

impl Batch {
    /// Where what is known of a job is kept.
    #[must_use]
    pub fn record(&self, job: &Job) -> PathBuf {
        self.record_of(&job.name)
    }

    pub(super) fn record_of(&self, name: &str) -> PathBuf {
        self.folder.join(format!("log/{name}.json"))
    }

    /// Why a job of this name cannot be done: its record cannot be read, and it has outputs that then may be anybody's; or none can be
    /// written, as something else than a file is in its place.
    pub(super) fn broken_record(&self, name: &str) -> Option<String> {
        let path = self.record_of(name);
        if fs::symlink_metadata(&path).is_err() || Record::read(&path).is_some() {
            return None;
        }
        if is_no_file(&path) {
            return Some(format!("{}: is no file, so nothing can be noted there; move it away", path.display()));
        }
        let files = self.outputs(name).into_iter().chain(others(name)).map(|name| self.folder.join(name));
        let there: Vec<PathBuf> = files.filter(|path| fs::symlink_metadata(path).is_ok()).collect();
        let (path, first) = (path.display(), there.first()?.display());
        let whose = match there.len() - 1 {
            0 => format!("{first} is"),
            more => format!("{first} and {more} more are"),
        };
        Some(format!("{path}: is no record, so nobody knows whose {whose}; move all of them away, or delete them"))
    }

    /// Names of what a job writes, in the folder of results: the report first, the record last.
    pub(super) fn names(&self, name: &str) -> impl Iterator<Item = String> {
        let others = others(name).into_iter().chain([format!("log/{name}.json")]);
        self.outputs(name).into_iter().chain(others)
    }

    /// The program, to be given arguments of this command.
    pub(super) fn command_of(&self, name: &str) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.command).arg(name);
        command
    }

    /// Names of a job's results; the report first.
    pub(super) fn outputs(&self, name: &str) -> Vec<String> {
        if name.ends_with(animation::ENDING) {
            return self.animation_files(name);
        }
        let extensions = ["json", &self.format].into_iter().chain(self.pictures.then_some("png"));
        let mut names: Vec<String> = extensions.map(|e| format!("{name}.{e}")).collect();
        names.push(format!("state/{name}.json"));
        names
    }
}

/// What a job writes besides: files that differ from run to run.
fn others(name: &str) -> [String; 2] {
    [format!("{name}.timing.json"), format!("log/{name}.txt")]
}

/// Where a part notes the files that it writes besides results.
fn claim_name(shard: Shard) -> String {
    format!("{HIDDEN}/wrote-{shard}.json")
}

/// Whether a pipe, a device or a folder is where a file is to be: to open a pipe waits for the other side.
fn is_no_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| !metadata.is_file())
}

impl Plan {
    /// Runs it; the jobs of a chain follow each other, each that [may](Job::goes_on) from where the one before has ended. `finished`
    /// is called after every job, in the order in which they end; `stop` is asked before each; `said` is told what the user
    /// should know besides.
    ///
    /// # Errors
    /// When it [must not run](Self::check), another batch has the folder, or files stand where results would go and are none: nothing
    /// has changed then. When the program cannot be started, or something cannot be written.
    pub fn run(
        &self,
        stop: &(dyn Fn() -> bool + Sync),
        finished: &(dyn Fn(&Outcome) + Sync),
        said: &dyn Fn(&str),
    ) -> Result<Finished, BatchError> {
        let clock = Instant::now();
        let lock = self.begin(said)?;
        let lost = || lock.is_lost();
        let run = Run::new(&self.batch, &self.jobs, lock.aside(), &lost);
        let outcomes = run.chains(&self.chains, stop, finished)?;
        let summary = self.summarise(&outcomes)?;
        let timing = Timing::new(self, &outcomes, clock.elapsed());
        self.batch.write_timing(self.shard, &timing)?;
        let of_part: Vec<Job> = outcomes.iter().map(|outcome| self.jobs[outcome.job].clone()).collect();
        let not_animated = self.batch.without_animation(&of_part);
        Ok(Finished { outcomes, summary, not_animated, timing })
    }

    /// Refuses what must not run, takes the folder, and makes it ready.
    fn begin(&self, said: &dyn Fn(&str)) -> Result<Lock, BatchError> {
        self.check()?;
        let of_part = animation::names(self.chains.iter().map(|c| self.jobs[c[0]].sequence.as_deref()));
        let names = || self.chains.iter().flatten().map(|&k| &*self.jobs[k].name);
        self.batch.begin(self.shard, &self.fingerprint(), names, &of_part, said)
    }

    /// Writes the table of all jobs. Other parts may do so at the same time: who writes last sees in what it reads then whether that
    /// was before another has ended.
    fn summarise(&self, outcomes: &[Outcome]) -> Result<Summary, WriteError> {
        let read = || Summary::of(&self.batch, &self.jobs, outcomes);
        let mut summary = read();
        loop {
            self.batch.write_summary(&summary)?;
            let now = read();
            if now == summary {
                return Ok(summary);
            }
            summary = now;
        }
    }
}

/// A folder that this process holds for jobs that others run, on other machines as well.
#[derive(Debug)]
pub struct Held {
    batch: Batch,
    lock: Lock,
}

impl Held {
    /// Takes the folder for the jobs of a whole manifest that was read from `path`, which others run by [`run_jobs`]; it is this
    /// process's until this is dropped. `job` says what a row runs; one job is held at a time.
    ///
    /// # Errors
    /// As [`Plan::run`], before anything runs.
    pub fn take(
        batch: Batch,
        path: &Path,
        rows: &[Row],
        job: impl Fn(&Row) -> Job,
        said: &dyn Fn(&str),
    ) -> Result<Self, BatchError> {
        let shard = Shard::whole();
        let sequences = animation::names(rows.iter().map(|row| row.sequence.as_deref()));
        plan::check(&batch, path, &plan::timing(shard), &sequences, || rows.iter().map(&job))?;
        // a whole goes with no other part, so that its fingerprint is compared with none
        let lock = batch.begin(shard, "", || rows.iter().map(|row| &*row.name), &sequences, said)?;
        Ok(Self { batch, lock })
    }

    /// Where each of the others makes a folder for [`run_jobs`]; taken away at the end.
    #[must_use]
    pub fn aside(&self) -> &Path {
        self.lock.aside()
    }

    /// Whether another batch took the folder over.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.lock.is_lost()
    }

    /// Writes what the others have told.
    ///
    /// # Errors
    /// When it cannot be written, or the folder was taken over.
    pub fn finish(&self, summary: &Summary, timing: &Timing) -> Result<(), BatchError> {
        if self.is_lost() {
            return Err(BatchError::Lost(self.batch.folder.clone()));
        }
        self.batch.write_summary(summary)?;
        Ok(self.batch.write_timing(Shard::whole(), timing)?)
    }
}

/// Runs jobs in a folder that the caller, or who asked it to, [holds](Held::take): chains of indices into `jobs`, as those of a plan.
/// `aside` is an empty folder in the same file system, for these jobs alone.
///
/// # Errors
/// When the program cannot be started, or something cannot be written.
pub fn run_jobs(
    batch: &Batch,
    jobs: &[Job],
    chains: &[Vec<usize>],
    aside: &Path,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Outcome>, BatchError> {
    batch.make_ready(aside, &animation::names(jobs.iter().map(|job| job.sequence.as_deref())), &|_| {})?;
    Run::new(batch, jobs, aside, &|| false).chains(chains, stop, &|_| {})
}

impl Batch {
    /// Takes the folder for jobs of these names and their sequences, and makes it ready.
    fn begin<'a, I: Iterator<Item = &'a str>>(
        &self,
        shard: Shard,
        fingerprint: &str,
        names: impl Fn() -> I,
        sequences: &'a [String],
        said: &dyn Fn(&str),
    ) -> Result<Lock, BatchError> {
        let animated = if self.animation.is_some() { sequences } else { &[] };
        let names = || names().chain(animated.iter().map(String::as_str));
        self.refuse_strangers(shard, names())?;
        let folder = &self.folder;
        let lock = Lock::take(folder, shard, fingerprint, said)?;
        // another batch may have been there until now
        self.refuse_strangers(shard, names())?;
        self.claim(shard)?;
        self.make_ready(lock.aside(), sequences, said)?;
        Ok(lock)
    }

    /// Makes the folders, and takes away what is there of sequences that are no longer animated.
    fn make_ready(&self, aside: &Path, sequences: &[String], said: &dyn Fn(&str)) -> Result<(), WriteError> {
        for folder in [aside, &self.folder].iter().flat_map(|at| self.folders().map(|name| at.join(name))) {
            fs::create_dir_all(&folder).map_err(|source| WriteError::Io { path: folder, source })?;
        }
        if self.animation.is_none() {
            sequences.iter().try_for_each(|name| self.forget_animation(name, said))?;
        }
        Ok(())
    }

    /// Names of the folders that results and what is known of them are in.
    fn folders(&self) -> impl Iterator<Item = &'static str> {
        ["log", "state"].into_iter().chain(self.animation.is_some().then_some(animation::FOLDER))
    }

    /// Names of the files that a part writes besides results.
    fn shared(shard: Shard) -> impl Iterator<Item = String> {
        SUMMARY.map(str::to_owned).into_iter().chain([plan::timing(shard)])
    }

    /// Writes down, before they are written, the names of the files besides results.
    fn claim(&self, shard: Shard) -> Result<(), WriteError> {
        let names: Vec<String> = Self::shared(shard).collect();
        write_durably(&self.folder.join(claim_name(shard)), |file| Ok(serde_json::to_writer_pretty(file, &names)?))
    }

    fn write_timing(&self, shard: Shard, timing: &Timing) -> Result<(), WriteError> {
        let path = self.folder.join(plan::timing(shard));
        write_atomically(&path, |file| Ok(serde_json::to_writer_pretty(file, timing)?))
    }

    fn write_summary(&self, summary: &Summary) -> Result<(), WriteError> {
        let [csv, page] = SUMMARY.map(|name| self.folder.join(name));
        write_atomically(&csv, |file| file.write_all(summary.to_csv().as_bytes()))?;
        let pictured = |name: &str| self.folder.join(format!("{name}.png")).exists();
        write_atomically(&page, |file| file.write_all(summary.to_html(&pictured).as_bytes()))
    }

    /// Refuses files that would be replaced and are of no batch.
    fn refuse_strangers<'a>(&self, shard: Shard, jobs: impl Iterator<Item = &'a str>) -> Result<(), BatchError> {
        let folder = &self.folder;
        let claimed = self.claimed();
        let special = |name: &String| is_no_file(&folder.join(name));
        let mut strangers: Vec<String> = std::iter::once(claim_name(shard)).filter(special).collect();
        for job in jobs {
            let path = self.record_of(job);
            let record = Record::read(&path);
            // a batch has been here, and its record broke: that is said of this job alone
            if record.is_none() && !claimed.is_empty() && path.exists() {
                continue;
            }
            let known =
                |name: &String| record.as_ref().is_some_and(|r| r.lists(name) || *name == format!("log/{job}.json"));
            let there = self.names(job).filter(|name| fs::symlink_metadata(folder.join(name)).is_ok());
            strangers.extend(there.filter(|name| !known(name) || special(name)));
        }
        let there = Self::shared(shard).filter(|name| fs::symlink_metadata(folder.join(name)).is_ok());
        strangers.extend(there.filter(|name| !claimed.contains(name) || special(name)));
        match &strangers[..] {
            [] => Ok(()),
            [first, others @ ..] => Err(BatchError::Stranger { file: folder.join(first), others: others.len() }),
        }
    }

    /// Names of the files that batches have written here besides results.
    fn claimed(&self) -> BTreeSet<String> {
        let mut claimed = BTreeSet::new();
        let entries = fs::read_dir(self.folder.join(HIDDEN)).into_iter().flatten().flatten();
        for path in entries.map(|e| e.path()).filter(|path| path.extension().is_some_and(|e| e == "json")) {
            claimed.extend(read_json::<Vec<String>>(&path).into_iter().flatten());
        }
        claimed
    }
}

impl Timing {
    fn new(plan: &Plan, outcomes: &[Outcome], elapsed: Duration) -> Self {
        let Batch { at_once, threads, .. } = plan.batch;
        let cores = at_once.min(plan.chains.len().max(1)) * threads;
        let ran: Vec<&Outcome> = outcomes.iter().filter(|o| !o.before).collect();
        let seconds = elapsed.as_secs_f64();
        Self {
            scans: ran.len(),
            before: outcomes.len() - ran.len(),
            seconds,
            cores,
            scans_per_core_minute: ran.len() as f64 / (seconds / 60.0 * cores as f64),
            seconds_of_scans: ran.iter().map(|o| (plan.jobs[o.job].name.clone(), o.seconds)).collect(),
        }
    }
}

/// Jobs that are being carried out.
pub(super) struct Run<'a> {
    pub batch: &'a Batch,
    pub jobs: &'a [Job],
    /// Where files are made before they replace others.
    pub aside: &'a Path,
    /// Whether another batch took the folder over.
    pub lost: &'a (dyn Fn() -> bool + Sync),
    pub hashes: Hashes,
}

impl<'a> Run<'a> {
    fn new(batch: &'a Batch, jobs: &'a [Job], aside: &'a Path, lost: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { batch, jobs, aside, lost, hashes: Hashes::default() }
    }

    fn chains(
        &self,
        chains: &[Vec<usize>],
        stop: &(dyn Fn() -> bool + Sync),
        finished: &(dyn Fn(&Outcome) + Sync),
    ) -> Result<Vec<Outcome>, BatchError> {
        let jobs = self.jobs;
        let next = AtomicUsize::new(0);
        let outcomes = Mutex::new(Vec::new());
        let worker = || -> Result<(), BatchError> {
            while let Some(chain) = chains.get(next.fetch_add(1, Ordering::Relaxed)) {
                let mut previous: Option<(usize, Record)> = None;
                let mut ends = Vec::with_capacity(chain.len());
                for &k in chain {
                    if stop() {
                        return Ok(());
                    }
                    let before = previous.as_ref().filter(|(_, r)| r.status == Status::Done && jobs[k].goes_on);
                    let before = before.and_then(|(job, record)| Some((&jobs[*job], record.key.as_deref()?)));
                    let Some(outcome) = self.job(k, before, stop)? else { return Ok(()) };
                    finished(&outcome);
                    // of a frame that cannot be read, an earlier run's end stands: those after it are not touched for that
                    let standing = || Record::read(&self.batch.record(&jobs[k])).and_then(|known| known.standing());
                    let record = if outcome.record.key.is_none() { standing() } else { Some(outcome.record.clone()) };
                    previous = record.map(|record| (k, record));
                    ends.push(outcome.record.clone());
                    outcomes.lock().unwrap_or_else(PoisonError::into_inner).push(outcome);
                }
                if !self.animate(chain, &ends, stop)? {
                    return Ok(());
                }
            }
            Ok(())
        };
        let ended: Vec<Result<(), BatchError>> = std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.batch.at_once.max(1)).map(|_| scope.spawn(worker)).collect();
            workers.into_iter().map(|w| w.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
        });
        ended.into_iter().collect::<Result<(), _>>()?;
        let mut outcomes = outcomes.into_inner().unwrap_or_else(PoisonError::into_inner);
        outcomes.sort_by_key(|outcome| outcome.job);
        Ok(outcomes)
    }

    /// Runs a job unless it is done; `None` if it was interrupted.
    fn job(
        &self,
        index: usize,
        before: Option<(&Job, &str)>,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Outcome>, BatchError> {
        let (clock, job) = (Instant::now(), &self.jobs[index]);
        let outcome = |record, before| Outcome { job: index, record, before, seconds: clock.elapsed().as_secs_f64() };
        if let Some(broken) = self.batch.broken_record(&job.name) {
            return Ok(Some(outcome(Record::failed(None, Start::Cold, broken, None), false)));
        }
        let known = Record::read(&self.batch.record(job));
        let key = match job.arguments.clone().and_then(|_| job.key(before.map(|b| b.1), &self.hashes)) {
            Ok(key) => key,
            // nobody knows what is done, so what is there stays as it is
            Err(error) => {
                let record = Record::failed(None, Start::Cold, error, None);
                if known.as_ref().is_none_or(|known| known.outputs.is_empty()) {
                    self.write_record(job, &record)?;
                }
                return Ok(Some(outcome(record, false)));
            }
        };
        let done = known.as_ref().filter(|_| !self.batch.again);
        if let Some(record) = done.and_then(|known| known.of_done(&key, &self.batch.folder)) {
            if known.as_ref() != Some(&record) {
                self.write_record(job, &record)?;
            }
            return Ok(Some(Outcome { seconds: 0.0, ..outcome(record, true) }));
        }
        let mut start = if before.is_some() { Start::Warm } else { Start::Cold };
        if let Err(changed) = self.refuse_changed(job, known.as_ref()) {
            return Ok(Some(outcome(Record::failed(None, start, changed.to_string(), None), false)));
        }
        let mut ended = self.process(job, before.map(|b| b.0))?;
        if start == Start::Warm && !ended.interrupted && (ended.error.is_some() || self.is_doubtful(job)) {
            self.clear(job);
            start = Start::ColdAgain;
            ended = self.process(job, None)?;
        }
        if (self.lost)() {
            return Err(BatchError::Lost(self.batch.folder.clone()));
        }
        if ended.interrupted && stop() {
            self.clear(job);
            return Ok(None);
        }
        let published = match ended.error {
            Some(error) => {
                let mut record = Record::failed(Some(key), start, error, known.as_ref());
                self.clear_results(job);
                let [_, said] = others(&job.name);
                if !record.others.contains(&said) {
                    record.others.push(said);
                }
                self.publish(job, known.as_ref(), record)
            }
            None => {
                let read: Option<Vec<InputHash>> = self
                    .report(job)
                    .and_then(|mut report| serde_json::from_value(report.get_mut("inputs")?.take()).ok());
                // a file that was changed between its hash and its use: what was used counts
                let read = read.unwrap_or_default();
                let key = job.key_of_what_was_read(before.map(|b| b.1), &self.hashes, &read).unwrap_or(key);
                let outputs = Record::hashes(self.aside, &self.results(job));
                let others = others(&job.name).to_vec();
                let (key, status) = (Some(key), Status::Done);
                let record =
                    Record { key, status, start, error: None, outputs, replaced: BTreeMap::new(), others, kept: None };
                self.publish(job, known.as_ref(), record)
            }
        };
        let record = match published {
            Ok(record) => record,
            // somebody has put it there, or changed it, while this job ran
            Err(theirs @ (BatchError::Stranger { .. } | BatchError::Changed(_))) => {
                self.clear(job);
                Record::failed(None, start, theirs.to_string(), None)
            }
            Err(error) => return Err(error),
        };
        Ok(Some(outcome(record, false)))
    }

    /// Refuses to replace results that somebody has changed.
    fn refuse_changed(&self, job: &Job, known: Option<&Record>) -> Result<(), BatchError> {
        let folder = &self.batch.folder;
        let names = self.results(job);
        let changed = known.into_iter().flat_map(|known| known.changed(folder)).find(|name| names.contains(name));
        changed.map_or(Ok(()), |name| Err(BatchError::Changed(folder.join(name))))
    }

    /// Puts what was made aside in the place of what an earlier run has left. The record comes first: what it lists and is not there
    /// as listed counts as not done.
    pub(super) fn publish(&self, job: &Job, known: Option<&Record>, mut record: Record) -> Result<Record, BatchError> {
        let folder = &self.batch.folder;
        let names: Vec<String> = self.results(job).into_iter().chain(others(&job.name)).collect();
        let made = |name: &String| self.aside.join(name).exists();
        let of_known = |name: &str| known.is_some_and(|known| known.lists(name));
        let stranger =
            names.iter().filter(|name| made(name)).find(|name| folder.join(name).exists() && !of_known(name));
        if let Some(name) = stranger {
            return Err(BatchError::Stranger { file: folder.join(name), others: 0 });
        }
        if record.status == Status::Done {
            self.refuse_changed(job, known)?;
            record.replaced = Record::hashes(folder, &record.outputs.keys().cloned().collect::<Vec<_>>());
            record.replaced.retain(|name, hash| record.outputs[name] != *hash);
        }
        if record.status == Status::Done {
            // what the record says is done is so after a power cut, too
            sync_files(&record.outputs.keys().map(|name| self.aside.join(name)).collect::<Vec<_>>())?;
            // of an earlier format, or a picture
            known.map_or(Ok(()), |known| known.take_away(folder, |name| !record.outputs.contains_key(name)))?;
        }
        self.write_record(job, &record)?;
        for name in names.iter().filter(|name| made(name)) {
            let path = folder.join(name);
            replace(&self.aside.join(name), &path).map_err(|source| WriteError::Io { path, source })?;
        }
        if record.status == Status::Done && !record.replaced.is_empty() {
            record.replaced.clear();
            self.write_record(job, &record)?;
        }
        Ok(record)
    }

    pub(super) fn write_record(&self, job: &Job, record: &Record) -> Result<(), WriteError> {
        write_durably(&self.batch.record(job), |file| Ok(serde_json::to_writer_pretty(file, record)?))
    }

    /// Takes away what was made aside.
    pub(super) fn clear(&self, job: &Job) {
        self.clear_results(job);
        for name in others(&job.name) {
            let _ = fs::remove_file(self.aside.join(name)); // it may not be there
        }
    }

    pub(super) fn clear_results(&self, job: &Job) {
        let names = self.results(job).into_iter().chain([format!("{}.timing.json", job.name)]);
        for name in names {
            let _ = fs::remove_file(self.aside.join(name)); // usually there is none
        }
    }

    fn report(&self, job: &Job) -> Option<serde_json::Value> {
        read_json(&self.aside.join(format!("{}.json", job.name)))
    }

    /// Names of a job's results, and of the files beside them.
    fn results(&self, job: &Job) -> Vec<String> {
        self.batch.outputs(&job.name).into_iter().chain(job.beside.iter().cloned()).collect()
    }

    fn is_doubtful(&self, job: &Job) -> bool {
        let report = self.report(job);
        report.is_some_and(|report| report["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty()))
    }

    fn process(&self, job: &Job, before: Option<&Job>) -> Result<Ended, WriteError> {
        let arguments = match &job.arguments {
            Ok(arguments) => arguments,
            Err(message) => return Ok(Ended { error: Some(message.clone()), interrupted: false }),
        };
        let aside = self.aside;
        let mut command = self.batch.command_of("register");
        command.args(arguments).arg("--threads").arg(self.batch.threads.to_string());
        let out = |extension: &str| aside.join(format!("{}.{extension}", job.name));
        command.arg("--out").arg(out(&self.batch.format)).arg("--report").arg(out("json"));
        command.arg("--state").arg(aside.join(format!("state/{}.json", job.name)));
        if self.batch.pictures {
            command.arg("--picture").arg(out("png"));
        }
        if let Some(before) = before {
            command.arg("--warm-start").arg(self.batch.folder.join(format!("state/{}.json", before.name)));
        }
        self.carry_out(command, job)
    }

    /// Runs a program, and writes down what it says.
    pub(super) fn carry_out(&self, mut command: Command, job: &Job) -> Result<Ended, WriteError> {
        let aside = self.aside;
        let path = aside.join(format!("log/{}.txt", job.name));
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| WriteError::Io { path, source }
        };
        let log = File::create(&path).map_err(failed(&path))?;
        let both = log.try_clone().map_err(failed(&path))?;
        command.stdin(Stdio::null()).stdout(both).stderr(log);
        let status = command.status().map_err(failed(&self.batch.program))?;
        // files are to be named as what they become
        let said = String::from_utf8_lossy(&fs::read(&path).unwrap_or_default()).into_owned();
        let said = said.replace(&*aside.to_string_lossy(), &self.batch.folder.to_string_lossy());
        fs::write(&path, &said).map_err(failed(&path))?;
        let error = (!status.success()).then(|| {
            let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
            error.map_or_else(|| format!("ended by {status} (out of memory?)"), str::to_owned)
        });
        let interrupted = was_asked_to_end(status);
        // whoever asked this process alone, and not the batch: an end by itself it was not
        let error = if interrupted { Some(format!("told to end from outside ({status})")) } else { error };
        Ok(Ended { error, interrupted })
    }
}

impl Record {
    /// A job that failed; what an earlier run has left stays, and is known to be there.
    pub(super) fn failed(key: Option<String>, start: Start, error: String, known: Option<&Self>) -> Self {
        let kept = known.and_then(|known| match known.status {
            Status::Done => Some(Kept { key: known.key.clone(), start: known.start }),
            Status::Failed => known.kept.clone(),
        });
        let outputs = known.filter(|_| kept.is_some()).map(|known| known.outputs.clone()).unwrap_or_default();
        let replaced = known.filter(|_| kept.is_some()).map(|known| known.replaced.clone()).unwrap_or_default();
        let others = known.map(|known| known.others.clone()).unwrap_or_default();
        Self { key, status: Status::Failed, start, error: Some(error), outputs, replaced, others, kept }
    }
}
