//! Who is next to whom: edges, neighbours, incident triangles, open boundary, connected components.
//!
//! Everything is built in linear time (counting sorts; each vertex's few neighbours are then sorted), lies in
//! compressed rows, and is ordered by index, so it depends on nothing but the connectivity.

use super::rows::Rows;
use super::{PolygonMesh, TriangleMesh, Vec3};

/// The triangles round every vertex, ascending. A triangle that names a vertex twice is listed once.
///
/// # Panics
/// When a triangle indexes past `vertex_count`.
#[must_use]
pub fn vertex_triangles(vertex_count: usize, triangles: &[[u32; 3]]) -> Rows {
    let pairs = triangles.iter().enumerate().flat_map(|(t, &[a, b, c])| {
        let twice = [false, b == a, c == a || c == b];
        [a, b, c].into_iter().zip(twice).filter(|(_, twice)| !twice).map(move |(v, _)| (v, t as u32))
    });
    Rows::sorted(vertex_count, pairs)
}

/// The undirected edges of a mesh and every vertex's neighbours.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EdgeGraph {
    edges: Vec<[u32; 2]>,
    faces: Vec<u32>,
    neighbours: Rows,
    edge_of: Vec<u32>,
}

impl EdgeGraph {
    /// Edges of triangles. Triangles that differ in nothing but the order of their corners count once for the boundary.
    ///
    /// # Panics
    /// When a triangle indexes past `vertex_count`.
    #[must_use]
    pub fn from_triangles(vertex_count: usize, triangles: &[[u32; 3]]) -> Self {
        let sides = triangles.iter().flat_map(|&[a, b, c]| {
            // a triangle without area by its indices joins its vertices but bounds nothing
            let flat = a == b || b == c || c == a;
            let seen = |opposite: u32| if flat { u32::MAX } else { opposite };
            [(a, b, seen(c)), (b, c, seen(a)), (c, a, seen(b))]
        });
        Self::from_sides(vertex_count, sides)
    }

    /// Edges of a triangle mesh.
    ///
    /// # Panics
    /// When a triangle indexes past the vertices.
    #[must_use]
    pub fn of(mesh: &TriangleMesh) -> Self {
        Self::from_triangles(mesh.positions.len(), &mesh.triangles)
    }

    /// Edges of polygons: a quad has four, no diagonals.
    ///
    /// # Panics
    /// When a polygon indexes past the vertices.
    #[must_use]
    pub fn from_polygons(mesh: &PolygonMesh) -> Self {
        let sides = (0..mesh.polygon_count()).flat_map(|f| {
            let polygon = mesh.polygon(f);
            (0..polygon.len()).map(move |i| (polygon[i], polygon[(i + 1) % polygon.len()], f as u32))
        });
        Self::from_sides(mesh.positions.len(), sides)
    }

    /// Any graph: pairs of vertices in any order, duplicates and loops are dropped.
    ///
    /// # Panics
    /// When a pair indexes past `vertex_count`.
    #[must_use]
    pub fn from_pairs(vertex_count: usize, pairs: &[[u32; 2]]) -> Self {
        Self::from_sides(vertex_count, pairs.iter().map(|&[a, b]| (a, b, u32::MAX)))
    }

    /// `(a, b, face)`: `face` tells the faces at an edge apart, `u32::MAX` for none.
    fn from_sides(vertex_count: usize, sides: impl Iterator<Item = (u32, u32, u32)> + Clone) -> Self {
        let proper = sides.filter(|(a, b, _)| a != b).map(|(a, b, face)| {
            assert!((a.max(b) as usize) < vertex_count, "vertex {} of {vertex_count}", a.max(b));
            (a.min(b), (a.max(b), face))
        });
        let mut buckets = Rows::sorted(vertex_count, proper);
        let mut edges = Vec::with_capacity(buckets.items().len() / 2);
        let mut faces = Vec::with_capacity(buckets.items().len() / 2);
        for low in 0..vertex_count {
            let bucket = buckets.row_mut(low);
            bucket.sort_unstable();
            let mut last = None;
            for &(high, face) in bucket.iter() {
                if last == Some((high, face)) {
                    continue;
                }
                if last.is_none_or(|(h, _)| h != high) {
                    edges.push([low as u32, high]);
                    faces.push(0);
                }
                if face != u32::MAX {
                    *faces.last_mut().unwrap_or(&mut 0) += 1;
                }
                last = Some((high, face));
            }
        }
        // edges are sorted, so both directions in this order give ascending neighbours
        let directed = edges.iter().enumerate().flat_map(|(e, &[a, b])| [(a, (b, e as u32)), (b, (a, e as u32))]);
        let edge_of = directed.clone().map(|(v, (_, e))| (v, e));
        let (edge_of, neighbours) = rayon::join(
            || Rows::sorted(vertex_count, edge_of).into_items(),
            || Rows::sorted(vertex_count, directed.map(|(v, (w, _))| (v, w))),
        );
        Self { edges, faces, neighbours, edge_of }
    }

