//! The exact closest point on a triangle mesh, and the closest vertices of a point cloud.
//!
//! The triangles or vertices lie in a hierarchy of boxes (`box_tree`), searched nearest box first.
//!
//! **Conventions.** Millimetres; squared distances in square millimetres. Winding does not matter. Barycentric
//! coordinates belong to the triangle's corners in their order, are not negative and sum to 1 up to rounding. Triangles
//! without area are the segments or points that they have become.
//!
//! **Ties** go to the lowest triangle or vertex index, and the answer is the same to the last bit whatever bound or hint
//! a query starts from. That holds because the distance to a triangle is, in floating point and not just in theory, at
//! least the distance to every box round it: both are sums of squares of differences to the query, and rounding is
//! monotone. So a box is skipped only if nothing in it can win or tie.

mod box_tree;
mod triangle;

use std::ops::Range;

use rayon::prelude::*;

use super::{MeshError, TriangleMesh, Vec3};
use box_tree::{Best, Bounds, BoxTree, Line};
use triangle::{closest_on_triangle, on_line, squared, sub};

/// The closest point of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its corners.
    pub barycentric: [f64; 3],
    /// The point, millimetres.
    pub point: Vec3,
    /// Squared distance to the query, square millimetres.
    pub squared_distance: f64,
}

/// The closest vertex of a point cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestVertex {
    /// Index of the vertex.
    pub vertex: u32,
    /// Squared distance to the query, square millimetres.
    pub squared_distance: f64,
}

type Point = [f64; 3];

/// Triangles that look for others together.
const TOGETHER: usize = 8;

/// Vertices whose neighbours are looked for one after the other.
const CHUNK: usize = 256;

/// Vertices whose neighbours wait for their place in the vertices' order.
const BATCH: usize = 256 * CHUNK;

/// More than rounding adds to a sum of two distances.
const ROUNDING: f64 = 1.0 + 1e-9;

/// Answers closest-point queries on a triangle mesh. Queries only read, so threads may share it.
#[derive(Debug, Clone)]
pub struct ClosestPoint {
    tree: BoxTree,
    positions: Vec<Vec3>,
    /// Corners of the triangle in every slot: by index, since triangles share them.
    triangles: Vec<[u32; 3]>,
    /// Slot of every triangle.
    slots: Vec<u32>,
}

impl ClosestPoint {
    /// Builds the hierarchy. A mesh without triangles is allowed: every query answers `None`.
    ///
    /// # Errors
    /// When a triangle indexes past the vertices, or a vertex of one is not finite.
    pub fn new(mesh: &TriangleMesh) -> Result<Self, MeshError> {
        check(&mesh.positions, &mesh.triangles)?;
        let tree = BoxTree::build(mesh.triangles.iter().map(|t| box_of(&corners(&mesh.positions, t))));
        let triangles: Vec<_> = tree.order.iter().map(|&t| mesh.triangles[t as usize]).collect();
        let mut slots = vec![0; triangles.len()];
        tree.order.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        Ok(Self { tree, positions: mesh.positions.clone(), triangles, slots })
    }

