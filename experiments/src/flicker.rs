//! `flicker`: how much a registered sequence shimmers, and what smoothing it in time does.
//!
//! A person of each seed moves smoothly; every frame is scanned with noise of its own, has landmarks with errors of their own, and is
//! registered from where the one before ended, as `nonrigid batch` does. Varied: frames a second, the cutoff of
//! [`motion::smooth`](nonrigid::motion::smooth), and what a tracker could do frame by frame instead, a pull to the frame before or to
//! where the two before lead. Held: person, motion, scans. Measured: rmse over the vertices that a frame's scan shows; flicker, the
//! second difference in time of the vertices' errors against truth, root mean square; and frames that are taken for lost.

use std::path::PathBuf;

use anyhow::Result;
use comfy_table::Table;
use nonrigid::console::{Failure, Stage, say};
use nonrigid::mesh::Vec3;
use nonrigid::motion::{Track, flicker};
use nonrigid::registration::{ModelKind, RegistrationInput, Silent, WarmStart, register};
use serde::Serialize;
use serde_json::json;

use crate::generated::Studio;
use crate::output::{each_once, make_output_folder};
use crate::scan_bench::BenchCase;
use crate::tables::{grouped, table, write_json};

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  experiments flicker --seeds 101 --seconds 0.5 --cutoffs 4")]
pub struct Arguments {
    /// Seeds, each a person and a motion
    #[arg(long, value_delimiter = ',', default_values_t = [7, 301])]
    seeds: Vec<u64>,
    /// Frames a second
    #[arg(long, value_delimiter = ',', default_values_t = [60, 15], value_parser = clap::value_parser!(u16).range(1..=1000))]
    rates: Vec<u16>,
    /// Length of each sequence
    #[arg(long, default_value_t = 1.0, value_parser = seconds)]
    seconds: f64,
    /// Cutoffs of the smoothing, Hz, at most half of each rate
    #[arg(long, value_delimiter = ',', default_values_t = [2.0, 3.0, 4.0, 6.0], value_parser = seconds)]
    cutoffs: Vec<f64>,
    /// Model
    #[arg(long, default_value_t = ModelKind::Hybrid, value_parser = str::parse::<ModelKind>)]
    model: ModelKind,
    /// Vertices of the template, approximately
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1000..=500_000))]
    vertices: u32,
    /// Triangles of each scan
    #[arg(long, default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(5000..=5_000_000))]
    triangles: u32,
    /// Where the table goes
    #[arg(long, value_name = "DIR", default_value = "out/flicker")]
    out: PathBuf,
    /// Threads [default: all cores]; results do not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

fn seconds(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|x: &f64| *x > 0.0 && *x <= 600.0);
    found.ok_or_else(|| format!("'{text}' is no number above 0, up to 600"))
}

/// What a way to smooth makes of a sequence.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    seed: u64,
    frames_per_second: u16,
    way: String,
    /// Mean over the frames of the root mean square error over the vertices that the scan shows, millimetres.
    rmse: f64,
    /// Root mean square of the errors' second differences, millimetres.
    flicker: f64,
    /// That over the flicker of the frames as they are.
    ratio: f64,
    /// Frames that are taken for lost.
    lost: usize,
}

/// Strengths of the pulls that look back only: weight of the prior, that of the frame being 1.
const PULLS: [f64; 2] = [0.5, 1.0];

/// Runs the command.
///
/// # Errors
/// A [`Failure`] when a registration fails or a file cannot be written.
pub fn run(a: &Arguments) -> Result<()> {
    each_once("--seeds", &a.seeds)?;
    each_once("--rates", &a.rates)?;
    each_once("--cutoffs", &a.cutoffs)?;
    check_times(a)?;
    make_output_folder(&a.out, [], &[])?;
    let studio = Studio::new(a.vertices as usize)?;
    let mut rows = Vec::new();
    for &seed in &a.seeds {
        for &fps in &a.rates {
            let frames = frames(a, fps);
            let cases = studio.sequence(frames, fps.into(), a.triangles as usize, seed)?;
            let tracked = track(&cases, a.model)?;
            let of_sequence = rows_of(a, seed, fps, &cases, &tracked)?;
            say(shown(&of_sequence))?;
            rows.extend(of_sequence);
        }
    }
    if a.seeds.len() > 1 {
        say(format_args!("means over the seeds\n{}", shown(&means(&rows))))?;
    }
    write_json(&a.out.join("flicker.json"), &json!(rows))
}

/// Frames of a sequence at this rate.
fn frames(a: &Arguments, fps: u16) -> usize {
    (a.seconds * f64::from(fps)).ceil() as usize
}

/// Refuses sequences that are too short for a second difference, and cutoffs that frames at their rate do not have.
fn check_times(a: &Arguments) -> Result<(), Failure> {
    for &fps in &a.rates {
        if frames(a, fps) < 3 {
            let message = format!(
                "--seconds {}: {} frames at --rates {fps}, flicker takes 3; give more of either",
                a.seconds,
                frames(a, fps)
            );
            return Err(Failure::new(Stage::Arguments, message));
        }
        if let Some(hz) = a.cutoffs.iter().find(|hz| **hz > f64::from(fps) / 2.0) {
            let message = format!(
                "--cutoffs {hz}: above half of --rates {fps}, where nothing is left to smooth; give lower --cutoffs"
            );
            return Err(Failure::new(Stage::Arguments, message));
        }
    }
    Ok(())
}

