//! Laws of the models of physical bodies: springs, soft tissue, a lattice.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3};
use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::normals::face_areas;
use nonrigid::mesh::{MeshError, TriangleMesh, Vec3};
use nonrigid::model::{
    Fem, Ffd, LatticeOptions, MassSpring, ModelFactory as _, ModelInput, ModelKind, SpringOptions, TissueOptions,
};
use nonrigid::nlls::{GradientCheck, Kernel, Minimizer, NormalEquations, Options, Problem, check_gradient};
use nonrigid::rig::{Regions, ShapeBasis};
use nonrigid::term::PointToPoint;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::sheets;

const TISSUE: TissueOptions = TissueOptions { thickness: 3.0, poisson: 0.3, anchor: 0.0, modulus: BTreeMap::new() };

fn springs(mesh: &TriangleMesh) -> MassSpring {
    MassSpring::new(mesh, SpringOptions { thickness: 3.0 }, 0.8).unwrap()
}

fn tissue(mesh: &TriangleMesh) -> Fem {
    Fem::new(mesh, TISSUE, 0.8).unwrap()
}

fn lattice(mesh: &TriangleMesh) -> Ffd {
    Ffd::new(mesh, LatticeOptions { spacing: 5.0 }, 500.0, 0.8).unwrap()
}

fn every_model(mesh: &TriangleMesh) -> [Box<dyn DeformationModel>; 3] {
    [Box::new(springs(mesh)), Box::new(tissue(mesh)), Box::new(lattice(mesh))]
}

/// A sheet of `size` by `size` millimetres, `cells` a side, at `place`.
fn sheet(size: f64, cells: usize, place: impl Fn(f64, f64) -> Vec3) -> TriangleMesh {
    let at = |i: f64| size * i / cells as f64;
    sheets::sheet(cells + 1, cells + 1, |c, r| place(at(c), at(r)))
}

/// A bowl, 81 vertices.
fn bowl() -> TriangleMesh {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut mesh = sheet(24.0, 8, |x, y| Vec3::new(x, y, 0.01 * ((x - 12.0).powi(2) + (y - 12.0).powi(2))));
    mesh.positions.iter_mut().for_each(|p| *p += Vec3::from_fn(|_, _| rng.random_range(-0.3..0.3)));
    mesh
}

fn turn() -> Rotation3<f64> {
    Rotation3::from_euler_angles(0.4, -2.0, 2.5)
}

type Body = Deformation<Box<dyn DeformationModel>, Box<dyn DataTerm>>;

fn body(model: Box<dyn DeformationModel>) -> Body {
    let count = model.vertex_count();
    Deformation::new(model, Samples::vertices(count))
}

/// Pulls the chosen vertices to their targets; the others weigh nothing.
fn pull(body: &mut Body, targets: Vec<Vec3>, chosen: impl Fn(usize) -> bool) {
    let weights = (0..targets.len()).map(|v| f64::from(u8::from(chosen(v)))).collect();
    let residuals = PointToPoint { targets, weights, scale: 1.0 };
    body.terms = vec![Box::new(Pointwise::new("pull", residuals, Kernel::None))];
}

fn settle(body: &mut Body) -> Vec<Vec3> {
    let mut x = body.model.rest_parameters();
    let options = Options::gauss_newton().with_max_iterations(400).with_energy_tolerance(1e-15);
    let summary = Minimizer::new(options.with_damping_floor(1e-10)).unwrap().minimize(body, &mut x);
    assert!(summary.final_energy <= summary.initial_energy, "{summary}");
    body.vertices(&x).to_vec()
}

