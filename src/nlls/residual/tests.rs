//! Laws of residual families: derivatives, determinism, layout.

use super::*;
use crate::nlls::{
    Bounded, Euclidean, GradientCheck, Kernel, LinearSolverKind, Manifold, Minimizer, NormalEquations, Options,
    Problem, Scaled, Se3, Sim3, So3, UnitQuaternion, check_gradient, check_hessian, so3,
};

/// `T_a^-1 T_b` measured: r = (vee of the antisymmetric part of Z' R_a' R_b, R_a' (t_b - t_a) - z).
struct RelativePose {
    rotation: [f64; 9],
    translation: [f64; 3],
}

impl Residual<6, 12> for RelativePose {
    type Blocks = (Se3, Se3);

    fn evaluate<D: Scalar>(&self, (a, b): &([D; 12], [D; 12])) -> [D; 6] {
        let at = |m: &[D; 12], i: usize, j: usize| m[3 * i + j];
        // E = R_a' R_b Z'
        let relative: [[D; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| at(a, 0, i) * at(b, 0, j) + at(a, 1, i) * at(b, 1, j) + at(a, 2, i) * at(b, 2, j))
        });
        let z = &self.rotation;
        let error: [[D; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                relative[i][0] * z[3 * j] + relative[i][1] * z[3 * j + 1] + relative[i][2] * z[3 * j + 2]
            })
        });
        let d = [b[9] - a[9], b[10] - a[10], b[11] - a[11]];
        let t: [D; 3] = std::array::from_fn(|i| at(a, 0, i) * d[0] + at(a, 1, i) * d[1] + at(a, 2, i) * d[2]);
        [
            (error[2][1] - error[1][2]) * 0.5,
            (error[0][2] - error[2][0]) * 0.5,
            (error[1][0] - error[0][1]) * 0.5,
            t[0] - self.translation[0],
            t[1] - self.translation[1],
            t[2] - self.translation[2],
        ]
    }
}

