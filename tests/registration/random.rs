//! Small registrations of random templates to random scans, with random models and options, and the corners of every model: no
//! panic, nothing that is not finite, and no step that raises the energy of its own problem.
//!
//! The cases come from a fixed seed; `NONRIGID_CASES` says how many there are, 1000 without it.

use crate::awkward::{extent, sheet};
use crate::task::Task;
use nonrigid::energy::Options;
use nonrigid::landmark::Landmark;
use nonrigid::mesh::{PolygonMesh, Pose, PoseKind, Vec3};
use nonrigid::model::GraphLevel;
use nonrigid::nlls::Kernel;
use nonrigid::registration::{
    BoundsOptions, KernelScale, Level, ModelFactory as _, ModelKind, RegistrationError, RegistrationInput,
    RegistrationResult, ScanFlip, ScanOptions, Schedule, SigmaOptions, Silent, SolverOptions, Stage, StageModel,
    StartOptions, StepAlgorithm, TERMS, WarmStartOptions, register,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::{LandmarkLevel, SeamOptions};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What is registered and how; geometry follows from `seed`.
#[derive(Debug, Clone)]
struct Case {
    seed: u64,
    model: ModelKind,
    columns: u32,
    rows: u32,
    /// Millimetres from vertex to vertex, and how much of that the scan is off the template.
    spacing: f64,
    roughness: f64,
    turn: f64,
    landmarks: usize,
    shapes: usize,
    cloud: bool,
    masked: bool,
    schedule: Schedule,
}

fn kernel() -> impl Strategy<Value = Kernel> {
    (0..9usize, 0.05..5.0).prop_map(|(kind, delta): (usize, f64)| match kind {
        0 => Kernel::None,
        1 => Kernel::Huber { delta },
        2 => Kernel::Cauchy { delta },
        3 => Kernel::GemanMcClure { delta },
        4 => Kernel::Welsch { delta },
        5 => Kernel::Tukey { delta },
        6 => Kernel::L1 { eps: delta },
        7 => Kernel::Lp { p: 0.5, eps: delta },
        _ => Kernel::Lp { p: 1.5, eps: delta },
    })
}

/// Nothing, or any power of ten about one.
fn weight() -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 3 => (-4.0..4.0).prop_map(|power: f64| 10f64.powf(power))]
}

fn level() -> impl Strategy<Value = Level> {
    let stiffness = [weight(), weight(), weight(), weight()];
    let data = [weight(), weight(), weight(), weight(), weight(), weight(), weight()];
    let rest = (1..4usize, kernel(), kernel(), 1.0..100.0, 10.0..180.0);
    (stiffness, data, rest).prop_map(
        |(stiffness, data, (steps, kernel, landmark_kernel, distance_cap, normal_angle))| {
            let scale = if steps == 3 { KernelScale::Mad } else { KernelScale::Fixed };
            let model = Options::of(&GraphLevel { kernel: landmark_kernel, ..GraphLevel::default() });
            let mut level = Level { steps, kernel, scale, distance_cap, normal_angle, model, ..Level::default() };
            LAMBDAS.iter().zip(stiffness).for_each(|(key, lambda)| level.model.set(key, lambda));
            TERMS.iter().zip(data).for_each(|(term, weight)| level.set_term(term.name(), weight));
            let landmarks = LandmarkLevel { weight: data[4], kernel: landmark_kernel };
            level.terms.insert("landmarks".into(), Options::of(&landmarks));
            level
        },
    )
}

/// What levels tell models; each takes those that it knows.
const LAMBDAS: [&str; 4] = ["lambda_graph", "lambda_blend", "lambda_smooth", "lambda_rotation"];

/// A schedule that tells its models only what they know.
fn fitted(mut schedule: Schedule, model: ModelKind) -> Schedule {
    let of = |known: Options, all: &Options| {
        all.keys()
            .filter(|key| known.get(key).is_some())
            .fold(Options::new(), |options, key| options.with(key, all.get(key).expect("it is a key").clone()))
    };
    let none = Options::new();
    let levels = |levels: &mut [Level], model: ModelKind| {
        levels.iter_mut().for_each(|l| l.model = of(model.level_options(&none).unwrap(), &l.model));
    };
    schedule.model = of(model.options(&none).unwrap(), &schedule.model);
    levels(&mut schedule.levels, model);
    levels(&mut schedule.bend, model);
    if let Some(then) = &mut schedule.then {
        let StageModel { name, options } = &mut then.model;
        *options = of(name.options(&none).unwrap(), options);
        levels(&mut then.levels, *name);
    }
    schedule
}

