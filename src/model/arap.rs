//! As-rigid-as-possible surfaces (Sorkine and Alexa 2007): every vertex with the edges to its neighbours, its star, should
//! move rigidly.
//!
//! ```text
//!     E_smooth = lambda sum_i sum_(j in N(i)) w_ij |(v_i - v_j) - R_i (n_i - n_j)|^2           their eq. (7), "spokes"
//! ```
//!
//! `v` are the parameters, `n` the rest positions, `w_ij` cotangent weights on a fixed triangulation. The rotations are not
//! parameters: for any `v` each `R_i` is the best one, so `E_smooth` is a function of `v` alone, and by the envelope theorem
//! its gradient is that at fixed `R_i`:
//!
//! ```text
//!     1/2 dE/dv_i = lambda sum_j w_ij ( 2 (v_i - v_j) - (R_i + R_j)(n_i - n_j) )                their eq. (9)
//! ```
//!
//! Two Hessians go with it. **Local/global** keeps the rotations: `2 lambda L`, `L` the cotangent Laplacian; a Gauss-Newton step
//! is then the paper's global step (without data, exactly), and the energy never rises. **Joint** linearises positions and
//! rotations together, `r_ij = v_i - v_j - exp(omega_i^) R_i (n_i - n_j)`, and eliminates each `omega_i` by its 3 x 3 block:
//!
//! ```text
//!     p_ij = R_i (n_i - n_j)      D_i = sum_j w_ij (|p_ij|^2 1 - p_ij p_ij')
//!     C_i v = sum_j w_ij p_ij x (v_j - v_i)
//!     H = 2 lambda L - lambda sum_i C_i' D_i^-1 C_i
//! ```
//!
//! It joins pairs of neighbours of a vertex too, and needs far fewer steps where rotations are large.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::edge_weights::{EdgeWeights, WeightedEdges};
use super::factory::{ModelError, ModelFactory, ModelInput, RegistrationModel, SmoothLevel};
use super::on_patch::{PatchFactory, PatchInput};
use super::rotation_fit::closest_rotation;
use super::vertex_assembly::{CHUNK, VertexAssembly, add_scalars, row_position};
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, Options, OptionsError, QuadricField, Samples};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::{BlockStructure, NormalEquations};

/// What a step knows of the rotations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArapSolver {
    /// They stay while the positions move (Sorkine and Alexa's alternation).
    #[default]
    LocalGlobal,
    /// They turn along: Gauss-Newton over positions and rotations, the rotations eliminated.
    Joint,
}

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

/// Part of the trace of `D_i` added to its diagonal: stars on a line turn freely round it.
const TURN_FLOOR: f64 = 1e-9;

/// An as-rigid-as-possible surface.
pub struct Arap {
    /// `lambda` of the regulariser.
    pub lambda_smooth: f64,
    options: ArapOptions,
    assembly: VertexAssembly,
    stars: Stars,
    fitted: Fit,
    /// `2 L`, a scalar for every stored block.
    stiffness: Vec<f64>,
    turns: Turns,
}

/// Neighbours of every vertex, one row after the other.
struct Stars {
    starts: Vec<u32>,
    spokes: Vec<Spoke>,
}

#[derive(Clone, Copy)]
struct Spoke {
    other: u32,
    weight: f64,
    /// `n_i - n_j`.
    rest: Vec3,
}

impl Stars {
    fn range(&self, i: usize) -> std::ops::Range<usize> {
        self.starts[i] as usize..self.starts[i + 1] as usize
    }

    fn of(&self, i: usize) -> &[Spoke] {
        &self.spokes[self.range(i)]
    }
}

/// Everything that follows from `x` alone, kept until `x` changes.
#[derive(Default)]
struct Fit {
    x: Vec<f64>,
    positions: Vec<Vec3>,
    rotations: Vec<UnitQuaternion<f64>>,
    stars: Vec<StarFit>,
}

#[derive(Clone, Copy)]
struct StarFit {
    rotation: Matrix3<f64>,
    energy: f64,
}

/// The eliminated rotations of the joint solver. A star's members are its centre and its spokes' ends.
#[derive(Default)]
struct Turns {
    starts: Vec<u32>,
    /// Block of every member, or `HELD`.
    members: Vec<u32>,
    /// `C_i` and `D_i^-1 C_i` for every member.
    coupling: Vec<[Matrix3<f64>; 2]>,
    /// Per block, the stars its vertex is a member of.
    row_starts: Vec<u32>,
    uses: Vec<TurnUse>,
    targets: Vec<TurnTarget>,
}

/// A star at one of its members; the members that come no later in the row are its targets.
struct TurnUse {
    member: u32,
    targets: std::ops::Range<u32>,
}

struct TurnTarget {
    member: u32,
    /// Where the block starts in the row.
    start: u32,
}

