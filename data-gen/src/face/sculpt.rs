//! The neutral face: a smooth head, and the features that make it a face.

use std::sync::LazyLock;

use nonrigid::mesh::Vec3;

use super::site::{Flat, Site, CLOSED_MOUTH, EYELIDS};
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

struct Profiles {
    y: Spline,
    front: Spline,
    width: Spline,
    depth: Spline,
    lift: Spline,
    nose: Spline,
    nose_width: Spline,
}

static PROFILES: LazyLock<Profiles> = LazyLock::new(|| Profiles {
    // Along the symmetry plane, by chart height: height and depth of the skin without nose and lips.
    y: Spline::new(&[
        (-150.0, -119.0), (-140.0, -118.5), (-132.0, -118.0), (-124.0, -116.8), (-116.0, -113.6), (-109.0, -108.6), (-101.0, -101.0),
        (-90.0, -90.0), (90.0, 90.0),
    ]),
    front: Spline::new(&[
        (-150.0, -43.0), (-140.0, -33.0), (-132.0, -25.0), (-124.0, -16.5), (-116.0, -10.0), (-109.0, -6.0), (-101.0, -4.0),
        (-85.0, -2.5), (-68.0, 0.0), (-50.0, 0.5), (-40.0, -1.0), (-25.0, -3.0),
        (-10.0, -5.0), (4.0, -5.0), (18.0, -1.5), (30.0, -1.0), (45.0, -3.5), (62.0, -9.5), (80.0, -20.0),
    ]),
    width: Spline::new(&[
        (-146.0, 42.0), (-120.0, 46.0), (-105.0, 50.0), (-90.0, 55.0), (-70.0, 61.5), (-50.0, 67.0), (-25.0, 71.0),
        (0.0, 72.0), (20.0, 72.0), (40.0, 70.0), (60.0, 66.0), (80.0, 60.0),
    ]),
    depth: Spline::new(&[(-146.0, 62.0), (-120.0, 75.0), (-90.0, 86.0), (-50.0, 92.0), (0.0, 97.0), (40.0, 92.0), (80.0, 80.0)]),
    lift: Spline::new(&[(-150.0, 50.0), (-120.0, 33.0), (-100.0, 19.0), (-80.0, 7.5), (-55.0, 0.0), (-20.0, 0.0), (90.0, 0.0)]),
    nose: Spline::new(&[
        (-53.0, 0.0), (-50.0, 1.0), (-48.0, 4.0), (-46.0, 10.0), (-43.5, 16.0), (-41.0, 18.8), (-38.0, 19.3), (-34.0, 17.8), (-25.0, 15.0),
        (-15.0, 10.0), (-5.0, 4.8), (4.0, 1.3), (12.0, 0.0), (20.0, 0.0),
    ]),
    nose_width: Spline::new(&[(-50.0, 8.0), (-44.0, 8.5), (-38.0, 10.5), (-30.0, 10.0), (-15.0, 8.5), (0.0, 8.0), (12.0, 9.0)]),
});

