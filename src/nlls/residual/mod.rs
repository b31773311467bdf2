//! Residual families: any residuals over any parameter blocks, differentiated by dual numbers.
//!
//! ```text
//!     E(x) = sum_families alpha sum_m rho( |r_m(x)|^2 )
//!
//!     J_m = d r_m(x [+] delta) / d delta at delta = 0        one pass with duals of static width, all blocks of r_m at once
//!     w_m = alpha rho'(|r_m|^2)
//!     g  += w_m J_m' r_m          H += w_m J_m' J_m
//! ```
//!
//! Linearising has two phases, both parallel and both independent of the number of threads: every residual writes its own
//! slot (r, J, w); then every block row sums the residuals that touch it, in the order in which they were added.

mod analytic;
mod block;
mod builder;
mod family;
mod problem;
#[cfg(test)]
mod tests;

use std::any::TypeId;

use thiserror::Error;

use super::manifold::{Manifold, PointArray};
use super::{BoundsError, OptionError, Scalar};

pub use analytic::AnalyticFamily;
pub use builder::ResidualProblemBuilder;
pub use family::Family;
pub use problem::ResidualProblem;

/// A residual with `R` entries over blocks with `T` tangent coordinates altogether.
///
/// ```
/// use nonrigid::nlls::{Residual, Scalar, Se3};
///
/// /// A point of a rigid body, measured: r = T p - q.
/// struct Measured { p: [f64; 3], q: [f64; 3] }
///
/// impl Residual<3, 6> for Measured {
///     type Blocks = (Se3,);
///
///     fn evaluate<D: Scalar>(&self, (pose,): &([D; 12],)) -> [D; 3] {
///         let moved = Se3::transform(pose, self.p.map(D::from));
///         std::array::from_fn(|i| moved[i] - self.q[i])
///     }
/// }
/// ```
///
/// `T` is the width of the dual numbers. It must be the sum of the blocks' `TANGENT`; a wrong sum does not compile.
pub trait Residual<const R: usize, const T: usize>: Send + Sync + 'static {
    /// The manifolds of the parameter blocks, as a tuple: `(Se3, Euclidean<2>)`.
    type Blocks: BlockList;

    /// The residual at the points of its blocks.
    fn evaluate<D: Scalar>(&self, points: &<Self::Blocks as BlockList>::Points<D>) -> [D; R];
}

/// A residual that brings its Jacobian, over `K` blocks of any manifolds, with as many entries as it says at run time.
///
/// ```
/// use nonrigid::nlls::{AnalyticFamily, AnalyticResidual, Euclidean, Minimizer, Options, ResidualProblem};
///
/// /// Differences of a polynomial from samples: r_i = sum_k c_k t_i^k - y_i.
/// struct Polynomial { t: Vec<f64>, y: Vec<f64> }
///
/// impl AnalyticResidual<1> for Polynomial {
///     fn len(&self) -> usize { self.t.len() }
///
///     fn evaluate(&self, [c]: [&[f64]; 1], residual: &mut [f64], jacobian: Option<&mut [f64]>) {
///         for (i, t) in self.t.iter().enumerate() {
///             residual[i] = c.iter().rev().fold(0.0, |sum, c| sum * t + c) - self.y[i];
///         }
///         for (row, t) in jacobian.into_iter().flat_map(|j| j.chunks_exact_mut(c.len())).zip(&self.t) {
///             row.iter_mut().enumerate().for_each(|(k, d)| *d = t.powi(k as i32));
///         }
///     }
/// }
///
/// let mut builder = ResidualProblem::builder();
/// let c = builder.add_block::<Euclidean<3>>(&[0.0; 3]);
/// let samples = Polynomial { t: vec![-1.0, 0.0, 1.0, 2.0], y: vec![6.0, 1.0, 2.0, 9.0] };
/// builder.add_analytic_family(AnalyticFamily::new(vec![samples], &[[c]]));
/// let mut problem = builder.build()?;
/// let mut x = problem.initial();
/// Minimizer::new(Options::gauss_newton())?.minimize(&mut problem, &mut x);
/// assert!((x[0] - 1.0).abs() < 1e-12 && (x[1] + 2.0).abs() < 1e-12 && (x[2] - 3.0).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// [`check_gradient`](super::check_gradient) compares the Jacobian with finite differences of the energy.
pub trait AnalyticResidual<const K: usize>: Send + Sync + 'static {
    /// Number of entries; asked once, when the problem is built.
    fn len(&self) -> usize;

    /// Whether it has no entries.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes the residual at the points (ambient coordinates) of its blocks to `residual` and, if asked for, its derivatives by the
    /// blocks' tangent coordinates to `jacobian`: row-major, zero when it is handed over, [`len`](Self::len) rows with the columns of
    /// all blocks side by side.
    fn evaluate(&self, points: [&[f64]; K], residual: &mut [f64], jacobian: Option<&mut [f64]>);
}

/// Tuples of one to six [`Manifold`]s.
pub trait BlockList: 'static {
    /// A tuple of arrays, one a block.
    type Points<D: Scalar>;
    /// `[BlockId; COUNT]`.
    type Ids: AsRef<[BlockId]>;
    /// Number of blocks.
    const COUNT: usize;
    /// Tangent coordinates of all blocks.
    const TANGENT: usize;
    /// Type and tangent dimension of each block.
    fn manifolds() -> Vec<(TypeId, &'static str, usize)>;
    /// Copies the points `x(0), x(1), ..`.
    fn load<'a>(x: impl Fn(usize) -> &'a [f64]) -> Self::Points<f64>;
    /// Moves the points `x(0), x(1), ..` by the tangent steps laid one after the other in `delta`.
    fn plus<'a, D: Scalar>(x: impl Fn(usize) -> &'a [f64], delta: &[D]) -> Self::Points<D>;
}

