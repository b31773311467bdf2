//! Linear solvers for the normal equations: `(H + diag(damping)) d = -g`.
//!
//! | solver | structure | method |
//! |---|---|---|
//! | [`DenseCholesky`] | any, meant for small ones | `H = L L'` |
//! | [`BorderedCholesky`] | blocks, with or without a dense border | supernodal `P H_gg P' = L L'`, Schur complement of the border |
//! | the same | blocks of three, all multiples of the identity, no border | one scalar factor for the three coordinates |
//! | [`BlockJacobi`] | blocks and a dense border, too many to factor | conjugate gradients, preconditioned by diagonal blocks and aggregates |
//!
//! All of them analyse the pattern once, refill preallocated buffers afterwards, and give the same bits whatever the number
//! of threads. faer is used in here and nowhere else.

use std::fmt;
use std::sync::Arc;

use thiserror::Error;

use super::{BlockStructure, NormalEquations};

mod block_jacobi;
mod bordered;
mod bounded;
mod box_qp;
mod dense;
mod front;
mod isotropic;
mod layout;
mod multifrontal;
mod ordering;
mod pcg;
mod scratch;
mod supernodal;
mod two_level;
mod vector;

pub(super) use block_jacobi::BLOCK_JACOBI;
pub use block_jacobi::BlockJacobi;
pub use bordered::{BorderedCholesky, ReducedSystem};
pub(super) use bounded::{BoundedStep, inverse_of_reduced};
pub(super) use box_qp::Side;
pub use dense::DenseCholesky;
pub use pcg::Pcg;
pub(crate) use vector::dot;

/// A pivot that keeps less than this share of its diagonal entry is rounding error, and the matrix numerically singular.
///
/// A pivot of Cholesky's method is the diagonal entry minus a sum of squares; when all but the last two digits cancel, its
/// value carries no information and the step that it would give is noise.
pub const PIVOT_TOLERANCE: f64 = 1e-14;

/// Below this many tangent coordinates [`choose`] prefers one dense factorisation to any sparse one.
pub const DENSE_DIMENSION: usize = 48;

/// Above so many numbers in the factor of the sparse blocks, a quarter of a gigabyte, [`choose`] prefers [`BlockJacobi`]: on faces at some
/// 9,000 nodes, or 6,500 vertices with an affine map each. Where the two take equal time differs by a factor of ten (less for large
/// blocks and for graphs in space, more for stiff graphs with blendshapes); where it matters, try both.
pub const FACTOR_NUMBERS: usize = 1 << 25;

/// One tangent coordinate, named by the block it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coordinate {
    /// A coordinate of a sparse block.
    Block {
        /// Index of the block.
        block: usize,
        /// Tangent coordinate inside the block.
        component: usize,
    },
    /// A coordinate of the dense border.
    Border {
        /// Index inside the border.
        index: usize,
    },
}

impl Coordinate {
    /// The name of tangent coordinate `i` of `structure`.
    ///
    /// # Panics
    /// If `i` is not less than [`BlockStructure::dimension`].
    #[must_use]
    pub fn of(structure: &BlockStructure, i: usize) -> Self {
        assert!(i < structure.dimension(), "coordinate {i} of {}", structure.dimension());
        let sparse = structure.sparse_dimension();
        if i >= sparse {
            return Self::Border { index: i - sparse };
        }
        let (mut low, mut high) = (0, structure.block_count());
        while high - low > 1 {
            let mid = (low + high) / 2;
            if structure.offset(mid) <= i { low = mid } else { high = mid }
        }
        Self::Block { block: low, component: i - structure.offset(low) }
    }
}

impl fmt::Display for Coordinate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Block { block, component } => write!(f, "coordinate {component} of block {block}"),
            Self::Border { index } => write!(f, "border coordinate {index}"),
        }
    }
}

