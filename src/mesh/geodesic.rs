//! Distances along the edges of a mesh: an upper bound of the geodesic distance that keeps apart what only touches in
//! space, such as the upper and the lower lip.
//!
//! Everything is Dijkstra's algorithm (1959) cut down to what is asked for: a bounded one, an incremental one for
//! farthest-point sampling (Gonzalez 1985; each new node relaxes only vertices that it comes nearer to), and one that
//! settles at most k labels a vertex, for the k nearest sources. None ever holds a table of vertices times sources.
//! Ties go to the lowest index, so the results do not depend on the order of anything.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::adjacency::{Components, EdgeGraph};
use super::rows::Rows;
use super::{MeshError, Vec3};

/// A vertex or source that is not there.
pub const NONE: u32 = u32::MAX;

/// A graph with the length of every edge, laid out for walking.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedGraph {
    /// Neighbour and length, by vertex.
    arcs: Rows<(u32, f64)>,
}

impl WeightedGraph {
    /// Gives edge `e` of `graph.edges()` the length `lengths[e]`; an infinite length cuts it.
    ///
    /// # Errors
    /// When a length is negative or NaN, or there is not one for each edge.
    pub fn new(graph: &EdgeGraph, lengths: &[f64]) -> Result<Self, MeshError> {
        if lengths.len() != graph.edges().len() {
            return Err(MeshError::EdgeLengthCount { found: lengths.len(), expected: graph.edges().len() });
        }
        if let Some(edge) = lengths.iter().position(|l| l.is_nan() || *l < 0.0) {
            return Err(MeshError::EdgeLength { edge, length: lengths[edge] });
        }
        let arcs = |v: usize| {
            let row = graph.neighbours(v).iter().zip(graph.edges_at(v));
            row.map(|(&w, &e)| (w, lengths[e as usize])).filter(|(_, l)| l.is_finite())
        };
        Ok(Self { arcs: (0..graph.vertex_count()).map(arcs).collect() })
    }

    /// Edge lengths in space, millimetres.
    ///
    /// # Errors
    /// When an edge has a vertex that is not finite.
    ///
    /// # Panics
    /// When there are fewer positions than vertices.
    pub fn euclidean(graph: &EdgeGraph, positions: &[Vec3]) -> Result<Self, MeshError> {
        Self::new(graph, &graph.lengths(positions))
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.arcs.len()
    }

    #[inline]
    fn arcs(&self, v: u32) -> &[(u32, f64)] {
        self.arcs.row(v as usize)
    }
}

/// Distances are not negative, so their bits order as they do.
#[inline]
fn key(distance: f64, low: u32, high: u32) -> u128 {
    (u128::from(distance.to_bits()) << 64) | (u128::from(high) << 32) | u128::from(low)
}

#[inline]
fn unkey(key: u128) -> (f64, u32, u32) {
    (f64::from_bits((key >> 64) as u64), key as u32, (key >> 32) as u32)
}

type Queue = BinaryHeap<Reverse<u128>>;

/// Lowers `distance` at the neighbours of `v`, which is at `d`, to what is reachable through it within `limit`, and queues them.
#[inline(always)]
fn relax(
    graph: &WeightedGraph,
    limit: f64,
    (v, d): (u32, f64),
    distance: &mut [f64],
    queue: &mut Queue,
    mut lowered: impl FnMut(u32),
) {
    for &(w, length) in graph.arcs(v) {
        let through = d + length;
        if through < distance[w as usize] && through <= limit {
            distance[w as usize] = through;
            lowered(w);
            queue.push(Reverse(key(through, w, 0)));
        }
    }
}

/// Lowers `distance` to what is reachable from what is in the queue, visiting nothing that is already nearer or beyond `limit`.
/// `settled` hears of every vertex whose distance falls, once, with the final one.
fn drain(
    graph: &WeightedGraph,
    limit: f64,
    distance: &mut [f64],
    queue: &mut Queue,
    mut settled: impl FnMut(u32, f64),
) {
    while let Some(Reverse(next)) = queue.pop() {
        let (d, v, _) = unkey(next);
        if d > distance[v as usize] {
            continue;
        }
        settled(v, d);
        relax(graph, limit, (v, d), distance, queue, |_| ());
    }
}

