//! Laws of a whole registration, on generated faces and scans.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use crate::support::farthest;
use crate::task::Task;
use crate::threads::on_threads;
use data_gen::{FaceOptions, FaceRig, ScanCase, ScanOptions, simulate_scan};
use nalgebra::Rotation3;
use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::evaluation::{TruthErrors, self_intersections};
use nonrigid::landmark::Landmark;
use nonrigid::mesh::closest_point::{ClosestPoint, ClosestVertices};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::mesh::{PolygonMesh, Pose, PoseKind, TriangleMesh, Vec3, closest_pose};
use nonrigid::model::{
    Arap, ArapOptions, ArapSolver, EdgeWeights, Fem, Ffd, Free, FreeOptions, Hybrid, Laplacian, LaplacianOptions,
    LatticeOptions, MassSpring, NodeGraph, Poisson, PoissonOptions, Smoothness, SpringOptions, Stiffness,
    TissueOptions, blendshape, graph, rigid, similarity, sumner,
};
use nonrigid::nlls::{Kernel, Minimizer, Options, Problem};
use nonrigid::registration::{
    Level, ModelFactory as _, ModelKind, RegistrationError, RegistrationInput, RegistrationObserver,
    RegistrationResult, RegistrationStop, Schedule, ScheduleError, Silent, Stage, StageModel, StepAlgorithm,
    StepRecord, StopOptions, TERMS, register,
};
use nonrigid::rig::{ShapeBasis, ShapeSelection};
use nonrigid::term::{Landmarks, PointToPlane, PointToPoint};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

impl Task {
    /// A person unknown to the rig: all expressions and the first identity modes.
    fn new(rig: &FaceRig, case: &ScanCase, identity_modes: usize) -> Self {
        let selection = ShapeSelection { identity_modes, ..ShapeSelection::default() };
        let shapes = rig.to_rig().unwrap().select(selection).unwrap();
        let landmarks = case.landmark_pairs();
        let (template, scan) = (rig.mesh.clone(), case.scan.clone());
        Self { template, shapes, scan, scan_normals: None, landmarks, mask: None, free_mask: None }
    }

    fn fit(&self, model: ModelKind) -> RegistrationResult {
        self.fit_by(model, &model.schedule().unwrap())
    }

    fn fit_by(&self, model: ModelKind, schedule: &Schedule) -> RegistrationResult {
        register(&self.input(), &model, schedule, &mut Silent).unwrap_or_else(|e| panic!("{model}: {e}"))
    }

    /// The scan and its landmarks in another place.
    fn moved(&self, place: impl Fn(Vec3) -> Vec3) -> Self {
        let mut task = self.clone();
        task.scan.positions.iter_mut().for_each(|p| *p = place(*p));
        task.landmarks.iter_mut().for_each(|l| l.target = place(l.target));
        for normal in task.scan_normals.iter_mut().flatten() {
            *normal = (place(*normal) - place(Vec3::zeros())).normalize();
        }
        task
    }

    /// The scan as a point cloud: its vertices with their normals.
    fn as_cloud(&self) -> Self {
        let normals = vertex_normals(&self.scan.positions, &self.scan.triangles, NormalWeighting::Area);
        let scan = TriangleMesh { triangles: Vec::new(), ..self.scan.clone() };
        Self { scan, scan_normals: Some(normals), ..self.clone() }
    }

    /// Pushes the vertices of the scan by `push`, whose argument is where the template has the nearest true vertex.
    fn pushed(&self, truth: &[Vec3], push: impl Fn(&Vec3) -> Vec3) -> Self {
        let tree = ClosestVertices::new(truth).unwrap();
        let mut task = self.clone();
        for p in &mut task.scan.positions {
            *p += push(&self.template.positions[tree.query(p).unwrap().vertex as usize]);
        }
        task
    }
}

fn small() -> (FaceRig, ScanCase) {
    let rig = FaceRig::generate(&FaceOptions { vertices: 600, ..FaceOptions::default() });
    let case = simulate_scan(&rig, &ScanOptions::default(), 3).unwrap();
    (rig, case)
}

pub fn small_task() -> Task {
    let (rig, case) = small();
    Task::new(&rig, &case, 5)
}

fn rmse(rig: &FaceRig, case: &ScanCase, result: &RegistrationResult) -> f64 {
    let triangles = rig.mesh.triangulate().triangles;
    TruthErrors::new(&result.positions, &case.truth, &case.observed, &triangles).unwrap().0.rmse
}

pub fn bits(positions: &[Vec3]) -> Vec<[u64; 3]> {
    positions.iter().map(|p| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()]).collect()
}

#[test]
fn the_hybrid_recovers_faces_better_than_its_parts() {
    // The subject's neutral is known, one of the two expressions shown is not: blendshapes alone cannot reach it, and the
    // graph alone does not know where skin slides.
    let rig = FaceRig::generate(&FaceOptions { vertices: 2500, ..FaceOptions::default() });
    let models = [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Blendshape, ModelKind::Rigid];
    let cases = [
        (21, ("jawOpen", 0.4), ("mouthSmile_L", 0.9)),
        (22, ("mouthPucker", 1.0), ("browInnerUp", 0.8)),
        (23, ("eyeBlink_R", 0.8), ("cheekPuff", 0.9)),
        (24, ("mouthSmile_L", 0.9), ("mouthSmile_R", 0.8)),
        (25, ("mouthSmile_R", 0.8), ("browDown_L", 0.9)),
        (26, ("mouthPucker", 0.9), ("noseSneer", 0.8)),
        (27, ("mouthPucker", 0.9), ("cheekPuff", 0.8)),
        (28, ("browInnerUp", 0.8), ("mouthSmile_L", 0.9)),
    ];
    let mut mean = [0.0; 4];
    for (seed, known, withheld) in cases {
        let wanted = [known, withheld].map(|(name, w)| (name.to_owned(), w)).to_vec();
        let options = ScanOptions { expressions: Some(wanted), landmark_noise: 0.3, ..ScanOptions::default() };
        let case = simulate_scan(&rig, &options, seed).unwrap();
        let mut subject = rig.clone();
        subject.neutral = rig.pose(&[], &case.identity_weights);
        subject.mesh.positions.clone_from(&subject.neutral);
        subject.expressions.retain(|e| !e.0.starts_with(withheld.0));
        let task = Task::new(&subject, &case, 0);
        let rmse = models.map(|model| rmse(&rig, &case, &task.fit(model)));
        println!("seed {seed}: {rmse:.3?}");
        assert!(rmse[0] < 0.8 * rmse[3], "seed {seed}: hybrid {:.3} mm, rigid {:.3} mm", rmse[0], rmse[3]);
        mean.iter_mut().zip(rmse).for_each(|(m, e)| *m += e / cases.len() as f64);
    }
    let [hybrid, graph, blendshape, rigid] = mean;
    let numbers = format!("mm: hybrid {hybrid:.3}, graph {graph:.3}, blendshape {blendshape:.3}, rigid {rigid:.3}");
    assert!(hybrid < 1.2, "{numbers}");
    assert!(hybrid < 0.8 * graph && hybrid < 0.8 * blendshape && graph.max(blendshape) < 0.8 * rigid, "{numbers}");
}

