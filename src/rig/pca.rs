//! Principal components of a population of shapes: how faces differ, as identity modes of a rig.

use std::path::Path;

use faer::diag::DiagMut;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::svd::{ComputeSvdVectors, SvdError, svd, svd_scratch};
use faer::{MatMut, MatRef, Par};

use super::{Family, Population, PopulationError, Rig, RigError, RigWarning, Shape};
use crate::io::{WriteError, write_folder, write_npy};
use crate::mesh::{PolygonMesh, Vec3};

/// Singular values below this mean nothing, whatever the data: their squares would vanish.
const SMALLEST: f64 = 1e-150;

/// The mean of a population and the `K` directions in which it varies most.
///
/// With the `N` shapes of `V` vertices as vectors `x_i` of `3 V` coordinates and their mean `m`, the columns of
/// `X = [x_1 - m, ..., x_N - m]` have the singular value decomposition `X = C S W'`. The components are the first columns
/// `c_k` of `C`, and `sigma_k = s_k / sqrt(N - 1)` is the sample standard deviation along `c_k` (Jolliffe, *Principal
/// Component Analysis*, 2nd ed. 2002, section 3.5). Decomposing `X` itself, not the Gram matrix `X' X`, keeps all digits of
/// the small ones.
///
/// Components are orthonormal, those of larger variance come first, and the coordinate of largest magnitude of each, the
/// first of equals, is positive. The same shapes give the same bits at any number of threads.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapePca {
    mean: Vec<Vec3>,
    /// Component by component, vertex by vertex, x y z.
    components: Vec<f64>,
    standard_deviations: Vec<f64>,
    total_variance: f64,
}

/// What [`ShapePca::write_components`] writes.
pub const COMPONENT_FILES: [&str; 2] = ["components.npy", "standard_deviations.npy"];

impl ShapePca {
    /// The first `components` principal components of a population. Differences of pose are variance like any other: see
    /// [`Population::align`]. Vertices of no polygon stay at their mean.
    ///
    /// Time `O(V N min(N, 3 V))`, memory two matrices of `3 V x N`.
    ///
    /// # Errors
    /// When `components` is not 1 to `min(N - 1, 3 V)`, or some of them have zero variance: no more than rounding leaves.
    pub fn fit(population: &Population, components: usize) -> Result<Self, PopulationError> {
        let samples = population.samples();
        let (count, vertices) = (samples.len(), population.vertex_count());
        let width = 3 * vertices;
        let most = (count - 1).min(width);
        if !(1..=most).contains(&components) {
            return Err(PopulationError::Components { asked: components, samples: count, vertices, most });
        }
        let mean = mean_shape(samples);
        let mut centred = Vec::with_capacity(width * count);
        let on_surface = population.on_surface();
        for sample in samples {
            let of = |((p, m), on): ((&Vec3, &Vec3), &bool)| if *on { p - m } else { Vec3::zeros() };
            centred.extend(sample.iter().zip(&mean).zip(&on_surface).flat_map(|each| <[f64; 3]>::from(of(each))));
        }
        let (singular_values, mut left) =
            thin_svd(&centred, width, count).map_err(|_| PopulationError::Decomposition { samples: count })?;
        drop(centred);
        left.truncate(components * width);
        left.shrink_to_fit();

        let magnitude = samples.iter().flatten().map(Vec3::norm_squared).sum::<f64>().sqrt();
        // What the decomposition and taking the mean round.
        let noise = f64::EPSILON * (width.max(count) as f64 * singular_values[0] + magnitude);
        let rank = singular_values[..most].iter().filter(|&&s| s > noise.max(SMALLEST)).count();
        if components > rank {
            return Err(PopulationError::Rank { asked: components, samples: count, rank });
        }
        left.chunks_exact_mut(width).for_each(fix_sign);
        let freedom = (count - 1) as f64;
        let total_variance = singular_values.iter().map(|s| s * s).sum::<f64>() / freedom;
        let standard_deviations = singular_values[..components].iter().map(|s| s / freedom.sqrt()).collect();
        Ok(Self { mean, components: left, standard_deviations, total_variance })
    }

    /// The mean shape, `V` positions, millimetres.
    #[must_use]
    pub fn mean(&self) -> &[Vec3] {
        &self.mean
    }

