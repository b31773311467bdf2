//! The deformation graph as a user would state it: what the one inside is held and measured against.

use nonrigid::mesh::Vec3;
use nonrigid::model::{Autodiff, NodeGraph, PositionFunction};
use nonrigid::nlls::{Scalar, Se3};

/// The deformation graph, eqs. (6) and (7), as a formula.
pub struct StatedGraph {
    rest: Vec<Vec3>,
    graph: NodeGraph,
}

impl PositionFunction for StatedGraph {
    type Block = Se3;

    fn name(&self) -> &'static str {
        "stated graph"
    }

    fn rest_blocks(&self) -> Vec<[f64; 12]> {
        vec![Se3::IDENTITY; self.graph.nodes().len()]
    }

    fn vertex_blocks(&self) -> Vec<Vec<usize>> {
        (0..self.rest.len()).map(|i| self.graph.influences(i).iter().map(|i| i.0 as usize).collect()).collect()
    }

    fn position<D: Scalar>(&self, vertex: usize, p: &[[D; 12]]) -> [D; 3] {
        let mut v = [D::from(0.0); 3];
        for (&(j, omega), p) in self.graph.influences(vertex).iter().zip(p) {
            let x_j = self.graph.nodes()[j as usize];
            let moved = Se3::transform(p, std::array::from_fn(|a| D::from(self.rest[vertex][a] - x_j[a])));
            for a in 0..3 {
                v[a] += (moved[a] + x_j[a]) * omega;
            }
        }
        v
    }

    fn smoothness_blocks(&self) -> Vec<Vec<usize>> {
        self.graph.edges().iter().map(|&(i, j)| vec![i as usize, j as usize]).collect()
    }

    fn smoothness<D: Scalar>(&self, m: usize, p: &[[D; 12]]) -> [D; 3] {
        let (i, j) = self.graph.edges()[m];
        let (x_i, x_j) = (self.graph.nodes()[i as usize], self.graph.nodes()[j as usize]);
        let moved = Se3::transform(&p[0], std::array::from_fn(|a| D::from(x_j[a] - x_i[a])));
        std::array::from_fn(|a| moved[a] + x_i[a] - p[1][9 + a] - x_j[a])
    }
}

/// That model, with weight `stiffness` of (7).
pub fn stated_graph(rest: &[Vec3], graph: &NodeGraph, stiffness: f64) -> Autodiff<StatedGraph> {
    let mut model = Autodiff::new(StatedGraph { rest: rest.to_vec(), graph: graph.clone() }).unwrap();
    model.stiffness = stiffness;
    model
}
