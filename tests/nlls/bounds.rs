//! Laws of bounds on the border's coordinates and of their covariance, for every minimiser and linear solver.

use std::cell::Cell;
use std::sync::Arc;

use nalgebra::DMatrix;
use nonrigid::nlls::{
    BlockStructure, BorderBounds, Bounded, BoundsError, Euclidean, Family, Kernel, LinearError, LinearSolverKind,
    Manifold, Minimizer, NormalEquations, Options, Problem, Residual, ResidualProblem, Scalar, Se3, Silent, StopReason,
    Workspace, border_covariance, linear::Coordinate,
};

use crate::dense_covariance::dense_covariance;
use crate::projected_gradient::projected_gradient;
use crate::threads::on_threads;

const POSES: usize = 12;
/// Where the border begins in x.
const FIRST: usize = 12 * POSES;
const FREE: [f64; 4] = [f64::INFINITY; 4];

/// A pose carries a point that shared weights shift and bend.
struct Carried {
    p: [f64; 3],
    q: [f64; 3],
}

impl Carried {
    fn place<D: Scalar>(&self, a: &[D; 12], b: &[D; 12], w: &[D; 4]) -> [D; 3] {
        let p = std::array::from_fn(|i| w[i] * (i as f64 + 1.0) + self.p[i] + w[3] * w[i] * self.p[(i + 1) % 3]);
        Se3::transform(b, Se3::transform(a, p))
    }
}

impl Residual<3, 16> for Carried {
    type Blocks = (Se3, Se3, Euclidean<4>);

    fn evaluate<D: Scalar>(&self, (a, b, w): &([D; 12], [D; 12], [D; 4])) -> [D; 3] {
        let p = self.place(a, b, w);
        std::array::from_fn(|i| p[i] - self.q[i])
    }
}

/// Holds three points of a pose, so that poses and weights are all observed.
struct Anchored([f64; 12]);

impl Residual<9, 6> for Anchored {
    type Blocks = (Se3,);

    fn evaluate<D: Scalar>(&self, (a,): &([D; 12],)) -> [D; 9] {
        let points = [[3.0, -2.0, 4.0], [-1.0, 5.0, 2.0], [4.0, 3.0, -3.0]];
        let moved = points.map(|p| Se3::transform(a, p.map(D::from)));
        let wanted = points.map(|p| Se3::transform(&self.0, p));
        std::array::from_fn(|i| moved[i / 3][i % 3] - wanted[i / 3][i % 3])
    }
}

/// Data that some poses and weights explain up to small errors: Gauss-Newton then converges fast, and the gradient of its
/// last point is far below what the rounding of the energy allows, `sqrt(epsilon E H)`.
fn carried(seed: f64) -> ResidualProblem {
    let mut builder = ResidualProblem::builder();
    let poses: Vec<_> = (0..POSES).map(|_| builder.add_block::<Se3>(&Se3::IDENTITY)).collect();
    let weights = builder.add_border_block::<Euclidean<4>>(&[0.1, 0.2, 0.3, 0.0]);
    let truth: Vec<[f64; 12]> = (0..POSES)
        .map(|j| {
            let tangent: [f64; 6] = std::array::from_fn(|i| 0.2 * (seed + (6 * j + i) as f64).sin());
            let mut pose = [0.0; 12];
            Se3::plus(&Se3::IDENTITY, &tangent, &mut pose);
            pose
        })
        .collect();
    let (mut residuals, mut blocks) = (Vec::new(), Vec::new());
    for k in 0..POSES * 8 {
        let p: [f64; 3] = std::array::from_fn(|i| 3.0 * (seed + k as f64 * (1.3 + i as f64)).sin());
        let mut carried = Carried { p, q: [0.0; 3] };
        let (a, b) = (k % POSES, (k + 1) % POSES);
        let placed = carried.place(&truth[a], &truth[b], &[0.4, -0.3, 0.2, 0.15]);
        carried.q = std::array::from_fn(|i| placed[i] + 0.01 * (7.0 * placed[i] + seed).cos());
        residuals.push(carried);
        blocks.push([poses[a], poses[b], weights]);
    }
    builder.add_family(Family::new(residuals, &blocks).with_kernel(Kernel::Huber { delta: 2.0 }));
    let anchors = truth.into_iter().map(Anchored).collect();
    builder.add_family(Family::new(anchors, &poses.iter().map(|p| [*p]).collect::<Vec<_>>()).with_weight(0.5));
    builder.build().unwrap()
}

