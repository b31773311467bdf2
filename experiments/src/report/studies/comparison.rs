//! The comparison table: every model, kernel and data term on the same scans.

use anyhow::Result;
use nonrigid::console::told;
use nonrigid::registration::ModelKind;

use crate::plots::{Bar, GroupedBars};
use crate::report::study::{Block, Section, Setting, Study, least_and_most, ranked, spread, write_runs};
use crate::report::table::{Table, counted, number};
use crate::scan_bench::{BenchCase, BenchRow, CaseSource, LandmarkUse, Variant, measure, megabytes, summarize};

pub const STUDY: Study = Study {
    name: "comparison",
    title: "Comparison: models, robust kernels, data terms",
    about: "Varied: the model with its default schedule; then, for the hybrid, the robust kernel of its data term and the data \
            terms. Held: scans, shapes, landmarks. Measured: errors over the observed vertices, flips, self-intersections, \
            steps, and, each variant but a model of your own in a process of its own, seconds and greatest memory.",
    tables: &["comparison", "comparison.timing"],
    seconds: |effort| {
        let affine = if effort.models.contains(&ModelKind::Affine) { 9.0 } else { 0.0 };
        let fast = effort.models.len() as f64 + if effort.kernels_and_terms { 16.0 } else { 0.0 };
        effort.vertices as f64 / 5000.0 * effort.cases.len() as f64 * (fast + affine)
    },
    run,
};

fn run(setting: &Setting<'_>) -> Result<Section> {
    let data = setting.data;
    let mut variants = Variant::models(&setting.effort.models)?;
    if setting.effort.kernels_and_terms {
        variants.extend(Variant::kernels()?);
        variants.extend(Variant::terms()?);
    }
    setting.progress.set_length((variants.len() * data.cases.len()) as u64);
    let threads = rayon::current_num_threads();
    let source = CaseSource::new(&data.cases_folder, &data.rig_folder);
    let mut rows = measure(setting.program, &source, &variants, threads, None, &mut |_| {
        setting.progress.inc(1);
        Ok(())
    })?;

    let own = setting.entrants(&[])?.into_iter().flat_map(|entrant| {
        let of_case = |case: &BenchCase| {
            let outcome = entrant.register(case, LandmarkUse::All);
            let seconds = outcome.as_ref().ok().map(|o| o.2);
            let score = outcome.map(|o| o.0).map_err(|e| told(&e));
            BenchRow { seconds, ..BenchRow::new("model", entrant.name(), &case.name, score) }
        };
        data.cases.iter().map(of_case).collect::<Vec<_>>()
    });
    let last = rows.iter().rposition(|row| row.group == "model").map_or(0, |k| k + 1);
    rows.splice(last..last, own);
    write_runs(setting.out, "comparison", &rows, threads)?;

    let columns = [
        "group",
        "variant",
        "rmse",
        "worst",
        "normal",
        "tangential",
        "p95",
        "flips",
        "self-intersections",
        "steps",
        "seconds",
        "MB",
        "failed",
    ];
    let mut shown = Table::new(&columns);
    let mut bars = Vec::new();
    for s in summarize(&rows) {
        let (_, range) = spread(&s.errors(&rows));
        bars.push((s.group.clone(), Bar { name: s.model.clone(), value: s.mean_rmse, spread: Some(range) }));
        let memory = s.peak_bytes.map_or(f64::NAN, |bytes| megabytes(bytes).round());
        let mut cells = vec![s.group, s.model];
        cells.extend([s.mean_rmse, s.worst_rmse, s.mean_normal, s.mean_tangential, s.mean_p95].map(number));
        cells.extend([s.worst_flips, s.worst_self_intersections].map(|n| n.to_string()));
        let missing = f64::NAN;
        cells.extend(
            [s.mean_iterations.unwrap_or(missing).round(), s.mean_seconds.unwrap_or(missing), memory].map(number),
        );
        cells.push(s.failed.to_string());
        shown.push(cells);
    }
    let cases = counted(data.cases.len(), "case");
    let caption = format!("Mean and range of the rmse over {cases}.");
    let figure = setting.plot("comparison", &GroupedBars::new("", "rmse / mm", bars).svg()?, caption)?;
    let caption = format!(
        "Over {cases}, millimetres: means of rmse, normal and tangential error, p95, steps and seconds; the worst rmse; the most flips and \
         self-intersections of a case; the greatest memory, data included. {threads} threads."
    );
    let finding = least_and_most("rmse", &ranked(&shown, &[("group", "model")], "variant", "rmse")?, " mm");
    let shown = Block::Table { table: shown, caption, file: "comparison.csv and comparison.timing.csv".into() };
    Ok(Section { finding, blocks: vec![figure, shown] })
}
