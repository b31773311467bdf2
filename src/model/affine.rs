//! Per-vertex affine maps, the model of optimal-step N-ICP (B. Amberg, S. Romdhani, T. Vetter, "Optimal step nonrigid ICP
//! algorithms for surface registration", CVPR 2007).
//!
//! ```text
//!     v_i      = X_i [q_i; 1]                                             X_i: 3 x 4, eq. (1)
//!     q_i      = (v0_i - c) / s                                           c the centroid, s the rms size of the rest shape
//!     E_smooth = lambda sum_(i,j) w_ij |(X_i - X_j) G|_F^2                G = diag(1, 1, 1, gamma), eqs. (3), (10)
//! ```
//!
//! The model is linear in its parameters, so its normal equations are exact and one step solves them (the paper's eq. (12)).
//!
//! # Units
//! `q_i` is of order one and has no unit, so all twelve entries of `X_i` are in the unit of the vertices: `gamma` has no unit,
//! and neither does `lambda`, whatever the size of the shape. The paper puts raw homogeneous coordinates in the place of
//! `[q_i; 1]`; with the origin at our centroid its stiffness term is ours with `gamma = gamma_paper s`, an inverse length there,
//! and `lambda = alpha / s^2`, `alpha` being the factor of `E_s` in its eq. (6) (its eq. (12) has `alpha` inside the norm, so
//! squared).
//!
//! trimesh's `nricp_amberg` first divides by the diagonal `d` of the bounding box, has every edge once for each face that it
//! bounds, divided by its length, and squares its weights: `w_ij = faces_ij d^2 / l_ij^2` (`l_ij` in the unit of the vertices),
//! `lambda = ws^2 d^2 / s^2`, `gamma = gamma_trimesh s / d`, landmarks weigh `wl^2`, and its energy times `d^2` is ours. Its
//! centroid is that of the surface, ours that of the vertices; `gamma` sees the difference.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::factory::{BuiltIn, RegistrationModel, SmoothLevel};
use super::linear_samples::LinearSamples;
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, Options, OptionsError, QuadricField, Samples};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{MeshError, TriangleMesh, Vec3, rms_size};
use crate::nlls::{BlockStructure, NormalEquations};

/// Entries of one `X_i`: rows x, y, z of four.
const SIZE: usize = 12;
/// Vertices that one task places.
const CHUNK: usize = 512;

/// Per-vertex affine maps under the stiffness of Amberg et al. 2007.
///
/// Parameters are the `X_i` row by row, one for every vertex that an edge reaches, in vertex order. A vertex without edges has
/// none of its own: it takes part in the map of the nearest vertex that has.
#[derive(Debug)]
pub struct Affine {
    /// `lambda`, per edge; changed from level to level of a registration.
    pub lambda: f64,
    gamma: f64,
    centre: Vec3,
    size: f64,
    vertices: Vec<Corner>,
    block_count: usize,
    /// Blocks at the ends of each edge.
    edges: Vec<[u32; 2]>,
    edge_weights: Vec<f64>,
    /// Per block: the other end of each of its edges, and the edge's weight.
    neighbours: Vec<Vec<(u32, f64)>>,
    samples: LinearSamples<4>,
}

/// `X_block h`, a term of a position.
#[derive(Debug, Clone, Copy)]
struct Corner {
    block: u32,
    h: [f64; 4],
}

impl Corner {
    fn position(&self, x: &[f64]) -> Vec3 {
        let x = &x[self.block as usize * SIZE..][..SIZE];
        let row = |a: usize| (0..4).map(|k| x[4 * a + k] * self.h[k]).sum();
        Vec3::new(row(0), row(1), row(2))
    }
}

impl Affine {
    /// The model on a rest shape, every edge of weight one as in the paper. `gamma` weighs differences of translation against
    /// those of the linear parts, both as displacements; 1 is a sound choice.
    ///
    /// # Errors
    /// When a position is not finite or a triangle refers to a vertex that does not exist.
    ///
    /// # Panics
    /// If `gamma` is not positive and finite.
    pub fn new(rest: &TriangleMesh, lambda: f64, gamma: f64) -> Result<Self, MeshError> {
        assert!(gamma > 0.0 && gamma.is_finite(), "gamma is {gamma}, but must be positive and finite");
        rest.check()?;
        let surface = rest.surface_points();
        let centre = super::centroid(&surface);
        let size = Some(rms_size(&surface)).filter(|size| *size > 0.0).unwrap_or(1.0);

        let graph = EdgeGraph::of(rest);
        let (owner, block_count) = owners(&graph, &rest.positions)?;
        let homogeneous = |p: &Vec3| {
            let q = (p - centre) / size;
            [q.x, q.y, q.z, 1.0]
        };
        let vertices =
            rest.positions.iter().zip(&owner).map(|(p, &block)| Corner { block, h: homogeneous(p) }).collect();
        let edges: Vec<[u32; 2]> = graph.edges().iter().map(|e| e.map(|v| owner[v as usize])).collect();
        let mut model = Self {
            lambda,
            gamma,
            centre,
            size,
            vertices,
            block_count,
            edge_weights: vec![1.0; edges.len()],
            edges,
            neighbours: Vec::new(),
            samples: LinearSamples::default(),
        };
        model.join();
        Ok(model)
    }

