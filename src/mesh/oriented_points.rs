//! A cloud of points with normals, as a surface: every point is a disc in its tangent plane (a surfel; Pfister et al. 2000).
//!
//! A disc reaches as far as the sixth nearest neighbour of its point, so that discs overlap where the cloud is dense enough
//! to show a surface, but not beyond the edge of the cloud. The closest point of the cloud is taken to lie on the disc of the
//! nearest point.
//!
//! **Where a cloud ends** is decided by the angle criterion of Bendels, Schnabel & Klein, "Detecting holes in point set
//! surfaces", 2006: seen from a point in its tangent plane, the sixteen nearest neighbours of its own side (normals less than
//! 90 degrees apart) surround it, unless the cloud ends there. A gap between them of more than 120 degrees makes it a point
//! of the edge, and what lies on the gap's side of it lies beyond the edge. This is what the open boundary is to a mesh: it
//! depends on directions alone, not on how far from the cloud a query is.

use rayon::prelude::*;

use super::closest_point::{ClosestVertex, ClosestVertices};
use super::{MeshError, Vec3, check_finite, noise};

/// Neighbours that have to surround a point.
const NEIGHBOURS: usize = 16;

/// The neighbour up to which a disc reaches.
const DISC: usize = 6;

/// Widest gap between the directions to the neighbours of a point inside the cloud, radians.
const GAP: f64 = 2.0 * std::f64::consts::FRAC_PI_3;

/// The closest point of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestDisc {
    /// Index of the nearest point among [`OrientedPoints::points`].
    pub index: u32,
    /// The closest point of its disc, millimetres.
    pub point: Vec3,
    /// Unit normal of the disc.
    pub normal: Vec3,
    /// Distance to the disc, millimetres.
    pub distance: f64,
    /// Whether the query lies beyond the edge of the cloud.
    pub beyond_edge: bool,
}

/// Points with unit normals, prepared for closest-point queries. Queries only read, so threads may share it.
#[derive(Debug, Clone)]
pub struct OrientedPoints {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    radii: Vec<f64>,
    edges: Vec<Option<Edge>>,
    noise: Vec<f32>,
    area: f64,
    tree: ClosestVertices,
}

/// The way out of the cloud at a point of its edge.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edge {
    /// Unit vector in the tangent plane, along the gap's middle.
    outward: Vec3,
    /// Cosine of half the gap.
    cosine: f64,
}

impl OrientedPoints {
    /// Prepares a cloud. Points whose normal has no direction are left out, points at the same place become one;
    /// `smoothing` is how often each normal is averaged with its neighbours'.
    ///
    /// # Errors
    /// When a point is not finite.
    ///
    /// # Panics
    /// When there are not as many normals as points.
    pub fn new(positions: &[Vec3], normals: &[Vec3], smoothing: usize) -> Result<Self, MeshError> {
        assert_eq!(positions.len(), normals.len(), "one normal per point");
        check_finite(positions)?;
        let (points, mut normals) = merged(positions, normals);
        let tree = ClosestVertices::new(&points)?;
        let near = tree.neighbourhoods(2 * NEIGHBOURS + 1, |i, found| Near::new(i, found, &normals));
        for _ in 0..smoothing {
            let average = |i: usize| {
                let sum = near[i].vertices().iter().fold(normals[i], |sum, &v| sum + normals[v as usize]);
                sum.try_normalize(0.0).unwrap_or(normals[i])
            };
            normals = (0..points.len()).into_par_iter().map(average).collect();
        }
        let noise = noise(&points, &normals, |i| near[i].vertices());
        let radii = near.iter().map(|near| near.disc.sqrt()).collect();
        let edges: Vec<Option<Edge>> =
            (0..points.len()).into_par_iter().map(|i| edge(&points, normals[i], i, near[i].vertices())).collect();
        // Half the sector that neighbours fill, times the squared distance of the farthest, for each of them.
        let share = |(near, edge): (&Near, &Option<Edge>)| {
            let half_sector = std::f64::consts::PI - edge.map_or(0.0, |e| e.cosine.acos());
            if near.count == 0 { 0.0 } else { half_sector * near.farthest / near.count as f64 }
        };
        let area = near.iter().zip(&edges).map(share).sum();
        Ok(Self { points, normals, radii, edges, noise, area, tree })
    }

    /// The points that have a normal.
    #[must_use]
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Their unit normals, smoothed.
    #[must_use]
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Standard deviation of point `index` along its normal ([`noise()`]), millimetres.
    #[must_use]
    pub fn noise(&self, index: usize) -> f64 {
        self.noise[index].into()
    }

    /// Whether point `index` lies on the edge of the cloud.
    #[must_use]
    pub fn on_edge(&self, index: usize) -> bool {
        self.edges[index].is_some()
    }

