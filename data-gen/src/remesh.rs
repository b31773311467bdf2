//! A finer, irregular triangulation of a quad mesh's surface that shares no vertex with it.
//!
//! Each quad gets k x k points at jittered places strictly inside. Points of one quad are joined in a lattice, lattices are
//! joined across edges, and round each template vertex the nearest points of its quads close a polygon (the dual of Doo &
//! Sabin 1978). Along open boundaries a row of points on the boundary edge is added. Points lie on the Phong tessellation
//! of the quads (Boubekeur & Alexa 2008), which passes through the template's vertices and is round between them.

use std::collections::BTreeMap;

use nonrigid::mesh::{PolygonMesh, Vec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A fine mesh whose vertices know where on the template they lie.
pub(crate) struct Remesh {
    /// Quad and bilinear weights of its four corners.
    pub places: Vec<(usize, [f64; 4])>,
    pub triangles: Vec<[u32; 3]>,
    /// The fine vertices round each template vertex.
    pub rings: Vec<Vec<u32>>,
}

/// Share of the Phong tessellation against the bilinear patch.
const ROUNDNESS: f64 = 0.75;
/// Largest move of a point in its cell, in cells, along each axis.
const JITTER: f64 = 0.3;

impl Remesh {
    /// `density`: points along each side of a quad. The mesh must be an oriented manifold of quads.
    pub fn new(mesh: &PolygonMesh, density: usize, rng: &mut ChaCha8Rng) -> Self {
        let (k, quads) = (density.max(1), mesh.polygon_count());
        let mut places = Vec::with_capacity(quads * k * k);
        for quad in 0..quads {
            for j in 0..k {
                for i in 0..k {
                    let mut at = |c: usize| (c as f64 + 0.5 + rng.random_range(-JITTER..JITTER)) / k as f64;
                    places.push((quad, bilinear(at(i), at(j))));
                }
            }
        }
        // The point nearest to position m (0..k) of side s of a quad, counted along the side.
        let lattice = |quad: usize, side: usize, m: usize| -> u32 {
            let (i, j) = match side {
                0 => (m, 0),
                1 => (k - 1, m),
                2 => (k - 1 - m, k - 1),
                _ => (0, k - 1 - m),
            };
            (quad * k * k + j * k + i) as u32
        };
        let mut out = Self { places, triangles: Vec::new(), rings: vec![Vec::new(); mesh.positions.len()] };
        let mut cells: Vec<[u32; 4]> = Vec::new();
        for quad in 0..quads {
            for j in 0..k - 1 {
                for i in 0..k - 1 {
                    let a = (quad * k * k + j * k + i) as u32;
                    cells.push([a, a + 1, a + 1 + k as u32, a + k as u32]);
                }
            }
        }
        // Directed edge -> quad and side.
        let mut sides = BTreeMap::new();
        for quad in 0..quads {
            let q = mesh.polygon(quad);
            for side in 0..4 {
                sides.insert((q[side], q[(side + 1) % 4]), (quad, side));
            }
        }
        // For each template vertex, the successor of each ring point: counter-clockwise walk from quad to quad.
        let mut rim: BTreeMap<(usize, usize), Vec<u32>> = BTreeMap::new();
        for (&(a, b), &(quad, side)) in &sides {
            if let Some(&(other, other_side)) = sides.get(&(b, a)) {
                if a < b {
                    for m in 0..k - 1 {
                        cells.push([
                            lattice(other, other_side, k - 1 - m),
                            lattice(other, other_side, k - 2 - m),
                            lattice(quad, side, m + 1),
                            lattice(quad, side, m),
                        ]);
                    }
                }
            } else {
                let first = out.places.len() as u32;
                for m in 0..k {
                    let t = (m as f64 + 0.5 + rng.random_range(-JITTER..JITTER)) / k as f64;
                    let mut weights = [0.0; 4];
                    (weights[side], weights[(side + 1) % 4]) = (1.0 - t, t);
                    out.places.push((quad, weights));
                }
                let row: Vec<u32> = (first..first + k as u32).collect();
                for m in 0..k - 1 {
                    cells.push([row[m], row[m + 1], lattice(quad, side, m + 1), lattice(quad, side, m)]);
                }
                rim.insert((quad, side), row);
            }
        }
        for [a, b, c, d] in cells {
            if rng.random::<bool>() {
                out.triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                out.triangles.extend([[b, c, d], [b, d, a]]);
            }
        }
        // Rings: from each quad at a vertex, step over the side that ends there to the next quad.
        let mut starts: Vec<Option<(usize, usize)>> = vec![None; mesh.positions.len()];
        for quad in 0..quads {
            for (corner, &v) in mesh.polygon(quad).iter().enumerate() {
                let open = rim.contains_key(&(quad, corner));
                let slot = &mut starts[v as usize];
                if slot.is_none() || open {
                    *slot = Some((quad, corner));
                }
            }
        }
        for (v, start) in starts.iter().enumerate() {
            let Some((first, first_corner)) = *start else { continue };
            let ring = &mut out.rings[v];
            if let Some(row) = rim.get(&(first, first_corner)) {
                ring.push(row[0]);
            }
            let (mut quad, mut corner) = (first, first_corner);
            loop {
                ring.push(lattice(quad, corner, 0));
                let q = mesh.polygon(quad);
                let before = (corner + 3) % 4;
                match sides.get(&(q[corner], q[before])) {
                    Some(&(next, side)) if (next, side) != (first, first_corner) && ring.len() < 64 => {
                        (quad, corner) = (next, side);
                    }
                    Some(_) => break,
                    None => {
                        if let Some(row) = rim.get(&(quad, before)) {
                            ring.push(row[k - 1]);
                        }
                        break;
                    }
                }
            }
            let ring = ring.clone();
            let pivot = if ring.len() > 2 { rng.random_range(0..ring.len()) } else { 0 };
            for i in 1..ring.len().saturating_sub(1) {
                let at = |i: usize| ring[(pivot + i) % ring.len()];
                out.triangles.push([at(0), at(i), at(i + 1)]);
            }
        }
        out
    }

    /// Positions of the fine vertices when the template's are at `positions` with unit `normals`.
    pub fn positions(&self, mesh: &PolygonMesh, positions: &[Vec3], normals: &[Vec3]) -> Vec<Vec3> {
        let place = |(quad, weights): &(usize, [f64; 4])| {
            let corners = || mesh.polygon(*quad).iter().map(|v| *v as usize).zip(weights);
            let flat: Vec3 = corners().map(|(v, w)| positions[v] * *w).sum();
            let round: Vec3 =
                corners().map(|(v, w)| (flat - normals[v] * normals[v].dot(&(flat - positions[v]))) * *w).sum();
            flat + (round - flat) * ROUNDNESS
        };
        self.places.iter().map(place).collect()
    }
}

fn bilinear(s: f64, t: f64) -> [f64; 4] {
    [(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FaceOptions, FaceRig};
    use rand::SeedableRng;

    #[test]
    fn the_fine_mesh_is_an_oriented_manifold_over_the_whole_template() {
        let rig = FaceRig::generate(&FaceOptions { vertices: 600 });
        for density in [1, 2, 3] {
            let fine = Remesh::new(&rig.mesh, density, &mut ChaCha8Rng::seed_from_u64(1));
            let mut edges = std::collections::BTreeSet::new();
            for t in &fine.triangles {
                for i in 0..3 {
                    assert!(edges.insert((t[i], t[(i + 1) % 3])), "an edge is used twice in one direction");
                }
            }
            assert!(fine.rings.iter().all(|r| r.len() >= 3));
            let flat = vec![Vec3::z(); rig.neutral.len()];
            let positions = fine.positions(&rig.mesh, &rig.neutral, &flat);
            let area = |p: &[Vec3], triangles: &[[u32; 3]]| -> f64 {
                let one = |t: &[u32; 3]| {
                    let [a, b, c] = t.map(|v| p[v as usize]);
                    0.5 * (b - a).cross(&(c - a)).z
                };
                triangles.iter().map(one).sum()
            };
            let (coarse, covered) =
                (area(&rig.neutral, &rig.mesh.triangulate().triangles), area(&positions, &fine.triangles));
            assert!((covered / coarse - 1.0).abs() < 0.02, "{density}: {covered} of {coarse}");
        }
    }
}