    /// The same model with weights `w_ij`, one for each of [`EdgeGraph::edges`], none negative.
    ///
    /// # Panics
    /// If there are not as many weights as edges.
    #[must_use]
    pub fn with_edge_weights(mut self, weights: Vec<f64>) -> Self {
        assert_eq!(weights.len(), self.edges.len(), "one weight for each edge");
        self.edge_weights = weights;
        self.join();
        self
    }

    /// `s`, the root-mean-square distance of the rest shape's vertices from their centroid.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.size
    }

    fn join(&mut self) {
        self.neighbours = vec![Vec::new(); self.block_count];
        for (&[a, b], &w) in self.edges.iter().zip(&self.edge_weights) {
            self.neighbours[a as usize].push((b, w));
            self.neighbours[b as usize].push((a, w));
        }
    }

    /// The squares of the diagonal of G, times `lambda`.
    fn stiffness(&self) -> [f64; 4] {
        [1.0, 1.0, 1.0, self.gamma * self.gamma].map(|g| self.lambda * g)
    }
}

/// The block of every vertex, and their number: blocks in vertex order for vertices with edges, the nearest of those for the
/// others (which all have blocks of their own if there are no edges).
fn owners(graph: &EdgeGraph, positions: &[Vec3]) -> Result<(Vec<u32>, usize), MeshError> {
    let connected: Vec<u32> =
        (0..positions.len() as u32).filter(|&v| !graph.neighbours(v as usize).is_empty()).collect();
    let points: Vec<Vec3> = connected.iter().map(|&v| positions[v as usize]).collect();
    let nearest = ClosestVertices::new(&points)?;
    let mut owner = vec![u32::MAX; positions.len()];
    for (block, &v) in connected.iter().enumerate() {
        owner[v as usize] = block as u32;
    }
    let mut count = connected.len();
    for (owner, p) in owner.iter_mut().zip(positions).filter(|o| *o.0 == u32::MAX) {
        *owner = nearest.query(p).map_or(count as u32, |found| found.vertex);
        count += usize::from(*owner as usize == count);
    }
    Ok((owner, count))
}

impl DeformationModel for Affine {
    fn name(&self) -> &'static str {
        "per-vertex affine"
    }

    fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    fn parameter_len(&self) -> usize {
        self.block_count * SIZE
    }

    fn rest_parameters(&self) -> Vec<f64> {
        let (s, c) = (self.size, self.centre);
        [s, 0.0, 0.0, c.x, 0.0, s, 0.0, c.y, 0.0, 0.0, s, c.z].repeat(self.block_count)
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.vertices.len(), "samples were made for another template");
        let moved_by = |v: u32| {
            let Corner { block, h } = self.vertices[v as usize];
            std::iter::once((block, h))
        };
        let edges = self.edges.iter().map(|e| (e[0] as usize, e[1] as usize));
        self.samples.analyse(samples, self.block_count, moved_by, edges)
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        out.resize(self.vertices.len(), Vec3::zeros());
        out.par_iter_mut().zip(&self.vertices).with_min_len(CHUNK).for_each(|(v, c)| *v = c.position(x));
    }

    fn pull_back(&mut self, _x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.samples.pull_back(field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        let weights = self.stiffness();
        let mut sum = 0.0;
        for (&[a, b], w) in self.edges.iter().zip(&self.edge_weights) {
            let [a, b] = [a, b].map(|v| &x[v as usize * SIZE..][..SIZE]);
            let squares: f64 = (0..SIZE).map(|k| weights[k % 4] * (a[k] - b[k]) * (a[k] - b[k])).sum();
            sum += w * squares;
        }
        out.push(("affine stiffness", sum));
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        let structure = equations.structure().clone();
        let weights = self.stiffness();
        equations.for_each_block_row(&|i, row| {
            let own = &x[i * SIZE..][..SIZE];
            let diagonal = row.blocks.len() - SIZE * SIZE;
            for &(j, w) in &self.neighbours[i] {
                let other = &x[j as usize * SIZE..][..SIZE];
                for k in 0..SIZE {
                    let weight = w * weights[k % 4];
                    row.blocks[diagonal + k * (SIZE + 1)] += weight;
                    row.gradient[k] += weight * (own[k] - other[k]);
                }
                if (j as usize) < i {
                    let at = position(&structure, i, j);
                    for k in 0..SIZE {
                        row.blocks[at + k * (SIZE + 1)] -= w * weights[k % 4];
                    }
                }
            }
        });
    }
}

/// Where block (`i`, `j`) starts in block row `i`.
fn position(structure: &BlockStructure, i: usize, j: u32) -> usize {
    let k =
        structure.row(i).binary_search(&(j as usize)).expect("proven: `analyse` added all pairs of edges and samples");
    k * SIZE * SIZE
}

