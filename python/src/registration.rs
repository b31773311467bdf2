//! Registrations: the library's, with callbacks on the thread that asked, and Ctrl-C.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use nonrigid::io::{Input, KnownUnit, MeshFile};
use nonrigid::landmark::pair_landmarks;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::nlls::NormalEquations;
use nonrigid::registration::TERMS;
use nonrigid::registration::{
    self, DetailReport, InputFile, ModelFactory as _, ModelKind, RegistrationError, RegistrationInput,
    RegistrationObserver, RegistrationResult, RegistrationStop, Reliability, Report, ScanFacing, StepRecord,
    VertexColors, add_detail, assess, register_with, scan_colors,
};
use nonrigid::render::{registration_sheet, save_png};
use nonrigid::rig::{Regions, ShapeBasis, ShapeSelection};
use nonrigid::text;
use numpy::{IntoPyArray as _, PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{computation, compute, input, no_thread, on_threads, value};
use crate::inputs::{Landmarks, Mask, Schedule};
use crate::mesh::{Mesh, check_plan, unit};
use crate::rig::Rig;

/// Where a registration has ended.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct WarmStart {
    state: registration::WarmStart,
    files: Vec<Input>,
}

#[pymethods]
impl WarmStart {
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        compute(py, Some(1), || {
            let inputs = nonrigid::io::Inputs::default();
            let text = inputs.reading("", || nonrigid::io::read_text(&path)).map_err(input)?;
            let state = serde_json::from_str(&text);
            let state = state.map_err(|e| value(format!("{}: is no state of a registration: {e}", path.display())))?;
            Ok(Self { state, files: inputs.files() })
        })
    }

    #[staticmethod]
    fn parse(text: &str) -> PyResult<Self> {
        let state = serde_json::from_str(text).map_err(|e| value(format!("warm_start: {e}")))?;
        Ok(Self { state, files: Vec::new() })
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }
}

/// One step of a registration.
#[pyclass(frozen, get_all, eq, module = "nonrigid")]
#[derive(PartialEq)]
pub struct Step {
    /// Level, from 0; counts on over the stages of the schedule.
    level: usize,
    /// Step within the level, from 0.
    step: usize,
    /// Energy before the step, at the step's correspondences.
    energy_before: f64,
    /// Energy after the step, at the same correspondences.
    energy: f64,
    /// The same by term and regulariser.
    energies: BTreeMap<String, f64>,
    /// Share of the template's vertices with an accepted correspondence, 0 to 1.
    inliers: f64,
    /// Largest motion of a vertex in this step, millimetres.
    motion: f64,
}

#[pymethods]
impl Step {
    #[new]
    fn new(
        level: usize,
        step: usize,
        energy_before: f64,
        energy: f64,
        energies: BTreeMap<String, f64>,
        inliers: f64,
        motion: f64,
    ) -> Self {
        Self { level, step, energy_before, energy, energies, inliers, motion }
    }

    fn __getnewargs__(&self) -> (usize, usize, f64, f64, BTreeMap<String, f64>, f64, f64) {
        let Self { level, step, energy_before, energy, energies, inliers, motion } = self;
        (*level, *step, *energy_before, *energy, energies.clone(), *inliers, *motion)
    }

    fn __repr__(&self) -> String {
        let Self { level, step, energy, inliers, motion, .. } = self;
        format!("Step(level={level}, step={step}, energy={energy:.6}, inliers={inliers:.3}, motion={motion:.4})")
    }
}

impl From<&StepRecord> for Step {
    fn from(record: &StepRecord) -> Self {
        Self {
            level: record.level,
            step: record.step,
            energy_before: record.energy_before,
            energy: record.energy,
            energies: record.energies.iter().cloned().collect(),
            inliers: record.inliers,
            motion: record.motion,
        }
    }
}

/// What the thread that computes says to the one that asked.
enum Event {
    Step(StepRecord),
    Positions(StepRecord, Vec<Vec3>),
}

/// Sees every step on the thread that computes.
struct Observer<'a> {
    stop: &'a AtomicBool,
    events: Option<(Sender<Event>, Receiver<()>)>,
    steps: bool,
    positions: bool,
    equations: Option<Option<Sparse>>,
}

