//! Who writes into a folder of results: one batch at a time, or parts of one.
//!
//! Each holder has a file of its own below [`HIDDEN`] and looks for those of others once it is there, so that of two who come at one
//! moment both may be refused, but never both let in. The file outlives a crash. On the machine that wrote it, a look at the
//! process tells whether it still runs; from elsewhere, that the file is written again every [`BEAT`]. That of a holder who is gone is
//! taken away.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use super::job::read_json;
use super::{BatchError, Shard};
use crate::io::WriteError;

/// Folder of a batch's own files, below that of its results.
pub(super) const HIDDEN: &str = ".nonrigid";
/// How often a holder shows that it lives.
const BEAT: Duration = Duration::from_secs(30);
/// After so long without that, one on another machine is taken for gone.
const GONE: Duration = Duration::from_secs(300);

/// A process that writes into a folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Holder {
    /// Its number.
    pub pid: u32,
    /// Name of the machine.
    pub host: String,
    /// When it began, UTC.
    pub started: String,
    /// What it does: part and number of parts.
    pub shard: Shard,
    /// Hash of the whole batch.
    pub plan: String,
    /// What tells this process from others of its number.
    process: Process,
}

/// Empty where the system does not say.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Process {
    machine: String,
    boot: String,
    /// Numbers of processes mean something within this alone.
    namespace: String,
    /// Clock ticks from boot to start.
    ticks: String,
}

impl Process {
    fn here() -> Self {
        let text = |path: &str| fs::read_to_string(path).map(|t| t.trim().to_owned()).unwrap_or_default();
        Self {
            machine: text("/etc/machine-id"),
            boot: text("/proc/sys/kernel/random/boot_id"),
            namespace: fs::read_link("/proc/self/ns/pid").map(|p| p.display().to_string()).unwrap_or_default(),
            ticks: ticks(std::process::id()).unwrap_or_default(),
        }
    }
}

/// When a process of this machine that runs was started.
fn ticks(pid: u32) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // the name before it is in brackets and may hold anything
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let gone = matches!(fields.first(), Some(&("Z" | "X")));
    fields.get(19).filter(|_| !gone).map(|&ticks| ticks.to_owned())
}

impl Holder {
    fn here(shard: Shard, plan: &str) -> Self {
        let host = fs::read_to_string("/proc/sys/kernel/hostname").ok();
        let host = host.or_else(|| std::env::var("COMPUTERNAME").ok()).or_else(|| std::env::var("HOSTNAME").ok());
        Self {
            pid: std::process::id(),
            host: host.map_or_else(|| "unknown".to_owned(), |h| h.trim().to_owned()),
            started: utc(SystemTime::now()),
            shard,
            plan: plan.to_owned(),
            process: Process::here(),
        }
    }

    /// Whether it runs, as far as this machine knows.
    fn runs(&self) -> Option<bool> {
        let here = Process::here();
        let same = |a: &str, b: &str| !a.is_empty() && a == b;
        let of = &self.process;
        if same(&of.boot, &here.boot) && same(&of.namespace, &here.namespace) && !of.ticks.is_empty() {
            return Some(ticks(self.pid).as_ref() == Some(&of.ticks));
        }
        let rebooted = same(&of.machine, &here.machine) && !of.boot.is_empty() && of.boot != here.boot;
        rebooted.then_some(false)
    }

    /// Whether both may write at once: other parts of one batch.
    fn goes_with(&self, other: &Self) -> bool {
        self.plan == other.plan && self.shard.is_beside(other.shard)
    }
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "process {} on {} since {}", self.pid, self.host, self.started)
    }
}

/// A folder is this process's until this is dropped.
#[derive(Debug)]
pub(super) struct Lock {
    path: PathBuf,
    aside: PathBuf,
    lost: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
    heart: Option<JoinHandle<()>>,
}

