//! Free vertices: every vertex has a displacement of its own, and a Laplacian or bi-Laplacian keeps the field smooth.
//!
//! ```text
//!     v_i = n_i + d_i
//!     E_smooth = lambda sum_(i,j) w_ij |d_i - d_j|^2                      Laplacian, each edge once
//!     E_smooth = lambda sum_i (1 / a_i) |sum_j c_ij (d_i - d_j)|^2        bi-Laplacian
//! ```
//!
//! (Botsch and Sorkine 2008, "On linear variational surface deformation methods", sections III and IV.) The first is the
//! membrane energy, the integral of `|grad d|^2`, the second the thin plate's, the integral of `(Laplace d)^2`, times the area
//! of one vertex of a template of the schedule's reference size. Both are in square millimetres, keep their value when
//! triangles are subdivided, and turn and scale with the template.
//!
//! Inside the surface `c_ij = w_ij`. On the open boundary that would charge a slope across the boundary as if it were
//! bending, so there the part of `d` that is linear along the surface is fitted to the neighbours and taken out:
//! `c_ij = w_ij (1 - e_ij' G^+ sum_k w_ik e_ik)`, with `e_ij = n_j - n_i` and `G = sum_k |w_ik| e_ik e_ik'` restricted to its two
//! leading directions.

use nalgebra::{Matrix3, SymmetricEigen};
use serde::{Deserialize, Serialize};

use super::edge_weights::{EdgeWeights, WeightedEdges};
use super::factory::BuiltIn;
use super::smooth_rows::SmoothRows;
use super::vertex_assembly::VertexAssembly;
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{NamedEnergy, OptionTable, Samples};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::{BlockStructure, NormalEquations};

/// Which derivative of the displacements costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Smoothness {
    /// The first: displacements of neighbours differ little.
    #[default]
    Laplacian,
    /// The second: displacements vary evenly. Fields linear on a flat surface are free.
    #[serde(rename = "bilaplacian")]
    BiLaplacian,
}

/// How free vertices are kept smooth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeOptions {
    /// Laplacian or bi-Laplacian.
    pub kind: Smoothness,
    /// Weights of the edges. Cotangents are clamped at zero for the Laplacian, whose energy they would make negative.
    pub weights: EdgeWeights,
    /// Number of vertices of the template that `lambda` is meant for: the bi-Laplacian's unit of area is the template's over
    /// this.
    pub reference_vertices: f64,
}

/// Free vertices under a Laplacian.
pub type Free = VertexModel<Smooth>;

/// The Laplacian of displacements, squared.
pub struct Smooth {
    rest: Vec<Vec3>,
    rows: SmoothRows,
}

/// Adds `scale sum_j c_j (d_i - d_j)`.
fn push_star(rows: &mut SmoothRows, i: u32, scale: f64, star: &[(u32, f64)]) {
    let own = (i, scale * star.iter().map(|s| s.1).sum::<f64>());
    let others = star.iter().filter(|s| s.1 != 0.0).map(|&(j, c)| (j, -scale * c));
    rows.push([own].into_iter().chain(others));
}

fn laplacian(edges: &WeightedEdges) -> SmoothRows {
    let mut rows = SmoothRows::default();
    for (&[i, j], &w) in edges.edges.iter().zip(&edges.weights) {
        push_star(&mut rows, i, w.sqrt(), &[(j, 1.0)]);
    }
    rows
}

fn bilaplacian(mesh: &TriangleMesh, edges: &WeightedEdges, options: &FreeOptions) -> SmoothRows {
    let mut stars = edges.without_ties().stars(mesh.positions.len());
    let areas = edges.areas(mesh, options.weights, options.reference_vertices);
    let mut rows = SmoothRows::default();
    for (i, star) in stars.iter_mut().enumerate().filter(|(_, s)| !s.is_empty()) {
        if edges.boundary[i] {
            take_out_slope(i, star, &mesh.positions);
        }
        push_star(&mut rows, i as u32, (1.0 / areas[i]).sqrt(), star);
    }
    // Ties have rows of their own: in the anchor's row the tied vertex would take up the bending there.
    for (&[i, j], &w) in edges.edges.iter().zip(&edges.weights).skip(edges.of_mesh) {
        push_star(&mut rows, i, w.sqrt(), &[(j, 1.0)]);
    }
    rows
}

