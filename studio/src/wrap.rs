//! Wrapping: a case's files and settings as a registration, its result as files of the vault, and the `nonrigid register` line that
//! makes the same bytes. Landmarks go through the files that the command line would read.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use nonrigid::evaluation::ScanDistance;
use nonrigid::io::{self, LengthUnit, MaterialFiles};
use nonrigid::landmark::Landmark;
use nonrigid::mesh::PolygonMesh;
use nonrigid::registration::{
    ModelFactory as _, ModelKind, RegistrationInput, RegistrationObserver, RegistrationResult, Report, Schedule, TERMS,
    WarmStart, assess, register, scan_colors,
};
use nonrigid::rig::{Family, Regions, ShapeBasis};

use crate::case::{Case, FileRef, Pair, Source, Unit, WrapSummary, Wrapped};
use crate::error::{Problem, problem};
use crate::plan;
use crate::store::{LoadedScan, Store};
use crate::vault::Vault;

/// Everything that a registration needs, read.
pub struct WrapJob {
    template: Arc<PolygonMesh>,
    /// The template's, which go along with a result.
    materials: MaterialFiles,
    scan: Arc<LoadedScan>,
    shapes: ShapeBasis,
    landmarks: Vec<Landmark>,
    masks: [Option<Vec<f64>>; 2],
    regions: Regions,
    warm: Option<WarmStart>,
    model: ModelKind,
    schedule: Schedule,
    command: Vec<String>,
    scan_name: String,
    settings: Regional,
    /// What the schedule says and has no effect.
    pub idle: Option<String>,
}

/// What the report repeats of the settings.
struct Regional {
    regions: Vec<String>,
    free_regions: Vec<String>,
}

/// A result, with what it needs to become files.
pub struct WrapOutcome {
    /// Of the registration.
    pub result: RegistrationResult,
    /// Distance of each vertex to the scan, mm.
    pub distances: Vec<f64>,
    /// Numbers and doubts.
    pub summary: WrapSummary,
    mesh: PolygonMesh,
    colors: Option<Vec<[u8; 3]>>,
    report: Report,
}

/// A file in a command, until the page shows where it is.
pub(crate) fn asset_path(at: &FileRef) -> String {
    if at.file.is_empty() { format!("asset:{}", at.asset) } else { format!("asset:{}/{}", at.asset, at.file) }
}

/// A command line with the vault's paths, quoted for a shell.
#[must_use]
pub fn shell_line(vault: &Vault, arguments: &[String]) -> String {
    let quoted = |text: &str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+@%".contains(c);
        if !text.is_empty() && text.chars().all(plain) {
            text.to_owned()
        } else {
            format!("'{}'", text.replace('\'', r"'\''"))
        }
    };
    let word = |argument: &String| quoted(&resolved(vault, argument));
    std::iter::once("nonrigid".to_owned()).chain(arguments.iter().map(word)).collect::<Vec<_>>().join(" ")
}

/// Whether a command is one that a wrap has made: what is copied into a shell names no file but the vault's and `wrapped.obj`.
#[must_use]
pub fn is_own_command(arguments: &[String]) -> bool {
    const FILES: [&str; 8] = [
        "--template",
        "--target",
        "--rig",
        "--landmarks",
        "--template-landmarks",
        "--mask",
        "--warm-start",
        "--config",
    ];
    const WORDS: [&str; 5] = ["--model", "--identity-modes", "--regions", "--free-regions", "--unit"];
    let [first, rest @ ..] = arguments else { return false };
    let mut rest = rest.iter().map(String::as_str);
    while let Some(option) = rest.next() {
        let sound = match option {
            _ if option.starts_with("--expression-bounds=") || option.starts_with("--identity-bounds=") => true,
            "--out" => rest.next() == Some("wrapped.obj"),
            _ if FILES.contains(&option) => rest.next().is_some_and(|value| value.starts_with("asset:")),
            _ if WORDS.contains(&option) => rest.next().is_some_and(|value| !value.starts_with('-')),
            _ => false,
        };
        if !sound {
            return false;
        }
    }
    first == "register"
}

/// An argument with the vault's path in place of an asset.
#[must_use]
pub fn resolved(vault: &Vault, argument: &str) -> String {
    let Some(asset) = argument.strip_prefix("asset:") else { return argument.to_owned() };
    let (asset, file) = asset.split_once('/').unwrap_or((asset, ""));
    let at = FileRef { asset: asset.to_owned(), file: file.to_owned() };
    vault.path(&at).map_or_else(|_| argument.to_owned(), |path| path.display().to_string())
}

