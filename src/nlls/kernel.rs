//! Robust kernels: functions of the squared residual norm that grow slower than it, so that outliers lose their pull.
//!
//! The energy of a residual r is `alpha rho_delta(s)` with `s = |r|^2`, and
//!
//! ```text
//!     rho_delta(s) = delta^2 rho(s / delta^2)        rho(0) = 0        rho'(0) = 1
//! ```
//!
//! so that a kernel looks like plain least squares for `|r| << delta`, and delta is in the unit of r. This is Ceres'
//! `LossFunction` convention. The solvers use iteratively reweighted least squares: the weight of a residual is `rho'(s)`,
//! which makes the gradient exact; `rho''` is there for whoever wants the second-order correction, and for tests.

use serde::{Deserialize, Serialize};

use super::OptionError;

/// A robust kernel. Implement it for your own:
///
/// ```
/// use nonrigid::nlls::{RobustKernel, Scaled};
///
/// /// rho(s) = 2 (sqrt(1 + s) - 1), "pseudo-Huber" or Charbonnier.
/// struct Charbonnier;
///
/// impl RobustKernel for Charbonnier {
///     fn evaluate(&self, s: f64) -> [f64; 3] {
///         let root = (1.0 + s).sqrt();
///         [2.0 * (root - 1.0), 1.0 / root, -0.5 / (root * root * root)]
///     }
/// }
///
/// let kernel = Scaled { kernel: Charbonnier, delta: 0.5 }; // half a millimetre
/// let [rho, weight, _] = kernel.evaluate(4.0);
/// assert!(rho < 4.0 && weight < 1.0);
/// nonrigid::nlls::check_kernel(&kernel, 2.0).unwrap();
/// ```
pub trait RobustKernel: Send + Sync {
    /// `[rho(s), rho'(s), rho''(s)]` at the squared norm `s >= 0`.
    fn evaluate(&self, s: f64) -> [f64; 3];

    /// The weight of a residual in iteratively reweighted least squares, `rho'(s)`.
    fn weight(&self, s: f64) -> f64 {
        self.evaluate(s)[1]
    }

    /// Checks its settings, if it has some; asked when a problem is built.
    ///
    /// # Errors
    /// Names the field, its value and the violated bound.
    fn validate(&self) -> Result<(), OptionError> {
        Ok(())
    }
}

fn check_scale(field: &'static str, scale: f64) -> Result<(), OptionError> {
    OptionError::require(scale > 0.0 && scale.is_finite(), field, scale, "positive and finite")?;
    // Its square is a factor and a divisor.
    OptionError::require((1e-100..=1e100).contains(&scale), field, scale, "in [1e-100, 1e100]")
}

/// A normalised kernel at the scale delta: `rho_delta(s) = delta^2 rho(s / delta^2)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaled<K> {
    /// The kernel at scale one.
    pub kernel: K,
    /// The scale, in the residual's unit.
    pub delta: f64,
}

impl<K: RobustKernel> RobustKernel for Scaled<K> {
    fn evaluate(&self, s: f64) -> [f64; 3] {
        let square = self.delta * self.delta;
        let [rho, first, second] = self.kernel.evaluate(s / square);
        [square * rho, first, second / square]
    }

    fn validate(&self) -> Result<(), OptionError> {
        check_scale("kernel.delta", self.delta)?;
        self.kernel.validate()
    }
}

