//! Meshes, scans and rigs of the vault, read once and shared by all windows; and what of them is shown.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use nonrigid::io::{self, FaceUnit, LengthUnit, MeshFile, Scan, face_extent, files_of_mesh};
use nonrigid::landmark::{TemplatePoint, read_landmark_set};
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3, surface_points};
use nonrigid::rig::{Regions, Rig, RigError, RigReadOptions, ShapeBasis, ShapeSelection};

use crate::case::{Case, Source, Unit};
use crate::error::{Problem, problem};
use crate::protocol::{Numbers, frame};
use crate::vault::Vault;

/// Triangles above which a mesh is thinned out for display.
const SHOWN_TRIANGLES: usize = 400_000;
/// Meshes that are kept.
const KEPT: usize = 12;
/// A rig's 68 landmarks.
pub const RIG_LANDMARKS: &str = "landmarks_multipie68.json";

/// A scan at work.
pub struct LoadedScan {
    /// Millimetres.
    pub scan: Scan,
    /// Its surface; `None` for a point cloud.
    pub surface: Option<ClosestPoint>,
}

/// A rig at work.
pub struct LoadedRig {
    /// Millimetres.
    pub rig: Rig,
    /// Its 68 landmarks, if it has them: where they are on the template.
    pub landmarks: Vec<(String, TemplatePoint)>,
}

/// What is read once.
#[derive(Default)]
pub struct Store {
    meshes: Shelf<Source, PolygonMesh>,
    scans: Shelf<Source, LoadedScan>,
    rigs: Shelf<(Source, u32), LoadedRig>,
}

/// The last things that were used.
struct Shelf<K, V>(Mutex<Uses<K, V>>);

/// A clock, and each thing with when it was used last.
struct Uses<K, V> {
    clock: u64,
    things: HashMap<K, (u64, Arc<V>)>,
}

impl<K, V> Default for Shelf<K, V> {
    fn default() -> Self {
        Self(Mutex::new(Uses { clock: 0, things: HashMap::new() }))
    }
}

impl<K: Clone + Eq + Hash, V> Shelf<K, V> {
    fn get(&self, key: &K, make: impl FnOnce() -> Result<V, Problem>) -> Result<Arc<V>, Problem> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = {
            let mut shelf = lock();
            shelf.clock += 1;
            let clock = shelf.clock;
            shelf.things.get_mut(key).map(|thing| {
                thing.0 = clock;
                thing.1.clone()
            })
        };
        if let Some(found) = found {
            return Ok(found);
        }
        // others may read meanwhile
        let made = Arc::new(make()?);
        let Uses { clock, things } = &mut *lock();
        things.insert(key.clone(), (*clock, made.clone()));
        while things.len() > KEPT {
            let oldest = things.iter().min_by_key(|e| e.1.0).map(|e| e.0.clone());
            oldest.and_then(|key| things.remove(&key));
        }
        Ok(made)
    }
}

fn unit_of(unit: LengthUnit) -> Unit {
    match unit {
        LengthUnit::Micrometre => Unit::Um,
        LengthUnit::Millimetre => Unit::Mm,
        LengthUnit::Centimetre => Unit::Cm,
        LengthUnit::Metre => Unit::M,
        LengthUnit::Inch => Unit::In,
    }
}

/// What the lengths of a file, as read, are multiplied by: readers have brought formats that state a unit to millimetres by it.
fn factor(path: &Path, unit: Unit) -> f64 {
    unit.length().millimetres() / LengthUnit::of_format(path).map_or(1.0, LengthUnit::millimetres)
}

/// The unit of points in a file, or the units that it may be in.
///
/// # Errors
/// With a sentence and the possible units.
pub fn guess_unit(path: &Path, points: &[Vec3]) -> Result<Unit, (String, Vec<Unit>)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if let Some(unit) = LengthUnit::of_format(path) {
        let extent = face_extent(points) / unit.millimetres();
        return match unit.instead_of(extent) {
            None => Ok(unit_of(unit)),
            Some(other) => {
                let text = format!(
                    "{name} is {extent:.0} {unit} across by its format, which no face or body is. In which unit is it?"
                );
                Err((text, vec![unit_of(other), unit_of(unit)]))
            }
        };
    }
    let extent = face_extent(points);
    match FaceUnit::of(extent) {
        FaceUnit::One(unit) | FaceUnit::Likely(unit, _) => Ok(unit_of(unit)),
        FaceUnit::Either(a, b) => {
            let text = format!("{name} is {extent:.3} across, which a face may be in {a} and in {b}. Which is it?");
            Err((text, vec![unit_of(a), unit_of(b)]))
        }
        FaceUnit::Unknown => {
            let text =
                format!("{name} is {extent:.3} across, which no face is in mm, cm, m or um. In which unit is it?");
            Err((text, vec![Unit::Mm, Unit::Cm, Unit::M, Unit::Um, Unit::In]))
        }
    }
}

