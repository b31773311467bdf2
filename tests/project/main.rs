//! What holds of the sources, the book and the fuzzing seeds.

#[path = "../support/generated_page.rs"]
mod generated_page;
#[path = "../support/skip.rs"]
mod skip;
#[path = "../support/mod.rs"]
mod support;

mod architecture;
mod corpus;
mod figures;
mod guide;
mod reference;
