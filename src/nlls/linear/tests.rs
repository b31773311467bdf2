//! Laws of the linear solvers on random positive definite systems.

use nalgebra::{DMatrix, DVector};

use super::*;

/// A small deterministic generator (SplitMix64), uniform in [-1, 1).
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub(super) fn index(&mut self, n: usize) -> usize {
        (((self.next() + 1.0) / 2.0 * n as f64) as usize).min(n - 1)
    }
}

/// `H = sum_k j_k j_k' + 0.1 I`, where each j_k touches one pair of blocks and the border: positive definite in the pattern.
fn random_equations(structure: &Arc<BlockStructure>, seed: u64) -> NormalEquations {
    let mut random = Random(seed);
    let s = structure;
    let (n, m) = (s.sparse_dimension(), s.border());
    let mut h = DMatrix::<f64>::identity(n + m, n + m) * 0.1;
    for i in 0..s.block_count() {
        for &j in s.row(i) {
            for _ in 0..4 {
                let mut touched: Vec<usize> =
                    [i, j].iter().flat_map(|&a| s.offset(a)..s.offset(a) + s.size(a)).collect();
                touched.extend(n..n + m);
                let row: Vec<f64> = touched.iter().map(|&c| if c < n { 1.0 } else { 0.3 } * random.next()).collect();
                for (&r, x) in touched.iter().zip(&row) {
                    for (&c, y) in touched.iter().zip(&row) {
                        h[(r, c)] += x * y;
                    }
                }
            }
        }
    }
    for _ in 0..m {
        let row = DVector::from_fn(n + m, |i, _| if i < n { 0.0 } else { random.next() });
        h.ger(1.0, &row, &row, 1.0);
    }
    let mut equations = NormalEquations::new(s.clone());
    for i in 0..s.block_count() {
        for (slot, &j) in s.row_slots(i).zip(s.row(i)) {
            for a in 0..s.size(i) {
                for b in 0..s.size(j) {
                    equations.blocks[s.values(slot).start + a * s.size(j) + b] = h[(s.offset(i) + a, s.offset(j) + b)];
                }
            }
        }
    }
    for r in 0..n {
        for c in 0..m {
            equations.cross[r * m + c] = h[(r, n + c)];
        }
    }
    for r in 0..m {
        for c in 0..m {
            // Only the lower triangle may be read.
            equations.border[r * m + c] = if c <= r { h[(n + r, n + c)] } else { f64::NAN };
        }
    }
    equations.gradient.iter_mut().for_each(|g| *g = random.next());
    equations
}

fn structures() -> Vec<Arc<BlockStructure>> {
    let mut random = Random(7);
    let mut all = vec![
        BlockStructure::dense(9),
        BlockStructure::new(&[3], [], 0).unwrap(),
        BlockStructure::new(&[1; 30], (1..30).map(|i| (i, i - 1)), 0).unwrap(),
        BlockStructure::new(&[6; 12], (1..12).map(|i| (0, i)), 5).unwrap(),
        BlockStructure::new(&[2, 6, 3, 1, 4], [], 3).unwrap(),
    ];
    for border in [0, 1, 55, 130] {
        let sizes: Vec<usize> = (0..40).map(|_| 1 + random.index(6)).collect();
        let pairs: Vec<_> = (0..90).map(|_| (random.index(40), random.index(40))).collect();
        all.push(BlockStructure::new(&sizes, pairs, border).unwrap());
    }
    all.into_iter().map(Arc::new).collect()
}

fn solvers(structure: &Arc<BlockStructure>) -> Vec<Box<dyn LinearSolver>> {
    use LinearSolverKind::*;
    [Dense, Bordered, BlockJacobi, Auto].map(|kind| kind.build(structure)).into()
}

/// Residual that a solver may leave: rounding, or what its tolerance allows.
fn accuracy(solver: &dyn LinearSolver) -> f64 {
    match solver.name() {
        "block-Jacobi conjugate gradients" => 1e-4,
        _ => 1e-11,
    }
}

