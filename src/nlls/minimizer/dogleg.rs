//! Powell's dogleg: steps within a trust region, on the broken line from x over the Cauchy point to the Gauss-Newton point.
//!
//! ```text
//!     c = -alpha D^-1 g,  alpha = g' D^-1 g / (D^-1 g)' H (D^-1 g)      minimiser along the scaled steepest descent
//!     n = -(H + mu D)^-1 g                                              Gauss-Newton point; mu = 0 unless H is singular
//!     |d|_D = sqrt(d' D d),   D_i = max(H_ii, memory D_i)               Jacobi scaling: the units of x do not matter
//!
//!     d = n                                    if |n|_D <= radius
//!     d = c radius / |c|_D                     if |c|_D >= radius
//!     d = c + tau (n - c),  |d|_D = radius     between
//!
//!     predicted = -2 g'd - d'Hd                decrease of E by the undamped quadratic model (H and g are those of E/2)
//!     gain = (E(x) - E(x + d)) / predicted
//!     gain < 1/4 or rejected:  radius <- min(radius, |d|_D) / 2         rejected: without solving again
//!     gain > 3/4:              radius <- max(radius, 3 |d|_D)
//! ```
//!
//! One factorisation serves all radii that are tried from a point, where Levenberg-Marquardt needs one for each damping. When
//! H is singular, mu grows by tens until H + mu D can be factorised, and falls again by fives, not below its floor.
//!
//! With bounds of the border, n minimises the model between them and c is the minimiser along the projected scaled gradient,
//! `P(x + c) - x`. Both ends of the line are between the bounds, and so is the line.
//!
//! M. J. D. Powell, "A hybrid method for nonlinear equations", 1970; J. Nocedal, S. Wright, "Numerical Optimization", section 4.1;
//! the rules for radius and mu are those of Ceres Solver.

use super::run::{DoglegPath, Run, positive};
use super::{Convergence, Dogleg, IterationRecord, StopReason};
use crate::nlls::linear::dot;
use crate::nlls::{LinearError, Problem};

pub(super) fn minimize<P: Problem + ?Sized>(run: &mut Run<'_, P>, options: &Dogleg) -> Result<StopReason, StopReason> {
    let mut energy = run.start()?;
    run.rescale(options.memory);
    let mut radius = match *run.radius {
        Some(last) if options.reuse_radius => last,
        _ => options.initial_radius * energy.sqrt(),
    };
    let mut mu = 0.0;
    let (mut stale, mut solved) = (false, false);
    for _ in 0..run.options.max_iterations {
        if stale {
            energy = run.linearize();
            run.rescale(options.memory);
            (stale, solved) = (false, false);
        }
        let gradient_norm = run.gradient_norm();
        if gradient_norm <= run.options.gradient_tolerance {
            return Ok(StopReason::Converged(Convergence::Gradient));
        }
        if !solved {
            mu = corners(run, options, mu)?;
            solved = true;
        }
        let Blend { length, whole } = blend(run, radius);
        let proposal = run.proposal();
        if proposal.predicted <= f64::EPSILON * energy || proposal.predicted.is_nan() {
            return Ok(run.stuck(energy, run.attainable()));
        }
        let trial = run.try_step(1.0, whole);
        let gain = (energy - trial) / proposal.predicted;
        let accepted = gain > options.min_gain && trial <= energy;
        let used = radius;
        if !accepted || gain < 0.25 {
            radius = 0.5 * radius.min(length);
        } else if gain > 0.75 {
            radius = radius.max(3.0 * length);
        }
        *run.radius = Some(radius);
        // A step that the radius cuts short is no proof of convergence unless coordinate steps promise no more either.
        let small = run.options.energy_tolerance * energy;
        let proof = whole || run.attainable() <= small;
        if accepted {
            run.accept(trial);
            stale = true;
        }
        let decrease = if accepted { energy - trial } else { 0.0 };
        let record = IterationRecord {
            decrease,
            gradient_norm,
            step_norm: proposal.step_norm,
            step_scale: 1.0,
            lambda: mu,
            radius: used,
            gain,
            accepted,
            ..IterationRecord::default()
        };
        run.record(record)?;
        if accepted && decrease <= small && proof {
            return Ok(StopReason::Converged(Convergence::Energy));
        }
        if proposal.step_is_small {
            let whole = accepted && whole;
            return Ok(if whole {
                StopReason::Converged(Convergence::Step)
            } else {
                run.stuck(energy, run.attainable())
            });
        }
    }
    Ok(StopReason::MaxIterations)
}

