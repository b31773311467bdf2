//! Levenberg-Marquardt with Marquardt's scaling and Nielsen's update of the damping.
//!
//! ```text
//!     (H + lambda D) d = -g            D = max(diag H, min_diagonal max_j H_jj), in all blocks, border included
//!     predicted = -2 g'd - d'Hd        decrease of E by the undamped quadratic model (H and g are those of E/2)
//!     gain = (E(x) - E(x + d)) / predicted
//!     accepted:  lambda <- lambda max(1/3, 1 - (2 gain - 1)^3),  nu <- 2
//!     rejected:  lambda <- lambda nu,  nu <- 2 nu                without linearising again
//! ```
//!
//! K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for non-linear least squares problems", 2004, section 3.2; D. Marquardt 1963.

use std::ops::ControlFlow;

use super::run::{Proposal, Run};
use super::{Convergence, LevenbergMarquardt, StopReason};
use crate::nlls::{LinearError, Problem};

pub(super) fn minimize<P: Problem + ?Sized>(run: &mut Run<'_, P>, options: &LevenbergMarquardt) -> StopReason {
    let mut energy = match run.start() {
        Ok(energy) => energy,
        Err(stop) => return stop,
    };
    let mut lambda = options.initial_lambda;
    if let (true, Some(last)) = (options.reuse_lambda, *run.lambda()) {
        lambda = last.clamp(options.min_lambda, options.max_lambda);
    }
    let mut nu = 2.0;
    let mut stale = false;
    let mut failure = None;
    for _ in 0..run.options.max_iterations {
        if stale {
            energy = run.linearize();
            stale = false;
        }
        if run.gradient_norm() <= run.options.gradient_tolerance {
            return StopReason::Converged(Convergence::Gradient);
        }
        if lambda > options.max_lambda {
            return failure.map_or_else(|| stuck(run, energy), StopReason::LinearSolverFailed);
        }
        let used = lambda;
        let (mut trial, mut gain, mut proposal) = (f64::INFINITY, f64::NAN, Proposal::default());
        match run.solve(used, options.min_diagonal) {
            Ok(()) => {
                failure = None;
                proposal = run.proposal();
                if proposal.predicted <= f64::EPSILON * energy {
                    return stuck(run, energy);
                }
                trial = run.try_step(1.0);
                gain = (energy - trial) / proposal.predicted;
            }
            Err(error @ LinearError::NonFinite { .. }) => return StopReason::LinearSolverFailed(error),
            // More damping may help.
            Err(error) => failure = Some(error),
        }
        let accepted = gain > options.min_gain && trial <= energy;
        if accepted {
            run.accept(trial);
            stale = true;
            lambda = (lambda * (1.0 / 3.0_f64).max(1.0 - (2.0 * gain - 1.0).powi(3))).max(options.min_lambda);
            nu = 2.0;
        } else {
            lambda *= nu;
            nu *= 2.0;
        }
        *run.lambda() = Some(lambda.min(options.max_lambda));
        let decrease = if accepted { energy - trial } else { 0.0 };
        let flow = run.record(decrease, proposal.step_norm, 1.0, used, gain, accepted);
        if flow == ControlFlow::Break(()) {
            return StopReason::StoppedByObserver;
        }
        if accepted && decrease <= run.options.energy_tolerance * energy {
            return StopReason::Converged(Convergence::Energy);
        }
        if failure.is_none() && proposal.step_is_small {
            return if accepted { StopReason::Converged(Convergence::Step) } else { stuck(run, energy) };
        }
    }
    StopReason::MaxIterations
}

/// No step is left that could lower the energy by more than rounding. Damped steps are short wherever one stands, so whether
/// this is the minimum is judged by the decrease that undamped coordinate steps promise.
fn stuck<P: Problem + ?Sized>(run: &Run<'_, P>, energy: f64) -> StopReason {
    if run.attainable() <= run.options.energy_tolerance.max(f64::EPSILON) * energy {
        StopReason::Converged(Convergence::Energy)
    } else {
        StopReason::NoDecrease
    }
}