impl Arap {
    /// The surface at rest on `mesh` (millimetres).
    ///
    /// Vertices that no triangle refers to follow the nearest one that has triangles, turning with it. Vertices in parts without
    /// data stay where they are if the solver damps (`Options::with_damping_floor`); without damping the normal equations
    /// are singular, which is an error there.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    pub fn new(mesh: &TriangleMesh, options: ArapOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        let edges = WeightedEdges::new(mesh, EdgeWeights::Cotangent, options.clamp)?;
        let n = &mesh.positions;
        let (mut starts, mut spokes) = (vec![0], Vec::new());
        for (i, star) in edges.stars(n.len()).into_iter().enumerate() {
            let spoke = |(j, weight): (u32, f64)| Spoke { other: j, weight, rest: n[i] - n[j as usize] };
            spokes.extend(star.into_iter().filter(|s| s.1 != 0.0).map(spoke));
            starts.push(spokes.len() as u32);
        }
        Ok(Self {
            lambda_smooth,
            options,
            assembly: VertexAssembly::new(n.clone(), &edges),
            stars: Stars { starts, spokes },
            fitted: Fit::default(),
            stiffness: Vec::new(),
            turns: Turns::default(),
        })
    }

    /// Holds the marked vertices at rest: they are not parameters, and their positions are copied bit for bit.
    ///
    /// # Panics
    /// If there is not one mark per vertex.
    #[must_use]
    pub fn with_held(self, held: &[bool]) -> Self {
        let rest = self.assembly.rest.clone();
        self.with_held_at(held, &rest)
    }

    /// Holds the marked vertices at the given positions, bit for bit; positions of other vertices are ignored.
    ///
    /// # Panics
    /// If there is not one mark and one position per vertex.
    #[must_use]
    pub fn with_held_at(mut self, held: &[bool], positions: &[Vec3]) -> Self {
        self.assembly.hold(held, positions);
        self.fitted = Fit::default();
        self
    }

    /// The best rotation of every vertex' star at `x`.
    pub fn rotations(&mut self, x: &[f64]) -> impl Iterator<Item = Rotation3<f64>> + '_ {
        self.fit(x);
        self.fitted.rotations.iter().map(|q| q.to_rotation_matrix())
    }

    /// In how many directions parts of the template can be shifted without any data noticing, at the last linearisation.
    #[must_use]
    pub fn unobserved_shifts(&self) -> usize {
        self.assembly.unobserved_shifts()
    }

    /// The local step.
    fn fit(&mut self, x: &[f64]) {
        let Fit { x: last, positions, rotations, stars: fits } = &mut self.fitted;
        if last == x && !positions.is_empty() {
            return;
        }
        last.clear();
        last.extend_from_slice(x);
        self.assembly.positions(x, positions, |_, v| v);
        let (stars, v) = (&self.stars, &*positions);
        rotations.resize(v.len(), UnitQuaternion::identity());
        fits.resize(v.len(), StarFit { rotation: Matrix3::identity(), energy: 0.0 });
        let chunks = fits.par_chunks_mut(CHUNK).zip(rotations.par_chunks_mut(CHUNK)).enumerate();
        chunks.for_each(|(c, (fits, rotations))| {
            for (k, (fit, rotation)) in fits.iter_mut().zip(rotations).enumerate() {
                let i = c * CHUNK + k;
                let spokes = stars.of(i);
                let mut a = Matrix3::zeros();
                for spoke in spokes {
                    a += (v[i] - v[spoke.other as usize]) * spoke.weight * spoke.rest.transpose();
                }
                *rotation = closest_rotation(&a, rotation);
                fit.rotation = rotation.to_rotation_matrix().into_inner();
                fit.energy = spokes
                    .iter()
                    .map(|s| s.weight * (v[i] - v[s.other as usize] - fit.rotation * s.rest).norm_squared())
                    .sum();
            }
        });
    }

    /// Members of the stars and where their pairs lie in the equations.
    fn analyse_turns(&mut self, structure: &BlockStructure, members: Vec<u32>, starts: Vec<u32>) {
        let mut uses: Vec<(usize, TurnUse)> = Vec::new();
        let turns = &mut self.turns;
        turns.targets.clear();
        for star in starts.windows(2) {
            let range = star[0]..star[1];
            let free = range.filter_map(|m| self.assembly.block(members[m as usize]).map(|block| (m, block)));
            for (member, row) in free.clone() {
                let first = turns.targets.len() as u32;
                let targets = free.clone().filter(|t| t.1 <= row);
                turns.targets.extend(
                    targets.map(|(member, column)| TurnTarget { member, start: row_position(structure, row, column) }),
                );
                uses.push((row, TurnUse { member, targets: first..turns.targets.len() as u32 }));
            }
        }
        uses.sort_by_key(|u| u.0);
        turns.row_starts = vec![0; structure.block_count() + 1];
        uses.iter().for_each(|u| turns.row_starts[u.0 + 1] += 1);
        for i in 0..structure.block_count() {
            turns.row_starts[i + 1] += turns.row_starts[i];
        }
        turns.uses = uses.into_iter().map(|u| u.1).collect();
        turns.coupling = vec![[Matrix3::zeros(); 2]; members.len()];
        turns.starts = starts;
        turns.members = members;
    }

    /// `C_i` and `D_i^-1 C_i` of all stars, in the order of their members.
    fn linearize_turns(&mut self) {
        let (stars, fits, turns) = (&self.stars, &self.fitted.stars, &mut self.turns);
        split_stars(&turns.starts, 0, &mut turns.coupling, &|i, coupling| {
            let mut d = Matrix3::zeros();
            coupling[0][0] = Matrix3::zeros();
            for (k, spoke) in stars.of(i).iter().enumerate() {
                let p = fits[i].rotation * spoke.rest;
                d += (Matrix3::from_diagonal_element(p.norm_squared()) - p * p.transpose()) * spoke.weight;
                coupling[k + 1][0] = p.cross_matrix() * spoke.weight;
                let own = coupling[0][0] - coupling[k + 1][0];
                coupling[0][0] = own;
            }
            // Where D is not positive definite (negative weights) the rotation stays, as in local/global.
            let floor = TURN_FLOOR * d.trace();
            let factor = (d + Matrix3::from_diagonal_element(floor)).cholesky();
            for [c, y] in coupling {
                *y = factor.as_ref().map_or_else(Matrix3::zeros, |factor| factor.solve(c));
            }
        });
    }
}

