//! Making the animated file of a sequence, by `nonrigid animate`, when its frames are done.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;

use super::animation::{ENDING, FOLDER, names};
use super::job::remove;
use super::run::{Ended, Run};
use super::{Animation, Batch, BatchError, Job, Record, Start, Status};
use crate::io::{WriteError, write_atomically};

impl Batch {
    /// Sequences of these jobs that have no animated file, and why.
    pub(super) fn without_animation(&self, jobs: &[Job]) -> Vec<(String, String)> {
        if self.animation.is_none() {
            return Vec::new();
        }
        let names = names(jobs.iter().map(|job| job.sequence.as_deref()));
        let failed = names.into_iter().filter_map(|name| {
            let failed = || Record::read(&self.record_of(&name)).filter(|record| record.status == Status::Failed);
            let error = self.broken_record(&name).or_else(|| failed()?.error)?;
            Some((name.trim_end_matches(ENDING).to_owned(), error))
        });
        failed.collect()
    }

    /// Takes away what an earlier run has made of a sequence, which shows results as they were then, now that nothing is made of it.
    /// Where somebody has changed a file of it, all of it stays, which is `said`: a later run with an animation finds it whole.
    pub(super) fn forget_animation(&self, name: &str, said: &dyn Fn(&str)) -> Result<(), WriteError> {
        let path = self.record_of(name);
        let Some(record) = Record::read(&path) else { return Ok(()) };
        if let Some(file) = record.changed(&self.folder).next() {
            let file = self.folder.join(file);
            said(&format!("{}: was changed since it was made, and stays: it may show earlier results", file.display()));
            return Ok(());
        }
        record.take_away(&self.folder, |_| true)?;
        record.others.iter().try_for_each(|other| remove(&self.folder.join(other)))?;
        remove(&path)
    }
}

impl Run<'_> {
    /// Makes the animated file of a chain whose jobs have ended so, unless it is there; false if it was interrupted.
    pub(super) fn animate(
        &self,
        chain: &[usize],
        ends: &[Record],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<bool, BatchError> {
        let frames: Vec<(&Job, &Record)> = chain.iter().map(|&k| &self.jobs[k]).zip(ends).collect();
        let Some((first, _)) = frames.first() else { return Ok(true) };
        let (Some(animation), Some(sequence)) = (&self.batch.animation, &first.sequence) else { return Ok(true) };
        let job = self.batch.animation_job(animation, sequence, first);
        if self.batch.broken_record(&job.name).is_some() {
            return Ok(true); // the summary says so
        }
        let lines: Vec<String> = frames.iter().map(|(job, record)| self.line(job, record)).collect();
        let known = Record::read(&self.batch.record(&job));
        let key = match job.key(Some(&lines.join("\n")), &self.hashes) {
            Ok(key) => key,
            Err(error) => {
                self.publish(&job, known.as_ref(), Record::failed(None, Start::Cold, error, known.as_ref()))?;
                return Ok(true);
            }
        };
        let done = known.as_ref().filter(|_| !self.batch.again);
        if done.and_then(|known| known.of_done(&key, &self.batch.folder)).is_some_and(|d| known.as_ref() == Some(&d)) {
            return Ok(true);
        }
        let ended = self.make(&job, &lines)?;
        if (self.lost)() {
            return Err(BatchError::Lost(self.batch.folder.clone()));
        }
        if ended.interrupted && stop() {
            self.clear(&job);
            return Ok(false);
        }
        let record = match ended.error {
            Some(error) => {
                self.clear_results(&job);
                Record::failed(Some(key), Start::Cold, error, known.as_ref())
            }
            None => {
                let outputs = Record::hashes(self.aside, &self.batch.outputs(&job.name));
                let (key, status, start) = (Some(key), Status::Done, Start::Cold);
                let (replaced, others) = (BTreeMap::new(), Vec::new());
                Record { key, status, start, error: None, outputs, replaced, others, kept: None }
            }
        };
        let said = format!("log/{}.txt", job.name);
        let others = if record.others.contains(&said) { record.others.clone() } else { vec![said] };
        match self.publish(&job, known.as_ref(), Record { others, ..record }) {
            Err(theirs @ (BatchError::Stranger { .. } | BatchError::Changed(_))) => {
                self.clear(&job);
                self.write_record(&job, &Record::failed(None, Start::Cold, theirs.to_string(), known.as_ref()))?;
            }
            published => drop(published?),
        }
        Ok(true)
    }

    /// What the list of frames says of one, and what decides it.
    fn line(&self, job: &Job, record: &Record) -> String {
        let mesh = format!("{}.{}", job.name, self.batch.format);
        // as it is now: somebody may have changed it
        let hashes = Record::hashes(&self.batch.folder, std::slice::from_ref(&mesh));
        match hashes.get(&mesh).filter(|_| record.status == Status::Done && record.outputs.contains_key(&mesh)) {
            Some(hash) => format!("{mesh}\t{hash}"),
            None => format!("- {}", job.name),
        }
    }

    fn make(&self, job: &Job, lines: &[String]) -> Result<Ended, WriteError> {
        if !lines.iter().any(|line| line.contains('\t')) {
            let error = "none of its frames is there";
            let path = self.aside.join(format!("log/{}.txt", job.name));
            fs::write(&path, format!("error: {error}\n")).map_err(|source| WriteError::Io { path, source })?;
            return Ok(Ended { error: Some(error.to_owned()), interrupted: false });
        }
        let list = self.aside.join(format!("{FOLDER}/{}.txt", job.name));
        write_atomically(&list, |file| {
            lines.iter().try_for_each(|line| match line.split_once('\t') {
                Some((mesh, _)) => writeln!(file, "./{mesh}"), // its name may start as other lines do
                None => writeln!(file, "{line}"),
            })
        })?;
        let mut command = self.batch.command_of("animate");
        command.arg("--meshes").arg(&self.batch.folder).arg("--list").arg(&list).args(job.arguments.iter().flatten());
        for (option, name) in ["--report", "--out"].into_iter().zip(self.batch.animation_files(&job.name)) {
            command.arg(option).arg(self.aside.join(name));
        }
        let ended = self.carry_out(command, job);
        let _ = fs::remove_file(&list); // it goes with the folder
        ended
    }
}

