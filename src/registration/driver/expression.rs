//! What face a subject makes, where few landmarks say it: at rest, or with the expression that moves most, as an open mouth does.
//!
//! From a closed mouth the lower lip finds the scan's upper one, and an open mouth stays shut or tears. So the first levels run from both,
//! and the start is that whose shape covers the scan better.

use std::ops::ControlFlow;

use super::super::evidence::Seen;
use super::{RegistrationError, RegistrationInput, Run, Schedule, StepRecord};
use crate::energy::Options;
use crate::nlls::Problem as _;
use crate::rig::ShapeBasis;

/// As many landmarks that pull say it themselves.
const MANY_LANDMARKS: usize = 16;
/// How many levels are run before the two are compared.
const LEVELS: usize = 2;
/// By how much the shares of template and scan that do not find each other must be less for another start than rest.
const MARGIN: f64 = 0.01;

impl Run {
    /// Starts with the expression that moves most, at the weight that the schedule says, if its shape covers the scan better, and returns
    /// its name.
    pub(super) fn choose_expression(
        &mut self,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
    ) -> Result<Option<String>, RegistrationError> {
        let weight = schedule.search.expression;
        let landmarks = schedule.levels.first().and_then(|level| level.terms.get("landmarks")?.number("weight"));
        if weight == 0.0 || (landmarks > Some(0.0) && input.landmarks.len() >= MANY_LANDMARKS) {
            return Ok(None);
        }
        let Some(shape) = most_moving(input.shapes) else { return Ok(None) };
        let weights = self.problem.model.named_weights(&self.x);
        let Some(k) = weights.iter().position(|w| w.0 == shape) else { return Ok(None) };
        let rest = self.x.clone();
        let mut moved = rest.clone();
        moved[rest.len() - self.problem.structure().border() + k] = weight;
        if let Some(bounds) = self.problem.border_bounds() {
            bounds.project(&mut moved);
        }
        let at_rest = self.misfit(input, schedule, &rest)?;
        // It may fail where rest does not, and is then no start.
        let with_it = self.misfit(input, schedule, &moved).unwrap_or(f64::INFINITY);
        let better = with_it < at_rest - MARGIN;
        self.start_from(if better { &moved } else { &rest });
        Ok(better.then_some(shape))
    }

    /// Shares of template and scan that do not find each other after the first levels from `x`.
    fn misfit(
        &mut self,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
        x: &[f64],
    ) -> Result<f64, RegistrationError> {
        self.start_from(x);
        for level in schedule.levels.iter().take(LEVELS) {
            let _ = self.level(level, usize::MAX, schedule, &mut |_: &StepRecord| ControlFlow::Continue(()))?;
            self.levels_done += 1;
        }
        let seen = Seen::new(input, &self.scan, &self.positions());
        Ok(seen.map_or(f64::INFINITY, |seen| seen.coverage.contradicted + seen.coverage.scan_missed))
    }

    /// As before the first step, with the model where `x` says.
    fn start_from(&mut self, x: &[f64]) {
        self.levels_done = 0;
        self.history.clear();
        self.set_resolution(&Options::new());
        self.x.copy_from_slice(x);
        self.vertices.copy_from_slice(self.problem.vertices(&self.x));
    }
}

/// The name of the shape whose weight is meant to lie from 0 to 1 that moves the surface most.
fn most_moving(shapes: &ShapeBasis) -> Option<String> {
    let count = shapes.len();
    let square = |k: usize| -> f64 {
        (0..shapes.vertex_count())
            .flat_map(|i| shapes.vertex(i)[k..].iter().step_by(count))
            .map(|d| f64::from(*d).powi(2))
            .sum()
    };
    let of = shapes.shapes().iter().enumerate().filter(|(_, shape)| shape.from_zero_to_one());
    let squares = of.map(|(k, shape)| (square(k), shape));
    squares.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, shape)| shape.name.clone())
}
