//! Sweeps: one difficulty at a time, from none to too much, for every model.

use anyhow::Result;
use nonrigid::mesh::Vec3;
use nonrigid::registration::ModelKind;

use crate::generated::{ScanOptions, Shot, Studio};
use crate::plots::{Axis, Grid, Plot, Point};
use crate::random_pose::random_pose;
use crate::report::study::{
    Block, ERROR_COLUMNS, Section, Setting, Study, error_cells, error_text, mean_point, model_line,
};
use crate::report::table::{Table, number};
use crate::scan_bench::{BenchCase, LandmarkUse, Score};

pub const STUDY: Study = Study {
    name: "sweeps",
    title: "Where each model breaks",
    about: "Varied, one at a time: how far the mouth is open, how far the eyes are closed, how wrong the start is turned, noise, the size of holes, outliers, and \
            how many of the shown expressions the rig lacks; for every model. Held: everything else, at moderate values. \
            Landmarks give the start alone, as the paper uses none. (Per-vertex affine maps take part only with --full: ten seconds a \
            registration.) Measured: errors over the observed vertices; mean and range \
            over several people.",
    tables: &["sweeps", "breaks"],
    seconds: |effort| {
        let scans = SWEEPS.len() * effort.sweep_values * effort.sweep_scans;
        let affine = if effort.sweep_models.contains(&ModelKind::Affine) { 5.0 } else { 0.0 };
        scans as f64 * effort.sweep_vertices as f64 / 2000.0 * (0.3 * effort.sweep_models.len() as f64 + affine)
    },
    run,
};

/// One difficulty.
struct Sweep {
    name: &'static str,
    /// The quantity with its unit.
    axis: &'static str,
    /// From the easiest to the hardest value.
    range: [f64; 2],
    /// Makes a moderate case so difficult.
    set: fn(&mut Trial, f64),
}

/// A case that is about to be made, and how wrong its start will be.
struct Trial {
    shot: Shot,
    /// Degrees about a random axis through the face.
    start_turned: f64,
}

const SWEEPS: [Sweep; 7] = [
    Sweep { name: "jaw", axis: "jaw opening / %", range: [0.0, 100.0], set: |t, v| t.show_alone("jawOpen", v / 100.0) },
    Sweep {
        name: "eyes",
        axis: "eyes closed / %",
        range: [0.0, 100.0],
        set: |t, v| t.show_alone("eyeBlink", v / 100.0),
    },
    Sweep { name: "start", axis: "start turned by / degrees", range: [0.0, 60.0], set: |t, v| t.start_turned = v },
    Sweep { name: "noise", axis: "noise / mm", range: [0.0, 2.0], set: |t, v| t.shot.scan.noise = v },
    Sweep {
        name: "holes",
        axis: "radius of 4 holes / mm",
        range: [0.0, 32.0],
        set: |t, v| {
            t.shot.scan.holes = if v > 0.0 { 4 } else { 0 };
            t.shot.scan.hole_radius = [v, v];
        },
    },
    Sweep {
        name: "outliers",
        axis: "outliers / % of the triangles",
        range: [0.0, 20.0],
        set: |t, v| t.shot.scan.outliers = v / 100.0,
    },
    Sweep {
        name: "missing",
        axis: "shown shapes that the rig lacks / %",
        range: [0.0, 100.0],
        set: |t, v| t.withhold(v / 100.0),
    },
];

/// What every face does unless a sweep says otherwise: a few strong expressions.
const EXPRESSION: [(&str, f64); 4] = [("jawOpen", 0.6), ("mouthSmile", 0.5), ("browOuterUp", 0.7), ("eyeBlink", 0.8)];

impl Trial {
    fn moderate(triangles: usize, seed: u64) -> Self {
        let expressions = EXPRESSION.map(|(name, weight)| (name.to_owned(), weight)).to_vec();
        let scan = ScanOptions { expressions: Some(expressions), triangles, ..ScanOptions::default() };
        Self { shot: Shot { name: String::new(), scan, known: true, withheld: Vec::new(), seed }, start_turned: 0.0 }
    }

    fn show_alone(&mut self, expression: &str, weight: f64) {
        self.shot.scan.expressions = Some(vec![(expression.to_owned(), weight)]);
    }

    /// Withholds a share of the shown expressions, from the first.
    fn withhold(&mut self, share: f64) {
        let shown: Vec<&str> = EXPRESSION.iter().map(|e| e.0).collect();
        let count = (share * shown.len() as f64).round() as usize;
        self.shot.withheld = shown[..count].iter().map(|name| (*name).to_owned()).collect();
    }

    /// Makes the case, and turns the landmarks, which give the start alone, about their middle.
    fn make(&self, studio: &Studio) -> Result<BenchCase> {
        let mut case = studio.shoot(&self.shot)?;
        let targets = || case.landmarks.iter().map(|l| l.target);
        let middle = targets().sum::<Vec3>() / case.landmarks.len().max(1) as f64;
        let turn = random_pose(self.start_turned, 0.0, self.shot.seed, 1);
        case.landmarks.iter_mut().for_each(|l| l.target = turn.apply(l.target - middle) + middle);
        Ok(case)
    }
}

