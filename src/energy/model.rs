//! Deformation models: what moves the vertices.

use super::{QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::{BlockStructure, NormalEquations};

/// Energy of one named part (a term or a regulariser).
pub type NamedEnergy = (&'static str, f64);

/// A deformation model: parameters `x`, vertex positions `v(x)`, a regulariser, and how quadrics in `v` become normal
/// equations in `x`. It never sees a data term, only the [`QuadricField`] they leave.
pub trait DeformationModel: Send {
    /// Name in reports.
    fn name(&self) -> &'static str;

    /// Number of vertices.
    fn vertex_count(&self) -> usize;

    /// Number of ambient parameters.
    fn parameter_len(&self) -> usize;

    /// Parameters of the undeformed rest shape.
    fn rest_parameters(&self) -> Vec<f64>;

    /// Fixes the samples and returns the sparsity of the normal equations. Called once before solving, and again only
    /// when the set of samples changes.
    fn analyse(&mut self, samples: &Samples) -> BlockStructure;

    /// Writes the vertex positions at `x`.
    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>);

    /// Adds gradient and Gauss-Newton Hessian of half the data energy to `equations`: pulls the quadrics back through
    /// `dv/dx` at `x`.
    fn pull_back(&mut self, x: &[f64], field: &QuadricField, equations: &mut NormalEquations);

    /// Regulariser energies at `x`, by name, appended to `out`.
    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>);

    /// Adds gradient and Gauss-Newton Hessian of half the regulariser energy to `equations`.
    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations);

    /// Writes `x` moved by the tangent `step` to `out`: their sum, unless parameters are more than numbers, such as rotations.
    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        for ((out, x), d) in out.iter_mut().zip(x).zip(step) {
            *out = x + d;
        }
    }

    /// Lower and upper bounds of the dense border's coordinates, one each, if they have any. The border must then be the last
    /// parameters of `x` as they are: numbers to which a step adds.
    fn border_bounds(&self) -> Option<(&[f64], &[f64])> {
        None
    }
}

impl<M: DeformationModel + ?Sized> DeformationModel for Box<M> {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn vertex_count(&self) -> usize {
        (**self).vertex_count()
    }

    fn parameter_len(&self) -> usize {
        (**self).parameter_len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        (**self).rest_parameters()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        (**self).analyse(samples)
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        (**self).positions(x, out);
    }

    fn pull_back(&mut self, x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        (**self).pull_back(x, field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        (**self).regulariser_energy(x, out);
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        (**self).regularise(x, equations);
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        (**self).retract(x, step, out);
    }

    fn border_bounds(&self) -> Option<(&[f64], &[f64])> {
        (**self).border_bounds()
    }
}
