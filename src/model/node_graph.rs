//! The deformation graph: nodes, how strongly each moves each vertex, and which nodes are neighbours (Sumner et al. 2007).

use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::{ClosestVertex, ClosestVertices};
use crate::mesh::geodesic::{
    NearestSources, WeightedGraph, farthest_point_sampling, farthest_point_sampling_from, nearest_sources, share_nodes,
};
use crate::mesh::normals::face_areas;
use crate::mesh::rows::Rows;
use crate::mesh::{MeshError, TriangleMesh, Vec3, referenced};

/// Nodes `x_j`, influences `omega_ij` and directed edges of an embedded deformation graph.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeGraph {
    nodes: Vec<Vec3>,
    influences: Rows<(u32, f64)>,
    edges: Vec<(u32, u32)>,
    /// How many of the last nodes stay where they are.
    fixed: usize,
    /// Which vertices follow a node without a say in what it is: those of no triangle. Empty if there are none.
    followers: Vec<bool>,
}

/// Influences of a vertex that [`NodeGraph::on_region`] takes: Sumner's.
const REGION_INFLUENCES: usize = 4;

impl NodeGraph {
    /// About `nodes` farthest-point nodes on the surface of `mesh`, `influences` (`K`) to a vertex, distances along edges.
    ///
    /// Weights are `(1 - d / d_(K+1))^2`, normalised (Sumner et al. 2007); edges join nodes that share a vertex, and
    /// one that shares none to its nearest. Every connected part has nodes of its own, at least one, so parts that merely touch in space (upper and lower lip) move
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
        let influences = influences.min(at.len());
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
        let graph = Self::from_influences(positions, lists).with_company(&nearest, &at);
        Ok(Self { followers: followers(mesh), ..graph }.with_neighbours_together())
    }

    /// A graph for the vertices of `mesh` that are not held: about `nodes` farthest-point nodes among them and, along the rim that
    /// held vertices make, twice as densely, [fixed](Self::free_nodes) ones. So the region's motion fades out towards its rim, and
    /// held vertices have fixed nodes only. Influences and edges as in [`along_surface`](Self::along_surface), `K = 4`.
    ///
    /// # Errors
    /// When a position is not finite.
    ///
    /// # Panics
    /// If there is not one mark per vertex.
    pub fn on_region(mesh: &TriangleMesh, held: &[bool], nodes: usize) -> Result<Self, MeshError> {
        assert_eq!(held.len(), mesh.positions.len(), "one mark per vertex");
        let edges = EdgeGraph::of(mesh);
        let components = edges.components();
        let graph = WeightedGraph::euclidean(&edges, &mesh.positions)?;
        let of_component = |c: usize| components.vertices(c).iter().filter(|v| !held[**v as usize]).count();
        let counts = share_nodes(&(0..components.count()).map(of_component).collect::<Vec<_>>(), nodes);

        let mut region = mesh.triangles.clone();
        region.retain(|t| t.iter().any(|v| !held[*v as usize]));
        let area: f64 = face_areas(&mesh.positions, &region).iter().sum();
        let apart = 0.5 * (area / nodes.max(1) as f64).sqrt();
        let at_rim = |v: &u32| held[*v as usize] && edges.neighbours(*v as usize).iter().any(|w| !held[*w as usize]);
        let rim: Vec<u32> = (0..held.len() as u32).filter(at_rim).collect();
        let rim = scattered(&mesh.positions, &rim, apart);

        let sampled = farthest_point_sampling_from(&graph, &components, &counts, &rim).nodes;
        let mut at: Vec<u32> = sampled.into_iter().filter(|v| !held[*v as usize]).collect();
        if at.is_empty() {
            // Nothing but vertices of no triangle can move: each by itself.
            at.extend((0..held.len() as u32).filter(|v| !held[*v as usize]));
        }
        let free = at.len();
        at.extend(rim);
        let nearest = nearest_sources(&graph, &at, REGION_INFLUENCES + 1);
        let positions: Vec<Vec3> = at.iter().map(|&v| mesh.positions[v as usize]).collect();
        let through_space = ClosestVertices::new(&positions)?;
        let influences = |i: usize| {
            let reached = nearest.of(i).filter(|n| !held[i] || n.0 as usize >= free).collect::<Vec<_>>();
            match through_space.query(&mesh.positions[i]) {
                Some(node) if reached.is_empty() => vec![(node.vertex, 1.0)],
                _ => influence_weights(&reached, REGION_INFLUENCES),
            }
        };
        let lists = (0..held.len()).map(influences);
        let fixed = positions.len() - free;
        let graph = Self::from_influences(positions, lists).with_company(&nearest, &at);
        Ok(Self { fixed, followers: followers(mesh), ..graph }.with_neighbours_together())
    }

    /// [`along_surface`](Self::along_surface) with influences by distance through space.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn through_space(mesh: &TriangleMesh, nodes: usize, influences: usize) -> Result<Self, MeshError> {
        let on_surface = Self::along_surface(mesh, nodes, influences)?;
        let influences = influences.min(on_surface.nodes.len());
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
        Ok(Self { followers: on_surface.followers, ..Self::from_influences(on_surface.nodes, lists) })
    }

    /// One node at `centre` that moves all of `vertex_count` vertices: the graph behind rigid, similarity and blendshape.
    #[must_use]
    pub fn single(centre: Vec3, vertex_count: usize) -> Self {
        Self {
            nodes: vec![centre],
            influences: (0..vertex_count).map(|_| [(0, 1.0)]).collect(),
            edges: Vec::new(),
            fixed: 0,
            followers: Vec::new(),
        }
    }

    /// The same graph with all of its nodes fixed: only shapes move anything.
    #[must_use]
    pub fn all_fixed(self) -> Self {
        Self { fixed: self.nodes.len(), ..self }
    }

    /// A graph from per-vertex lists of (node, weight); edges join, in both directions, all nodes that share a vertex.
    ///
    /// # Panics
    /// If an influence names a node that does not exist.
    #[must_use]
    pub fn from_influences(nodes: Vec<Vec3>, per_vertex: impl IntoIterator<Item = Vec<(u32, f64)>>) -> Self {
        let sorted = |mut list: Vec<(u32, f64)>| {
            list.retain(|i| i.1 > 0.0);
            list.sort_unstable_by_key(|i| i.0);
            assert!(list.iter().all(|i| (i.0 as usize) < nodes.len()), "influence of a node that does not exist");
            list
        };
        let influences: Rows<(u32, f64)> = per_vertex.into_iter().map(sorted).collect();
        let rows = (0..influences.len()).map(|i| influences.row(i));
        let shared = rows.flat_map(|row| row.iter().flat_map(move |a| row.iter().map(move |b| (a.0, b.0))));
        let shared = Rows::sorted(nodes.len(), shared);
        let mut edges = Vec::new();
        let mut last_of = vec![u32::MAX; nodes.len()];
        for i in 0..nodes.len() as u32 {
            for &j in shared.row(i as usize) {
                if i != j && std::mem::replace(&mut last_of[j as usize], i) != i {
                    edges.push((i, j));
                }
            }
        }
        Self { nodes, influences, edges: Vec::new(), fixed: 0, followers: Vec::new() }.with_edges(edges)
    }

    /// The same nodes and influences with these directed edges; repeated ones count once.
    ///
    /// # Panics
    /// If an edge names a node that does not exist, or joins a node to itself.
    #[must_use]
    pub fn with_edges(mut self, mut edges: Vec<(u32, u32)>) -> Self {
        let sound = |&(i, j): &(u32, u32)| i != j && (i.max(j) as usize) < self.nodes.len();
        assert!(edges.iter().all(sound), "an edge must join two nodes that exist");
        edges.sort_unstable();
        edges.dedup();
        self.edges = edges;
        self
    }

    /// The same graph with an edge to each node that shares no vertex with another, from the nodes nearest to its own vertex `at`: where
    /// nodes are about as many as vertices, and distances are equal, a node moves nothing but that, and nothing would hold it.
    fn with_company(self, nearest: &NearestSources, at: &[u32]) -> Self {
        let mut alone = vec![true; self.nodes.len()];
        self.edges.iter().for_each(|&(i, _)| alone[i as usize] = false);
        let mut edges = self.edges.clone();
        for (j, v) in (0..).zip(at).filter(|&(j, _): &(u32, _)| alone[j as usize]) {
            edges.extend(nearest.of(*v as usize).filter(|&(k, _)| k != j).flat_map(|(k, _)| [(j, k), (k, j)]));
        }
        self.with_edges(edges)
    }

    /// The same graph with its nodes numbered anew, halves of space one after the other, so that nodes with neighbouring numbers
    /// are neighbours in space: what an iteration reads for one node is then still in the processor's cache for the next. Fixed nodes
    /// stay the last.
    #[must_use]
    pub fn with_neighbours_together(self) -> Self {
        let mut order: Vec<u32> = (0..self.nodes.len() as u32).collect();
        let (free, fixed) = order.split_at_mut(self.free_nodes());
        bisect(&self.nodes, free);
        bisect(&self.nodes, fixed);
        let mut number = vec![0; order.len()];
        for (new, &old) in order.iter().enumerate() {
            number[old as usize] = new as u32;
        }
        let renumbered = |i: usize| {
            let mut list: Vec<_> = self.influences(i).iter().map(|&(j, omega)| (number[j as usize], omega)).collect();
            list.sort_unstable_by_key(|influence| influence.0);
            list
        };
        let nodes = order.iter().map(|&j| self.nodes[j as usize]).collect();
        let influences = (0..self.vertex_count()).map(renumbered).collect();
        let edges = self.edges.iter().map(|&(i, j)| (number[i as usize], number[j as usize])).collect();
        Self { nodes, influences, ..self }.with_edges(edges)
    }

    /// How many nodes can move: the first ones. The others are fixed; they have no parameters, and their motion is the identity.
    #[must_use]
    pub fn free_nodes(&self) -> usize {
        self.nodes.len() - self.fixed
    }

    /// Node positions `x_j` in the rest shape.
    #[must_use]
    pub fn nodes(&self) -> &[Vec3] {
        &self.nodes
    }

    /// The (node, `omega_ij`) of vertex `i`, nodes ascending, weights summing to one.
    #[must_use]
    pub fn influences(&self, i: usize) -> &[(u32, f64)] {
        self.influences.row(i)
    }

    /// Directed edges (i, j), sorted.
    #[must_use]
    pub fn edges(&self) -> &[(u32, u32)] {
        &self.edges
    }

    /// Of each node, the vertex at its place: the nearest by the rest positions of those that it moves; none if it moves none.
    #[must_use]
    pub fn own_vertices(&self, rest: &[Vec3]) -> Vec<Option<usize>> {
        let mut nearest = vec![(f64::INFINITY, None); self.nodes.len()];
        for (i, n) in rest.iter().enumerate() {
            for &(j, _) in self.influences(i) {
                let distance = (n - self.nodes[j as usize]).norm_squared();
                if distance < nearest[j as usize].0 {
                    nearest[j as usize] = (distance, Some(i));
                }
            }
        }
        nearest.into_iter().map(|n| n.1).collect()
    }

    /// Mean squared distance between a vertex and the nodes that move it, `sum_ij omega_ij |n_i - x_j|^2 / N`, for the rest
    /// positions `n_i` of the vertices that triangles have; in their unit, squared. Zero without vertices.
    #[must_use]
    pub fn squared_reach(&self, rest: &[Vec3]) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for i in self.carried() {
            for &(j, omega) in self.influences(i) {
                sum += omega * (rest[i] - self.nodes[j as usize]).norm_squared();
            }
            count += 1;
        }
        sum / count.max(1) as f64
    }

    /// The vertices that say what their nodes are: all but those of no triangle, which follow a node wherever they are.
    pub(super) fn carried(&self) -> impl Iterator<Item = usize> {
        (0..self.vertex_count()).filter(|&i| !self.followers.get(i).is_some_and(|follows| *follows))
    }

    /// Number of vertices the graph moves.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.influences.len()
    }
}