/// Every frame from where the one before ended.
fn track(cases: &[BenchCase], model: ModelKind) -> Result<Vec<Vec<Vec3>>> {
    let schedule = model.schedule()?;
    let mut last: Option<WarmStart> = None;
    let mut frames = Vec::with_capacity(cases.len());
    for case in cases {
        let input = RegistrationInput { warm_start: last.as_ref(), ..case.input() };
        let result = register(&input, &model, &schedule, &mut Silent);
        let result = result.map_err(|e| Failure::computation(format!("{}: {e}", case.name)))?;
        frames.push(result.positions);
        last = Some(result.end);
    }
    Ok(frames)
}

fn rows_of(a: &Arguments, seed: u64, fps: u16, cases: &[BenchCase], tracked: &[Vec<Vec3>]) -> Result<Vec<Row>> {
    let follow = |cutoff: Option<f64>| {
        Track::follow(tracked.iter().cloned().map(Some).collect(), cutoff.map(|hz| hz / f64::from(fps)))
    };
    let mut ways = vec![("as they are".to_owned(), follow(None)?)];
    for pull in PULLS {
        for (to, steps) in [("frame before", 1), ("where two lead", 2)] {
            let frames = pulled(tracked, pull, steps);
            ways.push((format!("{pull} to {to}"), Track { lost: vec![None; frames.len()], cuts: Vec::new(), frames }));
        }
    }
    for &hz in &a.cutoffs {
        ways.push((format!("smooth {hz} Hz"), follow(Some(hz))?));
    }
    let truth: Vec<&[Vec3]> = cases.iter().map(|case| &case.truth[..]).collect();
    let mut before = f64::NAN;
    let row = |(way, Track { frames, lost, .. }): (String, Track)| {
        let errors: Vec<Vec<Vec3>> =
            frames.iter().zip(&truth).map(|(f, t)| f.iter().zip(*t).map(|(p, q)| p - q).collect()).collect();
        let rmse = cases.iter().zip(&errors).map(|(case, errors)| {
            let seen = errors.iter().zip(&case.observed).filter(|(_, seen)| **seen);
            let (sum, count) = seen.fold((0.0, 0usize), |(sum, n), (e, _)| (sum + e.norm_squared(), n + 1));
            (sum / count.max(1) as f64).sqrt()
        });
        let (rmse, flicker) = (rmse.sum::<f64>() / cases.len() as f64, flicker(&errors));
        if before.is_nan() {
            before = flicker;
        }
        let lost = lost.iter().flatten().count();
        Row { seed, frames_per_second: fps, way, rmse, flicker, ratio: flicker / before, lost }
    };
    Ok(ways.into_iter().map(row).collect())
}

/// Each frame between itself and what those before it lead to: the frame before, or the line through two.
fn pulled(frames: &[Vec<Vec3>], weight: f64, steps: usize) -> Vec<Vec<Vec3>> {
    let mut done: Vec<Vec<Vec3>> = Vec::with_capacity(frames.len());
    for (k, frame) in frames.iter().enumerate() {
        let prior = |v: usize| match steps.min(k) {
            0 => frame[v],
            1 => done[k - 1][v],
            _ => done[k - 1][v] * 2.0 - done[k - 2][v],
        };
        let moved = (0..frame.len()).map(|v| (frame[v] + prior(v) * weight) / (1.0 + weight)).collect();
        done.push(moved);
    }
    done
}

/// By rate and way.
fn means(rows: &[Row]) -> Vec<Row> {
    let alike = grouped(rows.iter().map(|r| ((r.frames_per_second, &r.way), r))).into_iter().map(|group| group.1);
    let mean_of = |alike: Vec<&Row>| {
        let mean = |of: fn(&Row) -> f64| alike.iter().map(|r| of(r)).sum::<f64>() / alike.len() as f64;
        let lost = alike.iter().map(|r| r.lost).sum();
        let (rmse, flicker, ratio) = (mean(|r| r.rmse), mean(|r| r.flicker), mean(|r| r.ratio));
        Row { rmse, flicker, ratio, lost, ..alike[0].clone() }
    };
    alike.map(mean_of).collect()
}

fn shown(rows: &[Row]) -> Table {
    let line = |r: &Row| {
        let place = format!("seed {}, {} a second", r.seed, r.frames_per_second);
        let numbers = [r.rmse, r.flicker, r.ratio].map(|x| format!("{x:.3}"));
        [vec![place, r.way.clone()], numbers.to_vec(), vec![r.lost.to_string()]].concat()
    };
    table(&["sequence", "frames", "rmse", "flicker", "ratio", "lost"], rows.iter().map(line))
}
