//! What a batch will do, before it does any of it.

use std::borrow::Borrow;
use std::path::{Path, PathBuf};

use super::lock::HIDDEN;
use super::{Batch, BatchError, Job, Manifest, Record, Row, Shard, animation, chains};
use crate::io::{check_files, sha256};

/// The jobs of a batch, which of them to run, and how.
#[derive(Debug, Clone)]
pub struct Plan {
    /// How and where.
    pub batch: Batch,
    /// One for each row of the manifest, in its order.
    pub jobs: Vec<Job>,
    /// Jobs to be run: those of a chain follow each other.
    pub chains: Vec<Vec<usize>>,
    /// Which part of the whole they are.
    pub shard: Shard,
    manifest: PathBuf,
}

/// Names of files that all parts of a batch write.
pub(super) const SUMMARY: [&str; 2] = ["summary.csv", "index.html"];

impl Plan {
    /// A plan for a part of a manifest that was read from `path`; `job` says what a row runs.
    #[must_use]
    pub fn new(batch: Batch, path: &Path, manifest: &Manifest, shard: Shard, job: impl FnMut(&Row) -> Job) -> Self {
        let jobs = manifest.rows.iter().map(job).collect();
        Self { batch, jobs, chains: shard.of(chains(&manifest.rows)), shard, manifest: path.to_owned() }
    }

    /// How many jobs it runs.
    #[must_use]
    pub fn count(&self) -> usize {
        self.chains.iter().map(Vec::len).sum()
    }

    /// Whether it can be carried out without harm. [`run`](Self::run) asks this first.
    ///
    /// # Errors
    /// When a file that is read could be written, by name, or frames of a sequence cannot be animated.
    pub fn check(&self) -> Result<(), BatchError> {
        check(&self.batch, &self.manifest, &self.timing(), &self.sequences(), || self.jobs.iter())
    }

    /// Names, as of jobs, of the sequences of all parts.
    pub(super) fn sequences(&self) -> Vec<String> {
        animation::names(self.jobs.iter().map(|job| job.sequence.as_deref()))
    }

    /// Name of the file that this part writes its times to.
    #[must_use]
    pub fn timing(&self) -> String {
        timing(self.shard)
    }

    /// Hash of what all parts have in common.
    pub(super) fn fingerprint(&self) -> String {
        let Batch { format, pictures, animation, .. } = &self.batch;
        let jobs = self.jobs.iter().map(|job| (&job.name, &job.arguments, &job.settings, &job.sequence));
        sha256(format!("{format} {pictures} {animation:?} {:?}", jobs.collect::<Vec<_>>()).as_bytes())
    }
}

/// Name of the file that a part writes its times to.
pub(super) fn timing(shard: Shard) -> String {
    let part = if shard.is_whole() { String::new() } else { format!(".{shard}") };
    format!("summary{part}.timing.json")
}

/// Refuses jobs of which one would write what another, or this one, reads, and frames that cannot be animated. `jobs` tells them whenever
/// it is asked.
pub(super) fn check<J: Borrow<Job>, I: Iterator<Item = J>>(
    batch: &Batch,
    manifest: &Path,
    timing: &str,
    sequences: &[String],
    jobs: impl Fn() -> I,
) -> Result<(), BatchError> {
    animation::check(batch, jobs())?;
    let reads = || {
        let of_jobs = jobs().flat_map(|job| {
            let job = job.borrow();
            let of = |(role, path): &(String, PathBuf)| (format!("{role} of {:?}", job.name), path.clone());
            job.inputs.iter().map(of).collect::<Vec<_>>()
        });
        std::iter::once(("the manifest".to_owned(), manifest.to_owned())).chain(of_jobs)
    };
    let written = |what: String, name: &str, beside: &[String]| {
        let names: Vec<String> = batch.names(name).chain(beside.iter().cloned()).collect();
        // those that it would replace by others, or take away
        let earlier = Record::read(&batch.record_of(name)).map(|record| record.outputs).unwrap_or_default();
        let earlier = earlier.into_keys().filter(|name| !names.contains(name)).collect::<Vec<_>>();
        let all = names.into_iter().chain(earlier);
        all.map(|name| (what.clone(), batch.folder.join(name))).collect::<Vec<_>>()
    };
    let written = &written;
    let writes = || {
        let of_jobs = jobs().flat_map(|job| {
            let Job { name, beside, .. } = job.borrow();
            written(format!("result of {name:?}"), name, beside)
        });
        let of_sequences = sequences.iter().flat_map(|name| written(format!("animation {name:?}"), name, &[]));
        let shared = SUMMARY.map(str::to_owned).into_iter().chain([timing.to_owned()]);
        of_jobs.chain(of_sequences).chain(shared.map(|name| ("summary".to_owned(), batch.folder.join(name))))
    };
    Ok(check_files(reads, writes, &[("--out".to_owned(), batch.folder.join(HIDDEN))])?)
}