fn farthest(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

fn energies(model: &mut dyn DeformationModel, x: &[f64]) -> Vec<f64> {
    let mut energies = Vec::new();
    model.regulariser_energy(x, &mut energies);
    energies.iter().map(|e| e.1).collect()
}

fn energy(model: &mut dyn DeformationModel, x: &[f64]) -> f64 {
    energies(model, x).iter().sum()
}

/// Away from rest.
fn assert_gradient(body: &mut Body) {
    let x: Vec<f64> =
        body.model.rest_parameters().iter().enumerate().map(|(k, x)| x + 0.3 * (k as f64).sin()).collect();
    let report = check_gradient(body, &x, GradientCheck::default());
    assert!(report.passed(), "{}: {report}", body.model.name());
}

#[test]
fn rest_costs_nothing_and_is_a_minimum() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for model in every_model(&bowl()) {
        let mut body = body(model);
        let x = body.model.rest_parameters();
        assert!(farthest(body.vertices(&x), &bowl().positions) < 1e-13);
        let mut equations = NormalEquations::new(Arc::clone(body.structure()));
        assert!(body.linearize(&x, &mut equations) < 1e-22, "{}", body.model.name());
        assert!(equations.gradient.iter().all(|g| g.abs() < 1e-10));
        // Gauss-Newton is exact where nothing is strained.
        let d: Vec<f64> = x.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut at = |t: f64| body.energy(&x.iter().zip(&d).map(|(x, d)| x + t * d).collect::<Vec<_>>());
        let t = 1e-4;
        let numeric = 0.5 * (at(t) + at(-t)) / (t * t);
        assert!(numeric > 0.1);
        approx::assert_relative_eq!(equations.quadratic_form(&d), numeric, max_relative = 1e-5);
    }
}

#[test]
fn a_body_pulled_at_a_few_places_as_if_turned_turns_as_a_whole() {
    let place = |p: &Vec3| Rotation3::from_euler_angles(0.2, -0.4, 0.3) * p + Vec3::new(30.0, -8.0, 1.0);
    let mut mesh = bowl();
    mesh.positions.push(Vec3::new(12.0, 12.0, 30.0)); // in no triangle
    let targets: Vec<Vec3> = mesh.positions.iter().map(place).collect();
    for model in every_model(&mesh) {
        let mut body = body(model);
        pull(&mut body, targets.clone(), |v| v < 81 && v % 7 == 0);
        let settled = settle(&mut body);
        // The lattice moves a loose vertex as the nearest other, without turning it.
        let count = if body.model.name() == "ffd" { 81 } else { 82 };
        let distance = farthest(&settled[..count], &targets);
        println!("{}: {distance:e}", body.model.name());
        assert!(distance < 1e-4, "{}: {distance}", body.model.name());
    }
}

#[test]
fn a_rotation_of_all_nodes_costs_nothing_and_no_strain_depends_on_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mesh = bowl();
    let models: [Box<dyn DeformationModel>; 2] = [Box::new(springs(&mesh)), Box::new(tissue(&mesh))];
    for mut model in models {
        let rest = model.rest_parameters();
        let strained: Vec<f64> = rest.iter().map(|x| x + rng.random_range(-0.4..0.4)).collect();
        let turned = |x: &[f64]| -> Vec<f64> {
            x.chunks_exact(3).flat_map(|p| <[f64; 3]>::from(turn() * Vec3::from_column_slice(p))).collect()
        };
        assert!(energy(&mut *model, &turned(&rest)) < 1e-22);
        let [a, b] = [&strained, &turned(&strained)].map(|x| energy(&mut *model, x));
        assert!(a > 1.0);
        approx::assert_relative_eq!(a, b, max_relative = 1e-11);
    }
}