/// Refuses a mesh that leads to files outside its own folder: a glTF file names its buffers itself.
///
/// # Errors
/// With the name.
pub fn check_inside(path: &Path) -> Result<(), Problem> {
    let folder = path.parent().unwrap_or(path);
    for file in files_of_mesh(path) {
        let inside = file.parent() == Some(folder) && !file.components().any(|c| c.as_os_str() == "..");
        if !inside {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            return Err(problem(format!(
                "{name} takes a buffer from another folder, which is not read here; save it as .glb, or add its files together"
            )));
        }
    }
    Ok(())
}

/// Reads the points of a mesh, for its unit.
///
/// # Errors
/// When it cannot be read.
pub fn points_of_mesh(path: &Path) -> Result<Vec<Vec3>, Problem> {
    check_inside(path)?;
    let MeshFile { mesh, .. } = io::read_mesh_file(path)?;
    Ok(surface_points(&mesh.positions, mesh.corners.iter().copied()).into_owned())
}

/// Reads the points of a rig, for its unit.
///
/// # Errors
/// When it cannot be read.
pub fn points_of_rig(path: &Path) -> Result<Vec<Vec3>, Problem> {
    check_rig_inside(path)?;
    let (rig, _) = Rig::read(path, &RigReadOptions::default()).map_err(problem)?;
    Ok(rig.surface_points().into_owned())
}

fn check_rig_inside(path: &Path) -> Result<(), Problem> {
    let files = if path.is_dir() {
        std::fs::read_dir(path)?.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>()?
    } else {
        vec![path.to_owned()]
    };
    files.iter().try_for_each(|file| check_inside(file))
}

impl Store {
    /// A mesh, millimetres.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn mesh(&self, vault: &Vault, source: &Source) -> Result<Arc<PolygonMesh>, Problem> {
        self.meshes.get(source, || {
            let path = vault.path(&source.at)?;
            check_inside(&path)?;
            let MeshFile { mut mesh, .. } = io::read_mesh_file(&path)?;
            let factor = factor(&path, source.unit);
            mesh.positions.iter_mut().for_each(|p| *p *= factor);
            Ok(mesh)
        })
    }

    /// A scan, millimetres.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn scan(&self, vault: &Vault, source: &Source) -> Result<Arc<LoadedScan>, Problem> {
        self.scans.get(source, || {
            let path = vault.path(&source.at)?;
            check_inside(&path)?;
            let mut scan = io::read_scan(&path)?;
            let factor = factor(&path, source.unit);
            scan.mesh.positions.iter_mut().for_each(|p| *p *= factor);
            let surface = (!scan.mesh.triangles.is_empty()).then(|| ClosestPoint::new(&scan.mesh)).transpose();
            Ok(LoadedScan { surface: surface.map_err(problem)?, scan })
        })
    }

    /// A rig with so many identity modes at most, millimetres.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn rig(&self, vault: &Vault, source: &Source, identity_modes: u32) -> Result<Arc<LoadedRig>, Problem> {
        self.rigs.get(&(source.clone(), identity_modes), || {
            let path = vault.path(&source.at)?;
            check_rig_inside(&path)?;
            let options = RigReadOptions { identity_modes: identity_modes as usize, kind: None };
            let (mut rig, _) = Rig::read(&path, &options).map_err(problem)?;
            rig.scale(factor(&path, source.unit));
            let file = path.join(RIG_LANDMARKS);
            let landmarks = match rig.mesh().filter(|_| file.exists()) {
                Some(mesh) => read_landmark_set(&file)?.on_template(&file, mesh)?,
                None => {
                    let numbered = rig.landmarks().unwrap_or_default().iter().enumerate();
                    numbered.map(|(n, vertex)| (n.to_string(), TemplatePoint::Vertex(*vertex))).collect()
                }
            };
            Ok(LoadedRig { rig, landmarks })
        })
    }

    /// The shapes of a case's rig for a mesh of it, with so many identity modes at most; none without a rig.
    ///
    /// # Errors
    /// When the rig cannot be read, or the mesh is none of it.
    pub fn shapes(
        &self,
        vault: &Vault,
        case: &Case,
        identity_modes: u32,
        mesh: &PolygonMesh,
    ) -> Result<ShapeBasis, Problem> {
        let Some(source) = &case.rig else { return Ok(ShapeBasis::none()) };
        let rig = self.rig(vault, source, identity_modes)?;
        let selection = ShapeSelection { names: None, identity_modes: rig.rig.identity_modes() };
        let selected = rig.rig.select_for(selection, FACE, &mesh.positions).map_err(not_of_the_rig)?;
        Ok(selected.0)
    }

    /// The regions of a case's rig on a mesh of it, or the groups of a mesh.
    ///
    /// # Errors
    /// When the rig cannot be read, or the mesh is none of it.
    pub fn regions(&self, vault: &Vault, case: &Case, mesh: &PolygonMesh) -> Result<Regions, Problem> {
        let rig = case.rig.as_ref().map(|source| self.rig(vault, source, 0)).transpose()?;
        if let Some(rig) = &rig {
            rig.rig.check_subject(FACE, &mesh.positions).map_err(not_of_the_rig)?;
        }
        Ok(Regions::of(rig.as_ref().map(|rig| &rig.rig), mesh))
    }

    /// The face that plans change: the wrapped template, or else the template.
    ///
    /// # Errors
    /// When the case has neither, or it cannot be read.
    pub fn face(&self, vault: &Vault, case: &Case) -> Result<Arc<PolygonMesh>, Problem> {
        self.mesh(vault, &face_source(case)?)
    }
}

