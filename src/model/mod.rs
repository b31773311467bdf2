//! Deformation models, one file each, all on the one assembly in `assembly.rs`; and, in `autodiff`, any model that is stated
//! as a formula for vertex positions.

mod assembly;
mod autodiff;
mod blendshape;
mod graph;
mod hybrid;
mod node_graph;
mod rigid;
mod similarity;
mod transform;

pub use assembly::{Linearisation, NodeAssembly, Stiffness};
pub use autodiff::{Autodiff, AutodiffError, Point, PositionFunction};
pub use blendshape::{Blendshape, blendshape};
pub use graph::{Graph, graph};
pub use hybrid::{Hybrid, hybrid};
pub use node_graph::NodeGraph;
pub use rigid::{Rigid, rigid};
pub use similarity::{Similarity, similarity};
pub use transform::{AffineMap, NodeTransform, RigidMotion, SimilarityMotion};

use crate::mesh::Vec3;

fn centroid(positions: &[Vec3]) -> Vec3 {
    positions.iter().sum::<Vec3>() / positions.len().max(1) as f64
}
