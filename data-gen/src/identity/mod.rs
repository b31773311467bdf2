//! Identity modes: the principal components of how faces differ.
//!
//! People differ by independent Gaussian amounts of some 270 smooth fields on the skin: the named [directions], and
//! patches all over the face that move along it, up and off it. With the fields D at the default template's vertices,
//! freed of rigid motion, and the amounts' deviations S, the covariance of faces is D S S D^T: the
//! modes are the left singular vectors of D S. Each is kept as its mixture of fields, so it has a value anywhere.

mod directions;

use std::sync::LazyLock;

use faer::Mat;
use nonrigid::mesh::Vec3;
use rayon::prelude::*;

use self::directions::{ASYMMETRIES, At, Direction, MIDDLE, PAIRS};
use crate::face::{Layout, Site, site};

/// Patches that move alike on both sides, and patches that move against each other.
const PATCHES: [usize; 2] = [40, 20];
/// Vertices of the layout whose places stand for the skin.
const SAMPLES: usize = 5000;

/// A smooth round spot, moved along the surface, up and off it.
struct Patch {
    /// In the chart, millimetres.
    centre: [f64; 2],
    radius: f64,
    /// Deviations of the three motions.
    sigma: [f64; 3],
    /// Of the other side's motion: 1 symmetric, -1 antisymmetric.
    parity: f64,
}

/// Evenly spread places in the chart's left half, the first of them large and strong. Beyond the face's border they do no
/// harm.
fn patches() -> Vec<Patch> {
    let place = |k: usize| [98.0 * halton(k, 2), 80.0 - 218.0 * halton(k, 3)];
    let on_face = |[x, y]: &[f64; 2]| (x / 98.0).powi(2) + ((y + 30.0) / 112.0).powi(2) < 1.0;
    let mut places = (1..).map(place).filter(on_face);
    let mut family = |count: usize, parity: f64, strength: f64| -> Vec<Patch> {
        let of_patch = |(k, centre)| {
            let share = k as f64 / count as f64;
            let sigma = [0.5, 0.5, 1.0].map(|axis| axis * strength * (-2.5 * share).exp());
            Patch { centre, radius: 20.0 - 12.0 * share, sigma, parity }
        };
        places.by_ref().take(count).enumerate().map(of_patch).collect()
    };
    let mut patches = family(PATCHES[0], 1.0, 0.9);
    patches.extend(family(PATCHES[1], -1.0, 0.25));
    patches
}

/// Element `k` of the van der Corput sequence in a base.
fn halton(mut k: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while k > 0 {
        digit /= base as f64;
        value += digit * (k % base) as f64;
        k /= base;
    }
    value
}

fn mirror(v: Vec3) -> Vec3 {
    Vec3::new(-v.x, v.y, v.z)
}

/// Infinitesimal translations and rotations.
fn rigid(p: Vec3) -> [Vec3; 6] {
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
    [axes[0], axes[1], axes[2], axes[0].cross(&p), axes[1].cross(&p), axes[2].cross(&p)]
}

/// The population: all fields and how the modes are mixed from them. It does not depend on any template.
struct Population {
    patches: Vec<Patch>,
    /// For each mode, the amount of each field in the order of [`Population::fields`], then of the rigid motions.
    mixing: Vec<Vec<f64>>,
}

static POPULATION: LazyLock<Population> = LazyLock::new(Population::new);

impl Population {
    fn new() -> Self {
        let mut population = Self { patches: patches(), mixing: Vec::new() };
        let sigmas = population.sigmas();
        let sites = reference();
        let fields: Vec<Vec<Vec3>> = sites.par_iter().map(|s| population.fields(s)).collect();
        let motions: Vec<[Vec3; 6]> = sites.iter().map(|s| rigid(s.neutral)).collect();
        let mut matrix = Mat::from_fn(3 * sites.len(), sigmas.len(), |i, j| sigmas[j] * fields[i / 3][j][i % 3]);
        let motion = Mat::from_fn(3 * sites.len(), 6, |i, j| motions[i / 3][j][i % 3]);

        // Each field less the rigid motion that is nearest to it.
        let basis = motion.qr();
        let orthonormal = basis.compute_thin_Q();
        let taken = orthonormal.transpose() * &matrix;
        matrix -= &orthonormal * &taken;
        let mut rigid_of = taken;
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            basis.thin_R(),
            rigid_of.as_mut(),
            faer::Par::Seq,
        );

