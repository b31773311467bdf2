//! A lattice of uniform quadratic B-splines round a surface.
//!
//! Only cells that the surface goes through have control points, and a place of the lattice has one for each connected part of the
//! surface near it: upper and lower lip touch without being joined.

use std::collections::BTreeMap;

use super::adjacency::EdgeGraph;
use super::closest_point::ClosestVertices;
use super::{MeshError, TriangleMesh, Vec3, bounding_box, referenced};

/// Control points along an axis of a cell.
pub const ACROSS: usize = 3;

/// Control points of a cell.
pub const POINTS: usize = ACROSS * ACROSS * ACROSS;

/// Points at which triangles look for their cells, at most; more would seem to hang.
const MOST_PROBES: f64 = 2e7;

/// Which control points move which vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceLattice {
    /// Number of control points.
    count: usize,
    /// Those of each patch, place by place.
    patches: Vec<[u32; POINTS]>,
    /// Patch of each vertex.
    patch: Vec<u32>,
    /// Weight of each control point of the patch.
    weights: Vec<[f64; POINTS]>,
}

type Cell = [u32; 3];

/// Number of a control point within the 3 x 3 x 3 of a cell.
fn place([i, j, k]: [usize; 3]) -> usize {
    (i * ACROSS + j) * ACROSS + k
}

/// All places of a cell, by number.
pub fn places() -> impl Iterator<Item = [usize; 3]> {
    (0..POINTS).map(|n| [n / 9, n / 3 % 3, n % 3])
}

/// The three uniform quadratic B-splines that meet in a cell, at `t` in [0, 1].
fn splines(t: f64) -> [f64; ACROSS] {
    [(1.0 - t) * (1.0 - t), 1.0 + 2.0 * t * (1.0 - t), t * t].map(|b| b / 2.0)
}

/// Runs of pairs that are alike in the first, after sorting.
fn grouped<K: Ord + Copy, V: Ord + Copy>(pairs: &mut Vec<(K, V)>) -> impl Iterator<Item = &[(K, V)]> {
    pairs.sort_unstable();
    pairs.dedup();
    pairs.chunk_by(|a, b| a.0 == b.0)
}

