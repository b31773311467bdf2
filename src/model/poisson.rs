//! Gradient-domain deformation by Poisson's equation (Y. Yu, K. Zhou, D. Xu, X. Shi, H. Bao, B. Guo, H.-Y. Shum, "Mesh editing with
//! Poisson-based gradient field manipulation", SIGGRAPH 2004): the gradients of the coordinates, one per triangle, follow a guidance
//! field, and the positions are the least-squares solution.
//!
//! ```text
//!     E = sum_t A_t |grad_t v - R_t grad_t n|^2           so  div grad v = div (R grad n), their eq. (2) with guidance w = R grad n
//!       = sum_t sum_(a,b in t) (cot / 2) |(v_a - v_b) - R_t (n_a - n_b)|^2
//! ```
//!
//! `v` are the parameters, `n` the rest positions, `A_t` areas, `cot` of the angle opposite the edge. In the paper the `R_t` are given:
//! the user turns handles, and the turns spread by geodesic distance. A registration has no handles, so here the turns are estimated
//! from `v`. A triangle by itself would turn freely at its hinges, and bending would cost nothing; so a turn belongs to a **patch**,
//! a triangle and its neighbours across edges, and every triangle `s` is held to the turns of all `m_s` patches that it is in:
//!
//! ```text
//!     E_smooth = lambda sum_t sum_(s in patch t) (A_s / m_s) |grad_s v - R_t grad_s n|^2        R_t the best for v
//! ```
//!
//! For given turns that is the paper's energy with the mean of the patches' turns as guidance, plus a constant; the cells of
//! `rigid_cells.rs` are the patches. With `guidance = "rest"` all `R_t` are the identity, as under handles that are only moved: the
//! system is linear, and the energy that of free vertices under a cotangent Laplacian.
//!
//! Against ARAP: its cells are stars and its weights belong to edges, so that negative ones have to be clamped; here they belong to
//! triangles, each of which has an energy that is an integral and never negative, whatever its angles. Of both, the price of
//! stretching does not depend on the resolution, while bending gets cheaper as triangles shrink.

use serde::{Deserialize, Serialize};

use super::edge_weights::{EdgeWeights, LARGEST_COTANGENT, WeightedEdges, cotangents};
use super::factory::BuiltIn;
use super::rigid_cells::{ArapSolver, CellKind, Cells, RigidCells};
use super::vertex_model::VertexModel;
use crate::energy::OptionTable;
use crate::mesh::adjacency::{EdgeGraph, vertex_triangles};
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// Where the gradients that a surface should have come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Guidance {
    /// From the rest shape, each patch turned as it is now.
    #[default]
    Turned,
    /// From the rest shape as it stands. Turning costs.
    Rest,
}

/// `[model]` of gradient-domain deformation.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoissonOptions {
    /// The gradients that triangles should have: those of the rest shape, `turned` (default) patch by patch or as they stand (`rest`).
    pub guidance: Guidance,
    /// How turns are solved for: `local_global` (default) or `joint`.
    pub solver: ArapSolver,
}

impl OptionTable for PoissonOptions {}

/// Cells of gradient-domain deformation: a triangle and those beyond its edges.
#[derive(Debug)]
pub struct Patches;

impl CellKind for Patches {
    const NAME: &'static str = "poisson";
    const ENERGY: &'static str = "gradients";
    // A triangle by itself follows its corners out of its plane wherever they go: H would know nothing of them.
    const FEWEST_TURNING: usize = 4;
}

/// A surface whose gradients follow a guidance field. Cell `t` is the patch round triangle `t`.
pub type Poisson = VertexModel<RigidCells<Patches>>;

/// `cot / 2` of all angles of an equilateral triangle.
const EQUILATERAL: [f64; 3] = [0.288_675_134_594_812_9; 3];

impl Poisson {
    /// The surface at rest on `mesh` (millimetres).
    ///
    /// A triangle without area, or with an angle of less than 0.06 degrees, has no gradient to speak of; its edges are kept as if
    /// they were those of an equilateral one. Vertices that no triangle refers to follow the nearest one that has triangles, turning
    /// with the patch of its first.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    pub fn new(mesh: &TriangleMesh, options: PoissonOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        let (edges, rest) = (WeightedEdges::new(mesh, EdgeWeights::Uniform, true)?, &mesh.positions);
        let (patches, around) = (patches(mesh), vertex_triangles(rest.len(), &mesh.triangles));
        let mut ties: Vec<Vec<(u32, u32, f64)>> = vec![Vec::new(); patches.len()];
        for (&[loose, anchor], &weight) in edges.edges.iter().zip(&edges.weights).skip(edges.of_mesh) {
            ties[around.row(anchor as usize)[0] as usize].push((loose, anchor, weight));
        }
        let mut cells = Cells::default();
        for (patch, ties) in patches.iter().zip(&ties) {
            let mut edges: Vec<(u32, u32, f64)> = Vec::new();
            for &s in patch {
                let triangle = mesh.triangles[s as usize];
                for (k, weight) in gradient_weights(rest, triangle).into_iter().enumerate() {
                    let [a, b] = [triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
                    if a != b {
                        edges.push((a.min(b), a.max(b), weight / patches[s as usize].len() as f64));
                    }
                }
            }
            // An edge between two triangles of a patch counts once, for both.
            edges.sort_by_key(|e| (e.0, e.1));
            let merged = edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1));
            let merged = merged.map(|same| (same[0].0, same[0].1, same.iter().map(|e| e.2).sum()));
            cells.push(rest, merged.chain(ties.iter().copied()));
        }
        let solver = (options.guidance == Guidance::Turned).then_some(options.solver);
        Ok(Self::of_cells(rest, &edges, cells, solver, lambda_smooth))
    }
}

