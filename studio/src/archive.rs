//! A case as one zip file: `case.json`, with every revision that undo reaches, and `assets/HASH/NAME`. What comes in is a stranger's: names
//! are checked, sizes limited, every asset has to have the hash that it says, and every revision to keep the rules that edits keep.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::case::{Case, FileRef};
use crate::error::{Problem, problem};
use crate::vault::{History, Vault, check_name, is_hash};

/// Version of the format; that before it has no history.
const FORMAT: u32 = 2;
/// Most entries.
const MOST: usize = 20_000;
/// Most bytes of all entries, unpacked.
const LARGEST: u64 = 8 << 30;
/// Most bytes that a byte of the file may become, beyond a first megabyte.
const RATIO: u64 = 200;

#[derive(Serialize, Deserialize)]
struct Document {
    format: u32,
    case: Case,
    #[serde(default)]
    history: Option<History>,
}

/// Its format, before anything else is understood.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

fn packed(error: ZipError) -> Problem {
    match error {
        ZipError::Io(error) => error.into(),
        error => problem(format!("the zip file cannot be written: {error}")),
    }
}

/// The files of an asset, in order, with their names.
fn files_of(vault: &Vault, asset: &str) -> Result<Vec<(String, PathBuf)>, Problem> {
    let folder = vault.path(&FileRef { asset: asset.to_owned(), file: String::new() })?;
    let named = |path: PathBuf| (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), path);
    let mut files = std::fs::read_dir(folder)?.map(|e| e.map(|e| named(e.path()))).collect::<Result<Vec<_>, _>>()?;
    files.sort();
    Ok(files)
}

/// A file of the vault with those that lie beside it, such as the materials of a mesh, as one zip file; where it is alone, itself.
///
/// # Errors
/// When a file cannot be read or the zip file not be written.
pub fn with_files_beside(vault: &Vault, at: &FileRef) -> Result<FileRef, Problem> {
    vault.path(at)?;
    let files = files_of(vault, &at.asset)?;
    if files.len() == 1 {
        return Ok(at.clone());
    }
    let stem = at.file.split('.').next().unwrap_or_default();
    vault.add_file(&format!("{stem}.zip"), |path| {
        let mut zip = ZipWriter::new(File::create(path)?);
        for (name, file) in &files {
            zip.start_file(name, SimpleFileOptions::default().large_file(true)).map_err(packed)?;
            std::io::copy(&mut File::open(file)?, &mut zip)?;
        }
        zip.finish().map(drop).map_err(packed)
    })
}

/// Packs a case and its history, and says how many steps of that are left out since their files are not what they were.
///
/// # Errors
/// When a file of the case itself is not what it was, or the zip file cannot be written.
pub fn export(vault: &Vault, id: u32) -> Result<(FileRef, usize), Problem> {
    let mut history = vault.history(id)?;
    let case = history.at_head().clone();
    let assets: BTreeSet<String> = history.cases().flat_map(Case::assets).map(str::to_owned).collect();
    let (assets, damaged): (BTreeSet<_>, BTreeSet<_>) = assets.into_iter().partition(|asset| vault.is_whole(asset));
    let of_case = case.assets_and_files().filter(|(asset, _)| damaged.contains(*asset));
    let names: BTreeSet<&str> = of_case.map(|(_, file)| if file.is_empty() { "the rig" } else { file }).collect();
    if !names.is_empty() {
        return Err(problem(format!(
            "nothing is exported, as files of this client are missing in the vault, cannot be read or were changed there: {}; \
             add the same ones again, or remove them from the client; wrap again where it is a result",
            Vec::from_iter(names).join(", ")
        )));
    }
    let left_out = history.retain(|case| !case.assets().any(|asset| damaged.contains(asset)));
    let mut plain = String::new();
    for c in case.name.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' }) {
        // the name of a file is counted in bytes
        if plain.len() + c.len_utf8() > 100 {
            break;
        }
        plain.push(c);
    }
    let at = vault.add_file(&format!("{plain}.zip"), |path| {
        let options = SimpleFileOptions::default().large_file(true);
        let mut zip = ZipWriter::new(File::create(path)?);
        // revisions are so alike that packed they would look like a bomb
        let plain = options.compression_method(zip::CompressionMethod::Stored);
        zip.start_file("case.json", plain).map_err(packed)?;
        let document = Document { format: FORMAT, case: case.clone(), history: Some(history.clone()) };
        zip.write_all(serde_json::to_string(&document).map_err(problem)?.as_bytes())?;
        for asset in &assets {
            for (name, file) in files_of(vault, asset)? {
                zip.start_file(format!("assets/{asset}/{name}"), options).map_err(packed)?;
                std::io::copy(&mut File::open(&file)?, &mut zip)?;
            }
        }
        zip.finish().map(drop).map_err(packed)
    })?;
    Ok((at, left_out))
}