/// An error up to which a model counts as whole, millimetres; and how much worse than at its easiest value it may get.
const WHOLE: f64 = 1.0;
const WORSE: f64 = 2.0;
/// Plots end here, millimetres.
const TOP: f64 = 8.0;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let effort = setting.effort;
    let studio = Studio::new(effort.sweep_vertices)?;
    let entrants = setting.entrants(&effort.sweep_models)?;
    let last = (effort.sweep_values - 1).max(1) as f64;
    let values = |s: &Sweep| -> Vec<f64> {
        (0..effort.sweep_values).map(|k| s.range[0] + (s.range[1] - s.range[0]) * k as f64 / last).collect()
    };
    let scans = |(sweep, value): (usize, f64)| (0..effort.sweep_scans as u64).map(move |scan| (sweep, value, scan));
    let jobs: Vec<(usize, f64, u64)> = SWEEPS
        .iter()
        .enumerate()
        .flat_map(|(k, s)| values(s).into_iter().map(move |v| (k, v)))
        .flat_map(scans)
        .collect();

    let outcomes = setting.run_all(&jobs, |&(sweep, value, scan)| -> Result<Vec<Result<Score>>> {
        let mut trial = Trial::moderate(effort.sweep_triangles, setting.seed + scan);
        (SWEEPS[sweep].set)(&mut trial, value);
        let case = trial.make(&studio)?;
        Ok(entrants.iter().map(|e| e.register(&case, LandmarkUse::Align).map(|r| r.0)).collect())
    });

    let columns = [&["sweep", "value", "model", "scan"][..], &ERROR_COLUMNS, &["error"]].concat();
    let mut table = Table::new(&columns);
    for (&(sweep, value, scan), rows) in jobs.iter().zip(outcomes) {
        for (entrant, row) in entrants.iter().zip(rows?) {
            let mut cells =
                vec![SWEEPS[sweep].name.to_owned(), number(value), entrant.name().to_owned(), scan.to_string()];
            cells.extend(error_cells(row.as_ref().ok()));
            cells.push(error_text(&row));
            table.push(cells);
        }
    }
    table.write(setting.out, "sweeps")?;

    let mut plots = Vec::new();
    let mut breaks = Table::new(&[&["model"][..], &SWEEPS.map(|s| s.axis)].concat());
    let mut broken: Vec<Vec<String>> = entrants.iter().map(|e| vec![e.name().to_owned()]).collect();
    for sweep in &SWEEPS {
        let mut series = Vec::new();
        for (entrant, broken) in entrants.iter().zip(&mut broken) {
            let mut points = Vec::new();
            for value in values(sweep) {
                let rows = [("sweep", sweep.name), ("value", &number(value)), ("model", entrant.name())];
                points.push(mean_point(value, &table.numbers(&rows, "rmse")?));
            }
            broken.push(breaks_at(&points));
            series.push(model_line(entrant.name(), points));
        }
        let y = Axis::linear("rmse / mm").from_zero();
        plots.push(Plot::new(sweep.name, Axis::linear(sweep.axis), y).series(series).top(TOP));
    }
    broken.into_iter().for_each(|row| breaks.push(row));
    breaks.write(setting.out, "breaks")?;
    let caption = format!(
        "Error against one difficulty at a time; mean and range over {}. Above {TOP} mm: off the plot. Landmarks give \
         the start alone.",
        people(effort.sweep_scans)
    );
    let figure = setting.plot("sweeps", &Grid { columns: 2, plots }.svg()?, caption)?;
    let caption = format!(
        "Where each model breaks: the first value at which its mean error exceeds {WHOLE} mm and {WORSE} times that at the easiest \
         value. 'never' within the range; 'at once': its error is above {} mm from the start.",
        2.0 * WHOLE
    );
    let breaking = |row: &Vec<String>| format!("{} in {}", row[0], row[1..].iter().filter(|c| *c != "never").count());
    let finding = format!(
        "Of {} difficulties each model breaks: {}.",
        SWEEPS.len(),
        breaks.rows.iter().map(breaking).collect::<Vec<_>>().join(", ")
    );
    Ok(Section { finding, blocks: vec![figure, Block::Table { table: breaks, caption, file: "breaks.csv".into() }] })
}

fn people(count: usize) -> String {
    if count == 1 { "one person".to_owned() } else { format!("n = {count} people") }
}

fn breaks_at(points: &[Point]) -> String {
    let easiest = points.first().map_or(f64::NAN, |p| p.y);
    if easiest.is_nan() || easiest > 2.0 * WHOLE {
        return format!("at once ({easiest:.1} mm)");
    }
    // A failure, not a number, breaks too.
    let whole = |p: &&Point| p.y <= WHOLE.max(WORSE * easiest);
    points.iter().find(|p| !whole(p)).map_or_else(
        || "never".to_owned(),
        |p| format!("{:.3}", p.x).trim_end_matches('0').trim_end_matches('.').to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_breaks_where_its_error_doubles_and_counts() {
        let at = |errors: &[f64]| {
            let points = errors.iter().enumerate().map(|(k, y)| Point { x: 2.5 * k as f64, y: *y, spread: None });
            breaks_at(&points.collect::<Vec<_>>())
        };
        assert_eq!(at(&[0.5, 0.9, 1.0]), "never");
        assert_eq!(at(&[0.2, 0.9, 1.1]), "5");
        assert_eq!(at(&[0.8, 1.5, 1.7]), "5");
        assert_eq!(at(&[0.8, f64::NAN, 0.8]), "2.5");
        assert_eq!(at(&[3.0, 3.0, 3.0]), "at once (3.0 mm)");
    }
}
