//! The program `experiments`: what its commands leave, promise and refuse.

#[path = "../../../tests/support/closed_stdout.rs"]
mod closed_stdout;
#[path = "../../../tests/support/refusal.rs"]
mod refusal;
#[path = "../../../tests/support/repeats.rs"]
mod repeats;
#[path = "../../../tests/support/skip.rs"]
mod skip;
#[path = "../../../tests/support/threads.rs"]
mod threads;

mod bad_input;
mod ceres;
mod consistency;
mod determinism;
mod peers;
mod reference_problems;
mod report;
mod scaling;
mod scan_bench;
mod solver_case;
mod unseen;