        // The matrix is always this same one, and a test takes its decomposition: no input gets here.
        let svd = matrix.thin_svd().expect("the decomposition of the fixed fields converges");
        let right = svd.V();
        for k in 0..sigmas.len() {
            let mut column: Vec<f64> = (0..sigmas.len()).map(|j| right[(j, k)]).collect();
            let largest = column.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
            column.iter_mut().for_each(|c| *c *= largest.signum());
            let back = (0..6).map(|m| -column.iter().enumerate().map(|(j, c)| rigid_of[(m, j)] * c).sum::<f64>());
            let mixed: Vec<f64> = column.iter().zip(&sigmas).map(|(c, sigma)| c * sigma).chain(back).collect();
            population.mixing.push(mixed);
        }
        population
    }

    fn sigmas(&self) -> Vec<f64> {
        let named = MIDDLE.iter().chain(PAIRS).chain(ASYMMETRIES).map(|d| d.1);
        named.chain(self.patches.iter().flat_map(|p| p.sigma)).collect()
    }

    /// Every field there, in the order of the deviations.
    fn fields(&self, site: &Site) -> Vec<Vec3> {
        let twin = site.mirrored();
        let (at, other) = (At::new(site), At::new(&twin));
        let mut fields: Vec<Vec3> = Vec::new();
        fields.extend(MIDDLE.iter().map(|d| d.2(&at)));
        fields.extend(PAIRS.iter().map(|d| d.2(&at) + mirror(d.2(&other))));
        fields.extend(ASYMMETRIES.iter().map(|d| d.2(&at) - mirror(d.2(&other))));
        let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
        for patch in &self.patches {
            let here = at.spot(patch.centre, [patch.radius; 2]);
            let there = patch.parity * other.spot(patch.centre, [patch.radius; 2]);
            fields.extend(axes.map(|axis| at.local(axis) * here + mirror(other.local(axis)) * there));
        }
        fields
    }
}

/// Places that stand for the skin: the vertices of the default template, each counting as much as any other, as in the
/// components of meshes.
fn reference() -> Vec<Site> {
    Layout::new(SAMPLES).flat.par_iter().map(|f| site(*f)).collect()
}

/// Modes of falling variance, each scaled by its standard deviation.
pub(crate) struct IdentityModes {
    count: usize,
}

