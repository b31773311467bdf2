//! What the cameras see: depth buffers of the surface, and the angle of view.

use nonrigid::mesh::Vec3;
use rayon::prelude::*;

/// Cell of a depth buffer at the surface's distance, millimetres, and the largest number of cells along a side.
const CELL: f64 = 0.25;
const MOST: f64 = 2048.0;
/// By how much a point may lie behind the buffer's surface, which is a mesh, and still be on it, millimetres.
const TOLERANCE: f64 = 0.15;
/// The same for an eyeball behind the skin: lids lie close.
const UNDER_LIDS: f64 = 0.05;

/// The nearest of two layers of triangles in every direction from a camera.
pub(super) struct DepthMap {
    eye: Vec3,
    right: Vec3,
    up: Vec3,
    back: Vec3,
    /// Lowest plane coordinates, cells per unit.
    low: [f64; 2],
    scale: f64,
    size: [usize; 2],
    layers: [Vec<f32>; 2],
    /// Side of a cell at the surface, millimetres.
    cell: f64,
}

/// What the two layers of a [`DepthMap`] are.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Layers {
    SkinAndEyeballs,
    FrontAndBack,
}

/// What hides: triangles, the skin's points first, then the eyeballs'.
#[derive(Clone, Copy)]
pub(super) struct Occluder<'a> {
    pub positions: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    pub skin_points: usize,
}

/// All cameras' depth maps.
pub(super) struct View {
    maps: Vec<DepthMap>,
    least_cosine: f64,
}

impl View {
    /// Of a surface seen from `eyes`, at most `grazing` degrees off its normals.
    pub fn new(eyes: &[Vec3], surface: Occluder, grazing: f64) -> Self {
        let maps =
            eyes.par_iter().filter_map(|eye| DepthMap::new(*eye, surface, CELL, Layers::SkinAndEyeballs)).collect();
        Self { maps, least_cosine: grazing.to_radians().cos() }
    }

    /// Of each point, the cosine of the angle between normal and view ray of the camera that sees it most squarely, and
    /// the direction to that camera. Points from `skin_points` on are the eyeballs'. Without cameras everything is seen
    /// squarely.
    pub fn seen(&self, points: &[Vec3], normals: &[Vec3], skin_points: usize) -> Vec<Option<(f64, Vec3)>> {
        let one = |(i, (p, normal)): (usize, (&Vec3, &Vec3))| {
            if self.maps.is_empty() {
                return Some((1.0, *normal));
            }
            let seen = self.maps.iter().filter_map(|map| {
                let ray = (map.eye - p).normalize();
                let cosine = normal.dot(&ray);
                let visible = cosine > self.least_cosine && map.reaches(p, cosine, i >= skin_points);
                visible.then_some((cosine, ray))
            });
            seen.reduce(|a, b| if b.0 > a.0 { b } else { a })
        };
        points.par_iter().zip(normals).enumerate().map(one).collect()
    }
}

impl DepthMap {
    /// With cells of `cell` millimetres at the surface's distance. `None` where the camera has nothing before it.
    pub fn new(eye: Vec3, surface: Occluder, cell: f64, layers: Layers) -> Option<Self> {
        let points = surface.positions;
        let centre = points.iter().sum::<Vec3>() / points.len().max(1) as f64;
        let back = (eye - centre).try_normalize(1e-9)?;
        let right = Vec3::y().cross(&back).try_normalize(1e-9).unwrap_or_else(Vec3::x);
        let up = back.cross(&right);
        let mut map = Self {
            eye,
            right,
            up,
            back,
            low: [0.0; 2],
            scale: 1.0,
            size: [0; 2],
            layers: [Vec::new(), Vec::new()],
            cell,
        };
        let plane: Vec<[f64; 3]> = points.iter().map(|p| map.plane(p)).collect();
        let before: Vec<&[f64; 3]> = plane.iter().filter(|p| p[2] > 1.0).collect();
        let bound = |k: usize, pick: fn(f64, f64) -> f64| before.iter().map(|p| p[k]).reduce(pick);
        let (low, high) = ([bound(0, f64::min)?, bound(1, f64::min)?], [bound(0, f64::max)?, bound(1, f64::max)?]);
        let distance = (eye - centre).norm();
        let extent = (high[0] - low[0]).max(high[1] - low[1]).max(1e-9);
        map.scale = (distance / cell).min(MOST / extent);
        map.cell = distance / map.scale;
        map.low = low;
        map.size = [0, 1].map(|k| ((high[k] - low[k]) * map.scale) as usize + 2);
        map.layers = std::array::from_fn(|_| vec![f32::INFINITY; map.size[0] * map.size[1]]);
        for t in surface.triangles {
            let corners = t.map(|v| plane[v as usize]);
            if corners.iter().all(|c| c[2] > 1.0) {
                let eyeball = t[0] as usize >= surface.skin_points;
                map.draw(corners, |back| usize::from(if layers == Layers::FrontAndBack { back } else { eyeball }));
            }
        }
        Some(map)
    }

    pub fn eye(&self) -> Vec3 {
        self.eye
    }

