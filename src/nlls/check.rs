//! Derivatives checked against differences, for any problem.

use std::fmt;

use super::linear::Coordinate;
use super::{NormalEquations, Problem, ResidualProblem};

/// Rounding of a residual, as a share of its terms.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// How [`check_gradient`] differentiates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientCheck {
    /// Length of the tangent steps, as a share of the coordinate's size: of what it moves in x, of how far its own gradient asks it to go,
    /// or of 1, whichever shows the derivative clearly. Default 6e-6, the cube root of rounding.
    pub step: f64,
    /// Relative error up to which the gradient passes. Default 1e-6.
    pub tolerance: f64,
    /// Check this many coordinates at most, evenly spread; 0 checks all. Default 0.
    pub samples: usize,
}

impl Default for GradientCheck {
    fn default() -> Self {
        Self { step: f64::EPSILON.cbrt(), tolerance: 1e-6, samples: 0 }
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
    /// Rounding of the energies.
    rounding: f64,
}

impl GradientReport {
    /// All coordinates agree within the tolerance, and so do the two energies, to 1e-12 or rounding of the residuals' terms.
    #[must_use]
    pub fn passed(&self) -> bool {
        let [a, b] = self.energies;
        // Written so that NaN fails.
        (a - b).abs() <= (1e-12 * a.abs().max(b.abs())).max(self.rounding)
            && self.entries.iter().all(|e| e.relative_error <= self.tolerance)
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
    let coordinates: Vec<(usize, f64)> = (0..count)
        .map(|k| {
            let i = k * n / count;
            step[i] = 1.0;
            problem.retract(x, &step, &mut moved);
            step[i] = 0.0;
            let size =
                moved.iter().zip(x).filter(|(to, from)| to != from).map(|(_, from)| from.abs()).fold(0.0, f64::max);
            (i, size)
        })
        .collect();
    // Residuals are differences of terms of about this size, |J x|, and known to rounding of it; of all coordinates, if some are checked.
    let squares: f64 = coordinates.iter().map(|&(i, size)| equations.diagonal(i) * size * size).sum();
    let terms = (squares * n as f64 / count as f64).sqrt();
    // an energy that leaves out a constant may be negative
    let rounding = |energy: f64| ROUNDING * (energy.abs() + 2.0 * energy.abs().sqrt() * terms);
    let mut entries: Vec<GradientEntry> = coordinates
        .iter()
        .map(|&(i, size)| {
            let (analytic, h_ii) = (2.0 * equations.gradient[i], equations.diagonal(i));
            let mut energy_at = |t: f64| {
                step[i] = t;
                problem.retract(x, &step, &mut moved);
                step[i] = 0.0;
                problem.energy(&moved)
            };
            // Numeric derivative, what rounding may be of it, and that together with what it changes from second to fourth order.
            let mut best = [f64::NAN; 3];
            let newton = (0.5 * analytic / h_ii).abs();
            let lengths = [size, newton, 1.0].into_iter().filter(|length| *length > 0.0 && length.is_finite());
            for length in lengths {
                let h = options.step * length;
                let near = energy_at(h) - energy_at(-h);
                let far = energy_at(2.0 * h) - energy_at(-2.0 * h);
                let numeric = (8.0 * near - far) / (12.0 * h);
                let noise = rounding(energies[0] + h_ii * (2.0 * h).powi(2)) / h;
                let doubt = noise + (numeric - near / (2.0 * h)).abs();
                if doubt < best[2] || best[2].is_nan() {
                    best = [numeric, noise, doubt];
                }
                if doubt <= options.tolerance * numeric.abs() {
                    break;
                }
            }
            let [numeric, noise, _] = best;
            let size = analytic.abs().max(numeric.abs()).max(noise / options.tolerance).max(f64::MIN_POSITIVE);
            let relative_error = (analytic - numeric).abs() / size;
            GradientEntry { at: Coordinate::of(&structure, i), analytic, numeric, relative_error }
        })
        .collect();
    entries.sort_by(|a, b| b.relative_error.total_cmp(&a.relative_error));
    let rounding = rounding(energies[0]) + (ROUNDING * terms).powi(2);
    GradientReport { entries, energies, tolerance: options.tolerance, rounding }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nlls::{AnalyticFamily, AnalyticResidual, Euclidean, Family, Residual, Scalar};

    /// `a (1 - exp(-b t)) - y`, its derivatives times `factor`.
    struct Saturation {
        factor: f64,
        t: f64,
        y: f64,
    }

    impl AnalyticResidual<1> for Saturation {
        fn len(&self) -> usize {
            1
        }

        fn evaluate(&self, [p]: [&[f64]; 1], residual: &mut [f64], jacobian: Option<&mut [f64]>) {
            let left = (-p[1] * self.t).exp();
            residual[0] = p[0] * (1.0 - left) - self.y;
            if let Some(j) = jacobian {
                j.copy_from_slice(&[self.factor * (1.0 - left), self.factor * p[0] * self.t * left]);
            }
        }
    }

    fn saturation(start: [f64; 2], truth: [f64; 2], factor: f64) -> GradientReport {
        let mut builder = ResidualProblem::builder();
        let p = builder.add_block::<Euclidean<2>>(&start);
        let sample = |k: usize| {
            let t = 0.2 * (k + 1) as f64 / truth[1];
            Saturation { factor, t, y: truth[0] * (1.0 - (-truth[1] * t).exp()) }
        };
        builder.add_analytic_family(AnalyticFamily::new((0..10).map(sample).collect(), &[[p]; 10]));
        let mut problem = builder.build().unwrap();
        check_gradient(&mut problem, &start, GradientCheck::default())
    }

    #[test]
    fn derivatives_are_judged_at_the_scale_of_their_parameters() {
        for a in [1e-9, 1e-4, 1.0, 500.0, 1e9] {
            for b in [1e-9, 1e-4, 1.0, 500.0, 1e9] {
                let (near, far) = ([0.9 * a, 1.2 * b], [2.0 * a, 0.2 * b]);
                for start in [near, far, [a * 1e-12, 1.2 * b], [0.0, 1.2 * b]] {
                    let report = saturation(start, [a, b], 1.0);
                    assert!(report.passed(), "{a} {b}: {start:?}\n{report}");
                    for factor in [0.0, 0.5, 1.001, 2.0, -1.0] {
                        let report = saturation(start, [a, b], factor);
                        assert!(!report.passed(), "{a} {b}: {start:?}, {factor}\n{report}");
                    }
                }
            }
        }
    }

    #[test]
    fn at_an_exact_solution_rounding_is_no_error() {
        /// `cos(p) - q`.
        struct Cosine;
        impl Residual<1, 2> for Cosine {
            type Blocks = (Euclidean<1>, Euclidean<1>);
            fn evaluate<D: Scalar>(&self, (p, q): &([D; 1], [D; 1])) -> [D; 1] {
                [p[0].cos() - q[0]]
            }
        }
        for (p, q) in [(std::f64::consts::FRAC_PI_2, 0.0), (0.3, 0.3_f64.cos()), (1e6, 1e6_f64.cos()), (0.0, 1.0)] {
            let mut builder = ResidualProblem::builder();
            let ids = [p, q].map(|v| builder.add_block::<Euclidean<1>>(&[v]));
            builder.add_family(Family::new(vec![Cosine], &[ids]));
            let mut problem = builder.build().unwrap();
            let x = problem.initial();
            let report = check_gradient(&mut problem, &x, GradientCheck::default());
            assert!(report.passed(), "{p}\n{report}");
        }
    }
}