/// Replaces the weights `w_ij` of a star by the `c_ij` that vanish on fields linear along the surface.
pub(super) fn take_out_slope(i: usize, star: &mut [(u32, f64)], positions: &[Vec3]) {
    let edge = |j: u32| positions[j as usize] - positions[i];
    let (mut g, mut sum) = (Matrix3::zeros(), Vec3::zeros());
    for &(j, w) in star.iter() {
        g += edge(j) * edge(j).transpose() * w.abs();
        sum += edge(j) * w;
    }
    let eigen = SymmetricEigen::new(g);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let mut slope = Vec3::zeros();
    for k in order.into_iter().take(2).filter(|&k| eigen.eigenvalues[k] > 1e-10 * eigen.eigenvalues[order[0]]) {
        let u = eigen.eigenvectors.column(k);
        slope += u * (u.dot(&sum) / eigen.eigenvalues[k]);
    }
    for (j, w) in star {
        // |w| weights the fit; where w is negative so is its residual's coefficient
        *w -= w.abs() * edge(*j).dot(&slope);
    }
}

impl Free {
    /// Free vertices at the rest positions of `mesh` (millimetres).
    ///
    /// Vertices that no triangle refers to follow the nearest one that has triangles.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    ///
    /// # Panics
    /// If `options.reference_vertices` is not positive.
    pub fn new(mesh: &TriangleMesh, options: FreeOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        assert!(options.reference_vertices > 0.0, "reference_vertices must be positive");
        let clamp = options.kind == Smoothness::Laplacian;
        let edges = WeightedEdges::new(mesh, options.weights, clamp)?;
        let rows = match options.kind {
            Smoothness::Laplacian => laplacian(&edges),
            Smoothness::BiLaplacian => bilaplacian(mesh, &edges, &options),
        };
        let rest = &mesh.positions;
        let vertices = VertexAssembly::new(rest.clone(), rest.len(), &edges.joined());
        Ok(Self::of(Smooth { rest: rest.clone(), rows }, vertices, lambda_smooth))
    }
}

impl VertexRegulariser for Smooth {
    const NAME: &'static str = "free";

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        let structure = vertices.analyse(samples, self.rows.cliques());
        self.rows.analyse(&structure, |v| vertices.block(v));
        structure
    }

    fn fit(&mut self, nodes: &[Vec3]) {
        let rest = &self.rest;
        self.rows.place(|v| nodes[v as usize] - rest[v as usize]);
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        out.push(("smoothness", lambda * self.rows.energy()));
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        self.rows.add_to(equations, lambda);
    }
}

/// `[model]` of free vertices.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothOptions {
    /// Which derivative of the displacements costs: `laplacian` (default) or `bilaplacian`.
    pub kind: Smoothness,
    /// How edges weigh: `uniform` (default) or `cotangent`.
    pub weights: EdgeWeights,
}

impl OptionTable for SmoothOptions {}