#[test]
fn shut_eyes_and_closed_lips_cross_no_more_than_at_rest() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 1500, ..FaceOptions::default() });
    let triangles = rig.mesh.triangulate().triangles;
    let shown = [("eyeBlink_L", 1.0), ("eyeBlink_R", 1.0), ("mouthPucker", 0.9)].map(|(name, w)| (name.to_owned(), w));
    let options = ScanOptions { expressions: Some(shown.to_vec()), ..ScanOptions::default() };
    let case = simulate_scan(&rig, &options, 31).unwrap();
    let task = Task::new(&rig, &case, 5);
    let parted = task.fit(ModelKind::Hybrid);
    let left = task.fit_by(ModelKind::Hybrid, &Schedule { untangle: false, ..ModelKind::Hybrid.schedule().unwrap() });
    let crossings = |result: &RegistrationResult| self_intersections(&result.positions, &triangles).unwrap().len();
    let done = parted.untangled.unwrap();
    assert_eq!((left.untangled, done.before, done.after), (None, crossings(&left), crossings(&parted)));
    assert!(done.before > done.at_rest + 30 && done.after <= done.at_rest, "{done:?}");
    // The model is where it was, and the truth no farther.
    assert_eq!((&parted.weights, &parted.end.parameters), (&left.weights, &left.end.parameters));
    let [parted, left] = [&parted, &left].map(|result| rmse(&rig, &case, result));
    assert!(parted < left + 0.02, "{parted} {left}");
}

#[test]
fn the_rigid_models_find_the_closed_form_on_the_moved_template() {
    let (rig, _) = small();
    let turn = Rotation3::from_euler_angles(0.06, -0.05, 0.04);
    for (model, kind, scale) in
        [(ModelKind::Rigid, PoseKind::Rigid, 1.0), (ModelKind::Similarity, PoseKind::Similarity, 1.02)]
    {
        let place = |p: Vec3| turn * p * scale + Vec3::new(1.5, -2.0, 1.0);
        let scan = TriangleMesh {
            positions: rig.neutral.iter().map(|p| place(*p)).collect(),
            triangles: rig.mesh.triangulate().triangles,
        };
        let pairs: Vec<(Vec3, Vec3)> = rig.neutral.iter().copied().zip(scan.positions.iter().copied()).collect();
        let closed: Pose = closest_pose(&pairs, kind).unwrap();
        let expected: Vec<Vec3> = rig.neutral.iter().map(|p| closed.apply(*p)).collect();
        let template = rig.mesh.clone();
        let task = Task { template, shapes: ShapeBasis::none(), scan, landmarks: Vec::new(), ..small_task() };
        let mut schedule = model.schedule().unwrap();
        schedule.stop.energy = 0.0;
        schedule.stop.motion = 1e-9;
        let distance = farthest(&task.fit_by(model, &schedule).positions, &expected);
        println!("{model}: {distance}");
        assert!(distance < 1e-6, "{model}: {distance}");
    }
}

#[test]
fn kernels_scaled_by_the_residuals_fit_through_outliers_whatever_their_own_unit() {
    let (rig, _) = small();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let turn = Rotation3::from_euler_angles(0.03, -0.02, 0.04);
    let truth: Vec<Vec3> = rig.neutral.iter().map(|p| turn * p + Vec3::new(1.5, -2.0, 1.0)).collect();
    // A fifth of the scan, all on one side, stands out by 4 mm; the rest has a tenth of a millimetre of noise.
    let lifted = |p: &Vec3| if p.x > 25.0 { 4.0 } else { rng.random_range(-0.1..0.1) };
    let heights: Vec<f64> = rig.neutral.iter().map(lifted).collect();
    assert!((0.1..0.4).contains(&(heights.iter().filter(|h| **h == 4.0).count() as f64 / truth.len() as f64)));
    let positions = truth.iter().zip(heights).map(|(p, h)| p + Vec3::z() * h).collect();
    let scan = TriangleMesh { positions, triangles: rig.mesh.triangulate().triangles };
    // Landmarks on the other side, for a smooth face says little along itself.
    let on = (0..truth.len()).filter(|&v| rig.neutral[v].x < 20.0).step_by(40);
    let landmarks = on.map(|v| Landmark::new(v.to_string(), v as u32, truth[v])).collect();
    let task = Task { template: rig.mesh.clone(), shapes: ShapeBasis::none(), scan, landmarks, ..small_task() };
    let error = |kernel: &str| {
        let text = ModelKind::Rigid.default_schedule();
        let lines = text.lines().map(|line| if line.starts_with("kernel") { kernel } else { line });
        let schedule = Schedule::from_toml(&lines.collect::<Vec<_>>().join("\n")).unwrap();
        farthest(&task.fit_by(ModelKind::Rigid, &schedule).positions, &truth)
    };
    let (plain, scaled) =
        (error("kernel = \"none\""), error("kernel = { tukey = { delta = 4.685 } }\nscale = \"mad\""));
    println!("farthest vertex: {plain} mm without a kernel, {scaled} mm with");
    assert!(scaled < 0.5 && plain > 2.0 * scaled, "{plain} {scaled}");
}

#[test]
fn moving_scan_and_landmarks_moves_the_result() {
    let task = small_task();
    let turn = Rotation3::from_euler_angles(0.4, -1.0, 2.0);
    let place = |p: Vec3| turn * p + Vec3::new(40.0, -300.0, 25.0);
    let moved = task.moved(place);
    for model in ModelKind::ALL {
        let expected: Vec<Vec3> = task.fit(model).positions.into_iter().map(place).collect();
        let distance = farthest(&moved.fit(model).positions, &expected);
        assert!(distance < 1e-6, "{model}: {distance}");
    }
}

