//! A client's case: what a person has made of one face. Everything in it is the user's; each change is an [`Edit`], applied to the
//! document and nothing else, so that undo, several windows and a crash are matters of the vault alone.

use nonrigid::io::LengthUnit;
use nonrigid::registration::{ModelFactory as _, ModelKind};
use nonrigid::rig::IDENTITY_MODES;
use serde::{Deserialize, Serialize};
use ts_rs::TS;

use crate::error::{Problem, problem};
use crate::plan;

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Micrometres.
    Um,
    /// Millimetres.
    Mm,
    /// Centimetres.
    Cm,
    /// Metres.
    M,
    /// Inches.
    In,
}

impl Unit {
    /// That of the library, which is written as on the command line.
    #[must_use]
    pub fn length(self) -> LengthUnit {
        match self {
            Self::Um => LengthUnit::Micrometre,
            Self::Mm => LengthUnit::Millimetre,
            Self::Cm => LengthUnit::Centimetre,
            Self::M => LengthUnit::Metre,
            Self::In => LengthUnit::Inch,
        }
    }
}

/// A file of the vault: one of the files that were added together, under their own names.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, TS)]
pub struct FileRef {
    /// SHA-256 of names and contents, hexadecimal.
    pub asset: String,
    /// The file; empty for all of them, as of a rig.
    pub file: String,
}

/// A mesh, scan or rig, and its unit.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, TS)]
pub struct Source {
    /// Where it is.
    pub at: FileRef,
    /// What the page calls it.
    pub name: String,
    /// Unit of its lengths.
    pub unit: Unit,
}

/// A pair of landmarks; either side may still be open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Pair {
    /// Its name.
    pub name: String,
    /// Vertex of the template.
    pub vertex: Option<u32>,
    /// Place on the scan, in the scan's file's unit brought to millimetres.
    pub target: Option<[f64; 3]>,
    /// Why the place is doubtful, where it was suggested.
    pub doubt: Option<String>,
    /// Whether the user has placed it on the scan: suggestions leave it there.
    #[serde(default)]
    pub by_hand: bool,
}

/// How the template is wrapped onto the scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct WrapSettings {
    /// Landmarks.
    pub pairs: Vec<Pair>,
    /// Deformation model, as the command line calls it; the usual one unless stated.
    pub model: Option<String>,
    /// Identity modes of the rig, at most.
    pub identity_modes: u32,
    /// Regions outside of which the scan is not looked at; none for everywhere.
    pub regions: Vec<String>,
    /// Regions that follow smoothness alone.
    pub free_regions: Vec<String>,
    /// Bounds of expression weights.
    pub expression_bounds: Option<[f64; 2]>,
    /// Bounds of identity weights.
    pub identity_bounds: Option<[f64; 2]>,
    /// Painted weights of what the scan says at each template vertex (`.npy`).
    #[serde(default)]
    pub mask: Option<FileRef>,
    /// A schedule (`.toml`) in place of the model's own.
    #[serde(default)]
    pub schedule: Option<FileRef>,
}

impl Default for WrapSettings {
    fn default() -> Self {
        Self {
            pairs: Vec::new(),
            model: None,
            identity_modes: IDENTITY_MODES as u32,
            regions: Vec::new(),
            free_regions: Vec::new(),
            expression_bounds: None,
            identity_bounds: None,
            mask: None,
            schedule: None,
        }
    }
}

/// Landmarks on a scan that is not in work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Places {
    /// The scan.
    pub scan: Source,
    /// Pairs that have a place on it.
    pub pairs: Vec<Pair>,
}

/// A template that was wrapped onto a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Wrapped {
    /// The mesh, millimetres.
    pub mesh: FileRef,
    /// Where the registration ended, for the next one.
    pub state: FileRef,
    /// The report, JSON.
    pub report: FileRef,
    /// Arguments of `nonrigid` that make the same bytes; files as `asset:HASH/NAME`.
    pub command: Vec<String>,
    /// The model.
    pub model: String,
    /// The scan's name.
    pub scan: String,
    /// Its numbers.
    pub summary: WrapSummary,
}

