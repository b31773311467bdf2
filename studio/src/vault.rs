//! The vault: cases and articles in an SQLite database, meshes and pictures as files beside it.
//!
//! ```text
//! DIR/vault.sqlite         cases, every revision of them, which files were made of them besides, articles
//! DIR/assets/HASH/NAME     files that were added together, under their own names; HASH is that of names and contents
//! DIR/incoming/...         what is being written; swept when it is a day old
//! ```
//!
//! Every change of a case is one transaction that reads the newest revision, applies an [`Edit`] and writes the next one: whatever is
//! killed when, the vault holds a whole case, and several windows, or programs, on one vault never write over each other.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write as _;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use nonrigid::io::{sha256, sha256_of_file};
use rusqlite::{Connection, OptionalExtension as _, Transaction, TransactionBehavior, params};
use serde::{Deserialize, Serialize};
use ts_rs::TS;

use crate::case::{Case, Edit, FileRef};
use crate::error::{Problem, problem};

/// Steps from one version of the schema to the next; `user_version` counts those that are done.
const MIGRATIONS: [&str; 3] = [
    "CREATE TABLE cases (id INTEGER PRIMARY KEY AUTOINCREMENT, head INTEGER NOT NULL, touched INTEGER NOT NULL) STRICT;
     CREATE TABLE revisions (
         case_id INTEGER NOT NULL REFERENCES cases (id) ON DELETE CASCADE,
         number INTEGER NOT NULL, label TEXT NOT NULL, document TEXT NOT NULL,
         PRIMARY KEY (case_id, number)) STRICT, WITHOUT ROWID;",
    "CREATE TABLE articles (
         id INTEGER PRIMARY KEY AUTOINCREMENT, title TEXT NOT NULL, tags TEXT NOT NULL, body TEXT NOT NULL,
         recipe TEXT NOT NULL) STRICT;",
    "CREATE TABLE leftovers (
         case_id INTEGER NOT NULL REFERENCES cases (id) ON DELETE CASCADE, asset TEXT NOT NULL,
         PRIMARY KEY (case_id, asset)) STRICT, WITHOUT ROWID;",
];

/// Every revision of a case that undo and redo reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Which of them is the case, from 0.
    head: usize,
    /// What undo calls each, and the case as it was then; at least one.
    revisions: Vec<(String, Case)>,
}

impl History {
    /// That of a case without one.
    #[must_use]
    pub fn of(case: Case) -> Self {
        Self { head: 0, revisions: vec![("new case".to_owned(), case)] }
    }

    /// Whether its head is one of its revisions: of what was read, nobody knows.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.head < self.revisions.len()
    }

    /// The case.
    ///
    /// # Panics
    /// Unless it [is sound](Self::is_sound).
    #[must_use]
    pub fn at_head(&self) -> &Case {
        &self.revisions[self.head].1
    }

    /// Leaves out what does not hold, but for the case itself: how many of them.
    pub fn retain(&mut self, holds: impl Fn(&Case) -> bool) -> usize {
        let before = self.revisions.len();
        let stay: Vec<bool> =
            self.revisions.iter().enumerate().map(|(n, (_, case))| n == self.head || holds(case)).collect();
        self.head = stay[..self.head].iter().filter(|stays| **stays).count();
        let mut stays = stay.into_iter();
        self.revisions.retain(|_| stays.next() == Some(true));
        before - self.revisions.len()
    }

    /// All of them, the oldest first.
    pub fn cases(&self) -> impl Iterator<Item = &Case> {
        self.revisions.iter().map(|(_, case)| case)
    }
}

/// A case as the list shows it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, TS)]
pub struct CaseSummary {
    /// Its number.
    pub id: u32,
    /// The client.
    pub name: String,
    /// Date, as the user has written it.
    pub date: String,
    /// Beginning of the notes.
    pub notes: String,
    /// When it was changed last, seconds since 1970.
    #[ts(type = "number")]
    pub touched: i64,
    /// Scans.
    pub scans: u32,
    /// Whether a template is wrapped.
    pub wrapped: bool,
    /// Plans that have steps.
    pub plans: u32,
    /// Why it cannot be read, where it cannot: nothing else is known of it then.
    pub trouble: Option<String>,
}