#[test]
fn uniform_strain_of_tissue_is_hookes_law() {
    // Volume over thickness of a flat layer is the skin's area; eps is symmetric and constant.
    let mesh = sheet(10.0, 5, |x, y| Vec3::new(x, y, 0.0));
    let strain = Matrix3::new(0.02, 0.01, 0.0, 0.01, -0.03, 0.004, 0.0, 0.004, 0.015);
    for poisson in [0.0, 0.3, 0.45] {
        let mut model = Fem::new(&mesh, TissueOptions { poisson, ..TISSUE }, 0.8).unwrap();
        let nodes = model.layer().nodes.clone();
        let x: Vec<f64> =
            nodes.iter().flat_map(|p| <[f64; 3]>::from(turn() * (p + strain * p) + Vec3::new(3.0, 1.0, 4.0))).collect();
        let [mu, kappa] = [0.5 / (1.0 + poisson), poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))];
        let density = mu * strain.norm_squared() + kappa / 2.0 * strain.trace().powi(2);
        approx::assert_relative_eq!(energy(&mut model, &x), 0.8 * 100.0 * density, max_relative = 1e-9);
    }
    // Stretched by e with free sides, a bar of any cross section stores E V e^2 / 2.
    let poisson = 0.3;
    let strain = Matrix3::from_diagonal(&Vec3::new(1.0, -poisson, -poisson)) * 0.01;
    let mut model = Fem::new(&mesh, TissueOptions { poisson, ..TISSUE }, 1.0).unwrap();
    let x: Vec<f64> = model.layer().nodes.iter().flat_map(|p| <[f64; 3]>::from(p + strain * p)).collect();
    approx::assert_relative_eq!(energy(&mut model, &x), 0.5 * 100.0 * 1e-4, max_relative = 1e-9);
}

#[test]
fn a_region_of_another_modulus_weighs_as_much_more() {
    let mesh = sheet(20.0, 10, |x, y| Vec3::new(x, y, 0.0));
    let moduli: Vec<f64> = mesh.positions.iter().map(|p| if p.x > 10.0 { 25.0 } else { 1.0 }).collect();
    let strain = Matrix3::new(0.02, 0.01, 0.0, 0.01, -0.03, 0.0, 0.0, 0.0, 0.0);
    let options = TissueOptions { anchor: 0.5, ..TISSUE };
    let [mut even, mut mixed, mut doubled] = [vec![1.0; 121], moduli.clone(), vec![2.0; 121]]
        .map(|moduli| Fem::new(&mesh, options.clone(), 0.8).unwrap().with_moduli(&moduli));
    let x: Vec<f64> = even.layer().nodes.iter().flat_map(|p| <[f64; 3]>::from(p + strain * p)).collect();
    let [of_even, of_mixed, of_doubled] = [&mut even, &mut mixed, &mut doubled].map(|model| energies(model, &x));
    assert!(of_even.len() == 2 && of_even.iter().zip(&of_doubled).all(|(a, b)| (2.0 * a - b).abs() < 1e-12 * b));
    // Under the same strain everywhere it is the mean over the skin, linear between vertices.
    let mean = |t: &[u32; 3]| t.iter().map(|v| moduli[*v as usize]).sum::<f64>() / 3.0;
    let mean = mesh.triangles.iter().map(mean).sum::<f64>() / mesh.triangles.len() as f64;
    approx::assert_relative_eq!(of_mixed[0], mean * of_even[0], max_relative = 1e-9);

    // A schedule says so by name; regions that overlap multiply.
    let region =
        |name: &str, x: f64| (name.to_owned(), (0..121).filter(|v| mesh.positions[*v as usize].x > x).collect());
    let regions = Regions::new(121, vec![region("right", 10.0), region("more than right", 10.0)]).unwrap();
    let modulus = toml::toml! { right = 5.0 "more than right" = 5.0 };
    let given = nonrigid::energy::Options::of(&options).with("modulus", modulus);
    let build = |regions| {
        let options = &ModelKind::Fem.options(&given).unwrap();
        let (shapes, regions) = (&ShapeBasis::none(), Some(regions));
        ModelKind::Fem.build(&ModelInput {
            rest: &mesh,
            shapes,
            regions,
            options,
            reference_vertices: 121.0,
            unit: 1.0,
        })
    };
    let mut named = build(&regions).unwrap();
    named.set_level(&nonrigid::energy::Options::new().with("lambda_smooth", 0.8), 1.0).unwrap();
    approx::assert_relative_eq!(energy(&mut *named, &x), of_mixed.iter().sum(), max_relative = 1e-12);
    let error = build(&Regions::default()).err().unwrap().to_string();
    assert!(error.contains("more than right"), "{error}");

    // Two halves in a row carry the same force: the stiff one stretches by a twenty-fifth of the soft one, away from what joins them
    // and from where they are pulled. So little that what bends is as good as flat.
    let mesh = sheet(60.0, 20, |x, y| Vec3::new(x, y, 0.0));
    let moduli: Vec<f64> = mesh.positions.iter().map(|p| if p.x > 30.0 { 25.0 } else { 1.0 }).collect();
    let options = TissueOptions { poisson: 0.0, ..TISSUE };
    let mut body = body(Box::new(Fem::new(&mesh, options, 1.0).unwrap().with_moduli(&moduli)));
    pull(&mut body, mesh.positions.iter().map(|p| p + Vec3::x() * (1e-4 * p.x)).collect(), |v| v % 21 % 20 == 0);
    let settled = settle(&mut body);
    let longer = |a: usize, b: usize| settled[b].x - settled[a].x - (mesh.positions[b].x - mesh.positions[a].x);
    let [soft, stiff] = [longer(213, 217), longer(223, 227)];
    println!("soft {soft:e}, stiff {stiff:e}, ratio {}", soft / stiff);
    approx::assert_relative_eq!(soft / stiff, 25.0, max_relative = 0.05);
}

