//! Measurements of a face: distances, angles and ratios between named landmarks, symmetry, areas and volumes by region; of one
//! shape, or of two with the same vertices, before and after.
//!
//! [`Subject::measure`] gives the numbers ([`Measurements`]), which serialise to JSON, print as tables and write as CSV;
//! [`report::write`] puts them into a folder with pictures and a page. What is measured is one table, [`DEFINITIONS`], over the
//! landmarks of another, [`LANDMARKS`]. A measurement whose landmarks are not given has no value, and says which.
//!
//! Everything moves with the mesh: turned and shifted, it measures the same, and so does a face after whose head is held otherwise; only
//! displacements and volumes are those of the motion too, unless that is taken out ([`HeadMotion`]). Lengths are millimetres.
//! [`Subject::compare`] puts several shapes after beside each other.
//!
//! ```
//! use nonrigid::measurement::{Landmarks, Subject};
//! use nonrigid::{landmark::TemplatePoint, mesh::{TriangleMesh, Vec3}};
//!
//! let positions = vec![Vec3::new(-30., 0., 0.), Vec3::new(30., 0., 0.), Vec3::new(0., -80., 20.)];
//! let mesh = TriangleMesh { positions, triangles: vec![[0, 2, 1]] }.into();
//! let mut landmarks = Landmarks::default();
//! landmarks.add(&["exocanthion_right", "exocanthion_left", "menton"].map(|name| name.to_owned()).into_iter()
//!     .zip((0..).map(TemplatePoint::Vertex)).collect::<Vec<_>>())?;
//! let measured = Subject { landmarks: &landmarks, ..Subject::new(&mesh) }.measure()?;
//! assert_eq!(measured.value("biocular_width"), Some(60.0));
//! assert_eq!(measured.value("face_height"), None);
//! # Ok::<(), nonrigid::measurement::MeasurementError>(())
//! ```

mod change;
mod definitions;
mod error;
mod landmarks;
mod motion;
mod output;
pub mod report;
mod symmetry;

use serde::Serialize;

pub use change::{Change, swept_volume};
pub use definitions::{Axis, DEFINITIONS, Definition, FacialFrame, Formula, Missing, TypicalRange};
pub use error::MeasurementError;
pub use landmarks::{LANDMARKS, LandmarkDefinition, Landmarks};
pub use motion::HeadMotion;
pub use output::glossary;
pub use symmetry::{Asymmetry, Symmetry, SymmetryOptions};

use change::{Areas, Changes, Part};
use definitions::evaluate;
use landmarks::Placed;
use motion::head_motion;

use crate::mesh::{PolygonMesh, TriangleMesh, Vec3, check_finite};

/// What is to be measured.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The face, before if there is an after.
    pub mesh: &'a PolygonMesh,
    /// The same vertices after.
    pub after: Option<&'a [Vec3]>,
    /// Where the landmarks are. Without any, only the surface is measured.
    pub landmarks: &'a Landmarks,
    /// Parts of the face, besides the whole.
    pub regions: &'a [NamedRegion<'a>],
}

/// A named part of a face: a set of vertices, or a group of polygons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NamedRegion<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its vertices.
    pub vertices: &'a [u32],
    /// Its polygons, which count whole, if it is a group of them. Of a set of vertices a triangle counts by a third for each corner in it.
    pub polygons: Option<&'a [u32]>,
}

/// What a plan makes of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan<'a> {
    /// Its name.
    pub name: &'a str,
    /// The face's vertices after.
    pub positions: &'a [Vec3],
}

static NO_LANDMARKS: Landmarks = Landmarks::none();

impl<'a> Subject<'a> {
    /// One shape, without landmarks or regions.
    #[must_use]
    pub fn new(mesh: &'a PolygonMesh) -> Self {
        Self { mesh, after: None, landmarks: &NO_LANDMARKS, regions: &[] }
    }

