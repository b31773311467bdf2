//! Symmetric point-to-plane distance (Rusinkiewicz, "A symmetric objective function for ICP", 2019), with the normal of the
//! source frozen: `r = (v - c) . (n_source + n_target) / 2`.
//!
//! It is zero not only where v lies in the target's plane, but wherever v and c with their normals lie on one circle: sliding
//! along a curved surface costs less than with point-to-plane.

use super::along;
use super::factory::{BuiltIn, Scheduled, Step, TermLevel, TermWeight};
use crate::energy::{OptionsError, Pointwise, SampleResidual};
use crate::mesh::{MeshError, Vec3};
use crate::nlls::{Kernel, Scalar};

/// Pulls sample `m` towards `targets[m]` along the mean of both normals, weight `scale * weights[m]`.
#[derive(Debug, Clone, Default)]
pub struct Symmetric {
    /// `c`, millimetres.
    pub targets: Vec<Vec3>,
    /// `n_source`: unit normal at the sample when the target was found.
    pub source_normals: Vec<Vec3>,
    /// `n_target`: unit normal at `c`.
    pub target_normals: Vec<Vec3>,
    /// Confidence in each target; zero switches a sample off.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, changed from level to level.
    pub scale: f64,
}

impl Symmetric {
    #[inline(always)]
    fn normal(&self, m: usize) -> Vec3 {
        (self.source_normals[m] + self.target_normals[m]) / 2.0
    }
}

impl SampleResidual<1> for Symmetric {
    fn len(&self) -> usize {
        self.targets.len()
    }

    fn sample(&self, m: usize) -> usize {
        m
    }

    fn weight(&self, m: usize) -> f64 {
        self.scale * self.weights[m]
    }

    #[inline(always)]
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 1] {
        [along(v, self.targets[m], self.normal(m))]
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; 1], [[f64; 3]; 1]) {
        (self.residual(m, v), [self.normal(m).into()])
    }
}

impl Scheduled<1> for Symmetric {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(level.kernel)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        self.targets.clone_from(&step.correspondences.points);
        self.source_normals.clone_from(&step.correspondences.template_normals);
        self.target_normals.clone_from(&step.correspondences.normals);
        self.weights.clone_from(&step.correspondences.weights);
        Ok(())
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<TermWeight>("symmetric", |_| {
    Ok(Box::new(Pointwise::new("symmetric point to plane", Symmetric::default(), Kernel::None)))
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_one_circle_cost_nothing() {
        let on = |angle: f64| Vec3::new(angle.cos(), angle.sin(), 0.0);
        let term = |v: f64, c: f64| Symmetric {
            targets: vec![on(c) * 5.0],
            source_normals: vec![on(v)],
            target_normals: vec![on(c)],
            weights: vec![1.0],
            scale: 1.0,
        };
        for (v, c) in [(0.1, 0.9), (2.0, 1.2), (0.0, 0.0)] {
            let [r] = term(v, c).residual::<f64>(0, (on(v) * 5.0).into());
            approx::assert_abs_diff_eq!(r, 0.0, epsilon = 1e-14);
            // One millimetre off the circle: less than one along the mean of the normals, by half their angle, twice.
            let [r] = term(v, c).residual::<f64>(0, (on(v) * 6.0).into());
            approx::assert_abs_diff_eq!(r, (0.5 + 0.5 * (v - c).cos()), epsilon = 1e-14);
        }
    }
}
