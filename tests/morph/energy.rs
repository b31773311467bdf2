//! The mask morph as a constrained energy: what is held, pinned, free and drawn, on every model.

use std::sync::LazyLock;

use crate::threads::on_threads;
use data_gen::{FaceOptions, FaceRig};
use nonrigid::landmark::TemplatePoint;
use nonrigid::mesh::{TriangleMesh, Vec3, bounding_box_diagonal, sewn};
use nonrigid::model::Smoothness;
use nonrigid::morph::{self, *};
use nonrigid::registration::ModelKind;
use nonrigid::rig::{Family, Shape, ShapeBasis, ShapeSelection};

const FREE: MorphModel = MorphModel::Energy(ModelKind::Free);
const ARAP: MorphModel = MorphModel::Energy(ModelKind::Arap);
const GRAPH: MorphModel = MorphModel::Energy(ModelKind::Graph);
const BLENDSHAPE: MorphModel = MorphModel::Energy(ModelKind::Blendshape);
const HYBRID: MorphModel = MorphModel::Energy(ModelKind::Hybrid);
const POISSON: MorphModel = MorphModel::Energy(ModelKind::Poisson);
const LAPLACIAN: MorphModel = MorphModel::Energy(ModelKind::Laplacian);
const GPMM: MorphModel = MorphModel::Energy(ModelKind::Gpmm);
const SPRINGS: MorphModel = MorphModel::Energy(ModelKind::MassSpring);
const TISSUE: MorphModel = MorphModel::Energy(ModelKind::Fem);
const LATTICE: MorphModel = MorphModel::Energy(ModelKind::Ffd);
const ENERGIES: [MorphModel; 11] =
    [FREE, ARAP, GRAPH, BLENDSHAPE, HYBRID, POISSON, LAPLACIAN, GPMM, SPRINGS, TISSUE, LATTICE];

/// A generated face, its first identity modes, and a soft round mask on the tip of its nose.
struct Face {
    mesh: TriangleMesh,
    shapes: ShapeBasis,
    frame: LandmarkFrame,
    tip: u32,
}

impl Face {
    fn new(vertices: usize) -> Self {
        let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: 30 });
        let landmarks: Vec<(String, Vec3)> =
            (0..68).map(|k| (k.to_string(), rig.neutral[rig.landmarks[k].vertex as usize])).collect();
        let name = |k: usize| k.to_string();
        let spec =
            FrameSpec { origin: vec![name(30)], right: [name(36), name(45)], up: [name(33), name(27)], scale: None };
        let identity = ShapeSelection { names: Some(&[]), identity_modes: 30 };
        Self {
            mesh: rig.mesh.triangulate(),
            shapes: rig.to_rig().unwrap().select(identity).unwrap(),
            frame: LandmarkFrame::new(&spec, &landmarks).unwrap(),
            tip: rig.landmarks[30].vertex,
        }
    }

    /// The weights of a disc, millimetres about the tip of the nose.
    fn mask(&self, radius: f64) -> Weights {
        let (low, high) = ([-40.0; 2], [40.0; 2]);
        let disc = Region::from(morph::Shape::Circle { centre: [0.0; 2], radius });
        let texture = disc.rasterize(256, 256, Coordinates::Box { low, high }).unwrap();
        let texture = Blur { kernel: 7, ..Blur::default() }.apply(&texture).unwrap();
        let projector = self.frame.projector(low, high).unwrap();
        projector.weights(&self.mesh, &texture, Sampling::Bilinear, Visibility::default()).unwrap()
    }

    fn step(&self, displacement: Vec3) -> MorphStep {
        let pairs = vec![MaskedDisplacement { weights: self.mask(15.0), displacement }];
        MorphStep { pairs, ..MorphStep::default() }
    }

    fn solve(&self, step: &MorphStep, constraints: &Constraints, model: MorphModel) -> (Vec<Vec3>, EnergyReport) {
        self.energy(step, constraints, model, &EnergyOptions::default()).unwrap().solve().unwrap()
    }

    fn energy(
        &self,
        step: &MorphStep,
        constraints: &Constraints,
        model: MorphModel,
        options: &EnergyOptions,
    ) -> Result<MorphEnergy, MorphError> {
        MorphEnergy::new(&self.mesh, step, constraints, model, &self.shapes, options)
    }

    /// A triangle of three vertices that move much, nearest to the tip.
    fn triangle_at_tip(&self) -> [u32; 3] {
        *self.mesh.triangles.iter().find(|t| t.contains(&self.tip)).unwrap()
    }
}

