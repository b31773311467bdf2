//! Models whose parameters are the vertices: all but the regulariser, which each of them states.

use super::factory::{ModelError, RegistrationModel, SmoothLevel};
use super::on_patch::PatchInput;
use super::vertex_assembly::VertexAssembly;
use crate::energy::{DeformationModel, NamedEnergy, Options, OptionsError, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::{BlockStructure, NormalEquations};

/// What keeps the vertices of a [`VertexModel`] together.
pub trait VertexRegulariser: Send + Sync + 'static {
    /// Name of the model.
    const NAME: &'static str;

    /// Lays data and regulariser out for equations.
    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure;

    /// Takes where all vertices are, a model's own too.
    fn fit(&mut self, nodes: &[Vec3]);

    /// Adds the energies there, by name.
    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>);

    /// Adds the regulariser there to the equations.
    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations);
}

/// Vertices under data and a regulariser.
///
/// Parts without data stay where they are if the solver damps
/// ([`Options::with_damping_floor`](crate::nlls::Options::with_damping_floor)); without damping the normal equations are singular, which
/// is an error there.
pub struct VertexModel<R> {
    /// `lambda` of the regulariser.
    pub lambda_smooth: f64,
    pub(super) regulariser: R,
    vertices: VertexAssembly,
    fitted: Fitted,
}

/// Where the vertices are at the parameters that the regulariser was fitted to last.
#[derive(Default)]
struct Fitted {
    x: Vec<f64>,
    nodes: Vec<Vec3>,
}

impl<R: VertexRegulariser> VertexModel<R> {
    pub(super) fn of(regulariser: R, vertices: VertexAssembly, lambda_smooth: f64) -> Self {
        Self { lambda_smooth, regulariser, vertices, fitted: Fitted::default() }
    }

    /// Holds the marked vertices at rest: they are not parameters, and their positions are copied bit for bit.
    ///
    /// # Panics
    /// If there is not one mark per vertex.
    #[must_use]
    pub fn with_held(self, held: &[bool]) -> Self {
        let rest = self.vertices.rest[..self.vertex_count()].to_vec();
        self.with_held_at(held, &rest)
    }

    /// Holds the marked vertices at the given positions, bit for bit; positions of other vertices are ignored. Nodes of the model's
    /// own stay free.
    ///
    /// # Panics
    /// If there is not one mark and one position per vertex.
    #[must_use]
    pub fn with_held_at(mut self, held: &[bool], positions: &[Vec3]) -> Self {
        self.vertices.hold(held, positions);
        self.fitted = Fitted::default();
        self
    }

    /// The model of a patch, whose rim is held.
    pub(super) fn on_patch(self, input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
        Ok(Box::new(self.with_held_at(input.held, input.places)))
    }

    /// In how many directions parts of the template can be shifted without any data noticing, at the last linearisation.
    #[must_use]
    pub fn unobserved_shifts(&self) -> usize {
        self.vertices.unobserved_shifts()
    }

    /// Fits the regulariser to `x`.
    pub(super) fn fit(&mut self, x: &[f64]) {
        let Fitted { x: last, nodes } = &mut self.fitted;
        if last == x && !nodes.is_empty() {
            return;
        }
        last.clear();
        last.extend_from_slice(x);
        self.vertices.positions(x, nodes);
        self.regulariser.fit(nodes);
    }
}

impl<R: VertexRegulariser> DeformationModel for VertexModel<R> {
    fn name(&self) -> &'static str {
        R::NAME
    }

    fn vertex_count(&self) -> usize {
        self.vertices.vertex_count()
    }

    fn parameter_len(&self) -> usize {
        self.vertices.parameter_len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        self.vertices.rest_parameters()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        self.regulariser.analyse(&mut self.vertices, samples)
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.vertices.positions(x, out);
        out.truncate(self.vertex_count());
    }

    fn pull_back(&mut self, _x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.vertices.pull_back(field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.fit(x);
        self.regulariser.energy(self.lambda_smooth, out);
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.fit(x);
        self.regulariser.add_to(self.lambda_smooth, equations);
    }
}

impl<R: VertexRegulariser> RegistrationModel for VertexModel<R> {
    fn set_level(&mut self, options: &Options, _unit: f64) -> Result<(), OptionsError> {
        self.lambda_smooth = options.read::<SmoothLevel>()?.lambda_smooth;
        Ok(())
    }

    fn unobserved_directions(&self) -> Option<usize> {
        (self.lambda_smooth > 0.0).then(|| self.unobserved_shifts())
    }
}