/// Poses on a helix, odometry and loop closures, each measurement exact.
fn pose_graph(n: usize, kernel: Kernel) -> (ResidualProblem, Vec<BlockId>, Vec<[f64; 12]>) {
    let truth: Vec<[f64; 12]> = (0..n)
        .map(|k| {
            let angle = 0.3 * k as f64;
            let rows = so3::exp([0.1 * angle.sin(), 0.05, angle]);
            let r: &[f64; 9] = rows.as_flattened().first_chunk().unwrap();
            std::array::from_fn(|i| if i < 9 { r[i] } else { [10.0 * angle.cos(), 10.0 * angle.sin(), angle][i - 9] })
        })
        .collect();
    let pairs: Vec<(usize, usize)> = (1..n).map(|k| (k - 1, k)).chain((21..n).map(|k| (k - 21, k))).collect();
    let residuals = pairs
        .iter()
        .map(|&(a, b)| {
            let (a, b) = (&truth[a], &truth[b]);
            let column = |m: &[f64; 12], j: usize| [m[j], m[3 + j], m[6 + j]];
            let dot = |u: [f64; 3], v: [f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
            let d = [b[9] - a[9], b[10] - a[10], b[11] - a[11]];
            RelativePose {
                rotation: std::array::from_fn(|k| dot(column(a, k / 3), column(b, k % 3))),
                translation: std::array::from_fn(|i| dot(column(a, i), d)),
            }
        })
        .collect();
    let mut builder = ResidualProblem::builder();
    let ids: Vec<BlockId> = truth
        .iter()
        .enumerate()
        .map(|(k, pose)| {
            let s = if k == 0 { 0.0 } else { 0.05 };
            let step: [f64; 6] = std::array::from_fn(|i| s * (1.7 * (6 * k + i) as f64).sin());
            let mut start = [0.0; 12];
            Se3::plus(pose, &step, &mut start);
            builder.add_block::<Se3>(&start)
        })
        .collect();
    builder.set_constant(ids[0]);
    let blocks: Vec<[BlockId; 2]> = pairs.iter().map(|&(a, b)| [ids[a], ids[b]]).collect();
    builder.add_family(Family::new(residuals, &blocks).with_kernel(kernel).with_weight(2.5));
    (builder.build().unwrap(), ids, truth)
}

#[test]
fn a_pose_graph_is_solved_by_sparse_cholesky() {
    let (mut problem, ids, truth) = pose_graph(120, Kernel::None);
    assert_eq!(problem.structure().block_count(), 119);
    for options in [Options::gauss_newton(), Options::levenberg_marquardt()] {
        let mut x = problem.initial();
        let options = options.with_linear_solver(LinearSolverKind::Auto);
        let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
        assert!(summary.stop.converged() && summary.final_energy < 1e-18, "{summary}");
        assert_eq!(summary.linear_solver, "sparse Cholesky");
        for (id, pose) in ids.iter().zip(&truth) {
            for (a, b) in problem.block(&x, *id).iter().zip(pose) {
                assert!((a - b).abs() < 1e-8, "{summary}");
            }
        }
    }
}

#[test]
fn gradient_and_hessian_of_a_pose_graph() {
    for kernel in [Kernel::None, Kernel::Huber { delta: 0.05 }, Kernel::GemanMcClure { delta: 0.2 }] {
        let (mut problem, ..) = pose_graph(30, kernel);
        let x = problem.initial();
        let report = check_gradient(&mut problem, &x, GradientCheck::default());
        assert!(report.passed(), "{kernel:?}\n{report}");
        let report = check_hessian(&mut problem, &x);
        assert!(report.passed(1e-12), "{kernel:?}\n{report}");
    }
}

#[test]
fn linearising_gives_the_same_bits_at_any_number_of_threads_and_any_time() {
    let (mut problem, ..) = pose_graph(200, Kernel::Cauchy { delta: 0.1 });
    let x = problem.initial();
    let mut results = Vec::new();
    let mut equations = NormalEquations::new(problem.structure().clone());
    for threads in [1, 2, 4, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let energy = pool.install(|| problem.linearize(&x, &mut equations));
        assert_eq!(energy.to_bits(), pool.install(|| problem.energy(&x)).to_bits());
        results.push((energy, equations.blocks.clone(), equations.gradient.clone()));
    }
    assert!(results.iter().all(|r| *r == results[0]));
}

/// Touches every kind of place at once, with a block that comes twice and blocks in descending order.
struct Everything(f64);

impl Residual<2, 20> for Everything {
    type Blocks = (Sim3, Euclidean<2>, UnitQuaternion, Euclidean<2>, So3, So3);

    fn evaluate<D: Scalar>(&self, (s, u, q, v, a, b): &([D; 13], [D; 2], [D; 4], [D; 2], [D; 9], [D; 9])) -> [D; 2] {
        let p = Sim3::transform(s, [u[0], u[1] * v[0], D::from(self.0)]);
        let p = UnitQuaternion::rotate(q, p);
        let p = so3::rotate(a, p);
        let p = so3::rotate(b, [p[0] * v[1], p[1], p[2]]);
        [p[0] - p[2] * u[0], p[1].sin() + self.0]
    }
}

#[test]
fn borders_constants_and_repeated_blocks() {
    let rotation = |omega: [f64; 3]| so3::exp(omega).as_flattened().to_vec();
    for constant in [None, Some(0), Some(2), Some(4)] {
        let mut builder = ResidualProblem::builder();
        let a = builder.add_block::<So3>(&rotation([0.1, 0.2, 0.3]));
        let u = builder.add_border_block::<Euclidean<2>>(&[0.7, -0.4]);
        let b = builder.add_block::<So3>(&rotation([1.0, -2.0, 0.3]));
        let q = builder.add_block::<UnitQuaternion>(&[0.5, 0.5, -0.5, 0.5]);
        let v = builder.add_border_block::<Euclidean<2>>(&[1.5, 0.8]);
        let mut similarity = Sim3::IDENTITY;
        similarity[9..].copy_from_slice(&[1.0, 2.0, 3.0, 0.2]);
        let s = builder.add_block::<Sim3>(&similarity);
        if let Some(k) = constant {
            builder.set_constant([a, u, b, q, v, s][k]);
        }
        let ids = [[s, u, q, v, a, b], [s, v, q, u, b, a], [s, v, q, v, a, a], [s, u, q, u, b, b]];
        let residuals = vec![Everything(0.3), Everything(-1.0), Everything(2.0), Everything(0.1)];
        builder.add_family(Family::new(residuals, &ids).with_kernel(Kernel::Welsch { delta: 8.0 }));
        let mut problem = builder.build().unwrap();
        let x = problem.initial();
        assert_eq!(problem.block(&x, v), [1.5, 0.8]);
        let report = check_gradient(&mut problem, &x, GradientCheck::default());
        assert!(report.passed(), "{constant:?}\n{report}");
        let report = check_hessian(&mut problem, &x);
        assert!(report.passed(1e-13), "{constant:?}\n{report}");
    }
}

#[test]
fn changing_weight_kernel_and_data_needs_no_new_problem() {
    struct Pull(f64);
    impl Residual<1, 1> for Pull {
        type Blocks = (Euclidean<1>,);
        fn evaluate<D: Scalar>(&self, (p,): &([D; 1],)) -> [D; 1] {
            [p[0] - self.0]
        }
    }
    let mut builder = ResidualProblem::builder();
    let p = builder.add_border_block::<Euclidean<1>>(&[0.0]);
    let pull = builder.add_family(Family::new(vec![Pull(2.0)], &[[p]]));
    let mut problem = builder.build().unwrap();
    assert_eq!(problem.energy(&[0.0]), 4.0);
    problem.set_weight(pull, 0.5).unwrap();
    problem.set_kernel(pull, Kernel::Huber { delta: 1.0 }).unwrap();
    assert_eq!(problem.energy(&[0.0]), 1.5);
    problem.residuals_mut::<Pull>(pull).unwrap()[0].0 = 0.5;
    assert_eq!(problem.energy(&[0.0]), 0.125);
    assert!(problem.residuals_mut::<Everything>(pull).is_none());
    assert!(problem.set_weight(pull, -1.0).is_err());
}

#[test]
fn mistakes_are_named() {
    struct Unary;
    impl Residual<1, 3> for Unary {
        type Blocks = (So3,);
        fn evaluate<D: Scalar>(&self, (r,): &([D; 9],)) -> [D; 1] {
            [r[0]]
        }
    }
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let build = |fill: &dyn Fn(&mut ResidualProblemBuilder)| {
        let mut builder = ResidualProblem::builder();
        fill(&mut builder);
        builder.build().unwrap_err().to_string()
    };
    let error = build(&|b| {
        let plane = b.add_block::<Euclidean<2>>(&[0.0, 0.0]);
        b.add_family(Family::new(vec![Unary], &[[plane]]));
    });
    assert!(error.contains("So3 in place 0") && error.contains("Euclidean<2>"), "{error}");
    let error = build(&|b| {
        let r = b.add_block::<So3>(&identity);
        b.add_family(Family::new(vec![Unary, Unary], &[[r]]));
    });
    assert!(error.contains("2 residuals, but 1 lists"), "{error}");
    let error = build(&|b| {
        b.add_block::<So3>(&[f64::NAN; 9]);
    });
    assert!(error.contains("block 0"), "{error}");
    let error = build(&|b| {
        let r = b.add_block::<So3>(&identity);
        b.add_family(Family::new(vec![Unary], &[[r]]).with_kernel(Kernel::Cauchy { delta: 0.0 }));
    });
    assert_eq!(error, "family 0: kernel.delta is 0, but must be positive and finite");
    let error = build(&|b| {
        let r = b.add_block::<So3>(&identity);
        let kernel = Scaled { kernel: Kernel::Cauchy { delta: 1.0 }, delta: -1.0 };
        b.add_family(Family::new(vec![Unary], &[[r]]).with_kernel(kernel));
    });
    assert_eq!(error, "family 0: kernel.delta is -1, but must be positive and finite");
}

#[test]
fn starts_off_their_manifold_are_named() {
    fn build<M: Manifold>(start: &[f64]) -> Result<ResidualProblem, ProblemError> {
        let mut builder = ResidualProblem::builder();
        builder.add_block::<Euclidean<1>>(&[7.0]);
        builder.add_block::<M>(start);
        builder.build()
    }
    let diagonal = |d: [f64; 3]| [d[0], 0.0, 0.0, 0.0, d[1], 0.0, 0.0, 0.0, d[2]];
    let pose = |d: [f64; 3]| diagonal(d).into_iter().chain([5.0; 3]).collect::<Vec<_>>();
    for (result, name) in [
        (build::<UnitQuaternion>(&[0.0; 4]), "UnitQuaternion"),
        (build::<UnitQuaternion>(&[2.0, 0.0, 0.0, 0.0]), "UnitQuaternion"),
        (build::<So3>(&[0.0; 9]), "So3"),
        (build::<So3>(&diagonal([2.0; 3])), "So3"),
        (build::<So3>(&diagonal([1.0, 1.0, -1.0])), "So3"),
        (build::<Se3>(&pose([-1.0; 3])), "Se3"),
        (build::<Sim3>(&[0.0; 13]), "Sim3"),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.starts_with("the initial value of block 1 is no point of") && error.contains(name), "{error}");
    }
    // Read from a file.
    build::<UnitQuaternion>(&[0.8000001, 0.0, 0.6, 0.0]).unwrap();
    build::<So3>(&[0.8, -0.6, 0.0, 0.6, 0.8000001, 0.0, 0.0, 0.0, 1.0]).unwrap();
    build::<Se3>(&pose([1.0; 3])).unwrap();
}

