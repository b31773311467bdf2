//! One mask on every deformation model, and how fast a mask is drawn, projected and dragged.

use anyhow::{Context, Result};
use nonrigid::evaluation::self_intersections;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::morph::{
    Blur, Constraints, Coordinates, EnergyOptions, MaskedDisplacement, MorphChange, MorphEnergy, MorphModel, MorphStep,
    Projector, Region, Sampling, Shape, Texture, Visibility, Weights,
};
use nonrigid::registration::ModelKind;
use nonrigid::render::{Camera, ColourMap, ColourScale, Frame, Panel, Scene, Sheet, Style, View, render};
use nonrigid::rig::{IDENTITY_MODES, ShapeBasis, ShapeSelection};

use crate::generated::face;
use crate::plots::{Axis, Plot, Point, Series};
use crate::report::study::{
    Block, Section, Setting, Study, cpu_seconds, least_and_most, mean_point, one_thread, ranked, spread,
};
use crate::report::table::{Table, number};
use crate::scaling::{Configuration, MorphRun, run_apart};
use crate::scan_bench::megabytes;
use crate::surgery::{Masked, Patient};
use crate::tables::grouped;

pub const STUDY: Study = Study {
    name: "mask-models",
    title: "Li 2018: one mask on every model, and its speed",
    about: "Varied: the deformation model under the same masks, on faces of 5,000 and 20,000 vertices; then the number of vertices. Held: \
            mask, displacement, the smoothing length of 2 mm, 60 identity modes for the models with blendshapes. Measured: what was \
            reached of what was asked; how far the result is from what the mask asks (the paper's own result) and from soft tissue, \
            rms over the vertices that move; what becomes of volume, edges, triangles and of the held border; processor time to the \
            first result and of a handle that is dragged by a tenth of a millimetre; memory. Soft tissue is the reference for \
            realism: the same mask on a layer of linear elastic tissue 5 mm thick, by finite elements on triangles so much smaller \
            that the face has 80,000 vertices. The elements' own error there is that of their size; for the other models it says how \
            far they are from elasticity, not from a patient.",
    tables: &["mask-models", "mask-cost.timing", "mask-memory.timing", "mask-argument.timing", "mask-speed.timing"],
    seconds: |_| 21.0,
    run,
};

/// Presets and millimetres that every model is given: more than usual, so that differences show.
const MASKS: [(&str, f64); 3] = [("nose-bridge", 4.0), ("chin-forward", 6.0), ("hump", 2.5)];
/// Vertices of the faces on which models are compared, about.
const FACES: [usize; 2] = [5000, 20_000];
/// The reference is computed on meshes of so many vertices at least.
const FINE: usize = 60_000;
/// Vertices of a third face, on which masks alone are timed, about.
const LARGEST: usize = 100_000;
/// Repetitions of what is timed of masks alone, and of models.
const RUNS: usize = 5;
const REPEATS: usize = 3;
/// Energies are minimised so far while a handle is dragged.
const DRAG_TOLERANCE: f64 = 1e-4;
/// Millimetres.
const DRAG: f64 = 0.1;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let cases = cases(setting)?;
    let models = MorphModel::all();
    let jobs: Vec<(&Case, MorphModel)> = cases.iter().flat_map(|case| models.iter().map(move |m| (case, *m))).collect();
    let outcomes = setting.run_each_on_one_thread(&jobs, |(case, model)| {
        Outcome::of(case, *model).with_context(|| format!("{} on model {}", case.name, model.name()))
    })?;
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;

    write_results(setting, &jobs, &outcomes)?;
    write_costs(setting, &jobs, &outcomes)?;
    let argument = argument(setting, &models)?;
    let tissue = ranked(&argument, &[], "model", "off_tissue")?;
    let drag = ranked(&argument, &[], "model", "drag_ms")?;
    let finding = [
        least_and_most("share of the displacement off soft tissue", &tissue, ""),
        least_and_most("time of a drag", &drag, " ms"),
    ]
    .join(" ");
    let mut blocks = vec![picture(setting, &jobs, &outcomes)?];
    blocks.push(plot(setting, &argument)?);
    let caption = format!(
        "Means over masks and faces; times are medians of n = {REPEATS}; they and memory are means over the masks on the face of {} vertices. Shares \
         are of the displacement asked for; volume is that between the surfaces before and after, over the paper's own.",
        FACES[1]
    );
    blocks.push(Block::Table { table: argument, caption, file: "mask-argument.timing.csv".into() });
    let table = Table::read(&setting.out.join("mask-models.csv"))?;
    let caption = "Each mask on each face: jumps and the step at the border in millimetres, edges' length after over before, steps of the \
                   minimiser to the result and of a drag.";
    blocks.push(Block::Table { table, caption: caption.into(), file: "mask-models.csv".into() });
    let mut meshes: Vec<(&str, &TriangleMesh)> =
        cases.iter().map(|case| (&*case.size, &case.masked.triangles)).collect();
    meshes.dedup_by_key(|(size, _)| *size);
    let largest = face(LARGEST, 0, 0.0, setting.seed).mesh;
    let name = LARGEST.to_string();
    meshes.push((&name, &largest));
    blocks.extend(one_thread()?.install(|| speed(setting, &meshes))?);
    Ok(Section { finding, blocks })
}