macro_rules! block_list {
    ($count:literal: $($m:ident $k:tt),+) => {
        impl<$($m: Manifold),+> BlockList for ($($m,)+) {
            type Points<D: Scalar> = ($($m::Point<D>,)+);
            type Ids = [BlockId; $count];
            const COUNT: usize = $count;
            const TANGENT: usize = 0 $(+ $m::TANGENT)+;

            fn manifolds() -> Vec<(TypeId, &'static str, usize)> {
                vec![$((TypeId::of::<$m>(), std::any::type_name::<$m>(), $m::TANGENT)),+]
            }

            fn load<'a>(x: impl Fn(usize) -> &'a [f64]) -> Self::Points<f64> {
                ($({
                    let mut point = $m::Point::<f64>::filled(0.0);
                    point.as_mut().copy_from_slice(x($k));
                    point
                },)+)
            }

            fn plus<'a, D: Scalar>(x: impl Fn(usize) -> &'a [f64], delta: &[D]) -> Self::Points<D> {
                let mut rest = delta;
                ($({
                    let (own, others) = rest.split_at($m::TANGENT);
                    rest = others;
                    let _ = rest;
                    let mut point = $m::Point::<D>::filled(D::from(0.0));
                    $m::plus(x($k), own, point.as_mut());
                    point
                },)+)
            }
        }
    };
}

block_list!(1: A 0);
block_list!(2: A 0, B 1);
block_list!(3: A 0, B 1, C 2);
block_list!(4: A 0, B 1, C 2, D4 3);
block_list!(5: A 0, B 1, C 2, D4 3, E 4);
block_list!(6: A 0, B 1, C 2, D4 3, E 4, F 5);

/// Names a parameter block of a [`ResidualProblem`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BlockId(usize);

/// Names a family of a [`ResidualProblem`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FamilyId(usize);

/// Why a problem could not be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ProblemError {
    /// A family's residuals and lists of blocks do not pair up.
    #[error("family {family} has {residuals} residuals, but {block_lists} lists of blocks; give one list a residual")]
    LengthMismatch {
        /// Index of the family.
        family: usize,
        /// Number of residuals.
        residuals: usize,
        /// Number of lists.
        block_lists: usize,
    },
    /// A residual names a block of another problem.
    #[error("residual {residual} of family {family} names block {block}, but the problem has {blocks}")]
    BlockOutOfRange {
        /// Index of the family.
        family: usize,
        /// Index of the residual.
        residual: usize,
        /// The block.
        block: usize,
        /// Number of blocks.
        blocks: usize,
    },
    /// A block is not of the manifold that the residual is written for.
    #[error(
        "residual {residual} of family {family} wants a block of type {expected} in place {place}, but block {block} is {found}"
    )]
    WrongManifold {
        /// Index of the family.
        family: usize,
        /// Index of the residual.
        residual: usize,
        /// Position in the residual's tuple of blocks.
        place: usize,
        /// The block.
        block: usize,
        /// Manifold of the residual.
        expected: &'static str,
        /// Manifold of the block.
        found: &'static str,
    },
    /// The initial value of a block has the wrong length or is not finite.
    #[error("the initial value of block {block} ({manifold}) must be {expected} finite numbers, but is {found:?}")]
    BadInitialValue {
        /// The block.
        block: usize,
        /// Its manifold.
        manifold: &'static str,
        /// Ambient coordinates of the manifold.
        expected: usize,
        /// What was given.
        found: Vec<f64>,
    },
    /// The initial value of a block is no point of its manifold.
    #[error(
        "the initial value of block {block} is no point of {manifold}, or farther off than single precision: {found:?}; \
         normalise it, or start from the identity"
    )]
    OffManifold {
        /// The block.
        block: usize,
        /// Its manifold.
        manifold: &'static str,
        /// What was given.
        found: Vec<f64>,
    },
    /// A block with bounds is not of plain numbers.
    #[error("bounds hold plain numbers, but block {block} is {manifold}; set none on it")]
    BoundsOnManifold {
        /// The block.
        block: usize,
        /// Its manifold.
        manifold: &'static str,
    },
    /// A block of a border with bounds is not of plain numbers.
    #[error(
        "bounds hold plain numbers, but block {block} of the border is {manifold}; add it by `add_block`, not `add_border_block`"
    )]
    ManifoldBesideBounds {
        /// The block.
        block: usize,
        /// Its manifold.
        manifold: &'static str,
    },
    /// Bounds that no value can keep, or not one of each for each coordinate.
    #[error("block {block}: {source}")]
    Bounds {
        /// The block.
        block: usize,
        /// What is wrong.
        source: BoundsError,
    },
    /// A constant block does not keep its bounds.
    #[error("block {block} is held constant at a value outside its bounds; start inside, or set none on it")]
    ConstantOutOfBounds {
        /// The block.
        block: usize,
    },
    /// A weight or a kernel is out of bounds.
    #[error("family {family}: {source}")]
    Setting {
        /// Index of the family.
        family: usize,
        /// What is wrong.
        source: OptionError,
    },
}
