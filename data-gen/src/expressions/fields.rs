//! The vocabulary of the shapes: where the skin moves and which way.
//!
//! All of it is smooth on the flat face. Lips part only by what depends on the angle round the mouth; functions of the
//! chart alone move both of them alike.

use nonrigid::mesh::Vec3;

use crate::face::{Around, CLOSED_MOUTH, EYEBALL, EYELIDS, MOUTH, Site, bell, eye_point, fade, flatten, site};

/// 1 at a chart point, falling off like a Gaussian of the widths `[x, y]`.
pub(super) fn blob(s: &Site, [x, y]: [f64; 2], [wide, high]: [f64; 2]) -> f64 {
    bell(s.x - x, wide) * bell(s.y - y, high)
}

/// A vector of so many millimetres along the skin towards the subject's left, up, and out of the skin.
pub(super) fn along(s: &Site, [left, up, out]: [f64; 3]) -> Vec3 {
    // The head is about a cylinder, deeper than wide.
    let (sin, cos) = (s.x / 66.0).sin_cos();
    let tangent = Vec3::new(cos, 0.0, -1.4 * sin).normalize();
    tangent * left + Vec3::new(-tangent.z, 0.0, tangent.x) * out + Vec3::new(0.0, up, 0.0)
}

/// Moves a blob of skin.
pub(super) fn pull(s: &Site, at: [f64; 2], widths: [f64; 2], by: [f64; 3]) -> Vec3 {
    along(s, by) * blob(s, at, widths)
}

/// Moves a blob of skin and its mirror image.
pub(super) fn pull_both(s: &Site, at: [f64; 2], widths: [f64; 2], by: [f64; 3]) -> Vec3 {
    let right = pull(&s.mirrored(), at, widths, by);
    pull(s, at, widths, by) + Vec3::new(-right.x, right.y, right.z)
}

/// Wrinkles: waves of skin in a blob, across the direction `[x, y]` in which they repeat every `|[x, y]|` millimetres.
pub(super) fn wrinkles(s: &Site, at: [f64; 2], widths: [f64; 2], [x, y]: [f64; 2], height: f64) -> Vec3 {
    let phase = ((s.x - at[0]) * x + (s.y - at[1]) * y) / (x * x + y * y);
    pull(s, at, widths, [0.0, 0.0, height * (std::f64::consts::TAU * phase).cos()])
}

/// A crease along the line from `a` to `b` in the chart, `wide` millimetres.
pub(super) fn crease(s: &Site, a: [f64; 2], b: [f64; 2], wide: f64, depth: f64) -> Vec3 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = dx.hypot(dy);
    let (px, py) = (s.x - 0.5 * (a[0] + b[0]), s.y - 0.5 * (a[1] + b[1]));
    let (along_it, across) = ((px * dx + py * dy) / length, (px * dy - py * dx) / length);
    along(s, [0.0, 0.0, -depth * bell(along_it, 0.4 * length) * bell(across, wide)])
}

/// 1 in the middle of the upper lip's edge, 0 at the corners and below; reaching `reach` rings above the edge.
pub(super) fn upper_lip(s: &Site, reach: f64) -> f64 {
    s.mouth.eta.sin().max(0.0).powi(2) * bell(s.mouth.r.max(0.0), reach)
}

/// The same of the lower lip.
pub(super) fn lower_lip(s: &Site, reach: f64) -> f64 {
    s.mouth.eta.sin().min(0.0).powi(2) * bell(s.mouth.r.max(0.0), reach)
}

/// Parts the lips to an oval: each moves by `half`, corners stay.
pub(super) fn part_lips(s: &Site, half: f64, reach: f64) -> Vec3 {
    Vec3::new(0.0, half * s.mouth.eta.sin() * bell(s.mouth.r.max(0.0), reach), 0.0)
}

/// Draws the mouth together from the sides by a share of its width, and forward; `high` is how far up and down that reaches.
pub(super) fn purse(s: &Site, narrower: f64, forward: f64, high: f64) -> Vec3 {
    let evenly = |half: f64| (-(s.x / half).powi(4)).exp() * bell(s.y - MOUTH[1], high);
    along(s, [-narrower * s.x * evenly(36.0), 0.0, 0.0])
        + Vec3::new(0.0, 0.0, forward * evenly(27.0) * bell(s.y - MOUTH[1], high))
}

/// Turns the lips about their outer borders, inwards if positive; degrees in the middle of upper and lower lip. Their edges
/// move back or forward, not up or down.
pub(super) fn roll(s: &Site, [upper, lower]: [f64; 2]) -> Vec3 {
    let Around { r, eta } = s.mouth;
    if r > 40.0 {
        return Vec3::zeros();
    }
    let degrees = if eta > 0.0 { upper } else { -lower };
    let angle = degrees.to_radians() * eta.sin().powi(2);
    let on_ring = |r: f64| {
        let [x, y] = CLOSED_MOUTH.point(Around { r, eta });
        skin([MOUTH[0] + x, MOUTH[1] + y])
    };
    let border = on_ring(8.5);
    let (offset, edge) = (s.neutral - border, on_ring(1e-3) - border);
    let turned = turned_about_x(offset, angle * bell((r - 2.0).max(0.0), 4.0)) - offset;
    turned - Vec3::new(0.0, (turned_about_x(edge, angle) - edge).y * bell(r.max(0.0), 9.0), 0.0)
}