impl IdentityModes {
    /// The first `count` modes; there are as many as fields, some 270, at the most.
    pub fn new(count: usize) -> Self {
        Self { count: count.min(POPULATION.mixing.len()) }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    /// The person of these weights; missing ones are 0, superfluous ones are ignored.
    pub fn mix(&self, weights: &[f64]) -> Person {
        let mut amounts = vec![0.0; POPULATION.mixing.first().map_or(0, Vec::len)];
        for (weight, mode) in weights.iter().zip(&POPULATION.mixing[..self.count]) {
            amounts.iter_mut().zip(mode).for_each(|(a, m)| *a += weight * m);
        }
        Person::new(&amounts)
    }

    /// Each mode's displacement at weight 1, vertex by vertex.
    pub fn deltas(&self, sites: &[Site]) -> Vec<Vec<Vec3>> {
        let modes = &POPULATION.mixing[..self.count];
        let at_site = |site: &Site| {
            let mut fields = POPULATION.fields(site);
            fields.extend(rigid(site.neutral));
            let felt: Vec<(usize, Vec3)> = fields.into_iter().enumerate().filter(|f| f.1 != Vec3::zeros()).collect();
            modes.iter().map(|mode| felt.iter().map(|(j, f)| f * mode[*j]).sum()).collect()
        };
        let by_site: Vec<Vec<Vec3>> = sites.par_iter().map(at_site).collect();
        (0..self.count).map(|k| by_site.iter().map(|modes| modes[k]).collect()).collect()
    }
}

type Field = fn(&At) -> Vec3;

/// A sum of modes, as a sum of fields.
pub(crate) struct Person {
    middle: Vec<(f64, Field)>,
    /// Amounts of the field and of the other side's.
    sides: Vec<([f64; 2], Field)>,
    patches: Vec<(&'static Patch, Vec3)>,
    translation: Vec3,
    rotation: Vec3,
}

impl Person {
    /// The sum of all fields and the rigid motions in these amounts.
    fn new(amounts: &[f64]) -> Self {
        let mut rest = amounts.iter().copied();
        let mut take = |directions: &[Direction]| -> Vec<(f64, Field)> {
            directions.iter().map(|d| (rest.next().unwrap_or(0.0), d.2)).filter(|d| d.0 != 0.0).collect()
        };
        let middle = take(MIDDLE);
        let pairs = take(PAIRS).into_iter().map(|(amount, field)| ([amount; 2], field));
        let mut sides: Vec<([f64; 2], Field)> = pairs.collect();
        sides.extend(take(ASYMMETRIES).into_iter().map(|(amount, field)| ([amount, -amount], field)));
        let mut vector = || [0; 3].map(|_| rest.next().unwrap_or(0.0)).into();
        let patches = POPULATION.patches.iter().map(|p| (p, vector())).filter(|p| p.1 != Vec3::zeros()).collect();
        Self { middle, sides, patches, translation: vector(), rotation: vector() }
    }

    /// Millimetres.
    pub fn displacement(&self, site: &Site) -> Vec3 {
        let twin = site.mirrored();
        let (at, other) = (At::new(site), At::new(&twin));
        let mut left: Vec3 = self.middle.iter().map(|(amount, field)| field(&at) * *amount).sum();
        let mut right = Vec3::zeros();
        for ([here, there], field) in &self.sides {
            left += field(&at) * *here;
            right += field(&other) * *there;
        }
        let (mut here, mut there) = (Vec3::zeros(), Vec3::zeros());
        for (patch, motion) in &self.patches {
            here += motion * at.spot(patch.centre, [patch.radius; 2]);
            there += motion * (patch.parity * other.spot(patch.centre, [patch.radius; 2]));
        }
        left += at.local(here);
        right += other.local(there);
        left + mirror(right) + self.translation + self.rotation.cross(&site.neutral)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use nonrigid::evaluation::flipped_triangles;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::{FaceModel, FaceOptions, FaceRig, FaceWeights};

    const ALL: usize = 100;

    fn people(count: usize) -> Vec<Vec<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        (0..count).map(|_| (0..ALL).map(|_| StandardNormal.sample(&mut rng)).collect()).collect()
    }

    /// Inner products over the skin, mm^2 per vertex.
    fn products(a: &[Vec<Vec3>], b: &[Vec<Vec3>], weights: &[f64]) -> Vec<Vec<f64>> {
        let product = |a: &Vec<Vec3>, b: &Vec<Vec3>| a.iter().zip(b).zip(weights).map(|((a, b), w)| a.dot(b) * w).sum();
        a.iter().map(|a| b.iter().map(|b| product(a, b)).collect()).collect()
    }

