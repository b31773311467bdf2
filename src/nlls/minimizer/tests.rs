//! Laws of the minimisers on small dense problems with known answers.

use std::ops::ControlFlow;

use super::*;
use crate::nlls::Bounded;
use crate::nlls::linear::{Coordinate, LinearError};

/// Residuals and their Jacobian, row by row.
type Residuals = fn(&[f64]) -> Vec<(f64, Vec<f64>)>;

/// A dense problem over plain coordinates.
struct Dense {
    structure: Arc<BlockStructure>,
    residuals: Residuals,
    linearizations: usize,
}

impl Dense {
    fn new(n: usize, residuals: Residuals) -> Self {
        Self { structure: Arc::new(BlockStructure::dense(n)), residuals, linearizations: 0 }
    }
}

impl Problem for Dense {
    fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    fn parameter_len(&self) -> usize {
        self.structure.dimension()
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        (self.residuals)(x).iter().map(|(r, _)| r * r).sum()
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        self.linearizations += 1;
        equations.clear();
        let n = x.len();
        for (r, row) in (self.residuals)(x) {
            for i in 0..n {
                equations.gradient[i] += row[i] * r;
                for j in 0..n {
                    equations.border[i * n + j] += row[i] * row[j];
                }
            }
        }
        self.energy(x)
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        for i in 0..x.len() {
            out[i] = x[i] + step[i];
        }
    }
}

fn linear(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
    vec![
        (x[0] + 2.0 * x[1] - 1.0, vec![1.0, 2.0]),
        (3.0 * x[0] - x[1] - 2.0, vec![3.0, -1.0]),
        (x[0] + x[1], vec![1.0, 1.0]),
    ]
}

fn rosenbrock(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
    vec![(10.0 * (x[1] - x[0] * x[0]), vec![-20.0 * x[0], 10.0]), (1.0 - x[0], vec![-1.0, 0.0])]
}

fn powell_singular(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
    let (five, ten) = (5.0_f64.sqrt(), 10.0_f64.sqrt());
    let (u, v) = (x[1] - 2.0 * x[2], x[0] - x[3]);
    vec![
        (x[0] + 10.0 * x[1], vec![1.0, 10.0, 0.0, 0.0]),
        (five * (x[2] - x[3]), vec![0.0, 0.0, five, -five]),
        (u * u, vec![0.0, 2.0 * u, -4.0 * u, 0.0]),
        (ten * v * v, vec![2.0 * ten * v, 0.0, 0.0, -2.0 * ten * v]),
    ]
}

/// The third coordinate is seen by nothing.
fn unobserved(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
    vec![(x[0] * x[0] - 2.0, vec![2.0 * x[0], 0.0, 0.0]), (x[1] - x[0], vec![-1.0, 1.0, 0.0])]
}

fn run(options: Options, n: usize, residuals: Residuals, start: &[f64]) -> (Summary, Vec<f64>) {
    let mut x = start.to_vec();
    let summary = Minimizer::new(options).unwrap().minimize(&mut Dense::new(n, residuals), &mut x);
    (summary, x)
}

fn all() -> [Options; 3] {
    [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()]
}

#[test]
fn gauss_newton_solves_a_linear_problem_in_one_step() {
    let (summary, x) = run(Options::gauss_newton(), 2, linear, &[30.0, -40.0]);
    assert!(summary.stop.converged(), "{summary}");
    assert_eq!(summary.records[0].step_scale, 1.0);
    assert!((summary.records[0].gain - 1.0).abs() < 1e-12, "{summary}");
    assert!((summary.records[0].energy - summary.final_energy).abs() < 1e-15);
    // Normal equations by hand: [11 0; 0 6] x = [7; 0].
    assert!((x[0] - 7.0 / 11.0).abs() < 1e-14 && x[1].abs() < 1e-14, "{x:?}");
}