    /// Estimated area of the surface, square millimetres: the sum of each point's share of the circle, or on the edge of the
    /// sector, up to its sixteenth neighbour.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.area
    }

    /// The nearest point no farther than the square root of `max_squared_distance`, or `None`.
    #[must_use]
    pub fn nearest(&self, query: &Vec3, max_squared_distance: f64) -> Option<ClosestVertex> {
        self.tree.query_within(query, max_squared_distance)
    }

    /// The closest point of the cloud, if a point lies no farther than the square root of `max_squared_distance`. Faster if
    /// point `hint` is near; the answer does not depend on it.
    #[must_use]
    pub fn query(&self, query: &Vec3, hint: Option<u32>, max_squared_distance: f64) -> Option<ClosestDisc> {
        let hint = hint.and_then(|i| self.points.get(i as usize));
        let bound = hint.map_or(f64::INFINITY, |p| (p - query).norm_squared()).min(max_squared_distance);
        let index = self.nearest(query, bound)?.vertex;
        let i = index as usize;
        let normal = self.normals[i];
        let offset = query - self.points[i];
        let along = offset - normal * normal.dot(&offset);
        let length = along.norm();
        let beyond_edge = self.edges[i].is_some_and(|e| along.dot(&e.outward) >= e.cosine * length);
        let reach = if beyond_edge { 0.0 } else { self.radii[i] };
        let point = self.points[i] + if length > reach { along * (reach / length) } else { along };
        Some(ClosestDisc { index, point, normal, distance: (query - point).norm(), beyond_edge })
    }
}

/// Points with a normal, each place once, and their unit normals.
fn merged(positions: &[Vec3], normals: &[Vec3]) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut order: Vec<usize> = (0..positions.len()).filter(|&i| normals[i].norm_squared() > 0.0).collect();
    let place = |i: usize| positions[i].map(|x| x + 0.0); // -0 is 0
    order.sort_unstable_by(|&a, &b| {
        let (p, q) = (place(a), place(b));
        let axes = (0..3).map(|axis| p[axis].total_cmp(&q[axis]));
        axes.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then).then(a.cmp(&b))
    });
    let mut kept: Vec<(usize, Vec3)> = Vec::with_capacity(order.len());
    for i in order {
        let normal = normals[i].normalize();
        match kept.last_mut() {
            Some((first, sum)) if place(*first) == place(i) => *sum += normal,
            _ => kept.push((i, normal)),
        }
    }
    kept.sort_unstable_by_key(|k| k.0);
    kept.into_iter().filter_map(|(i, sum)| Some((positions[i], sum.try_normalize(1e-6)?))).unzip()
}

/// The nearest neighbours of a point whose normals are less than 90 degrees from its own, nearest first. Clouds have millions of these.
#[derive(Clone, Copy, Default)]
struct Near {
    vertices: [u32; NEIGHBOURS],
    count: usize,
    /// Squared distance to the neighbour up to which a disc reaches, and to the last; 0 where there is none.
    disc: f64,
    farthest: f64,
}

impl Near {
    /// Those of point `i` among the nearest of all points.
    fn new(i: u32, found: &[ClosestVertex], normals: &[Vec3]) -> Self {
        let mut near = Self::default();
        let normal = normals[i as usize];
        let of_its_side = found.iter().filter(|n| n.vertex != i && normals[n.vertex as usize].dot(&normal) > 0.0);
        for neighbour in of_its_side.take(NEIGHBOURS) {
            near.vertices[near.count] = neighbour.vertex;
            near.count += 1;
            near.farthest = neighbour.squared_distance;
            if near.count <= DISC {
                near.disc = neighbour.squared_distance;
            }
        }
        near
    }

    fn vertices(&self) -> &[u32] {
        &self.vertices[..self.count]
    }
}