#[test]
fn one_spring_is_hookes_law() {
    let mesh = sheet(10.0, 1, |x, y| Vec3::new(x, y, 0.0));
    let mut model = springs(&mesh);
    let rest = model.rest_parameters();
    let all: Vec<_> = model.springs().collect();
    // Two triangles: five edges above and below, ten across, four down.
    assert_eq!(all.len(), 24);
    let node = |x: &[f64], k: u32| Vec3::from_column_slice(&x[3 * k as usize..3 * k as usize + 3]);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let x: Vec<f64> = rest.iter().map(|x| x + rng.random_range(-2.0..2.0)).collect();
    let stated = all.iter().map(|&([a, b], k, l)| {
        approx::assert_relative_eq!((node(&rest, a) - node(&rest, b)).norm(), l, max_relative = 1e-14);
        k * ((node(&x, a) - node(&x, b)).norm() - l).powi(2)
    });
    approx::assert_relative_eq!(energy(&mut model, &x), 0.8 * stated.sum::<f64>(), max_relative = 1e-12);
}

/// Energy of a sheet whose nodes go to `place`.
fn of_field(model: &mut dyn DeformationModel, nodes: &[Vec3], place: impl Fn(&Vec3) -> Vec3) -> f64 {
    let x: Vec<f64> = nodes.iter().flat_map(|p| <[f64; 3]>::from(place(p))).collect();
    energy(model, &x)
}

/// Where the nodes go, by name.
type Field<'a> = (&'a str, &'a dyn Fn(&Vec3) -> Vec3);

