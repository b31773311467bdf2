//! Minimisers of nonlinear least-squares problems.

use std::sync::Arc;
use std::time::Instant;

use super::covariance::covariance_with;
use super::linear::BorderedCholesky;
use super::{BlockStructure, LinearSolver, LinearSolverKind, NormalEquations, OptionError, Problem};

mod bounded;
pub mod dogleg;
pub mod gauss_newton;
pub mod levenberg_marquardt;
mod observer;
mod options;
mod run;
mod summary;

pub use observer::{Observer, Silent};
pub use options::{Algorithm, Dogleg, GaussNewton, LevenbergMarquardt, Options};
pub use summary::{Convergence, IterationRecord, ProblemSize, StageTimes, StopReason, Summary};

use run::{Buffers, Run};

/// Minimises `E(x)` over any [`Problem`].
///
/// ```
/// # use std::sync::Arc;
/// # use nonrigid::nlls::{BlockStructure, Minimizer, NormalEquations, Options, Problem};
/// /// E(x) = (x - 3)^2
/// struct Parabola(Arc<BlockStructure>);
///
/// impl Problem for Parabola {
///     fn structure(&self) -> &Arc<BlockStructure> { &self.0 }
///     fn parameter_len(&self) -> usize { 1 }
///     fn energy(&mut self, x: &[f64]) -> f64 { (x[0] - 3.0).powi(2) }
///     fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
///         equations.border[0] = 1.0;
///         equations.gradient[0] = x[0] - 3.0;
///         self.energy(x)
///     }
///     fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) { out[0] = x[0] + step[0] }
/// }
///
/// let mut problem = Parabola(Arc::new(BlockStructure::dense(1)));
/// let mut x = [0.0];
/// let summary = Minimizer::new(Options::gauss_newton())?.minimize(&mut problem, &mut x);
/// assert!(summary.stop.converged() && x[0] == 3.0, "{summary}");
/// # Ok::<(), nonrigid::nlls::OptionError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Minimizer {
    options: Options,
}

impl Minimizer {
    /// A minimiser with these options.
    ///
    /// # Errors
    /// The first option that is out of bounds: field, value, bound.
    pub fn new(options: Options) -> Result<Self, OptionError> {
        options.validate()?;
        Ok(Self { options })
    }

    /// The options.
    #[must_use]
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Minimises from `x` in place, with buffers of its own. `x` never ends with a higher energy than it had, or than the
    /// nearest point within the problem's [bounds](Problem::border_bounds) has if it starts outside.
    ///
    /// # Panics
    /// If `x` does not have [`Problem::parameter_len`] entries.
    pub fn minimize<P: Problem + ?Sized>(&self, problem: &mut P, x: &mut [f64]) -> Summary {
        let mut workspace = Workspace::new();
        self.minimize_with(problem, x, &mut workspace, &mut Silent);
        workspace.summary
    }

    /// Minimises from `x` in place, with the buffers of a workspace and under the eyes of an observer. From the second call
    /// on nothing is allocated, as long as the structure of the problem stays the same (and `max_iterations` too: it sizes the
    /// list of records).
    ///
    /// # Panics
    /// If `x` does not have [`Problem::parameter_len`] entries.
    pub fn minimize_with<'w, P: Problem + ?Sized>(
        &self,
        problem: &mut P,
        x: &mut [f64],
        workspace: &'w mut Workspace,
        observer: &mut dyn Observer,
    ) -> &'w Summary {
        assert_eq!(x.len(), problem.parameter_len(), "x must hold the ambient coordinates of all parameters");
        let clock = Instant::now();
        let records = std::mem::take(&mut workspace.summary.records);
        workspace.summary = Summary {
            options: self.options,
            size: ProblemSize::of(problem.structure(), x.len()),
            records,
            ..Summary::empty()
        };
        workspace.summary.records.clear();
        if let Err(error) = workspace.buffers.bounds.load(problem) {
            workspace.summary.stop = StopReason::InvalidBounds(error);
            return &workspace.summary;
        }
        let mut run = Run::new(&self.options, problem, x, workspace, observer);
        let stop = match &self.options.algorithm {
            Algorithm::GaussNewton(options) => gauss_newton::minimize(&mut run, options),
            Algorithm::LevenbergMarquardt(options) => levenberg_marquardt::minimize(&mut run, options),
            Algorithm::Dogleg(options) => dogleg::minimize(&mut run, options),
        };
        run.finish(stop.unwrap_or_else(|cut_short| cut_short));
        workspace.summary.total_time = clock.elapsed();
        &workspace.summary
    }
}

