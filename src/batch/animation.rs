//! The animated files of sequences: what they are called, and what they say of their frames.

use std::borrow::Borrow;
use std::collections::{BTreeMap, HashMap, HashSet};

use serde_json::Value;

use super::job::read_json;
use super::{Batch, BatchError, Job, Record, Status};

/// How the frames of a sequence become one file.
#[derive(Debug, Clone, PartialEq)]
pub struct Animation {
    /// Extension: usda, pc2 or glb.
    pub format: String,
    /// Frames a second.
    pub frames_per_second: f64,
    /// Cutoff of smoothing in time, Hz; `None` for the frames as they are.
    pub smooth: Option<f64>,
}

/// Folder of animated files, below that of results.
pub(super) const FOLDER: &str = "sequences";
/// What the name of a sequence has behind it where names of jobs stand; no row's name ends so.
pub(super) const ENDING: &str = ".sequence";

/// Names, as of jobs, of the sequences of some rows, each once.
pub(super) fn names<'a>(sequences: impl Iterator<Item = Option<&'a str>>) -> Vec<String> {
    let mut seen = HashSet::new();
    let of_sequences = sequences.flatten().filter(|name| seen.insert(*name));
    of_sequences.map(|name| format!("{name}{ENDING}")).collect()
}

/// Refuses sequences that would have no animated file when all their frames are done: those are subdivided unlike each other, or unlike
/// the rig that is to explain them.
pub(super) fn check<J: Borrow<Job>>(batch: &Batch, jobs: impl Iterator<Item = J>) -> Result<(), BatchError> {
    let Some(animation) = &batch.animation else { return Ok(()) };
    let mut rounds_of = HashMap::new();
    for job in jobs {
        let job = job.borrow();
        let Some(sequence) = &job.sequence else { continue };
        let rounds = job.settings.iter().find(|(option, _)| option == "subdivide").map_or("0", |(_, rounds)| rounds);
        let refuse = |why| Err(BatchError::Frames { sequence: sequence.clone(), why });
        if animation.format == "glb" && rounds != "0" && job.inputs.iter().any(|(role, _)| role == "rig") {
            let why = "the rig's shapes do not have the vertices that --subdivide adds, and .glb is made of shapes";
            return refuse(format!("{why}; write --animation usda or pc2, or leave out --subdivide"));
        }
        let first = rounds_of.entry(sequence.clone()).or_insert_with(|| rounds.to_owned());
        if first != rounds {
            return refuse(format!("frame {:?} is subdivided {rounds} times, those before it {first}", job.name));
        }
    }
    Ok(())
}

/// What an animation says of its frames.
#[derive(Debug, Default)]
pub(super) struct Told {
    /// Why frames are lost, by name.
    lost: BTreeMap<String, String>,
    /// Why there is no animation.
    error: Option<String>,
}

/// What animations say, each read once.
#[derive(Debug, Default)]
pub(super) struct AllTold(HashMap<String, Told>);

impl AllTold {
    /// What is wrong with a job as a frame of its sequence, and whether it is lost.
    pub fn of(&mut self, batch: &Batch, job: &Job) -> Option<(String, bool)> {
        let sequence = job.sequence.as_ref().filter(|_| batch.animation.is_some())?;
        let told = self.0.entry(sequence.clone()).or_insert_with(|| Told::read(batch, sequence));
        if let Some(error) = &told.error {
            return Some((format!("no animated file of {sequence:?}: {error}"), false));
        }
        Some((format!("lost in {sequence:?}: {}", told.lost.get(&job.name)?), true))
    }
}

impl Told {
    fn read(batch: &Batch, sequence: &str) -> Self {
        let name = format!("{sequence}{ENDING}");
        let Some(record) = Record::read(&batch.record_of(&name)) else {
            return Self { error: batch.broken_record(&name), ..Self::default() };
        };
        if record.status == Status::Failed {
            return Self { error: record.error, ..Self::default() };
        }
        let report: Value = read_json(&batch.folder.join(format!("{FOLDER}/{sequence}.json"))).unwrap_or_default();
        let lost = |frame: &Value| Some((frame["name"].as_str()?.to_owned(), frame["lost"].as_str()?.to_owned()));
        Self { lost: report["frames"].as_array().into_iter().flatten().filter_map(lost).collect(), error: None }
    }
}
