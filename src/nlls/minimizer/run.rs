//! The parts that all minimisers share: linearise, solve, try, accept, record.

use std::time::Instant;

use super::bounded::Bounds;
use super::{Convergence, IterationRecord, Observer, Options, StageTimes, StopReason, Workspace};
use crate::nlls::linear::dot;
use crate::nlls::{LinearError, LinearSolver, NormalEquations, Problem};

/// An energy is known to so many units of rounding of `sqrt(E E_0)`: `dE = 2 r dr`, and residuals `r` of size `sqrt(E)` to rounding of
/// what they were at the start, `sqrt(E_0)`.
const ENERGY_NOISE: f64 = 16.0;

/// A step of [`Run::polish`] counts if it leaves at most this share of the gradient.
const GRADIENT_FALL: f64 = 0.9;

/// One minimisation in progress.
pub(super) struct Run<'a, P: Problem + ?Sized> {
    pub options: &'a Options,
    problem: &'a mut P,
    pub x: &'a mut [f64],
    observer: &'a mut dyn Observer,
    pub equations: &'a mut NormalEquations,
    solver: &'a mut dyn LinearSolver,
    pub buffers: &'a mut Buffers,
    summary: &'a mut super::Summary,
    /// Damping that the last run ended with.
    pub lambda: &'a mut Option<f64>,
    /// Trust-region radius that the last run ended with.
    pub radius: &'a mut Option<f64>,
    times: StageTimes,
}

/// Vectors of a run; sized on first use.
#[derive(Debug, Default)]
pub(super) struct Buffers {
    diagonal: Vec<f64>,
    /// D, see [`Run::rescale`].
    pub scaling: Vec<f64>,
    damping: Vec<f64>,
    pub step: Vec<f64>,
    scaled: Vec<f64>,
    trial: Vec<f64>,
    /// x before a step of [`Run::polish`].
    kept: Vec<f64>,
    pub bounds: Bounds,
    pub path: DoglegPath,
}

/// The two corners of a dogleg's path; sized on first use.
#[derive(Debug, Default)]
pub(super) struct DoglegPath {
    pub cauchy: Vec<f64>,
    pub newton: Vec<f64>,
}

/// What the quadratic model says of a step.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Proposal {
    /// Slope of E along the step, `2 g'd`.
    pub slope: f64,
    /// Predicted decrease of E, `-2 g'd - d'Hd` with the undamped H.
    pub predicted: f64,
    /// `d'Hd` with the undamped H.
    pub curvature: f64,
    /// `|d|`.
    pub step_norm: f64,
    /// `|d| <= tolerance (|x| + tolerance)`, and `predicted` is at most `sqrt(tolerance)` of the energy.
    pub step_is_small: bool,
}

impl Proposal {
    /// Damping, more than H, keeps the step from being longer: without damping and bounds `d'Hd = -g'd`.
    pub(super) fn is_damped(&self) -> bool {
        self.curvature < -0.25 * self.slope
    }
}

/// The scaling of a coordinate. One that nothing has observed yet does not move, whatever its scaling is.
pub(super) fn positive(d: f64) -> f64 {
    if d > 0.0 { d } else { 1.0 }
}

impl<'a, P: Problem + ?Sized> Run<'a, P> {
    pub(super) fn new(
        options: &'a Options,
        problem: &'a mut P,
        x: &'a mut [f64],
        workspace: &'a mut Workspace,
        observer: &'a mut dyn Observer,
    ) -> Self {
        workspace.prepare(problem.structure(), options.linear_solver);
        let Workspace { equations, solver, buffers, summary, lambda, radius, .. } = workspace;
        let (equations, solver) = match (equations, solver) {
            (Some(equations), Some(solver)) => (equations, solver.as_mut()),
            _ => unreachable!("`prepare` fills both"),
        };
        let n = problem.structure().dimension();
        for vector in [&mut buffers.diagonal, &mut buffers.step, &mut buffers.scaled] {
            vector.resize(n, 0.0);
        }
        buffers.scaling.clear();
        buffers.scaling.resize(n, 0.0);
        buffers.trial.resize(x.len(), 0.0);
        buffers.kept.resize(x.len(), 0.0);
        Self {
            options,
            problem,
            x,
            observer,
            equations,
            solver,
            buffers,
            summary,
            lambda,
            radius,
            times: StageTimes::default(),
        }
    }