/// Calls `fill(i, coupling of star i)` for every star, in parallel.
fn split_stars(
    starts: &[u32],
    first: usize,
    coupling: &mut [[Matrix3<f64>; 2]],
    fill: &(impl Fn(usize, &mut [[Matrix3<f64>; 2]]) + Sync),
) {
    let count = starts.len() - 1;
    if count <= CHUNK {
        let mut rest = coupling;
        for (k, star) in starts.windows(2).enumerate() {
            let (own, others) = rest.split_at_mut((star[1] - star[0]) as usize);
            fill(first + k, own);
            rest = others;
        }
        return;
    }
    let middle = count / 2;
    let (left, right) = coupling.split_at_mut((starts[middle] - starts[0]) as usize);
    rayon::join(
        || split_stars(&starts[..=middle], first, left, fill),
        || split_stars(&starts[middle..], first + middle, right, fill),
    );
}

impl DeformationModel for Arap {
    fn name(&self) -> &'static str {
        "arap"
    }

    fn vertex_count(&self) -> usize {
        self.assembly.rest.len()
    }

    fn parameter_len(&self) -> usize {
        self.assembly.parameter_len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        self.assembly.vertices.iter().flat_map(|&v| <[f64; 3]>::from(self.assembly.rest[v as usize])).collect()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        let stars = &self.stars;
        let (mut members, mut starts) = (Vec::new(), vec![0u32]);
        for i in 0..self.assembly.rest.len() {
            members.push(i as u32);
            members.extend(stars.of(i).iter().map(|s| s.other));
            starts.push(members.len() as u32);
        }
        let structure = match self.options.solver {
            ArapSolver::Joint => {
                let cliques = starts.windows(2).map(|s| &members[s[0] as usize..s[1] as usize]);
                self.assembly.analyse(samples, cliques)
            }
            ArapSolver::LocalGlobal => {
                let spokes: Vec<[u32; 2]> = (0..self.assembly.rest.len())
                    .flat_map(|i| stars.of(i).iter().map(move |s| [i as u32, s.other]))
                    .collect();
                self.assembly.analyse(samples, spokes.iter().map(|s| &s[..]))
            }
        };
        self.stiffness = vec![0.0; structure.slot_count()];
        for (row, &i) in self.assembly.vertices.iter().enumerate() {
            let slots = structure.row_slots(row);
            for spoke in self.stars.of(i as usize) {
                self.stiffness[slots.end - 1] += 2.0 * spoke.weight;
                if let Some(column) = self.assembly.block(spoke.other).filter(|&column| column < row) {
                    let slot = slots.start + row_position(&structure, row, column) as usize / 9;
                    self.stiffness[slot] -= 2.0 * spoke.weight;
                }
            }
        }
        if self.options.solver == ArapSolver::Joint {
            self.analyse_turns(&structure, members, starts);
        }
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.assembly.positions(x, out, |_, v| v);
    }

    fn pull_back(&mut self, _x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.assembly.pull_back(field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.fit(x);
        let sum: f64 = self.fitted.stars.iter().map(|s| s.energy).sum();
        out.push(("rigidity", self.lambda_smooth * sum));
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.fit(x);
        let joint = self.options.solver == ArapSolver::Joint;
        if joint {
            self.linearize_turns();
        }
        let structure = equations.structure().clone();
        let (stars, v, fits) = (&self.stars, &self.fitted.positions, &self.fitted.stars);
        let (vertices, stiffness, turns, lambda) =
            (&self.assembly.vertices, &self.stiffness, &self.turns, self.lambda_smooth);
        equations.for_each_block_row(&|row_index, mut row| {
            let i = vertices[row_index] as usize;
            add_scalars(&mut row, &stiffness[structure.row_slots(row_index)], lambda);
            let mut gradient = Vec3::zeros();
            for spoke in stars.of(i) {
                let j = spoke.other as usize;
                let turned = (fits[i].rotation + fits[j].rotation) * spoke.rest;
                gradient += ((v[i] - v[j]) * 2.0 - turned) * spoke.weight;
            }
            row.gradient.iter_mut().zip(&gradient).for_each(|(g, r)| *g += lambda * r);
            if joint {
                turns.subtract(row_index, row.blocks, lambda);
            }
        });
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        VertexAssembly::retract(x, step, out);
    }
}