fn graph() -> impl Strategy<Value = Options> {
    (1..40usize, 1..9usize, 0..2usize, 0..4usize).prop_map(|(nodes, influences, distance, kind)| {
        Options::new()
            .with("nodes", nodes as i64)
            .with("influences", influences as i64)
            .with("distance", ["surface", "euclidean"][distance])
            .with("lambda_unseen", [0.0, 2.0][distance])
            .with("node", if kind == 3 { "affine" } else { "rigid" })
            .with("rotation", ["matrix", "quaternion", "angle_axis", "matrix"][kind])
    })
}

fn schedule() -> impl Strategy<Value = Schedule> {
    let levels = proptest::collection::vec(level(), 1..4);
    let then = (0..5usize, graph(), proptest::collection::vec(level(), 1..3));
    let choices = [0..3usize, 0..2, 0..2, 0..2, 0..2, 0..2, 0..3, 0..4];
    let numbers = (0.1..10.0, 0.0..3.0, 0.0..10.0, 0.1..3.0);
    (levels, graph(), then, choices, numbers).prop_map(|(levels, graph, (next, next_graph, next_levels), choice, n)| {
        let [algorithm, start, kind, weights, solver, reject_boundary, normal_smoothing, bounds] = choice;
        let next = [ModelKind::Graph, ModelKind::Arap, ModelKind::Free, ModelKind::Affine, ModelKind::Rigid][next];
        Schedule {
            start: [PoseKind::Rigid, PoseKind::Similarity][start],
            search: StartOptions { rotations: 20, coarse: 10, fine: 3, ..StartOptions::default() },
            reference_size: 67.0,
            reference_vertices: 1000.0,
            model: graph
                .with("kind", ["laplacian", "bilaplacian"][kind])
                .with("weights", ["uniform", "cotangent"][weights])
                .with("solver", ["local_global", "joint"][solver])
                .with("gamma", n.0),
            terms: [(
                "seam".to_owned(),
                Options::of(&SeamOptions { width: n.2, widest: 2.0 * n.2, ..SeamOptions::default() }),
            )]
            .into(),
            scan: ScanOptions {
                normal_smoothing,
                reject_boundary: reject_boundary == 0,
                template_rim: n.1,
                reject_hidden: kind == 0,
                flip: [ScanFlip::Auto, ScanFlip::No][weights],
            },
            solver: SolverOptions {
                algorithm: [StepAlgorithm::GaussNewton, StepAlgorithm::LevenbergMarquardt, StepAlgorithm::Dogleg]
                    [algorithm],
                ..SolverOptions::default()
            },
            stop: Default::default(),
            untangle: start == 1,
            warm_start: WarmStartOptions { steps: 1 + kind },
            sigma: SigmaOptions { expression: n.3, identity: n.3, ..SigmaOptions::default() },
            bounds: BoundsOptions {
                expression: [None, None, Some([0.0, 1.0]), Some([0.3, 0.3])][bounds],
                identity: None,
            },
            bend: if solver == 1 { levels.clone() } else { Vec::new() },
            levels,
            then: Some(Box::new(Stage {
                model: StageModel { name: next, options: next_graph },
                levels: next_levels,
                then: None,
            })),
            closed: None,
        }
    })
}

fn case() -> impl Strategy<Value = Case> {
    let size = (8..15u32, 8..14u32, -3.0..3.0, 0.0..0.5);
    let input = (0.0..0.5, 0..9usize, 0..12usize, any::<bool>(), any::<bool>());
    (any::<u64>(), 0..ModelKind::ALL.len(), size, input, schedule()).prop_map(|(seed, model, size, input, schedule)| {
        let (columns, rows, power, roughness): (u32, u32, f64, f64) = size;
        let (turn, landmarks, shapes, cloud, masked) = input;
        let model = ModelKind::ALL[model];
        // The search of a start takes longer than all the rest: one case in nine goes without three landmarks.
        let landmarks = if landmarks == 0 { seed as usize % 3 } else { landmarks + 2 };
        let shapes = if model.uses_shapes() { shapes.max(1) } else { shapes };
        let then = schedule.then.clone().filter(|_| model == ModelKind::Sequential);
        let schedule = fitted(Schedule { then, ..schedule }, model);
        Case {
            seed,
            model,
            columns,
            rows,
            spacing: 10f64.powf(power),
            roughness,
            turn,
            landmarks,
            shapes,
            cloud,
            masked,
            schedule,
        }
    })
}

