//! One scan's registration, and what is known of it afterwards.

use std::collections::{BTreeMap, HashMap};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::io::{WriteError, read_side_file, sha256, sha256_of_file};

/// What is to be run.
#[derive(Debug, Clone)]
pub struct Job {
    /// Name of its outputs.
    pub name: String,
    /// Arguments of the program, without those of outputs; or what is wrong with them.
    pub arguments: Result<Vec<OsString>, String>,
    /// What decides the result besides files: option and value.
    pub settings: Vec<(String, String)>,
    /// Whether it may go on from the end of the frame before: only with landmarks, without which a face that was lost once stays
    /// lost, and nothing tells.
    pub goes_on: bool,
    /// The sequence whose frame it is.
    pub sequence: Option<String>,
    /// Names of files that it may write beside its results: images, materials.
    pub beside: Vec<String>,
    /// Files that are read, with what they are read as.
    pub inputs: Vec<(String, PathBuf)>,
}

impl Job {
    /// Hash of everything that decides the result: version, settings, contents and names of files, and, for a frame that goes on
    /// from another one's end, that frame's key.
    ///
    /// # Errors
    /// When a file cannot be read, with what is wrong with it: nobody knows then what is done.
    pub fn key(&self, previous: Option<&str>, hashes: &Hashes) -> Result<String, String> {
        self.key_by(previous, |_, path| hashes.of(path))
    }

    /// The key of a job that has read these files, as it says: one that changed meanwhile counts with what was in it then.
    pub(super) fn key_of_what_was_read(
        &self,
        previous: Option<&str>,
        hashes: &Hashes,
        read: &[InputHash],
    ) -> Result<String, String> {
        let mut left: Vec<&InputHash> = read.iter().collect();
        self.key_by(previous, |role, path| {
            let name = name_of(path);
            match left.iter().position(|input| input.role == role && input.name == name) {
                Some(at) => Ok(left.remove(at).sha256.clone()),
                // a file of the rig's folder, which may hold others
                None => hashes.of(path),
            }
        })
    }

    fn key_by(
        &self,
        previous: Option<&str>,
        mut hash_of: impl FnMut(&str, &Path) -> Result<String, String>,
    ) -> Result<String, String> {
        let mut text = Vec::new();
        let mut add = |part: &str| {
            text.extend_from_slice(&(part.len() as u64).to_le_bytes());
            text.extend_from_slice(part.as_bytes());
        };
        add(env!("CARGO_PKG_VERSION"));
        let mut settings: Vec<_> = self.settings.iter().collect();
        settings.sort();
        for (option, value) in settings {
            add(option);
            add(value);
        }
        for (role, path) in &self.inputs {
            add(role);
            add(&name_of(path));
            add(&hash_of(role, path)?);
        }
        add(previous.unwrap_or("cold"));
        Ok(sha256(&text))
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Hashes of files, each read once.
#[derive(Debug, Default)]
pub struct Hashes(Mutex<HashMap<PathBuf, String>>);

impl Hashes {
    /// SHA-256, hexadecimal.
    ///
    /// # Errors
    /// When the file cannot be read, or is none that can be read twice: what is wrong with it, by name.
    pub fn of(&self, path: &Path) -> Result<String, String> {
        let known = || self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(hash) = known().get(path) {
            return Ok(hash.clone());
        }
        let hash = sha256_of_file(path).map_err(|e| format!("{}: cannot be read: {e}", path.display()))?;
        known().insert(path.to_owned(), hash.clone());
        Ok(hash)
    }
}

/// What a report says of a file that was read.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct InputHash {
    role: String,
    name: String,
    sha256: String,
}

fn hash_of(path: &Path) -> Option<String> {
    sha256_of_file(path).ok()
}

/// What a batch has written as JSON; `None` if there is none that can be read. A pipe is not opened: that waits for who writes it.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&read_side_file(path).ok()?).ok()
}

