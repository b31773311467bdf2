//! The report at its smallest: what it leaves, that verdicts follow the tables, that equal runs leave equal files, how it fails.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan, write_rig};
use experiments::report::claims::{self, Bound, Claim, Judged, Measured, PAPERS, Pick, Verdict};
use experiments::report::effort::Effort;
use experiments::report::table::{Table, number};
use experiments::report::{Options, run};
use nonrigid::energy::OptionsError;
use nonrigid::io::{PlyOptions, write_ply};
use nonrigid::model::ModelError;
use nonrigid::registration::{ModelFactory, ModelInput, ModelKind, RegistrationModel};

use crate::repeats::files_of;
use crate::threads::on_threads;

/// Everything, as small as it gets: a quick report of less.
fn tiny() -> Effort {
    let models = vec![
        ModelKind::Hybrid,
        ModelKind::Sequential,
        ModelKind::Blendshape,
        ModelKind::Graph,
        ModelKind::Arap,
        ModelKind::Rigid,
    ];
    Effort {
        name: "tiny",
        vertices: 1000,
        triangles: 6000,
        cases: vec!["same_open"],
        models: models.clone(),
        components: vec![5, 50, 150],
        components_of_paper: vec![5, 30, 50, 90],
        population: 160,
        sweep_values: 2,
        sweep_models: models,
        sweep_triangles: 5000,
        resolutions: vec![1000, 1500],
        silence_runs: 4,
        solver_sizes: vec![1000, 2000],
        solver_shapes: vec![5, 20],
        solver_nodes: vec![50, 100],
        ..Effort::quick()
    }
}

/// A model of one's own: it is another's under its own name.
struct Mine;

impl ModelFactory for Mine {
    fn name(&self) -> &str {
        "mine"
    }

    fn default_schedule(&self) -> &str {
        ModelKind::Rigid.default_schedule()
    }

    fn options(&self, given: &nonrigid::energy::Options) -> Result<nonrigid::energy::Options, OptionsError> {
        ModelKind::Rigid.options(given)
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        ModelKind::Rigid.build(input)
    }
}

fn claims_of_all() -> impl Iterator<Item = &'static Claim> {
    PAPERS.iter().flat_map(|paper| paper.claims)
}

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_experiments"))
}

fn report(out: &Path, threads: usize, only: &[&str]) -> (Vec<Judged>, String) {
    report_of(None, out, threads, only)
}

/// With rig and scans of the user's.
fn report_of(own: Option<[PathBuf; 2]>, out: &Path, threads: usize, only: &[&str]) -> (Vec<Judged>, String) {
    let only = only.iter().map(ToString::to_string).collect();
    let (rig, scans) = own.map(|[rig, scans]| (rig, scans)).unzip();
    let options = Options { only, rig, scans, out: out.to_owned(), ..Options::default() };
    let mut log = Vec::new();
    let verdicts = on_threads(threads, || run(&options, &tiny(), program(), &[&Mine], &mut log)).unwrap();
    (verdicts, String::from_utf8(log).unwrap())
}

