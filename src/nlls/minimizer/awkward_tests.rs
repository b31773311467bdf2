//! Rank-deficient, badly scaled and non-finite problems: every minimiser with every direct solver ends with a named reason,
//! and never with a NaN.

use super::*;
use crate::nlls::linear::LinearError;
use crate::nlls::{Bounded, Euclidean, Family, Residual, ResidualProblem, Scalar};

/// What a residual makes of two blocks of two parameters, a and b, and one parameter w, at time t.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    /// w has no effect: a zero column.
    ZeroColumn,
    /// a_0 and w have the same one: two equal columns.
    EqualColumns,
    /// Columns from 1e-12 to 1e12.
    Scales,
    /// No logarithm of the start.
    NanAtStart,
    /// A value at the start, but an infinite derivative.
    InfiniteDerivative,
    /// Full steps leave the domain of the logarithm.
    NanAtTrial,
    /// Full steps overflow.
    InfiniteAtTrial,
    /// The start solves it.
    Solved,
}

struct Sample {
    shape: Shape,
    t: f64,
}

impl Residual<1, 5> for Sample {
    type Blocks = (Euclidean<2>, Euclidean<2>, Euclidean<1>);

    fn evaluate<D: Scalar>(&self, (a, b, w): &([D; 2], [D; 2], [D; 1])) -> [D; 1] {
        let t = self.t;
        let y = (3.0 * t).sin() + 2.0;
        let rest = a[1] * t + b[0] * (t * t) + b[1] * t.cos() - y;
        [match self.shape {
            Shape::ZeroColumn => rest + a[0],
            Shape::EqualColumns => rest + a[0] + w[0],
            Shape::Scales => {
                a[0] * 1e-12 + a[1] * (1e-6 * t) + b[0] * (t * t) + b[1] * (1e6 * t.cos()) + w[0] * (1e12 * t.exp()) - y
            }
            Shape::NanAtStart => rest + a[0] + (w[0] - 5.0).ln() * (-2.0 * t).exp(),
            Shape::InfiniteDerivative => rest + a[0] + (w[0] - 0.5).sqrt() * (-2.0 * t).exp(),
            Shape::NanAtTrial => rest + a[0] + ((w[0] - 0.4).ln() + 8.0) * (t * t * t),
            Shape::InfiniteAtTrial => rest + a[0] + (((w[0] - 0.5) * 100.0).exp() - 1e4) * (t * t * t),
            Shape::Solved => a[0] - 0.5 + (a[1] - 0.5) * t + (b[0] - b[1]) * (t * t) + (w[0] - 0.5) * t.exp(),
        }]
    }
}

/// The blocks all in the border, all sparse, or the last one in the border.
fn problem(shape: Shape, placed: &str) -> ResidualProblem {
    let mut builder = ResidualProblem::builder();
    let start = [0.5; 2];
    let [a, b] = [0, 1].map(|_| match placed {
        "dense" => builder.add_border_block::<Euclidean<2>>(&start),
        _ => builder.add_block::<Euclidean<2>>(&start),
    });
    let w = match placed {
        "sparse" => builder.add_block::<Euclidean<1>>(&start[..1]),
        _ => builder.add_border_block::<Euclidean<1>>(&start[..1]),
    };
    let samples: Vec<Sample> = (0..20).map(|k| Sample { shape, t: 0.05 * k as f64 }).collect();
    builder.add_family(Family::new(samples, &[(); 20].map(|()| [a, b, w])));
    builder.build().unwrap()
}

