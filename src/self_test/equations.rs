//! The arithmetic under every registration: derivatives by dual numbers, and the factorisation of normal equations with a border,
//! each against another way to the same numbers. The problem is eqs. (7) and (8) of Klimov 2020 stated residual by residual:
//!
//! ```text
//!     R_i (x_j - x_i) + x_i + t_i - x_j - t_j             neighbouring nodes
//!     R_j (p + sum_k w_k d_k - x_j) + x_j + t_j - q       points of a face that one node and all shapes move
//! ```

use std::error::Error;

use super::face::{self, scattered};
use super::{Check, largest};
use crate::mesh::{Pose, Vec3};
use crate::nlls::linear::{BorderedCholesky, DenseCholesky};
use crate::nlls::{
    Euclidean, Family, GradientCheck, Kernel, LinearSolver, NormalEquations, Problem as _, ProblemError, Residual,
    ResidualProblem, Scalar, Se3, check_gradient,
};

/// Against differences of the energy, of fourth order: [`GradientCheck`] says what these know, and takes it into account.
pub const DERIVATIVES: Check = Check {
    what: "autodiff of a graph with shapes against differences: worst relative error",
    expected: 0.0,
    tolerance: 1e-6,
    compute: derivatives,
};

/// Both factorisations are backward stable, so that steps differ by about the condition number times the machine's epsilon. The
/// eigenvalues go from 0.3 to 1.2e5, hence 1e-10; ten times as much is allowed.
pub const BORDERED_CHOLESKY: Check = Check {
    what: "a step by sparse Cholesky with a border against dense: relative difference",
    expected: 0.0,
    tolerance: 1e-9,
    compute: bordered_cholesky,
};

const NODES: usize = 220;
const POINTS: usize = 2000;
const SHAPES: usize = 20;
/// Node `i` has an edge to each node so much further on, if there is one.
const STRIDES: [usize; 4] = [1, 2, 13, 34];

struct Edge {
    from: [f64; 3],
    to: [f64; 3],
}

impl Residual<3, 12> for Edge {
    type Blocks = (Se3, Se3);

    fn evaluate<D: Scalar>(&self, (from, to): &([D; 12], [D; 12])) -> [D; 3] {
        let turned = Se3::transform(from, std::array::from_fn(|a| D::from(self.to[a] - self.from[a])));
        std::array::from_fn(|a| turned[a] + self.from[a] - self.to[a] - to[9 + a])
    }
}

struct Point {
    node: [f64; 3],
    rest: [f64; 3],
    shapes: [[f64; 3]; SHAPES],
    target: [f64; 3],
}

impl Residual<3, { 6 + SHAPES }> for Point {
    type Blocks = (Se3, Euclidean<SHAPES>);

    fn evaluate<D: Scalar>(&self, (node, w): &([D; 12], [D; SHAPES])) -> [D; 3] {
        let arm = std::array::from_fn(|a| {
            let start = D::from(self.rest[a] - self.node[a]);
            w.iter().zip(&self.shapes).fold(start, |sum, (w, shape)| sum + *w * shape[a])
        });
        let moved = Se3::transform(node, arm);
        std::array::from_fn(|a| moved[a] + self.node[a] - self.target[a])
    }
}

/// Nodes on the face, somewhat turned and shifted; points that belong somewhere else.
fn problem() -> Result<ResidualProblem, ProblemError> {
    let place = |i: usize| face::rest(scattered(i));
    let mut builder = ResidualProblem::builder();
    let nodes: Vec<_> = (0..NODES)
        .map(|i| {
            let turn = 0.3 * face::direction(i);
            let Pose { rotation, translation, .. } = Pose::rigid(turn, 2.0 * face::direction(i + NODES));
            let initial: Vec<f64> = rotation.transpose().iter().chain(&translation).copied().collect();
            builder.add_block::<Se3>(&initial)
        })
        .collect();
    let w = builder.add_border_block::<Euclidean<SHAPES>>(&[0.2; SHAPES]);
    let (mut edges, mut edge_blocks) = (Vec::new(), Vec::new());
    for (i, j) in (0..NODES).flat_map(|i| STRIDES.map(|stride| (i, i + stride))).filter(|(_, j)| *j < NODES) {
        for (i, j) in [(i, j), (j, i)] {
            edges.push(Edge { from: place(i).into(), to: place(j).into() });
            edge_blocks.push([nodes[i], nodes[j]]);
        }
    }
    let bumps = face::bumps(SHAPES);
    let point = |m: usize| {
        let rest = place(m);
        let target: Vec3 = rest + 3.0 * face::direction(m);
        let shapes = std::array::from_fn(|k| bumps[k].displacement(rest).into());
        Point { node: place(m % NODES).into(), rest: rest.into(), shapes, target: target.into() }
    };
    let point_blocks: Vec<_> = (0..POINTS).map(|m| [nodes[m % NODES], w]).collect();
    builder.add_family(Family::new(edges, &edge_blocks));
    builder.add_family(
        Family::new((0..POINTS).map(point).collect(), &point_blocks).with_kernel(Kernel::Cauchy { delta: 2.0 }),
    );
    builder.build()
}

fn derivatives() -> Result<f64, Box<dyn Error>> {
    let mut problem = problem()?;
    let x = problem.initial();
    let report = check_gradient(&mut problem, &x, GradientCheck { samples: 60, ..GradientCheck::default() });
    Ok(report.entries.first().map_or(f64::NAN, |worst| worst.relative_error))
}

fn bordered_cholesky() -> Result<f64, Box<dyn Error>> {
    let mut problem = problem()?;
    let structure = problem.structure().clone();
    let mut equations = NormalEquations::new(structure.clone());
    problem.linearize(&problem.initial(), &mut equations);
    let mut steps = [vec![0.0; structure.dimension()], vec![0.0; structure.dimension()]];
    BorderedCholesky::new(&structure).solve(&equations, &[], &mut steps[0])?;
    DenseCholesky::new(&structure).solve(&equations, &[], &mut steps[1])?;
    let [sparse, dense] = steps;
    Ok(largest(sparse.iter().zip(&dense).map(|(a, b)| a - b)) / largest(dense.iter().copied()))
}