#[test]
fn rosenbrock_from_the_classical_start() {
    for options in all() {
        let (summary, x) = run(options, 2, rosenbrock, &[-1.2, 1.0]);
        assert!(summary.stop.converged(), "{summary}");
        assert!((x[0] - 1.0).abs() < 1e-9 && (x[1] - 1.0).abs() < 1e-9, "{summary}\n{x:?}");
        assert_eq!(summary.initial_energy, 24.199999999999996);
    }
}

#[test]
fn powell_singular_converges_though_its_hessian_does_not_stay_regular() {
    for options in [Options::levenberg_marquardt(), Options::dogleg()] {
        let (summary, x) = run(options.with_max_iterations(200), 4, powell_singular, &[3.0, -1.0, 0.0, 1.0]);
        assert!(summary.stop.was_successful(), "{summary}");
        assert!(summary.final_energy < 1e-16 && x.iter().all(|v| v.abs() < 1e-4), "{summary}\n{x:?}");
    }
}

#[test]
fn energies_never_rise() {
    for options in all() {
        for (n, residuals, start) in
            [(2, rosenbrock as Residuals, &[-1.2, 1.0][..]), (4, powell_singular, &[3.0, -1.0, 0.0, 1.0])]
        {
            let (summary, _) = run(options, n, residuals, start);
            let mut last = summary.initial_energy;
            for r in &summary.records {
                assert!(r.energy <= last, "{summary}");
                last = r.energy;
            }
        }
    }
}

#[test]
fn a_singular_problem_ends_with_a_named_reason() {
    let (summary, x) = run(Options::gauss_newton(), 3, unobserved, &[1.0, 0.0, 5.0]);
    let reason = LinearError::NotPositiveDefinite { at: Coordinate::Border { index: 2 } };
    assert_eq!(summary.stop, StopReason::LinearSolverFailed(reason));
    assert!(!summary.stop.was_successful());
    assert_eq!(x, [1.0, 0.0, 5.0]);
    assert!(summary.to_string().contains("border coordinate 2"), "{summary}");
}

#[test]
fn a_damping_floor_leaves_unobserved_directions_where_they_are() {
    for options in all() {
        let (summary, x) = run(options.with_damping_floor(1e-9), 3, unobserved, &[1.0, 0.0, 5.0]);
        assert!(summary.stop.converged(), "{summary}");
        assert!((x[0] - 2.0_f64.sqrt()).abs() < 1e-9 && (x[1] - x[0]).abs() < 1e-9);
        assert_eq!(x[2], 5.0);
        assert!(summary.unobserved_directions() >= 1, "{summary}");
    }
}

#[test]
fn rejected_steps_do_not_linearise_again() {
    for options in [Options::levenberg_marquardt(), Options::dogleg()] {
        let mut problem = Dense::new(2, rosenbrock);
        let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut [-1.2, 1.0]);
        assert!(summary.accepted_steps() < summary.iterations, "{summary}");
        assert!(problem.linearizations <= summary.accepted_steps() + 1, "{summary}");
    }
}