#[test]
fn every_study_fills_its_section_and_verdicts_follow_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let (verdicts, log) = report(folder.path(), 2, &[]);
    let page = fs::read_to_string(folder.path().join("index.html")).unwrap();
    for study in [
        "inputs",
        "extreme",
        "shapes",
        "convergence",
        "comparison",
        "sweeps",
        "resolution",
        "ablations",
        "silence",
        "solver",
        "masks",
        "presets",
        "mask-models",
    ] {
        assert!(page.contains(&format!("<h2 id=\"{study}\">")), "{study}");
        assert!(page.contains(&format!("<a href=\"#{study}\">")), "{study}");
    }
    // One page with everything in it.
    assert!(!page.contains("Not yet run") && !page.contains("Running; reload"));
    let failures: Vec<&str> = page.split("<p class=\"failed\">").skip(1).filter_map(|p| p.lines().next()).collect();
    assert!(failures.is_empty(), "{failures:?}");
    let without_scripts: String =
        page.split("<script").map(|part| part.split_once("</script>").map_or(part, |p| p.1)).collect();
    let words =
        without_scripts.split("base64,").map(|part| part.split_once('"').map_or(part, |p| p.1)).collect::<String>();
    let nan: Vec<&str> = words.lines().filter(|line| line.contains("NaN")).collect();
    assert!(nan.is_empty(), "{nan:?}");
    assert_eq!(page.matches("<p class=\"finding\">").count(), 13);
    assert!(page.matches("<figure class=\"view3d\">").count() >= 2 && page.len() < 15_000_000, "{} bytes", page.len());
    let sources: Vec<&str> = page.split(" src=\"").skip(1).collect();
    assert!(sources.len() >= 4 && sources.iter().all(|s| s.starts_with("data:image/png;base64,")));
    assert!(!page.contains("href=\"http") && page.matches("<svg").count() >= 8);
    assert!(log.contains("plan, about") && log.contains("YOUR_SCAN/scan.ply"), "{log}");

    // A study by itself at one thread leaves the files that it leaves among all at two.
    let alone = tempfile::tempdir().unwrap();
    report(alone.path(), 1, &["ablations"]);
    let mut compared = 0;
    for (name, bytes) in files_of(alone.path()) {
        let of_study = name.to_string_lossy().starts_with("ablations");
        if of_study || name.starts_with("data") {
            assert!(fs::read(folder.path().join(&name)).unwrap() == bytes, "{}", name.display());
            compared += usize::from(of_study);
        }
    }
    assert!(compared >= 2, "{compared}");

    // A model of one's own has its rows.
    for (table, column) in [("extreme", "model"), ("comparison", "name"), ("sweeps", "model")] {
        let table = Table::read(&folder.path().join(format!("{table}.csv"))).unwrap();
        let rmse = |name| table.numbers(&[(column, name)], "rmse").unwrap();
        assert!(!rmse("mine").is_empty() && rmse("mine") == rmse("rigid"), "{:?}", rmse("mine"));
    }
    assert!(fs::read_to_string(folder.path().join("extreme-table1.tex")).unwrap().contains("mine & "));

    // Only the kernels and terms are left out of so small a run.
    let open: Vec<&str> =
        verdicts.iter().filter(|j| j.verdict == Verdict::NotMeasured).map(|j| j.claim.quote).collect();
    assert_eq!(open.len(), 1, "{open:#?}");
    assert!(
        fs::read_to_string(folder.path().join("claims.csv")).unwrap().lines().count() == claims_of_all().count() + 1
    );

    // Verdicts rest on this run's tables alone.
    let tables: Vec<&str> =
        claims_of_all().flat_map(|c| c.rules).flat_map(|r| [Some(r.value), r.over]).flatten().map(|p| p.csv).collect();
    let measured = Measured { folder: folder.path(), tables: &tables };
    let none = claims::judge_all(Measured { tables: &[], ..measured }).unwrap();
    assert!(none.iter().all(|j| j.verdict == Verdict::NotMeasured));

    // One scan decides nothing, and the last line says how often.
    let undecided = verdicts.iter().filter(|j| j.verdict == Verdict::Undecided).count();
    assert!(undecided >= 10 && log.contains(&format!(" {undecided} undecided")), "{log}");
    let single = verdicts.iter().filter(|j| j.numbers.iter().any(|n| n.contains("(n = 1)")));
    assert!(single.clone().count() >= 10 && single.clone().all(|j| j.verdict != Verdict::Holds));

    // Each verdict turns when the rows behind it do, were they all there is.
    tables.iter().for_each(|table| forget_units(&folder.path().join(format!("{table}.csv"))));
    // The few scans may take the same number of steps, and nothing is more or less than no variation.
    let overs = claims_of_all().flat_map(|c| c.rules).filter_map(|rule| rule.over);
    overs.filter(|over| over.take == claims::Take::Variation).for_each(|over| vary(&csv(folder.path(), &over), &over));
    let verdicts = claims::judge_all(measured).unwrap();
    for judged in verdicts.iter().filter(|j| j.verdict != Verdict::NotMeasured) {
        assert_ne!(judged.verdict, Verdict::Undecided, "{}: {:?}", judged.claim.quote, judged.numbers);
        for (k, rule) in judged.claim.rules.iter().enumerate() {
            let (before, file) = (fs::read(csv(folder.path(), &rule.value)).unwrap(), csv(folder.path(), &rule.value));
            for holds in [true, false] {
                let wanted = match (rule.is, holds) {
                    (Bound::AtLeast(_), true) | (Bound::AtMost(_), false) => 1e6,
                    _ => 1e-6,
                };
                scale(&file, &rule.value, wanted);
                let after = claims::judge(judged.paper, judged.claim, measured).unwrap();
                let wanted = if holds { Verdict::Holds } else { Verdict::Fails };
                assert_eq!(after.rules[k], wanted, "{}: {:?}", judged.claim.quote, after.numbers);
                assert!(holds || after.verdict == Verdict::Fails);
                fs::write(&file, &before).unwrap();
            }
        }
        let again = claims::judge(judged.paper, judged.claim, measured).unwrap();
        assert_eq!((again.verdict, &again.numbers), (judged.verdict, &judged.numbers));
    }
}