/// The kernels that ship with the crate. `delta` and `eps` are in the residual's unit.
///
/// | kernel | rho(s) at delta = 1 | weight rho'(s) |
/// |---|---|---|
/// | none | s | 1 |
/// | Huber (1964) | s, or 2 sqrt(s) - 1 for s > 1 | 1, or 1 / sqrt(s) |
/// | Cauchy | ln(1 + s) | 1 / (1 + s) |
/// | Geman-McClure (1985) | s / (1 + s) | 1 / (1 + s)^2 |
/// | Welsch (1978) | 1 - exp(-s) | exp(-s) |
/// | Tukey (1974) | (1 - (1 - s)^3) / 3, or 1/3 for s > 1 | (1 - s)^2, or 0 |
/// | Lp | (2/p) eps^(2-p) [(s + eps^2)^(p/2) - eps^p] | (1 + s / eps^2)^(p/2 - 1) |
///
/// L1 is Lp with p = 1. Lp is the objective of Bouaziz et al. 2013, smoothed by eps and minimised by reweighting (not by
/// their ADMM).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Kernel {
    /// Plain least squares.
    #[default]
    None,
    /// Quadratic up to delta, linear beyond.
    Huber {
        /// Scale.
        delta: f64,
    },
    /// Logarithmic growth.
    Cauchy {
        /// Scale.
        delta: f64,
    },
    /// Bounded by delta^2.
    #[serde(rename = "geman_mcclure")]
    GemanMcClure {
        /// Scale.
        delta: f64,
    },
    /// Bounded by delta^2, with a Gaussian weight.
    Welsch {
        /// Scale.
        delta: f64,
    },
    /// Constant beyond delta: outliers have no pull at all.
    Tukey {
        /// Scale.
        delta: f64,
    },
    /// Smoothed absolute value, Lp with p = 1.
    L1 {
        /// Smoothing.
        eps: f64,
    },
    /// Smoothed p-norm, 0 < p <= 2.
    Lp {
        /// Exponent.
        p: f64,
        /// Smoothing.
        eps: f64,
    },
}

impl Kernel {
    /// The scale: delta, or eps for the p-norms; `None` for plain least squares.
    #[must_use]
    pub fn scale(&self) -> Option<f64> {
        match *self {
            Self::None => None,
            Self::Huber { delta }
            | Self::Cauchy { delta }
            | Self::GemanMcClure { delta }
            | Self::Welsch { delta }
            | Self::Tukey { delta } => Some(delta),
            Self::L1 { eps } | Self::Lp { eps, .. } => Some(eps),
        }
    }

    /// The kernel with its scale times `factor`: for residuals in another unit.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        self.scale().map_or(self, |scale| self.with_scale(scale * factor))
    }

    /// The same kernel at another scale.
    #[must_use]
    pub fn with_scale(self, scale: f64) -> Self {
        match self {
            Self::None => Self::None,
            Self::Huber { .. } => Self::Huber { delta: scale },
            Self::Cauchy { .. } => Self::Cauchy { delta: scale },
            Self::GemanMcClure { .. } => Self::GemanMcClure { delta: scale },
            Self::Welsch { .. } => Self::Welsch { delta: scale },
            Self::Tukey { .. } => Self::Tukey { delta: scale },
            Self::L1 { .. } => Self::L1 { eps: scale },
            Self::Lp { p, .. } => Self::Lp { p, eps: scale },
        }
    }

    /// Checks the scale and the exponent.
    ///
    /// # Errors
    /// Names the field, its value and the violated bound.
    pub fn validate(&self) -> Result<(), OptionError> {
        if let Some(scale) = self.scale() {
            let field = if matches!(self, Self::L1 { .. } | Self::Lp { .. }) { "kernel.eps" } else { "kernel.delta" };
            check_scale(field, scale)?;
        }
        if let Self::Lp { p, .. } = *self {
            OptionError::require(p > 0.0 && p <= 2.0, "kernel.p", p, "in (0, 2]")?;
        }
        Ok(())
    }
}

impl RobustKernel for Kernel {
    fn evaluate(&self, s: f64) -> [f64; 3] {
        let scaled = |delta: f64, rho: fn(f64) -> [f64; 3]| {
            let square = delta * delta;
            let [value, first, second] = rho(s / square);
            [square * value, first, second / square]
        };
        match *self {
            Self::None => [s, 1.0, 0.0],
            Self::Huber { delta } => scaled(delta, huber),
            Self::Cauchy { delta } => scaled(delta, cauchy),
            Self::GemanMcClure { delta } => scaled(delta, geman_mcclure),
            Self::Welsch { delta } => scaled(delta, welsch),
            Self::Tukey { delta } => scaled(delta, tukey),
            Self::L1 { eps } => lp(1.0, eps, s),
            Self::Lp { p, eps } => lp(p, eps, s),
        }
    }

    fn validate(&self) -> Result<(), OptionError> {
        Self::validate(self)
    }
}

fn huber(s: f64) -> [f64; 3] {
    if s <= 1.0 {
        return [s, 1.0, 0.0];
    }
    let root = s.sqrt();
    [2.0 * root - 1.0, 1.0 / root, -0.5 / (s * root)]
}

