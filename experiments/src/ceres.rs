//! `ceres`: the inner solve of the hybrid beside Ceres Solver's, on the same numbers; and what a whole registration takes in iterations
//! of Ceres.
//!
//! A case is the rig at rest, and for each vertex the point and the normal of a generated scan nearest to where the vertex truly is. Held:
//! correspondences, graph, weights, tolerances, one thread. Varied: blendshapes. `experiments dev solver-case` and
//! `experiments/ceres/ceres_case.cpp`, which states the energy, solve it in turns, each in a process of its own. Measured: costs at start
//! and end, which must agree, and seconds of an iteration.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result};
use nonrigid::console::{Failure, Stage, say, tell};
use nonrigid::evaluation::percentile;
use nonrigid::io::NpzContents;
use nonrigid::mesh::Vec3;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::normals::face_normals;
use nonrigid::model::NodeGraph;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::generated::write_standard_cases;
use crate::output::{make_output_folder, write_file};
use crate::report::data::upright;
use crate::scan_bench::{BenchCase, BenchRig};
use crate::tables::{table, write_csv, write_json};
use crate::this_program;

/// What to run.
#[derive(Debug, clap::Args)]
#[command(after_help = "To build what runs Ceres, in a checkout:\n  \
    apt-get install g++ cmake libceres-dev\n  \
    cmake -S experiments/ceres -B build/ceres && cmake --build build/ceres\n\
    Ratios are of times that were taken in turns; run nothing beside it. It takes seven minutes.\n\n\
    Examples; the second asks only whether both solve the same, on a small case:\n  \
    experiments ceres\n  experiments ceres --quick --program ceres_case")]
pub struct Arguments {
    /// The program that runs Ceres
    #[arg(long, default_value = "build/ceres/ceres_case")]
    program: PathBuf,
    /// The program nonrigid, for a whole registration [default: the one beside this program]
    #[arg(long, value_name = "PROGRAM")]
    nonrigid: Option<PathBuf>,
    /// A small case, everything once: costs are compared, times say little
    #[arg(long)]
    quick: bool,
    /// Seed of the scan
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Where cases and results go
    #[arg(long, value_name = "DIR", default_value = "out/ceres")]
    out: PathBuf,
}

/// How much is done.
struct Effort {
    vertices: usize,
    triangles: usize,
    nodes: usize,
    shapes: &'static [usize],
    repeats: usize,
}

const WHOLE: Effort = Effort { vertices: 6700, triangles: 60_000, nodes: 400, shapes: &[10, 50, 100], repeats: 7 };
const QUICK: Effort = Effort { vertices: 1500, triangles: 8000, nodes: 100, shapes: &[10, 50], repeats: 1 };

/// An unknown person with the mouth wide open.
const CASE: &str = "new_open";
/// Of the rig, for the whole registration.
const IDENTITY_MODES: &str = "40";
/// With so many shapes and automatic derivatives a whole registration is compared with iterations.
const REGISTRATION: (usize, &str) = (50, "automatic");
const DERIVATIVES: [&str; 2] = ["automatic", "analytic"];
const SOLVERS: [&str; 3] = ["sparse-normal-cholesky", "sparse-schur", "dense-schur"];
/// Of the fastest solver's time; what takes longer is not run again.
const FAR_BEHIND: f64 = 1.5;
/// Both end by their tolerances long before.
const ITERATIONS: &str = "200";
/// Relative differences of costs at the start and at the end.
const SAME: [f64; 2] = [1e-9, 1e-6];

/// One solve.
#[derive(Debug, Clone, Copy, Deserialize)]
struct Solve {
    initial_cost: f64,
    final_cost: f64,
    iterations: usize,
    seconds_per_iteration: f64,
}

/// Ceres with one kind of derivatives beside ours: medians.
#[derive(Debug, Clone, Serialize)]
struct Row {
    shapes: usize,
    derivatives: &'static str,
    /// The fastest of Ceres' linear solvers.
    solver: &'static str,
    ceres_iterations: usize,
    our_iterations: usize,
    ceres_seconds_per_iteration: f64,
    our_seconds_per_iteration: f64,
    /// How many of our iterations take the time of one of Ceres'.
    ratio: f64,
}

