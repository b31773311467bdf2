//! Samples that are drawn to points, alike in all directions: their quadric is `alpha_s` times the identity, and what the samples
//! of two nodes have in common enters the equations by its moments alone. With `m_sj` the sum over the corners c of sample `s` of
//! `w_c omega_cj [b_c - x_j; 1]`, so that `dv_s/dT_j = D_j m_sj`, and `f_s` the gradient by the sample's position:
//!
//! ```text
//!     H_jk = sum_a D_ja Q_jk D_ka'     Q_jk = sum_s alpha_s m_sj m_sk'     4 x 4
//!     g_j  = sum_a D_ja G_ja           G_ja = sum_s f_sa m_sj              4
//! ```
//!
//! `D_ja` are the derivatives of row a of a node's `[A t]` by its tangent. Without blendshapes `m` never changes and `Q` follows the
//! weights alone, which stay while a handle is dragged: an iteration then costs a few products for each pair of nodes instead of
//! several for each sample.

use super::samples::{Blended, FIXED, NodeSamples};
use super::{MapJacobians, pitch};
use crate::energy::QuadricField;
use crate::mesh::rows::Rows;
use crate::nlls::dense_kernels::vectorized;
use crate::nlls::{BlockStructure, NormalEquations};

/// The moments of the samples of one graph without blendshapes.
#[derive(Default)]
pub(super) struct Moments {
    /// `m_sj`, item by item, free nodes ascending.
    places: Rows<[f64; 4]>,
    /// The blocks at which the free nodes of an item meet, row by row of the lower triangle.
    slots: Vec<u32>,
    /// `alpha` of each item, of which `squares` are.
    alphas: Vec<f64>,
    /// `Q` of each stored block.
    squares: Vec<[[f64; 4]; 4]>,
    /// `G` of each node.
    slopes: Vec<[[f64; 4]; 3]>,
}

impl Moments {
    pub fn new(samples: &NodeSamples, blended: Blended<'_>, structure: &BlockStructure) -> Self {
        let mut all = Self::default();
        for (item, nodes) in samples.all_nodes().enumerate() {
            let mut places = vec![[0.0; 4]; nodes.len()];
            for corner in samples.corners(item) {
                let i = corner.vertex as usize;
                for (&(j, omega), &slot) in blended.graph.influences(i).iter().zip(samples.slots(corner)) {
                    if slot == FIXED {
                        continue;
                    }
                    let q = blended.vertices[i] - blended.graph.nodes()[j as usize];
                    for (sum, q) in places[slot as usize].iter_mut().zip([q.x, q.y, q.z, 1.0]) {
                        *sum += corner.weight * omega * q;
                    }
                }
            }
            all.places.push(places);
            for (p, &j) in nodes.iter().enumerate() {
                let slot = |k: &u32| structure.slot(j as usize, *k as usize).expect("nodes of an item meet") as u32;
                all.slots.extend(nodes[..=p].iter().map(slot));
            }
        }
        all.alphas = vec![0.0; samples.order.len()];
        all.squares = vec![[[0.0; 4]; 4]; structure.slot_count()];
        all.slopes = vec![[[0.0; 4]; 3]; structure.block_count()];
        all
    }

    /// Adds the data quadrics to the equations and says so, unless one of them is not alike in all directions.
    pub fn add_to<const W: usize>(
        &mut self,
        samples: &NodeSamples,
        field: &QuadricField,
        maps: &MapJacobians<W>,
        equations: &mut NormalEquations,
    ) -> bool {
        let quadrics = field.quadrics();
        let mut same = true;
        for (&s, kept) in samples.order.iter().zip(&mut self.alphas) {
            let Some(alpha) = quadrics[s as usize].isotropic() else {
                // of no sum: they are taken anew
                self.alphas.fill(f64::NAN);
                return false;
            };
            same &= *kept == alpha;
            *kept = alpha;
        }
        let Self { places, slots, alphas, squares, slopes } = self;
        if !same {
            squares.fill([[0.0; 4]; 4]);
            let mut slots = slots.iter();
            for (own, alpha) in places.iter().zip(&*alphas) {
                for (p, m) in own.iter().enumerate() {
                    for (other, slot) in own[..=p].iter().zip(&mut slots) {
                        add_outer(&m.map(|m| alpha * m), other, &mut squares[*slot as usize]);
                    }
                }
            }
        }
        slopes.fill([[0.0; 4]; 3]);
        for (item, (&s, nodes)) in samples.order.iter().zip(samples.all_nodes()).enumerate() {
            let f = quadrics[s as usize].gradient();
            for (m, &j) in places.row(item).iter().zip(nodes) {
                add_outer(&f, m, &mut slopes[j as usize]);
            }
        }
        let structure = equations.structure().clone();
        equations.for_each_block_row(&|j, row| {
            vectorized(
                #[inline(always)]
                || {
                    let blocks = row.blocks.chunks_exact_mut(W * W).zip(structure.row_slots(j));
                    for ((block, slot), &k) in blocks.zip(structure.row(j)) {
                        for a in 0..3 {
                            add_block::<W>(maps.of_row(j, a), &squares[slot], maps.of_row(k, a), block);
                        }
                    }
                    for (a, slope) in slopes[j].iter().enumerate() {
                        for (entry, g) in maps.of_row(j, a).chunks_exact(pitch::<W>()).zip(slope) {
                            row.gradient.iter_mut().zip(entry).for_each(|(sum, d)| *sum += d * g);
                        }
                    }
                },
            );
        });
        true
    }
}

