//! What a command reads and what it could write, before it does either: the two have no file in common, nothing is written
//! twice, and every name can be one.
//!
//! Two paths are one file if they lead to one place, through links and `..`, or to one inode (hard links; file systems without
//! case). Files that are still to be made are one if their names differ by case alone.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasher as _, RandomState};
use std::path::{Component, Path, PathBuf};

/// Files of a command, each with what it is: an option, or a role.
#[derive(Debug, Clone, Default)]
pub struct FilePlan {
    reads: Vec<(String, PathBuf)>,
    writes: Vec<(String, PathBuf)>,
    folders: Vec<(String, PathBuf)>,
}

/// Why a plan must not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// An output is an input.
    #[error("{what} {}: would overwrite a file that is read ({role}{})", path.display(), other_name(path, read))]
    Clash {
        /// The output.
        what: String,
        /// Where it would be written.
        path: PathBuf,
        /// The input.
        role: String,
        /// What it is read from.
        read: PathBuf,
    },
    /// A folder of outputs has an input in it.
    #[error("{what} {}: {} in it is read ({role}); give another folder", path.display(), read.display())]
    Inside {
        /// The output.
        what: String,
        /// The folder.
        path: PathBuf,
        /// The input.
        role: String,
        /// What it is read from.
        read: PathBuf,
    },
    /// Two outputs are one file.
    #[error("{what} {}: {first} writes the same file{}", path.display(), other_name(path, other))]
    Twice {
        /// The later output.
        what: String,
        /// Where it would be written.
        path: PathBuf,
        /// The earlier one.
        first: String,
        /// Where that would be written.
        other: PathBuf,
    },
    /// A file and a folder would have one name.
    #[error("{what} {}: {first} writes a file {}, which cannot be a folder as well; give one of them another name", path.display(), other.display())]
    Below {
        /// The output inside the folder.
        what: String,
        /// Where it would be written.
        path: PathBuf,
        /// The output that is a file.
        first: String,
        /// Where that would be written.
        other: PathBuf,
    },
    /// A folder stands where a file would be written.
    #[error("{}: cannot be written: it is a folder, not a file ({what})", path.display())]
    Folder {
        /// The output.
        what: String,
        /// Where it would be written.
        path: PathBuf,
    },
    /// No file can have this name here.
    #[error("{}: cannot be written: {source} ({what}); give a shorter name", path.display())]
    Name {
        /// The output.
        what: String,
        /// Where it would be written.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
}

impl PlanError {
    /// Whether other arguments would help, not another place to write to.
    #[must_use]
    pub fn is_clash(&self) -> bool {
        matches!(self, Self::Clash { .. } | Self::Inside { .. } | Self::Twice { .. } | Self::Below { .. })
    }
}

fn other_name(path: &Path, other: &Path) -> String {
    if path == other { String::new() } else { format!(", as {}", other.display()) }
}

impl FilePlan {
    /// A plan to do nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A file will be read; one that is not there clashes with nothing but what would be made in its place.
    #[must_use]
    pub fn reads(mut self, role: impl Into<String>, path: impl Into<PathBuf>) -> Self {
        self.reads.push((role.into(), path.into()));
        self
    }

    /// [`Self::reads`] for each of several files.
    #[must_use]
    pub fn reads_all<R: Into<String>, P: Into<PathBuf>>(self, files: impl IntoIterator<Item = (R, P)>) -> Self {
        files.into_iter().fold(self, |plan, (role, path)| plan.reads(role, path))
    }

    /// A file could be written.
    #[must_use]
    pub fn writes(mut self, what: impl Into<String>, path: impl Into<PathBuf>) -> Self {
        self.writes.push((what.into(), path.into()));
        self
    }

    /// [`Self::writes`] for each of several files.
    #[must_use]
    pub fn writes_all<W: Into<String>, P: Into<PathBuf>>(self, files: impl IntoIterator<Item = (W, P)>) -> Self {
        files.into_iter().fold(self, |plan, (what, path)| plan.writes(what, path))
    }

