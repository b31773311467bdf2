//! What a study is: a name, what it is about, how long it takes, and a function that fills its section of the page.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::{Context as _, Result};
use indicatif::ProgressBar;
use nonrigid::console::{Failure, told};
use nonrigid::registration::{ModelFactory, ModelKind, RegistrationResult, Schedule, TERMS};
use nonrigid::render::{RgbImage, save_png};
use rayon::prelude::*;

use super::data::Data;
use super::effort::Effort;
use super::table::{Table, number, shown};
use super::view3d::View3d;
use crate::output::write_file;
use crate::plots::{Point, Series};
pub use crate::processor_time::cpu_seconds;
use crate::scan_bench::{BenchCase, BenchRow, LandmarkUse, Score, Variant, megabytes, run_case};
use crate::tables::grouped;

/// One figure, table or group of them on the page.
#[derive(Debug)]
pub struct Study {
    /// Name on the command line and of its files.
    pub name: &'static str,
    /// Heading on the page.
    pub title: &'static str,
    /// What is varied, what is held, what is measured.
    pub about: &'static str,
    /// The tables that it writes, by their files' names without extension.
    pub tables: &'static [&'static str],
    /// Seconds on two cores, about.
    pub seconds: fn(&Effort) -> f64,
    /// Does it.
    pub run: fn(&Setting<'_>) -> Result<Section>,
}

/// What a study works with.
pub struct Setting<'a> {
    /// How much of it.
    pub effort: &'a Effort,
    /// Rig and cases.
    pub data: &'a Data,
    /// Seed of everything random.
    pub seed: u64,
    /// Where its files go.
    pub out: &'a Path,
    /// The `experiments` whose processes measure memory.
    pub program: &'a Path,
    /// Models of the caller's own, which join those of the crate.
    pub own: &'a [&'a dyn ModelFactory],
    /// The Python that has the other programs, if they are asked for.
    pub peers: Option<&'a Path>,
    /// How far it is.
    pub progress: &'a ProgressBar,
}

/// What a study leaves on the page, from top to bottom.
#[derive(Debug)]
pub struct Section {
    /// What was found, in a sentence.
    pub finding: String,
    /// In this order.
    pub blocks: Vec<Block>,
}

/// A part of a section.
#[derive(Debug)]
pub enum Block {
    /// A file below the output folder, `.png` or `.svg`.
    Figure {
        /// Its name.
        file: String,
        /// What it shows.
        caption: String,
    },
    /// A table as people read it.
    Table {
        /// Its rows.
        table: Table,
        /// What it holds.
        caption: String,
        /// The file with all of its digits.
        file: String,
    },
    /// Meshes that one can turn.
    View(View3d),
}

/// A model with its default schedule: one of the crate's, or the caller's own.
pub struct Entrant<'a> {
    model: &'a dyn ModelFactory,
    schedule: Schedule,
}

impl Entrant<'_> {
    /// The model's name.
    #[must_use]
    pub fn name(&self) -> &str {
        self.model.name()
    }

    /// Registers a case: score, result, seconds.
    ///
    /// # Errors
    /// When the registration fails.
    pub fn register(&self, case: &BenchCase, landmarks: LandmarkUse) -> Result<(Score, RegistrationResult, f64)> {
        run_case(self.model, &TERMS, &self.schedule, case, landmarks)
    }
}

impl<'a> Setting<'a> {
    /// These models, then the caller's own.
    ///
    /// # Errors
    /// When a default schedule cannot be read.
    pub fn entrants(&self, models: &'a [ModelKind]) -> Result<Vec<Entrant<'a>>> {
        let models = models.iter().map(|m| m as &dyn ModelFactory).chain(self.own.iter().copied());
        models.map(|model| Ok(Entrant { model, schedule: Schedule::from_toml(model.default_schedule())? })).collect()
    }

    /// Saves a picture as `name`.png.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn picture(&self, name: &str, picture: &RgbImage, caption: impl Into<String>) -> Result<Block> {
        let file = format!("{name}.png");
        save_png(picture, self.out.join(&file)).map_err(Failure::writing)?;
        Ok(Block::Figure { file, caption: caption.into() })
    }

    /// Saves a plot as `name`.svg.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn plot(&self, name: &str, svg: &str, caption: impl Into<String>) -> Result<Block> {
        let file = format!("{name}.svg");
        write_file(&self.out.join(&file), svg)?;
        Ok(Block::Figure { file, caption: caption.into() })
    }

    /// Runs every job, several at a time. Each is done whether or not others fail; a failure is its row.
    pub fn run_all<J: Sync, R: Send>(&self, jobs: &[J], run: impl Fn(&J) -> R + Sync) -> Vec<R> {
        self.progress.set_length(jobs.len() as u64);
        let one = |job: &J| {
            let result = run(job);
            self.progress.inc(1);
            result
        };
        // One job a task: they take unequally long.
        jobs.par_iter().with_max_len(1).map(one).collect()
    }

    /// Runs every job on one thread, as many jobs at a time as there are threads: what [`cpu_seconds`] measures in a job is then all of
    /// its work, whatever else the machine does meanwhile.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn run_each_on_one_thread<J: Sync, R: Send>(&self, jobs: &[J], run: impl Fn(&J) -> R + Sync) -> Result<Vec<R>> {
        self.progress.set_length(jobs.len() as u64);
        let next = AtomicUsize::new(0);
        let lane = || -> Result<Vec<(usize, R)>> {
            let mut done = Vec::new();
            one_thread()?.install(|| {
                while let Some((k, job)) =
                    Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|k| Some((k, jobs.get(k)?)))
                {
                    done.push((k, run(job)));
                    self.progress.inc(1);
                }
            });
            Ok(done)
        };
        let mut done = thread::scope(|scope| -> Result<Vec<(usize, R)>> {
            let lanes: Vec<_> = (0..rayon::current_num_threads()).map(|_| scope.spawn(lane)).collect();
            let mut done = Vec::new();
            for lane in lanes {
                match lane.join() {
                    Ok(of_lane) => done.extend(of_lane?),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            Ok(done)
        })?;
        done.sort_by_key(|(k, _)| *k);
        Ok(done.into_iter().map(|(_, result)| result).collect())
    }
}