/// A model's default schedule with the terms that are off by default.
fn with_all_terms(model: ModelKind) -> Schedule {
    let mut schedule = model.schedule().unwrap();
    for level in &mut schedule.levels {
        for (term, weight) in [("point_to_plane", 0.3), ("symmetric", 0.7), ("scan_to_template", 0.5)] {
            level.set_term(term, weight);
        }
    }
    schedule
}

#[test]
fn moving_everything_moves_the_result_also_with_all_terms_and_for_point_clouds() {
    let mesh = small_task();
    let turn = Rotation3::from_euler_angles(0.4, -1.0, 2.0);
    let place = |p: Vec3| turn * p + Vec3::new(40.0, -300.0, 25.0);
    for task in [&mesh, &mesh.as_cloud()] {
        // Blendshapes turn with their template; the graph has none.
        for (model, template_too) in [(ModelKind::Hybrid, false), (ModelKind::Graph, false), (ModelKind::Rigid, true)] {
            let schedule = with_all_terms(model);
            let mut moved = task.moved(place);
            if template_too {
                moved.template.positions.iter_mut().for_each(|p| *p = place(*p));
            }
            let result = task.fit_by(model, &schedule);
            let used = |name: &str| result.history[0].energies.iter().any(|e| e.0.contains(name) && e.1 > 0.0);
            assert!(used("symmetric") && used("scan to template"), "{model}: {:?}", result.history[0].energies);
            let expected: Vec<Vec3> = result.positions.into_iter().map(place).collect();
            let distance = farthest(&moved.fit_by(model, &schedule).positions, &expected);
            println!("{model}: {distance}");
            assert!(distance < 1e-6, "{model}: {distance}");
        }
    }
}

#[test]
fn the_same_bits_at_any_number_of_threads_also_with_all_terms_and_for_point_clouds() {
    let mesh = small_task();
    for task in [&mesh, &mesh.as_cloud()] {
        let [one, three] = [1, 3]
            .map(|threads| on_threads(threads, || task.fit_by(ModelKind::Hybrid, &with_all_terms(ModelKind::Hybrid))));
        assert!(bits(&one.positions) == bits(&three.positions));
        assert_eq!((one.history, one.accepted), (three.history, three.accepted));
    }
}

#[test]
fn a_point_cloud_is_worth_its_mesh() {
    let (rig, case) = small();
    let task = Task::new(&rig, &case, 5);
    for model in [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Rigid] {
        let [mesh, cloud] = [&task, &task.as_cloud()].map(|task| rmse(&rig, &case, &task.fit(model)));
        println!("{model}: mesh {mesh:.3} mm, cloud {cloud:.3} mm");
        assert!(cloud < 1.15 * mesh + 0.05, "{model}: mesh {mesh} mm, cloud {cloud} mm");
    }
}

#[test]
fn what_is_masked_out_does_not_feel_the_scan() {
    let (rig, case) = small();
    let mut task = Task::new(&rig, &case, 5);
    let pushed =
        |task: &Task| task.pushed(&case.truth, |p| if p.x < -12.0 { Vec3::new(-3.0, 0.0, 6.0) } else { Vec3::zeros() });
    for model in [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Blendshape] {
        let distance = farthest(&task.fit(model).positions, &pushed(&task).fit(model).positions);
        assert!(distance > 2.0, "{model}: without a mask {distance} mm");
    }
    task.mask = Some(rig.neutral.iter().map(|p| if p.x > 0.0 { 1.0 } else { 0.0 }).collect());
    for model in [ModelKind::Hybrid, ModelKind::Graph, ModelKind::Blendshape] {
        // Which points of the scan stand for it, and for how much, depends on all of it.
        let spread_anew = farthest(&task.fit(model).positions, &pushed(&task).fit(model).positions);
        println!("{model}: {spread_anew} mm");
        assert!(spread_anew < 0.3, "{model}: {spread_anew} mm");
        let mut schedule = model.schedule().unwrap();
        schedule.levels.iter_mut().for_each(|level| level.set_term("scan_to_template", 0.0));
        let [result, other] = [&task, &pushed(&task)].map(|task| task.fit_by(model, &schedule));
        assert!(bits(&result.positions) == bits(&other.positions), "{model}");
        let accepted = result.accepted.iter().zip(&rig.neutral).filter(|(a, _)| **a);
        assert!(accepted.clone().all(|(_, p)| p.x > 0.0));
        let asked = rig.neutral.iter().zip(&result.hidden).filter(|(p, hidden)| p.x > 0.0 && !**hidden);
        let (taken, of) = (accepted.count(), asked.count());
        assert_eq!(result.history.last().unwrap().inliers, taken as f64 / of as f64, "{model}");
    }
    // Ones change nothing.
    let plain = Task { mask: None, ..task.clone() };
    task.mask = Some(vec![1.0; rig.neutral.len()]);
    task.free_mask = Some(vec![0.0; rig.neutral.len()]);
    assert!(bits(&task.fit(ModelKind::Hybrid).positions) == bits(&plain.fit(ModelKind::Hybrid).positions));
}

#[test]
fn free_vertices_between_fitted_ones_stay_smooth() {
    let (rig, case) = small();
    let task = Task::new(&rig, &case, 5);
    // A lump of 9 mm on a cheek.
    let cheek = Vec3::new(30.0, -15.0, 0.0);
    let off = |p: &Vec3| (p.xy() - cheek.xy()).norm();
    let lump = task.pushed(&case.truth, |p| Vec3::z() * if off(p) < 14.0 { 9.0 } else { 0.0 });
    let free = Task {
        free_mask: Some(rig.neutral.iter().map(|p| f64::from(u8::from(off(p) < 18.0))).collect()),
        ..lump.clone()
    };
    let chosen: Vec<usize> = (0..rig.neutral.len()).filter(|&i| off(&rig.neutral[i]) < 10.0).collect();
    assert!(chosen.len() >= 3, "{}", chosen.len());
    for model in [ModelKind::Hybrid, ModelKind::Graph] {
        let schedule = with_all_terms(model);
        let clean = task.fit_by(model, &schedule).positions;
        let difference = |task: &Task| -> f64 {
            let result = task.fit_by(model, &schedule);
            let of = |i: &usize| (result.positions[*i] - clean[*i]).norm();
            chosen.iter().map(of).sum::<f64>() / chosen.len() as f64
        };
        let (with_lump, with_free) = (difference(&lump), difference(&free));
        println!("{model}: the lump lifts the cheek by {with_lump:.2} mm, by {with_free:.2} mm where it is free");
        assert!(with_lump > 4.0 && with_free < 0.35 * with_lump, "{model}: {with_lump} mm, free {with_free} mm");
        let result = free.fit_by(model, &schedule);
        assert!(result.accepted.iter().zip(&rig.neutral).all(|(a, p)| !a || off(p) >= 18.0));
    }
}

