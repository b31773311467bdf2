//! Batches: the library's own manifest, jobs, resume rule, lock and summary, for whoever distributes them. And its command line.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;

use nonrigid::batch::{
    Animation, Batch, BatchError, Held, Job, Manifest, Row, Summary, SummaryRow, Timing, chains, run_jobs,
};
use nonrigid::cli::{self, Program};
use pyo3::prelude::*;

use crate::errors::{ComputationError, compute, input, os_error, value};

/// Line, name, sequence, options.
type PlainRow = (usize, String, Option<String>, Vec<(String, OsString)>);

/// Names of the columns that a manifest may have, and those of them that are paths.
#[pyfunction]
fn batch_columns() -> (Vec<String>, Vec<String>) {
    let columns = cli::batch::columns();
    (columns.options, columns.paths)
}

fn row_of((line, name, sequence, options): PlainRow) -> Row {
    Row { line, name, sequence, options }
}

/// Formats of animated files.
const ANIMATIONS: [&str; 3] = ["usda", "pc2", "glb"];

/// How and where jobs run.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Setting {
    program: PathBuf,
    command: Vec<OsString>,
    folder: PathBuf,
    format: String,
    pictures: bool,
    /// Format of animated files, or none.
    animation: Option<String>,
    fps: f64,
    /// Hz.
    smooth: Option<f64>,
    threads: usize,
    again: bool,
    /// Options of all rows.
    options: Vec<(String, OsString)>,
}

impl Setting {
    fn batch(&self, at_once: usize) -> PyResult<Batch> {
        if !["obj", "ply", "glb"].contains(&self.format.as_str()) {
            return Err(value(format!("format: {:?}; there are obj, ply and glb", self.format)));
        }
        if let Some(other) = self.animation.as_ref().filter(|format| !ANIMATIONS.contains(&format.as_str())) {
            return Err(value(format!("animation: {other:?}; there are usda, pc2, glb and None")));
        }
        if !(1.0..=1000.0).contains(&self.fps) || self.smooth.is_some_and(|hz| !(hz.is_finite() && hz > 0.0)) {
            return Err(value("fps: give a number from 1 to 1000; smooth: a frequency above 0, or None"));
        }
        Ok(Batch {
            program: self.program.clone(),
            command: self.command.clone(),
            folder: self.folder.clone(),
            format: self.format.clone(),
            pictures: self.pictures,
            animation: self.animation.clone().map(|format| Animation {
                format,
                frames_per_second: self.fps,
                smooth: self.smooth,
            }),
            at_once,
            threads: self.threads,
            again: self.again,
        })
    }

    fn job<'a>(&'a self, batch: &Batch) -> impl Fn(&Row) -> Job + 'a {
        let (settings, columns) = (cli::batch::settings(batch), cli::batch::columns());
        move |row| cli::batch::job(row, &self.options, &settings, &columns)
    }
}

fn batch_error(error: BatchError) -> PyErr {
    match error {
        BatchError::Taken { .. } | BatchError::Lost(_) => ComputationError::new_err(error.to_string()),
        error => input(error),
    }
}

/// What has come of rows so far.
#[derive(Default)]
struct Told {
    rows: Vec<Option<SummaryRow>>,
    /// Of rows that this run did: their numbers, and seconds.
    ran: Vec<(usize, f64)>,
    before: usize,
}

/// The rows of a manifest and what came of them, held here, where a million take the least; Python sees those that it asks for.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
struct Rows {
    rows: Vec<Row>,
    /// Those that follow each other.
    chains: Vec<Vec<usize>>,
    told: Mutex<Told>,
}

/// Whether a path is a URL: a scheme, and two slashes.
fn is_url(text: &str) -> bool {
    let scheme = text.split_once("://").map(|(scheme, _)| scheme);
    scheme.is_some_and(|scheme| {
        scheme.starts_with(|c: char| c.is_ascii_alphabetic())
            && scheme.chars().all(|c| c.is_ascii_alphanumeric() || "+.-".contains(c))
    })
}

impl Rows {
    fn told_so_far(&self) -> std::sync::MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn not_begun(&self, number: usize) -> SummaryRow {
        lost(self.rows[number].name.clone(), "it was not begun".to_owned())
    }