/// Why no step could be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinearError {
    /// A pivot is not positive, or is rounding error: nothing in the energy observes this direction.
    #[error("the normal equations are not positive definite at {at}; regularise it, or set a damping floor")]
    NotPositiveDefinite {
        /// The coordinate whose pivot failed (coordinates eliminated before it may share the blame).
        at: Coordinate,
    },
    /// A diagonal entry is negative, which no sum of squares is.
    #[error("negative entry on the diagonal of the normal equations at {at}; the weight of a residual is negative")]
    NegativeDiagonal {
        /// The first coordinate with such an entry.
        at: Coordinate,
    },
    /// The equations contain an infinity or a NaN, or are so badly scaled that the step does.
    #[error(
        "non-finite value in the normal equations at {at}; a residual or its derivative is not finite there, or one by the border is beyond 3e38 in an `Assembly`"
    )]
    NonFinite {
        /// The first coordinate whose row or gradient is not finite.
        at: Coordinate,
    },
    /// A search direction along which the quadratic model does not curve upwards.
    #[error(
        "conjugate gradients met a direction without positive curvature in iteration {iteration}: the normal equations or their preconditioner are not positive definite"
    )]
    NoCurvature {
        /// Iteration, from 1.
        iteration: usize,
    },
    /// The step between the bounds was not found: rounding leads from one set of coordinates at their bounds to the next.
    #[error(
        "no step between the bounds was found in {rounds} rounds; the normal equations are too ill-conditioned: regularise them, or set a damping floor"
    )]
    NoActiveSet {
        /// Rounds made.
        rounds: usize,
    },
    /// The residual did not fall below the tolerance.
    #[error(
        "conjugate gradients did not converge in {iterations} iterations; the normal equations are too ill-conditioned for the preconditioner"
    )]
    NotConverged {
        /// Iterations made.
        iterations: usize,
    },
}

/// Solves the normal equations; swap in your own through [`Workspace::with_linear_solver`](super::Workspace::with_linear_solver).
pub trait LinearSolver: fmt::Debug + Send {
    /// Writes the solution `d` of `(H + diag(damping)) d = -g` to `step`.
    ///
    /// `damping` has [`BlockStructure::dimension`] entries, or none for no damping. On an error `step` is unspecified.
    ///
    /// # Errors
    /// [`LinearError`] when the damped matrix is not numerically positive definite, or not finite.
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError>;

    /// How many pivots of the last factorisation were held up by damping alone: directions that nothing in the energy observes. 0 when
    /// unknown.
    ///
    /// The factorisations count coordinates whose diagonal entry in H is zero, and those whose damping is at most a millionth of that
    /// entry and at least half of the pivot: without damping it would be at most a millionth too. Stronger damping hides what it
    /// holds, so that nothing else is counted then.
    fn unobserved_pivots(&self) -> usize {
        0
    }

    /// The border's system of the last successful [`solve`](Self::solve), for steps under bounds. `None` from solvers that do not
    /// eliminate the sparse blocks: for steps that run into a bound the minimiser then does that with a solver of its own.
    fn elimination(&mut self) -> Option<&mut BorderedCholesky> {
        None
    }

    /// Iterations of the last [`solve`](Self::solve); `None` from direct solvers.
    fn iterations(&self) -> Option<usize> {
        None
    }

    /// A short name for reports, such as `"bordered Cholesky"`.
    fn name(&self) -> &'static str;
}

/// Which linear solver to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinearSolverKind {
    /// By structure, see [`choose`].
    #[default]
    Auto,
    /// [`DenseCholesky`].
    Dense,
    /// [`BorderedCholesky`], the sparse one where there is no border.
    Bordered,
    /// [`BlockJacobi`].
    BlockJacobi,
}

/// No linear solver has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("no linear solver is called {0:?}; there are {names}", names = LinearSolverKind::ALL.map(LinearSolverKind::name).join(", "))]
pub struct UnknownLinearSolver(pub String);

impl std::str::FromStr for LinearSolverKind {
    type Err = UnknownLinearSolver;

    fn from_str(name: &str) -> Result<Self, UnknownLinearSolver> {
        // What the one without a border used to be called.
        let known = if name == "sparse" { "bordered" } else { name };
        let is = |kind: &Self| kind.name() == known.replace('_', "-");
        Self::ALL.into_iter().find(is).ok_or_else(|| UnknownLinearSolver(name.to_owned()))
    }
}

impl fmt::Display for LinearSolverKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl LinearSolverKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Auto, Self::Dense, Self::Bordered, Self::BlockJacobi];

    /// Its name on command lines, such as `"block-jacobi"`; they also take that of schedules, `"block_jacobi"`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Dense => "dense",
            Self::Bordered => "bordered",
            Self::BlockJacobi => "block-jacobi",
        }
    }

    /// A solver of this kind, with its symbolic analysis done.
    #[must_use]
    pub fn build(self, structure: &Arc<BlockStructure>) -> Box<dyn LinearSolver> {
        match self {
            Self::Auto => choose(structure),
            Self::Dense => Box::new(DenseCholesky::new(structure)),
            Self::Bordered => Box::new(BorderedCholesky::new(structure)),
            Self::BlockJacobi => Box::new(BlockJacobi::new(structure)),
        }
    }
}

