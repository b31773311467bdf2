//! One run of the study, in a process of its own: what it is told to do, and what it measures.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use nonrigid::console::Failure;
use nonrigid::energy::{Deformation, DeformationModel as _, Pointwise, Samples};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::model::{Hybrid, Linearisation, NodeGraph, Stiffness};
use nonrigid::morph::{EnergyOptions, MorphModel};
use nonrigid::nlls::{Kernel, LinearSolverKind, Minimizer, Options, Silent, Workspace};
use nonrigid::registration::{ModelKind, RegistrationObserver, StepRecord, register};
use nonrigid::rig::ShapeBasis;
use nonrigid::term::PointToPlane;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::generated::{Face, bend, face, first_standard_case};
use crate::processor_time::busy_share;
use crate::scan_bench::BenchRig;
use crate::surgery::{Masked, Patient};
use crate::{add_shape, unread};

/// What a run does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "study", rename_all = "snake_case")]
pub enum Configuration {
    /// Gauss-Newton iterations of the hybrid with fixed correspondences.
    Solver(SolverRun),
    /// Whole registrations of the hybrid.
    Registration(RegistrationRun),
    /// The memory of a mask on a model.
    Morph(MorphRun),
}

/// A solve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolverRun {
    /// A rig folder whose template and first shapes take part, instead of a generated face of `vertices` vertices.
    pub rig: Option<PathBuf>,
    /// Vertices of the template, about.
    pub vertices: usize,
    /// Nodes of the graph.
    pub nodes: usize,
    /// Blendshapes.
    pub shapes: usize,
    /// Threads.
    pub threads: usize,
    /// What was asked to solve for a step.
    pub linear_solver: LinearSolverKind,
    /// Whether the derivatives are those of the paper, by automatic differentiation of every residual.
    pub reference: bool,
    /// Iterations at most.
    pub iterations: usize,
    /// How often it is repeated.
    pub repeats: usize,
    /// Seed of the goal.
    pub seed: u64,
}

/// A registration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RegistrationRun {
    /// Triangles of the scan, about.
    pub triangles: usize,
    /// Vertices of the template, about.
    pub template: usize,
    /// Threads.
    pub threads: usize,
    /// How often it is repeated.
    pub repeats: usize,
    /// Seed of the scan.
    pub seed: u64,
}

/// Masks of presets on a generated face.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MorphRun {
    /// Vertices of the face, about.
    pub vertices: usize,
    /// Identity modes for the models with blendshapes.
    pub modes: usize,
    /// Names of the presets, and millimetres.
    pub masks: Vec<(String, f64)>,
    /// What moves.
    pub models: Vec<MorphModel>,
}

impl Configuration {
    /// Threads of the run.
    #[must_use]
    pub fn threads(&self) -> usize {
        match self {
            Self::Solver(run) => run.threads,
            Self::Registration(run) => run.threads,
            Self::Morph(_) => 1,
        }
    }

    /// Runs it in this process and returns all that is known of it, the configuration included.
    ///
    /// # Errors
    /// When data cannot be made, or a minimisation does not lower the energy.
    pub fn measure(&self) -> Result<Value> {
        let measured = match self {
            Self::Solver(run) => solve(run)?,
            Self::Registration(run) => register_scan(run)?,
            Self::Morph(run) => morph(run)?,
        };
        let mut all = serde_json::to_value(self)?;
        for (into, from) in all.as_object_mut().into_iter().zip(measured.as_object()) {
            into.extend(from.clone());
        }
        Ok(all)
    }
}

/// Weight of the graph and of the blendshapes, width of Huber's kernel: those of the hybrid's default schedule half way, per vertex
/// on a template of [`REFERENCE_VERTICES`].
const STIFFNESS: Stiffness = Stiffness { graph: 1.0, kernel: Kernel::None, blend: 4.3, rotation: 0.0 };
const HUBER: f64 = 1.0;
const REFERENCE_VERTICES: f64 = 6706.0;
/// Nodes that move a vertex.
const INFLUENCES: usize = 4;
/// Largest displacement of the goal that no shape is, millimetres.
const BUMP: f64 = 2.0;
/// As in a registration.
const DAMPING_FLOOR: f64 = 1e-9;

