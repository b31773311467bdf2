//! The report: Klimov's figures and claims, the models side by side, and how the solver grows, on one page that fills as results
//! arrive.

use std::collections::BTreeMap;
use std::fs;
use std::io::{IsTerminal as _, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use nonrigid::console::{Failure, Stage, say_to, told};
use nonrigid::registration::{ModelFactory, ModelKind};
use nonrigid::self_test::Machine;
use serde_json::json;

pub mod claims;
pub(crate) mod data;
pub mod effort;
mod page;
mod studies;
mod study;
pub mod table;
mod view3d;

use claims::{Judged, Measured, Verdict};
use data::{Data, RealScans};
use effort::Effort;
use page::{Page, State};
use studies::STUDIES;
use study::{Setting, Study};

use crate::output::{check_output_folder, make_output_folder};
use crate::peers::check_python;
use crate::scan_bench::case_folders;

use crate::tables::write_json;

/// What to run.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// Less of everything: about two and a half minutes on two cores
    #[arg(long, conflicts_with = "full")]
    pub quick: bool,
    /// More of everything, however long it takes
    #[arg(long)]
    pub full: bool,
    /// Names the studies with what they would take, and ends
    #[arg(long)]
    pub list: bool,
    /// Only these studies
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// A rig of your own instead of the generated one, for studies of cases and of real scans
    #[arg(long, value_name = "DIR", requires = "scans")]
    pub rig: Option<PathBuf>,
    /// Its scans: cases with truth as data-gen writes them, anywhere below DIR, and real ones as real-scans finds them, in
    /// DIR/scans or else in DIR. Without cases among them all studies but real and presets are of generated ones
    #[arg(long, value_name = "DIR", requires = "rig")]
    pub scans: Option<PathBuf>,
    /// Other programs beside ours, run by this Python; `experiments peers --help` says how to install them [default: python3]
    #[arg(long, value_name = "PYTHON", num_args = 0..=1, default_missing_value = "python3")]
    pub peers: Option<PathBuf>,
    /// Seed of everything random
    #[arg(long, default_value_t = 7)]
    pub seed: u64,
    /// Where the page and everything else goes
    #[arg(long, value_name = "DIR", default_value = "out/report")]
    pub out: PathBuf,
}

impl Options {
    /// How much they ask for.
    #[must_use]
    pub fn effort(&self) -> Effort {
        match (self.quick, self.full) {
            (true, _) => Effort::quick(),
            (_, true) => Effort::full(),
            _ => Effort::usual(),
        }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            quick: false,
            full: false,
            list: false,
            only: Vec::new(),
            rig: None,
            scans: None,
            peers: None,
            seed: 7,
            out: PathBuf::from("out/report"),
        }
    }
}

