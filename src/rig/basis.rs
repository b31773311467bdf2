//! The shapes of a fit, as the solver reads them: constant slabs of displacements.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::{Family, Shape};
use crate::mesh::{TriangleMesh, Vec3, sewn_unless_opened};

/// Linear shapes `b_i(w) = n_i + sum_k w_k delta_ik`, eq. (4) of Klimov 2020, with a prior of standard deviation
/// `sigma_k` on each weight, eq. (5), and optional bounds of the weights. Cloning shares the displacements.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeBasis {
    shapes: Vec<Shape>,
    sigmas: Vec<f64>,
    /// Standard deviation of what lies beyond 0 and 1; infinite where nothing is said.
    beyond: Vec<f64>,
    /// Which weights are meant to lie between 0 and 1, and the scale of their sparse prior; 0 for none.
    from_zero_to_one: Vec<bool>,
    sparse: f64,
    /// Of the weights, lower and upper; both empty for none.
    bounds: [Vec<f64>; 2],
    /// In the order of the shapes: [joined](Self::joined) ones keep their own.
    slabs: Vec<Slab>,
}

/// Some shapes that follow each other.
#[derive(Debug, Clone, PartialEq)]
struct Slab {
    shapes: usize,
    /// `3 N` rows of one entry per shape.
    values: Arc<Vec<f32>>,
}

impl ShapeBasis {
    /// No shapes: what rigid, similarity and graph use.
    #[must_use]
    pub fn none() -> Self {
        Self::default()
    }

    /// Shapes with `sigma_k = 1`. `slab` holds `3 N` rows of one entry per shape: row `3 i + a` is the displacement of
    /// vertex `i` along axis `a` at weight one, millimetres. It has 32 bits, as the files of a [`Rig`](super::Rig) have: reading
    /// it is most of what a further shape costs a solver. All arithmetic with it has 64.
    ///
    /// # Panics
    /// If the slab is not made of whole vertices.
    #[must_use]
    pub fn new(shapes: Vec<Shape>, slab: Vec<f32>) -> Self {
        assert_eq!(slab.len() % (3 * shapes.len()).max(1), 0, "the slab must be 3 N rows of {} shapes", shapes.len());
        let beyond = vec![f64::INFINITY; shapes.len()];
        let slabs = (!shapes.is_empty()).then(|| Slab { shapes: shapes.len(), values: Arc::new(slab) });
        Self {
            sigmas: vec![1.0; shapes.len()],
            beyond,
            from_zero_to_one: shapes.iter().map(Shape::from_zero_to_one).collect(),
            sparse: 0.0,
            bounds: Default::default(),
            shapes,
            slabs: slabs.into_iter().collect(),
        }
    }

    /// The width, height and depth of a template about the centre of its surface's vertices, each larger by `share` at weight one.
    #[must_use]
    pub fn proportions(template: &TriangleMesh, share: f64) -> Self {
        let surface = template.surface_points();
        let centre = surface.iter().sum::<Vec3>() / surface.len().max(1) as f64;
        let shapes = ["width", "height", "depth"].map(|name| Shape { name: name.to_owned(), family: Family::Identity });
        // Rows x, y and z of a vertex, of three shapes each.
        let rows = template.positions.iter().flat_map(|p| {
            let delta = (p - centre) * share;
            (0..9).map(move |k| if k % 4 == 0 { delta[k / 4] as f32 } else { 0.0 })
        });
        Self::new(shapes.into(), rows.collect())
    }

    /// The same shapes with `sigma_k = sigma(shape k)`.
    #[must_use]
    pub fn with_sigmas(mut self, sigma: impl Fn(&Shape) -> f64) -> Self {
        self.sigmas = self.shapes.iter().map(sigma).collect();
        self
    }

