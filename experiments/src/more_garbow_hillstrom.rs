//! `more-garbow-hillstrom`: the 35 least-squares problems of J. More, B. Garbow, K. Hillstrom, "Testing unconstrained
//! optimization software", ACM Transactions on Mathematical Software 7(1), 1981, from their standard starts and from ten times
//! these.
//!
//! Energies are sums of squares, as in the paper. A run passes at any minimum that the paper prints, local ones and those at
//! infinity included; the table says which. Problems of variable size are taken at the sizes for which minima are printed.
//! One entry differs: the paper's Gulf function is misprinted, `|y_i m i x_2|` stands for `|y_i - x_2|`.

use std::array::from_fn;
use std::f64::consts::TAU;
use std::marker::PhantomData;

use anyhow::Result;
use nonrigid::console::say;
use nonrigid::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar, StopReason};
use serde::Serialize;

use crate::nist::to_the_last_digit;
use crate::tables::{stop_word, table};

/// How the result is printed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  experiments dev more-garbow-hillstrom")]
pub struct Arguments {
    /// Print JSON instead of the table
    #[arg(long)]
    json: bool,
}

/// A sum of squares below this counts as zero.
const ZERO: f64 = 1e-12;

/// Relative error that a published minimum of six digits allows.
const MINIMUM_TOLERANCE: f64 = 1e-5;

/// Which minimum was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Found {
    /// The lowest one that the paper prints.
    Lowest,
    /// One below all that the paper prints.
    Lower,
    /// Another one that the paper prints.
    PublishedLocal,
    /// One above those, or none at all.
    None,
}

/// One minimisation.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Sum of squares at the end.
    pub energy: f64,
    /// Which minimum that is.
    pub found: Found,
    /// Steps, rejected ones included.
    pub iterations: usize,
    /// Why it ended.
    pub stop: StopReason,
}

/// One problem from one start.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The paper's number of the problem.
    pub number: usize,
    /// The paper's name.
    pub problem: String,
    /// Number of parameters.
    pub parameters: usize,
    /// Number of residuals.
    pub residuals: usize,
    /// The start is this times the standard start (times the vector of ones, where the standard start is zero).
    pub factor: f64,
    /// By Levenberg-Marquardt.
    pub levenberg_marquardt: Outcome,
    /// By dogleg.
    pub dogleg: Outcome,
}

impl Row {
    /// Such as `"20 Watson (9) x 10"`.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{} {} ({}) x {}", self.number, self.problem, self.parameters, self.factor)
    }
}

/// One of the outcomes of a row.
pub type Pick = fn(&Row) -> &Outcome;

/// Runs every problem from both starts.
///
/// # Errors
/// None that the settings here can cause.
pub fn more_garbow_hillstrom() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for problem in problems() {
        for factor in [1.0, 10.0] {
            rows.push(Row {
                number: problem.number,
                problem: problem.name.to_owned(),
                parameters: problem.start.len(),
                residuals: problem.residuals,
                factor,
                levenberg_marquardt: problem.minimize(factor, Options::levenberg_marquardt())?,
                dogleg: problem.minimize(factor, Options::dogleg())?,
            });
        }
    }
    Ok(rows)
}

/// The names of the rows whose run ended above the published minima.
#[must_use]
pub fn failures(rows: &[Row], of: Pick) -> Vec<String> {
    rows.iter().filter(|r| of(r).found == Found::None).map(Row::name).collect()
}

fn count(rows: &[Row], of: Pick, found: Found) -> usize {
    rows.iter().filter(|r| of(r).found == found).count()
}

