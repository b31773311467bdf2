//! Triangles of one mesh that pass through each other.
//!
//! **What counts.** A pair of triangles whose *interiors* have a point in common. That is one rule for all pairs, whatever
//! vertices they share:
//!
//! - two triangles that cross along a segment count, also if they share a vertex;
//! - two triangles in one plane that overlap count: a flap folded by 180 degrees onto its neighbour over their common
//!   edge, a triangle that comes twice;
//! - touching does not count: a common corner or edge, whether by index or by position, and a corner or edge that rests on
//!   another triangle. Neither does a surface that passes through a triangle exactly along its own edges.
//! - Triangles without area, and those with a corner that is not finite, have no interior.
//!
//! **Exact.** The rule is decided by signs of orientation determinants alone, and these are right (adaptive precision,
//! Shewchuk 1997): the answer is that of exact arithmetic on the coordinates as given, as long as coordinates other than
//! zero are not smaller than 1e-90 times the largest. Order of vertices, triangles and threads do not matter. For two
//! triangles that are not in one plane: Guigue & Devillers 2003, with strict inequalities.

use rayon::prelude::*;
use robust::{Coord, Coord3D};

use super::{EvaluationError, check_triangles};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{TriangleMesh, Vec3};

/// Pairs of triangles whose interiors meet, lower index first, in lexicographic order. Crossing along a segment and
/// overlapping in one plane count, touching does not. Time is that of a closest-point search per triangle, plus the pairs found.
///
/// # Errors
/// When a triangle names a vertex that does not exist.
pub fn self_intersections(positions: &[Vec3], triangles: &[[u32; 3]]) -> Result<Vec<[u32; 2]>, EvaluationError> {
    check_triangles(triangles, positions.len())?;
    let positions = near_one(positions);
    let solid: Vec<u32> = (0..triangles.len() as u32)
        .into_par_iter()
        .filter(|&t| has_interior(&triangles[t as usize].map(|v| positions[v as usize])))
        .collect();
    let surface = TriangleMesh { triangles: solid.iter().map(|&t| triangles[t as usize]).collect(), positions };
    let tree = ClosestPoint::new(&surface).expect("proven: indices are checked, and corners of `solid` are finite");
    let corners = |t: u32| surface.triangles[t as usize].map(|v| surface.positions[v as usize]);
    let pairs = tree.meeting_pairs(|t, u| interiors_meet(&corners(t), &corners(u)));
    Ok(pairs.into_iter().map(|pair| pair.map(|t| solid[t as usize])).collect())
}

/// The points times a power of two that brings the largest coordinate near 1: exact, and determinants cannot overflow.
fn near_one(positions: &[Vec3]) -> Vec<Vec3> {
    let coordinates = positions.iter().flat_map(|p| p.iter()).filter(|x| x.is_finite());
    let largest = coordinates.fold(0.0f64, |largest, x| largest.max(x.abs()));
    let exponent = if largest > 0.0 { largest.log2().floor().clamp(-1000.0, 1000.0) as i32 } else { 0 };
    positions.iter().map(|p| p * 2f64.powi(-exponent)).collect()
}

type Corners = [Vec3; 3];

/// Which side of the plane through `a b c` the point `d` is on: positive where the three are counter-clockwise seen from.
fn side(a: &Vec3, b: &Vec3, c: &Vec3, d: &Vec3) -> f64 {
    if d == a || d == b || d == c {
        return 0.0; // as it is with shared vertices, without the work of finding out
    }
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p.x, y: p.y, z: p.z });
    -robust::orient3d(a, b, c, d)
}

/// Twice the signed area of the triangle seen along `axis`.
fn area_along(axis: usize, a: &Vec3, b: &Vec3, c: &Vec3) -> f64 {
    let [a, b, c] = [a, b, c].map(|p| Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] });
    robust::orient2d(a, b, c)
}

/// The axis along which a triangle with finite corners shows area; `None` if it has none.
fn visible_along([a, b, c]: &Corners) -> Option<usize> {
    (0..3).find(|&axis| area_along(axis, a, b, c) != 0.0)
}

fn has_interior(triangle: &Corners) -> bool {
    triangle.iter().all(|p| p.iter().all(|x| x.is_finite())) && visible_along(triangle).is_some()
}

