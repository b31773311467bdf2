//! Figs. 6 to 8 of Li et al. 2018, and its twenty modules on every face.

use anyhow::{Context, Result};
use nonrigid::io::read_polygon_mesh;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::morph::{Recipe, ReplayOptions, StepOutcome, preset, preset_names};
use nonrigid::registration::ModelKind;
use nonrigid::render::{Camera, Frame, Panel, RgbImage, Scene, Sheet, Style, View, render};
use nonrigid::rig::{IDENTITY_MODES, Rig, ShapeBasis};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::generated::Studio;
use crate::real_scans::register_all;
use crate::report::study::{Block, Section, Setting, Study, spread};
use crate::report::table::{Table, counted, number, shown};
use crate::surgery::Patient;
use crate::{add_shape, families};

pub const STUDY: Study = Study {
    name: "presets",
    title: "Li 2018, Figs. 6 to 8: thin face, jaw, nose; the twenty modules",
    about: "Varied: the preset, the face. Held: the recipes, in landmark coordinates. The faces: the template, another person, a coarser \
            and a finer mesh, and, with --scans, real scans that the template was registered to. Measured: the longest displacement of \
            what was asked, the largest jump across an edge, folds, the stretch of edges.",
    tables: &["presets"],
    seconds: |_| 8.0,
    run,
};

/// Vertices of the coarser and the finer mesh, about.
const RESOLUTIONS: [usize; 2] = [2000, 20_000];

/// The paper's three pictures: caption, and presets with millimetres.
const FIGURES: [(&str, &[(&str, f64)]); 3] = [
    ("Fig. 6: thin face", &[("thin-face", 5.0)]),
    ("Fig. 7: jaw", &[("chin-length", 4.0), ("chin-forward", 3.0), ("jaw-angle", 3.0)]),
    ("Fig. 8: nose", &[("nose-bridge", 3.0), ("nose-tip", 2.0), ("alar-width", 1.5)]),
];

fn run(setting: &Setting<'_>) -> Result<Section> {
    let patients = patients(setting)?;
    let mut blocks = vec![figures(setting, &patients[0])?];
    let recipes = preset_names().into_iter().map(|name| Ok((name, known(name)?))).collect::<Result<Vec<_>>>()?;
    let of_all = |patient| recipes.iter().map(move |(name, recipe)| (patient, *name, recipe));
    let jobs: Vec<(&Patient, &str, &Recipe)> = patients.iter().flat_map(of_all).collect();
    let outcomes = setting.run_all(&jobs, |(patient, _, recipe)| patient.morph(recipe, &ReplayOptions::default()));

    let columns =
        ["vertices", "asked", "reached", "reached_over_asked", "largest_jump", "folded", "stretch_min", "stretch_max"];
    let mut table = Table::new(&[&["preset", "face"][..], &columns].concat());
    let mut covered = Vec::new();
    for ((patient, name, _), outcome) in jobs.iter().zip(outcomes) {
        let outcome = outcome.with_context(|| format!("preset {name} on {}", patient.name))?;
        let (asked, change) = (outcome.report.asked, outcome.report.change);
        let numbers = [
            patient.mesh.positions.len() as f64,
            asked,
            change.reached,
            change.reached / asked,
            change.largest_jump,
            change.folded as f64,
            change.stretch.min,
            change.stretch.max,
        ];
        let mut cells = vec![(*name).to_owned(), patient.name.clone()];
        cells.extend(numbers.map(number));
        table.push(cells);
        if patient.name == patients[0].name {
            covered.push((*name, outcome));
        }
    }
    table.write(setting.out, "presets")?;
    blocks.push(modules(setting, &patients[0], &covered)?);
    blocks.push(Block::Table {
        table: by_preset(&table, &patients)?,
        caption: "Each preset at its usual amount: what was reached of what was asked, on every face; the worst of folds and stretch."
            .into(),
        file: "presets.csv".into(),
    });
    if patients.len() > 2 + RESOLUTIONS.len() {
        blocks.push(real(setting, &patients[2 + RESOLUTIONS.len()..])?);
    }
    let (mean, [least, most]) = spread(&table.numbers(&[], "reached_over_asked")?);
    let finding = format!(
        "Over {} and {}, {} to {} of the displacement asked for is reached, {} on average.",
        counted(recipes.len(), "preset"),
        counted(patients.len(), "face"),
        shown(least),
        shown(most),
        shown(mean)
    );
    Ok(Section { finding, blocks })
}

fn known(name: &str) -> Result<Recipe> {
    Ok(preset(name).with_context(|| format!("no preset {name}"))??)
}

/// The template, another person, two resolutions, then real scans if there are any.
fn patients(setting: &Setting<'_>) -> Result<Vec<Patient>> {
    let (rig, template) = (setting.data.rig.rig(), setting.data.rig.template());
    let of = |name: &str, mesh: PolygonMesh| Patient::new(name, mesh, rig.landmarks(), ShapeBasis::none());
    let person = template.with_positions(person(rig, &template.positions, setting.seed));
    let mut all = vec![of("template", template.clone())?, of("another person", person)?];
    for vertices in RESOLUTIONS {
        let studio = Studio::new(vertices)?;
        let (name, mesh) = (format!("{vertices} vertices"), studio.template().clone());
        all.push(Patient::new(name, mesh, Some(&studio.landmarks()), ShapeBasis::none())?);
    }
    let Some(real) = &setting.data.real else { return Ok(all) };
    let out = setting.out.join("presets");
    register_all(&real.arguments(vec![ModelKind::Hybrid], out.clone()), &real.scans)?;
    for scan in &real.scans {
        let path = out.join(&scan.name).join("hybrid.obj");
        if path.exists() {
            all.push(of(&scan.name, read_polygon_mesh(&path)?)?);
        }
    }
    Ok(all)
}

