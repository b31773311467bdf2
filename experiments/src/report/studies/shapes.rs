//! Fig. 4: time of a registration against the number of blendshapes.

use anyhow::Result;
use nonrigid::evaluation::percentile;
use nonrigid::mesh::{PoseKind, Vec3};
use nonrigid::registration::{ModelKind, Schedule};
use nonrigid::rig::{Population, Rig, ShapeBasis, ShapePca, ShapeSelection};
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use crate::generated::{ScanOptions, Shot, Studio};
use crate::plots::{Axis, Grid, LinearFit, Plot, Point, Series};
use crate::report::study::{
    Block, ERROR_COLUMNS, Section, Setting, Study, error_cells, mean_point, register_variant, spread,
};
use crate::report::table::{Table, number};
use crate::scan_bench::{BenchCase, LandmarkUse, Variant};

pub const STUDY: Study = Study {
    name: "shapes",
    title: "Fig. 4: time against the number of blendshapes",
    about: "Varied: the number of blendshapes, principal components of random faces, those of largest variance first, as in the \
            paper; and how derivatives are taken: the paper's way, every residual by all of its parameters, and ours, where no \
            dual number carries a blendshape weight. Held: template, 400 nodes, scans of random people, the hybrid's schedule, \
            all cores. Measured: the time of a whole registration and of one of its iterations, with its range over the scans, \
            and the error. Beside it: as many of the raw shapes, drawn at random.",
    tables: &["shapes", "shapes.timing", "shapes-fit.timing"],
    seconds: |effort| {
        let ours = 0.75 * (effort.components.len() + effort.components_of_paper.len()) as f64;
        let papers = effort.components_of_paper.iter().map(|k| 1.9 + 0.01 * *k as f64).sum::<f64>();
        effort.vertices as f64 / 5000.0 * (5.0 + (ours + papers) * effort.scans as f64)
    },
    run,
};

/// Seeds of the scans begin so far above the study's: their people are not those of the standard cases.
const SCAN_SEEDS: u64 = 4000;

/// One registration.
struct Run {
    family: &'static str,
    components: usize,
    scan: usize,
    paper: bool,
}

fn run(setting: &Setting<'_>) -> Result<Section> {
    let effort = setting.effort;
    let studio = Studio::new(effort.vertices)?;
    let most = effort.components.iter().chain(&effort.components_of_paper).copied().max().unwrap_or(1);
    let mut population = Population::new(studio.random_faces(effort.population, setting.seed))?;
    population.align(PoseKind::Rigid)?;
    let pca = ShapePca::fit(&population, most)?;
    let (components, _) = pca.to_rig(Some(studio.template()))?;
    let scans = (0..effort.scans).map(|k| scan(&studio, setting, k, pca.mean())).collect::<Result<Vec<_>>>()?;

    let mut runs = Vec::new();
    for scan in 0..effort.scans {
        let all = |family, paper, sizes: &[usize]| -> Vec<Run> {
            sizes.iter().map(|&components| Run { family, components, scan, paper }).collect()
        };
        runs.extend(all("pca", false, &effort.components));
        runs.extend(all("pca", true, &effort.components_of_paper));
        runs.extend(all("raw", false, &effort.components_of_paper));
    }
    let columns = [&["family", "shapes", "scan", "differentiation"][..], &ERROR_COLUMNS].concat();
    let mut table = Table::new(&columns);
    let mut times = Table::new(&["family", "shapes", "scan", "differentiation", "seconds", "seconds_per_iteration"]);
    setting.progress.set_length(runs.len() as u64);
    // One after the other, on all cores: the clock runs.
    for run in &runs {
        let mut case = scans[run.scan].clone();
        case.shapes = match run.family {
            "pca" => components.select(ShapeSelection { names: Some(&[]), identity_modes: run.components })?,
            _ => raw_shapes(&studio, run.components, setting.seed)?,
        };
        let variant = Variant {
            schedule: schedule(run.paper)?,
            landmarks: LandmarkUse::All,
            ..Variant::of_model(ModelKind::Hybrid)?
        };
        let (score, result, seconds) = register_variant(&variant, &case)?;
        let of = [
            run.family.into(),
            run.components.to_string(),
            run.scan.to_string(),
            if run.paper { "paper" } else { "ours" }.into(),
        ];
        times.push([&of[..], &[number(seconds), number(seconds / result.history.len() as f64)]].concat());
        table.push([&of[..], &error_cells(Some(&score))].concat());
        setting.progress.inc(1);
    }
    table.write(setting.out, "shapes")?;
    times.write(setting.out, "shapes.timing")?;
    let fits = fits(&times)?;
    fits.write(setting.out, "shapes-fit.timing")?;

    let whole = time_plot("Whole registration", "seconds", &times, 1.0, "seconds")?;
    let each = time_plot("One iteration", "seconds_per_iteration", &times, 1e3, "milliseconds")?;
    let error = error_plot(&table)?;
    let caption = format!(
        "Fig. 4: mean time of the algorithm against the number of blendshapes, template of {} vertices, {} scans, {} threads; and \
         the error beside it. Bars: range over the scans.",
        studio.template().positions.len(),
        effort.scans,
        rayon::current_num_threads()
    );
    let figure = setting.plot("shapes", &Grid { columns: 2, plots: vec![whole, each, error] }.svg()?, caption)?;
    let caption = "Straight lines through the times: slope and what the last adds to the first, share of the variance explained, and \
                   how likely so much curvature is by chance (below 0.05: not a line).";
    let fitted = Block::Table { table: fits, caption: caption.into(), file: "shapes-fit.timing.csv".into() };
    Ok(Section { blocks: vec![figure, fitted] })
}