impl SurfaceLattice {
    /// The lattice of cells `spacing` wide round `mesh`, at rest along the axes. A vertex that no triangle has moves as the nearest
    /// that has one.
    ///
    /// # Errors
    /// When a position is not finite, a triangle indexes past the vertices, there are no triangles, or the surface would go through
    /// tens of millions of cells.
    ///
    /// # Panics
    /// If the spacing is not positive.
    pub fn new(mesh: &TriangleMesh, spacing: f64) -> Result<Self, MeshError> {
        assert!(spacing > 0.0, "the spacing must be positive");
        mesh.check()?;
        let p = &mesh.positions;
        if mesh.triangles.is_empty() {
            return Err(MeshError::NoArea);
        }
        let used = referenced(p.len(), mesh.triangles.as_flattened().iter().copied());
        let on: Vec<u32> = (0..p.len() as u32).filter(|v| used[*v as usize]).collect();
        let on_places: Vec<Vec3> = on.iter().map(|v| p[*v as usize]).collect();
        let (low, high) = bounding_box(&on_places).unwrap_or_default();
        // Cells per side are counted in u32, probes are worked through.
        let per_side = |t: &[u32; 3]| {
            let side = |a: usize| (p[t[a] as usize] - p[t[(a + 1) % 3] as usize]).norm();
            (2.0 * side(0).max(side(1)).max(side(2)) / spacing).ceil().max(1.0)
        };
        let probes: f64 = mesh.triangles.iter().map(|t| per_side(t) * per_side(t)).sum();
        if probes.max((high - low).max() / spacing) > MOST_PROBES {
            return Err(MeshError::TooManyCells { spacing });
        }
        let cell = |p: Vec3| -> Cell { std::array::from_fn(|a| ((p[a] - low[a]) / spacing).max(0.0) as u32) };

        let mut cells: Vec<(Cell, u32)> = Vec::new();
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| p[v as usize]);
            let n = per_side(corners) as usize;
            for (i, j) in (0..=n).flat_map(|i| (0..=n - i).map(move |j| (i, j))) {
                let at = a + (b - a) * (i as f64 / n as f64) + (c - a) * (j as f64 / n as f64);
                cells.push((cell(at), t as u32));
            }
            // The corners to the last bit, as their weights are found by them.
            cells.extend([a, b, c].map(|p| (cell(p), t as u32)));
        }

        // A patch: triangles in a cell that hang together there.
        let mut patch_cells: Vec<Cell> = Vec::new();
        let mut patches_at: Vec<(u32, u32)> = Vec::new();
        for in_cell in grouped(&mut cells) {
            let corners: Vec<[u32; 3]> = in_cell.iter().map(|c| mesh.triangles[c.1 as usize]).collect();
            for vertices in hanging_together(&corners) {
                patches_at.extend(vertices.iter().map(|&v| (v, patch_cells.len() as u32)));
                patch_cells.push(in_cell[0].0);
            }
        }
        let mut neighbours: Vec<[u32; 2]> = Vec::new();
        for at in grouped(&mut patches_at) {
            for (k, &(_, patch)) in at.iter().enumerate() {
                neighbours.extend(at[..k].iter().map(|other| [patch, other.1]));
            }
        }
        let neighbours = EdgeGraph::from_pairs(patch_cells.len(), &neighbours);

        // A control point: patches that it moves and that hang together.
        let mut around: Vec<([u32; 3], (u32, u32))> = Vec::new();
        for (patch, cell) in patch_cells.iter().enumerate() {
            let of_place = |k: [usize; 3]| ([0, 1, 2].map(|a| cell[a] + k[a] as u32), (patch as u32, place(k) as u32));
            around.extend(places().map(of_place));
        }
        let mut patches = vec![[0; POINTS]; patch_cells.len()];
        let mut count = 0;
        for moved in grouped(&mut around) {
            let mut left: BTreeMap<u32, u32> = moved.iter().map(|m| m.1).collect();
            while let Some((patch, at)) = left.pop_first() {
                let mut part = vec![(patch, at)];
                while let Some((patch, at)) = part.pop() {
                    patches[patch as usize][at as usize] = count;
                    let next = neighbours.neighbours(patch as usize).iter();
                    part.extend(next.filter_map(|n| left.remove_entry(n)));
                }
                count += 1;
            }
        }

        // Vertices that no triangle has move as the nearest that one has.
        let nearest = ClosestVertices::new(&on_places)?;
        let stand_in =
            |v: usize| if used[v] { Some(v as u32) } else { Some(on[nearest.query(&p[v])?.vertex as usize]) };
        let stand_ins: Vec<u32> = (0..p.len()).map(|v| stand_in(v).unwrap_or(v as u32)).collect();
        let patch_of = |&v: &u32| {
            let own = cell(p[v as usize]);
            let first = patches_at.partition_point(|at| at.0 < v);
            let found = patches_at[first..].iter().find(|at| patch_cells[at.1 as usize] == own);
            found.expect("proven: a vertex' cell holds a patch with its triangles").1
        };
        let weights_of = |&v: &u32| {
            let own = cell(p[v as usize]);
            let [x, y, z] = [0, 1, 2].map(|a| splines((p[v as usize][a] - low[a]) / spacing - f64::from(own[a])));
            let mut weights = [0.0; POINTS];
            places().for_each(|k| weights[place(k)] = x[k[0]] * y[k[1]] * z[k[2]]);
            weights
        };
        let (patch, weights) = (stand_ins.iter().map(patch_of).collect(), stand_ins.iter().map(weights_of).collect());
        Ok(Self { count: count as usize, patches, patch, weights })
    }

    /// Number of control points.
    #[must_use]
    pub fn control_points(&self) -> usize {
        self.count
    }

    /// Control points of every cell with a connected part of the surface, in the order of [`places`].
    #[must_use]
    pub fn patches(&self) -> &[[u32; POINTS]] {
        &self.patches
    }

    /// The second differences `d_far - d_p - d_q + d_near` of all neighbouring control points, each once, and whether they are along
    /// one axis (`p = q`).
    #[must_use]
    pub fn second_differences(&self) -> Vec<([u32; 4], bool)> {
        let step = |k: [usize; 3], axes: &[usize]| {
            let mut k = k;
            axes.iter().for_each(|&a| k[a] += 1);
            k.iter().all(|&i| i < ACROSS).then(|| place(k))
        };
        let mut found: Vec<([u32; 4], bool)> = Vec::new();
        for patch in &self.patches {
            let points = |at: [usize; 4]| at.map(|n| patch[n]);
            for (k, a, b) in places().flat_map(|k| (0..9).map(move |ab| (k, ab / 3, ab % 3))).filter(|c| c.1 <= c.2) {
                if let (Some(far), Some(p), Some(q)) = (step(k, &[a, b]), step(k, &[a]), step(k, &[b])) {
                    found.push((points([far, p, q, place(k)]), a == b));
                }
            }
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The control points that move a vertex, and their weights, which sum to 1.
    pub fn of(&self, vertex: u32) -> impl Iterator<Item = (u32, f64)> + '_ {
        let points = self.patches[self.patch[vertex as usize] as usize];
        points.into_iter().zip(self.weights[vertex as usize])
    }
}

/// The vertices of each set of triangles that hang together by vertices; from the corners of all triangles.
fn hanging_together(corners: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut vertices = corners.as_flattened().to_vec();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.partition_point(|w| *w < v) as u32;
    let sides = |&[a, b, c]: &[u32; 3]| [[local(a), local(b)], [local(b), local(c)]];
    let parts = EdgeGraph::from_pairs(vertices.len(), &corners.iter().flat_map(sides).collect::<Vec<_>>()).components();
    let named = |part: &[u32]| part.iter().map(|&v| vertices[v as usize]).collect();
    // A triangle that is one vertex thrice has no sides.
    let alone = parts.unreferenced();
    let alone = alone.chunks(1);
    (0..parts.count()).map(|part| parts.vertices(part)).chain(alone).map(named).collect()
}
