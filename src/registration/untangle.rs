//! What comes after the last step: sheets that passed through each other, as closed lips and shut lids do, are taken apart.
//!
//! Data and shapes know nothing of the other sheet, and a graph's nodes are farther apart than lips are thick. So the vertices leave
//! the model here, by fractions of an edge, and no farther than it takes.
//!
//! Two triangles that cross are pushed apart along the difference of their normals, the direction in which sheets that face each other
//! part, by their overlap; the pushes are averaged with the neighbours', so that the deep middle of an overlap, where no triangle crosses
//! another, is carried along with its rim. As in the resolution of surface collisions by Volino and Magnenat-Thalmann ("Resolving surface
//! collisions through intersection contour minimization", 2006), crossings are all that is looked at, no inside and no outside: the
//! template may be open.

use serde::Serialize;

use crate::evaluation::self_intersections;
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::{TriangleMesh, Vec3};

/// Rounds at most, and rounds without fewer crossings after which it is no use.
const ROUNDS: usize = 40;
const PATIENCE: usize = 10;

/// How far a vertex goes in a round, and in all, in mean lengths of an edge.
const STEP: f64 = 0.2;
const FARTHEST: f64 = 0.5;

/// Rings that follow in a round, and those about the first crossings that may move at all.
const SPREAD: usize = 12;
const REACH: usize = 16;

/// Rings about the first crossings within which others may come up.
const NEAR: usize = 6;

/// Rounds of averaging normals with the neighbours', so that what already crosses does not say where it goes.
const SMOOTHING: usize = 2;

/// Least difference of two unit normals that says where to part.
const OPPOSED: f64 = 0.3;

/// Pairs of triangles that pass through each other, and what was taken apart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Untangled {
    /// Pairs at rest: faces may have some by design, at lips and eyelids.
    pub at_rest: usize,
    /// Pairs that the last step left.
    pub before: usize,
    /// Pairs that remain.
    pub after: usize,
    /// How far the farthest vertex went, in the unit of the positions; zero where no more crossed than at rest.
    pub farthest: f64,
}

impl std::fmt::Display for Untangled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { before, after, farthest, .. } = self;
        write!(
            f,
            "taken apart: {after} of {before} self-intersections are left, for which vertices moved by {farthest:.2} mm at most"
        )
    }
}

/// Moves `positions` until no more of their triangles cross than at rest. Where it cannot be reached, the state with the fewest
/// crossings stays. What crosses at rest is left as it is.
pub(super) fn untangle(rest: &TriangleMesh, positions: &mut [Vec3]) -> Untangled {
    let crossing = |positions: &[Vec3]| crossings(positions, &rest.triangles);
    let (tangled, by_design) = (crossing(positions), crossing(&rest.positions));
    let (before, at_rest) = (tangled.len(), by_design.len());
    let mut done = Untangled { at_rest, before, after: before, farthest: 0.0 };
    if before > at_rest {
        let mut patch = Patch::about(rest, positions, &tangled, &by_design);
        let moved = patch.part(at_rest);
        let mut parted = positions.to_vec();
        patch.vertices.iter().zip(&moved).for_each(|(&v, &p)| parted[v as usize] = p);
        // What is beyond the patch may be hit too.
        let after = crossing(&parted).len();
        if after < before {
            let distances = parted.iter().zip(&*positions).map(|(a, b)| (a - b).norm());
            done = Untangled { after, farthest: distances.fold(0.0, f64::max), ..done };
            positions.copy_from_slice(&parted);
        }
    }
    done
}

fn crossings(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    self_intersections(positions, triangles).expect("proven: a template's triangles name its vertices")
}

/// The surface about the crossings.
struct Patch {
    /// Its vertices in the template.
    vertices: Vec<u32>,
    mesh: TriangleMesh,
    /// Where its vertices are at rest.
    rest: Vec<Vec3>,
    edges: EdgeGraph,
    /// Vertices at its end, which stay.
    held: Vec<bool>,
    /// The triangles nearest to the crossings, among which more are looked for.
    near: Vec<[u32; 3]>,
    /// Which of these cross others at rest.
    by_design: Vec<bool>,
    /// Mean length of an edge.
    edge: f64,
}

