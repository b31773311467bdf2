//! The registration itself: non-rigid ICP. For each level of the schedule: new correspondences, one step of the solver (Gauss-Newton
//! unless the schedule says otherwise), again.

mod second_start;
mod setup;

use std::ops::ControlFlow;

pub use setup::find_start;
use setup::{Placed, build_model, build_terms, first_parameters, landmark_samples, warm_pose};

use super::input::check_input;
use super::one_surface::{OneSurface, TemplateRepair};
use super::rest::Rest;
use super::start::{self, Start};
use super::untangle::untangle;
use super::warm_start::fingerprint;
use super::{
    KernelScale, Level, NamedWeight, RegistrationError, RegistrationInput, RegistrationObserver, RegistrationResult,
    RegistrationStop, ScanFacing, Schedule, SolverOptions, StepAlgorithm, StepRecord, WarmStart,
};
use crate::correspondence::{Correspondences, ScanSurface};
use crate::energy::{Deformation, DeformationModel as _, Options, OptionsError, Samples};
use crate::mesh::{PoseKind, TriangleMesh, Vec3, weighted_closest_pose};
use crate::model::{ModelFactory, RegistrationModel};
use crate::nlls::{
    self, Algorithm, Dogleg, GaussNewton, IterationRecord, Kernel, LevenbergMarquardt, LinearSolverKind, Minimizer,
    NormalEquations, Problem as _, StopReason, Workspace,
};
use crate::rig::{Regions, ShapeBasis};
use crate::term::{RegistrationTerm, Step, TERMS, TermFactory, TermLevel};

/// Registers the template with the given model and the terms that come with the crate.
///
/// # Errors
/// When the inputs do not fit together, the schedule is wrong, no start is found, or the minimisation fails.
pub fn register(
    input: &RegistrationInput<'_>,
    model: &dyn ModelFactory,
    schedule: &Schedule,
    observer: &mut dyn RegistrationObserver,
) -> Result<RegistrationResult, RegistrationError> {
    register_with(input, model, &TERMS, schedule, observer)
}

/// [`register`] with any terms.
///
/// # Errors
/// As [`register`].
pub fn register_with(
    input: &RegistrationInput<'_>,
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    observer: &mut dyn RegistrationObserver,
) -> Result<RegistrationResult, RegistrationError> {
    check_input(input, model)?;
    let template = fingerprint(input.template);
    if let Some(warm) = input.warm_start {
        warm.check_template(&template)?;
    }
    let mut result = match OneSurface::of(input) {
        None => register_surface(input, model, terms, schedule, observer)?,
        Some(surface) => {
            let mut observer = surface.observer(observer);
            surface.result(register_surface(&surface.input(input), model, terms, schedule, &mut observer)?)
        }
    };
    result.end.template = template;
    Ok(result)
}

/// [`register_with`] for a template that is one surface.
fn register_surface(
    input: &RegistrationInput<'_>,
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    observer: &mut dyn RegistrationObserver,
) -> Result<RegistrationResult, RegistrationError> {
    let schedule = schedule.of_subject(input.template, input.shapes).resolved(model, terms)?;
    let cancel = start::Cancel(observer.cancel());
    let mut run = Run::new(input, model, terms, &schedule, cancel)?;
    if input.warm_start.is_none() {
        run.choose_start(input, &schedule, cancel)?;
    }
    run.all_stages(&schedule, input.regions, input.warm_start.is_some(), observer)?;
    if observer.wants_equations() {
        let mut equations = NormalEquations::new(run.problem.structure().clone());
        run.problem.linearize(&run.x, &mut equations);
        observer.on_equations(&equations);
    }
    Ok(run.finish(model.name().to_owned(), schedule, input.rest_positions()))
}

type RegistrationProblem = Deformation<Box<dyn RegistrationModel>, Box<dyn RegistrationTerm>>;

/// A registration under way, in the frame of the model: where the template rests, centred, and the scan is brought to it by the
/// start.
struct Run {
    template: Rest,
    /// In its own frame, and as it is seen from here.
    scan: ScanSurface,
    scan_here: ScanSurface,
    start: Start,
    scan_facing: ScanFacing,
    /// Name of the expression that it starts with, if any.
    start_expression: Option<String>,
    /// Whether it starts bent.
    start_bent: bool,
    problem: RegistrationProblem,
    /// Parameters before the first step, and now.
    first_x: Vec<f64>,
    x: Vec<f64>,
    workspace: Workspace,
    correspondences: Correspondences,
    predictions: Vec<Vec3>,
    /// Where the vertices are.
    vertices: Vec<Vec3>,
    /// Names of the terms, in order.
    term_names: Vec<String>,
    /// Names of all stages' levels, and how many of them are done.
    level_names: Vec<String>,
    levels_done: usize,
    history: Vec<StepRecord>,
    stalled_steps: usize,
    /// Parameters at the end of the first stage, and its weights, once there is another stage.
    first_stage: Option<(Vec<f64>, Vec<NamedWeight>)>,
    stop: RegistrationStop,
}

