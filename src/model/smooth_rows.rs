//! A quadratic regulariser: squares of fixed linear combinations of displacements, three coordinates alike.
//!
//! ```text
//!     E = lambda sum_m |sum_k c_mk d_k|^2
//! ```

use rayon::prelude::*;

use super::vertex_assembly::{CHUNK, add_scalars, row_position};
use crate::mesh::Vec3;
use crate::mesh::rows::Rows;
use crate::nlls::{BlockStructure, NormalEquations};

/// Residuals `r_m = sum_k c_mk d_k`: what is squared and summed.
#[derive(Default)]
pub(super) struct SmoothRows {
    members: Rows,
    coefficients: Vec<f64>,
    /// Residuals of the rows at the last displacements.
    residuals: Vec<Vec3>,
    /// `C'C`, a scalar for every stored block.
    stiffness: Vec<f64>,
    /// Per block, the (row, coefficient) in which its displacement takes part.
    uses: Vec<Vec<(u32, f64)>>,
}

impl SmoothRows {
    /// Adds a row of (displacement, coefficient).
    pub fn push(&mut self, row: impl IntoIterator<Item = (u32, f64)>) {
        let coefficients = &mut self.coefficients;
        self.members.push(row.into_iter().map(|(k, c)| {
            coefficients.push(c);
            k
        }));
        self.residuals.push(Vec3::zeros());
    }

    /// Which displacements meet in each row.
    pub fn cliques(&self) -> impl Iterator<Item = &[u32]> {
        self.members.iter()
    }

    fn of(&self, row: usize) -> impl Iterator<Item = (u32, f64)> + Clone + '_ {
        let coefficients = &self.coefficients[self.members.range(row)];
        self.members.row(row).iter().copied().zip(coefficients.iter().copied())
    }

    /// Lays the rows out for equations; `block` says where a displacement is, if it is a parameter.
    pub fn analyse(&mut self, structure: &BlockStructure, block: impl Fn(u32) -> Option<usize>) {
        let mut stiffness = vec![0.0; structure.slot_count()];
        let mut uses = vec![Vec::new(); structure.block_count()];
        for m in 0..self.residuals.len() {
            let free = self.of(m).filter_map(|(k, c)| block(k).map(|block| (block, c)));
            for (a, c_a) in free.clone() {
                uses[a].push((m as u32, c_a));
                for (b, c_b) in free.clone().filter(|f| f.0 <= a) {
                    let slot = structure.row_slots(a).start + row_position(structure, a, b) as usize / 9;
                    stiffness[slot] += c_a * c_b;
                }
            }
        }
        (self.stiffness, self.uses) = (stiffness, uses);
    }

    /// Takes the displacements.
    pub fn place(&mut self, displacement: impl Fn(u32) -> Vec3 + Sync) {
        let mut residuals = std::mem::take(&mut self.residuals);
        residuals.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(m, r)| {
            *r = self.of(m).map(|(v, c)| displacement(v) * c).sum();
        });
        self.residuals = residuals;
    }

    /// `E / lambda` at the last displacements.
    pub fn energy(&self) -> f64 {
        self.residuals.iter().map(Vec3::norm_squared).sum()
    }

    /// Adds `lambda C'C` and `lambda C'r` to the equations.
    pub fn add_to(&self, equations: &mut NormalEquations, lambda: f64) {
        let structure = equations.structure().clone();
        let (stiffness, uses, residuals) = (&self.stiffness, &self.uses, &self.residuals);
        equations.for_each_block_row(&|i, mut row| {
            add_scalars(&mut row, &stiffness[structure.row_slots(i)], lambda);
            let gradient: Vec3 = uses[i].iter().map(|&(m, c)| residuals[m as usize] * c).sum();
            row.gradient.iter_mut().zip(&gradient).for_each(|(g, r)| *g += lambda * r);
        });
    }
}
