//! The registration itself: non-rigid ICP. For each level of the schedule: new correspondences, one step of the solver (Gauss-Newton
//! unless the schedule says otherwise), again.

use std::borrow::Cow;
use std::ops::ControlFlow;

use serde::Serialize;

use super::facing::{self, Faced, ScanFacing, ScanFlip};
use super::start::{self, LandmarkStart, Start, StartInput};
use super::{
    Correspondences, KernelScale, Level, ModelFactory, ModelInput, RegistrationError, RegistrationModel,
    RegistrationTerm, ScanPoints, ScanSurface, Schedule, ScheduleError, Seams, SolverOptions, StartSearch,
    StepAlgorithm, TermFactory, TermInput, TermKind, VertexMasks, WarmStart, masks, scan,
};
use crate::energy::{Deformation, DeformationModel as _, Samples};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::io::{Landmark, TemplatePoint};
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::{MeshError, PolygonMesh, Pose, TriangleMesh, Vec3, referenced, surface_points};
use crate::model::Linearisation;
use crate::nlls::{
    Algorithm, Dogleg, GaussNewton, IterationRecord, LevenbergMarquardt, Minimizer, Options, Problem as _, StopReason,
    Workspace,
};
use crate::rig::ShapeBasis;

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
            warm_start: None,
        }
    }

    /// The positions that the registration deforms: `neutral`, or else the template's.
    #[must_use]
    pub fn rest_positions(&self) -> &[Vec3] {
        self.neutral.unwrap_or(&self.template.positions)
    }
}

/// What happened in one step, as an observer sees it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepRecord {
    /// Level, from 0; counts on over the stages of the schedule.
    pub level: usize,
    /// Step within the level, from 0.
    pub step: usize,
    /// Energy before the step, at the step's correspondences.
    pub energy_before: f64,
    /// Energy after the step, at the step's correspondences: never more than before.
    pub energy: f64,
    /// The same by term and regulariser.
    pub energies: Vec<(String, f64)>,
    /// Share of the template's vertices with an accepted correspondence.
    pub inliers: f64,
    /// Largest motion of a vertex in this step, millimetres.
    pub motion: f64,
}

/// Sees every step and may stop the run; the result is then what was reached.
pub trait RegistrationObserver {
    /// Called once before the first step with the number of levels and the greatest number of steps.
    fn on_start(&mut self, _levels: usize, _steps: usize) {}

    /// Called after every step.
    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()>;

    /// Whether [`on_positions`](Self::on_positions) is called, asked after every step; positions cost nothing unless it says yes.
    fn wants_positions(&self) -> bool {
        false
    }

    /// Called right after [`on_step`](Self::on_step), also where that stops the run, with one position per template vertex in the
    /// scan's frame; those of the last call are the result's.
    fn on_positions(&mut self, _record: &StepRecord, _positions: &[Vec3]) {}
}

impl<F: FnMut(&StepRecord) -> ControlFlow<()>> RegistrationObserver for F {
    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self(record)
    }
}

/// Why a registration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RegistrationStop {
    /// The schedule was run to its end.
    Finished,
    /// The observer asked for it.
    StoppedByObserver,
}

/// A blendshape weight of a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NamedWeight {
    /// The shape.
    pub name: String,
    /// `w_k`.
    pub value: f64,
    /// Its standard deviation `sigma sqrt((S^-1)_kk)`: see [`border_covariance`](crate::nlls::border_covariance), and
    /// [`Deformation::residual_variance`] for sigma.
    ///
    /// It takes the correspondences of the last step as they are, the model as right, and the residuals as independent;
    /// neighbouring errors of a scan are alike, so read it as a lower bound and for comparing weights. `None` at a bound, where
    /// the curvature says nothing; and where neither data nor regulariser determine the weights.
    pub deviation: Option<f64>,
    /// Whether a bound of the schedule holds it.
    pub at_bound: bool,
}

