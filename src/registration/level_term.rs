//! A data term of one's own in a registration, from its residuals and a rule for their weight.

use super::{Correspondences, Level, RegistrationTerm, TermFactory, TermInput};
use crate::energy::{DataTerm, Pointwise, QuadricField, SampleResidual};
use crate::mesh::Vec3;
use crate::nlls::RobustKernel;

/// Residuals under a kernel that follow the levels of a schedule, and the correspondences if they use them.
///
/// ```
/// use nonrigid::energy::SampleResidual;
/// use nonrigid::nlls::{Kernel, Scalar};
/// use nonrigid::registration::{LevelTerm, RegistrationTerm, TermFactory, TermInput};
///
/// /// Keeps vertices above a floor: r = y - height where y is below it.
/// struct AboveFloor { vertices: usize, height: f64, weight: f64 }
///
/// impl SampleResidual<1> for AboveFloor {
///     fn len(&self) -> usize { self.vertices }
///     fn sample(&self, m: usize) -> usize { m }
///     fn weight(&self, _m: usize) -> f64 { self.weight }
///     fn residual<D: Scalar>(&self, _m: usize, v: [D; 3]) -> [D; 1] {
///         [if v[1].re() < self.height { v[1] - self.height } else { D::from(0.0) }]
///     }
/// }
///
/// let floor = |_: &TermInput<'_>| -> Box<dyn RegistrationTerm> {
///     let residuals = AboveFloor { vertices: 100, height: -80.0, weight: 0.0 };
///     Box::new(LevelTerm::new("floor", residuals, Kernel::None, |term, level, density| {
///         term.residuals.weight = level.point_to_plane * density;
///     }))
/// };
/// let for_register_with: &dyn TermFactory = &floor;
/// ```
pub struct LevelTerm<T, K, const R: usize> {
    term: Pointwise<T, K, R>,
    set_level: Box<SetLevel<T, K, R>>,
    update: Option<Box<Update<T, K, R>>>,
}

type SetLevel<T, K, const R: usize> = dyn Fn(&mut Pointwise<T, K, R>, &Level, f64) + Send + Sync;
type Update<T, K, const R: usize> = dyn Fn(&mut Pointwise<T, K, R>, &Correspondences) + Send + Sync;

impl<T: SampleResidual<R>, K: RobustKernel, const R: usize> LevelTerm<T, K, R> {
    /// A term of the given name. `set_level` takes weights and kernel from a level, as in
    /// [`RegistrationTerm::set_level`].
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        residuals: T,
        kernel: K,
        set_level: impl Fn(&mut Pointwise<T, K, R>, &Level, f64) + Send + Sync + 'static,
    ) -> Self {
        Self { term: Pointwise::new(name, residuals, kernel), set_level: Box::new(set_level), update: None }
    }

    /// Takes what it needs from new correspondences, as in [`RegistrationTerm::update`].
    #[must_use]
    pub fn with_update(
        self,
        update: impl Fn(&mut Pointwise<T, K, R>, &Correspondences) + Send + Sync + 'static,
    ) -> Self {
        Self { update: Some(Box::new(update)), ..self }
    }
}

impl<T: SampleResidual<R>, K: RobustKernel + Send + Sync, const R: usize> DataTerm for LevelTerm<T, K, R> {
    fn name(&self) -> &str {
        self.term.name()
    }

    fn energy(&self, positions: &[Vec3]) -> f64 {
        self.term.energy(positions)
    }

    fn linearize(&self, positions: &[Vec3], field: &mut QuadricField) -> f64 {
        self.term.linearize(positions, field)
    }

    fn residual_variance(&self, positions: &[Vec3]) -> Option<[f64; 2]> {
        self.term.residual_variance(positions)
    }
}

impl<T: SampleResidual<R>, K: RobustKernel + Send + Sync, const R: usize> RegistrationTerm for LevelTerm<T, K, R> {
    fn set_level(&mut self, level: &Level, density: f64) {
        (self.set_level)(&mut self.term, level, density);
    }

    fn update(&mut self, correspondences: &Correspondences) {
        if let Some(update) = &self.update {
            update(&mut self.term, correspondences);
        }
    }
}

/// A function that builds a term is a factory.
impl<F: Fn(&TermInput<'_>) -> Box<dyn RegistrationTerm> + Send + Sync> TermFactory for F {
    fn build(&self, input: &TermInput<'_>) -> Box<dyn RegistrationTerm> {
        self(input)
    }
}
