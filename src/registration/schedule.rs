//! The schedule of a registration: levels from stiff to soft. Schedules are data, TOML files; the defaults are in
//! `schedules/`, one for each model.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{ModelKind, ScanFlip, StartOptions};
use crate::mesh::PoseKind;
use crate::model::{ArapSolver, EdgeWeights, Linearisation, Smoothness};
use crate::nlls::{Kernel, LinearSolverKind};
use crate::rig::Family;
use crate::text;

/// Everything that steers a registration.
///
/// Lengths are millimetres on a template of [`reference_size`](Self::reference_size) and scale with the template;
/// data weights are per vertex on a template of [`reference_vertices`](Self::reference_vertices) and scale with theirs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Whether the start may scale the template.
    #[serde(default)]
    pub start: PoseKind,
    /// How a start is searched where fewer than three landmarks give it.
    #[serde(default)]
    pub search: StartOptions,
    /// Root-mean-square distance of the template's vertices from their centroid that the lengths below are meant for,
    /// millimetres.
    pub reference_size: f64,
    /// Number of template vertices that the weights below are meant for.
    pub reference_vertices: f64,
    /// The deformation graph; only models with one read it.
    #[serde(default)]
    pub graph: GraphOptions,
    /// The smoothness of free vertices; only they read it.
    #[serde(default)]
    pub smooth: SmoothOptions,
    /// How as-rigid-as-possible surfaces are solved; only they read it.
    #[serde(default)]
    pub arap: RigidityOptions,
    /// Per-vertex affine maps; only the model of that name reads it.
    #[serde(default)]
    pub affine: AffineOptions,
    /// What of the scan is believed.
    #[serde(default)]
    pub scan: ScanOptions,
    /// How the energy is minimised.
    #[serde(default)]
    pub solver: SolverOptions,
    /// Where sheets of the template touch without being joined, as lips do.
    #[serde(default)]
    pub seam: SeamOptions,
    /// When a level ends before its last step.
    #[serde(default)]
    pub stop: StopOptions,
    /// How a registration runs that goes on from another one's end.
    #[serde(default)]
    pub warm_start: WarmStartOptions,
    /// Standard deviations: of each family of shapes a priori, and of landmarks that state none.
    #[serde(default)]
    pub sigma: SigmaOptions,
    /// Bounds of the weights of each family of shapes.
    #[serde(default)]
    pub bounds: BoundsOptions,
    /// The levels, stiff to soft.
    #[serde(rename = "level")]
    pub levels: Vec<Level>,
    /// What comes after the last level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub then: Option<Box<Stage>>,
}

/// A further stage: another model deforms the shape that the stage before has found, with levels of its own. Everything
/// else is as the schedule says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// The model; one without blendshapes, for these have had their turn.
    pub model: ModelKind,
    /// The deformation graph; only models with one read it.
    #[serde(default)]
    pub graph: GraphOptions,
    /// The levels, stiff to soft.
    #[serde(rename = "level")]
    pub levels: Vec<Level>,
    /// What comes after the last level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub then: Option<Box<Stage>>,
}

/// How the deformation graph is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraphOptions {
    /// Number of nodes.
    pub nodes: usize,
    /// Nodes that move each vertex, `K`.
    pub influences: usize,
    /// How distances are measured.
    pub distance: GraphDistance,
    /// How a node moves.
    pub node: NodeKind,
    /// What the rotation of a rigid node is parametrised by.
    pub rotation: RotationKind,
    /// Stiffness below which the graph does not fall where the scan shows nothing, in the unit of
    /// [`lambda_graph`](Level::lambda_graph): an edge of (7) counts `(lambda_unseen / lambda_graph)^u` times where that is more
    /// than once, with `u` the share of its nodes' vertices that have no correspondence. What is not seen then keeps the form that
    /// the blendshapes give it and goes where what is seen beside it goes. 0 for a graph that is equally stiff everywhere.
    pub lambda_unseen: f64,
}