impl Observer<'_> {
    /// Tells the other thread, and waits until it has done with it.
    fn tell(&self, event: Event) {
        if let Some((events, done)) = &self.events
            && events.send(event).is_ok()
        {
            let _ = done.recv(); // who does not answer has gone, and has said to stop
        }
    }
}

impl RegistrationObserver for Observer<'_> {
    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        if self.steps {
            self.tell(Event::Step(record.clone()));
        }
        if self.stop.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn cancel(&self) -> Option<&AtomicBool> {
        Some(self.stop)
    }

    fn wants_positions(&self) -> bool {
        self.positions
    }

    fn on_positions(&mut self, record: &StepRecord, positions: &[Vec3]) {
        self.tell(Event::Positions(record.clone(), positions.to_vec()));
    }

    fn wants_equations(&self) -> bool {
        self.equations.is_some()
    }

    fn on_equations(&mut self, equations: &NormalEquations) {
        let matrix = equations.to_csc();
        let (pointers, rows, values) = matrix.disassemble();
        let as_i64 = |list: Vec<usize>| list.into_iter().map(|i| i as i64).collect();
        let gradient = equations.gradient.clone();
        self.equations = Some(Some(Sparse { pointers: as_i64(pointers), rows: as_i64(rows), values, gradient }));
    }
}

/// A sparse matrix by columns, and a right-hand side.
struct Sparse {
    pointers: Vec<i64>,
    rows: Vec<i64>,
    values: Vec<f64>,
    gradient: Vec<f64>,
}

/// Name, value, standard deviation, whether at a bound.
type Weight = (String, f64, Option<f64>, bool);
/// Column pointers, row indices, values, gradient.
type Equations<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// What came of a registration.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Registration {
    result: RegistrationResult,
    colors: Option<VertexColors>,
    report: String,
    state: String,
    reliability: Reliability,
    equations: Option<Sparse>,
    finer: Option<MeshFile>,
    /// The file whose materials go along.
    materials: PathBuf,
    /// What is odd about the template or the neutral.
    notes: Vec<String>,
    /// Whether its model has blendshapes.
    uses_shapes: bool,
}

#[pymethods]
impl Registration {
    /// The finer mesh, if one was asked for.
    #[getter]
    fn finer(&self) -> Option<Mesh> {
        let finer = Mesh::of_arrays(self.finer.clone()?);
        Some(Mesh { materials: self.materials.clone(), ..finer })
    }

    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, &self.result.positions)
    }

    #[getter]
    fn colors<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        self.colors.as_ref().map(|c| arrays::from_colors(py, &c.colors)).transpose()
    }

    #[getter]
    fn accepted<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.result.accepted.clone().into_pyarray(py)
    }

    #[getter]
    fn weights(&self) -> Vec<Weight> {
        self.result.weights.iter().map(|w| (w.name.clone(), w.value, w.std_dev, w.at_bound)).collect()
    }

    /// The report, as the command line writes it.
    #[getter]
    fn report(&self) -> &str {
        &self.report
    }

    /// Where it has ended, as the command line writes it.
    #[getter]
    fn state(&self) -> &str {
        &self.state
    }

    #[getter]
    fn error_probability(&self) -> f64 {
        self.reliability.probability
    }

    #[getter]
    fn wrong_length(&self) -> String {
        self.reliability.wrong_length()
    }

    #[getter]
    fn doubts(&self) -> Vec<String> {
        self.reliability.doubts.iter().map(ToString::to_string).collect()
    }

    #[getter]
    fn uses_shapes(&self) -> bool {
        self.uses_shapes
    }

    #[getter]
    fn finished(&self) -> bool {
        self.result.stop == RegistrationStop::Finished
    }

    #[getter]
    fn facing(&self) -> (usize, usize, bool) {
        let ScanFacing { repeated, turned, flipped, .. } = self.result.scan_facing;
        (repeated, turned, flipped)
    }

    #[getter]
    fn remarks(&self) -> Vec<String> {
        self.notes.iter().cloned().chain(self.result.remarks()).collect()
    }

    #[getter]
    fn equations<'py>(&self, py: Python<'py>) -> Option<Equations<'py>> {
        let Sparse { pointers, rows, values, gradient } = self.equations.as_ref()?;
        let (pointers, rows) = (pointers.clone().into_pyarray(py), rows.clone().into_pyarray(py));
        Some((pointers, rows, values.clone().into_pyarray(py), gradient.clone().into_pyarray(py)))
    }
}

