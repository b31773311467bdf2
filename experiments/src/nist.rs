//! `nist`: the 27 nonlinear regression problems of NIST's Statistical Reference Datasets, from both of their starts.
//!
//! <https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml>. A file holds the data, two starts, and parameters certified to
//! eleven digits; the formula of its model is stated here, once, and differentiated by dual numbers. What counts are the digits
//! of the worst parameter, `min_i -log10(|b_i - c_i| / |c_i|)` (McCullough's LRE); six pass.
//!
//! One run hangs by a thread: from BoxBOD's first start the energy falls towards a plateau at infinite b2 as readily as towards
//! the minimum, and which of them a minimiser finds depends on the length of its first accepted step. It is the only run of
//! Levenberg-Marquardt whose outcome changes with initial dampings between 6e-3 and 2e-2.

use std::borrow::Cow;
use std::f64::consts::PI;
use std::fs;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use nonrigid::console::say;
use nonrigid::nlls::{
    Euclidean, Family, Minimizer, Options, Problem as _, Residual, ResidualProblem, Scalar, StopReason,
};
use serde::Serialize;

use crate::tables::{stop_word, table};
use crate::unread;

/// Digits that a run must reach in every parameter.
pub const DIGITS_TO_PASS: f64 = 6.0;

/// The certified values have no more.
const CERTIFIED_DIGITS: f64 = 11.0;

/// Some copies of `Roszman1.dat` print 1.20196866396E-0 for the certified b1, with the first digit of the number 2.0196866396E-01
/// lost and its last one in front.
const ROSZMAN1_B1: (&str, usize, f64) = ("Roszman1", 1, 1.20196866396);

/// Which files, and how the result is printed.
#[derive(Debug, clap::Args)]
#[command(after_help = "The files are those of <https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml>.\n\n\
    Examples:\n  experiments dev nist\n  experiments dev nist --json")]
pub struct Arguments {
    /// Folder of the .dat files [default: those that are built in]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print JSON instead of the table
    #[arg(long)]
    json: bool,
}

/// One problem as its file states it.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Its name, such as `"Misra1a"`.
    pub name: String,
    /// NIST's grade: `"lower"`, `"average"` or `"higher"`.
    pub difficulty: String,
    /// The far start and the near one.
    pub starts: [Vec<f64>; 2],
    /// Certified parameters.
    pub certified: Vec<f64>,
    /// Certified residual sum of squares.
    pub residual_sum_of_squares: f64,
    /// Responses, and one or two predictors each (the second is zero if there is none).
    pub observations: Vec<(f64, [f64; 2])>,
}

/// One minimisation.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Matching digits of the worst parameter, between 0 and 11.
    pub digits: f64,
    /// Relative error of the residual sum of squares.
    pub energy_error: f64,
    /// Steps, rejected ones included.
    pub iterations: usize,
    /// Why it ended.
    pub stop: StopReason,
}

impl Outcome {
    /// Enough digits match.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.digits >= DIGITS_TO_PASS
    }
}

/// One problem from one start.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The problem.
    pub problem: String,
    /// NIST's grade.
    pub difficulty: String,
    /// 1 or 2.
    pub start: usize,
    /// By Levenberg-Marquardt.
    pub levenberg_marquardt: Outcome,
    /// By dogleg.
    pub dogleg: Outcome,
}

/// The settings of all runs of an algorithm: its defaults, iterated until rounding alone is left.
#[must_use]
pub fn to_the_last_digit(options: Options) -> Options {
    options.with_max_iterations(10_000).with_energy_tolerance(0.0).with_step_tolerance(0.0).with_gradient_tolerance(0.0)
}

/// Runs every problem of `folder`, or else of the files that are built in, from both starts.
///
/// # Errors
/// When a file cannot be read, or there is none.
pub fn nist(folder: Option<&Path>) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for dataset in Dataset::read_all(folder).map_err(unread)? {
        for start in 0..2 {
            rows.push(Row {
                problem: dataset.name.clone(),
                difficulty: dataset.difficulty.clone(),
                start: start + 1,
                levenberg_marquardt: dataset.fit(start, to_the_last_digit(Options::levenberg_marquardt()))?,
                dogleg: dataset.fit(start, to_the_last_digit(Options::dogleg()))?,
            });
        }
    }
    Ok(rows)
}

