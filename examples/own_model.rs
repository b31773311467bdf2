//! A deformation model of one's own: a free-form deformation lattice (Sederberg & Parry 1986) of cubic B-splines around the
//! face, stated as a formula for vertex positions and registered to scans next to the models that come with the crate.
//!
//! `cargo run --release --example own_model`, or `-- <folder of cases> <rig folder>` for other data than generated.

use std::collections::BTreeMap;
use std::error::Error;

use experiments::generated::standard_cases;
use experiments::scan_bench::{BenchCase, BenchRig, LandmarkUse, scan_bench};
use experiments::tables::{summary_table, table_of};
use nonrigid::mesh::Vec3;
use nonrigid::model::{Autodiff, PositionFunction};
use nonrigid::nlls::{Euclidean, Scalar};
use nonrigid::registration::*;

/// Cells along the longest side of the face.
const CELLS: f64 = 16.0;
/// Stiffness: `lambda_smooth` for a `lambda_graph` of one.
const STIFFNESS: f64 = 1.0;

/// Control points of a uniform grid. Only those that some vertex uses are parameters, so that all of them are observed.
#[derive(Default)]
struct Lattice {
    /// Control points at rest, by block.
    control: Vec<Vec3>,
    /// For each vertex the 4 x 4 x 4 control points around it, and their weights: products of three splines.
    vertices: Vec<(Vec<usize>, Vec<f64>)>,
    /// Second differences, four control points each: the thin plate energy.
    differences: Vec<Vec<usize>>,
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
        self.differences.clone()
    }

    fn smoothness<D: Scalar>(&self, _m: usize, p: &[[D; 3]]) -> [D; 3] {
        combine(&[1.0, -1.0, -1.0, 1.0], p)
    }
}

fn combine<D: Scalar>(weights: &[f64], p: &[[D; 3]]) -> [D; 3] {
    let mut sum = [D::from(0.0); 3];
    for (w, p) in weights.iter().zip(p) {
        for a in 0..3 {
            sum[a] += p[a] * *w;
        }
    }
    sum
}

impl Lattice {
    fn around(rest: &[Vec3]) -> Self {
        let low = rest.iter().fold(rest[0], |m, p| m.inf(p));
        let cell = (rest.iter().fold(rest[0], |m, p| m.sup(p)) - low).max() / CELLS;
        let mut lattice = Self::default();
        let mut block_at: BTreeMap<[i32; 3], usize> = BTreeMap::new();
        for p in rest {
            let grid = (p - low) / cell;
            let splines = grid.map(|g| cubic(g.fract()));
            let (mut blocks, mut weights) = (Vec::new(), Vec::new());
            for [i, j, k] in (0..64).map(|n| [n / 16, n / 4 % 4, n % 4]) {
                weights.push(splines[0][i] * splines[1][j] * splines[2][k]);
                let at = [grid[0] as i32 + i as i32, grid[1] as i32 + j as i32, grid[2] as i32 + k as i32];
                blocks.push(*block_at.entry(at).or_insert_with(|| {
                    lattice.control.push(low + Vec3::from(at.map(|a| f64::from(a - 1))) * cell);
                    lattice.control.len() - 1
                }));
            }
            lattice.vertices.push((blocks, weights));
        }
        lattice.differences = second_differences(&block_at);
        lattice
    }
}

/// The corners of D_a D_b p = p(1, 1) - p(1, 0) - p(0, 1) + p(0, 0) for all axes a and b, where these points are there.
fn second_differences(block_at: &BTreeMap<[i32; 3], usize>) -> Vec<Vec<usize>> {
    let mut differences = Vec::new();
    for (at, (a, b)) in block_at.keys().flat_map(|at| (0..9).map(move |k| (at, (k / 3, k % 3)))) {
        let corner = |&(i, j): &(i32, i32)| {
            let mut corner = *at;
            corner[a] += i;
            corner[b] += j;
            block_at.get(&corner).copied()
        };
        differences.extend([(1, 1), (1, 0), (0, 1), (0, 0)].iter().map(corner).collect::<Option<Vec<usize>>>());
    }
    differences
}

/// The four uniform cubic B-splines that meet in a cell, at `t` in [0, 1).
fn cubic(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [s * s * s, 3.0 * t * t * (t - 2.0) + 4.0, 3.0 * s * s * (s - 2.0) + 4.0, t * t * t].map(|b| b / 6.0)
}

struct LatticeModel;

impl ModelFactory for LatticeModel {
    fn name(&self) -> &str {
        "lattice"
    }

    fn schedule(&self) -> Result<Schedule, ScheduleError> {
        let mut schedule = ModelKind::Graph.schedule()?;
        schedule.levels.iter_mut().for_each(|level| level.lambda_smooth = STIFFNESS * level.lambda_graph);
        Ok(schedule)
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
        Ok(Box::new(Autodiff::new(Lattice::around(&input.rest.positions))?))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let cases = match &arguments[..] {
        [] => standard_cases(2500, 40_000, 7)?,
        [cases, rig] => BenchCase::read_all(cases.as_ref(), &BenchRig::read(rig.as_ref())?)?,
        _ => return Err("arguments: none, or a folder of cases and a rig folder".into()),
    };
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    let models: [&dyn ModelFactory; 3] = [&LatticeModel, &ModelKind::Graph, &ModelKind::Rigid];
    let rows = scan_bench(&models, &terms, &cases, LandmarkUse::All, |_, _, _| Ok(()))?;
    println!("{}\n{}", table_of(&rows), summary_table(&rows));
    Ok(())
}
