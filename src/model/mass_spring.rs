//! Springs: along the edges of the surface, and through what is inside, which keeps it from folding.
//!
//! ```text
//!     E = lambda sum_(i,j) k_ij ( |x_i - x_j| - l_ij )^2          k_ij = A_ij / h_ij^2
//! ```
//!
//! What is found is the equilibrium, the minimum of the springs' energy under the data: no masses, no time. `A_ij` is the area that
//! a spring stands for, `h_ij` how much it lengthens when the tissue is strained by one, so that stiffness depends neither on the
//! triangulation nor on the unit (A. Van Gelder, "Approximate simulation of elastic membranes by triangulated spring meshes",
//! 1998, is the case of the edges, `h = l`).
//!
//! Springs of the surface alone, struts across its edges included, do not resist a push along the normal where it is flat. Radial
//! springs to one inner node (R. Balaniuk, I. Costa, J. Melo, "Cosmetic breast surgery simulation", 2006) hold each vertex by itself:
//! a smooth dent costs what a rough one does. So there is an inner surface under the skin, with the same edges, a radial spring
//! below each vertex and both diagonals below each edge: a smooth dent bends the layer little, a rough one much.
//!
//! Gauss-Newton drops what the energy's curvature has of `|x_i - x_j| - l_ij`: negative across a compressed spring, so that the
//! whole could be indefinite. `J'J` never is.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::elements::Elements;
use super::factory::{ModelError, ModelFactory, ModelInput, RegistrationModel, SmoothLevel};
use super::on_patch::{PatchFactory, PatchInput};
use super::vertex_assembly::{CHUNK, VertexAssembly};
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, Options, OptionsError, QuadricField, Samples};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::normals::{face_areas, vertex_areas};
use crate::mesh::{InnerLayer, MeshError, TriangleMesh, Vec3};
use crate::nlls::{BlockStructure, NormalEquations};

/// `[model]` of springs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SpringOptions {
    /// Depth of the inner surface below the skin, millimetres; less where it would fold.
    pub thickness: f64,
}

impl Default for SpringOptions {
    fn default() -> Self {
        Self { thickness: 5.0 }
    }
}

impl OptionTable for SpringOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::positive("thickness", self.thickness)
    }
}

/// A lever below this part of the mean edge counts as that: coincident vertices would be tied infinitely stiffly.
const SHORTEST: f64 = 1e-2;

/// Area that a tie of a vertex without tissue stands for, as a part of a vertex' own.
const TIE: f64 = 1e-3;

/// A surface on springs.
pub struct MassSpring {
    /// `lambda` of the springs.
    pub lambda_smooth: f64,
    assembly: VertexAssembly,
    springs: Elements<2>,
    laws: Vec<Law>,
    nodes: Vec<Vec3>,
    energies: Vec<f64>,
}

/// Stiffness and rest length of a spring.
#[derive(Debug, Clone, Copy)]
struct Law {
    stiffness: f64,
    length: f64,
}

impl MassSpring {
    /// Springs at rest on `mesh`; `options` has lengths in the mesh's unit.
    ///
    /// Vertices without tissue (in no triangle, or in such without area) hang on the nearest that has some, turning with it.
    /// Parts without data stay where they are if the solver damps (`Options::with_damping_floor`); without damping the normal
    /// equations are singular, which is an error there.
    ///
    /// # Errors
    /// When a position is not finite, a triangle indexes past the vertices, or no triangle has an area.
    ///
    /// # Panics
    /// If the thickness is not positive.
    pub fn new(mesh: &TriangleMesh, options: SpringOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        let layer = InnerLayer::new(mesh, options.thickness)?;
        let mut net = Net::default();
        let distance = |a: u32, b: u32| (layer.nodes[a as usize] - layer.nodes[b as usize]).norm();
        let graph = EdgeGraph::of(mesh);
        for (&[a, b], area) in graph.edges().iter().zip(edge_areas(mesh, &graph)) {
            let l = distance(a, b);
            let (Some(c), Some(d)) = (layer.below[a as usize], layer.below[b as usize]) else {
                net.lay(a, b, area, l);
                continue;
            };
            net.lay(a, b, area / 2.0, l);
            net.lay(c, d, area / 2.0, distance(c, d));
            let depth = (distance(a, c) + distance(b, d)) / 2.0;
            for [p, q] in [[a, d], [b, c]] {
                net.lay(p, q, area / 2.0, l * depth.max(l) / distance(p, q));
            }
        }
        let areas = vertex_areas(&mesh.positions, &mesh.triangles);
        for (v, below) in layer.below.iter().enumerate() {
            below.iter().for_each(|&c| net.lay(v as u32, c, areas[v], distance(v as u32, c)));
        }
        let tie = TIE * areas.iter().sum::<f64>() / areas.len() as f64;
        for &[v, ref others @ ..] in &layer.ties {
            others.iter().for_each(|&k| net.lay(v, k, tie, distance(v, k)));
        }
        let lengths = graph.lengths(&mesh.positions);
        let shortest = SHORTEST * lengths.iter().sum::<f64>() / lengths.len() as f64;
        let laws = net.ends.iter().zip(&net.areas_and_levers).map(|(&[a, b], (area, lever))| Law {
            stiffness: area / lever.max(shortest).powi(2),
            length: distance(a, b),
        });
        let laws: Vec<Law> = laws.collect();
        let assembly = VertexAssembly::new(layer.nodes, mesh.positions.len(), &net.ends);
        let energies = vec![0.0; laws.len()];
        Ok(Self { lambda_smooth, assembly, springs: Elements::new(net.ends), laws, nodes: Vec::new(), energies })
    }

