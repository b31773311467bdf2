//! Studies on top of `nonrigid`: the first run, and one subcommand for each of the others.

use std::fs;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, Subcommand};
use comfy_table::{CellAlignment, Table, presets};
use experiments::first;
use experiments::random_pose::random_pose;
use experiments::rig_statistics::RigStatistics;
use experiments::scan_bench::{BenchCase, BenchRig, BenchRow, LandmarkUse, Scheduled, scan_bench, summarize};
use experiments::start_bench::{StartCase, start_case};
use experiments::tables::write_tables;
use nonrigid::cli::{Failure, Stage};
use nonrigid::mesh::io::write_polygon_mesh;
use nonrigid::mesh::{Pose, Vec3};
use nonrigid::registration::{ModelFactory, ModelKind, RegistrationError, Schedule, TermFactory, TermKind};
use nonrigid::rig::{Rig, RigReadOptions};

/// Without a subcommand, the first run: makes a face rig and a scan of an extreme mouth, registers it with three models,
/// and leaves a picture, results and errors.
#[derive(Parser)]
#[command(name = "experiments", version, max_term_width = 110, args_conflicts_with_subcommands = true)]
#[command(after_help = "Exit codes: 0 done, 1 arguments, 2 computation, 3 writing, 4 loading.")]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    first: first::Options,
    /// Threads [default: all cores]; results do not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    /// Register every case below DIR with every model and compare with the ground truth
    ScanBench(ScanBench),
    /// Search the start of every scan without landmarks, as given and moved, and compare with the start by landmarks
    StartBench(StartBench),
    /// Put rigs side by side: edge lengths, curvature, expressions, spectrum of the identity modes
    CompareRigs {
        /// Rig folders
        #[arg(value_name = "DIR", required = true)]
        rigs: Vec<PathBuf>,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(clap::Args)]
struct ScanBench {
    /// Folder of cases
    #[arg(value_name = "DIR")]
    cases: PathBuf,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Where results, tables and timings go
    #[arg(long, value_name = "DIR", default_value = "out/scan-bench")]
    out: PathBuf,
    /// Models to run
    #[arg(long, value_delimiter = ',', default_values_t = ModelKind::ALL, value_parser = str::parse::<ModelKind>)]
    models: Vec<ModelKind>,
    /// Schedule (.toml) for every model instead of its own
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Landmarks: all, align (for the start only), none (the start is searched), or how many
    #[arg(long, default_value = "all", value_parser = str::parse::<LandmarkUse>)]
    landmarks: LandmarkUse,
    /// Turn every scan by this many degrees about a random axis
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0)]
    turn: f64,
    /// Move every scan by this many millimetres in a random direction
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    shift: f64,
    /// Seed of the random poses
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(clap::Args)]
struct StartBench {
    /// Folders of cases, and scans (.ply or .obj); landmarks.json beside a scan is its reference
    #[arg(value_name = "DIR_OR_SCAN", required = true)]
    scans: Vec<PathBuf>,
    /// Rig folder; its polygons are the template
    #[arg(long, value_name = "DIR")]
    rig: PathBuf,
    /// Turns about random axes, degrees
    #[arg(long, value_delimiter = ',', default_value = "0,30,90,180")]
    turns: Vec<f64>,
    /// Turn about the vertical axis instead
    #[arg(long)]
    vertical: bool,
    /// Shift with every turn but 0, millimetres
    #[arg(long, default_value_t = 500.0)]
    shift: f64,
    /// Seed of the random poses
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => {
            let _ = e.print(); // a closed pipe is all that can go wrong, and there is nobody left to tell
            return u8::from(e.use_stderr()).into();
        }
    };
    let outcome = match &cli.command {
        None => on_threads(cli.threads).and_then(|()| first::run(&cli.first, &mut io::stdout().lock()).map(drop)),
        Some(Command::ScanBench(arguments)) => on_threads(arguments.threads).and_then(|()| run_scan_bench(arguments)),
        Some(Command::StartBench(arguments)) => on_threads(arguments.threads).and_then(|()| run_start_bench(arguments)),
        Some(Command::CompareRigs { rigs, json }) => compare_rigs(rigs, *json),
    };
    let Err(e) = outcome else { return ExitCode::SUCCESS };
    eprintln!("error: {e:#}");
    exit_code(&e)
}

