//! Silence: does a bad result say that it is bad?

use anyhow::Result;

use crate::plots::{Axis, Plot, Point, Series};
use crate::report::study::{Block, Section, Setting, Study};
use crate::report::table::{Table, number};
use crate::silence::{BAD, Counts, SilenceRow, Sources, diagram, run_job, some_jobs};

pub const STUDY: Study = Study {
    name: "silence",
    title: "Does a bad result say so?",
    about: "Varied: what is wrong with scan, landmarks or rig, one kind at a time; people and expressions. Held: the hybrid's schedule, \
            and the calibration of the probability of error, which has seen neither these seeds nor the kinds marked so. Measured: \
            the error over the observed vertices, more than 3 mm being bad, and whether the result is doubted. (The command experiments silence \
            runs more of them, and scans of your own with ground truth.)",
    tables: &["silence", "silence-counts", "silence-diagram"],
    seconds: |effort| 0.8 * effort.silence_runs as f64,
    run,
};

/// Vertices of the template, about.
const VERTICES: usize = 2000;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let sources = Sources::new(VERTICES, Vec::new())?;
    let jobs = some_jobs(setting.effort.silence_runs);
    let rows: Vec<SilenceRow> =
        setting.run_all(&jobs, |job| run_job(&sources, job)).into_iter().collect::<Result<_>>()?;
    let mut all = Table::new(&[
        "kind",
        "kept_apart",
        "seed",
        "model",
        "landmarks",
        "verdict",
        "rmse",
        "probability",
        "doubts",
        "error",
    ]);
    for row in &rows {
        let reliability = row.reliability.as_ref();
        let doubts: Vec<&str> = reliability.iter().flat_map(|r| r.doubts.iter().map(|d| d.name())).collect();
        all.push(vec![
            row.kind.to_owned(),
            (!row.design_kind).to_string(),
            row.seed.to_string(),
            row.model.clone(),
            row.landmarks.to_string(),
            row.verdict().name().to_owned(),
            row.rmse.map_or_else(String::new, number),
            reliability.map_or_else(String::new, |r| number(r.probability)),
            doubts.join(" "),
            row.error.clone().unwrap_or_default(),
        ]);
    }
    all.write(setting.out, "silence")?;
    let counts = Counts::of(&rows);
    let mut table = Table::new(&["what", "of", "count", "share"]);
    let shares = counts.shares();
    for (k, (what, [of, count])) in
        [("good, doubted", counts.good), ("bad, silent", counts.bad), ("solvable, refused", counts.solvable)]
            .into_iter()
            .enumerate()
    {
        table.push(vec![what.to_owned(), of.to_string(), count.to_string(), number(shares[k])]);
    }
    table.write(setting.out, "silence-counts")?;
    let bands = diagram(&rows);
    let mut of_bands = Table::new(&["probability", "bad", "results"]);
    bands.iter().for_each(|(p, bad, n)| of_bands.push(vec![number(*p), number(*bad), n.to_string()]));
    of_bands.write(setting.out, "silence-diagram")?;
    let point = |&(x, y, n): &(f64, f64, usize)| {
        let spread = (y * (1.0 - y) / n as f64).sqrt().max(0.5 / n as f64);
        Point { x, y, spread: Some([(y - spread).max(0.0), (y + spread).min(1.0)]) }
    };
    let line = [0.0, 1.0].map(|x| Point { x, y: x, spread: None }).to_vec();
    let plot =
        Plot::new("Probability of error", Axis::linear("stated").from_zero(), Axis::linear("happened").from_zero())
            .series(vec![Series::line("results", bands.iter().map(point).collect()), Series::line("calibrated", line)]);
    let caption = format!(
        "Share of results with an error above {BAD} mm against the probability that they state themselves, in bands of it, with the \
         standard deviation of that share; {} results.",
        bands.iter().map(|b| b.2).sum::<usize>()
    );
    let of = |[of, count]: [usize; 2]| format!("{count} of {of}");
    let finding = format!(
        "{} good results are doubted, {} bad ones silent, {} solvable runs refused.",
        of(counts.good),
        of(counts.bad),
        of(counts.solvable)
    );
    let figure = setting.plot("silence-diagram", &plot.svg()?, caption)?;
    let caption = "How many good results are doubted, bad ones silent, and runs refused that can be solved.".to_owned();
    Ok(Section {
        finding,
        blocks: vec![figure, Block::Table { table, caption, file: "silence-counts.csv".to_owned() }],
    })
}