impl Default for GraphOptions {
    fn default() -> Self {
        Self {
            nodes: 400,
            influences: 4,
            distance: GraphDistance::Surface,
            node: NodeKind::Rigid,
            rotation: RotationKind::Matrix,
            lambda_unseen: 0.0,
        }
    }
}

impl GraphOptions {
    /// For affine nodes, `nodes` saying whose; `prefix` is where the options stand in the file.
    pub(super) fn require_no_rotation(&self, prefix: &str, nodes: &'static str) -> Result<(), ScheduleError> {
        if self.rotation == RotationKind::Matrix {
            return Ok(());
        }
        Err(ScheduleError::Rotation { field: format!("{prefix}graph.rotation"), nodes })
    }
}

/// How per-vertex affine maps differ at a cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AffineOptions {
    /// `gamma` of Amberg et al. 2007: weight of differences of translation against those of the linear parts, both as
    /// displacements at the template's root-mean-square size.
    pub gamma: f64,
}

impl Default for AffineOptions {
    fn default() -> Self {
        Self { gamma: 1.0 }
    }
}

/// Distance between nodes and vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraphDistance {
    /// Along the surface's edges: the two lips touch in space without sharing nodes.
    Surface,
    /// Through space.
    Euclidean,
}

/// The motion of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// Rotation and translation (Klimov 2020).
    Rigid,
    /// Any affine map, kept near the rotations by `lambda_rotation` (Sumner et al. 2007).
    Affine,
}

/// The parametrisation of a rigid node's rotation. An affine node has none: to name another than the default for it is an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationKind {
    /// A 3 x 3 matrix with steps from the left, `R <- exp(omega^) R`: [`RigidMotion`](crate::model::RigidMotion).
    #[default]
    Matrix,
    /// A unit quaternion with the same steps: [`QuaternionMotion`](crate::model::QuaternionMotion).
    Quaternion,
    /// The rotation vector itself, `R = exp(r^)`, `r <- r + delta`; for turns well below `2 pi`:
    /// [`AngleAxisMotion`](crate::model::AngleAxisMotion).
    AngleAxis,
}

/// The smoothness of free vertices.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothOptions {
    /// Which derivative of the displacements costs: `laplacian` (default) or `bilaplacian`.
    pub kind: Smoothness,
    /// How edges weigh: `uniform` (default) or `cotangent`.
    pub weights: EdgeWeights,
}

/// How a registration runs that goes on from another one's end ([`WarmStart`](super::WarmStart)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmStartOptions {
    /// Steps of a level at most, in the first stage. All levels stay: on generated sequences (15 frames a second, the hybrid), two
    /// steps of each level give 0.71 mm where a cold start's five give 0.79, in little more than half the time; leaving out
    /// the four stiffest levels instead gives 0.97, since the graph then takes what belongs to the blendshapes.
    pub steps: usize,
}

impl Default for WarmStartOptions {
    fn default() -> Self {
        Self { steps: 2 }
    }
}

/// How as-rigid-as-possible surfaces are solved.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigidityOptions {
    /// `local_global` (default) or `joint`.
    pub solver: ArapSolver,
}

/// How the energy of each set of correspondences is minimised: by one step, which never raises it. Steps that would are
/// shortened and tried again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverOptions {
    /// `gauss_newton` (default), `levenberg_marquardt` or `dogleg`.
    pub algorithm: StepAlgorithm,
    /// What solves the normal equations: `auto` (default, [by size](crate::nlls::linear::choose)), `dense`, `bordered` or
    /// `block_jacobi`.
    pub linear_solver: LinearSolverKind,
    /// `structured` (default) or `reference`, the differentiation of Klimov 2020; the same to rounding, for models made of nodes
    /// and blendshapes. An error for others.
    pub linearisation: Linearisation,
}

/// Which step is taken, with the settings of [`nlls`](crate::nlls::Options).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepAlgorithm {
    /// A full step, halved until the energy falls.
    #[default]
    GaussNewton,
    /// A damped step. The damping is relative to the curvature; it carries on from step to step of a level, as what it knows of the
    /// energy's shape outlives the correspondences, and starts anew with each level, whose weights make another energy.
    LevenbergMarquardt,
    /// A step within a trust region, whose radius carries on and starts anew as the damping does.
    Dogleg,
}

