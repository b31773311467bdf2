//! Deformation models, one file each, all on the one assembly in `assembly/`.

mod assembly;
mod blendshape;
mod graph;
mod hybrid;
mod node_graph;
mod rigid;
mod similarity;
mod sumner;
mod transform;

pub use assembly::{Linearisation, NodeAssembly, Stiffness};
pub use blendshape::{Blendshape, blendshape};
pub use graph::{Graph, graph};
pub use hybrid::{AffineHybrid, Hybrid, affine_hybrid, hybrid};
pub use node_graph::NodeGraph;
pub use rigid::{Rigid, rigid};
pub use similarity::{Similarity, similarity};
pub use sumner::{Sumner, sumner};
pub use transform::{AffineMap, AffineMotion, NodeTransform, RigidMotion, SimilarityMotion};

use crate::mesh::Vec3;

fn centroid(positions: &[Vec3]) -> Vec3 {
    positions.iter().sum::<Vec3>() / positions.len().max(1) as f64
}
