//! What takes long: registrations, each on a thread of its own. A job speaks to its window, which passes on to the page what belongs to
//! what the page shows by then; and a result is kept only while what it was made of is there.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use nonrigid::mesh::Vec3;
use nonrigid::registration::{ModelKind, RegistrationObserver, RegistrationResult, StepRecord};

use super::{Hub, Inbox, Outgoing, Window, panicked};
use crate::case::{Case, Source};
use crate::error::{Problem, problem};
use crate::protocol::{CompareRow, ServerMessage};
use crate::store::{positions_frame, values_frame};
use crate::vault::OpenCase;
use crate::wrap::WrapJob;

/// What a job works on: what it finds is true of these alone.
#[derive(Clone, PartialEq)]
pub(super) struct Inputs {
    case: u32,
    template: Option<Source>,
    rig: Option<Source>,
    scan: Option<Source>,
}

impl Inputs {
    pub(super) fn of(open: &OpenCase) -> Self {
        let OpenCase { id, case, .. } = open;
        let Case { template, rig, .. } = case;
        Self { case: *id, template: template.clone(), rig: rig.clone(), scan: case.scan_in_work().cloned() }
    }

    /// Refuses a result when the case has another template or rig by now, or its scan no longer.
    fn check(&self, now: &Case) -> Result<(), Problem> {
        let there = self.scan.as_ref().is_none_or(|scan| now.scans.contains(scan));
        let checks = [("template", now.template == self.template), ("rig", now.rig == self.rig), ("scan", there)];
        checks.into_iter().try_for_each(|(what, stays)| if stays { Ok(()) } else { Err(changed(what)) })
    }
}

fn changed(what: &str) -> Problem {
    problem(format!("the {what} or its unit was changed while this ran, so its result was not kept: start it again"))
}

/// The job that runs.
pub(super) struct Running {
    pub(super) inputs: Inputs,
    /// Whether nothing is kept of it but what the page shows.
    pub(super) for_page_alone: bool,
    /// Whose it is.
    client: String,
    cancel: Arc<AtomicBool>,
}

impl Running {
    pub(super) fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}

/// What a job tells its window.
pub enum FromJob {
    /// Said whatever the page shows.
    Says(Box<ServerMessage>),
    /// Shown while the page shows what the job works on.
    Shows(Outgoing),
    /// Positions on the way to a result, shown likewise; one of them may be left out.
    Live(Vec<u8>),
    /// That it has ended.
    Ended,
}

impl Window {
    /// Passes on to the page what a job tells.
    pub(super) fn pass_on(&mut self, from: FromJob) -> Result<(), Problem> {
        let Some(Running { inputs, client, .. }) = &self.job else { return Ok(()) };
        let now = self.open.as_ref().map(Inputs::of);
        match from {
            FromJob::Says(mut message) => {
                if now.is_none_or(|now| now.case != inputs.case) {
                    match &mut *message {
                        ServerMessage::Progress { what: text, .. }
                        | ServerMessage::Error { text }
                        | ServerMessage::Note { text } => *text = format!("{client}: {text}"),
                        _ => {}
                    }
                }
                self.say(*message);
            }
            FromJob::Shows(_) | FromJob::Live(_) if now.as_ref() != Some(inputs) => {}
            FromJob::Shows(Outgoing::Message(message)) => self.say(*message),
            FromJob::Shows(Outgoing::Frame(frame)) => self.show(frame),
            FromJob::Live(frame) => {
                self.shown.wrapped = None;
                // the rest would only wait in line
                let _ = self.page.try_send(Outgoing::Frame(frame));
            }
            FromJob::Ended => {
                self.job = None;
                let result = self.open.clone().map_or(Ok(()), |open| self.show_result(&open.case));
                self.say(ServerMessage::Idle);
                result?;
            }
        }
        Ok(())
    }

