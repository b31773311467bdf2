//! Where a subject may be far from rest: with the expression that moves most, as an open mouth does, or bent at joints.
//!
//! From a closed mouth the lower lip finds the scan's upper one, and an open mouth stays shut or tears; an arm that hangs finds the hip of
//! one that is raised. So the first levels run from rest and from the other, and the start is that whose shape covers the scan better.

use std::ops::ControlFlow;

use super::super::evidence::Seen;
use super::super::schedule::named;
use super::super::start::Cancel;
use super::{Level, RegistrationError, RegistrationInput, Run, Schedule, StepRecord};
use crate::energy::Options;
use crate::nlls::Problem as _;
use crate::rig::ShapeBasis;

/// As many landmarks that pull say an expression themselves.
const MANY_LANDMARKS: usize = 16;
/// How many levels are run before the two are compared.
const LEVELS: usize = 2;
/// By how much the shares of template and scan that do not find each other must be less for another start than rest.
const MARGIN: f64 = 0.01;

impl Run {
    /// Starts from elsewhere than rest, if that shape covers the scan better.
    pub(super) fn choose_start(
        &mut self,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
        cancel: Cancel<'_>,
    ) -> Result<(), RegistrationError> {
        let expression = self.expression(input, schedule);
        if expression.is_none() && schedule.bend.is_empty() {
            return Ok(());
        }
        let rest = self.x.clone();
        let (at_rest, scan_missed) = self.misfit(input, schedule, cancel)?;
        self.start_from(&rest);
        // A limb elsewhere leaves its scan without a template.
        if expression.is_none() && scan_missed <= MARGIN {
            return Ok(());
        }
        // It may fail where rest does not, and is then no start.
        let other = match &expression {
            Some((_, moved)) => Ok(moved.clone()),
            None => self.bent(schedule, cancel),
        };
        let with_it = other.and_then(|other| {
            self.start_from(&other);
            Ok((self.misfit(input, schedule, cancel)?.0, other))
        });
        cancel.check()?;
        match with_it {
            Ok((misfit, other)) if misfit < at_rest - MARGIN => {
                self.start_from(&other);
                self.start_bent = expression.is_none();
                self.start_expression = expression.map(|e| e.0);
            }
            _ => self.start_from(&rest),
        }
        Ok(())
    }

    /// The expression that moves most, and the model with it at the weight that the schedule says; `None` where landmarks say it.
    fn expression(&mut self, input: &RegistrationInput<'_>, schedule: &Schedule) -> Option<(String, Vec<f64>)> {
        let weight = schedule.search.expression;
        let landmarks = schedule.levels.first().and_then(|level| level.terms.get("landmarks")?.number("weight"));
        if weight == 0.0 || (landmarks > Some(0.0) && input.landmarks.len() >= MANY_LANDMARKS) {
            return None;
        }
        let shape = most_moving(input.shapes)?;
        let k = self.problem.model.named_weights(&self.x).iter().position(|w| w.0 == shape)?;
        let mut moved = self.x.clone();
        let first = moved.len() - self.problem.structure().border();
        moved[first + k] = weight;
        if let Some(bounds) = self.problem.border_bounds() {
            bounds.project(&mut moved);
        }
        Some((shape, moved))
    }

    /// Where the model is after the levels that bend it.
    fn bent(&mut self, schedule: &Schedule, cancel: Cancel<'_>) -> Result<Vec<f64>, RegistrationError> {
        self.run_levels(&schedule.bend, "bend ", schedule, cancel)?;
        self.set_resolution(&Options::new());
        Ok(self.x.clone())
    }

    /// Shares of template and scan that do not find each other after the first levels from here, their sum and that of the scan.
    fn misfit(
        &mut self,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
        cancel: Cancel<'_>,
    ) -> Result<(f64, f64), RegistrationError> {
        self.run_levels(&schedule.levels[..LEVELS.min(schedule.levels.len())], "", schedule, cancel)?;
        let seen = Seen::new(input, &self.scan, &self.positions());
        let misfit = |seen: Seen| (seen.coverage.contradicted + seen.coverage.scan_missed, seen.coverage.scan_missed);
        Ok(seen.map_or((f64::INFINITY, f64::INFINITY), misfit))
    }

    fn run_levels(
        &mut self,
        levels: &[Level],
        prefix: &str,
        schedule: &Schedule,
        cancel: Cancel<'_>,
    ) -> Result<(), RegistrationError> {
        let mut watch =
            |_: &StepRecord| if cancel.is_set() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        for (name, level) in named(prefix, levels) {
            let _ = self.level(level, &name, usize::MAX, schedule, &mut watch)?;
            cancel.check()?;
        }
        Ok(())
    }

    /// As before the first step, with the model where `x` says.
    fn start_from(&mut self, x: &[f64]) {
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