#[test]
fn every_solver_solves_the_damped_equations() {
    for (k, structure) in structures().iter().enumerate() {
        let equations = random_equations(structure, k as u64);
        let mut h = equations.to_dense();
        let n = structure.dimension();
        let damping: Vec<f64> = (0..n).map(|i| 0.01 * (1 + i % 3) as f64).collect();
        for damping in [&damping[..], &[]] {
            for (i, d) in damping.iter().enumerate() {
                h[(i, i)] += d;
            }
            let g = DVector::from_column_slice(&equations.gradient);
            for mut solver in solvers(structure) {
                let mut step = vec![f64::NAN; n];
                solver.solve(&equations, damping, &mut step).unwrap();
                let error = (&h * DVector::from_column_slice(&step) + &g).amax();
                assert!(error < accuracy(solver.as_ref()), "structure {k}, {}: residual {error:e}", solver.name());
            }
            for (i, d) in damping.iter().enumerate() {
                h[(i, i)] -= d;
            }
        }
    }
}

#[test]
fn another_librarys_solver_takes_the_same_step_from_the_sparse_matrix() {
    for (k, structure) in structures().iter().enumerate() {
        let equations = random_equations(structure, 300 + k as u64);
        let sparse = equations.to_csc();
        assert_eq!(DMatrix::from(&sparse), equations.to_dense());
        let n = structure.dimension();
        let dense = structure.border() * (n + structure.sparse_dimension());
        let stored: usize = (0..structure.block_count())
            .flat_map(|i| structure.row(i).iter().map(move |&j| (i, j)))
            .map(|(i, j)| structure.size(i) * structure.size(j) * if i == j { 1 } else { 2 })
            .sum();
        assert_eq!(sparse.nnz(), stored + dense);
        let cholesky = nalgebra_sparse::factorization::CscCholesky::factor(&sparse).unwrap();
        let theirs = cholesky.solve(&-DVector::from_column_slice(&equations.gradient));
        let mut ours = vec![0.0; n];
        BorderedCholesky::new(structure).solve(&equations, &[], &mut ours).unwrap();
        assert!((theirs.column(0) - DVector::from_vec(ours)).amax() < 1e-10 * theirs.amax(), "structure {k}");
    }
}

#[test]
fn reusing_a_factor_gives_the_bits_of_a_fresh_one() {
    for (k, structure) in structures().iter().enumerate() {
        let (first, second) =
            (random_equations(structure, 100 + k as u64), random_equations(structure, 200 + k as u64));
        let n = structure.dimension();
        for (mut used, mut fresh) in solvers(structure).into_iter().zip(solvers(structure)) {
            let (mut a, mut b) = (vec![0.0; n], vec![0.0; n]);
            used.solve(&first, &[], &mut a).unwrap();
            used.solve(&second, &[], &mut a).unwrap();
            fresh.solve(&second, &[], &mut b).unwrap();
            assert_eq!(a, b, "structure {k}, {}", used.name());
        }
    }
}

#[test]
fn a_new_structure_is_analysed_when_it_comes() {
    let all = structures();
    for mut solver in solvers(&all[3]) {
        for structure in &all {
            let equations = random_equations(structure, 5);
            let mut step = vec![0.0; structure.dimension()];
            solver.solve(&equations, &[], &mut step).unwrap();
            let error = (equations.to_dense() * DVector::from_column_slice(&step)
                + DVector::from_column_slice(&equations.gradient))
            .amax();
            assert!(error < accuracy(solver.as_ref()), "{}: residual {error:e}", solver.name());
        }
    }
}

#[test]
fn threads_do_not_change_bits() {
    // More blocks than fit one part of the product.
    let structure = Arc::new(BlockStructure::new(&[6; 100], (1..100).map(|i| (i, i / 2)), 60).unwrap());
    let equations = random_equations(&structure, 11);
    for kind in [LinearSolverKind::Bordered, LinearSolverKind::BlockJacobi] {
        let solve = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut step = vec![0.0; structure.dimension()];
                kind.build(&structure).solve(&equations, &[], &mut step).unwrap();
                step
            })
        };
        let one = solve(1);
        assert_eq!(one, solve(2), "{kind}");
        assert_eq!(one, solve(4), "{kind}");
    }
}

#[test]
fn names_of_solvers_are_read_as_they_are_written() {
    for kind in LinearSolverKind::ALL {
        assert_eq!(kind.to_string().parse(), Ok(kind));
        assert_eq!(serde_json::to_value(kind).unwrap().as_str().unwrap().parse(), Ok(kind), "as schedules say it");
    }
    let error = "blockjacobi".parse::<LinearSolverKind>().unwrap_err().to_string();
    assert!(error.contains("\"blockjacobi\"") && error.contains("dense, bordered, block-jacobi"), "{error}");
}

