//! What the benchmarks share: how long they measure, a face, models of it, and the problem of one step of a registration.
#![allow(dead_code)] // every benchmark uses its own part of this

use std::time::Duration;

use criterion::Criterion;
use data_gen::{FaceOptions, FaceRig};
use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::model::{Hybrid, NodeGraph, Stiffness};
use nonrigid::nlls::{Kernel, Problem};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::{PointToPlane, PointToPoint};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Nodes of a graph where nothing else is said, and how many of them move a vertex.
pub const NODES: usize = 400;
pub const INFLUENCES: usize = 4;

/// Two seconds for each benchmark, so that a file takes a few minutes.
pub fn short() -> Criterion {
    Criterion::default()
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .sample_size(20)
}

/// A face, and the same with an expression.
pub struct Face {
    pub mesh: TriangleMesh,
    pub targets: Vec<Vec3>,
}

impl Face {
    pub fn of_size(vertices: usize) -> Self {
        let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: 2 });
        Self { mesh: rig.mesh.triangulate(), targets: rig.pose(&[0.5, 0.3], &[1.0, -1.0]) }
    }

    pub fn graph(&self, nodes: usize) -> NodeGraph {
        NodeGraph::along_surface(&self.mesh, nodes, INFLUENCES).expect("a finite mesh")
    }

    /// Smooth random shapes.
    pub fn shapes(&self, count: usize) -> ShapeBasis {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut slab = vec![0.0; 3 * self.mesh.positions.len() * count];
        for k in 0..count {
            let [frequency, direction] = [0.05, 1.0].map(|s| Vec3::from_fn(|_, _| rng.random_range(-s..s)));
            for (i, p) in self.mesh.positions.iter().enumerate() {
                for a in 0..3 {
                    slab[(3 * i + a) * count + k] = (direction[a] * frequency.dot(p).sin()) as f32;
                }
            }
        }
        let names = (0..count).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
        ShapeBasis::new(names, slab)
    }

    pub fn hybrid(&self, nodes: usize, shapes: usize) -> Hybrid {
        let stiffness = Stiffness { graph: 1.0, blend: 1.0, ..Stiffness::default() };
        Hybrid::new(self.mesh.positions.clone(), self.graph(nodes), self.shapes(shapes), stiffness)
    }

    /// The model near the expression: what a step of a registration solves.
    pub fn problem<M: DeformationModel>(&self, model: M, data: Data) -> Step<M> {
        let (targets, weights) = (self.targets.clone(), vec![1.0; self.targets.len()]);
        let kernel = Kernel::Huber { delta: 1.0 };
        let term: Box<dyn DataTerm> = match data {
            Data::PointToPlane => {
                let normals = vertex_normals(&targets, &self.mesh.triangles, NormalWeighting::Area);
                Box::new(Pointwise::new("plane", PointToPlane { targets, normals, weights, scale: 1.0 }, kernel))
            }
            Data::PointToPoint => {
                Box::new(Pointwise::new("point", PointToPoint { targets, weights, scale: 1.0 }, kernel))
            }
        };
        let mut problem = Deformation::new(model, Samples::vertices(self.mesh.positions.len()));
        problem.terms.push(term);
        Step::new(problem)
    }
}

/// What pulls the vertices.
#[derive(Debug, Clone, Copy)]
pub enum Data {
    /// One residual row a vertex.
    PointToPlane,
    /// Three.
    PointToPoint,
}

/// A problem and points at which to linearise it in turn: models keep what they know of the last one.
pub struct Step<M> {
    pub problem: Deformation<M, Box<dyn DataTerm>>,
    points: [Vec<f64>; 2],
    turn: usize,
}

impl<M: DeformationModel> Step<M> {
    fn new(problem: Deformation<M, Box<dyn DataTerm>>) -> Self {
        let rest = problem.model.rest_parameters();
        let mut near = rest.clone();
        problem.retract(&rest, &vec![1e-3; problem.structure().dimension()], &mut near);
        Self { problem, points: [rest, near], turn: 0 }
    }

    /// The problem, and the point whose turn it is.
    pub fn next(&mut self) -> (&mut Deformation<M, Box<dyn DataTerm>>, &[f64]) {
        self.turn = 1 - self.turn;
        (&mut self.problem, &self.points[self.turn])
    }
}
