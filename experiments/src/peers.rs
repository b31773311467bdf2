//! `peers`: what one would otherwise take, on the same cases, from the same information: time, memory and error beside ours.
//!
//! Every program starts from the template laid on the scan by the landmarks, and has the landmarks and the rig's shapes as far as
//! it can use them (`experiments/peers/peers.py`). Its call alone is timed; its memory is that of its process. Ours run as
//! `scan-bench` runs them. Held: cases, landmarks, threads. Measured: rmse over the observed vertices, seconds, greatest memory.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use nonrigid::console::{Failure, Stage, say, tell, told};
use nonrigid::io::{NpzContents, read_npy_points};
use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PoseKind, Vec3, closest_pose};
use nonrigid::registration::ModelKind;
use serde::Deserialize;

use crate::output::{each_once, make_folder, make_output_folder, write_file};
use crate::plots::{Axis, Plot, Point, Series};
use crate::process::Process;
use crate::scan_bench::{
    BenchCase, BenchRow, CaseSource, Variant, measure, summarize, summary_table, table_of, write_rows,
};
use crate::this_program;

/// What runs the other programs.
const SCRIPT: &str = include_str!("../peers/peers.py");

/// The programs that it knows.
pub const METHODS: [&str; 6] =
    ["open3d-icp", "trimesh-amberg", "trimesh-sumner", "meshmonk", "libigl-arap", "scipy-map"];

/// What to run.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The other programs are Python packages; none of them comes with nonrigid. To install them:\n  \
    python3 -m venv peers && peers/bin/pip install numpy scipy trimesh open3d libigl meshmonk\n\
    Open3D needs libusb-1.0 and libGL from the system.\n\n\
    open3d-icp     Open3D: rigid ICP, point to plane, Tukey's loss\n\
    trimesh-amberg trimesh: optimal-step N-ICP with landmarks (Amberg et al. 2007)\n\
    trimesh-sumner trimesh: N-ICP with landmarks (Sumner and Popovic 2004)\n\
    meshmonk       meshmonk: visco-elastic registration (White et al. 2019)\n\
    libigl-arap    libigl: as-rigid-as-possible, the landmarks as handles (Sorkine and Alexa 2007)\n\
    scipy-map      SciPy: weights and pose of the rig by robust least squares, as users of linear head models fit them\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    experiments peers out/data/cases --rig out/data/rig --python peers/bin/python\n  \
    experiments peers out/data/cases --rig out/data/rig --methods scipy-map --models hybrid,blendshape"
)]
pub struct Arguments {
    /// Folder of cases
    #[arg(value_name = "DIR")]
    cases: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Other programs
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = METHODS.map(String::from), value_parser = method)]
    methods: Vec<String>,
    /// Our models beside them
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = OURS, value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// The Python that has them
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// Seconds after which a program has failed on a case
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    timeout: u32,
    /// Where results, tables and the plot go
    #[arg(long, value_name = "DIR", default_value = "out/peers")]
    out: PathBuf,
    /// Threads of ours and theirs [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Those of ours that stand for what the others do, and the one to choose.
pub const OURS: [ModelKind; 6] = [
    ModelKind::Hybrid,
    ModelKind::Klimov2020,
    ModelKind::Blendshape,
    ModelKind::Flame,
    ModelKind::Affine,
    ModelKind::Rigid,
];

