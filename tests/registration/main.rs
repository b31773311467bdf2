//! Whole registrations: laws, starts, random cases, the self-test.

#[path = "../support/awkward.rs"]
mod awkward;
#[path = "../support/real_data.rs"]
mod real_data;
#[path = "../support/skip.rs"]
mod skip;
#[path = "../support/mod.rs"]
mod support;

mod doubts;
mod laws;
mod random;
mod self_test;
mod start;