#[test]
fn the_observer_stops_the_run() {
    for options in all() {
        let mut x = vec![-1.2, 1.0];
        let mut seen = 0;
        let mut observer = |record: &IterationRecord| {
            seen = record.iteration;
            if record.iteration == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let mut workspace = Workspace::new();
        let minimizer = Minimizer::new(options).unwrap();
        let summary = minimizer.minimize_with(&mut Dense::new(2, rosenbrock), &mut x, &mut workspace, &mut observer);
        assert_eq!((summary.stop, summary.iterations), (StopReason::StoppedByObserver, 3));
        assert_eq!(seen, 3);
    }
}

#[test]
fn non_finite_energies_are_survived() {
    fn logarithm(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        vec![(x[0].ln(), vec![1.0 / x[0]])]
    }
    for options in all() {
        // From 5 the first full step goes to 5 - 5 ln 5 < 0, where the residual is NaN.
        let (summary, x) = run(options, 1, logarithm, &[5.0]);
        assert!(summary.stop.converged() && (x[0] - 1.0).abs() < 1e-9, "{summary}");
        let (summary, x) = run(options, 1, logarithm, &[-1.0]);
        assert_eq!(summary.stop, StopReason::NonFinite);
        assert_eq!(x, [-1.0]);
    }
}

#[test]
fn a_wrong_gradient_ends_in_no_decrease() {
    fn lying(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        vec![(x[0] - 3.0, vec![-1.0])]
    }
    for options in all() {
        let (summary, x) = run(options.with_max_iterations(100), 1, lying, &[0.0]);
        assert_eq!(summary.stop, StopReason::NoDecrease, "{summary}");
        assert_eq!(x, [0.0]);
    }
}

#[test]
fn no_iterations_and_a_minimum_at_the_start() {
    for options in all() {
        let (summary, _) = run(options.with_max_iterations(0), 2, rosenbrock, &[-1.2, 1.0]);
        assert_eq!((summary.stop, summary.iterations), (StopReason::MaxIterations, 0));
        let (summary, x) = run(options, 2, rosenbrock, &[1.0, 1.0]);
        assert_eq!((summary.stop, summary.iterations), (StopReason::Converged(Convergence::Gradient), 0));
        assert_eq!(x, [1.0, 1.0]);
    }
}

#[test]
fn a_used_workspace_gives_the_bits_of_a_fresh_one() {
    let mut workspace = Workspace::new();
    for options in all() {
        let minimizer = Minimizer::new(options).unwrap();
        let mut first = vec![3.0, -1.0, 0.0, 1.0];
        minimizer.minimize_with(&mut Dense::new(4, powell_singular), &mut first, &mut workspace, &mut Silent);
        let mut x = vec![-1.2, 1.0];
        let used = minimizer.minimize_with(&mut Dense::new(2, rosenbrock), &mut x, &mut workspace, &mut Silent);
        let (fresh, y) = run(options, 2, rosenbrock, &[-1.2, 1.0]);
        assert_eq!(x, y);
        assert_eq!(used.deterministic_report(), fresh.deterministic_report());
        assert_eq!(serde_json::to_string(used).unwrap(), serde_json::to_string(&fresh).unwrap());
    }
}

#[test]
fn dogleg_steps_stay_in_the_region_and_end_as_gauss_newton() {
    let dogleg = |initial_radius: f64| {
        Options::dogleg().with_algorithm(Algorithm::Dogleg(Dogleg { initial_radius, ..Dogleg::default() }))
    };
    let (summary, x) = run(dogleg(0.01).with_max_iterations(200), 2, rosenbrock, &[-1.2, 1.0]);
    assert!(summary.stop.converged() && (x[0] - 1.0).abs() + (x[1] - 1.0).abs() < 1e-9, "{summary}");
    assert_eq!(summary.records[0].radius, 0.01 * summary.initial_energy.sqrt());
    // D_11 >= 1 and D_22 = 100, so that |d| <= |d|_D.
    assert!(summary.records.iter().all(|r| r.step_norm <= 1.001 * r.radius), "{summary}");
    // A linear problem is one Gauss-Newton step in a wide region; where the region is narrower, the step reaches its rim.
    let (whole, newton) = run(dogleg(10.0), 2, linear, &[1.0, 0.5]);
    assert!((newton[0] - 7.0 / 11.0).abs() + newton[1].abs() < 1e-14 && whole.accepted_steps() <= 2, "{whole}");
    for share in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let (cut, x) = run(dogleg(share).with_max_iterations(1), 2, linear, &[1.0, 0.5]);
        // D = diag(11, 6).
        let length = |x: &[f64]| (11.0 * (x[0] - 1.0).powi(2) + 6.0 * (x[1] - 0.5).powi(2)).sqrt();
        assert!((length(&x) - cut.records[0].radius.min(length(&newton))).abs() < 1e-12, "{cut}");
        assert!((cut.records[0].gain - 1.0).abs() < 1e-10, "{cut}");
    }
}

