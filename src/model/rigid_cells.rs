//! Cells of edges that should move rigidly: what as-rigid-as-possible surfaces and gradient-domain deformation share. A model of this
//! kind says which edges each of its cells has, and how they weigh.
//!
//! ```text
//!     E_smooth = lambda sum_c sum_(a,b in c) w_ab |(v_a - v_b) - R_c (n_a - n_b)|^2
//! ```
//!
//! `v` are the parameters, `n` the rest positions. The rotations are not parameters: for any `v` each `R_c` is the best one, so
//! `E_smooth` is a function of `v` alone, and by the envelope theorem its gradient is that at fixed `R_c`.
//!
//! Two Hessians go with it. **Local/global** keeps the rotations: `L`, the Laplacian of all edges of all cells; the energy never
//! rises. **Joint** linearises positions and rotations together, `r_ab = v_a - v_b - exp(omega_c^) R_c (n_a - n_b)`, and
//! eliminates each `omega_c` by its 3 x 3 block:
//!
//! ```text
//!     p_ab = R_c (n_a - n_b)      D_c = sum w_ab (|p_ab|^2 1 - p_ab p_ab')
//!     C_c v = sum w_ab p_ab x (v_b - v_a)
//!     H = lambda L - lambda sum_c C_c' D_c^-1 C_c
//! ```
//!
//! It joins all members of a cell, and needs far fewer steps where rotations are large.

use std::marker::PhantomData;
use std::ops::Range;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::edge_weights::WeightedEdges;
use super::rotation_fit::closest_rotation;
use super::vertex_assembly::{CHUNK, VertexAssembly, add_scalars, row_position};
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{NamedEnergy, Samples};
use crate::mesh::Vec3;
use crate::mesh::rows::Rows;
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

/// Part of the trace of `D_c` added to its diagonal: cells on a line turn freely round it.
const TURN_FLOOR: f64 = 1e-9;

/// A kind of cells: [`Spokes`](super::Spokes) or [`Patches`](super::Patches).
pub trait CellKind: Send + Sync + 'static {
    /// Name of the model in reports.
    const NAME: &'static str;
    /// Name of its energy.
    const ENERGY: &'static str;
    /// Cells of fewer members stay as they are turned while a joint step is found.
    const FEWEST_TURNING: usize = 0;
}

/// What keeps the cells of a surface rigid, of [`Arap`](super::Arap) or [`Poisson`](super::Poisson).
pub struct RigidCells<K> {
    /// `None` for rotations that are the identity.
    solver: Option<ArapSolver>,
    cells: Cells,
    /// Where the vertices are, how the cells are turned, and their energies.
    nodes: Vec<Vec3>,
    rotations: Vec<UnitQuaternion<f64>>,
    fits: Vec<CellFit>,
    /// `L`, a scalar for every stored block.
    stiffness: Vec<f64>,
    rows: CellRows,
    /// What each member of each cell adds to half the gradient, but for `lambda`.
    pulls: Vec<Vec3>,
    /// `C_c` and `D_c^-1 C_c` for every member; joint only.
    coupling: Vec<[Matrix3<f64>; 2]>,
    kind: PhantomData<K>,
}

/// The edges of every cell, and its members: the vertices that they join.
#[derive(Default)]
pub(super) struct Cells {
    members: Rows,
    edges: Rows<CellEdge>,
}

#[derive(Clone, Copy)]
struct CellEdge {
    /// Its ends a and b among the members of the cell.
    ends: [u32; 2],
    weight: f64,
    /// `n_a - n_b`.
    rest: Vec3,
}

impl Cells {
    /// Adds the cell of the given edges, `(a, b, w_ab)`. Those without weight are left out.
    pub fn push(&mut self, rest: &[Vec3], edges: impl IntoIterator<Item = (u32, u32, f64)>) {
        let mut members = Vec::new();
        self.edges.push(edges.into_iter().filter(|e| e.2 != 0.0).map(|(a, b, weight)| {
            let ends = [a, b].map(|v| {
                let known = members.iter().position(|m| *m == v);
                known.unwrap_or_else(|| {
                    members.push(v);
                    members.len() - 1
                }) as u32
            });
            CellEdge { ends, weight, rest: rest[a as usize] - rest[b as usize] }
        }));
        self.members.push(members);
    }

    fn len(&self) -> usize {
        self.members.len()
    }