/// Removes a file, if it is there.
pub(super) fn remove(path: &Path) -> Result<(), WriteError> {
    match std::fs::remove_file(path) {
        Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
            Err(WriteError::Io { path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}

/// How a job ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Its outputs are there.
    Done,
    /// They are not.
    Failed,
}

/// Where a registration started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// By landmarks or search.
    Cold,
    /// From the end of the frame before.
    Warm,
    /// By landmarks or search, as from the end of the frame before it failed or was doubtful.
    ColdAgain,
}

/// What is known of a job, in `log/NAME.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// [`Job::key`].
    pub key: Option<String>,
    /// How it ended.
    pub status: Status,
    /// Where it started.
    pub start: Start,
    /// What went wrong.
    pub error: Option<String>,
    /// SHA-256 of each output; of a job that failed, those that an earlier run has left.
    pub outputs: BTreeMap<String, String>,
    /// SHA-256 of what these replace, until they have: a run that ended between this record and its files has left that.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub replaced: BTreeMap<String, String>,
    /// Other files that it has written: what was said, times.
    pub others: Vec<String>,
    /// Of a job that failed: the run whose outputs are still there.
    pub kept: Option<Kept>,
}

/// An earlier run of a job that failed since.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// [`Job::key`].
    pub key: Option<String>,
    /// Where it started.
    pub start: Start,
}

impl Record {
    /// Reads a record; `None` if there is none that can be read, which is as if nothing had been done.
    #[must_use]
    pub fn read(path: &Path) -> Option<Self> {
        read_json(path)
    }

    /// The record of the run whose outputs are there: this, or of a job that has failed since the one that was [kept](Kept).
    #[must_use]
    pub fn standing(&self) -> Option<Self> {
        match (self.status, &self.kept) {
            (Status::Done, _) => Some(self.clone()),
            (Status::Failed, Some(Kept { key, start })) => {
                let (key, start) = (key.clone(), *start);
                Some(Self { key, status: Status::Done, start, error: None, kept: None, ..self.clone() })
            }
            (Status::Failed, None) => None,
        }
    }

    /// [`Self::standing`], if it has this key and its outputs are in `folder`, as they were written or as somebody has made them since.
    #[must_use]
    pub fn of_done(&self, key: &str, folder: &Path) -> Option<Self> {
        let there = |(name, hash): (&String, &String)| {
            let found = hash_of(&folder.join(name));
            found.is_some_and(|found| found == *hash || self.is_of_somebody(folder, name, &found))
        };
        self.standing().filter(|done| done.key.as_deref() == Some(key) && done.outputs.iter().all(there))
    }

    /// Whether an output whose hash is not the one it was written with is somebody's work: not what an earlier run has left, nor, empty
    /// or nothing but zeros, what a power cut has.
    fn is_of_somebody(&self, folder: &Path, name: &str, found: &str) -> bool {
        let is_blank = || std::fs::read(folder.join(name)).is_ok_and(|bytes| bytes.iter().all(|byte| *byte == 0));
        self.replaced.get(name).is_none_or(|replaced| replaced != found) && !is_blank()
    }

    /// The outputs in `folder` that somebody has changed since they were written.
    pub fn changed<'a>(&'a self, folder: &'a Path) -> impl Iterator<Item = &'a String> {
        let changed = move |(name, hash): &(&String, &String)| {
            let found = hash_of(&folder.join(name));
            found.is_some_and(|found| found != **hash && self.is_of_somebody(folder, name, &found))
        };
        self.outputs.iter().filter(changed).map(|output| output.0)
    }

    /// Takes those of its outputs away that are `left` over and nobody has changed: they would be taken for those of a later run.
    pub(super) fn take_away(&self, folder: &Path, left: impl Fn(&str) -> bool) -> Result<(), WriteError> {
        let changed: Vec<&String> = self.changed(folder).collect();
        for name in self.outputs.keys().filter(|name| left(name) && !changed.contains(name)) {
            remove(&folder.join(name))?;
        }
        Ok(())
    }

    /// Whether a file of the folder of results is one that this job has written.
    #[must_use]
    pub fn lists(&self, name: &str) -> bool {
        self.outputs.contains_key(name) || self.others.iter().any(|other| other == name)
    }

