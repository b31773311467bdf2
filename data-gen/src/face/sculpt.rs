//! The neutral face: a smooth head, and the features that make it a face.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nonrigid::mesh::Vec3;

use super::site::{CLOSED_MOUTH, EYELIDS, Flat, Site};
use super::spline::Spline;

/// Centre and radius of the left eyeball, millimetres.
pub(crate) const EYEBALL: ([f64; 3], f64) = ([30.6, 0.0, -25.5], 12.0);
/// How far the inner edges of the lids stay off the eyeball.
const EYEBALL_GAP: f64 = 0.1;
/// Radius of the outer surface of the lids about the eyeball's centre.
const LID_RADIUS: f64 = 13.2;

/// The site of a material point, neutral position included.
pub(crate) fn site(flat: Flat) -> Site {
    let mut site = Site::flat(flat);
    site.neutral = if site.x < 0.0 {
        let p = left(&site.mirrored());
        Vec3::new(-p.x, p.y, p.z)
    } else {
        left(&site)
    };
    site
}

/// Curves over the chart's height, millimetres.
struct Profiles {
    /// Height and depth of the skin on the symmetry plane, without nose and lips.
    y: Spline,
    front: Spline,
    /// Half axes of the head's rows.
    width: Spline,
    depth: Spline,
    /// How far a row has risen by the time it points backwards: the jaw's line.
    lift: Spline,
    /// How far the ridge of the nose stands out, and its half width.
    nose: Spline,
    nose_width: Spline,
}

static PROFILES: LazyLock<Profiles> = LazyLock::new(|| Profiles {
    // Along the symmetry plane, by chart height: height and depth of the skin without nose and lips.
    y: Spline::new(&[
        (-150.0, -119.0),
        (-140.0, -118.5),
        (-132.0, -118.0),
        (-124.0, -116.8),
        (-116.0, -113.6),
        (-109.0, -108.6),
        (-101.0, -101.0),
        (-90.0, -90.0),
        (90.0, 90.0),
    ]),
    front: Spline::new(&[
        (-150.0, -43.0),
        (-140.0, -33.0),
        (-132.0, -25.0),
        (-124.0, -16.5),
        (-116.0, -10.0),
        (-109.0, -6.0),
        (-101.0, -4.0),
        (-85.0, -2.5),
        (-68.0, 0.0),
        (-50.0, 0.5),
        (-40.0, -1.0),
        (-25.0, -3.0),
        (-10.0, -5.0),
        (4.0, -5.0),
        (18.0, -1.5),
        (30.0, -1.0),
        (45.0, -3.5),
        (62.0, -9.5),
        (80.0, -20.0),
    ]),
    width: Spline::new(&[
        (-146.0, 42.0),
        (-120.0, 46.0),
        (-105.0, 50.0),
        (-90.0, 55.0),
        (-70.0, 61.5),
        (-50.0, 67.0),
        (-25.0, 71.0),
        (0.0, 72.0),
        (20.0, 72.0),
        (40.0, 70.0),
        (60.0, 66.0),
        (80.0, 60.0),
    ]),
    depth: Spline::new(&[
        (-146.0, 62.0),
        (-120.0, 75.0),
        (-90.0, 86.0),
        (-50.0, 92.0),
        (0.0, 97.0),
        (40.0, 92.0),
        (80.0, 80.0),
    ]),
    lift: Spline::new(&[
        (-150.0, 50.0),
        (-120.0, 33.0),
        (-100.0, 19.0),
        (-80.0, 7.5),
        (-55.0, 0.0),
        (-20.0, 0.0),
        (90.0, 0.0),
    ]),
    nose: Spline::new(&[
        (-53.0, 0.0),
        (-50.0, 1.0),
        (-48.0, 4.0),
        (-46.0, 10.0),
        (-43.5, 16.0),
        (-41.0, 18.8),
        (-38.0, 19.3),
        (-34.0, 17.8),
        (-25.0, 15.0),
        (-15.0, 10.0),
        (-5.0, 4.8),
        (4.0, 1.3),
        (12.0, 0.0),
        (20.0, 0.0),
    ]),
    nose_width: Spline::new(&[
        (-50.0, 8.0),
        (-44.0, 8.5),
        (-38.0, 10.5),
        (-30.0, 10.0),
        (-15.0, 8.5),
        (0.0, 8.0),
        (12.0, 9.0),
    ]),
});

