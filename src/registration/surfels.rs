//! Surfels: a surface as points with normals, evenly spaced whatever its triangles are, in a frame of its own. What the
//! search of a start runs on.

use nalgebra::{Matrix3, SymmetricEigen};

use crate::mesh::normals::{NormalWeighting, face_cross, vertex_normals};
use crate::mesh::{TriangleMesh, Vec3};

/// A piece of surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surfel {
    pub point: Vec3,
    /// Unit length.
    pub normal: Vec3,
    pub area: f64,
}

/// An orthonormal right-handed frame: a point's coordinates are `axes' (p - origin) / unit`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub origin: Vec3,
    pub axes: Matrix3<f64>,
    pub unit: f64,
}

impl Frame {
    /// The principal axes of a surface about its centroid, pointing to the side of the longer tail. The frame moves with the
    /// surface.
    pub fn principal(mesh: &TriangleMesh, unit: f64) -> Self {
        let pieces = || {
            mesh.triangles.iter().map(|&t| {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
                (0.5 * face_cross(&mesh.positions, t).norm(), (a + b + c) / 3.0)
            })
        };
        let (area, sum) = pieces().fold((0.0, Vec3::zeros()), |(w, s), (area, p)| (w + area, s + p * area));
        let origin = sum / area;
        let covariance = pieces().fold(Matrix3::zeros(), |m, (w, p)| m + (p - origin) * (p - origin).transpose() * w);
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let mut axes = order.map(|i| eigen.eigenvectors.column(i).into_owned());
        for axis in &mut axes[..2] {
            let skew: f64 = pieces().map(|(w, p)| w * axis.dot(&(p - origin)).powi(3)).sum();
            if skew < 0.0 {
                *axis = -*axis;
            }
        }
        axes[2] = axes[0].cross(&axes[1]);
        Self { origin, axes: Matrix3::from_columns(&axes), unit }
    }

    /// A point's coordinates in this frame.
    pub fn to_local(self, p: Vec3) -> Vec3 {
        self.axes.tr_mul(&(p - self.origin)) / self.unit
    }
}

/// At most this many pieces along a triangle's edge.
const MOST_PIECES: f64 = 64.0;
/// Pieces for each cell's area that a triangle may be cut into. As many as `(longest / cell)^2` follow the longest edge, and more than
/// these means a sliver: slivers together are sampled by area.
const DENSE: f64 = 16.0;
/// A triangle may always be cut into so many.
const FEW: f64 = 4.0;
/// Pieces beyond [`FEW`] for each triangle, however large the triangles are: 100 MB.
const MOST: f64 = 1e6;

/// The surface of `mesh` in `frame`, one surfel per cell of a cubic lattice that it passes through: mean point and normal of
/// the surface inside. Where the normals there cancel, as in a fold, there is none. Memory follows the number of triangles, not
/// their shapes. `normals`, one per vertex, if they are
/// known; triangles that touch a vertex in `ignored` are left out.
pub(super) fn surfels(
    mesh: &TriangleMesh,
    normals: Option<&[Vec3]>,
    ignored: &[bool],
    frame: Frame,
    cell: f64,
) -> Vec<Surfel> {
    let computed = match normals {
        Some(_) => Vec::new(),
        None => vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area),
    };
    let normals = normals.unwrap_or(&computed);
    let counted = |t: &&[u32; 3]| !t.iter().any(|&v| ignored.get(v as usize).copied().unwrap_or(false));
    let corners = |t: &[u32; 3]| t.map(|v| frame.to_local(mesh.positions[v as usize]));
    let (cut, mut by_area) = pieces_of(mesh.triangles.iter().filter(counted).map(corners), cell);
    let mut pieces: Vec<([i32; 3], Surfel)> = Vec::with_capacity(cut as usize);
    for t in mesh.triangles.iter().filter(counted) {
        let p = corners(t);
        let n = t.map(|v| frame.axes.tr_mul(&normals[v as usize]));
        let (area, cuts) = cuts(&p, cell);
        let mut add = |u: f64, v: f64, area: f64| {
            let mix = |c: &[Vec3; 3]| c[0] * (1.0 - u - v) + c[1] * u + c[2] * v;
            let point = mix(&p);
            let normal = mix(&n).try_normalize(0.0).unwrap_or_default();
            let place = (point / cell).map(f64::floor);
            pieces.push(([place.x as i32, place.y as i32, place.z as i32], Surfel { point, normal, area }));
        };
        let Some(cuts) = cuts.filter(|_| !by_area.all) else {
            by_area.sample(area, add);
            continue;
        };
        let area = area / (cuts * cuts);
        if area <= 0.0 {
            continue;
        }
        // Centres of the `cuts` squared equal triangles: those that point up, then those that point down.
        let count = cuts as usize;
        for (rest, third) in [(count, 1.0 / 3.0), (count - 1, 2.0 / 3.0)] {
            for i in 0..rest {
                for j in 0..rest - i {
                    let (u, v) = ((i as f64 + third) / cuts, (j as f64 + third) / cuts);
                    add(u, v, area);
                }
            }
        }
    }
    pieces.sort_by_key(|p| p.0);
    let mean = |group: &[([i32; 3], Surfel)]| {
        let area: f64 = group.iter().map(|p| p.1.area).sum();
        let point = group.iter().map(|p| p.1.point * p.1.area).sum::<Vec3>() / area;
        let normal = group.iter().map(|p| p.1.normal * p.1.area).sum::<Vec3>() / area;
        (normal.norm() > COHERENT).then(|| Surfel { point, normal: normal.normalize(), area })
    };
    pieces.chunk_by(|a, b| a.0 == b.0).filter_map(mean).collect()
}

