//! Where a subject may be far from rest: with the expression that moves most, as an open mouth does, or bent at joints.
//!
//! From a closed mouth the lower lip finds the scan's upper one, and an open mouth stays shut or tears; an arm that hangs finds the hip of
//! one that is raised. So the first levels run from rest and from the other, and the start is that whose shape covers the scan better.

use std::ops::ControlFlow;

use super::super::evidence::Seen;
use super::super::schedule::named;
use super::super::start::Cancel;
use super::{Level, RegistrationError, RegistrationInput, RegistrationObserver, Run, Schedule, StepRecord};
use crate::energy::Options;
use crate::nlls::Problem as _;
use crate::rig::ShapeBasis;

/// As many landmarks that pull say an expression themselves.
const MANY_LANDMARKS: usize = 16;
/// How many levels are run before the two are compared.
const LEVELS: usize = 2;
/// By how much the shares of template and scan that do not find each other must be less for another start than rest.
const MARGIN: f64 = 0.01;

/// The first levels from one start.
struct Trial {
    /// Parameters before and after.
    start: Vec<f64>,
    x: Vec<f64>,
    history: Vec<StepRecord>,
    /// Shares of template and scan that do not find each other, their sum and that of the scan.
    misfit: f64,
    scan_missed: f64,
}

impl Run {
    /// Starts from elsewhere than rest, if that shape covers the scan better; the first levels from there are then done.
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
        let at_rest = self.tried(self.x.clone(), input, schedule, cancel)?;
        // A limb elsewhere leaves its scan without a template.
        if expression.is_none() && at_rest.scan_missed <= MARGIN {
            return Ok(());
        }
        let other = match &expression {
            Some((_, moved)) => Ok(moved.clone()),
            None => self.bent(&at_rest.start, schedule, cancel),
        };
        // It may fail where rest does not, and is then no start.
        let other = other.and_then(|other| self.tried(other, input, schedule, cancel));
        cancel.check()?;
        if other.is_ok_and(|other| other.misfit < at_rest.misfit - MARGIN) {
            self.start_bent = expression.is_none();
            self.start_expression = expression.map(|e| e.0);
        } else {
            self.back_to(at_rest, schedule);
        }
        Ok(())
    }

    /// The levels of the first stage after those that a trial has done, of which the observer hears first.
    pub(super) fn go_on(
        &mut self,
        schedule: &Schedule,
        most_steps: usize,
        observer: &mut dyn RegistrationObserver,
    ) -> Result<ControlFlow<()>, RegistrationError> {
        // Where somebody looks at them or stops among them they run again, with the same bits.
        if observer.wants_positions() {
            self.start_from(self.first_x.clone());
        }
        if let Some(last) = self.history.iter().position(|record| observer.on_step(record).is_break()) {
            self.start_from(self.first_x.clone());
            let mut steps = 0..last;
            let mut up_to_last = |_: &StepRecord| {
                if steps.next().is_some() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            };
            return self.stage(&schedule.levels, schedule, most_steps, &mut up_to_last);
        }
        self.stage(&schedule.levels[self.levels_done..], schedule, most_steps, observer)
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
    fn bent(&mut self, rest: &[f64], schedule: &Schedule, cancel: Cancel<'_>) -> Result<Vec<f64>, RegistrationError> {
        self.start_from(rest.to_vec());
        self.run_levels(&schedule.bend, "bend ", schedule, cancel)?;
        self.set_resolution(&Options::new());
        Ok(self.x.clone())
    }

    /// The first levels from there.
    fn tried(
        &mut self,
        start: Vec<f64>,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
        cancel: Cancel<'_>,
    ) -> Result<Trial, RegistrationError> {
        self.start_from(start);
        self.run_levels(tried_levels(schedule), "", schedule, cancel)?;
        let seen = Seen::new(input, &self.scan, &self.positions());
        let (misfit, scan_missed) = seen.map_or((f64::INFINITY, f64::INFINITY), |seen| {
            (seen.coverage.contradicted + seen.coverage.scan_missed, seen.coverage.scan_missed)
        });
        let (start, x, history) = (self.first_x.clone(), self.x.clone(), self.history.clone());
        Ok(Trial { start, x, history, misfit, scan_missed })
    }

    /// As that trial left it, or before it where no level is left to find what another trial has overwritten: correspondences, and
    /// what the solver and the terms remember.
    fn back_to(&mut self, trial: Trial, schedule: &Schedule) {
        self.start_from(trial.start);
        let (Some(last), true) = (tried_levels(schedule).last(), schedule.levels.len() > LEVELS) else { return };
        self.set_resolution(&last.model);
        self.x.copy_from_slice(&trial.x);
        self.vertices.copy_from_slice(self.problem.vertices(&self.x));
        (self.history, self.levels_done) = (trial.history, LEVELS);
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
            self.levels_done += 1;
        }
        Ok(())
    }

    /// As before the first step, with the model where `x` says.
    fn start_from(&mut self, x: Vec<f64>) {
        self.history.clear();
        self.levels_done = 0;
        self.set_resolution(&Options::new());
        self.x.copy_from_slice(&x);
        self.vertices.copy_from_slice(self.problem.vertices(&x));
        self.first_x = x;
    }
}

/// The levels by which two starts are compared.
fn tried_levels(schedule: &Schedule) -> &[Level] {
    &schedule.levels[..LEVELS.min(schedule.levels.len())]
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
