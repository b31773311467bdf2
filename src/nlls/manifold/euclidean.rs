//! Plain vectors.

use super::{Manifold, Scalar};

/// `R^N`: a step is added.
#[derive(Debug, Clone, Copy)]
pub struct Euclidean<const N: usize>;

impl<const N: usize> Manifold for Euclidean<N> {
    const AMBIENT: usize = N;
    const TANGENT: usize = N;
    const PLAIN: bool = true;
    type Point<D: Scalar> = [D; N];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        for i in 0..N {
            out[i] = delta[i] + x[i];
        }
    }
}
