//! The schedule of a registration: levels from stiff to soft. Schedules are data, TOML files; each model brings its
//! default.

mod error;
mod level;
mod options;

use std::collections::BTreeMap;

pub use error::ScheduleError;
use error::{check, syntax_error};
pub use level::{KernelScale, Level};
pub use options::{BoundsOptions, SigmaOptions, SolverOptions, StepAlgorithm, StopOptions, WarmStartOptions};
use serde::{Deserialize, Serialize};

use super::StartOptions;
use crate::correspondence::ScanOptions;
use crate::energy::Options;
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::{PolygonMesh, PoseKind};
use crate::model::{ModelFactory, ModelKind, without_effect};
use crate::rig::{Family, Shape, ShapeBasis};
use crate::term::TermFactory;
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
    /// millimetres; 67 by default, as of the face that the schedules of the crate are for.
    #[serde(default = "reference_size")]
    pub reference_size: f64,
    /// Number of template vertices that the weights below are meant for; 6706 by default, as of that face.
    #[serde(default = "reference_vertices")]
    pub reference_vertices: f64,
    /// What the model is told, as its own documentation has it: `GraphOptions` and the like of [`model`](crate::model).
    #[serde(default)]
    pub model: Options,
    /// What data terms are told, by name: [`SeamOptions`](crate::term::SeamOptions).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<String, Options>,
    /// What of the scan is believed.
    #[serde(default)]
    pub scan: ScanOptions,
    /// How the energy is minimised.
    #[serde(default)]
    pub solver: SolverOptions,
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
    /// Whether sheets that passed through each other, as closed lips do, are [taken apart](super::Untangled) after the last step.
    #[serde(default)]
    pub untangle: bool,
    /// Further starts for what bends at joints, tried while parts of the scan are without a template. The first level leads; each of the
    /// others goes on from it and is a start of its own. That is taken whose shape covers the scan best after the first two of the levels,
    /// rest among them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bend: Vec<Level>,
    /// The levels, stiff to soft.
    #[serde(rename = "level", default)]
    pub levels: Vec<Level>,
    /// What comes after the last level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub then: Option<Box<Stage>>,
    /// What to do instead where the subject is closed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closed: Option<Box<ClosedSubject>>,
}

/// Model options and levels for bodies, bones and the like: for templates without any open edge whose shapes, if any, are all of
/// identity. A face has openings and expressions. Everything else is as the schedule says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClosedSubject {
    /// What the model is told.
    #[serde(default)]
    pub model: Options,
    /// Levels of further starts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bend: Vec<Level>,
    /// The levels, stiff to soft.
    #[serde(rename = "level", default)]
    pub levels: Vec<Level>,
}

/// A further stage: another model deforms the shape that the stage before has found, with levels of its own. Everything
/// else is as the schedule says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// The model: `{ name = "graph" }`, with what its `[model]` may say; one without blendshapes, for these have had their turn.
    pub model: StageModel,
    /// The levels, stiff to soft.
    #[serde(rename = "level", default)]
    pub levels: Vec<Level>,
    /// What comes after the last level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub then: Option<Box<Stage>>,
}

/// `[then.model]`: the model's name, and what it is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageModel {
    /// Its name.
    pub name: ModelKind,
    /// Its options.
    #[serde(flatten)]
    pub options: Options,
}

fn reference_size() -> f64 {
    67.0
}

fn reference_vertices() -> f64 {
    6706.0
}

/// Rounds of smoothing at most: more make all normals alike, slowly.
const MOST_SMOOTHING: usize = 1000;
/// Greatest count that a schedule may ask for.
const MOST: usize = 1_000_000;

impl Schedule {
    /// Reads and validates a schedule, such as a model's [default](ModelFactory::default_schedule), all but what belongs to models and
    /// terms. The error quotes the line of an unknown key or a malformed value.
    ///
    /// # Errors
    /// With the first thing that is wrong.
    pub fn from_toml(text: &str) -> Result<Self, ScheduleError> {
        let schedule: Self = toml::from_str(text).map_err(|e| syntax_error(&e))?;
        schedule.validate()?;
        Ok(schedule)
    }