/// Makes a table exact: its rows are no sample of anything.
fn forget_units(file: &Path) {
    let mut table = Table::read(file).unwrap();
    table.header.iter_mut().filter(|name| claims::UNITS.contains(&name.as_str())).for_each(|name| name.push_str(" of"));
    table.write(file.parent().unwrap(), file.file_stem().unwrap().to_str().unwrap()).unwrap();
}

fn csv(folder: &Path, pick: &Pick) -> PathBuf {
    folder.join(format!("{}.csv", pick.csv))
}

/// Makes the numbers of a pick vary a little.
fn vary(file: &Path, pick: &Pick) {
    let mut table = Table::read(file).unwrap();
    let column = table.column(pick.column).unwrap();
    let lines: Vec<usize> = table.find(pick.rows).unwrap().iter().map(|r| r.0 - 2).collect();
    for (k, line) in lines.into_iter().enumerate() {
        table.rows[line][column] = number([1.0, 1.1][k % 2]);
    }
    table.write(file.parent().unwrap(), file.file_stem().unwrap().to_str().unwrap()).unwrap();
}

/// Multiplies the numbers of a pick; where their variation counts, that.
fn scale(file: &Path, pick: &Pick, factor: f64) {
    let mut table = Table::read(file).unwrap();
    let column = table.column(pick.column).unwrap();
    let mut lines: Vec<usize> = table.find(pick.rows).unwrap().iter().map(|r| r.0 - 2).collect();
    match pick.take {
        claims::Take::First => lines.truncate(1),
        claims::Take::Last => lines = lines.split_off(lines.len() - 1),
        _ => {}
    }
    for (k, line) in lines.into_iter().enumerate() {
        let cell = &mut table.rows[line][column];
        let value: f64 = cell.parse().unwrap_or(1.0);
        *cell = match pick.take {
            claims::Take::Variation => number(if factor > 1.0 { [1e-9, 1.0][k % 2] } else { 1.0 }),
            _ => number(value.max(1e-12) * factor),
        };
    }
    table.write(file.parent().unwrap(), file.file_stem().unwrap().to_str().unwrap()).unwrap();
}

#[test]
fn equal_runs_leave_equal_files_at_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let runs = [("one", 1), ("two", 2)].map(|(name, threads)| {
        let out = folder.path().join(name);
        report(&out, threads, &["inputs", "extreme", "convergence"]);
        assert!(out.join("machine.json").exists(), "processor and times, in a file of their own");
        files_of(&out)
    });
    assert_eq!(runs[0].keys().collect::<Vec<_>>(), runs[1].keys().collect::<Vec<_>>());
    let differing: Vec<_> = runs[0].iter().filter(|(name, bytes)| runs[1][*name] != **bytes).map(|f| f.0).collect();
    assert!(differing.is_empty(), "{differing:?}");

    // A run in the folder of another replaces its files.
    report(&folder.path().join("two"), 2, &["inputs"]);

    // The same rig and cases as a user's own.
    let data = folder.path().join("one/data/tiny");
    let out = folder.path().join("own");
    report_of(Some([data.join("rig"), data.join("cases")]), &out, 2, &["extreme", "convergence"]);
    for table in ["extreme.csv", "convergence.csv", "extreme.png"] {
        assert!(fs::read(out.join(table)).unwrap() == runs[0][Path::new(table)], "{table}");
    }
    assert!(!out.join("data").exists());
}

#[test]
fn of_scans_without_truth_alone_is_said_what_is_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // A rig of fewer identity modes than are usual.
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 20 });
    write_rig(&at("rig"), &rig).unwrap();
    let case = simulate_scan(&rig, &ScanOptions { triangles: 6000, ..ScanOptions::default() }, 7).unwrap();
    fs::create_dir(at("scans")).unwrap();
    write_ply(&at("scans/anna.ply"), &case.scan, PlyOptions::default()).unwrap();
    let (_, log) = report_of(Some([at("rig"), at("scans")]), &at("out"), 2, &["real"]);
    assert!(log.contains("no case.json below --scans: real and presets are of your rig and scans"), "{log}");
    let page = fs::read_to_string(at("out/index.html")).unwrap();
    assert!(page.contains("real scans on your own rig"));
    let table = Table::read(&at("out/real.csv")).unwrap();
    assert!(
        table.rows.len() == tiny().models.len() && table.numbers(&[("model", "hybrid")], "median").unwrap()[0] < 1.0
    );
}

fn experiments(arguments: &[&str], folder: &Path) -> Output {
    Command::new(program()).args(arguments).current_dir(folder).output().unwrap()
}

#[test]
fn a_list_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let listed = experiments(&["--list"], folder.path());
    let text = String::from_utf8(listed.stdout).unwrap();
    assert!(listed.status.success() && text.lines().count() == 15 && text.contains("Fig. 4"), "{text}");
    assert!(!folder.path().join("out").exists(), "a list leaves nothing");
}
