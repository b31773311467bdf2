//! Faces with the 68 landmarks that presets need.

use anyhow::{Context, Result, bail};
use nonrigid::landmark::TemplatePoint;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::morph::{Recipe, ReplayOptions, StepOutcome, Subject, replay};
use nonrigid::rig::{Regions, ShapeBasis};

use crate::scan_bench::BenchRig;

/// A face with its 68 landmarks.
#[derive(Clone)]
pub struct Patient {
    /// Name in tables.
    pub name: String,
    /// The face.
    pub mesh: PolygonMesh,
    /// By number.
    pub landmarks: Vec<(String, TemplatePoint)>,
    /// For models that use them.
    pub shapes: ShapeBasis,
    regions: Regions,
}

impl Patient {
    /// A mesh with the polygons of a rig, and the rig's landmarks.
    ///
    /// # Errors
    /// When there are no 68.
    pub fn new(
        name: impl Into<String>,
        mesh: PolygonMesh,
        landmarks: Option<&[u32]>,
        shapes: ShapeBasis,
    ) -> Result<Self> {
        let landmarks =
            all68(landmarks)?.iter().enumerate().map(|(k, v)| (k.to_string(), TemplatePoint::Vertex(*v))).collect();
        Ok(Self { name: name.into(), regions: Regions::of_groups(&mesh), mesh, landmarks, shapes })
    }

    /// The same face elsewhere, or otherwise.
    #[must_use]
    pub fn standing_at(&self, positions: &[Vec3]) -> Self {
        Self { mesh: self.mesh.with_positions(positions.to_vec()), ..self.clone() }
    }

    /// Follows a recipe of one step.
    ///
    /// # Errors
    /// As [`replay`].
    pub fn morph(&self, recipe: &Recipe, options: &ReplayOptions) -> Result<StepOutcome> {
        let Self { mesh, landmarks, regions, shapes, .. } = self;
        let mut outcomes = replay(recipe, &Subject { mesh, landmarks, regions, shapes }, options)?;
        match (outcomes.pop(), outcomes.is_empty()) {
            (Some(outcome), true) => Ok(outcome),
            _ => bail!("a recipe of one step"),
        }
    }
}

fn all68(landmarks: Option<&[u32]>) -> Result<&[u32]> {
    let all = landmarks.filter(|l| l.len() == 68);
    all.context("the rig has no landmarks_multipie68.json: presets need the 68 landmarks")
}

/// Places of the 68 landmarks on a rig's template.
///
/// # Errors
/// When the rig has none.
pub fn landmarks68(rig: &BenchRig) -> Result<Vec<Vec3>> {
    Ok(all68(rig.rig().landmarks())?.iter().map(|v| rig.template().positions[*v as usize]).collect())
}