    /// Number of vertices, with or without edges.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.neighbours.len()
    }

    /// Every edge once, lower vertex first, sorted.
    #[must_use]
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Neighbours of a vertex, ascending.
    #[must_use]
    pub fn neighbours(&self, vertex: usize) -> &[u32] {
        self.neighbours.row(vertex)
    }

    /// The edge to each of [`Self::neighbours`], as index into [`Self::edges`].
    #[must_use]
    pub fn edges_at(&self, vertex: usize) -> &[u32] {
        &self.edge_of[self.neighbours.range(vertex)]
    }

    /// Index of the edge between two vertices.
    #[must_use]
    pub fn find(&self, a: u32, b: u32) -> Option<usize> {
        let row = self.neighbours(a as usize);
        row.binary_search(&b).ok().map(|i| self.edges_at(a as usize)[i] as usize)
    }

    /// Number of different faces at each edge: 1 on the open boundary, 2 inside, more where the surface is not a
    /// manifold.
    #[must_use]
    pub fn faces_per_edge(&self) -> &[u32] {
        &self.faces
    }

    /// Length of every edge when the vertices are at `positions`.
    ///
    /// # Panics
    /// When there are fewer positions than vertices.
    #[must_use]
    pub fn lengths(&self, positions: &[Vec3]) -> Vec<f64> {
        self.edges.iter().map(|&[a, b]| (positions[a as usize] - positions[b as usize]).norm()).collect()
    }

    /// Whether an edge has more than one face.
    #[must_use]
    pub fn has_inner_edges(&self) -> bool {
        self.faces.iter().any(|faces| *faces > 1)
    }

    /// Edges of the open boundary, with exactly one face; sorted.
    #[must_use]
    pub fn boundary_edges(&self) -> Vec<[u32; 2]> {
        self.edges.iter().zip(&self.faces).filter(|(_, faces)| **faces == 1).map(|(edge, _)| *edge).collect()
    }

    /// Whether each vertex lies on the open boundary.
    #[must_use]
    pub fn boundary_vertices(&self) -> Vec<bool> {
        let mut boundary = vec![false; self.vertex_count()];
        for [a, b] in self.boundary_edges() {
            boundary[a as usize] = true;
            boundary[b as usize] = true;
        }
        boundary
    }

    /// Whether there is no open boundary.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        !self.faces.contains(&1)
    }

    /// Connected components.
    #[must_use]
    pub fn components(&self) -> Components {
        let mut label = vec![Components::UNREFERENCED; self.vertex_count()];
        let mut vertices: Vec<u32> = Vec::with_capacity(self.vertex_count());
        let mut count = 0;
        for seed in 0..self.vertex_count() {
            if label[seed] != Components::UNREFERENCED || self.neighbours(seed).is_empty() {
                continue;
            }
            let mut done = vertices.len();
            label[seed] = count;
            vertices.push(seed as u32);
            while done < vertices.len() {
                for &w in self.neighbours(vertices[done] as usize) {
                    if label[w as usize] == Components::UNREFERENCED {
                        label[w as usize] = count;
                        vertices.push(w);
                    }
                }
                done += 1;
            }
            count += 1;
        }
        let labelled = label.iter().enumerate().filter(|(_, c)| **c != Components::UNREFERENCED);
        let vertices = Rows::sorted(count as usize, labelled.map(|(v, &c)| (c, v as u32)));
        Components { label, vertices }
    }
}