/// What of the scan is believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanOptions {
    /// Rounds of averaging of the scan's vertex normals with their neighbours'.
    pub normal_smoothing: usize,
    /// Whether the scan is turned over first: `auto` (default), `yes` or `no`.
    pub flip: ScanFlip,
    /// Reject correspondences on the scan's open boundary.
    pub reject_boundary: bool,
    /// This many rings of vertices along the template's own open boundary take no correspondence: lips and lids roll inwards
    /// there, out of the scanner's sight, and hair or collar lie beyond. Rings of a template of `reference_vertices`; a finer
    /// one has more. (A width in millimetres does worse: rims are finer where there is less to leave out.)
    pub template_rim: f64,
}

impl Default for ScanOptions {
    fn default() -> Self {
        Self { normal_smoothing: 2, flip: ScanFlip::Auto, reject_boundary: true, template_rim: 0.0 }
    }
}

/// Seams of the template, which close where the scan spans them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SeamOptions {
    /// Vertices of the rest shape that lie nearer than this, but far apart along the surface, form a seam, millimetres; zero
    /// for no seams.
    pub width: f64,
    /// Gaps wider than this are open, millimetres.
    pub widest: f64,
}

impl Default for SeamOptions {
    fn default() -> Self {
        Self { width: 2.0, widest: 6.0 }
    }
}

/// When a level ends early.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StopOptions {
    /// Largest relative change of the energy from step to step.
    pub energy: f64,
    /// Largest motion of any vertex from step to step, millimetres.
    pub motion: f64,
}

impl Default for StopOptions {
    fn default() -> Self {
        Self { energy: 0.01, motion: 0.25 }
    }
}

/// Standard deviations of what is known beforehand: `sigma_k` of (5) by family of shapes, and where landmarks are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SigmaOptions {
    /// Expression blendshapes, whose weights lie between 0 and 1.
    pub expression: f64,
    /// Identity modes, scaled to standard deviation one by the rig.
    pub identity: f64,
    /// `sigma_0` of a landmark that states none, millimetres. One that states `sigma` counts `(sigma_0 / sigma)^2` times the
    /// [level's weight](Level::landmarks) and, next to the others, as much in the start.
    ///
    /// A constant and not, say, the median of what a file states, so that landmarks that are all vague hold the template less
    /// against the scan, and one more landmark does not change what the others count.
    pub landmark: f64,
}

impl Default for SigmaOptions {
    fn default() -> Self {
        Self { expression: 1.0, identity: 1.0, landmark: 1.0 }
    }
}

impl SigmaOptions {
    /// `sigma_k` of a shape of the given family; shapes of unknown family count as expressions.
    #[must_use]
    pub fn of(&self, family: Family) -> f64 {
        match family {
            Family::Identity => self.identity,
            Family::Expression | Family::Other => self.expression,
        }
    }
}

/// Bounds `[l, u]` of the weights by family of shapes, held exactly; free without.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoundsOptions {
    /// Expression blendshapes; `[0, 1]` for weights as an animator sets them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expression: Option<[f64; 2]>,
    /// Identity modes, in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identity: Option<[f64; 2]>,
}

impl BoundsOptions {
    /// Bounds of a shape of the given family; shapes of unknown family count as expressions.
    #[must_use]
    pub fn of(&self, family: Family) -> [f64; 2] {
        let bounds = match family {
            Family::Identity => self.identity,
            Family::Expression | Family::Other => self.expression,
        };
        bounds.unwrap_or([f64::NEG_INFINITY, f64::INFINITY])
    }

    /// Checks one pair.
    fn validate(field: &str, bounds: Option<[f64; 2]>) -> Result<(), ScheduleError> {
        let Some([lower, upper]) = bounds else { return Ok(()) };
        // Written so that NaN fails.
        if lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY {
            return Ok(());
        }
        Err(ScheduleError::Bounds { field: field.to_owned(), lower, upper })
    }
}