/// Runs the command.
///
/// # Errors
/// As [`more_garbow_hillstrom`].
pub fn run(a: &Arguments) -> Result<()> {
    let rows = more_garbow_hillstrom()?;
    let by: [(&str, Pick); 2] = [("levenberg_marquardt", |r| &r.levenberg_marquardt), ("dogleg", |r| &r.dogleg)];
    let total = rows.len();
    if a.json {
        let counts = by.map(|(name, of)| {
            let failed = failures(&rows, of);
            let [local, lower] = [Found::PublishedLocal, Found::Lower].map(|found| count(&rows, of, found));
            let passed = total - failed.len();
            let json = serde_json::json!({
                "passed": passed, "local": local, "lower": lower, "total": total, "failed": failed,
            });
            (name, json)
        });
        let counts: serde_json::Map<_, _> = counts.into_iter().map(|(name, c)| (name.to_owned(), c)).collect();
        say(format_args!("{:#}", serde_json::json!({ "counts": counts, "rows": rows })))?;
        return Ok(());
    }
    let header = [
        "problem",
        "n",
        "m",
        "start x",
        "LM energy",
        "found",
        "steps",
        "stop",
        "dogleg energy",
        "found",
        "steps",
        "stop",
    ];
    let cells = rows.iter().map(|r| {
        let mut cells = vec![format!("{} {}", r.number, r.problem), r.parameters.to_string()];
        cells.extend([r.residuals.to_string(), r.factor.to_string()]);
        for (_, of) in by {
            let o = of(r);
            let found = match o.found {
                Found::Lowest => "lowest",
                Found::Lower => "lower",
                Found::PublishedLocal => "local",
                Found::None => "!",
            };
            let steps = o.iterations.to_string();
            cells.extend([format!("{:.6e}", o.energy), found.to_owned(), steps, stop_word(&o.stop).to_owned()]);
        }
        cells
    });
    say(table(&header, cells))?;
    for (name, of) in by {
        let failed = failures(&rows, of);
        let which = if failed.is_empty() { String::new() } else { format!("; failed: {}", failed.join(", ")) };
        let [local, lower] = [Found::PublishedLocal, Found::Lower].map(|found| count(&rows, of, found));
        say(format_args!(
            "{}: {} of {total} end at a published minimum or below ({local} at a local one, {lower} below){which}",
            name.replace('_', "-"),
            total - failed.len()
        ))?;
    }
    Ok(())
}

/// One problem of the paper.
struct TestProblem {
    number: usize,
    name: &'static str,
    residuals: usize,
    start: Vec<f64>,
    /// Printed minima, the lowest first.
    minima: &'static [f64],
    build: fn(&[f64]) -> Result<ResidualProblem>,
}

impl TestProblem {
    fn minimize(&self, factor: f64, options: Options) -> Result<Outcome> {
        let zero = self.start.iter().all(|x| *x == 0.0);
        let start: Vec<f64> =
            self.start.iter().map(|x| if zero && factor != 1.0 { factor } else { factor * x }).collect();
        let mut problem = (self.build)(&start)?;
        let mut x = problem.initial();
        let summary = Minimizer::new(to_the_last_digit(options))?.minimize(&mut problem, &mut x);
        let energy = summary.final_energy;
        let is = |minimum: f64| match minimum {
            0.0 => energy <= ZERO,
            _ => (energy - minimum).abs() <= MINIMUM_TOLERANCE * minimum,
        };
        let found = match self.minima.iter().position(|&minimum| is(minimum)) {
            Some(0) => Found::Lowest,
            Some(_) => Found::PublishedLocal,
            None if self.minima.iter().all(|&minimum| energy < minimum) => Found::Lower,
            None => Found::None,
        };
        Ok(Outcome { energy, found, iterations: summary.iterations, stop: summary.stop })
    }
}

/// `M` residuals of `N` parameters.
trait Function<const M: usize, const N: usize>: Send + Sync + 'static {
    fn residuals<D: Scalar>(x: &[D; N]) -> [D; M];
}

/// All residuals of a function at once.
struct All<F>(PhantomData<F>);

impl<F: Function<M, N>, const M: usize, const N: usize> Residual<M, N> for All<F> {
    type Blocks = (Euclidean<N>,);

    fn evaluate<D: Scalar>(&self, (x,): &([D; N],)) -> [D; M] {
        F::residuals(x)
    }
}

fn build<F: Function<M, N>, const M: usize, const N: usize>(start: &[f64]) -> Result<ResidualProblem> {
    let mut builder = ResidualProblem::builder();
    let x = builder.add_border_block::<Euclidean<N>>(start);
    builder.add_family(Family::new(vec![All::<F>(PhantomData)], &[[x]]));
    Ok(builder.build()?)
}

