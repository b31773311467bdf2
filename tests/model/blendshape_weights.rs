//! Laws of blendshape weights: bounds, and the standard deviations that a fit reports.

use nalgebra::DMatrix;
use nonrigid::energy::{Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::Vec3;
use nonrigid::model::{AffineMotion, Hybrid, NodeGraph, Stiffness, blendshape};
use nonrigid::nlls::{
    Bounded, Kernel, Minimizer, NormalEquations, Options, Problem, Silent, Workspace, border_covariance,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::PointToPoint;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::dense_covariance::dense_covariance;
use crate::projected_gradient::projected_gradient;
use crate::threads::on_threads;
use crate::zoo::random_vec;

const VERTICES: usize = 90;
const SHAPES: usize = 7;

/// Two standard normal numbers (Box and Muller 1958).
fn normal(rng: &mut ChaCha8Rng) -> [f64; 2] {
    let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    let radius = (-2.0 * u.ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    [radius * cos, radius * sin]
}

fn noise(rng: &mut ChaCha8Rng, sigma: f64) -> Vec3 {
    let ([x, y], [z, _]) = (normal(rng), normal(rng));
    Vec3::new(x, y, z) * sigma
}

fn rest(rng: &mut ChaCha8Rng) -> Vec<Vec3> {
    (0..VERTICES).map(|_| random_vec(rng, 50.0)).collect()
}

/// Shapes of very different sizes, all but the first three of which are alike in pairs.
fn shapes(rng: &mut ChaCha8Rng, bounds: impl Fn(usize) -> [f64; 2]) -> ShapeBasis {
    let shapes = (0..SHAPES).map(|k| Shape { name: k.to_string(), family: Family::Expression }).collect();
    let slab = (0..3 * VERTICES)
        .flat_map(|_| {
            let mut row: [f64; SHAPES] = std::array::from_fn(|k| rng.random_range(-1.0..1.0) * (0.5 + k as f64));
            row[4] = 0.8 * row[3] + 0.3 * row[4];
            row.map(|d| d as f32)
        })
        .collect();
    ShapeBasis::new(shapes, slab).with_bounds(|shape| bounds(shape.name.parse().unwrap()))
}

fn to_points(targets: Vec<Vec3>, scale: f64, kernel: Kernel) -> Pointwise<PointToPoint, Kernel, 3> {
    let weights = vec![1.0; targets.len()];
    Pointwise::new("points", PointToPoint { targets, weights, scale }, kernel)
}

#[test]
fn deviations_of_weights_are_the_scatter_of_repeated_fits() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (sigma, alpha, draws) = (0.8, 2.5, 200);
    let rest = rest(&mut rng);
    let basis = shapes(&mut rng, |_| [f64::NEG_INFINITY, f64::INFINITY]);
    let mut problem = Deformation::new(blendshape(rest, basis, 1e-9), Samples::vertices(VERTICES));
    // A turned, shifted face with all shapes in it.
    let mut truth = problem.model.rest_parameters();
    let step: Vec<f64> = (0..6 + SHAPES).map(|i| [0.2, 0.7][usize::from(i >= 6)] * (1.0 + i as f64).sin()).collect();
    let start = truth.clone();
    problem.retract(&start, &step, &mut truth);
    let exact = problem.vertices(&truth).to_vec();

    let minimizer = Minimizer::new(Options::gauss_newton()).unwrap();
    let mut workspace = Workspace::new();
    let (mut sum, mut squares, mut variances) = ([0.0; SHAPES], [0.0; SHAPES], 0.0);
    for _ in 0..draws {
        problem.terms =
            vec![to_points(exact.iter().map(|p| p + noise(&mut rng, sigma)).collect(), alpha, Kernel::None)];
        let mut x = start.clone();
        let summary = minimizer.minimize_with(&mut problem, &mut x, &mut workspace, &mut Silent);
        assert!(summary.stop.converged(), "{summary}");
        for (k, w) in x[x.len() - SHAPES..].iter().enumerate() {
            let error = w - truth[truth.len() - SHAPES + k];
            sum[k] += error;
            squares[k] += error * error;
        }
        variances += problem.residual_variance(&x).unwrap() / f64::from(draws);
    }
    // Residuals of weight alpha have variance sigma^2; a residual of weight one has alpha times that.
    let (residuals, parameters) = ((3 * VERTICES) as f64, (6 + SHAPES) as f64);
    let corrected = variances * residuals / (residuals - parameters);
    let sampling = (2.0 / (f64::from(draws) * (residuals - parameters))).sqrt();
    assert!((corrected / (alpha * sigma * sigma) - 1.0).abs() < 4.0 * sampling, "{corrected}");

    problem.terms = vec![to_points(exact, alpha, Kernel::None)];
    let covariance = border_covariance(&mut problem, &truth).unwrap() * (alpha * sigma * sigma);
    let count = f64::from(draws);
    for k in 0..SHAPES {
        let predicted = covariance[(k, k)].sqrt();
        let empirical = ((squares[k] - sum[k] * sum[k] / count) / (count - 1.0)).sqrt();
        println!("weight {k}: predicted {predicted:.5}, empirical {empirical:.5}");
        // A standard deviation from n draws scatters by its 1 / sqrt(2 (n - 1)), a mean by 1 / sqrt(n).
        let sampling = 1.0 / (2.0 * (count - 1.0)).sqrt();
        assert!((empirical / predicted - 1.0).abs() < 3.5 * sampling, "weight {k}: {empirical} {predicted}");
        assert!((sum[k] / count).abs() < 4.0 * predicted / count.sqrt(), "weight {k} is biased by {}", sum[k] / count);
    }
    // The shapes are not equally well known, or this shows little.
    let all: Vec<f64> = (0..SHAPES).map(|k| covariance[(k, k)].sqrt()).collect();
    assert!(all.iter().copied().fold(0.0, f64::max) > 5.0 * all.iter().copied().fold(f64::MAX, f64::min), "{all:?}");
}

#[test]
fn residual_variances_leave_out_what_a_kernel_has_switched_off() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let rest = rest(&mut rng);
    let mut problem = Deformation::new(blendshape(rest.clone(), ShapeBasis::none(), 1.0), Samples::vertices(VERTICES));
    assert_eq!(problem.residual_variance(&problem.model.rest_parameters()), None);
    let outliers = VERTICES / 3;
    let target = |(i, p): (usize, &Vec3)| p + Vec3::x() * if i < outliers { 40.0 } else { 0.1 };
    problem.terms = vec![to_points(rest.iter().enumerate().map(target).collect(), 3.0, Kernel::Tukey { delta: 5.0 })];
    let x = problem.model.rest_parameters();
    // Each vertex has three scalar residuals, one of which is 0.1 mm.
    let expected = 3.0 * 0.01 / 3.0;
    let found = problem.residual_variance(&x).unwrap();
    assert!((found / expected - 1.0).abs() < 1e-12, "{found}");
}

type Fit = Deformation<Box<dyn DeformationModel>, Pointwise<PointToPoint, Kernel, 3>>;

const MODELS: [&str; 3] = ["hybrid", "affine hybrid", "blendshape"];

/// How weights are bounded.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Bounds {
    /// Zero to one, where the data want some weights below, some above.
    Unit,
    /// Some a little too narrow for what the data say, with one side or two.
    Narrow,
}

