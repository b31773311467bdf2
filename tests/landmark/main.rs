//! Landmarks: their files and their standard deviations.

#[path = "../support/mod.rs"]
mod support;

mod formats;
mod sigma;