/// What a callback has answered: whether to go on.
fn answered(answer: PyResult<Bound<'_, PyAny>>) -> PyResult<bool> {
    let answer = answer?;
    Ok(answer.is_none() || answer.extract::<bool>().unwrap_or(true))
}

/// Answers events, and looks for Ctrl-C meanwhile, until the other thread ends. The first exception stops it.
fn attend(
    py: Python<'_>,
    (events, done): (Receiver<Event>, Sender<()>),
    stop: &AtomicBool,
    callback: Option<&Bound<'_, PyAny>>,
    on_positions: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let events = Mutex::new(events);
    let mut failed = None;
    let mut fail = |error: PyErr| {
        failed.get_or_insert(error);
        stop.store(true, Ordering::SeqCst);
    };
    loop {
        let event = py.detach(|| {
            let events = events.lock().unwrap_or_else(PoisonError::into_inner);
            events.recv_timeout(Duration::from_millis(20))
        });
        if let Err(error) = py.check_signals() {
            fail(error);
        }
        match event {
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => break,
            Ok(_) if stop.load(Ordering::SeqCst) => {}
            Ok(Event::Step(record)) => {
                if let Some(callback) = callback {
                    match answered(callback.call1((Step::from(&record),))) {
                        Ok(true) => {}
                        Ok(false) => stop.store(true, Ordering::SeqCst),
                        Err(error) => fail(error),
                    }
                }
            }
            Ok(Event::Positions(record, positions)) => {
                if let Some(callback) = on_positions {
                    let positions = arrays::from_points(py, &positions);
                    let answer = positions.and_then(|p| answered(callback.call1((Step::from(&record), p))));
                    match answer {
                        Ok(true) => {}
                        Ok(false) => stop.store(true, Ordering::SeqCst),
                        Err(error) => fail(error),
                    }
                }
            }
        }
        let _ = done.send(()); // who has gone needs no answer
    }
    failed.map_or(Ok(()), Err)
}

fn registration_error(error: RegistrationError) -> PyErr {
    if error.is_input() { input(error) } else { computation(error) }
}

fn combined(a: Option<Vec<f64>>, b: Option<Vec<f64>>, with: impl Fn(f64, f64) -> f64) -> Option<Vec<f64>> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.into_iter().zip(b).map(|(a, b)| with(a, b)).collect()),
        (a, b) => a.or(b),
    }
}

#[pyfunction]
#[pyo3(signature = (template, scan, *, neutral, rig, shapes, identity_modes, landmarks, template_landmarks, landmark_units, model, schedule,
    mask, free_mask, regions, free_regions, warm_start, subdivide, threads, callback, on_positions, equations))]
