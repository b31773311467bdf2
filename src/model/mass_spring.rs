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
use super::factory::BuiltIn;
use super::vertex_assembly::{CHUNK, VertexAssembly};
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{NamedEnergy, OptionTable, OptionsError, Samples};
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
pub type MassSpring = VertexModel<Springs>;

/// The springs.
pub struct Springs {
    ends: Elements<2>,
    laws: Vec<Law>,
    now: Vec<Now>,
}

/// Stiffness and rest length of a spring.
#[derive(Debug, Clone, Copy)]
struct Law {
    stiffness: f64,
    length: f64,
}

/// From its second end to its first, and how much longer it is than at rest.
#[derive(Debug, Clone, Copy)]
struct Now {
    along: Vec3,
    longer: f64,
}

impl MassSpring {
    /// Springs at rest on `mesh`; `options` has lengths in the mesh's unit.
    ///
    /// Vertices without tissue (in no triangle, or in such without area) hang on the nearest that has some, turning with it.
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
        let vertices = VertexAssembly::new(layer.nodes, mesh.positions.len(), &net.ends);
        let now = vec![Now { along: Vec3::zeros(), longer: 0.0 }; laws.len()];
        Ok(Self::of(Springs { ends: Elements::new(net.ends), laws, now }, vertices, lambda_smooth))
    }

    /// Ends, `k_ij` and `l_ij` of all springs. Ends from [`vertex_count`](crate::energy::DeformationModel::vertex_count) on are inner nodes.
    pub fn springs(&self) -> impl Iterator<Item = ([u32; 2], f64, f64)> + '_ {
        let Springs { ends, laws, .. } = &self.regulariser;
        ends.nodes.iter().zip(laws).map(|(ends, law)| (*ends, law.stiffness, law.length))
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

impl VertexRegulariser for Springs {
    const NAME: &'static str = "mass_spring";

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        let structure = vertices.analyse(samples, self.ends.cliques());
        self.ends.analyse(vertices, &structure, 1);
        structure
    }

    fn fit(&mut self, nodes: &[Vec3]) {
        let (ends, laws) = (&self.ends.nodes, &self.laws);
        self.now.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(k, now)| {
            let [a, b] = ends[k].map(|v| nodes[v as usize]);
            *now = Now { along: a - b, longer: (a - b).norm() - laws[k].length };
        });
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        let each = self.laws.iter().zip(&self.now).map(|(law, now)| law.stiffness * now.longer.powi(2));
        out.push(("springs", lambda * each.sum::<f64>()));
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        let (laws, now) = (&self.laws, &self.now);
        self.ends.add(equations, |s, _| {
            let (root, Now { along, longer }) = ((lambda * laws[s].stiffness).sqrt(), now[s]);
            let length = along.norm();
            // Where both ends meet there is no direction, and the spring pulls nowhere.
            let along = if length > 0.0 { along * (root / length) } else { Vec3::zeros() };
            ([[along, -along]], [root * longer])
        });
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<SpringOptions>("mass_spring", include_str!("schedules/mass_spring.toml"), |input| {
        let SpringOptions { thickness } = input.options.read()?;
        let options = SpringOptions { thickness: input.length(thickness) };
        Ok(Box::new(MassSpring::new(input.rest, options, 1.0)?))
    })
    .on_patch_by_vertex(&["smoothing"], |input| {
        MassSpring::new(input.mesh, SpringOptions::default(), input.gradient_weight())?.on_patch(input)
    });