    /// Runs something long on a thread of its own; one at a time in a window.
    fn start(
        &mut self,
        what: &str,
        for_page_alone: bool,
        work: impl FnOnce(&Job) -> Result<(), Problem> + Send + 'static,
    ) -> Result<(), Problem> {
        if self.job.is_some() {
            return Err(problem("something is running already: wait for it, or cancel it"));
        }
        let open = self.case()?;
        let (inputs, client, cancel) = (Inputs::of(open), open.case.name.clone(), Arc::new(AtomicBool::new(false)));
        let job =
            Job { hub: self.hub.clone(), window: self.me.clone(), inputs: inputs.clone(), cancel: cancel.clone() };
        self.job = Some(Running { inputs, for_page_alone, client, cancel });
        self.say(ServerMessage::Progress { what: what.to_owned(), share: None });
        std::thread::spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(|| work(&job)));
            if let Err(Problem(text)) = outcome.unwrap_or_else(|_| Err(panicked())) {
                job.say(ServerMessage::Error { text });
            }
            job.tell(FromJob::Ended);
        });
        Ok(())
    }

    pub(super) fn run_wrap(&mut self, warm: bool) -> Result<(), Problem> {
        let OpenCase { id, case, .. } = self.case()?.clone();
        self.start("wrapping", false, move |job| {
            let hub = &job.hub;
            let wrap = WrapJob::new(&hub.vault, &hub.store, &case, &case.model(), &case.wrap.pairs, warm)?;
            // said once for a result, not at each correction of it
            if let Some(text) = wrap.idle.clone().filter(|_| !warm) {
                job.say(ServerMessage::Note { text });
            }
            let result = job.register("wrapping", &wrap, Some("wrapped"))?;
            job.say(ServerMessage::Progress { what: "measuring".to_owned(), share: None });
            let outcome = wrap.measure(result)?;
            let wrapped = wrap.keep(&hub.vault, &outcome)?;
            // Of a case that was deleted meanwhile nothing stays.
            let made = [&wrapped.mesh, &wrapped.state, &wrapped.report].map(|at| hub.vault.leave(id, at));
            made.into_iter().collect::<Result<(), _>>()?;
            hub.vault.change(id, &format!("wrapped by {}", wrapped.model), |case| {
                job.inputs.check(case)?;
                case.wrapped = Some(wrapped);
                Ok(())
            })?;
            hub.tell(Some(id));
            Ok(())
        })
    }

    pub(super) fn suggest(&mut self) -> Result<(), Problem> {
        let OpenCase { id, mut case, .. } = self.case()?.clone();
        case.wrap.schedule = None;
        self.start("looking for landmarks", false, move |job| {
            let hub = &job.hub;
            let rig =
                case.rig.as_ref().ok_or_else(|| problem("landmarks are suggested from a rig that has 68: add one"))?;
            let landmarks = hub.store.rig(&hub.vault, rig, 0)?.landmarks.clone();
            if landmarks.is_empty() {
                return Err(problem("this rig has no 68 landmarks (landmarks_multipie68.json): place pairs by hand"));
            }
            let wrap = WrapJob::new(&hub.vault, &hub.store, &case, "hybrid", &[], false)?;
            let result = job.register("looking for landmarks", &wrap, None)?;
            let outcome = wrap.measure(result)?;
            let pairs = wrap.suggestions(&outcome, &landmarks);
            let doubtful = pairs.iter().filter(|p| p.doubt.is_some()).count();
            let count = pairs.len();
            let mut kept = 0;
            hub.vault.change(id, &format!("{count} landmarks"), |case| {
                job.inputs.check(case)?;
                if case.scan_in_work() != job.inputs.scan.as_ref() {
                    return Err(changed("scan"));
                }
                kept = case.take_suggestions(pairs)?;
                Ok(())
            })?;
            hub.tell(Some(id));
            let mut text = format!("{count} landmarks found, {doubtful} of them doubtful: look at those");
            if kept > 0 {
                text += &format!("; {kept} that you had placed stay where they were");
            }
            job.say(ServerMessage::Note { text });
            Ok(())
        })
    }

    pub(super) fn compare(&mut self, models: Vec<String>) -> Result<(), Problem> {
        let OpenCase { mut case, .. } = self.case()?.clone();
        case.wrap.schedule = None;
        if models.is_empty() || models.len() > ModelKind::ALL.len() {
            return Err(problem("choose the models to compare"));
        }
        self.start("comparing", true, move |job| {
            let hub = &job.hub;
            for (k, model) in models.iter().enumerate() {
                let share = Some(k as f64 / models.len() as f64);
                job.say(ServerMessage::Progress { what: format!("comparing: {model}"), share });
                let clock = Instant::now();
                let slot = format!("compare/{model}");
                let wrap = WrapJob::new(&hub.vault, &hub.store, &case, model, &case.wrap.pairs, false)
                    .and_then(|wrap| Ok((job.register(&format!("comparing: {model}"), &wrap, Some(&slot))?, wrap)));
                let seconds = clock.elapsed().as_secs_f64();
                let outcome = wrap.and_then(|(result, wrap)| wrap.measure(result));
                if job.cancel.load(Ordering::Relaxed) {
                    return Err(problem("the comparison has ended before all models were done"));
                }
                let row = match outcome {
                    Ok(outcome) => {
                        let distances = values_frame(&slot, "distance to the scan / mm", &outcome.distances, 0.0, 3.0);
                        job.show(Outgoing::Frame(positions_frame(&slot, &outcome.result.positions)));
                        job.show(Outgoing::Frame(distances));
                        CompareRow {
                            model: model.clone(),
                            summary: Some(outcome.summary),
                            seconds,
                            error: String::new(),
                        }
                    }
                    Err(Problem(error)) => CompareRow { model: model.clone(), summary: None, seconds, error },
                };
                job.show(Outgoing::Message(Box::new(ServerMessage::Compared { row })));
            }
            Ok(())
        })
    }
}