/// Runs the command.
///
/// # Errors
/// A [`Failure`]: of the arguments when a program cannot be started; of the computation when costs differ or a solve fails; of writing.
pub fn run(a: &Arguments) -> Result<()> {
    let effort = if a.quick { &QUICK } else { &WHOLE };
    let ours = this_program()?;
    let nonrigid = a.nonrigid.clone().unwrap_or_else(|| ours.with_file_name("nonrigid"));
    check_program("--program", &a.program, "; `experiments ceres --help` says how to build it")?;
    check_program("--nonrigid", &nonrigid, "")?;
    make_output_folder(&a.out, [("--program", &a.program)], &[])?;
    write_standard_cases(&a.out, effort.vertices, effort.triangles, &[CASE], a.seed)?;
    let rig = BenchRig::read(&a.out.join("rig"))?;
    let scanned = BenchCase::read(&a.out.join("cases").join(CASE), &rig)?;
    let mut rows = Vec::new();
    for &shapes in effort.shapes {
        let case = Case::new(&rig, &scanned, shapes, effort.nodes)?;
        let [npz, binary] = ["npz", "bin"].map(|e| a.out.join(format!("shapes{shapes}.{e}")));
        case.write_npz(&npz)?;
        case.write_binary(&binary)?;
        let our = || solve(&mut ours_command(&ours, &npz), "experiments dev solver-case");
        let theirs = |derivatives: &str, solver: &str| {
            let mut command = Command::new(&a.program);
            command.arg(&binary).args([derivatives, solver, ITERATIONS]);
            solve(&mut command, &format!("Ceres, {derivatives} derivatives, {solver}"))
        };
        rows.extend(compare(shapes, effort.repeats, &our, &theirs)?);
    }
    let whole = registration(&nonrigid, &a.out, effort.repeats)?;
    write(a, effort, &rows, whole)
}

/// Refuses a program that cannot be started.
fn check_program(option: &str, program: &Path, advice: &str) -> Result<()> {
    let started = Command::new(program).arg("--help").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let message = |e| format!("{option} {}: cannot be started: {e}{advice}", program.display());
    Ok(started.map(drop).map_err(|e| Failure::new(Stage::Arguments, message(e)))?)
}

fn ours_command(program: &Path, case: &Path) -> Command {
    let mut command = Command::new(program);
    command.args(["dev", "solver-case", "--json", "--threads", "1", "--max-iterations", ITERATIONS]).arg(case);
    command
}

/// What a program prints of its solve. Ceres' sparse solvers call a BLAS that would take further threads.
fn solve(command: &mut Command, name: &str) -> Result<Solve> {
    let output =
        command.envs([("OPENBLAS_NUM_THREADS", "1"), ("OMP_NUM_THREADS", "1")]).output().context("a solver")?;
    let said = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        let last = said.lines().last().unwrap_or("no message");
        return Err(Failure::computation(format!("{name}: {last} ({})", output.status)).into());
    }
    let parsed = serde_json::from_slice(&output.stdout);
    Ok(parsed.map_err(|e| Failure::computation(format!("{name}: not what a solver prints: {e}")))?)
}

