//! Settings of the minimisers, with their defaults.

use serde::{Deserialize, Serialize};

use crate::nlls::{LinearSolverKind, OptionError};

/// Which steps are taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Full steps, halved until the energy falls.
    GaussNewton(GaussNewton),
    /// Damped steps.
    LevenbergMarquardt(LevenbergMarquardt),
    /// Steps within a trust region.
    Dogleg(Dogleg),
}

/// Settings of [Gauss-Newton](super::gauss_newton).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GaussNewton {
    /// A step of length t is accepted if `E(x + t d) <= E(x) + c t 2 g'd` (Armijo). c, default 1e-4; 0 asks for any decrease.
    pub sufficient_decrease: f64,
    /// How often a step is halved before the minimiser gives up. Default 20.
    pub max_halvings: usize,
}

impl Default for GaussNewton {
    fn default() -> Self {
        Self { sufficient_decrease: 1e-4, max_halvings: 20 }
    }
}

/// Settings of [Levenberg-Marquardt](super::levenberg_marquardt).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LevenbergMarquardt {
    /// Damping at the start, relative to the diagonal of H. Default 1e-2, as Marquardt's.
    pub initial_lambda: f64,
    /// Damping never falls below this. Default 1e-16.
    pub min_lambda: f64,
    /// When the damping rises above this, no decrease can be found. Default 1e16.
    pub max_lambda: f64,
    /// A step is accepted if it achieves more than this share of the predicted decrease. Default 1e-3.
    pub min_gain: f64,
    /// Share of its scaling that a coordinate keeps from one linearisation to the next when its entry on the diagonal of H
    /// falls: 0 is Marquardt's scaling, 1 is More's. Default 0.9.
    pub memory: f64,
    /// Start from the damping that the last run in the same workspace ended with. Default false; for alternations that run one
    /// iteration at a time.
    pub reuse_lambda: bool,
}

impl Default for LevenbergMarquardt {
    fn default() -> Self {
        Self {
            initial_lambda: 1e-2,
            min_lambda: 1e-16,
            max_lambda: 1e16,
            min_gain: 1e-3,
            memory: 0.9,
            reuse_lambda: false,
        }
    }
}

/// Settings of [dogleg](super::dogleg).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dogleg {
    /// Radius of the trust region at the start, as a share of `sqrt(E)`: `|d|_D` is roughly the change of the residuals.
    /// Default 3.
    pub initial_radius: f64,
    /// A step is accepted if it achieves more than this share of the predicted decrease. Default 1e-3.
    pub min_gain: f64,
    /// As [`LevenbergMarquardt::memory`]. Default 0.7.
    pub memory: f64,
    /// Damping, relative to the diagonal of H, of the first attempt after H could not be factorised. Default 1e-12.
    pub min_mu: f64,
    /// When the damping rises above this, there is no Gauss-Newton point. Default 1.
    pub max_mu: f64,
    /// Start from the radius that the last run in the same workspace ended with. Default false; for alternations that run one
    /// iteration at a time.
    pub reuse_radius: bool,
}

impl Default for Dogleg {
    fn default() -> Self {
        Self { initial_radius: 3.0, min_gain: 1e-3, memory: 0.7, min_mu: 1e-12, max_mu: 1.0, reuse_radius: false }
    }
}

/// Settings of a [`Minimizer`](super::Minimizer).
///
/// The tolerances are tighter than Ceres' (1e-6, 1e-8, 1e-10): second-order methods reach them in a few more steps, and
/// "converged" should mean it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Which steps are taken. Default Levenberg-Marquardt.
    pub algorithm: Algorithm,
    /// How the normal equations are solved. Default by structure.
    pub linear_solver: LinearSolverKind,
    /// Steps at most, rejected ones included. Default 100.
    pub max_iterations: usize,
    /// Converged when an accepted step lowers the energy by at most this share of it. Default 1e-10. 0 for as far as rounding lets
    /// one go: once the energy no longer tells points apart, steps are judged by whether the gradient falls.
    pub energy_tolerance: f64,
    /// Converged when `|d| <= tolerance (|x| + tolerance)` and the step promises to lower the energy by at most `sqrt(tolerance)` of
    /// it. Default 1e-10.
    pub step_tolerance: f64,
    /// Converged when no entry of the gradient of E/2 exceeds this (for coordinates with bounds: of how far they can follow it,
    /// `w - P(w - gradient)`). Default 1e-12. In units of the energy: set it by scale.
    pub gradient_tolerance: f64,
    /// Damping of `floor max(H_ii, floor max_j H_jj)` in every coordinate and every step, for directions that nothing
    /// observes; they then stay where they are. Default 0: a singular H ends Gauss-Newton with a named reason. Use 1e-9 or so:
    /// far below what the data say, far above rounding.
    pub damping_floor: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            algorithm: Algorithm::LevenbergMarquardt(LevenbergMarquardt::default()),
            linear_solver: LinearSolverKind::Auto,
            max_iterations: 100,
            energy_tolerance: 1e-10,
            step_tolerance: 1e-10,
            gradient_tolerance: 1e-12,
            damping_floor: 0.0,
        }
    }
}