/// The left half, x >= 0.
fn left(site: &Site) -> Vec3 {
    let (x, y) = (site.x, site.y);
    let mut p = head(x, y);
    let eye = &site.left_eye;
    let up = site.mouth.eta.sin();

    // Sockets, brow ridge, cheek bone and the hollow under it, temple.
    p.z -= 6.5 * bell(x - 16.0, 6.0) * bell(y - 1.0, 9.0) + 2.5 * bell(x - 28.0, 13.0) * bell(y - 10.0, 5.0);
    p.z -= 2.0 * bell(x - 27.0, 12.0) * bell(y + 12.0, 6.0);
    let brow = 19.0 + 3.0 * bell(x - 36.0, 14.0) - 3.0 * ((x - 8.0) / 14.0).min(0.0).powi(2);
    p.z += 2.8 * bell(y - brow, 6.0) * (bell(x - 25.0, 16.0) + bell(x + 25.0, 16.0));
    let outward = Vec3::new(0.55, 0.0, 0.83);
    p += outward * (3.5 * bell(x - 52.0, 15.0) * bell(y + 24.0, 12.0) - 2.5 * bell(x - 52.0, 14.0) * bell(y + 60.0, 16.0));
    p += outward * (-2.0 * bell(x - 72.0, 12.0) * bell(y - 28.0, 16.0));

    // Nose: the ridge and the wing, melted together.
    let profiles = &*PROFILES;
    let ridge = profiles.nose.at(y).max(0.0) * (-(x / profiles.nose_width.at(y)).abs().powf(2.3)).exp();
    let wing = {
        let (u, v) = ((x - 13.0) / 6.8, (y + 41.5) / 7.8);
        10.5 * (1.0 - (u * u + v * v))
    };
    p.z += smooth_max(ridge, wing, 6.0) + 3.5 * bell(x, 11.0) * bell(y + 38.0, 7.0);
    p.z -= 1.2 * bell((x - 13.0).hypot(0.9 * (y + 41.5)) - 9.5, 2.0) * bell(x - 20.0, 5.0);
    p.z -= 2.5 * bell(x - 6.5, 2.6) * bell(y + 46.5, 1.8);

    // Fold from the nose to the mouth's corner.
    let fold = 22.0 + 0.36 * (-42.0 - y);
    p.z += fade(-(y + 38.0) / 6.0) * fade((y + 80.0) / 10.0) * (1.8 * bell(x - fold - 6.0, 6.0) - 0.8 * bell(x - fold, 2.5));

    // Philtrum.
    p.z += bell(y + 54.5, 4.5) * (0.9 * bell(x - 5.8, 1.9) - 0.9 * bell(x, 3.2));

    // Lips, chin.
    lips(&mut p, site, up);
    p.z += 4.5 * bell(x, 15.0) * bell(y + 101.5, 8.5) - 3.5 * bell(x, 17.0) * bell(y + 86.0, 4.5);

    // Lids over the eyeball.
    let (centre, radius) = EYEBALL;
    let [cx, cy, cz] = centre;
    let d2 = (p.x - cx).powi(2) + (p.y - cy).powi(2);
    let sphere = cz + (LID_RADIUS * LID_RADIUS - d2).max(0.0).sqrt() - 3.0 * (d2.sqrt() - LID_RADIUS).max(0.0);
    p.z = smooth_max(p.z, sphere, 4.5);
    let crease = eye.eta.sin().powi(2) * if eye.eta > 0.0 { bell(eye.r - 6.0, 1.3) } else { 0.5 * bell(eye.r - 6.5, 1.5) };
    p.z -= 1.1 * crease;
    // The opening is an almond rather than an ellipse.
    let (rise, opening) = (eye.eta.sin(), EYELIDS.half_heights[usize::from(eye.eta < 0.0)]);
    p.y += opening * rise * (rise.abs().powf(0.45) - 1.0) * bell(eye.r.max(0.0), 3.0);
    // The lids' margin turns in, onto the eyeball.
    let turned = eye.r.min(0.0) / EYELIDS.innermost;
    let outward = p - Vec3::from(centre);
    p += outward * (turned * turned * (EYEBALL_GAP + radius - outward.norm()) / outward.norm());
    p
}

/// The smooth head: rows of elliptic arcs.
fn head(x: f64, y: f64) -> Vec3 {
    let p = &*PROFILES;
    let angle = x / p.width.at(y);
    let back = 1.0 - angle.cos();
    Vec3::new(p.width.at(y) * angle.sin(), p.y.at(y) + p.lift.at(y) * back, p.front.at(y) - p.depth.at(y) * back)
}

/// Height of the red of the lips at an angle round the mouth, in rings.
pub(crate) fn lip_height(eta: f64) -> f64 {
    let (up, across) = eta.sin_cos();
    let x = across.abs() * CLOSED_MOUTH.half_width;
    let taper = (1.0 - across * across).max(0.0).sqrt();
    1.5 + taper * if up >= 0.0 { 7.3 + 1.1 * bell(x - 5.5, 3.0) - 0.6 * bell(x, 2.5) } else { 9.5 }
}

fn lips(p: &mut Vec3, site: &Site, up: f64) {
    let across = (site.mouth.eta.cos()).abs();
    let upper = up >= 0.0;
    let r = site.mouth.r;
    let x = across * CLOSED_MOUTH.half_width;
    // How far the red of the lips stands out.
    let taper = (1.0 - across * across).max(0.0).sqrt();
    let height = lip_height(site.mouth.eta);
    let out = taper.powf(0.8) * if upper { 6.5 } else { 7.5 };
    let t = (r / height).max(0.0);
    let swell = if t < 0.5 { (std::f64::consts::FRAC_PI_2 * t / 0.5).sin() } else { 0.62 + 0.38 * ((t - 0.5) / 0.5 * std::f64::consts::FRAC_PI_2).cos().max(0.0) };
    let skin = (-((r - height) / 7.0).max(0.0).powi(2)).exp();
    p.z += out * (0.45 + 0.55 * swell) * skin - 1.5 * bell(r, 2.0) * (0.2 + 0.8 * across.powi(4));
    p.z += 0.5 * bell(r - height, 0.9) * taper;
    // The line where they meet: an M.
    p.y += (-r.max(0.0) / 7.0).exp() * (0.5 * bell(x - 9.0, 5.0) - 0.9 * bell(x, 4.0) - 1.2 * across.powi(4));
    // Inside they part slowly.
    let gap = 0.02 * bell(r.max(0.0), 0.5) + 0.06 * r.min(0.0).powi(2) * taper;
    p.y += if upper { gap } else { -gap };
    p.z += 0.9 * r.min(0.0);
}

/// exp(-d^2 / 2 s^2).
pub(crate) fn bell(d: f64, s: f64) -> f64 {
    (-0.5 * (d / s).powi(2)).exp()
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