/// The left half, x >= 0. The features follow each other from the head outwards; each raises or lowers what is there.
fn left(site: &Site) -> Vec3 {
    let (x, y) = (site.x, site.y);
    let mut p = head(x, y);
    p += bones(x, y);
    p.z += nose(x, y) + round_the_mouth(x, y);
    p += lips(site);
    eyelids(p, site)
}

/// The smooth head: rows of elliptic arcs.
fn head(x: f64, y: f64) -> Vec3 {
    let p = &*PROFILES;
    let angle = x / p.width.at(y);
    let back = 1.0 - angle.cos();
    Vec3::new(p.width.at(y) * angle.sin(), p.y.at(y) + p.lift.at(y) * back, p.front.at(y) - p.depth.at(y) * back)
}

/// Eye sockets, brow ridge, cheek bone with the hollow under it, temple, chin.
fn bones(x: f64, y: f64) -> Vec3 {
    let at = |cx: f64, cy: f64, sx: f64, sy: f64| bell(x - cx, sx) * bell(y - cy, sy);
    let socket = 6.5 * at(16.0, 1.0, 6.0, 9.0) + 2.5 * at(28.0, 10.0, 13.0, 5.0) + 2.0 * at(27.0, -12.0, 12.0, 6.0);
    let brow_line = 19.0 + 3.0 * bell(x - 36.0, 14.0) - 3.0 * ((x - 8.0) / 14.0).min(0.0).powi(2);
    let brow = 2.8 * bell(y - brow_line, 6.0) * both(x, 25.0, 16.0);
    let cheek = 3.5 * at(52.0, -24.0, 15.0, 12.0) - 2.5 * at(52.0, -60.0, 14.0, 16.0);
    let temple = -2.0 * at(72.0, 28.0, 12.0, 16.0);
    let chin = 4.5 * at(0.0, -101.5, 15.0, 8.5) - 3.5 * at(0.0, -86.0, 17.0, 4.5);
    let outward = Vec3::new(0.55 * (x / 20.0).tanh(), 0.0, 0.83);
    outward * (cheek + temple) + Vec3::z() * (brow + chin - socket)
}

/// The ridge with its tip and the wing, melted together; the crease behind the wing, the nostril.
fn nose(x: f64, y: f64) -> f64 {
    let ridge = PROFILES.nose.at(y).max(0.0) * (-(x / PROFILES.nose_width.at(y)).abs().powf(2.3)).exp();
    let (u, v) = ((x - 13.0) / 6.8, (y + 41.5) / 7.8);
    let wing = 10.5 * (1.0 - (u * u + v * v));
    let tip = 3.5 * bell(x, 11.0) * bell(y + 38.0, 7.0);
    let crease = 1.2 * bell((x - 13.0).hypot(0.9 * (y + 41.5)) - 9.5, 2.0) * bell(x - 20.0, 5.0);
    let nostril = 2.5 * bell(x - 6.5, 2.6) * bell(y + 46.5, 1.8);
    smooth_max(ridge, wing, 6.0) + tip - crease - nostril
}

/// The fold from the nose past the mouth's corner, and the philtrum.
fn round_the_mouth(x: f64, y: f64) -> f64 {
    let line = 22.0 + 0.36 * (-42.0 - y);
    let along = fade(-(y + 38.0) / 6.0) * fade((y + 80.0) / 10.0);
    let fold = along * (1.8 * bell(x - line - 6.0, 6.0) - 0.8 * bell(x - line, 2.5));
    fold + 0.9 * bell(y + 54.5, 4.5) * (bell(x - 5.8, 1.9) - bell(x, 3.2))
}