/// Everything that a minimisation allocates: equations, linear solver with its symbolic analysis, vectors, records. Keep it
/// across calls that share a structure, as the steps of an alternation (non-rigid ICP) do.
#[derive(Debug)]
pub struct Workspace {
    equations: Option<NormalEquations>,
    solver: Option<Box<dyn LinearSolver>>,
    kind: LinearSolverKind,
    own_solver: bool,
    buffers: Buffers,
    summary: Summary,
    lambda: Option<f64>,
    radius: Option<f64>,
}

impl Default for Workspace {
    fn default() -> Self {
        Self::new()
    }
}

impl Workspace {
    /// An empty workspace; the first minimisation fills it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            equations: None,
            solver: None,
            kind: LinearSolverKind::Auto,
            own_solver: false,
            buffers: Buffers::default(),
            summary: Summary::empty(),
            lambda: None,
            radius: None,
        }
    }

    /// A workspace that solves with the given solver, whatever the options say.
    #[must_use]
    pub fn with_linear_solver(solver: Box<dyn LinearSolver>) -> Self {
        Self { solver: Some(solver), own_solver: true, ..Self::new() }
    }

    /// The report of the last minimisation.
    #[must_use]
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The equations of the last linearisation, if there was one.
    #[must_use]
    pub fn equations(&self) -> Option<&NormalEquations> {
        self.equations.as_ref()
    }

    /// Levenberg-Marquardt damping at the end of the last minimisation.
    #[must_use]
    pub fn lambda(&self) -> Option<f64> {
        self.lambda
    }

    /// Trust-region radius of dogleg at the end of the last minimisation, in its scaled norm.
    #[must_use]
    pub fn radius(&self) -> Option<f64> {
        self.radius
    }

    /// [`border_covariance`](super::border_covariance) of `problem` at `x`, with the workspace's equations and factor.
    ///
    /// `damping_floor` is that of [`Options`], for the sparse blocks alone: where nothing observes a direction of theirs, nothing
    /// of it reaches the border, and S is the same up to that share. 0 for none.
    ///
    /// # Errors
    /// [`LinearError`](super::LinearError) names the first coordinate that nothing observes, or that is not finite.
    ///
    /// # Panics
    /// As [`border_covariance`](super::border_covariance).
    pub fn border_covariance<P: Problem + ?Sized>(
        &mut self,
        problem: &mut P,
        x: &[f64],
        damping_floor: f64,
    ) -> Result<nalgebra::DMatrix<f64>, super::LinearError> {
        let structure = problem.structure().clone();
        self.prepare(&structure, self.kind);
        let (equations, solver) = match (&mut self.equations, &mut self.solver) {
            (Some(equations), Some(solver)) => (equations, solver.as_mut()),
            _ => unreachable!("`prepare` fills both"),
        };
        match solver.elimination() {
            Some(elimination) => covariance_with(problem, x, equations, elimination, damping_floor),
            None => covariance_with(problem, x, equations, &mut BorderedCholesky::new(&structure), damping_floor),
        }
    }

    /// Makes equations and solver fit the structure. A minimisation does so itself, but something else may be done meanwhile.
    pub(crate) fn prepare(&mut self, structure: &Arc<BlockStructure>, kind: LinearSolverKind) {
        let fits = |e: &NormalEquations| Arc::ptr_eq(e.structure(), structure) || e.structure() == structure;
        let mut fresh = false;
        if !self.equations.as_ref().is_some_and(fits) {
            self.equations = Some(NormalEquations::new(structure.clone()));
            self.lambda = None;
            self.radius = None;
            fresh = true;
            if !self.own_solver {
                self.solver = None;
            }
        }
        if self.solver.is_none() || (self.kind != kind && !self.own_solver) {
            self.solver = Some(kind.build(structure));
            self.kind = kind;
            fresh = true;
        }
        if let (Some(equations), Some(solver)) = (&self.equations, &mut self.solver) {
            self.buffers.bounds.prepare(equations, solver.as_mut(), fresh);
        }
    }
}

#[cfg(test)]
mod awkward_tests;
#[cfg(test)]
mod tests;
