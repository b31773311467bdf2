//! The same bits at any number of threads: equations and steps of every model with every linear solver, on a template that
//! several tasks share.

use nonrigid::model::Linearisation;
use nonrigid::nlls::{LinearSolverKind, Minimizer, NormalEquations, Options, Problem};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::threads::on_threads;
use crate::zoo::{Specimen, TestProblem, Zoo, problem_at_rest, random_step};

/// Bits of everything that was computed, by what it is.
type Prints = Vec<(String, Vec<u64>)>;

fn bits(parts: &[&[f64]]) -> Vec<u64> {
    parts.iter().flat_map(|part| part.iter().map(|v| v.to_bits())).collect()
}

fn equations_at(problem: &mut TestProblem, x: &[f64]) -> Vec<u64> {
    let mut equations = NormalEquations::new(problem.structure().clone());
    problem.linearize(x, &mut equations);
    bits(&[&equations.blocks, &equations.cross, &equations.border, &equations.gradient])
}

/// Equations of every model at random parameters.
fn all_equations(zoo: &Zoo) -> Prints {
    let mut prints = Prints::new();
    for Specimen { name, model, .. } in zoo.models() {
        let (mut problem, rest) = problem_at_rest(zoo, model, 31);
        let mut x = rest.clone();
        let step = random_step(&mut ChaCha8Rng::seed_from_u64(32), problem.structure().dimension());
        problem.retract(&rest, &step, &mut x);
        prints.push((name.clone(), equations_at(&mut problem, &x)));
        if problem.model.set_linearisation(Linearisation::Reference) {
            prints.push((format!("{name}, reference"), equations_at(&mut problem, &x)));
        }
    }
    prints
}

/// Where three Gauss-Newton steps from rest lead every model of at most so many coordinates.
fn all_steps(zoo: &Zoo, kind: LinearSolverKind, largest: usize) -> Prints {
    let mut prints = Prints::new();
    for Specimen { name, model, .. } in zoo.models() {
        let (mut problem, mut x) = problem_at_rest(zoo, model, 31);
        if problem.structure().dimension() > largest || name == crate::zoo::INDEFINITE {
            continue;
        }
        let options = Options::gauss_newton().with_linear_solver(kind).with_max_iterations(3);
        let options = options.with_damping_floor(1e-9).with_energy_tolerance(0.0);
        let summary = Minimizer::new(options).expect("options in bounds").minimize(&mut problem, &mut x);
        let name = format!("{name}, {kind:?} on {} coordinates", problem.structure().dimension());
        assert_eq!(summary.iterations, 3, "{name}: {summary}");
        prints.push((name, bits(&[&x, &[summary.final_energy]])));
    }
    prints
}

/// Runs `work` on one, two and four threads.
fn compare(least: usize, work: impl Fn() -> Prints + Sync) {
    let [one, two, four] = [1, 2, 4].map(|threads| on_threads(threads, &work));
    assert!(one.len() >= least, "{} models", one.len());
    for (threads, other) in [(2, two), (4, four)] {
        for ((name, expected), (_, found)) in one.iter().zip(&other) {
            let differ = expected.iter().zip(found).filter(|(a, b)| a != b).count();
            assert!(
                expected.len() == found.len() && differ == 0,
                "{name}: {differ} numbers differ at {threads} threads"
            );
        }
    }
}

/// So many models there are at least.
const MODELS: usize = 22;

#[test]
fn equations_have_the_same_bits_at_any_number_of_threads() {
    compare(MODELS + 8, || all_equations(&Zoo::large()));
}

#[test]
fn bordered_steps_have_the_same_bits_at_any_number_of_threads() {
    compare(MODELS - 1, || all_steps(&Zoo::large(), LinearSolverKind::Bordered, usize::MAX));
}

#[test]
fn block_jacobi_steps_have_the_same_bits_at_any_number_of_threads() {
    compare(MODELS - 1, || all_steps(&Zoo::large(), LinearSolverKind::BlockJacobi, usize::MAX));
}

#[test]
fn dense_steps_have_the_same_bits_at_any_number_of_threads() {
    compare(MODELS - 1, || all_steps(&Zoo::small(), LinearSolverKind::Dense, usize::MAX));
    // What has a few hundred coordinates on the large template too; the cost grows with the cube.
    compare(8, || all_steps(&Zoo::large(), LinearSolverKind::Dense, 1000));
}