#[test]
fn stiffness_depends_neither_on_the_triangulation_nor_on_the_unit() {
    let stretch = |p: &Vec3| Vec3::new(1.01 * p.x, 0.995 * p.y, p.z);
    // Rolled up round a cylinder: lines across the layer stay straight and at right angles to it.
    let radius = 60.0;
    let bend = |p: &Vec3| {
        let (sin, cos) = (p.x / radius).sin_cos();
        Vec3::new((radius + p.z) * sin, p.y, (radius + p.z) * cos)
    };
    let shear = |p: &Vec3| Vec3::new(p.x + 0.02 * p.z, p.y, p.z);
    let fields: [Field<'_>; 3] = [("stretch", &stretch), ("bend", &bend), ("shear", &shear)];
    let at = |cells: usize, unit: f64| -> Vec<[f64; 2]> {
        let mesh = sheet(30.0 * unit, cells, |x, y| Vec3::new(x, y, 0.0));
        let thickness = 4.0 * unit;
        let mut springs = MassSpring::new(&mesh, SpringOptions { thickness }, 1.0).unwrap();
        let mut tissue = Fem::new(&mesh, TissueOptions { thickness, ..TISSUE }, 1.0).unwrap();
        let nodes = tissue.layer().nodes.clone();
        let mut energies = |field: &dyn Fn(&Vec3) -> Vec3| {
            let place = |p: &Vec3| field(&(p / unit)) * unit;
            [of_field(&mut springs, &nodes, place), of_field(&mut tissue, &nodes, place)].map(|e| e / (unit * unit))
        };
        fields.iter().map(|f| energies(f.1)).collect()
    };
    let [coarse, fine, small] = [at(30, 1.0), at(60, 1.0), at(30, 1.0 / 1024.0)];
    for (k, (name, _)) in fields.iter().enumerate() {
        for model in 0..2 {
            let [a, b, c] = [coarse[k][model], fine[k][model], small[k][model]];
            println!("{name}, model {model}: {a:e} {b:e}");
            assert!(a > 1e-3 && (a - b).abs() < 0.1 * a, "{name}, model {model}: {a} {b}");
            assert!((a - c).abs() < 1e-9 * a, "{name}, model {model}: {a} {c}");
        }
    }
}

#[test]
fn the_lattice_bends_by_the_thin_plates_energy_whatever_its_spacing_and_triangulation() {
    // d = c x^2 / 2: the integral of |grad grad d|^2 is c^2 times the area.
    let (c, size) = (0.01, 118.0);
    let bent = |cells: usize, spacing: f64, unit: f64| {
        let mesh = sheet(size * unit, cells, |x, y| Vec3::new(x, y, 0.0));
        let mut model = Ffd::new(&mesh, LatticeOptions { spacing: spacing * unit }, 500.0, 1.0).unwrap();
        let count = mesh.positions.len();
        let mut body: Body = Deformation::new(Box::new(model), Samples::vertices(count));
        let targets: Vec<Vec3> = mesh.positions.iter().map(|p| p + Vec3::z() * (0.5 * c * p.x * p.x / unit)).collect();
        let residuals = PointToPoint { targets: targets.clone(), weights: vec![1e8; count], scale: 1.0 };
        body.terms = vec![Box::new(Pointwise::new("pull", residuals, Kernel::None))];
        let mut x = body.model.rest_parameters();
        let options = Options::gauss_newton().with_damping_floor(1e-12);
        Minimizer::new(options).unwrap().minimize(&mut body, &mut x);
        assert!(farthest(body.vertices(&x), &targets) < 1e-4 * unit, "splines reproduce squares");
        model = Ffd::new(&mesh, LatticeOptions { spacing: spacing * unit }, 500.0, 1.0).unwrap();
        energy(&mut model, &x) / (unit * unit)
    };
    for (cells, spacing) in [(30, 12.0), (60, 12.0), (60, 6.0), (60, 3.0)] {
        let found = bent(cells, spacing, 1.0);
        // The last cell reaches past the sheet, and the lattice has one row more on either side along it.
        let n = f64::ceil(size / spacing);
        let (area, covered) = (size * size, n * (n + 2.0) * spacing * spacing);
        println!("{cells} cells, spacing {spacing}: {found}, {} of the sheet is covered", covered / area);
        // The sheet lies on a side of the cells, where the third layer of control points has no weight: it relaxes at its rim.
        let all = area / 500.0 * c * c * covered;
        assert!(found < (1.0 + 1e-9) * all && found > 0.96 * all, "{found}, {all}");
    }
    approx::assert_relative_eq!(bent(30, 12.0, 1.0 / 1024.0), bent(30, 12.0, 1.0), max_relative = 1e-6);
}

#[test]
fn an_affine_map_is_free_for_the_lattice() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let linear = Matrix3::from_fn(|_, _| rng.random_range(-2.0..2.0));
    let targets: Vec<Vec3> = bowl().positions.iter().map(|p| linear * p + Vec3::new(3.0, 1.0, 4.0)).collect();
    let mut body = body(Box::new(lattice(&bowl())));
    pull(&mut body, targets.clone(), |v| v % 5 == 0);
    assert!(farthest(&settle(&mut body), &targets) < 1e-5);
}