fn turned_about_x(v: Vec3, angle: f64) -> Vec3 {
    let (sin, cos) = angle.sin_cos();
    Vec3::new(v.x, cos * v.y - sin * v.z, sin * v.y + cos * v.z)
}

/// How much the skin drops with the jaw: all at the chin and the lower lip, a third at the corners of the mouth, hardly at
/// the upper lip and before the ears.
fn drops_with_jaw(s: &Site) -> f64 {
    let up = s.mouth.eta.sin();
    follows_jaw(s, (1.0 - up) * (0.5 - (1.0 + up) * (0.17 + 0.11 * up)))
}

/// How much it goes with a jaw that slides: the corners of the mouth half, the lips beside them alike.
pub(super) fn slides_with_jaw(s: &Site) -> f64 {
    let up = s.mouth.eta.sin();
    follows_jaw(s, 0.5 - 0.5 * up * up.abs())
}

/// Given how much the lips' edges follow.
fn follows_jaw(s: &Site, lips: f64) -> f64 {
    // The cheek stretches between cheek bone and jaw.
    let x2 = s.x * s.x;
    let cheek = fade((-71.0 - x2 / 300.0 - s.y) / (14.0 + x2 / 200.0));
    let beside = (s.x.abs() - CLOSED_MOUTH.half_width).max(0.0);
    let at_lips = bell(beside.hypot(s.y - MOUTH[1]), 11.0);
    (at_lips * lips + (1.0 - at_lips) * cheek) * (-(x2 / 5300.0).powi(2)).exp()
}

/// Opens the jaw: it turns about an axis through both joints in front of the ears, which glide forwards and down.
pub(super) fn open_jaw(s: &Site, degrees: f64, glide: Vec3) -> Vec3 {
    let offset = s.neutral - Vec3::new(0.0, -12.0, -75.0);
    (turned_about_x(offset, degrees.to_radians()) - offset + glide) * drops_with_jaw(s)
}

/// Neutral position of a chart point.
fn skin(at: [f64; 2]) -> Vec3 {
    site(flatten(at)).neutral
}

/// Closes the left eye: its lids slide over the eyeball, each by a share of the way to the other one, `[upper, lower]`.
pub(super) fn lids(s: &Site, [upper, lower]: [f64; 2]) -> Vec3 {
    let Around { r, eta } = s.left_eye;
    if r > 40.0 || (upper == 0.0 && lower == 0.0) {
        return Vec3::zeros();
    }
    let up = eta.sin();
    // Near the corners both lids do alike, so that they meet there on a straight line.
    let on_upper = 0.5 + 0.5 * (1.8 * up * up.abs()).tanh() / 1.8f64.tanh();
    // Here and across the opening: on the lids' edges, at the corners on the margins themselves.
    let ring = r.min(0.0) * (1.0 - up * up);
    let edge = |eta: f64| skin(eye_point(Around { r: ring, eta }));
    let (here, across) = (edge(eta), edge(-eta));
    // The very corners stay open, by less than half a millimetre.
    let opening = (across - here).norm_squared();
    let close = (lower + (upper - lower) * on_upper) * opening / (opening + 0.6);
    let centre = Vec3::from(EYEBALL.0);
    let follow = bell(r.max(0.0), 1.0 + (5.5 + 2.0 * on_upper) * up * up);
    let inside = r.min(0.0) / EYELIDS.innermost;
    // The margins of lids that close are pressed together.
    let pressed = if r < 0.0 { 0.6 * (upper + lower).max(0.0) * up * up } else { 0.0 };
    let moved = s.neutral + (across - here) * (close * follow) + (here - s.neutral) * pressed - centre;
    let sinks = (across - centre).norm() - (here - centre).norm();
    let radius = (s.neutral - centre).norm() + close * follow * (1.0 - inside) * sinks;
    centre + moved * (radius / moved.norm()) - s.neutral
}

/// Displacement that slides over the eyeballs wherever lids move, and little: their corners are tied to the bone.
pub(super) fn keep_off_eyeballs(s: &Site, mut displacement: Vec3) -> Vec3 {
    for (eye, side) in [(s.left_eye, 1.0), (s.right_eye, -1.0)] {
        if eye.r < 30.0 {
            displacement *= 1.0 - 0.85 * bell(eye.r.max(0.0), 5.0);
            let from_centre = s.neutral - Vec3::new(side * EYEBALL.0[0], EYEBALL.0[1], EYEBALL.0[2]);
            let moved = from_centre + displacement;
            displacement += moved * ((from_centre.norm() / moved.norm() - 1.0) * bell(eye.r.max(0.0), 5.0));
        }
    }
    displacement
}
