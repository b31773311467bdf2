//! The assembly of a [`VertexModel`](super::VertexModel): blocks of three parameters per vertex, data quadrics, held vertices, and
//! which parts of the template no data fix.
//!
//! Held vertices are not parameters: they have no block, and their positions are copied.

use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

use crate::energy::{Quadric, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::rows::Rows;
use crate::nlls::{Assembly, BlockRow, BlockStructure, NormalEquations};

/// Block of a vertex that has none.
pub(super) const HELD: u32 = u32::MAX;

/// Vertices per parallel task.
pub(super) const CHUNK: usize = 512;

/// Vertices, their parameter blocks and how samples act on them.
pub struct VertexAssembly {
    /// Rest positions: those of the template's vertices, then those of a model's own.
    pub rest: Vec<Vec3>,
    /// How many vertices the template has.
    of_template: usize,
    /// Positions of held vertices; of the others, those at rest.
    pub fixed: Vec<Vec3>,
    /// Parameter block of every vertex, or [`HELD`].
    pub blocks: Vec<u32>,
    /// Vertex of every block, ascending.
    pub vertices: Vec<u32>,
    /// The (sample, weight) of those that one free vertex alone moves, block after block: they go to its diagonal block at once.
    single: Rows<(u32, f64)>,
    /// The samples of several free corners: items of the assembler.
    joint: Vec<u32>,
    /// Free blocks of their corners, ascending, and their weights.
    corner_blocks: Rows,
    corner_weights: Vec<f64>,
    assembly: Assembly,
    /// Connected part of every vertex.
    parts: Vec<u32>,
    /// Whether a held vertex fixes the part.
    anchored: Vec<bool>,
    /// Part of every sample; samples across parts fix the first of their corners'.
    sample_parts: Vec<u32>,
    /// Sum of the quadrics of each part at the last linearisation.
    part_quadrics: Vec<Matrix3<f64>>,
}

impl VertexAssembly {
    /// All vertices free, the first `of_template` of them those of the template. Parts are what `joined` joins.
    pub fn new(rest: Vec<Vec3>, of_template: usize, joined: &[[u32; 2]]) -> Self {
        let components = EdgeGraph::from_pairs(rest.len(), joined).components();
        let mut parts = components.labels().to_vec();
        let mut count = components.count() as u32;
        for part in parts.iter_mut().filter(|p| **p == crate::mesh::adjacency::Components::UNREFERENCED) {
            *part = count;
            count += 1;
        }
        Self {
            fixed: rest.clone(),
            blocks: (0..rest.len() as u32).collect(),
            vertices: (0..rest.len() as u32).collect(),
            rest,
            of_template,
            single: Rows::default(),
            joint: Vec::new(),
            corner_blocks: Rows::default(),
            corner_weights: Vec::new(),
            assembly: Assembly::default(),
            parts,
            anchored: vec![false; count as usize],
            sample_parts: Vec::new(),
            part_quadrics: Vec::new(),
        }
    }

    /// Number of the template's vertices.
    pub fn vertex_count(&self) -> usize {
        self.of_template
    }

    /// Holds the template's vertices marked in `held` at their `positions`; the others are free.
    ///
    /// # Panics
    /// If there is not one mark and one position per vertex.
    pub fn hold(&mut self, held: &[bool], positions: &[Vec3]) {
        assert_eq!(held.len(), self.of_template, "one mark per vertex");
        assert_eq!(positions.len(), self.of_template, "one position per vertex");
        self.vertices.clear();
        self.anchored.fill(false);
        for v in 0..self.rest.len() {
            let held = held.get(v).is_some_and(|held| *held);
            self.blocks[v] = if held { HELD } else { self.vertices.len() as u32 };
            self.fixed[v] = if held { positions[v] } else { self.rest[v] };
            if held {
                self.anchored[self.parts[v] as usize] = true;
            } else {
                self.vertices.push(v as u32);
            }
        }
    }

    /// Number of parameters.
    pub fn parameter_len(&self) -> usize {
        3 * self.vertices.len()
    }

    /// Where free vertices rest.
    pub fn rest_parameters(&self) -> Vec<f64> {
        self.vertices.iter().flat_map(|&v| <[f64; 3]>::from(self.rest[v as usize])).collect()
    }

    /// Block of a vertex that is free.
    pub fn block(&self, vertex: u32) -> Option<usize> {
        let block = self.blocks[vertex as usize];
        (block != HELD).then_some(block as usize)
    }

    /// The pattern: vertices of a clique meet, and so do the corners of a sample.
    pub fn analyse<'a>(&mut self, samples: &Samples, cliques: impl Iterator<Item = &'a [u32]>) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.of_template, "samples were made for another template");
        let mut pairs = Vec::new();
        let mut free = Vec::new();
        for clique in cliques {
            free.clear();
            free.extend(clique.iter().filter_map(|&v| self.block(v)));
            for (k, &a) in free.iter().enumerate() {
                pairs.extend(free[..k].iter().map(|&b| (a, b)));
            }
        }
        self.corner_blocks = Rows::default();
        self.corner_weights.clear();
        self.joint.clear();
        let mut single = vec![Vec::new(); self.vertices.len()];
        for s in 0..samples.len() {
            let corners = samples.corners(s).iter();
            let mut corners: Vec<_> = corners.filter_map(|c| Some((self.block(c.0)? as u32, c.1))).collect();
            match corners[..] {
                [] => {}
                [(block, weight)] => single[block as usize].push((s as u32, weight)),
                _ => {
                    corners.sort_unstable_by_key(|c| c.0);
                    self.corner_blocks.push(corners.iter().map(|c| c.0));
                    self.corner_weights.extend(corners.iter().map(|c| c.1));
                    self.joint.push(s as u32);
                }
            }
        }
        self.single = single.into_iter().collect();
        let items = || self.corner_blocks.iter();
        pairs.extend(Assembly::pairs(items()));
        let structure = BlockStructure::new(&vec![3; self.vertices.len()], pairs, 0)
            .expect("proven: all pairs are blocks of free vertices");
        self.assembly = Assembly::new(items(), &structure, |_| 3);
        let part = |s: usize| samples.corners(s).first().map_or(0, |c| self.parts[c.0 as usize]);
        self.sample_parts = (0..samples.len()).map(part).collect();
        structure
    }

    /// Adds the data quadrics to `equations`.
    pub fn pull_back(&mut self, field: &QuadricField, equations: &mut NormalEquations) {
        let quadrics = field.quadrics();
        self.part_quadrics.clear();
        self.part_quadrics.resize(self.anchored.len(), Matrix3::zeros());
        // What a held vertex fixes is not asked for.
        let loose = |part: u32| !self.anchored[part as usize];
        for (quadric, &part) in quadrics.iter().zip(&self.sample_parts).filter(|(_, part)| loose(**part)) {
            for row in quadric.rows() {
                let row = Vec3::from(*row);
                self.part_quadrics[part as usize] += row * row.transpose();
            }
        }
        let single = &self.single;
        equations.for_each_block_row(&|i, mut row| {
            for &(s, weight) in single.row(i) {
                add_single(&quadrics[s as usize], weight, &mut row);
            }
        });
        if self.joint.is_empty() {
            return;
        }
        let (joint, corners, weights) = (&self.joint, &self.corner_blocks, &self.corner_weights);
        let quadric = |item: usize| &quadrics[joint[item] as usize];
        self.assembly.linearize(
            0,
            |item| quadric(item).rows().len(),
            #[inline(always)]
            |item, rows| {
                for (slot, weight) in weights[corners.range(item)].iter().enumerate() {
                    for (r, row) in quadric(item).rows().iter().enumerate() {
                        rows.of_block(slot, r).iter_mut().zip(row).for_each(|(y, a)| *y = weight * a);
                    }
                }
                rows.set_residuals(quadric(item).residuals());
            },
        );
        self.assembly.add_to(equations);
    }

    /// In how many directions parts can be shifted as a whole without any data noticing, at the last linearisation: three
    /// for a part without data and without held vertices.
    pub fn unobserved_shifts(&self) -> usize {
        let free = |part: usize| {
            let m = self.part_quadrics.get(part).copied().unwrap_or_else(Matrix3::zeros);
            let curvatures = SymmetricEigen::new(m).eigenvalues;
            let least = 1e-9 * curvatures.max();
            curvatures.iter().filter(|c| **c <= least).count()
        };
        (0..self.anchored.len()).filter(|&part| !self.anchored[part]).map(free).sum()
    }

    /// Writes all positions, a model's own too.
    pub fn positions(&self, x: &[f64], out: &mut Vec<Vec3>) {
        out.resize(self.rest.len(), Vec3::zeros());
        out.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(v, p)| {
            *p = match self.blocks[v] {
                HELD => self.fixed[v],
                block => parameters(x, block as usize),
            };
        });
    }
}