/// A registered template.
#[derive(Debug, Clone)]
pub struct RegistrationResult {
    /// One position per template vertex, in the scan's frame.
    pub positions: Vec<Vec3>,
    /// Where the registration started.
    pub start: Pose,
    /// Where it ended, for the next frame.
    pub end: WarmStart,
    /// How the start was found, where it was searched: fewer than three landmarks gave it, or they left much of it open.
    pub start_search: Option<StartSearch>,
    /// What the landmarks say of the start, where three or more gave it.
    pub start_landmarks: Option<LandmarkStart>,
    /// What was done to the scan so that it faces outwards.
    pub scan_facing: ScanFacing,
    /// Blendshape weights by name, with their standard deviations; those of the first stage, for later ones have none.
    pub weights: Vec<NamedWeight>,
    /// Which vertices had an accepted correspondence at the end.
    pub accepted: Vec<bool>,
    /// Directions that nothing observed and damping held still, in the last step. Models of single vertices count the shifts of
    /// whole parts.
    pub weak_directions: usize,
    /// Every step.
    pub history: Vec<StepRecord>,
    /// Why it ended.
    pub stop: RegistrationStop,
    /// The schedule as it was used.
    pub schedule: Schedule,
}

/// Registers the template with the given model and the terms that come with the crate.
pub fn register(
    input: &RegistrationInput<'_>,
    model: &dyn ModelFactory,
    schedule: &Schedule,
    observer: &mut dyn RegistrationObserver,
) -> Result<RegistrationResult, RegistrationError> {
    let terms: Vec<&dyn TermFactory> = TermKind::ALL.iter().map(|t| t as &dyn TermFactory).collect();
    register_with(input, model, &terms, schedule, observer)
}