impl Wrapped {
    /// Whether it was made of a case's template and scan in work in their units, by their files and not by their names: many scans are
    /// called `scan.ply`.
    #[must_use]
    pub fn is_of(&self, case: &Case) -> bool {
        let made_of = |role: &str, source: &Source| {
            let file = format!("asset:{}/{}", source.at.asset, source.at.file);
            let unit = format!("{role}={}", source.unit.length());
            self.command.contains(&file) && self.command.iter().any(|word| word.split(',').any(|part| part == unit))
        };
        let sources = [("template", case.template.as_ref()), ("target", case.scan_in_work())];
        sources.into_iter().all(|(role, source)| source.is_some_and(|source| made_of(role, source)))
    }
}

/// What a registration reached, in numbers and words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct WrapSummary {
    /// Share of the vertices within 3 mm of the scan.
    pub within: f64,
    /// Median distance of those, mm.
    pub median: f64,
    /// 95th percentile of all distances, mm.
    pub p95: f64,
    /// Triangles turned over.
    pub flipped: u32,
    /// Probability that the error exceeds 3 mm on a face, the same share of the size on other subjects.
    pub probability: f64,
    /// Steps.
    pub steps: u32,
    /// Why the result is doubtful.
    pub doubts: Vec<String>,
}

/// A plan of an operation: a recipe, which `nonrigid morph` replays to the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Plan {
    /// Number within the case.
    pub id: u32,
    /// Its name.
    pub name: String,
    /// TOML.
    pub recipe: String,
}

/// A picture or other paper of the client.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Photo {
    /// The file.
    pub at: FileRef,
    /// What it shows.
    pub name: String,
}

/// All of a client's case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct Case {
    /// The client's name.
    pub name: String,
    /// Date of the case, as the user writes it.
    pub date: String,
    /// Notes.
    pub notes: String,
    /// The template.
    pub template: Option<Source>,
    /// Its rig.
    pub rig: Option<Source>,
    /// Scans of the client.
    pub scans: Vec<Source>,
    /// The one in work.
    pub scan: Option<u32>,
    /// Landmarks on the other ones.
    #[serde(default)]
    pub places: Vec<Places>,
    /// How it is wrapped.
    pub wrap: WrapSettings,
    /// The last result.
    pub wrapped: Option<Wrapped>,
    /// Plans.
    pub plans: Vec<Plan>,
    /// The one in work.
    pub plan: u32,
    /// Photos.
    pub photos: Vec<Photo>,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            name: "Unnamed".to_owned(),
            date: String::new(),
            notes: String::new(),
            template: None,
            rig: None,
            scans: Vec::new(),
            scan: None,
            places: Vec::new(),
            wrap: WrapSettings::default(),
            wrapped: None,
            plans: vec![Plan { id: 1, name: "Plan A".to_owned(), recipe: plan::empty("Plan A") }],
            plan: 1,
            photos: Vec::new(),
        }
    }
}

/// Which side of the face a ready operation changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Both, mirrored where the operation is.
    Both,
    /// The subject's left alone.
    Left,
    /// The subject's right alone.
    Right,
}

/// Which of a case's files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Which {
    /// The template.
    Template,
    /// The rig.
    Rig,
    /// The scan in work.
    Scan,
}