/// The three parameters of a block.
pub(super) fn parameters(x: &[f64], block: usize) -> Vec3 {
    Vec3::new(x[3 * block], x[3 * block + 1], x[3 * block + 2])
}

/// Where block (`row`, `column`) starts in its row.
pub(super) fn row_position(structure: &BlockStructure, row: usize, column: usize) -> u32 {
    let k = structure.row(row).binary_search(&column).expect("proven: the pair is part of the pattern");
    9 * k as u32
}

/// Adds `scale` times the scalars `k`, each times the identity, to the blocks of a row.
pub(super) fn add_scalars(row: &mut BlockRow<'_>, k: &[f64], scale: f64) {
    for (block, k) in row.blocks.chunks_exact_mut(9).zip(k) {
        for a in [0, 4, 8] {
            block[a] += scale * k;
        }
    }
}

/// Adds the quadric of a sample that this row's vertex moves by `weight`.
#[inline]
fn add_single(quadric: &Quadric, weight: f64, row: &mut BlockRow<'_>) {
    let diagonal = row.blocks.len() - 9;
    let block = &mut row.blocks[diagonal..];
    for (a, e) in quadric.rows().iter().zip(quadric.residuals()) {
        let a = a.map(|a| weight * a);
        for (r, g) in a.iter().zip(&mut *row.gradient) {
            *g += r * e;
        }
        for (h, (r, c)) in block.iter_mut().zip(a.iter().flat_map(|r| a.iter().map(move |c| (r, c)))) {
            *h += r * c;
        }
    }
}

