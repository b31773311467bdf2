//! The program `nonrigid`, run as people run it.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/broken.rs"]
mod broken;
#[path = "../support/closed_stdout.rs"]
mod closed_stdout;
#[path = "../support/command_page.rs"]
mod command_page;
#[path = "../support/generated_page.rs"]
mod generated_page;
#[path = "../support/help.rs"]
mod help;
#[path = "../support/refusal.rs"]
mod refusal;
#[path = "../support/repeats.rs"]
mod repeats;
#[path = "../support/skip.rs"]
mod skip;
#[path = "../support/mod.rs"]
mod support;

mod animate;
mod bad_input;
mod batch;
mod determinism;
mod doctor;
mod examples_in_help;
mod faults;
mod hostile_input;
mod landmarks;
mod measure;
mod morph;
mod odd_input;
mod register;
mod rig;