fn register(
    py: Python<'_>,
    template: &Mesh,
    scan: &Mesh,
    neutral: Option<&Mesh>,
    rig: Option<&Rig>,
    shapes: Option<Vec<String>>,
    identity_modes: Option<usize>,
    landmarks: Option<&Landmarks>,
    template_landmarks: Option<&Landmarks>,
    landmark_units: (Option<String>, Option<String>),
    model: &str,
    schedule: &Schedule,
    mask: Option<&Mask>,
    free_mask: Option<&Mask>,
    regions: Vec<String>,
    free_regions: Vec<String>,
    warm_start: Option<&WarmStart>,
    subdivide: u8,
    threads: Option<usize>,
    callback: Option<&Bound<'_, PyAny>>,
    on_positions: Option<&Bound<'_, PyAny>>,
    equations: bool,
) -> PyResult<Registration> {
    let model: ModelKind = model.parse().map_err(value)?;
    let (of_scan, of_template) = (unit(landmark_units.0.as_deref())?, unit(landmark_units.1.as_deref())?);
    let work = |observer: &mut Observer<'_>| -> PyResult<Registration> {
        let mut units: BTreeMap<String, KnownUnit> = BTreeMap::new();
        let mut know = |name: &str, known: Option<KnownUnit>| {
            known.map(|known| units.insert(name.to_owned(), known));
        };
        know("template", template.known);
        know("target", scan.known);
        know("neutral", neutral.and_then(|n| n.known));
        know("rig", rig.and_then(|r| r.known));
        let mesh = template.polygons();
        let target = mesh_of_scan(scan);
        let mut notes = Vec::new();
        let basis = match rig {
            None => ShapeBasis::none(),
            Some(rig) => {
                let names = shapes.as_deref();
                let usual = || rig.rig.usual_identity_modes(names, neutral.is_some());
                let identity_modes = identity_modes.unwrap_or_else(usual);
                let selection = ShapeSelection { names, identity_modes };
                let (what, subject) = neutral.map_or(("the template", mesh), |n| ("the neutral", n.polygons()));
                let (basis, odd) = rig.rig.select_for(selection, what, &subject.positions).map_err(input)?;
                notes.extend(odd.iter().map(ToString::to_string));
                basis
            }
        };
        let mut pairs = Vec::new();
        if let Some(landmarks) = landmarks {
            let (set, known) = landmarks.in_millimetres(of_scan, scan)?;
            know("landmarks", known);
            let names = template_landmarks
                .map(|names| Ok::<_, PyErr>((names.in_millimetres(of_template, template)?, &names.path)));
            let names = names.transpose()?;
            know("template-landmarks", names.as_ref().and_then(|((_, known), _)| *known));
            let names = names.as_ref().map(|((set, _), path)| (set, path.as_path()));
            pairs = pair_landmarks((set, &landmarks.path), names, mesh, Some(&target)).map_err(input)?;
        }
        let known_regions = Regions::of(rig.map(|r| &r.rig), mesh);
        let region_mask = |names: &[String], option: &str| -> PyResult<Option<Vec<f64>>> {
            let mask = (!names.is_empty()).then(|| known_regions.mask(names)).transpose();
            mask.map_err(|e| value(format!("{option}: {e}")))
        };
        let of_mask = |mask: Option<&Mask>| mask.map(|m| m.values.clone());
        let data_mask = combined(of_mask(mask), region_mask(&regions, "regions")?, |a, b| a * b);
        let share = combined(of_mask(free_mask), region_mask(&free_regions, "free_regions")?, f64::max);
        let input_of = RegistrationInput {
            neutral: neutral.map(|n| &n.polygons().positions[..]),
            shapes: &basis,
            scan_normals: scan.file.normals.as_deref(),
            landmarks: &pairs,
            mask: data_mask.as_deref(),
            free_mask: share.as_deref(),
            regions: Some(&known_regions),
            warm_start: warm_start.map(|w| &w.state),
            ..RegistrationInput::new(mesh, &target)
        };
        let mut result =
            register_with(&input_of, &model, &TERMS, &schedule.schedule, observer).map_err(registration_error)?;
        let rounds = Some(subdivide).filter(|n| *n > 0 && result.stop == RegistrationStop::Finished);
        let detail = rounds.map(|n| add_detail(&input_of, &result, n, observer)).transpose();
        let detail = detail.map_err(registration_error)?;
        let (quality, reliability) = assess(&input_of, &result).map_err(computation)?;
        // what is kept of the result keeps no scan
        let surface = std::mem::take(&mut result.scan);
        let colors = scan.file.colors.as_deref();
        let colors = colors.map(|colors| scan_colors(&input_of, &surface, colors, &result.positions)).transpose();
        let colors = colors.map_err(computation)?;
        let roles: [(&str, &[Input]); 10] = [
            ("template", &template.files),
            ("target", &scan.files),
            ("neutral", neutral.map_or(&[], |n| &n.files)),
            ("landmarks", landmarks.map_or(&[], |l| &l.files)),
            ("template landmarks", template_landmarks.map_or(&[], |l| &l.files)),
            ("warm start", warm_start.map_or(&[], |w| &w.files)),
            ("mask", mask.map_or(&[], |m| &m.files)),
            ("free mask", free_mask.map_or(&[], |m| &m.files)),
            ("schedule", &schedule.files),
            ("rig", rig.map_or(&[], |r| &r.files)),
        ];
        let files = roles.into_iter().flat_map(|(role, files)| {
            files.iter().map(move |file| InputFile::from(Input { role: role.to_owned(), ..file.clone() }))
        });
        let report = Report::new(model.name(), files.collect(), &result, quality, reliability.clone());
        let colors_observed = colors.as_ref().map(VertexColors::observed_count);
        let (mut finer, mut of_finer) = (None, None);
        if let Some(detail) = detail {
            let input = detail.input(&target, scan.file.normals.as_deref());
            let positions = &detail.result.positions;
            let colors = scan.file.colors.as_deref();
            let colors = colors.map(|colors| scan_colors(&input, &surface, colors, positions)).transpose();
            let colors = colors.map_err(computation)?.map(|c| c.colors);
            of_finer = Some(DetailReport::measure(&input, &detail).map_err(computation)?);
            finer = Some(MeshFile { mesh: detail.template.with_positions(positions.clone()), normals: None, colors });
        }
        let report = Report { regions, free_regions, units, colors_observed, detail: of_finer, ..report };
        let (report, state) = (json(&report)?, json(&result.end)?);
        Ok(Registration {
            result,
            colors,
            report,
            state,
            reliability,
            uses_shapes: model.uses_shapes(),
            equations: None,
            finer,
            materials: template.materials.clone(),
            notes,
        })
    };

    let stop = AtomicBool::new(false);
    let (to_here, events) = channel();
    let (done, from_here) = channel();
    let mut observer = Observer {
        stop: &stop,
        events: Some((to_here, from_here)),
        steps: callback.is_some(),
        positions: on_positions.is_some(),
        equations: equations.then_some(None),
    };
    let (outcome, attended) = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().spawn_scoped(scope, move || {
            on_threads(threads, move || {
                let result = work(&mut observer);
                let equations = observer.equations.take().flatten();
                drop(observer); // closes the channel
                result.map(|result| Registration { equations, ..result })
            })
        });
        let thread = thread.map_err(no_thread)?;
        let attended = attend(py, (events, done), &stop, callback, on_positions);
        let outcome = py.detach(|| thread.join());
        PyResult::Ok((outcome, attended))
    })?;
    attended?;
    outcome
        .unwrap_or_else(|_| Err(computation(std::io::Error::other("a thread of nonrigid has ended; please report it"))))
}

