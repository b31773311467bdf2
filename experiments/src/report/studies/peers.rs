//! What one would otherwise take, beside ours: error against seconds.

use anyhow::{Result, bail};

use crate::output::make_folder;
use crate::peers::{METHODS, OURS, plot, run_others};
use crate::report::study::{Block, Section, Setting, Study, least_and_most, ranked, write_runs};
use crate::report::table::{Table, counted, number};
use crate::scan_bench::{CaseSource, Variant, measure, megabytes, summarize};

pub const STUDY: Study = Study {
    name: "peers",
    title: "What one would otherwise take",
    about: "Varied: the program. Held: cases, landmarks, the start by landmarks, threads. Measured: rmse over the observed \
            vertices, seconds of the registration alone, greatest memory of the process.",
    tables: &["peers", "peers.timing"],
    seconds: |effort| 60.0 * effort.vertices as f64 / 5000.0 * effort.cases.len() as f64,
    run,
};

/// Seconds after which a program has failed on a case.
const TIMEOUT: u32 = 300;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let Some(python) = setting.peers else { bail!("--peers is needed") };
    let data = setting.data;
    let threads = rayon::current_num_threads();
    setting.progress.set_length(((METHODS.len() + OURS.len()) * data.cases.len()) as u64);
    let source = CaseSource::new(&data.cases_folder, &data.rig_folder);
    let mut on_row = |_: &_| {
        setting.progress.inc(1);
        Ok(())
    };
    let mut rows = measure(setting.program, &source, &Variant::models(&OURS)?, threads, None, &mut on_row)?;
    let out = setting.out.join("peers");
    make_folder(&out)?;
    let methods = METHODS.map(String::from);
    rows.extend(run_others(&methods, python, &data.cases, threads, TIMEOUT, &out, &mut on_row)?);

    write_runs(setting.out, "peers", &rows, threads)?;

    let mut shown = Table::new(&["program", "rmse", "worst", "normal", "tangential", "seconds", "MB", "failed"]);
    for s in summarize(&rows) {
        let errors = [s.mean_rmse, s.worst_rmse, s.mean_normal, s.mean_tangential].map(number);
        let memory = s.peak_bytes.map_or(f64::NAN, |bytes| megabytes(bytes).round());
        let rest = [number(s.mean_seconds.unwrap_or(f64::NAN)), number(memory), s.failed.to_string()];
        let name = if s.group == "peer" { s.model } else { format!("nonrigid {}", s.model) };
        shown.push([&[name][..], &errors, &rest].concat());
    }
    let cases = counted(data.cases.len(), "case");
    let caption = format!("Mean error against mean seconds over {cases}; the bars are the range of the error.");
    let figure = setting.plot("peers", &plot(&rows)?, caption)?;
    let caption = format!("Means over {cases}, millimetres; the worst rmse; {threads} threads.");
    let finding = least_and_most("rmse", &ranked(&shown, &[], "program", "rmse")?, " mm");
    let shown = Block::Table { table: shown, caption, file: "peers.csv and peers.timing.csv".into() };
    Ok(Section { finding, blocks: vec![figure, shown] })
}