/// `Name [residuals, parameters] for <size, if it varies> |x| formula`.
macro_rules! functions {
    ($($name:ident [$m:expr, $n:expr] $(for <$size:ident>)? |$x:ident| $residuals:expr;)+) => {
        $(
            struct $name;

            functions!(@impl $name [$m, $n] $($size)? |$x| $residuals);
        )+
    };
    (@impl $name:ident [$m:expr, $n:expr] |$x:ident| $residuals:expr) => {
        impl Function<$m, $n> for $name {
            fn residuals<D: Scalar>($x: &[D; $n]) -> [D; $m] {
                $residuals
            }
        }
    };
    (@impl $name:ident [$m:expr, $n:expr] $size:ident |$x:ident| $residuals:expr) => {
        impl<const $size: usize> Function<$m, $n> for $name {
            fn residuals<D: Scalar>($x: &[D; $n]) -> [D; $m] {
                $residuals
            }
        }
    };
}

functions! {
    Rosenbrock [2, 2] |x| [(x[1] - x[0] * x[0]) * 10.0, -x[0] + 1.0];
    FreudensteinRoth [2, 2] |x| [
        x[0] - 13.0 + ((-x[1] + 5.0) * x[1] - 2.0) * x[1],
        x[0] - 29.0 + ((x[1] + 1.0) * x[1] - 14.0) * x[1],
    ];
    PowellBadlyScaled [2, 2] |x| [x[0] * x[1] * 1e4 - 1.0, (-x[0]).exp() + (-x[1]).exp() - 1.0001];
    BrownBadlyScaled [3, 2] |x| [x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2.0];
    Beale [3, 2] |x| from_fn(|i| x[0] * (-x[1].powi(i as i32 + 1) + 1.0) * -1.0 + [1.5, 2.25, 2.625][i]);
    JennrichSampson [10, 2] |x| from_fn(|i| {
        let i = (i + 1) as f64;
        -((x[0] * i).exp() + (x[1] * i).exp()) + 2.0 + 2.0 * i
    });
    HelicalValley [3, 3] |x| {
        let turn = (x[1] / x[0]).atan() / TAU + if x[0].re() < 0.0 { 0.5 } else { 0.0 };
        [(x[2] - turn * 10.0) * 10.0, ((x[0] * x[0] + x[1] * x[1]).sqrt() - 1.0) * 10.0, x[2]]
    };
    Bard [15, 3] |x| from_fn(|i| {
        let (u, v) = ((i + 1) as f64, (15 - i) as f64);
        -(x[0] + (x[1] * v + x[2] * u.min(v)).recip() * u) + BARD[i]
    });
    Gaussian [15, 3] |x| from_fn(|i| {
        let t = (7.0 - i as f64) / 2.0;
        x[0] * (-x[1] * (x[2] - t).powi(2) / 2.0).exp() - GAUSSIAN[i.min(14 - i)]
    });
    Meyer [16, 3] |x| from_fn(|i| x[0] * (x[1] / (x[2] + 50.0 + 5.0 * i as f64)).exp() - MEYER[i]);
    Gulf [10, 3] |x| from_fn(|i| {
        let t = (i + 1) as f64 / 100.0;
        let y = 25.0 + (-50.0 * t.ln()).powf(2.0 / 3.0);
        // |y - x2|^x3
        let power = ((x[1] - y).powi(2).ln() * x[2] / 2.0).exp();
        (-power / x[0]).exp() - t
    });
    Box3 [10, 3] |x| from_fn(|i| {
        let t = 0.1 * (i + 1) as f64;
        (x[0] * -t).exp() - (x[1] * -t).exp() - x[2] * ((-t).exp() - (-10.0 * t).exp())
    });
    PowellSingular [4, 4] |x| powell_singular(x);
    Wood [6, 4] |x| [
        (x[1] - x[0] * x[0]) * 10.0,
        -x[0] + 1.0,
        (x[3] - x[2] * x[2]) * 90_f64.sqrt(),
        -x[2] + 1.0,
        (x[1] + x[3] - 2.0) * 10_f64.sqrt(),
        (x[1] - x[3]) / 10_f64.sqrt(),
    ];
    KowalikOsborne [11, 4] |x| from_fn(|i| {
        let (y, u) = KOWALIK_OSBORNE[i];
        -x[0] * (x[1] * u + u * u) / (x[2] * u + x[3] + u * u) + y
    });
    BrownDennis [20, 4] |x| from_fn(|i| {
        let t = (i + 1) as f64 / 5.0;
        (x[0] + x[1] * t - t.exp()).powi(2) + (x[2] + x[3] * t.sin() - t.cos()).powi(2)
    });
    Osborne1 [33, 5] |x| from_fn(|i| {
        let t = 10.0 * i as f64;
        -(x[0] + x[1] * (x[3] * -t).exp() + x[2] * (x[4] * -t).exp()) + OSBORNE_1[i]
    });
    BiggsExp6 [13, 6] |x| from_fn(|i| {
        let t = 0.1 * (i + 1) as f64;
        let y = (-t).exp() - 5.0 * (-10.0 * t).exp() + 3.0 * (-4.0 * t).exp();
        x[2] * (x[0] * -t).exp() - x[3] * (x[1] * -t).exp() + x[5] * (x[4] * -t).exp() - y
    });
    Osborne2 [65, 11] |x| from_fn(|i| {
        let t = i as f64 / 10.0;
        let peak = |k: usize| x[k] * (-(x[k + 7] - t).powi(2) * x[k + 4]).exp();
        -(x[0] * (x[4] * -t).exp() + peak(1) + peak(2) + peak(3)) + OSBORNE_2[i]
    });
    Watson [31, N] for <N> |x| from_fn(|i| match i {
        29 => x[0],
        30 => x[1] - x[0] * x[0] - 1.0,
        _ => {
            let t = (i + 1) as f64 / 29.0;
            let slope = sum((1..N).map(|j| x[j] * (j as f64 * t.powi(j as i32 - 1))));
            let value = sum((0..N).map(|j| x[j] * t.powi(j as i32)));
            slope - value * value - 1.0
        }
    });
    ExtendedRosenbrock [N, N] for <N> |x| from_fn(|i| match i % 2 {
        0 => (x[i + 1] - x[i] * x[i]) * 10.0,
        _ => -x[i - 1] + 1.0,
    });
    ExtendedPowell [N, N] for <N> |x| from_fn(|i| powell_singular(&from_fn(|k| x[i / 4 * 4 + k]))[i % 4]);
    Penalty1Of4 [5, 4] |x| penalty_1(x);
    Penalty1Of10 [11, 10] |x| penalty_1(x);
    Penalty2Of4 [8, 4] |x| penalty_2(x);
    Penalty2Of10 [20, 10] |x| penalty_2(x);
    VariablyDimensioned [12, 10] |x| {
        let weighted = sum((0..10).map(|j| (x[j] - 1.0) * (j + 1) as f64));
        from_fn(|i| match i {
            10 => weighted,
            11 => weighted * weighted,
            _ => x[i] - 1.0,
        })
    };
    Trigonometric [N, N] for <N> |x| {
        let cosines = sum((0..N).map(|j| x[j].cos()));
        from_fn(|i| -cosines + N as f64 + (-x[i].cos() + 1.0) * (i + 1) as f64 - x[i].sin())
    };
    BrownAlmostLinear [N, N] for <N> |x| {
        let total = sum(x.iter().copied());
        from_fn(|i| if i + 1 < N { x[i] + total - (N + 1) as f64 } else { x.iter().fold(D::from(1.0), |p, x| p * *x) - 1.0 })
    };
    DiscreteBoundaryValue [N, N] for <N> |x| {
        let h = 1.0 / (N + 1) as f64;
        let at = |i: usize| if (1..=N).contains(&i) { x[i - 1] } else { D::from(0.0) };
        from_fn(|i| {
            let t = (i + 1) as f64 * h;
            x[i] * 2.0 - at(i) - at(i + 2) + (x[i] + t + 1.0).powi(3) * (h * h / 2.0)
        })
    };
    DiscreteIntegral [N, N] for <N> |x| {
        let h = 1.0 / (N + 1) as f64;
        let t = |j: usize| (j + 1) as f64 * h;
        let cube = |j: usize| (x[j] + t(j) + 1.0).powi(3);
        from_fn(|i| {
            let below = sum((0..=i).map(|j| cube(j) * t(j)));
            let above = sum((i + 1..N).map(|j| cube(j) * (1.0 - t(j))));
            x[i] + (below * (1.0 - t(i)) + above * t(i)) * (h / 2.0)
        })
    };
    BroydenTridiagonal [N, N] for <N> |x| {
        let at = |i: usize| if (1..=N).contains(&i) { x[i - 1] } else { D::from(0.0) };
        from_fn(|i| (x[i] * -2.0 + 3.0) * x[i] - at(i) - at(i + 2) * 2.0 + 1.0)
    };
    BroydenBanded [N, N] for <N> |x| from_fn(|i| {
        let band = (i.saturating_sub(5)..(i + 2).min(N)).filter(|j| *j != i);
        x[i] * (x[i] * x[i] * 5.0 + 2.0) + 1.0 - sum(band.map(|j| x[j] * (x[j] + 1.0)))
    });
    LinearFullRank [10, 5] |x| {
        let mean = sum(x.iter().copied()) * (2.0 / 10.0);
        from_fn(|i| if i < 5 { x[i] - mean - 1.0 } else { -mean - 1.0 })
    };
    LinearRank1 [10, 5] |x| from_fn(|i| sum((0..5).map(|j| x[j] * (j + 1) as f64)) * (i + 1) as f64 - 1.0);
    LinearRank1Zero [10, 5] |x| from_fn(|i| match i {
        0 | 9 => D::from(-1.0),
        _ => sum((1..4).map(|j| x[j] * (j + 1) as f64)) * i as f64 - 1.0,
    });
    Chebyquad [N, N] for <N> |x| from_fn(|i| {
        let degree = i + 1;
        let integral = if degree % 2 == 0 { -1.0 / ((degree * degree) as f64 - 1.0) } else { 0.0 };
        sum(x.iter().map(|x| chebyshev(degree, *x * 2.0 - 1.0))) / N as f64 - integral
    });
}