pub(super) const MODEL: BuiltIn = BuiltIn::new::<SmoothOptions>("free", include_str!("schedules/free.toml"), |input| {
    let SmoothOptions { kind, weights } = input.options.read()?;
    let options = FreeOptions { kind, weights, reference_vertices: input.reference_vertices };
    Ok(Box::new(Free::new(input.rest, options, 1.0)?))
})
.on_patch_by_vertex(&["smoothing", "smoothness"], |input| {
    let (kind, weights) = (input.smoothness, EdgeWeights::Cotangent);
    let options = FreeOptions { kind, weights, reference_vertices: input.mesh.positions.len() as f64 };
    let lambda = match kind {
        Smoothness::Laplacian => input.gradient_weight(),
        Smoothness::BiLaplacian => input.gradient_weight().powi(2),
    };
    Free::new(input.mesh, options, lambda)?.on_patch(input)
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::{DataTerm, Deformation, DeformationModel as _};
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::model::vertex_assembly::testing::pins;
    use crate::nlls::{Minimizer, Options};

    const REFERENCE: f64 = 500.0;

    fn every_kind() -> impl Iterator<Item = FreeOptions> {
        let kinds = [Smoothness::Laplacian, Smoothness::BiLaplacian].into_iter();
        kinds.flat_map(|kind| [EdgeWeights::Uniform, EdgeWeights::Cotangent].map(|weights| options(kind, weights)))
    }

    fn options(kind: Smoothness, weights: EdgeWeights) -> FreeOptions {
        FreeOptions { kind, weights, reference_vertices: REFERENCE }
    }

    fn energy(mesh: &TriangleMesh, options: FreeOptions, field: impl Fn(&Vec3) -> Vec3) -> f64 {
        let mut model = Free::new(mesh, options, 2.0).unwrap();
        let x: Vec<f64> = mesh.positions.iter().flat_map(|p| <[f64; 3]>::from(p + field(p))).collect();
        let mut energies = Vec::new();
        model.regulariser_energy(&x, &mut energies);
        energies[0].1
    }

    fn regular() -> TriangleMesh {
        sheet(9, 7, |c, r| Vec3::new(c, r, 0.0))
    }

    /// A plane with uneven and obtuse triangles, askew in space.
    fn uneven() -> TriangleMesh {
        let (u, v) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 1.0, 0.0));
        sheet(9, 7, |c, r| {
            let k = (9.0 * r + c) as usize;
            u * (c + 0.35 * noise(k)) + v * (r + 0.35 * noise(k + 100)) + Vec3::new(5.0, 6.0, 7.0)
        })
    }

    #[test]
    fn shifts_are_free_and_bending_is_not() {
        for mesh in [regular(), uneven()] {
            for options in every_kind() {
                let shift = energy(&mesh, options, |_| Vec3::new(3.0, -50.0, 2.0));
                let bend = energy(&mesh, options, |p| Vec3::z() * p.y * p.y);
                assert!(shift < 1e-22 && bend > 1.0, "{options:?}: shift {shift}, bend {bend}");
            }
        }
    }

    #[test]
    fn fields_linear_on_a_plane_cost_their_slope_or_nothing() {
        let slope = nalgebra::Matrix3::new(0.3, 0.1, -0.7, 0.5, 1.3, 0.2, -0.4, 0.8, 0.9);
        let linear = |p: &Vec3| slope * p + Vec3::new(1.0, 2.0, 3.0);
        let mesh = uneven();
        let free = energy(&mesh, options(Smoothness::BiLaplacian, EdgeWeights::Cotangent), linear);
        assert!(free < 1e-22, "{free}");
        let free = energy(&regular(), options(Smoothness::BiLaplacian, EdgeWeights::Uniform), linear);
        assert!(free < 1e-22, "{free}");
        // Axis-aligned right angles: no weight is clamped.
        let mesh = regular();
        let area = 48.0;
        let paid = energy(&mesh, options(Smoothness::Laplacian, EdgeWeights::Cotangent), linear);
        let gradient = slope.fixed_columns::<2>(0).norm_squared();
        approx::assert_relative_eq!(paid, 2.0 * gradient * area, max_relative = 1e-12);
    }

    #[test]
    fn energies_are_the_integrals_whatever_the_resolution() {
        // d = sin(ax) sin(by) on a flat square of side pi: its gradient and its Laplacian, squared, integrate to
        // (a^2 + b^2) (pi/2)^2 and (a^2 + b^2)^2 (pi/2)^2.
        let side = std::f64::consts::PI;
        let field = |p: &Vec3| Vec3::z() * (2.0 * p.x).sin() * p.y.sin();
        let quarter = (side / 2.0) * (side / 2.0);
        let square = |n: usize| {
            sheet(n, n, |c, r| {
                let h = side / (n - 1) as f64;
                Vec3::new(c * h, r * h, 0.0)
            })
        };
        let membrane = options(Smoothness::Laplacian, EdgeWeights::Cotangent);
        let plate = options(Smoothness::BiLaplacian, EdgeWeights::Cotangent);
        for (n, tolerance) in [(33, 0.08), (65, 0.04)] {
            let mesh = square(n);
            approx::assert_relative_eq!(energy(&mesh, membrane, field), 2.0 * 5.0 * quarter, max_relative = tolerance);
            let expected = 2.0 * 25.0 * quarter * side * side / REFERENCE;
            approx::assert_relative_eq!(energy(&mesh, plate, field), expected, max_relative = tolerance);
        }
        // Uniform weights do not know the shape of triangles, but they know how many there are.
        for kind in [Smoothness::Laplacian, Smoothness::BiLaplacian] {
            let [coarse, fine] = [33, 65].map(|n| energy(&square(n), options(kind, EdgeWeights::Uniform), field));
            approx::assert_relative_eq!(coarse, fine, max_relative = 0.06);
        }
    }

    #[test]
    fn energies_scale_with_the_square_of_the_unit() {
        let field = |p: &Vec3| Vec3::new(p.x * p.y, p.y.sin(), p.z * p.z);
        for options in every_kind() {
            let mesh = uneven();
            let metres = TriangleMesh { positions: mesh.positions.iter().map(|p| p * 1e-3).collect(), ..mesh.clone() };
            let large = energy(&mesh, options, field);
            let small = energy(&metres, options, |p| field(&(p * 1e3)) * 1e-3);
            approx::assert_relative_eq!(small * 1e6, large, max_relative = 1e-9);
        }
    }

    type Problem = Deformation<Free, Box<dyn DataTerm>>;

    fn solve(model: Free, samples: &[usize], targets: &[Vec3]) -> (Problem, Vec<Vec3>) {
        let mut problem = Problem::new(model, Samples::vertices(72));
        problem.terms = pins(samples, targets);
        let mut x = problem.model.rest_parameters();
        let options = Options::gauss_newton().with_max_iterations(3).with_damping_floor(1e-9);
        let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
        assert!(summary.final_energy <= summary.initial_energy, "{summary}");
        let vertices = problem.vertices(&x).to_vec();
        (problem, vertices)
    }

    /// 63 vertices in a sheet, 8 in a strip apart from it, and one in no triangle, near vertex 30.
    fn parts() -> TriangleMesh {
        let mut mesh = side_by_side(&uneven(), &sheet(4, 2, |c, r| Vec3::new(c + 30.0, r, 0.0)));
        mesh.positions.push(mesh.positions[30] + Vec3::new(0.1, 0.1, -0.1));
        mesh
    }

    #[test]
    fn loose_vertices_follow_and_parts_without_data_stay() {
        let mesh = parts();
        let targets: Vec<Vec3> = (0..63).map(|i| mesh.positions[i] + Vec3::new(1.0, noise(i), 2.0)).collect();
        for options in every_kind() {
            let model = Free::new(&mesh, options, 0.5).unwrap();
            let (problem, vertices) = solve(model, &(0..63).collect::<Vec<_>>(), &targets);
            assert_eq!(problem.model.unobserved_shifts(), 3);
            let moved = |v: usize| vertices[v] - mesh.positions[v];
            assert!(moved(30).norm() > 1.0);
            approx::assert_abs_diff_eq!(moved(71), moved(30), epsilon = 1e-6);
            for v in 63..71 {
                approx::assert_abs_diff_eq!(moved(v), Vec3::zeros(), epsilon = 1e-6);
            }
        }
    }

    #[test]
    fn a_loose_vertex_changes_nothing_for_the_others() {
        let with = parts();
        let mut without = with.clone();
        without.positions[71] = Vec3::new(4.0, -70.0, 0.0);
        let targets: Vec<Vec3> = (0..63).map(|i| with.positions[i] + Vec3::new(1.0, noise(i), 2.0)).collect();
        for options in every_kind() {
            let [a, b] = [&with, &without]
                .map(|mesh| solve(Free::new(mesh, options, 0.5).unwrap(), &(0..63).collect::<Vec<_>>(), &targets).1);
            for v in 0..63 {
                approx::assert_abs_diff_eq!(a[v], b[v], epsilon = 1e-6);
            }
        }
    }

    #[test]
    fn holding_vertices_where_they_would_go_changes_nothing() {
        let mesh = parts();
        let held: Vec<bool> = (0..72).map(|i| i % 5 == 1).collect();
        let samples: Vec<usize> = (0..72).filter(|i| !held[*i]).step_by(3).collect();
        let targets: Vec<Vec3> = samples.iter().map(|&i| mesh.positions[i] + Vec3::new(noise(i), 1.0, 2.0)).collect();
        for options in every_kind() {
            let (_, free) = solve(Free::new(&mesh, options, 0.5).unwrap(), &samples, &targets);
            let model = Free::new(&mesh, options, 0.5).unwrap().with_held_at(&held, &free);
            assert_eq!(model.parameter_len(), 3 * held.iter().filter(|h| !**h).count());
            let (problem, again) = solve(model, &samples, &targets);
            assert_eq!(problem.model.unobserved_shifts(), 0);
            for v in 0..72 {
                approx::assert_abs_diff_eq!(again[v], free[v], epsilon = 1e-6);
                assert!(!held[v] || again[v] == free[v], "held vertices are copied bit for bit");
            }
            let (_, rest) = solve(Free::new(&mesh, options, 0.5).unwrap().with_held(&held), &samples, &targets);
            assert!((0..72).all(|v| held[v] == (rest[v] == mesh.positions[v])));
        }
    }
}
