//! Bounds of the border's coordinates.

use std::sync::Arc;

use thiserror::Error;

use super::{BlockStructure, NormalEquations, Problem};

/// Bounds `l <= w <= u` of the dense border's coordinates, which must then be plain numbers: the border of the tangent space is
/// `w` itself, and a step adds to it.
///
/// The minimisers hold them exactly: every point that they visit is inside, and a coordinate at a bound equals it bit for bit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BorderBounds<'a> {
    /// Where `w` begins in `x`.
    pub first: usize,
    /// `l`, one for each border coordinate; minus infinity for none.
    pub lower: &'a [f64],
    /// `u`, one for each border coordinate; infinity for none.
    pub upper: &'a [f64],
}

/// Why bounds cannot be held.
#[derive(Debug, Clone, Copy, PartialEq, Error, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BoundsError {
    /// No number lies between the two.
    #[error("border coordinate {index} is to lie between {lower} and {upper}, but no number does")]
    Empty {
        /// Index inside the border.
        index: usize,
        /// Its lower bound.
        lower: f64,
        /// Its upper bound.
        upper: f64,
    },
    /// Not one lower and one upper bound for each coordinate, or `w` would reach beyond the end of `x`.
    #[error(
        "{lower} lower and {upper} upper bounds for a border of {border} coordinates that begins at parameter {first} of {parameters}"
    )]
    Length {
        /// Number of lower bounds.
        lower: usize,
        /// Number of upper bounds.
        upper: usize,
        /// Number of border coordinates.
        border: usize,
        /// Where the border is said to begin.
        first: usize,
        /// Number of parameters.
        parameters: usize,
    },
}

impl BorderBounds<'_> {
    /// Checks that there are bounds for `border` coordinates among `parameters` and a number between each two.
    ///
    /// # Errors
    /// Names the coordinate and its bounds.
    pub fn validate(&self, border: usize, parameters: usize) -> Result<(), BoundsError> {
        let (lower, upper, first) = (self.lower.len(), self.upper.len(), self.first);
        if lower != border || upper != border || first.checked_add(border).is_none_or(|end| end > parameters) {
            return Err(BoundsError::Length { lower, upper, border, first, parameters });
        }
        for (index, (&lower, &upper)) in self.lower.iter().zip(self.upper).enumerate() {
            // Written so that NaN fails.
            if !(lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY) {
                return Err(BoundsError::Empty { index, lower, upper });
            }
        }
        Ok(())
    }

    /// Moves the border's coordinates in `x` to the nearest point inside.
    ///
    /// # Panics
    /// If the bounds are not [valid](Self::validate) for `x`.
    pub fn project(&self, x: &mut [f64]) {
        for ((w, &l), &u) in x[self.first..].iter_mut().zip(self.lower).zip(self.upper) {
            *w = w.clamp(l, u);
        }
    }

    /// Whether border coordinate `index` of `x` is at one of its bounds (or beyond).
    ///
    /// # Panics
    /// If there is no such coordinate.
    #[must_use]
    pub fn at_bound(&self, x: &[f64], index: usize) -> bool {
        let w = x[self.first + index];
        w <= self.lower[index] || w >= self.upper[index]
    }
}

/// Any problem, with bounds of its border.
///
/// ```
/// use nonrigid::nlls::{Bounded, Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar};
///
/// /// Fits a line `w_0 + w_1 t` to the point (t, y).
/// struct Point { t: f64, y: f64 }
///
/// impl Residual<1, 2> for Point {
///     type Blocks = (Euclidean<2>,);
///     fn evaluate<D: Scalar>(&self, (w,): &([D; 2],)) -> [D; 1] { [w[0] + w[1] * self.t - self.y] }
/// }
///
/// let mut builder = ResidualProblem::builder();
/// let line = builder.add_border_block::<Euclidean<2>>(&[0.0; 2]);
/// let points = vec![Point { t: 1.0, y: 3.0 }, Point { t: 2.0, y: 5.5 }];
/// builder.add_family(Family::new(points, &[[line]; 2]));
/// let problem = builder.build()?;
/// let mut x = problem.initial();
/// // An intercept of at least one; without the bound it would be 0.5.
/// let mut problem = Bounded { problem, first: 0, lower: vec![1.0, f64::NEG_INFINITY], upper: vec![f64::INFINITY; 2] };
/// Minimizer::new(Options::gauss_newton())?.minimize(&mut problem, &mut x);
/// assert!(x[0] == 1.0 && (x[1] - 2.2).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Bounded<P> {
    /// The problem without bounds.
    pub problem: P,
    /// See [`BorderBounds::first`].
    pub first: usize,
    /// See [`BorderBounds::lower`].
    pub lower: Vec<f64>,
    /// See [`BorderBounds::upper`].
    pub upper: Vec<f64>,
}

impl<P: Problem> Problem for Bounded<P> {
    fn structure(&self) -> &Arc<BlockStructure> {
        self.problem.structure()
    }

    fn parameter_len(&self) -> usize {
        self.problem.parameter_len()
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        self.problem.energy(x)
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        self.problem.linearize(x, equations)
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        self.problem.retract(x, step, out);
    }

    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        Some(BorderBounds { first: self.first, lower: &self.lower, upper: &self.upper })
    }
}