/// Template and scan of a case, or what is missing.
fn sides(case: &Case) -> Result<(&Source, &Source), Problem> {
    let template =
        case.template.as_ref().ok_or_else(|| problem("there is no template yet: add one, or a rig that has one"))?;
    let scan =
        case.scan_in_work().ok_or_else(|| problem("there is no scan yet: add one, or choose one from the list"))?;
    Ok((template, scan))
}

impl WrapJob {
    /// Reads a case for a registration with the given model; `pairs` are the landmarks that take part.
    ///
    /// # Errors
    /// When something is missing or cannot be read.
    pub fn new(
        vault: &Vault,
        store: &Store,
        case: &Case,
        model: &str,
        pairs: &[Pair],
        warm: bool,
    ) -> Result<Self, Problem> {
        let model: ModelKind = model.parse().map_err(problem)?;
        let (template_source, scan_source) = sides(case)?;
        if model.needs_shapes() && case.rig.is_none() {
            return Err(problem(format!("the model '{model}' needs blendshapes: add a rig, or choose graph or arap")));
        }
        let settings = &case.wrap;
        let template = store.mesh(vault, template_source)?;
        let scan = store.scan(vault, scan_source)?;
        let shapes = store.shapes(vault, case, settings.identity_modes, &template)?;
        let mut units = vec![
            format!("template={}", template_source.unit.length()),
            format!("target={}", scan_source.unit.length()),
        ];
        let mut command: Vec<String> = Vec::new();
        let mut add = |words: &[&str]| command.extend(words.iter().map(|w| (*w).to_owned()));
        add(&["register", "--template", &asset_path(&template_source.at), "--target", &asset_path(&scan_source.at)]);
        add(&["--model", model.name()]);
        if let Some(rig) = &case.rig {
            let modes = shapes.shapes().iter().filter(|shape| shape.family == Family::Identity).count();
            add(&["--rig", &asset_path(&rig.at), "--identity-modes", &modes.to_string()]);
            units.push(format!("rig={}", rig.unit.length()));
        }
        let mut landmarks = Vec::new();
        let whole: Vec<&Pair> = pairs.iter().filter(|p| p.vertex.is_some() && p.target.is_some()).collect();
        if !whole.is_empty() {
            let files = landmark_files(vault, &whole)?;
            let [target, names] = [vault.path(&files[0])?, vault.path(&files[1])?];
            landmarks = read_pairs(&target, &names, &template, &scan)?;
            add(&["--landmarks", &asset_path(&files[0]), "--template-landmarks", &asset_path(&files[1])]);
            units.push("landmarks=mm".to_owned());
        }
        let regions = store.regions(vault, case, &template)?;
        let mask_of = |names: &[String], regions: &Regions| {
            (!names.is_empty()).then(|| regions.mask(names)).transpose().map_err(problem)
        };
        let mut mask = mask_of(&settings.regions, &regions)?;
        let free = mask_of(&settings.free_regions, &regions)?;
        if let Some(at) = &settings.mask {
            let painted = io::read_npy_vector(&vault.path(at)?, Some(template.positions.len()))?;
            mask = Some(mask.map_or(painted.clone(), |m| m.iter().zip(&painted).map(|(a, b)| a * b).collect()));
            add(&["--mask", &asset_path(at)]);
        }
        if !settings.regions.is_empty() {
            add(&["--regions", &settings.regions.join(",")]);
        }
        if !settings.free_regions.is_empty() {
            add(&["--free-regions", &settings.free_regions.join(",")]);
        }
        let mut idle = None;
        let mut schedule = match &settings.schedule {
            None => model.schedule().map_err(problem)?,
            Some(at) => {
                add(&["--config", &asset_path(at)]);
                let schedule = read_schedule(&vault.path(at)?, &model)?;
                idle = without_effect(&at.file, &schedule);
                schedule
            }
        };
        if case.rig.is_some() {
            for (option, given, bounds) in [
                ("expression", settings.expression_bounds, &mut schedule.bounds.expression),
                ("identity", settings.identity_bounds, &mut schedule.bounds.identity),
            ] {
                if let Some([low, high]) = given {
                    *bounds = Some([low, high]);
                    add(&[&format!("--{option}-bounds={low},{high}")]);
                }
            }
        }
        let mut state = None;
        if let Some(wrapped) = case.wrapped.as_ref().filter(|w| warm && w.model == model.name() && w.is_of(case)) {
            let text = io::read_text(&vault.path(&wrapped.state)?)?;
            let damaged = |_| problem("the state of the last result is damaged: start anew with Wrap");
            let read: WarmStart = serde_json::from_str(&text).map_err(damaged)?;
            state = Some(read);
            add(&["--warm-start", &asset_path(&wrapped.state)]);
        }
        add(&["--unit", &units.join(","), "--out", "wrapped.obj"]);
        let Case { wrap, .. } = case;
        let settings = Regional { regions: wrap.regions.clone(), free_regions: wrap.free_regions.clone() };
        let scan_name = scan_source.name.clone();
        Ok(Self {
            materials: MaterialFiles::of(&vault.path(&template_source.at)?, &template),
            template,
            scan,
            shapes,
            landmarks,
            masks: [mask, free],
            regions,
            warm: state,
            model,
            schedule,
            command,
            scan_name,
            settings,
            idle,
        })
    }

