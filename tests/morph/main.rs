//! The mask morph and measurements.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;

mod energy;
mod masks;
mod measurement;
mod projection;
mod recipes;