fn exit_code(error: &anyhow::Error) -> ExitCode {
    if let Some(failure) = error.downcast_ref::<Failure>() {
        return failure.exit_code();
    }
    let input = error.downcast_ref().is_some_and(RegistrationError::is_input);
    ExitCode::from(if input { Stage::Loading } else { Stage::Computation } as u8)
}

fn on_threads(threads: Option<u16>) -> Result<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.map_or(0, usize::from));
    Ok(pool.build_global().map_err(|e| Failure::new(Stage::Arguments, format!("--threads: {e}")))?)
}

fn compare_rigs(folders: &[PathBuf], json: bool) -> Result<()> {
    let statistics = |folder: &PathBuf| -> Result<RigStatistics> {
        let (rig, _) = Rig::read(folder, &RigReadOptions::default()).map_err(Failure::loading)?;
        Ok(RigStatistics::of(&rig).map_err(|e| Failure::loading(format!("{}: {e}", folder.display())))?)
    };
    let all = folders.iter().map(statistics).collect::<Result<Vec<_>>>()?;
    if json {
        println!("{:#}", serde_json::json!(all));
        return Ok(());
    }
    let names: Vec<String> = folders.iter().map(|f| f.display().to_string()).collect();
    let header: Vec<&str> = [""].into_iter().chain(names.iter().map(String::as_str)).collect();
    let columns: Vec<Vec<(String, String)>> = all.iter().map(RigStatistics::rows).collect();
    let longest = columns.iter().max_by_key(|c| c.len()).map_or(&[][..], |c| c);
    let rows = longest.iter().map(|(name, _)| {
        let cell = |c: &Vec<(String, String)>| c.iter().find(|r| r.0 == *name).map_or(String::new(), |r| r.1.clone());
        [name.clone()].into_iter().chain(columns.iter().map(cell)).collect()
    });
    println!("{}", table(&header, rows));
    Ok(())
}

fn run_scan_bench(a: &ScanBench) -> Result<()> {
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    fs::create_dir_all(&a.out).map_err(|e| Failure::writing(format!("{}: {e}", a.out.display())))?;
    let rig = BenchRig::read(&a.rig).map_err(unread)?;
    let mut cases = BenchCase::read_all(&a.cases, &rig).map_err(unread)?;
    if a.turn != 0.0 || a.shift != 0.0 {
        println!("every scan turned by {} degrees and moved by {} mm, seed {}", a.turn, a.shift, a.seed);
        let moved = |(i, case): (usize, BenchCase)| case.moved(&random_pose(a.turn, a.shift, a.seed, i as u64));
        cases = cases.into_iter().enumerate().map(moved).collect();
    }
    println!("{} cases x {} models, {} threads", cases.len(), a.models.len(), rayon::current_num_threads());
    let scheduled = a.models.iter().map(|model| {
        let schedule = match &a.config {
            None => model.schedule()?,
            Some(path) => {
                let unread = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
                let text = fs::read_to_string(path).map_err(|e| unread(&e))?;
                Schedule::from_toml(&text).map_err(|e| unread(&e))?
            }
        };
        Ok(Scheduled { model, schedule })
    });
    let scheduled: Vec<Scheduled<'_>> = scheduled.collect::<Result<_>>()?;
    let models: Vec<&dyn ModelFactory> = scheduled.iter().map(|m| m as &dyn ModelFactory).collect();
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let rows = scan_bench(&models, &terms, &cases, a.landmarks, |row, case, result| {
        let folder = a.out.join(&row.case);
        fs::create_dir_all(&folder).map_err(|e| Failure::writing(format!("{}: {e}", folder.display())))?;
        let mesh = case.template.with_positions(result.positions.clone());
        write_polygon_mesh(&folder.join(format!("{}.obj", row.model)), &mesh).map_err(Failure::writing)?;
        eprintln!("{:16} {:12} rmse {:.3} mm  {:.2} s", row.case, row.model, row.errors.rmse, row.seconds);
        Ok(())
    })?;
    let json = serde_json::json!({ "rows": rows, "summary": summarize(&rows) });
    write_tables(&a.out, "scan-bench", &rows, &json)?;
    println!("{}", table_of(&rows));
    println!("{}", summary_table(&rows));
    println!("results, scan-bench.csv and scan-bench.json are in {}", a.out.display());
    Ok(())
}