    /// Measures everything.
    ///
    /// # Errors
    /// When a mesh is malformed, not finite or without a surface, the numbers of vertices differ, landmarks or regions have vertices
    /// past the end, or landmarks are given and no measurement has all of its own.
    pub fn measure(&self) -> Result<Measurements, MeasurementError> {
        self.check()?;
        let triangles = self.mesh.triangulate().triangles;
        let before = Face::new("the mesh", &self.mesh.positions, &triangles, self.landmarks, None)?;
        let of_before = (&before, &self.mesh.positions[..]);
        let after = self.after.map(|p| Face::new("the mesh after", p, &triangles, self.landmarks, Some(of_before)));
        let after = after.transpose()?;
        let changes = self.after.map(|after| Changes::new(&self.mesh.positions, after, &triangles));

        let values = DEFINITIONS.iter().enumerate().map(|(k, definition)| {
            let (before, after) = (before.values[k].clone(), after.as_ref().map(|a| a.values[k].clone()).transpose());
            Measurement {
                definition: *definition,
                before: before.as_ref().ok().copied(),
                after: after.as_ref().ok().copied().flatten(),
                missing: before.err().or(after.err()),
            }
        });
        let values: Vec<Measurement> = if self.landmarks.is_empty() { Vec::new() } else { values.collect() };
        if !values.is_empty() && values.iter().all(|v| v.before.is_none()) {
            let given = self.landmarks.names().collect::<Vec<_>>().join(", ");
            return Err(MeasurementError::NothingMeasured { given });
        }
        let region = |name: &str, part: &Part| {
            let state = |face: &Face| RegionState {
                area: face.areas.of(part),
                asymmetry: face.symmetry.of(part.vertices.iter().copied()),
            };
            RegionMeasurement {
                name: name.to_owned(),
                vertices: part.vertices.len(),
                before: state(&before),
                after: after.as_ref().map(state),
                change: changes.as_ref().map(|c| c.of(part)),
            }
        };
        let parts = self.regions.iter().map(|r| region(r.name, &Part::of(r, self.mesh, &triangles)));
        let whole = region(WHOLE, &Part::whole(self.mesh, &triangles));
        let regions = std::iter::once(whole).chain(parts).collect();
        Ok(Measurements {
            version: env!("CARGO_PKG_VERSION"),
            values,
            regions,
            before: before.into_state(),
            after: after.map(Face::into_state),
        })
    }

    /// Measures several shapes after beside each other; the subject's own counts where none is given.
    ///
    /// # Errors
    /// As [`Subject::measure`].
    pub fn compare(&self, plans: &[Plan<'a>]) -> Result<Comparison, MeasurementError> {
        if plans.is_empty() {
            let names = self.after.iter().map(|_| AFTER.to_owned()).collect();
            return Ok(Comparison { names, all: vec![self.measure()?] });
        }
        let all = plans.iter().map(|plan| Self { after: Some(plan.positions), ..*self }.measure());
        Ok(Comparison { names: plans.iter().map(|p| p.name.to_owned()).collect(), all: all.collect::<Result<_, _>>()? })
    }

    fn check(&self) -> Result<(), MeasurementError> {
        let vertices = self.mesh.positions.len();
        if let Some(after) = self.after
            && after.len() != vertices
        {
            return Err(MeasurementError::VertexCount {
                what: "the mesh after",
                found: after.len(),
                expected: vertices,
            });
        }
        for (what, positions) in [("the mesh", Some(&self.mesh.positions[..])), ("the mesh after", self.after)] {
            check_finite(positions.unwrap_or(&[])).map_err(|source| MeasurementError::Mesh { what, source })?;
        }
        for region in self.regions {
            if let Some(&vertex) = region.vertices.iter().find(|v| **v as usize >= vertices) {
                let what = format!("region {:?}", region.name);
                return Err(MeasurementError::NoSuchVertex { what, vertex, vertices });
            }
            let polygons = self.mesh.polygon_count();
            if let Some(&polygon) = region.polygons.unwrap_or_default().iter().find(|f| **f as usize >= polygons) {
                return Err(MeasurementError::NoSuchPolygon { region: region.name.to_owned(), polygon, polygons });
            }
        }
        if let Some(&vertex) = self.mesh.corners.iter().find(|v| **v as usize >= vertices) {
            return Err(MeasurementError::NoSuchVertex { what: "a polygon".to_owned(), vertex, vertices });
        }
        Ok(())
    }
}

/// Name of the shape after, where it has none of its own.
pub const AFTER: &str = "after";

/// Name of the whole surface among the regions.
pub const WHOLE: &str = "whole";

/// One of the two shapes.
struct Face {
    placed: Placed,
    areas: Areas,
    frame: Result<FacialFrame, Missing>,
    values: Vec<Result<f64, Missing>>,
    symmetry: Symmetry,
}

impl Face {
    fn new(
        what: &'static str,
        positions: &[Vec3],
        triangles: &[[u32; 3]],
        landmarks: &Landmarks,
        before: Option<(&Self, &[Vec3])>,
    ) -> Result<Self, MeasurementError> {
        let placed = landmarks.placed(positions)?;
        let mesh = TriangleMesh { positions: positions.to_vec(), triangles: triangles.to_vec() };
        let mut frame = FacialFrame::of(&placed, &mesh);
        if frame.as_ref().is_ok_and(|frame| frame.is_mirrored(&placed, &mesh)) {
            return Err(MeasurementError::Mirrored(what));
        }
        let start = frame.as_ref().ok().map(|f| f.plane).or(before.map(|(b, _)| b.symmetry.plane));
        let symmetry = Symmetry::find(&mesh, start, &SymmetryOptions::default(), what)?;
        if let Some((before, of_before)) = before {
            let motion = head_motion(of_before, positions, &before.symmetry.areas)?;
            frame = before.frame.clone().map(|frame| frame.carried(&motion));
        }
        let values = evaluate(&placed, &frame);
        Ok(Self { placed, areas: Areas::new(positions, triangles), frame, values, symmetry })
    }

