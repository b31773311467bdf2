//! The report of a registration: everything that two equal runs have in common. Times, threads and machine belong in a
//! file of their own, so that reports can be compared byte for byte.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::evidence::Seen;
use super::{
    Coverage, DetailReport, LandmarkStart, NamedWeight, RegistrationInput, RegistrationResult, RegistrationStop,
    Reliability, ScanFacing, Schedule, StartSearch, StepRecord, TemplateRepair, Untangled,
};
use crate::correspondence::ScanSurface;
use crate::evaluation::{DistanceSummary, EvaluationError, MeshQuality, flipped_triangles};
use crate::io::{Input, KnownUnit, sha256_of_file};
use crate::mesh::{MeshError, Pose, PoseKind, TriangleMesh, Vec3, closest_pose, hidden_vertices};

/// A file that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct InputFile {
    /// What it was read as.
    pub role: String,
    /// Its name, without folders.
    pub name: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}

impl InputFile {
    /// Hashes a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn hash(role: &str, path: &Path) -> std::io::Result<Self> {
        Ok(Input { role: role.to_owned(), path: path.to_owned(), sha256: sha256_of_file(path)? }.into())
    }
}

impl From<Input> for InputFile {
    fn from(input: Input) -> Self {
        let name = input.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self { role: input.role, name, sha256: input.sha256 }
    }
}

/// How well the result fits, without any ground truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Distances to the scan's surface of the result's vertices, without those that masks take out or the template hides;
    /// `share_within` counts those within 3 mm.
    pub to_scan: DistanceSummary,
    /// Median distance of the vertices within 3 mm.
    pub median_within: f64,
    /// How template and scan cover each other; in the report it is part of the evidence.
    #[serde(skip)]
    pub coverage: Coverage,
    /// Triangles whose normal turned by more than 90 degrees against the rest shape, after the best rigid motion.
    pub flipped: usize,
    /// Self-intersections and edge stretch against the rest shape.
    #[serde(flatten)]
    pub mesh: MeshQuality,
}

/// Distance in millimetres up to which a vertex counts as on the scan in [`Quality`].
pub const WITHIN_MM: f64 = 3.0;

impl Quality {
    /// Measures a result on the scan as it was registered; that of `input` takes no part.
    ///
    /// # Errors
    /// When the vertex counts differ.
    pub fn measure(
        input: &RegistrationInput<'_>,
        scan: &ScanSurface,
        positions: &[Vec3],
    ) -> Result<Self, QualityError> {
        let rest = TriangleMesh { positions: input.rest_positions().to_vec(), ..input.template.triangulate() };
        Self::counted(input, &hidden_vertices(&rest)?, scan, positions, None)
    }

    /// The same; the template hides `hidden` from scanners, and self-intersections are those of `untangled`, where they were counted.
    pub(super) fn counted(
        input: &RegistrationInput<'_>,
        hidden: &[bool],
        scan: &ScanSurface,
        positions: &[Vec3],
        untangled: Option<Untangled>,
    ) -> Result<Self, QualityError> {
        for (what, mask) in [("the mask", input.mask), ("the free mask", input.free_mask)] {
            let (expected, found) = (positions.len(), mask.map_or(positions.len(), <[f64]>::len));
            if found != expected {
                return Err(EvaluationError::VertexCount { what, expected, found }.into());
            }
        }
        let mut template = input.template.clone();
        template.positions = input.rest_positions().to_vec();
        let (seen, mesh) = rayon::join(
            || Seen::new(input, hidden, scan, positions),
            || match untangled {
                Some(known) => MeshQuality::with_counts(&template, positions, known.after, known.at_rest),
                None => MeshQuality::new(&template, positions),
            },
        );
        let Seen { distances, coverage, .. } = seen?;
        let within: Vec<f64> = distances.iter().copied().filter(|d| *d <= WITHIN_MM).collect();
        let rest = input.rest_positions();
        let pairs: Vec<_> = rest.iter().copied().zip(positions.iter().copied()).collect();
        let pose = closest_pose(&pairs, PoseKind::Rigid).unwrap_or_else(|_| Pose::identity());
        let posed: Vec<Vec3> = rest.iter().map(|&p| pose.apply(p)).collect();
        Ok(Self {
            to_scan: DistanceSummary::new(&distances, WITHIN_MM),
            median_within: DistanceSummary::new(&within, WITHIN_MM).median,
            coverage,
            flipped: flipped_triangles(&posed, positions, &template.triangulate().triangles)?,
            mesh: mesh?,
        })
    }
}