    /// The energy of the start, moved between its bounds, linearised if there is going to be a step.
    pub(super) fn start(&mut self) -> Result<f64, StopReason> {
        self.buffers.bounds.project(self.x);
        let energy = if self.options.max_iterations == 0 { self.energy_at_x() } else { self.linearize() };
        self.summary.initial_energy = energy;
        self.summary.final_energy = energy;
        if energy.is_finite() { Ok(energy) } else { Err(StopReason::NonFinite) }
    }

    fn energy_at_x(&mut self) -> f64 {
        let clock = Instant::now();
        let energy = self.problem.energy(self.x);
        self.times.energy += clock.elapsed();
        energy
    }

    pub(super) fn linearize(&mut self) -> f64 {
        let clock = Instant::now();
        let energy = self.problem.linearize(self.x, self.equations);
        self.times.linearize += clock.elapsed();
        energy
    }

    /// `max |g_i|`, with `|w_k - P(w_k - g_k)|` for border coordinates between bounds; NaN if any entry is. For use while x is where
    /// the equations were linearised.
    pub(super) fn gradient_norm(&self) -> f64 {
        let (sparse, border) = self.equations.gradient.split_at(self.equations.structure().sparse_dimension());
        let sparse = sparse.iter().map(|g| g.abs());
        let border = border.iter().enumerate().map(|(k, g)| self.buffers.bounds.reach(self.x, k, *g));
        sparse.chain(border).fold(0.0, |max: f64, g| if g <= max { max } else { g })
    }

    /// No step is left that could lower the energy by more than rounding. Damped steps are short wherever one stands, so whether
    /// this is the minimum is judged by the decrease that undamped steps promise, such as [`attainable`](Self::attainable).
    pub(super) fn stuck(&mut self, energy: f64, promised: f64) -> StopReason {
        // Residuals are known to rounding of what they were at the start.
        let noise = (4.0 * f64::EPSILON).powi(2) * self.summary.initial_energy;
        let negligible = promised <= self.options.energy_tolerance.max(f64::EPSILON) * energy + noise;
        self.polish(if negligible { StopReason::Converged(Convergence::Energy) } else { StopReason::NoDecrease })
    }

    /// At the end of a run without energy tolerance: Gauss-Newton steps too short for the energy to judge, for as long as the
    /// gradient falls by them. Where residuals remain the energy is flat to rounding within `sqrt(epsilon E / H)` of the minimum, and its
    /// gradient, `sqrt(epsilon E H)` there, still points the way (W. Hager, H. Zhang, "A new conjugate gradient method with guaranteed
    /// descent and an efficient line search", 2005, section 4: approximate Wolfe conditions).
    ///
    /// Takes the reason why the energy stopped the run, with the equations linearised at x, and gives the reason why this did.
    pub(super) fn polish(&mut self, mut stop: StopReason) -> StopReason {
        while self.options.energy_tolerance == 0.0 && self.summary.iterations < self.options.max_iterations {
            let energy = self.summary.final_energy;
            let noise = ENERGY_NOISE * f64::EPSILON * (energy * self.summary.initial_energy).sqrt();
            let gradient = self.gradient_norm();
            if gradient <= self.options.gradient_tolerance {
                return StopReason::Converged(Convergence::Gradient);
            }
            if self.solve(0.0).is_err() {
                return stop;
            }
            let Proposal { predicted, step_norm, step_is_small, .. } = self.proposal();
            if !(0.0..=noise).contains(&predicted) {
                return stop;
            }
            stop = StopReason::Converged(Convergence::Energy);
            let trial = self.try_step(1.0, true);
            if trial > (energy + noise).min(self.summary.initial_energy) {
                return stop;
            }
            self.buffers.kept.copy_from_slice(self.x);
            self.accept(trial);
            self.linearize();
            let left = self.gradient_norm();
            if left.is_nan() || left > GRADIENT_FALL * gradient {
                self.x.copy_from_slice(&self.buffers.kept);
                self.summary.final_energy = energy;
                return stop;
            }
            let record = IterationRecord {
                decrease: energy - trial,
                gradient_norm: gradient,
                step_norm,
                step_scale: 1.0,
                radius: f64::INFINITY,
                gain: (energy - trial) / predicted,
                accepted: true,
                ..IterationRecord::default()
            };
            if let Err(stop) = self.record(record) {
                return stop;
            }
            if step_is_small {
                return StopReason::Converged(Convergence::Step);
            }
        }
        stop
    }

    /// Brings the scaling up to date with the last linearisation: `D_i = max(H_ii, memory D_i)`, with D = 0 before the first.
    pub(super) fn rescale(&mut self, memory: f64) {
        let Buffers { diagonal, scaling, .. } = &mut *self.buffers;
        self.equations.copy_diagonal(diagonal);
        for (d, h) in scaling.iter_mut().zip(diagonal) {
            *d = h.max(memory * *d);
        }
    }

