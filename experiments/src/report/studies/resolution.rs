//! Resolution: finer and finer templates, and coarser and coarser scans.

use anyhow::Result;

use crate::generated::Studio;
use crate::plots::{Axis, Grid, Plot};
use crate::report::study::{
    ERROR_COLUMNS, Section, Setting, Study, error_cells, error_text, mean_point, model_line, ranked, register_variant,
};
use crate::report::table::{Table, counted, shown};
use crate::scan_bench::{LandmarkUse, Variant};
use nonrigid::registration::ModelKind;

pub const STUDY: Study = Study {
    name: "resolution",
    title: "Fine templates and coarse scans",
    about: "Varied: the number of the template's vertices, for models that move vertices and models that move nodes; then the number \
            of the scan's triangles, for the hybrid with the distance from point to plane (3) and from point to point (2). Held: \
            people, expressions, schedules (their weights scale with the template). Landmarks give the start alone. Measured: \
            errors over the observed vertices.",
    tables: &["resolution"],
    seconds: |effort| {
        let vertices: usize = effort.resolutions.iter().sum();
        effort.resolution_cases as f64 * (vertices as f64 / 1000.0 * 1.2 + 1.5 * SCAN_TRIANGLES.len() as f64)
    },
    run,
};

const MODELS: [ModelKind; 4] = [ModelKind::Hybrid, ModelKind::Sequential, ModelKind::Graph, ModelKind::Arap];
/// Triangles of the scans that get coarser.
const SCAN_TRIANGLES: [usize; 4] = [2_000, 6_000, 20_000, 60_000];

/// A registration that is about to be made.
struct Job {
    study: &'static str,
    size: usize,
    case: usize,
    variant: Variant,
}

fn run(setting: &Setting<'_>) -> Result<Section> {
    let effort = setting.effort;
    let align = |mut variants: Vec<Variant>| {
        variants.iter_mut().for_each(|v| v.landmarks = LandmarkUse::Align);
        variants
    };
    let mut jobs = Vec::new();
    let mut add = |study, size, variants: &[Variant]| {
        for case in 0..effort.resolution_cases {
            jobs.extend(variants.iter().map(|v| Job { study, size, case, variant: v.clone() }));
        }
    };
    let models = align(Variant::models(&MODELS)?);
    effort.resolutions.iter().for_each(|vertices| add("template", *vertices, &models));
    let distances = align(plane_and_point()?);
    SCAN_TRIANGLES.iter().for_each(|triangles| add("scan", *triangles, &distances));

    let mut studios = Vec::new();
    for vertices in effort.resolutions.iter().chain([&effort.vertices]) {
        studios.push((*vertices, Studio::new(*vertices)?));
    }
    let outcomes = setting.run_all(&jobs, |job| {
        let (vertices, triangles) =
            if job.study == "template" { (job.size, effort.triangles) } else { (effort.vertices, job.size) };
        let studio = studios.iter().find(|s| s.0 == vertices).expect("proven: made above for every size");
        let case = studio.1.standard(job.case, triangles, setting.seed)?;
        register_variant(&job.variant, &case).map(|r| r.0)
    });

    let columns = [&["study", "size", "name", "case"][..], &ERROR_COLUMNS, &["error"]].concat();
    let mut table = Table::new(&columns);
    for (job, outcome) in jobs.iter().zip(&outcomes) {
        let mut row = vec![job.study.to_owned(), job.size.to_string(), job.variant.name.clone(), job.case.to_string()];
        row.extend(error_cells(outcome.as_ref().ok()));
        row.push(error_text(outcome));
        table.push(row);
    }
    table.write(setting.out, "resolution")?;

    let plot = |study: &str, sizes: &[usize], variants: &[Variant], title: &str, x: &str| -> Result<Plot> {
        let mut series = Vec::new();
        for variant in variants {
            let mut points = Vec::new();
            for size in sizes {
                let rows = [("study", study), ("size", &size.to_string()), ("name", &variant.name)];
                points.push(mean_point(*size as f64, &table.numbers(&rows, "rmse")?));
            }
            series.push(model_line(&variant.name, points));
        }
        Ok(Plot::new(title, Axis::log(x), Axis::linear("rmse / mm").from_zero()).series(series))
    };
    let plots = vec![
        plot("template", &effort.resolutions, &models, "Finer templates", "vertices of the template")?,
        plot("scan", &SCAN_TRIANGLES, &distances, "Coarser scans, hybrid", "triangles of the scan")?,
    ];
    let caption = format!(
        "Mean and range of the error over {}; landmarks give the start alone.",
        counted(effort.resolution_cases, "case")
    );
    let sizes =
        [effort.resolutions.first(), effort.resolutions.last()].map(|s| s.map_or_else(String::new, usize::to_string));
    let [coarse, fine] =
        sizes.each_ref().map(|size| ranked(&table, &[("study", "template"), ("size", size)], "name", "rmse"));
    let (coarse, fine) = (coarse?, fine?);
    let change = |(name, from): &(String, f64)| {
        let to = fine.iter().find(|f| f.0 == *name).map_or_else(|| "none".to_owned(), |f| shown(f.1));
        format!("{name} {} to {to}", shown(*from))
    };
    let finding = format!(
        "Mean rmse in millimetres from {} to {} vertices: {}.",
        sizes[0],
        sizes[1],
        coarse.iter().map(change).collect::<Vec<_>>().join(", ")
    );
    Ok(Section { finding, blocks: vec![setting.plot("resolution", &Grid { columns: 2, plots }.svg()?, caption)?] })
}

/// The hybrid with point-to-plane alone, and with point-to-point to the nearest scan vertex alone.
fn plane_and_point() -> Result<Vec<Variant>> {
    let mut variants = Variant::terms()?;
    variants.retain(|v| v.name == "point_to_plane" || v.name == "point_to_point");
    Ok(variants)
}