    /// The edges of a cell, each with `v_a - v_b`.
    fn at<'a>(&'a self, c: usize, v: &'a [Vec3]) -> impl Iterator<Item = (&'a CellEdge, Vec3)> + 'a {
        let members = self.members.row(c);
        let place = move |end: u32| v[members[end as usize] as usize];
        self.edges.row(c).iter().map(move |edge| (edge, place(edge.ends[0]) - place(edge.ends[1])))
    }
}

#[derive(Clone, Copy)]
struct CellFit {
    rotation: Matrix3<f64>,
    energy: f64,
}

/// Per block, the cells that its vertex is a member of.
#[derive(Default)]
struct CellRows {
    uses: Rows<MemberUse>,
    targets: Vec<Target>,
}

/// A cell at one of its members. Joint: the members that come no later in the row are its targets.
struct MemberUse {
    member: u32,
    targets: Range<u32>,
}

struct Target {
    member: u32,
    /// Where the block starts in the row.
    start: u32,
}

impl<K: CellKind> VertexModel<RigidCells<K>> {
    /// The surface at rest. `edges` say which vertices hang together.
    pub(super) fn of_cells(
        rest: &[Vec3],
        edges: &WeightedEdges,
        cells: Cells,
        solver: Option<ArapSolver>,
        lambda_smooth: f64,
    ) -> Self {
        let regulariser = RigidCells {
            solver,
            nodes: Vec::new(),
            rotations: vec![UnitQuaternion::identity(); cells.len()],
            fits: vec![CellFit { rotation: Matrix3::identity(), energy: 0.0 }; cells.len()],
            cells,
            stiffness: Vec::new(),
            rows: CellRows::default(),
            pulls: Vec::new(),
            coupling: Vec::new(),
            kind: PhantomData,
        };
        Self::of(regulariser, VertexAssembly::new(rest.to_vec(), rest.len(), &edges.joined()), lambda_smooth)
    }

    /// The best rotation of every cell at `x`.
    pub fn rotations(&mut self, x: &[f64]) -> impl Iterator<Item = Rotation3<f64>> + '_ {
        self.fit(x);
        self.regulariser.rotations.iter().map(|q| q.to_rotation_matrix())
    }
}

impl<K: CellKind> RigidCells<K> {
    /// Where members and, for the joint solver, their pairs lie in the equations.
    fn analyse_rows(&mut self, vertices: &VertexAssembly, structure: &BlockStructure) {
        let joint = self.solver == Some(ArapSolver::Joint);
        let mut uses: Vec<Vec<MemberUse>> = (0..structure.block_count()).map(|_| Vec::new()).collect();
        let mut targets = Vec::new();
        for c in 0..self.cells.len() {
            let block = |m| vertices.block(self.cells.members.items()[m]).map(|block| (m as u32, block));
            let free = self.cells.members.range(c).filter_map(block);
            for (member, row) in free.clone() {
                let first = targets.len() as u32;
                let others = free.clone().filter(|other| joint && other.1 <= row);
                let target = |(member, column)| Target { member, start: row_position(structure, row, column) };
                targets.extend(others.map(target));
                uses[row].push(MemberUse { member, targets: first..targets.len() as u32 });
            }
        }
        self.rows = CellRows { uses: uses.into_iter().collect(), targets };
        let members = self.cells.members.items().len();
        self.pulls = vec![Vec3::zeros(); members];
        self.coupling = vec![[Matrix3::zeros(); 2]; if joint { members } else { 0 }];
    }

    /// Pulls of all members, and their `C_c` and `D_c^-1 C_c` if there are any.
    fn linearize_cells(&mut self) {
        let (cells, fits, v) = (&self.cells, &self.fits, &self.nodes);
        cells.members.fill(&mut self.pulls, |c, pulls| {
            pulls.fill(Vec3::zeros());
            for (edge, e) in cells.at(c, v) {
                let pull = (e - fits[c].rotation * edge.rest) * edge.weight;
                pulls[edge.ends[0] as usize] += pull;
                pulls[edge.ends[1] as usize] -= pull;
            }
        });
        if self.coupling.is_empty() {
            return;
        }
        cells.members.fill(&mut self.coupling, |c, coupling| {
            coupling.fill([Matrix3::zeros(); 2]);
            let mut d = Matrix3::zeros();
            for edge in cells.edges.row(c) {
                let p = fits[c].rotation * edge.rest;
                d += (Matrix3::from_diagonal_element(p.norm_squared()) - p * p.transpose()) * edge.weight;
                let cross = p.cross_matrix() * edge.weight;
                coupling[edge.ends[0] as usize][0] -= cross;
                coupling[edge.ends[1] as usize][0] += cross;
            }
            // Where D is not positive definite (negative weights) the rotation stays, as in local/global.
            let alone = coupling.len() < K::FEWEST_TURNING;
            let floor = TURN_FLOOR * d.trace();
            let factor = (d + Matrix3::from_diagonal_element(floor)).cholesky().filter(|_| !alone);
            for [c, y] in coupling {
                *y = factor.as_ref().map_or_else(Matrix3::zeros, |factor| factor.solve(c));
            }
        });
    }
}