#[test]
fn the_units_of_the_parameters_do_not_matter() {
    /// Rosenbrock's function of 2^40 times the first and 2^-40 times the second coordinate.
    fn scaled(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        let (a, b) = (2.0_f64.powi(40), 2.0_f64.powi(-40));
        rosenbrock(&[a * x[0], b * x[1]]).into_iter().map(|(r, row)| (r, vec![a * row[0], b * row[1]])).collect()
    }
    for options in all() {
        let options = options.with_gradient_tolerance(0.0).with_step_tolerance(0.0);
        let (plain, x) = run(options, 2, rosenbrock, &[-1.2, 1.0]);
        let (other, y) = run(options, 2, scaled, &[-1.2 * 2.0_f64.powi(-40), 2.0_f64.powi(40)]);
        assert_eq!(x, [y[0] * 2.0_f64.powi(40), y[1] * 2.0_f64.powi(-40)]);
        let energies = |s: &Summary| s.records.iter().map(|r| r.energy).collect::<Vec<_>>();
        assert_eq!(energies(&plain), energies(&other));
    }
}

#[test]
fn a_short_step_beside_a_far_coordinate_is_no_convergence() {
    /// Rosenbrock's function, and a coordinate that is solved.
    fn beside(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        let wide = |(r, row): (f64, Vec<f64>)| (r, vec![row[0], row[1], 0.0]);
        rosenbrock(x).into_iter().map(wide).chain([(x[2] - 1e12, vec![0.0, 0.0, 1.0])]).collect()
    }
    for options in all() {
        let (summary, x) = run(options, 3, beside, &[-1.2, 1.0, 1e12]);
        assert!(summary.stop.converged() && summary.final_energy < 1e-18, "{summary}\n{x:?}");
    }
}

#[test]
fn a_coordinate_that_runs_away_does_not_end_the_others() {
    /// Box' function: far out, the second coordinate has no effect, and the first step takes it to 1e45.
    fn box3(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        let row = |t: f64| {
            let (a, b, c) = ((-x[0] * t).exp(), (-x[1] * t).exp(), (-t).exp() - (-10.0 * t).exp());
            (a - b - x[2] * c, vec![-t * a, t * b, -c])
        };
        (1..=10).map(|i| row(0.1 * f64::from(i))).collect()
    }
    for options in [Options::levenberg_marquardt(), Options::dogleg()] {
        let (summary, x) = run(options.with_max_iterations(500), 3, box3, &[0.0, 1000.0, 2000.0]);
        assert!(x[1] > 1e20 && summary.stop.converged(), "{summary}\n{x:?}");
        assert!((summary.final_energy - 7.5589e-2).abs() < 1e-5, "{summary}\n{x:?}");
    }
}

#[test]
fn what_heavy_damping_holds_may_still_be_observed() {
    for initial_lambda in [1e-2, 1.0, 1e6] {
        let damped = LevenbergMarquardt { initial_lambda, ..LevenbergMarquardt::default() };
        let options = Options::default().with_algorithm(Algorithm::LevenbergMarquardt(damped)).with_max_iterations(200);
        let (summary, _) = run(options, 2, linear, &[30.0, -40.0]);
        assert_eq!(summary.unobserved_directions(), 0, "{summary}");
        let (summary, _) = run(options, 3, unobserved, &[1.0, 0.0, 5.0]);
        assert_eq!(summary.unobserved_directions(), 1, "{summary}");
    }
}

#[test]
fn a_solver_that_gives_no_descent_is_no_convergence() {
    /// Minus the gradient times a factor.
    #[derive(Debug)]
    struct Lazy(f64);
    impl LinearSolver for Lazy {
        fn solve(&mut self, equations: &NormalEquations, _: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
            step.iter_mut().zip(&equations.gradient).for_each(|(d, g)| *d = -self.0 * g);
            Ok(())
        }
        fn name(&self) -> &'static str {
            "lazy"
        }
    }
    for options in all() {
        for factor in [0.0, -1.0] {
            let mut workspace = Workspace::with_linear_solver(Box::new(Lazy(factor)));
            let (minimizer, mut x) = (Minimizer::new(options).unwrap(), [30.0, -40.0]);
            let summary = minimizer.minimize_with(&mut Dense::new(2, linear), &mut x, &mut workspace, &mut Silent);
            assert_eq!(summary.stop, StopReason::NoDecrease, "{factor}\n{summary}");
            assert_eq!(x, [30.0, -40.0]);
        }
    }
}

