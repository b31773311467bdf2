//! Minimisers, bounds and linear solvers against certified values, closed forms and each other.

#[path = "../support/dense_covariance.rs"]
mod dense_covariance;
#[path = "../support/projected_gradient.rs"]
mod projected_gradient;
#[path = "../support/threads.rs"]
mod threads;

mod block_jacobi;
mod bounds;
mod reference;