    /// `c_k`: `3 V` numbers without unit, vertex by vertex, x y z.
    ///
    /// # Panics
    /// When there is no component `k`.
    #[must_use]
    pub fn component(&self, k: usize) -> &[f64] {
        let width = 3 * self.mean.len();
        &self.components[k * width..(k + 1) * width]
    }

    /// `sigma_k` of each component, falling, millimetres: the length of a vector of all `3 V` coordinates. Over
    /// `sqrt(V)` it is the root mean square way of a vertex.
    #[must_use]
    pub fn standard_deviations(&self) -> &[f64] {
        &self.standard_deviations
    }

    /// Variance of the whole population, in the components and besides, square millimetres.
    #[must_use]
    pub fn total_variance(&self) -> f64 {
        self.total_variance
    }

    /// Share of the total variance that each component explains.
    #[must_use]
    pub fn explained(&self) -> Vec<f64> {
        self.standard_deviations.iter().map(|s| s * s / self.total_variance).collect()
    }

    /// Weights of a shape, `w_k = c_k' (x - m) / sigma_k`: in standard deviations, of the shape of the components closest to
    /// it. The shape has to lie in the population's pose.
    ///
    /// # Panics
    /// When the shape has not `V` vertices.
    #[must_use]
    pub fn weights(&self, shape: &[Vec3]) -> Vec<f64> {
        assert_eq!(shape.len(), self.mean.len(), "a shape of another topology");
        let weight = |(k, sigma): (usize, &f64)| {
            let vertices = self.component(k).chunks_exact(3).zip(shape.iter().zip(&self.mean));
            vertices.map(|(c, (p, m))| Vec3::new(c[0], c[1], c[2]).dot(&(p - m))).sum::<f64>() / sigma
        };
        self.standard_deviations.iter().enumerate().map(weight).collect()
    }

    /// The shape `m + sum_k w_k sigma_k c_k`; weights that are not given are zero.
    ///
    /// # Panics
    /// When there are more weights than components.
    #[must_use]
    pub fn shape(&self, weights: &[f64]) -> Vec<Vec3> {
        assert!(weights.len() <= self.standard_deviations.len(), "more weights than components");
        let mut shape = self.mean.clone();
        for (k, (weight, sigma)) in weights.iter().zip(&self.standard_deviations).enumerate() {
            for (p, c) in shape.iter_mut().zip(self.component(k).chunks_exact(3)) {
                *p += Vec3::new(c[0], c[1], c[2]) * (weight * sigma);
            }
        }
        shape
    }

    /// A rig whose neutral is the mean and whose identity modes `identity000`, ... are `sigma_k c_k`, so that weights of the
    /// population have standard deviation 1. The polygons, if any, are those of `mesh`. Modes that move no vertex by more
    /// than [`MOTIONLESS_SHARE`](super::MOTIONLESS_SHARE) are dropped and reported.
    ///
    /// # Errors
    /// When `mesh` has another number of vertices, or a mode exceeds 32 bits.
    pub fn to_rig(&self, mesh: Option<&PolygonMesh>) -> Result<(Rig, Vec<RigWarning>), RigError> {
        let mesh = mesh.map(|m| {
            let same = m.positions.len() == self.mean.len();
            if same { m.with_positions(self.mean.clone()) } else { m.clone() } // refused by the rig
        });
        let name = |k| Shape { name: format!("identity{k:03}"), family: Family::Identity };
        let shapes = (0..self.standard_deviations.len()).map(name).collect();
        let scaled = self.standard_deviations.iter().enumerate();
        let deltas = scaled.flat_map(|(k, sigma)| self.component(k).iter().map(move |c| (c * sigma) as f32)).collect();
        Rig::new(self.mean.clone(), mesh, shapes, deltas)
    }

    /// All components, one by one, vertex by vertex, x y z.
    #[must_use]
    pub fn components(&self) -> &[f64] {
        &self.components
    }

    /// Components as [`fit`](Self::fit) has found them: [`mean`](Self::mean), [`components`](Self::components),
    /// [`standard_deviations`](Self::standard_deviations), [`total_variance`](Self::total_variance).
    ///
    /// # Errors
    /// When lengths do not fit.
    pub fn of_parts(
        mean: Vec<Vec3>,
        components: Vec<f64>,
        standard_deviations: Vec<f64>,
        total_variance: f64,
    ) -> Result<Self, RigError> {
        let (found, expected) = (components.len() / 3, mean.len() * standard_deviations.len());
        if components.len() != 3 * expected {
            return Err(RigError::VertexCount { what: "the components".into(), found, expected });
        }
        Ok(Self { mean, components, standard_deviations, total_variance })
    }

