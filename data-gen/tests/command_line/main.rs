//! The program `data-gen`.

#[path = "../../../tests/support/refusal.rs"]
mod refusal;
#[path = "../../../tests/support/repeats.rs"]
mod repeats;

mod bad_input;
mod outputs;