impl Patch {
    fn about(rest: &TriangleMesh, positions: &[Vec3], tangled: &[[u32; 2]], by_design: &[[u32; 2]]) -> Self {
        let edges = EdgeGraph::of(rest);
        let mut rings = vec![usize::MAX; positions.len()];
        let corners = |pairs: &[[u32; 2]]| -> Vec<u32> {
            pairs.as_flattened().iter().flat_map(|&t| rest.triangles[t as usize]).collect()
        };
        let mut front = corners(tangled);
        for ring in 0..=REACH {
            front.retain(|&v| {
                let first = rings[v as usize] == usize::MAX;
                rings[v as usize] = rings[v as usize].min(ring);
                first
            });
            front = front.iter().flat_map(|&v| edges.neighbours(v as usize)).copied().collect();
        }
        let vertices: Vec<u32> = (0..positions.len() as u32).filter(|&v| rings[v as usize] <= REACH).collect();
        let mut local = vec![u32::MAX; positions.len()];
        vertices.iter().enumerate().for_each(|(i, &v)| local[v as usize] = i as u32);
        let within = |t: usize, ring: usize| rest.triangles[t].iter().all(|&v| rings[v as usize] <= ring);
        let of_ring = |ring: usize| (0..rest.triangles.len()).filter(move |&t| within(t, ring));
        let here = |t: usize| rest.triangles[t].map(|v| local[v as usize]);
        let mut crossed = vec![false; rest.triangles.len()];
        by_design.as_flattened().iter().for_each(|&t| crossed[t as usize] = true);
        let mesh = TriangleMesh {
            positions: vertices.iter().map(|&v| positions[v as usize]).collect(),
            triangles: of_ring(REACH).map(here).collect(),
        };
        let edges = EdgeGraph::of(&mesh);
        let lengths = edges.lengths(&mesh.positions);
        Self {
            rest: vertices.iter().map(|&v| rest.positions[v as usize]).collect(),
            held: vertices.iter().map(|&v| rings[v as usize] == REACH).collect(),
            near: of_ring(NEAR).map(here).collect(),
            by_design: of_ring(NEAR).map(|t| crossed[t]).collect(),
            edge: lengths.iter().sum::<f64>() / lengths.len().max(1) as f64,
            vertices,
            mesh,
            edges,
        }
    }

    /// The positions with the fewest crossings on the way to `enough`.
    fn part(&mut self, enough: usize) -> Vec<Vec3> {
        let start = self.mesh.positions.clone();
        let (mut best, mut fewest, mut since) = (start.clone(), usize::MAX, 0);
        for _ in 0..=ROUNDS {
            let pairs = crossings(&self.mesh.positions, &self.near);
            since += 1;
            if pairs.len() < fewest {
                (fewest, since) = (pairs.len(), 0);
                best.copy_from_slice(&self.mesh.positions);
            }
            if fewest <= enough || since > PATIENCE {
                break;
            }
            let pushes = self.pushes(&pairs);
            if pushes.iter().all(|push| *push == Vec3::zeros()) {
                break;
            }
            let pushes = self.spread(pushes);
            for (((p, push), from), held) in self.mesh.positions.iter_mut().zip(&pushes).zip(&start).zip(&self.held) {
                if !held {
                    *p = from + (*p + push - from).cap_magnitude(FARTHEST * self.edge);
                }
            }
        }
        best
    }

    /// How far each vertex would go for the pairs that its triangles cross.
    fn pushes(&self, pairs: &[[u32; 2]]) -> Vec<Vec3> {
        let positions = &self.mesh.positions;
        let normals = self.normals();
        let mut sums = vec![(Vec3::zeros(), 0.0); positions.len()];
        for pair in pairs {
            let [a, b] = pair.map(|t| self.near[t as usize]);
            if pair.iter().all(|&t| self.by_design[t as usize]) || self.split(a, b) {
                continue;
            }
            let normal = |t: [u32; 3]| t.iter().map(|&v| normals[v as usize]).sum::<Vec3>().normalize();
            let Some(apart) = (normal(b) - normal(a)).try_normalize(OPPOSED) else { continue };
            let heights = |t: [u32; 3]| t.map(|v| positions[v as usize].dot(&apart));
            let span = |t: [u32; 3]| {
                let [x, y, z] = heights(t);
                (x.min(y).min(z), x.max(y).max(z))
            };
            let ((low_a, high_a), (low_b, high_b)) = (span(a), span(b));
            let overlap = (high_b - low_a).min(high_a - low_b).max(0.0);
            let push = apart * (overlap.min(STEP * self.edge) / 2.0);
            for (t, push) in [(a, push), (b, -push)] {
                t.iter().for_each(|&v| {
                    let (sum, count) = &mut sums[v as usize];
                    *sum += push;
                    *count += 1.0;
                });
            }
        }
        sums.iter().map(|&(sum, count): &(Vec3, f64)| sum / count.max(1.0)).collect()
    }

    /// Whether two triangles are one sheet that has a vertex for each: they touch at rest, where no vertex is both's.
    fn split(&self, a: [u32; 3], b: [u32; 3]) -> bool {
        let same = |&i: &u32, &j: &u32| i != j && self.rest[i as usize] == self.rest[j as usize];
        a.iter().any(|i| b.iter().any(|j| same(i, j)))
    }

