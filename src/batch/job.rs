//! One scan's registration, and what is known of it afterwards.

use std::collections::{BTreeMap, HashMap};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

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
    /// Files that are read, with what they are read as; `None` if they cannot be told.
    pub inputs: Option<Vec<(String, PathBuf)>>,
}

impl Job {
    /// Hash of everything that decides the result: version, settings, contents and names of files, and, for a frame that goes on
    /// from another one's end, that frame's key. `None` when a file cannot be read: nobody knows then what is done.
    #[must_use]
    pub fn key(&self, previous: Option<&str>, hashes: &Hashes) -> Option<String> {
        let mut hash = Sha256::new();
        let mut add = |text: &str| {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text);
        };
        add(env!("CARGO_PKG_VERSION"));
        let mut settings: Vec<_> = self.settings.iter().collect();
        settings.sort();
        for (option, value) in settings {
            add(option);
            add(value);
        }
        for (role, path) in self.inputs.as_ref()? {
            add(role);
            add(&path.file_name().unwrap_or_default().to_string_lossy());
            add(&hashes.of(path)?);
        }
        add(previous.unwrap_or("cold"));
        Some(hexadecimal(&hash.finalize()))
    }
}

/// Hashes of files, each read once.
#[derive(Debug, Default)]
pub struct Hashes(Mutex<HashMap<PathBuf, String>>);

impl Hashes {
    /// SHA-256, hexadecimal; `None` if the file cannot be read.
    pub fn of(&self, path: &Path) -> Option<String> {
        let known = || self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(hash) = known().get(path) {
            return Some(hash.clone());
        }
        let hash = hash_of(path)?;
        known().insert(path.to_owned(), hash.clone());
        Some(hash)
    }
}

fn hash_of(path: &Path) -> Option<String> {
    Some(hexadecimal(&Sha256::digest(std::fs::read(path).ok()?)))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
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
    /// SHA-256 of each output.
    pub outputs: BTreeMap<String, String>,
}

impl Record {
    /// Reads a record; `None` if there is none that can be read, which is as if nothing had been done.
    #[must_use]
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(path).ok()?).ok()
    }

    /// Whether it is of this key and its outputs are in `folder` as they were written.
    #[must_use]
    pub fn holds(&self, key: &str, folder: &Path) -> bool {
        let intact = |(name, hash): (&String, &String)| hash_of(&folder.join(name)).as_ref() == Some(hash);
        self.status == Status::Done && self.key.as_deref() == Some(key) && self.outputs.iter().all(intact)
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
            inputs: Some(vec![("target".into(), scan)]),
        };
        let key = |job: &Job, previous| job.key(previous, &Hashes::default());
        let first = job("arap", file("x/scan.ply", "points"));
        let base = key(&first, None);
        assert!(base.as_ref().is_some_and(|k| k.len() == 64));
        let mut turned = Job { name: "b".into(), ..job("arap", file("y/scan.ply", "points")) };
        turned.settings.reverse();
        assert_eq!(key(&turned, None), base, "folders, names and the order of options");
        let others = [
            key(&job("graph", file("x/scan.ply", "points")), None),
            key(&first, Some("k")),
            key(&job("arap", file("y/scan.ply", "other points")), None),
            key(&job("arap", file("y/other.ply", "points")), None),
        ];
        assert!(others.iter().all(|k| k.is_some() && *k != base));
        assert_eq!(key(&job("arap", folder.path().join("missing.ply")), None), None);
    }

    #[test]
    fn a_record_holds_while_its_outputs_do() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.obj"), "v").unwrap();
        let outputs = Record::hashes(folder.path(), &["a.obj".into(), "a.png".into()]);
        assert_eq!(outputs.len(), 1);
        let record = Record { key: Some("k".into()), status: Status::Done, start: Start::Cold, error: None, outputs };
        assert!(record.holds("k", folder.path()) && !record.holds("l", folder.path()));
        let failed = Record { status: Status::Failed, ..record.clone() };
        assert!(!failed.holds("k", folder.path()));
        std::fs::write(folder.path().join("a.obj"), "w").unwrap();
        assert!(!record.holds("k", folder.path()));
        std::fs::remove_file(folder.path().join("a.obj")).unwrap();
        assert!(!record.holds("k", folder.path()));
    }
}