    /// Writes a rig, [as it writes itself](Rig::write), and the [components](Self::write_components) that it was made of, into one
    /// folder: all files or none.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write_with(&self, rig: &Rig, folder: &Path) -> Result<(), WriteError> {
        write_folder(folder, |aside| {
            rig.write_into(aside)?;
            self.write_components(aside)
        })
    }

    /// Writes `components.npy` (K, V, 3) and `standard_deviations.npy` (K), both in 64 bits: what the rig's modes have
    /// rounded and multiplied. The mean is the rig's neutral.
    ///
    /// # Errors
    /// When a file cannot be written; the folder has to be there.
    pub fn write_components(&self, folder: &Path) -> Result<(), WriteError> {
        let count = self.standard_deviations.len();
        write_npy(&folder.join("components.npy"), &[count, self.mean.len(), 3], &self.components)?;
        write_npy(&folder.join("standard_deviations.npy"), &[count], &self.standard_deviations)
    }
}

/// The mean, in two passes: the second takes out what the first has rounded.
fn mean_shape(samples: &[Vec<Vec3>]) -> Vec<Vec3> {
    let mut mean = vec![Vec3::zeros(); samples[0].len()];
    for _ in 0..2 {
        let mut rest = vec![Vec3::zeros(); mean.len()];
        for sample in samples {
            rest.iter_mut().zip(sample).zip(&mean).for_each(|((r, p), m)| *r += p - m);
        }
        mean.iter_mut().zip(rest).for_each(|(m, r)| *m += r / samples.len() as f64);
    }
    mean
}

/// Singular values, falling, and left singular vectors, one after the other, of a matrix given column by column. A matrix
/// that is much longer than wide, or wider than long, is first reduced by a QR decomposition.
fn thin_svd(columns: &[f64], rows: usize, count: usize) -> Result<(Vec<f64>, Vec<f64>), SvdError> {
    let size = rows.min(count);
    let (mut values, mut left) = (vec![0.0; size], vec![0.0; rows * size]);
    let (vectors, params) = ((ComputeSvdVectors::Thin, ComputeSvdVectors::No), Default::default());
    // On one thread, so that sums do not depend on how many there are.
    let mut scratch = MemBuffer::new(svd_scratch::<f64>(rows, count, vectors.0, vectors.1, Par::Seq, params));
    svd(
        MatRef::from_column_major_slice(columns, rows, count),
        DiagMut::from_slice_mut(&mut values),
        Some(MatMut::from_column_major_slice_mut(&mut left, rows, size)),
        None,
        Par::Seq,
        MemStack::new(&mut scratch),
        params,
    )?;
    Ok((values, left))
}

