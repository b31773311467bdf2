//! What a depth camera delivers: distances along the rays of its pixels, with noise that neighbours share, and nothing where it looks
//! too steeply or where the surface jumps.

use nonrigid::mesh::{TriangleMesh, Vec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::ScanOptions;
use super::faults::Hole;
use super::view::{DepthMap, Layers, Occluder};

/// Shares of the pixels at a jump of the surface that are lost, and that lie somewhere between its two sides.
const EDGE_LOST: f64 = 0.5;
const EDGE_FLYING: f64 = 0.1;
/// The noise is white noise under this filter along rows and columns; the last is the factor of its deviation.
const FILTER: [f64; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const FILTERED: f64 = 70.0 / 256.0;
/// How far a point may be from what the camera saw and still be shown: in pixels, and in what the four pixels round it differ by.
const SHOWN: [f64; 2] = [0.25, 0.5];

/// One image. Pixels count row by row.
pub(super) struct DepthImage {
    map: DepthMap,
    /// Depth of the true surface; infinite where there is none.
    true_depths: Vec<f64>,
    /// Measured depth; `NAN` where there is none.
    depths: Vec<f64>,
    /// Cosine of the angle between ray and normal.
    cosines: Vec<f64>,
    /// Neighbouring pixels that differ by more in depth are no one surface, millimetres.
    jump: f64,
}

impl DepthImage {
    /// The surface as a camera at `eye` would see it without any fault, pixels `pitch` millimetres apart on it; `grazing` degrees is
    /// the steepest angle that it measures. `None`: nothing is before the camera.
    pub fn new(eye: Vec3, surface: Occluder, pitch: f64, grazing: f64) -> Option<Self> {
        let map = DepthMap::new(eye, surface, pitch, Layers::FrontAndBack)?;
        let jump = 1.5 * map.pitch() * grazing.to_radians().tan().clamp(1.0, 10.0);
        let true_depths: Vec<f64> = map.nearest().collect();
        let cosines = vec![0.0; true_depths.len()];
        let mut image = Self { map, depths: true_depths.clone(), true_depths, cosines, jump };
        image.cosines = (0..image.depths.len()).map(|i| image.cosine(i)).collect();
        let least = grazing.to_radians().cos();
        for (depth, cosine) in image.depths.iter_mut().zip(&image.cosines) {
            if !depth.is_finite() || *cosine < least {
                *depth = f64::NAN;
            }
        }
        Some(image)
    }

    /// Pixels with a measurement, and where they are.
    pub fn points(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.depths.iter().enumerate().filter(|(_, d)| !d.is_nan()).map(|(i, d)| self.map.point(i, *d))
    }

    /// The pixels beside one, left, right, below and above; `None` outside.
    fn beside(&self, i: usize) -> [Option<usize>; 4] {
        let [wide, high] = self.map.size();
        let (x, y) = (i % wide, i / wide);
        [
            (x > 0).then(|| i - 1),
            (x + 1 < wide).then(|| i + 1),
            (y > 0).then(|| i - wide),
            (y + 1 < high).then(|| i + wide),
        ]
    }

    fn cosine(&self, i: usize) -> f64 {
        let depth = self.true_depths[i];
        let there = |j: Option<usize>| j.filter(|j| (self.true_depths[*j] - depth).abs() < self.jump);
        let at = |j: usize| self.map.point(j, self.true_depths[j]);
        let [left, right, below, above] = self.beside(i).map(there);
        if !depth.is_finite() || left.or(right).is_none() || below.or(above).is_none() {
            return 0.0;
        }
        let difference = |low: Option<usize>, high: Option<usize>| at(high.unwrap_or(i)) - at(low.unwrap_or(i));
        let normal = difference(left, right).cross(&difference(below, above));
        let ray = at(i) - self.map.eye();
        (normal.dot(&ray).abs() / (normal.norm() * ray.norm()).max(1e-300)).min(1.0)
    }

    /// Takes away what lies in `holes` and much of what is at a jump, and adds noise and spikes along the rays.
    pub fn spoil(&mut self, options: &ScanOptions, holes: &[Hole], [edges, noise, spikes]: [&mut ChaCha8Rng; 3]) {
        let [low, high] = options.spike_height;
        let smooth = correlated(self.map.size(), noise);
        for i in 0..self.depths.len() {
            let mut depth = self.depths[i];
            if depth.is_nan() {
                continue;
            }
            // The other side of the jump beside this pixel: infinite at the outline.
            let other =
                self.beside(i).iter().flatten().map(|j| self.true_depths[*j]).find(|d| (d - depth).abs() > self.jump);
            if let Some(other) = other {
                let chance: f64 = edges.random();
                if chance < EDGE_LOST {
                    depth = f64::NAN;
                } else if chance < EDGE_LOST + EDGE_FLYING && other.is_finite() {
                    depth += edges.random::<f64>() * (other - depth);
                }
            }
            if depth.is_nan() || holes.iter().any(|h| h.holds(&self.map.point(i, depth))) {
                self.depths[i] = f64::NAN;
                continue;
            }
            let sigma = options.noise * (1.0 + options.grazing_noise * (1.0 / self.cosines[i].max(0.05) - 1.0));
            let mut error = sigma * smooth[i];
            if spikes.random::<f64>() < options.spikes {
                error +=
                    (low + (high - low) * spikes.random::<f64>()) * if spikes.random::<bool>() { 1.0 } else { -1.0 };
            }
            self.depths[i] = depth + error / self.map.stretch(i);
        }
    }

    /// The pixels as a mesh, cut where the surface jumps.
    pub fn mesh(&self) -> TriangleMesh {
        let [wide, high] = self.map.size();
        let mut number = vec![u32::MAX; self.depths.len()];
        let mut positions = Vec::new();
        for (i, depth) in self.depths.iter().enumerate().filter(|(_, d)| !d.is_nan()) {
            number[i] = positions.len() as u32;
            positions.push(self.map.point(i, *depth));
        }
        let one = |corners: [usize; 3]| {
            let depths = corners.map(|i| self.depths[i]);
            let whole = depths.iter().all(|d| !d.is_nan())
                && depths.iter().all(|a| depths.iter().all(|b| (a - b).abs() < 1.5 * self.jump));
            whole.then(|| corners.map(|i| number[i]))
        };
        let quads = (0..high - 1).flat_map(|y| (0..wide - 1).map(move |x| y * wide + x));
        let triangles =
            quads.flat_map(|i| [[i, i + 1, i + wide + 1], [i, i + wide + 1, i + wide]]).filter_map(one).collect();
        TriangleMesh { positions, triangles }
    }

    /// Whether the four pixels round a point of the true surface are measured, and show it.
    pub fn shows(&self, p: &Vec3) -> bool {
        let Some((pixels, at, depth)) = self.around(p) else { return false };
        let depths = pixels.map(|i| self.true_depths[i]);
        let tolerance = SHOWN[0] * self.map.pitch() + SHOWN[1] * spread(&depths);
        pixels.iter().all(|i| !self.depths[*i].is_nan()) && (between(&depths, at) - depth).abs() < tolerance
    }

    /// How far a point is before the measured surface (behind it: negative), about along its normal, and the cosine of the angle at
    /// which it was seen. `None` where nothing was measured, or the surface jumps.
    pub fn before(&self, p: &Vec3) -> Option<(f64, f64)> {
        let (pixels, at, depth) = self.around(p)?;
        let depths = pixels.map(|i| self.depths[i]);
        if depths.iter().any(|d| d.is_nan()) || spread(&depths) > 1.5 * self.jump {
            return None;
        }
        let surface = between(&depths, at);
        let cosine = self.cosines[pixels[0]];
        Some(((surface - depth) * self.map.stretch(pixels[0]) * cosine, cosine))
    }

    /// The four pixels round a point's image, where it is between them, and its depth.
    fn around(&self, p: &Vec3) -> Option<([usize; 4], [f64; 2], f64)> {
        let [x, y, depth] = self.map.pixel(p);
        let [wide, high] = self.map.size();
        let inside = |x: f64, count: usize| x >= 0.0 && x < (count - 1) as f64;
        if depth <= 1.0 || !inside(x, wide) || !inside(y, high) {
            return None;
        }
        let i = y as usize * wide + x as usize;
        Some(([i, i + 1, i + wide, i + wide + 1], [x.fract(), y.fract()], depth))
    }
}

fn spread(depths: &[f64; 4]) -> f64 {
    depths.iter().copied().fold(f64::MIN, f64::max) - depths.iter().copied().fold(f64::MAX, f64::min)
}

/// Depth between four pixels, linear along rows and columns.
fn between([a, b, c, d]: &[f64; 4], [x, y]: [f64; 2]) -> f64 {
    (1.0 - y) * ((1.0 - x) * a + x * b) + y * ((1.0 - x) * c + x * d)
}

/// Noise of deviation 1 that neighbours share.
fn correlated([wide, high]: [usize; 2], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let white: Vec<f64> = (0..wide * high).map(|_| StandardNormal.sample(rng)).collect();
    let shifted = |x: usize, k: usize, count: usize| (x + k + count - 2) % count;
    let along = |image: &[f64], filtered: &dyn Fn(usize, usize, usize) -> usize| -> Vec<f64> {
        let sum = |i: usize| FILTER.iter().enumerate().map(|(k, f)| f * image[filtered(i % wide, i / wide, k)]).sum();
        (0..image.len()).map(sum).collect()
    };
    let rows = along(&white, &|x, y, k| y * wide + shifted(x, k, wide));
    let mut both = along(&rows, &|x, y, k| shifted(y, k, high) * wide + x);
    both.iter_mut().for_each(|x| *x /= FILTERED);
    both
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    /// A square of 40 mm at z = 0, and one of 20 mm 30 mm before it.
    fn image(options: &ScanOptions) -> DepthImage {
        let square = |z: f64, h: f64| [[-h, -h], [h, -h], [h, h], [-h, h]].map(|[x, y]| Vec3::new(x, y, z));
        let positions = [square(0.0, 20.0), square(30.0, 10.0)].concat();
        let triangles: Vec<[u32; 3]> =
            (0..2).flat_map(|k| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v| v + 4 * k))).collect();
        let surface = Occluder { positions: &positions, triangles: &triangles, skin_points: 8 };
        let mut image = DepthImage::new(Vec3::new(0.0, 0.0, 700.0), surface, 0.5, 70.0).unwrap();
        let mut rngs: [ChaCha8Rng; 3] = std::array::from_fn(|k| ChaCha8Rng::seed_from_u64(k as u64));
        let [a, b, c] = &mut rngs;
        image.spoil(options, &[], [a, b, c]);
        image
    }

    #[test]
    fn noise_has_its_deviation_and_neighbours_share_it() {
        let size = [200, 150];
        let noise = correlated(size, &mut ChaCha8Rng::seed_from_u64(1));
        let mean = |f: &dyn Fn(usize) -> f64| (0..noise.len() - 1).map(f).sum::<f64>() / (noise.len() - 1) as f64;
        let variance = mean(&|i| noise[i] * noise[i]);
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
        let shared = mean(&|i| noise[i] * noise[i + 1]);
        assert!((shared - 0.8).abs() < 0.05, "{shared}"); // 56 / 70
    }

    #[test]
    fn the_mesh_lies_on_what_is_seen_and_is_cut_at_jumps() {
        let image = image(&ScanOptions { noise: 0.0, spikes: 0.0, ..ScanOptions::default() });
        let mesh = image.mesh();
        assert!(mesh.triangles.len() > 8000, "{}", mesh.triangles.len());
        for t in &mesh.triangles {
            let z = t.map(|v| mesh.positions[v as usize].z);
            assert!(z.iter().all(|a| z.iter().all(|b| (a - b).abs() < 8.0)), "{z:?}");
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            assert!((b - a).cross(&(c - a)).z > 0.0, "faces the camera");
        }
        // But for what flies between the two squares, points are on them.
        let on = mesh.positions.iter().filter(|p| p.z.abs() < 1e-3 || (p.z - 30.0).abs() < 1e-3).count();
        assert!(on < mesh.positions.len() && on as f64 > 0.98 * mesh.positions.len() as f64, "{on}");
        assert!(image.shows(&Vec3::new(1.0, 1.0, 30.0)) && image.shows(&Vec3::new(15.0, 15.0, 0.0)));
        assert!(!image.shows(&Vec3::new(1.0, 1.0, 0.0)), "hidden");
        let (distance, cosine) = image.before(&Vec3::new(1.0, 1.0, 31.0)).unwrap();
        assert!((distance - 1.0).abs() < 1e-3 && cosine > 0.999, "{distance} {cosine}");
    }
}
