//! `solver-case`: one inner solve of the hybrid with fixed correspondences, for comparison with other solvers on the same numbers.
//!
//! Held: the correspondences, the graph, the shapes and all weights, as the case says. Measured: the cost at the start and at the
//! end (half the energy, as Ceres prints it), iterations, and seconds per iteration with the share of each stage.
//!
//! ```text
//!     E = sum_i rho( alpha (n_i . (v_i - c_i))^2 ) + lambda_graph (7) + lambda_blend sum_k w_k^2        rho: Huber, or none
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use nonrigid::console::{Failure, say};
use nonrigid::energy::{Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::io::{Npz, ReadError};
use nonrigid::mesh::Vec3;
use nonrigid::model::{Hybrid, Linearisation, NodeGraph, Stiffness};
use nonrigid::nlls::{
    Algorithm, Dogleg, GaussNewton, Kernel, LevenbergMarquardt, LinearSolverKind, Minimizer, Options, Silent, Summary,
    Workspace,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::PointToPlane;
use serde_json::json;

use crate::scaling::Derivatives;

/// What to solve, and how.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples, on a case of your own:\n  \
    experiments dev solver-case case.npz --report\n  \
    experiments dev solver-case case.npz --linearisation reference --algorithm gauss-newton --json")]
pub struct Arguments {
    /// The case: neutral, delta, target, normal, node, influence, weight, edge and the scalars alpha_data, lambda_graph,
    /// lambda_blend, huber_delta
    #[arg(value_name = "CASE.npz")]
    case: PathBuf,
    /// Steps at most
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    max_iterations: u32,
    /// How derivatives are taken: structured, or the paper's way
    #[arg(long, value_enum, default_value_t = Derivatives::Structured)]
    linearisation: Derivatives,
    /// Which steps are taken
    #[arg(long, value_enum, default_value_t = Steps::LevenbergMarquardt)]
    algorithm: Steps,
    /// What solves for a step: auto, dense, bordered, block-jacobi
    #[arg(long, default_value_t, value_parser = str::parse::<LinearSolverKind>)]
    linear_solver: LinearSolverKind,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
    /// Print energy and step of every iteration
    #[arg(long, conflicts_with = "json")]
    report: bool,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Steps {
    GaussNewton,
    LevenbergMarquardt,
    Dogleg,
}

/// Solves the case and prints what it cost.
///
/// # Errors
/// A [`Failure`] that names the case's file and what is wrong with it, or why the solver ended without a usable result.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut problem = read_case(&arguments.case)?;
    problem.model.linearisation = match arguments.linearisation {
        Derivatives::Structured => Linearisation::Structured,
        Derivatives::Reference => Linearisation::Reference,
    };
    let algorithm = match arguments.algorithm {
        Steps::GaussNewton => Algorithm::GaussNewton(GaussNewton::default()),
        Steps::LevenbergMarquardt => Algorithm::LevenbergMarquardt(LevenbergMarquardt::default()),
        Steps::Dogleg => Algorithm::Dogleg(Dogleg::default()),
    };
    let summary = solve(&mut problem, algorithm, arguments.linear_solver, arguments.max_iterations as usize);
    if !summary.stop.was_successful() {
        return Err(Failure::computation(format!("{}: {}", arguments.case.display(), summary.stop)).into());
    }
    let stages = stages(&summary);
    if arguments.json {
        say(json!({
            "initial_cost": summary.initial_energy / 2.0,
            "final_cost": summary.final_energy / 2.0,
            "iterations": summary.iterations,
            "seconds_per_iteration": stages.per_iteration,
            "linearise_seconds": stages.linearize,
            "solve_seconds": stages.solve,
            "energy_seconds": stages.energy,
            "other_seconds": stages.other,
            "threads": rayon::current_num_threads(),
            "linear_solver": summary.linear_solver,
            "linear_iterations": summary.records.iter().map(|r| r.linear_iterations).sum::<usize>(),
            "stop": summary.stop.to_string(),
        }))?;
        return Ok(());
    }
    if arguments.report {
        say(format_args!("{summary}\n"))?;
    }
    let share = |seconds: f64| format!("{:.2} ms, {:.0} %", 1e3 * seconds, 100.0 * seconds / stages.per_iteration);
    say(format_args!("initial_cost           {:.15e}", summary.initial_energy / 2.0))?;
    say(format_args!("final_cost             {:.15e}", summary.final_energy / 2.0))?;
    say(format_args!("iterations             {} ({})", summary.iterations, summary.stop))?;
    say(format_args!("seconds_per_iteration  {:.6}", stages.per_iteration))?;
    say(format_args!("  linearise            {}", share(stages.linearize)))?;
    say(format_args!("  solve                {}", share(stages.solve)))?;
    say(format_args!("  energy of the step   {}", share(stages.energy)))?;
    say(format_args!("  other, analysis once {}", share(stages.other)))?;
    Ok(())
}

/// Seconds per iteration: altogether, the symbolic analysis included, and of each stage.
struct Stages {
    per_iteration: f64,
    linearize: f64,
    solve: f64,
    energy: f64,
    other: f64,
}

fn stages(summary: &Summary) -> Stages {
    let each = |time: Duration| time.as_secs_f64() / summary.iterations.max(1) as f64;
    Stages {
        per_iteration: each(summary.total_time),
        linearize: each(summary.times.linearize),
        solve: each(summary.times.solve),
        energy: each(summary.times.energy),
        other: each(summary.total_time.saturating_sub(summary.times.total())),
    }
}

/// A hybrid under one point-to-plane term.
pub type SolverCase = Deformation<Hybrid, Pointwise<PointToPlane, Kernel, 1>>;

/// Minimises from the rest shape, all parameters zero.
#[must_use]
pub fn solve(
    problem: &mut SolverCase,
    algorithm: Algorithm,
    linear_solver: LinearSolverKind,
    max_iterations: usize,
) -> Summary {
    let options = Options::default().with_algorithm(algorithm).with_max_iterations(max_iterations);
    let options = options.with_linear_solver(linear_solver);
    let options = options.with_energy_tolerance(1e-12).with_step_tolerance(1e-14).with_gradient_tolerance(1e-14);
    let minimizer = Minimizer::new(options).expect("proven: defaults with positive tolerances");
    let mut x = problem.model.rest_parameters();
    let mut workspace = Workspace::new();
    minimizer.minimize_with(problem, &mut x, &mut workspace, &mut Silent).clone()
}

/// Reads a case.
///
/// # Errors
/// A [`Failure`] of loading: what cannot be read, has another shape than the rest, names nodes that do not exist, or is not finite.
pub fn read_case(path: &Path) -> Result<SolverCase, Failure> {
    let mut file = Npz::open(path).map_err(Failure::loading)?;
    let neutral = points(&mut file, "neutral", None)?;
    let n = neutral.len();
    let target = points(&mut file, "target", Some(n))?;
    let normal = points(&mut file, "normal", Some(n))?;
    let node = points(&mut file, "node", None)?;

    let delta = file.array("delta").map_err(Failure::loading)?;
    delta.expect_shape(&[Some(n), None, Some(3)]).map_err(Failure::loading)?;
    let shape_count = delta.shape()[1];
    let delta = finite(path, "delta", delta.read_f64())?;

    let influence = file.array("influence").map_err(Failure::loading)?;
    influence.expect_shape(&[Some(n), None]).map_err(Failure::loading)?;
    let k = influence.shape()[1];
    let influence = indices(path, "influence", influence.read_f64(), node.len())?;
    let weight = file.array("weight").map_err(Failure::loading)?;
    weight.expect_shape(&[Some(n), Some(k)]).map_err(Failure::loading)?;
    let weight = finite(path, "weight", weight.read_f64())?;
    let edge = file.array("edge").map_err(Failure::loading)?;
    edge.expect_shape(&[None, Some(2)]).map_err(Failure::loading)?;
    let edge = indices(path, "edge", edge.read_f64(), node.len())?;
    if let Some(loop_edge) = edge.chunks_exact(2).find(|e| e[0] == e[1]) {
        return Err(malformed(path, &format!("edge: node {} is joined to itself", loop_edge[0])));
    }

    let [alpha, graph, blend, huber] =
        ["alpha_data", "lambda_graph", "lambda_blend", "huber_delta"].map(|name| scalar(&mut file, path, name));
    let (alpha, huber, stiffness) =
        (alpha?, huber?, Stiffness { graph: graph?, blend: blend?, ..Stiffness::default() });
    if alpha == 0.0 {
        return Err(malformed(path, "alpha_data: 0, so there are no data to fit"));
    }

    let influences = influence
        .chunks_exact(k.max(1))
        .zip(weight.chunks_exact(k.max(1)))
        .map(|(nodes, weights)| nodes.iter().copied().zip(weights.iter().copied()).collect());
    let edges = edge.chunks_exact(2).map(|e| (e[0], e[1])).collect();
    let nodes = NodeGraph::from_influences(node, influences).with_edges(edges).with_neighbours_together();
    let mut slab = vec![0.0; 3 * n * shape_count];
    for (displacements, rows) in
        delta.chunks_exact((3 * shape_count).max(1)).zip(slab.chunks_exact_mut((3 * shape_count).max(1)))
    {
        for (k, displacement) in displacements.chunks_exact(3).enumerate() {
            for a in 0..3 {
                rows[a * shape_count + k] = displacement[a] as f32; // exact where the case comes from a rig
            }
        }
    }
    let shapes = (0..shape_count).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
    let model = Hybrid::new(neutral, nodes, ShapeBasis::new(shapes, slab), stiffness);
    let mut problem = Deformation::new(model, Samples::vertices(n));
    // The case's kernel acts on alpha r^2, ours on r^2 with alpha outside: rho_delta(alpha s) = alpha rho_(delta / sqrt(alpha))(s).
    let kernel = if huber > 0.0 { Kernel::Huber { delta: huber / alpha.sqrt() } } else { Kernel::None };
    let residuals = PointToPlane { targets: target, normals: normal, weights: vec![1.0; n], scale: alpha };
    problem.terms.push(Pointwise::new("point to plane", residuals, kernel));
    Ok(problem)
}

fn malformed(path: &Path, what: &str) -> Failure {
    Failure::loading(format!("{}: {what}", path.display()))
}

fn finite(path: &Path, name: &str, values: Result<Vec<f64>, ReadError>) -> Result<Vec<f64>, Failure> {
    let values = values.map_err(Failure::loading)?;
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(values),
        Some(at) => Err(malformed(path, &format!("{name}: item {at} is {}, expected finite numbers", values[at]))),
    }
}

fn points(file: &mut Npz, name: &str, count: Option<usize>) -> Result<Vec<Vec3>, Failure> {
    file.array(name).and_then(|a| a.expect_shape(&[count, Some(3)])).map_err(Failure::loading)?;
    file.points(name).map_err(Failure::loading)
}

fn indices(path: &Path, name: &str, values: Result<Vec<f64>, ReadError>, count: usize) -> Result<Vec<u32>, Failure> {
    let values = values.map_err(Failure::loading)?;
    match values.iter().find(|v| !(0.0..count as f64).contains(*v) || v.fract() != 0.0) {
        None => Ok(values.iter().map(|&v| v as u32).collect()),
        Some(v) => Err(malformed(path, &format!("{name}: {v} names no node, there are {count}"))),
    }
}

fn scalar(file: &mut Npz, path: &Path, name: &str) -> Result<f64, Failure> {
    let array = file.array(name).map_err(Failure::loading)?;
    array.expect_shape(&[]).map_err(Failure::loading)?;
    let value = array.read_f64().map_err(Failure::loading)?[0];
    let sound = value.is_finite() && value >= 0.0;
    sound
        .then_some(value)
        .ok_or_else(|| malformed(path, &format!("{name}: {value}, expected a number that is not negative")))
}
