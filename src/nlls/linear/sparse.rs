//! Sparse Cholesky of the block part; the solver for pose graphs, Laplacians and graphs without blendshapes.

use std::sync::Arc;

use super::supernodal::SupernodalFactor;
use super::{LinearError, LinearSolver, breakdown, check_step, damping_at, same_structure};
use crate::nlls::{BlockStructure, NormalEquations};

/// `P (H + diag(damping)) P' = L L'`: minimum-degree ordering of the blocks and symbolic analysis once, numeric factorisation
/// into preallocated buffers at every solve.
///
/// Equations with the matrix and damping of the last ones, bit for bit, are solved with its factor: where residuals are linear,
/// or a model keeps its Hessian as the local/global steps of as-rigid-as-possible surfaces do, one factorisation serves all steps.
///
/// A border is treated as one more block that meets all others. That is right for a handful of global parameters; for wide
/// borders use [`BorderedCholesky`](super::BorderedCholesky).
#[derive(Debug)]
pub struct SparseCholesky {
    structure: Arc<BlockStructure>,
    /// The equations with the border moved into a last block, if there is a border.
    flattened: Option<NormalEquations>,
    pub(super) factor: SupernodalFactor,
    permuted: Vec<f64>,
    weak: usize,
    /// What the factor is of: blocks, then damping. Empty when there is none.
    factored: Vec<f64>,
}

impl SparseCholesky {
    /// Analyses the structure. Equations of another structure are analysed when they come.
    #[must_use]
    pub fn new(structure: &Arc<BlockStructure>) -> Self {
        let flattened = (structure.border() > 0).then(|| NormalEquations::new(Arc::new(flatten(structure))));
        let factor = SupernodalFactor::analyse(flattened.as_ref().map_or(structure, NormalEquations::structure));
        let permuted = vec![0.0; structure.dimension()];
        let values = flattened.as_ref().map_or(structure.value_count(), |f| f.structure().value_count());
        let factored = Vec::with_capacity(values + structure.dimension());
        Self { structure: structure.clone(), flattened, factor, permuted, weak: 0, factored }
    }

    /// Factorises, unless the factor is of the same matrix.
    fn factorize(&mut self, equations: &NormalEquations, damping: &[f64]) -> Result<(), LinearError> {
        let equations_of_blocks = self.flattened.as_ref().unwrap_or(equations);
        let blocks = &equations_of_blocks.blocks;
        let length = blocks.len() + damping.len();
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        if self.factored.len() == length && self.factored.iter().zip(blocks.iter().chain(damping)).all(same) {
            return Ok(());
        }
        self.factored.clear();
        self.weak =
            self.factor.factorize(equations_of_blocks, damping).map_err(|i| breakdown(equations, damping, i))?;
        self.factored.extend(blocks.iter().chain(damping));
        Ok(())
    }
}

impl LinearSolver for SparseCholesky {
    fn solve(&mut self, equations: &NormalEquations, damping: &[f64], step: &mut [f64]) -> Result<(), LinearError> {
        if !same_structure(equations.structure(), &self.structure) {
            *self = Self::new(equations.structure());
        }
        if let Some(flattened) = &mut self.flattened {
            fill_flattened(equations, flattened);
        }
        self.factorize(equations, damping)?;
        for (&p, g) in self.factor.position().iter().zip(&equations.gradient) {
            self.permuted[p] = -g;
        }
        self.factor.forward(&mut self.permuted);
        self.factor.backward(&mut self.permuted);
        for (&p, d) in self.factor.position().iter().zip(&mut *step) {
            *d = self.permuted[p];
        }
        debug_assert!(damping.is_empty() || damping_at(damping, 0) >= 0.0, "damping must not be negative");
        check_step(equations, damping, step)
    }

    fn weak_pivots(&self) -> usize {
        self.weak
    }

    fn name(&self) -> &'static str {
        "sparse Cholesky"
    }
}

/// The same pattern with the border as one last block.
pub(super) fn flatten(s: &BlockStructure) -> BlockStructure {
    let n = s.block_count();
    let sizes: Vec<usize> = (0..n).map(|i| s.size(i)).chain([s.border()]).collect();
    let pairs = (0..n).flat_map(|i| s.row(i).iter().map(move |&j| (i, j)).chain([(n, i)]));
    BlockStructure::new(&sizes, pairs, 0).expect("all pairs lie inside the n + 1 blocks")
}

/// Copies values; row `n` of the flattened pattern holds blocks (n, 0), .., (n, n - 1), (n, n).
pub(super) fn fill_flattened(equations: &NormalEquations, flattened: &mut NormalEquations) {
    let s = equations.structure();
    let (n, border) = (s.block_count(), s.border());
    let (blocks, last) = flattened.blocks.split_at_mut(equations.blocks.len());
    blocks.copy_from_slice(&equations.blocks);
    let mut at = 0;
    for i in 0..n {
        for b in 0..border {
            for a in 0..s.size(i) {
                last[at] = equations.cross[(s.offset(i) + a) * border + b];
                at += 1;
            }
        }
    }
    // Only the lower triangle of the border is given; mirror it.
    for r in 0..border {
        for c in 0..=r {
            let v = equations.border[r * border + c];
            last[at + r * border + c] = v;
            last[at + c * border + r] = v;
        }
    }
}