    /// The same shapes with a prior on how far weights lie outside 0 to 1, `sigma(shape k)` its standard deviation; infinite for none.
    #[must_use]
    pub fn with_beyond(mut self, sigma: impl Fn(&Shape) -> f64) -> Self {
        self.beyond = self.shapes.iter().map(sigma).collect();
        self
    }

    /// Gives expressions whose weights are meant to lie between 0 and 1 ([`Shape::from_zero_to_one`]) a sparse [prior](Self::prior) of this
    /// scale instead of a normal one; 0 for a normal one.
    pub fn set_sparse(&mut self, scale: f64) {
        self.sparse = scale;
    }

    /// The same shapes with `l_k <= w_k <= u_k`, `[l_k, u_k] = bounds(shape k)`; infinite where there is no bound. Without any, the
    /// weights are free.
    #[must_use]
    pub fn with_bounds(mut self, bounds: impl Fn(&Shape) -> [f64; 2]) -> Self {
        let pairs: Vec<[f64; 2]> = self.shapes.iter().map(bounds).collect();
        let free = pairs.iter().all(|b| *b == [f64::NEG_INFINITY, f64::INFINITY]);
        self.bounds = [0, 1].map(|side| pairs.iter().filter(|_| !free).map(|b| b[side]).collect());
        self
    }

    /// The same shapes, turned.
    #[must_use]
    pub fn turned(&self, rotation: &Matrix3<f64>) -> Self {
        let turned = |slab: &Slab| {
            let (mut values, n) = (slab.values.to_vec(), slab.shapes);
            values.par_chunks_exact_mut((3 * n).max(1)).for_each(|rows| {
                for k in 0..n {
                    let d = Vec3::from_fn(|axis, _| f64::from(rows[axis * n + k]));
                    (rotation * d).iter().enumerate().for_each(|(axis, d)| rows[axis * n + k] = *d as f32);
                }
            });
            Slab { shapes: n, values: Arc::new(values) }
        };
        Self { slabs: self.slabs.iter().map(turned).collect(), ..self.clone() }
    }

    /// The same shapes on some of the vertices, each displacement times its vertex' weight; one weight for each of `vertices`.
    ///
    /// # Panics
    /// When there is no such vertex.
    #[must_use]
    pub fn masked(&self, vertices: &[u32], weights: &[f64]) -> Self {
        let masked = |slab: &Slab| {
            let mut values = Vec::with_capacity(3 * slab.shapes * vertices.len());
            for (&v, w) in vertices.iter().zip(weights) {
                values.extend(slab.vertex(v as usize).iter().map(|d| (w * f64::from(*d)) as f32));
            }
            Slab { shapes: slab.shapes, values: Arc::new(values) }
        };
        Self { slabs: self.slabs.iter().map(masked).collect(), ..self.clone() }
    }