/// Ours and the solvers of Ceres in turns; each time they must agree. Those that are far behind are left out.
fn compare(
    shapes: usize,
    repeats: usize,
    ours: &dyn Fn() -> Result<Solve>,
    theirs: &dyn Fn(&str, &str) -> Result<Solve>,
) -> Result<Vec<Row>> {
    let solvers = |derivatives| SOLVERS.map(|solver| (derivatives, solver, Vec::new()));
    let (mut our, mut their): (Vec<Solve>, Vec<_>) = (Vec::new(), DERIVATIVES.map(solvers).concat());
    for round in 1..=repeats {
        let now = ours()?;
        for (derivatives, solver, solves) in &mut their {
            let found = theirs(derivatives, solver)?;
            let Solve { initial_cost, final_cost, .. } = found;
            tell(format_args!(
                "{round}/{repeats}  {shapes:3} shapes  {derivatives:9}  {solver:22}  cost {initial_cost:.9e} -> {final_cost:.9e}  {:.2} ms",
                1e3 * found.seconds_per_iteration
            ));
            check_same(&now, &found, &format!("{shapes} shapes, {derivatives} derivatives, {solver}"))?;
            solves.push(found);
        }
        our.push(now);
        for derivatives in DERIVATIVES {
            let seconds = their.iter().filter(|of| of.0 == derivatives).map(|of| median(&of.2));
            let least = seconds.fold(f64::INFINITY, f64::min);
            their.retain(|of| of.0 != derivatives || median(&of.2) <= FAR_BEHIND * least);
        }
    }
    let our_seconds = median(&our);
    let rows = their.iter().map(|(derivatives, solver, solves)| Row {
        shapes,
        derivatives,
        solver,
        ceres_iterations: solves[0].iterations,
        our_iterations: our[0].iterations,
        ceres_seconds_per_iteration: median(solves),
        our_seconds_per_iteration: our_seconds,
        ratio: median(solves) / our_seconds,
    });
    let rows: Vec<Row> = rows.collect();
    let fastest = |of: &[Row]| of.iter().min_by(|a, b| a.ratio.total_cmp(&b.ratio)).cloned();
    Ok(rows.chunk_by(|a, b| a.derivatives == b.derivatives).filter_map(fastest).collect())
}

/// Refuses costs that differ.
fn check_same(our: &Solve, their: &Solve, of: &str) -> Result<(), Failure> {
    let pairs = [("initial", our.initial_cost, their.initial_cost), ("final", our.final_cost, their.final_cost)];
    for ((which, ours, theirs), same) in pairs.into_iter().zip(SAME) {
        let difference = (theirs / ours - 1.0).abs();
        // A NaN is no agreement.
        if !difference.le(&same) {
            let message =
                format!("{of}: {which} costs differ by {difference:.1e}: {theirs:.15e} of Ceres, {ours:.15e} of ours");
            return Err(Failure::computation(message));
        }
    }
    Ok(())
}

/// Of the seconds of an iteration.
fn median(solves: &[Solve]) -> f64 {
    let seconds: Vec<f64> = solves.iter().map(|s| s.seconds_per_iteration).collect();
    percentile(&seconds, 50.0).unwrap_or(f64::NAN)
}

/// Seconds of `nonrigid register` on the scan, from its start to its end, on two threads: the median.
fn registration(nonrigid: &Path, out: &Path, repeats: usize) -> Result<f64> {
    let case = out.join("cases").join(CASE);
    let mut seconds = Vec::new();
    for _ in 0..repeats {
        let mut command = Command::new(nonrigid);
        command.arg("register").args(["--threads", "2", "--identity-modes", IDENTITY_MODES]);
        for (option, path) in [
            ("--template", out.join("rig/template.obj")),
            ("--rig", out.join("rig")),
            ("--target", case.join("scan.ply")),
            ("--landmarks", case.join("landmarks.json")),
            ("--out", out.join("wrapped.obj")),
        ] {
            command.arg(option).arg(path);
        }
        let clock = Instant::now();
        let output = command.stdout(Stdio::null()).output().context("nonrigid register")?;
        seconds.push(clock.elapsed().as_secs_f64());
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            return Err(Failure::computation(format!("nonrigid register: {}", said.trim())).into());
        }
    }
    Ok(percentile(&seconds, 50.0).unwrap_or(f64::NAN))
}