    /// Checks every number against its bounds, all but those that belong to models and terms.
    ///
    /// # Errors
    /// With the first that is out of bounds.
    pub fn validate(&self) -> Result<(), ScheduleError> {
        let positive = |field: String, value: f64| check(field, value, value > 0.0, "positive and finite");
        let not_negative =
            |field: String, value: f64| check(field, value, value >= 0.0, "zero or positive, and finite");
        // What only costs time or memory in numbers that no registration needs: a slip of the pen would seem to hang.
        let count = |field: String, value: usize| check(field, value as f64, value <= MOST, "at most 1000000");
        positive("reference_size".into(), self.reference_size)?;
        positive("reference_vertices".into(), self.reference_vertices)?;
        for (prefix, levels) in self.stages() {
            if levels.is_empty() {
                return Err(ScheduleError::NoLevels(format!("{prefix}level")));
            }
        }
        positive("warm_start.steps".into(), self.warm_start.steps as f64)?;
        positive("search.rotations".into(), self.search.rotations as f64)?;
        positive("search.spacing".into(), self.search.spacing)?;
        positive("search.coarse".into(), self.search.coarse as f64)?;
        positive("search.fine".into(), self.search.fine as f64)?;
        positive("search.reach".into(), self.search.reach)?;
        positive("search.least_share".into(), self.search.least_share)?;
        positive("search.greatest_loss".into(), self.search.greatest_loss)?;
        positive("search.greatest_rival".into(), self.search.greatest_rival)?;
        not_negative("search.scale_sigma".into(), self.search.scale_sigma)?;
        not_negative("search.expression".into(), self.search.expression)?;
        count("search.rotations".into(), self.search.rotations)?;
        count("search.coarse".into(), self.search.coarse)?;
        count("search.fine".into(), self.search.fine)?;
        let rounds = self.scan.normal_smoothing;
        check("scan.normal_smoothing".into(), rounds as f64, rounds <= MOST_SMOOTHING, "at most 1000")?;
        not_negative("scan.template_rim".into(), self.scan.template_rim)?;
        count("scan.template_rim".into(), self.scan.template_rim.ceil() as usize)?;
        not_negative("stop.energy".into(), self.stop.energy)?;
        not_negative("stop.motion".into(), self.stop.motion)?;
        positive("sigma.expression".into(), self.sigma.expression)?;
        positive("sigma.identity".into(), self.sigma.identity)?;
        positive("sigma.landmark".into(), self.sigma.landmark)?;
        positive("sigma.beyond".into(), self.sigma.beyond.unwrap_or(1.0))?;
        BoundsOptions::validate("bounds.expression", self.bounds.expression)?;
        BoundsOptions::validate("bounds.identity", self.bounds.identity)?;
        for (place, level) in named("bend ", &self.bend).chain(self.levels_by_name()) {
            let name = |field: &str| format!("{place}: {field}");
            positive(name("steps"), level.steps as f64)?;
            count(name("steps"), level.steps)?;
            level
                .kernel
                .validate()
                .map_err(|e| ScheduleError::Kernel { level: place.clone(), reason: e.to_string() })?;
            positive(name("distance_cap"), level.distance_cap)?;
            not_negative(name("sampling"), level.sampling)?;
            not_negative(name("noise"), level.noise)?;
            check(
                name("normal_angle"),
                level.normal_angle,
                level.normal_angle > 0.0 && level.normal_angle <= 180.0,
                "above 0 and at most 180 degrees",
            )?;
        }
        for (k, stage) in self.later_stages().enumerate() {
            let model = stage.model.name;
            if model.uses_shapes() {
                return Err(ScheduleError::StageModel { field: "then.".repeat(k + 1) + "model", model });
            }
        }
        // last, since it has all else of the schedule
        self.of_closed().map_or(Ok(()), |closed| closed.validate()).map_err(|e| ScheduleError::Closed(Box::new(e)))
    }

    /// The schedule with all that `model`, the models of later stages, and `terms` are told, checked by them and their defaults
    /// filled in.
    ///
    /// # Errors
    /// With the first thing that is wrong.
    pub fn resolved(&self, model: &dyn ModelFactory, terms: &[&dyn TermFactory]) -> Result<Self, ScheduleError> {
        self.validate()?;
        if model.needs_second_stage() && self.then.is_none() {
            return Err(ScheduleError::NoSecondStage);
        }
        let place = |error, place: String| ScheduleError::Options { place, error };
        let mut resolved = self.clone();
        resolved.model = model.options(&self.model).map_err(|e| place(e, "model".into()))?;
        for term in terms {
            let given = self.terms.get(term.name()).cloned().unwrap_or_default();
            let options = term.options(&given).map_err(|e| place(e, format!("terms.{}", term.name())))?;
            resolved.terms.insert(term.name().to_owned(), options);
        }
        known_terms(&self.terms, "terms", terms)?;
        resolved.terms.retain(|_, options| !options.is_empty());
        resolve_levels(&mut resolved.bend, "bend ", model, terms)?;
        resolve_levels(&mut resolved.levels, "", model, terms)?;
        let (mut stage, mut prefix) = (resolved.then.as_deref_mut(), String::from("then."));
        while let Some(next) = stage {
            let StageModel { name, options } = &mut next.model;
            *options = name.options(options).map_err(|e| place(e, format!("{prefix}model")))?;
            resolve_levels(&mut next.levels, &prefix, name, terms)?;
            prefix += "then.";
            stage = next.then.as_deref_mut();
        }
        if let (Some(closed), Some(resolved)) = (self.of_closed(), &mut resolved.closed) {
            let Self { model, bend, levels, .. } =
                closed.resolved(model, terms).map_err(|e| ScheduleError::Closed(Box::new(e)))?;
            **resolved = ClosedSubject { model, bend, levels };
        }
        Ok(resolved)
    }