impl Options {
    /// Gauss-Newton with its defaults.
    #[must_use]
    pub fn gauss_newton() -> Self {
        Self::default().with_algorithm(Algorithm::GaussNewton(GaussNewton::default()))
    }

    /// Levenberg-Marquardt with its defaults.
    #[must_use]
    pub fn levenberg_marquardt() -> Self {
        Self::default()
    }

    /// Dogleg with its defaults.
    #[must_use]
    pub fn dogleg() -> Self {
        Self::default().with_algorithm(Algorithm::Dogleg(Dogleg::default()))
    }

    /// Sets [`algorithm`](Self::algorithm).
    #[must_use]
    pub fn with_algorithm(self, algorithm: Algorithm) -> Self {
        Self { algorithm, ..self }
    }

    /// Sets [`linear_solver`](Self::linear_solver).
    #[must_use]
    pub fn with_linear_solver(self, linear_solver: LinearSolverKind) -> Self {
        Self { linear_solver, ..self }
    }

    /// Sets [`max_iterations`](Self::max_iterations).
    #[must_use]
    pub fn with_max_iterations(self, max_iterations: usize) -> Self {
        Self { max_iterations, ..self }
    }

    /// Sets [`energy_tolerance`](Self::energy_tolerance).
    #[must_use]
    pub fn with_energy_tolerance(self, energy_tolerance: f64) -> Self {
        Self { energy_tolerance, ..self }
    }

    /// Sets [`step_tolerance`](Self::step_tolerance).
    #[must_use]
    pub fn with_step_tolerance(self, step_tolerance: f64) -> Self {
        Self { step_tolerance, ..self }
    }

    /// Sets [`gradient_tolerance`](Self::gradient_tolerance).
    #[must_use]
    pub fn with_gradient_tolerance(self, gradient_tolerance: f64) -> Self {
        Self { gradient_tolerance, ..self }
    }

    /// Sets [`damping_floor`](Self::damping_floor).
    #[must_use]
    pub fn with_damping_floor(self, damping_floor: f64) -> Self {
        Self { damping_floor, ..self }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting outside its bounds: field, value, bound.
    pub fn validate(&self) -> Result<(), OptionError> {
        let check = OptionError::require;
        let tolerance = |field, v: f64| check(v >= 0.0 && v.is_finite(), field, v, "finite and not negative");
        tolerance("energy_tolerance", self.energy_tolerance)?;
        tolerance("step_tolerance", self.step_tolerance)?;
        tolerance("gradient_tolerance", self.gradient_tolerance)?;
        check((0.0..1.0).contains(&self.damping_floor), "damping_floor", self.damping_floor, "in [0, 1)")?;
        match self.algorithm {
            Algorithm::GaussNewton(o) => {
                let c = o.sufficient_decrease;
                check((0.0..0.5).contains(&c), "gauss_newton.sufficient_decrease", c, "in [0, 0.5)")
            }
            Algorithm::LevenbergMarquardt(o) => {
                let (low, start, high) = (o.min_lambda, o.initial_lambda, o.max_lambda);
                check(low > 0.0 && low.is_finite(), "levenberg_marquardt.min_lambda", low, "positive and finite")?;
                check(
                    high >= low && high.is_finite(),
                    "levenberg_marquardt.max_lambda",
                    high,
                    "finite, >= min_lambda",
                )?;
                let within = (low..=high).contains(&start);
                check(within, "levenberg_marquardt.initial_lambda", start, "in [min_lambda, max_lambda]")?;
                check((0.0..1.0).contains(&o.min_gain), "levenberg_marquardt.min_gain", o.min_gain, "in [0, 1)")?;
                check((0.0..=1.0).contains(&o.memory), "levenberg_marquardt.memory", o.memory, "in [0, 1]")
            }
            Algorithm::Dogleg(o) => {
                let (r, low, high) = (o.initial_radius, o.min_mu, o.max_mu);
                check(r > 0.0 && r.is_finite(), "dogleg.initial_radius", r, "positive and finite")?;
                check((0.0..0.25).contains(&o.min_gain), "dogleg.min_gain", o.min_gain, "in [0, 1/4)")?;
                check((0.0..=1.0).contains(&o.memory), "dogleg.memory", o.memory, "in [0, 1]")?;
                check(low > 0.0 && low.is_finite(), "dogleg.min_mu", low, "positive and finite")?;
                check(high >= low && high.is_finite(), "dogleg.max_mu", high, "finite, >= min_mu")
            }
        }
    }
}
