//! Plans replayed, previewed, mixed and measured.

use std::time::Instant;

use nonrigid::landmark::TemplatePoint;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::morph::{
    FrameSpec, LandmarkFrame, LiveStep, MorphError, Recipe, ReplayOptions, StepOutcome, Subject, replay,
};
use nonrigid::rig::{Regions, ShapeBasis};

use super::{Hub, Window};
use crate::case::{Case, Edit, Pair, Side, Source};
use crate::error::{Problem, problem};
use crate::protocol::{FrameView, ServerMessage, StepResult};
use crate::store::{self, clear_frame, positions_frame, values_frame};
use crate::vault::Vault;
use crate::{plan, wrap};

/// A plan's first steps, so that a slider moves only its own step and those behind it.
pub(super) struct Base {
    on: Ground,
    pub(super) done: Vec<Done>,
}

/// The step that is being dragged, its masks and its energy kept from one preview to the next.
pub(super) struct Dragged {
    on: Ground,
    /// The steps before it.
    before: Vec<String>,
    /// Itself, without what a drag changes.
    key: String,
    step: LiveStep,
}

/// What a plan is made on: face, landmarks and rig.
type Ground = (Source, Vec<(String, TemplatePoint)>, Option<Source>);

/// Iterations of a preview: the next one goes on from there.
const ITERATIONS: usize = 2;

/// A face after a plan.
pub(super) struct Replayed {
    pub(super) positions: Vec<Vec3>,
    results: Vec<StepResult>,
    frame: Option<FrameView>,
}

/// A step that is done.
pub(super) struct Done {
    /// Its text; of a step that is being dragged, no text that a plan has: once it is let go, it is done as `nonrigid morph` does it.
    key: String,
    positions: Vec<Vec3>,
    result: StepResult,
    /// The largest weight of each vertex over its masks; where that is less, how much it is protected, below zero.
    pub(super) shown: Vec<f64>,
}

impl Window {
    /// The positions after a plan, each step from where the one before has left the face. Steps that are as they were are not done
    /// again; what is done is what `nonrigid morph` does.
    pub(super) fn positions(&mut self, case: &Case, recipe: &str) -> Result<Replayed, Problem> {
        self.positions_while(false, case, recipe)
    }

    /// [`Self::positions`]; while something is dragged, the first step that has changed starts from where its last preview ended.
    fn positions_while(&mut self, dragging: bool, case: &Case, recipe: &str) -> Result<Replayed, Problem> {
        let hub = self.hub.clone();
        let source = store::face_source(case)?;
        let face = hub.store.mesh(&hub.vault, &source)?;
        let landmarks = plan_landmarks(&hub, case)?;
        if plan::is_empty(recipe) {
            let frame = frame_view(&landmarks, &face.positions);
            return Ok(Replayed { positions: face.positions.clone(), results: Vec::new(), frame });
        }
        let parsed = plan::read(recipe)?;
        let mut parts = Parts { hub: &hub, case, face: &face, recipe: &parsed, loaded: None };
        let on: Ground = (source, landmarks, case.rig.clone());
        let keys = plan::step_keys(recipe);
        let mut done = match self.base.take() {
            Some(base) if base.on == on => base.done,
            _ => Vec::new(),
        };
        let same = done.iter().zip(&keys).take_while(|(d, wanted)| d.key == **wanted).count();
        done.truncate(same);
        let outcome = keys.iter().enumerate().skip(same).try_for_each(|(k, key)| {
            let before = done.last().map_or(&face.positions, |d| &d.positions);
            let single = plan::only_step(&parsed, k);
            let mut on_face = |work: &mut dyn FnMut(&Subject<'_>) -> Result<(), Problem>| {
                let mesh = face.with_positions(before.clone());
                let (regions, shapes) = parts.get()?;
                work(&Subject { mesh: &mesh, landmarks: &on.1, regions, shapes })
            };
            let (key, outcomes) = if dragging && k == same {
                let wanted = plan::drag_key(recipe, k);
                let fits = |d: &Dragged| d.on == on && d.before == keys[..k] && d.key == wanted;
                let mut step = self.dragged.take().filter(fits).map(|dragged| dragged.step);
                if step.is_none() {
                    on_face(&mut |subject| {
                        step = LiveStep::new(&single, subject, ITERATIONS).map_err(problem)?;
                        Ok(())
                    })?;
                }
                let Some(mut step) = step else { return Ok(()) };
                let outcome = step.solve(&single).map_err(problem)?;
                let before = keys[..k].to_vec();
                self.dragged = Some(Dragged { on: on.clone(), before, key: wanted, step });
                (String::new(), vec![outcome])
            } else {
                let mut outcomes = Vec::new();
                on_face(&mut |subject| {
                    outcomes = replay(&single, subject, &ReplayOptions::default()).map_err(problem)?;
                    Ok(())
                })?;
                (key.clone(), outcomes)
            };
            for outcome in outcomes {
                let mut shown = outcome.coverage();
                let StepOutcome { protected, positions, report, .. } = outcome;
                // what is protected is below zero
                shown.iter_mut().zip(&protected).filter(|(s, p)| *p > *s).for_each(|(s, p)| *s = -p);
                let change = &report.change;
                let result = StepResult {
                    moving: report.moving as u32,
                    reached: change.reached,
                    folded: change.folded as u32,
                    stretch: [change.stretch.min, change.stretch.max],
                    tears: change.tears(),
                    iterations: report.energy.as_ref().map_or(0, |e| e.iterations as u32),
                };
                done.push(Done { key: key.clone(), positions, result, shown });
            }
            Ok(())
        });
        let positions = done.last().map_or(&face.positions, |d| &d.positions).clone();
        let results = done.iter().map(|d| d.result.clone()).collect();
        let frame = frame_view(&on.1, &positions);
        self.base = Some(Base { on, done });
        outcome.map(|()| Replayed { positions, results, frame })
    }

