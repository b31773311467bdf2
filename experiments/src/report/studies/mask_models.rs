//! One mask on every deformation model, and how fast a mask is drawn, projected and dragged.

use anyhow::{Context, Result};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::morph::{
    Blur, Constraints, Coordinates, EnergyOptions, MaskedDisplacement, MorphEnergy, MorphModel, MorphStep, Projector,
    Region, ReplayOptions, Sampling, Shape, Texture, Visibility, preset,
};
use nonrigid::registration::ModelKind;
use nonrigid::render::{Camera, ColourMap, ColourScale, Frame, Panel, Scene, Sheet, Style, View, render};
use nonrigid::rig::{ShapeBasis, ShapeSelection};

use crate::generated::face;
use crate::plots::{Axis, Plot, Point, Series};
use crate::report::study::{
    Block, Section, Setting, Study, cpu_seconds, least_and_most, mean_point, one_thread, ranked,
};
use crate::report::table::{Table, number};
use crate::surgery::Patient;

pub const STUDY: Study = Study {
    name: "mask-models",
    title: "Li 2018: one mask on every model, and its speed",
    about: "Varied: the deformation model under the same mask; then the number of vertices. Held: mask, displacement, the smoothing \
            length of 2 mm, 40 identity modes for the models with blendshapes. Measured: what was reached of what was asked, jumps, \
            folds, stretch; milliseconds of one core to draw and blur a texture of 512 x 512, to give every vertex its weight, to move the \
            vertices, and to follow a handle that is dragged by a tenth of a millimetre.",
    tables: &["mask-models", "mask-speed.timing"],
    seconds: |_| 8.0,
    run,
};

/// Presets and millimetres that every model is given: more than usual, so that differences show.
const MASKS: [(&str, f64); 2] = [("nose-bridge", 4.0), ("cheek-volume", 5.0)];
const IDENTITY_MODES: usize = 40;
/// Vertices of the meshes that are timed, about.
const SIZES: [usize; 3] = [5000, 20_000, 100_000];
/// The median of so many runs counts.
const RUNS: usize = 5;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let mut blocks = models(setting)?;
    blocks.extend(one_thread()?.install(|| speed(setting))?);
    let reached = Table::read(&setting.out.join("mask-models.csv"))?;
    let reached = ranked(&reached, &[], "model", "reached_over_asked")?;
    let finding = least_and_most("share of the displacement asked for that is reached", &reached, "");
    Ok(Section { finding, blocks })
}

fn models(setting: &Setting<'_>) -> Result<Vec<Block>> {
    let rig = setting.data.rig.rig();
    let modes = rig.shapes().iter().filter(|s| s.family == nonrigid::rig::Family::Identity).count();
    let shapes = rig.select(ShapeSelection { names: Some(&[]), identity_modes: modes.min(IDENTITY_MODES) })?;
    let patient = Patient::new("template", setting.data.rig.template().clone(), rig.landmarks(), shapes)?;
    let all = MorphModel::all();
    let jobs: Vec<(&str, f64, MorphModel)> =
        MASKS.iter().flat_map(|(name, amount)| all.iter().map(|model| (*name, *amount, *model))).collect();
    let outcomes = setting.run_all(&jobs, |(name, amount, model)| {
        let recipe = preset(name).with_context(|| format!("no preset {name}"))??;
        let options = ReplayOptions { amount: Some(*amount), model: Some(*model), until: None };
        patient.morph(&recipe, &options)
    });

    let columns = ["moving", "reached_over_asked", "largest_jump", "folded", "stretch_min", "stretch_max", "steps"];
    let mut table = Table::new(&[&["mask", "model"][..], &columns].concat());
    let mut sheet = Sheet::new("");
    let (mut shaded, mut coloured) = (Vec::new(), Vec::new());
    let scale = ColourScale::new(ColourMap::Viridis, 0.0, 1.0, "displacement", "of asked");
    for ((name, _, model), outcome) in jobs.iter().zip(outcomes) {
        let outcome = outcome.with_context(|| format!("{name} on model {}", model.name()))?;
        let (report, change) = (&outcome.report, outcome.report.change);
        let numbers = [
            report.moving as f64,
            change.reached / report.asked,
            change.largest_jump,
            change.folded as f64,
            change.stretch.min,
            change.stretch.max,
            report.energy.as_ref().map_or(0.0, |e| e.iterations as f64),
        ];
        let mut cells = vec![(*name).to_owned(), model.name().to_owned()];
        cells.extend(numbers.map(number));
        table.push(cells);

        let coverage = outcome.coverage();
        let covered: Vec<Vec3> =
            patient.mesh.positions.iter().zip(&coverage).filter(|(_, g)| **g > 0.05).map(|(p, _)| *p).collect();
        let frame = Frame::of(&covered).scaled(1.3);
        let camera = Camera::framing(&frame, View::Angles { yaw: 50.0, pitch: 5.0 }, [PANEL; 2]);
        let moved = patient.mesh.positions.iter().zip(&outcome.positions).map(|(a, b)| (b - a).norm() / report.asked);
        let moved = Style::Values(moved.collect(), scale.clone());
        let mesh = patient.mesh.with_positions(outcome.positions).triangulate();
        let picture = |style| render(&Scene::new().mesh(&mesh, style), &camera, [PANEL; 2]);
        shaded.push(Panel::new(picture(Style::Clay), model.name()));
        coloured.push(Panel::new(picture(moved), ""));
    }
    table.write(setting.out, "mask-models")?;
    let count = all.len();
    for (m, (name, amount)) in MASKS.iter().enumerate() {
        let of_mask = m * count..(m + 1) * count;
        let rows = shaded[of_mask.clone()].chunks(ACROSS).zip(coloured[of_mask].chunks(ACROSS));
        for (k, (shaded, coloured)) in rows.enumerate() {
            let caption = if k == 0 { format!("{name} {amount} mm") } else { String::new() };
            sheet = sheet.row(&caption, shaded.to_vec()).row("", coloured.to_vec());
        }
    }
    let caption =
        "The same mask on every model, and how far each vertex went of what was asked. Direct is the paper's own.";
    let picture = setting.picture("mask-models", &sheet.colour_bar(&scale).render(), caption)?;
    let caption = "The same in numbers: jumps across edges in millimetres, edges' length after over before.";
    Ok(vec![picture, Block::Table { table, caption: caption.into(), file: "mask-models.csv".into() }])
}