static FACE: LazyLock<Face> = LazyLock::new(|| Face::new(3000));

const FORWARD: Vec3 = Vec3::new(0.0, 0.5, 3.0);

fn pinned(pins: Vec<PlacedPoint>) -> Constraints {
    Constraints { pins, ..Constraints::default() }
}

fn placed(name: &str, point: TemplatePoint, target: Vec3) -> PlacedPoint {
    PlacedPoint { name: name.into(), point, target }
}

#[test]
fn what_no_mask_lifts_keeps_its_bits_on_every_model() {
    let face = &*FACE;
    let step = face.step(FORWARD);
    let moves = step.moves(face.mesh.positions.len()).unwrap();
    for model in ENERGIES {
        let (moved, report) = face.solve(&step, &Constraints::default(), model);
        let kept = (0..moved.len()).filter(|v| !moves[*v]);
        assert!(kept.clone().all(|v| moved[v].map(f64::to_bits) == face.mesh.positions[v].map(f64::to_bits)));
        assert_eq!((report.held, report.moving), (kept.count(), moves.iter().filter(|m| **m).count()));
        let tip = moved[face.tip as usize] - face.mesh.positions[face.tip as usize];
        println!("{model:?}: tip {:.3} of {:.3} mm, {report:?}", tip.norm(), FORWARD.norm());
        assert!(tip.norm() > 0.5 * FORWARD.norm() && tip.norm() < 1.2 * FORWARD.norm(), "{model:?}: {tip:?}");
        assert_eq!(report.parts_at_rest, 0);
    }
}

#[test]
fn a_seam_through_the_region_changes_nothing() {
    let face = &*FACE;
    let whole = face.step(FORWARD);
    // Triangles on the left get vertices of their own along the middle, as programs write them where texture coordinates jump.
    let mut cut = face.mesh.clone();
    let middle = |v: u32| face.mesh.positions[v as usize].x;
    let left: Vec<bool> = cut.triangles.iter().map(|t| t.iter().map(|v| middle(*v)).sum::<f64>() < 0.0).collect();
    let on_the_right: Vec<u32> = cut.triangles.iter().zip(&left).filter(|(_, l)| !**l).flat_map(|(t, _)| *t).collect();
    let mut copies: Vec<(u32, u32)> = Vec::new();
    for t in cut.triangles.iter_mut().zip(&left).filter(|(_, left)| **left).map(|(t, _)| t) {
        for v in t.iter_mut().filter(|v| on_the_right.contains(v)) {
            let known = copies.iter().find(|c| c.0 == *v).map(|c| c.1);
            *v = known.unwrap_or_else(|| {
                copies.push((*v, cut.positions.len() as u32));
                cut.positions.push(face.mesh.positions[*v as usize]);
                copies[copies.len() - 1].1
            });
        }
    }
    assert!(copies.len() > 20 && copies.iter().any(|c| c.0 == face.tip), "{}", copies.len());
    // A mask in texture coordinates may give the two sides other weights: the larger one holds.
    let pair = &whole.pairs[0];
    let weight = |v: usize| pair.weights.values()[v];
    let lower = copies.iter().map(|c| 0.5 * weight(c.0 as usize));
    let weights = Weights::new((0..face.mesh.positions.len()).map(weight).chain(lower).collect()).unwrap();
    let pairs = vec![MaskedDisplacement { weights, displacement: pair.displacement }];
    let step = MorphStep { pairs, ..whole.clone() };
    let shapes = face.shapes.masked(
        &(0..face.mesh.positions.len() as u32).chain(copies.iter().map(|c| c.0)).collect::<Vec<_>>(),
        &vec![1.0; cut.positions.len()],
    );
    let options = EnergyOptions::default();
    for model in ENERGIES {
        let solve = |mesh, step, shapes| {
            MorphEnergy::new(mesh, step, &Constraints::default(), model, shapes, &options).unwrap().solve().unwrap().0
        };
        let [expected, found] = [solve(&face.mesh, &whole, &face.shapes), solve(&cut, &step, &shapes)];
        assert_eq!(found[..expected.len()], expected, "{model:?}");
        assert!(copies.iter().all(|c| found[c.0 as usize] == found[c.1 as usize]), "{model:?} tears");
    }
}