/// A change of a case. Those of plans change the plan in work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case", tag = "edit")]
pub enum Edit {
    /// The client.
    Describe {
        /// Name.
        name: String,
        /// Date.
        date: String,
        /// Notes.
        notes: String,
    },
    /// The unit of a file.
    SetUnit {
        /// Which.
        which: Which,
        /// Its unit.
        unit: Unit,
    },
    /// Another scan comes to work.
    UseScan {
        /// Its number in the list.
        index: u32,
    },
    /// A scan leaves the case.
    RemoveScan {
        /// Its number in the list.
        index: u32,
    },
    /// A photo leaves the case.
    RemovePhoto {
        /// Its number in the list.
        index: u32,
    },
    /// A pair is added, or the one of this name replaced.
    SetPair {
        /// The pair.
        pair: Pair,
    },
    /// A pair gets another name.
    RenamePair {
        /// Its name.
        name: String,
        /// Its new one.
        to: String,
    },
    /// A pair is taken away.
    RemovePair {
        /// Its name.
        name: String,
    },
    /// All pairs at once.
    SetPairs {
        /// In place of all that are there.
        pairs: Vec<Pair>,
    },
    /// How the template is wrapped, but for the pairs.
    SetWrap {
        /// Pairs and mask in it are ignored; without a schedule, the case's is taken away.
        settings: WrapSettings,
    },
    /// A new plan comes to work.
    NewPlan {
        /// Its name.
        name: String,
        /// The plan it begins as a copy of.
        copy_of: Option<u32>,
        /// Or else its recipe, TOML; without either it is empty.
        recipe: Option<String>,
    },
    /// Another plan comes to work.
    UsePlan {
        /// Its number.
        id: u32,
    },
    /// The plan in work gets another name.
    RenamePlan {
        /// The name.
        name: String,
    },
    /// A plan is taken away.
    RemovePlan {
        /// Its number.
        id: u32,
    },
    /// The whole recipe of the plan in work.
    SetRecipe {
        /// TOML.
        recipe: String,
    },
    /// A ready operation: added, changed, or with 0 mm taken away.
    SetPreset {
        /// Its name.
        preset: String,
        /// Millimetres.
        amount: f64,
        /// Which side.
        side: Side,
    },
    /// A drawn step is added.
    AddStep {
        /// The step.
        step: plan::DrawnStep,
    },
    /// A step is changed.
    ChangeStep {
        /// Its number, from 0.
        index: u32,
        /// What becomes of it.
        change: plan::StepChange,
    },
    /// A step moves to another place.
    MoveStep {
        /// From.
        from: u32,
        /// To.
        to: u32,
    },
    /// A step is taken away.
    RemoveStep {
        /// Its number, from 0.
        index: u32,
    },
}

/// Longest name or note, bytes.
const LONGEST: usize = 100_000;
/// Most pairs, plans or files of a case.
const MOST: usize = 2000;

impl Edit {
    /// What undo calls it.
    #[must_use]
    pub fn label(&self) -> String {
        match self {
            Self::Describe { .. } => "client's details".to_owned(),
            Self::SetUnit { unit, .. } => format!("unit {}", unit.length()),
            Self::UseScan { .. } => "choice of scan".to_owned(),
            Self::RemoveScan { .. } => "removal of a scan".to_owned(),
            Self::RemovePhoto { .. } => "removal of a photo".to_owned(),
            Self::SetPair { pair } => format!("landmark {}", pair.name),
            Self::RenamePair { to, .. } => format!("name of landmark {to}"),
            Self::RemovePair { name } => format!("removal of landmark {name}"),
            Self::SetPairs { pairs } => format!("{} landmarks", pairs.len()),
            Self::SetWrap { .. } => "wrap settings".to_owned(),
            Self::NewPlan { name, .. } => format!("new plan {name}"),
            Self::UsePlan { .. } => "choice of plan".to_owned(),
            Self::RenamePlan { name } => format!("plan's name {name}"),
            Self::RemovePlan { .. } => "removal of a plan".to_owned(),
            Self::SetRecipe { .. } => "recipe".to_owned(),
            Self::SetPreset { preset, amount, .. } => format!("{preset} {amount} mm"),
            Self::AddStep { step } => step.name.clone(),
            Self::ChangeStep { .. } => "change of a step".to_owned(),
            Self::MoveStep { .. } => "order of steps".to_owned(),
            Self::RemoveStep { .. } => "removal of a step".to_owned(),
        }
    }
}

fn checked(what: &str, text: &str) -> Result<String, Problem> {
    if text.len() > LONGEST {
        return Err(problem(format!("{what}: longer than {LONGEST} bytes; shorten it")));
    }
    Ok(text.to_owned())
}

/// The name of something, which shall have one.
fn named(what: &str, text: &str) -> Result<String, Problem> {
    match text.trim() {
        "" => Err(problem(format!("{what}: give it a name"))),
        text if text.len() > 200 => Err(problem(format!("{what}: a name of at most 200 bytes, please"))),
        text => Ok(text.to_owned()),
    }
}

impl Case {
    /// The scan in work.
    #[must_use]
    pub fn scan_in_work(&self) -> Option<&Source> {
        self.scans.get(self.scan? as usize)
    }