/// The triangles of a scan.
fn mesh_of_scan(scan: &Mesh) -> nonrigid::mesh::TriangleMesh {
    scan.polygons().triangulate()
}

fn json(what: &impl serde::Serialize) -> PyResult<String> {
    Ok(text::json(serde_json::to_string_pretty(what).map_err(value)?))
}

/// Picture of template, scan, result, and result over scan.
#[pyfunction]
fn picture(
    py: Python<'_>,
    path: PathBuf,
    title: &str,
    template: &Mesh,
    scan: &Mesh,
    result: &Mesh,
    facing: (usize, usize, bool),
    reads: Vec<PathBuf>,
) -> PyResult<()> {
    compute(py, None, || {
        check_plan(&reads, std::slice::from_ref(&path))?;
        let scan = mesh_of_scan(scan);
        let (repeated, turned, flipped) = facing;
        let (faced, _) = ScanFacing { repeated, turned, flipped, ..ScanFacing::default() }.apply(&scan, None);
        let (template, result): (&PolygonMesh, &PolygonMesh) = (template.polygons(), result.polygons());
        save_png(&registration_sheet(title, template, &faced, result, 480), &path).map_err(input)
    })
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Registration>()?;
    module.add_class::<Step>()?;
    module.add_class::<WarmStart>()?;
    module.add_function(wrap_pyfunction!(register, module)?)?;
    module.add_function(wrap_pyfunction!(picture, module)?)
}
