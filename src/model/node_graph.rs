//! The deformation graph: nodes, how strongly each moves each vertex, and which nodes are neighbours (Sumner et al. 2007).

use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::{ClosestVertex, ClosestVertices};
use crate::mesh::geodesic::{WeightedGraph, farthest_point_sampling, nearest_sources, share_nodes};
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// Nodes `x_j`, influences `omega_ij` and directed edges of an embedded deformation graph.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeGraph {
    nodes: Vec<Vec3>,
    starts: Vec<u32>,
    influences: Vec<(u32, f64)>,
    edges: Vec<(u32, u32)>,
}

impl NodeGraph {
    /// About `nodes` farthest-point nodes on the surface of `mesh`, `influences` (`K`) to a vertex, distances along edges.
    ///
    /// Weights are `(1 - d / d_(K+1))^2`, normalised (Sumner et al. 2007); edges join nodes that share a vertex. Every
    /// connected part has nodes of its own, at least one, so parts that merely touch in space (upper and lower lip) move
    /// apart freely; unreferenced vertices follow the nearest node and own none.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn along_surface(mesh: &TriangleMesh, nodes: usize, influences: usize) -> Result<Self, MeshError> {
        let edges = EdgeGraph::of(mesh);
        let components = edges.components();
        let graph = WeightedGraph::euclidean(&edges, &mesh.positions)?;
        let counts = share_nodes(&components.sizes(), nodes);
        let at = farthest_point_sampling(&graph, &components, &counts).nodes;
        let nearest = nearest_sources(&graph, &at, influences + 1);
        let positions: Vec<Vec3> = at.iter().map(|&v| mesh.positions[v as usize]).collect();
        let through_space = ClosestVertices::new(&positions)?;
        let lists = (0..mesh.positions.len()).map(|i| {
            let reached: Vec<(u32, f64)> = nearest.of(i).collect();
            match through_space.query(&mesh.positions[i]) {
                Some(node) if reached.is_empty() => vec![(node.vertex, 1.0)],
                _ => influence_weights(&reached, influences),
            }
        });
        Ok(Self::from_influences(positions, lists))
    }

    /// [`along_surface`](Self::along_surface) with influences by distance through space.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn through_space(mesh: &TriangleMesh, nodes: usize, influences: usize) -> Result<Self, MeshError> {
        let on_surface = Self::along_surface(mesh, nodes, influences)?;
        let tree = ClosestVertices::new(&on_surface.nodes)?;
        let mut found: Vec<ClosestVertex> = Vec::new();
        let lists: Vec<_> = mesh
            .positions
            .iter()
            .map(|p| {
                tree.k_nearest(p, influences + 1, &mut found);
                let reached: Vec<_> = found.iter().map(|f| (f.vertex, f.squared_distance.sqrt())).collect();
                influence_weights(&reached, influences)
            })
            .collect();
        Ok(Self::from_influences(on_surface.nodes, lists))
    }

    /// One node at `centre` that moves all of `vertex_count` vertices: the graph behind rigid, similarity and blendshape.
    #[must_use]
    pub fn single(centre: Vec3, vertex_count: usize) -> Self {
        Self {
            nodes: vec![centre],
            starts: (0..=vertex_count as u32).collect(),
            influences: vec![(0, 1.0); vertex_count],
            edges: Vec::new(),
        }
    }

    /// A graph from per-vertex lists of (node, weight); edges join, in both directions, all nodes that share a vertex.
    ///
    /// # Panics
    /// If an influence names a node that does not exist.
    #[must_use]
    pub fn from_influences(nodes: Vec<Vec3>, per_vertex: impl IntoIterator<Item = Vec<(u32, f64)>>) -> Self {
        let (mut starts, mut influences, mut edges) = (vec![0], Vec::new(), Vec::new());
        for mut list in per_vertex {
            list.retain(|i| i.1 > 0.0);
            list.sort_unstable_by_key(|i| i.0);
            assert!(list.iter().all(|i| (i.0 as usize) < nodes.len()), "influence of a node that does not exist");
            for a in &list {
                edges.extend(list.iter().filter(|b| b.0 != a.0).map(|b| (a.0, b.0)));
            }
            influences.extend(list);
            starts.push(influences.len() as u32);
        }
        edges.sort_unstable();
        edges.dedup();
        Self { nodes, starts, influences, edges }
    }

    /// The same graph with the given directed edges instead.
    #[must_use]
    pub fn with_edges(mut self, mut edges: Vec<(u32, u32)>) -> Self {
        edges.sort_unstable();
        edges.dedup();
        self.edges = edges;
        self
    }

    /// Node positions `x_j` in the rest shape.
    #[must_use]
    pub fn nodes(&self) -> &[Vec3] {
        &self.nodes
    }

    /// The (node, `omega_ij`) of vertex `i`, nodes ascending, weights summing to one.
    #[must_use]
    pub fn influences(&self, i: usize) -> &[(u32, f64)] {
        &self.influences[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Directed edges (i, j), sorted.
    #[must_use]
    pub fn edges(&self) -> &[(u32, u32)] {
        &self.edges
    }

    /// Number of vertices the graph moves.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }
}

/// `(1 - d / d_(K+1))^2`, normalised, of the nearest nodes with their distances, nearest first: at most `influences` plus
/// the one that sets the radius. A lone node gets weight one; weights that all vanish become equal.
fn influence_weights(nearest: &[(u32, f64)], influences: usize) -> Vec<(u32, f64)> {
    let Some(&(_, radius)) = nearest.last() else { return Vec::new() };
    let kept = &nearest[..(nearest.len() - 1).clamp(1, influences)];
    let raw = |d: f64| if radius > 0.0 { (1.0 - d / radius).powi(2) } else { 0.0 };
    let total: f64 = kept.iter().map(|n| raw(n.1)).sum();
    if total > 0.0 {
        kept.iter().map(|&(j, d)| (j, raw(d) / total)).collect()
    } else {
        kept.iter().map(|&(j, _)| (j, 1.0 / kept.len() as f64)).collect()
    }
}