    /// These shapes and, after them, those of `other`, on the same vertices. What they hold is shared, not copied.
    ///
    /// # Panics
    /// If both have shapes, but not of as many vertices.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        if self.is_empty() || other.is_empty() {
            return if self.is_empty() { other.clone() } else { self.clone() };
        }
        assert_eq!(self.vertex_count(), other.vertex_count(), "shapes of different templates");
        let bounds =
            [(0, f64::NEG_INFINITY), (1, f64::INFINITY)].map(|(side, free)| match (self.bounds(), other.bounds()) {
                (None, None) => Vec::new(),
                _ => [self, other]
                    .iter()
                    .flat_map(|basis| match basis.bounds[side].is_empty() {
                        true => vec![free; basis.len()],
                        false => basis.bounds[side].clone(),
                    })
                    .collect(),
            });
        Self {
            shapes: [&self.shapes[..], &other.shapes].concat(),
            sigmas: [&self.sigmas[..], &other.sigmas].concat(),
            beyond: [&self.beyond[..], &other.beyond].concat(),
            from_zero_to_one: [&self.from_zero_to_one[..], &other.from_zero_to_one].concat(),
            sparse: self.sparse,
            bounds,
            slabs: [&self.slabs[..], &other.slabs].concat(),
        }
    }

    /// Number of shapes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.shapes.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.shapes.is_empty()
    }

    /// Number of vertices that the shapes move; zero without shapes.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.slabs.first().map_or(0, |slab| slab.values.len() / (3 * slab.shapes))
    }

    /// Name and family of each shape, in the order of the weights `w_k`.
    #[must_use]
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Prior standard deviations `sigma_k`.
    #[must_use]
    pub fn sigmas(&self) -> &[f64] {
        &self.sigmas
    }

    /// How unlikely identities of these weights are among the rig's own people: the sum of their squares over the mean and twice the standard
    /// deviation of the chi-square distribution that it has where each weight is normal with deviation 1, as rigs scale their modes, whatever
    /// `sigma_k` a fit gives them. Zero without identities.
    ///
    /// # Panics
    /// Unless there is a weight for each shape.
    #[must_use]
    pub fn unlikeliness(&self, weights: &[f64]) -> f64 {
        assert_eq!(weights.len(), self.len(), "one weight for each shape");
        let identities = (0..self.len()).filter(|&k| self.shapes[k].family == Family::Identity);
        let (sum, count) = identities.fold((0.0, 0.0), |(sum, count), k| (sum + weights[k].powi(2), count + 1.0));
        if count > 0.0 { sum / (count + 2.0 * (2.0_f64 * count).sqrt()) } else { 0.0 }
    }

    /// The prior of weight `k` at `w`: `(w / sigma)^2 + ((w - clamp(w, 0, 1)) / sigma_beyond)^2`, half its derivative, and half the
    /// second derivative of the parabola through these that lies above it.
    ///
    /// [Sparse](Self::set_sparse) with scale `e`, `ln(1 + (w / e)^2) / 2` stands for `(w / sigma)^2`: nearly all weights are zero, and the others
    /// may have any size (the heavy-tailed prior of sparse Bayesian learning, Tipping 2001).
    ///
    /// # Panics
    /// When there is no such shape.
    #[must_use]
    pub fn prior(&self, k: usize, w: f64) -> [f64; 3] {
        let (value, curvature) = if self.sparse > 0.0 && self.from_zero_to_one[k] {
            let scale = self.sparse * self.sparse;
            (0.5 * (w * w / scale).ln_1p(), 0.5 / (scale + w * w))
        } else {
            let own = 1.0 / (self.sigmas[k] * self.sigmas[k]);
            (own * w * w, own)
        };
        let outside = w - w.clamp(0.0, 1.0);
        let beyond = if outside == 0.0 { 0.0 } else { 1.0 / (self.beyond[k] * self.beyond[k]) };
        [value + beyond * outside * outside, curvature * w + beyond * outside, curvature + beyond]
    }

    /// Bounds `l` and `u` of the weights, if there are any.
    #[must_use]
    pub fn bounds(&self) -> Option<(&[f64], &[f64])> {
        let [lower, upper] = &self.bounds;
        (!lower.is_empty()).then_some((lower, upper))
    }

    /// `B_i`, the three rows of vertex `i`, in pieces: which shapes, and their entries, `3 x` as many, row-major.
    ///
    /// # Panics
    /// When there is no vertex `i`.
    #[inline(always)]
    pub fn vertex(&self, i: usize) -> impl Iterator<Item = (Range<usize>, &[f32])> {
        self.slabs.iter().scan(0, move |first, slab| {
            let shapes = *first..*first + slab.shapes;
            *first = shapes.end;
            Some((shapes, slab.vertex(i)))
        })
    }

    /// Displacement of vertex `i` by shape `k` at weight one: column `k` of `B_i`.
    ///
    /// # Panics
    /// When there is no such vertex or shape.
    #[must_use]
    pub fn displacement(&self, i: usize, k: usize) -> Vec3 {
        let (shapes, rows) = self.vertex(i).find(|piece| piece.0.contains(&k)).expect("the shape is one of these");
        Vec3::from_fn(|a, _| rows[a * shapes.len() + k - shapes.start].into())
    }

    /// The first of the vertices with which each one is a point of the surface: itself, but along [seams](crate::mesh::sewn) of the rest
    /// shape that none of these opens.
    pub(crate) fn seams(&self, rest: &TriangleMesh) -> Vec<u32> {
        sewn_unless_opened(rest, self.len(), |k, v| self.displacement(v as usize, k))
    }

    /// `b_i(w)` for vertex `i` at rest in `rest`.
    #[inline(always)]
    #[must_use]
    pub fn blend(&self, i: usize, rest: Vec3, w: &[f64]) -> Vec3 {
        let mut b = rest;
        for (shapes, rows) in self.vertex(i) {
            for (a, row) in rows.chunks_exact(shapes.len()).enumerate() {
                b[a] += dot(row, &w[shapes.clone()]);
            }
        }
        b
    }
}