/// Whether the interiors of two triangles with interiors have a point in common.
fn interiors_meet(a: &Corners, b: &Corners) -> bool {
    let a_beside_b = a.map(|p| side(&b[0], &b[1], &b[2], &p));
    if a_beside_b == [0.0; 3] {
        return interiors_meet_in_plane(a, b);
    }
    let Some(i) = apex(a_beside_b) else { return false };
    let b_beside_a = b.map(|p| side(&a[0], &a[1], &a[2], &p));
    let Some(j) = apex(b_beside_a) else { return false };
    // Both cross the line in which the planes meet. Apex first, on the positive side of the other's plane:
    let (mut a, mut b) = ([a[i], a[(i + 1) % 3], a[(i + 2) % 3]], [b[j], b[(j + 1) % 3], b[(j + 2) % 3]]);
    if a_beside_b[i] < 0.0 {
        b.swap(1, 2);
    }
    if b_beside_a[j] < 0.0 {
        a.swap(1, 2);
    }
    // a's open interval on that line ends at its edges 01 and 02, b's at its edges 02 and 01: each begins before the other ends.
    side(&a[0], &a[1], &b[0], &b[1]) < 0.0 && side(&a[0], &a[2], &b[0], &b[2]) > 0.0
}

/// The corner that is strictly on one side of a plane with neither of the others; `None` if no two are on opposite sides.
fn apex(sides: [f64; 3]) -> Option<usize> {
    let opposite = |x: f64, y: f64| (x > 0.0 && y < 0.0) || (x < 0.0 && y > 0.0);
    let alone = |x: f64, y: f64| y == 0.0 || opposite(x, y);
    (0..3).find(|&i| {
        let [x, y, z] = [0, 1, 2].map(|k| sides[(i + k) % 3]);
        (opposite(x, y) && alone(x, z)) || (opposite(x, z) && alone(x, y))
    })
}

