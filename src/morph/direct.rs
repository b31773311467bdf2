//! The paper's own morph: vertices under the mask move by its grey value times a displacement (Li et al. 2018, section 2).
//!
//! ```text
//! V'(D) = V(D) + W D,    W_i = Gray(u_i, v_i)                                                                   (5), (6)
//! ```

use rayon::prelude::*;

use super::{MorphError, Weights};
use crate::mesh::{MirrorPlane, TriangleMesh, Vec3, check_finite};

/// The grey value above which a vertex moves: one step of an 8-bit texture. The paper does not print its own.
pub const DEFAULT_THRESHOLD: f64 = 1.0 / 255.0;

/// A mask and how far a vertex of weight 1 moves.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskedDisplacement {
    /// `W`.
    pub weights: Weights,
    /// `D`, millimetres.
    pub displacement: Vec3,
}

impl MaskedDisplacement {
    /// The mirror image, [`Weights::mirrored`], of mask and displacement.
    ///
    /// # Errors
    /// As [`Weights::mirrored`].
    pub fn mirrored(&self, mesh: &TriangleMesh, plane: &MirrorPlane) -> Result<Self, MorphError> {
        Ok(Self {
            weights: self.weights.mirrored(mesh, plane)?,
            displacement: plane.reflect_direction(self.displacement),
        })
    }
}

/// Displacements that are applied at once: each to the vertices where they were before the step, and added up.
#[derive(Debug, Clone, PartialEq)]
pub struct MorphStep {
    /// Masks and displacements.
    pub pairs: Vec<MaskedDisplacement>,
    /// Where a weight is above this, strictly, the vertex moves; 0 to 1, default [`DEFAULT_THRESHOLD`].
    pub threshold: f64,
}

impl Default for MorphStep {
    fn default() -> Self {
        Self { pairs: Vec::new(), threshold: DEFAULT_THRESHOLD }
    }
}

/// Vertices that one task moves: positions and weights stay in the cache from one pair to the next.
const CHUNK: usize = 2048;

impl MorphStep {
    /// The step's vertices moved, equation (5). What no mask lifts above the threshold keeps its bits.
    ///
    /// # Errors
    /// When a mask has not one weight per vertex, the threshold is not from 0 to 1, or a displacement, a position or the result is
    /// not finite.
    pub fn apply(&self, positions: &[Vec3]) -> Result<Vec<Vec3>, MorphError> {
        let mut moved = vec![Vec3::zeros(); positions.len()];
        self.apply_into(positions, &mut moved)?;
        Ok(moved)
    }

    /// As [`Self::apply`], into a buffer of the caller, whose content after an error is not specified.
    ///
    /// # Errors
    /// As [`Self::apply`], and when the buffer has another length.
    pub fn apply_into(&self, positions: &[Vec3], moved: &mut [Vec3]) -> Result<(), MorphError> {
        self.check(positions.len())?;
        if moved.len() != positions.len() {
            return Err(MorphError::BufferLength { found: moved.len(), vertices: positions.len() });
        }
        let chunks = moved.par_chunks_mut(CHUNK).zip(positions.par_chunks(CHUNK)).enumerate();
        let finite = chunks.map(|(chunk, (moved, positions))| {
            moved.copy_from_slice(positions);
            let vertices = chunk * CHUNK..chunk * CHUNK + moved.len();
            // Adding zeros would turn -0 into 0.
            for pair in self.pairs.iter().filter(|pair| pair.displacement != Vec3::zeros()) {
                let MaskedDisplacement { weights, displacement } = pair;
                for (p, &weight) in moved.iter_mut().zip(&weights.values()[vertices.clone()]) {
                    if weight > self.threshold {
                        *p += displacement * weight;
                    }
                }
            }
            moved.iter().fold(true, |finite, p| finite & p.iter().all(|c| c.is_finite()))
        });
        if finite.reduce(|| true, |a, b| a && b) { Ok(()) } else { Ok(check_finite(moved)?) }
    }

    /// Which of `vertices` vertices the step moves: those that some mask lifts above the threshold. The others are what an energy
    /// on this step holds.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn moves(&self, vertices: usize) -> Result<Vec<bool>, MorphError> {
        self.check(vertices)?;
        let lifted = |v: usize| self.pairs.iter().any(|pair| pair.weights.values()[v] > self.threshold);
        Ok((0..vertices).map(lifted).collect())
    }

    fn check(&self, vertices: usize) -> Result<(), MorphError> {
        if !(0.0..=1.0).contains(&self.threshold) {
            let (what, value) = ("the threshold", self.threshold);
            return Err(MorphError::Option { what, value, expected: "0 to 1" });
        }
        for (index, MaskedDisplacement { weights, displacement }) in self.pairs.iter().enumerate() {
            let found = weights.values().len();
            if found != vertices {
                return Err(MorphError::WeightCount { found, vertices });
            }
            if !displacement.iter().all(|c| c.is_finite()) {
                return Err(MorphError::Displacement { index, displacement: (*displacement).into() });
            }
        }
        Ok(())
    }
}
