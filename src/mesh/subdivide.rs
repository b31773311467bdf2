//! Catmull-Clark subdivision (Catmull and Clark 1978): every polygon of `k` corners becomes `k` quads, and the surface smooth.
//!
//! ```text
//! face point    F = mean of the polygon's corners
//! edge point    E = (a + b + F1 + F2) / 4                        within the surface
//!               E = (a + b) / 2                                  on its boundary
//! vertex        v' = (mean F + 2 mean (v + b) / 2 + (n - 3) v) / n     of n edges, within the surface
//!               v' = (a + 6 v + b) / 8                           on its boundary, a and b beside it there
//! ```
//!
//! Edges of three polygons or more count as boundary; a vertex where other than two boundary edges meet keeps its place, and so
//! does one that no polygon refers to. Texture coordinates are divided linearly within each polygon, so that seams stay where they
//! are painted.

use std::collections::HashMap;
use std::ops::{Add, Mul};

use super::{ObjMetadata, PolygonMesh};

/// One round of subdivision of a mesh, for anything that its vertices carry.
///
/// The mesh's vertices come first and keep their order, then one for each edge, then one for each polygon.
#[derive(Debug, Clone)]
pub struct Subdivision {
    /// For each vertex of the mesh the first of those that are one point with it.
    first: Vec<u32>,
    starts: Vec<u32>,
    corners: Vec<u32>,
    edges: Vec<[u32; 2]>,
    /// The edge after each corner.
    edge_of_corner: Vec<u32>,
    rules: Vec<VertexRule>,
    /// The two polygons of an edge within the surface.
    sides: Vec<Option<[u32; 2]>>,
    metadata: ObjMetadata,
}

#[derive(Debug, Clone)]
enum VertexRule {
    Kept,
    Boundary([u32; 2]),
    /// Its edges, and its polygons.
    Within(Vec<u32>, Vec<u32>),
}