    /// All rows, which are to be put back.
    fn take_summary(&self, told: &mut Told) -> Summary {
        let rows = std::mem::take(&mut told.rows).into_iter().enumerate();
        Summary { rows: rows.map(|(k, row)| row.unwrap_or_else(|| self.not_begun(k))).collect() }
    }

    fn timing(&self, told: &Told, seconds: f64, cores: usize) -> Timing {
        let (scans, before) = (told.ran.len(), told.before);
        let rate = scans as f64 / (seconds / 60.0 * cores as f64);
        let seconds_of_scans = told.ran.iter().map(|&(k, seconds)| (self.rows[k].name.clone(), seconds)).collect();
        Timing { scans, before, seconds, cores, scans_per_core_minute: rate, seconds_of_scans }
    }

    fn checked(&self, number: usize) -> PyResult<usize> {
        let count = self.rows.len();
        if number < count { Ok(number) } else { Err(value(format!("row {number}; there are {count}, from 0"))) }
    }

    fn chains_of(&self, first: usize, end: usize) -> PyResult<&[Vec<usize>]> {
        let chains = self.chains.get(first..end);
        chains.ok_or_else(|| value(format!("chains {first} to {end}; there are {}", self.chains.len())))
    }
}

#[pymethods]
impl Rows {
    /// Reads a manifest; `text` is what is in it, where it is no file.
    #[new]
    #[pyo3(signature = (path, text=None))]
    fn new(py: Python<'_>, path: PathBuf, text: Option<String>) -> PyResult<Self> {
        compute(py, Some(1), || {
            let columns = cli::batch::columns();
            let manifest = match text {
                Some(text) => Manifest::parse(&text, &path, &columns),
                None => Manifest::read(&path, &columns),
            };
            let mut rows = manifest.map_err(input)?.rows;
            // the manifest's folder was put before URLs as well
            let folder = path.parent().map(|folder| format!("{}/", folder.to_string_lossy().trim_end_matches('/')));
            for row in &mut rows {
                for (_, cell) in row.options.iter_mut().filter(|(option, _)| columns.paths.contains(option)) {
                    let Some(text) = cell.to_str() else { continue };
                    let plain = folder.as_ref().and_then(|folder| text.strip_prefix(folder.as_str())).unwrap_or(text);
                    if is_url(plain) {
                        *cell = plain.strip_prefix("file://").unwrap_or(plain).into();
                    }
                }
                row.options.shrink_to_fit();
            }
            let chains = chains(&rows);
            let told = Told { rows: std::iter::repeat_with(|| None).take(rows.len()).collect(), ..Told::default() };
            Ok(Self { rows, chains, told: Mutex::new(told) })
        })
    }

    fn __len__(&self) -> usize {
        self.rows.len()
    }

    fn name(&self, number: usize) -> PyResult<&str> {
        Ok(&self.rows[self.checked(number)?].name)
    }

    /// Where tasks of at least `chunk` scans begin among the chains, and where the last one ends.
    fn tasks(&self, chunk: usize) -> Vec<usize> {
        let mut bounds = vec![0];
        let mut scans = 0;
        for (k, chain) in self.chains.iter().enumerate() {
            scans += chain.len();
            if scans >= chunk {
                bounds.push(k + 1);
                scans = 0;
            }
        }
        if scans > 0 {
            bounds.push(self.chains.len());
        }
        bounds
    }

    /// Numbers of the rows of some chains.
    fn numbers(&self, first: usize, end: usize) -> PyResult<Vec<usize>> {
        Ok(self.chains_of(first, end)?.concat())
    }

    /// The rows of some chains, and these, by indices into those rows.
    fn task(&self, first: usize, end: usize) -> PyResult<(Vec<PlainRow>, Vec<Vec<usize>>)> {
        let chains = self.chains_of(first, end)?;
        let plain = |&k: &usize| {
            let Row { line, name, sequence, options } = self.rows[k].clone();
            (line, name, sequence, options)
        };
        let mut count = 0;
        let inside = chains.iter().map(|chain| {
            count += chain.len();
            (count - chain.len()..count).collect()
        });
        let inside = inside.collect();
        Ok((chains.iter().flatten().map(plain).collect(), inside))
    }

