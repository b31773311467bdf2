//! The graph's own energy: smoothness over edges (7) and, for affine nodes, `E_rot` of Sumner et al. 2007.

use num_dual::DualSVec64;

use super::{AffineMap, MapJacobian, NodeGraph, NodeTransform, Stiffness, derivatives};
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
}

/// A directed edge at one of its ends; `block` is where the block with the other end starts, if it lies in this row.
struct NodeEdge {
    edge: u32,
    is_source: bool,
    block: Option<u32>,
}

/// Residual of (7) and its derivatives by the tangents of both ends.
struct EdgeJacobian<const W: usize> {
    residual: [f64; 3],
    source: [[f64; W]; 3],
    target: [[f64; W]; 3],
}

/// Residual of (7) of edge (i, j): where its ends take node j, `T_i(x_j - x_i) + x_i - T_j(0) - x_j`.
#[inline(always)]
fn edge_residual(source: &AffineMap<f64>, target: &AffineMap<f64>, [xi, xj]: [Vec3; 2]) -> Vec3 {
    Vec3::from(source.apply((xj - xi).into())) + xi - Vec3::from(target.translation) - xj
}

impl<const W: usize> GraphRegulariser<W> {
    pub fn new(graph: &NodeGraph, rest: &[Vec3]) -> Self {
        Self { node_edges: Vec::new(), edges: Vec::new(), squared_reach: graph.squared_reach(rest) }
    }

    /// `position(j, k)`, `j >= k`, is where block (`j`, `k`) starts in block row `j`.
    pub fn attach(&mut self, graph: &NodeGraph, position: impl Fn(u32, u32) -> u32) {
        self.node_edges = graph.nodes().iter().map(|_| Vec::new()).collect();
        for (e, &(i, j)) in graph.edges().iter().enumerate() {
            for (at, other, is_source) in [(i, j, true), (j, i, false)] {
                let block = (other < at).then(|| position(at, other));
                self.node_edges[at as usize].push(NodeEdge { edge: e as u32, is_source, block });
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
            for &(i, j) in graph.edges() {
                let [i, j] = [i as usize, j as usize];
                sum += edge_residual(&maps[i], &maps[j], [graph.nodes()[i], graph.nodes()[j]]).norm_squared();
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
        (seeded, maps): (&[AffineMap<DualSVec64<W>>], &[MapJacobian<W>]),
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
                    edges.push(EdgeJacobian::new(&maps[i], &maps[j], [graph.nodes()[i], graph.nodes()[j]]));
                }
            },
        );
        let (edges, node_edges, lambda) = (&self.edges, &self.node_edges, stiffness.graph);
        let rotation = self.rotation_weight(stiffness);
        equations.for_each_block_row(&|j, row| {
            vectorized(
                #[inline(always)]
                || {
                    let diagonal = row.blocks.len() - W * W;
                    for at in &node_edges[j] {
                        let edge = &edges[at.edge as usize];
                        let (own, other) =
                            if at.is_source { (&edge.source, &edge.target) } else { (&edge.target, &edge.source) };
                        add_block(&mut row.blocks[diagonal..], own.each_ref(), own.each_ref(), lambda);
                        if let Some(block) = at.block {
                            let block = &mut row.blocks[block as usize..][..W * W];
                            add_block(block, own.each_ref(), other.each_ref(), lambda);
                        }
                        for (own, residual) in own.iter().zip(edge.residual) {
                            for t in 0..W {
                                row.gradient[t] += lambda * own[t] * residual;
                            }
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
    fn new(source: &MapJacobian<W>, target: &MapJacobian<W>, [xi, xj]: [Vec3; 2]) -> Self {
        let unit = |a: usize, length: f64| std::array::from_fn(|b| if a == b { length } else { 0.0 });
        let mut edge = Self {
            residual: edge_residual(&source.value, &target.value, [xi, xj]).into(),
            source: [[0.0; W]; 3],
            target: [[0.0; W]; 3],
        };
        for a in 0..3 {
            source.add_pulled_back(unit(a, 1.0), (xj - xi).into(), &mut edge.source[a]);
            target.add_pulled_back(unit(a, -1.0), [0.0; 3], &mut edge.target[a]);
        }
        edge
    }
}
