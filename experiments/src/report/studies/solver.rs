//! The solver: how the time of an iteration grows with vertices, shapes, nodes and threads, and which stage takes it.

use anyhow::Result;
use nonrigid::nlls::LinearSolverKind;
use serde_json::Value;

use crate::plots::{Axis, Grid, Plot, Point, Series, StackedBars};
use crate::report::study::{Section, Setting, Study};
use crate::report::table::{Table, counted, number, shown};
use crate::scaling::{Configuration, SolverRun, run_apart};
use crate::scan_bench::megabytes;
use crate::tables::grouped;

pub const STUDY: Study = Study {
    name: "solver",
    title: "The solver: growth with vertices, shapes, nodes, threads",
    about: "Varied, one at a time: vertices (with one node for each hundred), blendshapes (by the paper's differentiation and by \
            ours), nodes, threads. Held: 5,000 vertices or your own template, 400 nodes, 50 shapes, fixed correspondences, one thread \
            where threads are not varied. Measured: time of an iteration by stage, greatest memory, each run in a process of its own. On \
            one thread that is processor time, on several wall time.",
    tables: &["solver.timing"],
    seconds: |effort| {
        let vertices: usize = effort.solver_sizes.iter().sum();
        let runs = effort.solver_shapes.len() * 2 + effort.solver_nodes.len();
        vertices as f64 * 0.7e-4 * (1.0 + 0.2 * effort.solver_repeats as f64) * 2.0
            + runs as f64 * (0.5 + 0.15 * effort.solver_repeats as f64)
    },
    run,
};

const VERTICES: usize = 5000;
const NODES: usize = 400;
const SHAPES: usize = 50;
const ITERATIONS: usize = 4;

/// What is varied, and the runs.
struct Growth {
    name: &'static str,
    title: &'static str,
    axis: &'static str,
    column: &'static str,
    runs: Vec<SolverRun>,
}

fn growths(setting: &Setting<'_>) -> Vec<Growth> {
    let effort = setting.effort;
    let base = SolverRun {
        rig: (!setting.data.generated).then(|| setting.data.rig_folder.clone()),
        vertices: VERTICES,
        nodes: NODES,
        shapes: SHAPES,
        threads: 1,
        linear_solver: LinearSolverKind::Auto,
        reference: false,
        iterations: ITERATIONS,
        repeats: effort.solver_repeats,
        seed: setting.seed,
    };
    let all = rayon::current_num_threads();
    let mut vertices = Vec::new();
    for threads in if all > 1 { vec![1, all] } else { vec![1] } {
        let sized =
            |&v: &usize| SolverRun { rig: None, vertices: v, nodes: (v / 100).max(50), threads, ..base.clone() };
        vertices.extend(effort.solver_sizes.iter().map(sized));
    }
    // A rig of one's own may have fewer.
    let most = if setting.data.generated { usize::MAX } else { setting.data.rig.rig().shapes().len() };
    let mut shapes = Vec::new();
    for reference in [false, true] {
        let numbers = effort.solver_shapes.iter().filter(|shapes| **shapes <= most);
        shapes.extend(numbers.map(|&shapes| SolverRun { shapes, reference, ..base.clone() }));
    }
    let nodes = effort.solver_nodes.iter().map(|&nodes| SolverRun { nodes, ..base.clone() }).collect();
    let growth = |name, title, axis, column, runs| Growth { name, title, axis, column, runs };
    vec![
        growth("vertices", "Vertices", "vertices of the template", "vertices", vertices),
        growth("shapes", "Blendshapes", "blendshapes", "shapes", shapes),
        growth("nodes", "Nodes", "nodes of the graph", "nodes", nodes),
    ]
}

const STAGES: [(&str, &str); 3] = [
    ("linearise_seconds", "linearisation"),
    ("solve_seconds", "linear solve"),
    ("energy_seconds", "energy of the step"),
];