fn solve(run: &SolverRun) -> Result<Value> {
    let clock = Instant::now();
    let face = match &run.rig {
        Some(folder) => face_of_rig(folder, run.shapes, run.seed)?,
        None => face(run.vertices, run.shapes, BUMP, run.seed),
    };
    let generate = clock.elapsed().as_secs_f64();
    reset_peak();

    let clock = Instant::now();
    let vertices = face.mesh.positions.len();
    let graph = NodeGraph::along_surface(&face.mesh, run.nodes, INFLUENCES)?;
    let graph_seconds = clock.elapsed().as_secs_f64();
    let clock = Instant::now();
    let normals = vertex_normals(&face.goal, &face.mesh.triangles, NormalWeighting::Area);
    let scale = REFERENCE_VERTICES / vertices as f64;
    let residuals = PointToPlane { weights: vec![1.0; vertices], targets: face.goal, normals, scale };
    let mut model = Hybrid::new(face.mesh.positions, graph, face.shapes, STIFFNESS);
    model.linearisation = if run.reference { Linearisation::Reference } else { Linearisation::Structured };
    let mut problem = Deformation::new(model, Samples::vertices(vertices));
    problem.terms.push(Pointwise::new("point to plane", residuals, Kernel::Huber { delta: HUBER }));
    let attach_seconds = clock.elapsed().as_secs_f64();

    let options = Options::gauss_newton().with_max_iterations(run.iterations).with_energy_tolerance(0.0);
    let options = options.with_damping_floor(DAMPING_FLOOR).with_linear_solver(run.linear_solver);
    let minimizer = Minimizer::new(options)?;
    let mut workspace = Workspace::new();
    let (mut stages, mut first) = (<[Vec<f64>; 4]>::default(), None);
    for _ in 0..run.repeats {
        let mut x = problem.model.rest_parameters();
        let clock = Instant::now();
        let (summary, busy) =
            busy_share(|| minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut Silent))?;
        let seconds = clock.elapsed().as_secs_f64();
        if !summary.stop.was_successful() || summary.iterations == 0 {
            return Err(Failure::computation(summary.stop).into());
        }
        let [linearise, solve, energy] =
            [summary.times.linearize, summary.times.solve, summary.times.energy].map(|t| t.as_secs_f64());
        let each = [linearise, solve, energy, linearise + solve + energy].map(|s| busy * s / summary.iterations as f64);
        stages.iter_mut().zip(each).for_each(|(all, s)| all.push(s));
        // Choosing and analysing is what the first repetition does besides the stages.
        first.get_or_insert(busy * (seconds - linearise - solve - energy).max(0.0));
    }
    let summary = workspace.summary();
    let [linearise, solve, energy, iteration] = stages.map(|all| Spread::of(&all));
    let linear: Vec<usize> = summary.records.iter().map(|r| r.linear_iterations).collect();
    Ok(json!({
        "vertices": vertices,
        "nodes": problem.model.graph().nodes().len(),
        "unknowns": summary.size.tangent,
        "hessian_blocks": summary.size.hessian_blocks,
        "solved_by": summary.linear_solver,
        "iterations_made": summary.iterations,
        "initial_energy": summary.initial_energy,
        "final_energy": summary.final_energy,
        "linear_iterations": linear.iter().sum::<usize>() as f64 / linear.len() as f64,
        "linear_iterations_max": linear.iter().max(),
        "generate_seconds": generate,
        "graph_seconds": graph_seconds,
        "attach_seconds": attach_seconds,
        "analysis_seconds": first,
        "linearise_seconds": linearise,
        "solve_seconds": solve,
        "energy_seconds": energy,
        "iteration_seconds": iteration,
        "peak_bytes": peak_bytes(),
    }))
}

/// As [`face`], of the template and the first shapes of a rig: three of its shapes are the goal, and what no shape is.
fn face_of_rig(folder: &Path, shapes: usize, seed: u64) -> Result<Face> {
    let read = BenchRig::read(folder).map_err(unread)?;
    let (rig, mesh) = (read.rig(), read.template().triangulate());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut goal = mesh.positions.clone();
    for _ in 0..if rig.shapes().is_empty() { 0 } else { 3 } {
        let (k, weight) = (rng.random_range(0..rig.shapes().len()), rng.random_range(0.3..0.8));
        add_shape(&mut goal, rig, k, weight);
    }
    bend(&mut goal, BUMP, &mut rng);
    let count = shapes.min(rig.shapes().len());
    let slab = (0..3 * goal.len()).flat_map(|row| (0..count).map(move |k| rig.deltas(k)[row])).collect();
    Ok(Face { mesh, shapes: ShapeBasis::new(rig.shapes()[..count].to_vec(), slab), goal })
}

