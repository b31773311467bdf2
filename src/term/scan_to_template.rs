//! Points of the scan towards the template: `r = n_q . (v_s - (q + o))`.
//!
//! The closest point c of a scan point q on the template lies inside a triangle, but terms act on samples. So the residual acts
//! on the vertex s of that triangle to which c is nearest, less its offset `o = v_s - c` when c was found: there the residual
//! is `n_q . (c - q)`, the distance of c to the scan's plane, and the vertex is not pulled to q itself. Along the scan's normal,
//! not towards the point: which point of the template belongs to q is not known better than up to sliding.
//!
//! What it adds to the other direction: a scan's spike, the tip of a nose, that is no template vertex' closest point.

use super::factory::{BuiltIn, Scheduled, Step, TermLevel, TermWeight};
use super::sourced::{Source, Sourced};
use super::{ScanPoints, along};
use crate::energy::{OptionsError, Pointwise, SampleResidual};
use crate::mesh::{MeshError, Vec3};
use crate::nlls::{Kernel, Scalar};

/// Pulls sample `samples[m]` towards the plane through `targets[m]` with unit normal `normals[m]`, weight
/// `scale * weights[m]`.
#[derive(Debug, Clone, Default)]
pub struct ScanToTemplate {
    /// `s`: the sample of each scan point; several may share one.
    pub samples: Vec<usize>,
    /// `q + o`, millimetres.
    pub targets: Vec<Vec3>,
    /// `n_q`, unit length.
    pub normals: Vec<Vec3>,
    /// Confidence in each; zero switches a scan point off.
    pub weights: Vec<f64>,
    /// `alpha` of the whole term, changed from level to level.
    pub scale: f64,
}

impl SampleResidual<1> for ScanToTemplate {
    fn len(&self) -> usize {
        self.targets.len()
    }

    fn sample(&self, m: usize) -> usize {
        self.samples[m]
    }

    fn weight(&self, m: usize) -> f64 {
        self.scale * self.weights[m]
    }

    #[inline(always)]
    fn residual<D: Scalar>(&self, m: usize, v: [D; 3]) -> [D; 1] {
        let (c, n) = (self.targets[m], self.normals[m]);
        [along(v, c, n)]
    }

    #[inline(always)]
    fn linearize(&self, m: usize, v: [f64; 3]) -> ([f64; 1], [[f64; 3]; 1]) {
        (self.residual(m, v), [self.normals[m].into()])
    }
}

/// The points of the scan, spread when a level first weighs them.
type SpreadPoints = Option<ScanPoints>;

impl Source for SpreadPoints {
    const MEASURES: bool = true;
}

impl Scheduled<1> for Sourced<ScanToTemplate, SpreadPoints> {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.residuals.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(level.kernel)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        if self.residuals.scale == 0.0 {
            return Ok(());
        }
        let points = self.source.get_or_insert_with(|| ScanPoints::new(step.scan, step.rest));
        let normals = &step.correspondences.template_normals;
        points.find(step.vertices, normals, step.rest, step.masks, &step.accept, &mut self.residuals)
    }
}

pub(super) const TERM: BuiltIn = BuiltIn::new::<TermWeight>("scan_to_template", |_| {
    Ok(Box::new(Pointwise::new("scan to template", Sourced::<ScanToTemplate, SpreadPoints>::default(), Kernel::None)))
});