    /// Files of names that are not known yet could be written anywhere in a folder.
    #[must_use]
    pub fn writes_in(mut self, what: impl Into<String>, folder: impl Into<PathBuf>) -> Self {
        self.folders.push((what.into(), folder.into()));
        self
    }

    /// Whether it can be carried out without harm.
    ///
    /// # Errors
    /// The first output, in the order in which they were given, that is a file that is read, is another output or its folder, is a
    /// folder, or has a name that no file can have.
    pub fn check(&self) -> Result<(), PlanError> {
        check_files(|| self.reads.iter().cloned(), || self.writes.iter().cloned(), &self.folders)
    }
}

/// Paths that were resolved, so that a file of many jobs is looked up once; no more of them, so that they always fit.
const RESOLVED: usize = 4096;

/// [`FilePlan::check`] of more files than fit in memory: `reads` and `writes` tell them anew, each with what it is, whenever they are
/// asked, in the same order. What is kept is a hash of 8 bytes for each place.
///
/// # Errors
/// As [`FilePlan::check`].
pub fn check_files<R, W>(
    reads: impl Fn() -> R,
    writes: impl Fn() -> W,
    folders: &[(String, PathBuf)],
) -> Result<(), PlanError>
where
    R: Iterator<Item = (String, PathBuf)>,
    W: Iterator<Item = (String, PathBuf)>,
{
    let hasher = RandomState::new();
    let mut places = Places::default();
    let folder_places: Vec<Place> = folders.iter().map(|(_, path)| places.of(path)).collect();
    let mut read_inside: Vec<Option<(String, PathBuf)>> = vec![None; folders.len()];
    let mut seen: HashSet<PathBuf> = HashSet::new();
    let mut read = Vec::new();
    for (role, path) in reads() {
        if seen.contains(&path) {
            continue;
        }
        let place = places.of(&path);
        read.extend(place.keys().iter().map(|key| hasher.hash_one(key)));
        for (inside, folder) in read_inside.iter_mut().zip(&folder_places) {
            if inside.is_none() && place.path.starts_with(&folder.path) {
                *inside = Some((role.clone(), path.clone()));
            }
        }
        if seen.len() < RESOLVED {
            seen.insert(path);
        }
    }
    read.sort_unstable();
    read.dedup();
    // what is wrong with an output itself, which those before it come first of
    let mut wrong = None;
    let mut written = Vec::new();
    // the folders that outputs would be in, and those that are outputs
    let mut above: HashSet<u64> = HashSet::new();
    let mut last_folder = None;
    let mut count = 0;
    for (what, path) in writes() {
        match std::fs::symlink_metadata(where_names_are_judged(&path)) {
            Err(source) if source.kind() == std::io::ErrorKind::InvalidFilename => {
                wrong = Some(PlanError::Name { what, path, source });
                break;
            }
            _ if path.is_dir() => {
                wrong = Some(PlanError::Folder { what, path });
                break;
            }
            _ => {}
        }
        let place = places.of(&path);
        written.extend(place.written_keys().iter().map(|key| hasher.hash_one(key)));
        let folder = place.path.parent().map(Path::to_owned);
        if folder != last_folder {
            above.extend(place.folder_keys().map(|key| hasher.hash_one(key)));
            last_folder = folder;
        }
        count += 1;
    }
    above.extend(folder_places.iter().flat_map(Place::folder_keys).map(|key| hasher.hash_one(key)));
    above.extend(folder_places.iter().map(|place| hasher.hash_one(place.any_case())));
    written.sort_unstable();
    let twice = written.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]);
    let mut suspects: HashSet<u64> = twice.collect();
    suspects.extend(written.iter().filter(|hash| read.binary_search(hash).is_ok() || above.contains(hash)));
    if !suspects.is_empty() {
        // whether the keys are the same as well, and of which files
        let suspect = |key: &Key| suspects.contains(&hasher.hash_one(key));
        let mut read_at: HashMap<Key, (String, PathBuf)> = HashMap::new();
        for (role, path) in reads() {
            for key in places.of(&path).keys().into_iter().filter(suspect) {
                read_at.entry(key).or_insert_with(|| (role.clone(), path.clone()));
            }
        }
        let mut written_at: HashMap<Key, (String, PathBuf)> = HashMap::new();
        for (what, path) in writes().take(count) {
            let place = places.of(&path);
            if let Some((role, read)) = place.keys().iter().find_map(|key| read_at.get(key)).cloned() {
                return Err(PlanError::Clash { what, path, role, read });
            }
            for key in place.written_keys().into_iter().filter(suspect) {
                if let Some((first, other)) = written_at.get(&key).cloned() {
                    return Err(PlanError::Twice { what, path, first, other });
                }
                written_at.insert(key, (what.clone(), path.clone()));
            }
        }
        let below = |place: &Place| place.folder_keys().find_map(|key| written_at.get(&key)).cloned();
        for (what, path) in writes().take(count) {
            if let Some((first, other)) = below(&places.of(&path)) {
                return Err(PlanError::Below { what, path, first, other });
            }
        }
        for ((what, path), place) in folders.iter().zip(&folder_places) {
            if let Some((first, other)) = below(place).or_else(|| written_at.get(&place.any_case()).cloned()) {
                return Err(PlanError::Below { what: what.clone(), path: path.clone(), first, other });
            }
        }
    }
    if let Some(wrong) = wrong {
        return Err(wrong);
    }
    for ((what, folder), inside) in folders.iter().zip(read_inside) {
        if let Some((role, read)) = inside {
            return Err(PlanError::Inside { what: what.clone(), path: folder.clone(), role, read });
        }
    }
    Ok(())
}