    /// What a [resolved](Self::resolved) schedule says and has no effect, and why; with these shapes, if they are known.
    #[must_use]
    pub fn without_effect(&self, shapes: Option<&[Shape]>) -> Vec<String> {
        let said = |prefix: &str, model: &Options, levels: &[&Level]| -> Vec<String> {
            let found = without_effect(model, levels.iter().map(|level| &level.model), shapes);
            found.into_iter().map(|(key, why)| format!("{prefix}model: {key} has no effect: {why}")).collect()
        };
        let mut all = said("", &self.model, &self.bend.iter().chain(&self.levels).collect::<Vec<_>>());
        for (k, stage) in (1..).zip(self.later_stages()) {
            all.extend(said(&"then.".repeat(k), &stage.model.options, &stage.levels.iter().collect::<Vec<_>>()));
        }
        if let Some(closed) = &self.closed {
            let levels: Vec<&Level> = closed.bend.iter().chain(&closed.levels).collect();
            all.extend(said("closed.", &closed.model, &levels));
        }
        all
    }

    /// The schedule for closed subjects, if there is one of their own.
    fn of_closed(&self) -> Option<Self> {
        let ClosedSubject { model, bend, levels } = self.closed.as_deref()?.clone();
        Some(Self { model, bend, levels, closed: None, ..self.clone() })
    }

    /// The schedule for this template and these shapes: [`closed`](Self::closed) has been decided.
    #[must_use]
    pub fn of_subject(&self, template: &PolygonMesh, shapes: &ShapeBasis) -> Self {
        let identities = || shapes.shapes().iter().all(|s| s.family == Family::Identity);
        let closed = || EdgeGraph::of(&template.triangulate()).is_closed();
        let of_closed = self.of_closed().filter(|_| identities() && closed());
        of_closed.unwrap_or_else(|| Self { closed: None, ..self.clone() })
    }

    /// The next stage's model, and the schedule as if that stage were the first.
    #[must_use]
    pub fn next_stage(&self) -> Option<(ModelKind, Self)> {
        let Stage { model, levels, then } = self.then.as_deref()?.clone();
        Some((model.name, Self { model: model.options, levels, then, ..self.clone() }))
    }

    /// Levels of all stages, with the names that messages give them: `level 1`, `then.level 2`.
    pub fn levels_by_name(&self) -> impl Iterator<Item = (String, &Level)> {
        self.stages().flat_map(|(prefix, levels)| named(&prefix, levels).collect::<Vec<_>>())
    }

    /// Levels of each stage, with where they stand in the file: nowhere, `then.`, `then.then.`.
    fn stages(&self) -> impl Iterator<Item = (String, &[Level])> {
        let all = std::iter::once(&self.levels).chain(self.later_stages().map(|stage| &stage.levels));
        all.enumerate().map(|(k, levels)| ("then.".repeat(k), levels.as_slice()))
    }

    fn later_stages(&self) -> impl Iterator<Item = &Stage> {
        std::iter::successors(self.then.as_deref(), |stage| stage.then.as_deref())
    }
}

/// Levels with the names that messages give them.
pub(super) fn named<'a>(prefix: &str, levels: &'a [Level]) -> impl Iterator<Item = (String, &'a Level)> {
    levels.iter().enumerate().map(move |(i, level)| (format!("{prefix}level {}", i + 1), level))
}

impl ModelKind {
    /// The model's default schedule.
    ///
    /// # Errors
    /// None: the schedules of the crate can be read.
    pub fn schedule(self) -> Result<Schedule, ScheduleError> {
        Schedule::from_toml(self.default_schedule())
    }
}