/// Side of a panel, pixels, and how many lie side by side.
const PANEL: u32 = 250;
const ACROSS: usize = 6;

/// Milliseconds of each stage over the number of vertices.
fn speed(setting: &Setting<'_>) -> Result<Vec<Block>> {
    let mut table = Table::new(&["stage", "size", "vertices", "moving", "repetition", "milliseconds"]);
    let mut series: Vec<(&str, Vec<Point>)> = Vec::new();
    let mut meshes: Vec<(String, TriangleMesh)> =
        SIZES.map(|vertices| (vertices.to_string(), face(vertices, 0, 0.0, setting.seed).mesh)).to_vec();
    if !setting.data.generated {
        meshes.push(("your template".to_owned(), setting.data.rig.template().triangulate()));
        meshes.sort_by_key(|(_, mesh)| mesh.positions.len());
    }
    for (size, mesh) in meshes {
        let frame = Frame::of(&mesh.positions);
        let camera = Camera::framing_orthographic(&frame, View::Front, [SIDE as u32; 2]);
        let projector = Projector::of_camera(&camera, [SIDE as u32; 2])?;
        let half = SIDE as f64 / 2.0;
        let region = Region::from(Shape::Circle { centre: [half, half], radius: 0.4 * half });
        let mut drawn: Option<Texture> = None;
        let draw = timed(|| {
            let hard = region.rasterize(SIDE, SIDE, Coordinates::Pixels)?;
            drawn = Some(Blur::default().apply(&hard)?);
            Ok(())
        })?;
        let texture = drawn.context("nothing was drawn")?;
        let weigh = |visibility| {
            timed(|| {
                projector.weights(&mesh, &texture, Sampling::Bilinear, visibility)?;
                Ok(())
            })
        };
        let (through, visible) = (weigh(Visibility::Through)?, weigh(Visibility::default())?);
        let weights = projector.weights(&mesh, &texture, Sampling::Bilinear, Visibility::default())?;
        let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.0, 1.0, 3.0) }];
        let step = MorphStep { pairs, ..MorphStep::default() };
        let mut moved = mesh.positions.clone();
        let morph = timed(|| Ok(step.apply_into(&mesh.positions, &mut moved)?))?;
        let moving = step.moves(mesh.positions.len())?.iter().filter(|m| **m).count();
        let mut stages = vec![
            ("draw and blur", draw),
            ("weights, through", through),
            ("weights, visible", visible),
            ("direct morph", morph),
        ];
        for (name, model) in [
            ("dragged handle, arap", MorphModel::Energy(ModelKind::Arap)),
            ("dragged handle, graph", MorphModel::Energy(ModelKind::Graph)),
        ] {
            let options = EnergyOptions { tolerance: 1e-4, ..EnergyOptions::default() };
            let (none, shapes) = (Constraints::default(), ShapeBasis::none());
            let mut energy = MorphEnergy::new(&mesh, &step, &none, model, &shapes, &options)?;
            energy.solve()?;
            let mut far = false;
            let drag = timed(|| {
                far = !far;
                energy.set_displacement(0, Vec3::new(0.0, 1.0, if far { 3.1 } else { 3.0 }))?;
                energy.solve()?;
                Ok(())
            })?;
            stages.push((name, drag));
        }
        for (name, milliseconds) in stages {
            let [all, moving] = [mesh.positions.len(), moving].map(|n| n.to_string());
            for (repetition, time) in milliseconds.iter().enumerate() {
                let of = [name, &size, &all, &moving].map(str::to_owned);
                table.push([&of[..], &[repetition.to_string(), number(*time)]].concat());
            }
            let point = mean_point(mesh.positions.len() as f64, &milliseconds);
            match series.iter_mut().find(|s| s.0 == name) {
                Some((_, points)) => points.push(point),
                None => series.push((name, vec![point])),
            }
        }
    }
    table.write(setting.out, "mask-speed.timing")?;
    let lines = series.into_iter().map(|(name, points)| Series::line(name, points)).collect();
    let svg = Plot::new("", Axis::log("vertices"), Axis::log("milliseconds")).series(lines).svg()?;
    let caption = format!(
        "Processor time on one thread: mean and range of n = {RUNS} repetitions. A frame at 25 pictures a second is 40 ms."
    );
    let figure = setting.plot("mask-speed", &svg, caption)?;
    let caption = "The same in numbers.";
    Ok(vec![figure, Block::Table { table, caption: caption.into(), file: "mask-speed.timing.csv".into() }])
}

/// Side of the texture, pixels.
const SIDE: usize = 512;

/// Milliseconds of each of [`RUNS`], after one that does not count: the first finds memory and caches cold.
fn timed(mut work: impl FnMut() -> Result<()>) -> Result<Vec<f64>> {
    work()?;
    let run = |_| {
        let (done, seconds) = cpu_seconds(&mut work)?;
        done.map(|()| 1e3 * seconds)
    };
    (0..RUNS).map(run).collect()
}