    /// Ends, `k_ij` and `l_ij` of all springs. Ends from [`vertex_count`](DeformationModel::vertex_count) on are inner nodes.
    pub fn springs(&self) -> impl Iterator<Item = ([u32; 2], f64, f64)> + '_ {
        self.springs.nodes.iter().zip(&self.laws).map(|(ends, law)| (*ends, law.stiffness, law.length))
    }

    /// Holds the marked vertices at rest: they are not parameters, and their positions are copied bit for bit.
    ///
    /// # Panics
    /// If there is not one mark per vertex.
    #[must_use]
    pub fn with_held(self, held: &[bool]) -> Self {
        let rest = self.assembly.rest[..self.vertex_count()].to_vec();
        self.with_held_at(held, &rest)
    }

    /// Holds the marked vertices at the given positions, bit for bit; positions of other vertices are ignored. The nodes below
    /// them stay free.
    ///
    /// # Panics
    /// If there is not one mark and one position per vertex.
    #[must_use]
    pub fn with_held_at(mut self, held: &[bool], positions: &[Vec3]) -> Self {
        self.assembly.hold(held, positions);
        self
    }

    /// In how many directions parts of the template can be shifted without any data noticing, at the last linearisation.
    #[must_use]
    pub fn unobserved_shifts(&self) -> usize {
        self.assembly.unobserved_shifts()
    }
}

/// Springs as they are laid.
#[derive(Default)]
struct Net {
    ends: Vec<[u32; 2]>,
    areas_and_levers: Vec<(f64, f64)>,
}

impl Net {
    fn lay(&mut self, a: u32, b: u32, area: f64, lever: f64) {
        self.ends.push([a, b]);
        self.areas_and_levers.push((area, lever));
    }
}

/// A third of the area of the triangles at every edge; they sum to the surface.
fn edge_areas(mesh: &TriangleMesh, graph: &EdgeGraph) -> Vec<f64> {
    let mut shares = vec![0.0; graph.edges().len()];
    for (t, area) in mesh.triangles.iter().zip(face_areas(&mesh.positions, &mesh.triangles)) {
        let sides = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        sides.iter().filter_map(|&[a, b]| graph.find(a, b)).for_each(|edge| shares[edge] += area / 3.0);
    }
    shares
}

impl DeformationModel for MassSpring {
    fn name(&self) -> &'static str {
        "mass_spring"
    }

    fn vertex_count(&self) -> usize {
        self.assembly.vertex_count()
    }

    fn parameter_len(&self) -> usize {
        self.assembly.parameter_len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        self.assembly.rest_parameters()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        let structure = self.assembly.analyse(samples, self.springs.cliques());
        self.springs.analyse(&self.assembly, &structure, 1);
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.assembly.positions(x, out, |_, v| v);
        out.truncate(self.assembly.vertex_count());
    }

    fn pull_back(&mut self, _x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.assembly.pull_back(field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.assembly.positions(x, &mut self.nodes, |_, v| v);
        let (nodes, ends, laws) = (&self.nodes, &self.springs.nodes, &self.laws);
        self.energies.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            for (k, energy) in chunk.iter_mut().enumerate() {
                let [a, b] = ends[c * CHUNK + k].map(|v| nodes[v as usize]);
                let Law { stiffness, length } = laws[c * CHUNK + k];
                *energy = stiffness * ((a - b).norm() - length).powi(2);
            }
        });
        out.push(("springs", self.lambda_smooth * self.energies.iter().sum::<f64>()));
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.assembly.positions(x, &mut self.nodes, |_, v| v);
        let (nodes, laws, lambda) = (&self.nodes, &self.laws, self.lambda_smooth);
        self.springs.add(equations, |s, ends| {
            let [a, b] = ends.map(|v| nodes[v as usize]);
            let Law { stiffness, length } = laws[s];
            let root = (lambda * stiffness).sqrt();
            let (along, now) = ((a - b), (a - b).norm());
            // Where both ends meet there is no direction, and the spring pulls nowhere.
            let along = if now > 0.0 { along * (root / now) } else { Vec3::zeros() };
            ([[along, -along]], [root * (now - length)])
        });
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        VertexAssembly::retract(x, step, out);
    }
}

impl RegistrationModel for MassSpring {
    fn set_level(&mut self, options: &Options, _unit: f64) -> Result<(), OptionsError> {
        self.lambda_smooth = options.read::<SmoothLevel>()?.lambda_smooth;
        Ok(())
    }

    fn unobserved_directions(&self) -> Option<usize> {
        (self.lambda_smooth > 0.0).then(|| self.unobserved_shifts())
    }
}

pub(super) struct Factory;

impl ModelFactory for Factory {
    fn name(&self) -> &'static str {
        "mass_spring"
    }

    fn default_schedule(&self) -> &'static str {
        include_str!("schedules/mass_spring.toml")
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<SpringOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let SpringOptions { thickness } = input.options.read()?;
        let options = SpringOptions { thickness: input.length(thickness) };
        Ok(Box::new(MassSpring::new(input.rest, options, 1.0)?))
    }

    fn on_patch(&self) -> Option<&dyn PatchFactory> {
        Some(self)
    }
}

impl PatchFactory for Factory {
    fn by_vertex(&self) -> bool {
        true
    }

    fn build_on_patch(&self, input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
        let tissue = MassSpring::new(input.mesh, SpringOptions::default(), input.gradient_weight())?;
        Ok(Box::new(tissue.with_held_at(input.held, input.places)))
    }
}