/// Area of a triangle, and along each edge how many pieces it is cut into, unless it is a sliver.
fn cuts(p: &[Vec3; 3], cell: f64) -> (f64, Option<f64>) {
    let area = 0.5 * (p[1] - p[0]).cross(&(p[2] - p[0])).norm();
    let longest = (0..3).map(|i| (p[(i + 1) % 3] - p[i]).norm()).fold(0.0, f64::max);
    let cuts = (longest / cell).ceil().clamp(1.0, MOST_PIECES);
    let few = cuts * cuts <= (DENSE * area / (cell * cell)).max(FEW);
    (area, few.then_some(cuts))
}

/// How the triangles are sampled: number of pieces of those that are cut, and how the slivers are sampled, or all triangles if that
/// number is too large.
fn pieces_of(triangles: impl Iterator<Item = [Vec3; 3]>, cell: f64) -> (f64, ByArea) {
    let (mut count, mut cut, mut total) = (0.0, 0.0, 0.0);
    for p in triangles {
        let (area, cuts) = cuts(&p, cell);
        count += 1.0;
        cut += cuts.map_or(0.0, |cuts| cuts * cuts);
        total += area;
    }
    let most = FEW * count + MOST;
    let all = cut > most;
    // of the slivers alone, or of all
    let each = (cell * cell / DENSE).max(total / most);
    (if all { 0.0 } else { cut }, ByArea { all, each, carried: each, samples: 0 })
}

/// Samples at equal steps of the area of one triangle after the other, at places in them that are spread evenly (the sequence of
/// the golden ratio in two dimensions, Roberts 2018).
struct ByArea {
    /// Whether of all triangles, not of slivers alone.
    all: bool,
    /// Area of a sample.
    each: f64,
    /// Area since the last sample.
    carried: f64,
    samples: u32,
}

impl ByArea {
    fn sample(&mut self, area: f64, mut add: impl FnMut(f64, f64, f64)) {
        self.carried += area;
        while self.carried >= self.each && self.each > 0.0 {
            self.carried -= self.each;
            self.samples += 1;
            let at = |step: f64| (f64::from(self.samples) * step).fract();
            let (u, v) = (at(0.754_877_666_246_692_7), at(0.569_840_290_998_053_2));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            add(u, v, self.each);
        }
    }
}

/// Length of a cell's mean normal below which its surface is folded.
const COHERENT: f64 = 0.6;

/// Indices of at most `count` points: the first is `first`, each further one the farthest from those before; ends when none
/// is farther than `spacing`.
pub(super) fn farthest_points(points: &[Surfel], first: usize, count: usize, spacing: f64) -> Vec<usize> {
    let mut squared = vec![f64::INFINITY; points.len()];
    let (mut chosen, mut next) = (Vec::new(), (first, f64::INFINITY));
    while chosen.len() < count.min(points.len()) && next.1 > spacing * spacing {
        chosen.push(next.0);
        let from = points[next.0].point;
        next = (0, 0.0);
        for (i, (s, p)) in squared.iter_mut().zip(points).enumerate() {
            *s = s.min((p.point - from).norm_squared());
            if *s > next.1 {
                next = (i, *s);
            }
        }
    }
    chosen
}

/// Which surfel is near any point of space, looked up in a lattice: fast and approximate.
#[derive(Debug)]
pub(super) struct Lattice {
    low: Vec3,
    cell: f64,
    size: [usize; 3],
    /// Surfel plus one, zero where none is within reach.
    nearest: Vec<u32>,
}

/// Cells of a lattice at most.
const MOST_CELLS: f64 = 4e6;

impl Lattice {
    /// Around `surfels` (not empty), answering within about `reach`.
    pub fn new(surfels: &[Surfel], cell: f64, reach: f64) -> Self {
        let start = (surfels[0].point, surfels[0].point);
        let (low, high) = surfels.iter().fold(start, |(l, h), s| (l.inf(&s.point), h.sup(&s.point)));
        let (low, high) = (low.add_scalar(-reach), high.add_scalar(reach));
        let volume = (high - low).product();
        let cell = cell.max((volume / MOST_CELLS).cbrt());
        let size: [usize; 3] = std::array::from_fn(|a| ((high - low)[a] / cell) as usize + 1);
        let mut lattice = Self { low, cell, size, nearest: vec![0; size[0] * size[1] * size[2]] };
        lattice.fill(surfels, reach);
        lattice
    }

