//! Which deformation models a registration can use, by name; a user's own model joins through [`ModelFactory`].

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{GraphDistance, Level, NodeKind, RegistrationError, RotationKind, Schedule, ScheduleError, SmoothOptions};
use crate::energy::DeformationModel;
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::model::{
    Affine, AffineMotion, AngleAxisMotion, Arap, ArapOptions, Autodiff, Free, FreeOptions, Linearisation, NodeAssembly,
    NodeGraph, NodeTransform, PositionFunction, QuaternionMotion, RigidMotion, Stiffness,
};
use crate::model::{blendshape, graph_of, hybrid_of, rigid, similarity, sumner};
use crate::rig::ShapeBasis;

/// A deformation model that a schedule can stiffen and soften.
pub trait RegistrationModel: DeformationModel {
    /// Takes a level's stiffness, lengths already in the model's unit.
    fn set_level(&mut self, level: &Level);

    /// Takes which vertices have no correspondence, 0 to 1 each, and the schedule's
    /// [`lambda_unseen`](super::GraphOptions::lambda_unseen), for a model that is stiffer there. Called before every step.
    fn set_unseen(&mut self, _unseen: &[f64], _lambda: f64) {}

    /// Chooses how derivatives are taken; `false` if the model has no choice.
    fn set_linearisation(&mut self, _linearisation: Linearisation) -> bool {
        false
    }

    /// Writes the shape that the model deforms, before its local motions: where vertices belong, up to a rigid motion, when
    /// nothing is seen of them. The rest shape, unless the model knows better.
    fn prediction(&mut self, _x: &[f64], rest: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(rest);
    }

    /// Names and values of the blendshape weights in `x`, if the model has any; in the order of the border's coordinates.
    fn named_weights(&self, _x: &[f64]) -> Vec<(String, f64)> {
        Vec::new()
    }

    /// How many directions no data fixed at the last linearisation, for a model that knows better than the linear solver, which
    /// counts coordinates that damping alone holds.
    fn weak_directions(&self) -> Option<usize> {
        None
    }
}

/// What a model is built from.
#[derive(Debug, Clone, Copy)]
pub struct ModelInput<'a> {
    /// The template's rest shape, centred.
    pub rest: &'a TriangleMesh,
    /// The blendshapes, in the frame of `rest`.
    pub shapes: &'a ShapeBasis,
    /// Graph options and the like.
    pub schedule: &'a Schedule,
}

/// Builds a model for a template. Implement this for your own model to register with it and to see it in `scan_bench`.
pub trait ModelFactory: Send + Sync {
    /// Name on the command line, in tables and in output files.
    fn name(&self) -> &str;

    /// The model's default schedule.
    fn schedule(&self) -> Result<Schedule, ScheduleError> {
        Schedule::default_for(self.name())
    }

    /// Whether the model can do anything without blendshapes.
    fn needs_shapes(&self) -> bool {
        false
    }

    /// Builds the model.
    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, RegistrationError>;
}

/// The models that come with the crate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Blendshapes inside a deformation graph (Klimov 2020).
    Hybrid,
    /// Deformation graph, rigid nodes unless the schedule says otherwise.
    Graph,
    /// Deformation graph with affine nodes (Sumner et al. 2007), whatever node the schedule names.
    Sumner,
    /// Blendshapes, then what the schedule's `[then]` names, from the shape that they have found (Bhat et al. 2013).
    Sequential,
    /// Per-vertex affine maps: optimal-step N-ICP (Amberg et al. 2007).
    Affine,
    /// Blendshapes under one rigid motion.
    Blendshape,
    /// Every vertex by itself, its displacement smooth.
    Free,
    /// As-rigid-as-possible surface (Sorkine and Alexa 2007).
    Arap,
    /// Rigid motion.
    Rigid,
    /// Similarity.
    Similarity,
}

impl ModelKind {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Hybrid,
        Self::Sequential,
        Self::Blendshape,
        Self::Graph,
        Self::Sumner,
        Self::Arap,
        Self::Affine,
        Self::Free,
        Self::Rigid,
        Self::Similarity,
    ];

    /// Whether blendshapes are part of the model.
    #[must_use]
    pub fn uses_shapes(self) -> bool {
        matches!(self, Self::Hybrid | Self::Sequential | Self::Blendshape)
    }

    /// Whether it is made of nodes and blendshapes, a [`NodeAssembly`]; of the sequential method, the first stage is.
    #[must_use]
    pub fn is_assembled(self) -> bool {
        !matches!(self, Self::Affine | Self::Free | Self::Arap)
    }

    /// The hybrid, or else the graph, with nodes that move as `T` says.
    fn with_nodes<T: NodeTransform<W>, const W: usize>(
        self,
        input: &ModelInput<'_>,
    ) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
        let (rest, nodes, stiffness) = (input.rest.positions.clone(), node_graph(input)?, Stiffness::default());
        Ok(if self == Self::Hybrid {
            Box::new(hybrid_of::<T, W>(rest, nodes, input.shapes.clone(), stiffness))
        } else {
            Box::new(graph_of::<T, W>(rest, nodes, stiffness.graph))
        })
    }
}

