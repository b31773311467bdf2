//! The template's triangles on the texture: which sample lies on which triangle.

use crate::mesh::PolygonMesh;

/// Copies of a triangle on the repeated texture at most; one that lies over more tiles is left out.
const MOST_TILES: i64 = 64;

/// A triangle on the texture, in samples: columns to the right, rows downwards, both from the upper left corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    /// Index of the triangle in the polygons' fans.
    pub triangle: u32,
    pub corners: [[f64; 2]; 3],
}

/// All triangles that cover something.
#[derive(Debug, Default)]
pub(super) struct Atlas {
    /// In the order of the triangles.
    pub patches: Vec<Patch>,
    /// Polygon of each triangle.
    pub polygon_of: Vec<u32>,
    /// First corner of each triangle's fan in the mesh, and which two follow.
    pub corners: Vec<[u32; 3]>,
    /// Tiles that triangles lie on, sorted.
    pub tiles: Vec<[i64; 2]>,
    /// Polygons with a corner that has no texture coordinate, or that lie over too many tiles.
    pub unplaced: usize,
    /// Triangles without area on the texture.
    pub flat: usize,
}

impl Atlas {
    /// Of a mesh, on a square of `side` samples.
    pub fn new(mesh: &PolygonMesh, side: usize) -> Self {
        let mut atlas = Self::default();
        let metadata = &mesh.metadata;
        let place = |corner: u32| -> Option<[f64; 2]> {
            let uv = *metadata.corner_uvs.get(corner as usize).filter(|uv| **uv != u32::MAX)?;
            let [u, v] = *metadata.uvs.get(uv as usize)?;
            // beyond, half a texel is lost to rounding
            (u.abs() < 1e6 && v.abs() < 1e6).then_some([u, v])
        };
        for f in 0..mesh.polygon_count() {
            let (first, end) = (mesh.starts[f], mesh.starts[f + 1]);
            let mut placed = true;
            for c in first + 1..end.saturating_sub(1) {
                let triangle = atlas.corners.len() as u32;
                let corners = [first, c, c + 1];
                atlas.corners.push(corners);
                atlas.polygon_of.push(f as u32);
                match corners.map(place) {
                    [Some(a), Some(b), Some(c)] => placed &= atlas.place(triangle, [a, b, c], side as f64),
                    _ => placed = false,
                }
            }
            atlas.unplaced += usize::from(!placed);
        }
        atlas.tiles.sort_unstable();
        atlas.tiles.dedup();
        atlas
    }

    /// Puts a triangle on the texture, once for each tile that it lies over.
    fn place(&mut self, triangle: u32, uvs: [[f64; 2]; 3], side: f64) -> bool {
        let area = |[a, b, c]: [[f64; 2]; 3]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area(uvs) == 0.0 {
            self.flat += 1;
            return true;
        }
        let bound = |k: usize, pick: fn(f64, f64) -> f64| uvs.iter().map(|uv| uv[k]).reduce(pick).unwrap_or(0.0);
        // a side on the border of a tile does not reach into the next one
        let low = [0, 1].map(|k| (bound(k, f64::min) + 1e-9).floor() as i64);
        let high = [0, 1].map(|k| ((bound(k, f64::max) - 1e-9).floor() as i64).max(low[k]));
        if (high[0] - low[0] + 1) * (high[1] - low[1] + 1) > MOST_TILES {
            return false;
        }
        let middle = [0, 1].map(|k| (uvs.iter().map(|uv| uv[k]).sum::<f64>() / 3.0).floor() as i64);
        self.tiles.push([middle[1], middle[0]]);
        for v in low[1]..=high[1] {
            for u in low[0]..=high[0] {
                let corners = uvs.map(|uv| [(uv[0] - u as f64) * side, (1.0 - (uv[1] - v as f64)) * side]);
                self.patches.push(Patch { triangle, corners });
            }
        }
        true
    }
}

impl Patch {
    /// First row and the one past the last whose samples may lie on it, within `rows`.
    pub fn rows(&self, rows: std::ops::Range<usize>) -> std::ops::Range<usize> {
        self.range(1, rows)
    }

