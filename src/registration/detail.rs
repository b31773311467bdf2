//! A finer mesh than the template, for what the template is too coarse to carry: the result is divided by Catmull and Clark's
//! rules and its vertices go on to the scan by themselves, kept smooth.

use serde::Serialize;

use super::one_surface::seams;
use super::{
    ModelKind, Quality, QualityError, RegistrationError, RegistrationInput, RegistrationObserver, RegistrationResult,
    Schedule, WITHIN_MM, WarmStart, register,
};
use crate::mesh::{PolygonMesh, Pose, Subdivision, TriangleMesh, Vec3};

/// Rounds of subdivision at most: each makes four quads of one.
pub const MOST_ROUNDS: u8 = 3;

/// Vertices at most.
const MOST_VERTICES: usize = 5_000_000;

/// A result on a finer mesh.
#[derive(Debug, Clone)]
pub struct Detail {
    /// The template's rest shape, divided; its vertices come first, in their order.
    pub template: PolygonMesh,
    /// Where its vertices are in the scan's frame, before they went to the scan: the coarse result, divided.
    pub base: Vec<Vec3>,
    /// The input's mask, divided.
    pub mask: Option<Vec<f64>>,
    /// The input's free mask, divided.
    pub free_mask: Option<Vec<f64>>,
    /// How they went to the scan.
    pub result: RegistrationResult,
}

impl Detail {
    /// What it is measured and painted by: the finer mesh at rest, its masks, and the scan.
    #[must_use]
    pub fn input<'a>(&'a self, scan: &'a TriangleMesh, scan_normals: Option<&'a [Vec3]>) -> RegistrationInput<'a> {
        RegistrationInput {
            scan_normals,
            mask: self.mask.as_deref(),
            free_mask: self.free_mask.as_deref(),
            ..RegistrationInput::new(&self.template, scan)
        }
    }
}

/// Divides a result `rounds` times and registers the finer mesh, from where it is, with free vertices and the data terms of the last
/// level of the default: `detail.toml`.
///
/// # Errors
/// As [`register`]; and when the finer mesh has more vertices than can be held.
pub fn add_detail(
    input: &RegistrationInput<'_>,
    result: &RegistrationResult,
    rounds: u8,
    observer: &mut dyn RegistrationObserver,
) -> Result<Detail, RegistrationError> {
    let mut template = input.template.with_positions(input.rest_positions().to_vec());
    let mut base = result.positions.clone();
    let [mut mask, mut free_mask] = [input.mask, input.free_mask].map(|mask| mask.map(<[f64]>::to_vec));
    let mut first = seams(input);
    for _ in 0..rounds {
        let too_many = || RegistrationError::TooFine { rounds, most: MOST_VERTICES };
        let division = Subdivision::new(&template, &first).ok_or_else(too_many)?;
        first = division.first();
        template = division.mesh(&template.positions);
        if template.positions.len() > MOST_VERTICES {
            return Err(too_many());
        }
        base = division.apply(&base);
        for mask in [&mut mask, &mut free_mask].into_iter().flatten() {
            *mask = division.apply(mask);
            mask.iter_mut().for_each(|m| *m = m.clamp(0.0, 1.0)); // rounding
        }
    }
    let posed = template.with_positions(base.clone());
    let (scan, normals) = result.scan_facing.apply(input.scan, input.scan_normals);
    let here = WarmStart::at_rest(ModelKind::Free.to_string(), Pose::identity());
    let finer = RegistrationInput {
        scan_normals: normals.as_deref(),
        mask: mask.as_deref(),
        free_mask: free_mask.as_deref(),
        warm_start: Some(&here),
        ..RegistrationInput::new(&posed, &scan)
    };
    let schedule = Schedule::from_toml(include_str!("detail.toml"))?;
    let result = register(&finer, &ModelKind::Free, &schedule, observer)?;
    Ok(Detail { template, base, mask, free_mask, result })
}

/// What a report says of a finer mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetailReport {
    /// Vertices of the finer mesh.
    pub vertices: usize,
    /// Its polygons.
    pub polygons: usize,
    /// Steps that its vertices took.
    pub steps: usize,
    /// How well the divided result fitted before.
    pub before: Quality,
    /// How well it fits.
    pub quality: Quality,
}

impl DetailReport {
    /// Measures a finer mesh; `input` has its template.
    ///
    /// # Errors
    /// As [`Quality::measure`].
    pub fn measure(input: &RegistrationInput<'_>, detail: &Detail) -> Result<Self, QualityError> {
        Ok(Self {
            vertices: detail.base.len(),
            polygons: detail.template.polygon_count(),
            steps: detail.result.history.len(),
            before: Quality::measure(input, &detail.result.scan, &detail.base)?,
            quality: Quality::measure(input, &detail.result.scan, &detail.result.positions)?,
        })
    }
}

impl std::fmt::Display for DetailReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [before, after] = [&self.before, &self.quality].map(|q| (100.0 * q.to_scan.share_within, q.median_within));
        write!(
            f,
            "divided: {} vertices, {:.1} % within {WITHIN_MM} mm of the scan, their median {:.3} mm, before their own {} steps {:.1} % and \
             {:.3} mm",
            self.vertices, after.0, after.1, self.steps, before.0, before.1
        )
    }
}
