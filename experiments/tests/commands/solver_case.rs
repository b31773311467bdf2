//! `solver-case` on a case made here: its costs are those of the energy written out, both linearisations agree, and what is wrong
//! with a case is said.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::process::Command;

use nonrigid::io::NpzContents;
use serde_json::Value;

const SIDE: usize = 9;
const NODES: [usize; 4] = [20, 24, 56, 60];
const SHAPES: usize = 3;
const HUBER: f64 = 0.5;

/// A wavy square of vertices, four nodes, three shapes, and targets that no parameters reach.
struct Case {
    neutral: Vec<[f64; 3]>,
    delta: Vec<f64>,
    target: Vec<[f64; 3]>,
    influence: Vec<u32>,
    weight: Vec<f64>,
    edge: Vec<u32>,
    huber: f64,
}

/// Normals that see every motion of the square, if barely.
fn normal(v: &[f64; 3]) -> [f64; 3] {
    let raw = [0.4 * (1.3 * v[0]).sin(), 0.3 * (0.9 * v[1] + v[0]).cos(), 1.0];
    let length = raw.iter().map(|x| x * x).sum::<f64>().sqrt();
    raw.map(|x| x / length)
}

impl Case {
    fn new(huber: f64) -> Self {
        let grid = || (0..SIDE * SIDE).map(|i| ((i % SIDE) as f64, (i / SIDE) as f64));
        let neutral: Vec<[f64; 3]> = grid().map(|(x, y)| [x, y, (x * 0.7).sin() + 0.3 * y.cos()]).collect();
        let shape = |k: usize, x: f64, y: f64| ((1.0 + k as f64) * x * PI / 8.0).sin() * (0.4 * y + k as f64).cos();
        let delta =
            grid().flat_map(|(x, y)| (0..SHAPES).flat_map(move |k| [0.0, 0.0, f64::from(shape(k, x, y) as f32)]));
        let target = neutral.iter().map(|p| [p[0], p[1], p[2] + 1.5 + (0.9 * p[0]).cos() + 0.2 * p[1]]).collect();
        let (mut influence, mut weight) = (Vec::new(), Vec::new());
        for (x, y) in grid() {
            let raw = NODES.map(|n| 1.0 / (1.0 + (x - (n % SIDE) as f64).powi(2) + (y - (n / SIDE) as f64).powi(2)));
            let sum: f64 = raw.iter().sum();
            influence.extend(0..4);
            weight.extend(raw.map(|w| w / sum));
        }
        let edge = (0..4).flat_map(|i| (0..4).filter(move |j| *j != i).flat_map(move |j| [i, j])).collect();
        Self { neutral, delta: delta.collect(), target, influence, weight, edge, huber }
    }

    /// Half the energy with all parameters zero: the graph and the shapes are at rest, so it is the data's.
    fn initial_cost(&self) -> f64 {
        let rho = |s: f64| match self.huber {
            d if d > 0.0 && s > d * d => 2.0 * d * s.sqrt() - d * d,
            _ => s,
        };
        let residual = |(v, t): (&[f64; 3], &[f64; 3])| normal(v)[2] * (t[2] - v[2]);
        self.neutral.iter().zip(&self.target).map(residual).map(|r| rho(r * r)).sum::<f64>() / 2.0
    }

    fn write(&self, path: &Path) {
        let n = self.neutral.len();
        let normals: Vec<f64> = self.neutral.iter().flat_map(normal).collect();
        let nodes: Vec<[f64; 3]> = NODES.iter().map(|&i| self.neutral[i]).collect();
        NpzContents::new()
            .with("neutral", &[n, 3], &self.neutral.concat())
            .with("delta", &[n, SHAPES, 3], &self.delta)
            .with("target", &[n, 3], &self.target.concat())
            .with("normal", &[n, 3], &normals)
            .with("node", &[4, 3], &nodes.concat())
            .with("weight", &[n, 4], &self.weight)
            .with("alpha_data", &[], &[1.0])
            .with("lambda_graph", &[], &[10.0])
            .with("lambda_blend", &[], &[0.1])
            .with("huber_delta", &[], &[self.huber])
            .with("influence", &[n, 4], &self.influence)
            .with("edge", &[self.edge.len() / 2, 2], &self.edge)
            .write(path)
            .unwrap();
    }
}

fn written(case: &Case) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("case.npz");
    case.write(&path);
    (folder, path)
}

fn solved(path: &Path, options: &[&str]) -> Value {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiments"));
    let run = command.args(["dev", "solver-case"]).arg(path).args(["--json"]).args(options).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    serde_json::from_slice(&run.stdout).unwrap()
}

#[test]
fn all_ways_to_solve_a_case_start_at_its_energy_and_end_at_one_minimum() {
    for huber in [HUBER, 0.0] {
        let case = Case::new(huber);
        let (_folder, path) = written(&case);
        let run = |options: &[&str]| {
            let json = solved(&path, options);
            let number = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {json}"));
            assert!((number("initial_cost") / case.initial_cost() - 1.0).abs() < 1e-12, "{json}");
            assert!(number("seconds_per_iteration") > 0.0 && number("iterations") >= 3.0, "{json}");
            number("final_cost")
        };
        let cost = run(&[]);
        assert!(cost < 0.9 * case.initial_cost());
        for options in [
            &["--linearisation", "reference"][..],
            &["--algorithm", "gauss-newton"],
            &["--algorithm", "dogleg"],
            &["--linear-solver", "bordered"],
            &["--linear-solver", "block-jacobi"],
            &["--threads", "1"],
        ] {
            let other = run(&[options, &["--max-iterations", "500"]].concat());
            assert!((other / cost - 1.0).abs() < 1e-6, "{options:?}: {other} {cost}");
        }
    }
}

#[test]
fn the_table_names_every_stage() {
    let (_folder, path) = written(&Case::new(HUBER));
    let run = Command::new(env!("CARGO_BIN_EXE_experiments")).args(["dev", "solver-case"]).arg(&path).output().unwrap();
    let text = String::from_utf8(run.stdout).unwrap();
    for word in ["initial_cost", "final_cost", "iterations", "seconds_per_iteration", "linearise", "solve", "energy"] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

#[test]
fn a_bad_case_is_one_clear_error() {
    let broken = |change: fn(&mut Case), expected: &str| {
        let mut case = Case::new(HUBER);
        change(&mut case);
        let (_folder, path) = written(&case);
        let run =
            Command::new(env!("CARGO_BIN_EXE_experiments")).args(["dev", "solver-case"]).arg(&path).output().unwrap();
        let message = String::from_utf8(run.stderr).unwrap();
        assert_eq!((run.status.code(), message.lines().count()), (Some(4), 1), "{message}");
        assert!(message.contains(expected) && run.stdout.is_empty(), "{message}");
    };
    broken(|case| case.influence[7] = 4, "influence: 4 names no node, there are 4");
    broken(|case| case.edge[1] = case.edge[0], "edge: node 0 is joined to itself");
    broken(|case| case.weight[3] = f64::NAN, "weight: item 3 is NaN");
    broken(|case| case.huber = -1.0, "huber_delta: -1");
    let run =
        Command::new(env!("CARGO_BIN_EXE_experiments")).args(["dev", "solver-case", "absent.npz"]).output().unwrap();
    assert_eq!(run.status.code(), Some(4));
}
