//! What holds of the sources, the guide and the fuzzing seeds.

#[path = "../support/mod.rs"]
mod support;

mod architecture;
mod corpus;
mod guide;