fn cauchy(s: f64) -> [f64; 3] {
    let weight = 1.0 / (1.0 + s);
    [s.ln_1p(), weight, -weight * weight]
}

fn geman_mcclure(s: f64) -> [f64; 3] {
    if s == f64::INFINITY {
        return [1.0, 0.0, 0.0];
    }
    let u = 1.0 / (1.0 + s);
    [s * u, u * u, -2.0 * u * u * u]
}

fn welsch(s: f64) -> [f64; 3] {
    let weight = (-s).exp();
    [-(-s).exp_m1(), weight, -weight]
}

fn tukey(s: f64) -> [f64; 3] {
    if s >= 1.0 {
        return [1.0 / 3.0, 0.0, 0.0];
    }
    let u = 1.0 - s;
    // (1 - u^3) / 3 without the cancellation at s = 0.
    [s * (3.0 - s * (3.0 - s)) / 3.0, u * u, -2.0 * u]
}

/// With `q = s / eps^2`: `(2/p) eps^2 [(1 + q)^(p/2) - 1]`, evaluated without cancellation for small q.
fn lp(p: f64, eps: f64, s: f64) -> [f64; 3] {
    let square = eps * eps;
    let log = (s / square).ln_1p();
    let weight = ((0.5 * p - 1.0) * log).exp();
    [2.0 / p * square * (0.5 * p * log).exp_m1(), weight, (0.5 * p - 1.0) * weight / (square + s)]
}

/// Robust scale of residuals: `1.4826 median |r|`, the standard deviation if most of them are Gaussian (the factor is
/// 1 / Phi^-1(3/4)). Takes residual norms; NaN and infinities are left out; reorders the slice. `None` if nothing is left.
///
/// The median is about zero, not about the sample's own median: the norm of a residual is already a deviation.
pub fn mad_scale(norms: &mut [f64]) -> Option<f64> {
    for v in &mut *norms {
        *v = v.abs();
    }
    norms.sort_unstable_by(f64::total_cmp);
    let finite = norms.partition_point(|v| v.is_finite());
    let norms = &norms[..finite];
    let median = match finite {
        0 => return None,
        n if n % 2 == 1 => norms[n / 2],
        n => 0.5 * (norms[n / 2 - 1] + norms[n / 2]),
    };
    Some(1.4826 * median)
}

