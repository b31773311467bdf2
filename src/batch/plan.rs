//! What a batch will do, before it does any of it.

use std::path::{Path, PathBuf};

use super::lock::HIDDEN;
use super::{Batch, Job, Manifest, Record, Row, Shard, chains};
use crate::mesh::io::{FilePlan, PlanError, sha256};

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

    /// Everything that jobs read and could write, those of other parts included.
    #[must_use]
    pub fn files(&self) -> FilePlan {
        let mut plan = FilePlan::new().reads("the manifest", &self.manifest);
        for job in &self.jobs {
            plan = plan.reads_all(job.inputs.iter().map(|(role, path)| (format!("{role} of {:?}", job.name), path)));
        }
        for job in &self.jobs {
            let names = self.batch.names(&job.name);
            let names: Vec<String> = names.collect();
            // those that it would replace by others
            let earlier = Record::read(&self.batch.record(job)).map(|record| record.outputs).unwrap_or_default();
            let earlier = earlier.into_keys().filter(|name| !names.contains(name)).collect::<Vec<_>>();
            let all = names.into_iter().chain(earlier);
            plan = plan.writes_all(all.map(|name| (format!("result of {:?}", job.name), self.batch.folder.join(name))));
        }
        let shared = SUMMARY.map(str::to_owned).into_iter().chain([self.timing()]);
        plan = plan.writes_all(shared.map(|name| ("summary", self.batch.folder.join(name))));
        plan.writes_in("--out", self.batch.folder.join(HIDDEN))
    }

    /// Whether it can be carried out without harm. [`run`](Self::run) asks this first.
    ///
    /// # Errors
    /// When a file that is read could be written, by name.
    pub fn check(&self) -> Result<(), PlanError> {
        self.files().check()
    }

    /// Name of the file that this part writes its times to.
    #[must_use]
    pub fn timing(&self) -> String {
        let part = if self.shard.is_whole() { String::new() } else { format!(".{}", self.shard) };
        format!("summary{part}.timing.json")
    }

    /// Hash of what all parts have in common.
    pub(super) fn fingerprint(&self) -> String {
        let Batch { format, pictures, .. } = &self.batch;
        let jobs = self.jobs.iter().map(|job| (&job.name, &job.arguments, &job.settings));
        sha256(format!("{format} {pictures} {:?}", jobs.collect::<Vec<_>>()).as_bytes())
    }
}