impl Subdivision {
    /// How a mesh is divided, of whose vertices some are one point, as those on both sides of a seam are: `first` has the first of them for
    /// each, as [`sewn`](super::sewn) finds it. They stay one, and the edges between them are divided once. `None` when the result has more
    /// vertices than an index can count.
    ///
    /// # Panics
    /// When a polygon indexes past the vertices, or `first` has not one for each.
    #[must_use]
    pub fn new(mesh: &PolygonMesh, first: &[u32]) -> Option<Self> {
        let vertices = mesh.positions.len();
        assert_eq!(first.len(), vertices, "one for each vertex");
        let mut index = HashMap::with_capacity(mesh.corners.len());
        let (mut edges, mut edge_of_corner, mut polygons) = (Vec::new(), Vec::new(), Vec::<Vec<u32>>::new());
        let (mut edges_at, mut polygons_at) = (vec![Vec::new(); vertices], vec![Vec::new(); vertices]);
        for f in 0..mesh.polygon_count() {
            let polygon = mesh.polygon(f);
            for i in 0..polygon.len() {
                let [a, b] = [i, (i + 1) % polygon.len()].map(|i| first[polygon[i] as usize]);
                let e = *index.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    let e = edges.len() as u32;
                    edges.push([a, b]);
                    polygons.push(Vec::new());
                    edges_at[a as usize].push(e);
                    edges_at[b as usize].push(e);
                    e
                });
                polygons[e as usize].push(f as u32);
                polygons_at[a as usize].push(f as u32);
                edge_of_corner.push(e);
            }
        }
        u32::try_from(vertices + edges.len() + mesh.polygon_count()).ok().filter(|n| *n < u32::MAX)?;
        let sides: Vec<_> = polygons.iter().map(|p| <[u32; 2]>::try_from(p.as_slice()).ok()).collect();
        let rule = |(v, (edges_here, polygons_here)): (usize, (Vec<u32>, Vec<u32>))| {
            let boundary: Vec<u32> = edges_here.iter().copied().filter(|e| sides[*e as usize].is_none()).collect();
            let other = |e: u32| edges[e as usize].into_iter().find(|w| *w as usize != v).unwrap_or(v as u32);
            match boundary[..] {
                [] if edges_here.len() > 2 => VertexRule::Within(edges_here, polygons_here),
                [first, second] => VertexRule::Boundary([other(first), other(second)]),
                _ => VertexRule::Kept,
            }
        };
        let rules = edges_at.into_iter().zip(polygons_at).enumerate().map(rule).collect();
        let (starts, corners) = (mesh.starts.clone(), mesh.corners.clone());
        let metadata = divided_metadata(mesh)?;
        Some(Self { first: first.to_vec(), starts, corners, edges, edge_of_corner, rules, sides, metadata })
    }

    /// What [`new`](Self::new) takes to divide the finer mesh.
    #[must_use]
    pub fn first(&self) -> Vec<u32> {
        let count = self.first.len() + self.edges.len() + self.starts.len() - 1;
        self.first.iter().copied().chain(self.first.len() as u32..count as u32).collect()
    }

    /// Values at the finer mesh's vertices, from those at the mesh's.
    ///
    /// # Panics
    /// When there is not one value per vertex.
    #[must_use]
    pub fn apply<T: Copy + Add<Output = T> + Mul<f64, Output = T>>(&self, values: &[T]) -> Vec<T> {
        assert_eq!(values.len(), self.first.len(), "one value per vertex");
        let at = |v: u32| values[v as usize];
        let faces: Vec<T> = self
            .starts
            .windows(2)
            .map(|w| mean(self.corners[w[0] as usize..w[1] as usize].iter().map(|&v| at(v))))
            .collect();
        let middle = |e: u32| mean(self.edges[e as usize].map(at).into_iter());
        let edge = |e: usize| match self.sides[e] {
            Some([f, g]) => (middle(e as u32) + (faces[f as usize] + faces[g as usize]) * 0.5) * 0.5,
            None => middle(e as u32),
        };
        let vertex = |v: u32| match &self.rules[v as usize] {
            VertexRule::Kept => at(v),
            VertexRule::Boundary([a, b]) => (at(*a) + at(*b)) * 0.125 + at(v) * 0.75,
            VertexRule::Within(edges, polygons) => {
                let n = edges.len() as f64;
                let round =
                    mean(polygons.iter().map(|&f| faces[f as usize])) + mean(edges.iter().map(|&e| middle(e))) * 2.0;
                (round + at(v) * (n - 3.0)) * (1.0 / n)
            }
        };
        let vertices = self.first.iter().map(|&v| vertex(v));
        vertices.chain((0..self.edges.len()).map(edge)).chain(faces.iter().copied()).collect()
    }

    /// The finer mesh: quads, in the order of the polygons and their corners, with groups and materials of theirs.
    ///
    /// # Panics
    /// When there is not one position per vertex of the mesh.
    #[must_use]
    pub fn mesh(&self, positions: &[super::Vec3]) -> PolygonMesh {
        let first_edge = self.first.len() as u32;
        let first_face = first_edge + self.edges.len() as u32;
        let mut corners = Vec::with_capacity(4 * self.corners.len());
        for (f, w) in self.starts.windows(2).enumerate() {
            for (c, before) in ring(w[0], w[1]) {
                let edges = [c, before].map(|c| first_edge + self.edge_of_corner[c]);
                corners.extend([self.corners[c], edges[0], first_face + f as u32, edges[1]]);
            }
        }
        PolygonMesh {
            positions: self.apply(positions),
            starts: (0..=self.corners.len() as u32).map(|q| 4 * q).collect(),
            corners,
            metadata: self.metadata.clone(),
        }
    }
}

/// Each corner of a polygon with the one before it.
fn ring(start: u32, end: u32) -> impl Iterator<Item = (usize, usize)> {
    (start..end).map(move |c| (c as usize, if c == start { end - 1 } else { c - 1 } as usize))
}

fn mean<T: Copy + Add<Output = T> + Mul<f64, Output = T>>(mut values: impl ExactSizeIterator<Item = T>) -> T {
    let share = 1.0 / values.len() as f64;
    let first = values.next().expect("a polygon has corners and an edge has ends");
    values.fold(first, |sum, v| sum + v) * share
}