fn random_vec(rng: &mut ChaCha8Rng, size: f64) -> Vec3 {
    Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0) * size)
}

fn random_shapes(rng: &mut ChaCha8Rng, mesh: &PolygonMesh, count: usize, size: f64) -> ShapeBasis {
    let names = (0..count).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
    let waves: Vec<(Vec3, Vec3)> = (0..count).map(|_| (random_vec(rng, 1.0), random_vec(rng, size))).collect();
    let rows = mesh.positions.iter().flat_map(|p| (0..3).map(move |axis| (p / (3.0 * size), axis)));
    let slab =
        rows.flat_map(|(p, axis)| waves.iter().map(move |(wave, way)| ((wave.dot(&p)).sin() * way[axis]) as f32));
    ShapeBasis::new(names, slab.collect())
}

impl Task {
    fn of(case: &Case) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(case.seed);
        let mut template = sheet(case.columns, case.rows, case.spacing);
        template.positions.iter_mut().for_each(|p| *p += random_vec(&mut rng, 0.2 * case.spacing));
        let shapes = random_shapes(&mut rng, &template, case.shapes, 2.0 * case.spacing);
        let weights: Vec<f64> = (0..case.shapes).map(|_| rng.random_range(-0.2..1.0)).collect();
        let pose = Pose::rigid(random_vec(&mut rng, case.turn), random_vec(&mut rng, 3.0 * case.spacing));
        let truth: Vec<Vec3> = (0..template.positions.len())
            .map(|v| pose.apply(shapes.blend(v, template.positions[v], &weights)))
            .collect();
        let mut scan = template.with_positions(truth.clone()).triangulate();
        scan.positions.iter_mut().for_each(|p| *p += random_vec(&mut rng, case.roughness * case.spacing));
        let missing = rng.random_range(0..scan.triangles.len() / 2);
        scan.triangles.drain(..missing);
        let scan_normals = case.cloud.then(|| {
            let kind = nonrigid::mesh::normals::NormalWeighting::Area;
            nonrigid::mesh::normals::vertex_normals(&scan.positions, &scan.triangles, kind)
        });
        if case.cloud {
            scan.triangles.clear();
        }
        let mark = |_: usize| {
            let vertex = rng.random_range(0..truth.len());
            let target = truth[vertex] + random_vec(&mut rng, 0.3 * case.spacing);
            Landmark::new(vertex.to_string(), vertex as u32, target)
        };
        let landmarks = (0..case.landmarks).map(mark).collect();
        let mask =
            case.masked.then(|| template.positions.iter().map(|p| (p.x / case.spacing).sin().max(0.0)).collect());
        Self { template, shapes, scan, scan_normals, landmarks, mask, free_mask: None }
    }
}

fn run(
    input: &RegistrationInput<'_>,
    model: ModelKind,
    schedule: &Schedule,
) -> Result<RegistrationResult, RegistrationError> {
    register(input, &model, schedule, &mut Silent)
}

/// What every result has to be.
fn sound(result: &RegistrationResult) -> Result<(), String> {
    for (v, p) in result.positions.iter().enumerate() {
        if !p.iter().all(|x| x.is_finite()) {
            return Err(format!("vertex {v} is at {p:?}"));
        }
    }
    for r in &result.history {
        if !(r.energy >= 0.0 && r.energy <= r.energy_before && r.energy_before.is_finite() && r.motion.is_finite()) {
            return Err(format!("energy {} to {} at level {}, step {}", r.energy_before, r.energy, r.level, r.step));
        }
    }
    let odd = result.weights.iter().find(|w| !w.value.is_finite() || w.std_dev.is_some_and(|d| d.is_nan()));
    odd.map_or(Ok(()), |w| Err(format!("weight {w:?}")))
}