fn write(a: &Arguments, effort: &Effort, rows: &[Row], registration: f64) -> Result<()> {
    let (shapes, derivatives) = REGISTRATION;
    let iteration = rows.iter().find(|r| (r.shapes, r.derivatives) == REGISTRATION);
    let iteration = iteration.context("proven: both efforts have those shapes")?.ceres_seconds_per_iteration;
    let lines = rows.iter().map(|r| {
        let Row { shapes, derivatives, solver, ceres_iterations, our_iterations, .. } = r;
        let (ceres, ours, ratio) = (r.ceres_seconds_per_iteration, r.our_seconds_per_iteration, r.ratio);
        format!("{shapes},{derivatives},{solver},{ceres_iterations},{our_iterations},{ceres:.6},{ours:.6},{ratio:.3}")
    });
    let header = "shapes,derivatives,solver,ceres_iterations,our_iterations,ceres_seconds_per_iteration,our_seconds_per_iteration,ratio";
    write_csv(&a.out.join("ceres.csv"), header, lines)?;
    let json = json!({
        "seed": a.seed, "vertices": effort.vertices, "nodes": effort.nodes, "repeats": effort.repeats, "threads": 1,
        "rows": rows,
        "registration": {
            "seconds": registration, "threads": 2, "ceres_shapes": shapes, "ceres_derivatives": derivatives,
            "ceres_iterations": registration / iteration,
        },
    });
    write_json(&a.out.join("ceres.json"), &json)?;
    let header =
        ["shapes", "derivatives", "Ceres' solver", "its steps", "our steps", "its ms a step", "our ms", "Ceres / ours"];
    let cells = rows.iter().map(|r| {
        let steps = [r.ceres_iterations, r.our_iterations].map(|n| n.to_string());
        let times = [r.ceres_seconds_per_iteration, r.our_seconds_per_iteration].map(|s| format!("{:.2}", 1e3 * s));
        let names = [r.shapes.to_string(), r.derivatives.to_owned(), r.solver.to_owned()];
        [&names[..], &steps, &times, &[format!("{:.2}", r.ratio)]].concat()
    });
    say(table(&header, cells))?;
    say("costs agree: 1e-9 relative at the start, 1e-6 at the end, with every solver of Ceres")?;
    say(format_args!(
        "nonrigid register, 2 threads, files included: {registration:.2} s, the time of {:.1} iterations of Ceres ({shapes} shapes, \
         {derivatives} derivatives, 1 thread)",
        registration / iteration
    ))?;
    say(format_args!("cases, ceres.csv and ceres.json are in {}", a.out.display()))?;
    Ok(())
}

/// The weights of a case: of the graph, of the shapes, and Huber's delta.
const LAMBDA_GRAPH: f64 = 10.0;
const LAMBDA_BLEND: f64 = 0.1;
const HUBER: f64 = 0.5;
/// Nodes of a vertex at most.
const INFLUENCES: usize = 4;

/// Numbers of a case, in the order of its axes: a vertex' shapes, of these the coordinates.
struct Case {
    shapes: usize,
    neutral: Vec<f64>,
    delta: Vec<f64>,
    target: Vec<f64>,
    normal: Vec<f64>,
    node: Vec<f64>,
    /// [`INFLUENCES`] of a vertex; those that it does not have are of node 0, with weight zero.
    influence: Vec<u32>,
    weight: Vec<f64>,
    edge: Vec<u32>,
}