#[test]
fn lips_that_touch_open() {
    // Two sheets a hair apart, joined at one side only: pulled apart, each follows its own.
    let mut mesh = sheet(20.0, 8, |x, y| Vec3::new(x, y, 0.0));
    let upper = sheet(20.0, 8, |x, y| Vec3::new(x, y, 0.01));
    let first = mesh.positions.len() as u32;
    let name = |v: u32| if v.is_multiple_of(9) { v } else { first + v };
    mesh.triangles.extend(upper.triangles.iter().map(|t| t.map(name)));
    mesh.positions.extend(&upper.positions);
    let lift = |v: usize, p: &Vec3| Vec3::z() * if v < 81 { -0.2 * p.x } else { 0.2 * p.x };
    let targets: Vec<Vec3> = mesh.positions.iter().enumerate().map(|(v, p)| p + lift(v, p)).collect();
    let mut body = body(Box::new(Ffd::new(&mesh, LatticeOptions { spacing: 3.0 }, 500.0, 1e-4).unwrap()));
    pull(&mut body, targets.clone(), |_| true);
    let settled = settle(&mut body);
    for v in (0..162).filter(|v| mesh.positions[*v].x > 10.0) {
        assert!((settled[v] - targets[v]).norm() < 0.2, "{v}: {}", settled[v] - targets[v]);
    }
}

#[test]
fn holding_vertices_where_they_would_go_changes_nothing() {
    let mesh = bowl();
    let held: Vec<bool> = (0..81).map(|i| i % 5 == 1).collect();
    let targets: Vec<Vec3> = mesh.positions.iter().map(|p| p * 1.03 + Vec3::z() * (0.3 * (0.4 * p.x).sin())).collect();
    let pulled = |v: usize| v.is_multiple_of(3) && v % 5 != 1;
    let run = |model: Box<dyn DeformationModel>| {
        let mut body = body(model);
        pull(&mut body, targets.clone(), pulled);
        assert_gradient(&mut body);
        settle(&mut body)
    };
    let [free_springs, free_tissue] = [run(Box::new(springs(&mesh))), run(Box::new(tissue(&mesh)))];
    let again: [Box<dyn DeformationModel>; 2] = [
        Box::new(springs(&mesh).with_held_at(&held, &free_springs)),
        Box::new(tissue(&mesh).with_held_at(&held, &free_tissue)),
    ];
    for (model, free) in again.into_iter().zip([free_springs, free_tissue]) {
        let name = model.name();
        let found = run(model);
        assert!(farthest(&found, &free) < 1e-3, "{name}: {}", farthest(&found, &free));
        assert!((0..81).all(|v| !held[v] || found[v] == free[v]), "held vertices are copied bit for bit");
    }
    for model in [
        Box::new(springs(&mesh).with_held(&held)) as Box<dyn DeformationModel>,
        Box::new(tissue(&mesh).with_held(&held)),
    ] {
        let found = run(model);
        assert!((0..81).all(|v| held[v] == (found[v] == mesh.positions[v])));
    }
}

#[test]
fn a_rough_dent_costs_more_than_a_smooth_one() {
    let mesh = sheet(30.0, 15, |x, y| Vec3::new(x, y, 0.0));
    let wave = |p: &Vec3, waves: f64| 0.05 * (waves * std::f64::consts::TAU * p.x / 30.0).sin();
    for model in every_model(&mesh) {
        let name = model.name();
        let mut body = body(model);
        let mut cost = |waves: f64| {
            let targets = mesh.positions.iter().map(|p| p + Vec3::z() * wave(p, waves)).collect();
            pull(&mut body, targets, |_| true);
            let mut x = body.model.rest_parameters();
            let options = Options::gauss_newton().with_damping_floor(1e-10);
            Minimizer::new(options).unwrap().minimize(&mut body, &mut x);
            let energies = body.energies(&x);
            energies.iter().map(|e| e.1).sum::<f64>()
        };
        let [smooth, rough] = [cost(1.0), cost(4.0)];
        println!("{name}: {smooth:e} {rough:e}");
        assert!(smooth > 0.0 && rough > 4.0 * smooth, "{name}: {smooth} {rough}");
    }
}

