//! Convergence: energy by term, and error, after every step.

use std::ops::ControlFlow;

use anyhow::Result;
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::Vec3;
use nonrigid::registration::{ModelKind, RegistrationObserver, StepRecord, register};

use crate::plots::{Axis, Grid, Mark, Plot, Point, Series};
use crate::report::study::{Section, Setting, Study, model_line};
use crate::report::table::{Table, number, shown};
use crate::scan_bench::{BenchCase, Variant};

pub const STUDY: Study = Study {
    name: "convergence",
    title: "Convergence: energy by term, error by step",
    about: "Varied: the model. Held: the scan of the most extreme expression, all landmarks, the default schedules. Measured after \
            every step: the energy by term at that step's correspondences, and the error against the truth. Vertical lines: a new \
            level of the schedule, with other weights; energies of different levels do not compare.",
    tables: &["convergence"],
    seconds: |effort| effort.vertices as f64 / 1000.0,
    run,
};

const MODELS: [ModelKind; 5] =
    [ModelKind::Hybrid, ModelKind::Sequential, ModelKind::Blendshape, ModelKind::Graph, ModelKind::Arap];

/// Remembers steps, and the error after each.
struct Watch<'a> {
    case: &'a BenchCase,
    triangles: Vec<[u32; 3]>,
    steps: Vec<(StepRecord, f64)>,
}

impl RegistrationObserver for Watch<'_> {
    fn on_step(&mut self, _record: &StepRecord) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn wants_positions(&self) -> bool {
        true
    }

    fn on_positions(&mut self, record: &StepRecord, positions: &[Vec3]) {
        let errors = TruthErrors::new(positions, &self.case.truth, &self.case.observed, &self.triangles);
        self.steps.push((record.clone(), errors.map_or(f64::NAN, |e| e.0.rmse)));
    }
}

fn run(setting: &Setting<'_>) -> Result<Section> {
    let case = setting.data.extreme();
    let variants = Variant::models(&MODELS)?;
    let outcomes = setting.run_all(&variants, |variant| -> Result<Vec<(StepRecord, f64)>> {
        let mut watch = Watch { case, triangles: case.template.triangulate().triangles, steps: Vec::new() };
        register(&case.input(), &variant.model, &variant.schedule, &mut watch)?;
        Ok(watch.steps)
    });

    let mut table = Table::new(&["model", "iteration", "level", "rmse", "inliers", "motion", "term", "energy"]);
    let (mut plots, mut errors, mut ends) = (Vec::new(), Vec::new(), Vec::new());
    for (variant, steps) in variants.iter().zip(outcomes) {
        let steps = steps?;
        for (k, (record, rmse)) in steps.iter().enumerate() {
            let terms = record.energies.iter().map(|(name, e)| (name.as_str(), *e)).chain([("all", record.energy)]);
            for (term, energy) in terms {
                let mut row = vec![variant.name.clone(), (k + 1).to_string(), (record.level + 1).to_string()];
                row.extend([*rmse, record.inliers, record.motion].map(number));
                row.extend([term.to_owned(), number(energy)]);
                table.push(row);
            }
        }
        ends.push((variant.name.clone(), steps.len(), steps.last().map_or(f64::NAN, |s| s.1)));
        let points = steps.iter().enumerate().map(|(k, s)| Point { x: (k + 1) as f64, y: s.1, spread: None });
        errors.push(model_line(&variant.name, points.collect()));
        if plots.len() < 2 {
            plots.push(energies(&variant.name, &steps));
        }
    }
    table.write(setting.out, "convergence")?;
    let plot = Plot::new("Error", Axis::linear("step").from_zero(), Axis::log("rmse / mm")).series(errors);
    plots.insert(0, plot);
    let caption = format!("{}: the error of every model, and the energy of two of them by term.", case.name);
    let ends = ends.iter().map(|(name, steps, rmse)| format!("{name} {} mm after {steps}", shown(*rmse)));
    let finding = format!("Error after all steps: {}.", ends.collect::<Vec<_>>().join(", "));
    Ok(Section { finding, blocks: vec![setting.plot("convergence", &Grid { columns: 1, plots }.svg()?, caption)?] })
}

/// Energy by term against the step, levels marked.
fn energies(model: &str, steps: &[(StepRecord, f64)]) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    let names: Vec<&String> = steps.first().into_iter().flat_map(|s| s.0.energies.iter().map(|e| &e.0)).collect();
    for name in names {
        let energy = |s: &StepRecord| s.energies.iter().find(|e| e.0 == *name).map_or(f64::NAN, |e| e.1);
        let positive = |e: f64| if e > 0.0 { e } else { f64::NAN };
        let points: Vec<Point> = steps
            .iter()
            .enumerate()
            .map(|(k, s)| Point { x: (k + 1) as f64, y: positive(energy(&s.0)), spread: None })
            .collect();
        if points.iter().any(|p| p.y.is_finite()) {
            series.push(Series::line(name, points));
        }
    }
    let starts = steps.windows(2).enumerate().filter(|(_, w)| w[0].0.level != w[1].0.level);
    let marks = starts.map(|(k, w)| Mark { x: k as f64 + 1.5, label: format!("level {}", w[1].0.level + 1) }).collect();
    let title = format!("Energy of {model} by term");
    Plot::new(&title, Axis::linear("step").from_zero(), Axis::log("energy / mm²")).series(series).marks(marks)
}