/// Where a step is in the schedule, for errors.
struct At<'a> {
    level: &'a str,
    step: usize,
}

impl At<'_> {
    fn diverged(&self, what: &str) -> RegistrationError {
        RegistrationError::Diverged { what: what.to_owned(), level: self.level.to_owned(), step: self.step }
    }
}

/// The error of a level that asks for what model or terms do not know.
fn misfit(level: &str) -> impl FnOnce(OptionsError) -> RegistrationError {
    |error| RegistrationError::Options { level: level.to_owned(), error }
}

impl Run {
    /// Everything before the first step: the model at rest, a start, the scan where that puts it, the terms.
    fn new(
        input: &RegistrationInput<'_>,
        model: &dyn ModelFactory,
        terms: &[&dyn TermFactory],
        schedule: &Schedule,
        cancel: start::Cancel<'_>,
    ) -> Result<Self, RegistrationError> {
        let mut template = Rest::new(input, schedule)?;
        let shapes = input.shapes.clone().with_sigmas(|shape| schedule.sigma.of(shape.family));
        let shapes = shapes.with_beyond(|shape| schedule.sigma.beyond(shape));
        let shapes = shapes.with_bounds(|shape| schedule.bounds.of(shape.family));
        let mut samples = Samples::vertices(template.mesh.positions.len());
        let on_template = landmark_samples(input.landmarks, &mut samples)?;
        let of_model = || -> Result<_, RegistrationError> {
            let built = build_model(model, &template, &shapes, input.regions, schedule)?;
            let mut problem = RegistrationProblem::new(built, samples);
            let x = first_parameters(&mut problem, model.name(), input.warm_start)?;
            Ok((problem, x))
        };
        // Neither needs the other, but that a warm start is where the model is.
        let ((mut problem, x), placed) = match input.warm_start {
            None => {
                let of_scan = || Placed::by_search(input, &template, schedule, cancel);
                let (of_model, of_scan) = rayon::join(of_model, of_scan);
                (of_model?, of_scan?)
            }
            Some(warm) => {
                let (mut problem, x) = of_model()?;
                let start = warm_pose(warm, input.landmarks, problem.vertices(&x), template.centre);
                cancel.check()?;
                ((problem, x), Placed::at(start, input, schedule)?)
            }
        };
        // The search has looked at the whole template: less of it loses more starts on parts.
        if schedule.scan.reject_hidden && schedule.bend.is_empty() {
            template.reject_hidden();
        }
        let vertices = problem.vertices(&x).to_vec();
        let Placed { start, scan, facing } = placed.facing_outwards(&template, &vertices, schedule.scan.flip);
        problem.terms = build_terms(terms, input.landmarks, &on_template, &start, &template, schedule)?;
        let scan_here = scan.seen_from(&start.frame(template.centre));
        template.set_scan(&scan_here);
        Ok(Self {
            scan_here,
            scan,
            template,
            start,
            scan_facing: facing,
            start_expression: None,
            start_bent: false,
            problem,
            first_x: x.clone(),
            x,
            workspace: Workspace::new(),
            correspondences: Correspondences::default(),
            predictions: Vec::new(),
            vertices,
            term_names: terms.iter().map(|t| t.name().to_owned()).collect(),
            level_names: schedule.levels_by_name().map(|l| l.0).collect(),
            levels_done: 0,
            history: Vec::new(),
            stalled_steps: 0,
            first_stage: None,
            stop: RegistrationStop::Finished,
        })
    }