/// The paper's problems, sizes, starts and minima.
fn problems() -> Vec<TestProblem> {
    let mut all = Vec::new();
    macro_rules! add {
        ($number:literal $name:literal, $function:ident [$m:literal, $n:literal], $start:expr, $minima:expr) => {
            all.push(TestProblem {
                number: $number,
                name: $name,
                residuals: $m,
                start: start_of::<$n>($start),
                minima: &$minima,
                build: build::<$function, $m, $n>,
            })
        };
    }
    let ramp = |n: usize| move |j: usize| (j + 1) as f64 / (n + 1) as f64;
    add!(1 "Rosenbrock", Rosenbrock [2, 2], [-1.2, 1.0], [0.0]);
    add!(2 "Freudenstein and Roth", FreudensteinRoth [2, 2], [0.5, -2.0], [0.0, 48.984_25]);
    add!(3 "Powell badly scaled", PowellBadlyScaled [2, 2], [0.0, 1.0], [0.0]);
    add!(4 "Brown badly scaled", BrownBadlyScaled [3, 2], [1.0, 1.0], [0.0]);
    add!(5 "Beale", Beale [3, 2], [1.0, 1.0], [0.0]);
    add!(6 "Jennrich and Sampson", JennrichSampson [10, 2], [0.3, 0.4], [124.362]);
    add!(7 "Helical valley", HelicalValley [3, 3], [-1.0, 0.0, 0.0], [0.0]);
    add!(8 "Bard", Bard [15, 3], [1.0; 3], [8.214_87e-3, 17.4286]);
    add!(9 "Gaussian", Gaussian [15, 3], [0.4, 1.0, 0.0], [1.127_93e-8]);
    add!(10 "Meyer", Meyer [16, 3], [0.02, 4000.0, 250.0], [87.9458]);
    add!(11 "Gulf research and development", Gulf [10, 3], [5.0, 2.5, 0.15], [0.0]);
    add!(12 "Box three-dimensional", Box3 [10, 3], [0.0, 10.0, 20.0], [0.0]);
    add!(13 "Powell singular", PowellSingular [4, 4], [3.0, -1.0, 0.0, 1.0], [0.0]);
    add!(14 "Wood", Wood [6, 4], [-3.0, -1.0, -3.0, -1.0], [0.0]);
    add!(15 "Kowalik and Osborne", KowalikOsborne [11, 4], [0.25, 0.39, 0.415, 0.39], [3.075_05e-4, 1.027_34e-3]);
    add!(16 "Brown and Dennis", BrownDennis [20, 4], [25.0, 5.0, -5.0, -1.0], [85_822.2]);
    add!(17 "Osborne 1", Osborne1 [33, 5], [0.5, 1.5, -1.0, 0.01, 0.02], [5.464_89e-5]);
    add!(18 "Biggs EXP6", BiggsExp6 [13, 6], [1.0, 2.0, 1.0, 1.0, 1.0, 1.0], [0.0, 5.655_65e-3]);
    let start = [1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5];
    add!(19 "Osborne 2", Osborne2 [65, 11], start, [4.013_77e-2]);
    add!(20 "Watson", Watson [31, 6], [0.0; 6], [2.287_67e-3]);
    add!(20 "Watson", Watson [31, 9], [0.0; 9], [1.399_76e-6]);
    add!(20 "Watson", Watson [31, 12], [0.0; 12], [4.722_38e-10]);
    let start = from_fn(|i| if i % 2 == 0 { -1.2 } else { 1.0 });
    add!(21 "Extended Rosenbrock", ExtendedRosenbrock [10, 10], start, [0.0]);
    add!(22 "Extended Powell singular", ExtendedPowell [12, 12], from_fn(|i| [3.0, -1.0, 0.0, 1.0][i % 4]), [0.0]);
    add!(23 "Penalty I", Penalty1Of4 [5, 4], from_fn(|i| (i + 1) as f64), [2.249_97e-5]);
    add!(23 "Penalty I", Penalty1Of10 [11, 10], from_fn(|i| (i + 1) as f64), [7.087_65e-5]);
    add!(24 "Penalty II", Penalty2Of4 [8, 4], [0.5; 4], [9.376_29e-6]);
    add!(24 "Penalty II", Penalty2Of10 [20, 10], [0.5; 10], [2.936_60e-4]);
    add!(25 "Variably dimensioned", VariablyDimensioned [12, 10], from_fn(|i| 1.0 - (i + 1) as f64 / 10.0), [0.0]);
    add!(26 "Trigonometric", Trigonometric [10, 10], [0.1; 10], [0.0, 2.795_06e-5]);
    add!(27 "Brown almost-linear", BrownAlmostLinear [10, 10], [0.5; 10], [0.0, 1.0]);
    let start = from_fn(|i| ramp(10)(i) * (ramp(10)(i) - 1.0));
    add!(28 "Discrete boundary value", DiscreteBoundaryValue [10, 10], start, [0.0]);
    add!(29 "Discrete integral equation", DiscreteIntegral [10, 10], start, [0.0]);
    add!(30 "Broyden tridiagonal", BroydenTridiagonal [10, 10], [-1.0; 10], [0.0]);
    add!(31 "Broyden banded", BroydenBanded [10, 10], [-1.0; 10], [0.0]);
    add!(32 "Linear, full rank", LinearFullRank [10, 5], [1.0; 5], [5.0]);
    add!(33 "Linear, rank 1", LinearRank1 [10, 5], [1.0; 5], [45.0 / 21.0]);
    add!(34 "Linear, rank 1, zero columns", LinearRank1Zero [10, 5], [1.0; 5], [62.0 / 17.0]);
    add!(35 "Chebyquad", Chebyquad [7, 7], from_fn(ramp(7)), [0.0]);
    add!(35 "Chebyquad", Chebyquad [8, 8], from_fn(ramp(8)), [3.516_87e-3]);
    add!(35 "Chebyquad", Chebyquad [9, 9], from_fn(ramp(9)), [0.0]);
    add!(35 "Chebyquad", Chebyquad [10, 10], from_fn(ramp(10)), [6.503_95e-3]);
    all
}

