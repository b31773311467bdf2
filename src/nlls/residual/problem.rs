//! The problem itself: energy, equations and steps of all families together.

use std::fmt;
use std::sync::Arc;

use nalgebra::DMatrix;

use super::block::{Block, Place};
use super::builder::{Contribution, Gather, Layout, TargetKind};
use super::family::AnyFamily;
use super::{BlockId, FamilyId, ResidualProblemBuilder};
use crate::nlls::{BlockStructure, BorderBounds, Kernel, NormalEquations, OptionError, Problem};

/// A least-squares problem stated residual by residual, over parameter blocks on manifolds.
/// [The module](crate::nlls) begins with an example.
///
/// In x the sparse blocks come first, then the border, then the constant blocks, each in the order of addition.
pub struct ResidualProblem {
    pub(super) structure: Arc<BlockStructure>,
    pub(super) parameter_len: usize,
    pub(super) blocks: Vec<Block>,
    /// Ambient coordinates of every block.
    pub(super) ranges: Vec<std::ops::Range<usize>>,
    /// Blocks of the border, in order.
    pub(super) border_blocks: Vec<usize>,
    /// Lower and upper bounds of the border, if it has some.
    pub(super) bounds: Option<[Vec<f64>; 2]>,
    pub(super) families: Vec<Box<dyn AnyFamily>>,
    pub(super) layouts: Vec<Layout>,
    pub(super) sparse_gather: Gather,
    pub(super) border_gather: Gather,
}

impl fmt::Debug for ResidualProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ResidualProblem")
            .field("blocks", &self.blocks.len())
            .field("families", &self.families.len())
            .field("residuals", &self.residual_count())
            .finish_non_exhaustive()
    }
}

impl ResidualProblem {
    /// An empty builder.
    #[must_use]
    pub fn builder() -> ResidualProblemBuilder {
        ResidualProblemBuilder::default()
    }

    /// The initial values of all blocks, laid out as x.
    #[must_use]
    pub fn initial(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.parameter_len];
        for (block, range) in self.blocks.iter().zip(&self.ranges) {
            x[range.clone()].copy_from_slice(&block.initial);
        }
        x
    }

    /// The ambient coordinates of a block inside x.
    #[must_use]
    pub fn block<'x>(&self, x: &'x [f64], block: BlockId) -> &'x [f64] {
        &x[self.ranges[block.0].clone()]
    }

    /// Where a block's tangent coordinates lie in the gradient; `None` for a constant block.
    #[must_use]
    pub fn tangent_range(&self, block: BlockId) -> Option<std::ops::Range<usize>> {
        let block = &self.blocks[block.0];
        (block.place != Place::Constant).then(|| block.tangent_at..block.tangent_at + block.tangent)
    }

    /// Number of residuals in all families.
    #[must_use]
    pub fn residual_count(&self) -> usize {
        self.families.iter().map(|f| f.residual_count()).sum()
    }

    /// The first residual whose energy at `x` is not finite, by its family and its place in that.
    pub fn non_finite(&mut self, x: &[f64]) -> Option<(FamilyId, usize)> {
        self.energy(x);
        let first = |f: &dyn AnyFamily| (0..f.residual_count()).find(|&m| !f.energy_of(m).is_finite());
        self.families.iter().enumerate().find_map(|(f, family)| Some((FamilyId(f), first(family.as_ref())?)))
    }

    /// Changes the weight alpha of a family; at 0 its residuals are not evaluated.
    ///
    /// # Errors
    /// If it is negative or not finite.
    pub fn set_weight(&mut self, family: FamilyId, alpha: f64) -> Result<(), OptionError> {
        OptionError::require(alpha >= 0.0 && alpha.is_finite(), "weight", alpha, "finite and not negative")?;
        self.families[family.0].common_mut().weight = alpha;
        Ok(())
    }

    /// Changes the kernel of a family, as a graduated schedule does.
    ///
    /// # Errors
    /// If its scale or exponent is out of bounds.
    pub fn set_kernel(&mut self, family: FamilyId, kernel: Kernel) -> Result<(), OptionError> {
        kernel.validate()?;
        self.families[family.0].common_mut().kernel = Box::new(kernel);
        Ok(())
    }

    /// The residuals of a family, to change their data (not the blocks that they read); `None` if they are not of type `F`.
    pub fn residuals_mut<F: 'static>(&mut self, family: FamilyId) -> Option<&mut [F]> {
        self.families[family.0].residuals_mut().downcast_mut::<Vec<F>>().map(Vec::as_mut_slice)
    }

    /// All residuals and their Jacobian by the tangent coordinates, as of the last linearisation, each row multiplied by the
    /// square root of its weight: `g = J'r` and `H = J'J`. Dense; for diagnostics, covariances and tests.
    #[must_use]
    pub fn weighted_jacobian(&self) -> (Vec<f64>, DMatrix<f64>) {
        let all = || self.families.iter().flat_map(|f| (0..f.residual_count()).map(move |m| f.row(m)));
        let rows: usize = all().map(|(r, ..)| r.len()).sum();
        let mut jacobian = DMatrix::zeros(rows, self.structure.dimension());
        let mut residuals = Vec::with_capacity(rows);
        for (family, layout) in self.families.iter().zip(&self.layouts) {
            let width = layout.width();
            for (m, ids) in family.common().blocks.chunks_exact(family.block_count()).enumerate() {
                let (r, j, weight) = family.row(m);
                let root = weight.sqrt();
                for (r, row) in r.iter().zip(j.chunks_exact(width)) {
                    for (k, id) in ids.iter().enumerate() {
                        let Some(range) = self.tangent_range(*id) else { continue };
                        for (c, v) in range.zip(&row[layout.starts[k]..]) {
                            jacobian[(residuals.len(), c)] += root * v;
                        }
                    }
                    residuals.push(root * r);
                }
            }
        }
        (residuals, jacobian)
    }

    /// Adds what one contribution gives to its row: gradient, stored blocks, border part (whose rows are `stride` apart).
    fn contribute(&self, gather: &Gather, c: Contribution, row: &mut Row<'_>) {
        let layout = &self.layouts[c.family as usize];
        let (starts, width) = (&layout.starts, layout.width());
        let (r, j, weight) = self.families[c.family as usize].row(c.residual as usize);
        let own = starts[c.place as usize]..starts[c.place as usize + 1];
        for (r, line) in r.iter().zip(j.chunks_exact(width)) {
            for (g, v) in row.gradient.iter_mut().zip(&line[own.clone()]) {
                *g += weight * v * r;
            }
        }
        for target in &gather.targets[c.first_target as usize..][..c.target_count as usize] {
            let other = starts[target.place as usize]..starts[target.place as usize + 1];
            let (values, stride) = match target.kind {
                TargetKind::Blocks(start) => (&mut row.blocks[start as usize..], other.len()),
                TargetKind::Border(start) => (&mut row.border[start as usize..], row.stride),
            };
            for line in j.chunks_exact(width) {
                for (a, v) in line[own.clone()].iter().enumerate() {
                    let scaled = weight * v;
                    for (h, u) in values[a * stride..].iter_mut().zip(&line[other.clone()]) {
                        *h += scaled * u;
                    }
                }
            }
        }
    }
}