/// The same in one plane: no edge of either has the other triangle wholly outside.
fn interiors_meet_in_plane(a: &Corners, b: &Corners) -> bool {
    let Some(axis) = visible_along(a) else { return false };
    let turned = |[p, q, r]: Corners| if area_along(axis, &p, &q, &r) > 0.0 { [p, q, r] } else { [p, r, q] };
    let (a, b) = (turned(*a), turned(*b));
    let separates =
        |a: &Corners, b: &Corners| (0..3).any(|i| b.iter().all(|p| area_along(axis, &a[i], &a[(i + 1) % 3], p) <= 0.0));
    !separates(&a, &b) && !separates(&b, &a)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::mesh::testing::{noise, sheet, side_by_side};

    type Grid = [[i64; 3]; 3];

    /// The rule by another route, in integers: intervals along the line of both planes as fractions (Möller 1997); in one
    /// plane, a common interior point of two convex sets by clipping one with the other's edges.
    fn reference(a: &Grid, b: &Grid) -> bool {
        let sub = |p: &[i64; 3], q: &[i64; 3]| [0, 1, 2].map(|k| i128::from(p[k]) - i128::from(q[k]));
        let cross = |u: [i128; 3], v: [i128; 3]| [1, 2, 0].map(|k| u[k] * v[(k + 1) % 3] - u[(k + 1) % 3] * v[k]);
        let dot = |u: [i128; 3], v: [i128; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        let normal = |t: &Grid| cross(sub(&t[1], &t[0]), sub(&t[2], &t[0]));
        let (na, nb) = (normal(a), normal(b));
        if na == [0; 3] || nb == [0; 3] {
            return false;
        }
        let line = cross(na, nb);
        let heights = |t: &Grid, n: [i128; 3], o: &[i64; 3]| [0, 1, 2].map(|i| dot(n, sub(&t[i], o)));
        let (ha, hb) = (heights(a, nb, &b[0]), heights(b, na, &a[0]));
        if line == [0; 3] {
            return ha == [0; 3] && overlap_by_clipping(a, b, na);
        }
        // open interval of a triangle on the line as two fractions with positive denominators
        let interval = |t: &Grid, h: [i128; 3]| {
            let along = [0, 1, 2].map(|i| dot(line, t[i].map(i128::from)));
            let mut ends = Vec::new();
            for i in 0..3 {
                let j = (i + 1) % 3;
                if h[i].signum() * h[j].signum() < 0 {
                    let d = h[j] - h[i];
                    ends.push(((along[i] * h[j] - along[j] * h[i]) * d.signum(), d.abs()));
                }
                if h[i] == 0 {
                    ends.push((along[i], 1));
                }
            }
            // only a triangle with corners on both sides has interior points on the line
            let crosses = h.iter().any(|&x| x > 0) && h.iter().any(|&x| x < 0);
            crosses.then(|| {
                let less = |x: &(i128, i128), y: &(i128, i128)| (x.0 * y.1).cmp(&(y.0 * x.1));
                (*ends.iter().min_by(|x, y| less(x, y)).unwrap(), *ends.iter().max_by(|x, y| less(x, y)).unwrap())
            })
        };
        let (Some((la, ua)), Some((lb, ub))) = (interval(a, ha), interval(b, hb)) else { return false };
        let before = |x: (i128, i128), y: (i128, i128)| x.0 * y.1 < y.0 * x.1;
        before(la, ub) && before(lb, ua)
    }

    /// Area left of `a` after clipping with the edges of `b` (Sutherland & Hodgman 1974), in homogeneous integers.
    fn overlap_by_clipping(a: &Grid, b: &Grid, normal: [i128; 3]) -> bool {
        let axis = (0..3).find(|&k| normal[k] != 0).unwrap();
        let flat = |p: &[i64; 3]| [i128::from(p[(axis + 1) % 3]), i128::from(p[(axis + 2) % 3])];
        let (a, mut b) = (a.map(|p| flat(&p)), b.map(|p| flat(&p)));
        let turn = |p: [i128; 2], q: [i128; 2], r: [i128; 3]| {
            (q[0] - p[0]) * (r[1] - p[1] * r[2]) - (q[1] - p[1]) * (r[0] - p[0] * r[2])
        };
        if turn(b[0], b[1], [b[2][0], b[2][1], 1]) < 0 {
            b.swap(1, 2);
        }
        let mut polygon: Vec<[i128; 3]> = a.iter().map(|p| [p[0], p[1], 1]).collect();
        for i in 0..3 {
            let (p, q) = (b[i], b[(i + 1) % 3]);
            let mut kept = Vec::new();
            for (k, &r) in polygon.iter().enumerate() {
                let s = polygon[(k + 1) % polygon.len()];
                let (hr, hs) = (turn(p, q, r), turn(p, q, s));
                if hr >= 0 {
                    kept.push(r);
                }
                if hr.signum() * hs.signum() < 0 {
                    let sign = (hr - hs).signum();
                    let cut = [0, 1, 2].map(|c| (s[c] * hr - r[c] * hs) * sign);
                    let common = cut.iter().fold(0i128, |g, &x| gcd(g, x.abs()));
                    kept.push(cut.map(|x| x / common));
                }
            }
            polygon = kept;
        }
        // area of a convex polygon: is any corner off the line through two others?
        let det = |p: [i128; 3], q: [i128; 3], r: [i128; 3]| {
            p[0] * (q[1] * r[2] - q[2] * r[1]) - p[1] * (q[0] * r[2] - q[2] * r[0]) + p[2] * (q[0] * r[1] - q[1] * r[0])
        };
        (2..polygon.len()).any(|k| (1..k).any(|j| det(polygon[0], polygon[j], polygon[k]) != 0))
    }

    fn gcd(a: i128, b: i128) -> i128 {
        if b == 0 { a } else { gcd(b, a % b) }
    }

    fn point(p: [i64; 3]) -> Vec3 {
        Vec3::from(p.map(|x| x as f64))
    }

    fn pairs(mesh: &TriangleMesh) -> Vec<[u32; 2]> {
        self_intersections(&mesh.positions, &mesh.triangles).unwrap()
    }

    fn brute_force(mesh: &TriangleMesh) -> Vec<[u32; 2]> {
        let corners = |t: usize| mesh.triangles[t].map(|v| mesh.positions[v as usize]);
        let n = mesh.triangles.len();
        let solid: Vec<bool> = (0..n).map(|t| has_interior(&corners(t))).collect();
        let all = (0..n).flat_map(|t| (t + 1..n).map(move |u| (t, u)));
        let meet = |&(t, u): &(usize, usize)| solid[t] && solid[u] && interiors_meet(&corners(t), &corners(u));
        all.filter(meet).map(|(t, u)| [t as u32, u as u32]).collect()
    }

    /// A closed sphere of latitude rings; poles are fans.
    fn sphere(centre: Vec3, radius: f64, rings: u32, spokes: u32) -> TriangleMesh {
        let at = |ring: f64, spoke: f64| {
            let (t, p) = (
                std::f64::consts::PI * ring / f64::from(rings),
                2.0 * std::f64::consts::PI * spoke / f64::from(spokes),
            );
            centre + Vec3::new(t.sin() * p.cos(), t.cos(), -t.sin() * p.sin()) * radius
        };
        let mut positions: Vec<Vec3> =
            (1..rings).flat_map(|r| (0..spokes).map(move |s| (r, s))).map(|(r, s)| at(r.into(), s.into())).collect();
        let (top, bottom) = (positions.len() as u32, positions.len() as u32 + 1);
        positions.extend([centre + Vec3::y() * radius, centre - Vec3::y() * radius]);
        let vertex = |r: u32, s: u32| (r - 1) * spokes + s % spokes;
        let mut triangles = Vec::new();
        for s in 0..spokes {
            triangles.push([top, vertex(1, s), vertex(1, s + 1)]);
            triangles.push([bottom, vertex(rings - 1, s + 1), vertex(rings - 1, s)]);
            for r in 1..rings - 1 {
                triangles.push([vertex(r, s), vertex(r + 1, s), vertex(r + 1, s + 1)]);
                triangles.push([vertex(r, s), vertex(r + 1, s + 1), vertex(r, s + 1)]);
            }
        }
        TriangleMesh { positions, triangles }
    }

    #[test]
    fn known_pairs() {
        let floor: Grid = [[0, 0, 0], [6, 0, 0], [0, 6, 0]];
        let cases: [(&str, Grid, bool); 22] = [
            ("crosses", [[1, 1, -1], [2, 2, 3], [1, 2, 3]], true),
            ("crosses and shares a vertex", [[0, 0, 0], [3, 3, 2], [2, 2, -2]], true),
            ("shares a vertex, rises on one side", [[0, 0, 0], [3, 3, 2], [2, 2, 5]], false),
            ("shares a vertex, an edge lies in the other", [[0, 0, 0], [2, 2, 0], [2, 2, 5]], false),
            ("neighbour in the plane", [[6, 0, 0], [0, 6, 0], [6, 6, 0]], false),
            ("neighbour bent by 90 degrees", [[0, 0, 0], [6, 0, 0], [0, 0, 6]], false),
            ("neighbour folded onto it", [[0, 0, 0], [6, 0, 0], [2, 2, 0]], true),
            ("the same", floor, true),
            ("the same, turned over", [[0, 0, 0], [0, 6, 0], [6, 0, 0]], true),
            ("inside it", [[1, 1, 0], [2, 1, 0], [1, 2, 0]], true),
            ("overlaps in the plane, no corner in the other", [[-1, 1, 0], [9, 1, 0], [4, 2, 0]], true),
            ("touches an edge in the plane", [[1, 0, 0], [3, 0, 0], [2, -3, 0]], false),
            ("touches a corner in the plane", [[0, 0, 0], [-3, 0, 0], [-2, -3, 0]], false),
            ("shares a vertex, overlaps in the plane", [[0, 0, 0], [5, 1, 0], [1, 5, 0]], true),
            ("a corner rests on it", [[1, 1, 0], [2, 2, 3], [1, 2, 3]], false),
            ("an edge rests on it", [[1, 1, 0], [2, 2, 0], [1, 2, 3]], false),
            ("edges cross in one point", [[3, -2, -2], [3, 2, 2], [3, -2, 2]], false),
            ("a corner on its edge, through the plane", [[3, 0, 0], [3, -2, 2], [3, -2, -2]], false),
            ("a corner on its edge, through its interior", [[3, 0, 0], [3, 2, 2], [3, 2, -2]], true),
            ("through the plane, past it", [[7, 7, -1], [7, 8, 3], [8, 7, 3]], false),
            ("parallel", [[0, 0, 1], [6, 0, 1], [0, 6, 1]], false),
            ("without area", [[1, 1, -1], [1, 1, 0], [1, 1, 1]], false),
        ];
        for (name, other, expected) in cases {
            assert_eq!(reference(&floor, &other), expected, "reference: {name}");
            let positions = floor.iter().chain(&other).map(|&p| point(p)).collect();
            let mesh = TriangleMesh { positions, triangles: vec![[0, 1, 2], [3, 4, 5]] };
            assert_eq!(pairs(&mesh).len(), usize::from(expected), "{name}");
        }
    }

    #[test]
    fn a_gap_of_the_last_bit_is_seen() {
        // A needle that stops short of, at, and just beyond a plane in no special position.
        let [a, b, c] = [Vec3::new(0.1, 0.2, 0.7), Vec3::new(10.3, 0.4, 1.1), Vec3::new(0.9, 11.7, -2.3)];
        let inside = a * 0.5 + b * 0.25 + c * 0.25;
        let tip = |z: f64| Vec3::new(inside.x, inside.y, z);
        let at = |z: f64| {
            let top = Vec3::new(inside.x, inside.y, 9.0);
            let positions = vec![a, b, c, tip(z), top, top + Vec3::x()];
            pairs(&TriangleMesh { positions, triangles: vec![[0, 1, 2], [3, 4, 5]] }).len()
        };
        // By bisection the last height that crosses; the next number does not.
        let (mut crosses, mut clear) = (inside.z - 1.0, inside.z + 1.0);
        assert_eq!((at(crosses), at(clear)), (1, 0));
        while crosses.next_up() < clear {
            let middle = crosses + (clear - crosses) / 2.0;
            if at(middle) == 1 { crosses = middle } else { clear = middle }
        }
        assert_eq!((at(crosses), at(crosses.next_up())), (1, 0));
        assert!((crosses - inside.z).abs() < 1e-14, "{crosses} {}", inside.z);
    }

    #[test]
    fn closed_and_crossing_spheres() {
        let one = sphere(Vec3::zeros(), 10.0, 18, 30);
        assert_eq!(pairs(&one), Vec::<[u32; 2]>::new());
        let other = sphere(Vec3::new(7.0, 1.3, -2.1), 9.0, 14, 27);
        let both = side_by_side(&one, &other);
        let found = pairs(&both);
        assert_eq!(found, brute_force(&both));
        assert!(
            found.len() > 100
                && found.iter().all(|[t, u]| (*t as usize) < one.triangles.len() && *u as usize >= one.triangles.len())
        );
        // A torn-off copy at the same place: every triangle is there twice, and meets its copy alone.
        let twice = pairs(&side_by_side(&one, &one));
        let n = one.triangles.len() as u32;
        assert_eq!(twice, (0..n).map(|t| [t, t + n]).collect::<Vec<_>>());
        // Inside each other without touching.
        assert!(pairs(&side_by_side(&one, &sphere(Vec3::zeros(), 9.0, 18, 30))).is_empty());
    }

    #[test]
    fn a_sheet_through_a_sheet() {
        // 10 x 10 squares in z = 0, and a wall of two triangles at y = 4.5 through both halves of 10 squares; the wall's own
        // diagonal goes through one of these halves.
        let floor = sheet(11, 11, |x, y| Vec3::new(x, y, 0.0));
        let wall = |low: f64| sheet(2, 2, move |x, z| Vec3::new(-1.0 + 12.4 * x, 4.5, low + 2.0 * z));
        assert_eq!(pairs(&side_by_side(&floor, &wall(-1.0))).len(), 20 + 1);
        // On top of it: touches, does not cross.
        assert_eq!(pairs(&side_by_side(&floor, &wall(0.0))).len(), 0);
        assert_eq!(pairs(&side_by_side(&floor, &wall(-2.0))).len(), 0);
    }

    #[test]
    fn permutations_change_nothing_but_names() {
        let mut mesh = side_by_side(&sphere(Vec3::zeros(), 5.0, 8, 12), &sphere(Vec3::x() * 3.0, 4.0, 9, 11));
        mesh.positions.iter_mut().enumerate().for_each(|(i, p)| *p += Vec3::repeat(0.1 * noise(i)));
        let n = mesh.triangles.len();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| noise(*a).total_cmp(&noise(*b)));
        let turned = |t: [u32; 3], by: usize| match by % 6 {
            k @ 0..3 => [t[k], t[(k + 1) % 3], t[(k + 2) % 3]],
            k => [t[k - 3], t[(k - 1) % 3], t[(k - 2) % 3]],
        };
        let triangles = order.iter().enumerate().map(|(i, &t)| turned(mesh.triangles[t], i)).collect();
        let shuffled = TriangleMesh { triangles, ..mesh.clone() };
        let mut found: Vec<[u32; 2]> = pairs(&shuffled)
            .iter()
            .map(|p| {
                let [t, u] = p.map(|t| order[t as usize] as u32);
                [t.min(u), t.max(u)]
            })
            .collect();
        found.sort_unstable();
        let expected = pairs(&mesh);
        assert!(expected.len() > 30);
        assert_eq!(found, expected);
    }

    #[test]
    fn bad_input_neither_panics_nor_counts() {
        let mut mesh = side_by_side(&sphere(Vec3::zeros(), 5.0, 8, 12), &sphere(Vec3::x() * 3.0, 4.0, 9, 11));
        let expected = pairs(&mesh);
        for factor in [1e300, 1e-300, 1e-30] {
            let scaled: Vec<Vec3> = mesh.positions.iter().map(|p| p * factor).collect();
            let found = self_intersections(&scaled, &mesh.triangles).unwrap();
            assert!(found.len().abs_diff(expected.len()) <= expected.len() / 10, "{factor}: {}", found.len());
        }
        mesh.triangles.extend([[0, 0, 0], [1, 1, 2], [0, 30, 0]]);
        assert_eq!(pairs(&mesh), expected);
        let [t, _] = expected[0];
        mesh.positions[mesh.triangles[t as usize][0] as usize].y = f64::NAN;
        let fewer = pairs(&mesh);
        assert!(fewer.len() < expected.len() && fewer.iter().all(|pair| pair[0] != t && expected.contains(pair)));
        assert_eq!(self_intersections(&[], &[]), Ok(vec![]));
        assert_eq!(
            self_intersections(&[Vec3::zeros()], &[[0, 0, 1]]),
            Err(EvaluationError::VertexIndex { triangle: 0, vertex: 1, vertices: 1 })
        );
        let odd = [Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::MAX), Vec3::repeat(-f64::MAX), Vec3::x()];
        assert_eq!(self_intersections(&odd, &[[0, 1, 2], [1, 2, 3], [0, 1, 3]]), Ok(vec![]));
    }

    fn grid_triangle() -> impl Strategy<Value = Grid> {
        let corner = || [-3i64..4, -3i64..4, -3i64..4];
        prop_oneof![
            [corner(), corner(), corner()],
            [corner(), corner(), corner()].prop_map(|t| t.map(|[x, y, _]| [x, y, 0]))
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6000))]

        /// On a coarse grid, where corners coincide, edges touch and planes agree most of the time.
        #[test]
        fn agrees_with_integer_arithmetic(a in grid_triangle(), b in grid_triangle()) {
            let positions: Vec<Vec3> = a.iter().chain(&b).map(|&p| point(p)).collect();
            let found = self_intersections(&positions, &[[0, 1, 2], [3, 4, 5]]).unwrap();
            prop_assert_eq!(found.len() == 1, reference(&a, &b));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn the_tree_misses_nothing(
            corners in prop::collection::vec([-4.0..4.0f64, -4.0..4.0f64, -4.0..4.0f64], 3..60),
            snapped in prop::collection::vec(any::<bool>(), 60),
            triangles in prop::collection::vec([0u32..1000, 0u32..1000, 0u32..1000], 1..120),
        ) {
            let n = corners.len() as u32;
            let positions = corners.iter().zip(snapped).map(|(p, snap)| {
                if snap { Vec3::from(*p).map(f64::round) } else { Vec3::from(*p) }
            });
            let triangles = triangles.into_iter().map(|t| t.map(|v| v % n)).collect();
            let mesh = TriangleMesh { positions: positions.collect(), triangles };
            prop_assert_eq!(pairs(&mesh), brute_force(&mesh));
        }
    }
}