    /// The vertices of the mesh.
    #[must_use]
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// The triangles of the mesh, in its order.
    pub fn triangles(&self) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        self.slots.iter().map(|&slot| self.triangles[slot as usize])
    }

    /// Corners of a triangle.
    ///
    /// # Panics
    /// If there is no such triangle.
    #[inline]
    #[must_use]
    pub fn triangle(&self, triangle: u32) -> [u32; 3] {
        self.triangles[self.slots[triangle as usize] as usize]
    }

    /// The same triangles at other positions: the boxes are fitted anew, the tree is kept. Answers are those of [`new`](Self::new) to
    /// the last bit; searches are as short while neighbours stay neighbours.
    ///
    /// # Errors
    /// When a vertex of a triangle is not finite; nothing is changed then.
    ///
    /// # Panics
    /// When there are not as many vertices as before.
    pub fn move_to(&mut self, positions: &[Vec3]) -> Result<(), MeshError> {
        assert_eq!(positions.len(), self.positions.len(), "the vertices that the tree was built for");
        check(positions, &self.triangles)?;
        self.positions.copy_from_slice(positions);
        self.tree.refit(|slot| box_of(&corners(&self.positions, &self.triangles[slot])));
        Ok(())
    }

    /// The closest point; `None` if there are no triangles or `query` is not finite.
    #[must_use]
    pub fn query(&self, query: &Vec3) -> Option<Closest> {
        self.run(query, Best { squared_distance: f64::INFINITY, primitive: u32::MAX })
    }

    /// The closest point no farther than the square root of `max_squared_distance`, or `None`.
    #[must_use]
    pub fn query_within(&self, query: &Vec3, max_squared_distance: f64) -> Option<Closest> {
        self.run(query, Best { squared_distance: max_squared_distance, primitive: u32::MAX })
    }

    /// As [`Self::query_within`], faster if triangle `hint` is near. The answer does not depend on the hint; one that is out of
    /// range is ignored.
    #[must_use]
    pub fn query_from_within(&self, query: &Vec3, hint: u32, max_squared_distance: f64) -> Option<Closest> {
        let mut best = Best { squared_distance: max_squared_distance, primitive: u32::MAX };
        if let Some(&slot) = self.slots.get(hint as usize) {
            let (_, _, d) = self.closest(slot as usize, (*query).into());
            if d <= best.squared_distance {
                best = Best { squared_distance: d, primitive: hint };
            }
        }
        self.run(query, best)
    }

    /// Where the line through `origin` along the unit vector `direction` first meets a triangle whose front faces along `direction`,
    /// looked for both ways as far as `reach`; ties go to the lowest triangle. A triangle `hint` that is met makes it faster.
    /// [`Closest::squared_distance`] is that along the line.
    #[must_use]
    pub fn along(&self, origin: &Vec3, direction: &Vec3, reach: f64, hint: u32) -> Option<Closest> {
        let (o, d): (Point, Point) = ((*origin).into(), (*direction).into());
        if !o.iter().chain(&d).all(|x| x.is_finite()) {
            return None;
        }
        let mut best = Best { squared_distance: reach * reach, primitive: u32::MAX };
        let meet = |slot: usize| {
            let [a, b, c] = self.corners(slot);
            on_line(sub(a, o), sub(b, o), sub(c, o), d)
        };
        let hinted = self.slots.get(hint as usize).and_then(|&slot| meet(slot as usize));
        if let Some((_, t)) = hinted.filter(|(_, t)| t * t <= best.squared_distance) {
            best = Best { squared_distance: t * t, primitive: hint };
        }
        self.tree.search(
            Line::new(o, d),
            &mut best,
            #[inline(always)]
            |slots, best| {
                for slot in slots {
                    let triangle = self.tree.order[slot];
                    match meet(slot) {
                        Some((_, t)) if best.beaten_by(t * t, triangle) => {
                            *best = Best { squared_distance: t * t, primitive: triangle };
                        }
                        _ => {}
                    }
                }
            },
        );
        let (barycentric, t) = meet(*self.slots.get(best.primitive as usize)? as usize)?;
        let point = origin + direction * t;
        Some(Closest { triangle: best.primitive, barycentric, point, squared_distance: t * t })
    }

    /// [`Self::along`] as if there were that triangle only; `None` if there is no such triangle.
    #[must_use]
    pub fn along_to(&self, origin: &Vec3, direction: &Vec3, reach: f64, triangle: u32) -> Option<Closest> {
        let o: Point = (*origin).into();
        let [a, b, c] = self.corners(*self.slots.get(triangle as usize)? as usize);
        let (barycentric, t) = on_line(sub(a, o), sub(b, o), sub(c, o), (*direction).into())?;
        let point = origin + direction * t;
        (t.abs() <= reach).then_some(Closest { triangle, barycentric, point, squared_distance: t * t })
    }

    /// Pairs of triangles whose bounding boxes meet, boundaries included, and of which `meet` says that they do; lower index first, in
    /// lexicographic order.
    #[must_use]
    pub fn meeting_pairs(&self, meet: impl Fn(u32, u32) -> bool + Sync) -> Vec<[u32; 2]> {
        // Neighbours in the tree ask together.
        let pairs_of = |group: &[u32]| {
            let boxes: Vec<(u32, Bounds)> =
                group.iter().map(|&t| (t, self.box_of(self.slots[t as usize] as usize))).collect();
            let mut all = Bounds::EMPTY;
            boxes.iter().for_each(|(_, bounds)| all.include(bounds));
            let mut pairs = Vec::new();
            self.tree.meeting(&all, |slots| {
                for slot in slots {
                    let (u, of_u) = (self.tree.order[slot], self.box_of(slot));
                    let earlier = boxes.iter().filter(|(t, of_t)| *t < u && of_t.meets(&of_u) && meet(*t, u));
                    pairs.extend(earlier.map(|&(t, _)| [t, u]));
                }
            });
            pairs
        };
        let mut pairs: Vec<[u32; 2]> = self.tree.order.par_chunks(TOGETHER).flat_map_iter(pairs_of).collect();
        pairs.sort_unstable();
        pairs
    }

    fn box_of(&self, slot: usize) -> Bounds {
        box_of(&self.corners(slot))
    }

    #[inline(always)]
    fn corners(&self, slot: usize) -> [Point; 3] {
        corners(&self.positions, &self.triangles[slot])
    }

    #[inline(always)]
    fn closest(&self, slot: usize, query: Point) -> ([f64; 3], Point, f64) {
        let [a, b, c] = self.corners(slot);
        closest_on_triangle(sub(a, query), sub(b, query), sub(c, query))
    }

    fn run(&self, query: &Vec3, mut best: Best) -> Option<Closest> {
        let q: Point = (*query).into();
        if !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        self.tree.search(
            q,
            &mut best,
            #[inline(always)]
            |slots, best| {
                for slot in slots {
                    let (_, _, d) = self.closest(slot, q);
                    let triangle = self.tree.order[slot];
                    if best.beaten_by(d, triangle) {
                        *best = Best { squared_distance: d, primitive: triangle };
                    }
                }
            },
        );
        let slot = *self.slots.get(best.primitive as usize)?;
        let (barycentric, offset, squared_distance) = self.closest(slot as usize, q);
        let point = query + Vec3::from(offset);
        Some(Closest { triangle: best.primitive, barycentric, point, squared_distance })
    }
}

