//! Generic nonlinear least squares. Knows nothing of meshes.
//!
//! ```text
//!     min E(x),   E(x) = sum_m alpha_m rho( |r_m(x)|^2 )          no factor 1/2 in E
//!     (H + D) d = -g,   x <- x [+] d                              g and H are those of E/2
//! ```
//!
//! | to do this | use |
//! |---|---|
//! | state a problem residual by residual | [`Residual`], [`Family`], [`ResidualProblem`] |
//! | bring derivatives of your own | [`Problem`], [`BlockStructure`], [`NormalEquations`] |
//! | minimise | [`Minimizer`], [`Options`], [`Workspace`], [`Summary`] |
//! | watch and stop | [`Observer`] |
//! | resist outliers | [`Kernel`], [`RobustKernel`], [`mad_scale`] |
//! | hold parameters between bounds | [`Problem::border_bounds`], [`Bounded`] |
//! | ask how well parameters are known | [`border_covariance`] |
//! | move on a manifold | [`Manifold`], [`So3`], [`UnitQuaternion`], [`Se3`], [`Sim3`] |
//! | solve linear equations | [`linear`], [`LinearSolver`] |
//! | distrust what you wrote | [`check_gradient`], [`check_hessian`], [`check_manifold`], [`check_kernel`] |
//!
//! For users of Ceres: a `CostFunction` is a [`Residual`], a `LossFunction` a [`RobustKernel`] (same convention), a `Manifold`
//! a [`Manifold`], a `Problem` a [`ResidualProblem`], `Solver::Summary` a [`Summary`]. Ceres minimises E/2: its costs are half
//! of our energies, its gradients are equal to ours. What is fixed by structure there (`linear_solver_ordering`) is said when
//! a block is added: [`add_block`](ResidualProblemBuilder::add_block) or
//! [`add_border_block`](ResidualProblemBuilder::add_border_block).
//!
//! Results are the same bits at any number of threads, and after its first iteration a [`Workspace`] allocates nothing.
//! This module may import nothing from the rest of the crate.

mod bounds;
mod check;
mod covariance;
pub(crate) mod dense_kernels;
mod error;
mod kernel;
pub mod linear;
pub mod manifold;
pub mod minimizer;
mod normal_equations;
mod parallel;
mod problem;
mod residual;
mod scalar;
mod structure;

pub use bounds::{BorderBounds, Bounded, BoundsError};
pub use check::{GradientCheck, GradientEntry, GradientReport, HessianReport, check_gradient, check_hessian};
pub use covariance::border_covariance;
pub use error::OptionError;
pub use kernel::{Kernel, RobustKernel, Scaled, check_kernel, mad_scale};
pub use linear::{LinearError, LinearSolver, LinearSolverKind, UnknownLinearSolver};
pub use manifold::{
    Euclidean, Manifold, PointArray, QuaternionSe3, Se3, Sim3, So3, UnitQuaternion, check_manifold, so3,
};
pub use minimizer::{
    Algorithm, Convergence, Dogleg, GaussNewton, IterationRecord, LevenbergMarquardt, Minimizer, Observer, Options,
    ProblemSize, Silent, StageTimes, StopReason, Summary, Workspace,
};
pub use normal_equations::{BlockRow, NormalEquations};
pub use problem::Problem;
pub use residual::{
    BlockId, BlockList, Family, FamilyId, ProblemError, Residual, ResidualProblem, ResidualProblemBuilder,
};
pub use scalar::Scalar;
pub use structure::{BlockStructure, StructureError};
