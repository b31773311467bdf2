//! The program `data-gen`.

#[path = "../../../tests/support/closed_stdout.rs"]
mod closed_stdout;
#[path = "../../../tests/support/refusal.rs"]
mod refusal;
#[path = "../../../tests/support/repeats.rs"]
mod repeats;

mod bad_input;
mod outputs;
