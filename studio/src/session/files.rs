//! Files that join a case, and files that are written for the user.

use std::io::Read as _;
use std::path::Path;

use nonrigid::io;
use nonrigid::mesh::PolygonMesh;

use super::{Shown, Window, nearest_vertex};
use crate::case::{Edit, FileRef, Pair, Photo, Source, Unit};
use crate::error::{Problem, problem};
use crate::protocol::{Export, Role, ServerMessage, Upload};
use crate::vault::OpenCase;
use crate::{plan, store, wrap};

impl Window {
    /// Files join the case. Joined or refused, they wait no longer; only for their unit they do.
    pub(super) fn add(&mut self, role: Role, files: &[Upload], unit: Option<Unit>) -> Result<(), Problem> {
        let outcome = self.join(role, files, unit);
        if !matches!(outcome, Ok(true)) {
            self.hub.forget(files);
        }
        outcome.map(drop)
    }

    /// Whether they wait for their unit.
    fn join(&mut self, role: Role, all: &[Upload], unit: Option<Unit>) -> Result<bool, Problem> {
        let hub = self.hub.clone();
        // landmarks that come with their mesh
        let of_mesh = match role {
            Role::Scan => Some(Role::ScanLandmarks),
            Role::Template => Some(Role::TemplateLandmarks),
            _ => None,
        };
        let with_mesh = of_mesh.is_some() && !all.iter().all(holds_landmarks);
        let (marks, files): (Vec<Upload>, Vec<Upload>) =
            all.iter().cloned().partition(|file| with_mesh && holds_landmarks(file));
        let files = &files[..];
        let (Some(first), true) = (files.first(), files.len() <= crate::vault::MOST_FILES) else {
            return Err(problem("choose between one file and two thousand"));
        };
        let gathered = hub.gathered(files)?;
        let path = gathered.folder.join(&first.name);
        if role == Role::Case {
            let id = crate::archive::import(&hub.vault, &path)?;
            self.list("")?;
            self.open_case(id)?;
            return Ok(false);
        }
        let id = self.case()?.id;
        let main = match role {
            Role::Rig if files.len() > 1 => String::new(),
            _ => main_file(role, files)?,
        };
        let at_file = gathered.folder.join(&main);
        let unit = match role {
            Role::Template | Role::Scan | Role::Rig => {
                let rig = role == Role::Rig;
                let whole = if main.is_empty() { &gathered.folder } else { &at_file };
                let points = if rig { store::points_of_rig(whole) } else { store::points_of_mesh(whole) };
                let points = points?;
                match unit.map_or_else(|| store::guess_unit(&at_file, &points), Ok) {
                    Ok(unit) => unit,
                    Err((text, units)) => {
                        self.say(ServerMessage::UnitWanted { role, files: all.to_vec(), text, units });
                        return Ok(true);
                    }
                }
            }
            _ => Unit::Mm,
        };
        let template_inside = gathered.folder.join("template.obj").exists();
        match role {
            Role::Recipe => {
                let text = plan::text_of(&at_file)?;
                plan::check(&text)?;
                let name = main.trim_end_matches(".toml").to_owned();
                self.change(&format!("recipe {name}"), |case| {
                    case.apply(&Edit::NewPlan { name, copy_of: None, recipe: Some(text) })
                })?;
            }
            Role::Schedule => {
                let model = self.case()?.case.model().parse().map_err(problem)?;
                if let Some(text) = wrap::without_effect(&main, &wrap::read_schedule(&at_file, &model)?) {
                    self.say(ServerMessage::Note { text });
                }
                let asset = hub.vault.take(&gathered)?;
                self.change(&format!("schedule {main}"), |case| {
                    case.wrap.schedule = Some(FileRef { asset, file: main });
                    Ok(())
                })?;
            }
            Role::ScanLandmarks => {
                let case = &self.case()?.case;
                let source = case.scan_in_work().ok_or_else(|| problem("add the scan before its landmarks"))?;
                let scan = hub.store.scan(&hub.vault, source)?;
                let places = wrap::scan_places(&at_file, source.unit, &scan)?;
                let template =
                    case.template.as_ref().map(|template| hub.store.mesh(&hub.vault, template)).transpose()?;
                let vertices = template.map_or(0, |mesh| mesh.positions.len());
                let numbered = |name: &str| name.parse().ok().filter(|v: &u32| (*v as usize) < vertices);
                self.change(&format!("{} landmarks of {main}", places.len()), |case| {
                    for (name, target) in places {
                        let known = case.wrap.pairs.iter().find(|p| p.name == name);
                        // a name that is a number is a vertex of the template, unless a landmark has it
                        let vertex = known.map_or_else(|| numbered(&name), |p| p.vertex);
                        case.apply(&Edit::SetPair {
                            pair: Pair { name, vertex, target: Some(target), doubt: None, by_hand: true },
                        })?;
                    }
                    Ok(())
                })?;
            }
            Role::TemplateLandmarks => {
                let case = &self.case()?.case;
                let source = case.template.as_ref().ok_or_else(|| problem("add the template before its landmarks"))?;
                let mesh = hub.store.mesh(&hub.vault, source)?;
                let mut set = nonrigid::landmark::read_landmark_set(&at_file)?;
                set.assume(source.unit.length());
                let points = set.on_template(&at_file, &mesh)?;
                self.change(&format!("{} landmarks of {main}", points.len()), |case| {
                    for (name, point) in points {
                        let vertex = Some(nearest_vertex(&mesh.positions, point.position(&mesh.positions)));
                        let known = case.wrap.pairs.iter().find(|p| p.name == name);
                        let (target, by_hand) = known.map_or((None, false), |p| (p.target, p.by_hand));
                        case.apply(&Edit::SetPair { pair: Pair { name, vertex, target, doubt: None, by_hand } })?;
                    }
                    Ok(())
                })?;
            }
            Role::Template | Role::Scan | Role::Rig | Role::Photo => {
                if role == Role::Photo {
                    check_picture(&at_file)?;
                }
                let asset = hub.vault.take(&gathered)?;
                let at = FileRef { asset, file: main.clone() };
                let name = if main.is_empty() { "rig".to_owned() } else { main.clone() };
                let source = Source { at: at.clone(), name: name.clone(), unit };
                let mesh = |source: &Source| hub.store.mesh(&hub.vault, source);
                // a template whose file is gone can be replaced too
                let alike = match self.case()?.case.template.as_ref().filter(|_| role == Role::Template) {
                    Some(before) => {
                        mesh(before).is_ok_and(|before| mesh(&source).is_ok_and(|now| same_vertices(&before, &now)))
                    }
                    None => true,
                };
                let label = name.clone();
                let mut taken_out = Vec::new();
                let open = hub.vault.change(id, &label, |case| {
                    match role {
                        Role::Template => {
                            // Vertices, as of pins, and mask of another template mean nothing on this one.
                            if !alike {
                                case.wrap.mask = None;
                                case.wrap.pairs.iter_mut().for_each(|pair| pair.vertex = None);
                                for plan in &mut case.plans {
                                    let (recipe, names) = plan::without_vertices(&plan.recipe)?;
                                    plan.recipe = recipe;
                                    taken_out.extend(names.into_iter().map(|name| format!("{name} ({})", plan.name)));
                                }
                            }
                            (case.template, case.wrapped) = (Some(source), None);
                        }
                        Role::Rig => {
                            if case.template.is_none() && template_inside {
                                let file = FileRef { file: "template.obj".to_owned(), ..at.clone() };
                                case.template = Some(Source { at: file, name: "template.obj".to_owned(), unit });
                            }
                            case.rig = Some(source);
                        }
                        Role::Scan => {
                            case.scans.push(source);
                            case.apply(&Edit::UseScan { index: case.scans.len() as u32 - 1 })?;
                        }
                        _ => case.photos.push(Photo { at: at.clone(), name }),
                    }
                    Ok(())
                })?;
                if role != Role::Photo {
                    // a file that was missing may be there again
                    self.shown = Shown::default();
                }
                let outcome = self.made(open);
                if !taken_out.is_empty() {
                    let text = format!(
                        "steps that hold or draw vertices of the template before were taken out, undo brings them back: {}",
                        taken_out.join(", ")
                    );
                    self.say(ServerMessage::Note { text });
                }
                outcome?;
                if matches!(role, Role::Template | Role::Scan) {
                    self.say_what_is_missing(&hub.vault.path(&at)?);
                }
                if let Some(role) = of_mesh {
                    marks.into_iter().try_for_each(|mark| self.join(role, &[mark], None).map(drop))?;
                }
            }
            Role::Case => {}
        }
        Ok(false)
    }

