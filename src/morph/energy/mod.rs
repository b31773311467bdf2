//! The same morph as a constrained energy, on any deformation model.
//!
//! ```text
//! E(x) = sum_i |v_i(x) - (v_i0 + G_i D)|^2 + sum_goals alpha |s(x) - g|^2 + regulariser(x)
//! ```
//!
//! The first sum goes over the vertices that a mask lifts above the threshold. All others are **held**: they are not parameters,
//! and the result has their input coordinates bit for bit. Free vertices and as-rigid-as-possible surfaces have no unknowns
//! there; a graph has nodes inside the region alone, with fixed ones along its rim; blendshapes are multiplied by the mask, their
//! pose is fixed; the hybrid has both. **Pins** are hard: those at vertices hold bit for bit, those inside faces to
//! [`PIN_TOLERANCE`] of the bounding box.
//!
//! Regularisers are stated by lengths, so that they mean the same on any mesh. With the mean area `a` of a vertex that moves,
//! `lambda` is such that every model's energy is about `(1/a) integral |d - G D|^2 + l^2 |grad d|^2`, `l` the smoothing length: the
//! field of displacements is `G D` smoothed over `l` (rigid turns are free where the model allows them). For the bi-Laplacian it is
//! `l^4 (Laplace d)^2`.
//!
//! With free vertices and `l = 0` the minimiser is the paper's equation (5).

mod patch;
mod pins;

use serde::{Deserialize, Serialize};

use self::patch::Patch;
use self::pins::PinTerm;
use super::{MorphError, MorphStep, Weights};
use crate::energy::{Deformation, DeformationModel, Pointwise, Samples};
use crate::landmark::TemplatePoint;
use crate::mesh::{TriangleMesh, Vec3, bounding_box_diagonal, check_finite};
use crate::model::{ModelFactory, ModelKind, PatchInput, Smoothness};
use crate::nlls::{Kernel, Minimizer, Options, Silent, StopReason, Workspace};
use crate::rig::ShapeBasis;
use crate::term::Landmarks;

pub use pins::PIN_TOLERANCE;

/// How the vertices under the masks follow them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum MorphModel {
    /// Each by its weight, equation (5): no energy.
    #[default]
    Direct,
    /// A deformation model that can be held at the rim of a patch.
    Energy(ModelKind),
}

impl MorphModel {
    /// All of them.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let models = ModelKind::ALL.into_iter().filter(|m| m.on_patch().is_some());
        std::iter::once(Self::Direct).chain(models.map(Self::Energy)).collect()
    }

    /// The names of all of them, in one line.
    #[must_use]
    pub fn names() -> String {
        Self::all().iter().map(Self::name).collect::<Vec<_>>().join(", ")
    }

    /// Its name in recipes and on the command line.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Direct => "direct",
            Self::Energy(model) => model.name(),
        }
    }

    /// Whether it needs blendshapes.
    #[must_use]
    pub fn uses_shapes(self) -> bool {
        matches!(self, Self::Energy(model) if model.uses_shapes())
    }
}

impl From<MorphModel> for String {
    fn from(model: MorphModel) -> Self {
        model.name().to_owned()
    }
}

impl TryFrom<String> for MorphModel {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        name.parse()
    }
}

impl std::str::FromStr for MorphModel {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::all().into_iter().find(|m| m.name() == name);
        found.ok_or_else(|| format!("unknown model '{name}'; there are {}", Self::names()))
    }
}

/// Stiffness and accuracy of an energy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnergyOptions {
    /// Length over which displacements are smoothed, millimetres; default 2. 0 for none.
    pub smoothing: f64,
    /// What is smooth about the displacements of free vertices; default the bi-Laplacian, which has no crease at the rim.
    pub smoothness: Smoothness,
    /// Nodes of a graph within the region, at most one to two vertices; default 150.
    pub nodes: usize,
    /// A shape's weight of one standard deviation costs as much as this rms distance from the handles, millimetres; default 0.1.
    pub prior: f64,
    /// Done when a step lowers the energy by at most this share of it; default 1e-8.
    pub tolerance: f64,
    /// Steps at most; default 200.
    pub max_iterations: usize,
}

