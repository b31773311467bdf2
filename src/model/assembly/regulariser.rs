//! The graph's own energy: smoothness over edges (7) and, for affine nodes, `E_rot` of Sumner et al. 2007.

use num_dual::DualSVec64;

use super::samples::pitch;
use super::{AffineMap, MapJacobians, NodeGraph, NodeTransform, Stiffness, derivatives};
use crate::energy::NamedEnergy;
use crate::mesh::Vec3;
use crate::nlls::NormalEquations;
use crate::nlls::dense_kernels::{add_block, vectorized};

/// Where the edges of a graph enter the normal equations, and their Jacobians.
pub(super) struct GraphRegulariser<const W: usize> {
    node_edges: Vec<Vec<NodeEdge>>,
    edges: Vec<EdgeJacobian<W>>,
    /// `d^2` of a graph, squared millimetres: see [`NodeGraph::squared_reach`].
    squared_reach: f64,
    /// Weight of each edge in (7) over `lambda_graph`.
    edge_weights: Vec<f64>,
    /// Of each node, the unseen share of what it moves, and the sum of its influences.
    unseen: Vec<[f64; 2]>,
}

/// A directed edge at one of its ends; `block` is where the block with the other end starts, if it lies in this row.
struct NodeEdge {
    edge: u32,
    is_source: bool,
    other: u32,
    block: Option<u32>,
}

/// Residual of (7) and its derivatives by the tangent of its source. Those by the target's, `-dt_j`, are the same for all edges
/// that end there.
struct EdgeJacobian<const W: usize> {
    residual: [f64; 3],
    source: [[f64; W]; 3],
}

/// Residual of (7) of edge (i, j): where its ends take node j, `T_i(x_j - x_i) + x_i - T_j(0) - x_j`.
#[inline(always)]
fn edge_residual(source: &AffineMap<f64>, target: &AffineMap<f64>, [xi, xj]: [Vec3; 2]) -> Vec3 {
    Vec3::from(source.apply((xj - xi).into())) + xi - Vec3::from(target.translation) - xj
}

impl<const W: usize> GraphRegulariser<W> {
    pub fn new(graph: &NodeGraph, rest: &[Vec3]) -> Self {
        Self {
            node_edges: Vec::new(),
            edges: Vec::new(),
            squared_reach: graph.squared_reach(rest),
            edge_weights: vec![1.0; graph.edges().len()],
            unseen: Vec::new(),
        }
    }

    /// Weighs each edge by `factor^u`, with `u` the mean over its ends of the share, by influence, of their vertices that are
    /// `unseen` (0 to 1 each).
    pub fn stiffen(&mut self, graph: &NodeGraph, unseen: &[f64], factor: f64) {
        self.unseen.clear();
        self.unseen.resize(graph.nodes().len(), [0.0; 2]);
        for (i, unseen) in unseen.iter().enumerate() {
            for &(j, omega) in graph.influences(i) {
                let [sum, total] = &mut self.unseen[j as usize];
                *sum += omega * unseen;
                *total += omega;
            }
        }
        let share = |j: u32| {
            let [sum, total] = self.unseen[j as usize];
            if total > 0.0 { sum / total } else { 1.0 }
        };
        let log = factor.ln();
        for (weight, &(i, j)) in self.edge_weights.iter_mut().zip(graph.edges()) {
            *weight = (log * 0.5 * (share(i) + share(j))).exp();
        }
    }

    /// `position(j, k)`, `j >= k`, is where block (`j`, `k`) starts in block row `j`.
    pub fn attach(&mut self, graph: &NodeGraph, position: impl Fn(u32, u32) -> u32) {
        self.node_edges = (0..graph.free_nodes()).map(|_| Vec::new()).collect();
        for (e, &(i, j)) in graph.edges().iter().enumerate() {
            let ends = [(i, j, true), (j, i, false)].into_iter();
            for (at, other, is_source) in ends.filter(|end| (end.0 as usize) < graph.free_nodes()) {
                let block = (other < at).then(|| position(at, other));
                self.node_edges[at as usize].push(NodeEdge { edge: e as u32, is_source, other, block });
            }
        }
    }

