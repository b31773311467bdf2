//! One window of the page: a thread that answers its messages in order, and threads for what takes long. Nothing here runs on the
//! server's own threads, and what panics ends with an error in the window, not with the server.

mod files;
mod jobs;
mod plans;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};

use nonrigid::io;
use nonrigid::mesh::Vec3;
use nonrigid::morph::MorphModel;
use nonrigid::registration::ModelKind;

use self::jobs::{FromJob, Inputs, Running};
use self::plans::{Base, Dragged};
use crate::case::{Case, Edit, FileRef, Pair, Source};
use crate::error::{Problem, problem};
use crate::protocol::{ClientMessage, CompareRow, FromPage, LandmarkSide, ServerMessage, Upload};
use crate::store::{self, Store, clear_frame, mesh_frame, positions_frame, scan_frame, values_frame};
use crate::vault::{Incoming, OpenCase, Vault, check_name, stale};
use crate::{plan, wrap};

/// What all windows share.
pub struct Hub {
    /// Where everything is kept.
    pub vault: Vault,
    /// What was read of it.
    pub store: Store,
    /// The case that a new window opens.
    pub first_case: Mutex<Option<u32>>,
    windows: Mutex<Vec<(u64, Sender<Inbox>)>>,
    counter: AtomicU64,
    uploads: Mutex<Vec<(String, Incoming)>>,
}

/// What a window's thread is told.
pub enum Inbox {
    /// By the page.
    Page(Box<FromPage>),
    /// A case has changed: this one, or (none) perhaps any.
    Changed(Option<u32>),
    /// By the job of this window.
    Job(FromJob),
    /// The window is closed.
    Closed,
}

/// To the page.
#[derive(Debug, Clone)]
pub enum Outgoing {
    /// A message.
    Message(Box<ServerMessage>),
    /// Numbers.
    Frame(Vec<u8>),
}

/// The way to the page. A page that reads too slowly holds its own window up, nobody else.
pub type ToPage = tokio::sync::mpsc::Sender<Outgoing>;

/// Most files that wait to join a case; beyond, the one that has waited longest goes.
pub const MOST_UPLOADS: usize = 4000;

impl Hub {
    /// A hub of this vault.
    #[must_use]
    pub fn new(vault: Vault) -> Self {
        Self {
            vault,
            store: Store::default(),
            first_case: Mutex::default(),
            windows: Mutex::default(),
            counter: AtomicU64::new(1),
            uploads: Mutex::default(),
        }
    }

    /// Tells every window.
    pub fn tell(&self, case: Option<u32>) {
        let mut windows = lock(&self.windows);
        windows.retain(|(_, window)| window.send(Inbox::Changed(case)).is_ok());
    }

    /// Keeps a file until it joins a case: what it is called here.
    pub fn keep_upload(&self, incoming: Incoming) -> String {
        let name = incoming.folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut uploads = lock(&self.uploads);
        if uploads.len() >= MOST_UPLOADS {
            uploads.remove(0);
        }
        uploads.push((name.clone(), incoming));
        name
    }

    /// The files of these uploads in one folder, under their own names. They go on waiting until [`forget`](Self::forget).
    fn gathered(&self, files: &[Upload]) -> Result<Incoming, Problem> {
        let uploads = lock(&self.uploads);
        let folder = self.vault.incoming()?;
        for (k, file) in files.iter().enumerate() {
            check_name(&file.name)?;
            if files[..k].iter().any(|before| before.name == file.name) {
                return Err(problem(format!(
                    "two files are called {}: add those of one folder alone, without its subfolders",
                    file.name
                )));
            }
            let found = uploads.iter().find(|(id, _)| *id == file.id);
            let (_, upload) =
                found.ok_or_else(|| problem(format!("{}: it did not arrive; add it again", file.name)))?;
            let from = upload.folder.join(&file.name);
            std::fs::hard_link(&from, folder.folder.join(&file.name))
                .or_else(|_| std::fs::copy(&from, folder.folder.join(&file.name)).map(drop))?;
        }
        Ok(folder)
    }