/// Runs the studies that were asked for and tells `log` about it. `program` is the `experiments` whose processes measure memory.
/// Models of your own, `own`, join those of the crate in Fig. 5, the comparison and the sweeps.
///
/// # Errors
/// A [`Failure`] of the arguments, of reading, of writing; and of the computation when a study failed, after all others have run.
pub fn run(
    options: &Options,
    effort: &Effort,
    program: &Path,
    own: &[&dyn ModelFactory],
    log: &mut dyn Write,
) -> Result<Vec<Judged>> {
    let chosen = choose(options)?;
    if options.list {
        list(effort, log)?;
        return Ok(Vec::new());
    }
    if let Some(python) = &options.peers {
        check_python("--peers", python)?;
    }
    let out = &options.out;
    let clock = Instant::now();
    let threads = rayon::current_num_threads();
    let seconds: f64 = chosen.iter().map(|s| (s.seconds)(effort)).sum::<f64>() + generating(options, effort);
    let plan =
        chosen.iter().map(|s| format!("{} {}", s.name, spoken((s.seconds)(effort)))).collect::<Vec<_>>().join(", ");
    let say = |log: &mut dyn Write, text: String| say_to(log, format_args!("{text}"));
    say(log, format!("Klimov 2020, measured ({}); seed {}, threads {threads}\n", effort.name, options.seed))?;
    let of = if own_cases(options) { ", were the cases the generated ones" } else { "" };
    say(log, format!("plan, about {} on two cores{of}: {plan}\n", spoken(seconds)))?;
    if options.rig.is_some() && !own_cases(options) {
        let of_scans = studies::OF_SCANS.join(" and ");
        say(
            log,
            format!("no case.json below --scans: {of_scans} are of your rig and scans, the rest of a generated rig\n"),
        )?;
    }
    say(log, format!("page: {}, grows as results arrive\n\n", out.join("index.html").display()))?;

    let tables: Vec<&str> = chosen.iter().flat_map(|s| s.tables.iter().copied()).collect();
    let reads = options.rig.iter().map(|path| ("--rig", path));
    let folders = folders(effort, &chosen);
    check_output_folder(out, reads.chain(options.scans.iter().map(|path| ("--scans", path))), &folders)?;
    let data = read_data(options, effort, &folders, log)?;
    make_output_folder(out, [], &folders)?;
    forget_results(out, &tables)?;
    let measured = Measured { folder: out, tables: &tables };
    write_manifest(options, effort, &data, &chosen, own)?;
    let about = about(options, effort, &data);
    let mut states: Vec<(&'static Study, State)> = chosen.iter().map(|s| (*s, State::Waiting)).collect();
    let mut times = Vec::new();
    for k in 0..states.len() {
        let study = states[k].0;
        states[k].1 = State::Running;
        page::write(out, &Page { about: &about, verdicts: &claims::judge_all(measured)?, studies: &states })?;
        let begin = Instant::now();
        let progress = progress_bar();
        say(log, format!("{:12}", study.name))?;
        let (seed, peers) = (options.seed, options.peers.as_deref());
        states[k].1 =
            outcome(study, &Setting { effort, data: &data, seed, out, program, own, peers, progress: &progress })?;
        progress.finish_and_clear();
        let seconds = begin.elapsed().as_secs_f64();
        times.push((study.name, seconds));
        let failure =
            if let State::Failed(message) = &states[k].1 { format!("  failed: {message}") } else { String::new() };
        say(log, format!("{seconds:7.1} s{failure}\n"))?;
    }
    let verdicts = claims::judge_all(measured)?;
    claims::table(&verdicts).write(out, "claims")?;
    let bytes = page::write(out, &Page { about: &about, verdicts: &verdicts, studies: &states })?;
    write_machine(out, &times, clock.elapsed().as_secs_f64())?;

    let count = |v: Verdict| verdicts.iter().filter(|j| j.verdict == v).count();
    let [holds, fails, undecided, open] = Verdict::ALL.map(count);
    say(
        log,
        format!(
            "\nclaims: {holds} hold, {fails} do not, {undecided} undecided with so few scans, {open} not measured\n"
        ),
    )?;
    say(log, format!("page    {}, {:.1} MB\n", out.join("index.html").display(), bytes as f64 / 1e6))?;
    say(log, format!("data    {}, {}\n", data.rig_folder.display(), data.cases_folder.display()))?;
    say(log, format!("took {}\n\n{}\n", spoken(clock.elapsed().as_secs_f64()), next_commands(&data, out)))?;
    let failed =
        states.iter().find_map(|(s, state)| if let State::Failed(m) = state { Some((s.name, m)) } else { None });
    match failed {
        None => Ok(verdicts),
        Some((study, message)) => Err(Failure::computation(format!("{study}: {message}")).into()),
    }
}

/// Runs a study. That it fails is its outcome, but what cannot be written ends everything: the next would not be written either.
fn outcome(study: &Study, setting: &Setting<'_>) -> Result<State> {
    match (study.run)(setting) {
        Ok(section) => Ok(State::Done(section)),
        Err(e) if e.downcast_ref::<Failure>().is_some_and(|f| f.stage() == Stage::Writing) => Err(e),
        Err(e) => Ok(State::Failed(told(&e))),
    }
}

/// The studies that are asked for, in the order of the page: all without names, but those of real scans only where there
/// are some, and other programs only where they are asked for.
fn choose(options: &Options) -> Result<Vec<&'static Study>> {
    let names = &options.only;
    let refused = |message: String| Err(Failure::new(Stage::Arguments, message).into());
    if let Some(unknown) = names.iter().find(|n| !STUDIES.iter().any(|s| s.name == n.as_str())) {
        let known = STUDIES.iter().map(|s| s.name).collect::<Vec<_>>().join(", ");
        return refused(format!("--only {unknown}: no study of that name; there are {known}"));
    }
    let (real, peers) = (studies::REAL, studies::PEERS);
    let has_real = real_scans(options).is_some();
    let left_out = |study: &str| !names.is_empty() && !names.iter().any(|n| n == study);
    let named = |study: &str| !names.is_empty() && !left_out(study);
    if named(real) && !has_real {
        return refused(format!("--only {real}: needs --rig, and --scans with a scan that no case.json is beside"));
    }
    if has_real && !own_cases(options) && studies::OF_SCANS.iter().all(|study| left_out(study)) {
        let of_scans = studies::OF_SCANS.join(" and ");
        return refused(format!(
            "--rig, --scans: without a case.json below --scans only {of_scans} are of them; add one to --only, or leave them out"
        ));
    }
    if named(peers) && options.peers.is_none() {
        return refused(format!("--only {peers}: needs --peers"));
    }
    if options.peers.is_some() && left_out(peers) {
        return refused(format!(
            "--peers: only the study {peers} runs other programs; add it to --only, or leave --peers out"
        ));
    }
    let wanted = |s: &&Study| match &names[..] {
        [] => (s.name != real || has_real) && (s.name != peers || options.peers.is_some()),
        names => names.iter().any(|n| n == s.name),
    };
    Ok(STUDIES.iter().filter(wanted).collect())
}