impl Lock {
    /// Takes a folder. `said` is told of holders that are gone.
    pub(super) fn take(folder: &Path, shard: Shard, plan: &str, said: &dyn Fn(&str)) -> Result<Self, BatchError> {
        let holder = Holder::here(shard, plan);
        let hidden = folder.join(HIDDEN);
        let fail = |source| WriteError::Io { path: hidden.clone(), source };
        let bytes = serde_json::to_vec_pretty(&holder).map_err(|e| fail(e.into()))?;
        fs::create_dir_all(&hidden).map_err(fail)?;
        let host: String = holder.host.chars().filter(char::is_ascii_alphanumeric).take(40).collect();
        let (mut file, path) = (0..)
            .find_map(|k: u32| {
                let path = hidden.join(format!("{}-{host}-{k}.lock", holder.pid));
                match File::options().write(true).create_new(true).open(&path) {
                    Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => None,
                    made => Some(made.map(|file| (file, path))),
                }
            })
            .unwrap_or_else(|| Err(std::io::ErrorKind::AlreadyExists.into()))
            .map_err(fail)?;
        let (lost, ended) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let mut lock = Self { aside: path.with_extension("aside"), path, lost, ended, heart: None };
        file.write_all(&bytes).map_err(fail)?;
        lock.look_round(&hidden, &holder, said)?;
        fs::create_dir(&lock.aside).map_err(fail)?;
        let (path, lost, ended) = (lock.path.clone(), lock.lost.clone(), lock.ended.clone());
        lock.heart = Some(std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                std::thread::park_timeout(BEAT);
                // not made anew if somebody took it away; the same bytes, for the time that the file system gives them
                let beat = File::options().write(true).open(&path).and_then(|mut file| file.write_all(&bytes));
                if beat.is_err_and(|e| e.kind() == std::io::ErrorKind::NotFound) {
                    lost.store(true, Ordering::Relaxed);
                    return;
                }
            }
        }));
        Ok(lock)
    }

    fn look_round(&self, hidden: &Path, own: &Holder, said: &dyn Fn(&str)) -> Result<(), BatchError> {
        let fail = |source| WriteError::Io { path: hidden.to_owned(), source };
        let time = |path: &Path| fs::metadata(path).and_then(|m| m.modified());
        let now = time(&self.path).map_err(fail)?;
        let mut others: Vec<PathBuf> =
            fs::read_dir(hidden).and_then(|all| all.map(|e| e.map(|e| e.path())).collect()).map_err(fail)?;
        others.retain(|path| *path != self.path && path.extension().is_some_and(|e| e == "lock"));
        others.sort();
        for path in others {
            let Ok(beat) = time(&path) else { continue }; // it has ended meanwhile
            let other: Option<Holder> = read_json(&path);
            let fresh = now.duration_since(beat).is_ok_and(|age| age < GONE) || beat > now;
            let runs = other.as_ref().and_then(Holder::runs).unwrap_or(fresh);
            if runs && other.as_ref().is_some_and(|other| own.goes_with(other)) {
                continue;
            }
            let who = other.map_or_else(|| "a process that does not say which".to_owned(), |other| other.to_string());
            let folder = hidden.parent().unwrap_or(hidden).to_owned();
            if runs {
                return Err(BatchError::Taken { folder, who, lock: path });
            }
            let _ = fs::remove_dir_all(path.with_extension("aside")); // what it made and nobody will move
            match fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(fail(e).into()),
                _ => said(&format!("{}: taken over from {who}, which ended without a word", folder.display())),
            }
        }
        Ok(())
    }

    /// Where files are made before they replace others.
    pub(super) fn aside(&self) -> &Path {
        &self.aside
    }

    /// Whether another process took this one for gone, and the folder over.
    pub(super) fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(heart) = self.heart.take() {
            heart.thread().unpark();
            let _ = heart.join(); // it does nothing that could fail
        }
        let _ = fs::remove_dir_all(&self.aside); // what stays behind, the next one takes away
        let _ = fs::remove_file(&self.path);
        let _ = fs::remove_dir(self.path.parent().unwrap_or(Path::new(""))); // if nothing is in it
    }
}

