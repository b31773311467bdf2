//! `nonrigid batch`.

use std::ffi::OsString;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use clap::{Arg, ArgMatches, Args, CommandFactory, FromArgMatches, Parser};
use indicatif::{ProgressBar, ProgressStyle};

use super::animate::{Cutoff, FRAME_RATE, frame_rate, without_effect};
use super::inputs::refuse_as_shape;
use super::interrupt::Interrupt;
use super::{Failure, Program, Stage, bounded, check_output_folder, register, say, tell, warn};
use crate::batch::{Animation, Batch, Columns, Finished, Job, Manifest, Outcome, Plan, Row, Shard, Status, Timing};
use crate::text;

/// Arguments of `nonrigid batch`.
#[derive(Debug, Args)]
#[command(
    after_help = "The manifest has a line of column names, then a line for each scan. Columns are 'target', the scan; 'name' of its\n\
    outputs; 'sequence', whose frames follow each other in the manifest's order, each with landmarks from where the one before ended; and any\n\
    option of `nonrigid register`, which stands before that of the command line. Paths are relative to the manifest. Each scan is\n\
    a process of its own: one that fails, however it does, leaves the others alone. What is done, by the hash of all that went\n\
    into it, is not done again.\n\n\
    DIR gets NAME.obj and NAME.json (the report) for each scan, summary.csv, index.html, log/NAME.txt (what was said), and for each\n\
    sequence one animated file, sequences/SEQUENCE.usda, smoothed in time, and a report of lost frames, sequences/SEQUENCE.json.\n\n\
    scans.csv:\n  target,landmarks,sequence\n  ann/0001.ply,ann/0001.json,ann\n  ann/0002.ply,ann/0002.json,ann\n  \
    ben.obj,ben.mrk.json,\n\n\
    Examples:\n  nonrigid batch scans.csv --out wrapped --template face.obj --rig rig --pictures\n  \
    nonrigid batch scans.csv --out wrapped --template face.obj --shard 1/8     # a part of it, on each of eight machines"
)]
pub struct Arguments {
    /// List of scans (.csv)
    #[arg(value_name = "MANIFEST")]
    manifest: PathBuf,
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Scans at once [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Threads of all scans together [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Do part I of N only; sequences stay whole
    #[arg(long, value_name = "I/N", value_parser = str::parse::<Shard>)]
    shard: Option<Shard>,
    /// Write a picture for each scan, NAME.png, and show them in index.html
    #[arg(long)]
    pictures: bool,
    /// Format of results
    #[arg(long, value_enum, default_value_t = Format::Obj)]
    format: Format,
    /// Format of the animated file of each sequence [default: usda]
    #[arg(long, value_enum, value_name = "FORMAT")]
    animation: Option<AnimationFormat>,
    /// Frames a second of sequences, 1 to 1000, such as 23.976 [default: 60]
    #[arg(long, value_name = "N", value_parser = frame_rate)]
    fps: Option<f64>,
    /// Smooth animated files in time: what changes HZ times a second is halved, what changes slower stays, what changes faster goes;
    /// or none. The frames' own files stay as they are [default: 4]
    #[arg(long, value_name = "HZ")]
    smooth: Option<Cutoff>,
    /// Do again what is done
    #[arg(long)]
    again: bool,
    #[command(flatten)]
    of_register: OfRegister,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    Obj,
    Ply,
    Glb,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum AnimationFormat {
    /// A mesh with points over time
    Usda,
    /// A point cache
    Pc2,
    /// The rig's weights, a pose, and a target for what is left of each frame
    Glb,
    /// No animated file
    None,
}

/// `nonrigid register` on its own, to parse each row's options.
#[derive(Debug, Parser)]
#[command(name = "register")]
struct Register {
    #[command(flatten)]
    arguments: register::Arguments,
}

/// What the batch itself says to `register`.
const RESERVED: [&str; 6] = ["out", "report", "picture", "state", "warm-start", "threads"];
const SCAN: &str = "target";

/// Long name and definition of the options of `register` that rows may have.
fn options() -> Vec<(String, Arg)> {
    let command = Register::command();
    let named = command.get_arguments().filter_map(|arg| Some((arg.get_long()?.to_owned(), arg.clone())));
    named.filter(|(long, _)| !RESERVED.contains(&long.as_str()) && long != "help").collect()
}

fn is_path(arg: &Arg) -> bool {
    let names = arg.get_value_names().unwrap_or_default();
    names.iter().any(|name| ["MESH", "FILE", "DIR"].contains(&name.as_str()))
}

/// Options of `register` for every row: each as given, to be judged with the row's own.
#[derive(Debug, Default)]
struct OfRegister(Vec<(String, OsString)>);

impl Args for OfRegister {
    fn augment_args(command: clap::Command) -> clap::Command {
        options().into_iter().filter(|(long, _)| long != SCAN).fold(command, |command, (long, arg)| {
            let names = arg.get_value_names().unwrap_or_default().to_vec();
            let mut copy = Arg::new(format!("register-{long}")).long(long).value_names(names);
            copy = copy
                .value_parser(clap::value_parser!(OsString))
                .allow_hyphen_values(true)
                .help_heading("For every scan, as in `nonrigid register`");
            command.arg(if let Some(help) = arg.get_help() { copy.help(help.clone()) } else { copy })
        })
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for OfRegister {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |(long, _): (String, Arg)| {
            let value = matches.try_get_one::<OsString>(&format!("register-{long}")).ok()??.clone();
            Some((long, value))
        };
        Ok(Self(options().into_iter().filter_map(given).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The columns that a manifest may have: the options of `register`.
#[must_use]
pub fn columns() -> Columns {
    let known = options();
    let of_kind = |keep: &dyn Fn(&Arg) -> bool| known.iter().filter(|o| keep(&o.1)).map(|o| o.0.clone()).collect();
    Columns { options: of_kind(&|_| true), paths: of_kind(&is_path), required: SCAN.to_owned() }
}

/// What decides results besides options of `register`.
#[must_use]
pub fn settings(batch: &Batch) -> [(String, String); 2] {
    [("format".to_owned(), batch.format.clone()), ("pictures".to_owned(), batch.pictures.to_string())]
}

impl Arguments {
    /// What becomes of sequences. Of options that have no effect on them it is said.
    fn animation(&self, manifest: &Manifest) -> Option<Animation> {
        let format = self.animation.unwrap_or(AnimationFormat::Usda);
        let smooth = self.smooth.unwrap_or(Cutoff(Some(4.0))).0;
        let animation = (format != AnimationFormat::None).then(|| Animation {
            format: format!("{format:?}").to_lowercase(),
            frames_per_second: self.fps.unwrap_or(FRAME_RATE),
            smooth,
        });
        let is_given = [self.animation.is_some(), self.fps.is_some(), self.smooth.is_some()];
        let given = |from: usize| {
            let names = ["--animation", "--fps", "--smooth"].into_iter().zip(is_given).skip(from);
            Some(names.filter(|(_, is)| *is).map(|(name, _)| name).collect::<Vec<_>>().join(", "))
                .filter(|n| !n.is_empty())
        };
        let without_effect = match &animation {
            _ if manifest.rows.iter().all(|row| row.sequence.is_none()) => {
                given(0).map(|names| format!("{names}: no effect, as no row of the manifest has a sequence"))
            }
            None => given(1).map(|names| format!("{names}: no effect with --animation none")),
            Some(animation) => without_effect(&animation.format, self.fps, smooth),
        };
        without_effect.iter().for_each(warn);
        animation
    }
}

/// Runs the command.
pub fn run(a: &Arguments, program: &Program) -> Result<(), Failure> {
    check_output_folder(&a.out)?;
    let rig = a.of_register.0.iter().find(|(long, _)| long == "rig").map(|(_, path)| Path::new(path));
    refuse_as_shape(rig, &a.out, "--out")?;
    let columns = columns();
    let manifest = Manifest::read(&a.manifest, &columns).map_err(Failure::loading)?;
    let animation = a.animation(&manifest);
    let cores = a.threads.map_or_else(rayon::current_num_threads, |asked| bounded("--threads", asked.into()));
    let at_once = a.jobs.map_or(cores, |asked| bounded("--jobs", asked.into()));
    let batch = Batch {
        program: program.path.clone(),
        command: program.first.clone(),
        folder: a.out.clone(),
        format: format!("{:?}", a.format).to_lowercase(),
        pictures: a.pictures,
        animation,
        at_once,
        threads: (cores / at_once).max(1),
        again: a.again,
    };
    let settings = settings(&batch);
    let shard = a.shard.unwrap_or(Shard::whole());
    let plan = Plan::new(batch, &a.manifest, &manifest, shard, |row| job(row, &a.of_register.0, &settings, &columns));
    let count = plan.count();
    let interrupt = Interrupt::listen()?;
    let progress = Progress::new(count, &plan.jobs, &a.out);
    let finished = plan
        .run(&|| interrupt.asked(), &|outcome| progress.finished(outcome), &|said| warn(said))
        .map_err(|e| Failure::new(if e.is_clash() { Stage::Arguments } else { Stage::Writing }, e.to_string()))?;
    progress.bar.finish_and_clear();
    let Finished { outcomes, summary, not_animated, timing } = finished;
    say(summary.to_string().trim_end())?;
    say(line(&timing))?;
    say(format_args!("wrote {}", a.out.join("index.html").display()))?;
    if interrupt.asked() {
        let message = format!("interrupted: {} of {count} are done; the same command goes on", outcomes.len());
        return Err(interrupt.failure(message));
    }
    match outcomes.iter().filter(|o| o.record.status == Status::Failed).count() {
        0 => match not_animated.first() {
            None => Ok(()),
            Some((sequence, error)) => {
                let more = if not_animated.len() > 1 {
                    format!(", nor of {} more", not_animated.len() - 1)
                } else {
                    String::new()
                };
                Err(Failure::computation(format!("no animated file of sequence {sequence:?}{more}: {error}")))
            }
        },
        failed => {
            let path = a.out.join("summary.csv");
            Err(Failure::computation(format!("{failed} of {count} scans failed; {} says why", path.display())))
        }
    }
}

/// What a row runs: the options of the command line, then its own instead of them. `further` decides the result besides.
#[must_use]
pub fn job(row: &Row, of_all: &[(String, OsString)], further: &[(String, String)], columns: &Columns) -> Job {
    let of_row = |long: &str| row.options.iter().any(|(column, _)| column == long);
    let of_all = of_all.iter().filter(|(long, _)| !of_row(long)).cloned();
    let settings: Vec<(String, OsString)> = of_all.chain(row.options.iter().cloned()).collect();
    let argument = |(long, value): &(String, OsString)| {
        let mut argument = OsString::from(format!("--{long}="));
        argument.push(value);
        argument
    };
    let arguments: Vec<OsString> = settings.iter().map(argument).collect();
    // what the batch itself adds does not matter here
    let format = further.iter().find(|(option, _)| option == "format").map_or("obj", |(_, format)| format);
    let out = PathBuf::from(format!("{}.{format}", row.name));
    let line = [OsString::from("register"), format!("--out={}", out.display()).into()];
    let parsed = Register::try_parse_from(line.into_iter().chain(arguments.iter().cloned()));
    let (arguments, inputs, beside) = match parsed {
        Ok(parsed) => (Ok(arguments), parsed.arguments.input_paths(), parsed.arguments.beside(&out)),
        // its files are not to be overwritten either
        Err(error) => {
            let paths = settings.iter().filter(|(long, _)| columns.paths.contains(long));
            (Err(first_line(&error)), paths.map(|(long, path)| (&**long, path.into())).collect(), Vec::new())
        }
    };
    let goes_on = settings.iter().any(|(long, _)| long == "landmarks");
    // what is no path came from text
    let of_text = settings.iter().filter(|(long, _)| !columns.paths.contains(long));
    let mut settings: Vec<(String, String)> =
        of_text.map(|(long, value)| (long.clone(), value.to_string_lossy().into_owned())).collect();
    settings.extend(further.iter().cloned());
    let inputs = inputs.into_iter().map(|(role, path): (&str, PathBuf)| (role.to_owned(), path)).collect();
    let beside = beside.into_iter().map(|(_, path)| path.to_string_lossy().into_owned()).collect();
    Job { name: row.name.clone(), arguments, settings, goes_on, sequence: row.sequence.clone(), beside, inputs }
}

/// What clap has against an option, without advice on how to call the command, which is not the one that was called.
fn first_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let lines = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect::<Vec<_>>().join(" ");
    lines.trim_start_matches("error: ").to_owned()
}

/// Times, in a line.
fn line(timing: &Timing) -> String {
    let Timing { scans, before, seconds, cores, .. } = timing;
    let before = if *before > 0 { format!(", {before} were done before") } else { String::new() };
    let rate = timing.scans_per_core_minute;
    format!("{scans} scans in {seconds:.1} s on {cores} cores: {rate:.1} scans per core-minute{before}")
}

/// A bar on a terminal, otherwise a line for each scan; both with an estimate.
struct Progress<'a> {
    bar: ProgressBar,
    jobs: &'a [Job],
    /// Of results.
    folder: &'a Path,
    count: usize,
    clock: Instant,
    /// Scans that ended, and how many of them ran.
    ended: Mutex<(usize, usize)>,
}

impl<'a> Progress<'a> {
    fn new(count: usize, jobs: &'a [Job], folder: &'a Path) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = if terminal { ProgressBar::new(count as u64) } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len}  {msg}") {
            bar.set_style(style);
        }
        Self { bar, jobs, folder, count, clock: Instant::now(), ended: Mutex::new((0, 0)) }
    }

    fn finished(&self, outcome: &Outcome) {
        let mut ended = self.ended.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        ended.0 += 1;
        ended.1 += usize::from(!outcome.before);
        let left = self.clock.elapsed().as_secs_f64() / ended.1.max(1) as f64 * (self.count - ended.0) as f64;
        let left = if ended.0 == self.count { String::new() } else { format!(", about {} left", duration(left)) };
        let what = match (&outcome.record.error, outcome.before) {
            (Some(error), _) => format!("failed: {error}"),
            (None, true) => match outcome.record.changed(self.folder).next() {
                Some(file) => format!("done before; {} was changed since, and stays", text::short(file)),
                None => "done before".to_owned(),
            },
            (None, false) => format!("{:.1} s", outcome.seconds),
        };
        let name = &self.jobs[outcome.job].name;
        if self.bar.is_hidden() {
            tell(format_args!("[{}/{}] {name}: {what}{left}", ended.0, self.count));
        } else {
            if outcome.record.error.is_some() {
                self.bar.println(text::message(&format!("{name}: {what}")));
            }
            self.bar.set_message(format!("{}{left}", text::short(name)));
            self.bar.inc(1);
        }
    }
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