/// Texture coordinates of the quads; statements before the first quad of their polygon.
fn divided_metadata(mesh: &PolygonMesh) -> Option<ObjMetadata> {
    const NONE: u32 = u32::MAX;
    let old = &mesh.metadata;
    let statements = old.statements.iter().map(|(f, s)| (mesh.starts[*f as usize], s.clone())).collect();
    let (mut uvs, mut corner_uvs) = (old.uvs.clone(), Vec::new());
    let mut middles = HashMap::new();
    for w in mesh.starts.windows(2).filter(|_| !old.corner_uvs.is_empty()) {
        let of_polygon = &old.corner_uvs[w[0] as usize..w[1] as usize];
        if of_polygon.contains(&NONE) {
            corner_uvs.extend(std::iter::repeat_n(NONE, 4 * of_polygon.len()));
            continue;
        }
        let centre = uvs.len() as u32;
        let share = 1.0 / of_polygon.len() as f64;
        uvs.push([0, 1].map(|axis| of_polygon.iter().map(|&t| old.uvs[t as usize][axis]).sum::<f64>() * share));
        let mut middle = |a: u32, b: u32| {
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                uvs.push([0, 1].map(|axis| 0.5 * (old.uvs[a as usize][axis] + old.uvs[b as usize][axis])));
                uvs.len() as u32 - 1
            })
        };
        let k = of_polygon.len();
        for (i, &t) in of_polygon.iter().enumerate() {
            let (next, before) = (of_polygon[(i + 1) % k], of_polygon[(i + k - 1) % k]);
            let quad = [t, middle(t, next), centre, middle(before, t)];
            corner_uvs.extend(quad);
        }
    }
    u32::try_from(uvs.len()).ok()?;
    let corner_normals = Vec::new(); // the limit surface has no hard edges
    Some(ObjMetadata {
        uvs,
        corner_uvs,
        corner_normals,
        material_libraries: old.material_libraries.clone(),
        statements,
    })
}

#[cfg(test)]
mod tests {
    use super::super::Vec3;
    use super::*;