impl Slab {
    #[inline(always)]
    fn vertex(&self, i: usize) -> &[f32] {
        let n = 3 * self.shapes;
        &self.values[i * n..(i + 1) * n]
    }
}

/// Dot product with eight running sums, so that it vectorises.
#[inline(always)]
fn dot(a: &[f32], b: &[f64]) -> f64 {
    let (a8, a1) = a.as_chunks::<8>();
    let (b8, b1) = b.as_chunks::<8>();
    let (a4, a1) = a1.as_chunks::<4>();
    let (b4, b1) = b1.as_chunks::<4>();
    let mut sums = [0.0; 8];
    for (a, b) in a8.iter().zip(b8) {
        for l in 0..8 {
            sums[l] += f64::from(a[l]) * b[l];
        }
    }
    for (a, b) in a4.iter().zip(b4) {
        for l in 0..4 {
            sums[l] += f64::from(a[l]) * b[l];
        }
    }
    for (l, (a, b)) in a1.iter().zip(b1).enumerate() {
        sums[l] += f64::from(*a) * b;
    }
    let pairs: [f64; 4] = std::array::from_fn(|l| sums[l] + sums[l + 4]);
    (pairs[0] + pairs[1]) + (pairs[2] + pairs[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_are_unlikely_two_standard_deviations_beyond_the_mean_of_their_squares() {
        let shape = |family| Shape { name: String::new(), family };
        let families = [Family::Expression, Family::Identity, Family::Identity];
        let basis = ShapeBasis::new(families.map(shape).into(), vec![0.0; 9]).with_sigmas(|_| 2.0);
        assert_eq!(basis.unlikeliness(&[9.0, 1.0, -1.0]), 2.0 / 6.0);
        assert_eq!(basis.unlikeliness(&[0.0, 6f64.sqrt(), 0.0]).round(), 1.0);
        assert_eq!(ShapeBasis::new(vec![shape(Family::Expression)], vec![0.0; 3]).unlikeliness(&[5.0]), 0.0);
    }

    #[test]
    fn proportions_are_of_the_template_about_its_centre() {
        let positions = vec![Vec3::new(3.0, 10.0, -1.0), Vec3::new(1.0, 20.0, -5.0)];
        let basis = ShapeBasis::proportions(&TriangleMesh { positions, triangles: Vec::new() }, 0.1);
        assert_eq!(basis.shapes().iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["width", "height", "depth"]);
        let rows = |i: usize| basis.vertex(i).next().unwrap();
        assert_eq!(rows(0), (0..3, &[0.1, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.2][..]));
        assert_eq!(rows(1), (0..3, &[-0.1, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, -0.2][..]));
    }

    #[test]
    fn joined_shapes_move_as_each_does_and_as_many_as_one_slab_would() {
        let shapes = |count: usize| (0..count).map(|k| Shape { name: k.to_string(), family: Family::Other }).collect();
        let number = |row: usize, k: usize| (row * 7 + k * k) as f32;
        let slab = |ks: Range<usize>| (0..6).flat_map(|row| ks.clone().map(move |k| number(row, k))).collect();
        let joined = ShapeBasis::new(shapes(9), slab(0..9)).joined(&ShapeBasis::new(shapes(3), slab(9..12)));
        let (whole, w): (_, Vec<f64>) = (ShapeBasis::new(shapes(12), slab(0..12)), (0..12).map(f64::from).collect());
        assert_eq!((joined.len(), joined.vertex_count()), (12, 2));
        for i in 0..2 {
            let rest = Vec3::new(1.0, 2.0, 3.0);
            assert_eq!(joined.blend(i, rest, &w), whole.blend(i, rest, &w));
            for k in 0..12 {
                assert_eq!(joined.displacement(i, k), Vec3::from_fn(|a, _| number(3 * i + a, k).into()));
            }
        }
        let masked = joined.masked(&[1], &[0.5]);
        assert_eq!(masked.displacement(0, 10), joined.displacement(1, 10) * 0.5);
    }

    /// The prior's derivatives are those of differences, and names decide who is held between 0 and 1.
    #[test]
    fn expressions_pay_for_what_lies_beyond_zero_and_one() {
        let shape = |name: &str, family| Shape { name: name.into(), family };
        let shapes = vec![
            shape("jawOpen", Family::Expression),
            shape("jawOpen", Family::Identity),
            shape("mode3", Family::Other),
        ];
        let basis = ShapeBasis::new(shapes, vec![0.0; 9])
            .with_sigmas(|_| 2.0)
            .with_beyond(|s| if s.from_zero_to_one() { 0.1 } else { f64::INFINITY });
        for w in [-1.5, -0.2, 0.3, 0.9, 1.1, 4.0] {
            for k in 0..3 {
                let (h, [_, slope, curvature]) = (1e-4, basis.prior(k, w));
                let [before, here, after] = [w - h, w, w + h].map(|w| basis.prior(k, w)[0]);
                assert!((slope - (after - before) / (4.0 * h)).abs() < 1e-6, "{k} {w}");
                assert!((curvature - (after - 2.0 * here + before) / (2.0 * h * h)).abs() < 1e-3, "{k} {w}");
                let outside = if k == 0 { w - w.clamp(0.0, 1.0) } else { 0.0 };
                assert!((here - (w * w / 4.0 + 100.0 * outside * outside)).abs() < 1e-9, "{k} {w}");
            }
        }
    }

    /// Expressions alone are sparse; the slope is that of differences, and the parabola touches at `w` and lies above elsewhere.
    #[test]
    fn a_sparse_prior_lets_few_weights_be_large() {
        let shape = |name: &str, family| Shape { name: name.into(), family };
        let shapes = vec![shape("jawOpen", Family::Expression), shape("jawOpen", Family::Identity)];
        let mut basis = ShapeBasis::new(shapes, vec![0.0; 6]);
        let normal = basis.clone();
        basis.set_sparse(0.05);
        let value = |w: f64| basis.prior(0, w)[0];
        for w in [-0.7, -0.01, 0.0, 0.04, 0.3, 1.5] {
            assert_eq!(basis.prior(1, w), normal.prior(1, w));
            let (h, [here, slope, curvature]) = (1e-5, basis.prior(0, w));
            assert!((slope - (value(w + h) - value(w - h)) / (4.0 * h)).abs() < 1e-6, "{w}");
            for step in [-2.0, -0.3, -0.01, 0.02, 0.5] {
                let above = here + 2.0 * slope * step + curvature * step * step;
                assert!(value(w + step) <= above + 1e-12, "{w} {step}");
            }
        }
        // Once large it costs little to be larger.
        assert!(value(1.0) - value(0.5) < 0.5 * (value(0.5) - value(0.0)));
    }
}