/// The path, or, where its folder is still to be made, its name in the next folder that is there: the system says first what is
/// missing, and then what is too long.
fn where_names_are_judged(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default();
    let mut folders = path.ancestors().skip(1);
    match folders.find(|folder| folder.as_os_str().is_empty() || folder.is_dir()) {
        Some(folder) => folder.join(name),
        None => path.to_owned(),
    }
}

/// What makes two paths one file.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Key {
    Path(PathBuf),
    /// Device and inode.
    Node(u64, u64),
    /// A path in lower case.
    AnyCase(String),
}

/// Where a path leads.
#[derive(Debug)]
struct Place {
    path: PathBuf,
    node: Option<(u64, u64)>,
}

impl Place {
    fn keys(&self) -> Vec<Key> {
        let node = self.node.map(|(device, inode)| Key::Node(device, inode));
        std::iter::once(Key::Path(self.path.clone())).chain(node).collect()
    }

    fn written_keys(&self) -> Vec<Key> {
        self.keys().into_iter().chain([self.any_case()]).collect()
    }

    fn any_case(&self) -> Key {
        Key::AnyCase(self.path.to_string_lossy().to_lowercase())
    }

    /// Of the folders that it is in.
    fn folder_keys(&self) -> impl Iterator<Item = Key> {
        self.path.ancestors().skip(1).map(|folder| Key::AnyCase(folder.to_string_lossy().to_lowercase()))
    }
}

/// Resolves paths; folders only once.
#[derive(Debug, Default)]
struct Places(HashMap<PathBuf, PathBuf>);

impl Places {
    fn of(&mut self, path: &Path) -> Place {
        match path.canonicalize() {
            Ok(resolved) => Place { path: resolved, node: node(path) },
            Err(_) => Place { path: self.unmade(path), node: None },
        }
    }

    /// Where a file would be made: a link that leads nowhere yet is followed, and folders that are there are resolved.
    fn unmade(&mut self, path: &Path) -> PathBuf {
        if let Ok(target) = std::fs::read_link(path) {
            let beside = path.parent().unwrap_or(Path::new("")).join(target);
            // a link to itself leads nowhere at all
            if beside != path && std::fs::read_link(&beside).is_err() {
                return self.unmade(&beside);
            }
        }
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = match (self.0.get(folder), path.components().next_back()) {
            (Some(known), _) => known.clone(),
            (None, Some(Component::RootDir | Component::Prefix(_)) | None) => return path.to_owned(),
            (None, _) => {
                let resolved = folder.canonicalize().unwrap_or_else(|_| self.unmade(folder));
                self.0.insert(folder.to_owned(), resolved.clone());
                resolved
            }
        };
        match path.components().next_back() {
            Some(Component::Normal(name)) => folder.join(name),
            Some(Component::ParentDir) => folder.parent().unwrap_or(&folder).to_owned(),
            _ => folder,
        }
    }
}

