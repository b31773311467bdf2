//! The mask morph and measurements.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;
#[path = "../support/skip.rs"]
mod skip;
#[path = "../support/threads.rs"]
mod threads;

mod energy;
mod masks;
mod measurement;
mod projection;
mod recipes;
