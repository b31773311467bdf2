//! A deformation model under data terms, as a least-squares [`Problem`].

use std::sync::Arc;

use super::{DataTerm, DeformationModel, NamedEnergy, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::{BlockStructure, BorderBounds, NormalEquations, Problem};

/// `E(x) = sum of terms (v(x)) + regulariser (x)`: terms turn positions into quadrics, the model pulls them back.
pub struct Deformation<M, T> {
    /// The deformation model.
    pub model: M,
    /// The data terms.
    pub terms: Vec<T>,
    samples: Samples,
    structure: Arc<BlockStructure>,
    vertices: Vec<Vec3>,
    positions: Vec<Vec3>,
    field: QuadricField,
    energies: Vec<NamedEnergy>,
}

impl<M: DeformationModel, T: DataTerm> Deformation<M, T> {
    /// Attaches `samples` to the model; terms are added to [`terms`](Self::terms).
    #[must_use]
    pub fn new(mut model: M, samples: Samples) -> Self {
        let structure = Arc::new(model.analyse(&samples));
        Self {
            model,
            terms: Vec::new(),
            samples,
            structure,
            vertices: Vec::new(),
            positions: Vec::new(),
            field: QuadricField::default(),
            energies: Vec::new(),
        }
    }

    /// Analyses the samples anew, after the model has changed what its parameters are.
    pub fn analyse(&mut self) {
        self.structure = Arc::new(self.model.analyse(&self.samples));
    }

    /// The points on which terms act.
    #[must_use]
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Vertex positions at `x`.
    pub fn vertices(&mut self, x: &[f64]) -> &[Vec3] {
        self.model.positions(x, &mut self.vertices);
        &self.vertices
    }

    /// Energies at `x` by name: terms in order, then regularisers.
    pub fn energies(&mut self, x: &[f64]) -> Vec<(String, f64)> {
        self.place(x);
        let mut all: Vec<_> = self.terms.iter().map(|t| (t.name().to_owned(), t.energy(&self.positions))).collect();
        self.energies.clear();
        self.model.regulariser_energy(x, &mut self.energies);
        all.extend(self.energies.iter().map(|&(name, e)| (name.to_owned(), e)));
        all
    }

    /// Variance of a data residual of weight one at `x`, from the residuals there: `sum alpha rho' |r|^2 / sum rho'` over the
    /// scalar residuals of all terms that [tell](DataTerm::residual_variance) theirs. `None` if none does or nothing has weight.
    ///
    /// A residual of weight `alpha` then has variance `sigma^2 / alpha`; what a kernel has switched off counts neither above nor
    /// below. The parameters are not subtracted from the number of residuals (a regularised fit has fewer than it has
    /// coordinates): with `n` effective parameters for `m` residuals the estimate is low by a share of `n / m`.
    pub fn residual_variance(&mut self, x: &[f64]) -> Option<f64> {
        self.place(x);
        let parts = self.terms.iter().filter_map(|t| t.residual_variance(&self.positions));
        let [squares, count] = parts.fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        (count > 0.0).then(|| squares / count)
    }

    fn place(&mut self, x: &[f64]) {
        self.model.positions(x, &mut self.vertices);
        self.samples.positions(&self.vertices, &mut self.positions);
    }

    fn regulariser(&mut self, x: &[f64]) -> f64 {
        self.energies.clear();
        self.model.regulariser_energy(x, &mut self.energies);
        self.energies.iter().map(|e| e.1).sum()
    }
}

impl<M: DeformationModel, T: DataTerm> Problem for Deformation<M, T> {
    fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    fn parameter_len(&self) -> usize {
        self.model.parameter_len()
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        self.place(x);
        let data: f64 = self.terms.iter().map(|t| t.energy(&self.positions)).sum();
        data + self.regulariser(x)
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        self.place(x);
        equations.clear();
        self.field.reset(self.samples.len());
        let data: f64 = self.terms.iter().map(|t| t.linearize(&self.positions, &mut self.field)).sum();
        self.model.pull_back(x, &self.field, equations);
        self.model.regularise(x, equations);
        data + self.regulariser(x)
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        self.model.retract(x, step, out);
    }

    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        let first = self.parameter_len() - self.structure.border();
        self.model.border_bounds().map(|(lower, upper)| BorderBounds { first, lower, upper })
    }
}
