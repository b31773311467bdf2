//! The point of a triangle that is closest to the origin.

use super::Point;

#[inline(always)]
pub(super) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(super) fn squared(a: Point) -> f64 {
    a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
}

/// Closest point to the origin of a segment: weight of `b`, the point, its squared length.
#[inline(always)]
fn closest_on_segment(a: Point, b: Point) -> (f64, Point, f64) {
    let along = sub(b, a);
    let length = squared(along);
    let t = -dot(a, along);
    // not(>) so that a segment without length is its first end
    let (t, point) = if !(t > 0.0 && length > 0.0) {
        (0.0, a)
    } else if t >= length {
        (1.0, b)
    } else {
        let t = t / length;
        (t, [a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]])
    };
    (t, point, squared(point))
}

/// Where the line through the origin along `d` meets triangle `a b c` whose front faces along `d`: barycentric coordinates, and how
/// many unit vectors `d` that is. Borders belong to it, and a little beyond, so that a line between two triangles meets one of them (Möller &
/// Trumbore 1997).
#[inline(always)]
pub(super) fn on_line(a: Point, b: Point, c: Point, d: Point) -> Option<([f64; 3], f64)> {
    const BEYOND: f64 = -1e-9;
    let (ab, ac) = (sub(b, a), sub(c, a));
    let normal = cross(ab, ac);
    let (facing, area) = (dot(normal, d), squared(normal));
    // what is seen from its edge, or is a sliver, has no side, and where it is met would be rounding
    if !(facing > 0.0 && facing * facing > 1e-10 * area && area > 1e-14 * squared(ab) * squared(ac)) {
        return None;
    }
    let moment = cross(d, a);
    let (v, w) = (-dot(ac, moment) / facing, dot(ab, moment) / facing);
    let u = 1.0 - v - w;
    let met = u >= BEYOND && v >= BEYOND && w >= BEYOND;
    met.then(|| ([u.max(0.0), v.max(0.0), w.max(0.0)], dot(normal, a) / facing))
}

/// Closest point to the origin of triangle `a b c`: barycentric coordinates, the point, its squared length.
///
/// Inside, by the sub-triangles' areas along the normal (whose relative error is that of the normal, not of its square,
/// so slivers stay accurate); otherwise on a side that the projection lies beyond.
#[inline(always)]
pub(super) fn closest_on_triangle(a: Point, b: Point, c: Point) -> ([f64; 3], Point, f64) {
    /// Where the squares of area, sides and distance are in this proportion, the normal has ten digits; with fewer the projection along it
    /// may miss the triangle.
    const ROUNDED: f64 = 1e-12;
    let (ab, ac) = (sub(b, a), sub(c, a));
    let normal = cross(ab, ac);
    let areas = [dot(normal, cross(b, c)), dot(normal, cross(c, a)), dot(normal, cross(a, b))];
    let inside = areas.map(|area| area > 0.0);
    let mut beyond = inside.map(|inside| !inside);
    let mut best = ([1.0, 0.0, 0.0], a, f64::INFINITY);
    if inside == [true; 3] {
        let sum = areas[0] + areas[1] + areas[2];
        let w = [areas[0] / sum, areas[1] / sum, areas[2] / sum];
        let (area, sides) = (squared(normal), squared(ab) + squared(ac));
        if area > ROUNDED * sides * (sides + squared(a)) {
            // the projection of the origin along the normal
            let height = dot(normal, a) / area;
            best = (w, [height * normal[0], height * normal[1], height * normal[2]], 0.0);
        } else {
            // a sliver, or small and far away: a point of it, which one of a side may be closer than
            let point = [0, 1, 2].map(|i| w[0] * a[i] + w[1] * b[i] + w[2] * c[i]);
            best = (w, point, squared(point));
            beyond = [true; 3];
        }
    }
    if beyond[2] {
        let (t, point, d) = closest_on_segment(a, b);
        if d < best.2 {
            best = ([1.0 - t, t, 0.0], point, d);
        }
    }
    if beyond[0] {
        let (t, point, d) = closest_on_segment(b, c);
        if d < best.2 {
            best = ([0.0, 1.0 - t, t], point, d);
        }
    }
    if beyond[1] {
        let (t, point, d) = closest_on_segment(c, a);
        if d < best.2 {
            best = ([t, 0.0, 1.0 - t], point, d);
        }
    }
    let (barycentric, mut point, _) = best;
    // rounding may have left the triangle's box: see "Ties" of the module
    for i in 0..3 {
        let low = a[i].min(b[i]).min(c[i]);
        let high = a[i].max(b[i]).max(c[i]);
        point[i] = if point[i] < low {
            low
        } else if point[i] > high {
            high
        } else {
            point[i]
        };
    }
    (barycentric, point, squared(point))
}
