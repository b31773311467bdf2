//! Bounds of the border in a minimisation: a copy of the problem's, and what follows from them.

use crate::nlls::linear::{BoundedStep, LinearError, LinearSolver, Side};
use crate::nlls::{BorderBounds, BoundsError, NormalEquations, Problem};

/// Empty without bounds.
#[derive(Debug, Default)]
pub(super) struct Bounds {
    first: usize,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// The same for a step from x.
    step_lower: Vec<f64>,
    step_upper: Vec<f64>,
    step: Option<BoundedStep>,
}

impl Bounds {
    /// Takes the problem's bounds.
    pub(super) fn load<P: Problem + ?Sized>(&mut self, problem: &P) -> Result<(), BoundsError> {
        for vector in [&mut self.lower, &mut self.upper, &mut self.step_lower, &mut self.step_upper] {
            vector.clear();
        }
        let Some(bounds) = problem.border_bounds() else { return Ok(()) };
        bounds.validate(problem.structure().border(), problem.parameter_len())?;
        self.first = bounds.first;
        self.lower.extend_from_slice(bounds.lower);
        self.upper.extend_from_slice(bounds.upper);
        self.step_lower.extend_from_slice(bounds.lower);
        self.step_upper.extend_from_slice(bounds.upper);
        Ok(())
    }

    /// Buffers for equations and solver, if there are bounds; `fresh` when either is new.
    pub(super) fn prepare(&mut self, equations: &NormalEquations, solver: &mut dyn LinearSolver, fresh: bool) {
        if fresh {
            self.step = None;
        }
        if self.any() && self.step.is_none() {
            self.step = Some(BoundedStep::new(equations, solver));
        }
    }

    fn view(&self) -> BorderBounds<'_> {
        BorderBounds { first: self.first, lower: &self.lower, upper: &self.upper }
    }

    /// Moves x inside.
    pub(super) fn project(&self, x: &mut [f64]) {
        self.view().project(x);
    }

    /// Solves `(H + damping) d = -g`, or its bounded version.
    pub(super) fn solve(
        &mut self,
        solver: &mut dyn LinearSolver,
        equations: &NormalEquations,
        damping: &[f64],
        x: &[f64],
        step: &mut [f64],
    ) -> Result<(), LinearError> {
        let Some(bounded) = self.step.as_mut().filter(|_| !self.lower.is_empty()) else {
            return solver.solve(equations, damping, step);
        };
        for (k, w) in x[self.first..self.first + self.lower.len()].iter().enumerate() {
            self.step_lower[k] = self.lower[k] - w;
            self.step_upper[k] = self.upper[k] - w;
        }
        bounded.solve(solver, equations, damping, [&self.step_lower, &self.step_upper], step)
    }

    /// Whether there are bounds.
    pub(super) fn any(&self) -> bool {
        !self.lower.is_empty()
    }

    /// Takes rounding out of x after a step: inside, and where the `whole` step of the last solve ends at a bound, the bound itself.
    pub(super) fn settle(&self, x: &mut [f64], whole: bool) {
        self.project(x);
        let Some(step) = self.step.as_ref().filter(|_| whole && self.any()) else { return };
        for (k, side) in step.sides().iter().enumerate() {
            match side {
                Side::Free => {}
                Side::Lower => x[self.first + k] = self.lower[k],
                Side::Upper => x[self.first + k] = self.upper[k],
            }
        }
    }

    /// `|w_k - P(w_k - t)|` with the projection P into the box: how far coordinate `k` of the border can move by `-t`.
    pub(super) fn reach(&self, x: &[f64], k: usize, t: f64) -> f64 {
        match self.lower.get(k) {
            None => t.abs(),
            // `max` and `min` would lose it.
            Some(_) if t.is_nan() => t,
            Some(lower) if t > 0.0 => t.min(x[self.first + k] - lower),
            Some(_) => -(t.max(x[self.first + k] - self.upper[k])),
        }
    }
}