/// A strip of `n` blocks of 6 that meet the eight next to each, tied to their neighbours and held weakly, and a border.
fn strip(n: usize, border: usize) -> NormalEquations {
    let pairs = (0..n).flat_map(|i| (1..9).map(move |d| (i, i + d))).filter(|p| p.1 < n);
    let structure = Arc::new(BlockStructure::new(&[6; 1].repeat(n), pairs, border).unwrap());
    let mut random = Random(4);
    let mut equations = NormalEquations::new(structure.clone());
    for i in 0..n {
        for (slot, &j) in structure.row_slots(i).zip(structure.row(i)) {
            for a in 0..6 {
                equations.blocks[structure.values(slot).start + 7 * a] = if i == j { 16.0 + 1e-3 } else { -1.0 };
            }
        }
    }
    equations.cross.iter_mut().for_each(|c| *c = 0.01 * random.next());
    (0..border).for_each(|k| equations.border[k * (border + 1)] = n as f64);
    equations.gradient.iter_mut().for_each(|g| *g = random.next());
    equations
}

#[test]
fn what_fills_in_too_much_is_iterated() {
    let lattice = |side: usize, dimensions: u32, border: usize| {
        let n = side.pow(dimensions);
        let next = |i: usize, k: u32| {
            let stride = side.pow(k);
            (i / stride % side < side - 1).then_some((i, i + stride))
        };
        let pairs = (0..n).flat_map(|i| (0..dimensions).filter_map(move |k| next(i, k)));
        choose(&Arc::new(BlockStructure::new(&[6; 1].repeat(n), pairs, border).unwrap())).name()
    };
    assert_eq!(lattice(70, 2, 50), "bordered Cholesky");
    assert_eq!(lattice(70, 2, 0), "sparse Cholesky");
    assert_eq!(lattice(22, 3, 3), "block-Jacobi conjugate gradients");
    assert_eq!(lattice(22, 3, 0), "block-Jacobi conjugate gradients");
}

#[test]
fn block_jacobi_takes_no_more_iterations_for_more_blocks() {
    let iterations = |n: usize| {
        let equations = strip(n, 3);
        let mut solver = BlockJacobi::new(equations.structure());
        let mut step = vec![0.0; equations.structure().dimension()];
        solver.solve(&equations, &[], &mut step).unwrap();
        let mut direct = step.clone();
        BorderedCholesky::new(equations.structure()).solve(&equations, &[], &mut direct).unwrap();
        let error = step.iter().zip(&direct).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let size = direct.iter().map(|d| d.abs()).fold(0.0, f64::max);
        assert!(error < 1e-4 * size, "{n} blocks: {error} of {size}");
        solver.iterations().unwrap()
    };
    let (few, many) = (iterations(400), iterations(3200));
    assert!(many <= few + few / 4, "{few} {many}");
}

#[test]
fn an_unobserved_block_is_named() {
    let structure = Arc::new(BlockStructure::new(&[3; 20], (1..20).map(|i| (i, i - 1)), 2).unwrap());
    let mut equations = random_equations(&structure, 3);
    for (i, j) in [(13, 12), (13, 13), (14, 13)] {
        let values = structure.values(structure.slot(i, j).unwrap());
        equations.blocks[values].fill(0.0);
    }
    equations.cross[39 * 2..42 * 2].fill(0.0);
    equations.gradient[39..42].fill(0.0);
    let mut step = vec![0.0; structure.dimension()];
    for mut solver in solvers(&structure) {
        let error = solver.solve(&equations, &[], &mut step).unwrap_err();
        let LinearError::NotPositiveDefinite { at: Coordinate::Block { block: 13, .. } } = error else {
            panic!("{}: {error}", solver.name());
        };
        // With a floor under every pivot the same equations have a step, and the report knows that three directions are free.
        let floor = vec![1e-9; structure.dimension()];
        solver.solve(&equations, &floor, &mut step).unwrap();
        assert_eq!(solver.unobserved_pivots(), 3, "{}", solver.name());
        // Aggregates move it with its neighbours, until the damping is all that is left to tell.
        let still = if solver.name().contains("block-Jacobi") { 1e-3 } else { 0.0 };
        assert!(step[39..42].iter().all(|d| d.abs() <= still), "{}: {:?}", solver.name(), &step[39..42]);
    }
}

