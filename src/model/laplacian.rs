//! Laplacian surface editing (O. Sorkine, D. Cohen-Or, Y. Lipman, M. Alexa, C. Roessl, H.-P. Seidel, "Laplacian surface editing", SGP
//! 2004): every vertex keeps its differential coordinate, up to a similarity that follows from the positions themselves.
//!
//! ```text
//!     delta_i = L(n)_i = sum_j w_ij (n_i - n_j)                                     n at rest; their eq. (1)
//!     E_smooth = lambda sum_i (1 / a_i) |T_i(v) delta_i - L(v)_i|^2                 v the parameters; their eq. (4)
//!     T_i = s_i + h_i^  minimises  sum_(k in i and N(i)) |T_i n_k + t_i - v_k|^2    eqs. (5), (6)
//! ```
//!
//! `T_i` is linear in `v`, so the energy is quadratic, and large turns it gets wrong, as the paper says: that is `frames = "rest"`. With
//! `frames = "current"` every star is turned first by its best rotation for `v`, and `T_i` is taken round that: then the energy is a
//! function of `v` that no similarity of the whole changes, however large, and its derivatives are still exact. The algebra of `T_i` is
//! in `star_similarity.rs`.
//!
//! `a_i` is the area of a vertex in units of that of a template of the schedule's reference size, as for the bi-Laplacian of free
//! vertices, and with cotangent weights the slope at the open boundary is taken out of `delta` as there (at a cut the paper's `delta`
//! grows as triangles shrink): the energy is `integral |T Laplace n - Laplace v|^2` times an area, whatever the resolution.

use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::edge_weights::{EdgeWeights, WeightedEdges};
use super::factory::BuiltIn;
use super::free::take_out_slope;
use super::star_similarity::{Frames, Star, StarFit};
use super::vertex_assembly::{CHUNK, VertexAssembly};
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{NamedEnergy, OptionTable, Samples};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::{Assembly, BlockStructure, NormalEquations};

/// `[model]` of Laplacian surface editing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LaplacianOptions {
    /// How edges weigh in the differential coordinates: `cotangent` (default) or `uniform`.
    pub weights: EdgeWeights,
    /// What the similarities are linearised round: every star as it is turned now (`current`, default), or the rest shape (`rest`).
    pub frames: Frames,
}

impl Default for LaplacianOptions {
    fn default() -> Self {
        Self { weights: EdgeWeights::Cotangent, frames: Frames::Current }
    }
}

impl OptionTable for LaplacianOptions {}

/// A surface that keeps its differential coordinates.
pub type Laplacian = VertexModel<Differentials>;

/// The differential coordinates.
pub struct Differentials {
    frames: Frames,
    stars: Vec<Star>,
    fits: Vec<StarFit>,
    rows: Vec<Row>,
    residuals: Vec<Vec3>,
    /// The rows as items of the assembler.
    assembly: Assembly,
}

/// Three residuals, `T delta - sum_k c_k v_k`.
struct Row {
    star: u32,
    delta: Vec3,
    /// Every vertex that takes part, ascending.
    entries: Vec<Entry>,
}

struct Entry {
    vertex: u32,
    /// Its block, if it is free.
    block: Option<usize>,
    /// Which member of the star it is, if it is one.
    member: Option<u32>,
    /// `c_k`.
    coefficient: f64,
}