/// Where the face is that plans change.
///
/// # Errors
/// When there is none.
pub fn face_source(case: &Case) -> Result<Source, Problem> {
    let wrapped =
        case.wrapped.as_ref().map(|w| Source { at: w.mesh.clone(), name: "wrapped".to_owned(), unit: Unit::Mm });
    wrapped
        .or_else(|| case.template.clone())
        .ok_or_else(|| problem("the case has no face yet: add a template or a rig"))
}

/// What messages call the mesh that a rig is for.
const FACE: &str = "the face";

fn not_of_the_rig(error: RigError) -> Problem {
    problem(format!("{error}; add the rig's own template"))
}

fn bytes_of<const N: usize>(numbers: impl Iterator<Item = [u8; N]>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(N * numbers.size_hint().0);
    numbers.for_each(|number| bytes.extend_from_slice(&number));
    bytes
}

fn position_bytes(positions: &[Vec3]) -> Vec<u8> {
    bytes_of(positions.iter().flat_map(|p| [p.x, p.y, p.z]).map(|x| (x as f32).to_le_bytes()))
}

/// Positions on the triangles of another slot.
#[must_use]
pub fn positions_frame(slot: &str, positions: &[Vec3]) -> Vec<u8> {
    let header = Numbers::Positions { slot: slot.to_owned(), vertices: positions.len() as u32 };
    frame(&header, &[&position_bytes(positions)])
}

/// Values on the vertices of a slot.
#[must_use]
pub fn values_frame(slot: &str, title: &str, values: &[f64], low: f64, high: f64) -> Vec<u8> {
    let header = Numbers::Values {
        slot: slot.to_owned(),
        title: title.to_owned(),
        vertices: values.len() as u32,
        low: low as f32,
        high: high as f32,
    };
    frame(&header, &[&bytes_of(values.iter().map(|x| (*x as f32).to_le_bytes()))])
}

/// An empty slot.
#[must_use]
pub fn clear_frame(slot: &str) -> Vec<u8> {
    frame(&Numbers::Clear { slot: slot.to_owned() }, &[])
}

/// A mesh with the edges of its polygons, all of it.
#[must_use]
pub fn mesh_frame(slot: &str, mesh: &PolygonMesh) -> Vec<u8> {
    let mut edges = HashSet::new();
    let mut lines = Vec::new();
    for f in 0..mesh.polygon_count() {
        let corners = mesh.polygon(f);
        for (k, &a) in corners.iter().enumerate() {
            let b = corners[(k + 1) % corners.len()];
            if edges.insert([a.min(b), a.max(b)]) {
                lines.push([a, b]);
            }
        }
    }
    let triangles = mesh.triangulate();
    encode(slot, &triangles, &lines, None, triangles.triangles.len())
}

