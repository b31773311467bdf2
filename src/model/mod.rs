//! Deformation models, one file each: those made of nodes and blendshapes on the assembly in `assembly/`, models of free
//! vertices on the one in `vertex_assembly.rs`, per-vertex affine maps on their own; and, in `autodiff`, any model that is
//! stated as a formula for vertex positions.

mod affine;
mod arap;
mod assembly;
mod autodiff;
mod blendshape;
mod edge_weights;
mod free;
mod graph;
mod hybrid;
mod node_graph;
mod rigid;
mod rotation_fit;
mod similarity;
mod sumner;
mod transform;
mod vertex_assembly;

pub use affine::Affine;
pub use arap::{Arap, ArapOptions, ArapSolver};
pub use assembly::{Linearisation, NodeAssembly, Stiffness};
pub use autodiff::{Autodiff, AutodiffError, Point, PositionFunction};
pub use blendshape::{Blendshape, blendshape, blendshape_in_place};
pub use edge_weights::EdgeWeights;
pub use free::{Free, FreeOptions, Smoothness};
pub use graph::{Graph, graph, graph_of};
pub use hybrid::{AffineHybrid, Hybrid, affine_hybrid, hybrid, hybrid_of};
pub use node_graph::NodeGraph;
pub use rigid::{Rigid, rigid};
pub use similarity::{Similarity, similarity};
pub use sumner::{Sumner, sumner};
pub use transform::{
    AffineMap, AffineMotion, AngleAxisMotion, NodeTransform, QuaternionMotion, RigidMotion, SimilarityMotion,
};

use crate::mesh::Vec3;

fn centroid(positions: &[Vec3]) -> Vec3 {
    positions.iter().sum::<Vec3>() / positions.len().max(1) as f64
}