/// Refuses points outside its bounds.
struct Watched<P>(P, Cell<usize>);

impl<P: Problem> Watched<P> {
    fn check(&self, x: &[f64]) {
        let bounds = self.border_bounds().unwrap();
        for (k, w) in x[bounds.first..][..bounds.lower.len()].iter().enumerate() {
            assert!(bounds.lower[k] <= *w && *w <= bounds.upper[k], "{k}: {w}");
        }
        self.1.set(self.1.get() + 1);
    }
}

impl<P: Problem> Problem for Watched<P> {
    fn structure(&self) -> &Arc<BlockStructure> {
        self.0.structure()
    }

    fn parameter_len(&self) -> usize {
        self.0.parameter_len()
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        self.check(x);
        self.0.energy(x)
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        self.check(x);
        self.0.linearize(x, equations)
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        self.0.retract(x, step, out);
    }

    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        self.0.border_bounds()
    }
}

fn algorithms() -> [Options; 3] {
    [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()]
        .map(|o| o.with_max_iterations(200).with_energy_tolerance(0.0))
}

const KINDS: [LinearSolverKind; 4] =
    [LinearSolverKind::Auto, LinearSolverKind::Dense, LinearSolverKind::Bordered, LinearSolverKind::BlockJacobi];

fn minimize(options: Options, problem: &mut impl Problem, x: &mut [f64]) -> Workspace {
    let mut workspace = Workspace::new();
    Minimizer::new(options).unwrap().minimize_with(problem, x, &mut workspace, &mut Silent);
    workspace
}

#[test]
fn minima_between_bounds_are_stationary_and_at_their_bounds_to_the_bit() {
    let mut held_in_all = 0;
    for seed in 0..6 {
        let seed = f64::from(seed);
        let mut free = carried(seed).initial();
        minimize(Options::gauss_newton(), &mut carried(seed), &mut free);
        // Bounds on the wrong side of the free minimum for some weights, on the right side for others, with awkward digits.
        let w = &free[FIRST..];
        let lower = vec![w[0] + 0.0371, w[1] - 0.9, w[2] - 1.7, f64::NEG_INFINITY];
        let upper = vec![w[0] + 0.8, w[1] - 0.0123, w[2] + 1.3, w[3] - 0.005];
        for options in algorithms() {
            for kind in KINDS {
                let bounded =
                    Bounded { problem: carried(seed), first: FIRST, lower: lower.clone(), upper: upper.clone() };
                let mut problem = Watched(bounded, Cell::new(0));
                let mut x = problem.0.problem.initial();
                let mut start = x.clone();
                problem.border_bounds().unwrap().project(&mut start);
                let first = projected_gradient(&mut problem, &start);
                let workspace = minimize(options.with_linear_solver(kind), &mut problem, &mut x);
                let summary = workspace.summary();
                assert!(summary.stop.was_successful(), "{summary}");
                assert!(problem.1.get() > 3);
                let last = projected_gradient(&mut problem, &x);
                assert!(last <= 1e-8 * first.max(1.0), "{kind:?}: {last:e} after {first:e}\n{summary}");
                let held: Vec<usize> =
                    (0..4).filter(|k| x[FIRST + k] == lower[*k] || x[FIRST + k] == upper[*k]).collect();
                assert!(!held.is_empty(), "{:?} {lower:?} {upper:?}", &x[FIRST..]);
                held_in_all += held.len();
            }
        }
    }
    assert!(held_in_all < 6 * 8 * 4, "no weight was free");
}