    /// Appends the energies for the nodes' `maps`.
    pub fn energy<T: NodeTransform<W>>(
        &self,
        graph: &NodeGraph,
        maps: &[AffineMap<f64>],
        stiffness: &Stiffness,
        out: &mut Vec<NamedEnergy>,
    ) {
        if !graph.edges().is_empty() {
            let mut sum = 0.0;
            for (&(i, j), weight) in graph.edges().iter().zip(&self.edge_weights) {
                let [i, j] = [i as usize, j as usize];
                let residual = edge_residual(&maps[i], &maps[j], [graph.nodes()[i], graph.nodes()[j]]);
                sum += weight * residual.norm_squared();
            }
            out.push(("graph smoothness (7)", stiffness.graph * sum));
        }
        let mut rotation = None;
        for residuals in maps.iter().filter_map(T::rotation_residuals) {
            *rotation.get_or_insert(0.0) += residuals.iter().map(|r| r * r).sum::<f64>();
        }
        out.extend(rotation.map(|sum| ("node rotation (Sumner)", self.rotation_weight(stiffness) * sum)));
    }

    /// Adds gradient and Gauss-Newton Hessian of half the energies, at the nodes' maps with their tangents seeded and at what
    /// follows from these.
    pub fn add_to<T: NodeTransform<W>>(
        &mut self,
        graph: &NodeGraph,
        (seeded, maps): (&[AffineMap<DualSVec64<W>>], &MapJacobians<W>),
        stiffness: &Stiffness,
        equations: &mut NormalEquations,
    ) {
        let edges = &mut self.edges;
        edges.clear();
        vectorized(
            #[inline(always)]
            || {
                for &(i, j) in graph.edges() {
                    let [i, j] = [i as usize, j as usize];
                    edges.push(EdgeJacobian::new(maps, [i, j], [graph.nodes()[i], graph.nodes()[j]]));
                }
            },
        );
        let (edges, node_edges, edge_weights) = (&self.edges, &self.node_edges, &self.edge_weights);
        let rotation = self.rotation_weight(stiffness);
        equations.for_each_block_row(&|j, row| {
            vectorized(
                #[inline(always)]
                || {
                    let diagonal = row.blocks.len() - W * W;
                    let shift = |k: u32| std::array::from_fn(|a| maps.of_translation(k as usize, a));
                    let own_shift = shift(j as u32);
                    let (mut ends, mut pull) = (0.0, [0.0; 3]);
                    for at in &node_edges[j] {
                        let edge = &edges[at.edge as usize];
                        let lambda = stiffness.graph * edge_weights[at.edge as usize];
                        let source = edge.source.each_ref();
                        if at.is_source {
                            add_block(&mut row.blocks[diagonal..], source, source, lambda);
                            for (source, residual) in source.into_iter().zip(edge.residual) {
                                for t in 0..W {
                                    row.gradient[t] += lambda * source[t] * residual;
                                }
                            }
                        } else {
                            ends += lambda;
                            (0..3).for_each(|a| pull[a] += lambda * edge.residual[a]);
                        }
                        if let Some(block) = at.block {
                            let block = &mut row.blocks[block as usize..][..W * W];
                            let (own, other) =
                                if at.is_source { (source, shift(at.other)) } else { (own_shift, source) };
                            add_block(block, own, other, -lambda);
                        }
                    }
                    add_block(&mut row.blocks[diagonal..], own_shift, own_shift, ends);
                    for (shift, pull) in own_shift.into_iter().zip(pull) {
                        for t in 0..W {
                            row.gradient[t] -= shift[t] * pull;
                        }
                    }
                    for r in T::rotation_residuals(&seeded[j]).iter().flatten() {
                        let a = derivatives(r);
                        add_block(&mut row.blocks[diagonal..], [&a], [&a], rotation);
                        for t in 0..W {
                            row.gradient[t] += rotation * a[t] * r.re;
                        }
                    }
                },
            );
        });
    }

    /// What `E_rot` is multiplied by.
    fn rotation_weight(&self, stiffness: &Stiffness) -> f64 {
        stiffness.graph * stiffness.rotation * self.squared_reach
    }
}

impl<const W: usize> EdgeJacobian<W> {
    #[inline(always)]
    fn new(maps: &MapJacobians<W>, [i, j]: [usize; 2], [xi, xj]: [Vec3; 2]) -> Self {
        let q = xj - xi;
        let mut source = [[0.0; W]; 3];
        for (a, row) in source.iter_mut().enumerate() {
            let d = maps.of_row(i, a);
            for t in 0..W {
                let [d0, d1, d2, d3] = [0, 1, 2, 3].map(|c| d[c * pitch::<W>() + t]);
                row[t] = q[2].mul_add(d2, q[1].mul_add(d1, q[0].mul_add(d0, d3)));
            }
        }
        Self { residual: edge_residual(maps.value(i), maps.value(j), [xi, xj]).into(), source }
    }
}