/// The logarithm of a coordinate.
struct Log;

impl Residual<1, 1> for Log {
    type Blocks = (Euclidean<1>,);

    fn evaluate<D: Scalar>(&self, (p,): &([D; 1],)) -> [D; 1] {
        [p[0].ln()]
    }
}

/// The same, with its derivative.
impl AnalyticResidual<1> for Log {
    fn len(&self) -> usize {
        1
    }

    fn evaluate(&self, [p]: [&[f64]; 1], residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        residual[0] = p[0].ln();
        jacobian.into_iter().for_each(|j| j[0] = 1.0 / p[0]);
    }
}

#[test]
fn a_residual_that_is_not_finite_is_named_unless_it_weighs_nothing() {
    for analytic in [false, true] {
        let mut builder = ResidualProblem::builder();
        let [good, bad] = [2.0, -1.0].map(|v| builder.add_block::<Euclidean<1>>(&[v]));
        builder.add_family(Family::new(vec![Log], &[[good]]));
        let ids = [[good], [bad], [good]];
        let logs = vec![Log, Log, Log];
        let family = match analytic {
            true => builder.add_analytic_family(AnalyticFamily::new(logs, &ids)),
            false => builder.add_family(Family::new(logs, &ids)),
        };
        let mut problem = builder.build().unwrap();
        let mut x = problem.initial();
        let minimizer = Minimizer::new(Options::default()).unwrap();
        let summary = minimizer.minimize(&mut problem, &mut x);
        assert!(summary.to_string().contains("ResidualProblem::non_finite"), "{summary}");
        assert_eq!(problem.non_finite(&x), Some((family, 1)));
        // It has left NaN in its slot.
        problem.set_weight(family, 0.0).unwrap();
        assert_eq!(problem.non_finite(&x), None);
        let mut equations = NormalEquations::new(problem.structure().clone());
        assert_eq!(problem.linearize(&x, &mut equations), problem.energy(&x));
        assert!(equations.gradient[1] == 0.0 && equations.gradient[0] != 0.0);
        assert!(problem.weighted_jacobian().1.iter().all(|v| v.is_finite()));
    }
}