#[test]
fn random_registrations_end_well() {
    let cases = std::env::var("NONRIGID_CASES").map_or(1000, |n| n.parse().expect("NONRIGID_CASES is a number"));
    let config = Config { cases, failure_persistence: None, max_shrink_iters: 200, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]));
    let done = std::cell::RefCell::new(std::collections::BTreeMap::<String, [usize; 2]>::new());
    let reasons = std::cell::RefCell::new(std::collections::HashMap::new());
    let outcome = runner.run(&case(), |case| {
        let task = Task::of(&case);
        let result = run(&task.input(), case.model, &case.schedule);
        let mut done = done.borrow_mut();
        let count = done.entry(case.model.to_string()).or_default();
        count[usize::from(result.is_err())] += 1;
        match result {
            Ok(result) => {
                sound(&result).map_err(TestCaseError::fail)?;
                // one of four goes on from its end
                let warm = RegistrationInput { warm_start: Some(&result.end), ..task.input() };
                let again = (result.history.len() % 4 == 0).then(|| run(&warm, case.model, &case.schedule));
                match again {
                    Some(Ok(again)) => sound(&again).map_err(TestCaseError::fail),
                    Some(Err(e @ RegistrationError::WarmStart(_))) => Err(TestCaseError::fail(e.to_string())),
                    _ => Ok(()),
                }
            }
            Err(e) if matches!(e, RegistrationError::Schedule(_)) => Err(TestCaseError::fail(e.to_string())),
            Err(e) => {
                reasons.borrow_mut().insert(std::mem::discriminant(&e), e.to_string());
                Ok(())
            }
        }
    });
    let done = done.into_inner();
    for (name, [ok, err]) in &done {
        println!("{name:24} {ok} ended, {err} refused");
    }
    reasons.into_inner().values().for_each(|reason| println!("refused, for instance: {reason}"));
    outcome.unwrap_or_else(|e| panic!("{e}"));
    let [ended, refused] = done.values().fold([0, 0], |sum, count| [sum[0] + count[0], sum[1] + count[1]]);
    assert!(ended > 4 * refused, "{ended} ended, {refused} refused: too few to learn from");
}

/// A schedule of one level for all models.
fn plain_schedule() -> Schedule {
    let mut level = Level {
        steps: 10,
        kernel: Kernel::Huber { delta: 2.0 },
        distance_cap: 30.0,
        normal_angle: 90.0,
        ..Level::default()
    };
    LAMBDAS.iter().zip([1.0, 0.1, 1.0, 1.0]).for_each(|(key, lambda)| level.model.set(key, lambda));
    level.set_term("landmarks", 1.0);
    let mut schedule = ModelKind::Graph.schedule().unwrap();
    schedule.levels = vec![level.clone(); 3];
    schedule.model.set("nodes", 12);
    schedule.scan.template_rim = 0.0;
    let model = StageModel { name: ModelKind::Arap, options: Options::new() };
    schedule.then = Some(Box::new(Stage { model, levels: vec![level], then: None }));
    schedule
}

/// A template on itself, moved by a pose, with landmarks at all corners and in the middle.
fn moved(template: &PolygonMesh, pose: &Pose) -> Task {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let truth: Vec<Vec3> = template.positions.iter().map(|&p| pose.apply(p)).collect();
    let scan = template.with_positions(truth.clone()).triangulate();
    let count = truth.len();
    let mark = |vertex: usize| Landmark::new(vertex.to_string(), vertex as u32, truth[vertex]);
    let landmarks = [0, 8, count / 2, count - 9, count - 1].map(mark).to_vec();
    let shapes = random_shapes(&mut rng, template, 4, 10.0);
    Task { template: template.clone(), shapes, scan, scan_normals: None, landmarks, mask: None, free_mask: None }
}

fn models_of(schedule: &Schedule) -> impl Iterator<Item = (ModelKind, Schedule)> + use<> {
    let schedule = schedule.clone();
    ModelKind::ALL.into_iter().map(move |model| {
        let then = schedule.then.clone().filter(|_| model == ModelKind::Sequential);
        (model, fitted(Schedule { then, ..schedule.clone() }, model))
    })
}