/// The solver that suits a structure, by size alone: [`DenseCholesky`] without sparse blocks or with at most [`DENSE_DIMENSION`]
/// coordinates; [`BorderedCholesky`] while the factor of the blocks holds at most [`FACTOR_NUMBERS`] numbers; else [`BlockJacobi`].
/// Minimisers name the solver and the rule in their [`Summary`](super::Summary).
#[must_use]
pub fn choose(structure: &Arc<BlockStructure>) -> Box<dyn LinearSolver> {
    if structure.sparse_dimension() == 0 || structure.dimension() <= DENSE_DIMENSION {
        return Box::new(DenseCholesky::new(structure));
    }
    let cholesky = BorderedCholesky::new(structure);
    if cholesky.factor_numbers() <= FACTOR_NUMBERS { Box::new(cholesky) } else { Box::new(BlockJacobi::new(structure)) }
}

/// Is `a` the pattern that a solver has analysed as `b`? Pointer comparison first, so the usual case costs nothing.
fn same_structure(a: &Arc<BlockStructure>, b: &Arc<BlockStructure>) -> bool {
    Arc::ptr_eq(a, b) || a == b
}

/// The damping of coordinate `i`; an empty slice damps nothing.
fn damping_at(damping: &[f64], i: usize) -> f64 {
    damping.get(i).copied().unwrap_or(0.0)
}

/// Damping of up to this share of the diagonal entry tells by its pivot whether anything but damping holds a coordinate.
const LIGHT_DAMPING: f64 = 1e-6;

/// Judges one pivot (the square of a diagonal entry of L) against its damped diagonal entry; counts it if damping alone holds it up.
/// `own` is the diagonal entry of H.
///
/// Damping does not lower what the others leave of a diagonal entry: without any, the pivot is at most `pivot - damping`.
fn pivot_is_sound(pivot: f64, own: f64, damping: f64, weak: &mut usize) -> bool {
    let light = damping <= LIGHT_DAMPING * own || own == 0.0;
    if damping > 0.0 && light && pivot <= 2.0 * damping {
        *weak += 1;
    }
    pivot > PIVOT_TOLERANCE * (own + damping) && pivot.is_finite()
}

/// The error for a factorisation that broke down at tangent coordinate `i`: non-finite input is named before its consequence.
fn breakdown(equations: &NormalEquations, damping: &[f64], i: usize) -> LinearError {
    let at = Coordinate::of(equations.structure(), i);
    cause(equations, damping, LinearError::NotPositiveDefinite { at })
}

/// What is behind an error: input that is not finite, or no sum of squares, if there is any.
fn cause(equations: &NormalEquations, damping: &[f64], error: LinearError) -> LinearError {
    let s = equations.structure();
    if let Some(i) = first_non_finite(equations, damping) {
        return LinearError::NonFinite { at: Coordinate::of(s, i) };
    }
    match (0..s.dimension()).find(|&i| equations.diagonal(i) < 0.0) {
        Some(i) => LinearError::NegativeDiagonal { at: Coordinate::of(s, i) },
        None => error,
    }
}

/// `Err` if the step is not finite.
fn check_step(equations: &NormalEquations, damping: &[f64], step: &[f64]) -> Result<(), LinearError> {
    match step.iter().position(|d| !d.is_finite()) {
        None => Ok(()),
        Some(i) => {
            let i = first_non_finite(equations, damping).unwrap_or(i);
            Err(LinearError::NonFinite { at: Coordinate::of(equations.structure(), i) })
        }
    }
}

/// The first tangent coordinate whose gradient, damping or row of the matrix is not finite.
fn first_non_finite(equations: &NormalEquations, damping: &[f64]) -> Option<usize> {
    let s = equations.structure();
    let (sparse, border) = (s.sparse_dimension(), s.border());
    let bad = |values: &[f64]| values.iter().any(|v| !v.is_finite());
    for i in 0..s.block_count() {
        let rows = s.offset(i)..s.offset(i) + s.size(i);
        if bad(&equations.blocks[s.row_values(i)]) {
            return Some(rows.start);
        }
        for r in rows {
            if !equations.gradient[r].is_finite() {
                return Some(r);
            }
            // The block's own derivatives are finite.
            if let Some(k) = equations.cross[r * border..(r + 1) * border].iter().position(|v| !v.is_finite()) {
                return Some(sparse + k);
            }
        }
    }
    for r in 0..border {
        if bad(&equations.border[r * border..=r * border + r]) || !equations.gradient[sparse + r].is_finite() {
            return Some(sparse + r);
        }
    }
    damping.iter().position(|d| !d.is_finite())
}

#[cfg(test)]
mod tests;
