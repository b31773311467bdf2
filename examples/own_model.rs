//! A deformation model of one's own: a free-form deformation lattice (Sederberg & Parry 1986) of B-splines around the
//! face, stated as a formula for vertex positions and registered to scans next to the models that come with the crate.
//!
//! `cargo run --release --example own_model`, or `-- <folder of cases> <rig folder>` for other data than generated.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;

use experiments::generated::standard_cases;
use experiments::scan_bench::{BenchCase, BenchRig, LandmarkUse, scan_bench, summarize, summary_table, table_of};
use nonrigid::energy::{OptionTable, Options, OptionsError};
use nonrigid::mesh::{TriangleMesh, Vec3, adjacency::EdgeGraph};
use nonrigid::model::{Autodiff, ModelError, PositionFunction};
use nonrigid::nlls::{Euclidean, Scalar};
use nonrigid::registration::*;
use serde::{Deserialize, Serialize};

/// `[model]` of the lattice.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct LatticeOptions {
    /// Cells along the longest side of the face.
    cells: f64,
}

impl Default for LatticeOptions {
    fn default() -> Self {
        Self { cells: 20.0 }
    }
}

impl OptionTable for LatticeOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::positive("cells", self.cells)
    }
}

/// Softer from level to level; `lambda_smooth` weighs the second differences.
const SCHEDULE: &str = r#"
model = { cells = 20.0 }
scan = { template_rim = 2.0 }

[[level]]
steps = 5
distance_cap = 25.0
kernel = { huber = { delta = 3.0 } }
model = { lambda_smooth = 30.0 }
terms.landmarks = { weight = 5.0 }

[[level]]
steps = 5
distance_cap = 12.0
kernel = { huber = { delta = 2.0 } }
model = { lambda_smooth = 0.7 }
terms.landmarks = { weight = 2.4 }

[[level]]
steps = 5
distance_cap = 12.0
kernel = { huber = { delta = 1.0 } }
model = { lambda_smooth = 0.15 }
terms.landmarks = { weight = 1.8 }

[[level]]
steps = 15
distance_cap = 8.0
kernel = { huber = { delta = 0.4 } }
model = { lambda_smooth = 0.03 }
terms.landmarks = { weight = 1.0 }
"#;

/// A uniform grid of control points around the surface. A grid point moves the vertices less than one and a half cells away, and
/// is one control point for each connected part of them: upper and lower lip touch without being joined.
#[derive(Default)]
struct Lattice {
    /// Control points at rest, by block.
    control: Vec<Vec3>,
    /// For each vertex the 3 x 3 x 3 control points that move it, and their weights: products of three splines.
    vertices: Vec<(Vec<usize>, Vec<f64>)>,
    /// Second differences, four control points each: the thin plate energy.
    differences: BTreeSet<[usize; 4]>,
}

impl PositionFunction for Lattice {
    type Block = Euclidean<3>;

    fn name(&self) -> &'static str {
        "lattice"
    }

    fn rest_blocks(&self) -> Vec<[f64; 3]> {
        self.control.iter().map(|&c| c.into()).collect()
    }

    fn vertex_blocks(&self) -> Vec<Vec<usize>> {
        self.vertices.iter().map(|v| v.0.clone()).collect()
    }

    /// v = sum_ijk B_i B_j B_k p_ijk, eq. (2) of the paper with splines for Bernstein polynomials.
    fn position<D: Scalar>(&self, vertex: usize, p: &[[D; 3]]) -> [D; 3] {
        combine(&self.vertices[vertex].1, p)
    }

    fn smoothness_blocks(&self) -> Vec<Vec<usize>> {
        self.differences.iter().map(|d| d.to_vec()).collect()
    }

    fn smoothness<D: Scalar>(&self, _m: usize, p: &[[D; 3]]) -> [D; 3] {
        combine(&[1.0, -1.0, -1.0, 1.0], p)
    }
}