impl Laplacian {
    /// The surface at rest on `mesh` (millimetres). `reference_vertices` is the number of vertices of the template that `lambda` is
    /// meant for.
    ///
    /// Vertices that no triangle refers to follow the nearest one that has triangles, turning and growing with its star.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    ///
    /// # Panics
    /// If `reference_vertices` is not positive.
    pub fn new(
        mesh: &TriangleMesh,
        options: LaplacianOptions,
        reference_vertices: f64,
        lambda_smooth: f64,
    ) -> Result<Self, MeshError> {
        assert!(reference_vertices > 0.0, "reference_vertices must be positive");
        let edges = WeightedEdges::new(mesh, options.weights, false)?;
        let n = &mesh.positions;
        let mut neighbours = edges.without_ties().stars(n.len());
        let areas = edges.areas(mesh, options.weights, reference_vertices);
        let stars: Vec<Star> = neighbours.iter().enumerate().map(|(i, star)| Star::new(i, star, n)).collect();
        let mut rows = Vec::new();
        for (i, star) in neighbours.iter_mut().enumerate().filter(|(_, star)| !star.is_empty()) {
            if edges.boundary[i] && options.weights == EdgeWeights::Cotangent {
                take_out_slope(i, star, n);
            }
            rows.push(Row::new(&stars, i, i as u32, (1.0 / areas[i]).sqrt(), star, n));
        }
        for (&[loose, anchor], weight) in edges.edges.iter().zip(&edges.weights).skip(edges.of_mesh) {
            rows.push(Row::new(&stars, anchor as usize, loose, weight.sqrt(), &[(anchor, 1.0)], n));
        }
        let vertices = VertexAssembly::new(n.clone(), n.len(), &edges.joined());
        let differentials = Differentials {
            frames: options.frames,
            fits: stars.iter().map(|_| StarFit::identity()).collect(),
            stars,
            residuals: vec![Vec3::zeros(); rows.len()],
            rows,
            assembly: Assembly::default(),
        };
        Ok(Self::of(differentials, vertices, lambda_smooth))
    }
}

impl Row {
    /// `scale sum_j w_j (. - n_j)` for vertex `i`, which moves as the star does.
    fn new(stars: &[Star], star: usize, i: u32, scale: f64, others: &[(u32, f64)], n: &[Vec3]) -> Self {
        let entry = |vertex, member| Entry { vertex, block: None, member, coefficient: 0.0 };
        let members = stars[star].members.iter().enumerate();
        let mut entries: Vec<Entry> = members.map(|(k, &vertex)| entry(vertex, Some(k as u32))).collect();
        if entries.iter().all(|e| e.vertex != i) {
            entries.push(entry(i, None));
        }
        entries.sort_unstable_by_key(|e| e.vertex);
        let mut delta = Vec3::zeros();
        for &(j, w) in others {
            delta += (n[i as usize] - n[j as usize]) * (scale * w);
            for entry in &mut entries {
                let sign = f64::from(u8::from(entry.vertex == i)) - f64::from(u8::from(entry.vertex == j));
                entry.coefficient += sign * scale * w;
            }
        }
        Self { star: star as u32, delta, entries }
    }

    /// Its free blocks, ascending, each with its entry.
    fn free(&self) -> impl Iterator<Item = (u32, &Entry)> {
        self.entries.iter().filter_map(|e| Some((e.block? as u32, e)))
    }
}