#[test]
fn moving_the_template_changes_nothing() {
    // Rounding must not decide between equals when nodes are chosen, so the face may not be its own mirror image.
    let mut task = small_task();
    for (i, p) in task.template.positions.iter_mut().enumerate() {
        *p += Vec3::new(1.7, 2.3, 3.1).map(|f| 0.2 * (f * i as f64).sin());
    }
    let turn = Rotation3::from_euler_angles(-0.7, 0.5, 1.1);
    let mut moved = task.clone();
    moved.template.positions.iter_mut().for_each(|p| *p = turn * *p + Vec3::new(500.0, 3.0, -80.0));
    // Blendshapes turn with their template; the others have none.
    // Sumner's E_rot, as it was published, is not the same in all axes.
    for model in [ModelKind::Graph, ModelKind::Rigid, ModelKind::Similarity] {
        let distance = farthest(&moved.fit(model).positions, &task.fit(model).positions);
        assert!(distance < 1e-6, "{model}: {distance}");
    }
}

#[test]
fn lengths_scale_with_the_model() {
    // A power of two, so that numbers keep their digits and every decision is the same.
    let unit = 1.0 / 1024.0;
    let task = small_task();
    let mut scaled = task.moved(|p| p * unit);
    scaled.template.positions.iter_mut().for_each(|p| *p *= unit);
    let (shapes, vertices) = (task.shapes.shapes().to_vec(), task.shapes.vertex_count());
    let slab =
        (0..vertices).flat_map(|v| task.shapes.vertex(v).flat_map(|piece| piece.1).map(|d| d * unit as f32)).collect();
    scaled.shapes = ShapeBasis::new(shapes, slab);
    for model in ModelKind::ALL {
        let (large, small) = (task.fit(model), scaled.fit(model));
        let back: Vec<Vec3> = small.positions.iter().map(|p| p / unit).collect();
        let distance = farthest(&back, &large.positions);
        assert!(distance < 1e-9, "{model}: {distance}");
        for (a, b) in large.weights.iter().zip(&small.weights) {
            assert!((a.value - b.value).abs() < 1e-9, "{model} {}: {} {}", a.name, a.value, b.value);
            let (a, b) = (a.std_dev.unwrap(), b.std_dev.unwrap());
            assert!((a - b).abs() < 1e-6 * a, "{model}: {a} {b}");
        }
    }
}

#[test]
fn the_same_bits_at_one_two_and_four_threads() {
    let task = small_task();
    for model in ModelKind::ALL {
        let [one, two, four] = [1, 2, 4].map(|threads| on_threads(threads, || task.fit(model)));
        for other in [&two, &four] {
            assert!(bits(&one.positions) == bits(&other.positions), "{model}");
            assert_eq!((&one.history, &one.weights, &one.accepted), (&other.history, &other.weights, &other.accepted));
        }
    }
}