fn run(setting: &Setting<'_>) -> Result<Section> {
    let growths = growths(setting);
    setting.progress.set_length(growths.iter().map(|g| g.runs.len() as u64).sum());
    let columns = [
        "growth",
        "vertices",
        "nodes",
        "shapes",
        "threads",
        "differentiation",
        "seconds_per_iteration",
        "least",
        "greatest",
        "linearise",
        "solve",
        "energy",
        "peak_mb",
    ];
    let mut table = Table::new(&columns);
    let (mut plots, mut bars) = (Vec::new(), Vec::new());
    for growth in &growths {
        let mut measured: Vec<(&SolverRun, Value)> = Vec::new();
        for run in &growth.runs {
            let row = run_apart(setting.program, &Configuration::Solver(run.clone()))?;
            let differentiation = if run.reference { "paper" } else { "ours" };
            let stage = |key: &str, of: &str| row[key][of].as_f64().unwrap_or(f64::NAN);
            let mut cells = vec![growth.name.to_owned()];
            cells.extend(["vertices", "nodes"].map(|key| row[key].to_string()));
            cells.extend([run.shapes.to_string(), run.threads.to_string(), differentiation.to_owned()]);
            cells.extend(["median", "min", "max"].map(|of| number(stage("iteration_seconds", of))));
            cells.extend(STAGES.map(|(key, _)| number(stage(key, "median"))));
            cells.push(number(row["peak_bytes"].as_u64().map_or(f64::NAN, megabytes)));
            table.push(cells);
            measured.push((run, row));
            setting.progress.inc(1);
        }
        plots.push(plot(growth, &measured));
        bars.push(stacked(growth, &measured));
    }
    table.write(setting.out, "solver.timing")?;
    let caption = format!(
        "Time of an iteration: processor time on one thread, wall time on several; in the legend, from three points on, the exponent of the \
         power law through them. Points: median of n = {}; bars: their range.",
        counted(setting.effort.solver_repeats, "repetition")
    );
    let figure = setting.plot("solver", &Grid { columns: 2, plots }.svg()?, caption)?;
    let mut blocks = vec![figure];
    for (growth, bars) in growths.iter().zip(bars) {
        let caption = format!("The stages of an iteration against {}; our differentiation, one thread.", growth.axis);
        blocks.push(setting.plot(&format!("solver-stages-{}", growth.name), &bars.svg()?, caption)?);
    }
    let of = |paper: &str| -> Result<f64> {
        let times = table.numbers(&[("growth", "shapes"), ("differentiation", paper)], "seconds_per_iteration")?;
        Ok(times.last().copied().unwrap_or(f64::NAN))
    };
    let finding = format!(
        "With {} blendshapes an iteration takes {} ms of one core, {} ms by the paper's differentiation; median of {}.",
        setting.effort.solver_shapes.last().unwrap_or(&0),
        shown(1e3 * of("ours")?),
        shown(1e3 * of("paper")?),
        counted(setting.effort.solver_repeats, "repetition")
    );
    Ok(Section { finding, blocks })
}

/// A line for each number of threads and each differentiation.
fn plot(growth: &Growth, measured: &[(&SolverRun, Value)]) -> Plot {
    let points = measured.iter().map(|(run, row)| {
        let name = format!("{}, threads {}", if run.reference { "as in the paper" } else { "ours" }, run.threads);
        let of = |key: &str| 1e3 * row["iteration_seconds"][key].as_f64().unwrap_or(f64::NAN);
        let x = row[growth.column].as_f64().unwrap_or(f64::NAN);
        (name, Point { x, y: of("median"), spread: Some([of("min"), of("max")]) })
    });
    let line = |(name, points): (String, Vec<Point>)| Series::line(&name, points).with_power_law();
    let series = grouped(points).into_iter().map(line).collect();
    Plot::new(growth.title, Axis::log(growth.axis), Axis::log("milliseconds an iteration")).series(series)
}

fn stacked(growth: &Growth, measured: &[(&SolverRun, Value)]) -> StackedBars {
    let shown: Vec<_> = measured.iter().filter(|(run, _)| !run.reference && run.threads == 1).collect();
    let parts = STAGES.map(|(key, name)| {
        let values = shown.iter().map(|(_, row)| 1e3 * row[key]["median"].as_f64().unwrap_or(f64::NAN)).collect();
        (name.to_owned(), values)
    });
    StackedBars {
        title: format!("Stages of an iteration: {}", growth.axis),
        labels: shown.iter().map(|(_, row)| row[growth.column].to_string()).collect(),
        x: growth.axis.to_owned(),
        y: "milliseconds an iteration".to_owned(),
        parts: parts.to_vec(),
    }
}