impl Case {
    fn new(rig: &BenchRig, case: &BenchCase, shapes: usize, nodes: usize) -> Result<Self> {
        let (rest, pose) = (case.rest(), upright(case));
        let surface = ClosestPoint::new(&case.scan.mesh)?;
        let normals = face_normals(&case.scan.mesh.positions, &case.scan.mesh.triangles);
        let (mut target, mut normal) = (Vec::new(), Vec::new());
        for place in &case.truth {
            let hit = surface.query(place).context("a scan without triangles")?;
            // In the template's frame, so that the displacements are those of the rig's files.
            target.push(pose.apply_inverse(hit.point));
            normal.push(pose.rotation.transpose() * normals[hit.triangle as usize]);
        }
        let graph = NodeGraph::along_surface(&case.template.triangulate(), nodes, INFLUENCES)?;
        let (mut influence, mut weight) = (Vec::new(), Vec::new());
        for i in 0..rest.len() {
            let mut list = graph.influences(i).to_vec();
            list.resize(INFLUENCES, (0, 0.0));
            influence.extend(list.iter().map(|(node, _)| *node));
            weight.extend(list.iter().map(|(_, omega)| *omega));
        }
        let of_shapes: Vec<&[f32]> = (0..shapes).map(|k| rig.rig().deltas(k)).collect();
        let delta = (0..rest.len()).flat_map(|i| of_shapes.iter().flat_map(move |d| &d[3 * i..3 * i + 3]));
        Ok(Self {
            shapes,
            delta: delta.map(|d| f64::from(*d)).collect(),
            neutral: numbers(rest),
            target: numbers(&target),
            normal: numbers(&normal),
            node: numbers(graph.nodes()),
            influence,
            weight,
            edge: graph.edges().iter().flat_map(|&(i, j)| [i, j]).collect(),
        })
    }

    /// As `solver-case` reads it.
    fn write_npz(&self, path: &Path) -> Result<()> {
        let (n, m, e) = (self.neutral.len() / 3, self.node.len() / 3, self.edge.len() / 2);
        let contents = NpzContents::new()
            .with("neutral", &[n, 3], &self.neutral)
            .with("delta", &[n, self.shapes, 3], &self.delta)
            .with("target", &[n, 3], &self.target)
            .with("normal", &[n, 3], &self.normal)
            .with("node", &[m, 3], &self.node)
            .with("influence", &[n, INFLUENCES], &self.influence)
            .with("weight", &[n, INFLUENCES], &self.weight)
            .with("edge", &[e, 2], &self.edge)
            .with("alpha_data", &[], &[1.0])
            .with("lambda_graph", &[], &[LAMBDA_GRAPH])
            .with("lambda_blend", &[], &[LAMBDA_BLEND])
            .with("huber_delta", &[], &[HUBER]);
        Ok(contents.write(path).map_err(Failure::writing)?)
    }

    /// The same for the program that runs Ceres, little endian: a mark, numbers of vertices, nodes, influences, shapes and edges, the
    /// scalars, then the arrays.
    fn write_binary(&self, path: &Path) -> Result<()> {
        let counts = [self.neutral.len() / 3, self.node.len() / 3, INFLUENCES, self.shapes, self.edge.len() / 2];
        let mut bytes = b"NRCASE01".to_vec();
        let whole = |items: &[u32]| items.iter().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>();
        let real = |items: &[f64]| items.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        bytes.extend(whole(&counts.map(|n| n as u32)));
        bytes.extend(real(&[1.0, LAMBDA_GRAPH, LAMBDA_BLEND, HUBER]));
        for points in [&self.neutral, &self.delta, &self.target, &self.normal, &self.node] {
            bytes.extend(real(points));
        }
        bytes.extend(whole(&self.influence));
        bytes.extend(real(&self.weight));
        bytes.extend(whole(&self.edge));
        write_file(path, bytes)
    }
}

fn numbers(points: &[Vec3]) -> Vec<f64> {
    points.iter().flat_map(|p| p.data.0[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_costs_are_refused() {
        let our = Solve { initial_cost: 200.0, final_cost: 3.0, iterations: 9, seconds_per_iteration: 0.1 };
        let refused = |their: Solve| check_same(&our, &their, "Ceres").err().map(|e| e.to_string());
        assert_eq!(refused(Solve { initial_cost: 200.0 + 1e-8, final_cost: 3.0 + 1e-6, ..our }), None);
        let said = refused(Solve { initial_cost: 200.0 + 1e-6, ..our }).unwrap();
        assert!(said.contains("Ceres: initial costs differ by 5.0e-9"), "{said}");
        assert!(refused(Solve { final_cost: 3.0 + 1e-5, ..our }).unwrap().contains("final"));
        assert!(refused(Solve { final_cost: f64::NAN, ..our }).is_some());
    }
}