/// Distance of every vertex to the nearest source; infinite beyond `limit` or out of reach.
///
/// # Panics
/// When a source is not a vertex.
#[must_use]
pub fn distances(graph: &WeightedGraph, sources: &[u32], limit: f64) -> Vec<f64> {
    let mut distance = vec![f64::INFINITY; graph.vertex_count()];
    let mut queue = Queue::new();
    for &source in sources {
        if distance[source as usize] > 0.0 {
            distance[source as usize] = 0.0;
            queue.push(Reverse(key(0.0, source, 0)));
        }
    }
    drain(graph, limit, &mut distance, &mut queue, |_, _| {});
    distance
}

/// Asks of many vertices, one after the other, what lies near them along the surface: costs what is near, not the mesh.
#[derive(Debug, Clone)]
pub struct Reach<'a> {
    graph: &'a WeightedGraph,
    /// Infinite but where the current question has been.
    distance: Vec<f64>,
    touched: Vec<u32>,
    queue: Queue,
}

impl<'a> Reach<'a> {
    /// For questions about one mesh.
    #[must_use]
    pub fn new(graph: &'a WeightedGraph) -> Self {
        Self { graph, distance: vec![f64::INFINITY; graph.vertex_count()], touched: Vec::new(), queue: Queue::new() }
    }

    /// The first of `targets` that lies farther than `limit` from `source` along the surface, or is out of reach.
    ///
    /// # Panics
    /// When a source or target is not a vertex.
    pub fn first_beyond(&mut self, source: u32, limit: f64, targets: &[u32]) -> Option<u32> {
        self.distance[source as usize] = 0.0;
        self.touched.push(source);
        self.queue.push(Reverse(key(0.0, source, 0)));
        let mut beyond = targets;
        while let [next, rest @ ..] = beyond {
            if self.distance[*next as usize].is_finite() {
                beyond = rest;
                continue;
            }
            let Some(Reverse(settled)) = self.queue.pop() else { break };
            let (d, v, _) = unkey(settled);
            if d > self.distance[v as usize] {
                continue;
            }
            relax(self.graph, limit, (v, d), &mut self.distance, &mut self.queue, |w| self.touched.push(w));
        }
        self.queue.clear();
        self.touched.drain(..).for_each(|v| self.distance[v as usize] = f64::INFINITY);
        beyond.first().copied()
    }
}

/// Distances that differ by less than this share count as equal in [`farthest_point_sampling`].
const TIE: f64 = 1e-9;

/// Nodes spread over a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sampling {
    /// Vertex of every node, component by component, in the order in which they were found.
    pub nodes: Vec<u32>,
    /// Component of every node.
    pub components: Vec<u32>,
    /// For every node, the largest distance of a vertex of its component to the nodes up to and including this one.
    pub radii: Vec<f64>,
    /// Distance of every vertex to the nearest node; infinite for unreferenced vertices.
    pub distances: Vec<f64>,
}

/// Spreads `counts[c]` nodes over each component `c`: the first is the component's lowest vertex, each further one the
/// vertex farthest from all before it (of those as far but for rounding, the one of lowest index).
///
/// A component gets fewer nodes when all its vertices already are at distance 0 of one.
///
/// # Panics
/// When there is not one count for each component, or `components` belongs to another graph.
#[must_use]
pub fn farthest_point_sampling(graph: &WeightedGraph, components: &Components, counts: &[usize]) -> Sampling {
    farthest_point_sampling_from(graph, components, counts, &[])
}