/// Which vertices are of no triangle; empty if there are none.
fn followers(mesh: &TriangleMesh) -> Vec<bool> {
    let used = referenced(mesh.positions.len(), mesh.triangles.as_flattened().iter().copied());
    if used.contains(&false) { used.iter().map(|used| !used).collect() } else { Vec::new() }
}

/// Those of `candidates`, in order, that lie at least `apart` from all before them.
fn scattered(positions: &[Vec3], candidates: &[u32], apart: f64) -> Vec<u32> {
    let mut kept: Vec<u32> = Vec::new();
    for &v in candidates {
        let far = |k: &u32| (positions[*k as usize] - positions[v as usize]).norm() >= apart;
        if kept.iter().all(far) {
            kept.push(v);
        }
    }
    kept
}

/// Orders points by halving them along the longest side of their box, over and over.
fn bisect(points: &[Vec3], order: &mut [u32]) {
    if order.len() < 2 {
        return;
    }
    let of = |i: &u32| points[*i as usize];
    let low = order.iter().map(of).fold(Vec3::repeat(f64::INFINITY), |a, b| a.inf(&b));
    let high = order.iter().map(of).fold(Vec3::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b));
    let axis = (high - low).imax();
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |i, j| of(i)[axis].total_cmp(&of(j)[axis]).then(i.cmp(j)));
    let (first, second) = order.split_at_mut(middle);
    bisect(points, first);
    bisect(points, second);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{sheet, side_by_side};

    fn flat(z: f64) -> TriangleMesh {
        sheet(9, 7, |c, r| Vec3::new(c, r, z))
    }

    /// Two sheets that touch, unconnected: vertices 0 to 62 and 63 to 125.
    fn lips() -> TriangleMesh {
        side_by_side(&flat(0.0), &flat(0.1))
    }

    type Build = fn(&TriangleMesh, usize, usize) -> Result<NodeGraph, MeshError>;
    const BOTH: [Build; 2] = [NodeGraph::along_surface, NodeGraph::through_space];

    fn check(graph: &NodeGraph, vertices: usize, most: usize) {
        assert_eq!(graph.vertex_count(), vertices);
        for i in 0..vertices {
            let list = graph.influences(i);
            assert!((1..=most).contains(&list.len()), "vertex {i}: {list:?}");
            assert!(list.windows(2).all(|w| w[0].0 < w[1].0), "vertex {i}: {list:?}");
            assert!(list.iter().all(|n| n.1 > 0.0 && n.1 <= 1.0), "vertex {i}: {list:?}");
            approx::assert_abs_diff_eq!(list.iter().map(|n| n.1).sum::<f64>(), 1.0, epsilon = 1e-14);
        }
        assert!(graph.edges().iter().all(|&(i, j)| i != j && graph.edges().contains(&(j, i))));
    }

    #[test]
    fn weights_sum_to_one_whatever_the_number_of_nodes_and_influences() {
        for build in BOTH {
            for (nodes, influences) in [(1, 1), (1, 4), (2, 1), (2, 4), (10, 4), (10, 30), (63, 4), (500, 4)] {
                let graph = build(&flat(0.0), nodes, influences).unwrap();
                assert_eq!(graph.nodes().len(), nodes.min(63));
                check(&graph, 63, influences);
            }
        }
    }

    #[test]
    fn one_node_moves_everything() {
        for build in BOTH {
            let graph = build(&flat(0.0), 1, 4).unwrap();
            assert!((0..63).all(|i| graph.influences(i) == [(0, 1.0)]));
            assert!(graph.edges().is_empty());
        }
        check(&NodeGraph::single(Vec3::x(), 5), 5, 1);
    }

    #[test]
    fn more_influences_than_nodes_leave_out_the_farthest() {
        for build in BOTH {
            let graph = build(&flat(0.0), 3, 8).unwrap();
            check(&graph, 63, 2);
            assert_eq!(graph.nodes().len(), 3);
            assert!((0..63).any(|i| graph.influences(i).len() == 2));
        }
    }

    #[test]
    fn a_vertex_at_a_node_follows_it_most() {
        let mesh = flat(0.0);
        let graph = NodeGraph::along_surface(&mesh, 10, 4).unwrap();
        for (j, node) in graph.nodes().iter().enumerate() {
            let i = mesh.positions.iter().position(|p| p == node).unwrap();
            let strongest = graph.influences(i).iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
            assert_eq!(strongest.0, j as u32);
        }
    }

    #[test]
    fn neighbours_have_near_numbers_and_the_graph_is_the_same() {
        let graph = NodeGraph::along_surface(
            &sheet(60, 60, |c, r| Vec3::new(c + 0.1 * r.sin(), r + 0.1 * c.sin(), 0.0)),
            256,
            4,
        )
        .unwrap();
        let near = graph.edges().iter().filter(|(i, j)| i.abs_diff(*j) < 32).count();
        assert!(2 * near > graph.edges().len(), "{near} of {}", graph.edges().len());
        // Shuffled by hand and put together again: only the numbers change.
        let number = |j: u32| (j * 77) % 256;
        let mut nodes = vec![Vec3::zeros(); 256];
        (0..256).for_each(|j| nodes[number(j) as usize] = graph.nodes()[j as usize]);
        let influences = |i| graph.influences(i).iter().map(|&(j, omega)| (number(j), omega)).collect();
        let shuffled = NodeGraph::from_influences(nodes, (0..3600).map(influences));
        assert_eq!(shuffled.with_neighbours_together(), graph);
    }

    #[test]
    fn every_part_has_nodes_of_its_own() {
        let tiny = sheet(2, 2, |c, r| Vec3::new(50.0 + c, r, 0.0));
        let parts = side_by_side(&lips(), &tiny);
        let graph = NodeGraph::along_surface(&parts, 12, 4).unwrap();
        check(&graph, 130, 4);
        let count = |holds: &dyn Fn(&Vec3) -> bool| graph.nodes().iter().filter(|p| holds(p)).count();
        assert_eq!(graph.nodes().len(), 12);
        assert_eq!(count(&|p| p.x >= 50.0), 1);
        assert!(count(&|p| p.x < 50.0 && p.z == 0.0) >= 5 && count(&|p| p.z == 0.1) >= 5);
        // Fewer nodes than parts: still one each.
        assert_eq!(NodeGraph::along_surface(&parts, 1, 4).unwrap().nodes().len(), 3);
    }

    #[test]
    fn touching_sheets_share_nodes_through_space_only() {
        let mesh = lips();
        let shared = |graph: &NodeGraph| {
            let crosses = |i: &usize| {
                let other = |n: &(u32, f64)| graph.nodes()[n.0 as usize].z != mesh.positions[*i].z;
                graph.influences(*i).iter().any(other)
            };
            (0..126).filter(crosses).count()
        };
        let along = NodeGraph::along_surface(&mesh, 16, 4).unwrap();
        let through = NodeGraph::through_space(&mesh, 16, 4).unwrap();
        check(&along, 126, 4);
        check(&through, 126, 4);
        assert_eq!(along.nodes(), through.nodes());
        assert_eq!(shared(&along), 0);
        assert!(shared(&through) > 60, "{}", shared(&through));
        let height = |j: u32| along.nodes()[j as usize].z;
        assert!(along.edges().iter().all(|&(i, j)| height(i) == height(j)));
    }

    #[test]
    fn a_vertex_without_triangles_follows_the_nearest_node() {
        let mut mesh = flat(0.0);
        let alone = Vec3::new(8.5, 6.5, 4.0);
        mesh.positions.push(alone);
        let graph = NodeGraph::along_surface(&mesh, 9, 4).unwrap();
        check(&graph, 64, 4);
        assert!(!graph.nodes().contains(&alone));
        let distance = |j: u32| (graph.nodes()[j as usize] - alone).norm();
        let nearest = (0..9).min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap();
        assert_eq!(graph.influences(63), [(nearest, 1.0)]);
    }

    #[test]
    fn weights_fall_with_distance_and_are_equal_where_nodes_coincide() {
        assert_eq!(influence_weights(&[(3, 0.0), (1, 0.0), (2, 0.0)], 2), [(3, 0.5), (1, 0.5)]);
        assert_eq!(influence_weights(&[(3, 2.0), (1, 2.0), (2, 2.0)], 2), [(3, 0.5), (1, 0.5)]);
        assert_eq!(influence_weights(&[(5, 7.0)], 4), [(5, 1.0)]);
        assert_eq!(influence_weights(&[], 4), []);
        // (1 - 0)^2 : (1 - 1/2)^2
        assert_eq!(influence_weights(&[(0, 0.0), (1, 1.0), (2, 2.0)], 4), [(0, 0.8), (1, 0.2)]);
        let point = sheet(3, 3, |_, _| Vec3::x());
        check(&NodeGraph::along_surface(&point, 4, 3).unwrap(), 9, 3);
    }

    #[test]
    fn positions_must_be_finite_and_nodes_must_exist() {
        let mut mesh = flat(0.0);
        mesh.positions[7].y = f64::NAN;
        for build in BOTH {
            assert!(build(&mesh, 5, 4).is_err());
        }
        let missing = || NodeGraph::from_influences(vec![Vec3::x()], [vec![(1, 1.0)]]);
        assert!(std::panic::catch_unwind(missing).is_err());
    }
}