/// A pose moves so many points: r = R p + t - q for each.
struct Cloud(Vec<[[f64; 3]; 2]>);

/// One of them, differentiated by duals.
struct MovedPoint([[f64; 3]; 2]);

impl Residual<3, 6> for MovedPoint {
    type Blocks = (Se3,);

    fn evaluate<D: Scalar>(&self, (pose,): &([D; 12],)) -> [D; 3] {
        let moved = Se3::transform(pose, self.0[0].map(D::from));
        std::array::from_fn(|i| moved[i] - self.0[1][i])
    }
}

impl AnalyticResidual<1> for Cloud {
    fn len(&self) -> usize {
        3 * self.0.len()
    }

    fn evaluate(&self, [pose]: [&[f64]; 1], residual: &mut [f64], jacobian: Option<&mut [f64]>) {
        let turned = |p: &[f64; 3]| [0, 1, 2].map(|i: usize| (0..3).map(|k| pose[3 * i + k] * p[k]).sum::<f64>());
        for ([p, q], r) in self.0.iter().zip(residual.chunks_exact_mut(3)) {
            let v = turned(p);
            (0..3).for_each(|i| r[i] = v[i] + pose[9 + i] - q[i]);
        }
        for ([p, _], j) in self.0.iter().zip(jacobian.into_iter().flat_map(|j| j.chunks_exact_mut(18))) {
            let [x, y, z] = turned(p);
            // -[R p]x, then I.
            j.copy_from_slice(&[0.0, z, -y, 1.0, 0.0, 0.0, -z, 0.0, x, 0.0, 1.0, 0.0, y, -x, 0.0, 0.0, 0.0, 1.0]);
        }
    }
}

