//! The same shape on another graph: from the few nodes of a registration's stiff levels to the many of its soft ones.

use super::regulariser::GraphRegulariser;
use super::{AffineMap, Hybrid, NodeGraph, NodeTransform, Placement, node_range};
use crate::mesh::Vec3;
use crate::nlls::Manifold;

impl<T: NodeTransform<W>, const W: usize> Hybrid<T, W> {
    /// Puts `graph` in the place of the present one, and returns that and the parameters that stand for the shape at `x`: each new
    /// node takes its own vertex i to where that is, and turns as the old nodes turn it there, by the motion nearest to `Rbar_i`.
    /// Samples must be [analysed](crate::energy::DeformationModel::analyse) anew.
    ///
    /// # Panics
    /// If the graph is not of as many vertices.
    pub fn exchange_graph(&mut self, graph: NodeGraph, x: &[f64]) -> (NodeGraph, Vec<f64>) {
        assert_eq!(graph.vertex_count(), self.rest.len(), "graph and rest positions must have as many vertices");
        self.place(x);
        let mut parameters = vec![0.0; graph.free_nodes() * T::Parameters::AMBIENT];
        for (j, vertex) in graph.own_vertices(&self.rest).into_iter().take(graph.free_nodes()).enumerate() {
            let point = vertex.map_or_else(|| T::IDENTITY.to_vec(), |i| self.motion_of(i, graph.nodes()[j]));
            parameters[node_range::<T, W>(j)].copy_from_slice(&point);
        }
        parameters.extend_from_slice(self.weights(x));
        self.regulariser = GraphRegulariser::new(&graph, &self.rest);
        self.placed = Placement::default();
        self.seeded.clear();
        (std::mem::replace(&mut self.graph, graph), parameters)
    }

    /// How a node at `node` moves that does to vertex `i` what the placed nodes do.
    fn motion_of(&self, i: usize, node: Vec3) -> Vec<f64> {
        let (mut linear, mut position) = ([[0.0; 3]; 3], Vec3::zeros());
        for &(j, omega) in self.graph.influences(i) {
            let (map, x_j) = (&self.placed.maps[j as usize], self.graph.nodes()[j as usize]);
            position += (Vec3::from(map.apply((self.placed.blend[i] - x_j).into())) + x_j) * omega;
            for (sum, row) in linear.iter_mut().zip(map.linear) {
                sum.iter_mut().zip(row).for_each(|(sum, entry)| *sum += omega * entry);
            }
        }
        let turn = T::map(&T::nearest(&AffineMap { linear, translation: [0.0; 3] }));
        let turned = Vec3::from(turn.apply((self.placed.blend[i] - node).into()));
        T::nearest(&AffineMap { translation: (position - node - turned).into(), ..turn })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;
    use crate::energy::DeformationModel;
    use crate::mesh::TriangleMesh;
    use crate::mesh::testing::{noise, sheet};
    use crate::model::{AffineMotion, AngleAxisMotion, QuaternionMotion, RigidMotion, Stiffness};
    use crate::rig::{Family, Shape, ShapeBasis};

    fn curved() -> TriangleMesh {
        sheet(30, 30, |c, r| Vec3::new(c, r, 3.0 * (0.2 * c).sin() * (0.15 * r).cos()))
    }

    /// Parameters whose nodes move as `motion` says where they are, and the weight of the one shape.
    fn moved<T: NodeTransform<W>, const W: usize>(
        graph: &NodeGraph,
        motion: impl Fn(Vec3) -> (Rotation3<f64>, Vec3),
    ) -> Vec<f64> {
        let node = |x_j: &Vec3| {
            let (turn, translation) = motion(*x_j);
            let linear = std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)]));
            T::nearest(&AffineMap { linear, translation: translation.into() })
        };
        graph.nodes().iter().flat_map(node).chain([0.7]).collect()
    }

    fn exchange<T: NodeTransform<W>, const W: usize>() {
        let mesh = curved();
        let graph = |nodes| NodeGraph::along_surface(&mesh, nodes, 4).unwrap();
        let deltas = (0..2700).map(|i| noise(i) as f32).collect();
        let shape = Shape { name: "shape".into(), family: Family::Expression };
        let shapes = ShapeBasis::new(vec![shape], deltas);
        let mut model: Hybrid<T, W> =
            Hybrid::with_motion(mesh.positions.clone(), graph(20), shapes, Stiffness::default());
        let positions = |model: &mut Hybrid<T, W>, x: &[f64]| {
            let mut out = Vec::new();
            model.positions(x, &mut out);
            out
        };
        // One rigid motion for all is the same with any nodes.
        let turn = Rotation3::from_euler_angles(0.5, -0.3, 0.9);
        let rigid = |x_j: Vec3| (turn, turn * x_j - x_j + Vec3::new(3.0, -2.0, 1.0));
        let x = moved::<T, W>(model.graph(), rigid);
        let before = positions(&mut model, &x);
        let (coarse, fine) = model.exchange_graph(graph(120), &x);
        assert_eq!((coarse.nodes().len(), fine.len()), (20, model.parameter_len()));
        for (a, b) in before.iter().zip(positions(&mut model, &fine)) {
            approx::assert_abs_diff_eq!(*a, b, epsilon = 1e-11);
        }
        // A bend is followed by more nodes where a few make it.
        model.exchange_graph(coarse, &fine);
        let bend = |x_j: Vec3| {
            let turn = Rotation3::from_axis_angle(&Vec3::y_axis(), -0.02 * (x_j.x - 15.0));
            (turn, Vec3::new(0.0, 0.0, 0.01 * (x_j.x - 15.0).powi(2)))
        };
        let x = moved::<T, W>(model.graph(), bend);
        let before = positions(&mut model, &x);
        let (_, fine) = model.exchange_graph(graph(300), &x);
        let after = positions(&mut model, &fine);
        let apart = |(a, b): (&Vec3, &Vec3)| (a - b).norm();
        let worst = before.iter().zip(&after).map(apart).fold(0.0, f64::max);
        let moved = before.iter().zip(&mesh.positions).map(apart).fold(0.0, f64::max);
        assert!(worst < 0.1 * moved, "{worst} of {moved}");
        assert_eq!(model.weights(&fine), [0.7]);
    }

    #[test]
    fn the_shape_is_the_same_on_another_graph_for_every_kind_of_node() {
        exchange::<RigidMotion, 6>();
        exchange::<QuaternionMotion, 6>();
        exchange::<AngleAxisMotion, 6>();
        exchange::<AffineMotion, 12>();
    }
}
