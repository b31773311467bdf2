//! The graph's own energy: smoothness over edges (7) and, for affine nodes, `E_rot` of Sumner et al. 2007.

use std::collections::BTreeMap;

use num_dual::DualSVec64;

use super::{AffineMap, MapJacobians, NodeGraph, NodeTransform, Stiffness, derivatives, pitch};
use crate::energy::NamedEnergy;
use crate::mesh::Vec3;
use crate::nlls::{Assembly, BlockStructure, ItemRows, Kernel, NormalEquations, RobustKernel as _};

/// The edges of (7) and the nodes of `E_rot` as items of the assembler.
pub(super) struct GraphRegulariser<const W: usize> {
    assembly: Assembly,
    /// The edges of each item but those of `E_rot`: both directions between two nodes.
    joined: Vec<Vec<u32>>,
    /// `d^2` of a graph, squared millimetres: see [`NodeGraph::squared_reach`].
    squared_reach: f64,
    /// Weight of each edge in (7) over `lambda_graph`.
    edge_weights: Vec<f64>,
    /// Of each node, the unseen share of what it moves, and the sum of its influences.
    unseen: Vec<[f64; 2]>,
}

/// Residual of (7) of edge (i, j): where its ends take node j, `T_i(x_j - x_i) + x_i - T_j(0) - x_j`.
#[inline(always)]
fn edge_residual(source: &AffineMap<f64>, target: &AffineMap<f64>, [xi, xj]: [Vec3; 2]) -> Vec3 {
    Vec3::from(source.apply((xj - xi).into())) + xi - Vec3::from(target.translation) - xj
}

impl<const W: usize> GraphRegulariser<W> {
    pub fn new(graph: &NodeGraph, rest: &[Vec3]) -> Self {
        Self {
            assembly: Assembly::default(),
            joined: joined(graph),
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
        for i in graph.carried() {
            for &(j, omega) in graph.influences(i) {
                let [sum, total] = &mut self.unseen[j as usize];
                *sum += omega * unseen[i];
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

    /// Free nodes of each item: the ends of edges, then all nodes by themselves where `E_rot` holds them.
    pub fn items<T: NodeTransform<W>>(&self, graph: &NodeGraph) -> Vec<Vec<u32>> {
        let edges = self.joined.iter().map(|edges| {
            let (i, j) = graph.edges()[edges[0] as usize];
            [i.min(j), i.max(j)].into_iter().filter(|node| (*node as usize) < graph.free_nodes()).collect()
        });
        let held = if has_rotation_residuals::<T, W>() { graph.free_nodes() } else { 0 };
        edges.chain((0..held as u32).map(|j| vec![j])).collect()
    }

    /// Lays `items` out for the equations.
    pub fn analyse(&mut self, items: &[Vec<u32>], structure: &BlockStructure) {
        self.assembly = Assembly::new(items.iter().map(Vec::as_slice), structure, |_| 6);
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
                sum += weight * stiffness.kernel.evaluate(residual.norm_squared())[0];
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
        let rotation = self.rotation_weight(stiffness).sqrt();
        let edge_weights = &self.edge_weights;
        let joined = &self.joined;
        let count = |item: usize| joined.get(item).map_or(6, |edges| 3 * edges.len());
        self.assembly.linearize(
            0,
            count,
            #[inline(always)]
            |item, rows| {
                let mut residuals = [0.0; 6];
                match joined.get(item) {
                    Some(edges) => {
                        for (&edge, residuals) in edges.iter().zip(residuals.as_chunks_mut().0) {
                            let (i, j) = graph.edges()[edge as usize];
                            let ends = [i as usize, j as usize];
                            let first = if edge == edges[0] { 0 } else { 3 };
                            let weight = stiffness.graph * edge_weights[edge as usize];
                            *residuals = edge_rows(graph, maps, ends, (weight, stiffness.kernel), first, rows);
                        }
                    }
                    None => {
                        let Some(of_node) = T::rotation_residuals(&seeded[item - joined.len()]) else { return };
                        for (r, residual) in of_node.iter().enumerate() {
                            rows.of_block(0, r)[..W].copy_from_slice(&derivatives(residual).map(|d| rotation * d));
                        }
                        residuals = of_node.map(|r| rotation * r.re);
                    }
                }
                rows.set_residuals(&residuals);
            },
        );
        self.assembly.add_to(equations);
    }

    /// What `E_rot` is multiplied by.
    fn rotation_weight(&self, stiffness: &Stiffness) -> f64 {
        stiffness.graph * stiffness.rotation * self.squared_reach
    }
}

/// The edges between two nodes, in either direction.
fn joined(graph: &NodeGraph) -> Vec<Vec<u32>> {
    let mut joined: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    for (edge, &(i, j)) in graph.edges().iter().enumerate() {
        joined.entry((i.min(j), i.max(j))).or_default().push(edge as u32);
    }
    // A graph of one's own may state an edge twice.
    joined.values().flat_map(|edges| edges.chunks(2).map(<[u32]>::to_vec)).collect()
}

/// Residual of (7) of edge (i, j) and, in the rows from `first` on, its derivatives by the tangents of its ends, `d(A_i q + t_i)` and
/// `-dt_j`, all times the root of `weight` times that of the kernel.
#[inline(always)]
fn edge_rows<const W: usize>(
    graph: &NodeGraph,
    maps: &MapJacobians<W>,
    [i, j]: [usize; 2],
    (weight, kernel): (f64, Kernel),
    first: usize,
    rows: &mut ItemRows<'_>,
) -> [f64; 3] {
    let [xi, xj] = [graph.nodes()[i], graph.nodes()[j]];
    let (q, free) = (xj - xi, graph.free_nodes());
    let residual = edge_residual(maps.value(i), maps.value(j), [xi, xj]);
    let root = (weight * kernel.weight(residual.norm_squared())).sqrt();
    if i < free {
        let slot = usize::from(j < i);
        for a in 0..3 {
            let d = maps.of_row(i, a);
            let row = rows.of_block(slot, first + a);
            for t in 0..W {
                let [d0, d1, d2, d3] = [0, 1, 2, 3].map(|c| d[c * pitch::<W>() + t]);
                row[t] = root * q[2].mul_add(d2, q[1].mul_add(d1, q[0].mul_add(d0, d3)));
            }
        }
    }
    if j < free {
        let slot = usize::from(i < j);
        for a in 0..3 {
            let shift = maps.of_translation(j, a);
            rows.of_block(slot, first + a).iter_mut().zip(shift).for_each(|(row, d)| *row = -root * d);
        }
    }
    (root * residual).into()
}

/// Whether motions of type `T` are held near the rotations.
fn has_rotation_residuals<T: NodeTransform<W>, const W: usize>() -> bool {
    T::rotation_residuals(&T::map::<f64>(T::IDENTITY)).is_some()
}