    fn cube() -> PolygonMesh {
        let positions =
            (0..8u32).map(|i| Vec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        PolygonMesh {
            positions,
            starts: (0..=6).map(|f| 4 * f).collect(),
            corners: quads.concat(),
            ..PolygonMesh::default()
        }
    }

    /// `n` by `n` quads in the plane.
    fn sheet(n: u32) -> PolygonMesh {
        let positions = (0..(n + 1) * (n + 1)).map(|i| Vec3::new(f64::from(i % (n + 1)), f64::from(i / (n + 1)), 0.0));
        let quads = (0..n * n).map(|q| q / n * (n + 1) + q % n).flat_map(|v| [v, v + 1, v + n + 2, v + n + 1]);
        PolygonMesh {
            positions: positions.collect(),
            starts: (0..=n * n).map(|f| 4 * f).collect(),
            corners: quads.collect(),
            ..PolygonMesh::default()
        }
    }

    /// Each vertex a point of its own.
    fn own(mesh: &PolygonMesh) -> Vec<u32> {
        (0..mesh.positions.len() as u32).collect()
    }

    fn divided(mesh: &PolygonMesh) -> PolygonMesh {
        Subdivision::new(mesh, &own(mesh)).unwrap().mesh(&mesh.positions)
    }

    #[test]
    fn a_cube_that_was_cut_is_divided_as_the_whole_one() {
        let whole = cube();
        let corners = (0..whole.corners.len() as u32).collect();
        let positions = whole.corners.iter().map(|&v| whole.positions[v as usize]).collect();
        let mut cut = PolygonMesh { positions, corners, ..whole.clone() };
        let first_of = |v: u32| whole.corners.iter().position(|w| *w == v).unwrap() as u32;
        let mut first: Vec<u32> = whole.corners.iter().map(|&v| first_of(v)).collect();
        let mut fine = whole;
        for _ in 0..2 {
            let division = Subdivision::new(&cut, &first).unwrap();
            (cut, first) = (division.mesh(&cut.positions), division.first());
            fine = divided(&fine);
            let at = |mesh: &PolygonMesh| mesh.corners.iter().map(|&v| mesh.positions[v as usize]).collect::<Vec<_>>();
            let farthest = at(&cut).iter().zip(at(&fine)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(farthest < 1e-14, "{farthest}");
            assert!(first.iter().enumerate().all(|(v, &f)| cut.positions[v] == cut.positions[f as usize]));
        }
    }

    #[test]
    fn a_cube_has_the_points_of_catmull_and_clark() {
        let fine = {
            let cube = cube();
            divided(&cube)
        };
        assert_eq!((fine.positions.len(), fine.polygon_count()), (8 + 12 + 6, 24));
        // F = 1/2 off, E = (0 + 0 + 1/4 + 1/4)..., by hand: v' = (F + 2 R + 0 v) / 3 with F = 1/3, R = 1/6 each coordinate.
        let corner = (1.0 / 3.0 + 2.0 / 6.0) / 3.0;
        assert!((fine.positions[0] - Vec3::repeat(corner)).norm() < 1e-15, "{}", fine.positions[0]);
        // Of the edge from 0 to x: (a + b + F1 + F2) / 4.
        let edges: Vec<_> = fine.positions[8..20].iter().filter(|p| p.x == 0.5 && p.y < 0.5 && p.z < 0.5).collect();
        assert_eq!(edges, [&Vec3::new(0.5, 0.125, 0.125)]);
        // Every edge is in two quads, once in each direction.
        let mut directed = std::collections::HashSet::new();
        for f in 0..fine.polygon_count() {
            let q = fine.polygon(f);
            (0..4).for_each(|i| assert!(directed.insert((q[i], q[(i + 1) % 4]))));
        }
        assert!(directed.iter().all(|(a, b)| directed.contains(&(*b, *a))));
    }

    #[test]
    fn a_plane_stays_one_and_what_is_linear_on_it_stays_linear() {
        let plane = sheet(4);
        let division = Subdivision::new(&plane, &own(&plane)).unwrap();
        let fine = division.mesh(&plane.positions);
        assert_eq!(fine.positions.len(), 81);
        let height = |p: &Vec3| 1.0 + 2.0 * p.x - 3.0 * p.y;
        let heights = division.apply(&plane.positions.iter().map(height).collect::<Vec<_>>());
        for (p, h) in fine.positions.iter().zip(heights) {
            assert!(p.z == 0.0 && (height(p) - h).abs() < 1e-12);
        }
        // The boundary is a curve of its own: its points are where those of a line of vertices would be.
        assert_eq!(fine.positions[2], plane.positions[2]);
        assert!((fine.positions[0] - Vec3::new(0.125, 0.125, 0.0)).norm() < 1e-15);
    }

    #[test]
    fn a_sphere_gets_round() {
        let mut mesh = cube();
        for _ in 0..4 {
            mesh = divided(&mesh);
        }
        let centre = Vec3::repeat(0.5);
        let radii: Vec<f64> = mesh.positions.iter().map(|p| (p - centre).norm()).collect();
        let (low, high) = radii.iter().fold((f64::MAX, 0.0_f64), |(l, h), r| (l.min(*r), h.max(*r)));
        assert!(high / low < 1.12 && low > 0.4, "{low} {high}");
    }

    #[test]
    fn seams_groups_and_faces_without_texture_stay() {
        let mut mesh = sheet(2);
        mesh.metadata.uvs =
            (0..9).map(|i| [f64::from(i % 3) / 2.0, f64::from(i / 3) / 2.0]).chain([[9.0, 9.0]]).collect();
        mesh.metadata.corner_uvs = mesh.corners.clone();
        mesh.metadata.corner_uvs[4] = 9; // a seam between the first and the second quad
        mesh.metadata.corner_uvs[12..].fill(u32::MAX);
        mesh.metadata.statements = vec![(1, super::super::ObjStatement::Group("right".into()))];
        let fine = divided(&mesh);
        assert_eq!(fine.metadata.statements[0].0, 4);
        assert_eq!(fine.metadata.corner_uvs.len(), fine.corners.len());
        let uv = |c: usize| fine.metadata.uvs[fine.metadata.corner_uvs[c] as usize];
        assert_eq!([uv(0), uv(1), uv(2), uv(3)], [[0.0, 0.0], [0.25, 0.0], [0.25, 0.25], [0.0, 0.25]]);
        assert_eq!((uv(16), uv(17)), ([9.0, 9.0], [5.0, 4.5]));
        assert!(fine.metadata.corner_uvs[48..].iter().all(|t| *t == u32::MAX));
    }

    #[test]
    fn awkward_meshes_are_divided_too() {
        // Three triangles at one edge, a vertex of none, a polygon that uses a vertex twice.
        let fin = PolygonMesh {
            positions: (0..7).map(|i| Vec3::new(f64::from(i), f64::from(i * i), 1.0)).collect(),
            starts: vec![0, 3, 6, 9, 12],
            corners: vec![0, 1, 2, 1, 0, 3, 0, 1, 4, 2, 2, 4],
            ..PolygonMesh::default()
        };
        let fine = divided(&fin);
        assert!(fine.positions.iter().all(|p| p.iter().all(|x| x.is_finite())));
        assert_eq!(fine.positions[5..7], fin.positions[5..7]);
        assert!(fine.corners.iter().all(|&v| (v as usize) < fine.positions.len()));
        assert_eq!(divided(&PolygonMesh { starts: vec![0], ..PolygonMesh::default() }).polygon_count(), 0);
    }
}
