//! Landmarks: their files and their standard deviations.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/mod.rs"]
mod support;

mod formats;
mod sigma;