    /// Paths that rows read and that begin as the folder's.
    fn read_below(&self, folder: &str) -> Vec<String> {
        let paths = cli::batch::columns().paths;
        let of_paths = self.rows.iter().flat_map(|row| &row.options).filter(|(option, _)| paths.contains(option));
        let below = of_paths.filter_map(|(_, path)| path.to_str()).filter(|path| path.starts_with(folder));
        let distinct: std::collections::BTreeSet<&str> = below.collect();
        distinct.into_iter().map(str::to_owned).collect()
    }

    /// Which of some files rows may write.
    fn writes(&self, names: Vec<String>, format: &str) -> Vec<String> {
        let names: std::collections::BTreeSet<String> = names.into_iter().collect();
        if names.is_empty() {
            return Vec::new();
        }
        let all = self.rows.iter().flat_map(|row| {
            let sequence = row.sequence.as_ref().map(|name| batch_files(&format!("{name}.sequence"), format));
            batch_files(&row.name, format).into_iter().chain(sequence.unwrap_or_default())
        });
        all.filter(|name| names.contains(name)).collect()
    }

    /// Notes a row's row of the summary (JSON).
    fn tell(&self, number: usize, row: &str, before: bool, seconds: f64) -> PyResult<()> {
        let number = self.checked(number)?;
        let mut row: SummaryRow = serde_json::from_str(row).map_err(value)?;
        // words that recur take no memory
        for word in [&mut row.status, &mut row.start] {
            let known = ["done", "doubtful", "failed", "pending", "cold", "warm", "cold again"];
            if let Some(known) = known.into_iter().find(|known| known == word) {
                *word = known.into();
            }
        }
        row.name.shrink_to_fit();
        row.note.shrink_to_fit();
        let mut told = self.told_so_far();
        told.rows[number] = Some(row);
        if before {
            told.before += 1;
        } else {
            told.ran.push((number, seconds));
        }
        Ok(())
    }

    /// A row's row of the summary (JSON).
    fn told(&self, number: usize) -> PyResult<String> {
        let number = self.checked(number)?;
        let told = self.told_so_far();
        match &told.rows[number] {
            Some(row) => serde_json::to_string(row),
            None => serde_json::to_string(&self.not_begun(number)),
        }
        .map_err(value)
    }

    /// How many scans ran, and were done before.
    #[getter]
    fn counts(&self) -> (usize, usize) {
        let told = self.told_so_far();
        (told.ran.len(), told.before)
    }

    /// Table (CSV), page (HTML) and times (JSON); with `pictures`, results have a picture.
    fn summary(
        &self,
        py: Python<'_>,
        pictures: bool,
        seconds: f64,
        cores: usize,
    ) -> PyResult<(String, String, String)> {
        compute(py, Some(1), || {
            let mut told = self.told_so_far();
            let times = serde_json::to_string_pretty(&self.timing(&told, seconds, cores)).map_err(value)?;
            let summary = self.take_summary(&mut told);
            let of_status = |row: &&SummaryRow| pictures && ["done", "doubtful"].contains(&&*row.status);
            let pictured: std::collections::HashSet<&str> =
                summary.rows.iter().filter(of_status).map(|row| &*row.name).collect();
            let texts = (summary.to_csv(), summary.to_html(&|name| pictured.contains(name)), times);
            told.rows = summary.rows.into_iter().map(Some).collect();
            Ok(texts)
        })
    }
}

/// A folder that this process holds for jobs that others run.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
struct Holder(Mutex<Option<Held>>);

impl Holder {
    fn with<R>(&self, work: impl FnOnce(&Held) -> PyResult<R>) -> PyResult<R> {
        let held = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        held.as_ref().map_or_else(|| Err(value("the folder is not held any more")), work)
    }
}

#[pymethods]
impl Holder {
    /// Takes the folder of a whole manifest.
    #[new]
    fn new(py: Python<'_>, setting: Setting, manifest: PathBuf, rows: Py<Rows>) -> PyResult<Self> {
        let rows = rows.get();
        let held = compute(py, Some(1), || {
            let batch = setting.batch(1)?;
            cli::check_output_folder(&batch.folder).map_err(|e| os_error(&e.to_string()))?;
            let job = setting.job(&batch);
            Held::take(batch, &manifest, &rows.rows, job, &|_| {}).map_err(batch_error)
        })?;
        Ok(Self(Mutex::new(Some(held))))
    }