    /// Side of a cell at the surface, millimetres.
    pub fn pitch(&self) -> f64 {
        self.cell
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Depth of the first layer in each cell, row by row; infinite where there is none, or the second is before it.
    pub fn nearest(&self) -> impl Iterator<Item = f64> + '_ {
        self.layers[0].iter().zip(&self.layers[1]).map(|(a, b)| if a <= b { f64::from(*a) } else { f64::INFINITY })
    }

    /// Column, row and depth of a point, columns and rows as fractions.
    pub fn pixel(&self, p: &Vec3) -> [f64; 3] {
        let [x, y, depth] = self.plane(p);
        [self.cell(0, x), self.cell(1, y), depth]
    }

    /// The point of a cell's ray at this depth.
    pub fn point(&self, cell: usize, depth: f64) -> Vec3 {
        self.eye + self.ray(cell) * depth
    }

    /// Length along a cell's ray for one of depth.
    pub fn stretch(&self, cell: usize) -> f64 {
        self.ray(cell).norm()
    }

    fn ray(&self, cell: usize) -> Vec3 {
        let [x, y] = [cell % self.size[0], cell / self.size[0]].map(|k| k as f64 / self.scale);
        self.right * (x + self.low[0]) + self.up * (y + self.low[1]) - self.back
    }

    /// Coordinates in the image plane at unit distance, and depth.
    fn plane(&self, p: &Vec3) -> [f64; 3] {
        let d = p - self.eye;
        let depth = -d.dot(&self.back);
        [d.dot(&self.right) / depth, d.dot(&self.up) / depth, depth]
    }

    fn cell(&self, axis: usize, x: f64) -> f64 {
        (x - self.low[axis]) * self.scale
    }

    /// `layer` is told whether the triangle shows its back.
    fn draw(&mut self, corners: [[f64; 3]; 3], layer: impl Fn(bool) -> usize) {
        let [a, b, c] = corners.map(|p| [self.cell(0, p[0]), self.cell(1, p[1]), p[2]]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-12 {
            return;
        }
        let layer = layer(area < 0.0);
        let span = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).ceil().max(0.0) as usize;
            low..=(a[axis].max(b[axis]).max(c[axis]).floor().max(0.0) as usize).min(self.size[axis] - 1)
        };
        for y in span(1) {
            for x in span(0) {
                let (px, py) = (x as f64 - a[0], y as f64 - a[1]);
                let wb = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / area;
                let wc = (py * (b[0] - a[0]) - px * (b[1] - a[1])) / area;
                if wb >= 0.0 && wc >= 0.0 && wb + wc <= 1.0 {
                    let depth = a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2]);
                    let slot = &mut self.layers[layer][y * self.size[0] + x];
                    *slot = slot.min(depth as f32);
                }
            }
        }
    }

    /// Whether nothing lies before a point at which the surface is seen under an angle of this cosine.
    fn reaches(&self, p: &Vec3, cosine: f64, eyeball: bool) -> bool {
        let [x, y, depth] = self.plane(p);
        let cell = |axis: usize, x: f64| (self.cell(axis, x).round().max(0.0) as usize).min(self.size[axis] - 1);
        let at = cell(1, y) * self.size[0] + cell(0, x);
        // A slanted surface changes depth within a cell.
        let slant = TOLERANCE + 0.75 * self.cell * (1.0 / (cosine * cosine) - 1.0).max(0.0).sqrt();
        let tolerance = if eyeball { [UNDER_LIDS, slant] } else { [slant; 2] };
        depth > 1.0 && (0..2).all(|k| depth <= f64::from(self.layers[k][at]) + tolerance[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_behind_is_hidden() {
        let square = |z: f64, h: f64| [[-h, -h], [h, -h], [h, h], [-h, h]].map(|[x, y]| Vec3::new(x, y, z));
        let mut positions = square(0.0, 30.0).to_vec();
        positions.extend(square(-0.1, 10.0));
        positions.extend(square(-50.0, 10.0));
        let triangles: Vec<[u32; 3]> =
            (0..3).flat_map(|k| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v| v + 4 * k))).collect();
        let normals = vec![Vec3::z(); 12];
        let seen = |eye: Vec3, skin_points: usize| -> Vec<bool> {
            let surface = Occluder { positions: &positions, triangles: &triangles, skin_points };
            let view = View::new(&[eye], surface, 60.0);
            view.seen(&positions, &normals, skin_points).iter().map(Option::is_some).collect()
        };
        // All skin: a tenth of a millimetre is within the tolerance, but not for an eyeball.
        let front = seen(Vec3::new(0.0, 0.0, 600.0), 12);
        assert_eq!(front, [[true; 8].as_slice(), &[false; 4]].concat());
        let eyeball = seen(Vec3::new(0.0, 0.0, 600.0), 4);
        assert_eq!(eyeball, [[true; 4].as_slice(), &[false; 8]].concat());
        assert!(!seen(Vec3::new(0.0, 0.0, -600.0), 12).contains(&true), "from behind");
        assert!(!seen(Vec3::new(600.0, 0.0, 100.0), 12).contains(&true), "grazing");
    }
}
