//! The calibration: a logistic regression of "the error exceeds [`BAD`]" on monotone curves of the evidence.
//!
//! Each [`Risk`] gets a curve that is piecewise linear between quantiles of the design set and never falls: more of a bad sign
//! never makes a result more trustworthy. Weights minimise
//!
//! ```text
//! sum_i log(1 + exp(-y_i z_i)) + ridge/2 sum_j w_j^2,   z = intercept + sum_j w_j ramp_j,   w_j >= 0
//! ```
//!
//! by Newton steps along one coordinate at a time. The ridge and the threshold are chosen with whole kinds left out, since what a
//! user has will be of a kind that nobody thought of.

use std::io::Write as _;
use std::path::Path;

use anyhow::{Result, bail};
use nonrigid::cli::Failure;
use nonrigid::mesh::io::write_atomically;
use nonrigid::registration::{Calibration, Evidence, Risk, RiskCurve};

use super::{BAD, SilenceRow};

/// Quantiles between which curves are linear.
const KNOTS: [f64; 4] = [0.3, 0.6, 0.85, 0.97];
/// Ridges tried.
const RIDGES: [f64; 4] = [0.1, 0.3, 1.0, 3.0];
/// Share of bad results that the threshold may leave silent, with their kind left out.
const SILENT: f64 = 0.02;
/// Sweeps over all coordinates.
const SWEEPS: usize = 300;

/// A result and whether it is bad.
struct Example<'a> {
    kind: &'a str,
    evidence: &'a Evidence,
    bad: bool,
}

/// Fits the calibration on rows and writes it.
///
/// # Errors
/// When there are too few results, or the file cannot be written.
pub fn write(path: &Path, rows: &[SilenceRow]) -> Result<()> {
    let examples: Vec<Example<'_>> = rows
        .iter()
        .filter_map(|r| Some(Example { kind: r.kind, evidence: &r.reliability.as_ref()?.evidence, bad: r.rmse? > BAD }))
        .collect();
    let bad = examples.iter().filter(|e| e.bad).count();
    if bad < 20 || examples.len() < bad + 20 {
        bail!("--calibrate: {bad} bad of {} results; give more runs (20 of each at least)", examples.len());
    }
    let calibration = calibrate(&examples);
    let text = toml::to_string(&calibration).map_err(|e| Failure::writing(format!("{}: {e}", path.display())))?;
    let head = format!(
        "# Written by `experiments silence --set design --calibrate FILE` from {} results, {bad} of them bad; not by hand.\n",
        examples.len()
    );
    Ok(write_atomically(path, |out| write!(out, "{head}{text}")).map_err(Failure::writing)?)
}

fn calibrate(examples: &[Example<'_>]) -> Calibration {
    let all: Vec<&Example<'_>> = examples.iter().collect();
    let mut kinds: Vec<&str> = examples.iter().map(|e| e.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    // Probabilities of each example from a fit without its kind.
    let apart = |ridge: f64| -> Vec<(f64, bool)> {
        let of_kind = |kind: &&str| {
            let (out, rest): (Vec<&Example<'_>>, Vec<&Example<'_>>) = all.iter().partition(|e| e.kind == *kind);
            let fitted = fit(&rest, ridge);
            out.into_iter().map(|e| (fitted.probability(e.evidence), e.bad)).collect::<Vec<_>>()
        };
        kinds.iter().flat_map(of_kind).collect()
    };
    let loss = |of: &[(f64, bool)]| -> f64 {
        of.iter().map(|&(p, bad)| -(if bad { p } else { 1.0 - p }).max(1e-9).ln()).sum()
    };
    let trials = RIDGES.map(|ridge| (ridge, apart(ridge)));
    let best = trials.iter().min_by(|a, b| loss(&a.1).total_cmp(&loss(&b.1))).unwrap_or(&trials[0]);
    let mut of_bad: Vec<f64> = best.1.iter().filter(|p| p.1).map(|p| p.0).collect();
    of_bad.sort_unstable_by(f64::total_cmp);
    // Rounded down: what is written is what is meant.
    let threshold = of_bad[(SILENT * of_bad.len() as f64) as usize];
    Calibration { threshold: ((threshold * 1000.0).floor() / 1000.0).clamp(0.001, 0.5), ..fit(&all, best.0) }
}

/// The calibration with the least loss, its threshold not yet chosen.
fn fit(examples: &[&Example<'_>], ridge: f64) -> Calibration {
    let mut risks: Vec<RiskCurve> = Risk::ALL
        .iter()
        .map(|risk| {
            let mut values: Vec<f64> = examples.iter().map(|e| risk.of(e.evidence)).collect();
            values.sort_unstable_by(f64::total_cmp);
            let mut knots: Vec<f64> = KNOTS.iter().map(|q| values[(q * (values.len() - 1) as f64) as usize]).collect();
            knots.dedup();
            let weights = vec![0.0; knots.len().saturating_sub(1)];
            RiskCurve { risk: *risk, knots, weights }
        })
        .filter(|curve| !curve.weights.is_empty())
        .collect();
    // Column by column: the ramps of all curves.
    let columns: Vec<(usize, usize, Vec<f64>)> = risks
        .iter()
        .enumerate()
        .flat_map(|(r, curve)| (0..curve.weights.len()).map(move |j| (r, j, curve)))
        .map(|(r, j, curve)| (r, j, examples.iter().map(|e| curve.ramp(j, curve.risk.of(e.evidence))).collect()))
        .collect();
    let bad: Vec<f64> = examples.iter().map(|e| f64::from(u8::from(e.bad))).collect();
    let mut intercept = 0.0;
    let mut z = vec![0.0; examples.len()];
    let probability = |z: f64| 1.0 / (1.0 + (-z).exp());
    for _ in 0..SWEEPS {
        let slope = |z: &[f64], x: &dyn Fn(usize) -> f64| -> [f64; 2] {
            z.iter().enumerate().fold([0.0; 2], |[g, h], (i, &z)| {
                let p = probability(z);
                [g + (p - bad[i]) * x(i), h + p * (1.0 - p) * x(i) * x(i)]
            })
        };
        let [g, h] = slope(&z, &|_| 1.0);
        let step = -g / (h + 1e-6);
        intercept += step;
        z.iter_mut().for_each(|z| *z += step);
        for (r, j, x) in &columns {
            let w = risks[*r].weights[*j];
            let [g, h] = slope(&z, &|i| x[i]);
            let step = (w - (g + ridge * w) / (h + ridge)).max(0.0) - w;
            if step != 0.0 {
                risks[*r].weights[*j] += step;
                z.iter_mut().zip(x).for_each(|(z, x)| *z += step * x);
            }
        }
    }
    risks.retain(|curve| curve.weights.iter().any(|w| *w > 1e-3));
    let short = |x: f64| (x * 1e5).round() / 1e5;
    for curve in &mut risks {
        curve.weights.iter_mut().for_each(|w| *w = short(*w));
    }
    Calibration { threshold: 0.5, intercept: short(intercept), risks }
}