    /// Removes uploads that wait.
    fn forget(&self, files: &[Upload]) {
        lock(&self.uploads).retain(|(id, _)| !files.iter().any(|f| f.id == *id));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens a window, on the client that its page has shown before: where its messages go.
pub fn open(hub: &Arc<Hub>, page: ToPage, client: Option<u32>) -> Sender<Inbox> {
    let (sender, inbox) = std::sync::mpsc::channel();
    let number = hub.counter.fetch_add(1, Ordering::Relaxed);
    lock(&hub.windows).push((number, sender.clone()));
    let window = Window {
        hub: hub.clone(),
        page,
        me: sender.clone(),
        open: None,
        since: 0,
        shown: Shown::default(),
        base: None,
        dragged: None,
        job: None,
    };
    let hub = hub.clone();
    std::thread::spawn(move || {
        window.run(client, &inbox);
        lock(&hub.windows).retain(|(n, _)| *n != number);
    });
    sender
}

/// What the page has already been sent.
#[derive(Default, PartialEq)]
struct Shown {
    template: Option<Source>,
    scan: Option<Source>,
    face: Option<Source>,
    /// The result, or that there is none; none where a job has shown something else since.
    wrapped: Option<Option<FileRef>>,
    mask: Option<FileRef>,
    plan: Option<(Option<Source>, Option<Source>, String)>,
}

/// Whether a message is one of many in a row, of which only the last one counts.
fn live(message: &Inbox) -> bool {
    matches!(message, Inbox::Page(m) if matches!(m.message, ClientMessage::Preview { .. } | ClientMessage::Blend { .. }))
}

struct Window {
    hub: Arc<Hub>,
    page: ToPage,
    me: Sender<Inbox>,
    open: Option<OpenCase>,
    /// The revision since which this window alone has changed the case: from there on, what the page shows is its own.
    since: u32,
    shown: Shown,
    base: Option<Base>,
    dragged: Option<Dragged>,
    job: Option<Running>,
}

impl Window {
    fn run(mut self, client: Option<u32>, inbox: &Receiver<Inbox>) {
        self.guarded(|window| window.welcome(client));
        let mut waiting = None;
        while let Some(message) = waiting.take().or_else(|| inbox.recv().ok()) {
            let mut message = message;
            // of previews in a row only the last one counts
            while live(&message) {
                match inbox.try_recv() {
                    Ok(next) if live(&next) => message = next,
                    Ok(next) => {
                        waiting = Some(next);
                        break;
                    }
                    Err(_) => break,
                }
            }
            match message {
                Inbox::Page(message) => self.guarded(|window| window.hear(*message)),
                Inbox::Changed(id) => self.guarded(|window| window.refresh_if(id)),
                Inbox::Job(message) => self.guarded(|window| window.pass_on(message)),
                Inbox::Closed => break,
            }
        }
        if let Some(job) = &self.job {
            job.cancel();
        }
    }

    /// Does something; problems and panics are told to the page.
    fn guarded(&mut self, work: impl FnOnce(&mut Self) -> Result<(), Problem>) {
        let outcome = catch_unwind(AssertUnwindSafe(|| work(self)));
        if let Err(Problem(text)) = outcome.unwrap_or_else(|_| Err(panicked())) {
            self.say(ServerMessage::Error { text });
        }
    }

    fn say(&self, mut message: ServerMessage) {
        // where the server keeps its files is nobody's business
        match &mut message {
            ServerMessage::Error { text }
            | ServerMessage::Note { text }
            | ServerMessage::Plan { error: Some(text), .. }
            | ServerMessage::Compared { row: CompareRow { error: text, .. } } => {
                *text = self.hub.vault.without_folders(text);
            }
            _ => {}
        }
        // a page that is gone is told nothing
        let _ = self.page.blocking_send(Outgoing::Message(Box::new(message)));
    }

    fn show(&self, frame: Vec<u8>) {
        let _ = self.page.blocking_send(Outgoing::Frame(frame));
    }

    /// Shows what a slot holds by now; what cannot be read leaves nothing there, above all not what was shown before.
    fn show_in(&self, slot: &str, frame: Option<Result<Vec<u8>, Problem>>) -> Result<(), Problem> {
        let (frame, outcome) = match frame.transpose() {
            Ok(frame) => (frame, Ok(())),
            Err(problem) => (None, Err(problem)),
        };
        self.show(frame.unwrap_or_else(|| clear_frame(slot)));
        outcome
    }

    /// Does something that may take a while, and says so. What a job says of itself goes before.
    fn busy(&mut self, what: &str, work: impl FnOnce(&mut Self) -> Result<(), Problem>) -> Result<(), Problem> {
        if self.job.is_some() {
            return work(self);
        }
        self.say(ServerMessage::Progress { what: what.to_owned(), share: None });
        let outcome = work(self);
        self.say(ServerMessage::Idle);
        outcome
    }

    fn welcome(&mut self, client: Option<u32>) -> Result<(), Problem> {
        self.say(ServerMessage::Welcome {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            models: ModelKind::ALL.iter().map(ToString::to_string).collect(),
            morph_models: MorphModel::all().iter().map(|m| m.name().to_owned()).collect(),
            presets: plan::presets(),
            vault: self.hub.vault.path_of_folder(),
        });
        let cases = self.hub.vault.cases("")?;
        let first = *lock(&self.hub.first_case);
        let there = |id: &u32| cases.iter().any(|c| c.id == *id);
        let readable = || cases.iter().find(|c| c.trouble.is_none()).map(|c| c.id);
        let id = client.map_or_else(|| first.filter(there).or_else(readable), |id| Some(id).filter(there));
        self.say(ServerMessage::Cases { cases });
        let Some(id) = id else {
            self.say(ServerMessage::NoCase);
            // never another one in the place of the one that the page has shown
            return client
                .map_or(Ok(()), |_| Err(problem("the client of this window is not there any more: choose one")));
        };
        let outcome = self.open_case(id);
        if self.open.is_none() {
            self.say(ServerMessage::NoCase);
        }
        outcome
    }

    fn case(&self) -> Result<&OpenCase, Problem> {
        self.open.as_ref().ok_or_else(|| problem("no case is open: choose one, or make a new one"))
    }

    fn open_case(&mut self, id: u32) -> Result<(), Problem> {
        let open = self.hub.vault.case(id)?;
        *lock(&self.hub.first_case) = Some(id);
        self.shown = Shown::default();
        for slot in ["template", "scan", "face", "wrapped", "plan"] {
            self.show(clear_frame(slot));
        }
        self.changed(open)
    }

    fn list(&self, query: &str) -> Result<(), Problem> {
        self.say(ServerMessage::Cases { cases: self.hub.vault.cases(query)? });
        Ok(())
    }

    fn refresh_if(&mut self, id: Option<u32>) -> Result<(), Problem> {
        let Some(open) = &self.open else { return Ok(()) };
        if id.is_some_and(|id| id != open.id) {
            return Ok(());
        }
        match self.hub.vault.case(open.id) {
            Ok(new) if new == *open => Ok(()),
            Ok(new) => self.changed(new),
            Err(Problem(why)) => {
                let name = open.case.name.clone();
                self.open = None;
                self.say(ServerMessage::NoCase);
                self.list("")?;
                Err(problem(format!("{name}: {why}")))
            }
        }
    }

    /// A change of the page's, on the plan and revision that it shows. What is refused leaves the case shown as it is.
    fn edit(&mut self, plan: u32, revision: u32, edit: &Edit) -> Result<(), Problem> {
        let open = self.case()?;
        let (id, newest) = (open.id, open.revision);
        let made = if (self.since..=newest).contains(&revision) && open.case.plan == plan {
            self.check_sides(edit).and_then(|()| self.hub.vault.edit_on(id, newest, edit))
        } else {
            Err(stale())
        };
        if made.is_err() {
            self.guarded(|window| window.changed(window.hub.vault.case(id)?));
        }
        let (made, since) = (made?, self.since);
        let outcome = self.made(made);
        // the page may have sent more before it has seen this one
        self.since = since;
        outcome
    }

    /// A change that this window has made.
    fn made(&mut self, open: OpenCase) -> Result<(), Problem> {
        let id = open.id;
        let outcome = self.changed(open);
        self.hub.tell(Some(id));
        outcome
    }

    fn change(&mut self, label: &str, change: impl FnOnce(&mut Case) -> Result<(), Problem>) -> Result<(), Problem> {
        let open = self.hub.vault.change(self.case()?.id, label, change)?;
        self.made(open)
    }

    /// Shows what has changed of the open case.
    fn changed(&mut self, open: OpenCase) -> Result<(), Problem> {
        let OpenCase { id, revision, case, undo, redo } = open.clone();
        if let Some(job) = self.job.as_ref().filter(|job| job.for_page_alone && job.inputs != Inputs::of(&open)) {
            job.cancel();
        }
        self.open = Some(open);
        self.since = revision;
        let hub = self.hub.clone();
        let template = case.template.as_ref().map(|source| hub.store.mesh(&hub.vault, source));
        let regions = match &template {
            Some(Ok(mesh)) => {
                hub.store.regions(&hub.vault, &case, mesh).map(|r| r.names().map(str::to_owned).collect())
            }
            _ => Ok(Vec::new()),
        };
        let command = case.wrapped.as_ref().map(|w| wrap::shell_line(&hub.vault, &w.command));
        let unreadable = regions.as_ref().err().cloned();
        let message = ServerMessage::Case {
            id,
            revision,
            case: Box::new(case.clone()),
            undo,
            redo,
            regions: regions.unwrap_or_default(),
            command,
            current: case.wrapped.as_ref().is_some_and(|wrapped| wrapped.is_of(&case)),
        };
        self.say(message);
        // what cannot be read is said in the end: the rest is shown
        let mut outcomes = vec![unreadable.map_or(Ok(()), Err)];
        if self.shown.template != case.template {
            self.shown.template.clone_from(&case.template);
            (self.shown.wrapped, self.shown.mask) = (None, None);
            let frame = template.map(|mesh| Ok(mesh_frame("template", &*mesh?)));
            outcomes.push(self.show_in("template", frame));
        }
        if self.shown.mask != case.wrap.mask {
            self.shown.mask.clone_from(&case.wrap.mask);
            let read = |at| Ok(io::read_npy_vector(&hub.vault.path(at)?, None)?);
            // without a mask everything counts
            let weights = case.wrap.mask.as_ref().map_or_else(|| Ok(Vec::new()), read);
            self.show(values_frame("template", "mask", weights.as_deref().unwrap_or_default(), 0.0, 1.0));
            outcomes.push(weights.map(drop));
        }
        let scan = case.scan_in_work().cloned();
        if self.shown.scan != scan {
            self.shown.scan.clone_from(&scan);
            self.shown.wrapped = None;
            let loaded = scan.map(|source| hub.store.scan(&hub.vault, &source));
            outcomes.push(self.show_in("scan", loaded.map(|loaded| Ok(scan_frame("scan", &loaded?.scan)))));
        }
        outcomes.push(self.show_result(&case));
        let face = store::face_source(&case).ok();
        if self.shown.face != face {
            self.shown.face.clone_from(&face);
            (self.base, self.dragged) = (None, None);
            let mesh = face.as_ref().map(|source| hub.store.mesh(&hub.vault, source));
            outcomes.push(self.show_in("face", mesh.map(|mesh| Ok(mesh_frame("face", &*mesh?)))));
        }
        let recipe = case.plan_in_work()?.recipe.clone();
        let plan = Some((face, case.rig.clone(), recipe.clone()));
        if self.shown.plan != plan {
            self.shown.plan = plan;
            outcomes.push(self.replay(&case, &recipe, false));
        }
        outcomes.into_iter().collect()
    }

    /// Shows the result of a case, unless the page shows it.
    fn show_result(&mut self, case: &Case) -> Result<(), Problem> {
        let hub = self.hub.clone();
        let wrapped = Some(case.wrapped.as_ref().map(|w| w.mesh.clone()));
        if self.shown.wrapped == wrapped {
            return Ok(());
        }
        self.shown.wrapped = wrapped;
        let Some(result) = &case.wrapped else {
            self.show(clear_frame("wrapped"));
            return Ok(());
        };
        let mesh = hub.store.face(&hub.vault, case);
        let positions = mesh.as_ref().map(|mesh| positions_frame("wrapped", &mesh.positions));
        self.show_in("wrapped", Some(positions.map_err(Clone::clone)))?;
        let mesh = mesh?;
        // only on the scan that it was wrapped onto
        if let Some(scan) = case.scan_in_work().filter(|_| result.is_of(case)) {
            let scan = hub.store.scan(&hub.vault, scan)?;
            if let Some(surface) = &scan.surface {
                let distance = |p: &Vec3| surface.query(p).map_or(f64::NAN, |c| c.squared_distance.sqrt());
                let distances: Vec<f64> = mesh.positions.iter().map(distance).collect();
                self.show(values_frame("wrapped", "distance to the scan / mm", &distances, 0.0, 3.0));
            }
        }
        Ok(())
    }

    /// A message of the page's, if it is about the case that is open by now.
    fn hear(&mut self, FromPage { case, message }: FromPage) -> Result<(), Problem> {
        let open = self.open.as_ref().map(|open| open.id);
        let another = case.zip(open).is_some_and(|(shown, open)| shown != open);
        if !another || !message.is_of_the_case() {
            return self.answer(message);
        }
        if let ClientMessage::Add { files, .. } = &message {
            self.hub.forget(files);
        }
        if message.only_looks() {
            return Ok(());
        }
        Err(problem(
            "this was for a client who is not open any more, so nothing was done: open that client, and do it again",
        ))
    }

    fn answer(&mut self, message: ClientMessage) -> Result<(), Problem> {
        let hub = self.hub.clone();
        match message {
            ClientMessage::ListCases { query } => self.list(&query),
            ClientMessage::NewCase { name } => {
                let mut case = Case::default();
                case.apply(&Edit::Describe { name, date: String::new(), notes: String::new() })?;
                let id = hub.vault.add_case(&case)?;
                self.list("")?;
                self.open_case(id)
            }
            ClientMessage::OpenCase { id } => self.busy("opening", |window| window.open_case(id)),
            ClientMessage::DeleteCase { id } => {
                let name = hub.vault.cases("")?.into_iter().find(|case| case.id == id).map(|case| case.name);
                hub.vault.delete_case(id)?;
                self.say(ServerMessage::Note { text: format!("{} is deleted.", name.unwrap_or_default()) });
                if self.open.as_ref().is_some_and(|open| open.id == id) {
                    self.open = None;
                    self.say(ServerMessage::NoCase);
                }
                hub.tell(Some(id));
                self.list("")
            }
            ClientMessage::Edit { plan, revision, edit } => self.edit(plan, revision, &edit),
            ClientMessage::Preview { edit } => {
                let mut case = self.case()?.case.clone();
                edit.as_ref().map_or(Ok(()), |edit| case.apply(edit))?;
                let recipe = case.plan_in_work()?.recipe.clone();
                self.shown.plan = None;
                self.replay(&case, &recipe, edit.is_some())?;
                // what is being drawn is shown in colour
                let done = self.base.as_ref().and_then(|b| b.done.last());
                if let (Some(Edit::AddStep { .. }), Some(done)) = (&edit, done) {
                    self.show(values_frame("plan", "mask", &done.shown, 0.0, 1.0));
                }
                Ok(())
            }
            ClientMessage::Undo | ClientMessage::Redo => {
                let open = hub.vault.step(self.case()?.id, message == ClientMessage::Redo)?;
                self.made(open)
            }
            ClientMessage::Add { role, files, unit } => self.busy("reading", |window| window.add(role, &files, unit)),
            ClientMessage::Place { name, side, point } => self.place(name, side, point),
            ClientMessage::Suggest => self.suggest(),
            ClientMessage::Run { warm } => self.run_wrap(warm),
            ClientMessage::Compare { models } => self.compare(models),
            ClientMessage::Cancel => {
                match &self.job {
                    Some(job) => job.cancel(),
                    None => self.say(ServerMessage::Idle),
                }
                Ok(())
            }
            ClientMessage::PaintMask { weights } => self.paint(weights),
            ClientMessage::Analyse { plans } => self.busy("measuring", |window| window.analyse(&plans)),
            ClientMessage::Blend { from, to, share, difference } => self.blend(from, to, share, difference),
            ClientMessage::Export { what } => self.busy("writing", |window| window.export(&what)),
            ClientMessage::ListArticles { query } => {
                self.say(ServerMessage::Articles { articles: hub.vault.articles(&query)? });
                Ok(())
            }
            ClientMessage::SaveArticle { article } => {
                hub.vault.save_article(&article)?;
                self.say(ServerMessage::Articles { articles: hub.vault.articles("")? });
                Ok(())
            }
            ClientMessage::DeleteArticle { id } => {
                hub.vault.delete_article(id)?;
                self.say(ServerMessage::Articles { articles: hub.vault.articles("")? });
                Ok(())
            }
        }
    }

    fn place(&mut self, name: Option<String>, side: LandmarkSide, point: [f64; 3]) -> Result<(), Problem> {
        if !point.iter().all(|x| x.is_finite() && x.abs() < io::LARGEST_COORDINATE) {
            return Err(problem("this point is nowhere: click on the surface"));
        }
        let hub = self.hub.clone();
        let case = &self.case()?.case;
        let open = case.wrap.pairs.iter().find(|p| match side {
            LandmarkSide::Template => p.vertex.is_none(),
            LandmarkSide::Scan => p.target.is_none(),
        });
        let free = || (1..).map(|k| format!("point {k}")).find(|n| !case.wrap.pairs.iter().any(|p| p.name == *n));
        let name = name.or_else(|| open.map(|p| p.name.clone())).or_else(free).unwrap_or_default();
        let known = case.wrap.pairs.iter().find(|p| p.name == name).cloned();
        let mut pair = known.unwrap_or(Pair { name, vertex: None, target: None, doubt: None, by_hand: false });
        let point = Vec3::from(point);
        match side {
            LandmarkSide::Template => {
                let source = case.template.as_ref().ok_or_else(|| problem("there is no template to place it on"))?;
                pair.vertex = Some(nearest_vertex(&hub.store.mesh(&hub.vault, source)?.positions, point));
            }
            LandmarkSide::Scan => {
                let source = case.scan_in_work().ok_or_else(|| problem("there is no scan to place it on"))?;
                let scan = hub.store.scan(&hub.vault, source)?;
                let positions = &scan.scan.mesh.positions;
                let closest = scan.surface.as_ref().and_then(|s| s.query(&point)).map(|c| c.point);
                let place = closest.unwrap_or_else(|| positions[nearest_vertex(positions, point) as usize]);
                pair.target = Some(place.into());
                (pair.doubt, pair.by_hand) = (None, true);
            }
        }
        let (plan, revision) = (case.plan, self.case()?.revision);
        self.edit(plan, revision, &Edit::SetPair { pair })
    }
}

fn panicked() -> Problem {
    problem("something went wrong inside the program; nothing is lost. Please report it with what you did last")
}

fn nearest_vertex(positions: &[Vec3], point: Vec3) -> u32 {
    let squared = |p: &Vec3| (p - point).norm_squared();
    let nearest = positions.iter().enumerate().min_by(|a, b| squared(a.1).total_cmp(&squared(b.1)));
    nearest.map_or(0, |(k, _)| k as u32)
}