/// Unpacks a case as a new one: its number.
///
/// # Errors
/// When it is none, or not whole; nothing has been added then.
pub fn import(vault: &Vault, path: &Path) -> Result<u32, Problem> {
    let no_case = |why: String| problem(format!("this is no case of the studio: {why}; export it again"));
    let file = File::open(path)?;
    let mut budget = (file.metadata()?.len().saturating_mul(RATIO) + (1 << 20)).min(LARGEST);
    let mut zip = ZipArchive::new(file).map_err(|_| no_case("it is no zip file, or not a whole one".to_owned()))?;
    if zip.len() > MOST {
        return Err(no_case(format!("it has {} entries, at most {MOST} are read", zip.len())));
    }
    let mut document = None;
    let mut assets: BTreeMap<String, crate::vault::Incoming> = BTreeMap::new();
    for index in 0..zip.len() {
        let broken = || no_case(format!("file {} in it cannot be unpacked", index + 1));
        let unpacked = |e: std::io::Error| if e.kind() == ErrorKind::StorageFull { e.into() } else { broken() };
        let mut entry = zip.by_index(index).map_err(|_| broken())?;
        let name = entry.name().to_owned();
        // one byte more than the budget shows that there is more, whatever the headers say
        let mut bytes = (&mut entry).take(budget + 1);
        let read = if name == "case.json" {
            let mut text = Vec::new();
            bytes.read_to_end(&mut text).map_err(unpacked)?;
            if text.len() as u64 <= budget {
                document = Some(text.clone());
            }
            text.len() as u64
        } else {
            let parts: Vec<&str> = name.split('/').collect();
            let ["assets", asset, file] = parts[..] else { return Err(no_case(format!("it holds {name:?}"))) };
            check_name(file)?;
            if !is_hash(asset) {
                return Err(no_case(format!("it holds {name:?}")));
            }
            if !assets.contains_key(asset) {
                assets.insert(asset.to_owned(), vault.incoming()?);
            }
            let target = assets[asset].folder.join(file);
            if target.exists() {
                return Err(no_case(format!("it holds {name:?} twice")));
            }
            std::io::copy(&mut bytes, &mut File::create(target)?).map_err(unpacked)?
        };
        budget =
            budget.checked_sub(read).ok_or_else(|| no_case("it unpacks to more than a case can have".to_owned()))?;
    }
    let document = document.ok_or_else(|| no_case("there is no case.json in it".to_owned()))?;
    let unreadable = |_| no_case("its case.json is not whole, or another program's".to_owned());
    let Format { format } = serde_json::from_slice(&document).map_err(unreadable)?;
    if !(1..=FORMAT).contains(&format) {
        return Err(no_case(format!("its format is {format}, this program knows 1 to {FORMAT}")));
    }
    let Document { case, history, .. } = serde_json::from_slice(&document).map_err(unreadable)?;
    let history = history.unwrap_or_else(|| History::of(case.clone()));
    if !history.is_sound() || *history.at_head() != case {
        return Err(no_case("its history does not lead to the case".to_owned()));
    }
    let mut checked = BTreeSet::new();
    for case in history.cases() {
        if let Some(missing) = case.assets().find(|asset| !assets.contains_key(*asset)) {
            return Err(no_case(format!("the file {missing} is missing")));
        }
        for FileRef { asset, file } in case.files().filter(|at| !at.file.is_empty()) {
            check_name(file)?;
            if !assets[asset].folder.join(file).is_file() {
                return Err(no_case(format!("the file {file:?} is missing")));
            }
        }
        for plan in case.plans.iter().filter(|plan| checked.insert(&plan.recipe)) {
            crate::plan::check(&plan.recipe)?;
        }
        case.check().map_err(|e| no_case(e.0))?;
        if case.wrapped.as_ref().is_some_and(|w| !crate::wrap::is_own_command(&w.command)) {
            return Err(no_case("its command line is not one that the studio makes".to_owned()));
        }
    }
    for (asset, incoming) in &assets {
        if vault.take(incoming)? != *asset {
            return Err(no_case(format!("the file {asset} was changed")));
        }
    }
    vault.add_history(&history)
}