/// A random person of the rig's identity modes.
fn person(rig: &Rig, neutral: &[Vec3], seed: u64) -> Vec<Vec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut positions = neutral.to_vec();
    for mode in families(rig).1.into_iter().take(IDENTITY_MODES) {
        add_shape(&mut positions, rig, mode, StandardNormal.sample(&mut rng));
    }
    positions
}

/// Width and height of a panel, pixels.
const PANEL: [u32; 2] = [280, 320];

fn portrait(mesh: &PolygonMesh, frame: &Frame, view: View) -> RgbImage {
    render(&Scene::new().mesh(&mesh.triangulate(), Style::Clay), &Camera::framing(frame, view, PANEL), PANEL)
}

/// Several presets, one after the other.
fn changed(patient: &Patient, presets: &[(&str, f64)]) -> Result<PolygonMesh> {
    let mut mesh = patient.mesh.clone();
    for (name, amount) in presets {
        let options = ReplayOptions { amount: Some(*amount), ..ReplayOptions::default() };
        mesh.positions = patient.standing_at(&mesh.positions).morph(&known(name)?, &options)?.positions;
    }
    Ok(mesh)
}

/// Figs. 6 to 8: before and after, from the front and the side.
fn figures(setting: &Setting<'_>, patient: &Patient) -> Result<Block> {
    let frame = Frame::of(&patient.mesh.positions).scaled(0.95);
    let mut sheet = Sheet::new("").columns(&["before", "after", "before", "after", "before", "after"]);
    for (title, presets) in FIGURES {
        let after = changed(patient, presets)?;
        let views = [View::Front, View::ThreeQuarter, View::Side];
        let panels = views.iter().flat_map(|view| [&patient.mesh, &after].map(|m| portrait(m, &frame, *view)));
        sheet = sheet.row(title, panels);
    }
    let spoken = |(title, presets): &(&str, &[(&str, f64)])| {
        let parts: Vec<String> = presets.iter().map(|(name, mm)| format!("{name} {mm} mm")).collect();
        format!("{title}: {}", parts.join(", "))
    };
    let caption = FIGURES.iter().map(spoken).collect::<Vec<_>>().join(". ") + ".";
    setting.picture("surgery", &sheet.render(), caption)
}

/// The masks of all presets on one face.
fn modules(setting: &Setting<'_>, patient: &Patient, outcomes: &[(&str, StepOutcome)]) -> Result<Block> {
    let frame = Frame::of(&patient.mesh.positions);
    let camera = Camera::framing(&frame, View::Angles { yaw: 25.0, pitch: 2.0 }, [220, 240]);
    let mesh = patient.mesh.triangulate();
    let mut sheet = Sheet::new("");
    for row in outcomes.chunks(5) {
        let panel = |(name, outcome): &(&str, StepOutcome)| {
            let style = Style::Overlay(outcome.coverage(), [255, 0, 0]);
            Panel::new(render(&Scene::new().mesh(&mesh, style), &camera, [220, 240]), name)
        };
        sheet = sheet.row("", row.iter().map(panel));
    }
    setting.picture("presets", &sheet.render(), "The twenty presets: where each acts, in the paper's red.")
}

/// A row for each preset: the share reached on each face, then the worst of all faces.
fn by_preset(table: &Table, patients: &[Patient]) -> Result<Table> {
    let faces: Vec<&str> = patients.iter().map(|p| p.name.as_str()).collect();
    let mut rows = Table::new(&[&["preset", "asked"][..], &faces, &["folded", "shortest", "longest"]].concat());
    for name in preset_names() {
        let of = |column: &str, face: &str| table.numbers(&[("preset", name), ("face", face)], column);
        let all = |column: &str| table.numbers(&[("preset", name)], column).map(|values| spread(&values).1);
        let mut cells = vec![name.to_owned(), number(of("asked", faces[0])?[0])];
        for face in &faces {
            cells.push(number(of("reached_over_asked", face)?[0]));
        }
        cells.push(number(all("folded")?[1]));
        cells.push(number(all("stretch_min")?[0]));
        cells.push(number(all("stretch_max")?[1]));
        rows.push(cells);
    }
    Ok(rows)
}

/// Real scans before and after the presets of the three figures.
fn real(setting: &Setting<'_>, patients: &[Patient]) -> Result<Block> {
    let titles = FIGURES.map(|f| f.0);
    let mut sheet = Sheet::new("").columns(&[&["registered"][..], &titles].concat());
    for patient in patients {
        let frame = Frame::of(&patient.mesh.positions).scaled(0.95);
        for view in [View::Front, View::Side] {
            let mut panels = vec![portrait(&patient.mesh, &frame, view)];
            for (_, presets) in FIGURES {
                panels.push(portrait(&changed(patient, presets)?, &frame, view));
            }
            sheet = sheet.row(if view == View::Front { &patient.name } else { "" }, panels);
        }
    }
    setting.picture(
        "surgery-real",
        &sheet.render(),
        "The same recipes on real scans: the template registered to each, then morphed.",
    )
}
