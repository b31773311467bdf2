//! The calibration: how large the error is, as far as the evidence tells, and from that how probably it exceeds [`BAD`].
//!
//! Each [`Risk`] gets a curve that is piecewise linear between quantiles of the design set and never falls: more of a bad sign
//! never makes a result more trustworthy. Together they predict the logarithm of the error,
//!
//! ```text
//! min_{b, w >= 0}  sum_i (ln error_i - b - sum_j w_j ramp_j)^2 + ridge sum_j w_j^2
//! ```
//!
//! one coordinate at a time; every result says something about that, not the few bad ones alone. A logistic curve makes a probability
//! of the prediction. It, the ridge and the threshold are fitted to predictions with whole kinds left out, since what a user has
//! will be of a kind that nobody thought of.

use std::path::Path;

use anyhow::{Result, bail};
use nonrigid::console::{Failure, Stage, check_plan};
use nonrigid::io::FilePlan;
use nonrigid::registration::{Calibration, Evidence, Risk, RiskCurve};

use super::{BAD, Set, SilenceRow, Verdict};
use crate::output::write_file;

/// Quantiles between which curves are linear.
const KNOTS: [f64; 6] = [0.2, 0.4, 0.6, 0.8, 0.9, 0.97];
/// Errors beyond these are as good, or as bad, as these, millimetres.
const ERRORS: [f64; 2] = [0.4, 20.0];
/// Ridges tried.
const RIDGES: [f64; 4] = [0.3, 1.0, 3.0, 10.0];
/// Shares of bad results that may be silent, and of good ones that may be doubted: the threshold misses both by the same factor.
const SILENT: f64 = 0.02;
const DOUBTED: f64 = 0.08;
/// Sweeps over all coordinates.
const SWEEPS: usize = 300;

/// A result and its error.
struct Example<'a> {
    kind: &'a str,
    evidence: &'a Evidence,
    error: f64,
}

/// So many bad results and so many others it takes at least.
const LEAST: usize = 20;
/// What a calibration begins with.
const HEAD: &str = "# Written by `experiments silence --set design --calibrate FILE`";

/// Refuses, before anything runs, what could not become a calibration: runs of the test set, or too few of them; and a file that is no
/// place for one. `plan` is of all that is read and written.
///
/// # Errors
/// A [`Failure`] of the arguments or of writing.
pub fn check(path: &Path, plan: &FilePlan, set: Set, runs: usize) -> Result<(), Failure> {
    let refused = |message: String| Err(Failure::new(Stage::Arguments, format!("--calibrate: {message}")));
    if set == Set::Test {
        return refused("the test set is there to judge a calibration; give --set design".to_owned());
    }
    if runs < 2 * LEAST {
        return refused(format!("{runs} runs; it takes {LEAST} bad results and {LEAST} others: give more --runs"));
    }
    check_plan(plan)?;
    let cannot = |why: String| Err(Failure::writing(format!("--calibrate {}: {why}", path.display())));
    // the folder of a bare name is the empty path
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return cannot(format!("there is no folder {}", folder.display()));
    }
    if path.exists() && !std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(HEAD.as_bytes())) {
        return cannot("is there, and this command has not written it; move it away, or give another name".to_owned());
    }
    Ok(())
}

/// Fits the calibration on rows and writes it.
///
/// # Errors
/// When there are too few results, or the file cannot be written.
pub fn write(path: &Path, rows: &[SilenceRow]) -> Result<()> {
    let known = rows.iter().filter(|r| r.verdict() != Verdict::Undetermined);
    let examples: Vec<Example<'_>> = known
        .filter_map(|r| Some(Example { kind: r.kind, evidence: &r.reliability.as_ref()?.evidence, error: r.rmse? }))
        .collect();
    let bad = examples.iter().filter(|e| e.error > BAD).count();
    if bad < LEAST || examples.len() < bad + LEAST {
        bail!("--calibrate: {bad} bad of {} results; give more runs ({LEAST} of each at least)", examples.len());
    }
    let calibration = calibrate(&examples);
    let text = toml::to_string(&calibration).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?;
    let head = format!("{HEAD} from {} results, {bad} of them bad; not by hand.\n", examples.len());
    write_file(path, head + &text)
}

