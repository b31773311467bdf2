//! Residuals of one kind: evaluated and differentiated, each into its own slot.

use std::any::{Any, TypeId};
use std::marker::PhantomData;

use num_dual::DualSVec64;

use super::{BlockId, BlockList, Residual};
use crate::nlls::parallel::for_each;
use crate::nlls::{Kernel, OptionError, RobustKernel};

/// Residuals of one kind that share a kernel and a weight.
pub struct Family<F, const R: usize, const T: usize>
where
    F: Residual<R, T>,
{
    residuals: Vec<F>,
    blocks: Vec<BlockId>,
    block_lists: usize,
    kernel: Box<dyn RobustKernel>,
    kernel_error: Option<OptionError>,
    weight: f64,
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

impl<F: Residual<R, T>, const R: usize, const T: usize> Family<F, R, T> {
    /// The width of the dual numbers must be the sum of the blocks' tangent coordinates; anything else does not compile.
    const WIDTH: () = assert!(T == F::Blocks::TANGENT, "T of Residual<R, T> must be the sum of the blocks' TANGENT");

    /// Residuals and, for each, the blocks that it reads, in the order of [`Residual::Blocks`].
    #[must_use]
    pub fn new(residuals: Vec<F>, blocks: &[<F::Blocks as BlockList>::Ids]) -> Self {
        const { Self::WIDTH };
        Self {
            residuals,
            blocks: blocks.iter().flat_map(|ids| ids.as_ref().iter().copied()).collect(),
            block_lists: blocks.len(),
            kernel: Box::new(Kernel::None),
            kernel_error: None,
            weight: 1.0,
            slots: Vec::new(),
            tangents: PhantomData,
        }
    }

    /// The same residuals under one of the [`Kernel`]s. Default: plain squares.
    #[must_use]
    pub fn with_kernel(self, kernel: Kernel) -> Self {
        Self { kernel: Box::new(kernel), kernel_error: kernel.validate().err(), ..self }
    }

    /// The same residuals under a kernel of your own.
    #[must_use]
    pub fn with_robust_kernel(self, kernel: impl RobustKernel + 'static) -> Self {
        Self { kernel: Box::new(kernel), kernel_error: None, ..self }
    }

    /// The same residuals with the weight alpha >= 0. Default 1.
    #[must_use]
    pub fn with_weight(self, alpha: f64) -> Self {
        Self { weight: alpha, ..self }
    }
}

/// A family without its types.
pub(super) trait AnyFamily: Send + Sync {
    fn block_count(&self) -> usize;
    fn residual_count(&self) -> usize;
    fn block_lists(&self) -> usize;
    fn entries(&self) -> usize;
    fn blocks(&self) -> &[BlockId];
    fn manifolds(&self) -> Vec<(TypeId, &'static str, usize)>;
    fn kernel_error(&self) -> Option<&OptionError>;
    fn weight(&self) -> f64;
    fn set_weight(&mut self, weight: f64);
    fn set_kernel(&mut self, kernel: Box<dyn RobustKernel>);
    /// Allocates the slots.
    fn prepare(&mut self);
    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    /// Residual, Jacobian (row-major) and weight of residual `m`, as of the last linearisation.
    fn row(&self, m: usize) -> (&[f64], &[f64], f64);
    fn residuals_mut(&mut self) -> &mut dyn Any;
}

/// Residuals that one thread takes at least.
const GRAIN: usize = 32;

impl<F: Residual<R, T>, const R: usize, const T: usize> AnyFamily for Family<F, R, T> {
    fn block_count(&self) -> usize {
        F::Blocks::COUNT
    }

    fn residual_count(&self) -> usize {
        self.residuals.len()
    }

    fn block_lists(&self) -> usize {
        self.block_lists
    }

    fn entries(&self) -> usize {
        R
    }

    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn manifolds(&self) -> Vec<(TypeId, &'static str, usize)> {
        F::Blocks::manifolds()
    }

    fn kernel_error(&self) -> Option<&OptionError> {
        self.kernel_error.as_ref()
    }

    fn weight(&self) -> f64 {
        self.weight
    }

    fn set_weight(&mut self, weight: f64) {
        self.weight = weight;
    }

    fn set_kernel(&mut self, kernel: Box<dyn RobustKernel>) {
        self.kernel = kernel;
    }

    fn prepare(&mut self) {
        let empty = Slot { residual: [0.0; R], jacobian: [[0.0; T]; R], weight: 0.0, energy: 0.0 };
        self.slots = vec![empty; self.residuals.len()];
    }

    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        let Self { residuals, blocks, kernel, weight, slots, .. } = self;
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::load(|k| &x[ambient[ids[k].0].clone()]);
            let residual = residuals[m].evaluate(&points);
            let square: f64 = residual.iter().map(|r| r * r).sum();
            slot.energy = *weight * kernel.evaluate(square)[0];
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        let Self { residuals, blocks, kernel, weight, slots, .. } = self;
        let seeds: [DualSVec64<T>; T] = std::array::from_fn(|i| DualSVec64::from_re(0.0).derivative(i));
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::plus(|k| &x[ambient[ids[k].0].clone()], &seeds);
            let dual = residuals[m].evaluate(&points);
            for (i, value) in dual.into_iter().enumerate() {
                slot.residual[i] = value.re;
                slot.jacobian[i] = value.eps.0.map_or([0.0; T], |eps| eps.data.0[0]);
            }
            let square: f64 = slot.residual.iter().map(|r| r * r).sum();
            let [rho, first, _] = kernel.evaluate(square);
            slot.weight = *weight * first;
            slot.energy = *weight * rho;
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn row(&self, m: usize) -> (&[f64], &[f64], f64) {
        let slot = &self.slots[m];
        (&slot.residual, slot.jacobian.as_flattened(), slot.weight)
    }

    fn residuals_mut(&mut self) -> &mut dyn Any {
        &mut self.residuals
    }
}
