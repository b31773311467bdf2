//! What goes wrong in a scan: holes, noise, spikes, loose parts, outliers; and an order that says nothing.

use nalgebra::{Matrix3, SymmetricEigen};
use nonrigid::mesh::{TriangleMesh, Vec3};
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{ScanOptions, Stream};

/// Where nothing was measured.
pub(super) enum Hole {
    /// A ball.
    Ball { centre: Vec3, radius: f64 },
    /// What lies beyond a plane.
    Beyond { direction: Vec3, limit: f64 },
}

impl Hole {
    /// Holes at some of `points`, and what is cut off.
    pub fn all(points: &[Vec3], options: &ScanOptions, seed: u64) -> Vec<Self> {
        let mut holes = Self::draw(points, options, &mut Stream::Holes.of(seed));
        holes.extend(Self::cut(points, options.keep, &mut Stream::Cut.of(options.shared_seed.unwrap_or(seed))));
        holes
    }

    fn draw(points: &[Vec3], options: &ScanOptions, rng: &mut ChaCha8Rng) -> Vec<Self> {
        let [small, large] = options.hole_radius;
        let count = if points.is_empty() { 0 } else { options.holes };
        let hole = |_| Self::Ball {
            centre: points[rng.random_range(0..points.len())],
            radius: small + (large - small) * rng.random::<f64>(),
        };
        (0..count).map(hole).collect()
    }

    /// The end, either one, that leaves the share `keep` of the points, along the direction in which they spread most.
    fn cut(points: &[Vec3], keep: f64, rng: &mut ChaCha8Rng) -> Option<Self> {
        if keep >= 1.0 || points.is_empty() {
            return None;
        }
        let centre = points.iter().sum::<Vec3>() / points.len() as f64;
        let spread: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
        let eigen = SymmetricEigen::new(spread);
        let mut direction: Vec3 = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into();
        // The sign of an eigenvector is anybody's.
        direction *= direction[direction.iamax()].signum() * if rng.random::<bool>() { 1.0 } else { -1.0 };
        let mut along: Vec<f64> = points.iter().map(|p| direction.dot(p)).collect();
        let last = (keep * (along.len() - 1) as f64) as usize;
        let limit = *along.select_nth_unstable_by(last, f64::total_cmp).1;
        Some(Self::Beyond { direction, limit })
    }

    pub fn holds(&self, p: &Vec3) -> bool {
        match self {
            Self::Ball { centre, radius } => (p - centre).norm_squared() <= radius * radius,
            Self::Beyond { direction, limit } => direction.dot(p) > *limit,
        }
    }
}

/// Moves points along their rays: noise by the cosine of the angle of view, and spikes.
pub(super) fn measure(
    points: &mut [Vec3],
    seen: &[Option<(f64, Vec3)>],
    options: &ScanOptions,
    [noise, spikes]: [&mut ChaCha8Rng; 2],
) {
    let [low, high] = options.spike_height;
    for (p, seen) in points.iter_mut().zip(seen) {
        let normal: f64 = StandardNormal.sample(noise);
        let spike = spikes.random::<f64>() < options.spikes;
        let height = (low + (high - low) * spikes.random::<f64>()) * if spikes.random::<bool>() { 1.0 } else { -1.0 };
        if let Some((cosine, ray)) = seen {
            let sigma = options.noise * (1.0 + options.grazing_noise * (1.0 / cosine - 1.0));
            *p += ray * (normal * sigma + if spike { height } else { 0.0 });
        }
    }
}

/// Crumpled patches of 6 to 14 mm, 20 mm and more off the face, with triangles as large as the scan's.
pub(super) fn add_loose_parts(mesh: &mut TriangleMesh, centre: Vec3, edge: f64, count: usize, rng: &mut ChaCha8Rng) {
    for _ in 0..count {
        let angle = rng.random_range(-1.3..1.3f64);
        let away = Vec3::new(angle.sin(), rng.random_range(-0.6..0.6), angle.cos());
        let middle = centre + away * rng.random_range(110.0..150.0);
        let size = rng.random_range(6.0..14.0);
        let side = ((size / edge) as u32).clamp(3, 100);
        let step = size / f64::from(side);
        let waves: [f64; 4] = std::array::from_fn(|_| rng.random_range(0.0..std::f64::consts::TAU));
        let first = mesh.positions.len() as u32;
        for j in 0..=side {
            for i in 0..=side {
                let mut jitter = || rng.random_range(-0.3..0.3);
                let (x, y) = (step * (f64::from(i) + jitter()), step * (f64::from(j) + jitter()));
                let z = (0.6 * x + waves[0]).sin() + (0.7 * y + waves[1]).sin() + 0.3 * step * jitter();
                mesh.positions.push(middle + Vec3::new(x, y, z));
            }
        }
        for j in 0..side {
            for i in 0..side {
                let a = first + j * (side + 1) + i;
                let [b, c, d] = [a + 1, a + side + 2, a + side + 1];
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
}

/// Single triangles about as large as the scan's, within 60 mm of its points.
pub(super) fn add_outliers(mesh: &mut TriangleMesh, edge: f64, count: usize, rng: &mut ChaCha8Rng) {
    let points = mesh.positions.len();
    for _ in 0..if points == 0 { 0 } else { count } {
        let mut direction = || Vec3::from_fn(|_, _| StandardNormal.sample(rng)).try_normalize(1e-9).unwrap_or_default();
        let corners = [direction(), direction(), direction()];
        let away = direction();
        let middle = mesh.positions[rng.random_range(0..points)] + away * rng.random_range(2.0..60.0);
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(corners.map(|c| middle + c * (0.6 * edge)));
        mesh.triangles.push([first, first + 1, first + 2]);
    }
}

/// The points that triangles use in random order, and the triangles too: order carries no hint of the correspondence.
pub(super) fn shuffled(mesh: &TriangleMesh, rng: &mut ChaCha8Rng) -> TriangleMesh {
    let mut used = vec![false; mesh.positions.len()];
    mesh.triangles.iter().flatten().for_each(|v| used[*v as usize] = true);
    let mut order: Vec<u32> = (0..used.len() as u32).filter(|v| used[*v as usize]).collect();
    order.shuffle(rng);
    let mut renamed = vec![0u32; used.len()];
    for (new, old) in order.iter().enumerate() {
        renamed[*old as usize] = new as u32;
    }
    let mut triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| renamed[v as usize])).collect();
    triangles.shuffle(rng);
    for t in &mut triangles {
        t.rotate_left(rng.random_range(0..3));
    }
    TriangleMesh { positions: order.into_iter().map(|v| mesh.positions[v as usize]).collect(), triangles }
}