#[test]
fn free_vertices_without_a_regulariser_are_the_papers_morph() {
    let face = &*FACE;
    let step = face.step(FORWARD);
    let direct = step.apply(&face.mesh.positions).unwrap();
    let bound = 1e-12 * bounding_box_diagonal(&face.mesh.positions);
    for smoothness in [Smoothness::Laplacian, Smoothness::BiLaplacian] {
        let options = EnergyOptions { smoothing: 0.0, smoothness, ..EnergyOptions::default() };
        let mut energy = face.energy(&step, &Constraints::default(), FREE, &options).unwrap();
        let (moved, _) = energy.solve().unwrap();
        for (a, b) in moved.iter().zip(&direct) {
            assert!((a - b).norm() <= bound, "{:e}", (a - b).norm());
        }
    }
}

#[test]
fn no_displacement_is_the_identity() {
    let face = &*FACE;
    let step = face.step(Vec3::zeros());
    for model in ENERGIES {
        let (moved, _) = face.solve(&step, &Constraints::default(), model);
        for (a, b) in moved.iter().zip(&face.mesh.positions) {
            approx::assert_abs_diff_eq!(*a, *b, epsilon = 1e-11);
        }
    }
}

#[test]
fn pins_hold_exactly_and_goals_draw() {
    let face = &*FACE;
    let step = face.step(FORWARD);
    let at = |point: &TemplatePoint| point.position(&face.mesh.positions);
    let inside = TemplatePoint::Face { corners: face.triangle_at_tip(), weights: [0.2, 0.5, 0.3] };
    let tip = TemplatePoint::Vertex(face.tip);
    let (far, near) = (Vec3::new(0.7, -0.2, 4.0), Vec3::new(0.0, 0.3, 1.0));
    let bound = PIN_TOLERANCE * bounding_box_diagonal(&face.mesh.positions);
    for model in [FREE, ARAP, GRAPH, HYBRID, POISSON, LAPLACIAN] {
        let constraints = pinned(vec![placed("tip", tip, at(&tip) + far)]);
        let (moved, _) = face.solve(&step, &constraints, model);
        assert_eq!(moved[face.tip as usize].map(f64::to_bits), (at(&tip) + far).map(f64::to_bits), "{model:?}");

        let constraints = pinned(vec![placed("inside", inside, at(&inside) + near)]);
        let (moved, report) = face.solve(&step, &constraints, model);
        let miss = (inside.position(&moved) - at(&inside) - near).norm();
        println!("{model:?}: {miss:e}, {} steps", report.iterations);
        assert!(miss <= bound && report.pin_distance <= bound, "{model:?}: {miss:e}");

        let distance = |weight: f64| {
            let goals = vec![(placed("tip", tip, at(&tip) + far), weight)];
            let constraints = Constraints { goals, ..Constraints::default() };
            let (moved, _) = face.solve(&step, &constraints, model);
            (moved[face.tip as usize] - at(&tip) - far).norm()
        };
        let [weak, strong, stronger] = [1.0, 100.0, 1e4].map(distance);
        assert!(strong < 0.7 * weak && stronger < 0.1 * weak, "{model:?}: {weak}, {strong}, {stronger}");
    }
    // Thirty shapes reach any place of one point.
    let constraints = pinned(vec![placed("tip", tip, at(&tip) + near)]);
    let (moved, _) = face.solve(&step, &constraints, BLENDSHAPE);
    assert_eq!(moved[face.tip as usize], at(&tip) + near);
}

#[test]
fn a_dragged_handle_ends_where_a_fresh_start_does() {
    let face = &*FACE;
    let tip = TemplatePoint::Vertex(face.tip);
    let goal = |z: f64| (placed("tip", tip, tip.position(&face.mesh.positions) + Vec3::z() * z), 50.0);
    let constraints = |z: f64| Constraints { goals: vec![goal(z)], ..Constraints::default() };
    let options = EnergyOptions { tolerance: 1e-14, ..EnergyOptions::default() };
    for model in ENERGIES {
        let mut dragged = face.energy(&face.step(Vec3::z()), &constraints(1.0), model, &options).unwrap();
        dragged.solve().unwrap();
        dragged.set_displacement(0, FORWARD).unwrap();
        dragged.set_goal(0, goal(5.0).0.target).unwrap();
        let (warm, _) = dragged.solve().unwrap();
        let mut fresh = face.energy(&face.step(FORWARD), &constraints(5.0), model, &options).unwrap();
        let (cold, _) = fresh.solve().unwrap();
        for (a, b) in warm.iter().zip(&cold) {
            assert!((a - b).norm() < 1e-4, "{model:?}: {:e}", (a - b).norm());
        }
    }
}

