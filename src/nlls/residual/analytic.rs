//! Residuals that bring their Jacobians, of sizes known at run time.

use std::any::{Any, TypeId};

use super::block::Block;
use super::family::{AnyFamily, Common, GRAIN};
use super::{AnalyticResidual, BlockId};
use crate::nlls::RobustKernel;
use crate::nlls::parallel::for_each;

/// Residuals with Jacobians of their own that share a kernel and a weight: see [`AnalyticResidual`].
pub struct AnalyticFamily<F, const K: usize> {
    residuals: Vec<F>,
    common: Common,
    slots: Vec<Slot>,
}

/// What one residual writes.
#[derive(Debug, Default)]
struct Slot {
    residual: Vec<f64>,
    /// Row-major.
    jacobian: Vec<f64>,
    /// The residual of a step trial.
    trial: Vec<f64>,
    weight: f64,
    energy: f64,
}

impl Slot {
    fn clear(&mut self) {
        [&mut self.residual, &mut self.jacobian].into_iter().for_each(|v| v.fill(0.0));
        (self.weight, self.energy) = (0.0, 0.0);
    }
}

impl<F: AnalyticResidual<K>, const K: usize> AnalyticFamily<F, K> {
    /// Residuals and, for each, the blocks that it reads.
    #[must_use]
    pub fn new(residuals: Vec<F>, blocks: &[[BlockId; K]]) -> Self {
        const { assert!(K > 0, "a residual reads one block at least") };
        Self { residuals, common: Common::new(blocks), slots: Vec::new() }
    }

    /// The same residuals under one of the [`Kernel`](crate::nlls::Kernel)s or a kernel of your own. Default: plain squares.
    #[must_use]
    pub fn with_kernel(self, kernel: impl RobustKernel + 'static) -> Self {
        Self { common: self.common.with_kernel(kernel), ..self }
    }

    /// The same residuals with the weight alpha >= 0. Default 1; at 0 they are not evaluated.
    #[must_use]
    pub fn with_weight(self, alpha: f64) -> Self {
        Self { common: Common { weight: alpha, ..self.common }, ..self }
    }

    /// Calls `work` for every residual with its points, in parallel, and adds up the energies that it leaves.
    fn each(
        &mut self,
        x: &[f64],
        ambient: &[std::ops::Range<usize>],
        work: impl Fn(&F, [&[f64]; K], &Common, &mut Slot) + Sync,
    ) -> f64 {
        let Self { residuals, common, slots } = self;
        if common.weight == 0.0 {
            slots.iter_mut().for_each(Slot::clear);
            return 0.0;
        }
        let ids = common.blocks.as_chunks::<K>().0;
        for_each(slots, GRAIN, &|m, slot: &mut Slot| {
            work(&residuals[m], ids[m].map(|id| &x[ambient[id.0].clone()]), common, slot);
        });
        slots.iter().map(|slot| slot.energy).sum()
    }
}

impl<F: AnalyticResidual<K>, const K: usize> AnyFamily for AnalyticFamily<F, K> {
    fn block_count(&self) -> usize {
        K
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

    /// Those of the first residual's blocks: all others must be like these.
    fn manifolds(&self, blocks: &[Block]) -> Vec<(TypeId, &'static str, usize)> {
        let missing = (TypeId::of::<()>(), "missing", 0);
        let of = |id: &BlockId| blocks.get(id.0).map_or(missing, |b| (b.manifold, b.name, b.tangent));
        let first = self.common.blocks.first_chunk::<K>();
        first.map_or_else(|| vec![missing; K], |ids| ids.iter().map(of).collect())
    }

    fn prepare(&mut self, width: usize) {
        let slot = |f: &F| {
            let n = f.len();
            Slot { residual: vec![0.0; n], jacobian: vec![0.0; n * width], trial: vec![0.0; n], ..Slot::default() }
        };
        self.slots = self.residuals.iter().map(slot).collect();
    }

    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        self.each(x, ambient, |residual, points, common, slot| {
            residual.evaluate(points, &mut slot.trial, None);
            [slot.energy, _] = common.judge(&slot.trial);
        })
    }

    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        self.each(x, ambient, |residual, points, common, slot| {
            slot.jacobian.fill(0.0);
            residual.evaluate(points, &mut slot.residual, Some(&mut slot.jacobian));
            [slot.energy, slot.weight] = common.judge(&slot.residual);
        })
    }

    fn energy_of(&self, m: usize) -> f64 {
        self.slots[m].energy
    }

    fn row(&self, m: usize) -> (&[f64], &[f64], f64) {
        let slot = &self.slots[m];
        (&slot.residual, &slot.jacobian, slot.weight)
    }

    fn residuals_mut(&mut self) -> &mut dyn Any {
        &mut self.residuals
    }
}
