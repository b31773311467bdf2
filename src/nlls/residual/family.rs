//! Residuals of one kind: evaluated and differentiated, each into its own slot.

use std::any::{Any, TypeId};
use std::marker::PhantomData;

use num_dual::DualSVec64;

use super::block::Block;
use super::{BlockId, BlockList, Residual};
use crate::nlls::parallel::for_each;
use crate::nlls::{Kernel, RobustKernel};

/// Residuals of one kind that share a kernel and a weight.
pub struct Family<F, const R: usize, const T: usize>
where
    F: Residual<R, T>,
{
    residuals: Vec<F>,
    common: Common,
    slots: Vec<Slot<R, T>>,
    tangents: PhantomData<[(); T]>,
}

/// What one residual writes.
#[derive(Debug, Clone, Copy)]
struct Slot<const R: usize, const T: usize> {
    residual: [f64; R],
    jacobian: [[f64; T]; R],
    weight: f64,
    energy: f64,
}

impl<const R: usize, const T: usize> Slot<R, T> {
    const EMPTY: Self = Self { residual: [0.0; R], jacobian: [[0.0; T]; R], weight: 0.0, energy: 0.0 };
}

impl<F: Residual<R, T>, const R: usize, const T: usize> Family<F, R, T> {
    /// The width of the dual numbers must be the sum of the blocks' tangent coordinates; anything else does not compile.
    const WIDTH: () = assert!(T == F::Blocks::TANGENT, "T of Residual<R, T> must be the sum of the blocks' TANGENT");

    /// Residuals and, for each, the blocks that it reads, in the order of [`Residual::Blocks`].
    #[must_use]
    pub fn new(residuals: Vec<F>, blocks: &[<F::Blocks as BlockList>::Ids]) -> Self {
        const { Self::WIDTH };
        Self { residuals, common: Common::new(blocks), slots: Vec::new(), tangents: PhantomData }
    }

    /// The same residuals under one of the [`Kernel`]s or a kernel of your own. Default: plain squares.
    #[must_use]
    pub fn with_kernel(self, kernel: impl RobustKernel + 'static) -> Self {
        Self { common: self.common.with_kernel(kernel), ..self }
    }

    /// The same residuals with the weight alpha >= 0. Default 1; at 0 they are not evaluated.
    #[must_use]
    pub fn with_weight(self, alpha: f64) -> Self {
        Self { common: Common { weight: alpha, ..self.common }, ..self }
    }
}

/// What a family is besides its residuals: the blocks that they read, kernel and weight.
pub(super) struct Common {
    pub blocks: Vec<BlockId>,
    /// For how many residuals there are blocks.
    pub block_lists: usize,
    pub kernel: Box<dyn RobustKernel>,
    pub weight: f64,
}

impl Common {
    /// Plain squares of weight one.
    pub(super) fn new(blocks: &[impl AsRef<[BlockId]>]) -> Self {
        Self {
            blocks: blocks.iter().flat_map(|ids| ids.as_ref().iter().copied()).collect(),
            block_lists: blocks.len(),
            kernel: Box::new(Kernel::None),
            weight: 1.0,
        }
    }

    pub(super) fn with_kernel(self, kernel: impl RobustKernel + 'static) -> Self {
        Self { kernel: Box::new(kernel), ..self }
    }

    /// `alpha rho(|r|^2)` and `alpha rho'(|r|^2)`.
    pub(super) fn judge(&self, residual: &[f64]) -> [f64; 2] {
        let [rho, first, _] = self.kernel.evaluate(residual.iter().map(|r| r * r).sum());
        [self.weight * rho, self.weight * first]
    }
}

/// A family without its types.
pub(super) trait AnyFamily: Send + Sync {
    fn block_count(&self) -> usize;
    fn residual_count(&self) -> usize;
    fn common(&self) -> &Common;
    fn common_mut(&mut self) -> &mut Common;
    /// Type, name and tangent dimension of the blocks that its residuals read, in order; `blocks` are all of the problem.
    fn manifolds(&self, blocks: &[Block]) -> Vec<(TypeId, &'static str, usize)>;
    /// Allocates the slots for Jacobians of `width` columns.
    fn prepare(&mut self, width: usize);
    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    /// Energy of residual `m`, as last evaluated.
    fn energy_of(&self, m: usize) -> f64;
    /// Residual, Jacobian (row-major) and weight of residual `m`, as of the last linearisation.
    fn row(&self, m: usize) -> (&[f64], &[f64], f64);
    fn residuals_mut(&mut self) -> &mut dyn Any;
}

/// Residuals that one thread takes at least.
pub(super) const GRAIN: usize = 32;

impl<F: Residual<R, T>, const R: usize, const T: usize> AnyFamily for Family<F, R, T> {
    fn block_count(&self) -> usize {
        F::Blocks::COUNT
    }

    fn residual_count(&self) -> usize {
        self.residuals.len()
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn common_mut(&mut self) -> &mut Common {
        &mut self.common
    }

    fn manifolds(&self, _blocks: &[Block]) -> Vec<(TypeId, &'static str, usize)> {
        F::Blocks::manifolds()
    }

    fn prepare(&mut self, _width: usize) {
        self.slots = vec![Slot::EMPTY; self.residuals.len()];
    }

    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        if self.common.weight == 0.0 {
            self.slots.fill(Slot::EMPTY);
            return 0.0;
        }
        let Self { residuals, common, slots, .. } = self;
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &common.blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::load(|k| &x[ambient[ids[k].0].clone()]);
            [slot.energy, _] = common.judge(&residuals[m].evaluate(&points));
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        if self.common.weight == 0.0 {
            return self.energy(x, ambient);
        }
        let Self { residuals, common, slots, .. } = self;
        let seeds: [DualSVec64<T>; T] = std::array::from_fn(|i| DualSVec64::from_re(0.0).derivative(i));
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &common.blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::plus(|k| &x[ambient[ids[k].0].clone()], &seeds);
            let dual = residuals[m].evaluate(&points);
            for (i, value) in dual.into_iter().enumerate() {
                slot.residual[i] = value.re;
                slot.jacobian[i] = value.eps.0.map_or([0.0; T], |eps| eps.data.0[0]);
            }
            [slot.energy, slot.weight] = common.judge(&slot.residual);
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn energy_of(&self, m: usize) -> f64 {
        self.slots[m].energy
    }

    fn row(&self, m: usize) -> (&[f64], &[f64], f64) {
        let slot = &self.slots[m];
        (&slot.residual, slot.jacobian.as_flattened(), slot.weight)
    }

    fn residuals_mut(&mut self) -> &mut dyn Any {
        &mut self.residuals
    }
}