/// A mask on a face.
struct Case {
    name: String,
    mask: &'static str,
    amount: f64,
    size: String,
    masked: Masked,
    moves: Vec<bool>,
    /// Where the paper's own method takes the vertices, and soft tissue.
    direct: Vec<Vec3>,
    tissue: Vec<Vec3>,
    edges: EdgeGraph,
    intersections: usize,
}

fn cases(setting: &Setting<'_>) -> Result<Vec<Case>> {
    let mut faces = Vec::new();
    for vertices in FACES {
        faces.push((vertices.to_string(), Patient::generated(vertices, IDENTITY_MODES)?));
    }
    if !setting.data.generated {
        let rig = setting.data.rig.rig();
        let identity_modes = rig.usual_identity_modes(None, false);
        let shapes = rig.select(ShapeSelection { names: Some(&[]), identity_modes })?;
        let template = setting.data.rig.template().clone();
        let name = "your template".to_owned();
        faces.insert(0, (name.clone(), Patient::new(name, template, rig.landmarks(), shapes)?));
    }
    let both: Vec<_> = faces.iter().flat_map(|face| MASKS.map(|mask| (face, mask))).collect();
    let cases = setting.run_all(&both, |((size, patient), (mask, amount))| -> Result<Case> {
        let masked = Masked::new(patient.clone(), mask, *amount)?;
        let mesh = &masked.triangles;
        Ok(Case {
            name: format!("{mask} on {size}"),
            mask,
            amount: *amount,
            size: size.clone(),
            moves: masked.step.moves(mesh.positions.len())?,
            direct: masked.step.apply(&mesh.positions)?,
            tissue: tissue(&masked)?,
            edges: EdgeGraph::of(mesh),
            intersections: self_intersections(&mesh.positions, &mesh.triangles)?.len(),
            masked,
        })
    });
    cases.into_iter().collect()
}

/// Where soft tissue goes, by finite elements on a finer mesh of the same surface under the same mask.
fn tissue(masked: &Masked) -> Result<Vec<Vec3>> {
    let mut fine = masked.triangles.clone();
    let mut weights = masked.step.pairs[0].weights.values().to_vec();
    while fine.positions.len() < FINE {
        (fine, weights) = quartered(&fine, &weights);
    }
    let pair = MaskedDisplacement { weights: Weights::new(weights)?, displacement: masked.displacement() };
    let step = MorphStep { pairs: vec![pair], ..masked.step.clone() };
    let model = MorphModel::Energy(ModelKind::Fem);
    let options = EnergyOptions { tolerance: 1e-5, ..EnergyOptions::default() };
    let (none, shapes) = (Constraints::default(), ShapeBasis::none());
    let mut moved = MorphEnergy::new(&fine, &step, &none, model, &shapes, &options)?.solve()?.0;
    moved.truncate(masked.triangles.positions.len());
    Ok(moved)
}

