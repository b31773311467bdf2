//! What a registration tells while it runs, and what comes out.

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::{LandmarkStart, ScanFacing, Schedule, StartSearch, TemplateRepair, Untangled, WarmStart};
use crate::correspondence::{ScanFlip, ScanSurface};
#[cfg(doc)]
use crate::energy::Deformation;
use crate::mesh::{Pose, Vec3};
use crate::nlls::{NormalEquations, Silent};

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
    /// Largest motion of a vertex in this step, in the schedule's millimetres: those of a subject of its
    /// [`reference_size`](Schedule::reference_size).
    pub motion: f64,
}

/// Sees every step and may stop the run; the result is then what was reached.
pub trait RegistrationObserver {
    /// Called once before the first step with the number of levels and the greatest number of steps.
    fn on_start(&mut self, _levels: usize, _steps: usize) {}

    /// Called after every step.
    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()>;

    /// A flag that another thread may set before the first step, which alone asks [`on_step`](Self::on_step): the search of a start
    /// looks at it from many threads, and the run ends with [`RegistrationError::Cancelled`](super::RegistrationError::Cancelled).
    fn cancel(&self) -> Option<&AtomicBool> {
        None
    }

    /// Whether [`on_positions`](Self::on_positions) is called, asked before the first step and after every one; positions cost
    /// nothing unless it says yes.
    fn wants_positions(&self) -> bool {
        false
    }

    /// Called right after [`on_step`](Self::on_step), also where that stops the run, with one position per template vertex in the
    /// scan's frame; those of the last call are the result's, but for what is [untangled](RegistrationResult::untangled) and, where
    /// it is stopped among coarse levels, what all nodes then say.
    fn on_positions(&mut self, _record: &StepRecord, _positions: &[Vec3]) {}

    /// Whether [`on_equations`](Self::on_equations) is called; they are not assembled unless it says yes.
    fn wants_equations(&self) -> bool {
        false
    }

    /// Called once, at the end, with the normal equations of half the energy at the result, without damping: of the last stage, at
    /// the correspondences of its last step, in the centred rest frame.
    fn on_equations(&mut self, _equations: &NormalEquations) {}
}

impl<F: FnMut(&StepRecord) -> ControlFlow<()>> RegistrationObserver for F {
    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self(record)
    }
}

impl RegistrationObserver for Silent {
    fn on_step(&mut self, _: &StepRecord) -> ControlFlow<()> {
        ControlFlow::Continue(())
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
    pub std_dev: Option<f64>,
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
    /// The expression that it started with instead of rest, as few landmarks said which face it is: see
    /// [`StartOptions::expression`](super::StartOptions::expression).
    pub start_expression: Option<String>,
    /// Whether it started bent: where one of the [further starts](super::Schedule::bend) covered the scan better than rest.
    pub start_bent: bool,
    /// The scan as it was registered, in its own frame, for what is measured on it and taken from it. Large: whoever keeps results
    /// does better without ([`std::mem::take`]).
    pub scan: ScanSurface,
    /// What was done to the scan so that it faces outwards.
    pub scan_facing: ScanFacing,
    /// What was done to the template, for the registration alone, so that it is one surface.
    pub template_repair: TemplateRepair,
    /// What was taken apart after the last step, if the schedule says so; by it alone the positions differ from the model's.
    pub untangled: Option<Untangled>,
    /// Blendshape weights by name, with their standard deviations; those of the first stage, for later ones have none.
    pub weights: Vec<NamedWeight>,
    /// Which vertices had an accepted correspondence at the end.
    pub accepted: Vec<bool>,
    /// Which vertices the template hides from scanners, [at rest](crate::mesh::hidden_vertices).
    pub hidden: Vec<bool>,
    /// Directions that nothing observed and damping held still, in the last step. Models of single vertices count the shifts of
    /// whole parts.
    pub unobserved_directions: usize,
    /// Every step.
    pub history: Vec<StepRecord>,
    /// Steps along which the energy did not fall however short they were, though its derivatives say that it does: some derivative is wrong.
    pub stalled_steps: usize,
    /// Why it ended.
    pub stop: RegistrationStop,
    /// The schedule as it was used.
    pub schedule: Schedule,
}

impl RegistrationResult {
    /// What was wrong with template, scan and landmarks and what was done about it, for the user, a sentence each.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.template_repair.remarks();
        remarks.extend(self.scan_facing.remarks());
        if self.scan_facing.flipped && self.schedule.scan.flip == ScanFlip::Auto {
            remarks.push(
                "scan and template face opposite ways, so that the normals of one of them face inwards: the scan was turned over; if a \
                 program has mirrored it instead, left is right in the result; `no` for the option flip leaves it as it is"
                    .to_owned(),
            );
        }
        remarks.extend(self.start_landmarks.iter().flat_map(LandmarkStart::remarks));
        if self.stalled_steps > 0 {
            remarks.push(format!(
                "steps that should have lowered the energy and did not: {}; the derivatives of a model or term may be wrong",
                self.stalled_steps
            ));
        }
        remarks
    }
}