fn run_start_bench(a: &StartBench) -> Result<()> {
    let unread = |e: anyhow::Error| Failure::loading(format!("{e:#}"));
    let rig = BenchRig::read(&a.rig).map_err(unread)?;
    let mut cases: Vec<StartCase> = Vec::new();
    for path in &a.scans {
        if path.is_dir() {
            cases.extend(BenchCase::read_all(path, &rig).map_err(unread)?.into_iter().map(StartCase::from));
        } else {
            let marks = Some(path.with_file_name("landmarks.json")).filter(|p| p.exists());
            cases.push(StartCase::read(path, marks.as_ref(), &rig).map_err(unread)?);
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
            let head = vec![case.name.clone(), format!("{turn}")];
            let cells: Vec<String> = match start_case(case, &moved, &schedule) {
                Ok(row) => {
                    of += usize::from(!row.turn.is_nan());
                    found += usize::from(row.turn < FOUND_DEGREES);
                    let (fit, next) = (row.search.fit, row.search.runner_up.map_or(1.0, |f| f.loss));
                    let numbers = [row.turn, row.distance, fit.loss, fit.share, fit.residual, next, row.seconds];
                    {
                        let seen = row.search.expression.iter().map(|(name, w)| format!("{name} {w}"));
                        let seen = seen.collect::<Vec<_>>().join(", ");
                        numbers.map(|x| format!("{x:.2}")).into_iter().chain([seen]).collect()
                    }
                }
                Err(e) => {
                    of += 1;
                    vec![format!("{e:#}")]
                }
            };
            rows.push([head, cells].concat());
        }
    }
    println!("{}", table(&header, rows));
    println!("{found} of {of} within {FOUND_DEGREES} degrees of the start by landmarks");
    Ok(())
}

/// A start nearer than this to that by landmarks is found, degrees.
const FOUND_DEGREES: f64 = 5.0;

fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_HORIZONTAL_ONLY).set_header(header).add_rows(rows);
    table.column_iter_mut().skip(1).for_each(|c| c.set_cell_alignment(CellAlignment::Right));
    table
}

fn table_of(rows: &[BenchRow]) -> Table {
    let header = ["case / mm", "model", "rmse", "off", "slide", "median", "p95", "unobserved", "flips", "steps", "s"];
    table(
        &header,
        rows.iter().map(|r| {
            let e = &r.errors;
            let mut cells = vec![r.case.clone(), r.model.clone()];
            cells.extend([e.rmse, e.off, e.slide, e.median, e.p95, e.unobserved].map(|x| format!("{x:.3}")));
            cells.extend([e.flipped.to_string(), r.iterations.to_string(), format!("{:.2}", r.seconds)]);
            cells
        }),
    )
}

fn summary_table(rows: &[BenchRow]) -> Table {
    let header = ["model / mm", "mean rmse", "worst rmse", "mean off", "mean slide", "worst unobserved", "mean s"];
    table(
        &header,
        summarize(rows).into_iter().map(|s| {
            let numbers = [s.mean_rmse, s.worst_rmse, s.mean_off, s.mean_slide, s.worst_unobserved];
            let mut cells = vec![s.model];
            cells.extend(numbers.map(|x| format!("{x:.3}")));
            cells.push(format!("{:.2}", s.mean_seconds));
            cells
        }),
    )
}