impl Bounds {
    fn of(self, k: usize, wanted: f64) -> [f64; 2] {
        match (self, k) {
            (Self::Unit, _) => [0.0, 1.0],
            (Self::Narrow, 1 | 4) => [f64::NEG_INFINITY, wanted - 0.02],
            (Self::Narrow, 2) => [wanted + 0.03, 9.0],
            (Self::Narrow, _) => [-1.6, 2.6],
        }
    }
}

/// A model with shapes, drawn beyond bounds of their weights.
fn bounded_problem(which: &str, bounds: Bounds, seed: u64) -> Fit {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rest = rest(&mut rng);
    let wanted: Vec<f64> = match bounds {
        Bounds::Narrow => (0..SHAPES).map(|k| (seed as f64 + 2.0 * k as f64).sin()).collect(),
        Bounds::Unit => (0..SHAPES).map(|k| [-0.4, 0.5, 1.3, 0.2][k % 4] + rng.random_range(-0.2..0.2)).collect(),
    };
    let basis = shapes(&mut rng, |k| bounds.of(k, wanted[k]));
    let influences: Vec<Vec<(u32, f64)>> =
        (0..VERTICES).map(|i| vec![((i % 5) as u32, 0.7), (((i + 1) % 5) as u32, 0.3)]).collect();
    let nodes = NodeGraph::from_influences((0..5).map(|j| rest[j]).collect(), influences);
    let stiffness = Stiffness { graph: 0.5, rotation: 0.2, blend: 0.01, ..Stiffness::default() };
    let model: Box<dyn DeformationModel> = match which {
        "hybrid" => Box::new(Hybrid::new(rest.clone(), nodes, basis.clone(), stiffness)),
        "affine hybrid" => {
            Box::new(Hybrid::<AffineMotion, 12>::with_motion(rest.clone(), nodes, basis.clone(), stiffness))
        }
        _ => Box::new(blendshape(rest.clone(), basis.clone(), 0.01)),
    };
    let mut problem = Deformation::new(model, Samples::vertices(VERTICES));
    let targets = (0..VERTICES).map(|i| basis.blend(i, rest[i], &wanted) + random_vec(&mut rng, 0.05)).collect();
    problem.terms = vec![to_points(targets, 1.0, Kernel::Huber { delta: 2.0 })];
    problem
}