/// Fills in what the levels of a stage tell the model and the terms.
fn resolve_levels(
    levels: &mut [Level],
    prefix: &str,
    model: &dyn ModelFactory,
    terms: &[&dyn TermFactory],
) -> Result<(), ScheduleError> {
    for (k, level) in levels.iter_mut().enumerate() {
        let at = |what: &str| format!("{prefix}level {}: {what}", k + 1);
        let options = model.level_options(&level.model);
        level.model = options.map_err(|error| ScheduleError::Options { place: at("model"), error })?;
        known_terms(&level.terms, &at("terms"), terms)?;
        for term in terms {
            let place = at(&format!("terms.{}", term.name()));
            let given = level.terms.remove(term.name()).unwrap_or_default();
            let options = term.level_options(&given).map_err(|error| ScheduleError::Options { place, error })?;
            level.terms.insert(term.name().to_owned(), options);
        }
    }
    Ok(())
}

/// Refuses options of terms that there are not.
fn known_terms(
    given: &BTreeMap<String, Options>,
    place: &str,
    terms: &[&dyn TermFactory],
) -> Result<(), ScheduleError> {
    let Some(name) = given.keys().find(|name| terms.iter().all(|t| t.name() != name.as_str())) else { return Ok(()) };
    let nearest = text::most_similar(name, terms.iter().map(|t| t.name()));
    let meant = nearest.map_or(String::new(), |n| format!("; did you mean `{n}`?"));
    let known = terms.iter().map(|t| t.name()).collect::<Vec<_>>().join(", ") + &meant;
    Err(ScheduleError::UnknownTerm { place: place.to_owned(), name: name.clone(), known })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{TriangleMesh, Vec3};
    use crate::term::TERMS;

    #[test]
    fn a_closed_subject_of_identities_alone_has_levels_of_its_own() {
        let schedule = ModelKind::Hybrid.schedule().unwrap();
        let corners = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let mesh = |triangles: &[[u32; 3]]| {
            PolygonMesh::from(TriangleMesh { positions: corners.clone(), triangles: triangles.to_vec() })
        };
        let (closed, open) = (mesh(&faces), mesh(&faces[1..]));
        let shapes = |families: &[Family]| {
            let shape = |(k, family): (usize, &Family)| Shape { name: format!("shape {k}"), family: *family };
            ShapeBasis::new(families.iter().enumerate().map(shape).collect(), vec![0.5; 12 * families.len()])
        };
        let identities = shapes(&[Family::Identity; 2]);
        let own = schedule.of_subject(&closed, &identities);
        let stated = schedule.closed.clone().unwrap();
        assert_eq!((&own.model, &own.levels), (&stated.model, &stated.levels));
        assert_eq!(schedule.of_subject(&closed, &ShapeBasis::none()), own);
        assert!(own.closed.is_none() && own.levels != schedule.levels);
        let expressive = shapes(&[Family::Identity, Family::Expression]);
        for (template, shapes) in [(&open, &identities), (&closed, &expressive), (&open, &ShapeBasis::none())] {
            let of_faces = schedule.of_subject(template, shapes);
            assert_eq!(of_faces, Schedule { closed: None, ..schedule.clone() });
        }
        // What is wrong in it is found whatever the subject, and said to be there.
        let text = ModelKind::Hybrid.default_schedule();
        let wrong = text.replacen("node = \"affine\"", "knode = \"affine\"", 1);
        let error = Schedule::from_toml(&wrong).unwrap().resolved(&ModelKind::Hybrid, &TERMS).unwrap_err().to_string();
        assert!(error.starts_with("closed: ") && error.contains("did you mean `node`"), "{error}");
        let last = text.rfind("steps = 3").unwrap();
        let error = Schedule::from_toml(&format!("{}steps = 0{}", &text[..last], &text[last + 9..])).unwrap_err();
        assert!(error.to_string().starts_with("closed: level 6: steps"), "{error}");
        // And what is wrong everywhere is not.
        let with = |line: &str, more: &str| Schedule::from_toml(&text.replacen(line, &format!("{line}\n{more}"), 1));
        let resolved =
            with("untangle = true", "[terms.seam]\nwidth = -1.0").unwrap().resolved(&ModelKind::Hybrid, &TERMS);
        assert!(resolved.unwrap_err().to_string().starts_with("terms.seam.width"));
        let error = with("[scan]", "normal_smoothing = 100000").unwrap_err();
        assert!(
            error.to_string().starts_with("scan.normal_smoothing = 100000, but it must be at most 1000"),
            "{error}"
        );
        let then =
            "[then.model]\nname = \"blendshape\"\n[[then.level]]\nsteps = 1\ndistance_cap = 1.0\nkernel = \"none\"";
        let error = with("untangle = true", then).unwrap_err();
        assert!(error.to_string().starts_with("then.model"), "{error}");
    }

    #[test]
    fn what_has_no_effect_is_said_of_every_stage() {
        let said_of = |model: ModelKind, text: &str, shape: Option<&str>| {
            let shapes = shape.map(|name| [Shape { name: name.to_owned(), family: Family::Expression }]);
            let schedule = Schedule::from_toml(text).unwrap().resolved(&model, &TERMS).unwrap();
            schedule.without_effect(shapes.as_ref().map(|shapes| &shapes[..]))
        };
        let said = |model: ModelKind, text: &str| said_of(model, text, Some("jawOpen"));
        for model in ModelKind::ALL {
            assert_eq!(said(model, model.default_schedule()), [""; 0], "{model}");
        }
        let text = ModelKind::Hybrid.default_schedule();
        let found = said(ModelKind::Hybrid, &text.replace("smooth_shapes = 150\n", ""));
        assert_eq!(found, ["closed.model: smooth has no effect: smooth_shapes is 0"]);
        let text = ModelKind::Sumner.default_schedule().replace("coarse = true, ", "");
        assert_eq!(said(ModelKind::Sumner, &text), ["model: coarse_nodes has no effect: no level is coarse"]);
        let text = ModelKind::Hybrid.default_schedule();
        let found = said_of(ModelKind::Hybrid, text, Some("open the jaw"));
        assert_eq!(found, ["model: sparse has no effect: no shape is an expression with one of ARKit's names"]);
        assert_eq!(said_of(ModelKind::Hybrid, text, None), [""; 0]);
        let found = said(ModelKind::Hybrid, &text.replace("lambda_blend = 1.5, sparse", "lambda_blend = 0.0, sparse"));
        assert_eq!(found, ["model: sparse has no effect: lambda_blend is 0 beside it"]);
    }

    #[test]
    fn what_has_a_default_may_be_left_out_and_what_has_none_is_asked_for() {
        let lines = ["steps = 5\n", "distance_cap = 12.0\n", "kernel = \"none\"\n"];
        let level = format!("[[level]]\n{}", lines.concat());
        let schedule = Schedule::from_toml(&level).unwrap();
        let stated = "start = \"rigid\"\nreference_size = 67.0\nreference_vertices = 6706\n";
        assert_eq!(Schedule::from_toml(&format!("{stated}{level}normal_angle = 60.0\n")).unwrap(), schedule);
        let written = toml::to_string(&schedule).unwrap();
        assert!(written.contains("reference_size = 67.0\n") && written.contains("normal_angle = 60.0\n"), "{written}");
        for line in lines {
            let key = line.split(' ').next().unwrap();
            let message = Schedule::from_toml(&level.replace(line, "")).unwrap_err().to_string();
            assert!(message.contains(&format!("missing field `{key}`\nevery level ")), "{message}");
            assert!(message.contains(&format!(": {key} = ")), "{message}");
        }
        let message = |text: &str| Schedule::from_toml(text).unwrap_err().to_string();
        assert_eq!(message(""), "the schedule has no [[level]]");
        assert!(message(&format!("{level}[then]\n")).ends_with("[then.model] name = \"graph\""));
    }

    #[test]
    fn an_unknown_key_is_answered_with_the_nearest_and_a_former_one_with_what_stands_for_it() {
        let with = |line: &str| {
            let text = ModelKind::Hybrid.default_schedule().replacen("steps = 5", &format!("steps = 5\n{line}"), 1);
            Schedule::from_toml(&text).unwrap_err().to_string()
        };
        let message = with("distance_kap = 3.0");
        assert!(message.contains("unknown field `distance_kap`"), "{message}");
        assert!(message.ends_with("did you mean `distance_cap`?"), "{message}");
        let message = with("point_kernel = \"none\"");
        assert!(message.contains("`kernel` is that of every data term"), "{message}");
        let of_file = |text: &str| {
            let head = "reference_size = 67.0\nreference_vertices = 6706\n";
            Schedule::from_toml(&format!("{head}{text}")).unwrap_err().to_string()
        };
        for former in ["graph", "smooth", "arap", "affine"] {
            let message = of_file(&format!("[{former}]\nnodes = 3\n"));
            assert!(message.contains("stand in [model]"), "{message}");
        }
        let message = of_file("[then]\nmodel = \"arap\"\n");
        assert!(message.contains("[then.model] name = "), "{message}");
    }
}