/// The user's scans without truth, where there are any.
fn real_scans(options: &Options) -> Option<RealScans> {
    RealScans::find(options.rig.as_deref()?, options.scans.as_deref()?)
}

/// Whether cases are the user's own, as they are unless there are scans without truth alone.
fn own_cases(options: &Options) -> bool {
    options.scans.as_deref().is_some_and(|scans| case_folders(scans).is_ok() || real_scans(options).is_none())
}

fn list(effort: &Effort, log: &mut dyn Write) -> Result<()> {
    for study in STUDIES {
        say_to(log, format_args!("{:12} {:>8}  {}\n", study.name, spoken((study.seconds)(effort)), study.title))?;
    }
    Ok(())
}

/// Seconds to make the data, on two cores.
fn generating(options: &Options, effort: &Effort) -> f64 {
    if own_cases(options) { 1.0 } else { 0.5 + 0.6 * effort.cases.len() as f64 }
}

/// The folders of results: the data, and those of studies that have one, of the study's name.
fn folders(effort: &Effort, chosen: &[&Study]) -> Vec<String> {
    let of_studies =
        chosen.iter().map(|study| study.name.to_owned()).filter(|name| studies::WITH_FOLDER.contains(&&**name));
    std::iter::once(data_folder(effort)).chain(of_studies).collect()
}

/// Rig and cases of so much effort.
fn data_folder(effort: &Effort) -> String {
    format!("data/{}", effort.name)
}

fn read_data(options: &Options, effort: &Effort, folders: &[String], log: &mut dyn Write) -> Result<Data> {
    let begin = Instant::now();
    say_to(log, format_args!("{:12}", "data"))?;
    let folder = options.out.join(data_folder(effort));
    let generate = || {
        make_output_folder(&options.out, [], folders)?;
        Data::generate(&folder, effort, options.seed)
    };
    let data = match (&options.rig, &options.scans) {
        (Some(rig), Some(scans)) => Data::of_user(rig, scans, generate)?,
        _ => generate()?,
    };
    say_to(log, format_args!("{:7.1} s\n", begin.elapsed().as_secs_f64()))?;
    Ok(data)
}

/// Removes what an earlier run left under these names, so that no verdict rests on it.
fn forget_results(out: &Path, tables: &[&str]) -> Result<()> {
    for path in tables.iter().flat_map(|table| ["csv", "json"].map(|e| out.join(format!("{table}.{e}")))) {
        if path.exists() {
            fs::remove_file(&path).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?;
        }
    }
    Ok(())
}

fn about(options: &Options, effort: &Effort, data: &Data) -> String {
    let template = data.rig.template();
    let of = if data.generated {
        let real = if data.real.is_some() { "; real scans on your own rig" } else { "" };
        format!("generated from seed {}{real}", options.seed)
    } else {
        "your own rig and scans; sweeps, resolution and the solver's growth with vertices on generated faces".to_owned()
    };
    format!(
        "{} cases on a template of {} vertices, {of}. Effort: {}.",
        data.cases.len(),
        template.positions.len(),
        effort.name
    )
}

/// Says in the folder of a report that it is one.
const MANIFEST: &str = "manifest.json";