    /// Replays a plan and shows it.
    pub(super) fn replay(&mut self, case: &Case, recipe: &str, preview: bool) -> Result<(), Problem> {
        let clock = Instant::now();
        let steps = plan::view(recipe);
        if store::face_source(case).is_err() {
            self.show(clear_frame("plan"));
            let (results, command) = (Vec::new(), String::new());
            let message =
                ServerMessage::Plan { preview, steps, results, frame: None, command, milliseconds: 0.0, error: None };
            self.say(message);
            return Ok(());
        }
        let outcome = self.positions_while(preview, case, recipe);
        let milliseconds = 1e3 * clock.elapsed().as_secs_f64();
        let vault = &self.hub.vault;
        let command = if preview { String::new() } else { wrap::shell_line(vault, &morph_arguments(vault, case)?) };
        let (results, frame, error) = match outcome {
            Ok(Replayed { positions, results, frame }) => {
                self.show(positions_frame("plan", &positions));
                (results, frame, None)
            }
            Err(Problem(error)) => (Vec::new(), None, Some(error)),
        };
        self.say(ServerMessage::Plan { preview, steps, results, frame, command, milliseconds, error });
        Ok(())
    }

    /// Refuses one side, or a mirror image, on a face of which nothing tells left from right.
    pub(super) fn check_sides(&self, edit: &Edit) -> Result<(), Problem> {
        let case = &self.case()?.case;
        let spec = match edit {
            Edit::SetPreset { side, amount, .. } if *side != Side::Both && *amount != 0.0 => plan::frame_spec(),
            Edit::AddStep { step } if step.mirror => plan::frame_spec(),
            Edit::ChangeStep { index, change } if change.needs_sides() => {
                plan::frame_of(&case.plan_in_work()?.recipe, *index as usize)
            }
            _ => None,
        };
        // a plan may be made before there is a face
        let (Some(spec), true) = (spec, store::face_source(case).is_ok()) else { return Ok(()) };
        let face = self.hub.store.face(&self.hub.vault, case)?;
        frame_on(&spec, &plan_landmarks(&self.hub, case)?, &face.positions).map(drop).map_err(|error| {
            problem(format!(
                "nothing tells this face's left from its right ({error}): add a rig with 68 landmarks, or place these \
                 landmarks on the template under their names, and try again"
            ))
        })
    }

    pub(super) fn plan_positions(&mut self, id: u32) -> Result<(String, Vec<Vec3>), Problem> {
        let case = self.case()?.case.clone();
        let plan = case.plan_of(id)?;
        Ok((plan.name.clone(), self.positions(&case, &plan.recipe)?.positions))
    }

    pub(super) fn analyse(&mut self, plans: &[u32]) -> Result<(), Problem> {
        let hub = self.hub.clone();
        let case = self.case()?.case.clone();
        if plans.len() > 6 {
            return Err(problem("at most six plans are measured at once"));
        }
        let face = hub.store.face(&hub.vault, &case)?;
        let known = crate::analysis::landmarks(&hub.store, &hub.vault, &case, &face)?;
        let regions = hub.store.regions(&hub.vault, &case, &face)?;
        let mut measured = Vec::new();
        for id in plans {
            let (name, positions) = self.plan_positions(*id)?;
            measured.push((*id, name, positions));
        }
        let analysis = crate::analysis::analyse(&face, &known, &regions, &measured);
        self.say(ServerMessage::Analysis { analysis: Box::new(analysis?) });
        Ok(())
    }