#[test]
fn a_rank_deficient_block_is_caught_though_rounding_makes_its_pivot_positive() {
    let structure = Arc::new(BlockStructure::new(&[3; 30], [], 0).unwrap());
    let mut equations = random_equations(&structure, 3);
    let mut random = Random(1);
    let row: [f64; 3] = std::array::from_fn(|_| random.next());
    let other: [f64; 3] = std::array::from_fn(|_| random.next());
    let values = structure.values(structure.slot(4, 4).unwrap());
    for (k, v) in equations.blocks[values].iter_mut().enumerate() {
        *v = row[k / 3] * row[k % 3] + other[k / 3] * other[k % 3];
    }
    let mut step = vec![0.0; structure.dimension()];
    for mut solver in solvers(&structure) {
        let error = solver.solve(&equations, &[], &mut step).unwrap_err();
        assert_eq!(error, LinearError::NotPositiveDefinite { at: Coordinate::Block { block: 4, component: 2 } });
    }
}

#[test]
fn non_finite_values_are_named() {
    let structure = structures().pop().unwrap();
    let (sparse, block) = (structure.sparse_dimension(), 17);
    let mut step = vec![0.0; structure.dimension()];
    for mut solver in solvers(&structure) {
        let mut equations = random_equations(&structure, 3);
        let slot = structure.slot(block, block).unwrap();
        equations.block_mut(slot)[0] = f64::NAN;
        let error = solver.solve(&equations, &[], &mut step).unwrap_err();
        assert_eq!(
            error,
            LinearError::NonFinite { at: Coordinate::Block { block, component: 0 } },
            "{}",
            solver.name()
        );

        let mut equations = random_equations(&structure, 3);
        equations.gradient[sparse + 4] = f64::INFINITY;
        let error = solver.solve(&equations, &[], &mut step).unwrap_err();
        assert_eq!(error, LinearError::NonFinite { at: Coordinate::Border { index: 4 } }, "{}", solver.name());
    }
}

#[test]
fn a_negative_weight_is_not_blamed_on_the_regulariser() {
    let structure = Arc::new(BlockStructure::new(&[1, 1], [(0, 1)], 1).unwrap());
    let mut equations = NormalEquations::new(structure.clone());
    equations.blocks.copy_from_slice(&[2.0, 0.0, -2.0]);
    equations.border[0] = 4.0;
    for kind in LinearSolverKind::ALL {
        let error = kind.build(&structure).solve(&equations, &[], &mut [0.0; 3]).unwrap_err();
        assert_eq!(error, LinearError::NegativeDiagonal { at: Coordinate::Block { block: 1, component: 0 } }, "{kind}");
    }
}

#[test]
fn conjugate_gradients_end_after_as_many_iterations_as_there_are_eigenvalues() {
    let n = 60;
    let eigenvalue = |i: usize| [2.0, 5.0, 11.0, 300.0][i % 4];
    let b: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
    let apply = |p: &[f64], out: &mut [f64]| (0..n).for_each(|i| out[i] = eigenvalue(i) * p[i]);
    let identity = |r: &[f64], z: &mut [f64]| z.copy_from_slice(r);
    let mut pcg = Pcg::default();
    let mut x = vec![f64::NAN; n];
    assert_eq!(pcg.solve(&b, &mut x, apply, identity), Ok(4));
    for i in 0..n {
        approx::assert_relative_eq!(x[i], b[i] / eigenvalue(i), max_relative = 1e-9);
    }
    let exact = |r: &[f64], z: &mut [f64]| (0..n).for_each(|i| z[i] = r[i] / eigenvalue(i));
    assert_eq!(pcg.solve(&b, &mut x, apply, exact), Ok(1));
    // Of any size.
    for scale in [1e-300, 1e-200, 1e200, 1e300] {
        let scaled: Vec<f64> = b.iter().map(|b| scale * b).collect();
        assert_eq!(pcg.solve(&scaled, &mut x, apply, identity), Ok(4));
        for i in 0..n {
            approx::assert_relative_eq!(x[i] / scale, b[i] / eigenvalue(i), max_relative = 1e-9);
        }
    }
    // Another size with the same buffers.
    assert_eq!(pcg.solve(&b[..1], &mut x[..1], |p, out| out[0] = 4.0 * p[0], |r, z| z[0] = r[0]), Ok(1));
    assert_eq!(x[0], 0.25);
    assert_eq!(pcg.solve(&[0.0; 3], &mut x[..3], |_, _| unreachable!(), |r, z| z.copy_from_slice(r)), Ok(0));
}

#[test]
#[should_panic(expected = "the tolerance is -1, but must be in [0, 1)")]
fn conjugate_gradients_refuse_a_tolerance_that_is_none() {
    let identity = |r: &[f64], z: &mut [f64]| z.copy_from_slice(r);
    let _ = Pcg::default().with_tolerance(-1.0).solve(&[1.0], &mut [0.0], identity, identity);
}

