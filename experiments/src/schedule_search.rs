//! `search-schedules`: where the default schedules come from. One search for all models, so that comparing models is not
//! comparing how long somebody has tuned each of them.
//!
//! Held for all models: the ladder of levels in [`LADDER`]. Varied: what the model has, see [`axes`]: stiffness and landmark
//! weights at the first level and at the last, shortest distance cap, rim, stiffness of what is unseen. Measured over observed vertices, mean
//! over the cases: the rmse plus its part along the true normal. The rmse alone is mostly slide, which a stiff model hides at
//! the price of the surface that everybody sees. The cases are the six standard ones of data-gen at a seed of their own, on
//! which nothing else is reported.
//!
//! The search is a coordinate descent on a grid: axis by axis, one grid point up and on while that gains, else one down and on
//! while that gains; again from the first axis until a sweep changes nothing or the budget of evaluations is spent. One per cent
//! less counts as a gain. Every evaluation is a row of `search.csv`.

use std::collections::HashMap;
use std::fmt::Write as _;

use anyhow::Result;
use nonrigid::console::{say, tell};
use nonrigid::registration::{ModelKind, Schedule, TERMS};
use rayon::prelude::*;

use crate::generated::standard_cases;
use crate::output::{each_once, make_output_folder, write_file};
use crate::scan_bench::{BenchCase, LandmarkUse, run_case};

/// What all models share, level by level.
pub const LADDER: [Rung; 6] = [
    Rung { steps: 5, huber: 3.0, distance_cap: 25.0 },
    Rung { steps: 5, huber: 2.0, distance_cap: 12.0 },
    Rung { steps: 5, huber: 1.0, distance_cap: 12.0 },
    Rung { steps: 5, huber: 0.5, distance_cap: 5.0 },
    Rung { steps: 5, huber: 0.4, distance_cap: 5.0 },
    Rung { steps: 15, huber: 0.3, distance_cap: 5.0 },
];

/// The shared part of a level, millimetres.
#[derive(Debug, Clone, Copy)]
pub struct Rung {
    /// Steps at most; `stop` ends most levels after two or three, and models without shapes converge slowly.
    pub steps: usize,
    /// Scale of the Huber kernel on the data.
    pub huber: f64,
    /// Longest correspondence, unless the axis `cap` allows longer ones.
    pub distance_cap: f64,
}

/// The rung on which the second stage of a sequence starts.
const SECOND_STAGE: usize = 2;

/// Triangles of each scan, about.
const TRIANGLES: usize = 60_000;

/// Below this share of the best so far an objective counts as a gain.
const GAIN: f64 = 0.99;

/// One thing that the search may change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// Name in the log.
    pub name: &'static str,
    /// Values, ascending.
    pub grid: &'static [f64],
    /// Index of the value that the search starts from.
    pub start: usize,
}