/// Runs the command.
///
/// # Errors
/// When the files cannot be read.
pub fn run(a: &Arguments) -> Result<()> {
    let rows = nist(a.data.as_deref())?;
    let failures = |of: fn(&Row) -> &Outcome| -> Vec<String> {
        rows.iter().filter(|r| !of(r).passed()).map(|r| format!("{} from start {}", r.problem, r.start)).collect()
    };
    let (lm, dogleg) = (failures(|r| &r.levenberg_marquardt), failures(|r| &r.dogleg));
    let total = rows.len();
    if a.json {
        let json = serde_json::json!({
            "passed": total - lm.len(), "total": total, "failed": lm, "digits_to_pass": DIGITS_TO_PASS,
            "dogleg": { "passed": total - dogleg.len(), "total": total, "failed": dogleg },
            "options": to_the_last_digit(Options::levenberg_marquardt()),
            "rows": rows,
        });
        say(format_args!("{json:#}"))?;
        return Ok(());
    }
    let header = ["problem", "difficulty", "start", "LM digits", "steps", "stop", "dogleg digits", "steps", "stop"];
    let cells = rows.iter().map(|r| {
        let mut cells = vec![r.problem.clone(), r.difficulty.clone(), r.start.to_string()];
        for o in [&r.levenberg_marquardt, &r.dogleg] {
            let mark = if o.passed() { "" } else { " !" };
            cells.extend([format!("{:.1}{mark}", o.digits), o.iterations.to_string(), stop_word(&o.stop).to_owned()]);
        }
        cells
    });
    say(table(&header, cells))?;
    for (name, failed) in [("Levenberg-Marquardt", lm), ("dogleg", dogleg)] {
        let which = if failed.is_empty() { String::new() } else { format!("; failed: {}", failed.join(", ")) };
        say(format_args!("{name}: {} of {total} with {DIGITS_TO_PASS} digits or more{which}", total - failed.len()))?;
    }
    Ok(())
}

/// The expected response of a model with `N` parameters.
trait Model<const N: usize>: Send + Sync + 'static {
    fn response<D: Scalar>(b: &[D; N], x: [f64; 2]) -> D;
}

/// Response minus expected response.
struct Observation<M> {
    y: f64,
    x: [f64; 2],
    model: PhantomData<M>,
}

impl<M: Model<N>, const N: usize> Residual<1, N> for Observation<M> {
    type Blocks = (Euclidean<N>,);

    fn evaluate<D: Scalar>(&self, (b,): &([D; N],)) -> [D; 1] {
        [M::response(b, self.x) - self.y]
    }
}

fn problem_of<M: Model<N>, const N: usize>(dataset: &Dataset, start: &[f64]) -> Result<ResidualProblem> {
    let observation = |&(y, x): &(f64, [f64; 2])| Observation::<M> { y, x, model: PhantomData };
    let residuals: Vec<_> = dataset.observations.iter().map(observation).collect();
    let mut builder = ResidualProblem::builder();
    let b = builder.add_border_block::<Euclidean<N>>(start);
    let blocks = vec![[b]; residuals.len()];
    builder.add_family(Family::new(residuals, &blocks));
    Ok(builder.build()?)
}

macro_rules! models {
    ($($name:ident [$n:literal] |$b:ident, $x:pat_param| $response:expr;)+) => {
        $(
            #[allow(clippy::upper_case_acronyms)] // NIST's names
            struct $name;

            impl Model<$n> for $name {
                fn response<D: Scalar>($b: &[D; $n], $x: [f64; 2]) -> D {
                    $response
                }
            }
        )+

        /// The problem of a dataset, by its name.
        fn problem(dataset: &Dataset, start: &[f64]) -> Result<ResidualProblem> {
            match dataset.name.as_str() {
                $(stringify!($name) => problem_of::<$name, $n>(dataset, start),)+
                name => bail!("no model of the name {name:?} is known"),
            }
        }

        /// Names, numbers of parameters and files of the models.
        const MODELS: &[(&str, usize, &str)] =
            &[$((stringify!($name), $n, include_str!(concat!("../nist/", stringify!($name), ".dat")))),+];
    };
}