/// [`register`] with any terms.
pub fn register_with(
    input: &RegistrationInput<'_>,
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
    schedule: &Schedule,
    observer: &mut dyn RegistrationObserver,
) -> Result<RegistrationResult, RegistrationError> {
    schedule.validate()?;
    check_input(input, model)?;
    let mut template = Rest::new(input, schedule).map_err(|e| RegistrationError::Template(e.to_string()))?;
    let shapes = input.shapes.clone().with_sigmas(|shape| schedule.sigma.of(shape.family));
    let shapes = shapes.with_bounds(|shape| schedule.bounds.of(shape.family));
    let model_name = model.name().to_owned();
    let model = build(model, &ModelInput { rest: &template.mesh, shapes: &shapes, schedule })?;
    let mut samples = Samples::vertices(template.mesh.positions.len());
    let mut on_template = Vec::new();
    for landmark in input.landmarks {
        on_template.push(match landmark.template {
            TemplatePoint::Vertex(vertex) => vertex as usize,
            TemplatePoint::Face { corners, weights } => {
                samples.push(&std::array::from_fn::<_, 3, _>(|c| (corners[c], weights[c])))?
            }
        });
    }
    let mut problem: RegistrationProblem = Deformation::new(model, samples);
    let mut x = problem.model.rest_parameters();
    if let Some(warm) = input.warm_start {
        warm.check(&model_name, x.len())?;
        x.copy_from_slice(&warm.parameters);
    }
    if let Some(bounds) = problem.border_bounds() {
        bounds.validate(problem.structure().border(), x.len())?;
        bounds.project(&mut x);
    }
    let (faced, turned) = agreeing(input);
    let Start { pose: start, search: start_search, by_landmarks } = match input.warm_start {
        None => start_of(input, &faced, &template, schedule)?,
        Some(warm) => {
            let vertices = problem.vertices(&x);
            let at = |l: &Landmark| (l.template.position(vertices) + template.centre, l.target, l.weight(1.0));
            let pose = warm.pose_by(&input.landmarks.iter().map(at).collect::<Vec<_>>());
            Start { pose, search: None, by_landmarks: None }
        }
    };
    let to_rest = |p: Vec3| start.apply_inverse(p) - template.centre;
    let in_rest = |(scan, normals): &Faced<'_>| {
        let positions = scan.positions.iter().map(|&p| to_rest(p)).collect();
        let normals: Option<Vec<Vec3>> =
            normals.as_ref().map(|n| n.iter().map(|&n| start.rotation.tr_mul(&n)).collect());
        let scan = TriangleMesh { positions, triangles: scan.triangles.clone() };
        ScanSurface::new(scan, normals.as_deref(), &schedule.scan)
    };
    let searched = start_search.as_ref().map(|search| search.flipped);
    let (mut scan, mut scan_facing) = (None, ScanFacing { turned, flipped: schedule.scan.flip == ScanFlip::Yes });
    if schedule.scan.flip == ScanFlip::Auto {
        scan_facing.flipped = searched.unwrap_or(false);
        if searched.is_none() {
            let as_given = in_rest(&faced)?;
            scan_facing.flipped = template.sees_the_inside(&as_given, problem.vertices(&x));
            scan = Some(as_given).filter(|_| !scan_facing.flipped);
        }
    }
    let scan = match scan {
        Some(scan) => scan,
        None if scan_facing.flipped => in_rest(&facing::flipped(faced))?,
        None => in_rest(&faced)?,
    };
    let from_scan = schedule.levels_by_name().any(|(_, level)| level.scan_to_template > 0.0);
    let scan_points = from_scan.then(|| ScanPoints::new(&scan, &template.mesh));

    let sigma = schedule.sigma.landmark * template.unit * start.scale;
    let suspects = by_landmarks.as_ref().map_or(&[][..], |start| &start.suspects);
    let weight = |l: &Landmark| if suspects.iter().any(|s| s.name == l.name) { 0.0 } else { l.weight(sigma) };
    let targets = input.landmarks.iter().map(|l| (to_rest(l.target), weight(l)));
    let landmarks: Vec<(usize, Vec3, f64)> =
        on_template.into_iter().zip(targets).map(|(s, (p, w))| (s, p, w)).collect();
    let frame = Pose { translation: start.apply(template.centre), ..start };
    problem.terms.extend(terms.iter().map(|t| t.build(&TermInput { landmarks: &landmarks, frame })));
    let mut run = Run {
        start,
        scan_points,
        correspondences: Correspondences::default(),
        workspace: Workspace::new(),
        history: Vec::new(),
        vertices: problem.vertices(&x).to_vec(),
        level_names: schedule.levels_by_name().map(|l| l.0).collect(),
        first_level: 0,
    };
    let most_steps = input.warm_start.map_or(usize::MAX, |_| schedule.warm_start.steps);
    let first = schedule.levels.iter().map(|level| level.steps.min(most_steps));
    let later = schedule.levels_by_name().skip(schedule.levels.len()).map(|(_, level)| level.steps);
    observer.on_start(run.level_names.len(), first.chain(later).sum());
    let mut flow = run.stage(most_steps, schedule, &template, &scan, &mut problem, &mut x, observer)?;
    let end = WarmStart { model: model_name, pose: start, parameters: x.clone() };
    let weights = weights(&mut problem, &x, &mut run.workspace);
    let mut next = schedule.next_stage();
    while let (Some((model, schedule)), ControlFlow::Continue(())) = (&next, flow) {
        template.mesh.positions.copy_from_slice(&run.vertices);
        let model = build(model, &ModelInput { rest: &template.mesh, shapes: &ShapeBasis::none(), schedule })?;
        let terms = std::mem::take(&mut problem.terms);
        problem = Deformation::new(model, problem.samples().clone());
        problem.terms = terms;
        x = problem.model.rest_parameters();
        run.workspace = Workspace::new();
        flow = run.stage(usize::MAX, schedule, &template, &scan, &mut problem, &mut x, observer)?;
        next = schedule.next_stage();
    }
    Ok(RegistrationResult {
        positions: run.positions(template.centre),
        start,
        end,
        start_search,
        start_landmarks: by_landmarks,
        scan_facing,
        weights,
        accepted: run.correspondences.weights.iter().map(|&w| w > 0.0).collect(),
        weak_directions: problem.model.weak_directions().unwrap_or_else(|| run.workspace.summary().weak_directions()),
        history: run.history,
        stop: if flow.is_break() { RegistrationStop::StoppedByObserver } else { RegistrationStop::Finished },
        schedule: schedule.clone(),
    })
}