/// One level: a stiffness, a kernel scale, and what counts as a correspondence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Level {
    /// Steps of the solver at most, each with new correspondences.
    pub steps: usize,
    /// `lambda_graph` of (7), per directed edge.
    #[serde(default)]
    pub lambda_graph: f64,
    /// `lambda_blend` of (5), per shape.
    #[serde(default)]
    pub lambda_blend: f64,
    /// `lambda_smooth` of the models with one regulariser: free vertices, ARAP, per-vertex affine.
    #[serde(default)]
    pub lambda_smooth: f64,
    /// Weight of `E_rot` of Sumner et al. 2007 per affine node, times `lambda_graph` and the square of a node's reach
    /// ([`NodeGraph::squared_reach`](crate::model::NodeGraph::squared_reach)): dimensionless, and a ratio to (7), so that
    /// softening `lambda_graph` softens both.
    #[serde(default)]
    pub lambda_rotation: f64,
    /// Weight of point-to-plane (3) per accepted vertex.
    #[serde(default = "one")]
    pub point_to_plane: f64,
    /// Weight of symmetric point-to-plane (Rusinkiewicz 2019) per accepted vertex.
    #[serde(default)]
    pub symmetric: f64,
    /// Weight of scan points towards the template, for as many of them as the template has vertices.
    #[serde(default)]
    pub scan_to_template: f64,
    /// Weight of point-to-point (2), towards the closest point of the scan's surface, per accepted vertex.
    #[serde(default)]
    pub point_to_point: f64,
    /// Weight of each landmark, 1 / square millimetre; times `(sigma_0 / sigma)^2` where it [states](SigmaOptions::landmark) sigma.
    #[serde(default)]
    pub landmarks: f64,
    /// Robust kernel of landmarks, scale in millimetres: one that is wrong by much pulls no more than one at the scale.
    #[serde(default)]
    pub landmark_kernel: Kernel,
    /// Weight, per vertex without an accepted correspondence, of staying where the blendshapes in one rigid pose predict it. For
    /// subjects that are rigid as a whole, if at all: a limb that moves is torn off.
    /// [`lambda_unseen`](GraphOptions::lambda_unseen) holds to the form instead.
    #[serde(default)]
    pub prediction: f64,
    /// Weight, per vertex of a seam that the scan spans, of closing it.
    #[serde(default)]
    pub seam: f64,
    /// Robust kernel of the data terms, in the unit that [`scale`](Self::scale) says.
    pub kernel: Kernel,
    /// What the scale of [`kernel`](Self::kernel) counts: `fixed` (default) or `mad`.
    #[serde(default)]
    pub scale: KernelScale,
    /// Longest correspondence, millimetres.
    pub distance_cap: f64,
    /// Largest angle between the normals of a correspondence, degrees.
    pub normal_angle: f64,
}

/// One step of point-to-plane without a kernel, up to 5 mm and 60 degrees, and no regulariser.
impl Default for Level {
    fn default() -> Self {
        Self {
            steps: 1,
            lambda_graph: 0.0,
            lambda_blend: 0.0,
            lambda_smooth: 0.0,
            lambda_rotation: 0.0,
            point_to_plane: 1.0,
            symmetric: 0.0,
            scan_to_template: 0.0,
            point_to_point: 0.0,
            landmarks: 0.0,
            prediction: 0.0,
            seam: 0.0,
            kernel: Kernel::None,
            landmark_kernel: Kernel::None,
            scale: KernelScale::Fixed,
            distance_cap: 5.0,
            normal_angle: 60.0,
        }
    }
}

impl Level {
    /// The level with its lengths times `unit` (and energies times its square).
    #[must_use]
    pub fn scaled(&self, unit: f64) -> Self {
        let scaled = |kernel: Kernel| kernel.scale().map_or(kernel, |s| kernel.with_scale(s * unit));
        Self {
            lambda_blend: self.lambda_blend * unit * unit,
            kernel: if self.scale == KernelScale::Fixed { scaled(self.kernel) } else { self.kernel },
            landmark_kernel: scaled(self.landmark_kernel),
            distance_cap: self.distance_cap * unit,
            ..*self
        }
    }
}

