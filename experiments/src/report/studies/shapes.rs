//! Fig. 4: time of a registration against the number of blendshapes.

use anyhow::Result;
use nonrigid::mesh::{PolygonMesh, PoseKind, Vec3};
use nonrigid::registration::{ModelKind, Schedule};
use nonrigid::rig::{Population, Rig, ShapeBasis, ShapePca, ShapeSelection};
use rand::seq::{IndexedRandom as _, SliceRandom as _};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use crate::generated::{ScanOptions, Shot, Studio};
use crate::plots::{Axis, Grid, LinearFit, Plot, Point, Series};
use crate::report::study::{
    Block, ERROR_COLUMNS, Section, Setting, Study, cpu_seconds, error_cells, mean_point, register_variant, spread,
};
use crate::report::table::{Table, counted, number, shown};
use crate::scan_bench::{BenchCase, Variant};
use crate::tables::grouped;
use crate::{add_shape, families};

pub const STUDY: Study = Study {
    name: "shapes",
    title: "Fig. 4: time against the number of blendshapes",
    about: "Varied: the number of blendshapes, principal components of random faces, those of largest variance first, as in the \
            paper; and how derivatives are taken: the paper's way, every residual by all of its parameters, and ours, where no \
            dual number carries a blendshape weight. Held: template, 400 nodes, scans (of random people, or your own), the hybrid's \
            schedule. Measured: the processor time of a whole registration on one thread and of one of its iterations, the least of \
            the repetitions, with its range over the scans, and the error. Beside it: as many of the raw shapes, drawn at random.",
    tables: &["shapes", "shapes.timing", "shapes-fit.timing"],
    seconds: |effort| {
        let ours = 0.75 * (effort.components.len() + effort.components_of_paper.len()) as f64;
        let papers = effort.components_of_paper.iter().map(|k| 1.9 + 0.01 * *k as f64).sum::<f64>();
        effort.vertices as f64 / 5000.0 * (5.0 + (ours + papers) * (effort.scans * effort.repetitions) as f64)
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
    repetition: usize,
}

/// The rig whose shapes are offered, faces of random people in it, and scans.
struct Source {
    rig: Rig,
    template: PolygonMesh,
    faces: Vec<Vec<Vec3>>,
    scans: Vec<BenchCase>,
}

fn run(setting: &Setting<'_>) -> Result<Section> {
    let effort = setting.effort;
    let Source { rig, template, faces, mut scans } = source(setting)?;
    let most = effort.components.iter().chain(&effort.components_of_paper).copied().max().unwrap_or(1);
    let mut population = Population::new(faces)?;
    population.align(PoseKind::Rigid)?;
    let pca = ShapePca::fit(&population, most)?;
    let (components, _) = pca.to_rig(Some(&template))?;
    // A fit starts from the mean face.
    scans.iter_mut().for_each(|scan| scan.neutral = Some(pca.mean().to_vec()));

    let mut runs = Vec::new();
    for scan in 0..scans.len() {
        let mut all = |family, paper, sizes: &[usize], most: usize, repetitions| {
            for &components in sizes.iter().filter(|size| **size <= most) {
                runs.extend((0..repetitions).map(|repetition| Run { family, components, scan, paper, repetition }));
            }
        };
        let most = components.shapes().len();
        all("pca", false, &effort.components, most, effort.repetitions);
        all("pca", true, &effort.components_of_paper, most, effort.repetitions);
        all("raw", false, &effort.components_of_paper, rig.shapes().len(), 1);
    }
    let outcomes = setting.run_each_on_one_thread(&runs, |run| {
        let mut case = scans[run.scan].clone();
        case.shapes = match run.family {
            "pca" => components.select(ShapeSelection { names: Some(&[]), identity_modes: run.components })?,
            _ => raw_shapes(&rig, run.components, setting.seed)?,
        };
        let variant = Variant { schedule: schedule(run.paper)?, ..Variant::of_model(ModelKind::Hybrid)? };
        let (registered, seconds) = cpu_seconds(|| register_variant(&variant, &case))?;
        let (score, result, _) = registered?;
        anyhow::Ok((score, seconds, result.history.len()))
    })?;
    let columns = [&["family", "shapes", "scan", "differentiation"][..], &ERROR_COLUMNS].concat();
    let mut table = Table::new(&columns);
    let of_time =
        ["family", "shapes", "scan", "differentiation", "repetition", "cpu_seconds", "cpu_seconds_per_iteration"];
    let mut times = Table::new(&of_time);
    for (run, outcome) in runs.iter().zip(outcomes) {
        let (score, seconds, steps) = outcome?;
        let of = [
            run.family.into(),
            run.components.to_string(),
            run.scan.to_string(),
            if run.paper { "paper" } else { "ours" }.into(),
        ];
        let measured = [run.repetition.to_string(), number(seconds), number(seconds / steps as f64)];
        times.push([&of[..], &measured].concat());
        if run.repetition == 0 {
            table.push([&of[..], &error_cells(Some(&score))].concat());
        }
    }
    table.write(setting.out, "shapes")?;
    times.write(setting.out, "shapes.timing")?;
    let fits = fits(&times, scans.len())?;
    fits.write(setting.out, "shapes-fit.timing")?;

    let whole = time_plot("Whole registration", "cpu_seconds", &times, 1.0, "seconds of one core")?;
    let each = time_plot("One iteration", "cpu_seconds_per_iteration", &times, 1e3, "milliseconds of one core")?;
    let error = error_plot(&table)?;
    let caption = format!(
        "Fig. 4: processor time of a registration against the number of blendshapes, template of {} vertices, one thread, least of {}; \
         and the error beside it. Points: mean over n = {}; bars: their range. Dashed: straight lines through the points.",
        template.positions.len(),
        counted(effort.repetitions, "repetition"),
        counted(scans.len(), "scan"),
    );
    let figure = setting.plot("shapes", &Grid { columns: 2, plots: vec![whole, each, error] }.svg()?, caption)?;
    let caption = "A straight line through the times of each scan: slope and its error, share of the variance explained, the largest \
                   departure from the line against what it rises by, and what the last number of shapes takes over the first.";
    let mean = |of: &str, column: &str| -> Result<f64> {
        Ok(spread(&fits.numbers(&[("differentiation", of), ("quantity", "registration")], column)?).0)
    };
    let finding = format!(
        "A further shape costs {} ms of one core as in the paper and {} ms by our differentiation; the paper's times lie within {} % \
         of a straight line's rise.",
        shown(1e3 * mean("paper", "seconds_per_shape")?),
        shown(1e3 * mean("ours", "seconds_per_shape")?),
        shown(100.0 * mean("paper", "departure")?)
    );
    let fitted = Block::Table { table: fits, caption: caption.into(), file: "shapes-fit.timing.csv".into() };
    Ok(Section { finding, blocks: vec![figure, fitted] })
}

/// Random people with random expressions: of the user's rig, whose cases are the scans, or else of generated ones.
fn source(setting: &Setting<'_>) -> Result<Source> {
    let (effort, data) = (setting.effort, setting.data);
    if !data.generated {
        let rig = data.rig.rig().clone();
        let faces = linear_faces(&rig, effort.population, setting.seed);
        let scans = data.cases.iter().take(effort.scans).cloned().collect();
        return Ok(Source { rig, template: data.rig.template().clone(), faces, scans });
    }
    let studio = Studio::new(effort.vertices)?;
    let scans = (0..effort.scans).map(|k| scan(&studio, setting, k)).collect::<Result<_>>()?;
    let faces = studio.random_faces(effort.population, setting.seed);
    Ok(Source { rig: studio.rig().clone(), template: studio.template().clone(), faces, scans })
}

/// The neutral with five expressions of 0.2 to 1, and every identity mode by a normal weight.
fn linear_faces(rig: &Rig, count: usize, seed: u64) -> Vec<Vec<Vec3>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (expressions, identities) = families(rig);
    let mut face = || {
        let mut weights: Vec<(usize, f64)> = identities.iter().map(|k| (*k, StandardNormal.sample(&mut rng))).collect();
        let shown = expressions.choose_multiple(&mut rng, 5).copied().collect::<Vec<_>>();
        weights.extend(shown.into_iter().map(|k| (k, rng.random_range(0.2..1.0))));
        let mut positions = rig.neutral().to_vec();
        for (k, weight) in weights {
            add_shape(&mut positions, rig, k, weight);
        }
        positions
    };
    (0..count).map(|_| face()).collect()
}

