//! Equations of points in space that treat all directions alike: every block is a multiple of the identity, as those of surfaces whose
//! vertices are drawn to points.
//!
//! ```text
//!     H = K (x) 1      K = P' L L' P, one row for each block      L L' P [d_x d_y d_z] = -P [g_x g_y g_z]
//! ```
//!
//! One factor of a third of the side serves the three coordinates: a ninth of the numbers, of the arithmetic a 27th to factorise and
//! a third to solve.

use std::sync::Arc;

use super::supernodal::{LANES, SupernodalFactor};
use super::{LinearError, breakdown};
use crate::nlls::{BlockStructure, NormalEquations};

/// Coordinates of a block.
const SIZE: usize = 3;

/// The factor of `K`.
#[derive(Debug)]
pub(super) struct Isotropic {
    factor: SupernodalFactor,
    /// `K`, refilled before it is factorised.
    scalars: NormalEquations,
    damping: Vec<f64>,
    /// Whether the factor is that of the scalars and the damping.
    factored: bool,
    permuted: Vec<[f64; LANES]>,
    weak: usize,
}

impl Isotropic {
    /// Analyses a structure of blocks of three without a border.
    pub(super) fn new(structure: &BlockStructure) -> Self {
        let n = structure.block_count();
        let pairs = (0..n).flat_map(|i| structure.row(i).iter().map(move |&j| (i, j)));
        let scalar = BlockStructure::new(&vec![1; n], pairs, 0).expect("proven: the pairs are those of a structure");
        let scalar = Arc::new(scalar);
        Self {
            factor: SupernodalFactor::analyse(&scalar),
            scalars: NormalEquations::new(scalar),
            damping: vec![0.0; n],
            factored: false,
            permuted: vec![[0.0; LANES]; n],
            weak: 0,
        }
    }

    /// Whether these equations are of blocks of three without a border, each a multiple of the identity.
    pub(super) fn fits(equations: &NormalEquations, damping: &[f64]) -> bool {
        let s = equations.structure();
        // Shifted by its sign, a zero of either sign has no bits.
        let isotropic = |b: &[f64]| {
            let bits = |k: usize| b[k].to_bits();
            let off = (bits(1) | bits(2) | bits(3) | bits(5) | bits(6) | bits(7)) << 1;
            off | (bits(0) ^ bits(4)) | (bits(0) ^ bits(8)) == 0
        };
        s.border() == 0
            && s.sparse_dimension() == SIZE * s.block_count()
            && (0..s.block_count()).all(|i| s.size(i) == SIZE)
            && equations.blocks.chunks_exact(SIZE * SIZE).all(isotropic)
            && damping.chunks_exact(SIZE).all(|d| d.iter().all(|x| x.to_bits() == d[0].to_bits()))
    }

    /// Solves equations that [fit](Self::fits).
    pub(super) fn solve(
        &mut self,
        equations: &NormalEquations,
        damping: &[f64],
        step: &mut [f64],
    ) -> Result<(), LinearError> {
        let blocks = self.scalars.blocks.iter_mut().zip(equations.blocks.iter().step_by(SIZE * SIZE));
        let damped = self.damping.iter_mut().zip(damping.iter().chain(std::iter::repeat(&0.0)).step_by(SIZE));
        for (kept, new) in blocks.chain(damped) {
            self.factored &= kept.to_bits() == new.to_bits();
            *kept = *new;
        }
        if !self.factored {
            let weak = self.factor.factorize(&self.scalars, &self.damping);
            self.weak = SIZE * weak.map_err(|i| breakdown(equations, damping, SIZE * i))?;
            self.factored = true;
        }
        for (&p, g) in self.factor.position().iter().zip(equations.gradient.chunks_exact(SIZE)) {
            self.permuted[p] = [-g[0], -g[1], -g[2], 0.0];
        }
        self.factor.forward(&mut self.permuted);
        self.factor.backward(&mut self.permuted);
        for (&p, d) in self.factor.position().iter().zip(step.chunks_exact_mut(SIZE)) {
            d.copy_from_slice(&self.permuted[p][..SIZE]);
        }
        Ok(())
    }

    /// Pivots of the last factorisation that damping holds up, one for each coordinate.
    pub(super) fn weak(&self) -> usize {
        self.weak
    }
}
