//! What holds of the sources, the book and the fuzzing seeds.

#[path = "../support/generated_page.rs"]
mod generated_page;
#[path = "../support/mod.rs"]
mod support;

mod architecture;
mod corpus;
mod guide;
mod reference;