    /// Says which materials and images of a mesh have not come with it.
    fn say_what_is_missing(&self, mesh: &Path) {
        let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let missing: Vec<String> =
            io::files_of_painted_mesh(mesh).iter().filter(|file| !file.is_file()).map(|file| name(file)).collect();
        if !missing.is_empty() {
            let text = format!(
                "{} names {}, which did not come with it: add them together to keep its materials and colours",
                name(mesh),
                missing.join(", ")
            );
            self.say(ServerMessage::Note { text });
        }
    }

    pub(super) fn paint(&mut self, weights: Option<Vec<f32>>) -> Result<(), Problem> {
        let hub = self.hub.clone();
        let case = &self.case()?.case;
        let source = case.template.clone().ok_or_else(|| problem("there is no template to paint on"))?;
        let vertices = hub.store.mesh(&hub.vault, &source)?.positions.len();
        let mask = match weights {
            None => None,
            Some(weights) => {
                if weights.len() != vertices || !weights.iter().all(|w| (0.0..=1.0).contains(w)) {
                    return Err(problem(format!(
                        "a mask has a number from 0 to 1 for each of the {vertices} vertices"
                    )));
                }
                let write = |path: &Path| Ok(io::write_npy(path, &[weights.len()], &weights)?);
                Some(hub.vault.add_file("mask.npy", write)?)
            }
        };
        self.change("painted mask", |case| {
            case.wrap.mask = mask;
            Ok(())
        })
    }