    fn input(&self) -> RegistrationInput<'_> {
        RegistrationInput {
            shapes: &self.shapes,
            scan_normals: self.scan.scan.normals.as_deref(),
            landmarks: &self.landmarks,
            mask: self.masks[0].as_deref(),
            free_mask: self.masks[1].as_deref(),
            regions: Some(&self.regions),
            warm_start: self.warm.as_ref(),
            ..RegistrationInput::new(&self.template, &self.scan.scan.mesh)
        }
    }

    /// Registers.
    ///
    /// # Errors
    /// What the library says, or that it was cancelled.
    pub fn register(&self, observer: &mut impl RegistrationObserver) -> Result<RegistrationResult, Problem> {
        let result = register(&self.input(), &self.model, &self.schedule, observer);
        if observer.cancel().is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
            return Err(problem("cancelled: the last result stays as it was"));
        }
        result.map_err(problem)
    }

    /// Measures a result.
    ///
    /// # Errors
    /// What the library says.
    pub fn measure(&self, mut result: RegistrationResult) -> Result<WrapOutcome, Problem> {
        let scan = &self.scan.scan;
        let (quality, reliability) = assess(&self.input(), &result).map_err(problem)?;
        let (faced, normals) = result.scan_facing.apply(&scan.mesh, scan.normals.as_deref());
        // what is kept of the result keeps no scan
        let registered = std::mem::take(&mut result.scan);
        let colors = scan.colors.as_deref();
        let colors = colors.map(|colors| scan_colors(&self.input(), &registered, colors, &result.positions));
        let colors = colors.transpose().map_err(problem)?;
        let surface = ScanDistance::new(&faced, normals.as_deref()).map_err(problem)?;
        let distances = result.positions.iter().map(|p| surface.of(p)).collect();
        let mut doubts: Vec<String> = reliability.doubts.iter().map(ToString::to_string).collect();
        doubts.extend(result.remarks());
        let summary = WrapSummary {
            within: quality.to_scan.share_within,
            median: quality.median_within,
            p95: quality.to_scan.p95,
            flipped: quality.flipped as u32,
            probability: reliability.probability,
            steps: result.history.len() as u32,
            doubts,
        };
        let report = Report::new(self.model.name(), Vec::new(), &result, quality, reliability);
        let Regional { regions, free_regions } = &self.settings;
        let report = Report { regions: regions.clone(), free_regions: free_regions.clone(), ..report };
        let mut mesh = (*self.template).clone();
        mesh.positions.clone_from(&result.positions);
        Ok(WrapOutcome { result, distances, summary, mesh, colors: colors.map(|c| c.colors), report })
    }

    /// Writes a result into the vault.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn keep(&self, vault: &Vault, outcome: &WrapOutcome) -> Result<Wrapped, Problem> {
        let colors = outcome.colors.as_deref();
        let mesh = vault.add_file("wrapped.obj", |path| {
            let mut mesh = outcome.mesh.clone();
            let copied = self.materials.write(path, &mut mesh)?;
            io::write_colored_mesh(path, &mesh, colors)?;
            copied.keep();
            Ok(())
        })?;
        let json = |value: serde_json::Result<String>| value.map_err(problem);
        let state = json(serde_json::to_string_pretty(&outcome.result.end))?;
        let report = json(serde_json::to_string_pretty(&outcome.report))?;
        Ok(Wrapped {
            mesh,
            state: vault.add_bytes("state.json", state.as_bytes())?,
            report: vault.add_bytes("report.json", report.as_bytes())?,
            command: self.command.clone(),
            model: self.model.name().to_owned(),
            scan: self.scan_name.clone(),
            summary: outcome.summary.clone(),
        })
    }

    /// Pairs for the landmarks of a rig, placed on the scan where a result has them; doubtful ones say why.
    #[must_use]
    pub fn suggestions(
        &self,
        outcome: &WrapOutcome,
        landmarks: &[(String, nonrigid::landmark::TemplatePoint)],
    ) -> Vec<Pair> {
        let on_rim = rim(&self.scan.scan.mesh.triangles);
        let place = |(name, point): &(String, nonrigid::landmark::TemplatePoint)| {
            let nonrigid::landmark::TemplatePoint::Vertex(vertex) = point else { return None };
            let p = point.position(&outcome.result.positions);
            let seen = outcome.result.accepted[*vertex as usize];
            let closest = self.scan.surface.as_ref().and_then(|s| s.query(&p));
            let (target, distance) = closest.map_or((p, 0.0), |c| (c.point, c.squared_distance.sqrt()));
            let at_rim = closest
                .is_some_and(|c| self.scan.scan.mesh.triangles[c.triangle as usize].iter().any(|v| on_rim.contains(v)));
            let doubt = match () {
                () if distance > 2.0 => Some(format!("{distance:.1} mm from the wrapped template")),
                () if !seen => Some("the scan shows nothing of this place".to_owned()),
                () if at_rim => Some("at a rim or hole of the scan".to_owned()),
                () if outcome.summary.probability > 0.5 => Some("the registration itself is doubtful".to_owned()),
                () => None,
            };
            Some(Pair { name: name.clone(), vertex: Some(*vertex), target: Some(target.into()), doubt, by_hand: false })
        };
        landmarks.iter().filter_map(place).collect()
    }
}