impl Default for EnergyOptions {
    fn default() -> Self {
        let smoothness = Smoothness::BiLaplacian;
        Self { smoothing: 2.0, smoothness, nodes: 150, prior: 0.1, tolerance: 1e-8, max_iterations: 200 }
    }
}

impl EnergyOptions {
    /// Keys that say something else than the default and that a model does not read.
    #[must_use]
    pub fn without_effect(&self, model: MorphModel) -> Vec<&'static str> {
        let usual = Self::default();
        let said = [
            ("smoothing", self.smoothing != usual.smoothing),
            ("smoothness", self.smoothness != usual.smoothness),
            ("nodes", self.nodes != usual.nodes),
            ("prior", self.prior != usual.prior),
            ("tolerance", self.tolerance != usual.tolerance),
            ("max_iterations", self.max_iterations != usual.max_iterations),
        ];
        let reads = |key: &str| match model {
            MorphModel::Direct => false,
            MorphModel::Energy(kind) => {
                let of_model = kind.on_patch().is_some_and(|factory| factory.keys().contains(&key));
                of_model || ["tolerance", "max_iterations"].contains(&key)
            }
        };
        said.into_iter().filter(|(key, other)| *other && !reads(key)).map(|(key, _)| key).collect()
    }

    fn validate(&self) -> Result<(), MorphError> {
        let error = |what, value, expected| Err(MorphError::Option { what, value, expected });
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        match self {
            Self { smoothing, .. } if !not_negative(*smoothing) => {
                error("the smoothing length", *smoothing, "millimetres, 0 or more")
            }
            Self { prior, .. } if !not_negative(*prior) => error("the prior", *prior, "millimetres, 0 or more"),
            Self { nodes: 0, .. } => error("the number of nodes", 0.0, "1 or more"),
            Self { tolerance, .. } if !not_negative(*tolerance) => error("the tolerance", *tolerance, "0 or more"),
            Self { max_iterations: 0, .. } => error("the number of steps", 0.0, "1 or more"),
            _ => Ok(()),
        }
    }
}

/// A named point of the mesh and where it is to be, millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedPoint {
    /// For messages.
    pub name: String,
    /// A vertex, or a point inside a face.
    pub point: TemplatePoint,
    /// Its place.
    pub target: Vec3,
}

/// What the result has to do besides following the masks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Constraints {
    /// Masks in which vertices may move without handles of their own: they follow goals, pins and their neighbours.
    pub free: Vec<Weights>,
    /// Points that are at their targets exactly.
    pub pins: Vec<PlacedPoint>,
    /// Points that are drawn to their targets, each with its weight `alpha`, as much as so many vertices' handles.
    pub goals: Vec<(PlacedPoint, f64)>,
}

/// What became of a step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergyReport {
    /// The model.
    pub model: MorphModel,
    /// Vertices that could move.
    pub moving: usize,
    /// Vertices that were held, bit for bit.
    pub held: usize,
    /// Energies at the result: handles, goals, then the regularisers.
    pub energies: Vec<(String, f64)>,
    /// Steps.
    pub iterations: usize,
    /// Why the last run ended.
    pub stop: String,
    /// Whether that is because nothing was left to gain.
    pub settled: bool,
    /// Largest distance of a pin from its target, millimetres, before pinned vertices were set.
    pub pin_distance: f64,
    /// Weights of the blendshapes.
    pub weights: Vec<(String, f64)>,
    /// Parts that neither data nor regulariser moved: they kept their places.
    pub parts_at_rest: usize,
    /// Their vertices.
    pub vertices_at_rest: usize,
}

type Term = Pointwise<Landmarks, Kernel, 3>;

/// A morph as an energy, kept so that it can be solved again, from where it stands, when a handle has been dragged.
pub struct MorphEnergy {
    model: MorphModel,
    options: EnergyOptions,
    input: Vec<Vec3>,
    patch: Patch,
    /// Weights of each pair at the vertices of the handles, in their order.
    pair_weights: Vec<Vec<f64>>,
    displacements: Vec<Vec3>,
    problem: Deformation<Box<dyn DeformationModel>, Term>,
    shapes: ShapeBasis,
    /// Pinned vertices of the patch, and where.
    pinned: Vec<(usize, Vec3)>,
    pins: PinTerm,
    at_rest: [usize; 2],
    x: Vec<f64>,
    workspace: Workspace,
}