#[test]
fn bounds_out_of_reach_change_no_bit() {
    for options in algorithms() {
        for kind in KINDS {
            let options = options.with_linear_solver(kind);
            let run = |problem: &mut dyn Problem| {
                let mut x = carried(1.0).initial();
                let mut workspace = Workspace::new();
                Minimizer::new(options).unwrap().minimize_with(problem, &mut x, &mut workspace, &mut Silent);
                (x.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), workspace.summary().clone())
            };
            let (x, free) = run(&mut carried(1.0));
            for size in [30.0, 1e9] {
                let (lower, upper) = (vec![-size; 4], vec![size, f64::INFINITY, 2.0 * size, size]);
                let (y, bounded) = run(&mut Bounded { problem: carried(1.0), first: FIRST, lower, upper });
                assert_eq!(x, y);
                assert_eq!(free.final_energy.to_bits(), bounded.final_energy.to_bits());
                assert_eq!((free.iterations, free.stop), (bounded.iterations, bounded.stop));
                // The projected gradient is no longer than the way to the bound.
                if size > 100.0 {
                    assert_eq!(free.deterministic_report(), bounded.deterministic_report());
                }
            }
        }
    }
}

#[test]
fn threads_do_not_change_bits() {
    let run = |threads: usize| {
        on_threads(threads, || {
            let (lower, upper) = (vec![0.0; 4], vec![0.01, 0.02, 1.0, 0.0]);
            let mut problem = Bounded { problem: carried(2.0), first: FIRST, lower, upper };
            let mut x = problem.problem.initial();
            minimize(Options::gauss_newton().with_linear_solver(LinearSolverKind::Bordered), &mut problem, &mut x);
            let covariance = border_covariance(&mut problem, &x).unwrap();
            (x, covariance)
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn a_start_outside_is_moved_in_first() {
    let (lower, upper) = (vec![2.0, -1.0, -1.0, 0.5], vec![3.0, -0.5, 1.0, 0.5]);
    for options in algorithms() {
        let bounded = Bounded { problem: carried(0.0), first: FIRST, lower: lower.clone(), upper: upper.clone() };
        let mut problem = Watched(bounded, Cell::new(0));
        let mut x = problem.0.problem.initial();
        let mut moved = x.clone();
        moved[FIRST..].copy_from_slice(&[2.0, -0.5, 0.3, 0.5]);
        let expected = problem.energy(&moved);
        let workspace = minimize(options, &mut problem, &mut x);
        assert_eq!(workspace.summary().initial_energy, expected);
        assert_eq!(x[FIRST + 3], 0.5);
        let mut y = problem.0.problem.initial();
        minimize(options.with_max_iterations(0), &mut problem, &mut y);
        assert_eq!(y, moved);
    }
}

#[test]
fn impossible_bounds_are_named_before_anything_is_done() {
    let nan = f64::NAN;
    for (lower, upper) in
        [([0.0, 0.0, 2.0, 0.0], [1.0; 4]), ([0.0, 0.0, nan, 0.0], [1.0; 4]), ([0.0; 4], [1.0, 1.0, nan, 1.0])]
    {
        let bounded = Bounded { problem: carried(0.0), first: FIRST, lower: lower.to_vec(), upper: upper.to_vec() };
        let mut problem = Watched(bounded, Cell::new(0));
        let mut x = problem.0.problem.initial();
        let start = x.clone();
        for options in algorithms() {
            let stop = minimize(options, &mut problem, &mut x).summary().stop;
            assert!(matches!(stop, StopReason::InvalidBounds(BoundsError::Empty { index: 2, .. })), "{stop}");
            assert!(!stop.was_successful());
            assert_eq!((&x, problem.1.get()), (&start, 0));
        }
    }
    let mut problem = Bounded { problem: carried(0.0), first: FIRST, lower: vec![2.0; 4], upper: vec![1.0; 4] };
    let mut x = problem.problem.initial();
    let summary = minimize(Options::default(), &mut problem, &mut x).summary().clone();
    assert!(
        summary.to_string().contains("border coordinate 0 is to lie between 2 and 1, but no number does"),
        "{summary}"
    );
    problem.lower.pop();
    let stop = minimize(Options::default(), &mut problem, &mut x).summary().stop;
    let StopReason::InvalidBounds(BoundsError::Length { lower: 3, upper: 4, border: 4, .. }) = stop else {
        panic!("{stop}")
    };
}

/// Sees the first two of three weights only.
struct Blind(f64);

impl Residual<2, 3> for Blind {
    type Blocks = (Euclidean<3>,);

    fn evaluate<D: Scalar>(&self, (w,): &([D; 3],)) -> [D; 2] {
        [w[0] * w[0] - self.0, w[1] + w[0]]
    }
}

#[test]
fn what_nothing_observes_needs_no_damping_once_it_is_fixed() {
    let problem = || {
        let mut builder = ResidualProblem::builder();
        let w = builder.add_border_block::<Euclidean<3>>(&[1.0, 0.0, 5.0]);
        builder.add_family(Family::new(vec![Blind(2.0)], &[[w]]));
        builder.build().unwrap()
    };
    let mut x = vec![1.0, 0.0, 5.0];
    let bounds = |third: [f64; 2]| Bounded {
        problem: problem(),
        first: 0,
        lower: vec![-9.0, -0.7, third[0]],
        upper: vec![9.0, 9.0, third[1]],
    };
    let reason = LinearError::NotPositiveDefinite { at: Coordinate::Border { index: 2 } };
    for kind in [LinearSolverKind::Dense, LinearSolverKind::Bordered] {
        let options =
            Options::gauss_newton().with_linear_solver(kind).with_max_iterations(300).with_energy_tolerance(0.0);
        let mut free = x.clone();
        assert_eq!(
            minimize(options, &mut bounds([0.0, 9.0]), &mut free).summary().stop,
            StopReason::LinearSolverFailed(reason)
        );
        let mut fixed = bounds([5.0, 5.0]);
        let mut y = x.clone();
        let workspace = minimize(options, &mut fixed, &mut y);
        assert!(workspace.summary().stop.was_successful(), "{}", workspace.summary());
        assert!(projected_gradient(&mut fixed, &y) < 1e-8, "{y:?}");
        assert_eq!((y[1], y[2]), (-0.7, 5.0));
    }
    assert_eq!(border_covariance(&mut problem(), &x), Err(reason));
    x[2] = 3.0;
    let covariance = border_covariance(&mut bounds([3.0, 3.0]), &x).unwrap();
    assert!(covariance.row(2).iter().all(|c| *c == 0.0) && covariance[(0, 0)] > 0.0);
}

#[test]
fn covariances_are_the_borders_part_of_the_whole_inverse() {
    for (lower, upper, held) in [
        (FREE.map(|v| -v), FREE, [false; 4]),
        ([-9.0, 0.2, -9.0, 0.0], [9.0, 9.0, 9.0, 0.0], [false, true, false, true]),
    ] {
        let mut problem = Bounded { problem: carried(4.0), first: FIRST, lower: lower.to_vec(), upper: upper.to_vec() };
        let x = problem.problem.initial();
        let mut equations = NormalEquations::new(problem.structure().clone());
        problem.linearize(&x, &mut equations);
        let expected = dense_covariance(&equations.to_dense(), 4, &held);
        let close = |found: &DMatrix<f64>, tolerance: f64| {
            assert!((found - &expected).amax() <= tolerance * expected.amax(), "{found} {expected}");
        };
        close(&border_covariance(&mut problem, &x).unwrap(), 1e-8);
        for kind in KINDS {
            let mut workspace =
                minimize(Options::gauss_newton().with_linear_solver(kind), &mut problem, &mut x.clone());
            close(&workspace.border_covariance(&mut problem, &x, 0.0).unwrap(), 1e-8);
            close(&workspace.border_covariance(&mut problem, &x, 1e-9).unwrap(), 1e-5);
        }
    }
}
