//! The template as one surface, as the registration needs it: sewn where it was cut for texture coordinates or normals, and facing one
//! way. What the caller gave keeps its vertices and polygons; those that are one point come out at one place.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::facing::{is_collapsed, turned};
use super::{RegistrationInput, RegistrationObserver, RegistrationResult, StepRecord};
use crate::landmark::{Landmark, TemplatePoint};
#[cfg(doc)]
use crate::mesh::sewn;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::nlls::NormalEquations;
use crate::rig::{Regions, ShapeBasis};

/// What was done to the template's surface, for the registration alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TemplateRepair {
    /// Vertices that moved with another one at the same place, along a [seam](sewn) that no shape opens.
    pub sewn: usize,
    /// Triangles that were turned to agree with their neighbours.
    pub turned: usize,
}

impl TemplateRepair {
    /// What was found, in words.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let Self { sewn, turned } = self;
        let seams = format!(
            "{sewn} vertices of the template stand where another does, along seams, and moved with it; where a seam is to open, as lips \
             that touch are, move its sides a little apart in the template"
        );
        let turns = format!(
            "{turned} of the template's triangles face against their neighbours and were turned for the registration"
        );
        [(*sewn, seams), (*turned, turns)]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(_, remark)| remark)
            .collect()
    }
}

/// What is registered in place of a template that is not one surface yet.
pub(super) struct OneSurface {
    /// Vertex of the surface for each of the template's.
    vertex: Vec<u32>,
    template: PolygonMesh,
    neutral: Option<Vec<Vec3>>,
    shapes: ShapeBasis,
    landmarks: Vec<Landmark>,
    mask: Option<Vec<f64>>,
    free_mask: Option<Vec<f64>>,
    regions: Option<Regions>,
    repair: TemplateRepair,
}

impl OneSurface {
    /// `None` where the template is one surface. The input must have been checked.
    pub fn of(input: &RegistrationInput<'_>) -> Option<Self> {
        let (first, triangles, turned) = repaired(input);
        let chosen: Vec<u32> = (0..).zip(&first).filter(|(v, first)| v == *first).map(|(v, _)| v).collect();
        let repair = TemplateRepair { sewn: first.len() - chosen.len(), turned };
        if repair == TemplateRepair::default() {
            return None;
        }
        let mut vertex = vec![0; first.len()];
        (0..).zip(&chosen).for_each(|(k, v)| vertex[*v as usize] = k);
        let vertex: Vec<u32> = first.iter().map(|&v| vertex[v as usize]).collect();
        let to = |v: u32| vertex[v as usize];
        let select = |positions: &[Vec3]| chosen.iter().map(|&v| positions[v as usize]).collect::<Vec<_>>();
        // along a seam the largest
        let shares = |mask: &[f64]| {
            let mut shares = vec![0.0_f64; chosen.len()];
            vertex.iter().zip(mask).for_each(|(&v, &m)| shares[v as usize] = shares[v as usize].max(m));
            shares
        };
        let landmark = |landmark: &Landmark| {
            let template = match landmark.template {
                TemplatePoint::Vertex(v) => TemplatePoint::Vertex(to(v)),
                TemplatePoint::Face { corners, weights } => TemplatePoint::Face { corners: corners.map(to), weights },
            };
            Landmark { template, ..landmark.clone() }
        };
        let triangles = triangles.iter().map(|t| t.map(to)).filter(|t| repair.sewn == 0 || !is_collapsed(t));
        let mesh = TriangleMesh { positions: select(&input.template.positions), triangles: triangles.collect() };
        Some(Self {
            template: mesh.into(),
            neutral: input.neutral.map(select),
            shapes: if repair.sewn == 0 || input.shapes.is_empty() {
                input.shapes.clone()
            } else {
                input.shapes.masked(&chosen, &vec![1.0; chosen.len()])
            },
            landmarks: input.landmarks.iter().map(landmark).collect(),
            mask: input.mask.map(shares),
            free_mask: input.free_mask.map(shares),
            regions: input.regions.map(|regions| regions.on(chosen.len(), to)),
            vertex,
            repair,
        })
    }

    /// What is registered.
    pub fn input<'a>(&'a self, given: &RegistrationInput<'a>) -> RegistrationInput<'a> {
        RegistrationInput {
            template: &self.template,
            neutral: self.neutral.as_deref(),
            shapes: &self.shapes,
            landmarks: &self.landmarks,
            mask: self.mask.as_deref(),
            free_mask: self.free_mask.as_deref(),
            regions: self.regions.as_ref(),
            ..*given
        }
    }

    /// An observer that sees the template's own vertices.
    pub fn observer<'a>(&'a self, observer: &'a mut dyn RegistrationObserver) -> impl RegistrationObserver + 'a {
        OfVertices { surface: self, observer }
    }

    /// A result with the template's own vertices.
    pub fn result(&self, result: RegistrationResult) -> RegistrationResult {
        RegistrationResult {
            positions: self.of_vertices(&result.positions),
            accepted: self.of_vertices(&result.accepted),
            hidden: self.of_vertices(&result.hidden),
            template_repair: self.repair,
            ..result
        }
    }

    fn of_vertices<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.vertex.iter().map(|&v| values[v as usize]).collect()
    }
}

/// The template's polygons where some of its triangles were turned: its triangles then, all facing one way, on its own vertices.
pub(super) fn facing_one_way(input: &RegistrationInput<'_>) -> PolygonMesh {
    let (_, triangles, _) = repaired(input);
    TriangleMesh { positions: input.template.positions.clone(), triangles }.into()
}

/// The first of the vertices with which each of the template's is one point, its triangles, facing one way, and how many were turned.
fn repaired(input: &RegistrationInput<'_>) -> (Vec<u32>, Vec<[u32; 3]>, usize) {
    let mut rest = input.template.triangulate();
    rest.positions.copy_from_slice(input.rest_positions());
    let first = input.shapes.seams(&rest);
    let own = rest.triangles.clone();
    rest.triangles.iter_mut().for_each(|t| *t = t.map(|v| first[v as usize]));
    let (facing, count) = turned(Cow::Borrowed(&rest));
    let own = own.into_iter().zip(facing.triangles.iter().zip(&rest.triangles));
    let own = own.map(|([a, b, c], (now, before))| if now == before { [a, b, c] } else { [a, c, b] });
    (first, own.collect(), count)
}

/// The first of the vertices with which each of the template's is one point.
pub(super) fn seams(input: &RegistrationInput<'_>) -> Vec<u32> {
    input.shapes.seams(&TriangleMesh { positions: input.rest_positions().to_vec(), ..input.template.triangulate() })
}

struct OfVertices<'a> {
    surface: &'a OneSurface,
    observer: &'a mut dyn RegistrationObserver,
}

impl RegistrationObserver for OfVertices<'_> {
    fn on_start(&mut self, levels: usize, steps: usize) {
        self.observer.on_start(levels, steps);
    }

    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self.observer.on_step(record)
    }

    fn cancel(&self) -> Option<&AtomicBool> {
        self.observer.cancel()
    }

    fn wants_positions(&self) -> bool {
        self.observer.wants_positions()
    }

    fn on_positions(&mut self, record: &StepRecord, positions: &[Vec3]) {
        self.observer.on_positions(record, &self.surface.of_vertices(positions));
    }

    fn wants_equations(&self) -> bool {
        self.observer.wants_equations()
    }

    fn on_equations(&mut self, equations: &NormalEquations) {
        self.observer.on_equations(equations);
    }
}