fn calibrate(examples: &[Example<'_>]) -> Calibration {
    let all: Vec<&Example<'_>> = examples.iter().collect();
    let mut kinds: Vec<&str> = examples.iter().map(|e| e.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    // Predictions for each example from a fit without its kind.
    let apart = |ridge: f64| -> Vec<(f64, f64)> {
        let of_kind = |kind: &&str| {
            let (out, rest): (Vec<&Example<'_>>, Vec<&Example<'_>>) = all.iter().partition(|e| e.kind == *kind);
            let fitted = fit(&rest, ridge);
            out.into_iter().map(|e| (fitted.log_odds(e.evidence), e.error)).collect::<Vec<_>>()
        };
        kinds.iter().flat_map(of_kind).collect()
    };
    let misfit = |of: &[(f64, f64)]| -> f64 { of.iter().map(|(p, e)| (p - log_error(*e)).powi(2)).sum() };
    let trials = RIDGES.map(|ridge| (ridge, apart(ridge)));
    let best = trials.iter().min_by(|a, b| misfit(&a.1).total_cmp(&misfit(&b.1))).unwrap_or(&trials[0]);
    let [offset, slope] = logistic(&best.1);
    let probability = |prediction: f64| 1.0 / (1.0 + (-(offset + slope * prediction)).exp());
    let mut fitted = fit(&all, best.0);
    fitted.intercept = short(offset + slope * fitted.intercept);
    for weight in fitted.risks.iter_mut().flat_map(|curve| &mut curve.weights) {
        *weight = short(slope * *weight);
    }
    fitted.risks.retain(|curve| curve.weights.iter().any(|w| *w > 0.0));
    let judged: Vec<(f64, bool)> = best.1.iter().map(|(p, e)| (probability(*p), *e > BAD)).collect();
    let share = |bad: bool, above: bool, threshold: f64| {
        let of = judged.iter().filter(|j| j.1 == bad);
        let (count, some) = of.fold((0, 0), |(n, k), j| (n + 1, k + usize::from((j.0 > threshold) == above)));
        some as f64 / f64::from(count.max(1))
    };
    let missed = |t: f64| (share(true, false, t) / SILENT).max(share(false, true, t) / DOUBTED);
    let thresholds = (1..=50).map(|k| 0.01 * f64::from(k));
    let threshold = thresholds.min_by(|a, b| missed(*a).total_cmp(&missed(*b))).unwrap_or(0.5);
    Calibration { threshold: short(threshold), ..fitted }
}

fn log_error(error: f64) -> f64 {
    error.clamp(ERRORS[0], ERRORS[1]).ln()
}

fn short(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}

/// The curves with the least misfit of the logarithm of the error, which is what the result's "log-odds" are until they are scaled.
fn fit(examples: &[&Example<'_>], ridge: f64) -> Calibration {
    let curve = |risk: &Risk| {
        let mut values: Vec<f64> = examples.iter().map(|e| risk.of(e.evidence)).collect();
        values.sort_unstable_by(f64::total_cmp);
        let mut knots: Vec<f64> = KNOTS.iter().map(|q| values[(q * (values.len() - 1) as f64) as usize]).collect();
        knots.dedup();
        let weights = vec![0.0; knots.len() - 1];
        RiskCurve { risk: *risk, knots, weights }
    };
    let mut risks: Vec<RiskCurve> = Risk::ALL.iter().map(curve).collect();
    // Column by column: the ramps of all curves.
    let mut columns: Vec<(usize, usize, Vec<f64>)> = Vec::new();
    for (r, curve) in risks.iter().enumerate() {
        for j in 0..curve.weights.len() {
            columns.push((r, j, examples.iter().map(|e| curve.ramp(j, curve.risk.of(e.evidence))).collect()));
        }
    }
    let mut left: Vec<f64> = examples.iter().map(|e| log_error(e.error)).collect();
    let mut intercept = 0.0;
    for _ in 0..SWEEPS {
        let mean = left.iter().sum::<f64>() / left.len() as f64;
        intercept += mean;
        left.iter_mut().for_each(|l| *l -= mean);
        for (r, j, x) in &columns {
            let weight = &mut risks[*r].weights[*j];
            let slope: f64 = x.iter().zip(&left).map(|(x, l)| x * l).sum::<f64>() - ridge * *weight;
            let curvature = x.iter().map(|x| x * x).sum::<f64>() + ridge;
            let step = (*weight + slope / curvature).max(0.0) - *weight;
            if step != 0.0 {
                *weight += step;
                left.iter_mut().zip(x).for_each(|(l, x)| *l -= step * x);
            }
        }
    }
    Calibration { threshold: 0.5, intercept, risks }
}

/// Offset and slope of the logistic curve of "bad" over predictions, most likely with a weak prior of slope 3.
fn logistic(of: &[(f64, f64)]) -> [f64; 2] {
    let (mut offset, mut slope) = (-3.0 * BAD.ln(), 3.0);
    for _ in 0..100 {
        let (mut g, mut h) = ([0.0, (slope - 3.0) * 0.1], [1e-9, 0.0, 0.1]);
        for (x, error) in of {
            let p = 1.0 / (1.0 + (-(offset + slope * x)).exp());
            let (d, w) = (p - f64::from(u8::from(*error > BAD)), p * (1.0 - p));
            g = [g[0] + d, g[1] + d * x];
            h = [h[0] + w, h[1] + w * x, h[2] + w * x * x];
        }
        let det = h[0] * h[2] - h[1] * h[1];
        offset -= (h[2] * g[0] - h[1] * g[1]) / det;
        slope -= (h[0] * g[1] - h[1] * g[0]) / det;
    }
    [offset, slope]
}