/// Checks the laws that a kernel must obey, on squared norms from 0 to 100 `scale`^2: `rho(0) = 0`, `rho'(0) = 1`,
/// `rho' >= 0`, `rho'' <= 0`, and both derivatives against central differences.
///
/// # Errors
/// A sentence that names the law, the point and both numbers.
pub fn check_kernel(kernel: &(impl RobustKernel + ?Sized), scale: f64) -> Result<(), String> {
    let [rho, first, _] = kernel.evaluate(0.0);
    if rho != 0.0 {
        return Err(format!("rho(0) must be 0, but is {rho:e}"));
    }
    if (first - 1.0).abs() > 1e-12 {
        return Err(format!("rho'(0) must be 1, but is {first}"));
    }
    for k in 1..200 {
        // Squared norms on a geometric grid; an irrational ratio keeps away from the kinks at s = delta^2.
        let s = scale * scale * 1e-4 * 1.0717_f64.powi(k);
        let h = 1e-5 * s;
        let (low, high) = (kernel.evaluate(s - h), kernel.evaluate(s + h));
        let [rho, first, second] = kernel.evaluate(s);
        let (slope, curvature) = ((high[0] - low[0]) / (2.0 * h), (high[1] - low[1]) / (2.0 * h));
        if (slope - first).abs() > 1e-7 * (1.0 + rho / s) {
            return Err(format!("rho'({s:e}) is {first:e}, central difference {slope:e}"));
        }
        if (curvature - second).abs() * s > 1e-6 * (1.0 + first) {
            return Err(format!("rho''({s:e}) is {second:e}, central difference {curvature:e}"));
        }
        if first < 0.0 {
            return Err(format!("rho'({s:e}) is {first:e}: a weight must not be negative"));
        }
        if second > 0.0 {
            return Err(format!("rho''({s:e}) is {second:e}: a robust kernel must be concave in s"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(delta: f64) -> [Kernel; 9] {
        let eps = delta;
        [
            Kernel::None,
            Kernel::Huber { delta },
            Kernel::Cauchy { delta },
            Kernel::GemanMcClure { delta },
            Kernel::Welsch { delta },
            Kernel::Tukey { delta },
            Kernel::L1 { eps },
            Kernel::Lp { p: 0.4, eps },
            Kernel::Lp { p: 2.0, eps },
        ]
    }

    #[test]
    fn derivatives_and_normalisation() {
        for scale in [1.0, 0.02, 30.0] {
            for kernel in all(scale) {
                check_kernel(&kernel, scale).unwrap_or_else(|e| panic!("{kernel:?}: {e}"));
            }
        }
    }

    #[test]
    fn the_checker_catches_a_wrong_derivative() {
        struct Wrong;
        impl RobustKernel for Wrong {
            fn evaluate(&self, s: f64) -> [f64; 3] {
                let [rho, first, second] = cauchy(s);
                [rho, first * (1.0 - 1e-3 * s.min(1.0)), second]
            }
        }
        assert!(check_kernel(&Wrong, 1.0).unwrap_err().starts_with("rho'("));
    }

    #[test]
    fn closed_forms() {
        assert_eq!(Kernel::Huber { delta: 2.0 }.evaluate(9.0)[0], 2.0 * 2.0 * 3.0 - 4.0);
        let eps = 1e-3;
        // L1 tends to 2 eps |r|.
        let l1 = Kernel::L1 { eps }.evaluate(4.0)[0];
        assert!((l1 - 2.0 * eps * (2.0 - eps)).abs() < 1e-9, "{l1}");
        assert_eq!(Kernel::Tukey { delta: 3.0 }.weight(9.1), 0.0);
        assert!((Kernel::Lp { p: 2.0, eps: 0.7 }.evaluate(5.0)[0] - 5.0).abs() < 1e-12);
    }

    #[test]
    fn the_smallest_and_largest_scales_meet_any_residual() {
        for scale in [1e-100, 1e100] {
            for kernel in all(scale) {
                kernel.validate().unwrap();
                for r in [0.0, 1e-160, 1e-50, 1e-10, 1.0, 1e10, 1e50] {
                    let [rho, weight, _] = kernel.evaluate(r * r);
                    assert!(rho >= 0.0 && (0.0..=1.0).contains(&weight), "{kernel:?} at {r}: {rho} {weight}");
                }
            }
        }
        let delta = 1e-100;
        for bounded in [Kernel::GemanMcClure { delta }, Kernel::Welsch { delta }, Kernel::Tukey { delta }] {
            let [rho, weight, _] = bounded.evaluate(1e200);
            assert!(rho <= 1.01e-200 && weight == 0.0, "{bounded:?}: {rho} {weight}");
        }
        for delta in [1e-170, 1e170] {
            let error = Kernel::Welsch { delta }.validate().unwrap_err().to_string();
            assert!(error.ends_with("but must be in [1e-100, 1e100]"), "{error}");
        }
    }

    #[test]
    fn mad_of_a_known_sample() {
        assert_eq!(mad_scale(&mut [3.0, -1.0, f64::NAN, 2.0]), Some(1.4826 * 2.0));
        assert_eq!(mad_scale(&mut [4.0, 1.0, 2.0, 3.0, f64::INFINITY]), Some(1.4826 * 2.5));
        assert_eq!(mad_scale(&mut [f64::NAN]), None);
    }

    #[test]
    fn names_are_snake_case_and_errors_name_the_field() {
        let text = serde_json::to_string(&all(1.0)).unwrap();
        assert!(text.contains("\"geman_mcclure\":{\"delta\":1.0}") && text.starts_with("[\"none\""), "{text}");
        assert_eq!(serde_json::from_str::<[Kernel; 9]>(&text).unwrap(), all(1.0));
        let error = Kernel::Huber { delta: -1.0 }.validate().unwrap_err();
        assert_eq!(error.to_string(), "kernel.delta is -1, but must be positive and finite");
        assert!(Kernel::Lp { p: 0.0, eps: 1.0 }.validate().is_err());
    }
}