    /// The plan in work.
    pub fn plan_in_work(&self) -> Result<&Plan, Problem> {
        self.plan_of(self.plan)
    }

    /// A plan by its number.
    pub fn plan_of(&self, id: u32) -> Result<&Plan, Problem> {
        let plan = self.plans.iter().find(|plan| plan.id == id);
        plan.ok_or_else(|| problem(format!("there is no plan {id} any more; choose one from the list")))
    }

    /// All files that it refers to, but for those in the command of its result.
    pub fn files(&self) -> impl Iterator<Item = &FileRef> {
        let sources = self.template.iter().chain(&self.rig).chain(&self.scans).map(|s| &s.at);
        let wrapped = self.wrapped.iter().flat_map(|w| [&w.mesh, &w.state, &w.report]);
        let own = self.wrap.mask.iter().chain(&self.wrap.schedule);
        sources.chain(wrapped).chain(own).chain(self.photos.iter().map(|p| &p.at))
    }

    /// All assets that it refers to, each with the file in it that is meant; of a rig none.
    pub fn assets_and_files(&self) -> impl Iterator<Item = (&str, &str)> {
        let of_command = self.wrapped.iter().flat_map(|w| &w.command);
        let of_command = of_command.filter_map(|a| a.strip_prefix("asset:"));
        let of_command = of_command.map(|a| a.split_once('/').unwrap_or((a, "")));
        self.files().map(|at| (&*at.asset, &*at.file)).chain(of_command)
    }

    /// All assets that it refers to.
    pub fn assets(&self) -> impl Iterator<Item = &str> {
        self.assets_and_files().map(|(asset, _)| asset)
    }

    /// The model that wraps it.
    #[must_use]
    pub fn model(&self) -> String {
        self.wrap.model.clone().unwrap_or_else(|| ModelKind::usual(self.rig.is_some()).name().to_owned())
    }

    fn recipe(&mut self, change: impl FnOnce(&str) -> Result<String, Problem>) -> Result<(), Problem> {
        let recipe = change(&self.plan_in_work()?.recipe)?;
        let id = self.plan;
        self.plans.iter_mut().filter(|plan| plan.id == id).for_each(|plan| plan.recipe.clone_from(&recipe));
        Ok(())
    }