/// A random person with a random expression.
fn scan(studio: &Studio, setting: &Setting<'_>, k: usize) -> Result<BenchCase> {
    let scan = ScanOptions { triangles: setting.effort.triangles, identity_sigma: 1.0, ..ScanOptions::default() };
    let seed = setting.seed + SCAN_SEEDS + k as u64;
    studio.shoot(&Shot { name: format!("random{k}"), scan, known: false, withheld: Vec::new(), seed })
}

/// So many of the rig's own shapes, drawn from the seed.
fn raw_shapes(rig: &Rig, count: usize, seed: u64) -> Result<ShapeBasis> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..rig.shapes().len()).collect();
    order.shuffle(&mut rng);
    order.truncate(count);
    order.sort_unstable();
    let shapes: Vec<_> = order.iter().map(|k| rig.shapes()[*k].clone()).collect();
    let deltas = order.iter().flat_map(|k| rig.deltas(*k).iter().copied()).collect();
    let chosen = Rig::new(rig.neutral().to_vec(), rig.mesh().cloned(), shapes, deltas)?.0;
    Ok(chosen.select(ShapeSelection { names: None, identity_modes: chosen.identity_modes() })?)
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
    Ok(grouped(table.numbers(rows, "shapes")?.into_iter().zip(table.numbers(rows, column)?)))
}