/// Turns a component so that its coordinate of largest magnitude, the first of equals, is positive.
fn fix_sign(component: &mut [f64]) {
    let largest = component.iter().fold(0.0f64, |best, &x| if x.abs() > best.abs() { x } else { best });
    if largest < 0.0 {
        component.iter_mut().for_each(|x| *x = -*x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::write_npy;
    use crate::mesh::PoseKind;
    use crate::mesh::testing::{noise, sheet};
    use nalgebra::Rotation3;

    fn vectors(numbers: &[f64]) -> Vec<Vec3> {
        numbers.chunks_exact(3).map(|c| Vec3::new(c[0], c[1], c[2])).collect()
    }

    fn flat(shape: &[Vec3]) -> Vec<f64> {
        shape.iter().flat_map(|p| <[f64; 3]>::from(*p)).collect()
    }

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    /// Orthonormal vectors of `length`, those of `basis` and `more`, by Gram and Schmidt, twice.
    fn orthonormal(mut basis: Vec<Vec<f64>>, more: usize, length: usize, seed: usize) -> Vec<Vec<f64>> {
        for k in 0..more {
            let mut v: Vec<f64> = (0..length).map(|i| noise(seed + k * length + i)).collect();
            for _ in 0..2 {
                for b in &basis {
                    let along = dot(&v, b);
                    v.iter_mut().zip(b).for_each(|(x, b)| *x -= along * b);
                }
            }
            let norm = dot(&v, &v).sqrt();
            v.iter_mut().for_each(|x| *x /= norm);
            basis.push(v);
        }
        basis
    }

    /// A face-sized cloud.
    fn cloud(vertices: usize) -> Vec<f64> {
        (0..3 * vertices).map(|i| 80.0 * noise(7000 + i)).collect()
    }

    /// `count` shapes whose singular vectors and values are known: mean, vectors, standard deviations, population.
    fn known(vertices: usize, count: usize, sigmas: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>, Population) {
        let mean = cloud(vertices);
        let directions = orthonormal(Vec::new(), sigmas.len(), 3 * vertices, 1);
        // Weights whose columns are orthonormal and sum to zero: orthogonal to the first, which is constant.
        let weights = orthonormal(vec![vec![(1.0 / count as f64).sqrt(); count]], sigmas.len(), count, 90_000);
        let shape = |i: usize| {
            let mut x = mean.clone();
            for (k, sigma) in sigmas.iter().enumerate() {
                let s = sigma * ((count - 1) as f64).sqrt() * weights[k + 1][i];
                x.iter_mut().zip(&directions[k]).for_each(|(x, d)| *x += s * d);
            }
            vectors(&x)
        };
        let samples = (0..count).map(shape).collect();
        (mean, directions, Population::new(samples).unwrap())
    }

    fn assert_orthonormal(pca: &ShapePca) {
        for i in 0..pca.standard_deviations().len() {
            for j in 0..=i {
                let expected = if i == j { 1.0 } else { 0.0 };
                let found = dot(pca.component(i), pca.component(j));
                assert!((found - expected).abs() < 1e-12, "{i} {j}: {found}");
            }
        }
    }

    #[test]
    fn a_known_population_is_recovered_to_the_last_digits() {
        let sigmas = [300.0, 40.0, 5.0, 0.7, 1e-6];
        for (vertices, count) in [(200, 20), (4, 300), (15, 45), (10, 29)] {
            let (mean, directions, population) = known(vertices, count, &sigmas);
            let pca = ShapePca::fit(&population, sigmas.len()).unwrap();
            assert_orthonormal(&pca);
            let off = flat(pca.mean()).iter().zip(&mean).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-12, "{off}");
            for (k, sigma) in sigmas.iter().enumerate() {
                // 300 mm known to 16 digits leave 8 of a standard deviation of 1e-6; of a Gram matrix nothing would be left.
                let found = pca.standard_deviations()[k];
                assert!((found - sigma).abs() < 1e-12 * sigmas[0], "{vertices} x {count}: {found} {sigma}");
                let cosine = dot(pca.component(k), &directions[k]).abs();
                assert!((cosine - 1.0).abs() < 1e-9, "{vertices} x {count}, component {k}: {cosine}");
                let c = pca.component(k);
                let largest = c.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
                assert!(largest > 0.0, "component {k} points the wrong way");
            }
            let explained: f64 = pca.explained().iter().sum();
            assert!((explained - 1.0).abs() < 1e-12, "{explained}");
            match ShapePca::fit(&population, sigmas.len() + 1).unwrap_err() {
                PopulationError::Rank { asked: 6, rank: 5, .. } => {}
                other => panic!("{other}"),
            }
        }
    }

    #[test]
    fn what_reconstruction_lacks_is_the_tail_of_singular_values() {
        let (vertices, count) = (30, 12);
        let samples: Vec<Vec<Vec3>> = (0..count)
            .map(|i| vectors(&(0..3 * vertices).map(|j| 10.0 * noise(i * 3 * vertices + j)).collect::<Vec<_>>()))
            .collect();
        let population = Population::new(samples.clone()).unwrap();
        let all = ShapePca::fit(&population, count - 1).unwrap();
        for kept in 1..count {
            let pca = ShapePca::fit(&population, kept).unwrap();
            assert_orthonormal(&pca);
            let lost: f64 = samples
                .iter()
                .map(|s| {
                    let rebuilt = pca.shape(&pca.weights(s));
                    rebuilt.iter().zip(s).map(|(a, b)| (a - b).norm_squared()).sum::<f64>()
                })
                .sum();
            let tail: f64 = all.standard_deviations()[kept..].iter().map(|s| s * s * (count - 1) as f64).sum();
            assert!((lost - tail).abs() < 1e-10 * all.total_variance(), "{kept} kept: {lost} {tail}");
        }
        // Weights have mean 0 and standard deviation 1, uncorrelated.
        let weights: Vec<Vec<f64>> = samples.iter().map(|s| all.weights(s)).collect();
        for a in 0..count - 1 {
            assert!(weights.iter().map(|w| w[a]).sum::<f64>().abs() < 1e-10);
            for b in 0..=a {
                let covariance = weights.iter().map(|w| w[a] * w[b]).sum::<f64>() / (count - 1) as f64;
                assert!((covariance - f64::from(u8::from(a == b))).abs() < 1e-10, "{a} {b}: {covariance}");
            }
        }
    }

    #[test]
    fn numbers_of_components_that_cannot_be_are_named() {
        let (_, _, population) = known(20, 6, &[3.0, 1.0]);
        for asked in [0, 6, 100] {
            let message = ShapePca::fit(&population, asked).unwrap_err().to_string();
            let wanted = format!("{asked} components asked for, expected 1 to 5: 6 meshes of 20 vertices");
            assert!(message.contains(&wanted), "{message}");
        }
        let message = ShapePca::fit(&population, 3).unwrap_err().to_string();
        assert!(message.contains("3 components") && message.contains("2 directions"), "{message}");
        // Fewer coordinates than shapes; and shapes that are all the same, wherever they are.
        let (_, _, small) = known(1, 9, &[3.0, 2.0, 1.0]);
        assert!(ShapePca::fit(&small, 4).unwrap_err().to_string().contains("expected 1 to 3"));
        let same = vec![vectors(&cloud(40)).into_iter().map(|p| p * 1e3 / 7.0).collect::<Vec<_>>(); 11];
        let message = ShapePca::fit(&Population::new(same).unwrap(), 1).unwrap_err().to_string();
        assert!(message.contains("0 directions"), "{message}");
        let tiny = vec![vec![Vec3::x() * 1e-200], vec![Vec3::y() * 1e-200]];
        assert!(matches!(
            ShapePca::fit(&Population::new(tiny).unwrap(), 1),
            Err(PopulationError::Rank { rank: 0, .. })
        ));
    }

    #[test]
    fn the_rig_has_the_modes_scaled() {
        let (_, _, population) = known(50, 8, &[9.0, 2.0, 1e-7]);
        let pca = ShapePca::fit(&population, 3).unwrap();
        let (rig, warnings) = pca.to_rig(None).unwrap();
        assert_eq!(warnings, [RigWarning::Motionless { name: "identity002".into() }]);
        assert_eq!(rig.neutral(), pca.mean());
        let mode: Vec<f64> = rig.deltas(1).iter().map(|&x| f64::from(x)).collect();
        assert!((dot(&mode, pca.component(1)) - 2.0).abs() < 1e-6);
        assert!(pca.to_rig(Some(&PolygonMesh::default())).is_err());
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        let fit = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (_, _, mut population) = known(700, 30, &[300.0, 40.0, 5.0]);
            pool.install(|| {
                let rounds = population.align(PoseKind::Similarity).unwrap();
                (rounds, ShapePca::fit(&population, 20).unwrap())
            })
        };
        assert_eq!(fit(1), fit(2));
    }

    #[test]
    fn poses_are_no_variance_after_alignment() {
        let (_, _, population) = known(60, 9, &[12.0, 4.0]);
        let moved = |scaled: bool| {
            let moved = |(i, s): (usize, &Vec<Vec3>)| -> Vec<Vec3> {
                let n = |k: usize| noise(500 + 10 * i + k);
                let turn = Rotation3::from_euler_angles(n(0), 3.0 * n(1), n(2));
                let scale = if scaled { 1.0 + 0.3 * n(6) } else { 1.0 };
                s.iter().map(|p| turn * p * scale + Vec3::new(n(3), n(4), n(5)) * 1e3).collect()
            };
            Population::new(population.samples().iter().enumerate().map(moved).collect()).unwrap()
        };
        for (kind, scaled) in [(PoseKind::Rigid, false), (PoseKind::Similarity, true)] {
            let [mut reference, mut found] = [population.clone(), moved(scaled)];
            let first = found.samples()[0].clone();
            let rounds = [&mut reference, &mut found].map(|p| p.align(kind).unwrap());
            assert!(rounds.iter().all(|&r| r < 20), "{rounds:?}");
            let [a, b] = [&reference, &found].map(|p| ShapePca::fit(p, 2).unwrap());
            // The same shapes in other poses vary as much; scaled ones in another unit of length, as sizes were averaged.
            let unit = a.standard_deviations()[0] / b.standard_deviations()[0];
            assert!(scaled || (unit - 1.0).abs() < 1e-10, "{unit}");
            assert!((a.standard_deviations()[1] / b.standard_deviations()[1] / unit - 1.0).abs() < 1e-9);
            assert!((a.total_variance() / b.total_variance() / (unit * unit) - 1.0).abs() < 1e-9);
            // Where the first shape was: no turn or shift between it and its aligned self but what is its best fit.
            let shift = |s: &[Vec3]| s.iter().sum::<Vec3>() / s.len() as f64;
            assert!((shift(&first) - shift(&found.samples()[0])).norm() < 1e-9);
            let far = first.iter().zip(&found.samples()[0]).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(scaled || far < 3.0, "{far}");
        }
    }

    #[test]
    fn vertices_of_no_polygon_have_no_say() {
        let folder = tempfile::tempdir().unwrap();
        let (_, _, population) = known(60, 9, &[12.0, 4.0]);
        let mesh = |vertices: usize| {
            let sheet = PolygonMesh::from(sheet(10, 6, |x, y| Vec3::new(x, y, 0.0)));
            PolygonMesh { positions: vec![Vec3::zeros(); vertices], ..sheet }
        };
        let read = |strays: usize| {
            let path = folder.path().join("shapes.npy");
            let far = |i: usize| vec![Vec3::new(400.0 * noise(i), 0.0, 500.0); strays];
            let samples = population.samples().iter().enumerate().map(|(i, s)| [&s[..], &far(i)].concat());
            let numbers: Vec<f64> = samples.flatten().flat_map(<[f64; 3]>::from).collect();
            write_npy(&path, &[9, 60 + strays, 3], &numbers).unwrap();
            let mut population = Population::read_npy(&path, mesh(60 + strays)).unwrap();
            population.align(PoseKind::Rigid).unwrap();
            ShapePca::fit(&population, 2).unwrap()
        };
        let (without, with) = (read(0), read(4));
        for k in 0..2 {
            assert_eq!(with.standard_deviations()[k], without.standard_deviations()[k]);
            let apart = with.component(k)[..180].iter().zip(without.component(k)).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-12 && with.component(k)[180..].iter().all(|c| *c == 0.0));
        }
    }

    #[test]
    fn the_unit_of_length_does_not_matter() {
        let (_, _, population) = known(60, 9, &[12.0, 4.0]);
        for unit in [1e-30, 1e28] {
            let scaled = population.samples().iter().map(|s| s.iter().map(|p| p * unit).collect()).collect();
            let mut scaled = Population::new(scaled).unwrap();
            assert!(scaled.align(PoseKind::Similarity).unwrap() < 20);
            let sigma = ShapePca::fit(&scaled, 1).unwrap().standard_deviations()[0] / unit;
            assert!((sigma - 12.0).abs() < 0.5, "{sigma}");
        }
    }

    #[test]
    fn shapes_that_are_no_population_are_named() {
        let square = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::new(1.0, 1.0, 0.5)];
        let message = |samples: Vec<Vec<Vec3>>| Population::new(samples).unwrap_err().to_string();
        assert!(message(vec![]).contains("0 meshes, expected at least 2"));
        assert!(message(vec![square.clone()]).contains("1 mesh, expected at least 2"));
        let found = message(vec![square.clone(), square[..3].to_vec()]);
        assert!(found.contains("shape 1: found 3 vertices, expected 4 as in shape 0"), "{found}");
        for bad in [f64::NAN, f64::INFINITY, 1e31] {
            let mut other = square.clone();
            other[2].y = bad;
            assert!(message(vec![square.clone(), other]).contains("shape 1: vertex 2"));
        }
        let line: Vec<Vec3> = (0..4).map(|i| Vec3::x() * f64::from(i)).collect();
        let found = Population::new(vec![square, line]).unwrap().align(PoseKind::Rigid).unwrap_err().to_string();
        assert!(found.contains("shape 1: cannot be aligned") && found.contains("line"), "{found}");
    }
}