    fn range(&self, axis: usize, within: std::ops::Range<usize>) -> std::ops::Range<usize> {
        let of = |pick: fn(f64, f64) -> f64| self.corners.iter().map(|c| c[axis]).reduce(pick).unwrap_or(0.0);
        // samples are half a step in
        let first = (of(f64::min) - 0.5).ceil().max(within.start as f64) as usize;
        let end = ((of(f64::max) - 0.5).floor() + 1.0).clamp(0.0, within.end as f64) as usize;
        first..end.max(first)
    }

    /// Calls `found` with column, row and barycentric coordinates of each sample on it within `rows` and `columns`, one texel of
    /// `fine` x `fine` samples after the other.
    pub fn samples(
        &self,
        columns: usize,
        rows: std::ops::Range<usize>,
        fine: usize,
        mut found: impl FnMut(usize, usize, [f64; 3]),
    ) {
        let [a, b, c] = self.corners;
        let double_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let along = |p: [f64; 2], q: [f64; 2]| [(q[0] - p[0]) / double_area, (q[1] - p[1]) / double_area];
        let sides = [(b, along(b, c)), (c, along(c, a)), (a, along(a, b))];
        // a side belongs to both triangles, and the first of them takes its samples
        let beyond = -1e-9;
        let (rows, columns) = (self.range(1, rows), self.range(0, 0..columns));
        let texels = |of: &std::ops::Range<usize>| of.start / fine..of.end.div_ceil(fine);
        let within =
            |of: &std::ops::Range<usize>, texel: usize| (texel * fine).max(of.start)..((texel + 1) * fine).min(of.end);
        for texel_row in texels(&rows) {
            for texel_column in texels(&columns) {
                for row in within(&rows, texel_row) {
                    for column in within(&columns, texel_column) {
                        let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
                        let barycentric = sides.map(|(p, d)| d[0] * (y - p[1]) - d[1] * (x - p[0]));
                        if barycentric.iter().all(|w| *w >= beyond) {
                            found(column, row, barycentric);
                        }
                    }
                }
            }
        }
    }

    /// Samples that it covers, as an area.
    pub fn area(&self) -> f64 {
        let [a, b, c] = self.corners;
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{ObjMetadata, Vec3};

    /// One square with these coordinates.
    fn square(uvs: [[f64; 2]; 4]) -> PolygonMesh {
        PolygonMesh {
            positions: vec![Vec3::zeros(); 4],
            starts: vec![0, 4],
            corners: vec![0, 1, 2, 3],
            metadata: ObjMetadata { uvs: uvs.to_vec(), corner_uvs: vec![0, 1, 2, 3], ..ObjMetadata::default() },
        }
    }

    fn covered(mesh: &PolygonMesh, side: usize) -> Vec<u32> {
        let mut count = vec![0; side * side];
        for patch in Atlas::new(mesh, side).patches {
            patch.samples(side, 0..side, 2, |x, y, _| count[y * side + x] += 1);
        }
        count
    }

    #[test]
    fn a_tile_is_covered_wherever_it_lies_and_its_diagonal_twice() {
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (-3.0, 7.0), (0.3, 0.6)] {
            let mesh = square([[u, v], [u + 1.0, v], [u + 1.0, v + 1.0], [u, v + 1.0]]);
            let count = covered(&mesh, 8);
            assert!(count.iter().all(|c| *c >= 1), "{u} {v}: {count:?}");
            assert!(count.iter().sum::<u32>() <= 64 + 8 + 4, "{u} {v}: {count:?}");
        }
        let atlas = Atlas::new(&square([[1.0, 2.0], [2.0, 2.0], [2.0, 3.0], [1.0, 3.0]]), 8);
        assert_eq!((atlas.tiles, atlas.patches.len()), (vec![[2, 1]], 2));
    }

    #[test]
    fn what_has_no_place_is_counted() {
        let mut mesh = square([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 0.0]]);
        let atlas = Atlas::new(&mesh, 8);
        assert_eq!((atlas.flat, atlas.unplaced, atlas.patches.len()), (2, 0, 0));
        mesh.metadata.corner_uvs[2] = u32::MAX;
        assert_eq!(Atlas::new(&mesh, 8).unplaced, 1);
        assert_eq!(Atlas::new(&square([[0.0, 0.0], [1e5, 0.0], [1e5, 1.0], [0.0, 1.0]]), 8).unplaced, 1);
    }
}
