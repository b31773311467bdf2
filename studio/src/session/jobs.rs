//! What takes long: registrations, each on a thread of its own.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nonrigid::mesh::Vec3;
use nonrigid::registration::{ModelKind, RegistrationObserver, RegistrationResult, StepRecord};

use super::{Hub, Inbox, Outgoing, ToPage, Window, panicked};
use crate::case::Edit;
use crate::error::{Problem, problem};
use crate::protocol::{CompareRow, ServerMessage};
use crate::store::{positions_frame, values_frame};
use crate::vault::OpenCase;
use crate::wrap::WrapJob;

impl Window {
    /// Runs something long on a thread of its own; one at a time in a window.
    fn start(
        &mut self,
        what: &str,
        work: impl FnOnce(&Job) -> Result<(), Problem> + Send + 'static,
    ) -> Result<(), Problem> {
        if self.job.is_some() {
            return Err(problem("something is running already: wait for it, or cancel it"));
        }
        let cancel = Arc::new(AtomicBool::new(false));
        self.job = Some(cancel.clone());
        let job = Job { hub: self.hub.clone(), page: self.page.clone(), cancel };
        let me = self.me.clone();
        self.say(ServerMessage::Progress { what: what.to_owned(), share: None });
        std::thread::spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(|| work(&job)));
            if let Err(Problem(text)) = outcome.unwrap_or_else(|_| Err(panicked())) {
                job.say(ServerMessage::Error { text });
            }
            let _ = me.send(Inbox::Ended);
        });
        Ok(())
    }

    pub(super) fn run_wrap(&mut self, warm: bool) -> Result<(), Problem> {
        let OpenCase { id, case, .. } = self.case()?.clone();
        self.start("wrapping", move |job| {
            let hub = &job.hub;
            let wrap = WrapJob::new(&hub.vault, &hub.store, &case, &case.model(), &case.wrap.pairs, warm)?;
            let result = job.register("wrapping", &wrap, Some("wrapped"))?;
            job.say(ServerMessage::Progress { what: "measuring".to_owned(), share: None });
            let outcome = wrap.measure(result)?;
            let wrapped = wrap.keep(&hub.vault, &outcome)?;
            // Of a case that was deleted meanwhile nothing stays.
            let made = [&wrapped.mesh, &wrapped.state, &wrapped.report].map(|at| hub.vault.leave(id, at));
            made.into_iter().collect::<Result<(), _>>()?;
            hub.vault.change(id, &format!("wrapped by {}", wrapped.model), |case| {
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
        self.start("looking for landmarks", move |job| {
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
            hub.vault.edit(id, &Edit::SetPairs { pairs })?;
            hub.tell(Some(id));
            job.say(ServerMessage::Note {
                text: format!("{count} landmarks placed, {doubtful} of them doubtful: look at those"),
            });
            Ok(())
        })
    }

    pub(super) fn compare(&mut self, models: Vec<String>) -> Result<(), Problem> {
        let OpenCase { mut case, .. } = self.case()?.clone();
        case.wrap.schedule = None;
        if models.is_empty() || models.len() > ModelKind::ALL.len() {
            return Err(problem("choose the models to compare"));
        }
        self.start("comparing", move |job| {
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
                    return Err(problem("cancelled: the models that were done are shown"));
                }
                let row = match outcome {
                    Ok(outcome) => {
                        job.show(positions_frame(&slot, &outcome.result.positions));
                        job.show(values_frame(&slot, "distance to the scan / mm", &outcome.distances, 0.0, 3.0));
                        CompareRow {
                            model: model.clone(),
                            summary: Some(outcome.summary),
                            seconds,
                            error: String::new(),
                        }
                    }
                    Err(Problem(error)) => CompareRow { model: model.clone(), summary: None, seconds, error },
                };
                job.say(ServerMessage::Compared { row });
            }
            Ok(())
        })
    }
}

/// Something long that runs for a window.
struct Job {
    hub: Arc<Hub>,
    page: ToPage,
    cancel: Arc<AtomicBool>,
}

impl Job {
    fn say(&self, message: ServerMessage) {
        let _ = self.page.blocking_send(Outgoing::Message(Box::new(message)));
    }

    fn show(&self, frame: Vec<u8>) {
        let _ = self.page.blocking_send(Outgoing::Frame(frame));
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
        self.job.say(ServerMessage::Step {
            level: record.level as u32 + 1,
            step: self.step,
            levels: self.levels as u32,
            energy: record.energy,
            energies: record.energies.clone(),
            inliers: record.inliers,
            motion: record.motion,
        });
        if self.job.cancel.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn cancel(&self) -> Option<&AtomicBool> {
        Some(&self.job.cancel)
    }

    fn wants_positions(&self) -> bool {
        self.slot.is_some()
    }

    fn on_positions(&mut self, _record: &StepRecord, positions: &[Vec3]) {
        // twenty a second are live; the rest would only wait in line
        if let Some(slot) = self.slot.filter(|_| self.shown.elapsed() > Duration::from_millis(50)) {
            self.shown = Instant::now();
            let _ = self.job.page.try_send(Outgoing::Frame(positions_frame(slot, positions)));
        }
    }
}