#[test]
fn a_region_without_handles_follows_pins_and_goals() {
    let face = &*FACE;
    let tip = TemplatePoint::Vertex(face.tip);
    let target = tip.position(&face.mesh.positions) + Vec3::z() * 4.0;
    let constraints = Constraints { free: vec![face.mask(15.0)], ..pinned(vec![placed("tip", tip, target)]) };
    for model in [FREE, ARAP, GRAPH, HYBRID] {
        let (moved, report) = face.solve(&MorphStep::default(), &constraints, model);
        assert_eq!(moved[face.tip as usize], target);
        let neighbours = face.triangle_at_tip().into_iter().filter(|v| *v != face.tip);
        for v in neighbours {
            let d = moved[v as usize] - face.mesh.positions[v as usize];
            assert!(d.z > 2.0 && d.norm() < 6.0, "{model:?}: {d:?}");
        }
        println!("{model:?}: {} steps", report.iterations);
    }
}

#[test]
fn parts_that_nothing_drives_stay_and_are_counted() {
    // Two copies of the face; the second one's nose is free and has no handle.
    let face = &*FACE;
    let count = face.mesh.positions.len();
    let mut mesh = face.mesh.clone();
    mesh.positions.extend(face.mesh.positions.iter().map(|p| p + Vec3::x() * 400.0));
    mesh.triangles.extend(face.mesh.triangles.iter().map(|t| t.map(|v| v + count as u32)));
    // A triangle on its own, free as a whole.
    let at = mesh.positions.len() as u32;
    mesh.positions.extend([Vec3::zeros(), Vec3::x(), Vec3::y()].map(|p| p + Vec3::repeat(900.0)));
    mesh.triangles.push([at, at + 1, at + 2]);
    let weights = |first: f64, second: f64, alone: f64| {
        let mask = face.mask(15.0).into_values();
        let of = |scale: f64| mask.iter().map(move |w| w * scale);
        Weights::new(of(first).chain(of(second)).chain([alone; 3]).collect()).unwrap()
    };
    let pairs = vec![MaskedDisplacement { weights: weights(1.0, 0.0, 0.0), displacement: FORWARD }];
    let step = MorphStep { pairs, ..MorphStep::default() };
    let constraints = Constraints { free: vec![weights(0.0, 1.0, 1.0)], ..Constraints::default() };
    for model in [FREE, ARAP] {
        for (smoothing, parts) in
            [(2.0, 1), (0.0, 3 + face.mask(15.0).values().iter().filter(|w| **w > DEFAULT_THRESHOLD).count())]
        {
            let options = EnergyOptions { smoothing, ..EnergyOptions::default() };
            let none = ShapeBasis::none();
            let mut energy = MorphEnergy::new(&mesh, &step, &constraints, model, &none, &options).unwrap();
            let (moved, report) = energy.solve().unwrap();
            assert_eq!(report.parts_at_rest, parts, "{model:?}");
            assert!(moved[face.tip as usize].z > mesh.positions[face.tip as usize].z + 1.0);
            assert!((at as usize..at as usize + 3).all(|v| moved[v] == mesh.positions[v]), "{model:?}");
        }
    }
}