fn start_of<const N: usize>(start: [f64; N]) -> Vec<f64> {
    start.to_vec()
}

fn sum<D: Scalar>(terms: impl Iterator<Item = D>) -> D {
    terms.fold(D::from(0.0), |a, b| a + b)
}

fn powell_singular<D: Scalar>(x: &[D; 4]) -> [D; 4] {
    let (five, ten) = (5_f64.sqrt(), 10_f64.sqrt());
    [x[0] + x[1] * 10.0, (x[2] - x[3]) * five, (x[1] - x[2] * 2.0).powi(2), (x[0] - x[3]).powi(2) * ten]
}

fn penalty_1<D: Scalar, const M: usize, const N: usize>(x: &[D; N]) -> [D; M] {
    from_fn(|i| if i < N { (x[i] - 1.0) * 1e-5_f64.sqrt() } else { sum(x.iter().map(|x| *x * *x)) - 0.25 })
}

fn penalty_2<D: Scalar, const M: usize, const N: usize>(x: &[D; N]) -> [D; M] {
    let (root, tenth) = (1e-5_f64.sqrt(), |x: D| (x / 10.0).exp());
    from_fn(|i| {
        if i == 0 {
            x[0] - 0.2
        } else if i < N {
            let y = ((i + 1) as f64 / 10.0).exp() + (i as f64 / 10.0).exp();
            (tenth(x[i]) + tenth(x[i - 1]) - y) * root
        } else if i < 2 * N - 1 {
            (tenth(x[i - N + 1]) - (-0.1_f64).exp()) * root
        } else {
            sum((0..N).map(|j| x[j] * x[j] * (N - j) as f64)) - 1.0
        }
    })
}