/// Computes n and c at x, n with a mu that makes H + mu D positive definite; given the last one, returns this one.
fn corners<P: Problem + ?Sized>(run: &mut Run<'_, P>, options: &Dogleg, last: f64) -> Result<f64, LinearError> {
    let mut mu = if last > 0.0 { (last / 5.0).max(options.min_mu) } else { 0.0 };
    loop {
        match run.solve(mu) {
            Ok(()) => break,
            Err(error @ LinearError::NonFinite { .. }) => return Err(error),
            Err(error) => {
                mu = (10.0 * mu).max(options.min_mu);
                if mu > options.max_mu {
                    return Err(error);
                }
            }
        }
    }
    let sparse = run.equations.structure().sparse_dimension();
    let buffers = &mut *run.buffers;
    let (g, x, bounds) = (&run.equations.gradient, &*run.x, &buffers.bounds);
    let DoglegPath { cauchy, newton } = &mut buffers.path;
    newton.clone_from(&buffers.step);
    cauchy.clear();
    cauchy.extend(g.iter().zip(&buffers.scaling).map(|(g, d)| -g / positive(*d)));
    let alpha = -dot(g, cauchy) / run.equations.quadratic_form(cauchy);
    // The gradient lies in the range of H, so that this fails by rounding alone; then the diagonal is as good a guess.
    let alpha = if alpha.is_finite() && alpha > 0.0 { alpha } else { 1.0 };
    cauchy.iter_mut().for_each(|c| *c *= alpha);
    if bounds.any() {
        for (k, c) in cauchy[sparse..].iter_mut().enumerate() {
            *c = bounds.reach(x, k, -*c).copysign(*c);
        }
        let t = -dot(g, cauchy) / run.equations.quadratic_form(cauchy);
        if (0.0..1.0).contains(&t) {
            cauchy.iter_mut().for_each(|c| *c *= t);
        }
    }
    Ok(mu)
}

/// Where on the line a step ends.
struct Blend {
    /// `|d|_D`.
    length: f64,
    /// It is the whole Gauss-Newton step.
    whole: bool,
}

/// Writes the step of this radius.
fn blend<P: Problem + ?Sized>(run: &mut Run<'_, P>, radius: f64) -> Blend {
    let buffers = &mut *run.buffers;
    let DoglegPath { cauchy, newton } = &buffers.path;
    let scaling = &buffers.scaling;
    let product = |a: &[f64], b: &[f64]| -> f64 { (0..a.len()).map(|i| positive(scaling[i]) * a[i] * b[i]).sum() };
    let step = &mut buffers.step;
    let length = product(newton, newton).sqrt();
    if length <= radius {
        step.copy_from_slice(newton);
        return Blend { length, whole: true };
    }
    let reach = product(cauchy, cauchy).sqrt();
    if reach >= radius {
        step.iter_mut().zip(cauchy).for_each(|(d, c)| *d = c * (radius / reach));
        return Blend { length: radius, whole: false };
    }
    // |c + tau (n - c)|^2 = a tau^2 + 2 b tau + reach^2 = radius^2: one root is in (0, 1], in the form that does not cancel.
    step.iter_mut().zip(newton.iter().zip(cauchy)).for_each(|(d, (n, c))| *d = n - c);
    let (a, b, rest) = (product(step, step), product(cauchy, step), (radius - reach) * (radius + reach));
    let root = (b * b + a * rest).sqrt();
    let tau = if b > 0.0 { rest / (b + root) } else { (root - b) / a };
    step.iter_mut().zip(cauchy).for_each(|(d, c)| *d = c + tau.min(1.0) * *d);
    Blend { length: radius, whole: false }
}