/// A pool of one thread.
///
/// # Errors
/// When it cannot be started.
pub fn one_thread() -> Result<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().context("a pool of one thread")
}

/// Registers a case with a variant: score, result, seconds.
///
/// # Errors
/// When the registration fails.
pub fn register_variant(variant: &Variant, case: &BenchCase) -> Result<(Score, RegistrationResult, f64)> {
    run_case(&variant.model, &TERMS, &variant.schedule, case, variant.landmarks)
}

/// Columns of [`error_cells`].
pub const ERROR_COLUMNS: [&str; 9] =
    ["rmse", "normal", "tangential", "median", "p95", "unobserved", "flips", "self_intersections", "iterations"];

/// Writes `name`.csv, the errors of every run, and `name`.timing.csv, what it took.
///
/// # Errors
/// When they cannot be written.
pub fn write_runs(out: &Path, name: &str, rows: &[BenchRow], threads: usize) -> Result<()> {
    let mut table = Table::new(&[&["group", "name", "case"][..], &ERROR_COLUMNS, &["error"]].concat());
    let mut times = Table::new(&["group", "name", "case", "seconds", "peak_mb", "threads"]);
    for row in rows {
        let of = [row.group.clone(), row.model.clone(), row.case.clone()];
        let error = row.error.clone().unwrap_or_default();
        table.push([of.to_vec(), error_cells(row.score.as_ref()), vec![error]].concat());
        let peak = row.peak_bytes.map_or(f64::NAN, megabytes);
        let numbers = [row.seconds.unwrap_or(f64::NAN), peak, threads as f64].map(number);
        times.push([&of[..], &numbers].concat());
    }
    table.write(out, name)?;
    times.write(out, &format!("{name}.timing"))
}

/// The errors of a result, millimetres; of a failure none.
#[must_use]
pub fn error_cells(score: Option<&Score>) -> Vec<String> {
    let Some(score) = score else { return vec![String::new(); ERROR_COLUMNS.len()] };
    let e = &score.errors;
    let counts = [e.flipped, score.mesh.self_intersections, score.iterations.unwrap_or(0)];
    let numbers = [e.rmse, e.normal, e.tangential, e.median, e.p95, e.unobserved.unwrap_or(f64::NAN)];
    numbers.into_iter().chain(counts.map(|n| n as f64)).map(number).collect()
}

/// What a failed job says; nothing for a success.
#[must_use]
pub fn error_text<T>(result: &Result<T>) -> String {
    result.as_ref().err().map_or_else(String::new, told)
}

/// The names in a column by the mean of their numbers in another, least first; without those that have none, as a failure has.
///
/// # Errors
/// When a column does not exist.
pub fn ranked(table: &Table, holding: &[(&str, &str)], name: &str, column: &str) -> Result<Vec<(String, f64)>> {
    let (key, value) = (table.column(name)?, table.column(column)?);
    let named = |(_, row): (usize, &[String])| (row[key].clone(), row[value].parse().unwrap_or(f64::NAN));
    let all = grouped(table.find(holding)?.into_iter().map(named));
    let mut means: Vec<(String, f64)> = all.into_iter().map(|(name, of)| (name, spread(&of).0)).collect();
    means.retain(|(_, mean)| mean.is_finite());
    means.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(means)
}

/// What was found of [`ranked`] names, in a sentence.
#[must_use]
pub fn least_and_most(quantity: &str, ranked: &[(String, f64)], unit: &str) -> String {
    let said = |(name, mean): &(String, f64)| format!("{name} {}{unit}", shown(*mean));
    match ranked {
        [] => format!("No {quantity}: everything failed."),
        [one] => format!("Mean {quantity}: {}.", said(one)),
        [first, second, .., last] => {
            format!("Least mean {quantity}: {}, then {}; greatest: {}.", said(first), said(second), said(last))
        }
        [first, last] => format!("Least mean {quantity}: {}; greatest: {}.", said(first), said(last)),
    }
}

/// Mean, and least and greatest, of some numbers. Where one is none, as of a failure, so is the mean.
#[must_use]
pub fn spread(values: &[f64]) -> (f64, [f64; 2]) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (mean, [least, greatest])
}

/// Models that are compared most often: each has a colour of its own, which the others share, with other markers.
const OWN_COLOURS: [ModelKind; 7] = [
    ModelKind::Hybrid,
    ModelKind::Sequential,
    ModelKind::Blendshape,
    ModelKind::Graph,
    ModelKind::Arap,
    ModelKind::Free,
    ModelKind::Rigid,
];

/// A line of a model, which looks the same in every plot.
#[must_use]
pub fn model_line(model: &str, points: Vec<Point>) -> Series {
    let line = Series::line(model, points);
    let others = ModelKind::ALL.iter().filter(|m| !OWN_COLOURS.contains(m));
    match OWN_COLOURS.iter().chain(others).position(|m| m.to_string() == model) {
        Some(look) => line.with_look(look),
        None => line,
    }
}

/// Mean and range of some numbers as a point of a plot.
#[must_use]
pub fn mean_point(x: f64, values: &[f64]) -> Point {
    let (y, range) = spread(values);
    Point { x, y, spread: Some(range) }
}