#[test]
fn an_observer_sees_every_step_and_may_stop_with_the_state_so_far() {
    let task = small_task();
    let mut schedule = ModelKind::Hybrid.schedule().unwrap();
    schedule.stop.energy = 0.0;
    schedule.stop.motion = 0.0;
    let first = schedule.levels[0].steps;
    for steps in [1, first, first + 2] {
        let mut seen: Vec<StepRecord> = Vec::new();
        let stopped = register(&task.input(), &ModelKind::Hybrid, &schedule, &mut |record: &StepRecord| {
            seen.push(record.clone());
            if seen.len() == steps { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap();
        assert_eq!(stopped.stop, RegistrationStop::StoppedByObserver);
        assert_eq!(stopped.history, seen);
        assert_eq!(seen.len(), steps);
        // The same as a schedule that ends there.
        let mut short = schedule.clone();
        short.levels.truncate(if steps > first { 2 } else { 1 });
        let last = short.levels.last_mut().unwrap();
        last.steps = if steps > first { steps - first } else { steps };
        let ended = task.fit_by(ModelKind::Hybrid, &short);
        assert_eq!(ended.stop, RegistrationStop::Finished);
        assert!(bits(&ended.positions) == bits(&stopped.positions), "after {steps} steps");
        assert_eq!((ended.weights, ended.accepted), (stopped.weights, stopped.accepted));
    }
}

#[test]
fn named_energies_sum_to_the_energy_and_history_counts_on() {
    let task = small_task();
    for model in ModelKind::ALL {
        let result = task.fit(model);
        assert_eq!(result.stop, RegistrationStop::Finished);
        for pair in result.history.windows(2) {
            let (a, b) = ((pair[0].level, pair[0].step), (pair[1].level, pair[1].step));
            assert!(b == (a.0, a.1 + 1) || (b.1 == 0 && b.0 == a.0 + 1), "{model}: {a:?} then {b:?}");
        }
        for record in &result.history {
            let sum: f64 = record.energies.iter().map(|e| e.1).sum();
            assert!((sum - record.energy).abs() <= 1e-10 * record.energy, "{model}: {sum} {}", record.energy);
            assert!((0.0..=1.0).contains(&record.inliers) && record.motion.is_finite());
        }
        let [accepted, shown] = [&result.accepted, &result.hidden.iter().map(|h| !h).collect()]
            .map(|of: &Vec<bool>| of.iter().filter(|a| **a).count() as f64);
        assert_eq!(accepted / shown, result.history.last().unwrap().inliers);
    }
}

/// A strip of 300 mm by 60 mm, its columns `spacing` apart up to `length` along it, bent by 70 degrees between 80 and 140 mm
/// if asked: quads, and one position per vertex, column by column.
fn strip(length: f64, spacing: f64, bent: bool) -> PolygonMesh {
    const ROWS: usize = 13;
    let (from, over, turn) = (80.0, 60.0, 70f64.to_radians());
    let along = |s: f64| {
        let inside = ((s - from) / over).clamp(0.0, 1.0);
        if !bent || inside == 0.0 {
            return Vec3::new(s, 0.0, 0.0);
        }
        let (radius, angle) = (over / turn, turn * inside);
        let beyond = (s - from - over).max(0.0);
        Vec3::new(
            from + radius * angle.sin() + beyond * angle.cos(),
            0.0,
            radius * (1.0 - angle.cos()) + beyond * angle.sin(),
        )
    };
    let columns = (length / spacing) as usize + 1;
    let place = |k: usize| along(spacing * (k / ROWS) as f64) + Vec3::new(0.0, 5.0 * (k % ROWS) as f64, 0.0);
    let positions: Vec<Vec3> = (0..columns * ROWS).map(place).collect();
    let quads = (0..(columns - 1) * ROWS).filter(|k| k % ROWS < ROWS - 1);
    let corners: Vec<u32> = quads.flat_map(|k| [k, k + ROWS, k + ROWS + 1, k + 1]).map(|v| v as u32).collect();
    let starts = (0..=corners.len() as u32 / 4).map(|f| 4 * f).collect();
    PolygonMesh { positions, starts, corners, ..PolygonMesh::default() }
}

#[test]
fn what_is_not_seen_goes_where_what_is_seen_beside_it_goes() {
    let (template, truth) = (strip(300.0, 5.0, false), strip(300.0, 5.0, true).positions);
    // The scan shows the bend, and 60 mm of what lies beyond; 100 mm are out of its sight.
    let scan = strip(200.0, 2.5, true).triangulate();
    let seen = truth.iter().zip(&template.positions).map(|(_, rest)| rest.x <= 200.0).collect::<Vec<_>>();
    let marked = (0..truth.len()).filter(|v| seen[*v] && (v / 13) % 8 == 0 && (v % 13) % 6 == 0);
    let landmarks: Vec<Landmark> = marked.map(|v| Landmark::new(v.to_string(), v as u32, truth[v])).collect();
    let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&template, &scan) };
    let fit = |schedule: &Schedule| {
        let result = register(&input, &ModelKind::Hybrid, schedule, &mut Silent);
        let triangles = template.triangulate().triangles;
        TruthErrors::new(&result.unwrap().positions, &truth, &seen, &triangles).unwrap().0
    };
    let default = ModelKind::Hybrid.schedule().unwrap();
    let errors = fit(&default);
    // A bare strip slides by some millimetres between its landmarks, and its far end with it.
    assert!(errors.normal < 0.5 && errors.unobserved.unwrap() < 15.0 && errors.flipped == 0, "{errors:?}");
    // Held to one rigid motion of the whole instead, it is torn off.
    let mut to_one_pose = default;
    to_one_pose.model.set("lambda_unseen", 0.0);
    to_one_pose.levels.iter_mut().for_each(|level| level.set_term("prediction", 0.01));
    let torn = fit(&to_one_pose);
    assert!(torn.unobserved > errors.unobserved.map(|unobserved| 2.0 * unobserved), "{torn:?} {errors:?}");
}

/// A round plate of 64 mm with a pouch of 20 mm below an opening of 4 mm in its middle, or closed over it; ring by ring.
fn plate(closed: bool) -> TriangleMesh {
    const ROUND: usize = 48;
    let profile = |k: usize| match k as f64 / 6.0 {
        s if closed && s < 3.0 => (2.0 * s / 3.0, 0.0),
        s if s < 1.0 => (10.0 * s, -4.0),
        s if s < 2.0 => (10.0, -4.0 + 3.0 * (s - 1.0)),
        s if s < 3.0 => (10.0 - 8.0 * (s - 2.0), s - 3.0),
        s => (2.0 + 30.0 * (s - 3.0), 0.0),
    };
    let place = |k: usize| {
        let ((radius, height), angle) = (profile(k / ROUND), std::f64::consts::TAU * (k % ROUND) as f64 / ROUND as f64);
        let (x, y) = (radius.max(0.05) * angle.cos(), radius.max(0.05) * angle.sin());
        Vec3::new(x, y, height + 0.5 * (0.3 * x).sin() * (0.25 * y + 0.7).cos())
    };
    let triangles = (0..30 * ROUND).flat_map(|k| {
        let next = k / ROUND * ROUND + (k + 1) % ROUND;
        [[k, k + ROUND, next], [next, k + ROUND, next + ROUND]].map(|t| t.map(|v| v as u32))
    });
    TriangleMesh { positions: (0..31 * ROUND).map(place).collect(), triangles: triangles.collect() }
}

#[test]
fn what_the_template_hides_follows_what_is_seen_beside_it() {
    let bend = |p: &Vec3| p + Vec3::new(0.0, 0.0, 0.004 * (p.x * p.x - p.y * p.y) + 1.0);
    let template = plate(false);
    let truth: Vec<Vec3> = template.positions.iter().map(bend).collect();
    let mut scan = plate(true);
    scan.positions.iter_mut().for_each(|p| *p = bend(p));
    let landmark = |v: usize| Landmark::new(v.to_string(), v as u32, truth[v]);
    let landmarks: Vec<Landmark> = (0..8).map(|k| landmark(48 * 24 + 6 * k)).collect();
    let polygons = PolygonMesh::from(template.clone());
    let pouch: Vec<bool> = (0..truth.len()).map(|v| v < 48 * 17).collect();
    let fit = |schedule: &Schedule| {
        let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&polygons, &scan) };
        let result = register(&input, &ModelKind::Hybrid, schedule, &mut Silent).unwrap();
        let errors = TruthErrors::new(&result.positions, &truth, &pouch, &template.triangles).unwrap().0;
        (result, errors)
    };
    let mut schedule = ModelKind::Hybrid.schedule().unwrap();
    // So that the pouch is within reach.
    schedule.levels[1].distance_cap = 12.0;
    schedule.levels[1].model.set("lambda_graph", 10.0);
    let (result, errors) = fit(&schedule);
    let hidden = || result.hidden.iter().enumerate().filter(|(_, hidden)| **hidden).map(|(v, _)| v);
    assert!(hidden().count() > 48 * 12, "{}", hidden().count());
    assert!(hidden().all(|v| v < 48 * 19 && !result.accepted[v]));
    schedule.scan.reject_hidden = false;
    let (_, pulled) = fit(&schedule);
    println!("the pouch is off by {:.2} mm, {:.2} where it feels the scan", errors.rmse, pulled.rmse);
    assert!(errors.rmse < 0.5 && pulled.rmse > 2.0 * errors.rmse, "{errors:?} {pulled:?}");
}