/// A case at its newest revision.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenCase {
    /// Its number.
    pub id: u32,
    /// Revision.
    pub revision: u32,
    /// The document.
    pub case: Case,
    /// What undo would take back.
    pub undo: Option<String>,
    /// What redo would do again.
    pub redo: Option<String>,
}

/// An article of the knowledge base.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, TS)]
pub struct Article {
    /// Its number; 0 for a new one.
    pub id: u32,
    /// Title.
    pub title: String,
    /// Tags, separated by blanks.
    pub tags: String,
    /// Markdown.
    pub body: String,
    /// A recipe (TOML), or nothing.
    pub recipe: String,
}

/// A vault that is open.
pub struct Vault {
    folder: PathBuf,
    /// What tells its database's file from another one in its place.
    identity: Option<(u64, u64)>,
    database: Mutex<Connection>,
}

/// Device and number of the database's file in this folder.
#[cfg(unix)]
fn identity(folder: &Path) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt as _;
    fs::metadata(folder.join("vault.sqlite")).ok().map(|file| (file.dev(), file.ino()))
}

/// Elsewhere a file that is open stays where it is.
#[cfg(not(unix))]
fn identity(_: &Path) -> Option<(u64, u64)> {
    None
}

/// Most bytes of one file.
pub const LARGEST_FILE: u64 = 2 << 30;
/// Most files of one asset.
pub const MOST_FILES: usize = 2000;

impl Vault {
    /// Opens a vault, makes it where there is none, and brings its schema to this version.
    ///
    /// # Errors
    /// When the folder cannot be made or written, or a newer program has written it.
    pub fn open(folder: &Path) -> Result<Self, Problem> {
        Self::opened(folder).map_err(|Problem(error)| {
            problem(format!("{}: cannot be a vault: {error}; choose another folder with --vault", folder.display()))
        })
    }

    fn opened(folder: &Path) -> Result<Self, Problem> {
        for part in ["assets", "incoming"] {
            fs::create_dir_all(folder.join(part))?;
        }
        // a command that is copied elsewhere needs the whole path
        let folder = folder.canonicalize()?;
        let mut database = Connection::open(folder.join("vault.sqlite"))?;
        database.busy_timeout(Duration::from_secs(20))?;
        database.execute_batch(
            "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA secure_delete = ON;",
        )?;
        let change = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let version: usize = change.query_row("PRAGMA user_version", [], |row| row.get(0))?;
        if version > MIGRATIONS.len() {
            let message =
                format!("its version is {version}, this program knows {}; use the newer one", MIGRATIONS.len());
            return Err(problem(message));
        }
        for migration in &MIGRATIONS[version..] {
            change.execute_batch(migration)?;
        }
        change.pragma_update(None, "user_version", MIGRATIONS.len())?;
        if version < 2 {
            for article in crate::knowledge::first_articles() {
                insert_article(&change, &article)?;
            }
        }
        change.commit()?;
        let vault = Self { identity: identity(&folder), folder, database: Mutex::new(database) };
        vault.sweep()?;
        Ok(vault)
    }

    /// The database, while it is the one in the folder: what is written to a file that was removed or replaced is lost.
    fn database(&self) -> Result<MutexGuard<'_, Connection>, Problem> {
        if identity(&self.folder) != self.identity {
            return Err(problem(format!(
                "the vault {} was moved, removed or replaced while the program runs, so nothing is kept: put it back, or start the \
                 program again with --vault",
                self.folder.display()
            )));
        }
        // a panic elsewhere rolls its transaction back; the connection stays sound
        Ok(self.database.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// A number that grows when another program changes the vault.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub fn foreign_version(&self) -> Result<i64, Problem> {
        Ok(self.database()?.query_row("PRAGMA data_version", [], |row| row.get(0))?)
    }

