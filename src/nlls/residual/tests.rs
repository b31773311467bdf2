//! Laws of residual families: derivatives, determinism, layout.

use super::*;
use crate::nlls::{
    Euclidean, GradientCheck, Kernel, LinearSolverKind, Minimizer, NormalEquations, Options, Problem, Se3, Sim3, So3,
    UnitQuaternion, check_gradient, check_hessian, so3,
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
}
