//! The face as a map from its flat domain into space, for any expression and person.

use std::f64::consts::{PI, TAU};

use nonrigid::mesh::{TriangleMesh, Vec3};
use rayon::prelude::*;

use super::layout::outline;
use super::rings::Around;
use super::sculpt::{EYEBALL, site};
use super::site::{EYELIDS, FLAT_MOUTH, Flat, Site, eye_point, flatten};
use crate::expressions::{Expression, expressions};
use crate::identity::IdentityModes;

/// Who a face is and what it does. Missing weights are 0.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FaceWeights {
    /// In the order of [`FaceModel::expression_names`]; 0 is neutral, 1 the full expression.
    pub expressions: Vec<f64>,
    /// Of the identity modes, in standard deviations.
    pub identity: Vec<f64>,
}

/// A sphere, millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eyeball {
    /// Its centre.
    pub centre: Vec3,
    /// Its radius.
    pub radius: f64,
}

impl Eyeball {
    /// Its surface as triangles, for pictures.
    #[must_use]
    pub fn surface(&self) -> TriangleMesh {
        const ROUND: usize = 48;
        const DOWN: usize = 24;
        let point = |k: usize| {
            let (around, down) = (TAU * (k % ROUND) as f64 / ROUND as f64, PI * (k / ROUND) as f64 / DOWN as f64);
            self.centre + Vec3::new(around.cos() * down.sin(), around.sin() * down.sin(), down.cos()) * self.radius
        };
        let vertex = |i: usize, j: usize| (j * ROUND + i % ROUND) as u32;
        let cells = (0..DOWN).flat_map(|j| (0..ROUND).map(move |i| (i, j)));
        let triangles = cells.flat_map(|(i, j)| {
            let [a, b, c, d] = [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1), vertex(i + 1, j)];
            [[a, b, c], [a, c, d]]
        });
        TriangleMesh { positions: (0..ROUND * (DOWN + 1)).map(point).collect(), triangles: triangles.collect() }
    }
}

/// A face of any resolution: positions of material points, exact everywhere and not at some mesh's vertices only.
///
/// position = neutral(u) + sum of expression weights x fields(u) + sum of identity weights x modes(u), `u` in the flat face.
pub struct FaceModel {
    expressions: Vec<Expression>,
    identity: IdentityModes,
    outline: Vec<Flat>,
}

impl FaceModel {
    /// The one face that there is, with `identity_modes` ways to differ from it.
    #[must_use]
    pub fn new(identity_modes: usize) -> Self {
        Self { expressions: expressions(), identity: IdentityModes::new(identity_modes), outline: outline() }
    }

    /// Names of the expressions, in the order of their weights.
    pub fn expression_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.expressions.iter().map(|e| &*e.name)
    }

    /// Number of identity modes.
    #[must_use]
    pub fn identity_modes(&self) -> usize {
        self.identity.len()
    }

    /// Whether a place of the flat plane belongs to the face: inside its outline and in none of its three openings.
    #[must_use]
    pub fn contains(&self, [u, v]: Flat) -> bool {
        // Crossings of the outline by the ray towards +u.
        let mut inside = false;
        for (k, a) in self.outline.iter().enumerate() {
            let b = self.outline[(k + 1) % self.outline.len()];
            if (a[1] > v) != (b[1] > v) && u < a[0] + (v - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                inside = !inside;
            }
        }
        let site = Site::flat([u, v]);
        let open = site.mouth.r <= FLAT_MOUTH.innermost;
        let eyes = [site.left_eye, site.right_eye].iter().any(|e| e.r <= EYELIDS.innermost);
        inside && !open && !eyes
    }

    /// The outer border in the flat plane: a closed polygon, counter-clockwise.
    #[must_use]
    pub fn outline(&self) -> &[Flat] {
        &self.outline
    }

    /// Where the material points `places` are, millimetres in the rig's coordinates.
    #[must_use]
    pub fn positions(&self, places: &[Flat], weights: &FaceWeights) -> Vec<Vec3> {
        self.positions_in_manner(places, weights, &|_| Vec3::repeat(1.0))
    }

    /// The same with the expressions' displacement multiplied, coordinate by coordinate, by `manner`.
    pub(crate) fn positions_in_manner(
        &self,
        places: &[Flat],
        weights: &FaceWeights,
        manner: &(dyn Fn(&Site) -> Vec3 + Sync),
    ) -> Vec<Vec3> {
        let expressions: Vec<(f64, &Expression)> =
            weights.expressions.iter().copied().zip(&self.expressions).filter(|e| e.0 != 0.0).collect();
        let identity = self.identity.mix(&weights.identity);
        places
            .par_iter()
            .map(|place| {
                let site = site(*place);
                let moved: Vec3 = expressions.iter().map(|(w, e)| e.displacement(&site) * *w).sum();
                site.neutral + moved.component_mul(&manner(&site)) + identity.displacement(&site)
            })
            .collect()
    }

    /// Displacement of each place at weight 1 of expression `k`.
    #[must_use]
    pub(crate) fn expression_deltas(&self, k: usize, sites: &[Site]) -> Vec<Vec3> {
        sites.par_iter().map(|s| self.expressions[k].displacement(s)).collect()
    }

    /// Displacement of each place at weight 1 of every identity mode.
    #[must_use]
    pub(crate) fn identity_deltas(&self, sites: &[Site]) -> Vec<Vec<Vec3>> {
        self.identity.deltas(sites)
    }

    /// The left and the right eyeball of a person: they move with the lids' corners.
    #[must_use]
    pub fn eyeballs(&self, weights: &FaceWeights) -> [Eyeball; 2] {
        let identity = self.identity.mix(&weights.identity);
        [1.0, -1.0].map(|side| {
            let (centre, radius) = EYEBALL;
            let rim = (0..32).map(|k| {
                let eta = f64::from(k) / 16.0 * PI;
                let [x, y] = eye_point(Around { r: 0.0, eta });
                identity.displacement(&site(flatten([side * x, y])))
            });
            let moved = rim.sum::<Vec3>() / 32.0;
            Eyeball { centre: Vec3::new(side * centre[0], centre[1], centre[2]) + moved, radius }
        })
    }
}
