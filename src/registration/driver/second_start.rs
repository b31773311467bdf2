//! Where a subject may be far from rest: with the expression that moves most, as an open mouth does, or bent at joints.
//!
//! From a closed mouth the lower lip finds the scan's upper one, and an open mouth stays shut or tears; an arm that hangs finds the hip of
//! one that is raised. So the first levels run from rest and from elsewhere, and the start is that whose shape covers the scan best.

use std::ops::ControlFlow;
use std::slice;

use super::super::evidence::Seen;
use super::super::schedule::named;
use super::super::start::Cancel;
use super::{Level, RegistrationError, RegistrationInput, RegistrationObserver, Run, Schedule, StepRecord};
use crate::energy::Options;
use crate::nlls::Problem as _;
use crate::rig::ShapeBasis;

/// As many landmarks that pull say an expression themselves.
const MANY_LANDMARKS: usize = 16;
/// How many levels are run before starts are compared.
pub(super) const LEVELS: usize = 2;
/// By how much the shares of template and scan that do not find each other must be less for another start.
const MARGIN: f64 = 0.01;
/// Share of rest's misfit that an expression may leave, if it costs less energy; and at any energy.
const LESS: f64 = 0.9;
const LITTLE: f64 = 0.5;
/// Share of the scan without a template below which no further start is tried.
const COVERED: f64 = 0.004;
/// A limb that nothing found may be a hundredth of the scan, and where the scan ends the template finds nothing either: what the scan
/// shows counts so many times.
const SHOWN: f64 = 5.0;

/// The first levels from one start.
struct Trial {
    /// Parameters before and after.
    start: Vec<f64>,
    x: Vec<f64>,
    history: Vec<StepRecord>,
    /// Shares of template and scan that do not find each other.
    contradicted: f64,
    scan_missed: f64,
    /// After the last step; infinite without one.
    energy: f64,
}

impl Trial {
    /// How badly it covers the scan, where a share of the scan counts `shown` times one of the template.
    fn misfit(&self, shown: f64) -> f64 {
        self.contradicted + shown * self.scan_missed
    }

    fn is_better_than(&self, other: &Self, shown: f64) -> bool {
        self.misfit(shown) < other.misfit(shown) - MARGIN
    }
}

impl Run {
    /// Starts from elsewhere than rest, if that shape covers the scan better; the first levels of the one or the other are then done.
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
        let Some((name, moved)) = expression else { return self.choose_bend(at_rest, input, schedule, cancel) };
        if at_rest.misfit(1.0) <= MARGIN {
            return Ok(()); // nothing covers the scan better by so much
        }
        // It may fail where rest does not, and is then no start.
        let moved = self.tried(moved, input, schedule, cancel);
        cancel.check()?;
        // A mouth that opens wrongly covers some of what is uncovered for other reasons, hair or a hole, and mostly shapes must bend for it.
        let leaves = |moved: &Trial, share: f64| moved.misfit(1.0) < share * at_rest.misfit(1.0);
        let explains = |moved: &Trial| leaves(moved, LITTLE) || (leaves(moved, LESS) && moved.energy < at_rest.energy);
        if moved.is_ok_and(|moved| moved.is_better_than(&at_rest, 1.0) && explains(&moved)) {
            self.start_expression = Some(name);
        } else {
            self.back_to(at_rest, schedule);
        }
        Ok(())
    }

    /// Bends the model in one way after the other, as long as parts of the scan are without a template: a limb elsewhere leaves them so.
    fn choose_bend(
        &mut self,
        at_rest: Trial,
        input: &RegistrationInput<'_>,
        schedule: &Schedule,
        cancel: Cancel<'_>,
    ) -> Result<(), RegistrationError> {
        if at_rest.scan_missed <= MARGIN {
            return Ok(());
        }
        let Some((lead, ways)) = schedule.bend.split_first() else { return Ok(()) };
        let rest = at_rest.start.clone();
        self.start_from(rest.clone());
        let led = self.run_levels(slice::from_ref(lead), "bend ", schedule, cancel).map(|()| self.x.clone());
        cancel.check()?;
        let Ok(led) = led else {
            self.back_to(at_rest, schedule);
            return Ok(());
        };
        let mut best = at_rest;
        // What leads is a start itself where there is no way to go on.
        let ways = if ways.is_empty() { vec![ways] } else { ways.chunks(1).collect() };
        for way in ways {
            if best.scan_missed <= COVERED {
                break;
            }
            self.start_from(rest.clone());
            self.place(&led, &lead.model);
            let bent = self.run_levels(way, "bend ", schedule, cancel).and_then(|()| {
                self.set_resolution(&Options::new());
                self.tried(self.x.clone(), input, schedule, cancel)
            });
            cancel.check()?;
            if let Some(bent) = bent.ok().filter(|bent| bent.is_better_than(&best, SHOWN)) {
                best = bent;
                self.start_bent = true;
            }
        }
        self.back_to(best, schedule);
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
        let seen = Seen::new(input, &self.template.hidden, &self.scan, &self.positions());
        let covers = seen.map(|seen| (seen.coverage.contradicted, seen.coverage.scan_missed));
        let (contradicted, scan_missed) = covers.unwrap_or((f64::INFINITY, f64::INFINITY));
        let (start, x, history) = (self.first_x.clone(), self.x.clone(), self.history.clone());
        let energy = history.last().map_or(f64::INFINITY, |record| record.energy);
        Ok(Trial { start, x, history, contradicted, scan_missed, energy })
    }

    /// As that trial left it, or before it where no level is left to find what another trial has overwritten: correspondences, and
    /// what the solver and the terms remember.
    fn back_to(&mut self, trial: Trial, schedule: &Schedule) {
        self.start_from(trial.start);
        let (Some(last), true) = (tried_levels(schedule).last(), schedule.levels.len() > LEVELS) else { return };
        self.place(&trial.x, &last.model);
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
        self.place(&x, &Options::new());
        self.first_x = x;
    }

    /// Puts the model where `x` says, which is of the resolution that the options ask for.
    fn place(&mut self, x: &[f64], options: &Options) {
        self.set_resolution(options);
        self.x.copy_from_slice(x);
        self.vertices.copy_from_slice(self.problem.vertices(x));
    }
}

/// The levels by which starts are compared.
fn tried_levels(schedule: &Schedule) -> &[Level] {
    &schedule.levels[..LEVELS.min(schedule.levels.len())]
}

/// The name of the shape whose weight is meant to lie from 0 to 1 that moves the surface most.
fn most_moving(shapes: &ShapeBasis) -> Option<String> {
    let square =
        |k: usize| -> f64 { (0..shapes.vertex_count()).map(|i| shapes.displacement(i, k).norm_squared()).sum() };
    let of = shapes.shapes().iter().enumerate().filter(|(_, shape)| shape.from_zero_to_one());
    let squares = of.map(|(k, shape)| (square(k), shape));
    squares.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, shape)| shape.name.clone())
}