/// The row of a block, borrowed for writing.
struct Row<'a> {
    gradient: &'a mut [f64],
    blocks: &'a mut [f64],
    border: &'a mut [f64],
    stride: usize,
}

impl Problem for ResidualProblem {
    fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    fn parameter_len(&self) -> usize {
        self.parameter_len
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        self.families.iter_mut().map(|family| family.energy(x, &self.ranges)).sum()
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        let energy = self.families.iter_mut().map(|family| family.linearize(x, &self.ranges)).sum();
        let problem = &*self;
        let (sparse, border) = (problem.structure.sparse_dimension(), problem.structure.border());
        equations.for_each_block_row(&|i, row| {
            row.blocks.fill(0.0);
            row.cross.fill(0.0);
            row.gradient.fill(0.0);
            let gather = &problem.sparse_gather;
            let mut row = Row { gradient: row.gradient, blocks: row.blocks, border: row.cross, stride: border };
            for &c in &gather.contributions[gather.starts[i]..gather.starts[i + 1]] {
                problem.contribute(gather, c, &mut row);
            }
        });
        equations.border.fill(0.0);
        equations.gradient[sparse..].fill(0.0);
        let gather = &problem.border_gather;
        for (k, &i) in problem.border_blocks.iter().enumerate() {
            let block = &problem.blocks[i];
            let first = block.tangent_at - sparse;
            let mut row = Row {
                gradient: &mut equations.gradient[block.tangent_at..block.tangent_at + block.tangent],
                blocks: &mut [],
                border: &mut equations.border[first * border..(first + block.tangent) * border],
                stride: border,
            };
            for &c in &gather.contributions[gather.starts[k]..gather.starts[k + 1]] {
                problem.contribute(gather, c, &mut row);
            }
        }
        energy
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        for (block, range) in self.blocks.iter().zip(&self.ranges) {
            let (from, to) = (&x[range.clone()], &mut out[range.clone()]);
            if block.place == Place::Constant {
                to.copy_from_slice(from);
            } else {
                (block.move_by)(from, &step[block.tangent_at..block.tangent_at + block.tangent], to);
            }
        }
    }

    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        let [lower, upper] = self.bounds.as_ref()?;
        let first = self.border_blocks.first().map_or(0, |&i| self.ranges[i].start);
        Some(BorderBounds { first, lower, upper })
    }
}