impl<K: CellKind> VertexRegulariser for RigidCells<K> {
    const NAME: &'static str = K::NAME;

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        let cells = &self.cells;
        let structure = match self.solver {
            Some(ArapSolver::Joint) => vertices.analyse(samples, (0..cells.len()).map(|c| cells.members.row(c))),
            Some(ArapSolver::LocalGlobal) | None => {
                let of =
                    |c| cells.edges.row(c).iter().map(move |e| e.ends.map(|end| cells.members.row(c)[end as usize]));
                let edges: Vec<[u32; 2]> = (0..cells.len()).flat_map(of).collect();
                vertices.analyse(samples, edges.iter().map(|e| &e[..]))
            }
        };
        self.stiffness = vec![0.0; structure.slot_count()];
        for c in 0..cells.len() {
            for edge in cells.edges.row(c) {
                let ends = edge.ends.map(|end| vertices.block(cells.members.row(c)[end as usize]));
                for row in ends.into_iter().flatten() {
                    self.stiffness[structure.row_slots(row).end - 1] += edge.weight;
                }
                if let [Some(a), Some(b)] = ends {
                    let slot = structure.row_slots(a.max(b)).start;
                    self.stiffness[slot + row_position(&structure, a.max(b), a.min(b)) as usize / 9] -= edge.weight;
                }
            }
        }
        self.analyse_rows(vertices, &structure);
        structure
    }

    /// The local step.
    fn fit(&mut self, nodes: &[Vec3]) {
        self.nodes.clear();
        self.nodes.extend_from_slice(nodes);
        let (cells, turning) = (&self.cells, self.solver.is_some());
        let all = self.fits.par_iter_mut().zip(&mut self.rotations).with_min_len(CHUNK).enumerate();
        all.for_each(|(c, (fit, rotation))| {
            if turning {
                let a = cells.at(c, nodes).map(|(edge, e)| e * edge.weight * edge.rest.transpose()).sum();
                *rotation = closest_rotation(&a, rotation);
                fit.rotation = rotation.to_rotation_matrix().into_inner();
            }
            let strain = |(edge, e): (&CellEdge, Vec3)| edge.weight * (e - fit.rotation * edge.rest).norm_squared();
            fit.energy = cells.at(c, nodes).map(strain).sum();
        });
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        out.push((K::ENERGY, lambda * self.fits.iter().map(|c| c.energy).sum::<f64>()));
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        self.linearize_cells();
        let structure = equations.structure().clone();
        let (stiffness, rows, pulls, coupling) = (&self.stiffness, &self.rows, &self.pulls, &self.coupling);
        equations.for_each_block_row(&|i, mut row| {
            add_scalars(&mut row, &stiffness[structure.row_slots(i)], lambda);
            let uses = rows.uses.row(i);
            let gradient: Vec3 = uses.iter().map(|u| pulls[u.member as usize]).sum();
            row.gradient.iter_mut().zip(&gradient).for_each(|(g, r)| *g += lambda * r);
            if !coupling.is_empty() {
                rows.subtract_turns(uses, coupling, row.blocks, lambda);
            }
        });
    }
}

impl CellRows {
    /// Subtracts `lambda C_c' D_c^-1 C_c` of all cells from one block row.
    fn subtract_turns(&self, uses: &[MemberUse], coupling: &[[Matrix3<f64>; 2]], blocks: &mut [f64], lambda: f64) {
        for cell in uses {
            let own = coupling[cell.member as usize][0] * lambda;
            for target in &self.targets[cell.targets.start as usize..cell.targets.end as usize] {
                let product = own.tr_mul(&coupling[target.member as usize][1]);
                let block = &mut blocks[target.start as usize..target.start as usize + 9];
                for (k, h) in block.iter_mut().enumerate() {
                    *h -= product[(k / 3, k % 3)];
                }
            }
        }
    }
}
