//! The surface before the scanner: the posed face with its detail, a function of the flat place, and the eyeballs.

use nonrigid::mesh::{Pose, Vec3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::detail::Detail;
use super::domain::{Domain, Field, hole};
use super::manner::Manner;
use super::net::Net;
use crate::face::{EYEBALL, FaceModel, MOUTH, Site, flatten};
use crate::{Eyeball, FaceWeights, Flat};

/// Lattice of the flat face for stretch and normals, millimetres.
const STEP: f64 = 1.0;
/// How much of an eyeball lies about its optical axis in the scanned cap, radians.
const CAP: f64 = 1.4;

/// A face as it is posed.
pub(super) struct Surface<'a> {
    model: &'a FaceModel,
    weights: FaceWeights,
    pose: Pose,
    manner: Manner,
    detail: Detail,
    skin: Domain<'a>,
    /// Where detail points, times how much of it there is: none where lids and lips turn in.
    relief: Field,
    eyeballs: Vec<Eyeball>,
}

/// A sampled surface.
pub(super) struct Shell {
    pub skin: Net,
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// How many of the positions are the skin's; the others are the eyeballs'.
    pub skin_points: usize,
}

impl<'a> Surface<'a> {
    /// `contains` is [`FaceModel::contains`].
    pub fn new(
        model: &'a FaceModel,
        contains: &'a (dyn Fn(Flat) -> bool + Sync),
        weights: FaceWeights,
        pose: Pose,
        manner: Manner,
        detail: Detail,
        eyeballs: bool,
    ) -> Self {
        let mut loops = vec![model.outline().to_vec()];
        let eye = [EYEBALL.0[0], EYEBALL.0[1]];
        let openings = [MOUTH, flatten(eye), flatten([-eye[0], eye[1]])];
        loops.extend(openings.into_iter().map(|centre| hole(contains, centre)).filter(|l| !l.is_empty()));
        let skin = Domain::new(loops, STEP, contains, &|places| {
            model.positions_in_manner(places, &weights, &|site| manner.at(site))
        });
        let relief = skin.normals(|place| {
            let site = Site::flat(place);
            let lid = site.left_eye.r.min(site.right_eye.r);
            smooth(lid / 4.0) * smooth(site.mouth.r / 3.0)
        });
        let eyeballs = if eyeballs { model.eyeballs(&weights).to_vec() } else { Vec::new() };
        Self { model, weights, pose, manner, detail, skin, relief, eyeballs }
    }

    /// Where material points of the skin are, in scan coordinates.
    pub fn skin(&self, places: &[Flat]) -> Vec<Vec3> {
        let mut points = self.model.positions_in_manner(places, &self.weights, &|site| self.manner.at(site));
        points.par_iter_mut().zip(places).for_each(|(p, place)| {
            *p = self.pose.apply(*p + self.relief.at(*place) * self.detail.height(*place));
        });
        points
    }

    /// Samples it at about `points` points.
    pub fn sample(&self, points: usize, rng: &mut ChaCha8Rng) -> Shell {
        let cap = |eye: &Eyeball| std::f64::consts::TAU * eye.radius.powi(2) * (1.0 - CAP.cos());
        let density = points as f64 / (self.skin.area() + self.eyeballs.iter().map(cap).sum::<f64>());
        let skin = Net::new(&self.skin, (density * self.skin.area()) as usize, rng);
        let mut shell = Shell {
            positions: self.skin(&skin.places),
            triangles: skin.triangles(),
            skin_points: skin.places.len(),
            skin,
        };
        for eye in &self.eyeballs {
            let (radius, rim) = (eye.radius, 2.0 * eye.radius * (0.5 * CAP).sin());
            // Lambert's azimuthal projection: equal areas.
            let place = |[u, v]: &Flat| {
                let squared = (u * u + v * v) / radius.powi(2);
                let c = (1.0 - 0.25 * squared).max(0.0).sqrt();
                self.pose.apply(eye.centre + Vec3::new(u * c, v * c, radius * (1.0 - 0.5 * squared)))
            };
            let around = |k: usize| (std::f64::consts::TAU * k as f64 / 256.0).sin_cos();
            let border = (0..256).map(|k| [rim * around(k).1, rim * around(k).0]).collect();
            let contains = |[u, v]: Flat| u * u + v * v < rim * rim;
            let domain = Domain::new(vec![border], rim / 24.0, &contains, &|places| places.iter().map(place).collect());
            let net = Net::new(&domain, (density * cap(eye)) as usize, rng);
            let first = shell.positions.len() as u32;
            shell.positions.extend(net.places.iter().map(place));
            shell.triangles.extend(net.triangles().into_iter().map(|t| t.map(|v| v + first)));
        }
        shell
    }
}

/// 0 below 0, 1 above 1, smooth between.
pub(super) fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