    /// Cases whose name, date, notes or plans contain `query`, the last changed one first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub fn cases(&self, query: &str) -> Result<Vec<CaseSummary>, Problem> {
        let database = self.database()?;
        let mut rows = database.prepare(
            "SELECT c.id, c.touched, r.document FROM cases c JOIN revisions r ON r.case_id = c.id AND r.number = c.head
             ORDER BY c.touched DESC, c.id DESC",
        )?;
        let rows = rows.query_map([], |row| Ok((row.get::<_, u32>(0)?, row.get(1)?, row.get::<_, String>(2)?)))?;
        let query = query.to_lowercase();
        let mut found = Vec::new();
        for row in rows {
            let (id, touched, document) = row?;
            let case = match parse(id, &document) {
                Ok(case) => case,
                // listed whatever is looked for, and the others can be opened
                Err(Problem(why)) => {
                    let (name, trouble) = (format!("case {id}"), Some(why));
                    found.push(CaseSummary { id, name, touched, trouble, ..CaseSummary::default() });
                    continue;
                }
            };
            let plans = case.plans.iter().map(|p| p.name.as_str());
            let words: Vec<&str> = [&*case.name, &*case.date, &*case.notes].into_iter().chain(plans).collect();
            if words.join("\n").to_lowercase().contains(&query) {
                found.push(CaseSummary {
                    id,
                    notes: case.notes.chars().take(120).collect(),
                    touched,
                    scans: case.scans.len() as u32,
                    wrapped: case.wrapped.is_some(),
                    plans: case.plans.iter().filter(|p| !crate::plan::is_empty(&p.recipe)).count() as u32,
                    name: case.name,
                    date: case.date,
                    trouble: None,
                });
            }
        }
        Ok(found)
    }

    /// Adds a case.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub fn add_case(&self, case: &Case) -> Result<u32, Problem> {
        self.add_history(&History::of(case.clone()))
    }

    /// Adds a case with its history.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub fn add_history(&self, history: &History) -> Result<u32, Problem> {
        let mut database = self.database()?;
        let change = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let head = u32::try_from(history.head + 1).map_err(problem)?;
        change.execute("INSERT INTO cases (head, touched) VALUES (?1, ?2)", params![head, now()])?;
        let id = u32::try_from(change.last_insert_rowid()).map_err(problem)?;
        for (number, (label, case)) in (1..).zip(&history.revisions) {
            write_revision(&change, id, number, label, case)?;
        }
        change.commit()?;
        Ok(id)
    }

    /// A case with its history.
    ///
    /// # Errors
    /// When it is not there.
    pub fn history(&self, id: u32) -> Result<History, Problem> {
        let mut database = self.database()?;
        // one view of it, whatever other windows write
        let view = database.transaction()?;
        let open = read(&view, id)?;
        let mut rows =
            view.prepare("SELECT number, label, document FROM revisions WHERE case_id = ?1 ORDER BY number")?;
        let rows = rows.query_map([id], |row| Ok((row.get::<_, u32>(0)?, row.get(1)?, row.get::<_, String>(2)?)))?;
        let mut history = History { head: 0, revisions: Vec::new() };
        for row in rows {
            let (number, label, document): (u32, String, String) = row?;
            if number == open.revision {
                history.head = history.revisions.len();
            }
            history.revisions.push((label, parse(id, &document)?));
        }
        Ok(history)
    }

    /// A case at its newest revision.
    ///
    /// # Errors
    /// When it is not there.
    pub fn case(&self, id: u32) -> Result<OpenCase, Problem> {
        let database = self.database()?;
        read(&database, id)
    }

    /// Applies a change of the user's.
    ///
    /// # Errors
    /// When it cannot be applied, or not be written; nothing has changed then.
    pub fn edit(&self, id: u32, edit: &Edit) -> Result<OpenCase, Problem> {
        self.change(id, &edit.label(), |case| case.apply(edit))
    }

    /// The same for a change that was made on this revision: refused when the case is at another one by now.
    ///
    /// # Errors
    /// As [`edit`](Self::edit).
    pub fn edit_on(&self, id: u32, revision: u32, edit: &Edit) -> Result<OpenCase, Problem> {
        self.changed(
            id,
            &edit.label(),
            |open| if open.revision == revision { open.case.apply(edit) } else { Err(stale()) },
        )
    }

    /// Applies any change; `label` is what undo calls it. One that changes nothing leaves no revision.
    ///
    /// # Errors
    /// As [`edit`](Self::edit).
    pub fn change(
        &self,
        id: u32,
        label: &str,
        change: impl FnOnce(&mut Case) -> Result<(), Problem>,
    ) -> Result<OpenCase, Problem> {
        self.changed(id, label, |open| change(&mut open.case))
    }

    fn changed(
        &self,
        id: u32,
        label: &str,
        change: impl FnOnce(&mut OpenCase) -> Result<(), Problem>,
    ) -> Result<OpenCase, Problem> {
        let mut database = self.database()?;
        let transaction = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let before = read(&transaction, id)?;
        let mut open = before.clone();
        change(&mut open)?;
        if open == before {
            return Ok(open);
        }
        // a number that an undone revision had is not given again: a revision's number says what is in it
        let number = "SELECT max(number) + 1 FROM revisions WHERE case_id = ?1";
        let number: u32 = transaction.query_row(number, [id], |row| row.get(0))?;
        let undone = assets_of(&transaction, "case_id = ?1 AND number > ?2", params![id, open.revision])?;
        undone.iter().try_for_each(|asset| leave(&transaction, id, asset))?;
        transaction.execute("DELETE FROM revisions WHERE case_id = ?1 AND number > ?2", params![id, open.revision])?;
        write_revision(&transaction, id, number, label, &open.case)?;
        come_to(transaction, id, number)
    }

    /// Goes one revision back, or forth.
    ///
    /// # Errors
    /// When there is none.
    pub fn step(&self, id: u32, forth: bool) -> Result<OpenCase, Problem> {
        let mut database = self.database()?;
        let transaction = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let open = read(&transaction, id)?;
        let none = || problem(if forth { "nothing was undone" } else { "this is where the case began" });
        let (number, _) = next_to(&transaction, id, open.revision, forth)?.ok_or_else(none)?;
        come_to(transaction, id, number)
    }

    /// Notes a file that was made of a case and that none of its revisions has, such as an export: it goes with the case. Where the case is
    /// gone already, so is the file.
    ///
    /// # Errors
    /// When the database cannot be written, or the case is not there any more.
    pub fn leave(&self, id: u32, at: &FileRef) -> Result<(), Problem> {
        let mut database = self.database()?;
        let transaction = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        if let Err(gone) = read(&transaction, id) {
            if !assets(&transaction)?.contains(&at.asset) {
                remove_folder(&self.folder.join("assets").join(&at.asset))?;
            }
            return Err(gone);
        }
        leave(&transaction, id, &at.asset)?;
        Ok(transaction.commit()?)
    }

    /// Deletes a case: all revisions, what was made of it, and every file that no other case has.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub fn delete_case(&self, id: u32) -> Result<(), Problem> {
        let mut database = self.database()?;
        let transaction = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
        // What cannot be read names no files: those that it alone had are swept when no case has them.
        let mut own = assets_of(&transaction, "case_id = ?1", [id]).unwrap_or_default();
        let mut rows = transaction.prepare("SELECT asset FROM leftovers WHERE case_id = ?1")?;
        own.extend(rows.query_map([id], |row| row.get::<_, String>(0))?.collect::<Result<Vec<_>, _>>()?);
        drop(rows);
        if transaction.execute("DELETE FROM cases WHERE id = ?1", [id])? == 0 {
            return Err(problem("this case is not there any more"));
        }
        let others = assets(&transaction)?;
        // files first, and under the lock: a crash in between leaves a case that can be deleted again, not a file without a case
        for asset in own.difference(&others) {
            remove_folder(&self.folder.join("assets").join(asset))?;
        }
        transaction.commit()?;
        database.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
        Ok(())
    }

    /// Articles whose title, tags or text contain `query`.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub fn articles(&self, query: &str) -> Result<Vec<Article>, Problem> {
        let database = self.database()?;
        let mut rows = database.prepare("SELECT id, title, tags, body, recipe FROM articles ORDER BY title, id")?;
        let rows = rows.query_map([], |row| {
            Ok(Article {
                id: row.get(0)?,
                title: row.get(1)?,
                tags: row.get(2)?,
                body: row.get(3)?,
                recipe: row.get(4)?,
            })
        })?;
        let articles = rows.collect::<Result<Vec<_>, _>>()?;
        let query = query.to_lowercase();
        let has = |a: &Article| format!("{}\n{}\n{}", a.title, a.tags, a.body).to_lowercase().contains(&query);
        Ok(articles.into_iter().filter(has).collect())
    }

    /// Adds an article, or writes one anew; its number.
    ///
    /// # Errors
    /// When its recipe is none, or the database cannot be written.
    pub fn save_article(&self, article: &Article) -> Result<u32, Problem> {
        if article.title.trim().is_empty() || article.title.len() + article.tags.len() > 1000 {
            return Err(problem("an article needs a title of at most 1000 bytes"));
        }
        if article.body.len() > 1 << 20 {
            return Err(problem("the article is longer than a megabyte; split it"));
        }
        if !article.recipe.is_empty() {
            crate::plan::read(&article.recipe)?;
        }
        let database = self.database()?;
        if article.id == 0 {
            insert_article(&database, article)?;
            return u32::try_from(database.last_insert_rowid()).map_err(problem);
        }
        let Article { id, title, tags, body, recipe } = article;
        let changed = database.execute(
            "UPDATE articles SET title = ?2, tags = ?3, body = ?4, recipe = ?5 WHERE id = ?1",
            params![id, title, tags, body, recipe],
        )?;
        if changed == 0 { Err(problem("this article is not there any more; save it as a new one")) } else { Ok(*id) }
    }

    /// Deletes an article.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub fn delete_article(&self, id: u32) -> Result<(), Problem> {
        self.database()?.execute("DELETE FROM articles WHERE id = ?1", [id])?;
        Ok(())
    }

    /// The vault's folder, for people.
    #[must_use]
    pub fn path_of_folder(&self) -> String {
        self.folder.display().to_string()
    }

    /// A text that calls the vault's files by their own names, and a whole folder of them the rig.
    #[must_use]
    pub fn without_folders(&self, text: &str) -> String {
        let mut text = text.to_owned();
        for part in ["assets", "incoming"] {
            let start = format!("{}{MAIN_SEPARATOR}", self.folder.join(part).display());
            let mut pieces = text.split(&start);
            let mut out = pieces.next().unwrap_or_default().to_owned();
            for piece in pieces {
                let rest = piece.trim_start_matches(|c: char| c.is_ascii_hexdigit());
                match rest.strip_prefix(MAIN_SEPARATOR) {
                    Some(file) => out += file,
                    None => out = out + "the rig" + rest,
                }
            }
            text = out;
        }
        text
    }

    /// Where a file of the vault is.
    ///
    /// # Errors
    /// When the name is not one of the vault's, or nothing is there.
    pub fn path(&self, at: &FileRef) -> Result<PathBuf, Problem> {
        let what = if at.file.is_empty() { "rig".to_owned() } else { format!("file {:?}", at.file) };
        let missing = || problem(format!("the vault has no {what} any more; add it again, or make it anew"));
        if !is_hash(&at.asset) {
            return Err(missing());
        }
        let mut path = self.folder.join("assets").join(&at.asset);
        if !at.file.is_empty() {
            check_name(&at.file)?;
            path.push(&at.file);
        }
        if path.exists() { Ok(path) } else { Err(missing()) }
    }

    /// A new empty folder for files on their way into the vault.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn incoming(&self) -> Result<Incoming, Problem> {
        let folder = self.folder.join("incoming").join(random_name()?);
        fs::create_dir(&folder)?;
        Ok(Incoming { folder })
    }

    /// Takes the files of a folder into the vault: its hash.
    ///
    /// # Errors
    /// When a file cannot be read or moved.
    pub fn take(&self, incoming: &Incoming) -> Result<String, Problem> {
        for entry in fs::read_dir(&incoming.folder)? {
            fs::File::open(entry?.path())?.sync_all()?;
        }
        let asset = hash_of(&incoming.folder)?;
        let place = self.folder.join("assets").join(&asset);
        if place.exists() && !self.is_whole(&asset) {
            remove_folder(&place)?;
        }
        if !place.exists()
            && let Err(error) = fs::rename(&incoming.folder, &place)
            && !place.exists()
        {
            return Err(error.into());
        }
        Ok(asset)
    }

    /// Whether the files of an asset are there as they were taken.
    #[must_use]
    pub fn is_whole(&self, asset: &str) -> bool {
        is_hash(asset) && hash_of(&self.folder.join("assets").join(asset)).is_ok_and(|hash| hash == asset)
    }

    /// Writes one file into the vault.
    ///
    /// # Errors
    /// When `fill` fails or the file cannot be written.
    pub fn add_file(&self, name: &str, fill: impl FnOnce(&Path) -> Result<(), Problem>) -> Result<FileRef, Problem> {
        check_name(name)?;
        let incoming = self.incoming()?;
        fill(&incoming.folder.join(name))?;
        Ok(FileRef { asset: self.take(&incoming)?, file: name.to_owned() })
    }

    /// Writes bytes into the vault.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn add_bytes(&self, name: &str, bytes: &[u8]) -> Result<FileRef, Problem> {
        self.add_file(name, |path| Ok(fs::File::create(path)?.write_all(bytes)?))
    }

    /// Removes what no case refers to and nobody can be writing any more.
    fn sweep(&self) -> Result<(), Problem> {
        // Of a case that cannot be read, which the list of cases says, nobody knows which files are its own.
        let database = self.database()?;
        let Ok(used) = assets(&database) else { return Ok(()) };
        for part in ["assets", "incoming"] {
            for entry in fs::read_dir(self.folder.join(part))? {
                let entry = entry?;
                let old = entry.metadata()?.modified()?.elapsed().is_ok_and(|age| age > Duration::from_secs(24 * 3600));
                if old && !used.contains(&*entry.file_name().to_string_lossy()) {
                    remove_folder(&entry.path())?;
                }
            }
        }
        Ok(())
    }
}