/// Connected components, numbered by their lowest vertex.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Components {
    label: Vec<u32>,
    vertices: Rows,
}

impl Components {
    /// Label of a vertex that no edge reaches.
    pub const UNREFERENCED: u32 = u32::MAX;

    /// Number of components; unreferenced vertices belong to none.
    #[must_use]
    pub fn count(&self) -> usize {
        self.vertices.len()
    }

    /// Component of every vertex, or [`Self::UNREFERENCED`].
    #[must_use]
    pub fn labels(&self) -> &[u32] {
        &self.label
    }

    /// Vertices of a component, ascending.
    #[must_use]
    pub fn vertices(&self, component: usize) -> &[u32] {
        self.vertices.row(component)
    }

    /// Number of vertices in each component.
    #[must_use]
    pub fn sizes(&self) -> Vec<usize> {
        (0..self.count()).map(|c| self.vertices(c).len()).collect()
    }

    /// Vertices without any edge, ascending.
    #[must_use]
    pub fn unreferenced(&self) -> Vec<u32> {
        (0..self.label.len() as u32).filter(|&v| self.label[v as usize] == Self::UNREFERENCED).collect()
    }
}

/// Which sides and corners of a mesh's triangles lie on its open boundary: tells whether a closest point does.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenBoundary {
    vertices: Vec<bool>,
    /// Per triangle, whether the side opposite each corner is on the boundary.
    sides: Vec<[bool; 3]>,
}

impl OpenBoundary {
    /// Finds the boundary of a mesh.
    ///
    /// # Panics
    /// When a triangle indexes past the vertices.
    #[must_use]
    pub fn of(mesh: &TriangleMesh) -> Self {
        Self::of_edges(&EdgeGraph::of(mesh), &mesh.triangles)
    }

    /// [`of`](Self::of), where the edges of the triangles are known.
    #[must_use]
    pub fn of_edges(graph: &EdgeGraph, triangles: &[[u32; 3]]) -> Self {
        let vertices = graph.boundary_vertices();
        let open = |a: u32, b: u32| {
            let may_be = vertices[a as usize] && vertices[b as usize];
            may_be && graph.find(a, b).is_some_and(|e| graph.faces[e] == 1)
        };
        let sides = triangles.iter().map(|&[a, b, c]| [open(b, c), open(c, a), open(a, b)]).collect();
        Self { vertices, sides }
    }

    /// Whether the point of triangle `index` (with these corners) at `barycentric` lies on the boundary: on an open side,
    /// or at a corner where one ends.
    #[must_use]
    pub fn holds(&self, index: usize, corners: [u32; 3], barycentric: [f64; 3]) -> bool {
        let zero = barycentric.map(|w| w == 0.0);
        let side = (0..3).any(|i| zero[i] && self.sides[index][i]);
        let corner = (0..3).find(|&i| zero[(i + 1) % 3] && zero[(i + 2) % 3]);
        side || corner.is_some_and(|i| self.vertices[corners[i] as usize])
    }

    /// Whether each vertex lies on the boundary.
    #[must_use]
    pub fn vertices(&self) -> &[bool] {
        &self.vertices
    }
}

/// Parts with a smaller share of the vertices are crumbs.
const CRUMBS: f64 = 0.05;