/// What the scale of a level's kernel counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KernelScale {
    /// Millimetres.
    #[default]
    Fixed,
    /// Robust standard deviations of the residuals ([`mad_scale`](crate::nlls::mad_scale)), found anew at each step from the distances of
    /// the accepted vertices to their planes: `{ tukey = { delta = 4.685 } }` keeps 95 % of the efficiency of plain least squares
    /// on Gaussian noise of any size. [`landmark_kernel`](Level::landmark_kernel) stays in millimetres.
    Mad,
}

/// Keys that schedules had, and what stands for them.
const FORMER_KEYS: [(&str, &str); 2] = [
    ("point_kernel", "`kernel` is that of every data term; leave this key out"),
    (
        "test_vertices",
        "`point_to_point` goes to the closest point of the surface, which needs no test; leave this key out",
    ),
];

/// What is wrong with a text, and what to write instead of an unknown key.
fn syntax_error(error: &toml::de::Error) -> ScheduleError {
    let mut message = error.to_string().trim_end().to_owned();
    // "unknown field `stepps`, expected one of `steps`, `lambda_graph`": every second piece is a name.
    let names: Vec<&str> = error.message().split('`').skip(1).step_by(2).collect();
    if let (true, [key, known @ ..]) = (error.message().starts_with("unknown field"), &names[..]) {
        match FORMER_KEYS.iter().find(|(former, _)| former == key) {
            Some((_, advice)) => message += &format!("\n{advice}"),
            None => {
                message += &text::most_similar(key, known.iter().copied())
                    .map_or(String::new(), |k| format!("\ndid you mean `{k}`?"))
            }
        }
    }
    ScheduleError::Syntax(message)
}

/// Greatest count that a schedule may ask for.
const MOST: usize = 1_000_000;

fn one() -> f64 {
    1.0
}

/// Why a schedule cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScheduleError {
    /// Not TOML, or an unknown key, or a wrong type.
    #[error("{0}")]
    Syntax(String),
    /// A number out of bounds.
    #[error("{field} = {value}, but it must be {bound}")]
    OutOfBounds {
        /// Where, as in the file.
        field: String,
        /// What was given.
        value: f64,
        /// What would do.
        bound: &'static str,
    },
    /// Bounds that leave no value.
    #[error("{field} = [{lower}, {upper}], but no weight lies between the two")]
    Bounds {
        /// Where, as in the file.
        field: String,
        /// The lower bound.
        lower: f64,
        /// The upper bound.
        upper: f64,
    },
    /// A kernel's scale out of bounds.
    #[error("{level}: {reason}")]
    Kernel {
        /// Where, as in the file: `level 1`, `then.level 2`.
        level: String,
        /// Field, value and bound.
        reason: String,
    },
    /// No levels.
    #[error("the schedule has no [[{0}]]")]
    NoLevels(String),
    /// A later stage cannot have blendshapes.
    #[error(
        "{field} = \"{model}\", but a later stage deforms the shape that the one before has found and has no blendshapes; \
         name a model without, such as \"graph\""
    )]
    StageModel {
        /// Where, as in the file.
        field: String,
        /// What was given.
        model: ModelKind,
    },
    /// An affine node has no rotation to parametrise.
    #[error(
        "{field} is not \"matrix\", but {nodes} nodes are affine and have no rotation; leave it out, or let nodes be rigid"
    )]
    Rotation {
        /// Where, as in the file.
        field: String,
        /// Whose.
        nodes: &'static str,
    },
    /// A model with one linearisation only.
    #[error(
        "solver.linearisation = \"reference\", but model '{model}' has only one linearisation; leave it out, or choose a model made \
         of nodes and blendshapes, such as 'hybrid'"
    )]
    Linearisation {
        /// The model.
        model: String,
    },
    /// A sequence of one.
    #[error(
        "model 'sequential' needs a second stage, [then] with a model and [[then.level]]; for one stage choose 'blendshape'"
    )]
    NoSecondStage,
    /// No default for this model.
    #[error("no default schedule for model '{0}'; known: {known}", known = super::DEFAULT_SCHEDULES.iter().map(|s| s.0).collect::<Vec<_>>().join(", "))]
    UnknownModel(String),
}