/// `out += left right'`.
#[inline(always)]
fn add_outer<const R: usize>(left: &[f64; R], right: &[f64; 4], out: &mut [[f64; 4]; R]) {
    for (row, l) in out.iter_mut().zip(left) {
        row.iter_mut().zip(right).for_each(|(sum, r)| *sum += l * r);
    }
}

/// `out += D_j Q D_k'` of one row of `[A t]`; `own` and `other` are the four rows of `D_j'` and `D_k'`.
#[inline(always)]
fn add_block<const W: usize>(own: &[f64], q: &[[f64; 4]; 4], other: &[f64], out: &mut [f64]) {
    debug_assert_eq!(out.len(), W * W);
    for (c, q) in q.iter().enumerate() {
        let mut row = [0.0; W];
        for (d, q) in q.iter().enumerate() {
            let other = &other[d * pitch::<W>()..][..W];
            row.iter_mut().zip(other).for_each(|(sum, o)| *sum += q * o);
        }
        let own = &own[c * pitch::<W>()..][..W];
        for (out, own) in out.chunks_exact_mut(W).zip(own) {
            out.iter_mut().zip(&row).for_each(|(sum, r)| *sum += own * r);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::energy::{Deformation, DeformationModel, Pointwise, SampleResidual, Samples};
    use crate::mesh::Vec3;
    use crate::mesh::testing::{noise, sheet};
    use crate::model::hybrid::{Hybrid, Linearisation};
    use crate::model::{AffineMotion, NodeGraph, NodeTransform, RigidMotion, SimilarityMotion, graph_of};
    use crate::nlls::{Kernel, Problem, Scalar};

    /// Samples, the points that they are drawn to, and weights.
    #[derive(Clone)]
    struct Drawn(Vec<usize>, Vec<Vec3>, Vec<f64>);

    impl SampleResidual<3> for Drawn {
        fn len(&self) -> usize {
            self.0.len()
        }

        fn sample(&self, m: usize) -> usize {
            self.0[m]
        }

        fn weight(&self, m: usize) -> f64 {
            self.2[m]
        }

        fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 3] {
            let c = self.1[m];
            [v[0] - c.x, v[1] - c.y, v[2] - c.z]
        }
    }

    /// Both linearisations at parameters off the rest, with weights that change in between and samples without any.
    fn check<T: NodeTransform<W>, const W: usize>(nodes: usize) {
        let mesh = sheet(9, 7, |c, r| Vec3::new(3.0 * c, 3.0 * r, (c * r).sin()));
        let graph = || NodeGraph::along_surface(&mesh, nodes, 4).unwrap();
        let mut samples = Samples::vertices(63);
        let face = samples.push(&[(11, 0.5), (12, 0.3), (20, 0.2)]).unwrap();
        let drawn: Vec<usize> = (0..40).chain([face, 7]).collect();
        let problem = |linearisation| {
            let mut model: Hybrid<T, W> = graph_of(mesh.positions.clone(), graph(), 0.0);
            model.linearisation = linearisation;
            Deformation::new(model, samples.clone())
        };
        let mut problems = [Linearisation::Structured, Linearisation::Reference].map(problem);
        for round in 0..3 {
            let weights: Vec<f64> = (0..drawn.len()).map(|k| 0.7 * (1.5 + noise(k + 50 * (round / 2)))).collect();
            let targets = (0..drawn.len()).map(|k| mesh.positions[k] + Vec3::repeat(noise(k + round))).collect();
            let points = Drawn(drawn.clone(), targets, weights);
            let equations = problems.each_mut().map(|problem| {
                problem.terms = vec![Pointwise::new("points", points.clone(), Kernel::None)];
                let rest = problem.model.rest_parameters();
                let step: Vec<f64> = (0..problem.structure().dimension()).map(|k| 0.2 * noise(k + 9 * round)).collect();
                let mut x = rest.clone();
                problem.retract(&rest, &step, &mut x);
                let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
                problem.linearize(&x, &mut equations);
                equations
            });
            let [h, expected] = equations.each_ref().map(NormalEquations::to_dense);
            assert!((&h - &expected).amax() < 1e-11 * expected.amax(), "{W}, {nodes} nodes, round {round}");
            let largest = equations[1].gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
            for (g, expected) in equations[0].gradient.iter().zip(&equations[1].gradient) {
                assert!((g - expected).abs() < 1e-11 * largest, "{W}, {nodes} nodes, round {round}");
            }
            let alphas = &problems[0].model.moments.as_ref().unwrap().alphas;
            assert!(alphas.iter().all(|a| a.is_finite()) && alphas.contains(&0.0));
        }
    }

    #[test]
    fn moments_give_the_equations_of_the_rows() {
        for nodes in [1, 2, 12] {
            check::<RigidMotion, 6>(nodes);
            check::<SimilarityMotion, 7>(nodes);
            check::<AffineMotion, 12>(nodes);
        }
    }
}