/// The Chebyshev polynomial of this degree, by its recurrence.
fn chebyshev<D: Scalar>(degree: usize, x: D) -> D {
    let (mut last, mut value) = (D::from(1.0), x);
    for _ in 1..degree {
        (last, value) = (value, x * value * 2.0 - last);
    }
    value
}

const BARD: [f64; 15] = [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39];

/// One half; the other mirrors it.
const GAUSSIAN: [f64; 8] = [0.0009, 0.0044, 0.0175, 0.0540, 0.1295, 0.2420, 0.3521, 0.3989];

const MEYER: [f64; 16] = [
    34780.0, 28610.0, 23650.0, 19630.0, 16370.0, 13720.0, 11540.0, 9744.0, 8261.0, 7030.0, 6005.0, 5147.0, 4427.0,
    3820.0, 3307.0, 2872.0,
];

/// `(y_i, u_i)`.
const KOWALIK_OSBORNE: [(f64, f64); 11] = [
    (0.1957, 4.0),
    (0.1947, 2.0),
    (0.1735, 1.0),
    (0.1600, 0.5),
    (0.0844, 0.25),
    (0.0627, 0.167),
    (0.0456, 0.125),
    (0.0342, 0.1),
    (0.0323, 0.0833),
    (0.0235, 0.0714),
    (0.0246, 0.0625),
];

const OSBORNE_1: [f64; 33] = [
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628, 0.603,
    0.580, 0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411,
    0.406,
];

const OSBORNE_2: [f64; 65] = [
    1.366, 1.191, 1.112, 1.013, 0.991, 0.885, 0.831, 0.847, 0.786, 0.725, 0.746, 0.679, 0.608, 0.655, 0.616, 0.606,
    0.602, 0.626, 0.651, 0.724, 0.649, 0.649, 0.694, 0.644, 0.624, 0.661, 0.612, 0.558, 0.533, 0.495, 0.500, 0.423,
    0.395, 0.375, 0.372, 0.391, 0.396, 0.405, 0.428, 0.429, 0.523, 0.562, 0.607, 0.653, 0.672, 0.708, 0.633, 0.668,
    0.645, 0.632, 0.591, 0.559, 0.597, 0.625, 0.739, 0.710, 0.729, 0.720, 0.636, 0.581, 0.428, 0.292, 0.162, 0.098,
    0.054,
];
