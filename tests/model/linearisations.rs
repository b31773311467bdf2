//! What `linearize` fills in is right: against the baseline linearisation, against dense dual numbers, against differences.

use nalgebra::{DMatrix, DVector};
use nonrigid::energy::Deformation;
use nonrigid::mesh::Vec3;
use nonrigid::model::Linearisation;
use nonrigid::nlls::{
    Euclidean, GradientCheck, Kernel, Manifold, NormalEquations, Problem, QuaternionSe3, Se3, Sim3, So3,
    UnitQuaternion, check_gradient, check_manifold,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::reference::Reference;
use crate::zoo::{KERNELS, Specimen, TestModel, TestProblem, Zoo, random_step, sampled, terms};

/// The model at random parameters, without terms yet, and where the samples are there.
fn anywhere(model: Box<dyn TestModel>, zoo: &Zoo, rng: &mut ChaCha8Rng) -> (TestProblem, Vec<f64>, Vec<Vec3>) {
    let mut problem = Deformation::new(model, zoo.samples());
    let rest = problem.model.rest_parameters();
    let mut x = rest.clone();
    problem.retract(&rest, &random_step(rng, problem.structure().dimension()), &mut x);
    let positions = sampled(&mut problem, &x);
    (problem, x, positions)
}

/// Runs `check` on every kernel with each term alone and with all of them.
fn each_choice_of_terms(
    problem: &mut TestProblem,
    positions: &[Vec3],
    rng: &mut ChaCha8Rng,
    mut check: impl FnMut(&mut TestProblem, &str),
) {
    for kernel in KERNELS {
        let all = terms(rng, positions, kernel);
        let count = all.len();
        assert_eq!(count, 5);
        for term in all {
            let name = format!("{}, {kernel:?}", term.name());
            problem.terms = vec![term];
            check(problem, &name);
        }
        problem.terms = terms(rng, positions, kernel);
        check(problem, &format!("all terms, {kernel:?}"));
    }
}

fn linearized(problem: &mut TestProblem, x: &[f64]) -> NormalEquations {
    let mut equations = NormalEquations::new(problem.structure().clone());
    problem.linearize(x, &mut equations);
    equations
}

/// What products with derivatives by the border may differ by, since those are rounded to f32 (relative).
const BORDER_TOLERANCE: f64 = 1e-7;

/// Blocks of nodes, cross terms, border and gradient agree, each relative to its own largest entry.
fn assert_same(found: &NormalEquations, expected: (&DMatrix<f64>, &DVector<f64>), tolerance: f64, what: &str) {
    let s = found.structure();
    let (n, m) = (s.sparse_dimension(), s.border());
    let (h, g) = (found.to_dense(), DVector::from_column_slice(&found.gradient));
    for (part, (row, rows), (column, columns)) in
        [("blocks", (0, n), (0, n)), ("cross", (0, n), (n, m)), ("border", (n, m), (n, m))]
    {
        if rows * columns == 0 {
            continue;
        }
        let view = |matrix: &DMatrix<f64>| matrix.view((row, column), (rows, columns)).into_owned();
        let (found, expected) = (view(&h), view(expected.0));
        let (error, size) = ((found - &expected).amax(), expected.amax());
        let tolerance = if part == "blocks" { tolerance } else { tolerance.max(BORDER_TOLERANCE) };
        assert!(size > 0.0 && error <= tolerance * size, "{what}, {part}: {error:e} of {size:e}");
    }
    let (error, size) = ((g - expected.1).amax(), expected.1.amax());
    assert!(size > 0.0 && error <= tolerance * size, "{what}, gradient: {error:e} of {size:e}");
}

#[test]
fn the_structured_linearisation_is_the_reference_one_for_every_model_term_and_kernel() {
    let zoo = Zoo::small();
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for Specimen { name, model, .. } in zoo.assembled() {
        let (mut problem, x, positions) = anywhere(model, &zoo, &mut rng);
        each_choice_of_terms(&mut problem, &positions, &mut rng, |problem, terms| {
            let [structured, reference] = [Linearisation::Structured, Linearisation::Reference].map(|linearisation| {
                assert!(problem.model.set_linearisation(linearisation));
                linearized(problem, &x)
            });
            let expected = (&reference.to_dense(), &DVector::from_column_slice(&reference.gradient));
            assert_same(&structured, expected, 1e-10, &format!("{name}, {terms}"));
        });
    }
}

#[test]
fn every_linearisation_is_that_of_dense_dual_numbers_for_every_model_term_and_kernel() {
    let zoo = Zoo::small();
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    for Specimen { name, model, reference } in zoo.models() {
        let (mut problem, x, positions) = anywhere(model, &zoo, &mut rng);
        let Reference { positions: by_vertex, hessian, gradient } = reference(&x);
        let samples = problem.samples();
        let by_sample: Vec<DMatrix<f64>> = (0..samples.len())
            .map(|s| {
                let row = |&(v, weight): &(u32, f64)| by_vertex.rows(3 * v as usize, 3) * weight;
                samples.corners(s).iter().map(row).sum()
            })
            .collect();
        each_choice_of_terms(&mut problem, &positions, &mut rng, |problem, terms| {
            let rows: Vec<_> = problem.terms.iter().flat_map(|t| t.rows(&positions)).filter(|r| r.1 != 0.0).collect();
            let mut jacobian = DMatrix::zeros(rows.len(), hessian.nrows());
            for (m, (sample, _, a, _)) in rows.iter().enumerate() {
                jacobian.row_mut(m).copy_from(&(nalgebra::RowVector3::from(*a) * &by_sample[*sample]));
            }
            let (data, pull) = crate::reference::normal(&jacobian, rows.iter().map(|r| (r.1, r.3)));
            let expected = (&(&hessian + data), &(&gradient + pull));
            assert_same(&linearized(problem, &x), expected, 1e-10, &format!("{name}, {terms}"));
        });
    }
}

#[test]
fn gradients_pass_the_derivative_checker_for_every_model_term_and_kernel() {
    let zoo = Zoo::small();
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    for Specimen { name, model, .. } in zoo.models() {
        let (mut problem, x, positions) = anywhere(model, &zoo, &mut rng);
        each_choice_of_terms(&mut problem, &positions, &mut rng, |problem, terms| {
            let report = check_gradient(problem, &x, GradientCheck::default());
            assert!(report.passed(), "{name}, {terms}:\n{report}");
        });
    }
}

/// Where they all start, and where a rotation vector is zero.
#[test]
fn gradients_pass_the_derivative_checker_at_rest() {
    let zoo = Zoo::small();
    let mut rng = ChaCha8Rng::seed_from_u64(26);
    for Specimen { name, model, .. } in zoo.assembled() {
        let mut problem = Deformation::new(model, zoo.samples());
        let x = problem.model.rest_parameters();
        each_choice_of_terms(&mut problem, &zoo.resting(), &mut rng, |problem, terms| {
            let report = check_gradient(problem, &x, GradientCheck::default());
            assert!(report.passed(), "{name}, {terms}:\n{report}");
        });
    }
}

/// Points all over a manifold, reached by steps of up to `size` from one point of it.
fn check_everywhere<M: Manifold>(origin: &[f64], size: f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let mut x = origin.to_vec();
    for _ in 0..20 {
        check_manifold::<M>(&x).unwrap_or_else(|e| panic!("{}: {e}", std::any::type_name::<M>()));
        let step: Vec<f64> = (0..M::TANGENT).map(|_| rng.random_range(-size..size)).collect();
        let mut next = x.clone();
        M::plus(&x, &step, &mut next);
        M::normalize(&mut next);
        x = next;
    }
}

#[test]
fn every_manifold_passes_the_checker_everywhere() {
    for size in [1e-9, 0.3, 3.0] {
        check_everywhere::<So3>(&Se3::IDENTITY[..9], size);
        check_everywhere::<UnitQuaternion>(&[1.0, 0.0, 0.0, 0.0], size);
        check_everywhere::<Se3>(&Se3::IDENTITY, size);
        check_everywhere::<QuaternionSe3>(&QuaternionSe3::IDENTITY, size);
        check_everywhere::<Sim3>(&Sim3::IDENTITY, size.min(1.0));
        check_everywhere::<Euclidean<1>>(&[0.0], size);
        check_everywhere::<Euclidean<12>>(&Se3::IDENTITY, size);
    }
}

#[test]
fn a_wrong_term_is_noticed() {
    let zoo = Zoo::small();
    let mut rng = ChaCha8Rng::seed_from_u64(25);
    let Specimen { model, .. } = zoo.models().into_iter().next().expect("some");
    let (mut problem, x, positions) = anywhere(model, &zoo, &mut rng);
    problem.terms = terms(&mut rng, &positions, Kernel::None);
    let right = linearized(&mut problem, &x);
    let mut wrong = right.clone();
    let last = wrong.blocks.len() - 1;
    wrong.blocks[last] += 1e-9 * right.to_dense().amax();
    let expected = (&right.to_dense(), &DVector::from_column_slice(&right.gradient));
    let caught = std::panic::catch_unwind(|| assert_same(&wrong, expected, 1e-10, "wrong"));
    assert!(caught.is_err());
}
