//! Gauss-Newton with backtracking, the method of Klimov 2020.
//!
//! ```text
//!     H d = -g        x <- x + t d        t = 1, 1/2, 1/4, ..  until  E(x + t d) <= E(x) + c t 2 g'd
//! ```
//!
//! `2 g'd` is the slope of E along d (the equations are those of E/2); it is negative whenever H is positive definite, so a
//! short enough step always lowers the energy, and the sequence of energies is monotone.
//!
//! With bounds of the border, d minimises `g'd + d'Hd / 2` between them. As d = 0 is allowed, `g'd <= -d'Hd`: all of this still
//! holds, and as x and x + d are between the bounds, so is every x + t d.

use super::run::{Proposal, Run};
use super::{Convergence, GaussNewton, IterationRecord, StopReason};
use crate::nlls::Problem;

pub(super) fn minimize<P: Problem + ?Sized>(
    run: &mut Run<'_, P>,
    options: &GaussNewton,
) -> Result<StopReason, StopReason> {
    let mut energy = run.start()?;
    let gradient_count = run.equations.gradient.len() as f64;
    for iteration in 1..=run.options.max_iterations {
        if iteration > 1 {
            energy = run.linearize();
        }
        let gradient_norm = run.gradient_norm();
        if gradient_norm <= run.options.gradient_tolerance {
            return Ok(StopReason::Converged(Convergence::Gradient));
        }
        run.solve(0.0)?;
        let Proposal { slope, predicted, curvature, step_norm, step_is_small } = run.proposal();
        if predicted <= f64::EPSILON * energy {
            // The step solves the equations, so that it promises at least what the best of the coordinate steps does.
            run.rescale(0.0);
            let least = run.attainable() / gradient_count;
            return Ok(run.stuck(energy, least));
        }
        let mut accepted = None;
        let mut scale = 1.0;
        for _ in 0..=options.max_halvings {
            let trial = run.try_step(scale, scale == 1.0);
            // The comparison with `energy` keeps the sequence monotone even when the slope is lost in rounding.
            if trial <= energy + options.sufficient_decrease * scale * slope && trial <= energy {
                accepted = Some(trial);
                break;
            }
            scale *= 0.5;
        }
        let Some(trial) = accepted else {
            let negligible = predicted <= run.options.energy_tolerance * energy;
            let stop = if negligible { StopReason::Converged(Convergence::Energy) } else { StopReason::NoDecrease };
            return Ok(run.polish(stop));
        };
        run.accept(trial);
        let decrease = energy - trial;
        let gain = decrease / (scale * (-slope - scale * curvature));
        let record = IterationRecord {
            decrease,
            gradient_norm,
            step_norm: scale * step_norm,
            step_scale: scale,
            lambda: 0.0,
            radius: f64::INFINITY,
            gain,
            accepted: true,
            ..IterationRecord::default()
        };
        run.record(record)?;
        // A small decrease after halvings is no proof of convergence unless the model expected no more.
        let small = run.options.energy_tolerance * energy;
        if decrease <= small && (scale == 1.0 || predicted <= small) {
            if run.options.energy_tolerance == 0.0 {
                run.linearize(); // for `polish`
            }
            return Ok(run.polish(StopReason::Converged(Convergence::Energy)));
        }
        if step_is_small {
            return Ok(StopReason::Converged(Convergence::Step));
        }
    }
    Ok(StopReason::MaxIterations)
}
