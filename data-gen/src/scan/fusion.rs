//! Many depth images made one mesh: a truncated signed distance, averaged over the views on a grid of blocks where there is something
//! (Curless and Levoy 1996), and its zero as a net of one vertex a cell ("surface nets", Gibson 1998).

use std::collections::{BTreeSet, HashMap};

use nonrigid::mesh::{TriangleMesh, Vec3};
use rayon::prelude::*;

use super::depth::DepthImage;

/// Voxels along a block's side.
const SIDE: i32 = 8;
/// How far behind the surface a view has a say, in voxels.
const TRUNCATION: f64 = 4.0;
/// The surface passes between two voxels only where both are at most as far from it: what jumps from far before to far behind is
/// the border of what was seen.
const NEAR: f32 = 2.0;

type Cell = [i32; 3];

/// Signed distances in voxels, positive before the surface; `NAN` where no view has a say.
struct Grid {
    voxel: f64,
    keys: Vec<Cell>,
    number: HashMap<Cell, usize>,
    blocks: Vec<Vec<f32>>,
}

/// The surface that all images see, in triangles about as large as a voxel.
pub(super) fn fuse(images: &[DepthImage], voxel: f64) -> TriangleMesh {
    let grid = Grid::new(images, voxel);
    let vertices: Vec<(Cell, Vec3)> = grid.keys.par_iter().flat_map_iter(|key| grid.cells(*key)).collect();
    let number: HashMap<Cell, u32> = vertices.iter().zip(0..).map(|((cell, _), k)| (*cell, k)).collect();
    let triangles = grid.keys.par_iter().flat_map_iter(|key| grid.quads(*key, &number)).flatten().collect();
    TriangleMesh { positions: vertices.into_iter().map(|(_, p)| p).collect(), triangles }
}

fn plus(cell: Cell, axis: usize, step: i32) -> Cell {
    let mut cell = cell;
    cell[axis] += step;
    cell
}

/// The voxels of a block, x first.
fn voxels(key: Cell) -> impl Iterator<Item = Cell> {
    (0..SIDE * SIDE * SIDE).map(move |i| {
        let inside = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
        std::array::from_fn(|k| key[k] * SIDE + inside[k])
    })
}

impl Grid {
    fn new(images: &[DepthImage], voxel: f64) -> Self {
        let reach = TRUNCATION * voxel;
        let block = f64::from(SIDE) * voxel;
        let near = |image: &DepthImage| -> BTreeSet<Cell> {
            let mut found = BTreeSet::new();
            for p in image.points() {
                let [low, high] = [-reach, reach].map(|by| p.map(|x| ((x + by) / block).floor() as i32));
                for z in low.z..=high.z {
                    for y in low.y..=high.y {
                        found.extend((low.x..=high.x).map(|x| [x, y, z]));
                    }
                }
            }
            found
        };
        let keys: BTreeSet<Cell> = images.par_iter().map(near).reduce(BTreeSet::new, |mut a, b| {
            a.extend(b);
            a
        });
        let keys: Vec<Cell> = keys.into_iter().collect();
        let value = |cell: Cell| {
            let p = Vec3::from_fn(|k, _| f64::from(cell[k])) * voxel;
            let (mut sum, mut weight) = (0.0, 0.0);
            for (distance, cosine) in images.iter().filter_map(|image| image.before(&p)) {
                if distance > -reach {
                    sum += cosine * cosine * distance.min(reach);
                    weight += cosine * cosine;
                }
            }
            if weight > 0.0 { (sum / weight / voxel) as f32 } else { f32::NAN }
        };
        let blocks = keys.par_iter().map(|key| voxels(*key).map(value).collect()).collect();
        let number = keys.iter().copied().zip(0..).collect();
        Self { voxel, keys, number, blocks }
    }

    fn at(&self, cell: Cell) -> f32 {
        let Some(block) = self.number.get(&cell.map(|x| x.div_euclid(SIDE))) else { return f32::NAN };
        let [x, y, z] = cell.map(|x| x.rem_euclid(SIDE));
        self.blocks[*block][(x + SIDE * (y + SIDE * z)) as usize]
    }