/// [`farthest_point_sampling`] where there are nodes already, at the vertices `seeds`: they are neither counted nor listed, and in
/// their components the first node is the vertex farthest from them.
///
/// # Panics
/// As [`farthest_point_sampling`], or when a seed is not a vertex.
#[must_use]
pub fn farthest_point_sampling_from(
    graph: &WeightedGraph,
    components: &Components,
    counts: &[usize],
    seeds: &[u32],
) -> Sampling {
    assert_eq!(counts.len(), components.count(), "one count per component");
    let mut sampling = Sampling { distances: vec![f64::INFINITY; graph.vertex_count()], ..Sampling::default() };
    let mut queue = Queue::new();
    // The place of every vertex in its component.
    let mut place = vec![0u32; graph.vertex_count()];
    for (c, &count) in counts.iter().enumerate() {
        let vertices = components.vertices(c);
        vertices.iter().enumerate().for_each(|(k, &v)| place[v as usize] = k as u32);
        let mut farthest = Farthest::new(vertices.len());
        let mut new: Vec<u32> =
            seeds.iter().copied().filter(|s| components.labels()[*s as usize] == c as u32).collect();
        let (mut next, mut found) = (vertices[0], 0);
        loop {
            if new.is_empty() {
                if found == count {
                    break;
                }
                found += 1;
                sampling.nodes.push(next);
                sampling.components.push(c as u32);
                new.push(next);
            }
            for &v in new.iter().filter(|v| sampling.distances[**v as usize] > 0.0) {
                queue.push(Reverse(key(0.0, v, 0)));
            }
            new.iter().for_each(|v| sampling.distances[*v as usize] = 0.0);
            new.clear();
            let lower = |v: u32, distance: f64| farthest.lower(place[v as usize] as usize, distance);
            drain(graph, f64::INFINITY, &mut sampling.distances, &mut queue, lower);
            let radius = farthest.greatest();
            // Rounding must not decide between vertices that are equally far, as on a symmetric mesh.
            next = vertices[farthest.first_of_at_least(radius * (1.0 - TIE))];
            if found > 0 {
                sampling.radii.push(radius);
            }
            if radius == 0.0 {
                break;
            }
        }
    }
    sampling
}

/// Distances of a component's vertices under a tree of maxima, so that a further node costs what it changes and not a look at
/// every vertex: `tree[1]` is the greatest of all, `tree[i]` that of `tree[2 i]` and `tree[2 i + 1]`, leaves are the last half.
struct Farthest {
    tree: Vec<f64>,
}

impl Farthest {
    /// All distances infinite.
    fn new(count: usize) -> Self {
        let leaves = count.next_power_of_two();
        let mut tree = vec![f64::INFINITY; 2 * leaves];
        tree[leaves + count..].fill(f64::NEG_INFINITY);
        for i in (1..leaves).rev() {
            tree[i] = tree[2 * i].max(tree[2 * i + 1]);
        }
        Self { tree }
    }

    /// Sets the distance at place `k`, which must not have been less.
    fn lower(&mut self, k: usize, distance: f64) {
        let mut i = self.tree.len() / 2 + k;
        self.tree[i] = distance;
        while i > 1 {
            let greater = self.tree[i].max(self.tree[i ^ 1]);
            i /= 2;
            if self.tree[i] == greater {
                break;
            }
            self.tree[i] = greater;
        }
    }

    fn greatest(&self) -> f64 {
        self.tree[1]
    }

    /// The lowest place whose distance is `bound`, at most the greatest, or more.
    fn first_of_at_least(&self, bound: f64) -> usize {
        let leaves = self.tree.len() / 2;
        let mut i = 1;
        while i < leaves {
            i = if self.tree[2 * i] >= bound { 2 * i } else { 2 * i + 1 };
        }
        i - leaves
    }
}

