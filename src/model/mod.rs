//! Deformation models, one file each, with the options that it reads from a schedule and what builds it; a new one is a line of the
//! table below besides. Those of nodes and blendshapes are the hybrid with one node or without shapes; those of
//! vertices state a regulariser each, the rest is `vertex_model.rs`; and `autodiff` makes a model of any formula for vertex positions. All are assembled by
//! [`nlls::Assembly`](crate::nlls::Assembly).

mod affine;
mod arap;
mod autodiff;
mod blendshape;
mod corotational;
mod edge_weights;
mod elements;
mod factory;
mod fem;
mod ffd;
mod flame;
mod free;
mod gpmm;
mod graph;
mod hybrid;
mod klimov2020;
mod laplacian;
mod linear_samples;
mod mass_spring;
mod node_graph;
mod node_options;
mod on_patch;
mod poisson;
mod rigid;
mod rigid_cells;
mod rotation_fit;
mod sequential;
mod similarity;
mod smooth_rows;
mod star_similarity;
mod sumner;
mod transform;
mod vertex_assembly;
mod vertex_model;

pub use affine::{Affine, AffineOptions};
pub use arap::{Arap, ArapOptions, RigidityOptions, Spokes};
pub use autodiff::{Autodiff, AutodiffError, Point, PositionFunction};
pub use blendshape::{Blendshape, BlendshapeLevel, blendshape, blendshape_in_place};
pub use edge_weights::EdgeWeights;
pub use factory::{ModelError, ModelFactory, ModelInput, RegistrationModel, SmoothLevel};
pub use fem::{Fem, TissueOptions};
pub use ffd::{Ffd, LatticeOptions};
pub use free::{Free, FreeOptions, SmoothOptions, Smoothness};
pub use gpmm::{GaussianKernel, GpmmOptions, gpmm};
pub use graph::{Graph, graph, graph_of};
pub use hybrid::{Hybrid, HybridLevel, Linearisation, Stiffness};
pub use laplacian::{Laplacian, LaplacianOptions};
pub use mass_spring::{MassSpring, SpringOptions};
pub use node_graph::NodeGraph;
pub(crate) use node_options::without_effect;
pub use node_options::{GraphDistance, GraphLevel, GraphOptions, NodeKind, OneNodeOptions, RotationKind};
pub use on_patch::{PatchFactory, PatchInput};
pub use poisson::{Guidance, Patches, Poisson, PoissonOptions};
pub use rigid::{Rigid, rigid};
pub use rigid_cells::{ArapSolver, CellKind, RigidCells};
pub use similarity::{Similarity, similarity};
pub use star_similarity::Frames;
pub use sumner::{Sumner, SumnerOptions, sumner};
pub use transform::{
    AffineMap, AffineMotion, AngleAxisMotion, NodeTransform, QuaternionMotion, RigidMotion, SimilarityMotion,
};
pub use vertex_model::{VertexModel, VertexRegulariser};

use serde::{Deserialize, Serialize};

use self::factory::BuiltIn;
use crate::energy::{Options, OptionsError};
use crate::mesh::Vec3;