    /// The first stage, and those after it: each deforms the shape that the one before has found.
    fn all_stages(
        &mut self,
        schedule: &Schedule,
        regions: Option<&Regions>,
        warm: bool,
        observer: &mut dyn RegistrationObserver,
    ) -> Result<(), RegistrationError> {
        let most_steps = if warm { schedule.warm_start.steps } else { usize::MAX };
        let first = schedule.levels.iter().map(|level| level.steps.min(most_steps));
        let later = schedule.levels_by_name().skip(schedule.levels.len()).map(|(_, level)| level.steps);
        observer.on_start(self.level_names.len(), first.chain(later).sum());
        let mut flow = self.go_on(schedule, most_steps, observer)?;
        self.set_resolution(&Options::new()); // whatever the last level, or the observer, left it at
        let mut next = schedule.next_stage();
        while let (Some((model, schedule)), ControlFlow::Continue(())) = (&next, flow) {
            let Self { problem, x, workspace, first_stage, .. } = &mut *self;
            first_stage.get_or_insert_with(|| (x.clone(), weights(problem, x, workspace)));
            self.template.mesh.positions.copy_from_slice(&self.vertices);
            let model = build_model(model, &self.template, &ShapeBasis::none(), regions, schedule)?;
            let terms = std::mem::take(&mut self.problem.terms);
            self.problem = Deformation::new(model, self.problem.samples().clone());
            self.problem.terms = terms;
            self.x = self.problem.model.rest_parameters();
            self.workspace = Workspace::new();
            flow = self.stage(&schedule.levels, schedule, usize::MAX, observer)?;
            next = schedule.next_stage();
        }
        if flow.is_break() {
            self.stop = RegistrationStop::StoppedByObserver;
        }
        Ok(())
    }