/// Times of a differentiation with principal components: for each number of them, the least of the repetitions on each scan.
fn times_of(times: &Table, differentiation: &str, column: &str) -> Result<Vec<(f64, Vec<f64>)>> {
    let rows = [("family", "pca"), ("differentiation", differentiation)];
    let of_scans = times.numbers(&rows, "scan")?.into_iter().zip(times.numbers(&rows, column)?);
    let least = |(_, repetitions): (f64, Vec<f64>)| repetitions.into_iter().reduce(f64::min).unwrap_or(f64::NAN);
    let found = grouped(times.numbers(&rows, "shapes")?.into_iter().zip(of_scans));
    Ok(found.into_iter().map(|(x, of_scans)| (x, grouped(of_scans).into_iter().map(least).collect())).collect())
}

const DIFFERENTIATIONS: [(&str, &str); 2] = [("paper", "as in the paper"), ("ours", "ours")];

fn time_plot(title: &str, column: &str, times: &Table, worth: f64, unit: &str) -> Result<Plot> {
    let mut plot =
        Plot::new(title, Axis::linear("blendshapes (PCA components)").from_zero(), Axis::linear(unit).from_zero());
    for (key, name) in DIFFERENTIATIONS {
        let points: Vec<Point> = times_of(times, key, column)?
            .into_iter()
            .map(|(x, seconds)| mean_point(x, &seconds.iter().map(|s| worth * s).collect::<Vec<_>>()))
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

/// A straight line through the times of each scan: is the time linear, and how steep?
fn fits(times: &Table, scans: usize) -> Result<Table> {
    let mut table = Table::new(&[
        "differentiation",
        "quantity",
        "scan",
        "seconds_per_shape",
        "standard_error",
        "seconds_without_shapes",
        "r_squared",
        "departure",
        "last_over_first",
        "growing_share",
    ]);
    for (key, _) in DIFFERENTIATIONS {
        for (quantity, column) in [("registration", "cpu_seconds"), ("iteration", "cpu_seconds_per_iteration")] {
            let all = times_of(times, key, column)?;
            for scan in 0..scans {
                let points: Vec<[f64; 2]> = all.iter().map(|(x, times)| [*x, times[scan]]).collect();
                let Some(fit) = LinearFit::fit(&points) else { continue };
                let [first, last] = [points[0], points[points.len() - 1]];
                let growing = fit.slope * last[0] / (fit.intercept + fit.slope * last[0]);
                let numbers = [
                    fit.slope,
                    fit.slope_error,
                    fit.intercept,
                    fit.r_squared,
                    fit.departure,
                    last[1] / first[1],
                    growing,
                ];
                let mut row = vec![key.to_owned(), quantity.to_owned(), scan.to_string()];
                row.extend(numbers.map(number));
                table.push(row);
            }
        }
    }
    Ok(table)
}