const FIRST: &[f64] = &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
/// Softer starts gain a per cent with landmarks, and without them let a mouth take a wrong expression that it never leaves.
const BLEND_FIRST: &[f64] = &[100.0, 300.0, 1000.0];
const LAST: &[f64] = &[0.003, 0.007, 0.015, 0.03, 0.07, 0.15, 0.3, 0.7, 1.5, 3.0, 7.0, 15.0];
const LANDMARKS_FIRST: &[f64] = &[1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
const LANDMARKS_LAST: &[f64] = &[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0];

/// The models that are searched: not those that state what others do.
#[must_use]
pub fn searched() -> Vec<ModelKind> {
    ModelKind::ALL.into_iter().filter(|m| !matches!(m, ModelKind::Klimov2020 | ModelKind::Flame)).collect()
}

/// What may be varied of a model, in the order of the search; of one that is not [`searched`], what of the model that it runs.
#[must_use]
pub fn axes(model: ModelKind) -> Vec<Axis> {
    let axis = |name, grid, start| Axis { name, grid, start };
    let graph = [axis("lambda_graph last", LAST, 4), axis("lambda_graph first", FIRST, 3)];
    let blend = [axis("lambda_blend last", LAST, 7), axis("lambda_blend first", BLEND_FIRST, 0)];
    let smooth = [axis("lambda_smooth last", LAST, 6), axis("lambda_smooth first", FIRST, 3)];
    let mut axes = match model {
        ModelKind::Rigid | ModelKind::Similarity => Vec::new(),
        ModelKind::Blendshape | ModelKind::Flame | ModelKind::Gpmm | ModelKind::GpmmRig => blend.to_vec(),
        ModelKind::Klimov2020 => [&graph[..], &blend].concat(),
        ModelKind::Hybrid => [&graph[..], &blend, &[axis("lambda_unseen", &[0.0, 0.3, 1.0, 3.0, 10.0], 2)]].concat(),
        ModelKind::Sequential => [&smooth[..], &blend].concat(),
        ModelKind::Graph => graph.to_vec(),
        ModelKind::Sumner => [&graph[..], &[axis("lambda_rotation", &[0.001, 0.01, 0.1, 1.0, 10.0], 2)]].concat(),
        ModelKind::Free => {
            [&[axis("bilaplacian", &[0.0, 1.0], 0), axis("cotangent", &[0.0, 1.0], 0)], &smooth[..]].concat()
        }
        ModelKind::Laplacian => smooth.to_vec(),
        ModelKind::Affine => [&[axis("gamma", &[0.1, 0.3, 1.0, 3.0, 10.0], 2)], &smooth[..]].concat(),
        ModelKind::MassSpring | ModelKind::Fem | ModelKind::Ffd => smooth.to_vec(),
        ModelKind::Arap | ModelKind::Poisson => [&[axis("joint", &[0.0, 1.0], 1)], &smooth[..]].concat(),
    };
    axes.push(axis("landmarks last", LANDMARKS_LAST, 2));
    axes.push(axis("landmarks first", LANDMARKS_FIRST, 2));
    axes.push(axis("cap", &[5.0, 8.0, 12.0, 25.0], 0));
    axes.push(axis("rim", &[0.0, 1.0, 2.0, 3.0], 3));
    axes
}

/// A schedule of the family as TOML, `at` giving the value of each of the model's axes by name.
#[must_use]
pub fn schedule_text(model: ModelKind, at: &HashMap<&'static str, f64>) -> String {
    let mut text = format!(
        "# Default schedule of the model '{model}', as `experiments dev search-schedules` found it: the same ladder, cases and\n\
         # budget for every model (experiments/src/schedule_search.rs).\n\
         #\n\
         # For a template of the default `reference_size` and `reference_vertices`. Every key is described at `registration::Schedule`.\n\n"
    );
    if matches!(model, ModelKind::Rigid | ModelKind::Similarity) {
        text += "# Steps are cheap without deformation, and a pose is wanted to the micrometre.\n[stop]\nenergy = 1e-4\nmotion = 0.001\n\n";
    }
    let _ = writeln!(text, "[scan]\ntemplate_rim = {:?}", at["rim"]);
    let mut options: Vec<String> = Vec::new();
    if at.contains_key("lambda_graph last") {
        options.extend(["nodes = 400", "influences = 4", "distance = \"surface\""].map(String::from));
    }
    let choices = [
        ("bilaplacian", "kind", ["laplacian", "bilaplacian"]),
        ("cotangent", "weights", ["uniform", "cotangent"]),
        ("joint", "solver", ["local_global", "joint"]),
    ];
    for (axis, key, choices) in choices {
        options.extend(at.get(axis).map(|&choice| format!("{key} = {:?}", choices[usize::from(choice > 0.0)])));
    }
    for key in ["gamma", "lambda_unseen"] {
        options.extend(at.get(key).map(|value| format!("{key} = {value:?}")));
    }
    if !options.is_empty() {
        let _ = writeln!(text, "\n[model]\n{}", options.join("\n"));
    }
    if model == ModelKind::Sequential {
        text += &levels_text("level", &LADDER, &["lambda_blend"], at);
        text += "\n[then.model]\nname = \"arap\"\n";
        text += &levels_text("then.level", &LADDER[SECOND_STAGE..], &["lambda_smooth"], at);
    } else {
        text += &levels_text("level", &LADDER, &["lambda_graph", "lambda_smooth", "lambda_blend"], at);
    }
    text
}

/// The levels under `rungs` as `[[table]]`s, with ramps of the landmarks and of those of `keys` that `at` has ends for.
fn levels_text(table: &str, rungs: &[Rung], keys: &[&str], at: &HashMap<&'static str, f64>) -> String {
    let mut text = String::new();
    for (level, rung) in rungs.iter().enumerate() {
        let along = |key: &str| {
            let [first, last] = ["first", "last"].map(|end| at.get(&*format!("{key} {end}")).copied());
            Some(ramp(first?, last?, level, rungs.len()))
        };
        let mut model: Vec<String> = keys.iter().filter_map(|k| Some(format!("{k} = {:?}", along(k)?))).collect();
        model.extend(at.get("lambda_rotation").map(|ratio| format!("lambda_rotation = {ratio:?}")));
        let cap = rung.distance_cap.max(at["cap"]);
        let _ = write!(
            text,
            "\n[[{table}]]\nsteps = {}\ndistance_cap = {cap:?}\nkernel = {{ huber = {{ delta = {:?} }} }}\n",
            rung.steps, rung.huber
        );
        if !model.is_empty() {
            let _ = writeln!(text, "model = {{ {} }}", model.join(", "));
        }
        if let Some(weight) = along("landmarks") {
            let _ =
                writeln!(text, "terms.landmarks = {{ weight = {weight:?}, kernel = {{ huber = {{ delta = 3.0 }} }} }}");
        }
        if at.contains_key("lambda_unseen") {
            text += "terms.seam = { weight = 0.3 }\n";
        }
    }
    text
}

/// From `first` to `last` over so many levels, then constant; two digits. The logarithm falls with the square root of the level:
/// what a stiff start is for, the pose and the large deviations, is done after one level, and the details need the others.
fn ramp(first: f64, last: f64, level: usize, levels: usize) -> f64 {
    let t = level.min(levels - 1) as f64 / (levels - 1) as f64;
    let value = first * (last / first).powf(t.sqrt());
    let digit = 10f64.powf(value.log10().floor() - 1.0);
    let rounded = (value / digit).round() * digit;
    format!("{rounded:.6}").parse().unwrap_or(rounded)
}

/// What a search found.
#[derive(Debug, Clone)]
pub struct Found {
    /// The model.
    pub model: ModelKind,
    /// The best schedule as TOML.
    pub schedule: String,
    /// Mean over the cases of its rmse plus off-surface error, millimetres.
    pub objective: f64,
    /// Evaluations spent.
    pub evaluations: usize,
}

/// Searches the schedule of one model; `log` sees every evaluation: its values by axis and its objective.
///
/// # Errors
/// When a schedule cannot be used.
pub fn search(
    model: ModelKind,
    cases: &[BenchCase],
    budget: usize,
    mut log: impl FnMut(&[(&'static str, f64)], f64),
) -> Result<Found> {
    let axes = axes(model);
    let named = |values: &[f64]| axes.iter().map(|a| a.name).zip(values.iter().copied()).collect::<Vec<_>>();
    let (values, objective, evaluations) = descend(&axes, budget, |values| {
        let values = named(values);
        let text = schedule_text(model, &values.iter().copied().collect());
        let objective = objective(model, &Schedule::from_toml(&text)?, cases);
        log(&values, objective);
        Ok(objective)
    })?;
    let schedule = schedule_text(model, &named(&values).into_iter().collect());
    Ok(Found { model, schedule, objective, evaluations })
}

/// Coordinate descent on the grid, at most `budget` evaluations: the best values, their objective, and the evaluations spent.
fn descend(
    axes: &[Axis],
    budget: usize,
    mut objective: impl FnMut(&[f64]) -> Result<f64>,
) -> Result<(Vec<f64>, f64, usize)> {
    let values = |at: &[usize]| axes.iter().zip(at).map(|(a, &i)| a.grid[i]).collect::<Vec<f64>>();
    let mut at: Vec<usize> = axes.iter().map(|a| a.start).collect();
    let mut best = objective(&values(&at))?;
    let mut known = HashMap::from([(at.clone(), best)]);
    loop {
        let before = at.clone();
        for k in 0..axes.len() {
            for step in [1, -1] {
                let start = at[k];
                while let Some(i) = at[k].checked_add_signed(step).filter(|i| *i < axes[k].grid.len()) {
                    let trial = [&at[..k], &[i], &at[k + 1..]].concat();
                    let value = match known.get(&trial) {
                        Some(&value) => value,
                        None if known.len() >= budget => return Ok((values(&at), best, known.len())),
                        None => objective(&values(&trial))?,
                    };
                    known.insert(trial.clone(), value);
                    if value >= GAIN * best {
                        break;
                    }
                    (best, at) = (value, trial);
                }
                if at[k] != start {
                    break;
                }
            }
        }
        if at == before {
            return Ok((values(&at), best, known.len()));
        }
    }
}

/// Mean over the cases of rmse plus its part along the normal; infinite where a registration fails.
fn objective(model: ModelKind, schedule: &Schedule, cases: &[BenchCase]) -> f64 {
    let run = |case: &BenchCase| {
        run_case(&model, &TERMS, schedule, case, LandmarkUse::All)
            .map_or(f64::INFINITY, |(score, ..)| score.errors.rmse + score.errors.normal)
    };
    let errors: Vec<f64> = cases.par_iter().map(run).collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// What to search.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Example: a short search for one model\n  \
    experiments dev search-schedules --models graph --budget 4 --vertices 1000 --out out/short-search")]
pub struct Options {
    /// Models to search
    #[arg(long, value_delimiter = ',', default_values_t = searched(), value_parser = searched_model)]
    models: Vec<ModelKind>,
    /// Seeds, six cases from each
    #[arg(long, value_delimiter = ',', default_values_t = [101])]
    seeds: Vec<u64>,
    /// Vertices of the template, about
    #[arg(long, default_value_t = 3500, value_parser = clap::value_parser!(u32).range(1000..=100_000))]
    vertices: u32,
    /// Evaluations for each model
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    budget: u32,
    /// Where log and schedules go
    #[arg(long, value_name = "DIR", default_value = "out/schedule-search")]
    out: std::path::PathBuf,
    /// Threads [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

fn searched_model(name: &str) -> Result<ModelKind, String> {
    let model = name.parse()?;
    if searched().contains(&model) { Ok(model) } else { Err(format!("the schedule of '{model}' is not searched")) }
}

/// Searches and writes `MODEL.toml` for each model and `search.csv`.
///
/// # Errors
/// A [`Failure`](nonrigid::console::Failure) when something cannot be written; anything else is a failed computation.
pub fn run(options: &Options) -> Result<()> {
    let Options { models, seeds, vertices, budget, out, .. } = options;
    each_once("--models", models)?;
    each_once("--seeds", seeds)?;
    make_output_folder(out, [], &[])?;
    say(format_args!(
        "{} models, six cases of each of seeds {seeds:?}, {vertices} vertices, {budget} evaluations each",
        models.len()
    ))?;
    let mut cases = Vec::new();
    for &seed in seeds {
        cases.extend(standard_cases(*vertices as usize, TRIANGLES, seed)?);
    }
    let mut rows = "model,evaluation,axes,mean_rmse_plus_off\n".to_owned();
    for &model in models {
        let mut count = 0;
        let found = search(model, &cases, *budget as usize, |values, objective| {
            count += 1;
            let values: Vec<String> = values.iter().map(|(name, v)| format!("{name} {v}")).collect();
            tell(format_args!("{model:12} {count:3}  {objective:.4} mm  {}", values.join(", ")));
            let _ = writeln!(rows, "{model},{count},{},{objective:.6}", values.join("; "));
        })?;
        say(format_args!("{model}: {:.4} mm after {} evaluations", found.objective, found.evaluations))?;
        write_file(&out.join(format!("{model}.toml")), &found.schedule)?;
        write_file(&out.join("search.csv"), &rows)?;
    }
    say(format_args!("schedules and search.csv are in {}", out.display()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_corner_of_every_models_grid_is_a_schedule() {
        for model in searched() {
            for end in [|a: &Axis| a.grid[0], |a: &Axis| a.grid[a.start], |a: &Axis| a.grid[a.grid.len() - 1]] {
                let at = axes(model).iter().map(|a| (a.name, end(a))).collect();
                let schedule =
                    Schedule::from_toml(&schedule_text(model, &at)).unwrap_or_else(|e| panic!("{model}: {e}"));
                schedule.resolved(&model, &TERMS).unwrap_or_else(|e| panic!("{model}: {e}"));
                assert_eq!(
                    (schedule.levels.len(), schedule.then.is_some()),
                    (LADDER.len(), model == ModelKind::Sequential)
                );
                let landmarks: Vec<f64> = schedule.levels.iter().map(|l| l.term("landmarks").unwrap()).collect();
                assert_eq!((landmarks[0], landmarks[5]), (at["landmarks first"], at["landmarks last"]));
            }
        }
    }

    #[test]
    fn axes_ascend_and_start_inside() {
        for axis in searched().into_iter().flat_map(axes) {
            assert!(axis.grid.is_sorted() && axis.start < axis.grid.len(), "{axis:?}");
        }
    }

    #[test]
    fn descent_finds_the_minimum_of_a_bowl_and_keeps_to_its_budget() {
        const GRID: &[f64] = &[-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0];
        let axes = ["x", "y"].map(|name| Axis { name, grid: GRID, start: 0 });
        let mut count = 0;
        let mut bowl = |v: &[f64]| {
            count += 1;
            Ok(1.0 + (v[0] - 1.0).powi(2) + (v[1] + 1.0).powi(2) + 0.2 * v[0] * v[1])
        };
        let (values, best, evaluations) = descend(&axes, 100, &mut bowl).unwrap();
        assert_eq!((values, best), (vec![1.0, -1.0], 0.8));
        let (_, partial, spent) = descend(&axes, 4, &mut bowl).unwrap();
        assert!(spent == 4 && partial > best);
        assert_eq!(count, evaluations + spent);
    }
}
