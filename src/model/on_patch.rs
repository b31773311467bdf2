//! How a morph makes a model: on a patch of a mesh, whose rim is held.

use super::{ModelError, Smoothness};
use crate::energy::DeformationModel;
use crate::mesh::{TriangleMesh, Vec3};
use crate::rig::ShapeBasis;

/// What moves, with rings round it that are held, and how stiff it is. Lengths are millimetres.
#[derive(Debug, Clone, Copy)]
pub struct PatchInput<'a> {
    /// Rest shape of the patch.
    pub mesh: &'a TriangleMesh,
    /// Vertices that keep their places, one mark each.
    pub held: &'a [bool],
    /// Where held vertices are.
    pub places: &'a [Vec3],
    /// How much a vertex takes part, 0 to 1; 0 where it is held by the mask.
    pub mask: &'a [f64],
    /// Blendshapes, already times the mask; none for models that do not use any.
    pub shapes: &'a ShapeBasis,
    /// Mean area of a vertex that moves.
    pub vertex_area: f64,
    /// Number of vertices that move.
    pub moving: usize,
    /// Length `l` over which displacements are smoothed.
    pub smoothing: f64,
    /// What is smooth about the displacements of free vertices.
    pub smoothness: Smoothness,
    /// Nodes of a graph.
    pub nodes: usize,
    /// A shape's weight of one standard deviation costs as much as this rms distance from the handles.
    pub prior: f64,
}

impl PatchInput<'_> {
    /// Weight per vertex of a squared gradient whose energy is `(1 / vertex_area) integral |d - G D|^2 + l^2 |grad d|^2`.
    #[must_use]
    pub fn gradient_weight(&self) -> f64 {
        self.smoothing * self.smoothing / self.vertex_area
    }

    /// Weight of the squared shape weights.
    #[must_use]
    pub fn shape_weight(&self) -> f64 {
        self.prior * self.prior * self.moving as f64
    }
}

/// A model that can deform a patch.
pub trait PatchFactory: Send + Sync {
    /// Whether vertices are its parameters, so that any of them can be held bit for bit.
    fn by_vertex(&self) -> bool {
        false
    }

    /// Those of `smoothing`, `smoothness`, `nodes` and `prior` of a [`PatchInput`] that it reads.
    fn keys(&self) -> &[&str];

    /// Builds the model.
    ///
    /// # Errors
    /// When the geometry does not do.
    fn build_on_patch(&self, input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError>;
}

pub(super) type BuildOnPatch = fn(&PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError>;

/// How a model of the crate is made on a patch.
pub(super) struct BuiltInPatch {
    pub by_vertex: bool,
    pub keys: &'static [&'static str],
    pub build: BuildOnPatch,
}

impl PatchFactory for BuiltInPatch {
    fn by_vertex(&self) -> bool {
        self.by_vertex
    }

    fn keys(&self) -> &[&str] {
        self.keys
    }

    fn build_on_patch(&self, input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
        (self.build)(input)
    }
}
