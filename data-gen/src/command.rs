//! The command line `data-gen`: a synthetic face rig and scans of it with exact truth, as folders. Other programs call it with arguments
//! of their own: [`write()`] for folders, [`scan_options`] for a scan in memory.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::files::{LIBRARY, forget_shapes};
use crate::record::{self, Series};
use crate::scan::arguments::{camera_at, in_range};
use crate::{
    Camera, FaceOptions, FaceRig, Motion, PRESETS, STANDARD_CASES, ScanCase, ScanError, ScanOptions, Scanner, Subject,
    contact_sheet, preset_weights, simulate_scan, write_case, write_population, write_rig, write_weights,
};
use clap::builder::PossibleValuesParser;
use clap::parser::ValueSource;
use clap::{ArgMatches, FromArgMatches as _, Parser};
use nonrigid::console::{Failure, Stage, answer, check_folder_path, check_plan, on_threads, say, told};
use nonrigid::io::FilePlan;
use nonrigid::render::save_png;

const EXAMPLES: &str = "\
Exit codes: 0 done, 1 arguments, 2 computation, 3 writing, 4 loading. In a checkout, `data-gen` is `cargo run --release -p data-gen --`.

Examples:
  data-gen --seed 7 --out out/data                               # the rig and the six standard cases
  data-gen --seed 7 --out out/data --case same_open --triangles 1000000
  data-gen --seed 7 --out out/data --case my_smile --expression mouthSmile=0.8 --expression jawOpen=0.3
  data-gen --seed 7 --out out/data --cases 20                    # 20 cases of random people and expressions
  data-gen --seed 7 --out out/data --population 200              # and 200 neutral faces for `nonrigid rig pca`
  data-gen --seed 7 --out out/data --frames 60 --fps 30          # a sequence of two seconds
  data-gen --seed 7 --out out/data --camera 0,0 --camera=-60,10 --noise 0.3 --holes 8
  data-gen --seed 7 --out out/data --cases 10 --scanner fused    # as seven depth cameras see them
  data-gen --seed 7 --out out/data --cases 10 --scanner frame --rig RIG   # people of a rig of one's own
  data-gen --seed 7 --out out/data --cases 4 --scanner fused --rig BODIES --bend wrist_l,elbow_l=60 --bend wrist_l,acromion_l=50";

/// The command line, as clap knows it.
#[must_use]
pub fn command() -> clap::Command {
    <Arguments as clap::CommandFactory>::command()
}

/// Synthetic face rigs and scans with exact truth, from one seed: DIR/rig and DIR/cases/NAME, in millimetres.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES, allow_negative_numbers = true)]
struct Arguments {
    /// Folder for everything; made if it is not there. What no earlier run has made stays as it is: data-gen.json lists what has.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Everything random comes from this number. Case k is drawn from it plus k, so neighbouring seeds share people.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads; default: one per processor. The result is the same with any number.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Also a picture of the rig and the first scans, DIR/contact_sheet.png.
    #[arg(long)]
    contact_sheet: bool,

    /// Scans people of this rig instead of the generated one: any that `nonrigid register --rig` reads, in millimetres. It is not
    /// written again. Needs --scanner frame or fused.
    #[arg(long, value_name = "RIG", conflicts_with_all = ["vertices", "identity_modes", "eyeballs"], help_heading = "Rig")]
    rig: Option<PathBuf>,
    /// Vertices of the template, approximately: 1,000 to 500,000.
    #[arg(long, default_value_t = 5000, value_parser = in_range(1000, 500_000), help_heading = "Rig")]
    vertices: usize,
    /// Identity modes of the rig, at most 200.
    #[arg(long, default_value_t = 100, value_parser = in_range(0, 200), help_heading = "Rig")]
    identity_modes: usize,