    /// Solves `(H + lambda D + floor) d = -g`, or its bounded version.
    pub(super) fn solve(&mut self, lambda: f64) -> Result<(), LinearError> {
        let clock = Instant::now();
        let floor = self.options.damping_floor;
        let Buffers { diagonal, scaling, damping, step, bounds, .. } = &mut *self.buffers;
        damping.clear();
        if lambda > 0.0 || floor > 0.0 {
            self.equations.copy_diagonal(diagonal);
            let largest = diagonal.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            let floors = diagonal.iter().map(|h| floor * h.max(floor * largest));
            damping.extend(floors.zip(&*scaling).map(|(floor, &d)| lambda * positive(d) + floor));
        }
        let result = bounds.solve(self.solver, self.equations, damping, self.x, step);
        self.times.solve += clock.elapsed();
        result
    }

    /// The decrease of E that coordinate-wise steps promise, `sum_i g_i^2 / H_ii` (less where a bound shortens the step): a
    /// measure of how far the minimum is that does not shrink with the damping. For use after [`rescale`](Self::rescale), while x is
    /// where the equations were linearised.
    pub(super) fn attainable(&self) -> f64 {
        let sparse = self.equations.structure().sparse_dimension();
        let terms = self.equations.gradient.iter().zip(&self.buffers.diagonal).enumerate();
        terms
            .map(|(i, (g, h))| {
                if *h <= 0.0 {
                    return 0.0;
                }
                let full = (g / h).abs();
                let reach = if i < sparse { full } else { self.buffers.bounds.reach(self.x, i - sparse, g / h) };
                if reach < full { reach * (2.0 * g.abs() - h * reach) } else { g * g / h }
            })
            .sum()
    }

    /// What the model says of the step that was just computed.
    pub(super) fn proposal(&self) -> Proposal {
        let d = &self.buffers.step;
        let slope = 2.0 * dot(&self.equations.gradient, d);
        let curvature = self.equations.quadratic_form(d);
        let norm = |v: &[f64]| dot(v, v).sqrt();
        let (step_norm, predicted, tolerance) = (norm(d), -slope - curvature, self.options.step_tolerance);
        let short = step_norm <= tolerance * (norm(self.x) + tolerance);
        // Beside a coordinate that is far away, any step is short.
        let step_is_small = short && predicted <= tolerance.sqrt() * self.summary.final_energy;
        Proposal { slope, predicted, curvature, step_norm, step_is_small }
    }

    /// Moves a copy of x by `scale` times the step; returns its energy, infinity if that is not finite. `whole` says that this is
    /// the step of the last solve, which ends exactly at the bounds that it runs into.
    pub(super) fn try_step(&mut self, scale: f64, whole: bool) -> f64 {
        let clock = Instant::now();
        let Buffers { step, scaled, trial, bounds, .. } = &mut *self.buffers;
        for (t, d) in scaled.iter_mut().zip(step) {
            *t = scale * *d;
        }
        self.problem.retract(self.x, scaled, trial);
        bounds.settle(trial, whole);
        let energy = self.problem.energy(trial);
        self.times.energy += clock.elapsed();
        if energy.is_finite() { energy } else { f64::INFINITY }
    }

    /// Takes the step that was tried last.
    pub(super) fn accept(&mut self, energy: f64) {
        self.x.copy_from_slice(&self.buffers.trial);
        self.summary.final_energy = energy;
    }

    /// Files an iteration and shows it to the observer. What the run knows itself is filled in: number, energy, weak directions,
    /// times.
    pub(super) fn record(&mut self, step: IterationRecord) -> Result<(), StopReason> {
        self.summary.iterations += 1;
        let times = std::mem::take(&mut self.times);
        self.summary.times += times;
        let record = IterationRecord {
            iteration: self.summary.iterations,
            energy: self.summary.final_energy,
            unobserved_directions: self.solver.unobserved_pivots(),
            linear_iterations: self.solver.iterations().unwrap_or(0),
            times,
            ..step
        };
        self.summary.records.push(record);
        if self.observer.on_iteration(&record).is_break() { Err(StopReason::StoppedByObserver) } else { Ok(()) }
    }

    /// Times spent since the last record.
    pub(super) fn finish(self, stop: StopReason) {
        self.summary.times += self.times;
        self.summary.stop = stop;
        self.summary.linear_solver = self.solver.name();
    }
}