#[test]
fn an_anchored_inner_side_resists_a_shift() {
    let mesh = sheet(10.0, 5, |x, y| Vec3::new(x, y, 0.0));
    let mut model = Fem::new(&mesh, TissueOptions { anchor: 2.0, ..TISSUE }, 0.8).unwrap();
    let nodes = model.layer().nodes.clone();
    let area: f64 = face_areas(&mesh.positions, &mesh.triangles).iter().sum();
    let shifted = of_field(&mut model, &nodes, |p| p + Vec3::new(0.0, 0.3, 0.4));
    approx::assert_relative_eq!(shifted, 0.8 * 2.0 * area * 0.25 / 9.0, max_relative = 1e-9);
    let mut body = body(Box::new(model));
    assert_gradient(&mut body);
}

#[test]
fn what_is_broken_stays_finite_and_what_has_no_data_stays() {
    // A bowl with data, a sheet without, a triangle without area, three vertices on one spot, one in no triangle, and triangles
    // twice and of one vertex.
    let mut mesh = bowl();
    let other = sheet(8.0, 2, |x, y| Vec3::new(x + 100.0, y, 0.0));
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 81)));
    mesh.positions.extend(&other.positions);
    mesh.positions.extend([Vec3::zeros(), Vec3::x() * 2.0, Vec3::x() * 5.0].map(|p| p + Vec3::new(100.0, 0.0, 9.0)));
    mesh.positions.extend([Vec3::new(101.0, 2.0, 30.0); 3]);
    mesh.positions.push(Vec3::new(103.0, 1.2, 0.5));
    mesh.triangles.extend([[90, 91, 92], [93, 94, 95], [3, 3, 4], [7, 7, 7], mesh.triangles[5], mesh.triangles[8]]);
    let targets: Vec<Vec3> = mesh.positions.iter().map(|p| p * 1.1 + Vec3::z()).collect();
    for model in every_model(&mesh) {
        let name = model.name();
        let mut body = body(model);
        pull(&mut body, targets.clone(), |v| v < 81);
        let settled = settle(&mut body);
        assert!(settled.iter().all(|p| p.iter().all(|c| c.is_finite())), "{name}");
        assert!(farthest(&settled[..81], &targets) < 3.0, "{name}: {}", farthest(&settled[..81], &targets));
        assert!(farthest(&settled[81..], &mesh.positions[81..]) < 1e-3, "{name}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut broken = bowl();
    broken.positions[4].y = f64::INFINITY;
    let line = sheet(10.0, 3, |x, y| Vec3::new(x + y, 0.0, 0.0));
    let built = |mesh: &TriangleMesh| {
        [
            MassSpring::new(mesh, SpringOptions::default(), 1.0).err(),
            Fem::new(mesh, TISSUE, 1.0).err(),
            Ffd::new(mesh, LatticeOptions::default(), 500.0, 1.0).err(),
        ]
    };
    for error in built(&broken) {
        assert!(matches!(error, Some(MeshError::NotFinite { vertex: 4, .. })), "{error:?}");
    }
    assert_eq!(built(&line)[..2], [Some(MeshError::NoArea), Some(MeshError::NoArea)]);
    let cloud = TriangleMesh { triangles: Vec::new(), ..bowl() };
    assert!(built(&cloud).iter().all(|e| *e == Some(MeshError::NoArea)));
    let error = Ffd::new(&bowl(), LatticeOptions { spacing: 1e-4 }, 500.0, 1.0).err();
    assert_eq!(error, Some(MeshError::TooManyCells { spacing: 1e-4 }));
}