/// Height of the red of the lips at an angle round the mouth, in rings: Cupid's bow above.
pub(crate) fn lip_height(eta: f64) -> f64 {
    let (up, across) = eta.sin_cos();
    let x = across * CLOSED_MOUTH.half_width;
    // Smooth past the corners.
    let rise = 1.15 * up * up / (up.abs() + 0.15);
    1.5 + rise * if up >= 0.0 { 7.3 + 1.1 * both(x, 5.5, 3.0) - 0.6 * bell(x, 2.5) } else { 9.5 }
}

/// What the lips add: they swell from the line where they meet, stand out at the red's border, and roll into the mouth.
fn lips(site: &Site) -> Vec3 {
    let (r, eta) = (site.mouth.r, site.mouth.eta);
    let outside = r.max(0.0);
    let (up, across) = eta.sin_cos();
    let (upper, corner) = (up >= 0.0, across.powi(4));
    let x = across * CLOSED_MOUTH.half_width;
    let height = lip_height(eta);

    // They vanish towards the corners: at once on the line, over a distance on the skin beside it.
    let beside = (outside / 20.0).powi(2);
    let taper = ((up * up + beside) / (1.0 + beside)).powf(0.4);
    let t = outside / height;
    let profile = if t < 0.5 { (PI * t).sin() } else { 0.62 + 0.38 * (PI * (t - 0.5)).cos().max(0.0) };
    let (meet, out) = (3.0, 7.0 - 0.5 * (up / 0.2).tanh());
    let skin = (-((r - height) / 7.0).max(0.0).powi(2)).exp();
    let swell = taper * (meet + (out - meet) * profile) * skin;
    let border = 0.5 * up.abs() * bell(r - height, 0.9);
    let groove = 1.5 * bell(r, 2.0) * (0.2 + 0.8 * corner);

    // The line itself is an M that falls at the corners.
    let line = (-outside / 7.0).exp() * (0.5 * both(x, 9.0, 5.0) - 1.0 * bell(x, 4.0) - 1.2 * corner);
    let inside = r.min(0.0);
    let gap = 0.02 * bell(outside, 0.5) + 0.06 * inside * inside * up.abs();
    Vec3::new(0.0, line + if upper { gap } else { -gap }, swell + border - groove + 0.9 * inside)
}

/// The lids: skin over the eyeball, a crease above, an almond opening whose margin turns in onto the eyeball.
fn eyelids(mut p: Vec3, site: &Site) -> Vec3 {
    let eye = &site.left_eye;
    let (centre, radius) = (Vec3::from(EYEBALL.0), EYEBALL.1);
    let beside = (p - centre).xy().norm();
    let (inside, outside) = ((LID_RADIUS - beside).max(0.0), (beside - LID_RADIUS).max(0.0));
    let ball = centre.z + (inside * (LID_RADIUS + beside)).sqrt() - 3.0 * outside;
    p.z = smooth_max(p.z, ball, 4.5);

    let rise = eye.eta.sin();
    let crease = if rise > 0.0 { bell(eye.r - 6.0, 1.3) } else { 0.5 * bell(eye.r - 6.5, 1.5) };
    p.z -= 1.1 * rise * rise * crease;
    let height = (EYELIDS.half_heights[usize::from(rise < 0.0)] + eye.r) * rise;
    p.y += height * (rise.abs().powf(0.45) - 1.0) * bell(eye.r.max(0.0), 3.0);

    let turned = eye.r.min(0.0) / EYELIDS.innermost;
    let outward = p - centre;
    p + outward * (turned * turned * (EYEBALL_GAP + radius - outward.norm()) / outward.norm())
}

/// exp(-d^2 / 2 s^2).
pub(crate) fn bell(d: f64, s: f64) -> f64 {
    (-0.5 * (d / s).powi(2)).exp()
}

/// Bells on both sides of the symmetry plane.
fn both(x: f64, centre: f64, s: f64) -> f64 {
    bell(x - centre, s) + bell(x + centre, s)
}

/// 0 below -1, 1 above 1, smooth between.
pub(crate) fn fade(t: f64) -> f64 {
    0.5 + 0.5 * (1.5 * t).tanh()
}

/// The larger of two, rounded where they differ by less than `k`.
fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    let near = (1.0 - (a - b).abs() / k).max(0.0);
    a.max(b) + 0.25 * k * near * near
}