/// Refuses triangles that [`corners`] cannot be asked for.
fn check(positions: &[Vec3], triangles: &[[u32; 3]]) -> Result<(), MeshError> {
    for (triangle, indices) in triangles.iter().enumerate() {
        for &index in indices {
            let Some(position) = positions.get(index as usize) else {
                return Err(MeshError::IndexOutOfRange { triangle, index, count: positions.len() });
            };
            finite(index as usize, position)?;
        }
    }
    Ok(())
}

#[inline(always)]
fn corners(positions: &[Vec3], triangle: &[u32; 3]) -> [Point; 3] {
    triangle.map(|i| positions[i as usize].into())
}

fn box_of(corners: &[Point; 3]) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    corners.iter().for_each(|&p| bounds.include(&Bounds { low: p, high: p }));
    bounds
}

fn finite(vertex: usize, position: &Vec3) -> Result<Point, MeshError> {
    let position: Point = (*position).into();
    if position.iter().all(|x| x.is_finite()) { Ok(position) } else { Err(MeshError::NotFinite { vertex, position }) }
}

/// Answers closest-vertex queries on a point cloud. Queries only read, so threads may share it.
#[derive(Debug, Clone)]
pub struct ClosestVertices {
    tree: BoxTree,
    points: Vec<Point>,
}

impl ClosestVertices {
    /// Builds the hierarchy. No points are allowed: every query answers `None`.
    ///
    /// # Errors
    /// When a point is not finite.
    pub fn new(positions: &[Vec3]) -> Result<Self, MeshError> {
        let points: Vec<Point> = positions.iter().enumerate().map(|(i, p)| finite(i, p)).collect::<Result<_, _>>()?;
        let tree = BoxTree::build(points.iter().map(|&p| Bounds { low: p, high: p }));
        let points = tree.order.iter().map(|&i| points[i as usize]).collect();
        Ok(Self { tree, points })
    }