/// Two flats 40 mm wide and between them a groove 20 mm deep, whose walls stand at an angle to the upright.
fn groove(angle: f64) -> TriangleMesh {
    const ACROSS: usize = 61;
    let place = |k: usize| {
        let s = 2.0 * (k % ACROSS) as f64 - 60.0;
        let (wall, flat) = (s.abs().min(20.0), (s.abs() - 20.0).max(0.0));
        let (x, z) = (wall * angle.sin() + flat, (wall - 20.0) * angle.cos());
        Vec3::new(x.copysign(s), 2.0 * (k / ACROSS) as f64, z)
    };
    let squares = (0..40 * ACROSS).filter(|k| k % ACROSS + 1 < ACROSS);
    let triangles = squares
        .flat_map(|k| [[k, k + 1, k + ACROSS], [k + 1, k + ACROSS + 1, k + ACROSS]].map(|t| t.map(|v| v as u32)));
    TriangleMesh { positions: (0..41 * ACROSS).map(place).collect(), triangles: triangles.collect() }
}

#[test]
fn what_a_bend_brings_to_light_follows_the_scan() {
    let [template, scan] = [0.1, 0.4].map(groove);
    let landmark = |v: usize| Landmark::new(v.to_string(), v as u32, scan.positions[v]);
    let landmarks: Vec<Landmark> =
        [2, 11, 20, 30, 40, 49, 58].iter().flat_map(|c| [5, 20, 35].map(|r| landmark(61 * r + c))).collect();
    let polygons = PolygonMesh::from(template.clone());
    let input = RegistrationInput { landmarks: &landmarks, ..RegistrationInput::new(&polygons, &scan) };
    let mut schedule = ModelKind::Hybrid.schedule().unwrap();
    let fit = |schedule: &Schedule| {
        let result = register(&input, &ModelKind::Hybrid, schedule, &mut Silent).unwrap();
        let hidden = result.hidden.iter().filter(|hidden| **hidden).count();
        let accepted = result.hidden.iter().zip(&result.accepted).filter(|(hidden, found)| **hidden && **found).count();
        (hidden, accepted)
    };
    schedule.bend.clear();
    let (hidden, accepted) = fit(&schedule);
    assert!(hidden > 400 && accepted == 0, "{accepted} of {hidden}");
    schedule.bend = vec![schedule.levels[0].clone()];
    let (hidden, accepted) = fit(&schedule);
    assert!(accepted > 50, "{accepted} of {hidden}");
}

/// The sequential method's schedule, its second stage replaced.
fn sequential(then: Stage) -> Schedule {
    Schedule { then: Some(Box::new(then)), ..ModelKind::Sequential.schedule().unwrap() }
}

fn graph_stage(levels: Vec<Level>) -> Stage {
    stage(ModelKind::Graph, levels)
}

fn stage(name: ModelKind, levels: Vec<Level>) -> Stage {
    Stage { model: StageModel { name, options: nonrigid::energy::Options::new() }, levels, then: None }
}

#[test]
fn a_second_stage_starts_where_the_first_ended() {
    let task = small_task();
    let first = task.fit_by(ModelKind::Blendshape, &Schedule { then: None, ..sequential(graph_stage(Vec::new())) });
    // Nothing pulls but the prediction, which is the first stage's result: had it been the neutral, or had anything else been
    // the rest shape, the graph would move.
    let level = Level { steps: 3, distance_cap: 3.0, ..Level::default() };
    let level = level.with_term("point_to_plane", 0.0).with_term("prediction", 1.0);
    for model in [ModelKind::Graph, ModelKind::Sumner, ModelKind::Rigid] {
        let third = stage(ModelKind::Rigid, vec![level.clone()]);
        let second =
            if model == ModelKind::Rigid { level.clone() } else { level.clone().with_model("lambda_graph", 0.1) };
        let still = Stage { then: Some(Box::new(third)), ..stage(model, vec![second]) };
        let both = task.fit_by(ModelKind::Sequential, &sequential(still));
        assert!(first.accepted.iter().any(|a| !a), "the prediction must have something to pull at");
        let distance = farthest(&both.positions, &first.positions);
        assert!(distance < 1e-9, "{model}: {distance}");
        assert_eq!(both.weights, first.weights);
        let (before, after) = both.history.split_at(first.history.len());
        assert_eq!(before, first.history);
        assert!(after.iter().all(|h| h.energy < 1e-12 && h.motion < 1e-9), "{model}: {after:?}");
        // Levels count on.
        let levels = sequential(graph_stage(Vec::new())).levels.len();
        assert_eq!(after.iter().map(|h| h.level).collect::<BTreeSet<_>>(), BTreeSet::from([levels, levels + 1]));
    }
}

#[test]
fn a_second_stage_comes_nearer_to_the_scan() {
    let task = small_task();
    let schedule = ModelKind::Sequential.schedule().unwrap();
    let first = task.fit_by(ModelKind::Blendshape, &Schedule { then: None, ..schedule.clone() });
    let both = task.fit_by(ModelKind::Sequential, &schedule);
    let surface = ClosestPoint::new(&task.scan).unwrap();
    let distance = |result: &RegistrationResult| {
        let seen = first.accepted.iter().zip(&both.accepted).map(|(a, b)| *a && *b);
        let distances = result.positions.iter().zip(seen).filter(|p| p.1);
        distances.map(|(p, _)| surface.query(p).unwrap().squared_distance).sum::<f64>()
    };
    println!("{} {}", distance(&first), distance(&both));
    assert!(distance(&both) < 0.5 * distance(&first), "{} {}", distance(&both), distance(&first));
    assert_eq!(both.weights, first.weights);
    assert_eq!(both.schedule, schedule.resolved(&ModelKind::Sequential, &TERMS).unwrap());
}

/// Counts, stops after a number of steps, and may want the positions.
pub struct StopAfter {
    announced: (usize, usize),
    pub seen: Vec<StepRecord>,
    places: Option<Vec<Vec<[u64; 3]>>>,
    steps: usize,
}

impl StopAfter {
    pub fn new(steps: usize, looks: bool) -> Self {
        Self { announced: (0, 0), seen: Vec::new(), places: looks.then(Vec::new), steps }
    }
}