    fn into_state(self) -> FaceState {
        let landmarks = LANDMARKS.iter().zip(self.placed).filter_map(|(l, p)| Some((l.name, p?))).collect();
        FaceState { frame: self.frame.ok(), symmetry: self.symmetry, landmarks }
    }
}

/// Everything that was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurements {
    /// Version of this library.
    pub version: &'static str,
    /// In the order of [`DEFINITIONS`]; empty without landmarks.
    pub values: Vec<Measurement>,
    /// The whole surface, then each region.
    pub regions: Vec<RegionMeasurement>,
    /// The first shape.
    pub before: FaceState,
    /// The second.
    pub after: Option<FaceState>,
}

/// Shapes after, measured beside each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    names: Vec<String>,
    /// One for each name; the face alone where there is none.
    all: Vec<Measurements>,
}

impl Comparison {
    /// The face before: any of them.
    #[must_use]
    pub fn before(&self) -> &Measurements {
        &self.all[0]
    }

    /// The shapes after, with their names.
    pub fn plans(&self) -> impl ExactSizeIterator<Item = (&str, &Measurements)> {
        self.names.iter().map(String::as_str).zip(&self.all)
    }
}

/// One measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// What it is.
    pub definition: Definition,
    /// Its value, in the unit of its formula.
    pub before: Option<f64>,
    /// The same after.
    pub after: Option<f64>,
    /// Why there is none, before or after.
    pub missing: Option<Missing>,
}

/// What was measured of a region.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionMeasurement {
    /// Its name.
    pub name: String,
    /// Number of its vertices.
    pub vertices: usize,
    /// Of the first shape.
    pub before: RegionState,
    /// Of the second.
    pub after: Option<RegionState>,
    /// From one to the other.
    pub change: Option<Change>,
}

/// A region of one shape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RegionState {
    /// Its area, square millimetres.
    pub area: f64,
    /// How far it is from the mirror image of the other side.
    pub asymmetry: Asymmetry,
}

/// Axes and symmetry of one shape.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceState {
    /// Axes from the landmarks, if they fix them; after, those of the face before, carried along by the motion of the head.
    pub frame: Option<FacialFrame>,
    /// Symmetry of the surface.
    pub symmetry: Symmetry,
    /// Where the landmarks are.
    pub landmarks: Vec<(&'static str, Vec3)>,
}

impl Measurements {
    /// The value of a measurement before, if it has one.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<f64> {
        self.measurement(name)?.before
    }

    /// A measurement by its name.
    #[must_use]
    pub fn measurement(&self, name: &str) -> Option<&Measurement> {
        self.values.iter().find(|m| m.definition.name == name)
    }
}