/// `[model]` of per-vertex affine maps: how they differ at a cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AffineOptions {
    /// `gamma` of Amberg et al. 2007: weight of differences of translation against those of the linear parts, both as
    /// displacements at the template's root-mean-square size.
    pub gamma: f64,
}

impl Default for AffineOptions {
    fn default() -> Self {
        Self { gamma: 1.0 }
    }
}

impl OptionTable for AffineOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::positive("gamma", self.gamma)
    }
}

impl RegistrationModel for Affine {
    fn set_level(&mut self, options: &Options, _unit: f64) -> Result<(), OptionsError> {
        self.lambda = options.read::<SmoothLevel>()?.lambda_smooth;
        Ok(())
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<AffineOptions>("affine", include_str!("schedules/affine.toml"), |input| {
        let gamma = input.options.read::<AffineOptions>()?.gamma;
        Ok(Box::new(Affine::new(input.rest, 1.0, gamma)?))
    });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet, side_by_side};

    fn bumpy() -> TriangleMesh {
        sheet(6, 5, |c, r| Vec3::new(20.0 * c, 20.0 * r, 30.0 * (c * 0.7).sin() + 10.0 * r))
    }

    #[test]
    fn a_vertex_without_edges_follows_the_map_of_the_nearest_that_has() {
        let mut mesh = side_by_side(&bumpy(), &bumpy());
        mesh.positions.insert(0, Vec3::new(41.0, 39.0, 100.0));
        mesh.triangles.iter_mut().flatten().for_each(|v| *v += 1);
        let mut model = Affine::new(&mesh, 1.0, 1.0).unwrap();
        assert_eq!((model.vertex_count(), model.parameter_len()), (61, 12 * 60));
        let near = (1..61).min_by(|&a, &b| {
            let d = |i: usize| (mesh.positions[i] - mesh.positions[0]).norm();
            d(a).total_cmp(&d(b))
        });
        let near = near.unwrap();
        let mut x = model.rest_parameters();
        let mut rest = Vec::new();
        model.positions(&x, &mut rest);
        let error = rest.iter().zip(&mesh.positions).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(error < 1e-12, "{error}");
        // An affine map about the origin at the nearest vertex alone moves both, and nobody else.
        for (k, x) in x[(near - 1) * SIZE..near * SIZE].iter_mut().enumerate() {
            *x += noise(k);
        }
        let mut moved = Vec::new();
        model.positions(&x, &mut moved);
        for i in 0..61 {
            let q = (mesh.positions[i] - model.centre) / model.size;
            let shift = Vec3::from_fn(|a, _| (0..3).map(|b| noise(4 * a + b) * q[b]).sum::<f64>() + noise(4 * a + 3));
            let expected = if i == 0 || i == near { mesh.positions[i] + shift } else { mesh.positions[i] };
            assert!((moved[i] - expected).norm() < 1e-12, "vertex {i}");
        }
    }

    #[test]
    fn without_edges_every_vertex_has_a_map_of_its_own() {
        let cloud = TriangleMesh { positions: vec![Vec3::x(), Vec3::y(), Vec3::x()], triangles: Vec::new() };
        assert_eq!(Affine::new(&cloud, 1.0, 1.0).unwrap().parameter_len(), 36);
        let point = TriangleMesh { positions: vec![Vec3::x(); 3], triangles: vec![[0, 1, 2]] };
        let mut model = Affine::new(&point, 1.0, 1.0).unwrap();
        let (x, mut positions) = (model.rest_parameters(), Vec::new());
        model.positions(&x, &mut positions);
        assert_eq!(positions, point.positions);
    }

    #[test]
    fn the_size_of_the_shape_does_not_matter() {
        // The same relative change of the maps costs the square of the scale, as squared distances do.
        let energy = |scale: f64| {
            let mut mesh = bumpy();
            mesh.positions.iter_mut().for_each(|p| *p = *p * scale + Vec3::new(700.0, -5.0, 3.0));
            let mut model = Affine::new(&mesh, 2.0, 1.5).unwrap();
            let mut x = model.rest_parameters();
            x.iter_mut().enumerate().for_each(|(k, x)| *x += scale * noise(k));
            let mut energies = Vec::new();
            model.regulariser_energy(&x, &mut energies);
            energies[0].1
        };
        let (one, large) = (energy(1.0), energy(1000.0));
        assert!((large / (1e6 * one) - 1.0).abs() < 1e-9, "{one} {large}");
    }

    #[test]
    fn bad_meshes_are_named() {
        let mut mesh = bumpy();
        mesh.positions[4].y = f64::NAN;
        assert!(matches!(Affine::new(&mesh, 1.0, 1.0), Err(MeshError::NotFinite { vertex: 4, .. })));
        let mut mesh = bumpy();
        mesh.triangles[2][1] = 30;
        let error = Affine::new(&mesh, 1.0, 1.0).unwrap_err();
        assert_eq!(error, MeshError::IndexOutOfRange { triangle: 2, index: 30, count: 30 });
    }
}