    /// The closest vertex; `None` if there are none or `query` is not finite.
    #[must_use]
    pub fn query(&self, query: &Vec3) -> Option<ClosestVertex> {
        self.query_within(query, f64::INFINITY)
    }

    /// The closest vertex no farther than the square root of `max_squared_distance`, or `None`.
    #[must_use]
    pub fn query_within(&self, query: &Vec3, max_squared_distance: f64) -> Option<ClosestVertex> {
        let q: Point = (*query).into();
        let mut best = Best { squared_distance: max_squared_distance, primitive: u32::MAX };
        if !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        self.tree.search(
            q,
            &mut best,
            #[inline(always)]
            |slots, best| {
                for slot in slots {
                    let d = squared(sub(self.points[slot], q));
                    if best.beaten_by(d, self.tree.order[slot]) {
                        *best = Best { squared_distance: d, primitive: self.tree.order[slot] };
                    }
                }
            },
        );
        let found = best.primitive != u32::MAX;
        found.then_some(ClosestVertex { vertex: best.primitive, squared_distance: best.squared_distance })
    }

    /// The `k` closest vertices, nearest first, lowest index on ties, into `found` (cleared first).
    pub fn k_nearest(&self, query: &Vec3, k: usize, found: &mut Vec<ClosestVertex>) {
        self.k_nearest_within(query, k, f64::INFINITY, found);
    }

    /// Those of them that are no farther than `distance`, for less work.
    pub fn k_nearest_within(&self, query: &Vec3, k: usize, distance: f64, found: &mut Vec<ClosestVertex>) {
        found.clear();
        let q: Point = (*query).into();
        if k == 0 || !q.iter().all(|x| x.is_finite()) {
            return;
        }
        let mut best = Best { squared_distance: distance * distance, primitive: u32::MAX };
        self.tree.search(q, &mut best, |slots, best| {
            for slot in slots {
                let new = ClosestVertex {
                    vertex: self.tree.order[slot],
                    squared_distance: squared(sub(self.points[slot], q)),
                };
                if !best.beaten_by(new.squared_distance, new.vertex) {
                    continue;
                }
                let before = |o: &ClosestVertex| (o.squared_distance, o.vertex) < (new.squared_distance, new.vertex);
                found.insert(found.partition_point(before), new);
                found.truncate(k);
                if found.len() == k {
                    let last = found[k - 1];
                    *best = Best { squared_distance: last.squared_distance, primitive: last.vertex };
                }
            }
        });
    }

    /// What `of` makes of every vertex and its `k` closest vertices, itself among them, nearest first.
    ///
    /// # Panics
    /// If `k` is 0.
    pub fn neighbourhoods<R: Copy + Default + Send>(
        &self,
        k: usize,
        of: impl Fn(u32, &[ClosestVertex]) -> R + Sync,
    ) -> Vec<R> {
        assert!(k > 0, "of no neighbours nothing is made");
        // In the tree's order: what the vertex before has found lies within its distance plus the way from there.
        let of_slots = |slots: Range<usize>| -> Vec<R> {
            let (mut found, mut before) = (Vec::<ClosestVertex>::with_capacity(k + 1), Vec3::zeros());
            let of_slot = |slot: usize| {
                let p = Vec3::from(self.points[slot]);
                let farthest = found.get(k - 1).map_or(f64::INFINITY, |n| n.squared_distance.sqrt());
                self.k_nearest_within(&p, k, (farthest + (p - before).norm()) * ROUNDING, &mut found);
                before = p;
                of(self.tree.order[slot], &found)
            };
            slots.map(of_slot).collect()
        };
        let (count, mut all) = (self.points.len(), vec![R::default(); self.points.len()]);
        // A batch at a time: all of them in both orders would be much memory.
        for batch in (0..count).step_by(BATCH) {
            let slots = batch..count.min(batch + BATCH);
            let chunks = slots.clone().into_par_iter().step_by(CHUNK);
            let made: Vec<Vec<R>> = chunks.map(|first| of_slots(first..slots.end.min(first + CHUNK))).collect();
            self.tree.order[slots].iter().zip(made.into_iter().flatten()).for_each(|(&v, r)| all[v as usize] = r);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet};
    use proptest::prelude::*;

    fn v(p: Point) -> Vec3 {
        Vec3::from(p)
    }

    /// Coordinates on a coarse grid now and then, so that ties and degenerate triangles happen.
    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![-3.0..3.0f64, (-3i32..4).prop_map(f64::from), Just(1e-9), Just(100.0)]
    }