/// Shares `total` nodes among components by their sizes: at least one each (even if that exceeds `total`), at most one a
/// vertex; what rounding leaves over goes to the largest remainders, lowest component first.
#[must_use]
pub fn share_nodes(sizes: &[usize], total: usize) -> Vec<usize> {
    let all: usize = sizes.iter().sum();
    if all == 0 {
        return vec![0; sizes.len()];
    }
    let exact = |size: usize| total as f64 * size as f64 / all as f64;
    let mut counts: Vec<usize> = sizes.iter().map(|&s| (exact(s).floor() as usize).clamp(s.min(1), s)).collect();
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by(|&a, &b| exact(sizes[b]).fract().total_cmp(&exact(sizes[a]).fract()).then(a.cmp(&b)));
    let mut used: usize = counts.iter().sum();
    for &c in &order {
        if used < total && counts[c] < sizes[c] {
            counts[c] += 1;
            used += 1;
        }
    }
    // the guaranteed single nodes of many small parts are paid for by the largest
    while used > total {
        let Some(largest) = (0..sizes.len()).rev().max_by_key(|&c| counts[c]).filter(|&c| counts[c] > 1) else { break };
        counts[largest] -= 1;
        used -= 1;
    }
    counts
}

/// The k nearest sources of every vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestSources {
    k: usize,
    sources: Vec<u32>,
    distances: Vec<f64>,
}

impl NearestSources {
    /// How many were asked for.
    #[must_use]
    pub fn k(&self) -> usize {
        self.k
    }

    /// The sources in reach of a vertex, at most k, nearest first, lowest index on ties: index into the list of sources,
    /// and distance.
    pub fn of(&self, vertex: usize) -> impl Iterator<Item = (u32, f64)> + '_ {
        let range = vertex * self.k..(vertex + 1) * self.k;
        let pairs = self.sources[range.clone()].iter().zip(&self.distances[range]);
        pairs.map(|(&s, &d)| (s, d)).take_while(|(s, _)| *s != NONE)
    }

    /// Indices into the list of sources, k to a vertex, [`NONE`] where there are fewer.
    #[must_use]
    pub fn sources(&self) -> &[u32] {
        &self.sources
    }

    /// Distances, k to a vertex, infinite where there are fewer.
    #[must_use]
    pub fn distances(&self) -> &[f64] {
        &self.distances
    }
}

/// Finds the `k` nearest of `sources` (vertices) for every vertex.
///
/// All sources spread at once. A vertex keeps the k best labels (distance, source) that have reached it and passes each
/// on once, so the work is k times that of one Dijkstra, however many sources there are: a source that is not among the
/// k nearest of a vertex is not among those of any vertex behind it.
///
/// # Panics
/// When a source is not a vertex.
#[must_use]
pub fn nearest_sources(graph: &WeightedGraph, sources: &[u32], k: usize) -> NearestSources {
    let n = graph.vertex_count();
    let mut labels = NearestSources { k, sources: vec![NONE; n * k], distances: vec![f64::INFINITY; n * k] };
    if k == 0 {
        return labels;
    }
    // how many of a vertex's labels are final; they come first
    let mut settled = vec![0u32; n];
    let mut queue = Queue::with_capacity(n);
    for (s, &v) in sources.iter().enumerate() {
        if labels.offer(v, 0, s as u32, 0.0) {
            queue.push(Reverse(key(0.0, v, s as u32)));
        }
    }
    while let Some(Reverse(next)) = queue.pop() {
        let (d, v, s) = unkey(next);
        let done = settled[v as usize] as usize;
        let slot = v as usize * k + done;
        // popped in ascending order: the next label to settle, or one that has been displaced or shortened since
        if done == k || labels.sources[slot] != s || labels.distances[slot] != d {
            continue;
        }
        settled[v as usize] += 1;
        for &(w, length) in graph.arcs(v) {
            let through = d + length;
            if labels.offer(w, settled[w as usize] as usize, s, through) {
                queue.push(Reverse(key(through, w, s)));
            }
        }
    }
    labels
}

