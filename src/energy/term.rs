//! Data terms: functions of sample positions.

use num_dual::DualSVec64;

use super::QuadricField;
use crate::mesh::Vec3;
use crate::nlls::{RobustKernel, Scalar};

/// A data term `alpha sum_m rho(|r_m|^2)`. It sees sample positions only; which model moves them is not its business.
pub trait DataTerm: Send + Sync {
    /// Name under which reports list the term's energy.
    fn name(&self) -> &str;

    /// The term's energy at the given sample positions (one per sample, millimetres).
    fn energy(&self, positions: &[Vec3]) -> f64;

    /// Adds the term's Gauss-Newton quadrics to `field` and returns its energy.
    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64;

    /// What the term's residuals say of the noise of the data: `[sum alpha rho' |r|^2, sum rho']` at the given positions, the
    /// second over scalar residuals. `None` from terms that do not say, or whose residuals are not measurements.
    fn residual_variance(&self, _positions: &[Vec3]) -> Option<[f64; 2]> {
        None
    }
}

impl<T: DataTerm + ?Sized> DataTerm for Box<T> {
    fn name(&self) -> &str {
        (**self).name()
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        (**self).energy(positions)
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        (**self).linearize(positions, field)
    }

    fn residual_variance(&self, positions: &[Vec3]) -> Option<[f64; 2]> {
        (**self).residual_variance(positions)
    }
}

/// A residual of one sample's position, stated once for any dual number. [`Pointwise`] makes a [`DataTerm`] of it.
///
/// ```
/// use nonrigid::{energy::{DataTerm, Pointwise, SampleResidual}, mesh::Vec3, nlls::{Kernel, Scalar}};
///
/// /// Keeps samples on a sphere round the origin: r = |v| - radius.
/// struct OnSphere { samples: Vec<usize>, radius: f64 }
///
/// impl SampleResidual<1> for OnSphere {
///     fn len(&self) -> usize { self.samples.len() }
///     fn sample(&self, m: usize) -> usize { self.samples[m] }
///     fn weight(&self, _m: usize) -> f64 { 1.0 }
///     fn residual<D: Scalar>(&self, _m: usize, v: [D; 3]) -> [D; 1] {
///         [(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt() - self.radius]
///     }
/// }
///
/// let term = Pointwise::new("sphere", OnSphere { samples: vec![0], radius: 2.0 }, Kernel::None);
/// assert_eq!(term.energy(&[Vec3::new(5.0, 0.0, 0.0)]), 9.0);
/// ```
pub trait SampleResidual<const R: usize>: Send + Sync {
    /// Number of residuals.
    fn len(&self) -> usize;

    /// Whether there are no residuals.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The sample that residual `m` acts on.
    fn sample(&self, m: usize) -> usize;

    /// `alpha` of residual `m`, not negative; zero switches it off.
    fn weight(&self, m: usize) -> f64;

    /// The residual at sample position `v`.
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; R];

    /// Whether the residuals are measurements, which say something of the noise of the data
    /// ([`DataTerm::residual_variance`]), and not guesses.
    fn measures(&self) -> bool {
        true
    }

    /// The residual at `v` and its derivatives by `v`, a row each. Dual numbers take them from [`residual`](Self::residual); a
    /// residual that is affine in `v` knows them, and may say so to save that.
    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; R], [[f64; 3]; R]) {
        let v = std::array::from_fn(|a| DualSVec64::<3>::from_re(v[a]).derivative(a));
        let r = self.residual(m, v);
        (r.map(|r| r.re), r.map(|r| r.eps.0.map_or([0.0; 3], Into::into)))
    }
}

/// Residuals of single samples under a robust kernel.
#[derive(Debug, Clone)]
pub struct Pointwise<T, K, const R: usize> {
    name: String,
    /// The residuals.
    pub residuals: T,
    /// `rho`, applied to the squared norm of each residual vector.
    pub kernel: K,
}

impl<T: SampleResidual<R>, K: RobustKernel, const R: usize> Pointwise<T, K, R> {
    /// A term of the given name.
    #[must_use]
    pub fn new(name: impl Into<String>, residuals: T, kernel: K) -> Self {
        Self { name: name.into(), residuals, kernel }
    }
}

impl<T: SampleResidual<R>, K: RobustKernel + Send + Sync, const R: usize> DataTerm for Pointwise<T, K, R> {
    fn name(&self) -> &str {
        &self.name
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        let mut energy = 0.0;
        for m in 0..self.residuals.len() {
            let weight = self.residuals.weight(m);
            if weight == 0.0 {
                continue;
            }
            let r = self.residuals.residual(m, positions[self.residuals.sample(m)].into());
            energy += weight * self.kernel.evaluate(r.iter().map(|r| r * r).sum())[0];
        }
        energy
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        let mut energy = 0.0;
        for m in 0..self.residuals.len() {
            let weight = self.residuals.weight(m);
            if weight == 0.0 {
                continue;
            }
            let sample = self.residuals.sample(m);
            let (r, rows) = self.residuals.linearize(m, positions[sample].into());
            let [rho, rho1, _] = self.kernel.evaluate(r.iter().map(|r| r * r).sum());
            energy += weight * rho;
            for (r, row) in r.into_iter().zip(rows) {
                field.at_mut(sample).add(weight * rho1, row, r);
            }
        }
        energy
    }

    fn residual_variance(&self, positions: &[Vec3]) -> Option<[f64; 2]> {
        if !self.residuals.measures() {
            return None;
        }
        let mut sums = [0.0; 2];
        for m in 0..self.residuals.len() {
            let weight = self.residuals.weight(m);
            if weight == 0.0 {
                continue;
            }
            let r = self.residuals.residual(m, positions[self.residuals.sample(m)].into());
            let square = r.iter().map(|r| r * r).sum();
            let robust = self.kernel.weight(square);
            sums[0] += weight * robust * square;
            sums[1] += robust * R as f64;
        }
        Some(sums)
    }
}