impl std::fmt::Display for ModelKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ModelKind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| {
            let known: Vec<_> = Self::ALL.iter().map(|m| m.name().to_owned()).collect();
            format!("unknown model '{name}'; known models: {}", known.join(", "))
        })
    }
}

impl ModelFactory for ModelKind {
    fn name(&self) -> &str {
        match self {
            Self::Hybrid => "hybrid",
            Self::Graph => "graph",
            Self::Sumner => "sumner",
            Self::Sequential => "sequential",
            Self::Affine => "affine",
            Self::Blendshape => "blendshape",
            Self::Free => "free",
            Self::Arap => "arap",
            Self::Rigid => "rigid",
            Self::Similarity => "similarity",
        }
    }

    fn needs_shapes(&self) -> bool {
        matches!(self, Self::Blendshape | Self::Sequential)
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
        let rest = input.rest.positions.clone();
        let options = &input.schedule.graph;
        // Levels set it before the first step.
        let stiffness = Stiffness::default();
        Ok(match self {
            Self::Hybrid | Self::Graph if options.node == NodeKind::Rigid => match options.rotation {
                RotationKind::Matrix => self.with_nodes::<RigidMotion, 6>(input)?,
                RotationKind::Quaternion => self.with_nodes::<QuaternionMotion, 6>(input)?,
                RotationKind::AngleAxis => self.with_nodes::<AngleAxisMotion, 6>(input)?,
            },
            Self::Hybrid => self.with_nodes::<AffineMotion, 12>(input)?,
            Self::Graph | Self::Sumner => {
                options.require_no_rotation("", "Sumner's")?;
                Box::new(sumner(rest, node_graph(input)?, stiffness.graph, stiffness.rotation))
            }
            Self::Sequential if input.schedule.then.is_none() => return Err(ScheduleError::NoSecondStage.into()),
            Self::Sequential | Self::Blendshape => Box::new(blendshape(rest, input.shapes.clone(), stiffness.blend)),
            Self::Free => Box::new(Free::new(input.rest, free_options(input.schedule), 1.0).map_err(template_error)?),
            Self::Arap => {
                let options = ArapOptions { solver: input.schedule.arap.solver, ..ArapOptions::default() };
                Box::new(Arap::new(input.rest, options, 1.0).map_err(template_error)?)
            }
            Self::Affine => {
                Box::new(Affine::new(input.rest, 1.0, input.schedule.affine.gamma).map_err(template_error)?)
            }
            Self::Rigid => Box::new(rigid(rest)),
            Self::Similarity => Box::new(similarity(rest)),
        })
    }
}

fn node_graph(input: &ModelInput<'_>) -> Result<NodeGraph, RegistrationError> {
    let options = &input.schedule.graph;
    let build = match options.distance {
        GraphDistance::Surface => NodeGraph::along_surface,
        GraphDistance::Euclidean => NodeGraph::through_space,
    };
    build(input.rest, options.nodes, options.influences).map_err(template_error)
}

fn free_options(schedule: &Schedule) -> FreeOptions {
    let SmoothOptions { kind, weights } = schedule.smooth;
    FreeOptions { kind, weights, reference_vertices: schedule.reference_vertices }
}

fn template_error(error: MeshError) -> RegistrationError {
    RegistrationError::Template(error.to_string())
}

impl RegistrationModel for Free {
    fn set_level(&mut self, level: &Level) {
        self.lambda_smooth = level.lambda_smooth;
    }

    fn weak_directions(&self) -> Option<usize> {
        (self.lambda_smooth > 0.0).then(|| self.unobserved_shifts())
    }
}

impl RegistrationModel for Arap {
    fn set_level(&mut self, level: &Level) {
        self.lambda_smooth = level.lambda_smooth;
    }

    fn weak_directions(&self) -> Option<usize> {
        (self.lambda_smooth > 0.0).then(|| self.unobserved_shifts())
    }
}

impl RegistrationModel for Affine {
    fn set_level(&mut self, level: &Level) {
        self.lambda = level.lambda_smooth;
    }
}

impl<T: NodeTransform<W>, const W: usize> RegistrationModel for NodeAssembly<T, W> {
    fn set_level(&mut self, level: &Level) {
        self.stiffness =
            Stiffness { graph: level.lambda_graph, rotation: level.lambda_rotation, blend: level.lambda_blend };
    }

    fn set_unseen(&mut self, unseen: &[f64], lambda: f64) {
        let graph = self.stiffness.graph;
        self.stiffen_unseen(unseen, if graph > 0.0 { (lambda / graph).max(1.0) } else { 1.0 });
    }

    fn set_linearisation(&mut self, linearisation: Linearisation) -> bool {
        self.linearisation = linearisation;
        true
    }

    fn prediction(&mut self, x: &[f64], _rest: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(self.blended(x));
    }

    fn named_weights(&self, x: &[f64]) -> Vec<(String, f64)> {
        self.shapes().shapes().iter().map(|s| s.name.clone()).zip(self.weights(x).iter().copied()).collect()
    }
}

impl<F: PositionFunction> RegistrationModel for Autodiff<F> {
    fn set_level(&mut self, level: &Level) {
        self.stiffness = level.lambda_smooth;
    }
}