impl Batch {
    /// Report and file of a sequence that is called so as a job, if one is made.
    pub(super) fn animation_files(&self, name: &str) -> Vec<String> {
        let sequence = name.trim_end_matches(ENDING);
        let of = |extension| format!("{FOLDER}/{sequence}.{extension}");
        self.animation.iter().flat_map(|animation| ["json", &animation.format].map(of)).collect()
    }

    /// What makes the animation of a sequence whose first frame is `first`: its rig, if the format has weights.
    fn animation_job(&self, animation: &Animation, sequence: &str, first: &Job) -> Job {
        let setting = |option: &str, value: String| (option.to_owned(), value);
        let mut settings = vec![setting("fps", animation.frames_per_second.to_string())];
        settings.extend(animation.smooth.map(|hz| setting("smooth", hz.to_string())));
        let mut arguments: Vec<_> = settings.iter().map(|(o, v)| format!("--{o}={v}").into()).collect();
        if self.format != "glb" {
            arguments.push("--unit=meshes=mm".into()); // results are; glTF says metres itself
        }
        settings.push(setting("animation", animation.format.clone()));
        let mut inputs = Vec::new();
        if animation.format == "glb" {
            let of_rig = |argument: &&std::ffi::OsString| {
                let text = argument.to_string_lossy();
                ["--rig=", "--shape-kind=", "--identity-modes="].iter().any(|option| text.starts_with(option))
            };
            arguments.extend(first.arguments.iter().flatten().filter(of_rig).cloned());
            let decides = |(option, _): &&(String, String)| ["shape-kind", "identity-modes"].contains(&option.as_str());
            settings.extend(first.settings.iter().filter(decides).cloned());
            for unit in first.settings.iter().filter(|(option, _)| option == "unit").flat_map(|(_, v)| v.split(',')) {
                let of_rig = unit.strip_prefix("rig=").or((!unit.contains('=')).then_some(unit));
                if let Some(unit) = of_rig {
                    arguments.push(format!("--unit=rig={unit}").into());
                    settings.push(setting("unit", unit.to_owned()));
                }
            }
            inputs.extend(first.inputs.iter().filter(|(role, _)| role == "rig").cloned());
        }
        let name = format!("{sequence}{ENDING}");
        Job { name, arguments: Ok(arguments), settings, goes_on: false, sequence: None, beside: Vec::new(), inputs }
    }
}