    #[test]
    fn modes_are_orthogonal_have_falling_variance_and_no_rigid_motion() {
        let sites = reference();
        let weights = vec![1.0 / sites.len() as f64; sites.len()];
        let deltas = IdentityModes::new(ALL).deltas(&sites);
        assert_eq!(deltas.len(), ALL);
        let gram = products(&deltas, &deltas, &weights);
        let deviation: Vec<f64> = (0..ALL).map(|k| gram[k][k].sqrt()).collect();
        for k in 0..ALL {
            assert!(k == 0 || deviation[k] <= deviation[k - 1] * (1.0 + 1e-9));
            for j in 0..k {
                assert!(gram[k][j].abs() < 1e-8 * deviation[k] * deviation[j], "{k} {j}");
            }
        }
        let motions: Vec<Vec<Vec3>> = (0..6).map(|m| sites.iter().map(|s| rigid(s.neutral)[m]).collect()).collect();
        let own = products(&motions, &motions, &weights);
        for (m, with) in products(&motions, &deltas, &weights).iter().enumerate() {
            for (k, product) in with.iter().enumerate() {
                assert!(product.abs() < 1e-8 * own[m][m].sqrt() * deviation[k], "mode {k}, motion {m}: {product}");
            }
        }
        // As wide a spread as scanned people have, from head size down to details.
        let total = deviation.iter().map(|d| d * d).sum::<f64>().sqrt();
        assert!((3.7..4.8).contains(&total), "{total}");
        assert!((2.3..3.5).contains(&deviation[0]), "{}", deviation[0]);
        let decades = |k: usize| 2.0 * (deviation[0] / deviation[k]).log10();
        assert!((1.9..2.5).contains(&decades(19)) && (3.0..3.7).contains(&decades(59)), "{}", decades(59));
    }

    #[test]
    fn each_mode_is_symmetric_or_antisymmetric_and_the_sides_differ_little() {
        let sites = reference();
        let weights = vec![1.0 / sites.len() as f64; sites.len()];
        let twins: Vec<Site> = sites.iter().map(Site::mirrored).collect();
        let modes = IdentityModes::new(ALL);
        let (deltas, other) = (modes.deltas(&sites), modes.deltas(&twins));
        let (mut uneven, mut all) = (0.0, 0.0);
        for (k, (mode, other)) in deltas.iter().zip(&other).enumerate() {
            let norm = |difference: &dyn Fn(&Vec3, &Vec3) -> Vec3| -> f64 {
                mode.iter().zip(other).zip(&weights).map(|((a, b), w)| w * difference(a, b).norm_squared()).sum()
            };
            let variance = norm(&|a, _| *a);
            let (odd, even) = (norm(&|a, b| (a - mirror(*b)) * 0.5), norm(&|a, b| (a + mirror(*b)) * 0.5));
            assert!(odd.min(even) < 1e-12 * variance, "mode {k}: {odd} {even}");
            uneven += odd;
            all += variance;
        }
        assert!((0.005..0.03).contains(&(uneven / all)), "{}", uneven / all);
    }

    #[test]
    fn modes_are_functions_of_the_place_whatever_the_template() {
        let rig = |vertices| FaceRig::generate(&FaceOptions { vertices, identity_modes: ALL });
        let (coarse, fine) = (rig(1000), rig(5000));
        let key = |p: &[f64; 2]| p.map(|c| (c * 1e6).round() as i64);
        let at: BTreeMap<[i64; 2], usize> = coarse.places.iter().enumerate().map(|(v, p)| (key(p), v)).collect();
        let common: Vec<(usize, usize)> =
            fine.places.iter().enumerate().filter_map(|(v, p)| at.get(&key(p)).map(|c| (*c, v))).collect();
        assert!(common.len() > 20, "{}", common.len());
        for (a, b) in coarse.identities.iter().zip(&fine.identities) {
            assert!(common.iter().all(|(c, f)| (a[*c] - b[*f]).norm() < 1e-4));
        }
        let identity = people(1).remove(0);
        let weights = FaceWeights { identity: identity.clone(), ..FaceWeights::default() };
        let posed = coarse.pose(&[], &identity);
        for (rig, posed) in [(&fine, posed), (&coarse, fine.pose(&[], &identity))] {
            let other = if rig.places.len() > 2000 { &coarse } else { &fine };
            let direct = rig.model.as_ref().unwrap().positions(&other.places, &weights);
            assert!(direct.iter().zip(&posed).all(|(a, b)| (a - b).norm() < 1e-9));
        }
        assert_eq!(IdentityModes::new(7).deltas(&[site([0.0, 0.0])]).len(), 7);
        assert!(IdentityModes::new(100_000).len() > 2 * ALL);
    }