    pub(super) fn export(&mut self, what: &Export) -> Result<(), Problem> {
        let hub = self.hub.clone();
        let OpenCase { id, case, .. } = self.case()?.clone();
        let known = |format: &str| {
            if ["obj", "ply", "glb"].contains(&format) {
                Ok(())
            } else {
                Err(problem("meshes are written as obj, ply or glb"))
            }
        };
        let at = match what {
            Export::Wrapped { format } => {
                known(format)?;
                let wrapped =
                    case.wrapped.as_ref().ok_or_else(|| problem("nothing is wrapped yet: press Wrap first"))?;
                if format == "obj" {
                    wrapped.mesh.clone()
                } else {
                    // the colours come back from the file, eight bits each
                    let file = io::read_mesh_file(&hub.vault.path(&wrapped.mesh)?)?;
                    let write = |path: &Path| Ok(io::write_colored_mesh(path, &file.mesh, file.colors.as_deref())?);
                    hub.vault.add_file(&format!("wrapped.{format}"), write)?
                }
            }
            Export::Recipe => hub.vault.add_bytes("plan.toml", case.plan_in_work()?.recipe.as_bytes())?,
            Export::Face { format } => {
                known(format)?;
                let recipe = case.plan_in_work()?.recipe.clone();
                if plan::is_empty(&recipe) {
                    return Err(problem("the plan has no steps yet: move a slider or draw a region"));
                }
                let positions = self.positions(&case, &recipe)?.positions;
                let mut mesh = hub.store.face(&hub.vault, &case)?.with_positions(positions);
                hub.vault.add_file(&format!("morphed.{format}"), |path| {
                    let materials = match format == "obj" {
                        true => io::MaterialFiles::of(&hub.vault.path(&store::face_source(&case)?.at)?, &mesh),
                        false => io::MaterialFiles::default(),
                    };
                    let copied = materials.write(path, &mut mesh)?;
                    io::write_polygon_mesh(path, &mesh)?;
                    copied.keep();
                    Ok(())
                })?
            }
            Export::Landmarks => {
                let whole: Vec<&Pair> =
                    case.wrap.pairs.iter().filter(|p| p.vertex.is_some() && p.target.is_some()).collect();
                if whole.is_empty() {
                    return Err(problem("no landmark has both sides yet"));
                }
                wrap::landmark_files(&hub.vault, &whole)?[0].clone()
            }
            Export::Case => {
                let (at, left_out) = crate::archive::export(&hub.vault, id)?;
                if left_out > 0 {
                    let text = format!(
                        "{left_out} earlier states of this client are not in the zip file: files of theirs are missing in the vault \
                         or were changed there"
                    );
                    self.say(ServerMessage::Note { text });
                }
                at
            }
        };
        hub.vault.leave(id, &at)?;
        let at = match what {
            Export::Wrapped { .. } | Export::Face { .. } => crate::archive::with_files_beside(&hub.vault, &at)?,
            _ => at,
        };
        hub.vault.leave(id, &at)?;
        self.say(ServerMessage::Exported { at });
        Ok(())
    }
}

/// Refuses a photo that no browser shows.
fn check_picture(path: &Path) -> Result<(), Problem> {
    let mut head = Vec::new();
    std::fs::File::open(path)?.take(12).read_to_end(&mut head)?;
    let webp = head.starts_with(b"RIFF") && head.ends_with(b"WEBP");
    if webp || head.starts_with(b"\x89PNG\r\n\x1a\n") || head.starts_with(b"\xff\xd8\xff") {
        return Ok(());
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Err(problem(format!("{name} is no picture: add a PNG, JPEG or WebP file")))
}

/// Whether a number means the same vertex of both meshes: the polygons join the same ones, or where there are none, all lie where they did.
fn same_vertices(a: &PolygonMesh, b: &PolygonMesh) -> bool {
    let polygons = a.positions.len() == b.positions.len() && a.starts == b.starts && a.corners == b.corners;
    polygons && (!a.corners.is_empty() || a.positions == b.positions)
}

/// Whether a file beside a mesh is one of its landmarks, by its name.
fn holds_landmarks(file: &Upload) -> bool {
    let endings = [".json", ".ljson", ".fcsv", ".pp", ".pts", ".lm3", ".csv", ".txt"];
    endings.iter().any(|ending| file.name.to_lowercase().ends_with(ending))
}

/// Of files that were added together, the one that the others belong to: a glTF file's buffers, an OBJ file's materials.
fn main_file(role: Role, files: &[Upload]) -> Result<String, Problem> {
    let side = [".bin", ".mtl", ".png", ".jpg", ".jpeg"];
    let lower = |f: &Upload| f.name.to_lowercase();
    let main: Vec<&Upload> =
        files.iter().filter(|f| files.len() == 1 || !side.iter().any(|s| lower(f).ends_with(s))).collect();
    match main[..] {
        [one] => Ok(one.name.clone()),
        _ if matches!(role, Role::Template | Role::Scan | Role::Rig) => {
            Err(problem("add one mesh at a time; a folder of several files is a rig"))
        }
        _ => Err(problem("add one file of this kind at a time")),
    }
}
