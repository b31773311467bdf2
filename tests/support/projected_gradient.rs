//! How far a point is from the minimum between bounds.

use nonrigid::nlls::{NormalEquations, Problem};

/// `max |x_i - P(x_i - g_i)|`, by its definition.
pub fn projected_gradient(problem: &mut impl Problem, x: &[f64]) -> f64 {
    let mut equations = NormalEquations::new(problem.structure().clone());
    problem.linearize(x, &mut equations);
    let sparse = problem.structure().sparse_dimension();
    let bounds = problem.border_bounds().unwrap();
    let moved = equations.gradient.iter().enumerate().map(|(i, g)| match i.checked_sub(sparse) {
        None => g.abs(),
        Some(k) => {
            let w = x[bounds.first + k];
            (w - (w - g).clamp(bounds.lower[k], bounds.upper[k])).abs()
        }
    });
    moved.fold(0.0, f64::max)
}
