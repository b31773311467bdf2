//! How faces differ, direction by direction: what anthropometry measures, with its spread among adults.

use nonrigid::mesh::Vec3;

use crate::face::{EYEBALL, Site};

/// Centre of the left eye's opening, in the chart and in space.
const EYE: ([f64; 2], [f64; 3]) = ([31.5, 0.0], [31.5, 0.0, -13.0]);
/// How much of a field's change across an eye's opening is kept: eyes differ less than what is round them.
const EYE_SHARE: f64 = 0.2;

/// A site as the fields see it: near the eyes the coordinates are drawn together, so that what is not about the eyes moves
/// each nearly as one.
pub(super) struct At<'a> {
    /// Chart.
    pub x: f64,
    pub y: f64,
    /// Position.
    p: Vec3,
    site: &'a Site,
    /// Along the surface to the subject's left, and off it.
    across: Vec3,
    out: Vec3,
}

impl<'a> At<'a> {
    pub fn new(site: &'a Site) -> Self {
        let (mut x, mut y, mut p) = (site.x, site.y, site.neutral);
        for side in [1.0, -1.0] {
            let ([ex, ey], centre) = (EYE.0, Vec3::new(side * EYE.1[0], EYE.1[1], EYE.1[2]));
            let off = ((site.x - side * ex) / 14.0).hypot((site.y - ey) / 8.0);
            let lost = (1.0 - EYE_SHARE) * (1.0 - ramp((off - 0.9) / 1.4));
            x -= lost * (site.x - side * ex);
            y -= lost * (site.y - ey);
            p -= (site.neutral - centre) * lost;
        }
        let (sin, cos) = (x / 75.0).sin_cos();
        Self { x, y, p, site, across: Vec3::new(cos, 0.0, -sin), out: Vec3::new(sin, 0.0, cos) }
    }

    /// A vector given along the surface to the left, up, and off the surface.
    pub fn local(&self, v: Vec3) -> Vec3 {
        self.across * v.x + Vec3::y() * v.y + self.out * v.z
    }

    /// Nearly a Gaussian bell of these deviations, exactly 0 beyond 2.8 of them.
    pub fn spot(&self, centre: [f64; 2], spread: [f64; 2]) -> f64 {
        let (u, v) = ((self.x - centre[0]) / spread[0], (self.y - centre[1]) / spread[1]);
        (1.0 - (u * u + v * v) / 8.0).max(0.0).powi(4)
    }

    /// 0 above chart height `from`, 1 below `to`; the other way round if `to` is higher.
    fn beyond(&self, from: f64, to: f64) -> f64 {
        ramp((self.y - from) / (to - from))
    }

    /// 1 on the left eye's lids, 0 from 11 mm beside them.
    fn lids(&self) -> f64 {
        1.0 - ramp(self.site.left_eye.r / 11.0)
    }

    /// Motion of the left eye's lids, along the eyeball: only the part of (`dx`, `dy`, 0) that stays on the sphere.
    fn slide(&self, dx: f64, dy: f64) -> Vec3 {
        let (normal, motion) = ((self.site.neutral - Vec3::from(EYEBALL.0)).normalize(), Vec3::new(dx, dy, 0.0));
        (motion - normal * normal.dot(&motion)) * self.lids()
    }

    /// From the centre of the left eye's opening, in the chart.
    fn off_eye(&self) -> [f64; 2] {
        [self.site.x - EYE.0[0], self.site.y - EYE.0[1]]
    }

    /// Share of the upper (1) or lower (-1) lid or lip at an angle round it.
    fn part(eta: f64, side: f64) -> f64 {
        (side * eta.sin()).max(0.0).powi(3)
    }

    /// The red of the upper (1) or lower (-1) lip: 0 where the lips meet, 1 at its border, fading beyond.
    fn red(&self, side: f64, height: f64) -> f64 {
        let r = self.site.mouth.r;
        Self::part(self.site.mouth.eta, side) * ramp(r / height) * (1.0 - ramp((r - height) / 12.0))
    }
}

