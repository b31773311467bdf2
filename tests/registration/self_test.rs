//! The self-test of `nonrigid doctor`: its expected numbers, and how well they are known.

use crate::threads::on_threads;
use nonrigid::mesh::Vec3;
use nonrigid::self_test::{CHECKS, Check, Face, Machine, registration_rmse};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn every_check_passes_and_none_passes_whatever_it_finds() {
    for check in CHECKS {
        let finding = check.run();
        assert!(finding.ok, "{finding:?}");
        // As far beside the number that was found as the check allows to be beside the expected one, and half as much again.
        let beside = finding.found.unwrap() + (1.5 * check.tolerance).max(1e-6);
        let wrong = Check { expected: beside, ..check };
        assert!(!wrong.run().ok, "{}", check.what);
    }
}

/// Processors and mathematical libraries differ in the sixteenth digit, of some 1e-14 mm here.
#[test]
fn what_other_processors_compute_otherwise_stays_far_inside_the_tolerance() {
    let registration = CHECKS.iter().find(|check| check.what.contains("rmse")).unwrap();
    let face = Face::new();
    let rmse = registration_rmse(&face).unwrap();
    let mut changes = Vec::new();
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut moved = |p: &mut Vec3| p.iter_mut().for_each(|x| *x += rng.random_range(-1e-10..1e-10));
        let mut other = face.clone();
        other.template.positions.iter_mut().for_each(&mut moved);
        other.scan.positions.iter_mut().for_each(&mut moved);
        changes.push((registration_rmse(&other).unwrap() - rmse).abs());
    }
    eprintln!("rmse {rmse} mm, changed by {changes:?}");
    assert!(changes.iter().any(|c| *c > 0.0), "nothing was moved");
    assert!(changes.iter().all(|c| *c < 0.1 * registration.tolerance), "{changes:?}");
}

#[test]
fn the_machine_says_what_it_is() {
    let machine = on_threads(3, Machine::new);
    assert_eq!((machine.threads, machine.system), (3, std::env::consts::OS));
    assert!(machine.cores >= 1 && machine.instruction_set.lanes >= 1);
    if cfg!(target_os = "linux") {
        let (all, free) = (machine.memory.unwrap(), machine.available_memory.unwrap());
        assert!(free <= all && all > 1 << 28, "{free} of {all} bytes");
    }
}