#[test]
fn residuals_with_jacobians_of_their_own_give_the_equations_of_duals() {
    let point = |k: usize| [0.0, 7.0].map(|s| std::array::from_fn(|i| (s + 1.3 * (3 * k + i) as f64).sin()));
    let mut start = [0.0; 12];
    Se3::plus(&Se3::IDENTITY, &[0.3, -0.2, 0.5, 1.0, 2.0, -1.0], &mut start);
    // Clouds of three sizes on two poses, one of which does not move.
    let sizes = [1, 4, 2];
    let places = [0, 1, 0];
    let mut problems = [true, false].map(|analytic| {
        let mut builder = ResidualProblem::builder();
        let poses = [(); 2].map(|()| builder.add_block::<Se3>(&start));
        builder.set_constant(poses[1]);
        let mut from = 0;
        for (size, place) in sizes.iter().zip(places) {
            let points: Vec<_> = (from..from + size).map(point).collect();
            from += size;
            if analytic {
                let family = AnalyticFamily::new(vec![Cloud(points)], &[[poses[place]]]).with_weight(1.5);
                builder.add_analytic_family(family);
            } else {
                let ids = vec![[poses[place]]; *size];
                let points = points.into_iter().map(MovedPoint).collect();
                builder.add_family(Family::new(points, &ids).with_weight(1.5));
            }
        }
        builder.build().unwrap()
    });
    assert_eq!(problems.each_ref().map(ResidualProblem::residual_count), [3, 7]);
    let x = problems[0].initial();
    let linearised = problems.each_mut().map(|problem| {
        let mut equations = NormalEquations::new(problem.structure().clone());
        let energy = problem.linearize(&x, &mut equations);
        assert!((energy - problem.energy(&x)).abs() < 1e-12 * energy);
        let (r, jacobian) = problem.weighted_jacobian();
        assert_eq!((r.len(), jacobian.nrows()), (21, 21));
        (energy, equations)
    });
    let [(a, ours), (b, theirs)] = linearised;
    approx::assert_relative_eq!(a, b, max_relative = 1e-13);
    approx::assert_relative_eq!(ours.to_dense(), theirs.to_dense(), epsilon = 1e-11);
    for (g, h) in ours.gradient.iter().zip(&theirs.gradient) {
        approx::assert_relative_eq!(*g, *h, epsilon = 1e-11);
    }
    let report = check_gradient(&mut problems[0], &x, GradientCheck::default());
    assert!(report.passed(), "{report}");
    let kernel = Kernel::Huber { delta: 0.5 };
    let mut builder = ResidualProblem::builder();
    let pose = builder.add_block::<Se3>(&start);
    let clouds = (0..50).map(|k| Cloud((k..k + k % 4).map(point).collect())).collect();
    builder.add_analytic_family(AnalyticFamily::new(clouds, &[[pose]; 50]).with_kernel(kernel));
    let mut problem = builder.build().unwrap();
    let report = check_gradient(&mut problem, &x[..12], GradientCheck::default());
    assert!(report.passed(), "{report}");
}

/// `w - target`, over plain numbers.
struct Near([f64; 2]);

impl Residual<2, 2> for Near {
    type Blocks = (Euclidean<2>,);