/// The models that come with the crate, one line each: name in Rust, and what it is.
macro_rules! models {
    ($($(#[$doc:meta])* $kind:ident => $built_in:expr,)+) => {
        /// The models that come with the crate.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum ModelKind {
            $($(#[$doc])* $kind,)+
        }

        impl ModelKind {
            /// All of them.
            pub const ALL: [Self; [$(stringify!($kind)),+].len()] = [$(Self::$kind),+];

            fn built_in(self) -> &'static BuiltIn {
                match self {
                    $(Self::$kind => &$built_in,)+
                }
            }
        }
    };
}

models! {
    /// Blendshapes inside a deformation graph (Klimov 2020).
    Hybrid => hybrid::MODEL,
    /// The hybrid with the energy of Klimov 2020 and nothing else.
    Klimov2020 => klimov2020::MODEL,
    /// Blendshapes, then what the schedule's `[then]` names, from the shape that they have found (Bhat et al. 2013).
    Sequential => sequential::MODEL,
    /// Blendshapes under one rigid motion.
    Blendshape => blendshape::MODEL,
    /// Blendshapes as users of linear head models fit them: landmarks, then robust closest points (Li et al. 2017, FLAME).
    Flame => flame::MODEL,
    /// Gaussian process of smooth displacements as shapes, under one rigid motion (Luethi et al. 2018).
    Gpmm => gpmm::MODEL,
    /// The same and the blendshapes: the sum of a learnt kernel and a smooth one.
    GpmmRig => gpmm::WITH_RIG,
    /// Deformation graph, rigid nodes unless the schedule says otherwise.
    Graph => graph::MODEL,
    /// Deformation graph with affine nodes (Sumner et al. 2007).
    Sumner => sumner::MODEL,
    /// As-rigid-as-possible surface (Sorkine and Alexa 2007).
    Arap => arap::MODEL,
    /// Gradient-domain surface: every patch of triangles keeps its gradients but for a turn (Yu et al. 2004).
    Poisson => poisson::MODEL,
    /// Surface that keeps its differential coordinates up to similarities (Sorkine et al. 2004).
    Laplacian => laplacian::MODEL,
    /// Per-vertex affine maps: optimal-step N-ICP (Amberg et al. 2007).
    Affine => affine::MODEL,
    /// Springs along the edges and through a layer of tissue (Balaniuk, Costa and Melo 2006; Van Gelder 1998).
    MassSpring => mass_spring::MODEL,
    /// Soft tissue of corotational finite elements under the skin (Mueller and Gross 2004).
    Fem => fem::MODEL,
    /// A lattice of control points round the surface (Sederberg and Parry 1986; Rueckert et al. 1999).
    Ffd => ffd::MODEL,
    /// Every vertex by itself, its displacement smooth.
    Free => free::MODEL,
    /// Rigid motion.
    Rigid => rigid::MODEL,
    /// Similarity.
    Similarity => similarity::MODEL,
}

impl ModelKind {
    /// The model where nobody names one: the hybrid with a rig; without shapes that is a graph which stays stiff for long, and Sumner's
    /// comes nearest to the truth.
    #[must_use]
    pub const fn usual(with_rig: bool) -> Self {
        if with_rig { Self::Hybrid } else { Self::Sumner }
    }

    /// The names of all of them, in one line.
    #[must_use]
    pub fn names() -> String {
        Self::ALL.map(|m| m.to_string()).join(", ")
    }
}

impl std::fmt::Display for ModelKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for ModelKind {
    type Err = String;

    /// By its name, blanks around it aside: lists of models have them.
    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|m| m.name() == name.trim());
        found.ok_or_else(|| format!("unknown model '{name}'; known models: {}", Self::names()))
    }
}

impl ModelFactory for ModelKind {
    fn name(&self) -> &str {
        self.built_in().name
    }

    fn default_schedule(&self) -> &str {
        self.built_in().schedule
    }

    fn uses_shapes(&self) -> bool {
        self.built_in().uses_shapes
    }

    fn needs_shapes(&self) -> bool {
        self.built_in().needs_shapes
    }

    fn needs_second_stage(&self) -> bool {
        self.built_in().needs_second_stage
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        (self.built_in().options)(given)
    }

    fn level_options(&self, given: &Options) -> Result<Options, OptionsError> {
        (self.built_in().level_options)(given)
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        (self.built_in().build)(input)
    }

    fn on_patch(&self) -> Option<&dyn PatchFactory> {
        self.built_in().on_patch.as_ref().map(|patch| patch as &dyn PatchFactory)
    }
}

fn centroid(positions: &[Vec3]) -> Vec3 {
    positions.iter().sum::<Vec3>() / positions.len().max(1) as f64
}
