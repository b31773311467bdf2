//! Derivatives checked against differences, for any problem.

use std::fmt;

use super::linear::Coordinate;
use super::{NormalEquations, Problem, ResidualProblem};

/// How [`check_gradient`] differentiates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientCheck {
    /// Length of the tangent steps, in units of the tangent coordinates. Default 1e-4: with differences of fourth order the
    /// truncation is of order 1e-16, and the rounding of order 1e-12 E.
    pub step: f64,
    /// Relative error up to which the gradient passes. Default 1e-6.
    pub tolerance: f64,
    /// Check this many coordinates at most, evenly spread; 0 checks all. Default 0.
    pub samples: usize,
}

impl Default for GradientCheck {
    fn default() -> Self {
        Self { step: 1e-4, tolerance: 1e-6, samples: 0 }
    }
}

/// One coordinate of a gradient, twice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientEntry {
    /// Which coordinate.
    pub at: Coordinate,
    /// `dE / d delta_i` by the problem: twice its gradient of E/2.
    pub analytic: f64,
    /// The same by differences of the energy.
    pub numeric: f64,
    /// Their difference over the larger of the two, or over what rounding lets one see, whichever is more.
    pub relative_error: f64,
}

/// What [`check_gradient`] found. `Display` says it in words.
#[derive(Debug, Clone, PartialEq)]
pub struct GradientReport {
    /// All checked coordinates, worst first.
    pub entries: Vec<GradientEntry>,
    /// The energy returned by `linearize` and by `energy`.
    pub energies: [f64; 2],
    /// The tolerance that was asked for.
    pub tolerance: f64,
}

impl GradientReport {
    /// All coordinates agree within the tolerance, and so do the two energies, to 1e-12.
    #[must_use]
    pub fn passed(&self) -> bool {
        let [a, b] = self.energies;
        // Written so that NaN fails.
        (a - b).abs() <= 1e-12 * a.abs().max(b.abs()) && self.entries.iter().all(|e| e.relative_error <= self.tolerance)
    }
}

impl fmt::Display for GradientReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wrong =
            self.entries.iter().filter(|e| e.relative_error.is_nan() || e.relative_error > self.tolerance).count();
        let verdict = if self.passed() { "passed" } else { "FAILED" };
        writeln!(
            f,
            "Gradient check {verdict}: {wrong} of {} coordinates beyond {:e}",
            self.entries.len(),
            self.tolerance
        )?;
        writeln!(f, "  energy by linearize {:.15e}, by energy {:.15e}", self.energies[0], self.energies[1])?;
        for e in self.entries.iter().take(5) {
            let (at, error) = (e.at.to_string(), e.relative_error);
            writeln!(
                f,
                "  {at:<32} by problem {:>16.9e}  by differences {:>16.9e}  error {error:.1e}",
                e.analytic, e.numeric
            )?;
        }
        Ok(())
    }
}

/// Compares the gradient of [`Problem::linearize`] at `x` with differences of [`Problem::energy`] along tangent coordinates:
///
/// ```text
///     dE/d delta_i = [ 8 (E(h) - E(-h)) - (E(2h) - E(-2h)) ] / 12 h + O(h^4),      E(t) = E(x [+] t e_i)
/// ```
///
/// Holds for robust kernels too, because `J' rho' r` is the exact gradient of E/2. For terms that freeze something per
/// linearisation (normals, correspondences) freeze it in the energy as well, or expect the difference.
///
/// # Panics
/// If `x` does not have [`Problem::parameter_len`] entries.
pub fn check_gradient<P: Problem + ?Sized>(problem: &mut P, x: &[f64], options: GradientCheck) -> GradientReport {
    assert_eq!(x.len(), problem.parameter_len(), "x must hold the ambient coordinates of all parameters");
    let structure = problem.structure().clone();
    let n = structure.dimension();
    let mut equations = NormalEquations::new(structure.clone());
    let energies = [problem.linearize(x, &mut equations), problem.energy(x)];
    let (mut step, mut moved) = (vec![0.0; n], x.to_vec());
    let count = if options.samples == 0 { n } else { options.samples.min(n) };
    let h = options.step;
    // Differences of energies of this size know the derivative to about this much.
    let noise = 10.0 * f64::EPSILON * energies[0].abs() / h / options.tolerance;
    let mut entries: Vec<GradientEntry> = (0..count)
        .map(|k| {
            let i = k * n / count;
            let mut energy_at = |t: f64| {
                step[i] = t;
                problem.retract(x, &step, &mut moved);
                step[i] = 0.0;
                problem.energy(&moved)
            };
            let near = energy_at(h) - energy_at(-h);
            let far = energy_at(2.0 * h) - energy_at(-2.0 * h);
            let numeric = (8.0 * near - far) / (12.0 * h);
            let analytic = 2.0 * equations.gradient[i];
            let size = analytic.abs().max(numeric.abs()).max(noise).max(f64::MIN_POSITIVE);
            let relative_error = (analytic - numeric).abs() / size;
            GradientEntry { at: Coordinate::of(&structure, i), analytic, numeric, relative_error }
        })
        .collect();
    entries.sort_by(|a, b| b.relative_error.total_cmp(&a.relative_error));
    GradientReport { entries, energies, tolerance: options.tolerance }
}

/// What [`check_hessian`] found: largest errors, relative to the largest entry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HessianReport {
    /// Of H against J'J.
    pub hessian: f64,
    /// Of g against J'r.
    pub gradient: f64,
    /// The entry of H that is farthest off.
    pub worst: [Coordinate; 2],
}

impl HessianReport {
    /// Both errors are at most `tolerance` (1e-12 suits).
    #[must_use]
    pub fn passed(&self, tolerance: f64) -> bool {
        self.hessian <= tolerance && self.gradient <= tolerance
    }
}

impl fmt::Display for HessianReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [row, col] = self.worst;
        write!(
            f,
            "H differs from J'J by {:.1e}, worst at ({row}, {col}); g from J'r by {:.1e}",
            self.hessian, self.gradient
        )
    }
}

/// Compares the block-wise sums of [`ResidualProblem::linearize`](Problem::linearize) with the products of its dense weighted
/// Jacobian. Dense: for problems of up to a few thousand coordinates.
///
/// # Panics
/// If the problem has no tangent coordinates.
pub fn check_hessian(problem: &mut ResidualProblem, x: &[f64]) -> HessianReport {
    let structure = problem.structure().clone();
    let mut equations = NormalEquations::new(structure.clone());
    problem.linearize(x, &mut equations);
    let (r, j) = problem.weighted_jacobian();
    let r = nalgebra::DVector::from_vec(r);
    let expected = j.tr_mul(&j);
    let difference = (equations.to_dense() - &expected).abs();
    let (row, col) = difference.iamax_full();
    let g = j.tr_mul(&r);
    let gradient_error = (nalgebra::DVector::from_column_slice(&equations.gradient) - &g).amax();
    HessianReport {
        hessian: difference[(row, col)] / expected.amax().max(f64::MIN_POSITIVE),
        gradient: gradient_error / g.amax().max(f64::MIN_POSITIVE),
        worst: [Coordinate::of(&structure, row), Coordinate::of(&structure, col)],
    }
}