fn method(name: &str) -> Result<String, String> {
    let known = METHODS.contains(&name);
    known.then(|| name.to_owned()).ok_or_else(|| format!("'{name}' is none of {}", METHODS.join(", ")))
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`]: of the arguments; of loading; of writing; of the computation when every run of the others failed.
pub fn run(a: &Arguments) -> Result<()> {
    each_once("--methods", &a.methods)?;
    each_once("--models", &a.models)?;
    let source = CaseSource::new(&a.cases, &a.rig);
    let cases = source.read()?;
    check_python("--python", &a.python)?;
    let folders: Vec<String> = cases.iter().map(|case| case.name.clone()).collect();
    make_output_folder(&a.out, [("DIR", &a.cases), ("--rig", &a.rig)], &folders)?;
    let threads = rayon::current_num_threads();
    let total = (a.methods.len() + a.models.len()) * cases.len();
    say(format_args!("{} cases x {} programs, {threads} threads", cases.len(), a.methods.len() + a.models.len()))?;
    let mut done = 0;
    let mut progress = |row: &BenchRow| {
        done += 1;
        let outcome = match (&row.score, &row.error) {
            (Some(score), _) => format!("rmse {:.3} mm  {:.2} s", score.errors.rmse, row.seconds.unwrap_or(f64::NAN)),
            (None, error) => format!("failed: {}", error.as_deref().unwrap_or_default()),
        };
        tell(format_args!("{done}/{total}  {:14} {:16} {outcome}", row.model, row.case));
        Ok(())
    };
    let mut rows = measure(&this_program()?, &source, &Variant::models(&a.models)?, threads, None, &mut progress)?;
    let theirs = run_others(&a.methods, &a.python, &cases, threads, a.timeout, &a.out, &mut progress)?;
    let failed = theirs.iter().all(|row| row.score.is_none()).then(|| theirs.first().and_then(|r| r.error.clone()));
    rows.extend(theirs);
    write_rows(&a.out, "peers", &rows, threads)?;
    write_file(&a.out.join("peers.svg"), plot(&rows)?)?;
    say(table_of(&rows))?;
    say(summary_table(&summarize(&rows)))?;
    say(format_args!("peers.csv, .json, .timing.csv and .svg are in {}", a.out.display()))?;
    match failed.flatten() {
        None => Ok(()),
        Some(reason) => Err(Failure::computation(format!("no other program has a result; the first: {reason}")).into()),
    }
}

/// Refuses a Python that cannot be started, before anything runs.
///
/// # Errors
/// A [`Failure`] of the arguments that names the option.
pub fn check_python(option: &str, python: &Path) -> Result<()> {
    let started = Command::new(python).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let unstarted =
        |e| Failure::new(Stage::Arguments, format!("{option} {}: cannot be started: {e}", python.display()));
    Ok(started.map(drop).map_err(unstarted)?)
}

/// Every method on every case, one after the other; one that fails has a row that says why.
///
/// # Errors
/// A [`Failure`] when Python cannot be started or something cannot be written; whatever `on_row` returns.
pub fn run_others(
    methods: &[String],
    python: &Path,
    cases: &[BenchCase],
    threads: usize,
    timeout: u32,
    out: &Path,
    on_row: &mut dyn FnMut(&BenchRow) -> Result<()>,
) -> Result<Vec<BenchRow>> {
    let script = out.join("peers.py");
    write_file(&script, SCRIPT)?;
    let mut rows = Vec::new();
    for case in cases {
        let folder = out.join(&case.name);
        make_folder(&folder)?;
        let input = folder.join("case.npz");
        case_for_others(case)?.write(&input).map_err(Failure::writing)?;
        for method in methods {
            let result = folder.join(format!("{method}.npy"));
            let mut command = Command::new(python);
            command.arg(&script).arg(method).args([&input, &result]);
            for variable in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"] {
                command.env(variable, threads.to_string());
            }
            let (said, scored) = match run_one(&mut command, Duration::from_secs(timeout.into()))? {
                Err(reason) => (None, Err(reason)),
                Ok(said) => (Some(said), score(case, &result).map_err(|e| told(&e))),
            };
            let mut row = BenchRow::new("peer", method, &case.name, scored);
            (row.seconds, row.peak_bytes) = said.map_or((None, None), |s| (Some(s.seconds), Some(s.peak_bytes)));
            on_row(&row)?;
            rows.push(row);
        }
    }
    Ok(rows)
}

fn score(case: &BenchCase, result: &Path) -> Result<crate::scan_bench::Score> {
    Ok(case.scored(&read_npy_points(result)?, None)?)
}

/// What the script says of a run.
#[derive(Debug, Deserialize)]
struct Said {
    seconds: f64,
    peak_bytes: u64,
}

/// Runs the script: what it says, or why there is nothing.
fn run_one(command: &mut Command, timeout: Duration) -> Result<Result<Said, String>> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = Process(command.spawn().context("Python")?);
    let read = |pipe: Option<Box<dyn std::io::Read + Send>>| {
        std::thread::spawn(move || {
            let mut text = Vec::new();
            pipe.map(|mut pipe| pipe.read_to_end(&mut text));
            String::from_utf8_lossy(&text).into_owned()
        })
    };
    let out = read(process.0.stdout.take().map(|pipe| Box::new(pipe) as _));
    let err = read(process.0.stderr.take().map(|pipe| Box::new(pipe) as _));
    let begin = Instant::now();
    let status = loop {
        match process.0.try_wait().context("the process' end")? {
            Some(status) => break status,
            None if begin.elapsed() > timeout => return Ok(Err(format!("over {} s", timeout.as_secs()))),
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    let [out, err] = [out, err].map(|text| text.join().unwrap_or_default());
    if !status.success() {
        let last = err.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("no message").to_owned();
        return Ok(Err(format!("{last} ({status})")));
    }
    let line = out.lines().rfind(|line| line.starts_with('{')).unwrap_or_default();
    Ok(serde_json::from_str(line).map_err(|e| format!("not what the script says: {line:.80}: {e}")))
}

/// What the script is given of a case.
fn case_for_others(case: &BenchCase) -> Result<NpzContents> {
    let rest = case.rest();
    let pairs: Vec<(Vec3, Vec3)> = case.landmarks.iter().map(|l| (l.template.position(rest), l.target)).collect();
    let pose = closest_pose(&pairs, PoseKind::Rigid).with_context(|| format!("{}: its landmarks", case.name))?;
    let numbers = |points: &[Vec3]| points.iter().flat_map(|p| p.data.0[0]).collect::<Vec<f64>>();
    let placed: Vec<Vec3> = rest.iter().map(|&p| pose.apply(p)).collect();
    let indices = |triangles: &[[u32; 3]]| triangles.iter().flatten().copied().collect::<Vec<u32>>();
    let (template, scan) = (case.template.triangulate().triangles, &case.scan.mesh);
    if scan.triangles.is_empty() {
        bail!("{}: the scan has no triangles, which the other programs need", case.name);
    }
    // A landmark inside a triangle goes to its greatest corner: most programs know vertices alone.
    let nearest = |l: &Landmark| l.template.corners().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |corner| corner.0);
    let marks: Vec<u32> = case.landmarks.iter().map(nearest).collect();
    let points: Vec<Vec3> = case.landmarks.iter().map(|l| l.target).collect();
    let shapes = &case.shapes;
    let delta = |k: usize, v: usize| (pose.rotation * shapes.displacement(v, k)).data.0[0];
    let deltas: Vec<f64> = (0..shapes.len()).flat_map(|k| (0..rest.len()).flat_map(move |v| delta(k, v))).collect();
    Ok(NpzContents::new()
        .with("rest", &[rest.len(), 3], &numbers(&placed))
        .with("triangles", &[template.len(), 3], &indices(&template))
        .with("scan", &[scan.positions.len(), 3], &numbers(&scan.positions))
        .with("scan_triangles", &[scan.triangles.len(), 3], &indices(&scan.triangles))
        .with("landmark_vertices", &[marks.len()], &marks)
        .with("landmark_points", &[marks.len(), 3], &numbers(&points))
        .with("shapes", &[shapes.len(), rest.len(), 3], &deltas))
}

/// Error against seconds, a point a program: means over its cases, the bar the range of the error.
///
/// # Errors
/// When nothing was measured.
pub fn plot(rows: &[BenchRow]) -> Result<String> {
    let mut series = Vec::new();
    for summary in summarize(rows) {
        let errors = summary.errors(rows);
        if let (Some(seconds), false) = (summary.mean_seconds, errors.is_empty()) {
            let [low, high] =
                [errors.iter().copied().fold(f64::INFINITY, f64::min), errors.iter().copied().fold(0.0, f64::max)];
            let point = Point { x: seconds, y: summary.mean_rmse, spread: Some([low, high]) };
            series.push(Series::line(&summary.model, vec![point]));
        }
    }
    Plot::new("", Axis::log("seconds a registration"), Axis::log("rmse / mm")).series(series).svg()
}