/// What identifies a run: equal manifests, equal results.
fn write_manifest(
    options: &Options,
    effort: &Effort,
    data: &Data,
    chosen: &[&Study],
    own: &[&dyn ModelFactory],
) -> Result<()> {
    let command: Vec<String> = std::env::args().skip(1).collect();
    let models = ModelKind::ALL.iter().map(|m| m as &dyn ModelFactory).chain(own.iter().copied());
    let schedules: BTreeMap<&str, &str> = models.map(|m| (m.name(), m.default_schedule())).collect();
    let manifest = json!({
        "version": env!("CARGO_PKG_VERSION"),
        "commit": commit(),
        "command": command,
        "seed": options.seed,
        "effort": effort,
        "studies": chosen.iter().map(|s| s.name).collect::<Vec<_>>(),
        "schedules": schedules,
        "generated": data.generated,
        "inputs": data.hashes()?,
    });
    write_json(&options.out.join(MANIFEST), &manifest)
}

/// The commit that this program's sources are at, and whether they differ from it; `None` outside of a checkout.
fn commit() -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(["-C", env!("CARGO_MANIFEST_DIR")]).args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "HEAD"])?;
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    Some(if changed { format!("{commit}, changed") } else { commit })
}

/// What may differ between equal runs.
fn write_machine(out: &Path, times: &[(&str, f64)], total: f64) -> Result<()> {
    let finished = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let machine = json!({
        "machine": Machine::new(),
        "finished_unix_seconds": finished,
        "seconds": times.iter().copied().collect::<std::collections::BTreeMap<_, _>>(),
        "seconds_in_all": total,
    });
    write_json(&out.join("machine.json"), &machine)
}

fn progress_bar() -> ProgressBar {
    let target =
        if std::io::stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let style = ProgressStyle::with_template("  {bar:30} {pos}/{len}, {eta} left").expect("proven: a fixed template");
    let bar = ProgressBar::with_draw_target(Some(0), target).with_style(style);
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// Seconds as people say them.
fn spoken(seconds: f64) -> String {
    let seconds = seconds.ceil() as u64;
    if seconds < 60 { format!("{seconds} s") } else { format!("{} min {:02} s", seconds / 60, seconds % 60) }
}

/// What to type next, as it works from the same folder.
fn next_commands(data: &Data, out: &Path) -> String {
    let quoted = |path: PathBuf| {
        let text = path.display().to_string();
        if text.contains(char::is_whitespace) { format!("\"{text}\"") } else { text }
    };
    let (rig, template) = (quoted(data.rig_folder.clone()), quoted(data.rig_folder.join("template.obj")));
    let below = [data.cases_folder.clone(), data.cases_folder.join("cases")].map(|at| at.join(&data.extreme().name));
    let case = below.iter().find(|at| at.is_dir()).unwrap_or(&data.cases_folder).clone();
    format!(
        "look closer:\n  \
         cargo run --release -p experiments -- scan-bench {} --rig {rig} --out {}\n\n\
         your own scan, in a folder YOUR_SCAN with scan.ply and landmarks.json ({} is one):\n  \
         cargo run --release -- register --template {template} --rig {rig} \
         --target YOUR_SCAN/scan.ply --landmarks YOUR_SCAN/landmarks.json --out {} --picture {}",
        quoted(data.cases_folder.clone()),
        quoted(out.join("scan-bench")),
        quoted(case),
        quoted(out.join("wrapped.obj")),
        quoted(out.join("wrapped.png")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_studies_are_refused_with_those_that_there_are() {
        let options = |names: &[&str]| Options {
            quick: true,
            only: names.iter().map(ToString::to_string).collect(),
            ..Options::default()
        };
        let error = choose(&options(&["shapes", "fig9"])).unwrap_err().to_string();
        assert!(error.contains("fig9") && error.contains("sweeps"), "{error}");
        let error = choose(&options(&["real"])).unwrap_err().to_string();
        assert!(error.contains("--scans"), "{error}");
        let chosen = choose(&options(&["sweeps", "inputs"])).unwrap();
        assert_eq!(chosen.iter().map(|s| s.name).collect::<Vec<_>>(), ["inputs", "sweeps"]);
        assert_eq!(choose(&options(&[])).unwrap().len(), STUDIES.len() - 2);
    }

    #[test]
    fn durations_read_well() {
        assert_eq!([0.2, 59.0, 59.5, 125.0].map(spoken), ["1 s", "59 s", "1 min 00 s", "2 min 05 s"]);
    }
}