/// Files on their way into the vault; what is not taken is removed.
#[derive(Debug)]
pub struct Incoming {
    /// Where they are.
    pub folder: PathBuf,
}

impl Drop for Incoming {
    fn drop(&mut self) {
        // taken, or swept later
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn remove_folder(path: &Path) -> Result<(), Problem> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
        _ => Ok(()),
    }
}

fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs().cast_signed())
}

fn insert_article(database: &Connection, article: &Article) -> Result<(), Problem> {
    let Article { title, tags, body, recipe, .. } = article;
    database.execute(
        "INSERT INTO articles (title, tags, body, recipe) VALUES (?1, ?2, ?3, ?4)",
        params![title, tags, body, recipe],
    )?;
    Ok(())
}

fn parse(id: u32, document: &str) -> Result<Case, Problem> {
    serde_json::from_str(document).map_err(|_| {
        problem(format!(
            "case {id} in the vault cannot be read, so no file of the vault is removed: put vault.sqlite back from a backup, \
             or delete this case"
        ))
    })
}

fn read(database: &Connection, id: u32) -> Result<OpenCase, Problem> {
    let sql =
        "SELECT r.number, r.label, r.document FROM cases c JOIN revisions r ON r.case_id = c.id AND r.number = c.head
               WHERE c.id = ?1";
    let row = database.query_row(sql, [id], |row| Ok((row.get::<_, u32>(0)?, row.get(1)?, row.get::<_, String>(2)?)));
    let (revision, label, document): (u32, String, String) =
        row.optional()?.ok_or_else(|| problem("this case is not there any more; choose another one"))?;
    let undo = next_to(database, id, revision, false)?.map(|_| label);
    let redo = next_to(database, id, revision, true)?.map(|(_, label)| label);
    Ok(OpenCase { id, revision, case: parse(id, &document)?, undo, redo })
}