impl Schedule {
    /// The default schedule of a model.
    pub fn default_for(model: &str) -> Result<Self, ScheduleError> {
        let (_, text) = super::DEFAULT_SCHEDULES
            .iter()
            .find(|s| s.0 == model)
            .ok_or_else(|| ScheduleError::UnknownModel(model.to_owned()))?;
        Self::from_toml(text)
    }

    /// Reads and validates a schedule. The error quotes the line of an unknown key or a malformed value.
    pub fn from_toml(text: &str) -> Result<Self, ScheduleError> {
        let schedule: Self = toml::from_str(text).map_err(|e| syntax_error(&e))?;
        schedule.validate()?;
        Ok(schedule)
    }

    /// Checks every number against its bounds.
    pub fn validate(&self) -> Result<(), ScheduleError> {
        let positive = |field: String, value: f64| check(field, value, value > 0.0, "positive and finite");
        let not_negative =
            |field: String, value: f64| check(field, value, value >= 0.0, "zero or positive, and finite");
        // What only costs time or memory in numbers that no registration needs: a slip of the pen would seem to hang.
        let count = |field: String, value: usize| check(field, value as f64, value <= MOST, "at most 1000000");
        positive("reference_size".into(), self.reference_size)?;
        positive("reference_vertices".into(), self.reference_vertices)?;
        for (prefix, graph, levels) in self.stages() {
            if levels.is_empty() {
                return Err(ScheduleError::NoLevels(format!("{prefix}level")));
            }
            positive(format!("{prefix}graph.nodes"), graph.nodes as f64)?;
            positive(format!("{prefix}graph.influences"), graph.influences as f64)?;
            not_negative(format!("{prefix}graph.lambda_unseen"), graph.lambda_unseen)?;
            count(format!("{prefix}graph.nodes"), graph.nodes)?;
            count(format!("{prefix}graph.influences"), graph.influences)?;
            if graph.node == NodeKind::Affine {
                graph.require_no_rotation(&prefix, "these")?;
            }
        }
        positive("warm_start.steps".into(), self.warm_start.steps as f64)?;
        positive("affine.gamma".into(), self.affine.gamma)?;
        positive("search.rotations".into(), self.search.rotations as f64)?;
        positive("search.spacing".into(), self.search.spacing)?;
        positive("search.coarse".into(), self.search.coarse as f64)?;
        positive("search.fine".into(), self.search.fine as f64)?;
        positive("search.reach".into(), self.search.reach)?;
        positive("search.least_share".into(), self.search.least_share)?;
        positive("search.greatest_loss".into(), self.search.greatest_loss)?;
        positive("search.greatest_rival".into(), self.search.greatest_rival)?;
        not_negative("search.scale_sigma".into(), self.search.scale_sigma)?;
        count("search.rotations".into(), self.search.rotations)?;
        count("search.coarse".into(), self.search.coarse)?;
        count("search.fine".into(), self.search.fine)?;
        count("scan.normal_smoothing".into(), self.scan.normal_smoothing)?;
        not_negative("scan.template_rim".into(), self.scan.template_rim)?;
        count("scan.template_rim".into(), self.scan.template_rim.ceil() as usize)?;
        not_negative("seam.width".into(), self.seam.width)?;
        not_negative("seam.widest".into(), self.seam.widest)?;
        not_negative("stop.energy".into(), self.stop.energy)?;
        not_negative("stop.motion".into(), self.stop.motion)?;
        positive("sigma.expression".into(), self.sigma.expression)?;
        positive("sigma.identity".into(), self.sigma.identity)?;
        positive("sigma.landmark".into(), self.sigma.landmark)?;
        BoundsOptions::validate("bounds.expression", self.bounds.expression)?;
        BoundsOptions::validate("bounds.identity", self.bounds.identity)?;
        for (place, level) in self.levels_by_name() {
            let name = |field: &str| format!("{place}: {field}");
            positive(name("steps"), level.steps as f64)?;
            count(name("steps"), level.steps)?;
            not_negative(name("lambda_graph"), level.lambda_graph)?;
            not_negative(name("lambda_blend"), level.lambda_blend)?;
            not_negative(name("lambda_smooth"), level.lambda_smooth)?;
            not_negative(name("lambda_rotation"), level.lambda_rotation)?;
            not_negative(name("point_to_plane"), level.point_to_plane)?;
            not_negative(name("symmetric"), level.symmetric)?;
            not_negative(name("scan_to_template"), level.scan_to_template)?;
            not_negative(name("point_to_point"), level.point_to_point)?;
            not_negative(name("landmarks"), level.landmarks)?;
            not_negative(name("prediction"), level.prediction)?;
            not_negative(name("seam"), level.seam)?;
            for kernel in [level.kernel, level.landmark_kernel] {
                kernel.validate().map_err(|e| ScheduleError::Kernel { level: place.clone(), reason: e.to_string() })?;
            }
            positive(name("distance_cap"), level.distance_cap)?;
            check(
                name("normal_angle"),
                level.normal_angle,
                level.normal_angle > 0.0 && level.normal_angle <= 180.0,
                "above 0 and at most 180 degrees",
            )?;
        }
        for (k, stage) in self.later_stages().enumerate() {
            if stage.model.uses_shapes() {
                return Err(ScheduleError::StageModel { field: "then.".repeat(k + 1) + "model", model: stage.model });
            }
            if stage.model == ModelKind::Sumner {
                stage.graph.require_no_rotation(&"then.".repeat(k + 1), "Sumner's")?;
            }
            if self.solver.linearisation == Linearisation::Reference && !stage.model.is_assembled() {
                return Err(ScheduleError::Linearisation { model: stage.model.to_string() });
            }
        }
        Ok(())
    }