fn off(result: &RegistrationResult, task: &Task) -> f64 {
    let pairs = result.positions.iter().zip(&task.scan.positions);
    pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

#[test]
fn no_rotation_and_half_a_turn_are_found_by_every_model() {
    let template = sheet(9, 7, 10.0);
    let half = std::f64::consts::PI;
    for turn in
        [Vec3::zeros(), Vec3::x() * half, Vec3::y() * half, Vec3::z() * half, Vec3::new(1.0, 2.0, 2.0) * half / 3.0]
    {
        let task = moved(&template, &Pose::rigid(turn, Vec3::new(5.0, -3.0, 2.0)));
        for (model, schedule) in models_of(&plain_schedule()) {
            let result = run(&task.input(), model, &schedule).unwrap_or_else(|e| panic!("{model}, {turn:?}: {e}"));
            sound(&result).unwrap();
            assert!(off(&result, &task) < 1e-3, "{model}, {turn:?}: {} mm off", off(&result, &task));
        }
    }
}

#[test]
fn half_a_turn_of_one_part_against_the_other_leaves_every_model_sound() {
    // The start is right for the left half; the right half has to turn by pi about its own axis, or to stay behind.
    let template = sheet(9, 7, 10.0);
    let mut task = moved(&template, &Pose::identity());
    let twisted = |p: &Vec3| if p.x > 40.0 { Vec3::new(p.x, 60.0 - p.y, -p.z) } else { *p };
    task.scan.positions.iter_mut().for_each(|p| *p = twisted(p));
    for landmark in &mut task.landmarks {
        landmark.target = twisted(&landmark.target);
    }
    for (model, schedule) in models_of(&plain_schedule()) {
        let result = run(&task.input(), model, &schedule).unwrap_or_else(|e| panic!("{model}: {e}"));
        sound(&result).unwrap_or_else(|e| panic!("{model}: {e}"));
    }
}

#[test]
fn weights_of_zero_leave_every_model_where_the_start_put_it() {
    let template = sheet(9, 7, 10.0);
    let pose = Pose::rigid(Vec3::new(0.2, -0.1, 0.3), Vec3::new(5.0, -3.0, 2.0));
    let task = moved(&template, &pose);
    for stiff in [true, false] {
        let mut plain = plain_schedule();
        let still = |level: &mut Level| {
            level.set_term("point_to_plane", 0.0);
            level.set_term("landmarks", 0.0);
            if !stiff {
                LAMBDAS.iter().for_each(|key| level.model.set(key, 0.0));
            }
        };
        plain.levels.iter_mut().for_each(still);
        plain.then.iter_mut().for_each(|then| then.levels.iter_mut().for_each(still));
        for (model, schedule) in models_of(&plain) {
            let result = run(&task.input(), model, &schedule).unwrap_or_else(|e| panic!("{model}, {stiff}: {e}"));
            sound(&result).unwrap_or_else(|e| panic!("{model}, {stiff}: {e}"));
            assert!(off(&result, &task) < 1e-6, "{model}, {stiff}: {} mm off", off(&result, &task));
        }
    }
}

#[test]
fn coincident_vertices_and_more_influences_than_nodes_are_no_obstacle() {
    let pose = Pose::rigid(Vec3::new(0.2, -0.1, 0.3), Vec3::new(5.0, -3.0, 2.0));
    let mut pinched = sheet(9, 7, 10.0);
    // Two columns fall on one another, and seven vertices into one point.
    for row in 0..7 {
        pinched.positions[9 * row + 4] = pinched.positions[9 * row + 3];
    }
    let point = pinched.positions[30];
    [31, 32, 40, 41, 39, 21, 22].iter().for_each(|&v| pinched.positions[v] = point);
    let task = moved(&pinched, &pose);
    let (size, _) = extent(&pinched);
    for (nodes, influences) in [(1, 1), (1, 8), (3, 20), (63, 4), (1000, 64)] {
        for distance in ["surface", "euclidean"] {
            let mut plain = plain_schedule();
            plain.model.set("nodes", nodes);
            plain.model.set("influences", influences);
            plain.model.set("distance", distance);
            for (model, schedule) in models_of(&plain) {
                let what = format!("{model}, {nodes} nodes, {influences} influences, {distance}");
                let result = run(&task.input(), model, &schedule).unwrap_or_else(|e| panic!("{what}: {e}"));
                sound(&result).unwrap_or_else(|e| panic!("{what}: {e}"));
                assert!(off(&result, &task) < 0.01 * size, "{what}: {} mm off", off(&result, &task));
            }
        }
    }
}