/// Runs all minimisers with all solvers that can factor, on all placements.
fn each(shape: Shape, check: impl Fn(&Options, &Summary)) {
    use LinearSolverKind::{Bordered, Dense};
    for options in [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()] {
        for placed in ["dense", "sparse", "bordered"] {
            for kind in [Dense, Bordered] {
                let mut problem = problem(shape, placed);
                let mut x = problem.initial();
                let options = options.with_linear_solver(kind).with_max_iterations(300);
                let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
                assert!(x.iter().all(|v| v.is_finite()), "{shape:?}, {placed}: {x:?}\n{summary}");
                let energy = problem.energy(&x);
                assert!(energy == summary.final_energy || energy.is_nan(), "{shape:?}, {placed}\n{summary}");
                assert!(energy <= summary.initial_energy || energy.is_nan(), "{shape:?}, {placed}\n{summary}");
                check(&options, &summary);
            }
        }
    }
}

fn is_gauss_newton(options: &Options) -> bool {
    matches!(options.algorithm, Algorithm::GaussNewton(_))
}

#[test]
fn directions_that_nothing_observes() {
    for shape in [Shape::ZeroColumn, Shape::EqualColumns] {
        each(shape, |options, summary| {
            if is_gauss_newton(options) {
                let named =
                    matches!(summary.stop, StopReason::LinearSolverFailed(LinearError::NotPositiveDefinite { .. }));
                assert!(named && summary.iterations == 0, "{shape:?}: {summary}");
            } else {
                assert!(summary.stop.converged(), "{shape:?}: {summary}");
                assert!(summary.final_energy < 0.05, "{shape:?}: {summary}");
                assert!(summary.unobserved_directions() <= 1, "{shape:?}: {summary}");
            }
        });
    }
}

#[test]
fn scales_from_minus_to_plus_twelve() {
    each(Shape::Scales, |_, summary| {
        assert!(summary.stop.converged(), "{summary}");
        // Least squares of five functions leave this.
        assert!(summary.final_energy < 1e-3, "{summary}");
    });
}

#[test]
fn a_start_that_is_not_finite() {
    each(Shape::NanAtStart, |_, summary| assert_eq!(summary.stop, StopReason::NonFinite, "{summary}"));
}

#[test]
fn a_derivative_that_is_not_finite() {
    each(Shape::InfiniteDerivative, |_, summary| {
        let named = matches!(summary.stop, StopReason::LinearSolverFailed(LinearError::NonFinite { .. }));
        assert!(named && summary.iterations == 0, "{summary}");
    });
}

#[test]
fn trials_that_are_not_finite() {
    for shape in [Shape::NanAtTrial, Shape::InfiniteAtTrial] {
        each(shape, |_, summary| {
            let met = summary.records.iter().any(|r| r.gain == f64::NEG_INFINITY || r.step_scale < 1.0);
            assert!(met && summary.stop.was_successful(), "{shape:?}: {summary}");
            assert!(summary.final_energy < 0.1 * summary.initial_energy, "{shape:?}: {summary}");
        });
    }
}

#[test]
fn nothing_left_to_do() {
    each(Shape::Solved, |_, summary| {
        assert_eq!((summary.stop, summary.iterations), (StopReason::Converged(Convergence::Gradient), 0), "{summary}");
        assert_eq!(summary.final_energy, 0.0);
    });
}

#[test]
fn dogleg_between_bounds_ends_where_the_others_do() {
    for placed in ["dense", "bordered"] {
        let ends: Vec<Vec<f64>> = [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()]
            .map(|options| {
                let problem = problem(Shape::NanAtTrial, placed);
                let mut x = problem.initial();
                let border = problem.structure().border();
                let first = x.len() - border;
                let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; border], vec![f64::INFINITY; border]);
                (lower[border - 1], upper[border - 1]) = (0.45, 0.9);
                let mut problem = Bounded { problem, first, lower, upper };
                let options = options.with_max_iterations(300);
                let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
                assert!(summary.stop.converged(), "{placed}: {summary}");
                x
            })
            .into();
        for x in &ends {
            assert!((0.45..=0.9).contains(&x[4]), "{ends:?}");
            assert!(x.iter().zip(&ends[0]).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b.abs())), "{ends:?}");
        }
    }
}