    /// Applies a change.
    ///
    /// # Errors
    /// When it refers to what is not there, or breaks a rule; the case may be half changed then and is to be thrown away.
    pub fn apply(&mut self, edit: &Edit) -> Result<(), Problem> {
        let gone = |what: &str| problem(format!("this {what} is not there any more"));
        match edit {
            Edit::Describe { name, date, notes } => {
                self.name = named("the client", name)?;
                self.date = checked("the date", date)?;
                self.notes = checked("the notes", notes)?;
            }
            Edit::SetUnit { which, unit } => {
                let scan = self.scan;
                let source = match which {
                    Which::Template => self.template.as_mut(),
                    Which::Rig => self.rig.as_mut(),
                    Which::Scan => scan.and_then(|k| self.scans.get_mut(k as usize)),
                };
                let before = std::mem::replace(&mut source.ok_or_else(|| gone("file"))?.unit, *unit);
                if *which == Which::Scan {
                    // what lay on the scan lies on it still
                    let times = unit.length().millimetres() / before.length().millimetres();
                    let places = self.wrap.pairs.iter_mut().filter_map(|pair| pair.target.as_mut());
                    places.flatten().for_each(|x| *x *= times);
                }
            }
            Edit::UseScan { index } => {
                self.scans.get(*index as usize).ok_or_else(|| gone("scan"))?;
                self.use_scan(Some(*index));
            }
            Edit::RemoveScan { index } => {
                let index = *index as usize;
                self.scans.get(index).ok_or_else(|| gone("scan"))?;
                match self.scan {
                    Some(at) if at as usize == index => self.use_scan(None),
                    Some(at) if at as usize > index => self.scan = Some(at - 1),
                    _ => {}
                }
                let removed = self.scans.remove(index);
                if !self.scans.contains(&removed) {
                    self.places.retain(|places| places.scan != removed);
                }
            }
            Edit::RemovePhoto { index } => {
                self.photos.get(*index as usize).ok_or_else(|| gone("photo"))?;
                self.photos.remove(*index as usize);
            }
            Edit::SetPair { pair } => {
                check_pair(pair)?;
                match self.wrap.pairs.iter_mut().find(|known| known.name == pair.name) {
                    Some(known) => known.clone_from(pair),
                    None => self.wrap.pairs.push(pair.clone()),
                }
            }
            Edit::RenamePair { name, to } => {
                let to = named("the landmark", to)?;
                if self.wrap.pairs.iter().any(|pair| pair.name == to) {
                    return Err(problem(format!("there is a landmark {to:?} already; choose another name")));
                }
                if !self.wrap.pairs.iter().any(|pair| pair.name == *name) {
                    return Err(gone("landmark"));
                }
                let elsewhere = self.places.iter_mut().flat_map(|places| &mut places.pairs);
                let named = self.wrap.pairs.iter_mut().chain(elsewhere).filter(|pair| pair.name == *name);
                named.for_each(|pair| pair.name.clone_from(&to));
            }
            Edit::RemovePair { name } => self.wrap.pairs.retain(|pair| pair.name != *name),
            Edit::SetPairs { pairs } => {
                check_pairs(pairs)?;
                self.wrap.pairs.clone_from(pairs);
            }
            Edit::SetWrap { settings } => {
                check_settings(settings)?;
                let WrapSettings { pairs, mask, schedule, .. } = std::mem::take(&mut self.wrap);
                // no message names a file: one that is there stays, or is taken away
                let schedule = schedule.filter(|_| settings.schedule.is_some());
                self.wrap = WrapSettings { pairs, mask, schedule, ..settings.clone() };
            }
            Edit::NewPlan { name, copy_of, recipe } => {
                let name = named("the plan", name)?;
                recipe.as_deref().map_or(Ok(()), plan::check)?;
                let recipe = match (copy_of, recipe) {
                    (Some(id), _) => self.plan_of(*id)?.recipe.clone(),
                    (None, Some(recipe)) => recipe.clone(),
                    (None, None) => plan::empty(&name),
                };
                let id = self.plans.iter().map(|plan| plan.id).max().unwrap_or(0) + 1;
                self.plans.push(Plan { id, name, recipe });
                self.plan = id;
            }
            Edit::UsePlan { id } => self.plan = self.plan_of(*id)?.id,
            Edit::RenamePlan { name } => {
                let name = named("the plan", name)?;
                let id = self.plan;
                self.plans.iter_mut().filter(|plan| plan.id == id).for_each(|plan| plan.name.clone_from(&name));
            }
            Edit::RemovePlan { id } => {
                if self.plans.len() == 1 {
                    return Err(problem("a case keeps one plan; make another one first"));
                }
                self.plans.retain(|plan| plan.id != *id);
                if self.plan_in_work().is_err() {
                    self.plan = self.plans[0].id;
                }
            }
            Edit::SetRecipe { recipe } => {
                plan::check(recipe)?;
                self.recipe(|_| Ok(recipe.clone()))?;
            }
            Edit::SetPreset { preset, amount, side } => {
                self.recipe(|text| plan::with_preset(text, preset, *amount, *side))?;
            }
            Edit::AddStep { step } => self.recipe(|text| plan::with_step(text, step))?,
            Edit::ChangeStep { index, change } => {
                self.recipe(|text| plan::with_change(text, *index as usize, change))?;
            }
            Edit::MoveStep { from, to } => self.recipe(|text| plan::moved(text, *from as usize, *to as usize))?,
            Edit::RemoveStep { index } => self.recipe(|text| plan::without(text, *index as usize))?,
        }
        // a landmark that is gone is gone from all scans
        let pairs = &self.wrap.pairs;
        let elsewhere = self.places.iter_mut();
        elsewhere.for_each(|places| places.pairs.retain(|there| pairs.iter().any(|pair| pair.name == there.name)));
        self.check_counts()
    }