    /// Only these cases, repeatable. Names other than the six standard ones take their expression from --expression or
    /// --preset or chance; those that begin with `new` are of an unknown person, all others of one whose own neutral is known.
    #[arg(long = "case", value_name = "NAME", help_heading = "Cases", conflicts_with = "cases")]
    names: Vec<String>,
    /// This many cases of random people and expressions, every other one unknown, instead of the standard ones.
    #[arg(long, value_name = "N", value_parser = in_range(0, 100_000), help_heading = "Cases")]
    cases: Option<usize>,
    /// A sequence of N frames of one person, DIR/sequence/frame_0000 and so on with weights.csv, instead of cases.
    #[arg(long, value_name = "N", value_parser = in_range(1, 100_000), help_heading = "Cases", conflicts_with_all = ["names", "cases"])]
    frames: Option<usize>,
    /// Also N random people's neutral faces as OBJ, DIR/population, as `nonrigid rig pca` reads them.
    #[arg(long, value_name = "N", value_parser = in_range(1, 100_000), help_heading = "Cases")]
    population: Option<usize>,
    /// Frames per second of a sequence.
    #[arg(long, default_value_t = 30.0, value_name = "HZ", help_heading = "Cases", requires = "frames", conflicts_with_all = ["names", "cases"])]
    fps: f64,
    /// A named expression for every case or as the peak of a sequence.
    #[arg(long, value_parser = PossibleValuesParser::new(PRESETS.iter().map(|p| p.0)), conflicts_with = "expressions", help_heading = "Cases")]
    preset: Option<String>,

    #[command(flatten)]
    scan: ScanOptions,

    /// A camera's position in the scan's coordinates, mm; repeatable.
    #[arg(long = "camera-at", value_name = "X,Y,Z", value_parser = camera_at, allow_hyphen_values = true, help_heading = "Scanner")]
    cameras_at: Vec<Camera>,
    /// No cameras: everything is seen, inside the lips too.
    #[arg(long, conflicts_with_all = ["cameras", "cameras_at", "grazing", "grazing_noise"], help_heading = "Scanner")]
    see_all: bool,
}

/// Why a scan could not be simulated, by stage.
fn unsimulated(error: ScanError) -> Failure {
    let stage = match error {
        ScanError::Option(_) => Stage::Arguments,
        ScanError::NothingSeen => Stage::Computation,
    };
    Failure::new(stage, error.to_string())
}

fn unwritten(error: anyhow::Error) -> Failure {
    Failure::writing(told(&error))
}

/// Where lines for the user go.
type Said<'a> = &'a dyn Fn(std::fmt::Arguments<'_>) -> Result<(), Failure>;

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    let given = match Given::parse(std::env::args_os()) {
        Ok(given) => given,
        Err(error) => return answer(&error),
    };
    match on_threads(given.arguments.threads, || run(&given, &|line| say(line))) {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(failure)) | Err(failure) => failure.report(),
    }
}

/// A command line: its arguments, and which of them it names.
struct Given {
    arguments: Arguments,
    matches: ArgMatches,
}

/// Options that say how something is that another one, where it is 0, leaves out.
const DETAILS: [(&str, &str); 4] =
    [("hole_radius", "holes"), ("spike_height", "spikes"), ("grazing_noise", "noise"), ("wrinkles", "detail")];

impl Given {
    fn parse(line: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let matches = command().try_get_matches_from(line)?;
        Ok(Self { arguments: Arguments::from_arg_matches(&matches)?, matches })
    }

