//! What a minimisation did: energies, iterations, times, and why it stopped.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use super::{Algorithm, Options};
use crate::nlls::linear::{BLOCK_JACOBI, FACTOR_NUMBERS};
use crate::nlls::{BlockStructure, BoundsError, LinearError, LinearSolverKind};

/// Which criterion was met.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Convergence {
    /// The energy no longer falls.
    Energy,
    /// The parameters no longer move.
    Step,
    /// The gradient vanishes, or points out of the bounds.
    Gradient,
}

/// Why a minimisation ended.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// A tolerance was met.
    Converged(Convergence),
    /// The limit on iterations was reached.
    MaxIterations,
    /// No step along the computed direction lowers the energy. The last accepted parameters are kept.
    NoDecrease,
    /// No step could be computed. The last accepted parameters are kept.
    LinearSolverFailed(LinearError),
    /// The energy of the start is not finite: [`ResidualProblem::non_finite`](crate::nlls::ResidualProblem::non_finite) names the residual.
    NonFinite,
    /// The observer asked to stop.
    StoppedByObserver,
    /// The bounds leave nothing to choose. The parameters are those of the start.
    InvalidBounds(BoundsError),
}

impl StopReason {
    /// The parameters are usable and no worse than the start: converged, out of iterations, or stopped on request.
    #[must_use]
    pub fn was_successful(&self) -> bool {
        matches!(self, Self::Converged(_) | Self::MaxIterations | Self::StoppedByObserver)
    }

    /// A tolerance was met.
    #[must_use]
    pub fn converged(&self) -> bool {
        matches!(self, Self::Converged(_))
    }
}

impl From<LinearError> for StopReason {
    fn from(error: LinearError) -> Self {
        Self::LinearSolverFailed(error)
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged(Convergence::Energy) => write!(f, "converged: the energy no longer falls"),
            Self::Converged(Convergence::Step) => write!(f, "converged: the parameters no longer move"),
            Self::Converged(Convergence::Gradient) => write!(f, "converged: the gradient vanishes"),
            Self::MaxIterations => write!(f, "stopped at the limit on iterations, not converged"),
            Self::NoDecrease => write!(f, "failed: no step lowers the energy"),
            Self::LinearSolverFailed(e) => write!(f, "failed: {e}"),
            Self::NonFinite => write!(
                f,
                "failed: the energy of the start is not finite; `ResidualProblem::non_finite` says which residual is not"
            ),
            Self::StoppedByObserver => write!(f, "stopped by the observer"),
            Self::InvalidBounds(e) => write!(f, "failed: {e}"),
        }
    }
}

/// Wall time of the three stages of an iteration. Not reproducible: kept out of comparisons and of serialised summaries.
#[derive(Debug, Clone, Copy, Default)]
pub struct StageTimes {
    /// Residuals, derivatives and normal equations.
    pub linearize: Duration,
    /// Linear solver.
    pub solve: Duration,
    /// Energies of step trials.
    pub energy: Duration,
}

impl StageTimes {
    /// All stages together.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.linearize + self.solve + self.energy
    }
}

impl std::ops::AddAssign for StageTimes {
    fn add_assign(&mut self, other: Self) {
        self.linearize += other.linearize;
        self.solve += other.solve;
        self.energy += other.energy;
    }
}

/// One step, accepted or not.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct IterationRecord {
    /// Counts from 1.
    pub iteration: usize,
    /// Energy E after the iteration.
    pub energy: f64,
    /// By how much the iteration lowered it; 0 if the step was rejected.
    pub decrease: f64,
    /// Largest entry of the gradient of E/2 at the point where the step starts; of `w - P(w - gradient)` for border coordinates
    /// with bounds, P being the projection between them.
    pub gradient_norm: f64,
    /// Euclidean norm of the tangent step that was taken; of the rejected one, if it was.
    pub step_norm: f64,
    /// Share of the full step that was taken: 1, or 1/2, 1/4, .. after halvings.
    pub step_scale: f64,
    /// Damping with which the step was computed, relative to the diagonal of H: lambda of Levenberg-Marquardt, mu of dogleg;
    /// 0 in Gauss-Newton.
    pub lambda: f64,
    /// Radius of dogleg's trust region, in its scaled norm; infinite (`null` when serialised) in the others.
    pub radius: f64,
    /// Achieved over predicted decrease; NaN (`null` when serialised) if no step could be computed.
    pub gain: f64,
    /// The step was accepted.
    pub accepted: bool,
    /// Directions in which nothing but damping holds the parameters, as far as the damping of this step is light enough to tell: see
    /// [`LinearSolver::unobserved_pivots`](crate::nlls::LinearSolver::unobserved_pivots).
    pub unobserved_directions: usize,
    /// Iterations of the linear solver; 0 from direct ones.
    pub linear_iterations: usize,
    /// Wall times; not serialised.
    #[serde(skip)]
    pub times: StageTimes,
}

/// Size of a problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct ProblemSize {
    /// Ambient coordinates.
    pub parameters: usize,
    /// Tangent coordinates.
    pub tangent: usize,
    /// Sparse blocks.
    pub blocks: usize,
    /// Stored blocks of the lower triangle of `H_gg`.
    pub hessian_blocks: usize,
    /// Tangent coordinates in the dense border.
    pub border: usize,
}

