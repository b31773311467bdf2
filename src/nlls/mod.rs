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
//! | bring a residual's Jacobian, or its size at run time | [`AnalyticResidual`], [`AnalyticFamily`] |
//! | bring derivatives of your own | [`Problem`], [`BlockStructure`], [`NormalEquations`] |
//! | bring Jacobians of many residuals over few blocks each | [`Assembly`] |
//! | minimise | [`Minimizer`], [`Options`], [`Workspace`], [`Summary`] |
//! | watch and stop | [`Observer`] |
//! | resist outliers | [`Kernel`], [`RobustKernel`], [`mad_scale`] |
//! | hold parameters between bounds | [`set_bounds`](ResidualProblemBuilder::set_bounds), [`Problem::border_bounds`], [`Bounded`] |
//! | ask how well parameters are known | [`border_covariance`] |
//! | move on a manifold | [`Manifold`], [`So3`], [`UnitQuaternion`], [`Se3`], [`Sim3`] |
//! | solve linear equations | [`linear`], [`LinearSolver`] |
//! | distrust what you wrote | [`check_gradient`], [`check_hessian`], [`check_manifold`], [`check_kernel`] |
//!
//! A decay fitted to samples, its rate not negative:
//!
//! ```
//! use nonrigid::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar};
//!
//! struct Sample { t: f64, y: f64 }
//!
//! impl Residual<1, 2> for Sample {
//!     type Blocks = (Euclidean<2>,);
//!     fn evaluate<D: Scalar>(&self, (p,): &([D; 2],)) -> [D; 1] { [p[0] * (-p[1] * self.t).exp() - self.y] }
//! }
//!
//! let samples = [(0.0, 3.0), (1.0, 1.8), (2.0, 1.1), (3.0, 0.7)].map(|(t, y)| Sample { t, y });
//! let mut builder = ResidualProblem::builder();
//! let p = builder.add_block::<Euclidean<2>>(&[1.0, 1.0]);
//! builder.set_bounds(p, &[f64::NEG_INFINITY, 0.0], &[f64::INFINITY; 2]);
//! builder.add_family(Family::new(samples.into(), &[[p]; 4]));
//! let mut problem = builder.build()?;
//! let mut x = problem.initial();
//! let summary = Minimizer::new(Options::default())?.minimize(&mut problem, &mut x);
//! assert!(summary.stop.converged() && (x[0] - 3.0).abs() < 0.01 && (x[1] - 0.5).abs() < 0.01, "{summary}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! For users of Ceres: an `AutoDiffCostFunction` is a [`Residual`], any other `CostFunction` an [`AnalyticResidual`], a `LossFunction` a [`RobustKernel`] (same convention), a `Manifold`
//! a [`Manifold`], a `Problem` a [`ResidualProblem`], `Solver::Summary` a [`Summary`]. Ceres minimises E/2: its costs are half
//! of our energies, its gradients are equal to ours. What is fixed by structure there (`linear_solver_ordering`) is said when
//! a block is added: [`add_block`](ResidualProblemBuilder::add_block) or
//! [`add_border_block`](ResidualProblemBuilder::add_border_block).
//!
//! Results are the same bits at any number of threads, and after its first iteration a [`Workspace`] allocates nothing.
//! This module may import nothing from the rest of the crate.

mod assembly;
mod border_sum;
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

pub(crate) use assembly::FillRows;
pub use assembly::{Assembly, ItemRows};
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
    AnalyticFamily, AnalyticResidual, BlockId, BlockList, Family, FamilyId, ProblemError, Residual, ResidualProblem,
    ResidualProblemBuilder,
};
pub use scalar::Scalar;
pub use structure::{BlockStructure, StructureError};