/// 0 below 0, 1 above 1, once differentiable.
fn ramp(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn x(v: f64) -> Vec3 {
    Vec3::new(v, 0.0, 0.0)
}

fn y(v: f64) -> Vec3 {
    Vec3::new(0.0, v, 0.0)
}

fn z(v: f64) -> Vec3 {
    Vec3::new(0.0, 0.0, v)
}

/// Name, standard deviation, displacement at 1: millimetres unless it is a stretch.
pub(super) type Direction = (&'static str, f64, fn(&At) -> Vec3);

/// Symmetric as they stand.
pub(super) const MIDDLE: &[Direction] = &[
    ("size", 0.042, |s| s.p),
    ("face width", 0.025, |s| x(s.p.x)),
    ("face height", 0.027, |s| y(s.p.y)),
    ("face depth", 0.045, |s| z(s.p.z)),
    ("lower face height", 1.7, |s| y(-s.beyond(-45.0, -115.0))),
    ("middle face height", 1.6, |s| y(-s.beyond(-5.0, -50.0))),
    ("lower face width", 0.036, |s| x(s.p.x * s.beyond(-25.0, -95.0))),
    ("upper face width", 0.020, |s| x(s.p.x * s.beyond(0.0, 55.0))),
    ("facial convexity", 2.1, |s| z(1.0 - ((s.y + 30.0) / 62.0).powi(2))),
    ("mandibular prognathism", 2.5, |s| z(s.beyond(-52.0, -100.0))),
    ("forehead slope", 2.9, |s| z(-s.beyond(18.0, 85.0))),
    ("flat face", 1.7, |s| z((s.x / 60.0).powi(2).min(2.5) - 0.5)),
    ("chin height", 1.6, |s| y(-s.spot([0.0, -112.0], [30.0, 14.0]))),
    ("chin protrusion", 1.7, |s| z(s.spot([0.0, -105.0], [22.0, 13.0]))),
    ("chin width", 1.4, |s| x((s.x / 14.0) * s.spot([0.0, -106.0], [20.0, 13.0]))),
    ("chin cleft", 0.45, |s| z(-s.spot([0.0, -104.0], [3.5, 7.0]))),
    ("fold below the lips", 0.9, |s| z(-s.spot([0.0, -87.0], [16.0, 5.5]))),
    ("under the chin", 1.5, |s| Vec3::new(0.0, -0.8, 0.6) * s.spot([0.0, -134.0], [32.0, 12.0])),
    ("nose length", 1.7, |s| y(-s.spot([0.0, -41.0], [15.0, 11.0]))),
    ("nose bridge height", 1.4, |s| z(s.spot([0.0, -12.0], [8.0, 13.0]))),
    ("nose hump", 0.80, |s| z(s.spot([0.0, -19.0], [6.0, 6.5]))),
    ("nose root depth", 1.2, |s| z(s.spot([0.0, 4.0], [9.0, 8.0]))),
    ("nose projection", 1.8, |s| z(s.spot([0.0, -37.0], [11.0, 13.0]))),
    ("nose tip rotation", 1.4, |s| Vec3::new(0.0, 1.0, 0.15) * s.spot([0.0, -38.0], [8.0, 9.0])),
    ("nose width", 1.7, |s| x((s.x / 13.0) * s.spot([0.0, -42.0], [14.0, 10.0]))),
    ("ball width", 0.9, |s| x((s.x / 6.0) * s.spot([0.0, -38.0], [7.0, 7.0]))),
    ("nose root width", 0.9, |s| x((s.x / 8.0) * s.spot([0.0, -8.0], [9.0, 13.0]))),
    ("columella", 0.80, |s| y(-s.spot([0.0, -47.0], [5.0, 5.0]))),
    ("glabella", 0.9, |s| z(s.spot([0.0, 19.0], [10.0, 9.0]))),
    ("forehead height", 2.6, |s| y(s.beyond(25.0, 85.0))),
    ("forehead bossing", 1.6, |s| z(s.spot([0.0, 52.0], [32.0, 17.0]))),
    ("mouth width", 2.0, |s| s.across * ((s.x / 25.0) * s.spot([0.0, -68.0], [24.0, 16.0]))),
    ("mouth height", 1.3, |s| y(s.spot([0.0, -68.0], [28.0, 14.0]))),
    ("mouth protrusion", 1.6, |s| z(s.spot([0.0, -68.0], [24.0, 14.0]))),
    ("mouth curve", 0.80, |s| y(((s.x / 20.0).powi(2) - 0.6) * s.spot([0.0, -68.0], [20.0, 12.0]))),
    ("upper lip thickness", 1.0, |s| Vec3::new(0.0, 1.0, 0.35) * s.red(1.0, 8.0)),
    ("lower lip thickness", 1.0, |s| Vec3::new(0.0, -1.0, 0.35) * s.red(-1.0, 10.0)),
    ("upper lip protrusion", 0.80, |s| z(s.red(1.0, 5.0))),
    ("lower lip protrusion", 0.80, |s| z(s.red(-1.0, 6.0))),
    ("philtrum depth", 0.40, |s| z(-s.spot([0.0, -54.5], [3.0, 5.0]))),
    ("Cupid's bow", 0.50, |s| y(-s.red(1.0, 8.0) * s.spot([0.0, -60.0], [4.0, 14.0]))),
];

/// On the subject's left; the right gets the mirror image.
pub(super) const PAIRS: &[Direction] = &[
    ("heaviness", 2.2, |s| {
        let cheek = s.spot([58.0, -62.0], [24.0, 28.0]) + 0.4 * s.spot([25.0, -105.0], [20.0, 14.0]);
        s.out * cheek + Vec3::new(0.0, -0.8, 0.4) * s.spot([20.0, -132.0], [28.0, 14.0])
    }),
    ("jaw width", 1.7, |s| s.out * s.spot([78.0, -74.0], [20.0, 22.0])),
    ("gonial angle", 2.1, |s| y(-s.spot([76.0, -84.0], [20.0, 18.0]))),
    ("jaw hollow", 0.9, |s| s.out * -s.spot([44.0, -98.0], [16.0, 12.0])),
    ("jowls", 1.0, |s| Vec3::new(0.5, -0.7, 0.3) * s.spot([42.0, -100.0], [13.0, 11.0])),
    ("square chin", 1.0, |s| s.local(Vec3::new(0.3, 0.0, 1.0)) * s.spot([18.0, -107.0], [9.0, 9.0])),
    ("cheekbone width", 1.7, |s| s.out * s.spot([70.0, -18.0], [18.0, 15.0])),
    ("cheekbone prominence", 1.7, |s| s.out * s.spot([46.0, -24.0], [15.0, 12.0])),
    ("cheekbone height", 1.3, |s| y(s.spot([50.0, -24.0], [17.0, 15.0]))),
    ("cheek fullness", 1.6, |s| s.out * s.spot([48.0, -60.0], [17.0, 20.0])),
    ("cheek fat", 1.3, |s| s.out * s.spot([33.0, -38.0], [12.0, 12.0])),
    ("tear trough", 0.80, |s| z(-s.spot([24.0, -18.0], [10.0, 6.5]))),
    ("nasolabial fold", 0.80, |s| z(s.spot([34.0, -56.0], [7.0, 13.0]) - s.spot([24.0, -56.0], [5.0, 12.0]))),
    ("wing flare", 1.0, |s| Vec3::new(0.5, 0.0, 0.6) * s.spot([15.0, -42.0], [6.0, 6.5])),
    ("nostril height", 0.9, |s| y(s.spot([12.0, -46.5], [7.0, 6.0]))),
    ("beside the nose", 1.0, |s| z(s.spot([20.0, -34.0], [9.0, 12.0]))),
    ("eye distance", 1.6, |s| s.across * s.spot([31.5, 1.0], [22.0, 17.0])),
    ("eye height", 1.2, |s| y(s.spot([31.5, 2.0], [26.0, 18.0]))),
    ("eye depth", 1.6, |s| z(-s.spot([30.0, 2.0], [20.0, 14.0]))),
    ("eye size", 0.045, |s| {
        let [dx, dy] = s.off_eye();
        s.slide(dx, 0.4 * dy)
    }),
    ("upper lid", 0.80, |s| s.slide(0.0, At::part(s.site.left_eye.eta, 1.0))),
    ("lower lid", 0.50, |s| s.slide(0.0, At::part(s.site.left_eye.eta, -1.0))),
    ("eye tilt", 0.9, |s| s.slide(0.0, s.off_eye()[0] / 14.0)),
    ("lid fold", 0.9, |s| z(s.spot([34.0, 12.0], [13.0, 5.0]))),
    ("inner socket", 0.80, |s| z(s.spot([16.0, 4.0], [7.0, 9.0]))),
    ("bags below the eyes", 0.65, |s| Vec3::new(0.0, -0.4, 0.8) * s.spot([31.0, -13.0], [12.0, 4.5])),
    ("brow height", 1.6, |s| y(s.spot([32.0, 20.0], [24.0, 11.0]))),
    ("brow ridge", 1.3, |s| z(s.spot([24.0, 19.0], [17.0, 7.0]))),
    ("brow tilt", 0.9, |s| y(s.spot([47.0, 18.0], [11.0, 10.0]) - s.spot([15.0, 18.0], [9.0, 10.0]))),
    ("brow distance", 0.80, |s| x(s.spot([14.0, 19.0], [10.0, 9.0]))),
    ("frontal eminence", 1.2, |s| s.out * s.spot([28.0, 50.0], [17.0, 14.0])),
    ("temple hollow", 1.6, |s| s.out * -s.spot([70.0, 24.0], [15.0, 17.0])),
    ("side of the face", 1.7, |s| s.out * s.spot([90.0, -35.0], [18.0, 28.0])),
];

/// How the sides differ: half of what is between the left, given here, and the mirrored right.
pub(super) const ASYMMETRIES: &[Direction] = &[
    ("nose bent", 0.38, |s| x(s.spot([0.0, -34.0], [11.0, 14.0]))),
    ("bridge bent", 0.26, |s| x(s.spot([0.0, -14.0], [8.0, 9.0]))),
    ("jaw to one side", 0.59, |s| x(s.beyond(-55.0, -110.0))),
    ("mouth to one side", 0.34, |s| x(s.spot([0.0, -68.0], [26.0, 15.0]))),
    ("mouth tilted", 0.34, |s| y((s.x / 25.0) * s.spot([0.0, -68.0], [26.0, 15.0]))),
    ("one eye lower", 0.34, |s| y(-s.spot([31.5, 2.0], [22.0, 17.0]))),
    ("one eye deeper", 0.26, |s| z(-s.spot([31.5, 0.0], [20.0, 14.0]))),
    ("one eye more open", 0.17, |s| s.slide(0.0, At::part(s.site.left_eye.eta, 1.0))),
    ("one brow higher", 0.43, |s| y(s.spot([32.0, 20.0], [22.0, 10.0]))),
    ("one cheek fuller", 0.51, |s| s.out * s.spot([50.0, -50.0], [20.0, 22.0])),
    ("one jaw angle wider", 0.59, |s| s.out * s.spot([76.0, -78.0], [18.0, 18.0])),
    ("one nostril lower", 0.21, |s| y(-s.spot([12.0, -45.0], [7.0, 7.0]))),
    ("one side forward", 0.43, |s| z((s.x / 40.0).tanh())),
    ("chin oblique", 0.3, |s| y((s.x / 18.0) * s.spot([0.0, -108.0], [22.0, 12.0]))),
];