    fn point() -> impl Strategy<Value = Vec3> {
        [coordinate(), coordinate(), coordinate()].prop_map(v)
    }

    fn mesh() -> impl Strategy<Value = TriangleMesh> {
        (prop::collection::vec(point(), 3..40), prop::collection::vec([0u32..1000, 0u32..1000, 0u32..1000], 1..80))
            .prop_map(|(positions, triangles)| {
                let n = positions.len() as u32;
                TriangleMesh { positions, triangles: triangles.into_iter().map(|t| t.map(|i| i % n)).collect() }
            })
    }

    proptest! {
        #[test]
        fn a_line_meets_what_it_meets_first_of_all_triangles(
            mesh in mesh(), origin in point(), direction in point(), reach in 0.1..8.0f64, hint in 0u32..90,
        ) {
            let Some(direction) = direction.try_normalize(1e-6) else { return Ok(()) };
            let tree = ClosestPoint::new(&mesh).unwrap();
            let each = (0..mesh.triangles.len() as u32).filter_map(|t| tree.along_to(&origin, &direction, reach, t));
            let first = each.min_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance));
            let found = tree.along(&origin, &direction, reach, hint);
            prop_assert_eq!(first.map(|f| f.squared_distance), found.map(|f| f.squared_distance));
            if let Some(found) = found {
                let corners = mesh.triangles[found.triangle as usize].map(|v| mesh.positions[v as usize]);
                let on_it = corners[0] * found.barycentric[0] + corners[1] * found.barycentric[1] + corners[2] * found.barycentric[2];
                prop_assert!((found.point - on_it).norm() < 1e-5 * (1.0 + on_it.norm()), "{found:?}");
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
                prop_assert!(normal.dot(&direction) > 0.0);
            }
        }
    }

    /// Ericson, "Real-Time Collision Detection", 5.1.5, by regions: another route to the same distance.
    fn reference(p: Vec3, [a, b, c]: [Vec3; 3]) -> f64 {
        let segment = |a: Vec3, b: Vec3| {
            let ab = b - a;
            let t = if ab.norm_squared() > 0.0 { ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0) } else { 0.0 };
            (a + ab * t - p).norm_squared()
        };
        let mut best = segment(a, b).min(segment(b, c)).min(segment(c, a));
        let n = (b - a).cross(&(c - a));
        if n.norm() > 1e-7 * (b - a).norm() * (c - a).norm() {
            let inside = [(a, b), (b, c), (c, a)].iter().all(|(s, e)| (e - s).cross(&(p - s)).dot(&n) >= 0.0);
            if inside {
                best = best.min(n.normalize().dot(&(p - a)).powi(2));
            }
        }
        best
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn the_closest_point_is_that_of_all_triangles(mesh in mesh(), queries in prop::collection::vec(point(), 1..20),
                                                      hint in 0u32..90) {
            let tree = ClosestPoint::new(&mesh).unwrap();
            for q in &queries {
                let found = tree.query(q).unwrap();
                // the same function over all triangles: same bits, lowest index
                let all = (0..mesh.triangles.len()).map(|t| {
                    let (_, _, d) = tree.closest(tree.slots[t] as usize, (*q).into());
                    (d, t as u32)
                });
                let (d, t) = all.reduce(|a, b| if b < a { b } else { a }).unwrap();
                prop_assert_eq!((found.squared_distance, found.triangle), (d, t));
                // another function over all triangles: same distance
                let brute = mesh.triangles.iter().map(|t| reference(*q, t.map(|i| mesh.positions[i as usize])))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!((brute.sqrt() - d.sqrt()).abs() < 1e-6, "{} {}", brute.sqrt(), d.sqrt());
                // the point is where it says
                let corners = mesh.triangles[t as usize].map(|i| mesh.positions[i as usize]);
                let w = found.barycentric;
                let by_weights = corners[0] * w[0] + corners[1] * w[1] + corners[2] * w[2];
                prop_assert!((by_weights - found.point).norm() < 1e-6, "{by_weights} {}", found.point);
                prop_assert!(w.iter().all(|w| *w >= 0.0) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                // hints and bounds change nothing
                prop_assert_eq!(tree.query_from_within(q, hint, f64::INFINITY), Some(found));
                prop_assert_eq!(tree.query_within(q, d), Some(found));
                prop_assert_eq!(tree.query_from_within(q, hint, d), Some(found));
                if d > 0.0 {
                    prop_assert_eq!(tree.query_within(q, d.next_down()), None);
                    prop_assert_eq!(tree.query_from_within(q, hint, d.next_down()), None);
                }
            }
        }

        #[test]
        fn the_pairs_whose_boxes_meet_are_those_of_all(mesh in mesh()) {
            let bounds = |t: u32| {
                let [a, b, c] = mesh.triangles[t as usize].map(|i| mesh.positions[i as usize]);
                (a.inf(&b).inf(&c), a.sup(&b).sup(&c))
            };
            let meet = |t: u32, u: u32| {
                let ((low_t, high_t), (low_u, high_u)) = (bounds(t), bounds(u));
                (0..3).all(|i| low_t[i] <= high_u[i] && low_u[i] <= high_t[i])
            };
            let count = mesh.triangles.len() as u32;
            let all = (0..count).flat_map(|t| (t + 1..count).map(move |u| [t, u])).filter(|&[t, u]| meet(t, u));
            let all: Vec<_> = all.collect();
            let tree = ClosestPoint::new(&mesh).unwrap();
            prop_assert_eq!(&tree.meeting_pairs(|_, _| true), &all);
            prop_assert!(tree.meeting_pairs(|t, u| (t + u) % 2 == 0).iter().eq(all.iter().filter(|[t, u]| (t + u) % 2 == 0)));
        }

        #[test]
        fn the_closest_vertices_are_those_of_all(points in prop::collection::vec(point(), 1..120), q in point(),
                                                 k in 1usize..8, distance in 0.0..120.0) {
            let tree = ClosestVertices::new(&points).unwrap();
            let mut all: Vec<ClosestVertex> = points.iter().enumerate()
                .map(|(i, p)| ClosestVertex { vertex: i as u32, squared_distance: squared(sub((*p).into(), q.into())) })
                .collect();
            all.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.vertex.cmp(&b.vertex)));
            prop_assert_eq!(tree.query(&q), Some(all[0]));
            let mut found = Vec::new();
            tree.k_nearest(&q, k, &mut found);
            all.truncate(k);
            prop_assert_eq!(&found, &all);
            tree.k_nearest_within(&q, k, distance, &mut found);
            all.retain(|c| c.squared_distance <= distance * distance);
            prop_assert_eq!(&found, &all);
            let vertices = |found: &[ClosestVertex]| -> [u32; 8] {
                std::array::from_fn(|i| found.get(i).map_or(u32::MAX, |n| n.vertex))
            };
            let of_all = tree.neighbourhoods(k, |v, found| (v, vertices(found)));
            for (i, p) in points.iter().enumerate() {
                tree.k_nearest(p, k, &mut found);
                prop_assert_eq!(of_all[i], (i as u32, vertices(&found)));
            }
        }
    }

    #[test]
    fn slivers_and_triangles_without_area() {
        let (origin, x, two_x) = ([0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]);
        let (over, under) = ([1e-9, 0.0, 100.0], [0.0, 1e-9, 100.0]); // their distance has five digits, seen from afar
        let cases = [
            ([origin, x, two_x], [0.5, 1.0, 0.0], 1.0),
            ([origin; 3], [0.5, 1.0, 0.0], 1.25f64.sqrt()),
            ([x, x, origin], [0.5, 1.0, 0.0], 1.0),
            ([origin, x, [0.5, 1e-9, 0.0]], [0.5, 1.0, 0.0], 1.0),
            ([[100.0, 100.0, -2.0], over, under], over, 0.0),
            ([[0.0, 0.0, -3.0], under, over], [100.0, 100.0, 1.5], 2e4f64.sqrt()),
        ];
        for (corners, q, distance) in cases {
            let mesh = TriangleMesh { positions: corners.map(v).to_vec(), triangles: vec![[0, 1, 2]] };
            let found = ClosestPoint::new(&mesh).unwrap().query(&v(q)).unwrap();
            assert!((found.squared_distance.sqrt() - distance).abs() < 2e-9, "{distance} {found:?}");
            let by_weights: Vec3 = corners.iter().zip(found.barycentric).map(|(&corner, w)| v(corner) * w).sum();
            assert!((by_weights - found.point).norm() < 2e-9, "{by_weights} {found:?}");
        }
    }

    #[test]
    fn nothing_to_find_and_nothing_to_build() {
        let mut mesh = TriangleMesh { positions: vec![Vec3::zeros(); 3], triangles: vec![] };
        assert_eq!(ClosestPoint::new(&mesh).unwrap().query(&Vec3::zeros()), None);
        assert_eq!(ClosestVertices::new(&[]).unwrap().query(&Vec3::zeros()), None);
        mesh.triangles = vec![[0, 1, 2]; 300]; // all boxes alike
        let tree = ClosestPoint::new(&mesh).unwrap();
        assert_eq!(tree.query(&Vec3::x()).unwrap().triangle, 0);
        assert_eq!(tree.query(&Vec3::new(f64::NAN, 0.0, 0.0)), None);
        mesh.triangles.push([0, 1, 3]);
        assert!(matches!(
            ClosestPoint::new(&mesh),
            Err(MeshError::IndexOutOfRange { triangle: 300, index: 3, count: 3 })
        ));
        mesh.triangles.pop();
        mesh.positions[1].y = f64::NAN;
        assert!(matches!(ClosestPoint::new(&mesh), Err(MeshError::NotFinite { vertex: 1, .. })));
        assert!(ClosestVertices::new(&mesh.positions).is_err());
    }

    #[test]
    fn enormous_coordinates_neither_panic_nor_lose_the_answer() {
        let positions = [[1e300, 0.0, 0.0], [0.0, 1e300, 0.0], [0.0, 0.0, 1e300], [-1e300; 3]].map(v).to_vec();
        let mesh = TriangleMesh { positions, triangles: vec![[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3], [3, 3, 3]] };
        let tree = ClosestPoint::new(&mesh).unwrap();
        assert!(tree.query(&Vec3::repeat(-1e300)).is_some());
    }

    /// Large enough for halves that are built side by side; moved so far that the tree's boxes all overlap.
    #[test]
    fn a_moved_tree_answers_as_a_new_one() {
        let height = |c: f64, r: f64| noise((97.0 * c + r) as usize);
        let flat = sheet(81, 81, |c, r| Vec3::new(c, r, height(c, r)));
        let bent = sheet(81, 81, |c, r| Vec3::new(c * (0.1 * r).cos(), 40.0 * noise(r as usize), height(r, c)));
        let mut tree = ClosestPoint::new(&flat).unwrap();
        let queries: Vec<Vec3> = (0..60).map(|k| Vec3::from_fn(|a, _| 80.0 * noise(7 * k + a))).collect();
        for mesh in [&bent, &flat] {
            tree.move_to(&mesh.positions).unwrap();
            let new = ClosestPoint::new(mesh).unwrap();
            for q in &queries {
                let answers = [tree.query(q), new.query(q), tree.query_from_within(q, 5000, f64::INFINITY)];
                let by_hand =
                    (0..new.triangles.len()).map(|slot| new.closest(slot, (*q).into()).2).min_by(f64::total_cmp);
                assert_eq!(answers[0].map(|c| c.squared_distance), by_hand);
                assert!(answers.iter().all(|a| *a == answers[0]));
            }
        }
        let mut broken = bent.positions.clone();
        broken[3].x = f64::NAN;
        let refused = tree.move_to(&broken).unwrap_err();
        assert!(matches!(refused, MeshError::NotFinite { vertex: 3, .. }), "{refused}");
        assert_eq!(tree.query(&queries[0]), ClosestPoint::new(&flat).unwrap().query(&queries[0]), "left as it was");
    }
}