impl VertexRegulariser for Differentials {
    const NAME: &'static str = "laplacian";

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        for entry in self.rows.iter_mut().flat_map(|row| &mut row.entries) {
            entry.block = vertices.block(entry.vertex);
        }
        let of = |row: &Row| row.entries.iter().map(|e| e.vertex).collect();
        let cliques: Vec<Vec<u32>> = self.rows.iter().map(of).collect();
        let structure = vertices.analyse(samples, cliques.iter().map(Vec::as_slice));
        let items: Vec<Vec<u32>> = self.rows.iter().map(|row| row.free().map(|free| free.0).collect()).collect();
        self.assembly = Assembly::new(items.iter().map(Vec::as_slice), &structure, |_| 3);
        structure
    }

    fn fit(&mut self, nodes: &[Vec3]) {
        let frames = self.frames;
        let fits = self.fits.par_iter_mut().zip(&self.stars).with_min_len(CHUNK);
        fits.for_each(|(fit, star)| fit.update(star, frames, nodes));
        let fits = &self.fits;
        let residuals = self.residuals.par_iter_mut().zip(&self.rows).with_min_len(CHUNK);
        residuals.for_each(|(residual, row)| {
            let laplacian: Vec3 = row.entries.iter().map(|e| nodes[e.vertex as usize] * e.coefficient).sum();
            *residual = fits[row.star as usize].apply(row.delta) - laplacian;
        });
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        let sum: f64 = self.residuals.iter().map(Vec3::norm_squared).sum();
        out.push(("differential coordinates", lambda * sum));
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        let (rows, stars, fits, residuals) = (&self.rows, &self.stars, &self.fits, &self.residuals);
        let (frames, root) = (self.frames, lambda.sqrt());
        self.assembly.linearize(
            0,
            |_| 3,
            |item, out| {
                let row = &rows[item];
                let (star, fit) = (&stars[row.star as usize], &fits[row.star as usize]);
                let by_member = fit.derivative(star, frames, row.delta * root);
                for (slot, (_, entry)) in row.free().enumerate() {
                    let turned = entry.member.map_or_else(Matrix3::zeros, |member| by_member(member as usize));
                    let m = turned - Matrix3::from_diagonal_element(root * entry.coefficient);
                    for (a, row) in m.row_iter().enumerate() {
                        out.of_block(slot, a).iter_mut().zip(&row).for_each(|(out, d)| *out = *d);
                    }
                }
                out.set_residuals((residuals[item] * root).as_slice());
            },
        );
        self.assembly.add_to(equations);
    }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<LaplacianOptions>("laplacian", include_str!("schedules/laplacian.toml"), |input| {
        Ok(Box::new(Laplacian::new(input.rest, input.options.read()?, input.reference_vertices, 1.0)?))
    })
    .on_patch_by_vertex(&["smoothing"], |input| {
        let (options, lambda) = (LaplacianOptions::default(), input.gradient_weight().powi(2));
        Laplacian::new(input.mesh, options, input.mesh.positions.len() as f64, lambda)?.on_patch(input)
    });

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{DMatrix, DVector, Rotation3};

    use super::*;
    use crate::energy::{DataTerm, Deformation, DeformationModel as _};
    use crate::mesh::adjacency::EdgeGraph;
    use crate::mesh::testing::{noise, sheet};
    use crate::model::vertex_assembly::testing::{broken, bumpy, flat, pins, solve_held, turn};
    use crate::model::{Free, FreeOptions, Smoothness};
    use crate::nlls::{Minimizer, Options, Problem};

    const REFERENCE: f64 = 500.0;

    fn ways() -> impl Iterator<Item = LaplacianOptions> {
        let weights = [EdgeWeights::Cotangent, EdgeWeights::Uniform].into_iter();
        weights.flat_map(|weights| [Frames::Current, Frames::Rest].map(|frames| LaplacianOptions { weights, frames }))
    }

    type Surface = Deformation<Laplacian, Box<dyn DataTerm>>;

    fn problem(mesh: &TriangleMesh, options: LaplacianOptions) -> Surface {
        let model = Laplacian::new(mesh, options, REFERENCE, 0.8).unwrap();
        Deformation::new(model, Samples::vertices(mesh.positions.len()))
    }

    #[test]
    fn similarities_cost_nothing() {
        let mut mesh = bumpy();
        mesh.positions.push(Vec3::new(20.0, 3.0, 1.0)); // in no triangle
        let shift = Vec3::new(30.0, -8.0, 1.0);
        // A similarity to first order in its turn: what the paper's T_i can be.
        let linear = Matrix3::identity() * 1.4 + Vec3::new(0.3, -0.5, 0.2).cross_matrix();
        for options in ways() {
            let similarity = match options.frames {
                Frames::Current => turn().into_inner() * 1.7,
                Frames::Rest => linear,
            };
            let moved: Vec<Vec3> = mesh.positions.iter().map(|p| similarity * p + shift).collect();
            let mut problem = problem(&mesh, options);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            for x in [&mesh.positions, &moved] {
                let energy = problem.linearize(&flat(x), &mut equations);
                assert!(energy < 1e-17, "{options:?}: {energy}");
                assert!(equations.gradient.iter().all(|g| g.abs() < 1e-7), "{options:?}");
            }
        }
    }

    /// The paper's way: the unknowns of eq. (5) by the pseudo-inverse of its matrix A_i, eq. (6).
    #[test]
    fn the_papers_energy_is_that_of_its_pseudo_inverses() {
        let mesh = bumpy();
        let n = &mesh.positions;
        let moved: Vec<Vec3> = n.iter().enumerate().map(|(i, p)| Vec3::new(p.y, -p.x, noise(i + 9) - p.z)).collect();
        let graph = EdgeGraph::of(&mesh);
        let weight = 1.0 / 3f64.sqrt();
        let mut expected = 0.0;
        for i in 0..n.len() {
            let members: Vec<usize> =
                std::iter::once(i).chain(graph.neighbours(i).iter().map(|&j| j as usize)).collect();
            let a = DMatrix::from_fn(3 * members.len(), 7, |row, column| {
                let p = n[members[row / 3]];
                [
                    [p.x, 0.0, p.z, -p.y, 1.0, 0.0, 0.0],
                    [p.y, -p.z, 0.0, p.x, 0.0, 1.0, 0.0],
                    [p.z, p.y, -p.x, 0.0, 0.0, 0.0, 1.0],
                ][row % 3][column]
            });
            let b = DVector::from_fn(3 * members.len(), |row, _| moved[members[row / 3]][row % 3]);
            let found = a.pseudo_inverse(1e-12).unwrap() * b;
            let t = Matrix3::identity() * found[0] + Vec3::new(found[1], found[2], found[3]).cross_matrix();
            let laplacian = |v: &[Vec3]| -> Vec3 { members[1..].iter().map(|&j| (v[i] - v[j]) * weight).sum() };
            expected += (t * laplacian(n) - laplacian(&moved)).norm_squared() * n.len() as f64 / REFERENCE;
        }
        let options = LaplacianOptions { weights: EdgeWeights::Uniform, frames: Frames::Rest };
        approx::assert_relative_eq!(problem(&mesh, options).energy(&flat(&moved)), 0.8 * expected, max_relative = 1e-7);
    }

    #[test]
    fn gradients_are_those_of_differences_and_the_papers_system_is_linear() {
        let mesh = bumpy();
        let strained: Vec<f64> = flat(&mesh.positions.iter().map(|p| turn() * p * 1.2).collect::<Vec<_>>())
            .iter()
            .enumerate()
            .map(|(k, x)| x + 0.3 * noise(k + 31))
            .collect();
        let d: Vec<f64> = (0..strained.len()).map(noise).collect();
        for options in ways() {
            let mut problem = problem(&mesh, options);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            problem.linearize(&strained, &mut equations);
            let mut at = |t: f64| problem.energy(&strained.iter().zip(&d).map(|(x, d)| x + t * d).collect::<Vec<_>>());
            let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
            let found: f64 = 2.0 * equations.gradient.iter().zip(&d).map(|(g, d)| g * d).sum::<f64>();
            approx::assert_relative_eq!(found, slope, max_relative = 1e-6);
            if options.frames == Frames::Rest {
                let curvature = 0.5 * (at(1.0) - 2.0 * at(0.0) + at(-1.0));
                approx::assert_relative_eq!(equations.quadratic_form(&d), curvature, max_relative = 1e-9);
            }
        }
    }

    #[test]
    fn on_a_plane_it_is_the_bending_of_free_vertices() {
        // Inside a plane delta vanishes, and so does every T delta; at the boundary it does not, so that is held still.
        let mesh = sheet(9, 7, |c, r| Vec3::new(c + 0.3 * r, r, 0.0));
        let bump = |i: usize| if (2..7).contains(&(i % 9)) && (2..5).contains(&(i / 9)) { noise(i) } else { 0.0 };
        let d: Vec<Vec3> = (0..63).map(|i| Vec3::z() * bump(i)).collect();
        let moved: Vec<Vec3> = mesh.positions.iter().zip(&d).map(|(p, d)| p + d).collect();
        for weights in [EdgeWeights::Cotangent, EdgeWeights::Uniform] {
            let kind = Smoothness::BiLaplacian;
            let mut free = Free::new(&mesh, FreeOptions { kind, weights, reference_vertices: REFERENCE }, 0.8).unwrap();
            let mut bending = Vec::new();
            free.regulariser_energy(&flat(&d), &mut bending);
            let options = LaplacianOptions { weights, frames: Frames::Rest };
            let energy = problem(&mesh, options).energy(&flat(&moved));
            approx::assert_relative_eq!(energy, bending[0].1, max_relative = 1e-9);
        }
    }

    #[test]
    fn a_fold_costs_the_same_whatever_the_resolution_and_the_unit() {
        let energy = |n: usize, unit: f64, options: LaplacianOptions| {
            let at = |c: f64, r: f64| [c, r].map(|k| k / (n - 1) as f64);
            let place = |x: f64, y: f64| Vec3::new(x, y, 0.2 * (3.0 * x).sin() * (2.0 * y).cos()) * 10.0 * unit;
            let mesh = sheet(n, n, |c, r| {
                let [x, y] = at(c, r);
                place(x, y)
            });
            let bend = |p: &Vec3| {
                let q = p / (10.0 * unit);
                Vec3::new(q.x.sin(), q.y + 0.1 * (2.0 * q.x).sin(), q.z + q.x.cos()) * 10.0 * unit
            };
            let moved: Vec<Vec3> = mesh.positions.iter().map(bend).collect();
            problem(&mesh, options).energy(&flat(&moved))
        };
        let options = LaplacianOptions::default();
        let found = [33, 65].map(|n| energy(n, 1.0, options));
        approx::assert_relative_eq!(found[0], found[1], max_relative = 0.1);
        for options in ways() {
            approx::assert_relative_eq!(energy(9, 1e-3, options) * 1e6, energy(9, 1.0, options), max_relative = 1e-6);
        }
    }

    #[test]
    fn broken_stars_loose_vertices_and_parts_without_data_stay_finite() {
        let mut mesh = broken(&bumpy());
        let small = Rotation3::from_euler_angles(0.2, -0.5, 0.3);
        let targets: Vec<Vec3> = (0..72).map(|i| small * mesh.positions[i] * 1.1 + Vec3::z()).collect();
        for options in ways() {
            let mut problem = problem(&mesh, options);
            problem.terms = pins(&(0..72).collect::<Vec<_>>(), &targets);
            let mut x = problem.model.rest_parameters();
            let minimizer = Options::gauss_newton().with_max_iterations(100).with_damping_floor(1e-9);
            let summary = Minimizer::new(minimizer.with_energy_tolerance(0.0)).unwrap().minimize(&mut problem, &mut x);
            assert!(summary.final_energy < 0.1 * summary.initial_energy, "{options:?} {summary}");
            assert_eq!(problem.model.unobserved_shifts(), 12, "{options:?}");
            let vertices = problem.vertices(&x).to_vec();
            assert!(vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
            for (v, n) in vertices.iter().zip(&mesh.positions).skip(72).take(12) {
                approx::assert_abs_diff_eq!(*v, *n, epsilon = 1e-5);
            }
            if options.frames == Frames::Current {
                let loose = small * mesh.positions[90] * 1.1 + Vec3::z();
                approx::assert_abs_diff_eq!(vertices[90], loose, epsilon = 1e-3);
            }
        }
        mesh.positions[4].y = f64::INFINITY;
        assert!(Laplacian::new(&mesh, LaplacianOptions::default(), REFERENCE, 1.0).is_err());
    }

    #[test]
    fn held_vertices_are_no_parameters_and_the_papers_minimum_is_one_step_away() {
        let mesh = bumpy();
        for options in ways() {
            let pins = pins(&[8, 71], &[Vec3::new(9.0, -1.0, 2.0), Vec3::new(8.0, 9.0, 3.0)]);
            let one = options.frames == Frames::Rest;
            let (mut problem, x) = solve_held(&mesh, pins, if one { 1 } else { 100 }, |held| {
                Laplacian::new(&mesh, options, REFERENCE, 0.8).unwrap().with_held(held)
            });
            if one {
                let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
                problem.linearize(&x, &mut equations);
                assert!(equations.gradient.iter().all(|g| g.abs() < 1e-9));
            }
        }
    }
}