    /// Takes another scan, or none, in work: the landmarks on the one before are kept with it, and those on this one are there again.
    fn use_scan(&mut self, index: Option<u32>) {
        if self.scan == index {
            return;
        }
        let placed: Vec<Pair> = self.wrap.pairs.iter().filter(|pair| pair.target.is_some()).cloned().collect();
        if let Some(scan) = self.scan_in_work().cloned() {
            self.places.retain(|places| places.scan != scan);
            self.places.push(Places { scan, pairs: placed });
        }
        self.scan = index;
        let known = self.scan_in_work().and_then(|scan| self.places.iter().find(|places| places.scan == *scan));
        for pair in &mut self.wrap.pairs {
            let there = known.and_then(|places| places.pairs.iter().find(|there| there.name == pair.name)).cloned();
            (pair.target, pair.doubt, pair.by_hand) =
                there.map_or((None, None, false), |there| (there.target, there.doubt, there.by_hand));
        }
    }

    fn check_counts(&self) -> Result<(), Problem> {
        let most = [self.wrap.pairs.len(), self.plans.len(), self.scans.len(), self.photos.len()];
        if most.iter().any(|count| *count > MOST) {
            return Err(problem(format!("a case holds at most {MOST} of a kind; remove some first")));
        }
        Ok(())
    }

    /// Checks a case that no edits have made, as one from elsewhere: it keeps all rules that they keep.
    ///
    /// # Errors
    /// With the first one that it breaks.
    pub fn check(&self) -> Result<(), Problem> {
        self.check_counts()?;
        named("the client", &self.name)?;
        checked("the date", &self.date)?;
        checked("the notes", &self.notes)?;
        check_pairs(&self.wrap.pairs)?;
        self.places.iter().try_for_each(|places| check_pairs(&places.pairs))?;
        check_settings(&self.wrap)?;
        for plan in &self.plans {
            named("a plan", &plan.name)?;
            if self.plans.iter().filter(|other| other.id == plan.id).count() > 1 {
                return Err(problem(format!("two plans have the number {}", plan.id)));
            }
        }
        self.plan_in_work()?;
        if self.scan.is_some() && self.scan_in_work().is_none() {
            return Err(problem("the scan in work is not there"));
        }
        Ok(())
    }

    /// Pairs that were found on the scan join those that are there. Where the user has placed one, it stays: how many do.
    ///
    /// # Errors
    /// When they break a rule.
    pub fn take_suggestions(&mut self, found: Vec<Pair>) -> Result<usize, Problem> {
        let mut kept = 0;
        for pair in found {
            match self.wrap.pairs.iter_mut().find(|known| known.name == pair.name) {
                Some(known) if known.by_hand && known.target.is_some() => {
                    known.vertex = known.vertex.or(pair.vertex);
                    kept += 1;
                }
                _ => self.apply(&Edit::SetPair { pair })?,
            }
        }
        Ok(kept)
    }
}

fn check_pair(pair: &Pair) -> Result<(), Problem> {
    named("the landmark", &pair.name)?;
    if pair.target.iter().flatten().any(|x| !x.is_finite()) {
        return Err(problem(format!("landmark {:?} is nowhere: its coordinates are not finite", pair.name)));
    }
    Ok(())
}

fn check_pairs(pairs: &[Pair]) -> Result<(), Problem> {
    pairs.iter().try_for_each(check_pair)?;
    let mut names: Vec<&str> = pairs.iter().map(|pair| pair.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(problem(format!("landmark {:?} comes twice; give each its own name", twice[0])));
    }
    Ok(())
}

