//! `scaling`: how time and memory grow. Two things are varied, each in a table of its own.
//!
//! - The solver: the hybrid on generated faces of growing vertex count, nodes in proportion (one for each hundred vertices unless
//!   said otherwise, at least 50), correspondences fixed; seconds per iteration and stage, iterations of the linear solver, memory.
//! - Registrations of one template to scans of growing triangle count: seconds by stage, memory.
//!
//! Every configuration runs in a process of its own, so that its peak memory is its own; making the data does not count. One line
//! of JSON a run on standard output; tables, plots and the fitted exponents in the output folder.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;

use anyhow::Result;
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::nlls::LinearSolverKind;
use serde_json::Value;

use crate::generated::shapes_at_most;
use crate::output::{each_once, make_output_folder, write_file};
use crate::plots::{Axis, Plot, Point, PowerLaw, Series};
use crate::tables::{csv_field, grouped, table, write_csv};
use crate::this_program;

mod measure;

pub use measure::{Configuration, MorphRun, RegistrationRun, SolverRun};
pub(crate) use measure::{peak_bytes, reset_peak};

/// Numbers separated by commas, or `none`.
#[derive(Debug, Clone)]
struct Numbers(Vec<usize>);

impl FromStr for Numbers {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self(Vec::new()));
        }
        let number = |t: &str| t.trim().parse().map_err(|_| format!("{t:?} is not a number"));
        text.split(',').map(number).collect::<Result<_, _>>().map(Self)
    }
}

/// `auto`, or numbers.
#[derive(Debug, Clone)]
enum Nodes {
    Auto,
    List(Vec<usize>),
}

impl FromStr for Nodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(|Numbers(list)| Self::List(list)) }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Derivatives {
    Structured,
    Reference,
}

impl std::fmt::Display for Derivatives {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if *self == Self::Structured { "structured" } else { "reference" })
    }
}

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples, the first of a minute:\n  \
    experiments scaling --sizes 5000,20000 --repeats 1 --out out/short-scaling\n  \
    experiments scaling --sizes 100000 --linear-solver bordered,block-jacobi\n  \
    experiments scaling --sizes none --scan-triangles 50000,500000")]
