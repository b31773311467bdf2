//! Faces with the 68 landmarks that presets need.

use anyhow::{Context, Result, bail};
use nonrigid::landmark::TemplatePoint;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::morph::{
    Constraints, EnergyOptions, MaskedDisplacement, MorphEnergy, MorphModel, MorphStep, Recipe, ReplayOptions,
    StepOutcome, Subject, preset, replay,
};
use nonrigid::rig::{Regions, ShapeBasis, ShapeSelection};

use crate::generated::Studio;
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

    /// The generated face of about `vertices` vertices, with its first identity modes.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn generated(vertices: usize, identity_modes: usize) -> Result<Self> {
        let studio = Studio::new(vertices)?;
        let shapes = studio.rig().select(ShapeSelection { names: Some(&[]), identity_modes })?;
        Self::new(vertices.to_string(), studio.template().clone(), Some(&studio.landmarks()), shapes)
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

/// The mask of a preset on a face, and what it asks for.
#[derive(Clone)]
pub struct Masked {
    /// The face.
    pub patient: Patient,
    /// Its triangles.
    pub triangles: TriangleMesh,
    /// The mask, and the displacement where it is 1.
    pub step: MorphStep,
}

impl Masked {
    /// Draws the mask of a preset that has one, without a mirror image; `amount` is in millimetres.
    ///
    /// # Errors
    /// When there is no such preset, or it does not suit the face.
    pub fn new(patient: Patient, name: &str, amount: f64) -> Result<Self> {
        let recipe = preset(name).with_context(|| format!("no preset {name}"))??;
        let options = ReplayOptions { amount: Some(amount), model: Some(MorphModel::Direct), until: None };
        let outcome = patient.morph(&recipe, &options)?;
        let [mask] = &outcome.masks[..] else { bail!("preset {name}: one mask") };
        let weights = mask.weights.clone();
        let values = weights.values();
        let moved = |v: usize| outcome.positions[v] - patient.mesh.positions[v];
        let most = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).context("a face of vertices")?;
        let displacement = moved(most) / values[most];
        let step = MorphStep { pairs: vec![MaskedDisplacement { weights, displacement }], ..MorphStep::default() };
        let direct = step.apply(&patient.mesh.positions)?;
        if direct.iter().zip(&outcome.positions).any(|(a, b)| (a - b).norm() > 1e-9 * displacement.norm()) {
            bail!("preset {name}: a mask without a mirror image");
        }
        Ok(Self { triangles: patient.mesh.triangulate(), patient, step })
    }

    /// The displacement asked for where the mask is 1.
    #[must_use]
    pub fn displacement(&self) -> Vec3 {
        self.step.pairs[0].displacement
    }

    /// The same mask as an energy.
    ///
    /// # Errors
    /// As [`MorphEnergy::new`].
    pub fn energy(&self, model: MorphModel, options: &EnergyOptions) -> Result<MorphEnergy> {
        let (shapes, none) = (&self.patient.shapes, Constraints::default());
        Ok(MorphEnergy::new(&self.triangles, &self.step, &none, model, shapes, options)?)
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