/// The mean of all vertices of the parts that hold `vertices`; of the whole mesh where those are crumbs, as of one in single triangles.
///
/// # Panics
/// When one is no vertex.
#[must_use]
pub fn middle_of_parts(mesh: &TriangleMesh, vertices: impl IntoIterator<Item = u32>) -> Vec3 {
    let parts = EdgeGraph::of(mesh).components();
    let mut held = vec![false; parts.count()];
    for v in vertices {
        if let Some(held) = held.get_mut(parts.labels()[v as usize] as usize) {
            *held = true;
        }
    }
    let of = |which: &dyn Fn(usize) -> bool| -> (usize, Vec3) {
        let vertices = (0..parts.count()).filter(|&c| which(c)).flat_map(|c| parts.vertices(c));
        vertices.fold((0, Vec3::zeros()), |(count, sum), v| (count + 1, sum + mesh.positions[*v as usize]))
    };
    let (all, all_sum) = of(&|_| true);
    let (count, sum) = of(&|c| held[c]);
    if (count as f64) < CRUMBS * all as f64 { all_sum / all.max(1) as f64 } else { sum / count as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 x 2 vertices in two quads cut into triangles, a loose triangle 7-8-9, and vertex 6 in no face.
    fn sheet() -> Vec<[u32; 3]> {
        vec![[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [8, 9, 7]]
    }

    #[test]
    fn neighbours_are_symmetric_sorted_and_complete() {
        let graph = EdgeGraph::from_triangles(10, &sheet());
        assert_eq!(graph.neighbours(1), [0, 2, 4, 5]);
        assert!(graph.neighbours(6).is_empty());
        assert_eq!(graph.edges().len(), 12);
        assert!(graph.edges().is_sorted());
        for (e, &[a, b]) in graph.edges().iter().enumerate() {
            assert!(a < b);
            assert_eq!(graph.find(a, b), Some(e));
            assert_eq!(graph.find(b, a), Some(e));
        }
        assert_eq!(graph.find(0, 5), None);
        // Euler: V - E + F = 1 for a disc
        assert_eq!(6 - 9 + 4, 1);
    }

    #[test]
    fn the_boundary_ignores_duplicate_and_degenerate_triangles() {
        let expected = vec![[0, 1], [0, 3], [1, 2], [2, 5], [3, 4], [4, 5], [7, 8], [7, 9], [8, 9]];
        let mut triangles = sheet();
        assert_eq!(EdgeGraph::from_triangles(10, &triangles).boundary_edges(), expected);
        triangles.push([4, 0, 1]);
        triangles.push([3, 3, 4]);
        let graph = EdgeGraph::from_triangles(10, &triangles);
        assert_eq!(graph.boundary_edges(), expected);
        let on: Vec<usize> = (0..10).filter(|&v| graph.boundary_vertices()[v]).collect();
        assert_eq!(on, [0, 1, 2, 3, 4, 5, 7, 8, 9]);
    }

    #[test]
    fn components_and_unreferenced_vertices() {
        let components = EdgeGraph::from_triangles(10, &sheet()).components();
        assert_eq!(components.sizes(), [6, 3]);
        assert_eq!(components.vertices(1), [7, 8, 9]);
        assert_eq!(components.unreferenced(), [6]);
        assert_eq!(components.labels()[8], 1);
        assert_eq!(EdgeGraph::from_triangles(0, &[]).components().count(), 0);
    }

    #[test]
    fn triangles_round_a_vertex() {
        let rows = vertex_triangles(10, &[[0, 1, 2], [2, 2, 0], [1, 2, 3]]);
        assert_eq!(rows.row(2), [0, 1, 2]);
        assert_eq!(rows.row(0), [0, 1]);
        assert!(rows.row(9).is_empty());
    }

    #[test]
    fn closest_points_on_the_boundary() {
        let mesh = TriangleMesh { positions: vec![Vec3::zeros(); 10], triangles: sheet() };
        let boundary = OpenBoundary::of(&mesh);
        let holds = |t: usize, w| boundary.holds(t, mesh.triangles[t], w);
        assert!(holds(0, [0.5, 0.5, 0.0])); // 0-1 is open
        assert!(!holds(0, [0.5, 0.0, 0.5])); // 0-4 is shared
        assert!(!holds(0, [0.2, 0.3, 0.5]));
        assert!(holds(1, [1.0, 0.0, 0.0]));
        assert!(holds(0, [0.0, 0.0, 1.0])); // vertex 4 ends open sides of other triangles
    }

    #[test]
    fn polygons_have_no_diagonals() {
        let mut mesh = PolygonMesh { positions: vec![Vec3::zeros(); 4], ..PolygonMesh::default() };
        mesh.starts = vec![0, 4];
        mesh.corners = vec![0, 1, 2, 3];
        assert_eq!(EdgeGraph::from_polygons(&mesh).edges().len(), 4);
        assert_eq!(EdgeGraph::of(&mesh.triangulate()).edges().len(), 5);
    }
}