impl ProblemSize {
    pub(super) fn of(structure: &BlockStructure, parameters: usize) -> Self {
        Self {
            parameters,
            tangent: structure.dimension(),
            blocks: structure.block_count(),
            hessian_blocks: structure.slot_count(),
            border: structure.border(),
        }
    }
}

/// The report of one minimisation. `Display` prints all of it; serialised, it holds nothing that changes from run to run.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// What was asked for.
    pub options: Options,
    /// Size of the problem.
    pub size: ProblemSize,
    /// The linear solver that was used.
    pub linear_solver: &'static str,
    /// E at the start.
    pub initial_energy: f64,
    /// E at the end.
    pub final_energy: f64,
    /// Number of steps, rejected ones included.
    pub iterations: usize,
    /// Why it ended.
    pub stop: StopReason,
    /// One record a step.
    pub records: Vec<IterationRecord>,
    /// Wall times of the stages, over all iterations; not serialised.
    #[serde(skip)]
    pub times: StageTimes,
    /// Wall time altogether; not serialised.
    #[serde(skip)]
    pub total_time: Duration,
}

impl Summary {
    pub(super) fn empty() -> Self {
        Self {
            options: Options::default(),
            size: ProblemSize::default(),
            linear_solver: "none",
            initial_energy: f64::NAN,
            final_energy: f64::NAN,
            iterations: 0,
            stop: StopReason::MaxIterations,
            records: Vec::new(),
            times: StageTimes::default(),
            total_time: Duration::ZERO,
        }
    }

    /// Number of accepted steps.
    #[must_use]
    pub fn accepted_steps(&self) -> usize {
        self.records.iter().filter(|r| r.accepted).count()
    }

    /// Most directions that damping alone held in any iteration, as far as [the records](IterationRecord::unobserved_directions)
    /// tell.
    #[must_use]
    pub fn unobserved_directions(&self) -> usize {
        self.records.iter().map(|r| r.unobserved_directions).max().unwrap_or(0)
    }

    /// The full report without wall times: equal runs give equal text.
    #[must_use]
    pub fn deterministic_report(&self) -> String {
        let mut text = String::new();
        self.write(&mut text, false).expect("writing to a string does not fail");
        text
    }

    fn write(&self, f: &mut dyn fmt::Write, times: bool) -> fmt::Result {
        let o = &self.options;
        let algorithm = match o.algorithm {
            Algorithm::GaussNewton(_) => "Gauss-Newton, backtracking",
            Algorithm::LevenbergMarquardt(_) => "Levenberg-Marquardt",
            Algorithm::Dogleg(_) => "dogleg",
        };
        let asked = match o.linear_solver {
            LinearSolverKind::Auto if self.linear_solver == BLOCK_JACOBI => {
                format!("by size: a factor would hold more than {FACTOR_NUMBERS} numbers")
            }
            LinearSolverKind::Auto => "by size".to_owned(),
            kind => format!("asked for: {kind}"),
        };
        writeln!(f, "Minimisation report")?;
        writeln!(f, "  parameters      {:>12}   tangent coordinates {}", self.size.parameters, self.size.tangent)?;
        writeln!(
            f,
            "  sparse blocks   {:>12}   stored blocks of H {}, border {}",
            self.size.blocks, self.size.hessian_blocks, self.size.border
        )?;
        writeln!(f, "  algorithm       {algorithm}")?;
        writeln!(f, "  linear solver   {} ({asked})", self.linear_solver)?;
        writeln!(
            f,
            "  tolerances      energy {:e}, step {:e}, gradient {:e}; at most {} iterations",
            o.energy_tolerance, o.step_tolerance, o.gradient_tolerance, o.max_iterations
        )?;
        writeln!(f)?;
        write!(f, "  iter        energy      decrease   |gradient|       |step|   scale    lambda    radius     gain")?;
        writeln!(f, "{}", if times { "        ms" } else { "" })?;
        writeln!(f, "  {:>4}  {:>12.6e}", 0, self.initial_energy)?;
        for r in &self.records {
            write!(
                f,
                "  {:>4}  {:>12.6e}  {:>12.4e} {:>12.4e} {:>12.4e} {:>7.4} {:>9.1e} {:>9.1e} {:>8.3}",
                r.iteration,
                r.energy,
                r.decrease,
                r.gradient_norm,
                r.step_norm,
                r.step_scale,
                r.lambda,
                r.radius,
                r.gain
            )?;
            if times {
                write!(f, " {:>9.3}", r.times.total().as_secs_f64() * 1e3)?;
            }
            writeln!(f, "{}", if r.accepted { "" } else { "  rejected" })?;
        }
        writeln!(f)?;
        writeln!(f, "  energy          {:.9e} -> {:.9e}", self.initial_energy, self.final_energy)?;
        writeln!(f, "  iterations      {} ({} accepted)", self.iterations, self.accepted_steps())?;
        if self.unobserved_directions() > 0 {
            writeln!(f, "  unobserved      {} directions are held by damping alone", self.unobserved_directions())?;
        }
        if times {
            let ms = |d: Duration| d.as_secs_f64() * 1e3;
            writeln!(
                f,
                "  time            {:.3} ms: linearise {:.3}, solve {:.3}, energy {:.3}, rest {:.3}",
                ms(self.total_time),
                ms(self.times.linearize),
                ms(self.times.solve),
                ms(self.times.energy),
                ms(self.total_time.saturating_sub(self.times.total()))
            )?;
        }
        write!(f, "  {}", self.stop)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f, true)
    }
}