    /// Each cell takes the nearest of its neighbours' surfels, in waves from the surface outwards.
    fn fill(&mut self, surfels: &[Surfel], reach: f64) {
        let centre = |place: [usize; 3]| self.low + Vec3::from_fn(|a, _| place[a] as f64 + 0.5) * self.cell;
        let [nx, ny, nz] = self.size;
        let mut squared = vec![f32::INFINITY; self.nearest.len()];
        let mut wave: Vec<([usize; 3], u32)> = Vec::with_capacity(surfels.len());
        let mut candidates: Vec<([usize; 3], u32)> = Vec::new();
        for (i, s) in surfels.iter().enumerate() {
            let place = ((s.point - self.low) / self.cell).map(|x| x as usize);
            candidates.push(([place.x.min(nx - 1), place.y.min(ny - 1), place.z.min(nz - 1)], i as u32 + 1));
        }
        loop {
            wave.clear();
            for &(place, id) in &candidates {
                let at = (place[2] * ny + place[1]) * nx + place[0];
                let d = (surfels[id as usize - 1].point - centre(place)).norm_squared() as f32;
                if d < squared[at] && f64::from(d) <= reach * reach {
                    squared[at] = d;
                    self.nearest[at] = id;
                    wave.push((place, id));
                }
            }
            if wave.is_empty() {
                break;
            }
            candidates.clear();
            for &([x, y, z], id) in &wave {
                if self.nearest[(z * ny + y) * nx + x] != id {
                    continue;
                }
                let mut push = |x, y, z| candidates.push(([x, y, z], id));
                if x > 0 {
                    push(x - 1, y, z);
                }
                if x + 1 < nx {
                    push(x + 1, y, z);
                }
                if y > 0 {
                    push(x, y - 1, z);
                }
                if y + 1 < ny {
                    push(x, y + 1, z);
                }
                if z > 0 {
                    push(x, y, z - 1);
                }
                if z + 1 < nz {
                    push(x, y, z + 1);
                }
            }
        }
    }

    /// A surfel near `p`, if any is within reach.
    #[inline]
    pub fn near(&self, p: Vec3) -> Option<usize> {
        let q = (p - self.low) / self.cell;
        if !(q.x >= 0.0 && q.y >= 0.0 && q.z >= 0.0) {
            return None;
        }
        let [x, y, z] = [q.x as usize, q.y as usize, q.z as usize];
        if x >= self.size[0] || y >= self.size[1] || z >= self.size[2] {
            return None;
        }
        let id = self.nearest[(z * self.size[1] + y) * self.size[0] + x];
        (id > 0).then(|| id as usize - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;

    const FRAME: fn() -> Frame = || Frame { origin: Vec3::zeros(), axes: Matrix3::identity(), unit: 1.0 };

    fn disc(n: u32) -> TriangleMesh {
        let point = |i: u32| {
            let t = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
            Vec3::new(100.0 * t.cos(), 100.0 * t.sin(), 1.0)
        };
        let triangles = (1..n - 1).map(|i| [0, i, i + 1]).collect();
        TriangleMesh { positions: (0..n).map(point).collect(), triangles }
    }

    /// One surface as a fan of slivers, whose longest edges are 25 cells, and as a few triangles.
    #[test]
    fn slivers_are_sampled_as_evenly_as_other_triangles_and_by_area() {
        let (few, many) = (disc(60), disc(20_000));
        let of = |mesh: &TriangleMesh| surfels(mesh, None, &[], FRAME(), 8.0);
        let (a, b) = (of(&few), of(&many));
        assert!((a.len() as f64 / b.len() as f64 - 1.0).abs() < 0.05, "{} {}", a.len(), b.len());
        let area = |surfels: &[Surfel]| surfels.iter().map(|s| s.area).sum::<f64>();
        let exact = std::f64::consts::PI * 1e4;
        assert!((area(&a) / exact - 1.0).abs() < 0.01 && (area(&b) / exact - 1.0).abs() < 0.01);
        assert!(b.iter().all(|s| s.normal.z > 0.999 && (s.point.z - 1.0).abs() < 1e-9));
        let sample = |mesh: &TriangleMesh| {
            let p = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize]));
            pieces_of(p, 8.0)
        };
        let (cut, by_area) = sample(&many);
        assert!(cut <= FEW * many.triangles.len() as f64 && exact / by_area.each < 1e4, "{cut} {}", by_area.each);
    }

    #[test]
    fn ordinary_triangles_are_cut_as_ever_and_large_ones_come_to_a_number_that_is_bounded() {
        let mesh = sheet(5, 5, |x, y| Vec3::new(30.0 * x, 20.0 * y, x * y));
        for t in &mesh.triangles {
            let (_, cuts) = cuts(&t.map(|v| mesh.positions[v as usize]), 4.0);
            assert!(cuts.is_some());
        }
        let large = [Vec3::zeros(), Vec3::x() * 1e4, Vec3::y() * 1e4];
        let (cut, by_area) = pieces_of(std::iter::repeat_n(large, 10_000), 4.0);
        assert!(cut == 0.0 && by_area.all);
        assert!(10_000.0 * 5e7 / by_area.each <= FEW * 1e4 + MOST + 1.0);
    }
}