/// Four triangles for each, new vertices on the middles of the edges after the old.
fn quartered(mesh: &TriangleMesh, weights: &[f64]) -> (TriangleMesh, Vec<f64>) {
    let graph = EdgeGraph::of(mesh);
    let (mut positions, mut all) = (mesh.positions.clone(), weights.to_vec());
    for [a, b] in graph.edges().iter().map(|edge| edge.map(|v| v as usize)) {
        positions.push((mesh.positions[a] + mesh.positions[b]) / 2.0);
        all.push((weights[a] + weights[b]) / 2.0);
    }
    let first = mesh.positions.len() as u32;
    let middle = |a: u32, b: u32| first + graph.find(a, b).expect("proven: a side of a triangle is an edge") as u32;
    let four = |&[a, b, c]: &[u32; 3]| {
        let [p, q, r] = [middle(a, b), middle(b, c), middle(c, a)];
        [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
    };
    (TriangleMesh { positions, triangles: mesh.triangles.iter().flat_map(four).collect() }, all)
}

/// What became of a case on a model, and what it took.
struct Outcome {
    positions: Vec<Vec3>,
    intersections: usize,
    steps: usize,
    /// Of the last drag.
    drag_steps: usize,
    /// Milliseconds from the drawn mask to the result of the first [`DRAG`].
    first: Vec<f64>,
    /// Milliseconds of another, later.
    drag: Vec<f64>,
}

impl Outcome {
    fn of(case: &Case, model: MorphModel) -> Result<Self> {
        let masked = &case.masked;
        let intersections = |p: &[Vec3]| self_intersections(p, &masked.triangles.triangles).map(|pairs| pairs.len());
        if model == MorphModel::Direct {
            let step = || Ok(masked.step.apply(&masked.triangles.positions).map(|_| ())?);
            let (first, drag) = (timed(REPEATS, step)?, timed(REPEATS, step)?);
            let (positions, intersections) = (case.direct.clone(), intersections(&case.direct)?);
            return Ok(Self { positions, intersections, steps: 0, drag_steps: 0, first, drag });
        }
        let (positions, report) = masked.energy(model, &EnergyOptions::default())?.solve()?;
        let options = EnergyOptions { tolerance: DRAG_TOLERANCE, ..EnergyOptions::default() };
        let displacement = masked.displacement();
        let little = displacement * (DRAG / displacement.norm());
        let mut last = None;
        let first = timed(REPEATS, || {
            let mut energy = masked.energy(model, &options)?;
            energy.set_displacement(0, little)?;
            energy.solve()?;
            last = Some(energy);
            Ok(())
        })?;
        let mut energy = last.context("nothing was timed")?;
        energy.set_displacement(0, displacement)?;
        energy.solve()?;
        let (mut far, mut drag_steps) = (false, 0);
        let drag = timed(REPEATS, || {
            far = !far;
            energy.set_displacement(0, if far { displacement + little } else { displacement })?;
            drag_steps = energy.solve()?.1.iterations;
            Ok(())
        })?;
        let (intersections, steps) = (intersections(&positions)?, report.iterations);
        Ok(Self { positions, intersections, steps, drag_steps, first, drag })
    }
}

/// The volume between the surface and the origin: of two surfaces with the same border the difference is what lies between them.
fn volume(positions: &[Vec3], triangles: &[[u32; 3]]) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        a.dot(&b.cross(&c)) / 6.0
    };
    triangles.iter().map(of).sum()
}