fn register_scan(run: &RegistrationRun) -> Result<Value> {
    let clock = Instant::now();
    let case = first_standard_case(run.template, run.triangles, run.seed).map_err(Failure::computation)?;
    let generate = clock.elapsed().as_secs_f64();
    reset_peak();
    let schedule = ModelKind::Hybrid.schedule()?;
    let (mut stages, mut steps) = (<[Vec<f64>; 4]>::default(), 0);
    for _ in 0..run.repeats {
        let mut watch = Watch::new();
        let (result, busy) = busy_share(|| register(&case.input(), &ModelKind::Hybrid, &schedule, &mut watch))?;
        let result = result?;
        let end = Instant::now();
        let whole = (end - watch.begin).as_secs_f64();
        let setup = (watch.started - watch.begin).as_secs_f64();
        let stepping = (watch.stepped - watch.started).as_secs_f64();
        steps = result.history.len();
        let each = [setup, stepping, (end - watch.stepped).as_secs_f64(), whole];
        stages.iter_mut().zip(each).for_each(|(all, s)| all.push(busy * s));
    }
    let [setup, stepping, finish, whole] = stages.map(|all| Spread::of(&all));
    Ok(json!({
        "triangles": case.scan.mesh.triangles.len(),
        "template": case.template.positions.len(),
        "nodes": schedule.model.number("nodes"),
        "shapes": case.shapes.len(),
        "steps": steps,
        "generate_seconds": generate,
        "setup_seconds": setup,
        "steps_seconds": stepping,
        "finish_seconds": finish,
        "registration_seconds": whole,
        "peak_bytes": peak_bytes(),
    }))
}

/// How much the process grows until a model has moved a mask, for each mask the bytes of every model.
fn morph(run: &MorphRun) -> Result<Value> {
    let patient = Patient::generated(run.vertices, run.modes)?;
    let mut grown = Vec::new();
    for (mask, amount) in &run.masks {
        let masked = Masked::new(patient.clone(), mask, *amount)?;
        let of = |model: &MorphModel| -> Result<Option<u64>> {
            reset_peak();
            let before = peak_bytes();
            match model {
                MorphModel::Direct => masked.step.apply(&masked.triangles.positions)?,
                _ => masked.energy(*model, &EnergyOptions::default())?.solve()?.0,
            };
            Ok(before.zip(peak_bytes()).map(|(before, peak)| peak.saturating_sub(before)))
        };
        grown.push(run.models.iter().map(of).collect::<Result<Vec<_>>>()?);
    }
    Ok(json!({ "grown_bytes": grown }))
}

/// Looks at the clock before the first step (scan indexed, start found, model built) and after every one.
struct Watch {
    begin: Instant,
    started: Instant,
    stepped: Instant,
}

impl Watch {
    fn new() -> Self {
        let now = Instant::now();
        Self { begin: now, started: now, stepped: now }
    }
}

impl RegistrationObserver for Watch {
    fn on_start(&mut self, _levels: usize, _steps: usize) {
        self.started = Instant::now();
        self.stepped = self.started;
    }

    fn on_step(&mut self, _record: &StepRecord) -> ControlFlow<()> {
        self.stepped = Instant::now();
        ControlFlow::Continue(())
    }
}

/// What repetitions took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Spread {
    min: f64,
    median: f64,
    max: f64,
}

impl Spread {
    /// Of at least one value.
    fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (n, at) = (sorted.len(), |k: usize| sorted.get(k).copied().unwrap_or(f64::NAN));
        Self { min: at(0), median: (at(n.saturating_sub(1) / 2) + at(n / 2)) / 2.0, max: at(n.saturating_sub(1)) }
    }
}

/// Forgets the greatest memory so far, so that making the data does not count. Where the system cannot, it does count.
pub(crate) fn reset_peak() {
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Greatest memory that this process had in use at once since [`reset_peak`], in bytes; `None` where the system does not say.
pub(crate) fn peak_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_that_of_its_values() {
        assert_eq!(Spread::of(&[3.0, 1.0, 2.0]), Spread { min: 1.0, median: 2.0, max: 3.0 });
        assert_eq!(Spread::of(&[4.0, 1.0]), Spread { min: 1.0, median: 2.5, max: 4.0 });
    }
}