/// Of every triangle, itself and those that share an edge with it, ascending.
fn patches(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let graph = EdgeGraph::of(mesh);
    let sides = |[a, b, c]: [u32; 3]| [(a, b), (b, c), (c, a)].into_iter().filter_map(|(a, b)| graph.find(a, b));
    let mut at_edge = vec![Vec::new(); graph.edges().len()];
    for (t, &triangle) in mesh.triangles.iter().enumerate() {
        sides(triangle).for_each(|edge| at_edge[edge].push(t as u32));
    }
    let patch = |(t, &triangle): (usize, &[u32; 3])| {
        let mut patch = vec![t as u32];
        patch.extend(sides(triangle).flat_map(|edge| &at_edge[edge]));
        patch.sort_unstable();
        patch.dedup();
        patch
    };
    mesh.triangles.iter().enumerate().map(patch).collect()
}

/// `w` of the side opposite each corner with `A |grad f|^2 = sum w |f_a - f_b|^2` for a function linear on the triangle.
fn gradient_weights(rest: &[Vec3], triangle: [u32; 3]) -> [f64; 3] {
    let cotangents = cotangents(rest, triangle);
    let thin = cotangents == [0.0; 3] || cotangents.iter().any(|c| c.abs() >= LARGEST_COTANGENT);
    if thin { EQUILATERAL } else { cotangents.map(|c| 0.5 * c) }
}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<PoissonOptions>("poisson", include_str!("schedules/poisson.toml"), |input| {
        Ok(Box::new(Poisson::new(input.rest, input.options.read()?, 1.0)?))
    })
    .on_patch_by_vertex(&["smoothing"], |input| {
        Poisson::new(input.mesh, PoissonOptions::default(), input.gradient_weight())?.on_patch(input)
    });

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{Matrix3, Rotation3};

    use super::*;
    use crate::energy::{DataTerm, Deformation, DeformationModel, Samples};
    use crate::mesh::normals::face_areas;
    use crate::mesh::testing::{noise, sheet};
    use crate::model::vertex_assembly::testing::{broken, flat, pins, solve_held, turn};
    use crate::model::{Free, FreeOptions, Smoothness};
    use crate::nlls::{Minimizer, NormalEquations, Options, Problem};

    fn ways() -> [PoissonOptions; 3] {
        let [turned, rest] = [Guidance::Turned, Guidance::Rest];
        let [alternating, joint] = [ArapSolver::LocalGlobal, ArapSolver::Joint];
        [(turned, alternating), (turned, joint), (rest, alternating)]
            .map(|(guidance, solver)| PoissonOptions { guidance, solver })
    }

    /// With obtuse triangles, so with negative cotangents.
    fn bumpy(spread: f64) -> TriangleMesh {
        sheet(9, 8, |c, r| {
            let k = (9.0 * r + c) as usize;
            Vec3::new(c - 0.5 * r + spread * noise(k), 0.9 * r + spread * noise(k + 100), 0.4 * noise(k + 200))
        })
    }

    type Surface = Deformation<Poisson, Box<dyn DataTerm>>;

    fn problem(mesh: &TriangleMesh, options: PoissonOptions) -> Surface {
        Deformation::new(Poisson::new(mesh, options, 0.8).unwrap(), Samples::vertices(mesh.positions.len()))
    }

    #[test]
    fn a_rigid_motion_costs_nothing_unless_the_guidance_stands() {
        let mut mesh = bumpy(0.3);
        mesh.positions.push(Vec3::new(20.0, 3.0, 1.0)); // in no triangle
        let turn = turn();
        let moved: Vec<Vec3> = mesh.positions.iter().map(|p| turn * p + Vec3::new(30.0, -8.0, 1.0)).collect();
        for options in ways() {
            let mut problem = problem(&mesh, options);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            assert!(problem.linearize(&flat(&mesh.positions), &mut equations) < 1e-28);
            let energy = problem.linearize(&flat(&moved), &mut equations);
            if options.guidance == Guidance::Rest {
                assert!(energy > 1.0);
                continue;
            }
            assert!(energy < 1e-23, "{energy}");
            assert!(equations.gradient.iter().all(|g| g.abs() < 1e-11));
            assert!(problem.model.rotations(&flat(&moved)).all(|r| (r.matrix() - turn.matrix()).norm() < 1e-11));
        }
    }

    #[test]
    fn stretching_costs_the_integral_whatever_the_triangles() {
        let stretch = Matrix3::new(1.2, 0.05, 0.0, 0.05, 0.9, 0.0, 0.0, 0.0, 1.0);
        for (columns, spread) in [(5, 0.0), (9, 0.0), (9, 0.3), (33, 0.3)] {
            let side = (columns - 1) as f64;
            let mesh = sheet(columns, columns, |c, r| {
                let k = (40.0 * r + c) as usize;
                let inside = c > 0.0 && r > 0.0 && c < side && r < side;
                let spread = if inside { spread } else { 0.0 };
                Vec3::new(c + spread * noise(k), r + spread * noise(k + 5000), 0.0) * (7.0 / side)
            });
            let moved: Vec<Vec3> = mesh.positions.iter().map(|p| stretch * p).collect();
            let gradient = (stretch - Matrix3::identity()).norm_squared();
            for options in ways() {
                let energy = problem(&mesh, options).energy(&flat(&moved));
                approx::assert_relative_eq!(energy, 0.8 * 49.0 * gradient, max_relative = 1e-11);
            }
        }
    }

    /// A triangle's gradients by the pseudo-inverse of its edges, the turns by Kabsch's decomposition.
    #[test]
    fn the_energy_is_that_of_gradients() {
        let mesh = bumpy(0.3);
        let moved: Vec<Vec3> = (mesh.positions.iter().enumerate())
            .map(|(i, p)| Vec3::new(p.x, p.y * 0.5f64.cos(), p.y) + Vec3::new(noise(i), noise(i + 90), noise(i + 300)))
            .collect();
        let edges = |v: &[Vec3], t: [u32; 3]| {
            let [a, b, c] = t.map(|k| v[k as usize]);
            nalgebra::Matrix3x2::from_columns(&[b - a, c - a])
        };
        let gradients = |v: &[Vec3]| -> Vec<Matrix3<f64>> {
            let of = |&t: &[u32; 3]| edges(v, t) * edges(&mesh.positions, t).pseudo_inverse(1e-12).unwrap();
            mesh.triangles.iter().map(of).collect()
        };
        let (now, rest) = (gradients(&moved), gradients(&mesh.positions));
        let areas = face_areas(&mesh.positions, &mesh.triangles);
        let adjacent = |s: usize, t: usize| {
            let [s, t] = [s, t].map(|k| mesh.triangles[k]);
            s.iter().filter(|v| t.contains(v)).count() >= 2
        };
        let count = mesh.triangles.len();
        let patch = |t: usize| (0..count).filter(move |&s| adjacent(s, t));
        let (mut turned, mut still) = (0.0, 0.0);
        for t in 0..count {
            let share = |s: usize| areas[s] / patch(s).count() as f64;
            let a: Matrix3<f64> = patch(t).map(|s| now[s] * rest[s].transpose() * share(s)).sum();
            let svd = a.svd(true, true);
            let (u, v) = (svd.u.unwrap(), svd.v_t.unwrap());
            let r = u * Matrix3::from_diagonal(&Vec3::new(1.0, 1.0, (u * v).determinant().signum())) * v;
            turned += patch(t).map(|s| share(s) * (now[s] - r * rest[s]).norm_squared()).sum::<f64>();
            still += areas[t] * (now[t] - rest[t]).norm_squared();
        }
        for options in ways() {
            let expected = if options.guidance == Guidance::Rest { still } else { turned };
            let energy = problem(&mesh, options).energy(&flat(&moved));
            approx::assert_relative_eq!(energy, 0.8 * expected, max_relative = 1e-11);
        }
    }

    #[test]
    fn the_gradient_is_that_of_differences_and_the_joint_hessian_exact_where_nothing_is_strained() {
        let mesh = bumpy(0.3);
        let turn = turn();
        let rest = flat(&mesh.positions.iter().map(|p| turn * p).collect::<Vec<_>>());
        let strained: Vec<f64> = rest.iter().enumerate().map(|(k, x)| x + 0.2 * noise(k + 31)).collect();
        let d: Vec<f64> = (0..rest.len()).map(noise).collect();
        for options in ways() {
            let mut problem = problem(&mesh, options);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            problem.linearize(&strained, &mut equations);
            let at = |problem: &mut Surface, x: &[f64], t: f64| {
                problem.energy(&x.iter().zip(&d).map(|(x, d)| x + t * d).collect::<Vec<_>>())
            };
            let slope = (at(&mut problem, &strained, 1e-5) - at(&mut problem, &strained, -1e-5)) / 2e-5;
            let found: f64 = 2.0 * equations.gradient.iter().zip(&d).map(|(g, d)| g * d).sum::<f64>();
            approx::assert_relative_eq!(found, slope, max_relative = 1e-6);
            problem.linearize(&rest, &mut equations);
            let h = equations.quadratic_form(&d);
            let [before, here, after] = [-1e-4, 0.0, 1e-4].map(|t| at(&mut problem, &rest, t));
            let numeric = 0.5 * (after - 2.0 * here + before) / 1e-8;
            if options.guidance == Guidance::Rest || options.solver == ArapSolver::Joint {
                approx::assert_relative_eq!(h, numeric, max_relative = 1e-5);
            } else {
                assert!(h > 1.01 * numeric, "turns are charged: {h} {numeric}");
            }
        }
    }

    #[test]
    fn guidance_that_stands_is_the_membrane_of_free_vertices() {
        let mesh = bumpy(0.02);
        let edges = WeightedEdges::new(&mesh, EdgeWeights::Cotangent, false).unwrap();
        assert!(edges.weights.iter().all(|w| *w > 0.0), "free vertices clamp");
        let d: Vec<f64> = (0..3 * 72).map(noise).collect();
        let x: Vec<f64> = flat(&mesh.positions).iter().zip(&d).map(|(n, d)| n + d).collect();
        let options =
            FreeOptions { kind: Smoothness::Laplacian, weights: EdgeWeights::Cotangent, reference_vertices: 100.0 };
        let free = Free::new(&mesh, options, 0.8).unwrap();
        let mut free: Deformation<_, Box<dyn DataTerm>> = Deformation::new(free, Samples::vertices(72));
        let mut poisson = problem(&mesh, ways()[2]);
        let mut equations = [free.structure(), poisson.structure()].map(|s| NormalEquations::new(Arc::clone(s)));
        let energies = [free.linearize(&x, &mut equations[0]), poisson.linearize(&x, &mut equations[1])];
        approx::assert_relative_eq!(energies[0], energies[1], max_relative = 1e-12);
        assert!((equations[0].to_dense() - equations[1].to_dense()).amax() < 1e-12);
        for (a, b) in equations[0].gradient.iter().zip(&equations[1].gradient) {
            approx::assert_abs_diff_eq!(a, b, epsilon = 1e-11);
        }
    }

    #[test]
    fn broken_triangles_loose_vertices_and_parts_without_data_stay_finite() {
        let mut mesh = broken(&bumpy(0.3));
        mesh.triangles.push(mesh.triangles[0]);
        let turn = Rotation3::from_euler_angles(0.2, -0.5, 0.3);
        let targets: Vec<Vec3> = (0..72).map(|i| turn * mesh.positions[i] + Vec3::z()).collect();
        for options in ways() {
            let mut problem = problem(&mesh, options);
            problem.terms = pins(&(0..72).collect::<Vec<_>>(), &targets);
            let mut x = problem.model.rest_parameters();
            let minimizer = Options::gauss_newton().with_max_iterations(100).with_damping_floor(1e-9);
            let summary = Minimizer::new(minimizer.with_energy_tolerance(0.0)).unwrap().minimize(&mut problem, &mut x);
            assert!(summary.final_energy < 0.5 * summary.initial_energy, "{options:?} {summary}");
            assert_eq!(problem.model.unobserved_shifts(), 12, "{options:?}");
            let vertices = problem.vertices(&x).to_vec();
            for (v, n) in vertices.iter().zip(&mesh.positions).skip(72).take(18) {
                approx::assert_abs_diff_eq!(*v, *n, epsilon = 1e-6);
            }
            if options.guidance == Guidance::Turned {
                let loose = turn * mesh.positions[90] + Vec3::z();
                approx::assert_abs_diff_eq!(vertices[90], loose, epsilon = 1e-3);
            }
        }
        mesh.positions[4].y = f64::INFINITY;
        assert!(Poisson::new(&mesh, PoissonOptions::default(), 1.0).is_err());
    }

    #[test]
    fn held_vertices_are_no_parameters() {
        let mesh = bumpy(0.3);
        for options in ways() {
            let pins = pins(&[8, 71], &[Vec3::new(3.0, -4.0, 6.0), Vec3::new(8.0, 9.0, 3.0)]);
            solve_held(&mesh, pins, 100, |held| Poisson::new(&mesh, options, 0.8).unwrap().with_held(held));
        }
    }
}