/// A schedule for a model.
///
/// # Errors
/// When it cannot be read, or is none for this model.
pub fn read_schedule(path: &Path, model: &ModelKind) -> Result<Schedule, Problem> {
    let text = plan::text_of(path)?;
    let read = Schedule::from_toml(&text).and_then(|schedule| schedule.resolved(model, &TERMS));
    read.map_err(|e| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        problem(format!(
            "{name} is no schedule for the model '{}': {e}; correct it, or choose the model's own",
            model.name()
        ))
    })
}

/// What a schedule of one's own says and has no effect, in a line.
#[must_use]
pub fn without_effect(name: &str, schedule: &Schedule) -> Option<String> {
    let idle = schedule.without_effect(None);
    (!idle.is_empty()).then(|| format!("{name}: {}", idle.join("; ")))
}

/// Vertices at an edge of one triangle.
fn rim(triangles: &[[u32; 3]]) -> std::collections::HashSet<u32> {
    let mut edges = std::collections::HashMap::new();
    for t in triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *edges.entry([a.min(b), a.max(b)]).or_insert(0u32) += 1;
        }
    }
    edges.into_iter().filter(|e| e.1 == 1).flat_map(|e| e.0).collect()
}

/// The landmark files of pairs that have both sides: on the scan, on the template.
///
/// # Errors
/// When they cannot be written.
pub fn landmark_files(vault: &Vault, pairs: &[&Pair]) -> Result<[FileRef; 2], Problem> {
    let text = |value: serde_json::Map<String, serde_json::Value>| {
        serde_json::to_string_pretty(&value).map_err(problem).map(|text| text + "\n")
    };
    let scan = text(pairs.iter().map(|p| (p.name.clone(), p.target.unwrap_or_default().to_vec().into())).collect())?;
    let template = text(pairs.iter().map(|p| (p.name.clone(), p.vertex.unwrap_or_default().into())).collect())?;
    Ok([
        vault.add_bytes("landmarks.json", scan.as_bytes())?,
        vault.add_bytes("template_landmarks.json", template.as_bytes())?,
    ])
}

/// Reads landmarks as the command line does.
fn read_pairs(
    target: &Path,
    names: &Path,
    template: &PolygonMesh,
    scan: &LoadedScan,
) -> Result<Vec<Landmark>, Problem> {
    let mut set = nonrigid::landmark::read_scan_landmark_set(target)?;
    set.assume(LengthUnit::Millimetre);
    let names_set = nonrigid::landmark::read_landmark_set(names)?;
    Ok(nonrigid::landmark::pair_landmarks((set, target), Some((&names_set, names)), template, Some(&scan.scan.mesh))?)
}

/// Places on a scan of the landmarks in a file: names and points, mm.
///
/// # Errors
/// When it cannot be read.
pub fn scan_places(path: &Path, unit: Unit, scan: &LoadedScan) -> Result<Vec<(String, [f64; 3])>, Problem> {
    let mut set = nonrigid::landmark::read_scan_landmark_set(path)?;
    set.assume(unit.length());
    let mesh = PolygonMesh::from(scan.scan.mesh.clone());
    let points = set.positions_on(path, &mesh)?;
    Ok(set.landmarks.iter().zip(points).map(|(l, p)| (l.name.clone(), p.into())).collect())
}
