//! A registration of arrays in memory, stated step by step.

use super::{
    ModelKind, RegistrationError, RegistrationInput, RegistrationObserver, RegistrationResult, Schedule, Silent,
    WarmStart, register,
};
use crate::landmark::Landmark;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::rig::{Regions, ShapeBasis};

/// What is registered, with what model and schedule. Everything but template and scan is optional.
///
/// ```
/// use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
/// use nonrigid::landmark::Landmark;
/// use nonrigid::registration::Registration;
///
/// // A bowl of 9 x 9 vertices, and the same bowl 5 mm higher.
/// let bowl = |z: f64| (0..81).map(move |i| Vec3::new(f64::from(i % 9), f64::from(i / 9), 0.0) * 10.0)
///     .map(move |p| p + Vec3::new(0.0, 0.0, z + 0.01 * ((p.x - 40.0).powi(2) + (p.y - 40.0).powi(2)) + 0.1 * p.x));
/// let quads = (0..64u32).map(|i| i / 8 * 9 + i % 8).map(|v| [v, v + 1, v + 10, v + 9]);
/// let triangles = quads.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
/// let template = TriangleMesh { positions: bowl(0.0).collect(), triangles };
/// let scan = TriangleMesh { positions: bowl(5.0).collect(), ..template.clone() };
/// let template = PolygonMesh::from(template);
///
/// let landmarks = [0, 8, 72, 76].map(|v: u32| Landmark::new(format!("point {v}"), v, scan.positions[v as usize]));
/// let result = Registration::new(&template, &scan).landmarks(&landmarks).run()?;
/// assert!((result.positions[40] - scan.positions[40]).norm() < 0.1);
/// # Ok::<(), nonrigid::registration::RegistrationError>(())
/// ```
pub struct Registration<'a> {
    input: RegistrationInput<'a>,
    model: Option<ModelKind>,
    schedule: Option<Schedule>,
    observer: Option<&'a mut dyn RegistrationObserver>,
}

impl<'a> Registration<'a> {
    /// A template and a scan; the scan's triangles, or a point cloud with [`scan_normals`](Self::scan_normals).
    #[must_use]
    pub fn new(template: &'a PolygonMesh, scan: &'a TriangleMesh) -> Self {
        let input = RegistrationInput::new(template, scan);
        Self { input, model: None, schedule: None, observer: None }
    }

    /// The rest shape instead of the template's own: one position per template vertex.
    #[must_use]
    pub fn neutral(mut self, positions: &'a [Vec3]) -> Self {
        self.input.neutral = Some(positions);
        self
    }

    /// Blendshapes on the template's vertices.
    #[must_use]
    pub fn shapes(mut self, shapes: &'a ShapeBasis) -> Self {
        self.input.shapes = shapes;
        self
    }

    /// The scan's own normals, one per vertex, of any length.
    #[must_use]
    pub fn scan_normals(mut self, normals: &'a [Vec3]) -> Self {
        self.input.scan_normals = Some(normals);
        self
    }

    /// Landmarks; three or more give the start, which is searched otherwise.
    #[must_use]
    pub fn landmarks(mut self, landmarks: &'a [Landmark]) -> Self {
        self.input.landmarks = landmarks;
        self
    }

    /// Weight of the data at each template vertex, 0 to 1.
    #[must_use]
    pub fn mask(mut self, weights: &'a [f64]) -> Self {
        self.input.mask = Some(weights);
        self
    }

    /// Share by which each template vertex follows smoothness alone, 0 to 1.
    #[must_use]
    pub fn free_mask(mut self, shares: &'a [f64]) -> Self {
        self.input.free_mask = Some(shares);
        self
    }

    /// Named regions of the template, for models that the schedule tells about them.
    #[must_use]
    pub fn regions(mut self, regions: &'a Regions) -> Self {
        self.input.regions = Some(regions);
        self
    }

    /// Where the registration of the frame before has ended.
    #[must_use]
    pub fn warm_start(mut self, state: &'a WarmStart) -> Self {
        self.input.warm_start = Some(state);
        self
    }

    /// The deformation model; unless stated the hybrid, or without shapes Sumner's graph, as on the command line.
    #[must_use]
    pub fn model(mut self, model: ModelKind) -> Self {
        self.model = Some(model);
        self
    }

    /// A schedule instead of the model's default.
    #[must_use]
    pub fn schedule(mut self, schedule: Schedule) -> Self {
        self.schedule = Some(schedule);
        self
    }

    /// What sees every step and may stop the run.
    #[must_use]
    pub fn observer(mut self, observer: &'a mut dyn RegistrationObserver) -> Self {
        self.observer = Some(observer);
        self
    }

    /// Registers.
    ///
    /// # Errors
    /// When the inputs do not fit together, the schedule is wrong, no start is found, or the minimisation fails.
    pub fn run(self) -> Result<RegistrationResult, RegistrationError> {
        let unstated = if self.input.shapes.is_empty() { ModelKind::Sumner } else { ModelKind::Hybrid };
        let model = self.model.unwrap_or(unstated);
        let schedule = self.schedule.map_or_else(|| model.schedule(), Ok)?;
        register(&self.input, &model, &schedule, self.observer.unwrap_or(&mut Silent))
    }
}