models! {
    Bennett5 [3] |b, [x, _]| b[0] * (b[1] + x).powd(-b[2].recip());
    BoxBOD [2] |b, [x, _]| saturation(b, x);
    Chwirut1 [3] |b, [x, _]| (b[0] * -x).exp() / (b[1] + b[2] * x);
    Chwirut2 [3] |b, [x, _]| (b[0] * -x).exp() / (b[1] + b[2] * x);
    DanWood [2] |b, [x, _]| b[0] * (b[1] * x.ln()).exp();
    ENSO [9] |b, [x, _]| {
        let year = 2.0 * PI * x / 12.0;
        let (u, v) = (b[3].recip() * (2.0 * PI * x), b[6].recip() * (2.0 * PI * x));
        b[0] + b[1] * year.cos() + b[2] * year.sin() + b[4] * u.cos() + b[5] * u.sin() + b[7] * v.cos() + b[8] * v.sin()
    };
    Eckerle4 [3] |b, [x, _]| b[0] / b[1] * (((b[2] - x) / b[1]).powi(2) * -0.5).exp();
    Gauss1 [8] |b, [x, _]| decay_and_peaks(b, x);
    Gauss2 [8] |b, [x, _]| decay_and_peaks(b, x);
    Gauss3 [8] |b, [x, _]| decay_and_peaks(b, x);
    Hahn1 [7] |b, [x, _]| cubic_over_cubic(b, x);
    Kirby2 [5] |b, [x, _]| (b[0] + b[1] * x + b[2] * (x * x)) / (b[3] * x + b[4] * (x * x) + 1.0);
    Lanczos1 [6] |b, [x, _]| three_decays(b, x);
    Lanczos2 [6] |b, [x, _]| three_decays(b, x);
    Lanczos3 [6] |b, [x, _]| three_decays(b, x);
    MGH09 [4] |b, [x, _]| b[0] * (b[1] * x + x * x) / (b[2] * x + b[3] + x * x);
    MGH10 [3] |b, [x, _]| b[0] * (b[1] / (b[2] + x)).exp();
    MGH17 [5] |b, [x, _]| b[0] + b[1] * (b[3] * -x).exp() + b[2] * (b[4] * -x).exp();
    Misra1a [2] |b, [x, _]| saturation(b, x);
    Misra1b [2] |b, [x, _]| b[0] * (-(b[1] * (x / 2.0) + 1.0).powi(-2) + 1.0);
    Misra1c [2] |b, [x, _]| b[0] * (-(b[1] * (2.0 * x) + 1.0).sqrt().recip() + 1.0);
    Misra1d [2] |b, [x, _]| b[0] * b[1] * x / (b[1] * x + 1.0);
    Nelson [3] |b, [x1, x2]| b[0] - b[1] * x1 * (b[2] * -x2).exp();
    Rat42 [3] |b, [x, _]| b[0] / ((b[1] - b[2] * x).exp() + 1.0);
    Rat43 [4] |b, [x, _]| b[0] / ((b[1] - b[2] * x).exp() + 1.0).powd(b[3].recip());
    Roszman1 [4] |b, [x, _]| b[0] - b[1] * x - (b[2] / (-b[3] + x)).atan() / PI;
    Thurber [7] |b, [x, _]| cubic_over_cubic(b, x);
}

fn saturation<D: Scalar>(b: &[D; 2], x: f64) -> D {
    b[0] * (-(b[1] * -x).exp() + 1.0)
}

fn decay_and_peaks<D: Scalar>(b: &[D; 8], x: f64) -> D {
    let peak = |height: D, centre: D, width: D| height * (-((centre - x) / width).powi(2)).exp();
    b[0] * (b[1] * -x).exp() + peak(b[2], b[3], b[4]) + peak(b[5], b[6], b[7])
}

fn cubic_over_cubic<D: Scalar>(b: &[D; 7], x: f64) -> D {
    (b[0] + b[1] * x + b[2] * x.powi(2) + b[3] * x.powi(3)) / (b[4] * x + b[5] * x.powi(2) + b[6] * x.powi(3) + 1.0)
}

fn three_decays<D: Scalar>(b: &[D; 6], x: f64) -> D {
    b[0] * (b[1] * -x).exp() + b[2] * (b[3] * -x).exp() + b[4] * (b[5] * -x).exp()
}