/// Why a result could not be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// Its geometry cannot be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The result.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
}

/// The report, as it is written to JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this crate.
    pub version: String,
    /// Model name.
    pub model: String,
    /// What was read.
    pub inputs: Vec<InputFile>,
    /// Regions outside of which the scan was not looked at; none for everywhere.
    pub regions: Vec<String>,
    /// Regions that followed smoothness alone.
    pub free_regions: Vec<String>,
    /// Units of the inputs, by what they were read as.
    pub units: BTreeMap<String, KnownUnit>,
    /// The schedule as it was used.
    pub schedule: Schedule,
    /// Where the registration started.
    pub start: Pose,
    /// How the start was found, where fewer than three landmarks gave it.
    pub start_search: Option<StartSearch>,
    /// What the landmarks say of the start, where three or more gave it.
    pub start_landmarks: Option<LandmarkStart>,
    /// The expression that it started with instead of rest, where few landmarks said which face it is.
    pub start_expression: Option<String>,
    /// Whether it started bent instead of at rest.
    pub start_bent: bool,
    /// What was done to the scan so that it faces outwards.
    pub scan_facing: ScanFacing,
    /// What was done to the template, for the registration alone, so that it is one surface.
    pub template_repair: TemplateRepair,
    /// What was taken apart after the last step, if the schedule says so.
    pub untangled: Option<Untangled>,
    /// Why it ended.
    pub stop: RegistrationStop,
    /// Share of the template's vertices with an accepted correspondence at the end, of those that no mask takes out.
    pub inliers: f64,
    /// Directions that nothing observed and damping held still, in the last step.
    pub unobserved_directions: usize,
    /// How well the result fits.
    pub quality: Quality,
    /// Vertices whose colour the scan shows, of those of the template; `None` without colours.
    pub colors_observed: Option<usize>,
    /// Share of the template's part of a baked texture that the scan shows; `None` if none was baked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_seen: Option<f64>,
    /// The finer mesh that the result was divided into; `None` if it was not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<DetailReport>,
    /// Probability that the result is wrong, what speaks for it, and what both rest on.
    #[serde(flatten)]
    pub reliability: Reliability,
    /// Blendshape weights by name, with their standard deviations.
    pub weights: Vec<NamedWeight>,
    /// Every step.
    pub history: Vec<StepRecord>,
}

impl Report {
    /// The report of a result, and of how far it can be believed.
    #[must_use]
    pub fn new(
        model: &str,
        inputs: Vec<InputFile>,
        result: &RegistrationResult,
        quality: Quality,
        reliability: Reliability,
    ) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            model: model.to_owned(),
            inputs,
            regions: Vec::new(),
            free_regions: Vec::new(),
            units: BTreeMap::new(),
            schedule: result.schedule.clone(),
            start: result.start,
            start_search: result.start_search.clone(),
            start_landmarks: result.start_landmarks.clone(),
            start_expression: result.start_expression.clone(),
            start_bent: result.start_bent,
            scan_facing: result.scan_facing,
            template_repair: result.template_repair,
            untangled: result.untangled,
            stop: result.stop,
            inliers: result.history.last().map_or(0.0, |h| h.inliers),
            unobserved_directions: result.unobserved_directions,
            quality,
            colors_observed: None,
            texture_seen: None,
            detail: None,
            reliability,
            weights: result.weights.clone(),
            history: result.history.clone(),
        }
    }
}