    /// Unit normals of the vertices, smoothed.
    fn normals(&self) -> Vec<Vec3> {
        let mut normals = vertex_normals(&self.mesh.positions, &self.mesh.triangles, NormalWeighting::Area);
        for _ in 0..SMOOTHING {
            normals = (0..normals.len())
                .map(|i| {
                    (normals[i] + self.mean_round(i, &normals)).try_normalize(f64::MIN_POSITIVE).unwrap_or(normals[i])
                })
                .collect();
        }
        normals
    }

    /// Lets neighbours follow.
    fn spread(&self, mut pushes: Vec<Vec3>) -> Vec<Vec3> {
        for _ in 0..SPREAD {
            pushes = (0..pushes.len()).map(|i| (pushes[i] + self.mean_round(i, &pushes)) / 2.0).collect();
        }
        pushes
    }

    fn mean_round(&self, i: usize, of: &[Vec3]) -> Vec3 {
        let round = self.edges.neighbours(i);
        round.iter().map(|&j| of[j as usize]).sum::<Vec3>() / round.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet, side_by_side};

    const SIDE: usize = 61;

    /// Two domes, one above the other, whose tops overlap by `overlap`.
    fn domes(overlap: f64) -> TriangleMesh {
        let dome = |up: f64, base: f64| {
            sheet(SIDE, SIDE, move |c, r| {
                let square = (c - 30.0).powi(2) + (r - 30.0).powi(2);
                let height = base + up * (3.0 - 0.03 * square);
                if up > 0.0 { Vec3::new(c, r, height) } else { Vec3::new(60.0 - c, r + 0.31, height) }
            })
        };
        side_by_side(&dome(1.0, -3.0 + overlap / 2.0), &dome(-1.0, 3.0 - overlap / 2.0))
    }

    #[test]
    fn sheets_that_overlap_are_taken_apart() {
        let (rest, tangled) = (domes(-0.2), domes(0.5));
        let mut positions = tangled.positions.clone();
        let done = untangle(&rest, &mut positions);
        assert_eq!(done.before, crossings(&tangled.positions, &rest.triangles).len());
        assert!(done.before > 50, "{done:?}");
        assert_eq!((done.after, crossings(&positions, &rest.triangles).len()), (0, 0));
        let moved = |i: usize| (positions[i] - tangled.positions[i]).norm();
        assert_eq!(done.farthest, (0..positions.len()).map(moved).fold(0.0, f64::max));
        // Half of the overlap each, and a little; the tops of both touch, their rims stay.
        assert!(done.farthest < 0.35, "{done:?}");
        let low = SIDE * SIDE / 2;
        let high = low + SIDE * SIDE;
        let overlap = |of: &[Vec3]| of[low].z - of[high].z;
        assert!((overlap(&tangled.positions) - 0.5).abs() < 1e-12 && overlap(&positions) < 0.05);
        assert!([0, SIDE * SIDE - 1, SIDE * SIDE].iter().all(|&corner| moved(corner) == 0.0));
    }

    #[test]
    fn what_does_not_cross_or_crosses_at_rest_is_left_alone() {
        for (rest, now) in [(domes(-0.2), domes(-0.1)), (domes(0.5), domes(0.5)), (domes(0.5), domes(0.1))] {
            let mut positions = now.positions.clone();
            let done = untangle(&rest, &mut positions);
            assert_eq!((done.after, done.farthest), (done.before, 0.0));
            assert_eq!(positions, now.positions);
        }
    }

    #[test]
    fn a_sheet_in_pieces_is_one_sheet() {
        // Every triangle with vertices of its own, all of them a little off where they belong.
        let apart = |mesh: &TriangleMesh, off: f64| {
            let corners = mesh.triangles.as_flattened();
            let place = |(i, &v): (usize, &u32)| mesh.positions[v as usize] + Vec3::repeat(off * noise(i));
            let triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            TriangleMesh { positions: corners.iter().enumerate().map(place).collect(), triangles }
        };
        let roof = sheet(9, 9, |c, r| Vec3::new(c, r, -(c - 4.0).abs()));
        let (rest, now) = (apart(&roof, 0.0), apart(&roof, 0.05));
        let mut positions = now.positions.clone();
        let done = untangle(&rest, &mut positions);
        assert!(done.before > 20 && done.farthest == 0.0, "{done:?}");
    }

    #[test]
    fn what_lies_too_deep_stays_within_reach_and_never_gets_worse() {
        let (rest, tangled) = (domes(-0.2), domes(4.0));
        let mut positions = tangled.positions.clone();
        let done = untangle(&rest, &mut positions);
        assert!(done.after <= done.before && done.after == crossings(&positions, &rest.triangles).len(), "{done:?}");
        // Edges grow outwards: those of the patch are no longer on average than all.
        let lengths = EdgeGraph::of(&tangled).lengths(&tangled.positions);
        assert!(done.farthest <= FARTHEST * lengths.iter().sum::<f64>() / lengths.len() as f64, "{done:?}");
    }
}