fn combine<D: Scalar>(weights: &[f64], p: &[[D; 3]]) -> [D; 3] {
    std::array::from_fn(|a| weights.iter().zip(p).fold(D::from(0.0), |sum, (w, p)| sum + p[a] * *w))
}

/// The points of a 3 x 3 x 3 box, in lexicographic order.
fn in_box() -> impl Iterator<Item = [usize; 3]> {
    (0..27).map(|n| [n / 9, n / 3 % 3, n % 3])
}

impl Lattice {
    fn around(rest: &TriangleMesh, cells: f64) -> Self {
        let (low, high) =
            rest.positions.iter().fold((rest.positions[0], rest.positions[0]), |(l, h), p| (l.inf(p), h.sup(p)));
        let cell = (high - low).max() / cells;
        let mut lattice = Self::default();
        let mut moved_by: BTreeMap<[usize; 3], BTreeSet<u32>> = BTreeMap::new();
        for (vertex, p) in rest.positions.iter().enumerate() {
            let grid = (p - low) / cell;
            let [x, y, z] = [0, 1, 2].map(|a| quadratic(grid[a].fract()));
            for k in in_box() {
                moved_by.entry([0, 1, 2].map(|a| grid[a] as usize + k[a])).or_default().insert(vertex as u32);
            }
            lattice.vertices.push((Vec::new(), in_box().map(|[i, j, k]| x[i] * y[j] * z[k]).collect()));
        }
        let edges = EdgeGraph::of(rest);
        for (point, mut vertices) in moved_by {
            while let Some(vertex) = vertices.pop_first() {
                let mut part = vec![vertex];
                while let Some(vertex) = part.pop() {
                    lattice.vertices[vertex as usize].0.push(lattice.control.len());
                    part.extend(edges.neighbours(vertex as usize).iter().filter(|v| vertices.remove(v)));
                }
                lattice.control.push(low + Vec3::from(point.map(|i| i as f64 - 0.5)) * cell);
            }
        }
        // D_a D_b p for all axes a and b, wherever one vertex has all four corners.
        for blocks in lattice.vertices.iter().map(|v| &v.0).collect::<BTreeSet<_>>() {
            for ((n, k), a, b) in in_box().enumerate().flat_map(|k| (0..9).map(move |ab| (k, ab / 3, ab % 3))) {
                let (mut far, next) = (k, [9, 3, 1]);
                far[a] += 1;
                far[b] += 1;
                if far.iter().all(|&i| i < 3) {
                    let corners = [n + next[a] + next[b], n + next[a], n + next[b], n];
                    lattice.differences.insert(corners.map(|n| blocks[n]));
                }
            }
        }
        lattice
    }
}

/// The three uniform quadratic B-splines that meet in a cell, at `t` in [0, 1).
fn quadratic(t: f64) -> [f64; 3] {
    [(1.0 - t) * (1.0 - t), 1.0 + 2.0 * t * (1.0 - t), t * t].map(|b| b / 2.0)
}

struct LatticeModel;

impl ModelFactory for LatticeModel {
    fn name(&self) -> &str {
        "lattice"
    }

    fn default_schedule(&self) -> &str {
        SCHEDULE
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<LatticeOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let LatticeOptions { cells } = input.options.read()?;
        Ok(Box::new(Autodiff::new(Lattice::around(input.rest, cells))?))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let cases = match &arguments[..] {
        [] => standard_cases(2500, 40_000, 7)?,
        [cases, rig] => BenchCase::read_all(cases.as_ref(), &BenchRig::read(rig.as_ref())?)?,
        _ => return Err("arguments: none, or a folder of cases and a rig folder".into()),
    };
    let models: [&dyn ModelFactory; 3] = [&LatticeModel, &ModelKind::Graph, &ModelKind::Rigid];
    let rows = scan_bench(&models, &TERMS, &cases, LandmarkUse::All)?;
    println!("{}\n{}", table_of(&rows), summary_table(&summarize(&rows)));
    Ok(())
}