/// The revision before or after one: its number and label.
fn next_to(database: &Connection, id: u32, revision: u32, forth: bool) -> Result<Option<(u32, String)>, Problem> {
    let next = if forth { "number > ?2 ORDER BY number" } else { "number < ?2 ORDER BY number DESC" };
    let sql = format!("SELECT number, label FROM revisions WHERE case_id = ?1 AND {next} LIMIT 1");
    Ok(database.query_row(&sql, [id, revision], |row| Ok((row.get(0)?, row.get(1)?))).optional()?)
}

/// Ends a change at this revision.
fn come_to(change: Transaction<'_>, id: u32, number: u32) -> Result<OpenCase, Problem> {
    change.execute("UPDATE cases SET head = ?2, touched = ?3 WHERE id = ?1", params![id, number, now()])?;
    let open = read(&change, id)?;
    change.commit()?;
    Ok(open)
}

/// What a change comes to that was made on what is not there any more.
pub(crate) fn stale() -> Problem {
    problem(
        "the case has changed meanwhile, in another window or by a run that has ended, and is shown as it is now; nothing was \
         done: look at it, and do it again",
    )
}

fn write_revision(change: &Transaction<'_>, id: u32, number: u32, label: &str, case: &Case) -> Result<(), Problem> {
    let document = serde_json::to_string(case).map_err(problem)?;
    change.execute(
        "INSERT INTO revisions (case_id, number, label, document) VALUES (?1, ?2, ?3, ?4)",
        params![id, number, label, document],
    )?;
    Ok(())
}