fn write_results(setting: &Setting<'_>, jobs: &[(&Case, MorphModel)], outcomes: &[Outcome]) -> Result<()> {
    let columns = [
        "moving",
        "reached_over_asked",
        "off_asked",
        "off_tissue",
        "volume_over_direct",
        "stretch_min",
        "stretch_max",
        "folded",
        "self_intersections_added",
        "largest_jump",
        "border_step",
        "held_moved",
        "steps",
        "drag_steps",
    ];
    let mut table = Table::new(&[&["case", "mask", "size", "model"][..], &columns].concat());
    for ((case, model), outcome) in jobs.iter().zip(outcomes) {
        let Case { masked, moves, edges, .. } = case;
        let (mesh, asked) = (&masked.triangles, masked.displacement().norm());
        let positions = &outcome.positions;
        let change = MorphChange::of(&masked.patient.mesh, positions)?;
        let moving = moves.iter().filter(|m| **m).count() as f64;
        let from = |other: &[Vec3]| {
            let square = |v: usize| (positions[v] - other[v]).norm_squared();
            ((0..moves.len()).filter(|v| moves[*v]).map(square).sum::<f64>() / moving).sqrt()
        };
        let gained = |moved: &[Vec3]| volume(moved, &mesh.triangles) - volume(&mesh.positions, &mesh.triangles);
        let displacement = |v: usize| positions[v] - mesh.positions[v];
        let border = edges.edges().iter().map(|e| e.map(|v| v as usize)).filter(|[a, b]| moves[*a] != moves[*b]);
        let greatest = |lengths: &mut dyn Iterator<Item = f64>| lengths.fold(0.0, f64::max);
        let numbers = [
            moving,
            change.reached / asked,
            from(&case.direct) / asked,
            from(&case.tissue) / asked,
            gained(positions) / gained(&case.direct),
            change.stretch.min,
            change.stretch.max,
            change.folded as f64,
            outcome.intersections as f64 - case.intersections as f64,
            change.largest_jump,
            greatest(&mut border.map(|[a, b]| (displacement(a) - displacement(b)).norm())),
            greatest(&mut (0..moves.len()).filter(|v| !moves[*v]).map(|v| displacement(v).norm())),
            outcome.steps as f64,
            outcome.drag_steps as f64,
        ];
        let of = [&case.name, case.mask, &case.size, model.name()].map(str::to_owned);
        table.push([&of[..], &numbers.map(number)].concat());
    }
    table.write(setting.out, "mask-models")
}

fn write_costs(setting: &Setting<'_>, jobs: &[(&Case, MorphModel)], outcomes: &[Outcome]) -> Result<()> {
    let mut times = Table::new(&["mask", "size", "model", "repetition", "first", "drag"]);
    for ((case, model), outcome) in jobs.iter().zip(outcomes) {
        for (repetition, (first, drag)) in outcome.first.iter().zip(&outcome.drag).enumerate() {
            let of = [case.mask, &case.size, model.name()].map(str::to_owned);
            times.push([&of[..], &[repetition.to_string(), number(*first), number(*drag)]].concat());
        }
    }
    times.write(setting.out, "mask-cost.timing")?;

    let models = MorphModel::all();
    let runs = FACES.map(|vertices| {
        let masks = MASKS.iter().map(|(mask, amount)| ((*mask).to_owned(), *amount)).collect();
        Configuration::Morph(MorphRun { vertices, modes: IDENTITY_MODES, masks, models: models.clone() })
    });
    let grown = setting.run_all(&runs, |run| run_apart(setting.program, run));
    let mut memory = Table::new(&["mask", "size", "model", "mb"]);
    for (vertices, grown) in FACES.iter().zip(grown) {
        let grown = grown?;
        for (m, (mask, _)) in MASKS.iter().enumerate() {
            for (k, model) in models.iter().enumerate() {
                let grown = grown["grown_bytes"][m][k].as_u64().map_or(f64::NAN, megabytes);
                memory.push([mask, &*vertices.to_string(), model.name(), &number(grown)].map(str::to_owned).to_vec());
            }
        }
    }
    memory.write(setting.out, "mask-memory.timing")
}