    pub(super) fn blend(&mut self, from: Option<u32>, to: u32, share: f64, difference: bool) -> Result<(), Problem> {
        if !(0.0..=1.0).contains(&share) {
            return Err(problem("a share lies between 0 and 1"));
        }
        let hub = self.hub.clone();
        let a = match from {
            Some(id) => self.plan_positions(id)?.1,
            None => hub.store.face(&hub.vault, &self.case()?.case)?.positions.clone(),
        };
        let (_, b) = self.plan_positions(to)?;
        self.show(positions_frame("other", &a));
        let mixed: Vec<Vec3> = a.iter().zip(&b).map(|(a, b)| a * (1.0 - share) + b * share).collect();
        self.shown.plan = None;
        self.show(positions_frame("plan", &mixed));
        if difference {
            let distances: Vec<f64> = a.iter().zip(&b).map(|(a, b)| (a - b).norm()).collect();
            let most = distances.iter().copied().fold(0.1, f64::max);
            self.show(values_frame("plan", "difference / mm", &distances, 0.0, most));
        }
        Ok(())
    }
}

/// What steps need of a case besides its face; loaded when the first one does, which a step that is dragged on has done.
struct Parts<'a> {
    hub: &'a Hub,
    case: &'a Case,
    face: &'a PolygonMesh,
    recipe: &'a Recipe,
    loaded: Option<(Regions, ShapeBasis)>,
}

impl Parts<'_> {
    fn get(&mut self) -> Result<&(Regions, ShapeBasis), Problem> {
        let Self { hub, case, face, recipe, loaded } = self;
        let parts = match loaded.take() {
            Some(parts) => parts,
            None => {
                let regions = hub.store.regions(&hub.vault, case, face)?;
                let uses_shapes = recipe.step.iter().any(|s| s.get_ref().model.uses_shapes());
                let shapes =
                    if uses_shapes { hub.store.shapes(&hub.vault, case, 0, face)? } else { ShapeBasis::none() };
                (regions, shapes)
            }
        };
        Ok(loaded.insert(parts))
    }
}

/// The landmarks in whose frame plans are made: the rig's, or else those on the template.
fn plan_landmarks(hub: &Hub, case: &Case) -> Result<Vec<(String, TemplatePoint)>, Problem> {
    let vertices = hub.store.face(&hub.vault, case).map_or(0, |face| face.positions.len());
    // Those of a rig, or of a template before this one, may be of another mesh.
    let on_face = |(_, point): &(String, TemplatePoint)| point.corners().all(|(v, _)| (v as usize) < vertices);
    if let Some(rig) = &case.rig {
        let rig = hub.store.rig(&hub.vault, rig, 0)?;
        if !rig.landmarks.is_empty() {
            return Ok(rig.landmarks.iter().filter(|l| on_face(l)).cloned().collect());
        }
    }
    let placed = |p: &Pair| Some((p.name.clone(), TemplatePoint::Vertex(p.vertex?)));
    Ok(case.wrap.pairs.iter().filter_map(placed).filter(on_face).collect())
}

/// A frame on a face.
fn frame_on(
    spec: &FrameSpec,
    landmarks: &[(String, TemplatePoint)],
    positions: &[Vec3],
) -> Result<LandmarkFrame, MorphError> {
    let places: Vec<(String, Vec3)> = landmarks.iter().map(|(name, p)| (name.clone(), p.position(positions))).collect();
    LandmarkFrame::new(spec, &places)
}

/// The frame of the ready operations on a face, if it has their landmarks.
fn frame_view(landmarks: &[(String, TemplatePoint)], positions: &[Vec3]) -> Option<FrameView> {
    let frame = frame_on(&plan::frame_spec()?, landmarks, positions).ok()?;
    let unit = frame.vector([1.0, 0.0, 0.0]).norm();
    Some(FrameView { origin: frame.origin().into(), axes: frame.axes().map(Into::into), unit })
}

/// The `nonrigid morph` line of a case's plan, whose recipe is exported as `plan.toml`.
fn morph_arguments(vault: &Vault, case: &Case) -> Result<Vec<String>, Problem> {
    let face = store::face_source(case)?;
    let mut words = vec!["morph".to_owned(), "--mesh".to_owned(), wrap::asset_path(&face.at)];
    let mut units = vec![format!("mesh={}", face.unit.length())];
    if let Some(rig) = &case.rig {
        words.extend(["--rig".to_owned(), wrap::asset_path(&rig.at)]);
        units.push(format!("rig={}", rig.unit.length()));
    }
    let own: Vec<&Pair> = case.wrap.pairs.iter().filter(|p| p.vertex.is_some()).collect();
    if case.rig.is_none() && !own.is_empty() {
        let [_, at] = wrap::landmark_files(vault, &own)?;
        words.extend(["--landmarks".to_owned(), wrap::asset_path(&at)]);
    }
    words.extend(["--recipe", "plan.toml", "--unit", &units.join(","), "--out", "morphed.obj"].map(str::to_owned));
    Ok(words)
}