impl Dataset {
    /// All problems of `folder`, or else of the files that are built in, by name.
    ///
    /// # Errors
    /// When a file is missing or is not laid out as NIST's are.
    pub fn read_all(folder: Option<&Path>) -> Result<Vec<Self>> {
        let read = |&(name, parameters, built_in): &(&str, usize, &'static str)| {
            let path = folder.unwrap_or(Path::new("")).join(format!("{name}.dat"));
            let text = match folder {
                Some(_) => fs::read_to_string(&path).map(Cow::Owned).map_err(anyhow::Error::from),
                None => Ok(Cow::Borrowed(built_in)),
            };
            let dataset = text.and_then(|text| Self::parse(name, parameters, &text)).and_then(Self::checked);
            dataset.with_context(|| format!("{}, a file of NIST's nonlinear regression data", path.display()))
        };
        MODELS.iter().map(read).collect()
    }

    fn parse(name: &str, parameters: usize, text: &str) -> Result<Self> {
        let level = text.split("Level of Difficulty").next().and_then(|head| head.split_whitespace().last());
        let line_of = |start: &str| text.lines().find_map(|l| l.trim().strip_prefix(start).map(str::trim));
        let (mut starts, mut certified) = ([Vec::new(), Vec::new()], Vec::new());
        for i in 1..=parameters {
            let line = line_of(&format!("b{i} =")).with_context(|| format!("no line for parameter b{i}"))?;
            let [first, second, value, _] = numbers(line)?[..] else {
                bail!("b{i} should have four numbers: {line:?}")
            };
            starts[0].push(first);
            starts[1].push(second);
            certified.push(if (name, i, value) == ROSZMAN1_B1 { 2.019_686_639_6e-1 } else { value });
        }
        let sum = line_of("Residual Sum of Squares:").context("no residual sum of squares")?;
        let count = line_of("Number of Observations:").context("no number of observations")?;
        let mut observations = Vec::new();
        // The second line that starts so heads the numbers.
        for line in
            text.lines().skip_while(|l| !(l.starts_with("Data:") && l.contains('x') && !l.contains('('))).skip(1)
        {
            match (name, &numbers(line)?[..]) {
                (_, []) => {}
                // log[y] = ..
                ("Nelson", &[y, x1, x2]) => observations.push((y.ln(), [x1, x2])),
                (_, &[y, x]) => observations.push((y, [x, 0.0])),
                _ => bail!("{line:?} is not an observation"),
            }
        }
        ensure!(numbers(count)? == [observations.len() as f64], "{} observations, not {count}", observations.len());
        Ok(Self {
            name: name.to_owned(),
            difficulty: level.context("no level of difficulty")?.to_lowercase(),
            starts,
            certified,
            residual_sum_of_squares: sum.parse().context("residual sum of squares")?,
            observations,
        })
    }

    /// The certified parameters must give the certified sum of squares.
    fn checked(self) -> Result<Self> {
        let energy = problem(&self, &self.certified)?.energy(&self.certified);
        let certified = self.residual_sum_of_squares;
        // Eleven digits of a parameter: Lanczos1 has residuals smaller than what the others cost.
        let rounding = 1e-18 * self.observations.iter().map(|(y, _)| y * y).sum::<f64>();
        ensure!(
            (energy - certified).abs() <= 1e-6 * certified + rounding,
            "the certified parameters give a sum of squares of {energy:e}, not {certified:e}: a misprint in the file"
        );
        Ok(self)
    }

    /// Minimises from a start, 0 or 1.
    ///
    /// # Errors
    /// When the options are out of bounds.
    pub fn fit(&self, start: usize, options: Options) -> Result<Outcome> {
        let mut problem = problem(self, &self.starts[start])?;
        let mut b = problem.initial();
        let summary = Minimizer::new(options)?.minimize(&mut problem, &mut b);
        let digits = b.iter().zip(&self.certified).map(|(b, c)| -((b - c) / c).abs().log10());
        // A NaN has no digits.
        let digits = digits.fold(CERTIFIED_DIGITS, |least, d| if d >= least { least } else { d.max(0.0) });
        Ok(Outcome {
            digits,
            energy_error: (summary.final_energy / self.residual_sum_of_squares - 1.0).abs(),
            iterations: summary.iterations,
            stop: summary.stop,
        })
    }
}

fn numbers(line: &str) -> Result<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse().with_context(|| format!("{word:?} is not a number"))).collect()
}