const HANDLES: usize = 0;
const GOALS: usize = 1;
const PINS: usize = 2;

impl MorphEnergy {
    /// The energy of a step on a mesh, with blendshapes (of the whole mesh) for the models that use them.
    ///
    /// # Errors
    /// When the mesh or the step is malformed, nothing is left to move, an option is out of range, the model has no energy or no
    /// shapes, or a pin or a goal lies where nothing can move.
    pub fn new(
        mesh: &TriangleMesh,
        step: &MorphStep,
        constraints: &Constraints,
        model: MorphModel,
        shapes: &ShapeBasis,
        options: &EnergyOptions,
    ) -> Result<Self, MorphError> {
        let count = mesh.positions.len();
        options.validate()?;
        mesh.check()?;
        let mut moves = step.moves(count)?;
        for weights in &constraints.free {
            let found = weights.values().len();
            if found != count {
                return Err(MorphError::WeightCount { found, vertices: count });
            }
            moves.iter_mut().zip(weights.values()).for_each(|(m, w)| *m |= *w > step.threshold);
        }
        if !moves.contains(&true) {
            return Err(MorphError::NothingMoves);
        }
        if model.uses_shapes() && shapes.vertex_count() != count {
            let found = shapes.vertex_count();
            return Err(MorphError::Shapes { model: model.name().to_owned(), found, vertices: count });
        }
        let patch = Patch::around(mesh, &moves);

        let factory = match &model {
            MorphModel::Direct => return Err(MorphError::NoEnergy),
            MorphModel::Energy(kind) => kind.on_patch().ok_or(MorphError::NoEnergy)?,
        };
        // A pinned vertex of a model whose vertices are its parameters is held like all others, elsewhere.
        let by_vertex = factory.by_vertex();
        let mut pinned = Vec::new();
        let mut samples = Samples::vertices(patch.vertices.len());
        let mut pins = PinTerm::new(PIN_TOLERANCE * bounding_box_diagonal(&mesh.positions));
        for (i, pin) in constraints.pins.iter().enumerate() {
            check_target(pin)?;
            let place = |pin: &PlacedPoint| pin.point.corners().map(|(v, w)| (patch.find(v), w)).collect::<Vec<_>>();
            let twice = |other: &&PlacedPoint| place(other) == place(pin) && other.target != pin.target;
            if constraints.pins[..i].iter().any(|other| twice(&other)) {
                return Err(MorphError::PinnedTwice(pin.name.clone()));
            }
            let sample = sample_of(pin, &patch, &mut samples)?;
            if let TemplatePoint::Vertex(_) = pin.point {
                pinned.push((sample, pin.target));
            }
            if !(by_vertex && matches!(pin.point, TemplatePoint::Vertex(_))) {
                pins.push(pin, sample);
            }
        }
        let mut goals = Landmarks { scale: 1.0, ..Landmarks::default() };
        for (goal, weight) in &constraints.goals {
            check_target(goal)?;
            if !(*weight > 0.0 && weight.is_finite()) {
                return Err(MorphError::Option { what: "the weight of a goal", value: *weight, expected: "above 0" });
            }
            goals.samples.push(sample_of(goal, &patch, &mut samples)?);
            goals.targets.push(goal.target);
            goals.weights.push(*weight);
        }

        let lifting = |weights: &Weights| {
            let weights = patch.weights(weights).into_iter();
            weights.map(|w| if w > step.threshold { w } else { 0.0 }).collect::<Vec<f64>>()
        };
        let pulling: Vec<Vec<f64>> = step.pairs.iter().map(|pair| lifting(&pair.weights)).collect();
        let is_pinned = |k: usize| pinned.iter().any(|p: &(usize, Vec3)| p.0 == k);
        let handles = (0..patch.vertices.len()).filter(|k| !patch.held[*k] && !is_pinned(*k));
        let handles: Vec<usize> = handles.filter(|k| pulling.iter().any(|weights| weights[*k] > 0.0)).collect();
        let pair_weights = pulling.iter().map(|weights| handles.iter().map(|k| weights[*k]).collect()).collect();
        let displacements = step.pairs.iter().map(|pair| pair.displacement).collect();
        let weights = vec![1.0; handles.len()];
        let targets = vec![Vec3::zeros(); handles.len()];
        let handles = Landmarks { samples: handles, targets, weights, scale: 1.0 };

        let at_rest =
            parts_at_rest(&patch, options, by_vertex, &samples, [&handles, &goals, pins.landmarks()], &pinned);
        let mut mask = vec![0.0; patch.vertices.len()];
        for weights in pulling.into_iter().chain(constraints.free.iter().map(lifting)) {
            mask.iter_mut().zip(weights).for_each(|(m, w): (&mut f64, f64)| *m = m.max(w));
        }
        let shapes = if model.uses_shapes() { shapes.masked(&patch.vertices, &mask) } else { ShapeBasis::none() };
        let (mut held, mut places) = (patch.held.clone(), patch.mesh.positions.clone());
        for (k, target) in pinned.iter().filter(|_| by_vertex) {
            (held[*k], places[*k]) = (true, *target);
        }
        let built = factory.build_on_patch(&PatchInput {
            mesh: &patch.mesh,
            held: &held,
            places: &places,
            mask: &mask,
            shapes: &shapes,
            vertex_area: patch.vertex_area,
            moving: patch.moving(),
            smoothing: options.smoothing,
            smoothness: options.smoothness,
            nodes: options.nodes,
            prior: options.prior,
        })?;
        let mut problem = Deformation::new(built, samples);
        let term = |name: &str, landmarks| Pointwise::new(name, landmarks, Kernel::None);
        problem.terms = vec![term("handles", handles), term("goals", goals), term("pins", pins.landmarks().clone())];
        let x = problem.model.rest_parameters();
        let input = mesh.positions.clone();
        let workspace = Workspace::new();
        let mut this = Self {
            model,
            options: *options,
            input,
            patch,
            pair_weights,
            displacements,
            problem,
            shapes,
            pinned,
            pins,
            at_rest,
            x,
            workspace,
        };
        this.place_handles();
        Ok(this)
    }