/// Where the minimiser ends, and which weights are at a bound there.
fn bounded_fit(which: &str, bounds: Bounds, seed: u64, options: Options) -> (Vec<f64>, Vec<bool>) {
    let mut problem = bounded_problem(which, bounds, seed);
    let mut x = problem.model.rest_parameters();
    let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
    assert!(summary.stop.was_successful(), "{which}, {bounds:?}, {seed}: {summary}");
    let (lower, upper) = problem.model.border_bounds().unwrap();
    let weights = &x[x.len() - SHAPES..];
    let held: Vec<bool> = (0..SHAPES).map(|k| weights[k] == lower[k] || weights[k] == upper[k]).collect();
    for (k, w) in weights.iter().enumerate() {
        assert!((lower[k]..=upper[k]).contains(w), "{which}, {bounds:?}, {seed}, {k}: {w}");
        assert_eq!(held[k], problem.border_bounds().unwrap().at_bound(&x, k));
    }
    assert!(held.iter().filter(|h| **h).count() >= 2 && held.iter().any(|h| !h), "{held:?}");
    (x, held)
}

#[test]
fn bounded_weights_are_at_the_constrained_minimum() {
    let tight = |options: Options| options.with_max_iterations(300).with_energy_tolerance(0.0);
    for which in MODELS {
        for bounds in [Bounds::Unit, Bounds::Narrow] {
            for seed in 0..5 {
                for options in [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()] {
                    let (x, _) = bounded_fit(which, bounds, seed, tight(options));
                    // Of a problem that has seen nothing yet.
                    let mut fresh = bounded_problem(which, bounds, seed);
                    let last = projected_gradient(&mut fresh, &x);
                    let start = fresh.model.rest_parameters();
                    let mut equations = NormalEquations::new(fresh.structure().clone());
                    fresh.linearize(&start, &mut equations);
                    let first = equations.gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
                    assert!(last <= 1e-8 * first.max(1.0), "{which}, {bounds:?}, {seed}: {last:e} after {first:e}");
                }
            }
        }
    }
}

#[test]
fn covariances_of_weights_are_their_part_of_the_whole_inverse() {
    for which in MODELS {
        for seed in 0..3 {
            let (x, held) = bounded_fit(which, Bounds::Unit, seed, Options::gauss_newton());
            let mut problem = bounded_problem(which, Bounds::Unit, seed);
            let mut equations = NormalEquations::new(problem.structure().clone());
            problem.linearize(&x, &mut equations);
            let h = equations.to_dense();
            let close = |found: DMatrix<f64>, held: &[bool]| {
                let expected = dense_covariance(&h, SHAPES, held);
                let error = (found - &expected).amax() / expected.amax();
                assert!(error <= 1e-8, "{which}, {seed}, {held:?}: {error:e}");
            };
            close(border_covariance(&mut problem, &x).unwrap(), &held);
            // The same point with bounds out of reach.
            let (first, far) = (x.len() - SHAPES, f64::INFINITY);
            let mut free = Bounded { problem, first, lower: vec![-far; SHAPES], upper: vec![far; SHAPES] };
            close(border_covariance(&mut free, &x).unwrap(), &[false; SHAPES]);
        }
    }
}

#[test]
fn bounded_weights_have_the_same_bits_at_any_number_of_threads() {
    for which in MODELS {
        let [one, two] = [1, 2]
            .map(|threads| on_threads(threads, || bounded_fit(which, Bounds::Unit, 1, Options::gauss_newton()).0));
        assert!(one.iter().zip(&two).all(|(a, b)| a.to_bits() == b.to_bits()), "{which}");
    }
}