/// The widest gap between the directions to the neighbours of point `i`, if it is too wide.
fn edge(points: &[Vec3], normal: Vec3, i: usize, near: &[u32]) -> Option<Edge> {
    let u = normal.cross(&Vec3::ith(normal.iamin(), 1.0)).normalize();
    let w = normal.cross(&u);
    let direction = |&v: &u32| {
        let offset = points[v as usize] - points[i];
        offset.dot(&w).atan2(offset.dot(&u))
    };
    let mut angles: Vec<f64> = near.iter().map(direction).collect();
    angles.sort_unstable_by(f64::total_cmp);
    let Some(&first) = angles.first() else { return Some(Edge { outward: u, cosine: -1.0 }) };
    let after = angles.iter().skip(1).copied().chain([first + std::f64::consts::TAU]);
    let gaps = angles.iter().zip(after).map(|(&a, b)| (b - a, a));
    let (gap, start) = gaps.fold((0.0, 0.0), |widest, gap| if gap.0 > widest.0 { gap } else { widest });
    let (sin, cos) = (start + gap / 2.0).sin_cos();
    (gap > GAP).then(|| Edge { outward: u * cos + w * sin, cosine: (gap / 2.0).cos() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{self, sheet};

    /// A square of 20 mm in the plane z = 0, points about a millimetre apart.
    fn square(jitter: f64) -> Vec<Vec3> {
        let place = |c: f64, r: f64| {
            let i = (21.0 * r + c) as usize;
            Vec3::new(c + jitter * testing::noise(2 * i), r + jitter * testing::noise(2 * i + 1), 0.0)
        };
        sheet(21, 21, place).positions
    }

    fn cloud(points: &[Vec3]) -> OrientedPoints {
        OrientedPoints::new(points, &vec![Vec3::z() * 3.0; points.len()], 2).unwrap()
    }

    #[test]
    fn only_the_rim_of_a_square_is_its_edge() {
        let cloud = cloud(&square(0.0));
        for (i, p) in cloud.points().iter().enumerate() {
            let depth = p.x.min(20.0 - p.x).min(p.y).min(20.0 - p.y);
            assert_eq!(cloud.on_edge(i), depth == 0.0, "{p}");
        }
        assert!((cloud.area() - 420.0).abs() < 40.0, "{}", cloud.area());
    }

    #[test]
    fn beyond_the_edge_is_beyond_it_at_any_height_and_inside_is_inside() {
        let cloud = cloud(&square(0.3));
        for height in [0.0, 0.5, 30.0] {
            for i in 0..400 {
                let p = Vec3::new(10.0 + 14.0 * testing::noise(2 * i), 10.0 + 14.0 * testing::noise(2 * i + 1), height);
                let found = cloud.query(&p, None, f64::INFINITY).unwrap();
                let depth = p.x.min(20.0 - p.x).min(p.y).min(20.0 - p.y);
                // Within the jitter and one spacing either answer will do.
                if !(-0.5..=1.3).contains(&depth) {
                    assert_eq!(found.beyond_edge, depth < 0.0, "{p}");
                }
                if depth > 1.3 {
                    approx::assert_abs_diff_eq!(found.point, Vec3::new(p.x, p.y, 0.0), epsilon = 1e-12);
                    approx::assert_abs_diff_eq!(found.distance, height, epsilon = 1e-12);
                }
                for hint in [0, found.index, 440, 9999] {
                    assert_eq!(cloud.query(&p, Some(hint), f64::INFINITY), Some(found));
                }
            }
        }
        assert_eq!(cloud.query(&Vec3::new(10.0, 10.0, 5.0), None, 24.0), None);
    }

    #[test]
    fn a_hole_has_an_edge() {
        let points: Vec<Vec3> =
            square(0.0).into_iter().filter(|p| (p - Vec3::new(10.0, 10.0, 0.0)).norm() > 4.0).collect();
        let cloud = cloud(&points);
        for i in 0..200 {
            let p = Vec3::new(10.0 + 2.4 * testing::noise(2 * i), 10.0 + 2.4 * testing::noise(2 * i + 1), 0.2);
            let found = cloud.query(&p, None, f64::INFINITY).unwrap();
            assert!(found.beyond_edge, "{p}");
            assert!(found.distance > 0.2, "{p}: {found:?}");
        }
    }

    #[test]
    fn two_sheets_back_to_back_do_not_hide_each_others_edges() {
        let front = square(0.0);
        let back: Vec<Vec3> = front.iter().map(|p| p + Vec3::new(8.0, 0.0, -0.4)).collect();
        let points = [front.clone(), back].concat();
        let normals = [vec![Vec3::z(); 441], vec![-Vec3::z(); 441]].concat();
        let cloud = OrientedPoints::new(&points, &normals, 2).unwrap();
        for (i, p) in front.iter().enumerate() {
            assert_eq!(cloud.on_edge(i), p.x == 0.0 || p.x == 20.0 || p.y == 0.0 || p.y == 20.0, "{p}");
            assert_eq!(cloud.normals()[i], Vec3::z());
        }
    }

    #[test]
    fn points_without_a_normal_are_left_out_and_points_at_one_place_are_one() {
        let once = square(0.2);
        let mut points: Vec<Vec3> = once.iter().flat_map(|p| [*p; 3]).collect();
        let mut normals = vec![Vec3::new(0.0, 0.6, 0.8); points.len()];
        normals.iter_mut().step_by(3).for_each(|n| *n = Vec3::new(0.0, -1.2, 1.6));
        points.push(Vec3::new(10.0, 10.0, 3.0));
        normals.push(Vec3::zeros());
        let cloud = OrientedPoints::new(&points, &normals, 0).unwrap();
        assert_eq!(cloud.points(), once);
        let expected = Vec3::new(0.0, 0.6, 2.4).normalize();
        cloud.normals().iter().for_each(|n| approx::assert_abs_diff_eq!(*n, expected, epsilon = 1e-12));
        let nothing = OrientedPoints::new(&once, &vec![Vec3::zeros(); once.len()], 2).unwrap();
        assert!(nothing.points().is_empty() && nothing.query(&Vec3::zeros(), None, f64::INFINITY).is_none());
        assert!(OrientedPoints::new(&[Vec3::repeat(f64::NAN)], &[Vec3::z()], 0).is_err());
    }
}