/// A random person with a random expression; a fit starts from the mean face.
fn scan(studio: &Studio, setting: &Setting<'_>, k: usize, mean: &[Vec3]) -> Result<BenchCase> {
    let scan = ScanOptions { triangles: setting.effort.triangles, identity_sigma: 1.0, ..ScanOptions::default() };
    let seed = setting.seed + SCAN_SEEDS + k as u64;
    let mut case =
        studio.shoot(&Shot { name: format!("random{k}"), scan, known: false, withheld: Vec::new(), seed })?;
    case.neutral = Some(mean.to_vec());
    Ok(case)
}

/// So many of the rig's own shapes, drawn from the seed.
fn raw_shapes(studio: &Studio, count: usize, seed: u64) -> Result<ShapeBasis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rig = studio.rig();
    let mut order: Vec<usize> = (0..rig.shapes().len()).collect();
    order.shuffle(&mut rng);
    order.truncate(count);
    order.sort_unstable();
    let shapes: Vec<_> = order.iter().map(|k| rig.shapes()[*k].clone()).collect();
    let deltas = order.iter().flat_map(|k| rig.deltas(*k).iter().copied()).collect();
    let chosen = Rig::new(rig.neutral().to_vec(), rig.mesh().cloned(), shapes, deltas)?.0;
    let modes = chosen.shapes().iter().filter(|s| s.family == nonrigid::rig::Family::Identity).count();
    Ok(chosen.select(ShapeSelection { names: None, identity_modes: modes })?)
}

fn schedule(paper: bool) -> Result<Schedule> {
    let mut schedule = ModelKind::Hybrid.schedule()?;
    if paper {
        schedule.model.set("linearisation", "reference");
    }
    Ok(schedule)
}

/// Numbers of a column by number of shapes, in the order of the table: (shapes, one number for each scan).
fn by_shapes(table: &Table, rows: &[(&str, &str)], column: &str) -> Result<Vec<(f64, Vec<f64>)>> {
    let (shapes, numbers) = (table.numbers(rows, "shapes")?, table.numbers(rows, column)?);
    let mut found: Vec<(f64, Vec<f64>)> = Vec::new();
    for (x, y) in shapes.into_iter().zip(numbers) {
        match found.iter_mut().find(|f| f.0 == x) {
            Some(f) => f.1.push(y),
            None => found.push((x, vec![y])),
        }
    }
    Ok(found)
}

/// Times of a differentiation with principal components.
fn times_of(times: &Table, differentiation: &str, column: &str) -> Result<Vec<(f64, Vec<f64>)>> {
    by_shapes(times, &[("family", "pca"), ("differentiation", differentiation)], column)
}

fn median(values: &[f64]) -> f64 {
    percentile(values, 50.0).unwrap_or(f64::NAN)
}

const DIFFERENTIATIONS: [(&str, &str); 2] = [("paper", "as in the paper"), ("ours", "ours")];

fn time_plot(title: &str, column: &str, times: &Table, worth: f64, unit: &str) -> Result<Plot> {
    let mut plot =
        Plot::new(title, Axis::linear("blendshapes (PCA components)").from_zero(), Axis::linear(unit).from_zero());
    for (key, name) in DIFFERENTIATIONS {
        let points: Vec<Point> = times_of(times, key, column)?
            .into_iter()
            .map(|(x, seconds)| {
                let (_, range) = spread(&seconds);
                Point { x, y: worth * median(&seconds), spread: Some(range.map(|s| worth * s)) }
            })
            .collect();
        let fit = LinearFit::fit(&points.iter().map(|p| [p.x, p.y]).collect::<Vec<_>>());
        plot = plot.series(vec![Series::line(name, points)]);
        if let Some(fit) = fit {
            plot = plot.line(name, fit);
        }
    }
    Ok(plot)
}

fn error_plot(table: &Table) -> Result<Plot> {
    let mut plot = Plot::new("Error", Axis::linear("blendshapes").from_zero(), Axis::linear("rmse / mm").from_zero());
    for (family, name) in [("pca", "PCA components"), ("raw", "raw shapes, drawn")] {
        let found = by_shapes(table, &[("family", family), ("differentiation", "ours")], "rmse")?;
        let points = found.iter().map(|(x, errors)| mean_point(*x, errors));
        plot = plot.series(vec![Series::line(name, points.collect())]);
    }
    Ok(plot)
}

/// A straight line through each curve: is the time linear, and how steep?
fn fits(times: &Table) -> Result<Table> {
    let mut table = Table::new(&[
        "differentiation",
        "quantity",
        "seconds_per_shape",
        "standard_error",
        "seconds_without_shapes",
        "r_squared",
        "curvature_p",
        "sag",
        "last_over_first",
        "growing_share",
    ]);
    for (key, _) in DIFFERENTIATIONS {
        for quantity in ["seconds", "seconds_per_iteration"] {
            let points: Vec<[f64; 2]> = times_of(times, key, quantity)?.iter().map(|(x, s)| [*x, median(s)]).collect();
            let Some(fit) = LinearFit::fit(&points) else { continue };
            let (p, sag) = fit.curvature.map_or((f64::NAN, f64::NAN), |c| (c.p, c.sag));
            let [first, last] = [points[0], points[points.len() - 1]];
            let growing = fit.slope * last[0] / (fit.intercept + fit.slope * last[0]);
            let numbers =
                [fit.slope, fit.slope_error, fit.intercept, fit.r_squared, p, sag, last[1] / first[1], growing];
            let mut row = vec![key.to_owned(), quantity.to_owned()];
            row.extend(numbers.map(number));
            table.push(row);
        }
    }
    Ok(table)
}