    /// Levels of one stage, of at most so many steps each; `schedule` is as if that stage were the first.
    fn stage(
        &mut self,
        levels: &[Level],
        schedule: &Schedule,
        most_steps: usize,
        observer: &mut dyn RegistrationObserver,
    ) -> Result<ControlFlow<()>, RegistrationError> {
        for level in levels {
            let name = self.level_names[self.levels_done].clone();
            // A pose brings to light what rest hides.
            if schedule.scan.reject_hidden && !schedule.bend.is_empty() && self.levels_done >= second_start::LEVELS {
                self.template.reject_hidden_at(&self.vertices)?;
            }
            if self.level(level, &name, most_steps, schedule, observer)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
            self.levels_done += 1;
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Steps until nothing changes any more.
    fn level(
        &mut self,
        level: &Level,
        name: &str,
        most_steps: usize,
        schedule: &Schedule,
        observer: &mut dyn RegistrationObserver,
    ) -> Result<ControlFlow<()>, RegistrationError> {
        self.problem.model.set_level(&level.model, self.template.unit).map_err(misfit(name))?;
        self.problem.model.trust_shapes(&self.x);
        if most_steps == usize::MAX {
            self.set_resolution(&level.model);
        }
        if level.scale == KernelScale::Fixed {
            self.weigh_terms(level, level.kernel.scaled(self.template.unit)).map_err(misfit(name))?;
        }
        self.template.set_level(level);
        for step in 0..level.steps.min(most_steps) {
            let at = At { level: name, step: step + 1 };
            self.set_out(level, schedule.solver.linear_solver, &at)?;
            let record = self.step(step, &schedule.solver, &at)?;
            let flow = observer.on_step(&record);
            if observer.wants_positions() {
                observer.on_positions(&record, &self.positions());
            }
            let fall = (record.energy_before - record.energy) / record.energy.max(f64::MIN_POSITIVE);
            let still = record.motion <= schedule.stop.motion && fall <= schedule.stop.energy;
            self.history.push(record);
            if flow.is_break() {
                return Ok(flow);
            }
            if still {
                break;
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// All that a step needs: what it acts on, and memory for its equations.
    fn set_out(&mut self, level: &Level, solver: LinearSolverKind, at: &At<'_>) -> Result<(), RegistrationError> {
        let (mut workspace, structure) = (std::mem::take(&mut self.workspace), self.problem.structure().clone());
        // Where equations are new, their analysis takes as long as the search.
        let (told, ()) = rayon::join(
            || {
                self.find_correspondences(level, at)?;
                if level.scale == KernelScale::Mad {
                    self.weigh_terms(level, self.measured_kernel(level)).map_err(misfit(at.level))?;
                }
                self.tell_terms(level, at)
            },
            || workspace.prepare(&structure, solver),
        );
        self.workspace = workspace;
        told
    }

    /// Lets the model have the resolution that a level asks for.
    fn set_resolution(&mut self, options: &Options) {
        if let Some(x) = self.problem.model.set_resolution(options, &self.x) {
            self.workspace = Workspace::new();
            self.problem.analyse();
            self.x = x;
            self.vertices.copy_from_slice(self.problem.vertices(&self.x));
        }
    }

    /// Tells all terms what they weigh.
    fn weigh_terms(&mut self, level: &Level, kernel: Kernel) -> Result<(), OptionsError> {
        let (density, unit) = (self.template.density, self.template.unit);
        for (name, term) in self.term_names.iter().zip(&mut self.problem.terms) {
            let options = &level.terms[name];
            term.set_level(&TermLevel { options, kernel, density, unit })?;
        }
        Ok(())
    }

    /// The closest point of the scan for every vertex; and the model hears what is not seen.
    fn find_correspondences(&mut self, level: &Level, at: &At<'_>) -> Result<(), RegistrationError> {
        let Self { template, scan_here, correspondences, .. } = self;
        let accept = level.acceptance(template.unit);
        correspondences.find(scan_here, &self.vertices, &template.mesh, &template.masks, &accept);
        if !correspondences.any() {
            return Err(RegistrationError::NoOverlap { level: at.level.to_owned(), cap: level.distance_cap });
        }
        self.problem.model.set_unseen(&correspondences.unseen);
        Ok(())
    }

    /// The level's kernel, its scale counted in robust deviations of the residuals.
    fn measured_kernel(&self, level: &Level) -> Kernel {
        let Some(scale) = level.kernel.scale() else { return level.kernel };
        let deviation = self.correspondences.residual_scale(&self.vertices);
        // Where half of the template fits exactly, only rounding is left to scale with.
        let floor = 1e-6 * level.distance_cap * self.template.unit;
        level.kernel.with_scale(scale * deviation.unwrap_or(floor).max(floor))
    }

    /// Tells all terms what the next step acts on.
    fn tell_terms(&mut self, level: &Level, at: &At<'_>) -> Result<(), RegistrationError> {
        self.predictions.clear();
        if self.problem.terms.iter().any(|t| t.needs_predictions()) {
            self.problem.model.prediction(&self.x, &self.template.mesh.positions, &mut self.predictions);
            pose_predictions(&mut self.predictions, &self.vertices, &self.correspondences.weights);
        }
        let step = Step {
            scan: &self.scan_here,
            vertices: &self.vertices,
            rest: &self.template.mesh,
            masks: &self.template.masks,
            correspondences: &self.correspondences,
            accept: level.acceptance(self.template.unit),
            predictions: &self.predictions,
        };
        let told = self.problem.terms.iter_mut().try_for_each(|t| t.update(&step));
        told.map_err(|_| at.diverged("a vertex"))
    }

    /// One step of the solver at fixed correspondences; `step` counts within the level, from 0.
    fn step(&mut self, step: usize, solver: &SolverOptions, at: &At<'_>) -> Result<StepRecord, RegistrationError> {
        let (problem, x) = (&mut self.problem, &mut self.x[..]);
        let exact = EXACT * self.template.unit.powi(2) * self.vertices.len() as f64;
        let summary = minimizer(solver, step > 0).minimize_with(problem, x, &mut self.workspace, &mut one_step);
        match &summary.stop {
            StopReason::LinearSolverFailed(reason) => {
                let (level, reason) = (at.level.to_owned(), reason.to_string());
                return Err(RegistrationError::Solver { level, step: at.step, reason });
            }
            StopReason::NonFinite => {
                let energies = problem.energies(x);
                let named = energies.iter().find(|(_, energy)| !energy.is_finite());
                return Err(at.diverged(&named.map_or("the energy".to_owned(), |(n, _)| format!("the energy {n:?}"))));
            }
            // of an exact fit rounding is left
            StopReason::NoDecrease if summary.final_energy > exact => self.stalled_steps += 1,
            _ => {}
        }
        let (energy_before, energy) = (summary.initial_energy, summary.final_energy);
        let moved = problem.vertices(x);
        // what has no weight is not in the energy
        if !moved.iter().all(|p| p.iter().all(|c| c.is_finite())) {
            return Err(at.diverged("a vertex"));
        }
        let pairs = moved.iter().zip(&self.vertices).zip(&self.template.used);
        let motion = pairs.filter(|p| *p.1).map(|((a, b), _)| (a - b).norm()).fold(0.0, f64::max);
        self.vertices.copy_from_slice(moved);
        Ok(StepRecord {
            level: self.levels_done,
            step,
            energy_before,
            energy,
            energies: problem.energies(x),
            inliers: self.correspondences.inlier_share(),
            motion: motion / self.template.unit,
        })
    }

    /// Where the vertices are in the scan's frame.
    fn positions(&self) -> Vec<Vec3> {
        self.vertices.iter().map(|&v| self.start.pose.apply(v + self.template.centre)).collect()
    }

    fn finish(mut self, model: String, schedule: Schedule, rest: &[Vec3]) -> RegistrationResult {
        let unobserved = self.problem.model.unobserved_directions();
        let mut positions = self.positions();
        let Self { template, problem, x, workspace, first_stage, .. } = &mut self;
        let untangled = || {
            let rest = TriangleMesh { positions: rest.to_vec(), triangles: template.mesh.triangles.clone() };
            schedule.untangle.then(|| untangle(&rest, &mut positions))
        };
        let first_stage = || first_stage.take().unwrap_or_else(|| (x.clone(), weights(problem, x, workspace)));
        let (untangled, (parameters, weights)) = rayon::join(untangled, first_stage);
        let Start { pose, search, by_landmarks } = self.start;
        RegistrationResult {
            positions,
            start: pose,
            end: WarmStart { model, template: String::new(), pose, parameters },
            start_search: search,
            start_landmarks: by_landmarks,
            start_expression: self.start_expression,
            start_bent: self.start_bent,
            scan: self.scan,
            scan_facing: self.scan_facing,
            template_repair: TemplateRepair::default(),
            untangled,
            weights,
            accepted: self.correspondences.weights.iter().map(|&w| w > 0.0).collect(),
            hidden: self.template.hidden,
            unobserved_directions: unobserved.unwrap_or_else(|| self.workspace.summary().unobserved_directions()),
            history: self.history,
            stalled_steps: self.stalled_steps,
            stop: self.stop,
            schedule,
        }
    }
}

/// Moves predictions, as a model wrote them, into the rigid pose that fits `positions` best where correspondences have weight.
fn pose_predictions(predictions: &mut [Vec3], positions: &[Vec3], weights: &[f64]) {
    let pairs = predictions.iter().zip(positions).zip(weights).map(|((&p, &v), &w)| (p, v, w));
    match weighted_closest_pose(pairs, PoseKind::Rigid) {
        Ok(pose) => predictions.iter_mut().for_each(|p| *p = pose.apply(*p)),
        Err(_) => predictions.copy_from_slice(positions),
    }
}

/// Energy of a vertex, millimetres squared, that is next to nothing.
const EXACT: f64 = 1e-12;

/// Damping of what nothing observes: see [`nlls::Options::damping_floor`].
const DAMPING_FLOOR: f64 = 1e-9;

/// The minimiser of a level's first step, or of a later one, which carries on from the step before.
fn minimizer(solver: &SolverOptions, carry_on: bool) -> Minimizer {
    let algorithm = match solver.algorithm {
        StepAlgorithm::GaussNewton => Algorithm::GaussNewton(GaussNewton::default()),
        StepAlgorithm::LevenbergMarquardt => Algorithm::LevenbergMarquardt(LevenbergMarquardt {
            reuse_lambda: carry_on,
            ..LevenbergMarquardt::default()
        }),
        StepAlgorithm::Dogleg => Algorithm::Dogleg(Dogleg { reuse_radius: carry_on, ..Dogleg::default() }),
    };
    let options = nlls::Options::default().with_algorithm(algorithm).with_linear_solver(solver.linear_solver);
    let options = options.with_damping_floor(DAMPING_FLOOR);
    Minimizer::new(options).expect("proven: the defaults and the floor are in bounds")
}

/// Ends a minimisation with its first step; those that are rejected before are trials.
fn one_step(record: &IterationRecord) -> ControlFlow<()> {
    if record.accepted { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// The blendshape weights at the end, and how well the last correspondences determine them.
fn weights(problem: &mut RegistrationProblem, x: &[f64], workspace: &mut Workspace) -> Vec<NamedWeight> {
    let named = problem.model.named_weights(x);
    if named.is_empty() {
        return Vec::new();
    }
    let variance = problem.residual_variance(x);
    let covariance = workspace.border_covariance(problem, x, DAMPING_FLOOR).ok();
    let covariance = covariance.filter(|c| c.nrows() >= named.len()).zip(variance);
    let bounds = problem.border_bounds().filter(|b| b.lower.len() >= named.len());
    let weight = |(k, (name, value))| {
        let at_bound = bounds.is_some_and(|b| b.at_bound(x, k));
        let std_dev = covariance.as_ref().filter(|_| !at_bound).map(|(c, variance)| (variance * c[(k, k)]).sqrt());
        NamedWeight { name, value, std_dev, at_bound }
    };
    named.into_iter().enumerate().map(weight).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::mesh::Pose;
    use nalgebra::Rotation3;

    use crate::mesh::testing::noise;
    use crate::nlls::{BlockStructure, Problem};

    /// E(x) = atan(x)^2: from 10, an undamped step lands beyond 100 on the other side.
    struct Overshooting(Arc<BlockStructure>);

    impl Problem for Overshooting {
        fn structure(&self) -> &Arc<BlockStructure> {
            &self.0
        }

        fn parameter_len(&self) -> usize {
            1
        }

        fn energy(&mut self, x: &[f64]) -> f64 {
            x[0].atan().powi(2)
        }

        fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
            let slope = 1.0 / (1.0 + x[0] * x[0]);
            equations.border[0] = slope * slope;
            equations.gradient[0] = slope * x[0].atan();
            self.energy(x)
        }

        fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
            out[0] = x[0] + step[0];
        }
    }

    #[test]
    fn a_step_is_tried_again_until_the_energy_falls_and_the_next_one_carries_on() {
        for algorithm in [StepAlgorithm::GaussNewton, StepAlgorithm::LevenbergMarquardt, StepAlgorithm::Dogleg] {
            let mut problem = Overshooting(Arc::new(BlockStructure::dense(1)));
            let (mut workspace, mut x) = (Workspace::new(), [10.0]);
            let mut step = |carry_on, x: &mut [f64; 1]| {
                let before = problem.energy(x);
                let solver = SolverOptions { algorithm, ..SolverOptions::default() };
                let summary =
                    minimizer(&solver, carry_on).minimize_with(&mut problem, x, &mut workspace, &mut one_step);
                assert!(summary.final_energy < before, "{algorithm:?}: {summary}");
                let records = summary.records.clone();
                let (last, trials) = records.split_last().expect("a step");
                assert!(last.accepted && trials.iter().all(|t| !t.accepted), "{algorithm:?}: {records:?}");
                (records[0], records.len(), workspace.lambda(), workspace.radius())
            };
            let (first, trials, lambda, radius) = step(false, &mut x);
            // Gauss-Newton halves within a step.
            assert_eq!(trials > 1, algorithm != StepAlgorithm::GaussNewton);
            assert!(trials > 1 || first.step_scale < 1.0);
            let (second, ..) = step(true, &mut x);
            let (anew, ..) = step(false, &mut x);
            match algorithm {
                StepAlgorithm::GaussNewton => {}
                StepAlgorithm::LevenbergMarquardt => {
                    assert_eq!(
                        (Some(second.lambda), anew.lambda),
                        (lambda, LevenbergMarquardt::default().initial_lambda)
                    );
                    assert!(lambda > Some(anew.lambda), "what the rejected trials have taught");
                }
                StepAlgorithm::Dogleg => {
                    assert_eq!(Some(second.radius), radius);
                    assert!(anew.radius != second.radius);
                }
            }
        }
    }

    #[test]
    fn predictions_take_the_pose_of_the_accepted_vertices() {
        let pose = Pose {
            scale: 1.0,
            rotation: Rotation3::from_euler_angles(0.4, -0.2, 0.9).into_inner(),
            translation: Vec3::new(3.0, -8.0, 1.0),
        };
        let predicted: Vec<Vec3> = (0..12).map(|i| Vec3::new(noise(i), noise(50 + i), noise(90 + i)) * 10.0).collect();
        let weights: Vec<f64> = (0..12).map(|i| f64::from(u8::from(i % 2 == 0))).collect();
        // What is not accepted may be anywhere.
        let place = |(i, p): (usize, &Vec3)| if i % 2 == 0 { pose.apply(*p) } else { Vec3::new(700.0, i as f64, 0.0) };
        let positions: Vec<Vec3> = predicted.iter().enumerate().map(place).collect();
        let mut posed = predicted.clone();
        pose_predictions(&mut posed, &positions, &weights);
        for (p, q) in predicted.iter().zip(&posed) {
            approx::assert_abs_diff_eq!(pose.apply(*p), *q, epsilon = 1e-9);
        }
        // Two vertices determine no pose: stay where they are.
        let weights: Vec<f64> = (0..12).map(|i| f64::from(u8::from(i < 2))).collect();
        pose_predictions(&mut posed, &positions, &weights);
        assert_eq!(posed, positions);
    }
}
