//! `start-bench`: in how many poses is the start found without landmarks?
//!
//! Varied: the pose of the scan. Held: the scan, the template's rest shape, the schedule. Measured: turn and distance at the
//! template's centroid between the start that is searched and the one by all landmarks.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::ValueEnum as _;
use nonrigid::console::{Failure, Stage, say, told};
use nonrigid::io;
use nonrigid::landmark;
use nonrigid::mesh::{Pose, Vec3};
use nonrigid::registration::{ModelKind, RegistrationInput, Schedule, StartSearch, find_start};
use nonrigid::rig::Regions;
use rayon::prelude::*;

use crate::output::each_once;
use crate::random_pose::{finite, random_pose};
use crate::scan_bench::{BenchCase, BenchRig};
use crate::start_cases::{StartKind, face_pose};
use crate::tables::table;
use crate::unread;

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example, on what `data-gen --seed 7 --out out/data` makes:\n  \
    experiments dev start-bench out/data/cases --rig out/data/rig --turns 0,90 --shift 100\n  \
    experiments dev start-bench out/data/cases --rig out/data/rig --kinds all --poses 4")]
pub struct Arguments {
    /// Folders of cases, and scans (.ply or .obj); landmarks.json beside a scan is its reference
    #[arg(value_name = "DIR_OR_SCAN", required = true)]
    scans: Vec<PathBuf>,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Make the cases' scans worse instead, each way of these in random poses, and count right and wrong starts and refusals;
    /// 'all' for every way
    #[arg(long, value_delimiter = ',', value_name = "KIND", value_parser = kinds, conflicts_with_all = ["turns", "vertical", "shift"])]
    kinds: Vec<Vec<StartKind>>,
    /// Random poses of each kind and case
    #[arg(long, default_value_t = 1, requires = "kinds", value_parser = clap::value_parser!(u32).range(1..=1000))]
    poses: u32,
    /// Turns about random axes, degrees
    #[arg(long, value_delimiter = ',', default_value = "0,30,90,180", value_parser = finite, allow_negative_numbers = true)]
    turns: Vec<f64>,
    /// Turn about the vertical axis instead, without a shift
    #[arg(long, conflicts_with_all = ["shift", "seed"])]
    vertical: bool,
    /// Shift with every turn but 0, millimetres
    #[arg(long, default_value_t = 500.0, value_parser = finite, allow_negative_numbers = true)]
    shift: f64,
    /// Seed of the random poses
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

fn kinds(text: &str) -> Result<Vec<StartKind>, String> {
    let all = StartKind::value_variants();
    if text == "all" {
        return Ok(all.to_vec());
    }
    let names = || all.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ");
    StartKind::from_str(text, false).map(|kind| vec![kind]).map_err(|_| format!("there are: {}", names()))
}

/// A start is right up to this root mean square distance of the template's vertices, in the template's size, from where the best
/// similarity onto the true vertices puts them, millimetres.
const RIGHT: f64 = 15.0;

/// Right starts, wrong ones and refusals, by kind.
fn run_kinds(a: &Arguments, cases: &[BenchCase]) -> Result<()> {
    let schedule = ModelKind::Hybrid.schedule()?;
    let header = ["kind", "right", "wrong", "refused", "of", "s", "wrong or refused"];
    let (mut rows, mut total) = (Vec::new(), [0; 3]);
    for kind in a.kinds.concat() {
        let mut jobs = Vec::new();
        for (c, case) in cases.iter().enumerate() {
            jobs.extend((0..u64::from(a.poses)).map(|p| (case, a.seed * 1000 + 50 * c as u64 + p)));
        }
        let one = |&(case, seed): &(&BenchCase, u64)| {
            let posed = kind.make(case, seed);
            let clock = Instant::now();
            let found = find_start(&RegistrationInput { landmarks: &[], ..posed.input() }, &schedule);
            let seconds = clock.elapsed().as_secs_f64();
            let truth = face_pose(&posed);
            let (verdict, what) = match found {
                Err(_) => (2, "refused".to_owned()),
                Ok((pose, _)) => {
                    let away = posed.rest().iter().map(|&p| (pose.apply(p) - truth.apply(p)).norm_squared());
                    let rms = (away.sum::<f64>() / posed.rest().len() as f64).sqrt() / truth.scale;
                    (usize::from(rms > RIGHT), format!("{rms:.0} mm"))
                }
            };
            (verdict, seconds, format!("{} {what}", case.name))
        };
        let ends: Vec<(usize, f64, String)> = jobs.par_iter().map(one).collect();
        let count = |v: usize| ends.iter().filter(|e| e.0 == v).count();
        (0..3).for_each(|v| total[v] += count(v));
        let seconds = ends.iter().map(|e| e.1).sum::<f64>() / ends.len() as f64;
        let bad: Vec<&str> = ends.iter().filter(|e| e.0 > 0).map(|e| &*e.2).collect();
        let numbers = [count(0), count(1), count(2), ends.len()].map(|n| n.to_string());
        rows.push([&[kind.name()], &numbers[..], &[format!("{seconds:.2}"), bad.join(", ")]].concat());
    }
    say(table(&header, rows))?;
    say(format_args!("right: {}, wrong: {}, refused: {}", total[0], total[1], total[2]))?;
    Ok(())
}

/// A start nearer than this to that by landmarks is found, degrees.
const FOUND_DEGREES: f64 = 5.0;

/// A scan of its own, whose pose its landmarks tell; where the template's vertices truly are is not known.
fn scan_alone(path: &Path, rig: &BenchRig) -> Result<BenchCase> {
    let (template, scan) = (rig.template(), io::read_scan(path)?);
    crate::check_millimetres(path, &scan.mesh.positions)?;
    let landmarks = match path.with_file_name("landmarks.json") {
        marks if marks.exists() => landmark::read_landmarks(&marks, None, template, Some(&scan.mesh))?,
        _ => Vec::new(),
    };
    Ok(BenchCase {
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        template: template.clone(),
        neutral: None,
        regions: Regions::of(Some(rig.rig()), template),
        shapes: rig.expressions()?,
        scan,
        truth: Vec::new(),
        observed: Vec::new(),
        landmarks,
        rig_landmarks: Vec::new(),
    })
}

/// What came out.
struct StartRow {
    /// Turn against the start by landmarks, degrees.
    turn: f64,
    /// Distance of the template's centroid to where the landmarks put it, millimetres.
    distance: f64,
    /// The search.
    search: StartSearch,
    /// Wall time.
    seconds: f64,
}

/// Whether landmarks tell the pose of the scan.
fn has_reference(case: &BenchCase) -> bool {
    case.landmarks.len() >= 3
}

/// Searches the start of the case moved by `moved`.
fn start_case(case: &BenchCase, moved: &Pose, schedule: &Schedule) -> Result<StartRow> {
    let case = case.clone().moved(moved);
    let without = RegistrationInput { landmarks: &[], ..case.input() };
    let clock = Instant::now();
    let (pose, search) = find_start(&without, schedule)?;
    let seconds = clock.elapsed().as_secs_f64();
    let search = search.expect("proven: no landmarks were given");
    let (turn, distance) = if has_reference(&case) {
        let (reference, _) = find_start(&case.input(), schedule)?;
        let cosine = 0.5 * ((reference.rotation.transpose() * pose.rotation).trace() - 1.0);
        let centre = case.rest().iter().sum::<Vec3>() / case.rest().len() as f64;
        (cosine.clamp(-1.0, 1.0).acos().to_degrees(), (reference.apply(centre) - pose.apply(centre)).norm())
    } else {
        (f64::NAN, f64::NAN)
    };
    Ok(StartRow { turn, distance, search, seconds })
}

/// Searches the start of every scan in every pose and prints a table.
///
/// # Errors
/// A [`Failure`] when something cannot be read.
pub fn run(a: &Arguments) -> Result<()> {
    let rig = BenchRig::read(&a.rig).map_err(unread)?;
    if !a.kinds.is_empty() {
        each_once("--kinds", &a.kinds.concat().into_iter().map(StartKind::name).collect::<Vec<_>>())?;
        let mut cases = Vec::new();
        for path in &a.scans {
            if path.is_file() {
                let message = format!("{}: --kinds needs the truth of cases, give their folder", path.display());
                return Err(Failure::new(Stage::Arguments, message).into());
            }
            cases.extend(BenchCase::read_all(path, &rig).map_err(unread)?);
        }
        return run_kinds(a, &cases);
    }
    let mut cases = Vec::new();
    for path in &a.scans {
        if path.is_dir() {
            cases.extend(BenchCase::read_all(path, &rig).map_err(unread)?);
        } else {
            cases.push(scan_alone(path, &rig).map_err(unread)?);
        }
    }
    let schedule = ModelKind::Hybrid.schedule()?;
    let header = [
        "scan",
        "turned / deg",
        "off by / deg",
        "and / mm",
        "loss",
        "share",
        "residual / mm",
        "runner-up",
        "s",
        "expression",
    ];
    let (mut rows, mut found, mut of) = (Vec::new(), 0, 0);
    for case in &cases {
        for (i, &turn) in a.turns.iter().enumerate() {
            let moved = if turn == 0.0 {
                Pose::identity()
            } else if a.vertical {
                Pose::rigid(Vec3::y() * turn.to_radians(), Vec3::zeros())
            } else {
                random_pose(turn, a.shift, a.seed, i as u64)
            };
            of += usize::from(has_reference(case));
            let head = vec![case.name.clone(), format!("{turn}")];
            let cells: Vec<String> = match start_case(case, &moved, &schedule) {
                Ok(row) => {
                    found += usize::from(row.turn < FOUND_DEGREES);
                    let (fit, next) = (row.search.fit, row.search.runner_up.map_or(1.0, |f| f.loss));
                    let numbers = [row.turn, row.distance, fit.loss, fit.share, fit.residual, next, row.seconds];
                    let seen = row.search.expression.iter().map(|(name, w)| format!("{name} {w}"));
                    let seen = seen.collect::<Vec<_>>().join(", ");
                    numbers.map(|x| format!("{x:.2}")).into_iter().chain([seen]).collect()
                }
                Err(e) => vec![told(&e)],
            };
            rows.push([head, cells].concat());
        }
    }
    say(table(&header, rows))?;
    say(format_args!("{found} of {of} within {FOUND_DEGREES} degrees of the start by landmarks"))?;
    Ok(())
}
