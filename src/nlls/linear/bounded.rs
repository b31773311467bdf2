//! Steps of the normal equations under bounds of the border's coordinates.
//!
//! ```text
//!     min 1/2 d' H d + g' d    subject to  l <= d_w <= u,   d_g free
//! ```
//!
//! The sparse blocks are free, so they are eliminated as ever; what is left is the same in the border alone, with the Schur
//! complement S and the reduced gradient s in place of H and g ([`ReducedSystem`](super::ReducedSystem)): a small program in a
//! box, solved exactly. Back substitution completes the step. H stands for the damped matrix where there is damping.

use super::box_qp::{BoxQp, Program, Side, Unsolved};
use super::{BorderedCholesky, Coordinate, LinearError, LinearSolver, breakdown, cause, check_step, damping_at};
use crate::nlls::NormalEquations;

/// What bounded steps need beside the linear solver.
#[derive(Debug)]
pub(in crate::nlls) struct BoundedStep {
    program: BoxQp,
    pivots: Vec<f64>,
    /// For solvers that do not keep the border's system themselves.
    elimination: Option<BorderedCholesky>,
}

impl BoundedStep {
    /// Buffers for equations like these and the given solver.
    pub(in crate::nlls) fn new(equations: &NormalEquations, solver: &mut dyn LinearSolver) -> Self {
        let structure = equations.structure();
        Self {
            program: BoxQp::new(structure.border()),
            pivots: vec![0.0; structure.border()],
            elimination: solver.elimination().is_none().then(|| BorderedCholesky::new(structure)),
        }
    }

    /// At which of its bounds each coordinate of the last step ends.
    pub(in crate::nlls) fn sides(&self) -> &[Side] {
        self.program.sides()
    }

    /// [`LinearSolver::solve`] with `lower <= d_w <= upper`, one bound per border coordinate, `lower <= 0 <= upper`.
    ///
    /// If the step of the linear solver keeps the bounds, it is taken as it is: bounds out of reach change no bit.
    pub(in crate::nlls) fn solve(
        &mut self,
        solver: &mut dyn LinearSolver,
        equations: &NormalEquations,
        damping: &[f64],
        [lower, upper]: [&[f64]; 2],
        step: &mut [f64],
    ) -> Result<(), LinearError> {
        let n = equations.structure().sparse_dimension();
        match solver.solve(equations, damping, step) {
            Ok(()) => {
                if step[n..].iter().zip(lower.iter().zip(upper)).all(|(d, (l, u))| l <= d && d <= u) {
                    self.program.release();
                    return Ok(());
                }
            }
            // The free coordinates alone may be well determined.
            Err(LinearError::NotPositiveDefinite { at: Coordinate::Border { .. } }) => {}
            Err(error) => return Err(error),
        }
        let elimination = match solver.elimination() {
            Some(elimination) => elimination,
            None => {
                let own = self.elimination.get_or_insert_with(|| BorderedCholesky::new(equations.structure()));
                own.reduce(equations, damping)?;
                own
            }
        };
        for (k, pivot) in self.pivots.iter_mut().enumerate() {
            *pivot = equations.diagonal(n + k) + damping_at(damping, n + k);
        }
        let reduced = elimination.reduced();
        let program =
            Program { matrix: reduced.matrix, gradient: reduced.gradient, pivots: &self.pivots, lower, upper };
        self.program.solve(&program, &mut step[n..]).map_err(|unsolved| match unsolved {
            Unsolved::Flat(k) => breakdown(equations, damping, n + k),
            Unsolved::Rounds(rounds) => cause(equations, damping, LinearError::NoActiveSet { rounds }),
        })?;
        elimination.back_substitute(step);
        check_step(equations, damping, step)
    }
}

/// The inverse of the Schur complement of the border: `sigma^2` times this is the covariance of its coordinates. Rows and columns
/// of coordinates that are `held` are zero, and the others' are those of the system without them.
pub(in crate::nlls) fn inverse_of_reduced(
    elimination: &mut BorderedCholesky,
    equations: &NormalEquations,
    damping: &[f64],
    held: impl Fn(usize) -> bool,
) -> Result<nalgebra::DMatrix<f64>, LinearError> {
    let (n, m) = (equations.structure().sparse_dimension(), equations.structure().border());
    let free: Vec<usize> = (0..m).filter(|&k| !held(k)).collect();
    let reduced = elimination.reduce(equations, damping)?;
    let mut factor = super::dense::DenseFactor::new(free.len());
    let l = factor.matrix_mut();
    for (c, &i) in free.iter().enumerate() {
        for (r, &j) in free.iter().enumerate() {
            l[c * free.len() + r] = reduced.matrix[i * m + j];
        }
    }
    factor
        .factorize(|k| equations.diagonal(n + free[k]), |_| 0.0)
        .map_err(|k| breakdown(equations, damping, n + free[k]))?;
    let mut inverse = nalgebra::DMatrix::zeros(m, m);
    let mut column = vec![0.0; free.len()];
    for (c, &i) in free.iter().enumerate() {
        column.fill(0.0);
        column[c] = 1.0;
        factor.solve(&mut column);
        for (v, &j) in column.iter().zip(&free).skip(c) {
            inverse[(i, j)] = *v;
            inverse[(j, i)] = *v;
        }
    }
    Ok(inverse)
}