impl NearestSources {
    /// Puts a label in order among the `k` of vertex `v`, of which the first `settled` are final; false if it is no use.
    #[inline]
    fn offer(&mut self, v: u32, settled: usize, source: u32, distance: f64) -> bool {
        let (first, k) = (v as usize * self.k, self.k);
        let sources = &mut self.sources[first..first + k];
        let distances = &mut self.distances[first..first + k];
        let before = |d: f64, s: u32| d < distance || (d == distance && s <= source);
        if before(distances[k - 1], sources[k - 1]) {
            return false;
        }
        // where the same source already stands, or the last place
        let mut end = k - 1;
        for i in 0..k {
            if sources[i] == source {
                if i < settled || distances[i] <= distance {
                    return false;
                }
                end = i;
                break;
            }
        }
        let mut i = end;
        while i > settled && !before(distances[i - 1], sources[i - 1]) {
            sources[i] = sources[i - 1];
            distances[i] = distances[i - 1];
            i -= 1;
        }
        if i < settled {
            return false;
        }
        sources[i] = source;
        distances[i] = distance;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A jittered sheet of `w` x `h` vertices and, apart from it, another of 3 x 3.
    fn sheets(w: usize, h: usize, jitter: &[f64]) -> (EdgeGraph, Vec<Vec3>) {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for (w, h, z) in [(w, h, 0.0), (3, 3, 5.0)] {
            let first = positions.len() as u32;
            for i in 0..w * h {
                let j = jitter[positions.len() % jitter.len()];
                positions.push(Vec3::new((i % w) as f64 + j, (i / w) as f64 - j * j, z + j));
            }
            for y in 0..h as u32 - 1 {
                for x in 0..w as u32 - 1 {
                    let a = first + y * w as u32 + x;
                    let b = a + w as u32;
                    triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
                }
            }
        }
        positions.push(Vec3::zeros()); // unreferenced
        (EdgeGraph::from_triangles(positions.len(), &triangles), positions)
    }

    fn brute_nearest(graph: &WeightedGraph, sources: &[u32], k: usize) -> Vec<Vec<(f64, u32)>> {
        let tables: Vec<_> = sources.iter().map(|&s| distances(graph, &[s], f64::INFINITY)).collect();
        (0..graph.vertex_count())
            .map(|v| {
                let mut all: Vec<_> = tables.iter().enumerate().map(|(s, d)| (d[v], s as u32)).collect();
                all.retain(|(d, _)| d.is_finite());
                all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                all.truncate(k);
                all
            })
            .collect()
    }

    #[test]
    fn the_first_target_beyond_the_limit_is_that_of_the_distances_whatever_was_asked_before() {
        let (edges, positions) = sheets(12, 9, &[0.0, 0.2, -0.1, 0.3]);
        let graph = WeightedGraph::euclidean(&edges, &positions).unwrap();
        let mut reach = Reach::new(&graph);
        let mut found = 0;
        for source in 0..graph.vertex_count() as u32 {
            for limit in [0.0, 0.9, 2.5, 20.0] {
                let along = distances(&graph, &[source], limit);
                let targets: Vec<u32> =
                    (0..5).map(|k| (source * 7 + k * k * 5) % graph.vertex_count() as u32).collect();
                let expected = targets.iter().copied().find(|&t| along[t as usize].is_infinite());
                assert_eq!(reach.first_beyond(source, limit, &targets), expected, "{source} {limit}");
                found += usize::from(expected.is_some());
            }
        }
        assert!(found > 100 && found < 450, "{found}");
        assert_eq!(reach.first_beyond(3, 1.0, &[]), None);
    }

    proptest! {
        #[test]
        fn k_nearest_sources_are_those_of_full_dijkstras(
            jitter in prop::collection::vec(-0.3..0.3f64, 7..30),
            picks in prop::collection::vec(0usize..1000, 1..20),
            k in 1usize..7,
        ) {
            let (graph, positions) = sheets(9, 7, &jitter);
            let graph = WeightedGraph::euclidean(&graph, &positions).unwrap();
            let sources: Vec<u32> = picks.iter().map(|p| (p % positions.len()) as u32).collect();
            let labels = nearest_sources(&graph, &sources, k);
            for (v, expected) in brute_nearest(&graph, &sources, k).into_iter().enumerate() {
                let found: Vec<(f64, u32)> = labels.of(v).map(|(s, d)| (d, s)).collect();
                prop_assert_eq!(found, expected);
            }
        }

        #[test]
        fn bounded_distances_are_the_unbounded_ones_up_to_the_limit(limit in 0.0..9.0f64, source in 0u32..63) {
            let (graph, positions) = sheets(9, 7, &[0.1, -0.2, 0.05]);
            let graph = WeightedGraph::euclidean(&graph, &positions).unwrap();
            let full = distances(&graph, &[source, 3], f64::INFINITY);
            let cut = distances(&graph, &[source, 3], limit);
            for (full, cut) in full.into_iter().zip(cut) {
                prop_assert_eq!(if full <= limit { full } else { f64::INFINITY }, cut);
            }
        }
    }

    #[test]
    fn ties_go_to_the_lowest_source() {
        let (graph, _) = sheets(5, 5, &[0.0]);
        let graph = WeightedGraph::new(&graph, &vec![1.0; graph.edges().len()]).unwrap();
        let sources = [24, 4, 20, 0, 0];
        let labels = nearest_sources(&graph, &sources, 3);
        for (v, expected) in brute_nearest(&graph, &sources, 3).into_iter().enumerate() {
            assert_eq!(labels.of(v).map(|(s, d)| (d, s)).collect::<Vec<_>>(), expected, "vertex {v}");
        }
        assert_eq!(labels.of(34).count(), 0);
    }

    #[test]
    fn farthest_points_cover_ever_better_and_are_farthest() {
        let (graph, positions) = sheets(20, 15, &[0.2, -0.1, 0.15, -0.25, 0.0]);
        let components = graph.components();
        let graph = WeightedGraph::euclidean(&graph, &positions).unwrap();
        let sampling = farthest_point_sampling(&graph, &components, &[40, 9]);
        assert_eq!(sampling.nodes.len(), 49);
        assert!(sampling.radii[..40].is_sorted_by(|a, b| a >= b));
        assert!(sampling.radii[40..].is_sorted_by(|a, b| a >= b));
        assert_eq!(sampling.radii[48], 0.0);
        assert_eq!(sampling.distances, distances(&graph, &sampling.nodes, f64::INFINITY));
        for i in 1..40 {
            let before = distances(&graph, &sampling.nodes[..i], f64::INFINITY);
            let (chosen, farthest) = (before[sampling.nodes[i] as usize], sampling.radii[i - 1]);
            assert!(chosen <= farthest && chosen >= farthest * (1.0 - TIE));
        }
        // more nodes than vertices: every vertex once
        assert_eq!(farthest_point_sampling(&graph, &components, &[1, 99]).nodes.len(), 10);
    }

    #[test]
    fn nodes_are_shared_by_size() {
        assert_eq!(share_nodes(&[100, 50, 1], 30), [19, 10, 1]);
        assert_eq!(share_nodes(&[3, 3], 100), [3, 3]);
        assert_eq!(share_nodes(&[10, 10, 10], 2), [1, 1, 1]);
        assert_eq!(share_nodes(&[], 5), [0; 0]);
        for total in 3..200 {
            let counts = share_nodes(&[97, 13, 90], total);
            assert_eq!(counts.iter().sum::<usize>(), total, "{counts:?}");
        }
    }

    #[test]
    fn lengths_are_checked() {
        let (graph, positions) = sheets(3, 3, &[0.0]);
        let mut lengths = graph.lengths(&positions);
        assert!(matches!(WeightedGraph::new(&graph, &lengths[1..]), Err(MeshError::EdgeLengthCount { .. })));
        lengths[2] = -1.0;
        assert_eq!(WeightedGraph::new(&graph, &lengths), Err(MeshError::EdgeLength { edge: 2, length: -1.0 }));
        lengths[2] = f64::INFINITY;
        assert!(WeightedGraph::new(&graph, &lengths).is_ok());
    }
}