impl Turns {
    /// Subtracts `lambda C_i' D_i^-1 C_i` of all stars from one block row.
    fn subtract(&self, row: usize, blocks: &mut [f64], lambda: f64) {
        for star in &self.uses[self.row_starts[row] as usize..self.row_starts[row + 1] as usize] {
            let own = self.coupling[star.member as usize][0] * lambda;
            for target in &self.targets[star.targets.start as usize..star.targets.end as usize] {
                let product = own.tr_mul(&self.coupling[target.member as usize][1]);
                let block = &mut blocks[target.start as usize..target.start as usize + 9];
                for (k, h) in block.iter_mut().enumerate() {
                    *h -= product[(k / 3, k % 3)];
                }
            }
        }
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

impl RegistrationModel for Arap {
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
        "arap"
    }

    fn default_schedule(&self) -> &'static str {
        include_str!("schedules/arap.toml")
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<RigidityOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let options = ArapOptions { solver: input.options.read::<RigidityOptions>()?.solver, ..ArapOptions::default() };
        Ok(Box::new(Arap::new(input.rest, options, 1.0)?))
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
        // Each edge counts twice.
        let arap = Arap::new(input.mesh, ArapOptions::default(), 0.5 * input.gradient_weight())?;
        Ok(Box::new(arap.with_held_at(input.held, input.places)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::energy::{DataTerm, Deformation};
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::model::vertex_assembly::testing::pins;
    use crate::nlls::{Minimizer, Options, Problem};

    const SOLVERS: [ArapSolver; 2] = [ArapSolver::LocalGlobal, ArapSolver::Joint];

    fn bumpy() -> TriangleMesh {
        sheet(9, 8, |c, r| {
            let k = (9.0 * r + c) as usize;
            Vec3::new(c + 0.3 * noise(k), r + 0.3 * noise(k + 100), 0.4 * noise(k + 200))
        })
    }

    type Surface = Deformation<Arap, Box<dyn DataTerm>>;

    fn problem(mesh: &TriangleMesh, solver: ArapSolver) -> Surface {
        let model = Arap::new(mesh, ArapOptions { solver, clamp: true }, 0.8).unwrap();
        Deformation::new(model, Samples::vertices(mesh.positions.len()))
    }

    fn flat(positions: &[Vec3]) -> Vec<f64> {
        positions.iter().flat_map(|p| <[f64; 3]>::from(*p)).collect()
    }

    fn turn() -> Rotation3<f64> {
        Rotation3::from_euler_angles(0.4, -2.0, 2.5)
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
        let held: Vec<bool> = (0..72).map(|i| i % 9 == 0 || i == 40).collect();
        for solver in SOLVERS {
            let model = Arap::new(&mesh, ArapOptions { solver, clamp: true }, 0.8).unwrap().with_held(&held);
            assert_eq!(model.parameter_len(), 3 * (72 - 9));
            let mut problem: Surface = Deformation::new(model, Samples::vertices(72));
            problem.terms = pins(&[8, 71, 40], &[Vec3::new(3.0, -4.0, 6.0), Vec3::new(8.0, 9.0, 3.0), Vec3::z()]);
            let mut x = problem.model.rest_parameters();
            let summary = Minimizer::new(Options::gauss_newton()).unwrap().minimize(&mut problem, &mut x);
            assert!(summary.final_energy < 0.9 * summary.initial_energy, "{summary}");
            assert_eq!(problem.model.unobserved_shifts(), 0);
            for (v, held) in held.iter().enumerate() {
                assert_eq!(problem.vertices(&x)[v] == mesh.positions[v], *held, "vertex {v}");
            }
        }
    }
}
