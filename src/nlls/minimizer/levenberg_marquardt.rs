//! Levenberg-Marquardt with Marquardt's scaling, a fading memory of it, Nielsen's decrease of the damping and a patient increase.
//!
//! ```text
//!     (H + lambda D) d = -g            in all blocks, border included
//!     D_i = max(H_ii, memory D_i)      at every linearisation
//!     predicted = -2 g'd - d'Hd        decrease of E by the undamped quadratic model (H and g are those of E/2)
//!     gain = (E(x) - E(x + d)) / predicted
//!     accepted:  lambda <- lambda max(1/3, 1 - (2 gain - 1)^3)
//!     rejected:  lambda <- 2 lambda    without linearising again; from the tenth rejection in a row on with growing factors 4, 8, ..
//! ```
//!
//! Memory 0 is Marquardt's D, memory 1 is More's. Without memory, a parameter that has wandered to where it has no effect (the
//! rate of a decay that is over before the first sample) is not damped and never returns; with a full one, a large derivative at
//! the start brakes a parameter for ever. Small increases find the largest step that succeeds, which is worth a few trials: a
//! step that is too short costs a linearisation.
//!
//! D. Marquardt 1963; J. More, "The Levenberg-Marquardt algorithm: implementation and theory", 1978; K. Madsen, H. B. Nielsen,
//! O. Tingleff, "Methods for non-linear least squares problems", 2004, section 3.2; M. Transtrum, J. Sethna, "Improvements to the
//! Levenberg-Marquardt algorithm for nonlinear least-squares minimization", 2012 ("delayed gratification").

use super::run::{Proposal, Run};
use super::{Convergence, IterationRecord, LevenbergMarquardt, StopReason};
use crate::nlls::{LinearError, Problem};

/// What a rejected step multiplies the damping by.
const GROWTH: f64 = 2.0;

/// So many steps are rejected in a row before that factor doubles with each.
const PATIENCE: usize = 10;

pub(super) fn minimize<P: Problem + ?Sized>(
    run: &mut Run<'_, P>,
    options: &LevenbergMarquardt,
) -> Result<StopReason, StopReason> {
    let mut energy = run.start()?;
    run.rescale(options.memory);
    let mut lambda = options.initial_lambda;
    if let (true, Some(last)) = (options.reuse_lambda, *run.lambda) {
        lambda = last.clamp(options.min_lambda, options.max_lambda);
    }
    let mut nu = GROWTH;
    let mut rejections = 0;
    let mut stale = false;
    let mut failure = None;
    for _ in 0..run.options.max_iterations {
        if stale {
            energy = run.linearize();
            run.rescale(options.memory);
            stale = false;
        }
        let gradient_norm = run.gradient_norm();
        if gradient_norm <= run.options.gradient_tolerance {
            return Ok(StopReason::Converged(Convergence::Gradient));
        }
        if lambda > options.max_lambda {
            return Ok(failure.map_or_else(|| run.stuck(energy, run.attainable()), StopReason::LinearSolverFailed));
        }
        let used = lambda;
        let (mut trial, mut gain, mut proposal) = (f64::INFINITY, f64::NAN, Proposal::default());
        match run.solve(used) {
            Ok(()) => {
                failure = None;
                proposal = run.proposal();
                if proposal.predicted <= f64::EPSILON * energy {
                    return Ok(run.stuck(energy, run.attainable()));
                }
                trial = run.try_step(1.0, true);
                gain = (energy - trial) / proposal.predicted;
            }
            Err(error @ LinearError::NonFinite { .. }) => return Err(error.into()),
            // More damping may help.
            Err(error) => failure = Some(error),
        }
        let accepted = gain > options.min_gain && trial <= energy;
        // A step that damping cuts short is no proof of convergence unless coordinate steps promise no more either.
        let small = run.options.energy_tolerance * energy;
        let proof = accepted && (!proposal.is_damped() || run.attainable() <= small);
        if accepted {
            run.accept(trial);
            stale = true;
            lambda = (lambda * (1.0 / 3.0_f64).max(1.0 - (2.0 * gain - 1.0).powi(3))).max(options.min_lambda);
            nu = GROWTH;
            rejections = 0;
        } else {
            lambda *= nu;
            rejections += 1;
            if rejections >= PATIENCE {
                nu *= 2.0;
            }
        }
        *run.lambda = Some(lambda.min(options.max_lambda));
        let decrease = if accepted { energy - trial } else { 0.0 };
        let record = IterationRecord {
            decrease,
            gradient_norm,
            step_norm: proposal.step_norm,
            step_scale: 1.0,
            lambda: used,
            radius: f64::INFINITY,
            gain,
            accepted,
            ..IterationRecord::default()
        };
        run.record(record)?;
        if proof && decrease <= small {
            return Ok(StopReason::Converged(Convergence::Energy));
        }
        if failure.is_none() && proposal.step_is_small {
            if !accepted {
                return Ok(run.stuck(energy, run.attainable()));
            }
            if proof {
                return Ok(StopReason::Converged(Convergence::Step));
            }
        }
    }
    Ok(StopReason::MaxIterations)
}
