//! The graph's own energy: smoothness over edges (7) and, for affine nodes, `E_rot` of Sumner et al. 2007.

use num_dual::DualSVec64;

use super::samples::add_block;
use super::{AffineMap, NodeGraph, NodeTransform, Stiffness, derivatives};
use crate::energy::NamedEnergy;
use crate::mesh::Vec3;
use crate::nlls::{NormalEquations, Scalar};

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

/// Where both ends of edge (i, j) take node j: `T_i(x_j - x_i) + x_i` and `T_j(0) + x_j`. Their difference is the residual
/// of (7); each depends on one end's tangent only.
#[inline(always)]
fn ends<D: Scalar>(maps: &[AffineMap<D>], nodes: &[Vec3], (i, j): (u32, u32)) -> [[D; 3]; 2] {
    let (xi, xj) = (nodes[i as usize], nodes[j as usize]);
    let moved = maps[i as usize].apply(std::array::from_fn(|a| D::from(xj[a] - xi[a])));
    let own = maps[j as usize].translation;
    [std::array::from_fn(|a| moved[a] + xi[a]), std::array::from_fn(|a| own[a] + xj[a])]
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
            for &edge in graph.edges() {
                let [moved, own] = ends(maps, graph.nodes(), edge).map(Vec3::from);
                sum += (moved - own).norm_squared();
            }
            out.push(("graph smoothness (7)", stiffness.graph * sum));
        }
        let mut rotation = None;
        for residuals in maps.iter().filter_map(T::rotation_residuals) {
            *rotation.get_or_insert(0.0) += residuals.iter().map(|r| r * r).sum::<f64>();
        }
        out.extend(rotation.map(|sum| ("node rotation (Sumner)", self.rotation_weight(stiffness) * sum)));
    }

    /// Adds gradient and Gauss-Newton Hessian of half the energies, at the nodes' maps with their tangents seeded.
    pub fn add_to<T: NodeTransform<W>>(
        &mut self,
        graph: &NodeGraph,
        seeded: &[AffineMap<DualSVec64<W>>],
        stiffness: &Stiffness,
        equations: &mut NormalEquations,
    ) {
        self.edges.clear();
        self.edges.extend(graph.edges().iter().map(|&edge| EdgeJacobian::new(ends(seeded, graph.nodes(), edge))));
        let (edges, node_edges, lambda) = (&self.edges, &self.node_edges, stiffness.graph);
        let rotation = self.rotation_weight(stiffness);
        equations.for_each_block_row(&|j, row| {
            let diagonal = row.blocks.len() - (W - 3) * (W - 3);
            for at in &node_edges[j] {
                let edge = &edges[at.edge as usize];
                let (own, other) =
                    if at.is_source { (&edge.source, &edge.target) } else { (&edge.target, &edge.source) };
                for r in 0..3 {
                    add_block(&mut row.blocks[diagonal..], &own[r], &own[r], lambda);
                    if let Some(block) = at.block {
                        add_block(&mut row.blocks[block as usize..], &own[r], &other[r], lambda);
                    }
                    for t in 0..W - 3 {
                        row.gradient[t] += lambda * own[r][t] * edge.residual[r];
                    }
                }
            }
            for r in T::rotation_residuals(&seeded[j]).iter().flatten() {
                let a = derivatives(r);
                add_block(&mut row.blocks[diagonal..], &a, &a, rotation);
                for t in 0..W - 3 {
                    row.gradient[t] += rotation * a[t] * r.re;
                }
            }
        });
    }

    /// What `E_rot` is multiplied by.
    fn rotation_weight(&self, stiffness: &Stiffness) -> f64 {
        stiffness.graph * stiffness.rotation * self.squared_reach
    }
}

impl<const W: usize> EdgeJacobian<W> {
    fn new([moved, own]: [[DualSVec64<W>; 3]; 2]) -> Self {
        Self {
            residual: std::array::from_fn(|a| moved[a].re - own[a].re),
            source: moved.map(|d| derivatives(&d)),
            target: own.map(|d| derivatives(&d).map(|d| -d)),
        }
    }
}