/// A scan, thinned out for display where it is big.
#[must_use]
pub fn scan_frame(slot: &str, scan: &Scan) -> Vec<u8> {
    let of = scan.mesh.triangles.len();
    let points = scan.mesh.positions.len();
    if of <= SHOWN_TRIANGLES && (of > 0 || points <= SHOWN_TRIANGLES) {
        return encode(slot, &scan.mesh, &[], scan.colors.as_deref(), of);
    }
    let (mesh, colors) = thinned(scan, SHOWN_TRIANGLES);
    encode(slot, &mesh, &[], colors.as_deref(), of.max(points))
}

fn encode(slot: &str, mesh: &TriangleMesh, lines: &[[u32; 2]], colors: Option<&[[u8; 3]]>, of: usize) -> Vec<u8> {
    let header = Numbers::Mesh {
        slot: slot.to_owned(),
        vertices: mesh.positions.len() as u32,
        triangles: mesh.triangles.len() as u32,
        lines: lines.len() as u32,
        colors: colors.is_some(),
        of: of as u32,
    };
    let triangles = bytes_of(mesh.triangles.iter().flatten().map(|v| v.to_le_bytes()));
    let lines = bytes_of(lines.iter().flatten().map(|v| v.to_le_bytes()));
    frame(&header, &[&position_bytes(&mesh.positions), &triangles, &lines, colors.unwrap_or_default().as_flattened()])
}

/// Vertices that share a cell of a grid become one, the first of them; the grid is as fine as `most` triangles allow.
fn thinned(scan: &Scan, most: usize) -> (TriangleMesh, Option<Vec<[u8; 3]>>) {
    let positions = &scan.mesh.positions;
    let [mut low, mut high] = [Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)];
    for p in positions {
        (low, high) = (low.inf(p), high.sup(p));
    }
    let size = (high - low).max().max(1e-9);
    // a surface of n triangles meets about n / 2 cells
    let mut cells = (most as f64 / 2.0).sqrt() * 1.2;
    loop {
        let cell = size / cells;
        let mut first: HashMap<[i32; 3], u32> = HashMap::new();
        let mut kept = Vec::new();
        let mut colors = scan.colors.as_ref().map(|_| Vec::new());
        let of: Vec<u32> = positions
            .iter()
            .enumerate()
            .map(|(v, p)| {
                let key = ((p - low) / cell).map(|x| x.floor() as i32).into();
                *first.entry(key).or_insert_with(|| {
                    kept.push(*p);
                    colors.iter_mut().zip(&scan.colors).for_each(|(out, all)| out.push(all[v]));
                    kept.len() as u32 - 1
                })
            })
            .collect();
        let mut triangles: Vec<[u32; 3]> = scan.mesh.triangles.iter().map(|t| t.map(|v| of[v as usize])).collect();
        triangles.retain(|[a, b, c]| a != b && b != c && c != a);
        triangles.sort_unstable();
        triangles.dedup();
        if triangles.len() <= most && kept.len() <= most {
            return (TriangleMesh { positions: kept, triangles }, colors);
        }
        cells *= 0.8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_big_scan_is_shown_thinned_out() {
        let n = 300u32;
        let positions = (0..n * n).map(|i| Vec3::new(f64::from(i % n), f64::from(i / n), 0.0)).collect();
        let at = |x: u32, y: u32| y * n + x;
        let quads = (0..n - 1).flat_map(|y| (0..n - 1).map(move |x| (x, y)));
        let triangles = quads.flat_map(|(x, y)| {
            [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]]
        });
        let mesh = TriangleMesh { positions, triangles: triangles.collect() };
        let scan = Scan { mesh, normals: None, colors: Some(vec![[1, 2, 3]; (n * n) as usize]) };
        let (thin, colors) = thinned(&scan, 20_000);
        assert!((5_000..=20_000).contains(&thin.triangles.len()), "{}", thin.triangles.len());
        assert_eq!(colors.unwrap().len(), thin.positions.len());
        thin.check_indices().unwrap();
    }
}