/// Date and time; days by Hinnant's `civil_from_days`.
fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    // years begin in March, eras of 400 years on 0000-03-01
    let shifted = days + 719_468;
    let (era, day) = (shifted / 146_097, shifted % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let of_year = day - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let (day, month) = (of_year - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
    let year = year + 400 * era + u64::from(month <= 2);
    let (hour, minute, second) = (of_day / 3_600, of_day / 60 % 60, of_day % 60);
    format!("{year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_868_799, "2000-02-29 23:59:59 UTC"),
            (1_700_000_000, "2023-11-14 22:13:20 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(utc(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
    }

    /// Writes the lock of somebody else, so long ago.
    fn other(folder: &Path, name: &str, holder: &Holder, age: Duration) -> PathBuf {
        let path = folder.join(HIDDEN).join(name);
        fs::create_dir_all(path.with_extension("aside")).unwrap();
        fs::write(&path, serde_json::to_vec(holder).unwrap()).unwrap();
        File::options().write(true).open(&path).unwrap().set_modified(SystemTime::now() - age).unwrap();
        path
    }

    #[test]
    fn a_folder_has_one_holder_and_one_that_is_gone_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let said = RefCell::new(Vec::new());
        let take = |shard: &str, plan: &str| {
            Lock::take(folder, shard.parse().unwrap(), plan, &|text| said.borrow_mut().push(text.to_owned()))
        };
        let whole = take("1/1", "a").unwrap();
        assert!(whole.aside().is_dir());
        for (shard, plan) in [("1/1", "a"), ("1/2", "a")] {
            let error = take(shard, plan).unwrap_err().to_string();
            assert!(error.contains(&format!("process {} on ", std::process::id())), "{error}");
        }
        drop(whole);
        assert!(!folder.join(HIDDEN).exists());
        let part = take("1/3", "a").unwrap();
        let beside = take("2/3", "a").unwrap();
        for (shard, plan) in [("1/3", "a"), ("2/3", "a"), ("3/3", "b"), ("3/4", "a"), ("1/1", "a")] {
            assert!(matches!(take(shard, plan), Err(BatchError::Taken { .. })), "{shard} of {plan}");
        }
        drop((part, beside));
        assert!(said.borrow().is_empty());

        let here = Holder::here(Shard::whole(), "a");
        let elsewhere = Process { machine: "m".into(), boot: "b".into(), ..here.process.clone() };
        let elsewhere = Holder { host: "far".into(), pid: 77, process: elsewhere, ..here.clone() };
        let (young, old) = (Duration::from_secs(5), GONE + Duration::from_secs(5));
        let path = other(folder, "77-far-0.lock", &elsewhere, young);
        let error = take("1/1", "a").unwrap_err().to_string();
        assert!(error.contains("process 77 on far") && error.contains("77-far-0.lock"), "{error}");
        let path = {
            fs::remove_file(path).unwrap();
            other(folder, "77-far-0.lock", &elsewhere, old)
        };
        drop(take("1/1", "a").unwrap());
        assert!(
            said.borrow()[0].contains("process 77 on far") && !path.exists() && !path.with_extension("aside").exists()
        );
        if here.process.ticks.is_empty() {
            println!("skipped: this system does not tell of processes");
            return;
        }
        // of this machine: its process counts, however young the file
        let process = Process { ticks: "1".into(), ..here.process.clone() };
        other(folder, "1-here-0.lock", &Holder { process, ..here.clone() }, young);
        drop(take("1/1", "a").unwrap());
        let process = Process { boot: "before".into(), machine: "m".into(), ..here.process.clone() };
        other(folder, "1-here-0.lock", &Holder { process, ..here.clone() }, young);
        take("1/1", "a").unwrap_err();
        other(folder, "1-here-0.lock", &here, old);
        take("1/1", "a").unwrap_err();
        assert_eq!(said.borrow().len(), 2);
    }

    #[test]
    fn a_lock_that_somebody_took_away_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let lock = Lock::take(folder.path(), Shard::whole(), "a", &|_| {}).unwrap();
        assert!(!lock.is_lost());
        fs::remove_file(&lock.path).unwrap();
        lock.heart.as_ref().unwrap().thread().unpark();
        while !lock.is_lost() {
            std::thread::yield_now();
        }
    }
}