    fn evaluate<D: Scalar>(&self, (w,): &([D; 2],)) -> [D; 2] {
        [w[0] - self.0[0], w[1] - self.0[1] + w[0] * 0.3]
    }
}

#[test]
fn blocks_between_bounds_move_to_the_border_and_stay_inside() {
    let none = f64::INFINITY;
    let build = |bounded: bool| {
        let mut builder = ResidualProblem::builder();
        let free = builder.add_block::<So3>(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let ids = if bounded {
            let ids = [(); 2].map(|()| builder.add_block::<Euclidean<2>>(&[0.0; 2]));
            builder.set_bounds(ids[1], &[-none, 0.5], &[0.1, none]);
            let still = builder.add_block::<Euclidean<2>>(&[0.5; 2]);
            builder.set_constant(still);
            builder.set_bounds(still, &[0.0; 2], &[1.0; 2]);
            ids
        } else {
            [builder.add_block::<Euclidean<2>>(&[0.0; 2]), builder.add_border_block::<Euclidean<2>>(&[0.0; 2])]
        };
        builder.add_family(Family::new(vec![Near([1.0, 2.0]), Near([0.7, 0.1])], &ids.map(|id| [id])));
        builder.add_family(Family::new(vec![Turned], &[[free]]));
        (builder.build().unwrap(), ids)
    };
    let (mut problem, ids) = build(true);
    let mut x = problem.initial();
    let minimizer = Minimizer::new(Options::default()).unwrap();
    let summary = minimizer.minimize(&mut problem, &mut x);
    assert!(summary.stop.converged(), "{summary}");
    let (other, same) = build(false);
    let first = other.parameter_len() - 2;
    let mut other = Bounded { problem: other, first, lower: vec![-none, 0.5], upper: vec![0.1, none] };
    let mut y = other.problem.initial();
    minimizer.minimize(&mut other, &mut y);
    for (id, same) in ids.iter().zip(same) {
        assert_eq!(problem.block(&x, *id), other.problem.block(&y, same));
    }
    assert_eq!(problem.block(&x, ids[1]), [0.1, 0.5]);
    assert!((problem.block(&x, ids[0])[0] - 1.0).abs() < 1e-9);
}

/// A rotation near another.
struct Turned;

impl Residual<3, 3> for Turned {
    type Blocks = (So3,);

    fn evaluate<D: Scalar>(&self, (r,): &([D; 9],)) -> [D; 3] {
        [r[1] - 0.1, r[2] - 0.2, r[5] + 0.3]
    }
}

#[test]
fn bounds_that_cannot_be_held_are_named() {
    let error = |fill: &dyn Fn(&mut ResidualProblemBuilder)| {
        let mut builder = ResidualProblem::builder();
        fill(&mut builder);
        builder.build().unwrap_err().to_string()
    };
    let empty = error(&|b| {
        let w = b.add_block::<Euclidean<2>>(&[0.0; 2]);
        b.set_bounds(w, &[0.0, 2.0], &[1.0; 2]);
    });
    assert_eq!(empty, "block 0: border coordinate 1 is to lie between 2 and 1, but no number does");
    let short = error(&|b| {
        let w = b.add_block::<Euclidean<2>>(&[0.0; 2]);
        b.set_bounds(w, &[0.0], &[1.0; 2]);
    });
    assert!(short.contains("block 0: 1 lower and 2 upper bounds"), "{short}");
    let turned = error(&|b| {
        b.add_border_block::<So3>(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let w = b.add_block::<Euclidean<1>>(&[0.0]);
        b.set_bounds(w, &[0.0], &[1.0]);
    });
    assert!(turned.contains("block 0 of the border is") && turned.contains("So3"), "{turned}");
    let own = error(&|b| {
        let r = b.add_block::<So3>(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        b.set_bounds(r, &[0.0; 9], &[1.0; 9]);
    });
    assert!(own.contains("block 0 is") && own.contains("So3; set none on it"), "{own}");
    let constant = error(&|b| {
        let w = b.add_block::<Euclidean<2>>(&[0.5, 9.0]);
        b.set_constant(w);
        b.set_bounds(w, &[0.0; 2], &[1.0; 2]);
    });
    assert!(constant.starts_with("block 0 is held constant at a value outside its bounds"), "{constant}");
}