    /// The next stage's model, and the schedule as if that stage were the first.
    #[must_use]
    pub fn next_stage(&self) -> Option<(ModelKind, Self)> {
        let Stage { model, graph, levels, then } = self.then.as_deref()?.clone();
        Some((model, Self { graph, levels, then, ..self.clone() }))
    }

    /// Levels of all stages, with the names that messages give them: `level 1`, `then.level 2`.
    pub fn levels_by_name(&self) -> impl Iterator<Item = (String, &Level)> {
        self.stages().flat_map(|(prefix, _, levels)| {
            levels.iter().enumerate().map(move |(i, level)| (format!("{prefix}level {}", i + 1), level))
        })
    }

    /// Graph options and levels of each stage, with where they stand in the file: nowhere, `then.`, `then.then.`.
    fn stages(&self) -> impl Iterator<Item = (String, &GraphOptions, &[Level])> {
        let first = std::iter::once((&self.graph, &self.levels));
        let all = first.chain(self.later_stages().map(|stage| (&stage.graph, &stage.levels)));
        all.enumerate().map(|(k, (graph, levels))| ("then.".repeat(k), graph, levels.as_slice()))
    }

    fn later_stages(&self) -> impl Iterator<Item = &Stage> {
        std::iter::successors(self.then.as_deref(), |stage| stage.then.as_deref())
    }
}

fn check(field: String, value: f64, holds: bool, bound: &'static str) -> Result<(), ScheduleError> {
    if holds && value.is_finite() { Ok(()) } else { Err(ScheduleError::OutOfBounds { field, value, bound }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_key_is_answered_with_the_nearest_and_a_former_one_with_what_stands_for_it() {
        let with = |line: &str| {
            let text = super::super::DEFAULT_SCHEDULES[0].1.replacen("steps = 5", &format!("steps = 5\n{line}"), 1);
            Schedule::from_toml(&text).unwrap_err().to_string()
        };
        let message = with("distance_kap = 3.0");
        assert!(message.contains("unknown field `distance_kap`"), "{message}");
        assert!(message.ends_with("did you mean `distance_cap`?"), "{message}");
        let message = with("point_kernel = \"none\"");
        assert!(message.contains("`kernel` is that of every data term"), "{message}");
    }
}