#[test]
fn the_patch_is_the_whole_as_far_as_the_energy_knows() {
    // More held vertices round the region change nothing: compare with a mask that lifts all, most of them held by hand.
    let face = &*FACE;
    let step = face.step(FORWARD);
    let cut = |model| {
        // The face without what lies far from the nose.
        let centre = face.mesh.positions[face.tip as usize];
        let near = |v: &u32| (face.mesh.positions[*v as usize] - centre).norm() < 60.0;
        let mut mesh = face.mesh.clone();
        mesh.triangles.retain(|t| t.iter().all(near));
        let options = EnergyOptions { tolerance: 1e-13, ..EnergyOptions::default() };
        let solve = |mesh: &TriangleMesh| {
            MorphEnergy::new(mesh, &step, &Constraints::default(), model, &face.shapes, &options)
                .unwrap()
                .solve()
                .unwrap()
                .0
        };
        solve(&mesh).iter().zip(solve(&face.mesh)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    };
    for model in ENERGIES {
        assert!(cut(model) == 0.0, "{model:?}");
    }
}

#[test]
fn one_recipe_means_the_same_at_any_resolution() {
    // The tip's displacement on 2,000 and on 12,000 vertices.
    let faces = [Face::new(2000), Face::new(12_000)];
    for model in ENERGIES {
        let [coarse, fine] = [&faces[0], &faces[1]].map(|face| {
            let (moved, _) = face.solve(&face.step(FORWARD), &Constraints::default(), model);
            moved[face.tip as usize] - face.mesh.positions[face.tip as usize]
        });
        println!("{model:?}: {coarse:.3?} {fine:.3?}");
        assert!((coarse - fine).norm() < 0.1 * FORWARD.norm(), "{model:?}: {coarse:?}, {fine:?}");
    }
}

#[test]
fn weights_of_shapes_stay_between_their_bounds() {
    let face = &*FACE;
    let bounded = face.shapes.clone().with_bounds(|_| [-0.1, 0.1]);
    for model in [BLENDSHAPE, HYBRID] {
        let step = face.step(FORWARD);
        let options = EnergyOptions::default();
        let mut energy =
            MorphEnergy::new(&face.mesh, &step, &Constraints::default(), model, &bounded, &options).unwrap();
        let (_, report) = energy.solve().unwrap();
        assert_eq!(report.weights.len(), 30);
        assert!(report.weights.iter().all(|w| w.1.abs() <= 0.1));
        assert!(report.weights.iter().any(|w| w.1.abs() == 0.1));
    }
}

#[test]
fn threads_change_no_bit() {
    let face = &*FACE;
    let step = face.step(FORWARD);
    let on = |threads: usize, model| on_threads(threads, || face.solve(&step, &Constraints::default(), model));
    for model in ENERGIES {
        assert_eq!(on(1, model), on(2, model));
    }
}

#[test]
fn impossible_morphs_are_named() {
    let face = &*FACE;
    let (step, none) = (face.step(FORWARD), Constraints::default());
    let options = EnergyOptions::default();
    let fails = |step: &MorphStep, constraints: &Constraints, model, options: &EnergyOptions| {
        face.energy(step, constraints, model, options).err().unwrap()
    };
    assert_eq!(fails(&MorphStep::default(), &none, FREE, &options), MorphError::NothingMoves);
    assert_eq!(fails(&step, &none, MorphModel::Direct, &options), MorphError::NoEnergy);
    let no_shapes = ShapeBasis::none();
    let error = MorphEnergy::new(&face.mesh, &step, &none, BLENDSHAPE, &no_shapes, &options).err().unwrap();
    assert_eq!(
        error.to_string(),
        format!("model blendshape needs blendshapes of {} vertices, found 0", face.mesh.positions.len())
    );
    for wrong in [
        EnergyOptions { smoothing: f64::NAN, ..options },
        EnergyOptions { prior: -1.0, ..options },
        EnergyOptions { nodes: 0, ..options },
        EnergyOptions { tolerance: -1.0, ..options },
        EnergyOptions { max_iterations: 0, ..options },
    ] {
        assert!(matches!(fails(&step, &none, FREE, &wrong), MorphError::Option { .. }));
    }
    let moves = step.moves(face.mesh.positions.len()).unwrap();
    let held = TemplatePoint::Vertex(moves.iter().position(|m| !m).unwrap() as u32);
    let tip = TemplatePoint::Vertex(face.tip);
    let error = fails(&step, &pinned(vec![placed("ear", held, Vec3::zeros())]), ARAP, &options);
    assert_eq!(error, MorphError::PointHeld("ear".into()));
    let twice = vec![placed("a", tip, Vec3::zeros()), placed("b", tip, Vec3::x())];
    assert_eq!(fails(&step, &pinned(twice), ARAP, &options), MorphError::PinnedTwice("b".into()));
    let nan = vec![placed("a", tip, Vec3::repeat(f64::NAN))];
    assert!(matches!(fails(&step, &pinned(nan), ARAP, &options), MorphError::Target { .. }));
    let one = ShapeBasis::new(
        vec![Shape { name: "up".into(), family: Family::Identity }],
        (0..face.mesh.positions.len()).flat_map(|_| [0.0, 1.0, 0.0]).collect(),
    );
    let aside = pinned(vec![placed("tip", tip, tip.position(&face.mesh.positions) + Vec3::x())]);
    let mut energy = MorphEnergy::new(&face.mesh, &step, &aside, BLENDSHAPE, &one, &options).unwrap();
    let error = energy.solve().unwrap_err();
    assert!(
        matches!(&error, MorphError::PinOutOfReach { name, distance } if name == "tip" && *distance > 0.9),
        "{error}"
    );
    let mut mesh = face.mesh.clone();
    mesh.triangles.push([0, 1, u32::MAX]);
    assert!(MorphEnergy::new(&mesh, &step, &none, FREE, &no_shapes, &options).is_err());
}

#[test]
fn awkward_meshes_give_finite_results_and_keep_what_is_held() {
    let (mut moved_somewhere, mut refused) = (0, Vec::new());
    for (name, polygons) in crate::awkward::awkward() {
        let mesh = polygons.triangulate();
        let weight = |i: usize| [0.0, 1.0, 0.4, 0.0, 0.9][i % 5];
        let weights = Weights::new((0..mesh.positions.len()).map(weight).collect()).unwrap();
        let size = bounding_box_diagonal(&mesh.positions);
        let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.01, 0.02, 0.05) * size }];
        let step = MorphStep { pairs, ..MorphStep::default() };
        for model in [FREE, ARAP, GRAPH] {
            let (none, options) = (Constraints::default(), EnergyOptions::default());
            let energy = MorphEnergy::new(&mesh, &step, &none, model, &ShapeBasis::none(), &options);
            match energy.and_then(|mut energy| energy.solve()) {
                Ok((moved, _)) => {
                    let (moves, first) = (step.moves(moved.len()).unwrap(), sewn(&mesh, |_, _| true));
                    let moves = |v: usize| (0..moves.len()).any(|w| first[w] == first[v] && moves[w]);
                    for (v, (p, q)) in mesh.positions.iter().zip(&moved).enumerate() {
                        assert!(q.iter().all(|c| c.is_finite()) && (moves(v) || p == q), "{name}, {model:?}: {v}");
                        assert!((p - q).norm() <= size + 1e-9, "{name}, {model:?}: {v} by {}", (p - q).norm());
                    }
                    moved_somewhere += usize::from(moved != mesh.positions);
                }
                Err(error) => refused.push(format!("{name}, {model:?}: {error}")),
            }
        }
    }
    println!("{}", refused.join("\n"));
    assert!(moved_somewhere >= 50, "{moved_somewhere}");
    assert!(refused.iter().all(|r| r.starts_with("empty") || r.contains("minimised")), "{refused:#?}");
}