    /// Drags the displacement of a pair of the step.
    ///
    /// # Errors
    /// When it is not finite.
    ///
    /// # Panics
    /// If there is no such pair.
    pub fn set_displacement(&mut self, pair: usize, displacement: Vec3) -> Result<(), MorphError> {
        if !displacement.iter().all(|c| c.is_finite()) {
            return Err(MorphError::Displacement { index: pair, displacement: displacement.into() });
        }
        self.displacements[pair] = displacement;
        self.place_handles();
        Ok(())
    }

    /// Drags a goal.
    ///
    /// # Errors
    /// When it is not finite.
    ///
    /// # Panics
    /// If there is no such goal.
    pub fn set_goal(&mut self, goal: usize, target: Vec3) -> Result<(), MorphError> {
        check_finite(&[target])?;
        self.problem.terms[GOALS].residuals.targets[goal] = target;
        Ok(())
    }

    fn place_handles(&mut self) {
        let handles = &mut self.problem.terms[HANDLES].residuals;
        for (k, target) in handles.targets.iter_mut().enumerate() {
            *target = self.patch.mesh.positions[handles.samples[k]];
            for (weights, displacement) in self.pair_weights.iter().zip(&self.displacements) {
                *target += displacement * weights[k];
            }
        }
    }

    /// Minimises from where the last solution stands (at first, from the input) and gives the positions of the whole mesh.
    ///
    /// # Errors
    /// When the minimiser fails, or a pin is out of the model's reach.
    pub fn solve(&mut self) -> Result<(Vec<Vec3>, EnergyReport), MorphError> {
        let mut options = Options::gauss_newton()
            .with_energy_tolerance(self.options.tolerance)
            .with_max_iterations(self.options.max_iterations)
            .with_damping_floor(DAMPING_FLOOR);
        options.gradient_tolerance = 0.0;
        let minimizer = Minimizer::new(options).map_err(|e| MorphError::Minimizer(e.to_string()))?;
        let mut iterations = 0;
        let (stop, settled, pin_distance) = loop {
            let Self { problem, x, workspace, .. } = self;
            let summary = minimizer.minimize_with(problem, x, workspace, &mut Silent);
            iterations += summary.iterations;
            // Without a step left to take, the start was the minimum.
            if !summary.stop.was_successful() && summary.stop != StopReason::NoDecrease {
                return Err(MorphError::Minimizer(summary.stop.to_string()));
            }
            let vertices = self.problem.vertices(&self.x).to_vec();
            if let Some(distance) = self.pins.update(self.problem.samples(), &vertices)? {
                break (summary.stop.to_string(), summary.stop != StopReason::MaxIterations, distance);
            }
            self.problem.terms[PINS].residuals.targets.clone_from(&self.pins.landmarks().targets);
        };
        let mut moved = self.problem.vertices(&self.x).to_vec();
        for (k, target) in &self.pinned {
            moved[*k] = *target;
        }
        let mut positions = self.input.clone();
        let mut moving = 0;
        for (v, k) in self.patch.movers() {
            positions[v] = moved[k];
            moving += 1;
        }
        check_finite(&positions)?;
        let first_weight = self.x.len() - self.shapes.len();
        let names = self.shapes.shapes().iter().map(|shape| shape.name.clone());
        let report = EnergyReport {
            model: self.model,
            moving,
            held: self.input.len() - moving,
            energies: self.problem.energies(&self.x),
            iterations,
            stop,
            settled,
            pin_distance,
            weights: names.zip(self.x[first_weight..].iter().copied()).collect(),
            parts_at_rest: self.at_rest[0],
            vertices_at_rest: self.at_rest[1],
        };
        Ok((positions, report))
    }
}