    /// The hashes of files of a folder, of those that are there.
    pub(super) fn hashes(folder: &Path, names: &[String]) -> BTreeMap<String, String> {
        names.iter().filter_map(|name| Some((name.clone(), hash_of(&folder.join(name))?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_changes_with_whatever_decides_the_result_and_with_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, content: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, content).unwrap();
            path
        };
        let job = |model: &str, scan: PathBuf| Job {
            name: "a".into(),
            arguments: Ok(Vec::new()),
            settings: vec![("model".into(), model.into()), ("identity-modes".into(), "4".into())],
            goes_on: true,
            sequence: None,
            beside: Vec::new(),
            inputs: vec![("target".into(), scan)],
        };
        let key = |job: &Job, previous| job.key(previous, &Hashes::default());
        let first = job("arap", file("x/scan.ply", "points"));
        let base = key(&first, None);
        assert!(base.as_ref().is_ok_and(|k| k.len() == 64));
        let mut turned = Job { name: "b".into(), ..job("arap", file("y/scan.ply", "points")) };
        turned.settings.reverse();
        assert_eq!(key(&turned, None), base, "folders, names and the order of options");
        let others = [
            key(&job("graph", file("x/scan.ply", "points")), None),
            key(&first, Some("k")),
            key(&job("arap", file("y/scan.ply", "other points")), None),
            key(&job("arap", file("y/other.ply", "points")), None),
        ];
        assert!(others.iter().all(|k| k.is_ok() && *k != base));
        let error = key(&job("arap", folder.path().join("missing.ply")), None).unwrap_err();
        assert!(error.contains("missing.ply: cannot be read"), "{error}");
        assert!(key(&job("arap", folder.path().to_owned()), None).unwrap_err().contains("no regular file"));

        // what was in a file when it was read
        let read = |role: &str, content: &str| InputHash {
            role: role.into(),
            name: "scan.ply".into(),
            sha256: sha256(content.as_bytes()),
        };
        let of_read = |read: &[InputHash]| first.key_of_what_was_read(None, &Hashes::default(), read);
        assert_eq!(of_read(&[read("target", "points")]), base);
        assert_eq!(of_read(&[read("template", "others")]), base);
        let before = of_read(&[read("target", "other points")]);
        assert_eq!(before, key(&job("arap", file("z/scan.ply", "other points")), None));
    }

    #[test]
    fn a_record_holds_while_its_outputs_do() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.obj"), "v").unwrap();
        let outputs = Record::hashes(folder.path(), &["a.obj".into(), "a.png".into()]);
        assert_eq!(outputs.len(), 1);
        let (start, others) = (Start::Cold, vec!["log/a.txt".into()]);
        let key = Some("k".to_owned());
        let record = Record {
            key: key.clone(),
            status: Status::Done,
            start,
            error: None,
            outputs,
            replaced: BTreeMap::new(),
            others,
            kept: None,
        };
        let holds = |record: &Record, key: &str| record.of_done(key, folder.path()).is_some();
        assert!(holds(&record, "k") && !holds(&record, "l"));
        assert!(record.lists("a.obj") && record.lists("log/a.txt") && !record.lists("a.png"));
        let failed = Record { key: Some("l".into()), status: Status::Failed, ..record.clone() };
        assert!(!holds(&failed, "k") && !holds(&failed, "l"));
        let kept = Record { error: Some("no".into()), kept: Some(Kept { key, start }), ..failed };
        assert_eq!(kept.of_done("k", folder.path()), Some(record.clone()));
        assert!(!holds(&kept, "l"));
        assert_eq!(record.changed(folder.path()).next(), None);
        std::fs::write(folder.path().join("a.obj"), "w").unwrap();
        assert!(holds(&record, "k") && holds(&kept, "k"), "somebody has changed it");
        assert_eq!(record.changed(folder.path()).next().unwrap(), "a.obj");
        let replaced = Record::hashes(folder.path(), &["a.obj".to_owned()]);
        let ended = Record { replaced, ..record.clone() };
        assert!(!holds(&ended, "k") && ended.changed(folder.path()).next().is_none(), "it is of the run before");
        for blank in ["", "\0\0\0"] {
            std::fs::write(folder.path().join("a.obj"), blank).unwrap();
            assert!(!holds(&record, "k") && record.changed(folder.path()).next().is_none(), "a power cut has left it");
        }
        std::fs::remove_file(folder.path().join("a.obj")).unwrap();
        assert!(!holds(&record, "k"));
    }
}