    #[getter]
    fn aside(&self) -> PyResult<OsString> {
        self.with(|held| Ok(held.aside().to_owned().into()))
    }

    #[getter]
    fn is_lost(&self) -> PyResult<bool> {
        self.with(|held| Ok(held.is_lost()))
    }

    /// Writes the summary of what was told.
    fn finish(&self, py: Python<'_>, rows: Py<Rows>, seconds: f64, cores: usize) -> PyResult<()> {
        let rows = rows.get();
        compute(py, Some(1), || {
            let mut told = rows.told_so_far();
            let timing = rows.timing(&told, seconds, cores);
            let summary = rows.take_summary(&mut told);
            let written = self.with(|held| held.finish(&summary, &timing).map_err(batch_error));
            told.rows = summary.rows.into_iter().map(Some).collect();
            written
        })
    }

    /// Lets go of the folder.
    fn release(&self, py: Python<'_>) {
        let held = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        py.detach(|| drop(held));
    }
}

/// A row of the summary for a scan that no worker could do.
#[pyfunction]
fn batch_lost(name: String, note: String) -> PyResult<String> {
    serde_json::to_string(&lost(name, note)).map_err(value)
}

fn lost(name: String, note: String) -> SummaryRow {
    SummaryRow { name, status: "failed".into(), start: "cold".into(), note, ..SummaryRow::default() }
}

/// Runs jobs in a folder that somebody holds. For each row: its row of the summary (JSON), whether it was done before, seconds.
#[pyfunction]
fn batch_run(
    py: Python<'_>,
    setting: Setting,
    aside: PathBuf,
    rows: Vec<PlainRow>,
    chains: Vec<Vec<usize>>,
) -> PyResult<Vec<(usize, String, bool, f64)>> {
    compute(py, Some(1), || {
        let batch = setting.batch(1)?;
        let job = setting.job(&batch);
        let jobs: Vec<Job> = rows.into_iter().map(|row| job(&row_of(row))).collect();
        let outcomes = run_jobs(&batch, &jobs, &chains, &aside, &|| false).map_err(batch_error)?;
        let told = Summary::of(&batch, &jobs, &outcomes).rows;
        let row = |outcome: nonrigid::batch::Outcome| {
            let text = serde_json::to_string(&told[outcome.job]).map_err(value)?;
            Ok((outcome.job, text, outcome.before, outcome.seconds))
        };
        outcomes.into_iter().map(row).collect()
    })
}

/// Names of the files that a job, or what is made of a sequence, `NAME.sequence`, may write, its record first.
#[pyfunction]
fn batch_files(name: &str, format: &str) -> Vec<String> {
    if let Some(sequence) = name.strip_suffix(".sequence") {
        let files = ANIMATIONS.iter().chain(&["json"]).map(|ending| format!("sequences/{sequence}.{ending}"));
        return [format!("log/{name}.json"), format!("log/{name}.txt")].into_iter().chain(files).collect();
    }
    let plain = [format!("log/{name}.json"), format!("state/{name}.json"), format!("log/{name}.txt")];
    let endings = ["json", "timing.json", format, "png"];
    plain.into_iter().chain(endings.map(|ending| format!("{name}.{ending}"))).collect()
}

/// The command line. Exit code.
#[pyfunction]
fn command_line(py: Python<'_>, arguments: Vec<OsString>, program: PathBuf, first: Vec<OsString>) -> u8 {
    let code = py.detach(|| cli::run(arguments, &Program { path: program, first }));
    // an exit code tells its number to nobody but the system
    (0..=u8::MAX).find(|number| ExitCode::from(*number) == code).unwrap_or(1)
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Rows>()?;
    module.add_class::<Holder>()?;
    module.add_function(wrap_pyfunction!(batch_columns, module)?)?;
    module.add_function(wrap_pyfunction!(batch_lost, module)?)?;
    module.add_function(wrap_pyfunction!(batch_run, module)?)?;
    module.add_function(wrap_pyfunction!(batch_files, module)?)?;
    module.add_function(wrap_pyfunction!(command_line, module)?)
}