fn leave(change: &Transaction<'_>, id: u32, asset: &str) -> Result<(), Problem> {
    change.execute("INSERT OR IGNORE INTO leftovers (case_id, asset) VALUES (?1, ?2)", params![id, asset])?;
    Ok(())
}

/// The assets of all cases, in any of their revisions.
fn assets(database: &Connection) -> Result<BTreeSet<String>, Problem> {
    assets_of(database, "1", [])
}

/// The assets of revisions that an SQL condition chooses.
fn assets_of(database: &Connection, of: &str, params: impl rusqlite::Params) -> Result<BTreeSet<String>, Problem> {
    let mut rows = database.prepare(&format!("SELECT case_id, document FROM revisions WHERE {of}"))?;
    let rows = rows.query_map(params, |row| Ok((row.get::<_, u32>(0)?, row.get::<_, String>(1)?)))?;
    let mut found = BTreeSet::new();
    for row in rows {
        let (id, document) = row?;
        found.extend(parse(id, &document)?.assets().map(str::to_owned));
    }
    Ok(found)
}

/// The hash of the names and contents of a folder's files.
fn hash_of(folder: &Path) -> Result<String, Problem> {
    let mut listing = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        check_name(&name)?;
        listing.push((name, sha256_of_file(&path)?));
    }
    if listing.is_empty() {
        return Err(problem("no file came; choose at least one"));
    }
    listing.sort();
    let text = serde_json::to_string(&listing).map_err(problem)?;
    Ok(sha256(text.as_bytes()))
}

/// Whether a text can be an asset's.
#[must_use]
pub fn is_hash(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

/// Refuses a name that is not that of one plain file.
///
/// # Errors
/// With what is wrong.
pub fn check_name(name: &str) -> Result<(), Problem> {
    let odd = |c: char| c.is_control() || "/\\:*?\"<>|".contains(c);
    if name.is_empty() || name.len() > 200 || name.starts_with('.') || name.contains(odd) {
        let shown: String = name.chars().take(60).collect();
        return Err(problem(format!(
            "{shown:?} cannot be the name of a file here, at most 200 bytes without / \\ : * ? \" < > | and no dot first; rename it"
        )));
    }
    Ok(())
}

/// 32 hexadecimal digits that nobody can guess.
///
/// # Errors
/// When the system has no random numbers.
pub fn random_name() -> Result<String, Problem> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|e| problem(format!("the system gives no random numbers: {e}")))?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}
