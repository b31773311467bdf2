//! The guide says what is so: the fields of a report, the signs of doubt and their thresholds, the messages of errors.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crate::support::Bench;
use nonrigid::io::{PlyOptions, write_ply};
use nonrigid::registration::Doubt;
use serde_json::Value;

fn text(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// The rows of the table under the heading that starts with `heading`, without its head.
fn table(chapter: &str, heading: &str) -> Vec<Vec<String>> {
    let section = chapter.split("\n## ").find(|s| s.starts_with(heading)).unwrap();
    let rows = section.lines().filter(|l| l.starts_with("| ")).skip(1);
    rows.map(|l| l.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()).collect()
}

/// What stands between backticks.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

/// `a.b`, `.c` as a.b and a.c.
fn paths(cell: &str) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for name in quoted(cell) {
        let folder = all.last().and_then(|last| last.rsplit_once('.')).map_or("", |(folder, _)| folder);
        all.push(if name.starts_with('.') { format!("{folder}{name}") } else { name.to_owned() });
    }
    all
}

/// Every field, those in a list as `list[].field`; not below what `opaque` names.
fn fields(value: &Value, path: &str, opaque: &[&str], found: &mut BTreeSet<String>) {
    if opaque.contains(&path) {
        return;
    }
    match value {
        Value::Object(entries) => {
            for (name, value) in entries {
                let inner = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                found.insert(inner.clone());
                fields(value, &inner, opaque, found);
            }
        }
        Value::Array(entries) => entries.iter().for_each(|e| fields(e, &format!("{path}[]"), opaque, found)),
        _ => {}
    }
}

#[test]
fn the_chapter_on_reports_names_every_field_and_no_other() {
    let bench = Bench::of_size(1000, 20_000);
    let colors = vec![[180, 140, 120]; bench.case.scan.positions.len()];
    let options = PlyOptions { colors: Some(&colors), ..PlyOptions::default() };
    write_ply(&bench.path("scan.ply"), &bench.case.scan, options).unwrap();
    bench.done("register --template rig/template.obj --target scan.ply --rig rig --out r.obj --report r.json --subdivide 1 --bake-texture 64");
    let report = bench.json("r.json");
    let chapter = text("docs/src/reference/report.md");
    let said = table(&chapter, "Every field").iter().flat_map(|row| paths(&row[0])).collect::<Vec<_>>();
    let mut found = BTreeSet::new();
    let opaque = [
        "schedule",
        "start_search.runner_up",
        "start_search.expression",
        "doubts[]",
        "history[].energies",
        "evidence.handedness",
        "detail.before",
        "detail.quality",
    ];
    fields(&report, "", &opaque, &mut found);
    // What has fields of its own is not said once more unless it can be null.
    let parents: BTreeSet<String> =
        found.iter().filter_map(|f| f.rsplit_once('.')).map(|f| f.0.replace("[]", "")).collect();
    let leaves: BTreeSet<String> = found.iter().filter(|f| !parents.contains(*f)).cloned().collect();
    let said: BTreeSet<String> = said.into_iter().collect();
    let missing: Vec<_> = leaves.difference(&said).collect();
    let extra: Vec<_> = said.difference(&found).collect();
    assert!(missing.is_empty() && extra.is_empty(), "not in the chapter: {missing:?}; not in the report: {extra:?}");

    let timing = bench.json("r.timing.json");
    for field in timing.as_object().unwrap().keys() {
        assert!(chapter.contains(&format!("`{field}`")), "{field}");
    }
}

#[test]
fn the_chapter_on_reports_names_every_doubt() {
    let all = [
        Doubt::Start { tried: 1, share: 0.1, residual: 2.0, rival: 0.9 },
        Doubt::LittleSeen { share: 0.3 },
        Doubt::Contradicted { share: 0.3 },
        Doubt::ScanMissed { share: 0.3 },
        Doubt::HighResidual { median: 1.0 },
        Doubt::Landmarks { rms: 20.0, worst: "chin".into(), distance: 40.0 },
        Doubt::FewLandmarks { count: 2 },
        Doubt::NoShapes,
        Doubt::BeyondShapes { rms: 3.0 },
        Doubt::ExtremeWeights { energy: 9.0, worst: "jawOpen".into(), deviations: 4.0 },
        Doubt::LooseWeights { shift: 2.0 },
        Doubt::ManyFolds { folded: 9, intersections: 10 },
        Doubt::Stretched { longest: 3.0, shortest: 0.2 },
        Doubt::Spikes { vertices: 3, longest: 9.0 },
        Doubt::FeaturesMoved { correlation: 0.4 },
        Doubt::Unsettled { motion: 2.0 },
        Doubt::Mirrored { odds: 30.0 },
        Doubt::Scale { scale: 0.8 },
    ];
    let rows = table(&text("docs/src/reference/report.md"), "Doubts");
    assert_eq!(rows.len(), all.len());
    for (row, doubt) in rows.iter().zip(&all) {
        let json = serde_json::to_value(doubt).unwrap();
        let mut names: Vec<&str> =
            json.as_object().unwrap().keys().map(String::as_str).filter(|k| *k != "sign").collect();
        names.insert(0, json["sign"].as_str().unwrap());
        let said: BTreeSet<&str> = quoted(&row[0]).into_iter().collect();
        assert_eq!(said, names.into_iter().collect(), "{doubt:?}");
    }
    // A new sign needs a row: every variant has one arm in the function that names them.
    let source = text("src/registration/doubt.rs");
    let names = source.split("pub fn name").nth(1).unwrap().split("}\n    }").next().unwrap();
    assert_eq!(names.matches("=> \"").count(), all.len());
}

#[test]
fn the_first_chapter_quotes_messages_that_there_are() {
    let chapter = text("docs/src/tutorials/developer.md");
    let source = text("src/registration/error.rs") + &text("src/correspondence/scan.rs") + &text("src/mesh/pose.rs");
    let source: String = source.replace("\\\n", " ").split_whitespace().collect::<Vec<_>>().join(" ");
    let rows = table(&chapter, "What can go wrong");
    assert!(rows.len() > 5);
    for row in rows {
        for message in quoted(&row[0]) {
            assert!(source.contains(message), "{message:?}");
        }
    }
}
