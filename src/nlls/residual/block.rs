//! Parameter blocks with their manifolds erased.

use std::any::TypeId;

/// Where the tangent coordinates of a parameter block live.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// A block of the sparse part.
    Sparse,
    /// A stretch of the dense border.
    Border,
    /// Nowhere: the block does not move.
    Constant,
}

/// A parameter block, its manifold erased.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub place: Place,
    pub manifold: TypeId,
    pub name: &'static str,
    /// A step adds to its coordinates.
    pub plain: bool,
    /// Lower and upper bounds.
    pub bounds: Option<[Vec<f64>; 2]>,
    pub ambient: usize,
    pub tangent: usize,
    pub initial: Vec<f64>,
    pub move_by: fn(&[f64], &[f64], &mut [f64]),
    pub contains: fn(&[f64], f64) -> bool,
    /// First ambient coordinate in x.
    pub ambient_at: usize,
    /// First tangent coordinate: in the gradient.
    pub tangent_at: usize,
    /// Sparse: index in the block structure.
    pub index: usize,
}