/// Something long that runs for a window.
struct Job {
    hub: Arc<Hub>,
    window: Sender<Inbox>,
    inputs: Inputs,
    cancel: Arc<AtomicBool>,
}

impl Job {
    fn tell(&self, message: FromJob) {
        // a window that is closed hears nothing
        let _ = self.window.send(Inbox::Job(message));
    }

    fn say(&self, message: ServerMessage) {
        self.tell(FromJob::Says(Box::new(message)));
    }

    fn show(&self, what: Outgoing) {
        self.tell(FromJob::Shows(what));
    }

    fn register(&self, what: &str, wrap: &WrapJob, slot: Option<&str>) -> Result<RegistrationResult, Problem> {
        wrap.register(&mut Watch { job: self, what, slot, levels: 0, steps: 1, step: 0, shown: Instant::now() })
    }
}

/// Tells the page of every step of a registration, and ends it when asked.
struct Watch<'a> {
    job: &'a Job,
    what: &'a str,
    /// Where the positions are shown.
    slot: Option<&'a str>,
    levels: usize,
    /// The greatest number of steps.
    steps: usize,
    /// Those that are done.
    step: u32,
    /// When positions were shown last.
    shown: Instant,
}

impl RegistrationObserver for Watch<'_> {
    fn on_start(&mut self, levels: usize, steps: usize) {
        (self.levels, self.steps) = (levels, steps.max(1));
    }

    fn on_step(&mut self, record: &StepRecord) -> ControlFlow<()> {
        self.step += 1;
        let share = Some(f64::from(self.step) / self.steps as f64);
        self.job.say(ServerMessage::Progress { what: self.what.to_owned(), share });
        self.job.show(Outgoing::Message(Box::new(ServerMessage::Step {
            level: record.level as u32 + 1,
            step: self.step,
            levels: self.levels as u32,
            energy: record.energy,
            energies: record.energies.clone(),
            inliers: record.inliers,
            motion: record.motion,
        })));
        if self.job.cancel.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn cancel(&self) -> Option<&AtomicBool> {
        Some(&self.job.cancel)
    }

    fn wants_positions(&self) -> bool {
        self.slot.is_some()
    }

    fn on_positions(&mut self, _record: &StepRecord, positions: &[Vec3]) {
        // twenty a second are live
        if let Some(slot) = self.slot.filter(|_| self.shown.elapsed() > Duration::from_millis(50)) {
            self.shown = Instant::now();
            self.job.tell(FromJob::Live(positions_frame(slot, positions)));
        }
    }
}