impl RegistrationObserver for StopAfter {
    fn on_start(&mut self, levels: usize, steps: usize) {
        self.announced = (levels, steps);
    }

    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self.seen.push(record.clone());
        if self.seen.len() == self.steps { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn wants_positions(&self) -> bool {
        self.places.is_some()
    }

    fn on_positions(&mut self, record: &StepRecord, positions: &[Vec3]) {
        assert_eq!(self.seen.last(), Some(record));
        self.places.as_mut().expect("only who asks is told").push(bits(positions));
    }
}

#[test]
fn an_observer_sees_and_stops_every_stage() {
    let task = small_task();
    let mut schedule = sequential(graph_stage(ModelKind::Graph.schedule().unwrap().levels[4..6].to_vec()));
    schedule.levels = schedule.levels[..3].to_vec();
    schedule.stop = StopOptions { energy: 0.0, motion: 0.0 };
    let first: usize = schedule.levels.iter().map(|l| l.steps).sum();
    let second: usize = schedule.then.as_ref().unwrap().levels.iter().map(|l| l.steps).sum();
    let all = {
        let mut observer = StopAfter::new(usize::MAX, true);
        register(&task.input(), &ModelKind::Sequential, &schedule, &mut observer).unwrap();
        observer.places.unwrap()
    };
    assert_eq!(all.len(), first + second);
    for (steps, stop) in [
        (1, RegistrationStop::StoppedByObserver),
        (first, RegistrationStop::StoppedByObserver),
        (first + 1, RegistrationStop::StoppedByObserver),
        (first + second + 1, RegistrationStop::Finished),
    ] {
        let mut observer = StopAfter::new(steps, false);
        let result = register(&task.input(), &ModelKind::Sequential, &schedule, &mut observer).unwrap();
        assert_eq!((result.stop, observer.announced), (stop, (5, first + second)));
        let taken = steps.min(first + second);
        assert_eq!((result.history.len(), &result.history), (taken, &observer.seen));
        assert!(bits(&result.positions) == all[taken - 1], "other positions after {taken} steps");
        assert_eq!(result.weights.len(), task.shapes.len());
    }
}

#[test]
fn failures_name_the_level_of_their_stage() {
    let task = small_task();
    let level = Level::default().with_model("lambda_graph", 1.0);
    let blind = Level { distance_cap: 1e-9, ..level.clone() };
    let run = |schedule: &Schedule| register(&task.input(), &ModelKind::Sequential, schedule, &mut Silent).unwrap_err();
    let error = run(&sequential(graph_stage(vec![level.clone(), blind])));
    assert_eq!(error, RegistrationError::NoOverlap { level: "then.level 2".into(), cap: 1e-9 });
    assert!(error.to_string().starts_with("then.level 2: no vertex"), "{error}");
    let mut schedule = sequential(graph_stage(vec![level]));
    schedule.levels[1].distance_cap = 1e-9;
    assert_eq!(run(&schedule), RegistrationError::NoOverlap { level: "level 2".into(), cap: 1e-9 });
    schedule.then = None;
    assert_eq!(run(&schedule), RegistrationError::Schedule(ScheduleError::NoSecondStage));
}

#[test]
fn every_algorithm_arrives_where_gauss_newton_does() {
    let task = small_task();
    let mut schedule = ModelKind::Graph.schedule().unwrap();
    schedule.levels.last_mut().unwrap().steps = 60;
    // Point-to-plane alone: which points of the scan find the template depends on the way there, and the minimum on them.
    for level in &mut schedule.levels {
        level.terms.retain(|term, _| term == "landmarks");
        (level.distance_cap, level.normal_angle) = (1e3, 180.0); // nor which of them are refused
    }
    schedule.stop = StopOptions { energy: 1e-9, motion: 1e-5 };
    let run = |algorithm: StepAlgorithm| {
        let mut schedule = schedule.clone();
        schedule.solver.algorithm = algorithm;
        let schedule = Schedule::from_toml(&toml::to_string(&schedule).unwrap()).unwrap();
        assert_eq!(schedule.solver.algorithm, algorithm);
        task.fit_by(ModelKind::Graph, &schedule)
    };
    let expected = run(StepAlgorithm::GaussNewton);
    assert_eq!(bits(&expected.positions), bits(&task.fit_by(ModelKind::Graph, &schedule).positions));
    for algorithm in [StepAlgorithm::LevenbergMarquardt, StepAlgorithm::Dogleg] {
        let result = run(algorithm);
        let distance = farthest(&result.positions, &expected.positions);
        println!("{algorithm:?}: {distance}, {} and {} steps", result.history.len(), expected.history.len());
        assert!(distance < 1e-3, "{algorithm:?}: {distance}");
        assert!(bits(&result.positions) != bits(&expected.positions), "{algorithm:?} is not heard");
    }
}

#[test]
fn the_reference_linearisation_gives_the_same_registration_and_is_refused_where_there_is_none() {
    let task = small_task();
    for model in ModelKind::ALL {
        let mut schedule = model.schedule().unwrap();
        schedule.model.set("linearisation", "reference");
        let result = register(&task.input(), &model, &schedule, &mut Silent);
        if !model.options(&nonrigid::energy::Options::new()).unwrap().keys().any(|key| key == "linearisation") {
            let error = result.unwrap_err().to_string();
            assert!(error.contains("model: unknown field `linearisation`"), "{model}: {error}");
        } else {
            let (found, expected) = (result.unwrap(), task.fit(model));
            let distance = farthest(&found.positions, &expected.positions);
            println!("{model}: {distance:e}");
            assert!(distance < 1e-10, "{model}: {distance:e}");
            assert!(bits(&found.positions) != bits(&expected.positions), "{model}: reference is not heard");
        }
    }
}

#[test]
fn a_schedule_chooses_the_rotations_parameters_where_there_are_rotations() {
    let task = small_task();
    for model in [ModelKind::Hybrid, ModelKind::Graph] {
        let mut schedule = model.schedule().unwrap();
        let expected = task.fit_by(model, &schedule).positions;
        for (rotation, tolerance) in [("quaternion", 1e-9), ("angle_axis", 0.05)] {
            schedule.model.set("rotation", rotation);
            let positions = task.fit_by(model, &schedule).positions;
            let distance = farthest(&positions, &expected);
            println!("{model}, {rotation}: {distance:e}");
            assert!(distance < tolerance, "{model}, {rotation}: {distance:e}");
            assert!(bits(&positions) != bits(&expected), "{model}: {rotation} is not heard");
        }
        schedule.model.set("node", "affine");
        let error = schedule.resolved(&model, &TERMS).unwrap_err().to_string();
        assert!(error.starts_with("model.rotation: affine nodes have no rotation"), "{error}");
    }
    let graph = ModelKind::Graph.schedule().unwrap();
    let mut then = graph_stage(graph.levels.clone());
    then.model.options = nonrigid::energy::Options::new().with("node", "affine").with("rotation", "quaternion");
    let mut staged = Schedule { then: Some(Box::new(then)), ..graph };
    let error = staged.resolved(&ModelKind::Graph, &TERMS).unwrap_err().to_string();
    assert!(error.starts_with("then.model.rotation: affine nodes have no rotation"), "{error}");
    // Sumner's nodes are always affine.
    staged.then.as_mut().unwrap().model =
        StageModel { name: ModelKind::Sumner, options: nonrigid::energy::Options::new().with("rotation", "matrix") };
    let error = register(&task.input(), &ModelKind::Graph, &staged, &mut Silent).unwrap_err().to_string();
    assert!(error.contains("then.model: unknown field `rotation`"), "{error}");
}

/// Terms with fixed correspondences: targets near the pose of the case, normals in all directions.
fn fixed_terms(rng: &mut ChaCha8Rng, rest: &[Vec3], kernel: Kernel) -> Vec<Box<dyn DataTerm>> {
    let mut near = |size: f64| -> Vec<Vec3> {
        rest.iter().map(|p| p + Vec3::from_fn(|_, _| rng.random_range(-size..size))).collect()
    };
    let (plane, point, marks) = (near(6.0), near(6.0), near(9.0));
    let normals = near(50.0).iter().zip(rest).map(|(a, b)| (a - b).normalize()).collect();
    let weights: Vec<f64> = (0..rest.len()).map(|i| f64::from(u8::from(i % 5 != 2))).collect();
    let chosen: Vec<usize> = (0..rest.len()).step_by(40).collect();
    let targets: Vec<Vec3> = chosen.iter().map(|&v| marks[v]).collect();
    let landmarks = Landmarks { weights: vec![1.0; chosen.len()], samples: chosen, targets, scale: 2.0 };
    vec![
        Box::new(Pointwise::new(
            "plane",
            PointToPlane { targets: plane, normals, weights: weights.clone(), scale: 1.0 },
            kernel,
        )),
        Box::new(Pointwise::new("point", PointToPoint { targets: point, weights, scale: 0.1 }, kernel)),
        Box::new(Pointwise::new("landmarks", landmarks, Kernel::None)),
    ]
}

#[test]
fn no_step_raises_the_energy_at_fixed_correspondences() {
    let (rig, case) = small();
    let task = Task::new(&rig, &case, 5);
    let surface = task.template.triangulate();
    let rest = surface.positions.clone();
    let nodes = NodeGraph::along_surface(&surface, 60, 4).unwrap();
    let stiffness = Stiffness { graph: 0.5, blend: 0.8, ..Stiffness::default() };
    let smooth = |kind| FreeOptions { kind, weights: EdgeWeights::Cotangent, reference_vertices: 6706.0 };
    let joint = ArapOptions { solver: ArapSolver::Joint, ..ArapOptions::default() };
    let models: Vec<Box<dyn Fn() -> Box<dyn DeformationModel>>> = vec![
        Box::new(|| Box::new(Hybrid::new(rest.clone(), nodes.clone(), task.shapes.clone(), stiffness))),
        Box::new(|| Box::new(graph(rest.clone(), nodes.clone(), 0.5))),
        Box::new(|| Box::new(sumner(rest.clone(), nodes.clone(), 0.5, 0.3))),
        Box::new(|| Box::new(blendshape(rest.clone(), task.shapes.clone(), 0.8))),
        Box::new(|| Box::new(rigid(rest.clone()))),
        Box::new(|| Box::new(similarity(rest.clone()))),
        Box::new(|| Box::new(Free::new(&surface, smooth(Smoothness::Laplacian), 0.5).unwrap())),
        Box::new(|| Box::new(Free::new(&surface, smooth(Smoothness::BiLaplacian), 0.5).unwrap())),
        Box::new(|| Box::new(Arap::new(&surface, ArapOptions::default(), 0.5).unwrap())),
        Box::new(|| Box::new(Arap::new(&surface, joint, 0.5).unwrap())),
        Box::new(|| Box::new(MassSpring::new(&surface, SpringOptions::default(), 0.5).unwrap())),
        Box::new(|| Box::new(Fem::new(&surface, TissueOptions::default(), 0.5).unwrap())),
        Box::new(|| Box::new(Ffd::new(&surface, LatticeOptions::default(), 6706.0, 0.5).unwrap())),
        Box::new(|| Box::new(Poisson::new(&surface, PoissonOptions::default(), 0.5).unwrap())),
        Box::new(|| Box::new(Laplacian::new(&surface, LaplacianOptions::default(), 6706.0, 0.5).unwrap())),
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut lowered = 0;
    for build in &models {
        for kernel in [
            Kernel::None,
            Kernel::Huber { delta: 1.0 },
            Kernel::GemanMcClure { delta: 2.0 },
            Kernel::Tukey { delta: 5.0 },
        ] {
            for options in [Options::gauss_newton(), Options::levenberg_marquardt()] {
                let mut problem = Deformation::new(build(), Samples::vertices(rest.len()));
                problem.terms = fixed_terms(&mut rng, &rest, kernel);
                let x0 = problem.model.rest_parameters();
                let step: Vec<f64> =
                    (0..problem.structure().dimension()).map(|_| rng.random_range(-0.2..0.2)).collect();
                let mut x = x0.clone();
                problem.retract(&x0, &step, &mut x);
                let minimizer = Minimizer::new(options.with_max_iterations(1).with_damping_floor(1e-9)).unwrap();
                let mut energy = problem.energy(&x);
                for _ in 0..6 {
                    let summary = minimizer.minimize(&mut problem, &mut x);
                    let after = problem.energy(&x);
                    assert!(after <= energy, "{} {kernel:?}: {energy} to {after}\n{summary}", problem.model.name());
                    lowered += usize::from(after < energy);
                    energy = after;
                }
            }
        }
    }
    // A minimiser that stands still would pass the rest.
    assert!(lowered > 440, "{lowered} of 720 steps lowered the energy");
}