#[test]
fn conjugate_gradients_name_what_stops_them() {
    let identity = |r: &[f64], z: &mut [f64]| z.copy_from_slice(r);
    let hilbert = |p: &[f64], out: &mut [f64]| {
        for i in 0..p.len() {
            out[i] = p.iter().enumerate().map(|(j, p)| p / (i + j + 1) as f64).sum();
        }
    };
    let mut x = [0.0; 30];
    let mut pcg = Pcg::default().with_tolerance(1e-15).with_max_iterations(5);
    assert_eq!(pcg.solve(&[1.0; 30], &mut x, hilbert, identity), Err(LinearError::NotConverged { iterations: 5 }));
    let indefinite = |p: &[f64], out: &mut [f64]| {
        out.copy_from_slice(p);
        out[0] *= -3.0;
    };
    let stopped = pcg.solve(&[1.0; 30], &mut x, indefinite, identity);
    assert!(matches!(stopped, Err(LinearError::NoCurvature { iteration: 1 | 2 })), "{stopped:?}");
    let turned = |r: &[f64], z: &mut [f64]| z.iter_mut().zip(r).for_each(|(z, r)| *z = -r);
    assert_eq!(pcg.solve(&[1.0; 30], &mut x, hilbert, turned), Err(LinearError::NoCurvature { iteration: 1 }));
    let nan = |_: &[f64], out: &mut [f64]| out.fill(f64::NAN);
    assert_eq!(pcg.solve(&[1.0; 30], &mut x, nan, identity), Err(LinearError::NoCurvature { iteration: 1 }));
}

#[test]
fn equations_that_treat_coordinates_alike_are_solved_by_one_factor_until_they_do_not() {
    let pairs = |random: &mut Random| (0..150).map(|_| (random.index(60), random.index(60))).collect::<Vec<_>>();
    let pairs = pairs(&mut Random(3));
    let scalar = Arc::new(BlockStructure::new(&[1; 60], pairs.iter().copied(), 0).unwrap());
    let structure = Arc::new(BlockStructure::new(&[3; 60], pairs, 0).unwrap());
    let mut solver = BorderedCholesky::new(&structure);
    let mut solve = |equations: &NormalEquations, damping: &[f64], alike: bool| {
        assert_eq!(isotropic::Isotropic::fits(equations, damping), alike);
        let mut h = equations.to_dense();
        damping.iter().enumerate().for_each(|(i, d)| h[(i, i)] += d);
        let mut step = vec![f64::NAN; 180];
        solver.solve(equations, damping, &mut step).unwrap();
        let g = DVector::from_column_slice(&equations.gradient);
        let error = (h * DVector::from_column_slice(&step) + g).amax();
        assert!(error < 1e-11, "{error:e}");
        assert_eq!(solver.unobserved_pivots(), 0);
    };
    for seed in 0..3 {
        let random = random_equations(&scalar, seed);
        let mut equations = NormalEquations::new(structure.clone());
        for (block, k) in equations.blocks.chunks_exact_mut(9).zip(&random.blocks) {
            [0, 4, 8].iter().for_each(|a| block[*a] = *k);
            block[1] = -0.0;
        }
        let mut numbers = Random(seed + 100);
        equations.gradient.iter_mut().for_each(|g| *g = numbers.next());
        let mut damping = vec![0.02; 180];
        solve(&equations, &damping, true);
        // another right-hand side, then another matrix, then none that fits
        equations.gradient.reverse();
        solve(&equations, &damping, true);
        solve(&equations, &[], true);
        damping[4] = 0.03;
        solve(&equations, &damping, false);
        solve(&equations, &[], true);
        equations.blocks[2] = 1e-3;
        solve(&equations, &[], false);
        equations.blocks[2] = f64::NAN;
        assert!(!isotropic::Isotropic::fits(&equations, &[]));
    }
    // What nothing observes is damped in three directions, and named without damping.
    let empty = NormalEquations::new(structure.clone());
    let mut step = vec![0.0; 180];
    solver.solve(&empty, &[1e-3; 180], &mut step).unwrap();
    assert_eq!((solver.unobserved_pivots(), step[0]), (180, 0.0));
    let error = solver.solve(&empty, &[], &mut step).unwrap_err();
    assert!(
        matches!(error, LinearError::NotPositiveDefinite { at: Coordinate::Block { component: 0, .. } }),
        "{error}"
    );
}