#[test]
fn what_a_model_is_said_not_to_read_changes_no_bit_and_what_it_reads_does() {
    let usual = EnergyOptions::default();
    let step = FACE.step(FORWARD);
    let solve = |model, options: &EnergyOptions| {
        FACE.energy(&step, &Constraints::default(), model, options).unwrap().solve().unwrap()
    };
    for model in ENERGIES {
        let before = solve(model, &usual);
        for options in [
            EnergyOptions { smoothing: 4.0, ..usual },
            EnergyOptions { smoothness: Smoothness::Laplacian, ..usual },
            EnergyOptions { nodes: 40, ..usual },
            EnergyOptions { prior: 3.0, ..usual },
            EnergyOptions { max_iterations: 1, ..usual },
        ] {
            let (positions, report) = solve(model, &options);
            let idle = options.without_effect(model);
            assert!(idle.len() < 2, "{idle:?}");
            if options.max_iterations == 1 {
                assert!(idle.is_empty() && (report.settled || report.iterations == 1), "{}", model.name());
            } else {
                assert_eq!(positions == before.0, idle.len() == 1, "{} with {options:?}", model.name());
            }
        }
    }
    assert_eq!(
        EnergyOptions { nodes: 40, tolerance: 0.1, ..usual }.without_effect(MorphModel::Direct),
        ["nodes", "tolerance"]
    );
}