fn check_settings(settings: &WrapSettings) -> Result<(), Problem> {
    settings.model.iter().try_for_each(|name| name.parse::<ModelKind>().map(drop)).map_err(problem)?;
    for [low, high] in settings.expression_bounds.iter().chain(&settings.identity_bounds) {
        if low.is_nan() || high.is_nan() || low > high {
            return Err(problem(format!("no weight lies between {low} and {high}; put the lower bound first")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, from_value, json};

    use super::*;

    #[test]
    fn suggestions_leave_what_the_user_has_placed() {
        let pair = |name: &str, vertex, x: f64, by_hand| {
            let target = (x >= 0.0).then_some([x, 0.0, 0.0]);
            Pair { name: name.to_owned(), vertex, target, doubt: None, by_hand }
        };
        let mut case = Case::default();
        case.wrap.pairs = vec![
            pair("mole", Some(7), 1.0, true),
            pair("30", None, 2.0, true),
            pair("8", Some(3), 3.0, false),
            pair("27", Some(4), -1.0, true),
        ];
        let found = ["30", "8", "27", "33"].map(|name| pair(name, Some(9), 5.0, false));
        assert_eq!(case.take_suggestions(found.to_vec()).unwrap(), 1);
        let names: Vec<&str> = case.wrap.pairs.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["mole", "30", "8", "27", "33"]);
        assert_eq!(case.wrap.pairs[0], pair("mole", Some(7), 1.0, true));
        // its place stays, and it learns where it is on the template
        assert_eq!(case.wrap.pairs[1], pair("30", Some(9), 2.0, true));
        assert!(case.wrap.pairs[2..].iter().all(|p| p.vertex == Some(9) && p.target == Some([5.0, 0.0, 0.0])));
    }

    #[test]
    fn landmarks_stay_with_their_scan() {
        let source =
            |name: &str| from_value(json!({ "at": { "asset": name, "file": "s.ply" }, "name": "s.ply", "unit": "mm" }));
        let scans = ["a", "b"].map(|name| source(name).unwrap()).to_vec();
        let mut case = Case { scans, scan: Some(0), ..Case::default() };
        let placed = |case: &mut Case, name: &str, x: f64| {
            let pair =
                Pair { name: name.to_owned(), vertex: Some(1), target: Some([x; 3]), doubt: None, by_hand: true };
            case.apply(&Edit::SetPair { pair }).unwrap();
        };
        let at = |case: &Case| case.wrap.pairs.iter().map(|p| p.target.map(|t| t[0])).collect::<Vec<_>>();
        placed(&mut case, "nose", 1.0);
        placed(&mut case, "chin", 2.0);
        case.apply(&Edit::UseScan { index: 1 }).unwrap();
        assert_eq!(at(&case), [None, None]);
        placed(&mut case, "nose", 3.0);
        // a landmark has its new name on both, and one that is removed is on neither
        case.apply(&Edit::RenamePair { name: "nose".to_owned(), to: "tip".to_owned() }).unwrap();
        case.apply(&Edit::RemovePair { name: "chin".to_owned() }).unwrap();
        case.apply(&Edit::UseScan { index: 0 }).unwrap();
        assert_eq!((at(&case), case.wrap.pairs[0].by_hand), (vec![Some(1.0)], true));
        case.apply(&Edit::UseScan { index: 1 }).unwrap();
        assert_eq!(at(&case), [Some(3.0)]);
        case.check().unwrap();
        case.apply(&Edit::RemoveScan { index: 1 }).unwrap();
        assert_eq!((at(&case), case.places.len()), (vec![None], 1));
    }

    #[test]
    fn a_result_is_one_of_its_scan_in_its_unit() {
        let at = |asset: &str| json!({ "asset": asset, "file": "scan.ply" });
        let command = [
            "register",
            "--template",
            "asset:t/scan.ply",
            "--target",
            "asset:a/scan.ply",
            "--unit",
            "template=cm,target=mm",
        ];
        let summary =
            json!({ "within": 1, "median": 0, "p95": 0, "flipped": 0, "probability": 0, "steps": 1, "doubts": [] });
        let wrapped: Wrapped = from_value(json!({
            "mesh": at("b"), "state": at("b"), "report": at("b"), "command": command, "model": "rigid", "scan": "scan.ply",
            "summary": summary,
        }))
        .unwrap();
        let source = |at: Value, unit: &str| from_value(json!({ "at": at, "name": "scan.ply", "unit": unit })).unwrap();
        let is_of = |scan, template| {
            let (template, scans) = (Some(template), vec![scan]);
            wrapped.is_of(&Case { template, scans, scan: Some(0), ..Case::default() })
        };
        let template = |unit: &str| source(at("t"), unit);
        assert!(is_of(source(at("a"), "mm"), template("cm")) && !is_of(source(at("a"), "mm"), template("mm")));
        assert!(!is_of(source(at("c"), "mm"), template("cm")) && !is_of(source(at("a"), "cm"), template("cm")));
    }
}