/// Of what nothing observes; far below what the handles say, whose weight is 1.
const DAMPING_FLOOR: f64 = 1e-10;

fn check_target(placed: &PlacedPoint) -> Result<(), MorphError> {
    if placed.target.iter().all(|c| c.is_finite()) {
        return Ok(());
    }
    Err(MorphError::Target { name: placed.name.clone(), target: placed.target.into() })
}

/// The sample of a point, which must be able to move.
fn sample_of(placed: &PlacedPoint, patch: &Patch, samples: &mut Samples) -> Result<usize, MorphError> {
    let corners: Vec<(u32, f64)> = match placed.point {
        TemplatePoint::Vertex(v) => vec![(v, 1.0)],
        TemplatePoint::Face { corners, weights } => corners.into_iter().zip(weights).collect(),
    };
    let found: Option<Vec<(u32, f64)>> = corners.iter().map(|(v, w)| Some((patch.find(*v)?, *w))).collect();
    let moves = |found: &Vec<(u32, f64)>| found.iter().any(|(k, w)| *w > 0.0 && !patch.held[*k as usize]);
    let Some(found) = found.filter(moves) else { return Err(MorphError::PointHeld(placed.name.clone())) };
    if let [(k, _)] = found[..] {
        return Ok(k as usize);
    }
    samples.push(&found).map_err(|e| MorphError::Point { name: placed.name.clone(), error: e.to_string() })
}

/// Parts, and their vertices, that neither data nor regulariser move. Without a regulariser every free vertex is a part; shapes and
/// graphs are regularised by themselves or by what is pinned.
fn parts_at_rest(
    patch: &Patch,
    options: &EnergyOptions,
    by_vertex: bool,
    samples: &Samples,
    data: [&Landmarks; 3],
    pinned: &[(usize, Vec3)],
) -> [usize; 2] {
    let count = patch.vertices.len();
    let (parts, part_count) =
        if by_vertex && options.smoothing == 0.0 { ((0..count).collect(), count) } else { patch.parts() };
    let mut driven = vec![false; part_count];
    (0..count).filter(|k| patch.held[*k]).for_each(|k| driven[parts[k]] = true);
    pinned.iter().for_each(|(k, _)| driven[parts[*k]] = true);
    for sample in data.iter().flat_map(|landmarks| &landmarks.samples) {
        samples.corners(*sample).iter().for_each(|c| driven[parts[c.0 as usize]] = true);
    }
    let vertices = (0..count).filter(|k| !driven[parts[*k]]).count();
    [driven.iter().filter(|d| !**d).count(), vertices]
}