pub struct Arguments {
    /// Vertices of the faces, 1,000 to 500,000 each, or none
    #[arg(long, value_name = "LIST", default_value = "5000,20000,100000,500000")]
    sizes: Numbers,
    /// Blendshapes
    #[arg(long, default_value_t = 50)]
    shapes: usize,
    /// Nodes of each face's graph, one number a size; auto: one for each hundred vertices, at least 50
    #[arg(long, value_name = "auto|LIST", default_value = "auto")]
    nodes: Nodes,
    /// Numbers of threads
    #[arg(long, value_name = "LIST", default_value = "1,2")]
    threads: Numbers,
    /// What solves for a step: auto, dense, bordered, block-jacobi
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "auto", value_parser = str::parse::<LinearSolverKind>)]
    linear_solver: Vec<LinearSolverKind>,
    /// How derivatives are taken
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_enum, default_value = "structured")]
    linearisation: Vec<Derivatives>,
    /// Gauss-Newton iterations of a run at most
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// How often each run is repeated
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Triangles of the scans that are registered, 500 to 10,000,000 each, or none; they take the default solver
    #[arg(long, value_name = "LIST", default_value = "none")]
    scan_triangles: Numbers,
    /// Vertices of the template that is registered to them
    #[arg(long, value_name = "N", default_value_t = 5000)]
    scan_template: usize,
    /// Seed of goals and scans
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Where tables and plots go
    #[arg(long, value_name = "DIR", default_value = "out/scaling")]
    out: PathBuf,
    /// Run this configuration here and print its line
    #[arg(long, hide = true, value_name = "JSON")]
    run: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`] of the arguments before anything runs; of the computation, with the configuration, when a run fails; of writing.
pub fn run(a: &Arguments) -> Result<()> {
    if let Some(configuration) = &a.run {
        return run_here(configuration);
    }
    each_once("--sizes", &a.sizes.0)?;
    each_once("--threads", &a.threads.0)?;
    each_once("--scan-triangles", &a.scan_triangles.0)?;
    each_once("--linear-solver", &a.linear_solver)?;
    each_once("--linearisation", &a.linearisation)?;
    let configurations = configurations(a).map_err(|what| Failure::new(Stage::Arguments, what))?;
    make_output_folder(&a.out, [], &[])?;
    let program = this_program()?;
    let mut rows = Vec::new();
    for (k, configuration) in configurations.iter().enumerate() {
        tell(format_args!("{}/{}  {}", k + 1, configurations.len(), describe(configuration)));
        let row = run_apart(&program, configuration)?;
        say(&row)?;
        rows.push(row);
    }
    write_results(a, &rows)
}

/// Every combination, smallest first, or what is wrong with one.
fn configurations(a: &Arguments) -> Result<Vec<Configuration>, String> {
    let (Numbers(sizes), Numbers(threads), Numbers(scans)) = (&a.sizes, &a.threads, &a.scan_triangles);
    if sizes.is_empty() && scans.is_empty() {
        return Err("--sizes none and --scan-triangles none leave nothing to run".to_owned());
    }
    let within = |option: &str, values: &[usize], least: usize, most: usize| match values
        .iter()
        .find(|v| !(least..=most).contains(v))
    {
        Some(v) => Err(format!("{option}: {v}, expected {least} to {most}")),
        None => Ok(()),
    };
    within("--sizes", sizes, 1000, 500_000)?;
    within("--threads", threads, 1, 1024)?;
    within("--scan-triangles", scans, 500, 10_000_000)?;
    within("--scan-template", &[a.scan_template], 1000, 500_000)?;
    within("--shapes", &[a.shapes], 0, shapes_at_most())?;
    if threads.is_empty() {
        return Err("--threads: none, expected at least one number".to_owned());
    }
    let nodes: Vec<usize> = match &a.nodes {
        Nodes::Auto => sizes.iter().map(|v| (v / 100).max(50)).collect(),
        Nodes::List(list) if list.len() != sizes.len() => {
            return Err(format!("--nodes: {} numbers for {} --sizes", list.len(), sizes.len()));
        }
        Nodes::List(list) => list.clone(),
    };
    let (iterations, repeats) = (a.iterations as usize, a.repeats as usize);
    let mut all = Vec::new();
    for (&vertices, &nodes) in sizes.iter().zip(&nodes) {
        within("--nodes", &[nodes], 1, vertices)?;
        for &linear_solver in &a.linear_solver {
            fits(linear_solver, nodes, a.shapes)?;
            for derivatives in &a.linearisation {
                let reference = *derivatives == Derivatives::Reference;
                all.extend(threads.iter().map(|&threads| {
                    let (shapes, seed) = (a.shapes, a.seed);
                    Configuration::Solver(SolverRun {
                        rig: None,
                        vertices,
                        nodes,
                        shapes,
                        threads,
                        linear_solver,
                        reference,
                        iterations,
                        repeats,
                        seed,
                    })
                }));
            }
        }
    }
    for &triangles in scans {
        all.extend(threads.iter().map(|&threads| {
            let (template, seed) = (a.scan_template, a.seed);
            Configuration::Registration(RegistrationRun { triangles, template, threads, repeats, seed })
        }));
    }
    Ok(all)
}

/// Unknowns beyond which one dense square does not fit where the rest of the study does.
const DENSE_UNKNOWNS: usize = 20_000;

fn fits(solver: LinearSolverKind, nodes: usize, shapes: usize) -> Result<(), String> {
    let unknowns = 6 * nodes + shapes;
    if solver == LinearSolverKind::Dense && unknowns > DENSE_UNKNOWNS {
        let gigabytes = 8e-9 * (unknowns * unknowns) as f64;
        return Err(format!(
            "--linear-solver dense with {nodes} nodes: {unknowns} unknowns, a square of {gigabytes:.1} GB; at most {DENSE_UNKNOWNS} unknowns"
        ));
    }
    Ok(())
}

fn describe(configuration: &Configuration) -> String {
    match configuration {
        Configuration::Solver(r) => format!(
            "{} vertices, {} nodes, {} shapes, {}, {}, threads {}",
            r.vertices,
            r.nodes,
            r.shapes,
            r.linear_solver,
            if r.reference { "reference" } else { "structured" },
            r.threads
        ),
        Configuration::Registration(r) => {
            format!("scan of {} triangles, template of {} vertices, threads {}", r.triangles, r.template, r.threads)
        }
        Configuration::Morph(r) => {
            format!("{} masks on {} models, {} vertices", r.masks.len(), r.models.len(), r.vertices)
        }
    }
}

fn run_here(configuration: &str) -> Result<()> {
    let configuration: Configuration =
        serde_json::from_str(configuration).map_err(|e| Failure::new(Stage::Arguments, format!("--run: {e}")))?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(configuration.threads()).build();
    let pool = pool.map_err(|e| Failure::new(Stage::Arguments, format!("--threads: {e}")))?;
    say(pool.install(|| configuration.measure())?)?;
    Ok(())
}

/// Runs a configuration in a process of its own, of the `experiments` at `program`, and returns all that is known of it.
///
/// # Errors
/// A [`Failure`] of the computation, with the configuration, when the run fails.
pub fn run_apart(program: &Path, configuration: &Configuration) -> Result<Value> {
    let failed = |what: String| Failure::computation(format!("{}: {what}", describe(configuration)));
    let mut command = Command::new(program);
    command.args(["scaling", "--run"]).arg(serde_json::to_string(configuration)?).stdin(Stdio::null());
    if matches!(configuration, Configuration::Morph(_)) {
        // What is freed goes back to the system at once, so that what one model leaves is not what the next takes. glibc reads these.
        let settings = [("ARENA_MAX", "1"), ("TRIM_THRESHOLD_", "0"), ("MMAP_THRESHOLD_", "4096")];
        command.envs(settings.map(|(name, value)| (format!("MALLOC_{name}"), value)));
    }
    let output = command.output().map_err(|e| failed(format!("cannot be started: {e}")))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.trim().trim_start_matches("error: ");
        return Err(failed(if said.is_empty() { output.status.to_string() } else { said.to_owned() }).into());
    }
    Ok(serde_json::from_slice(&output.stdout).map_err(|e| failed(format!("its result: {e}")))?)
}

/// A quantity that is fitted and plotted: key in a row, name, unit, what one of its units is worth.
struct Quantity {
    key: &'static str,
    name: &'static str,
    unit: &'static str,
    worth: f64,
}

const fn seconds(key: &'static str, name: &'static str) -> Quantity {
    Quantity { key, name, unit: "seconds", worth: 1.0 }
}

const PEAK: Quantity = Quantity { key: "peak_bytes", name: "peak memory", unit: "MB", worth: 1e6 };

const SOLVER: &[Quantity] = &[
    seconds("iteration_seconds", "one iteration"),
    seconds("linearise_seconds", "linearisation, of an iteration"),
    seconds("solve_seconds", "linear solve, of an iteration"),
    seconds("energy_seconds", "energy, of an iteration"),
    seconds("graph_seconds", "construction of the graph"),
    seconds("attach_seconds", "assembly's preparation"),
    seconds("analysis_seconds", "analysis of the equations"),
    PEAK,
];

const REGISTRATION: &[Quantity] = &[
    seconds("registration_seconds", "the whole run"),
    seconds("setup_seconds", "before the first step"),
    seconds("steps_seconds", "all steps"),
    PEAK,
];

fn write_results(a: &Arguments, rows: &[Value]) -> Result<()> {
    let mut exponents = Vec::new();
    for (study, x, title, quantities) in [
        ("solver", "vertices", "Hybrid, fixed correspondences", SOLVER),
        ("registration", "triangles", "Registration of the hybrid", REGISTRATION),
    ] {
        let rows: Vec<&Value> = rows.iter().filter(|r| r["study"] == study).collect();
        if rows.is_empty() {
            continue;
        }
        write_rows(&a.out.join(format!("{study}.csv")), &rows)?;
        for quantity in quantities {
            let lines = lines(&rows, x, quantity);
            for (name, points) in &lines {
                if let Some(law) = PowerLaw::fit(points) {
                    exponents.push((study, quantity, name.clone(), law));
                }
            }
            if lines.iter().any(|(_, points)| points.iter().any(|p| p[1] > 0.0)) {
                let stem = quantity.key.trim_end_matches("_seconds").trim_end_matches("_bytes");
                let x = format!("{x} of the {}", if study == "solver" { "template" } else { "scan" });
                let point = |p: &[f64; 2]| Point { x: p[0], y: p[1], spread: None };
                let series = |(name, points): &(String, Vec<[f64; 2]>)| {
                    Series::line(name, points.iter().map(point).collect()).with_power_law()
                };
                let plot = Plot::new(&format!("{title}: {}", quantity.name), Axis::log(&x), Axis::log(quantity.unit));
                let plot = plot.series(lines.iter().map(series).collect()).with_proportional();
                write_file(&a.out.join(format!("{study}-{stem}.svg")), plot.svg()?)?;
            }
        }
    }
    let fields = |(study, quantity, name, law): &(&str, &Quantity, String, PowerLaw)| {
        let (exponent, range) = (format!("{:.3}", law.exponent), [law.from, law.to].map(|v| v.to_string()));
        let [from, to] = range;
        [(*study).to_owned(), quantity.key.to_owned(), name.clone(), exponent, from, to].to_vec()
    };
    let csv = exponents.iter().map(|e| fields(e).iter().map(|f| csv_field(f)).collect::<Vec<_>>().join(","));
    write_csv(&a.out.join("exponents.csv"), "study,quantity,series,exponent,from,to", csv)?;
    if !exponents.is_empty() {
        let header = ["study", "quantity", "series", "exponent", "from", "to"];
        tell(format_args!("{}", table(&header, exponents.iter().map(fields))));
    }
    tell(format_args!("tables and plots are in {}", a.out.display()));
    Ok(())
}

/// One line for each solver, linearisation and number of threads: its name and points (x, y), x ascending. What was repeated counts by
/// its median.
fn lines(rows: &[&Value], x: &str, quantity: &Quantity) -> Vec<(String, Vec<[f64; 2]>)> {
    let points = rows.iter().filter_map(|row| {
        let measured = &row[quantity.key];
        let y = measured["median"].as_f64().or_else(|| measured.as_f64())?;
        let threads = format!("threads {}", row["threads"]);
        let name = match (row["linear_solver"].as_str(), row["reference"].as_bool()) {
            (Some(solver), Some(true)) => format!("{}, reference, {threads}", solver.replace('_', "-")),
            (Some(solver), _) => format!("{}, {threads}", solver.replace('_', "-")),
            _ => threads,
        };
        Some((name, [row[x].as_f64().unwrap_or(f64::NAN), y / quantity.worth]))
    });
    let mut lines = grouped(points);
    lines.iter_mut().for_each(|(_, points)| points.sort_by(|a, b| a[0].total_cmp(&b[0])));
    lines
}

/// All that rows hold, a column for each number.
fn write_rows(path: &Path, rows: &[&Value]) -> Result<()> {
    let flat = |row: &Value| -> Vec<(String, String)> {
        let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), csv_field);
        let object = row.as_object().into_iter().flatten();
        let cells = object.flat_map(|(key, value)| match value.as_object() {
            Some(parts) => parts.iter().map(|(part, v)| (format!("{key}_{part}"), text(v))).collect(),
            None => vec![(key.clone(), text(value))],
        });
        cells.collect()
    };
    let header = flat(rows[0]).into_iter().map(|c| c.0).collect::<Vec<_>>().join(",");
    let line = |row: &&Value| flat(row).into_iter().map(|c| c.1).collect::<Vec<_>>().join(",");
    write_csv(path, &header, rows.iter().map(line))
}