/// What the tests of these models share.
#[cfg(test)]
pub(super) mod testing {
    use nalgebra::Rotation3;

    use super::*;
    use crate::energy::{DataTerm, Deformation, DeformationModel, Pointwise, SampleResidual, Samples};
    use crate::mesh::TriangleMesh;
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::nlls::{Kernel, Minimizer, Options, Scalar};

    struct Pins {
        samples: Vec<usize>,
        targets: Vec<Vec3>,
    }

    impl SampleResidual<3> for Pins {
        fn len(&self) -> usize {
            self.samples.len()
        }

        fn sample(&self, m: usize) -> usize {
            self.samples[m]
        }

        fn weight(&self, _m: usize) -> f64 {
            1.0
        }

        fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
            std::array::from_fn(|a| v[a] - self.targets[m][a])
        }
    }

    /// Pulls samples to targets.
    pub fn pins(samples: &[usize], targets: &[Vec3]) -> Vec<Box<dyn DataTerm>> {
        let pins = Pins { samples: samples.to_vec(), targets: targets.to_vec() };
        vec![Box::new(Pointwise::new("pins", pins, Kernel::None))]
    }

    /// Solves a model of which some vertices are held, by so many steps: the others are its parameters, and move.
    pub fn solve_held<M: DeformationModel>(
        mesh: &TriangleMesh,
        pins: Vec<Box<dyn DataTerm>>,
        steps: usize,
        model: impl FnOnce(&[bool]) -> M,
    ) -> (Deformation<M, Box<dyn DataTerm>>, Vec<f64>) {
        let held: Vec<bool> = (0..72).map(|i| i % 9 == 0 || i == 40).collect();
        let model = model(&held);
        assert_eq!(model.parameter_len(), 3 * (72 - 9));
        let mut problem = Deformation::new(model, Samples::vertices(72));
        problem.terms = pins;
        let mut x = problem.model.rest_parameters();
        let options = Options::gauss_newton().with_max_iterations(steps);
        let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
        assert!(summary.final_energy < 0.9 * summary.initial_energy, "{summary}");
        for (v, held) in held.iter().enumerate() {
            assert_eq!(problem.vertices(&x)[v] == mesh.positions[v], *held, "vertex {v}");
        }
        (problem, x)
    }

    /// A sheet of 72 vertices, each beside its place.
    pub fn bumpy() -> TriangleMesh {
        sheet(9, 8, |c, r| {
            let k = (9.0 * r + c) as usize;
            Vec3::new(c + 0.3 * noise(k), r + 0.3 * noise(k + 100), 0.4 * noise(k + 200))
        })
    }

    /// A sheet of 72 vertices, a second one, a triangle alone, one without area, one of a single point, one of two vertices,
    /// and a vertex in none.
    pub fn broken(first: &TriangleMesh) -> TriangleMesh {
        let mut mesh = side_by_side(first, &sheet(3, 3, |c, r| Vec3::new(c + 30.0, r, 0.0)));
        let n = mesh.positions.len() as u32;
        mesh.positions.extend([Vec3::zeros(), Vec3::x() * 2.0, Vec3::y() * 5.0].map(|p| p + Vec3::z() * 50.0));
        mesh.positions.extend([Vec3::zeros(), Vec3::x() * 2.0, Vec3::x() * 5.0].map(|p| p + Vec3::z() * 9.0));
        mesh.positions.extend([Vec3::new(1.0, 2.0, 30.0); 3]);
        mesh.positions.push(mesh.positions[40] + Vec3::new(0.1, 0.2, 0.5));
        mesh.triangles.extend([[n, n + 1, n + 2], [n + 3, n + 4, n + 5], [n + 6, n + 7, n + 8], [3, 3, 4]]);
        mesh
    }

    /// As parameters are.
    pub fn flat(positions: &[Vec3]) -> Vec<f64> {
        positions.iter().flat_map(|p| <[f64; 3]>::from(*p)).collect()
    }

    pub fn turn() -> Rotation3<f64> {
        Rotation3::from_euler_angles(0.4, -2.0, 2.5)
    }
}