    /// As another program gives them.
    fn of(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, Failure> {
        let line = std::iter::once(OsString::from("data-gen")).chain(arguments);
        Self::parse(line).map_err(|e| {
            let text = e.to_string();
            let lines: Vec<&str> = text.lines().take_while(|line| !line.is_empty()).map(str::trim).collect();
            Failure::new(Stage::Arguments, lines.join(" ").trim_start_matches("error: "))
        })
    }

    fn names(&self, id: &str) -> bool {
        self.matches.value_source(id) == Some(ValueSource::CommandLine)
    }

    /// Refuses an option whose effect another one has taken away.
    fn check(&self) -> Result<(), Failure> {
        let fail = |message: String| Err(Failure::new(Stage::Arguments, message));
        let scan = &self.arguments.scan;
        if self.arguments.see_all && scan.scanner != Scanner::Net {
            return fail("--see-all: a depth camera does not see everything; leave it out".to_owned());
        }
        let none = |switch: &str| match switch {
            "holes" => scan.holes == 0,
            "spikes" => scan.spikes == 0.0,
            "noise" => scan.noise == 0.0,
            _ => scan.detail == 0.0,
        };
        if let Some((detail, switch)) = DETAILS.iter().find(|(detail, switch)| self.names(detail) && none(switch)) {
            return fail(format!("--{}: has no effect with --{switch} 0; leave one of them out", option(detail)));
        }
        let [forehead, crows_feet, folds] = [scan.wrinkles.forehead, scan.wrinkles.crows_feet, scan.wrinkles.folds];
        if self.arguments.rig.is_some() && [forehead, crows_feet, folds].iter().any(|strength| *strength != 1.0) {
            return fail(
                "--wrinkles: of a --rig only the last number, the skin's structure, has an effect; give 1,1,1,S".into(),
            );
        }
        Ok(())
    }

    /// Refuses `--manner` where nobody makes an expression.
    fn check_manner(&self, rig: &FaceRig, plans: &[Plan]) -> Result<(), Failure> {
        let none =
            |plan: &Plan| plan.options.expressions.as_ref().is_some_and(|all| all.iter().all(|(_, w)| *w == 0.0));
        if self.names("manner") && (rig.expressions.is_empty() || plans.iter().all(none)) {
            let message =
                "--manner: has no effect without expressions; leave it out, or give --expression or another --preset";
            return Err(Failure::new(Stage::Arguments, message));
        }
        Ok(())
    }
}

/// An option as it is written, without its dashes.
fn option(id: &str) -> String {
    if id == "names" { "case".to_owned() } else { id.replace('_', "-") }
}

/// Does what the command line does with these arguments, without a word, on the threads of the caller. Between two folders it looks whether
/// it is to `stop`.
///
/// # Errors
/// As the command line, at its stages; and where it is stopped.
pub fn write(arguments: impl IntoIterator<Item = OsString>, stop: &AtomicBool) -> Result<(), Failure> {
    run(&Given::of(arguments)?, &|_| {
        if stop.load(Ordering::Relaxed) { Err(Failure::computation("stopped")) } else { Ok(()) }
    })
}

/// The scan that these arguments of the command line describe, those of groups Cases, Scanner and Faults.
///
/// # Errors
/// When one of them makes no sense, or is of files, of which a scan alone has none.
pub fn scan_options(arguments: impl IntoIterator<Item = OsString>) -> Result<ScanOptions, Failure> {
    let out = [OsString::from("--out"), OsString::from("nowhere")];
    let given = Given::of(out.into_iter().chain(arguments))?;
    given.check()?;
    let of_files = [
        "threads",
        "contact_sheet",
        "rig",
        "vertices",
        "identity_modes",
        "names",
        "cases",
        "frames",
        "population",
        "fps",
    ];
    match of_files.iter().find(|id| given.names(id)) {
        None => Ok(given.arguments.scan_options()),
        Some(id) => {
            let message =
                format!("--{}: has no effect on a scan alone, of a face that is there; leave it out", option(id));
            Err(Failure::new(Stage::Arguments, message))
        }
    }
}

fn run(given: &Given, say: Said<'_>) -> Result<(), Failure> {
    let arguments = &given.arguments;
    if !(1e-3..=1e4).contains(&arguments.fps) {
        return Err(Failure::new(Stage::Arguments, format!("--fps: 0.001 to 10,000, not {}", arguments.fps)));
    }
    let Arguments { seed, vertices, identity_modes, .. } = *arguments;
    given.check()?;
    say(format_args!("seed {seed}"))?;
    let start = Instant::now();
    let rig = match &arguments.rig {
        Some(path) => FaceRig::read(path).map_err(|e| Failure::new(Stage::Loading, told(&e)))?,
        None => FaceRig::generate(&FaceOptions { vertices, identity_modes }),
    };
    let generated = start.elapsed().as_secs_f64();
    let plans = plan(&rig, arguments)?;
    // Whatever is wrong with the options shows before anything is written.
    for plan in &plans {
        plan.options.validate(&rig).map_err(unsimulated)?;
    }
    given.check_manner(&rig, &plans)?;
    let count = plans.len();
    let mut scans = plans.iter().map(|plan| simulate(&rig, plan)).peekable();
    if let Some(Err(failure)) = scans.next_if(Result::is_err) {
        return Err(failure);
    }
    check_plan(&files(arguments, &plans))?;
    check_folder_path(&arguments.out)?;
    claim(arguments, &rig, &plans)?;
    let folder = arguments.rig.clone().unwrap_or_else(|| arguments.out.join("rig"));
    if arguments.rig.is_none() {
        // of an earlier run, as the record says
        forget_shapes(&folder, &rig).and_then(|()| write_rig(&folder, &rig)).map_err(Failure::writing)?;
    }
    let (vertices, expressions, modes) = (rig.neutral.len(), rig.expressions.len(), rig.identities.len());
    say(format_args!(
        "{}: {vertices} vertices, {expressions} expressions, {modes} identity modes, {generated:.1} s",
        folder.display()
    ))?;
    if let Some(people) = arguments.population {
        let folder = arguments.out.join("population");
        write_population(&folder, &rig, people, seed).map_err(Failure::writing)?;
        say(format_args!("{}: {people} people", folder.display()))?;
    }
    let mut shown = Vec::new();
    let mut weights = Vec::new();
    for (k, (plan, scan)) in plans.iter().zip(&mut scans).enumerate() {
        let (case, seconds) = scan?;
        write_scan(&rig, plan, &case, &arguments.out, seconds, (&format!("{}/{count}", k + 1), say))?;
        weights.push((plan.time, case.expression_weights.clone()));
        if arguments.contact_sheet && shown.len() < 3 {
            shown.push((plan.name.clone(), case));
        }
    }
    if arguments.frames.is_some() {
        let path = arguments.out.join("sequence/weights.csv");
        write_weights(&path, &rig, &weights).map_err(unwritten)?;
        say(format_args!("{}", path.display()))?;
    }
    if arguments.contact_sheet {
        let path = arguments.out.join("contact_sheet.png");
        save_png(&contact_sheet(&rig, &shown, seed).render(), &path).map_err(Failure::writing)?;
        say(format_args!("{}", path.display()))?;
    }
    Ok(())
}

/// Everything that is written: a file of each folder stands for it.
fn files(arguments: &Arguments, plans: &[Plan]) -> FilePlan {
    let of_folder = |folder: &str| arguments.out.join(folder).join("neutral.npy");
    let mut plan = match &arguments.rig {
        Some(path) => FilePlan::new().reads("--rig", path.clone()),
        None => FilePlan::new().writes("the rig", of_folder("rig")),
    };
    plan = plan.writes_all(plans.iter().map(|plan| (format!("--case {}", plan.name), of_folder(&plan.name))));
    if arguments.contact_sheet {
        plan = plan.writes("--contact-sheet", arguments.out.join("contact_sheet.png"));
    }
    plan
}

/// Records what is going to be made.
fn claim(arguments: &Arguments, rig: &FaceRig, plans: &[Plan]) -> Result<(), Failure> {
    let mut made: BTreeSet<String> = plans.iter().map(|plan| plan.name.clone()).collect();
    let mut series: Vec<&Series> = Vec::new();
    if arguments.rig.is_none() {
        made.insert("rig".to_owned());
    }
    if arguments.cases.is_some_and(|cases| cases > 0) {
        series.push(&record::CASES);
    }
    if arguments.frames.is_some() {
        series.push(&record::SEQUENCE);
        made.insert("sequence/weights.csv".to_owned());
    }
    if let Some(people) = arguments.population {
        series.push(&record::POPULATION);
        made.extend((0..people).map(|k| format!("population/person_{k:04}.obj")));
        made.extend(
            rig.mesh.metadata.material_libraries.iter().filter(|l| *l == LIBRARY).map(|l| format!("population/{l}")),
        );
    }
    if arguments.contact_sheet {
        made.insert("contact_sheet.png".to_owned());
    }
    record::claim(&arguments.out, made, &series)
}

/// One scan to make.
struct Plan {
    /// Its folder, below the output's.
    name: String,
    options: ScanOptions,
    /// What a fit knows; `None`: decided by what the scan shows, [`Subject::same`].
    subject: Option<Subject>,
    seed: u64,
    /// In a sequence, seconds.
    time: f64,
}

fn plan(rig: &FaceRig, arguments: &Arguments) -> Result<Vec<Plan>, Failure> {
    let options = arguments.scan_options();
    let seed = |k: usize| arguments.seed.wrapping_add(k as u64);
    if let Some(frames) = arguments.frames {
        let time = |frame: usize| frame as f64 / arguments.fps;
        options.validate(rig).map_err(unsimulated)?;
        let motion = Motion::new(rig, &options, time(frames), arguments.seed).map_err(unsimulated)?;
        let frame = |k| Plan {
            name: format!("sequence/frame_{k:04}"),
            options: motion.options(time(k)),
            subject: Some(Subject::Same { withheld: Vec::new() }),
            seed: seed(k),
            time: time(k),
        };
        return Ok((0..frames).map(frame).collect());
    }
    let unknown = || Some(Subject::new(rig));
    if let Some(cases) = arguments.cases {
        let case = |k| {
            let (prefix, subject) = if k % 2 == 0 { ("same", None) } else { ("new", unknown()) };
            Plan { name: format!("cases/{prefix}_{k:04}"), options: options.clone(), subject, seed: seed(k), time: 0.0 }
        };
        return Ok((0..cases).map(case).collect());
    }
    let standard = STANDARD_CASES.iter().map(|s| s.name.to_owned());
    let wanted: Vec<String> = if arguments.names.is_empty() { standard.collect() } else { arguments.names.clone() };
    let mut plans: Vec<Plan> = Vec::new();
    for (k, name) in wanted.iter().enumerate() {
        if wanted[..k].contains(name) {
            return Err(Failure::new(Stage::Arguments, format!("--case {name:?} twice")));
        }
        let at = STANDARD_CASES.iter().position(|s| s.name == *name);
        let mut options = options.clone();
        let mut subject = if name.starts_with("new") { unknown() } else { None };
        if name.is_empty() || name.contains(['/', '\\']) || name.starts_with('.') {
            return Err(Failure::new(Stage::Arguments, format!("--case {name:?} is no name for a folder")));
        }
        if let Some(standard) = at.map(|at| STANDARD_CASES[at]) {
            options.expressions = options.expressions.or_else(|| Some(standard.expressions()));
            subject = Some(standard.subject(rig).map_err(unsimulated)?);
        }
        // A standard case is the same whether it is made alone or with the others.
        let number = at.unwrap_or(STANDARD_CASES.len() + plans.len());
        plans.push(Plan { name: format!("cases/{name}"), options, subject, seed: seed(number), time: 0.0 });
    }
    Ok(plans)
}

/// Simulates one case; how many seconds it took.
fn simulate(rig: &FaceRig, plan: &Plan) -> Result<(ScanCase, f64), Failure> {
    let start = Instant::now();
    let case = simulate_scan(rig, &plan.options, plan.seed).map_err(unsimulated)?;
    Ok((case, start.elapsed().as_secs_f64()))
}

/// Writes one case that took so many seconds to simulate.
fn write_scan(
    rig: &FaceRig,
    plan: &Plan,
    case: &ScanCase,
    out: &Path,
    simulated: f64,
    (progress, say): (&str, Said<'_>),
) -> Result<(), Failure> {
    let start = Instant::now();
    let folder = out.join(&plan.name);
    let subject = plan.subject.clone().unwrap_or_else(|| Subject::same(rig, case));
    write_case(&folder, rig, case, &subject, plan.seed).map_err(Failure::writing)?;
    let seen = case.observed.iter().filter(|o| **o).count();
    let (points, triangles) = (case.scan.positions.len(), case.scan.triangles.len());
    say(format_args!(
        "[{progress}] {}: {points} points, {triangles} triangles, {seen} vertices observed; {simulated:.1} + {:.1} s",
        folder.display(),
        start.elapsed().as_secs_f64()
    ))
}

impl Arguments {
    fn scan_options(&self) -> ScanOptions {
        let mut options = self.scan.clone();
        options.expressions = options.expressions.or_else(|| self.preset.as_deref().map(preset_weights));
        options.cameras.extend(&self.cameras_at);
        if options.cameras.is_empty() && options.scanner == Scanner::Net && !self.see_all {
            options.cameras = ScanOptions::default().cameras;
        }
        options
    }
}

#[cfg(test)]
#[path = "../../tests/support/help.rs"]
mod help;

#[cfg(test)]
mod tests {
    use super::{command, help, scan_options};

    #[test]
    fn help_ends_with_examples_that_parse() {
        let faults = help::faults(&command());
        assert!(faults.is_empty(), "{}", faults.join("\n"));
    }

    #[test]
    fn a_scan_alone_refuses_options_of_files() {
        let told = |option: &str| scan_options([option.into()]).map(drop).map_err(|e| e.to_string());
        assert_eq!(told("--noise=0.2"), Ok(()));
        for option in ["population=3", "frames=4", "cases=2", "case=smile", "rig=x", "vertices=2000", "contact-sheet"] {
            let error = told(&format!("--{option}")).unwrap_err();
            let name = option.split('=').next().unwrap();
            assert!(error.starts_with(&format!("--{name}: has no effect")), "{error}");
        }
    }
}