#[test]
fn options_name_what_is_wrong_with_them() {
    let error = Minimizer::new(Options::default().with_energy_tolerance(-1.0)).unwrap_err();
    assert_eq!(error.to_string(), "energy_tolerance is -1, but must be finite and not negative");
    assert!(Options::default().with_damping_floor(f64::NAN).validate().is_err());
    let dogleg = Dogleg { initial_radius: 0.0, ..Dogleg::default() };
    let error = Options::dogleg().with_algorithm(Algorithm::Dogleg(dogleg)).validate().unwrap_err();
    assert_eq!(error.to_string(), "dogleg.initial_radius is 0, but must be positive and finite");
    let options: Options = toml::from_str("max_iterations = 7\n[algorithm.gauss_newton]\nmax_halvings = 3\n").unwrap();
    assert_eq!(options.algorithm, Algorithm::GaussNewton(GaussNewton { max_halvings: 3, ..Default::default() }));
    assert!(toml::from_str::<Options>("max_iteration = 7").is_err());
}

#[test]
fn a_small_decrease_under_heavy_damping_is_no_convergence() {
    for initial_lambda in [1e6, 1e13] {
        let damped = LevenbergMarquardt { initial_lambda, ..LevenbergMarquardt::default() };
        let options = Options::default().with_algorithm(Algorithm::LevenbergMarquardt(damped));
        for options in [options, options.with_energy_tolerance(1e-3), options.with_step_tolerance(1e-3)] {
            let (summary, x) = run(options.with_max_iterations(200), 2, linear, &[30.0, -40.0]);
            assert!(summary.stop.converged(), "{summary}");
            assert!((x[0] - 7.0 / 11.0).abs() < 0.1 && x[1].abs() < 0.1, "{summary}\n{x:?}");
        }
    }
}

#[test]
fn records_hold_the_gradient_at_the_point_where_their_step_starts() {
    /// Himmelblau's function and a pull to the diagonal, so that residuals remain.
    fn himmelblau(x: &[f64]) -> Vec<(f64, Vec<f64>)> {
        vec![
            (x[0] * x[0] + x[1] - 11.0, vec![2.0 * x[0], 1.0]),
            (x[0] + x[1] * x[1] - 7.0, vec![1.0, 2.0 * x[1]]),
            (x[0] - x[1], vec![1.0, -1.0]),
        ]
    }
    for (lower, upper) in [([f64::NEG_INFINITY; 2], [f64::INFINITY; 2]), ([0.0, 0.0], [5.0, 2.0])] {
        let norm = |x: &[f64]| {
            let gradient = |k: usize| himmelblau(x).iter().map(|(r, row)| r * row[k]).sum::<f64>();
            let reach = |k: usize| (x[k] - (x[k] - gradient(k)).clamp(lower[k], upper[k])).abs();
            reach(0).max(reach(1))
        };
        for options in all() {
            // No tolerances: the last steps are those that the energy cannot judge.
            let options = options.with_energy_tolerance(0.0).with_step_tolerance(0.0).with_gradient_tolerance(0.0);
            let run = |steps: usize| {
                let problem = Dense::new(2, himmelblau);
                let mut problem = Bounded { problem, first: 0, lower: lower.to_vec(), upper: upper.to_vec() };
                let mut x = [1.0, 1.0];
                let options = options.with_max_iterations(steps);
                (Minimizer::new(options).unwrap().minimize(&mut problem, &mut x), x)
            };
            let (summary, _) = run(100);
            for (k, record) in summary.records.iter().enumerate() {
                let expected = norm(&run(k).1);
                // Both are sums of terms of the size of the residuals.
                assert!((record.gradient_norm - expected).abs() < 1e-12, "{k}: {expected:e}\n{summary}");
            }
            assert!(summary.records.len() > 3, "{summary}");
        }
    }
}