    /// Where between two voxels the surface passes: the share of the way from the first.
    fn crossing(a: f32, b: f32) -> Option<f32> {
        // A comparison with what is not a number is false.
        ((a < 0.0) != (b < 0.0) && a.abs() <= NEAR && b.abs() <= NEAR).then(|| a / (a - b))
    }

    /// A vertex for each cell of a block that the surface passes: the mean of where it meets the cell's edges.
    fn cells(&self, key: Cell) -> impl Iterator<Item = (Cell, Vec3)> {
        voxels(key).filter_map(|cell| {
            let corner = |k: usize| -> Cell { std::array::from_fn(|axis| cell[axis] + (k >> axis & 1) as i32) };
            let values: [f32; 8] = std::array::from_fn(|k| self.at(corner(k)));
            let (mut sum, mut count) = (Vec3::zeros(), 0.0);
            for axis in 0..3 {
                for k in (0..8).filter(|k| k >> axis & 1 == 0) {
                    if let Some(share) = Self::crossing(values[k], values[k | 1 << axis]) {
                        let mut p = Vec3::from_fn(|a, _| f64::from(corner(k)[a]));
                        p[axis] += f64::from(share);
                        sum += p;
                        count += 1.0;
                    }
                }
            }
            (count > 0.0).then(|| (cell, sum * (self.voxel / count)))
        })
    }

    /// Two triangles for each edge between voxels of a block that the surface passes, of the vertices of the four cells about it.
    fn quads<'a>(&'a self, key: Cell, number: &'a HashMap<Cell, u32>) -> impl Iterator<Item = [[u32; 3]; 2]> + 'a {
        voxels(key).flat_map(move |cell| {
            (0..3).filter_map(move |axis| {
                let (a, b) = (self.at(cell), self.at(plus(cell, axis, 1)));
                Self::crossing(a, b)?;
                let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
                let round = [plus(plus(cell, u, -1), v, -1), plus(cell, v, -1), cell, plus(cell, u, -1)];
                let [p, q, r, s] = round.map(|cell| number.get(&cell).copied());
                let quad = [p?, q?, r?, s?];
                // Outwards is where distances grow.
                let [p, q, r, s] = if a < b { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
                Some([[p, q, r], [p, r, s]])
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::view::Occluder;
    use super::*;

    #[test]
    fn a_ball_seen_from_all_sides_comes_out_as_one() {
        let (radius, n) = (30.0, 200u32);
        let place = |i: u32, j: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i % n) / f64::from(n)).sin_cos();
            let (up, level) = (std::f64::consts::PI * (f64::from(j) / f64::from(n) - 0.5)).sin_cos();
            Vec3::new(cos * level, up, -sin * level) * radius
        };
        let positions: Vec<Vec3> = (0..=n).flat_map(|j| (0..n).map(move |i| place(i, j))).collect();
        let quad = |i: u32, j: u32| [j * n + i, j * n + (i + 1) % n, (j + 1) * n + (i + 1) % n, (j + 1) * n + i];
        let all = (0..n).flat_map(|j| (0..n).map(move |i| quad(i, j)));
        let triangles: Vec<[u32; 3]> = all.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let surface = Occluder { positions: &positions, triangles: &triangles, skin_points: positions.len() };
        let eyes = (0..12).map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k % 6) / 6.0).sin_cos();
            Vec3::new(cos, if k < 6 { 0.7 } else { -0.7 }, sin).normalize() * 600.0
        });
        let images: Vec<DepthImage> = eyes.filter_map(|eye| DepthImage::new(eye, surface, 0.5, 70.0)).collect();
        let mesh = fuse(&images, 1.0);
        let area: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
                let cross = (b - a).cross(&(c - a));
                assert!(cross.dot(&a) > 0.0, "outwards");
                0.5 * cross.norm()
            })
            .sum();
        let ball = 4.0 * std::f64::consts::PI * radius * radius;
        assert!((area / ball - 1.0).abs() < 0.02, "{area} {ball}");
        let worst = mesh.positions.iter().map(|p| (p.norm() - radius).abs()).fold(0.0, f64::max);
        assert!(worst < 0.3, "{worst}");
        let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                *edges.entry([a.min(b), a.max(b)]).or_default() += 1;
            }
        }
        let open = edges.values().filter(|n| **n == 1).count();
        assert_eq!(open, 0, "closed, of {} edges", edges.len());
    }
}
