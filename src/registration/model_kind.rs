//! Which deformation models a registration can use, by name; a user's own model joins through [`ModelFactory`].

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{GraphDistance, Level, RegistrationError, Schedule, ScheduleError};
use crate::energy::DeformationModel;
use crate::mesh::{TriangleMesh, Vec3};
use crate::model::{
    Autodiff, NodeAssembly, NodeGraph, NodeTransform, PositionFunction, Stiffness, blendshape, graph, hybrid, rigid,
    similarity,
};
use crate::rig::ShapeBasis;

/// A deformation model that a schedule can stiffen and soften.
pub trait RegistrationModel: DeformationModel {
    /// Takes a level's stiffness, lengths already in the model's unit.
    fn set_level(&mut self, level: &Level);

    /// Writes the shape that the model deforms, before its local motions: where vertices belong, up to a rigid motion, when
    /// nothing is seen of them. The rest shape, unless the model knows better.
    fn prediction(&mut self, _x: &[f64], rest: &[Vec3], out: &mut Vec<Vec3>) {
        out.clear();
        out.extend_from_slice(rest);
    }

    /// Names and values of the blendshape weights in `x`, if the model has any.
    fn named_weights(&self, _x: &[f64]) -> Vec<(String, f64)> {
        Vec::new()
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
    /// Deformation graph (Sumner et al. 2007).
    Graph,
    /// Blendshapes under one rigid motion.
    Blendshape,
    /// Rigid motion.
    Rigid,
    /// Similarity.
    Similarity,
}

impl ModelKind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Hybrid, Self::Graph, Self::Blendshape, Self::Rigid, Self::Similarity];
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
            Self::Blendshape => "blendshape",
            Self::Rigid => "rigid",
            Self::Similarity => "similarity",
        }
    }

    fn needs_shapes(&self) -> bool {
        *self == Self::Blendshape
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
        let rest = input.rest.positions.clone();
        let stiffness = Stiffness { graph: 1.0, blend: 1.0 };
        Ok(match self {
            Self::Hybrid => Box::new(hybrid(rest, node_graph(input)?, input.shapes.clone(), stiffness)),
            Self::Graph => Box::new(graph(rest, node_graph(input)?, stiffness.graph)),
            Self::Blendshape => Box::new(blendshape(rest, input.shapes.clone(), stiffness.blend)),
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
    build(input.rest, options.nodes, options.influences).map_err(|e| RegistrationError::Template(e.to_string()))
}

impl<T: NodeTransform<W>, const W: usize> RegistrationModel for NodeAssembly<T, W> {
    fn set_level(&mut self, level: &Level) {
        self.stiffness = Stiffness { graph: level.lambda_graph, blend: level.lambda_blend };
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