    /// Degrees between the normals on both sides of each edge.
    fn bends(positions: &[Vec3], triangles: &[[u32; 3]]) -> BTreeMap<(u32, u32), f64> {
        let mut first = BTreeMap::new();
        let mut bends = BTreeMap::new();
        for t in triangles {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            let normal = (b - a).cross(&(c - a)).normalize();
            for k in 0..3 {
                let edge = (t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3]));
                if let Some(other) = first.insert(edge, normal) {
                    bends.insert(edge, normal.dot(&other).clamp(-1.0, 1.0).acos().to_degrees());
                }
            }
        }
        bends
    }

    #[test]
    fn nothing_folds_at_three_deviations_of_a_mode_or_in_random_people() {
        for vertices in [5000, 20_000] {
            let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: ALL });
            let triangles = rig.mesh.triangulate().triangles;
            let before = bends(&rig.neutral, &triangles);
            let extremes = (0..2 * ALL).map(|k| {
                let mut weights = vec![0.0; ALL];
                weights[k / 2] = if k % 2 == 0 { 3.0 } else { -3.0 };
                weights
            });
            for (k, weights) in extremes.chain(people(100)).enumerate().step_by(if vertices > 10_000 { 7 } else { 1 }) {
                let posed = rig.pose(&[], &weights);
                assert_eq!(flipped_triangles(&rig.neutral, &posed, &triangles), Ok(0), "person {k}");
                for (edge, angle) in bends(&posed, &triangles) {
                    // Some edges at the corners of mouth and eyes are sharp already.
                    let was = before[&edge];
                    let at = rig.neutral[edge.0 as usize];
                    assert!(was > 45.0 || angle - was < 60.0, "person {k} folds from {was} to {angle} degrees at {at}");
                }
            }
        }
    }

    #[test]
    fn closed_lips_stay_closed_and_lids_stay_near_the_eyeballs() {
        let model = FaceModel::new(ALL);
        let neutral = model.eyeballs(&FaceWeights::default())[0];
        assert!((neutral.centre - Vec3::from(crate::face::EYEBALL.0)).norm() < 1e-9);
        let lip = |eta: f64, up: f64| [25.5 * eta.cos(), -68.0 + up * 4.2 * eta.sin()];
        let etas: Vec<f64> = (0..=60).map(|k| f64::from(k) / 60.0 * std::f64::consts::PI).collect();
        let [upper, lower] = [1.0, -1.0].map(|up| etas.iter().map(|eta| lip(*eta, up)).collect::<Vec<_>>());
        assert!(upper.iter().chain(&lower).all(|p| site(*p).mouth.r.abs() < 1e-6));
        // The margin of the left lids.
        let fine = FaceRig::generate(&FaceOptions { vertices: 20_000, identity_modes: 0 });
        let margin: Vec<[f64; 2]> = fine.places.iter().copied().filter(|p| site(*p).left_eye.r < -1.9).collect();
        assert!(margin.len() > 50);
        for (k, identity) in people(100).into_iter().enumerate() {
            let weights = FaceWeights { identity, ..FaceWeights::default() };
            let [a, b] = [&upper, &lower].map(|lip| model.positions(lip, &weights));
            let gap = a.iter().zip(&b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(gap < 0.2, "person {k}: lips {gap} mm apart");
            let ball = model.eyeballs(&weights)[0];
            for p in model.positions(&margin, &weights) {
                let gap = (p - ball.centre).norm() - ball.radius;
                assert!((-0.8..1.2).contains(&gap), "person {k}: lid {gap} mm off the eyeball at {p}");
            }
        }
    }
}