/// The table of the paper's argument, a row for each model.
fn argument(setting: &Setting<'_>, models: &[MorphModel]) -> Result<Table> {
    let read = |name: &str| Table::read(&setting.out.join(format!("{name}.csv")));
    let (results, times, memory) = (read("mask-models")?, read("mask-cost.timing")?, read("mask-memory.timing")?);
    let columns = [
        "reached_over_asked",
        "off_asked",
        "off_tissue",
        "volume_over_direct",
        "stretch_max",
        "folded",
        "self_intersections_added",
        "border_step",
        "held_moved",
    ];
    let mut table = Table::new(&[&["model", "drag_ms", "first_ms", "memory_mb"][..], &columns].concat());
    let large = FACES[1].to_string();
    for model in models.iter().map(MorphModel::name) {
        let mut cells = vec![model.to_owned()];
        for column in ["drag", "first"] {
            let mut of_masks = Vec::new();
            for (mask, _) in MASKS {
                let row = [("mask", mask), ("size", large.as_str()), ("model", model)];
                of_masks.push(median(times.numbers(&row, column)?));
            }
            cells.push(number(spread(&of_masks).0));
        }
        cells.push(number(spread(&memory.numbers(&[("size", large.as_str()), ("model", model)], "mb")?).0));
        for column in columns {
            cells.push(number(spread(&results.numbers(&[("model", model)], column)?).0));
        }
        table.push(cells);
    }
    table.write(setting.out, "mask-argument.timing")?;
    Ok(table)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// What a step of a drag takes, and how far from soft tissue it ends.
fn plot(setting: &Setting<'_>, argument: &Table) -> Result<Block> {
    let mut series = Vec::new();
    for row in &argument.rows {
        let of = |column: &str| -> Result<f64> { Ok(row[argument.column(column)?].parse().unwrap_or(f64::NAN)) };
        let point = Point { x: of("drag_ms")?, y: 100.0 * of("off_tissue")?, spread: None };
        series.push(Series::line(&row[0], vec![point]));
    }
    let (x, y) = (Axis::log("milliseconds of a dragged handle"), Axis::log("% of the displacement off soft tissue"));
    let caption =
        "Cost and realism of each model, as in the table below: to the left is fast, down is near to soft tissue.";
    setting.plot("mask-argument", &Plot::new("", x, y).series(series).svg()?, caption)
}

/// The masks on the first face, shaded, and how far each vertex went.
fn picture(setting: &Setting<'_>, jobs: &[(&Case, MorphModel)], outcomes: &[Outcome]) -> Result<Block> {
    let mut sheet = Sheet::new("");
    let scale = ColourScale::new(ColourMap::Viridis, 0.0, 1.0, "displacement", "of asked");
    let count = MorphModel::all().len();
    for (jobs, outcomes) in jobs.chunks(count).zip(outcomes.chunks(count)).take(PICTURED) {
        let case = jobs[0].0;
        let (mesh, asked) = (&case.masked.triangles, case.masked.displacement().norm());
        let weights = case.masked.step.pairs[0].weights.values();
        let covered: Vec<Vec3> = mesh.positions.iter().zip(weights).filter(|(_, g)| **g > 0.05).map(|p| *p.0).collect();
        let frame = Frame::of(&covered).scaled(1.3);
        let camera = Camera::framing(&frame, View::Angles { yaw: 50.0, pitch: 5.0 }, [PANEL; 2]);
        let (mut shaded, mut coloured) = (Vec::new(), Vec::new());
        for ((_, model), outcome) in jobs.iter().zip(outcomes) {
            let moved = mesh.positions.iter().zip(&outcome.positions).map(|(a, b)| (b - a).norm() / asked);
            let moved = Style::Values(moved.collect(), scale.clone());
            let mesh = TriangleMesh { positions: outcome.positions.clone(), triangles: mesh.triangles.clone() };
            let picture = |style| render(&Scene::new().mesh(&mesh, style), &camera, [PANEL; 2]);
            shaded.push(Panel::new(picture(Style::Clay), model.name()));
            coloured.push(Panel::new(picture(moved), ""));
        }
        for (k, (shaded, coloured)) in shaded.chunks(ACROSS).zip(coloured.chunks(ACROSS)).enumerate() {
            let caption = if k == 0 { format!("{} {} mm", case.mask, case.amount) } else { String::new() };
            sheet = sheet.row(&caption, shaded.to_vec()).row("", coloured.to_vec());
        }
    }
    let caption =
        "The same mask on every model, and how far each vertex went of what was asked. Direct is the paper's own.";
    setting.picture("mask-models", &sheet.colour_bar(&scale).render(), caption)
}

/// Masks that are shown, on the first face.
const PICTURED: usize = 2;
/// Side of a panel, pixels, and how many lie side by side.
const PANEL: u32 = 250;
const ACROSS: usize = 6;

/// Milliseconds of each stage over the number of vertices.
fn speed(setting: &Setting<'_>, meshes: &[(&str, &TriangleMesh)]) -> Result<Vec<Block>> {
    let mut table = Table::new(&["stage", "size", "vertices", "moving", "repetition", "milliseconds"]);
    let mut points: Vec<(&str, Point)> = Vec::new();
    for &(size, mesh) in meshes {
        let frame = Frame::of(&mesh.positions);
        let camera = Camera::framing_orthographic(&frame, View::Front, [SIDE as u32; 2]);
        let projector = Projector::of_camera(&camera, [SIDE as u32; 2])?;
        let half = SIDE as f64 / 2.0;
        let region = Region::from(Shape::Circle { centre: [half, half], radius: 0.4 * half });
        let mut drawn: Option<Texture> = None;
        let draw = timed(RUNS, || {
            let hard = region.rasterize(SIDE, SIDE, Coordinates::Pixels)?;
            drawn = Some(Blur::default().apply(&hard)?);
            Ok(())
        })?;
        let texture = drawn.context("nothing was drawn")?;
        let weigh = |visibility| {
            timed(RUNS, || {
                projector.weights(mesh, &texture, Sampling::Bilinear, visibility)?;
                Ok(())
            })
        };
        let (through, visible) = (weigh(Visibility::Through)?, weigh(Visibility::default())?);
        let weights = projector.weights(mesh, &texture, Sampling::Bilinear, Visibility::default())?;
        let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.0, 1.0, 3.0) }];
        let step = MorphStep { pairs, ..MorphStep::default() };
        let mut moved = mesh.positions.clone();
        let morph = timed(RUNS, || Ok(step.apply_into(&mesh.positions, &mut moved)?))?;
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
            let mut energy = MorphEnergy::new(mesh, &step, &none, model, &shapes, &options)?;
            energy.solve()?;
            let mut far = false;
            let drag = timed(RUNS, || {
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
                let of = [name, size, &all, &moving].map(str::to_owned);
                table.push([&of[..], &[repetition.to_string(), number(*time)]].concat());
            }
            points.push((name, mean_point(mesh.positions.len() as f64, &milliseconds)));
        }
    }
    table.write(setting.out, "mask-speed.timing")?;
    let lines = grouped(points).into_iter().map(|(name, points)| Series::line(name, points)).collect();
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

/// Milliseconds of each of so many runs, after one that does not count: the first finds memory and caches cold.
fn timed(runs: usize, mut work: impl FnMut() -> Result<()>) -> Result<Vec<f64>> {
    work()?;
    let run = |_| {
        let (done, seconds) = cpu_seconds(&mut work)?;
        done.map(|()| 1e3 * seconds)
    };
    (0..runs).map(run).collect()
}