/// Damping of what nothing observes: see [`Options::damping_floor`].
const DAMPING_FLOOR: f64 = 1e-9;

/// The minimiser of a level's first step, or of a later one, which carries on from the step before.
fn minimizer(solver: &SolverOptions, carry_on: bool) -> Minimizer {
    let algorithm = match solver.algorithm {
        StepAlgorithm::GaussNewton => Algorithm::GaussNewton(GaussNewton::default()),
        StepAlgorithm::LevenbergMarquardt => Algorithm::LevenbergMarquardt(LevenbergMarquardt {
            reuse_lambda: carry_on,
            ..LevenbergMarquardt::default()
        }),
        StepAlgorithm::Dogleg => Algorithm::Dogleg(Dogleg { reuse_radius: carry_on, ..Dogleg::default() }),
    };
    let options = Options::default().with_algorithm(algorithm).with_linear_solver(solver.linear_solver);
    let options = options.with_damping_floor(DAMPING_FLOOR);
    Minimizer::new(options).expect("proven: the defaults and the floor are in bounds")
}

/// Ends a minimisation with its first step; those that are rejected before are trials.
fn one_step(record: &IterationRecord) -> ControlFlow<()> {
    if record.accepted { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// The model, with the linearisation that the schedule names.
fn build(factory: &dyn ModelFactory, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
    let mut model = factory.build(input)?;
    let linearisation = input.schedule.solver.linearisation;
    if linearisation == Linearisation::Reference && !model.set_linearisation(linearisation) {
        return Err(ScheduleError::Linearisation { model: factory.name().to_owned() }.into());
    }
    Ok(model)
}

/// The blendshape weights at the end, and how well the last correspondences determine them.
fn weights(problem: &mut RegistrationProblem, x: &[f64], workspace: &mut Workspace) -> Vec<NamedWeight> {
    let named = problem.model.named_weights(x);
    if named.is_empty() {
        return Vec::new();
    }
    let variance = problem.residual_variance(x);
    let covariance = workspace.border_covariance(problem, x, DAMPING_FLOOR).ok();
    let covariance = covariance.filter(|c| c.nrows() == named.len()).zip(variance);
    let bounds = problem.border_bounds().filter(|b| b.lower.len() == named.len());
    let weight = |(k, (name, value))| {
        let at_bound = bounds.is_some_and(|b| b.at_bound(x, k));
        let deviation = covariance.as_ref().filter(|_| !at_bound).map(|(c, variance)| (variance * c[(k, k)]).sqrt());
        NamedWeight { name, value, deviation, at_bound }
    };
    named.into_iter().enumerate().map(weight).collect()
}

/// Where [`register`] starts: by three or more landmarks in closed form, otherwise by a search, which then says what it found.
///
/// # Errors
/// Those of [`register`] before its first step.
pub fn find_start(
    input: &RegistrationInput<'_>,
    schedule: &Schedule,
) -> Result<(Pose, Option<StartSearch>), RegistrationError> {
    schedule.validate()?;
    check_geometry(input)?;
    let template = Rest::new(input, schedule).map_err(|e| RegistrationError::Template(e.to_string()))?;
    let start = start_of(input, &agreeing(input).0, &template, schedule)?;
    Ok((start.pose, start.search))
}

/// The scan, its triangles facing as their neighbours do unless it has normals of its own, or the template's do not either;
/// and how many were turned.
fn agreeing<'a>(input: &RegistrationInput<'a>) -> (Faced<'a>, usize) {
    match input.scan_normals {
        Some(normals) => ((Cow::Borrowed(input.scan), Some(Cow::Borrowed(normals))), 0),
        None => {
            let (scan, turned) = match facing::agreeing(&input.template.triangulate()) {
                (_, 0) => facing::agreeing(input.scan),
                _ => (Cow::Borrowed(input.scan), 0),
            };
            ((scan, None), turned)
        }
    }
}

fn start_of(
    input: &RegistrationInput<'_>,
    (scan, scan_normals): &Faced<'_>,
    rest: &Rest,
    schedule: &Schedule,
) -> Result<Start, RegistrationError> {
    let (scan, scan_normals): (&TriangleMesh, Option<&[Vec3]>) = (scan, scan_normals.as_deref());
    let at = |l: &Landmark| l.template.position(&rest.mesh.positions) + rest.centre;
    let landmarks: Vec<_> = input.landmarks.iter().map(|l| (at(l), l)).collect();
    let discs = scan.triangles.is_empty().then(|| start::discs(scan, scan_normals.unwrap_or_default()));
    let (scan, scan_normals) = match &discs {
        Some((mesh, normals)) => (mesh, Some(&normals[..])),
        None => (scan, scan_normals),
    };
    let search = StartInput {
        template: &rest.mesh,
        ignored: &rest.masks.unseen(),
        centre: rest.centre,
        unit: rest.unit,
        shapes: input.shapes,
        scan,
        scan_normals,
        landmarks: &landmarks,
        sigma: schedule.sigma.landmark * rest.unit,
        flip: schedule.scan.flip,
    };
    start::find_start(&search, schedule.start, &schedule.search)
}

/// The shape that a stage deforms, in the first stage the centred rest shape, and how the schedule's units translate to it.
struct Rest {
    mesh: TriangleMesh,
    /// Vertices that a triangle uses.
    used: Vec<bool>,
    masks: VertexMasks,
    seams: Seams,
    centre: Vec3,
    /// Length of one of the schedule's millimetres.
    unit: f64,
    /// Weight per vertex for weight one on the schedule's reference template.
    density: f64,
}

impl Rest {
    fn new(input: &RegistrationInput<'_>, schedule: &Schedule) -> Result<Self, MeshError> {
        let mut mesh = input.template.triangulate();
        mesh.positions.copy_from_slice(input.rest_positions());
        let corners = || mesh.triangles.as_flattened().iter().copied();
        let used = referenced(mesh.positions.len(), corners());
        let points = surface_points(&mesh.positions, corners());
        let count = points.len() as f64;
        let centre = points.iter().sum::<Vec3>() / count;
        let size = (points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / count).sqrt();
        mesh.positions.iter_mut().for_each(|p| *p -= centre);
        let unit = size / schedule.reference_size;
        let finer = (count / schedule.reference_vertices).sqrt();
        let rim = rim(&mesh, (schedule.scan.template_rim * finer).round() as usize);
        let masks = VertexMasks::new(input.mask, input.free_mask, rim).of_surface(&used);
        let seams = Seams::find(&mesh, schedule.seam.width * unit)?;
        let density = schedule.reference_vertices / count;
        Ok(Self { mesh, used, masks, seams, centre, unit, density })
    }

    /// Whether the scan faces inwards, by its normals near vertices of the model.
    fn sees_the_inside(&self, scan: &ScanSurface, vertices: &[Vec3]) -> bool {
        let normals = vertex_normals(vertices, &self.mesh.triangles, NormalWeighting::Area);
        let unseen = self.masks.unseen();
        let each = vertices.len() / FACING_VERTICES + 1;
        let chosen = || (0..vertices.len()).step_by(each).filter(|&v| !unseen[v] && normals[v] != Vec3::zeros());
        let points: Vec<Vec3> = chosen().map(|v| vertices[v]).collect();
        let normals: Vec<Vec3> = chosen().map(|v| normals[v]).collect();
        facing::faces_inwards(scan, &points, &normals, FACING_REACH * self.unit)
    }
}

/// Vertices of the template that are asked, about, and how far from the scan they may be, millimetres.
const FACING_VERTICES: usize = 1000;
const FACING_REACH: f64 = 20.0;

/// The vertices within `rings` rings of the open boundary; the boundary itself is the first.
fn rim(mesh: &TriangleMesh, rings: usize) -> Vec<bool> {
    let edges = EdgeGraph::of(mesh);
    let mut marked = if rings > 0 { edges.boundary_vertices() } else { vec![false; mesh.positions.len()] };
    for _ in 1..rings {
        let grown = (0..marked.len()).map(|i| marked[i] || edges.neighbours(i).iter().any(|&j| marked[j as usize]));
        marked = grown.collect();
    }
    marked
}

fn check_input(input: &RegistrationInput<'_>, model: &dyn ModelFactory) -> Result<(), RegistrationError> {
    check_geometry(input)?;
    if model.needs_shapes() && input.shapes.is_empty() {
        return Err(RegistrationError::NeedsShapes(model.name().to_owned()));
    }
    Ok(())
}

fn check_geometry(input: &RegistrationInput<'_>) -> Result<(), RegistrationError> {
    let vertices = input.template.positions.len();
    if input.template.polygon_count() == 0 {
        return Err(RegistrationError::EmptyTemplate);
    }
    check_numbers(input)?;
    scan::check_normals(input.scan, input.scan_normals)?;
    if let Some(neutral) = input.neutral.filter(|n| n.len() != vertices) {
        return Err(RegistrationError::VertexCount { what: "neutral", found: neutral.len(), template: vertices });
    }
    if !input.shapes.is_empty() && input.shapes.vertex_count() != vertices {
        let found = input.shapes.vertex_count();
        return Err(RegistrationError::VertexCount { what: "rig", found, template: vertices });
    }
    masks::check_mask("mask", input.mask, vertices)?;
    masks::check_mask("free mask", input.free_mask, vertices)?;
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
    for landmark in input.landmarks {
        if let Some(sigma) = landmark.sigma.filter(|s| !(*s > 0.0 && s.is_finite())) {
            return Err(RegistrationError::LandmarkSigma { name: landmark.name.clone(), sigma });
        }
    }
    input.scan.check_indices().map_err(|e| RegistrationError::Scan(e.to_string()))?;
    input.template.triangulate().check_indices().map_err(|e| RegistrationError::Template(e.to_string()))
}

struct Run {
    start: Pose,
    /// Whether a level has found the scan's vertices to coincide with the template's; it is not asked again.
    /// Points of the scan that look for the template, where a level asks for them.
    scan_points: Option<ScanPoints>,
    correspondences: Correspondences,
    workspace: Workspace,
    history: Vec<StepRecord>,
    /// Current vertex positions, model frame.
    vertices: Vec<Vec3>,
    /// Names of all stages' levels, and how many of them lie in earlier stages.
    level_names: Vec<String>,
    first_level: usize,
}

type RegistrationProblem = Deformation<Box<dyn RegistrationModel>, Box<dyn RegistrationTerm>>;

impl Run {
    /// Current vertex positions in the scan's frame.
    fn positions(&self, centre: Vec3) -> Vec<Vec3> {
        self.vertices.iter().map(|&v| self.start.apply(v + centre)).collect()
    }

    /// All levels of one stage, of at most so many steps each; `schedule` is as if that stage were the first.
    #[allow(clippy::too_many_arguments)]
    fn stage(
        &mut self,
        most_steps: usize,
        schedule: &Schedule,
        rest: &Rest,
        scan: &ScanSurface,
        problem: &mut RegistrationProblem,
        x: &mut [f64],
        observer: &mut dyn RegistrationObserver,
    ) -> Result<ControlFlow<()>, RegistrationError> {
        for level in 0..schedule.levels.len() {
            if self.level(level, most_steps, schedule, rest, scan, problem, x, observer)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        self.first_level += schedule.levels.len();
        Ok(ControlFlow::Continue(()))
    }

    #[allow(clippy::too_many_arguments)]
    fn level(
        &mut self,
        index: usize,
        most_steps: usize,
        schedule: &Schedule,
        rest: &Rest,
        scan: &ScanSurface,
        problem: &mut RegistrationProblem,
        x: &mut [f64],
        observer: &mut dyn RegistrationObserver,
    ) -> Result<ControlFlow<()>, RegistrationError> {
        let number = self.first_level + index;
        let level = schedule.levels[index].scaled(rest.unit);
        problem.model.set_level(&level);
        problem.terms.iter_mut().for_each(|t| t.set_level(&level, rest.density));
        let mut last_energy = f64::INFINITY;
        for step in 0..level.steps.min(most_steps) {
            self.correspondences.find(scan, &self.vertices, &rest.mesh, &rest.masks, &level);
            if !self.correspondences.any() {
                return Err(RegistrationError::NoOverlap {
                    level: self.level_names[number].clone(),
                    cap: schedule.levels[index].distance_cap,
                });
            }
            let unseen = &self.correspondences.prediction_weights;
            problem.model.set_unseen(unseen, schedule.graph.lambda_unseen);
            problem.model.prediction(x, &rest.mesh.positions, &mut self.correspondences.predictions);
            self.correspondences.pose_predictions(&self.vertices);
            let c = &mut self.correspondences;
            let widest = schedule.seam.widest * rest.unit;
            rest.seams.targets(scan, &self.vertices, widest, &mut c.seam_points, &mut c.seam_weights);
            c.seam_weights.iter_mut().zip(&rest.masks.data).for_each(|(weight, data)| *weight *= data);
            if let Some(points) = self.scan_points.as_ref().filter(|_| level.scan_to_template > 0.0) {
                c.find_from_scan(points, &self.vertices, &rest.mesh, &rest.masks, &level).map_err(|_| {
                    RegistrationError::Diverged { level: self.level_names[number].clone(), step: step + 1 }
                })?;
            }
            if level.scale == KernelScale::Mad
                && let (Some(delta), Some(deviation)) =
                    (level.kernel.scale(), self.correspondences.residual_scale(&self.vertices))
            {
                // Where half of the template fits exactly, only rounding is left to scale with.
                let deviation = deviation.max(1e-6 * level.distance_cap);
                let measured = Level { kernel: level.kernel.with_scale(delta * deviation), ..level };
                problem.terms.iter_mut().for_each(|t| t.set_level(&measured, rest.density));
            }
            problem.terms.iter_mut().for_each(|t| t.update(&self.correspondences));
            let minimizer = minimizer(&schedule.solver, step > 0);
            let summary = minimizer.minimize_with(problem, x, &mut self.workspace, &mut one_step);
            let final_energy = summary.final_energy;
            match summary.stop {
                StopReason::LinearSolverFailed(reason) => {
                    let reason = reason.to_string();
                    return Err(RegistrationError::Solver {
                        level: self.level_names[number].clone(),
                        step: step + 1,
                        reason,
                    });
                }
                StopReason::NonFinite => {
                    return Err(RegistrationError::Diverged {
                        level: self.level_names[number].clone(),
                        step: step + 1,
                    });
                }
                _ => {}
            }
            let moved = problem.vertices(x);
            let pairs = moved.iter().zip(&self.vertices).zip(&rest.used);
            let motion = pairs.filter(|p| *p.1).map(|((a, b), _)| (a - b).norm()).fold(0.0, f64::max) / rest.unit;
            self.vertices.copy_from_slice(moved);
            let record = StepRecord {
                level: number,
                step,
                energy_before: summary.initial_energy,
                energy: final_energy,
                energies: problem.energies(x),
                inliers: self.correspondences.inlier_share(),
                motion,
            };
            let flow = observer.on_step(&record);
            if observer.wants_positions() {
                observer.on_positions(&record, &self.positions(rest.centre));
            }
            let change = (last_energy - record.energy).abs() / record.energy.max(f64::MIN_POSITIVE);
            last_energy = record.energy;
            self.history.push(record);
            if flow.is_break() {
                return Ok(flow);
            }
            if motion <= schedule.stop.motion && change <= schedule.stop.energy {
                break;
            }
        }
        Ok(ControlFlow::Continue(()))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::mesh::testing::sheet;
    use crate::nlls::{BlockStructure, NormalEquations, Problem};

    /// E(x) = atan(x)^2: from 10, an undamped step lands beyond 100 on the other side.
    struct Overshooting(Arc<BlockStructure>);

    impl Problem for Overshooting {
        fn structure(&self) -> &Arc<BlockStructure> {
            &self.0
        }

        fn parameter_len(&self) -> usize {
            1
        }

        fn energy(&mut self, x: &[f64]) -> f64 {
            x[0].atan().powi(2)
        }

        fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
            let slope = 1.0 / (1.0 + x[0] * x[0]);
            equations.border[0] = slope * slope;
            equations.gradient[0] = slope * x[0].atan();
            self.energy(x)
        }

        fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
            out[0] = x[0] + step[0];
        }
    }

    #[test]
    fn a_step_is_tried_again_until_the_energy_falls_and_the_next_one_carries_on() {
        for algorithm in [StepAlgorithm::GaussNewton, StepAlgorithm::LevenbergMarquardt, StepAlgorithm::Dogleg] {
            let mut problem = Overshooting(Arc::new(BlockStructure::dense(1)));
            let (mut workspace, mut x) = (Workspace::new(), [10.0]);
            let mut step = |carry_on, x: &mut [f64; 1]| {
                let before = problem.energy(x);
                let solver = SolverOptions { algorithm, ..SolverOptions::default() };
                let summary =
                    minimizer(&solver, carry_on).minimize_with(&mut problem, x, &mut workspace, &mut one_step);
                assert!(summary.final_energy < before, "{algorithm:?}: {summary}");
                let records = summary.records.clone();
                let (last, trials) = records.split_last().expect("a step");
                assert!(last.accepted && trials.iter().all(|t| !t.accepted), "{algorithm:?}: {records:?}");
                (records[0], records.len(), workspace.lambda(), workspace.radius())
            };
            let (first, trials, lambda, radius) = step(false, &mut x);
            // Gauss-Newton halves within a step.
            assert_eq!(trials > 1, algorithm != StepAlgorithm::GaussNewton);
            assert!(trials > 1 || first.step_scale < 1.0);
            let (second, ..) = step(true, &mut x);
            let (anew, ..) = step(false, &mut x);
            match algorithm {
                StepAlgorithm::GaussNewton => {}
                StepAlgorithm::LevenbergMarquardt => {
                    assert_eq!(
                        (Some(second.lambda), anew.lambda),
                        (lambda, LevenbergMarquardt::default().initial_lambda)
                    );
                    assert!(lambda > Some(anew.lambda), "what the rejected trials have taught");
                }
                StepAlgorithm::Dogleg => {
                    assert_eq!(Some(second.radius), radius);
                    assert!(anew.radius != second.radius);
                }
            }
        }
    }

    #[test]
    fn the_rim_grows_ring_by_ring() {
        let mesh = sheet(9, 7, |c, r| Vec3::new(c, r, 0.0));
        for (rings, marked) in [(0, 0), (1, 28), (2, 48), (3, 60), (4, 63), (9, 63)] {
            let rim = rim(&mesh, rings);
            assert_eq!(rim.iter().filter(|m| **m).count(), marked, "{rings} rings");
            for (p, in_rim) in mesh.positions.iter().zip(rim) {
                let depth = p.x.min(8.0 - p.x).min(p.y).min(6.0 - p.y);
                assert_eq!(in_rim, depth < rings as f64, "{rings} rings, {p}");
            }
        }
    }

    #[test]
    fn a_closed_surface_has_no_rim() {
        let positions = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let closed = TriangleMesh { positions, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] };
        assert_eq!(rim(&closed, 3), [false; 4]);
        let opened = TriangleMesh { triangles: closed.triangles[..3].to_vec(), ..closed };
        assert_eq!(rim(&opened, 1), [true, false, true, true]);
    }
}