#[cfg(unix)]
fn node(path: &Path) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt as _;
    let metadata = std::fs::metadata(path).ok()?;
    Some((metadata.dev(), metadata.ino()))
}

#[cfg(not(unix))]
fn node(_: &Path) -> Option<(u64, u64)> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn one_file_under_two_names_is_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("scan.ply"), "scan").unwrap();
        std::fs::write(at("other.ply"), "other").unwrap();
        std::fs::create_dir(at("sub")).unwrap();
        std::fs::hard_link(at("scan.ply"), at("hard.ply")).unwrap();
        std::os::unix::fs::symlink("scan.ply", at("soft.ply")).unwrap();
        std::os::unix::fs::symlink(".", at("here")).unwrap();
        std::os::unix::fs::symlink("new.ply", at("towards.ply")).unwrap();
        std::os::unix::fs::symlink("round.ply", at("round.ply")).unwrap();
        let plan = |write: &str| FilePlan::new().reads("target", at("scan.ply")).writes("--out", at(write)).check();
        for name in ["scan.ply", "hard.ply", "soft.ply", "here/scan.ply", "sub/../scan.ply", "./sub/.././scan.ply"] {
            let error = plan(name).unwrap_err();
            assert!(error.is_clash() && error.to_string().contains("(target"), "{name}: {error}");
        }
        for name in ["other.ply", "Scan2.ply", "new.ply", "sub/scan.ply", "none/scan.ply", "round.ply"] {
            plan(name).unwrap();
        }
        let two = |a: &str, b: &str| FilePlan::new().writes("--out", at(a)).writes("--report", at(b)).check();
        for (a, b) in [
            ("new.ply", "new.ply"),
            ("new.ply", "sub/../new.ply"),
            ("new.ply", "New.PLY"),
            ("new.ply", "towards.ply"),
            ("none/a.ply", "none/b/../a.ply"),
            ("scan.ply", "hard.ply"),
        ] {
            let error = two(a, b).unwrap_err();
            assert!(matches!(error, PlanError::Twice { .. }), "{a} {b}: {error}");
        }
        two("new.ply", "none/new.ply").unwrap();
        for (a, b) in
            [("new.ply", "new.ply/page.html"), ("new.ply/page.html", "new.ply"), ("New.ply", "new.ply/pages/1.html")]
        {
            let error = two(a, b).unwrap_err();
            assert!(matches!(error, PlanError::Below { .. }) && error.is_clash(), "{a} {b}: {error}");
        }
        for folder in ["new.ply", "new.ply/pages"] {
            let plan = FilePlan::new().writes("--out", at("new.ply")).writes_in("--report", at(folder));
            assert!(matches!(plan.check(), Err(PlanError::Below { .. })), "{folder}");
        }
        FilePlan::new().writes("--out", at("pages/new.ply")).writes_in("--report", at("pages")).check().unwrap();

        let error = FilePlan::new().writes("--out", at("sub")).check().unwrap_err().to_string();
        assert!(error.contains("is a folder"), "{error}");
        let long = "x".repeat(300);
        let error = FilePlan::new().writes("--out", at(&long)).check().unwrap_err().to_string();
        assert!(error.contains(&long) && error.contains("shorter"), "{error}");
        assert!(FilePlan::new().writes("--out", at("none").join(&long)).check().is_err());

        let inside = |read: &str, folder: &str| {
            FilePlan::new().reads("rig", at(read)).writes_in("--out", at(folder)).check().is_err()
        };
        assert!(inside("scan.ply", "sub/..") && inside("scan.ply", "") && !inside("scan.ply", "sub"));
        assert!(!inside("scan.ply", "scan.pl"));
    }
}
