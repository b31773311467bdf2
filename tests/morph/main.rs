//! The mask morph and measurements.

#[path = "../support/awkward.rs"]
mod awkward;

mod energy;
mod masks;
mod measurement;
mod projection;
mod recipes;
