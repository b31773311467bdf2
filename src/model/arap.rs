//! As-rigid-as-possible surfaces (Sorkine and Alexa 2007): every vertex with the edges to its neighbours, its star, should
//! move rigidly.
//!
//! ```text
//!     E_smooth = lambda sum_i sum_(j in N(i)) w_ij |(v_i - v_j) - R_i (n_i - n_j)|^2           their eq. (7), "spokes"
//! ```
//!
//! `v` are the parameters, `n` the rest positions, `w_ij` cotangent weights on a fixed triangulation. The cells of
//! `rigid_cells.rs` are the stars. There is the algebra of both solvers: with **local/global** a Gauss-Newton step is the
//! paper's global step (without data, exactly), their eq. (9); **joint** turns the stars along.

use serde::{Deserialize, Serialize};

use super::edge_weights::{EdgeWeights, WeightedEdges};
use super::factory::BuiltIn;
use super::rigid_cells::{ArapSolver, CellKind, Cells, RigidCells};
use super::vertex_model::VertexModel;
use crate::energy::OptionTable;
use crate::mesh::{MeshError, TriangleMesh};

/// How as-rigid-as-possible surfaces are solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArapOptions {
    /// Local/global or joint.
    pub solver: ArapSolver,
    /// Whether negative cotangent weights count as zero; without, the energy may be negative and a step may fail.
    pub clamp: bool,
}

impl Default for ArapOptions {
    fn default() -> Self {
        Self { solver: ArapSolver::LocalGlobal, clamp: true }
    }
}

/// Cells of as-rigid-as-possible surfaces: a vertex and the edges to its neighbours.
#[derive(Debug)]
pub struct Spokes;

impl CellKind for Spokes {
    const NAME: &'static str = "arap";
    const ENERGY: &'static str = "rigidity";
}

/// An as-rigid-as-possible surface. Cell `i` is the star of vertex `i`.
pub type Arap = VertexModel<RigidCells<Spokes>>;

impl Arap {
    /// The surface at rest on `mesh` (millimetres).
    ///
    /// Vertices that no triangle refers to follow the nearest one that has triangles, turning with it.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    pub fn new(mesh: &TriangleMesh, options: ArapOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        let edges = WeightedEdges::new(mesh, EdgeWeights::Cotangent, options.clamp)?;
        let mut cells = Cells::default();
        for (i, star) in edges.stars(mesh.positions.len()).into_iter().enumerate() {
            cells.push(&mesh.positions, star.into_iter().map(|(j, w)| (i as u32, j, w)));
        }
        Ok(Self::of_cells(&mesh.positions, &edges, cells, Some(options.solver), lambda_smooth))
    }
}

/// `[model]` of as-rigid-as-possible surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigidityOptions {
    /// `local_global` (default) or `joint`.
    pub solver: ArapSolver,
}

impl OptionTable for RigidityOptions {}

pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<RigidityOptions>("arap", include_str!("schedules/arap.toml"), |input| {
        let options = ArapOptions { solver: input.options.read::<RigidityOptions>()?.solver, ..ArapOptions::default() };
        Ok(Box::new(Arap::new(input.rest, options, 1.0)?))
    })
    .on_patch_by_vertex(&["smoothing"], |input| {
        // Each edge counts twice.
        Arap::new(input.mesh, ArapOptions::default(), 0.5 * input.gradient_weight())?.on_patch(input)
    });

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::energy::{DataTerm, Deformation, DeformationModel as _, Samples};
    use crate::mesh::Vec3;
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::model::vertex_assembly::testing::{bumpy, flat, pins, solve_held, turn};
    use crate::nlls::{Minimizer, NormalEquations, Options, Problem};

    const SOLVERS: [ArapSolver; 2] = [ArapSolver::LocalGlobal, ArapSolver::Joint];

    type Surface = Deformation<Arap, Box<dyn DataTerm>>;

    fn problem(mesh: &TriangleMesh, solver: ArapSolver) -> Surface {
        let model = Arap::new(mesh, ArapOptions { solver, clamp: true }, 0.8).unwrap();
        Deformation::new(model, Samples::vertices(mesh.positions.len()))
    }

    #[test]
    fn a_rigid_motion_costs_nothing_and_is_found_as_every_stars_rotation() {
        let mut mesh = bumpy();
        mesh.positions.push(Vec3::new(20.0, 3.0, 1.0)); // in no triangle
        let moved: Vec<Vec3> = mesh.positions.iter().map(|p| turn() * p + Vec3::new(30.0, -8.0, 1.0)).collect();
        for solver in SOLVERS {
            let mut problem = problem(&mesh, solver);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            let energy = problem.linearize(&flat(&moved), &mut equations);
            assert!(energy < 1e-24, "{energy}");
            assert!(equations.gradient.iter().all(|g| g.abs() < 1e-12));
            let rotations: Vec<_> = problem.model.rotations(&flat(&moved)).collect();
            // A star at the rim may lie on a line, and turns freely round it.
            let inside = (0..72).filter(|v| (1..8).contains(&(v % 9)) && (1..7).contains(&(v / 9)));
            for v in inside {
                assert!((rotations[v].matrix() - turn().matrix()).norm() < 1e-12, "vertex {v}");
            }
        }
    }

    #[test]
    fn the_joint_hessian_is_the_energys_where_nothing_is_strained() {
        // Gauss-Newton is exact where residuals vanish. Local/global knows nothing of turns and charges them.
        let mesh = bumpy();
        let moved = flat(&mesh.positions.iter().map(|p| turn() * p).collect::<Vec<_>>());
        let omega = Vec3::new(0.3, -0.5, 0.2);
        let spin: Vec<Vec3> = mesh.positions.iter().map(|p| omega.cross(&(turn() * p))).collect();
        let other: Vec<f64> = (0..moved.len()).map(noise).collect();
        let curvature = |solver, d: &[f64]| {
            let mut problem = problem(&mesh, solver);
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            problem.linearize(&moved, &mut equations);
            let at = |problem: &mut Surface, t: f64| {
                problem.energy(&moved.iter().zip(d).map(|(x, d)| x + t * d).collect::<Vec<_>>())
            };
            // E = t^2 d'Hd + O(t^3); symmetric, so to O(t^4)
            let t = 1e-4;
            let numeric = 0.5 * (at(&mut problem, t) + at(&mut problem, -t)) / (t * t);
            (equations.quadratic_form(d), numeric)
        };
        let (h, numeric) = curvature(ArapSolver::Joint, &other);
        approx::assert_relative_eq!(h, numeric, max_relative = 1e-5);
        let (h, _) = curvature(ArapSolver::Joint, &flat(&spin));
        let (stiff, _) = curvature(ArapSolver::LocalGlobal, &flat(&spin));
        assert!(stiff > 1.0 && h.abs() < 1e-6 * stiff, "joint {h}, local/global {stiff}");
    }

    #[test]
    fn loose_vertices_turn_with_the_surface() {
        let mut mesh = bumpy();
        let (near, far) = (Vec3::new(4.2, 3.9, 2.0), Vec3::new(40.0, 4.0, -3.0));
        mesh.positions.extend([near, far, mesh.positions[11]]);
        let targets: Vec<Vec3> = mesh.positions[..72].iter().map(|p| turn() * p + Vec3::new(1.0, 2.0, 3.0)).collect();
        for solver in SOLVERS {
            let mut problem = problem(&mesh, solver);
            problem.terms = pins(&(0..72).collect::<Vec<_>>(), &targets);
            let mut x = problem.model.rest_parameters();
            let options = Options::gauss_newton().with_max_iterations(200).with_energy_tolerance(0.0);
            let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
            assert!(summary.final_energy < 1e-12, "{solver:?} {summary}");
            for (v, n) in problem.vertices(&x).iter().zip(&mesh.positions) {
                approx::assert_abs_diff_eq!(*v, turn() * n + Vec3::new(1.0, 2.0, 3.0), epsilon = 1e-4);
            }
        }
    }

    #[test]
    fn broken_stars_and_parts_without_data_stay_finite_and_are_counted() {
        // A sheet with data, a sheet without, a triangle without area, three vertices on one spot, and one in no triangle.
        let mut mesh = side_by_side(&bumpy(), &sheet(3, 3, |c, r| Vec3::new(c + 30.0, r, 0.0)));
        let n = mesh.positions.len() as u32;
        mesh.positions.extend([Vec3::zeros(), Vec3::x() * 2.0, Vec3::x() * 5.0].map(|p| p + Vec3::z() * 9.0));
        mesh.positions.extend([Vec3::new(1.0, 2.0, 30.0); 3]);
        mesh.positions.push(Vec3::new(31.0, 1.2, 0.5));
        mesh.triangles.extend([[n, n + 1, n + 2], [n + 3, n + 4, n + 5], [3, 3, 4]]);
        for solver in SOLVERS {
            let mut problem = problem(&mesh, solver);
            let targets: Vec<Vec3> = (0..72).map(|i| mesh.positions[i] * 1.1 + Vec3::z()).collect();
            problem.terms = pins(&(0..72).collect::<Vec<_>>(), &targets);
            let mut x = problem.model.rest_parameters();
            // Nothing fixes three parts: without damping that is an error.
            let options = Options::gauss_newton().with_max_iterations(6);
            let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
            assert!(!summary.stop.was_successful(), "{solver:?} {summary}");
            let mut x = problem.model.rest_parameters();
            let damped = Minimizer::new(options.with_damping_floor(1e-9)).unwrap();
            let summary = damped.minimize(&mut problem, &mut x);
            assert!(summary.final_energy < 0.5 * summary.initial_energy, "{solver:?} {summary}");
            assert_eq!(problem.model.unobserved_shifts(), 9, "{solver:?}");
            let vertices = problem.vertices(&x);
            assert!(vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
            for (v, n) in vertices.iter().zip(&mesh.positions).skip(72) {
                approx::assert_abs_diff_eq!(*v, *n, epsilon = 1e-6);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut mesh = bumpy();
        mesh.positions[4].y = f64::INFINITY;
        assert!(Arap::new(&mesh, ArapOptions::default(), 1.0).is_err());
        let held = std::panic::catch_unwind(|| {
            let _ = Arap::new(&bumpy(), ArapOptions::default(), 1.0).unwrap().with_held(&[true; 3]);
        });
        assert!(held.is_err());
    }

    #[test]
    fn held_vertices_are_no_parameters() {
        let mesh = bumpy();
        for solver in SOLVERS {
            let pins = pins(&[8, 71, 40], &[Vec3::new(3.0, -4.0, 6.0), Vec3::new(8.0, 9.0, 3.0), Vec3::z()]);
            let (problem, _) = solve_held(&mesh, pins, 100, |held| {
                Arap::new(&mesh, ArapOptions { solver, clamp: true }, 0.8).unwrap().with_held(held)
            });
            assert_eq!(problem.model.unobserved_shifts(), 0);
        }
    }
}
