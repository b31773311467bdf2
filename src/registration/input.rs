//! What is registered to what, and whether it fits together.

use super::{RegistrationError, WarmStart};
use crate::correspondence::{VertexMasks, check_normals};
use crate::energy::SampleError;
use crate::landmark::{Landmark, TemplatePoint};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::model::ModelFactory;
use crate::rig::{Regions, ShapeBasis};

/// What is registered to what.
#[derive(Debug, Clone, Copy)]
pub struct RegistrationInput<'a> {
    /// The template: polygons, and positions unless `neutral` is given.
    pub template: &'a PolygonMesh,
    /// The rest shape, if it is not the template's own: one position per template vertex.
    pub neutral: Option<&'a [Vec3]>,
    /// Blendshapes on the template's vertices; [`ShapeBasis::none`] for models without.
    pub shapes: &'a ShapeBasis,
    /// The scan: triangles, or a point cloud without any.
    pub scan: &'a TriangleMesh,
    /// The scan's own vertex normals, where it has any; computed from the triangles otherwise. A point cloud needs them.
    pub scan_normals: Option<&'a [Vec3]>,
    /// Landmarks. Three or more start the registration, fewer hold the search of a start; all of them take part in it where the schedule weights them.
    pub landmarks: &'a [Landmark],
    /// Weight of the data terms at each template vertex, 0 to 1: what the scan says there counts as much. Landmarks keep
    /// their own weight, and where the mask is 0 the prediction takes over.
    pub mask: Option<&'a [f64]>,
    /// Share by which each template vertex is free, 0 to 1: 1 for a vertex that follows smoothness alone, without
    /// correspondences, prediction and seams, such as the bags of eyes and mouth.
    pub free_mask: Option<&'a [f64]>,
    /// Named regions of the template, for models that a schedule tells about them (`modulus` of finite elements).
    pub regions: Option<&'a Regions>,
    /// Where the registration of the frame before has ended, to go on from there.
    pub warm_start: Option<&'a WarmStart>,
}

impl<'a> RegistrationInput<'a> {
    /// A template and a scan, nothing else: no neutral, no shapes, no landmarks.
    ///
    /// Add the rest with `RegistrationInput { shapes: &shapes, ..RegistrationInput::new(&template, &scan) }`.
    #[must_use]
    pub fn new(template: &'a PolygonMesh, scan: &'a TriangleMesh) -> Self {
        static NO_SHAPES: std::sync::LazyLock<ShapeBasis> = std::sync::LazyLock::new(ShapeBasis::none);
        Self {
            template,
            neutral: None,
            shapes: &NO_SHAPES,
            scan,
            scan_normals: None,
            landmarks: &[],
            mask: None,
            free_mask: None,
            regions: None,
            warm_start: None,
        }
    }

    /// The positions that the registration deforms: `neutral`, or else the template's.
    #[must_use]
    pub fn rest_positions(&self) -> &[Vec3] {
        self.neutral.unwrap_or(&self.template.positions)
    }
}

pub(super) fn check_input(input: &RegistrationInput<'_>, model: &dyn ModelFactory) -> Result<(), RegistrationError> {
    check_geometry(input)?;
    if model.needs_shapes() && input.shapes.is_empty() {
        return Err(RegistrationError::NeedsShapes(model.name().to_owned()));
    }
    Ok(())
}

pub(super) fn check_geometry(input: &RegistrationInput<'_>) -> Result<(), RegistrationError> {
    let vertices = input.template.positions.len();
    if input.template.polygon_count() == 0 {
        return Err(RegistrationError::EmptyTemplate);
    }
    check_numbers(input)?;
    check_normals(input.scan, input.scan_normals)?;
    for (what, found) in [
        ("neutral", input.neutral.map(<[Vec3]>::len)),
        ("rig", (!input.shapes.is_empty()).then(|| input.shapes.vertex_count())),
        ("set of regions", input.regions.map(Regions::vertex_count)),
    ] {
        if let Some(found) = found.filter(|n| *n != vertices) {
            return Err(RegistrationError::VertexCount { what, found, template: vertices });
        }
    }
    check_mask("mask", input.mask, vertices)?;
    check_mask("free mask", input.free_mask, vertices)?;
    if VertexMasks::new(input.mask, input.free_mask, vec![false; vertices]).counted() == 0 {
        return Err(RegistrationError::EmptyMask);
    }
    Ok(())
}

/// Refuses coordinates that are not finite and triangles of vertices that do not exist. Files have none; callers may.
fn check_numbers(input: &RegistrationInput<'_>) -> Result<(), RegistrationError> {
    let targets: Vec<Vec3> = input.landmarks.iter().map(|l| l.target).collect();
    for (what, points) in [
        ("template", &input.template.positions[..]),
        ("neutral", input.neutral.unwrap_or_default()),
        ("scan", &input.scan.positions),
        ("landmarks", &targets),
    ] {
        if let Some(index) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(RegistrationError::NotFinite { what, index });
        }
    }
    let count = input.template.positions.len();
    for landmark in input.landmarks {
        let corners = match landmark.template {
            TemplatePoint::Vertex(v) => [v; 3],
            TemplatePoint::Face { corners, .. } => corners,
        };
        if let Some(vertex) = corners.map(|v| v as usize).into_iter().find(|v| *v >= count) {
            return Err(SampleError::VertexOutOfRange { vertex, count }.into());
        }
        if let Some(sigma) = landmark.sigma.filter(|s| !(*s > 0.0 && s.is_finite())) {
            return Err(RegistrationError::LandmarkSigma { name: landmark.name.clone(), sigma });
        }
    }
    input.scan.check_indices().map_err(|e| RegistrationError::Scan(e.to_string()))?;
    input.template.triangulate().check_indices().map_err(|e| RegistrationError::Template(e.to_string()))
}

/// Refuses a mask that has not one value from 0 to 1 per vertex.
pub(super) fn check_mask(what: &'static str, mask: Option<&[f64]>, vertices: usize) -> Result<(), RegistrationError> {
    let Some(mask) = mask else { return Ok(()) };
    if mask.len() != vertices {
        return Err(RegistrationError::VertexCount { what, found: mask.len(), template: vertices });
    }
    match mask.iter().position(|m| !(0.0..=1.0).contains(m)) {
        Some(vertex) => Err(RegistrationError::MaskValue { what, vertex, value: mask[vertex] }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_masks_are_named() {
        let message = |mask: &[f64]| check_mask("mask", Some(mask), 3).unwrap_err().to_string();
        assert!(message(&[1.0; 4]).contains("mask has 4"));
        for (value, text) in [(f64::NAN, "NaN"), (-0.5, "-0.5"), (1.5, "1.5"), (f64::INFINITY, "inf")] {
            let message = message(&[0.0, 1.0, value]);
            assert!(message.contains("vertex 2") && message.contains(text), "{message}");
        }
        assert_eq!(check_mask("mask", Some(&[0.0, 0.3, 1.0]), 3), Ok(()));
        assert_eq!(check_mask("mask", None, 3), Ok(()));
    }
}
