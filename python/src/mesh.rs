//! Meshes, point clouds, and the unit and files that they came from.

use std::ffi::OsString;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use nonrigid::io::{
    self, FaceUnit, FilePlan, Input, Inputs, KnownUnit, LengthUnit, MaterialFiles, MeshFile, ReadError, UnitSource,
    absolute, face_extent, read_mesh_file, write_atomically,
};
use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3, surface_points};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{abandonable, compute, in_python, input, value};

/// What a file said of its unit, and by what its lengths were multiplied.
pub struct Measured {
    pub known: KnownUnit,
    pub factor: f64,
    /// Another unit that it could be in, or is.
    pub note: Option<String>,
}

/// The unit of lengths that were read from `path`: as asked, as its format states, or the one in which they have the size of a face.
pub fn measured(path: &Path, points: &[Vec3], asked: Option<LengthUnit>) -> PyResult<Measured> {
    let of_format = LengthUnit::of_format(path);
    let mut note = None;
    let known = match (asked, of_format) {
        (Some(unit), _) => KnownUnit { unit, by: UnitSource::Option },
        (None, Some(unit)) => {
            let extent = face_extent(points) / unit.millimetres();
            note = unit.misfit(path.display(), extent, |other| format!("unit=\"{other}\""));
            KnownUnit { unit, by: UnitSource::File }
        }
        (None, None) => {
            let extent = face_extent(points);
            let at = path.display();
            let mm = |unit: LengthUnit| extent * unit.millimetres();
            let unit = match FaceUnit::of(extent) {
                FaceUnit::One(unit) => unit,
                FaceUnit::Likely(unit, other) => {
                    note = Some(format!(
                        "{at} is taken for {:.0} mm across, in {unit}; if it is in {other}, {:.0} mm, say unit=\"{other}\"",
                        mm(unit),
                        mm(other)
                    ));
                    unit
                }
                FaceUnit::Either(a, b) => {
                    let (of_a, of_b) = (mm(a), mm(b));
                    return Err(value(format!(
                        "{at}: {extent:.3} across, which a face may be in {a} ({of_a:.0} mm) and in {b} ({of_b:.0} mm); say unit=\"{a}\" \
                         or unit=\"{b}\""
                    )));
                }
                FaceUnit::Unknown => {
                    return Err(value(format!(
                        "{at}: {extent:.3} across, which no face is in mm, cm, m or um; say its unit, such as unit=\"mm\""
                    )));
                }
            };
            KnownUnit { unit, by: UnitSource::Size }
        }
    };
    // readers have brought formats that state a unit to millimetres by it
    let factor = known.unit.millimetres() / of_format.map_or(1.0, LengthUnit::millimetres);
    Ok(Measured { known, factor, note })
}

/// A unit by name; `None` is to be found.
pub fn unit(name: Option<&str>) -> PyResult<Option<LengthUnit>> {
    match name {
        None | Some("auto") => Ok(None),
        Some(name) => name.parse().map(Some).map_err(|e| value(format!("unit: {e}, or auto"))),
    }
}

/// A mesh or a point cloud, millimetres, with the files that it came from.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Mesh {
    pub file: MeshFile,
    pub known: Option<KnownUnit>,
    pub files: Vec<Input>,
    pub path: PathBuf,
    /// The file that it was made of, whose materials go along where it is written; empty for none.
    pub materials: PathBuf,
    pub note: Option<String>,
}

impl Mesh {
    pub fn of_arrays(file: MeshFile) -> Self {
        Self { file, known: None, files: Vec::new(), path: PathBuf::new(), materials: PathBuf::new(), note: None }
    }

    /// Positions, polygons and what else an OBJ file holds.
    pub fn polygons(&self) -> &PolygonMesh {
        &self.file.mesh
    }
}

/// Where a mesh comes from, for a copy or a pickle: path, the file whose materials go along, files with their SHA-256, unit and how it is
/// known.
type Source = (OsString, OsString, Files, Option<(String, String)>);
/// Files and their SHA-256.
pub type Files = Vec<(OsString, String)>;

/// How a unit is known, by name.
const UNIT_SOURCES: [(&str, UnitSource); 4] = [
    ("option", UnitSource::Option),
    ("file", UnitSource::File),
    ("size", UnitSource::Size),
    ("mesh", UnitSource::Mesh),
];

/// Names of a unit and of how it is known.
pub fn names_of_unit(known: KnownUnit) -> Option<(String, String)> {
    let (name, _) = UNIT_SOURCES.iter().find(|(_, by)| *by == known.by)?;
    Some((known.unit.to_string(), (*name).to_owned()))
}

/// A unit and how it is known, for users.
pub fn unit_text(known: KnownUnit) -> String {
    in_python(&known.to_string())
}

/// [`names_of_unit`], the other way.
pub fn unit_of_names((unit, by): (String, String)) -> PyResult<KnownUnit> {
    let source = UNIT_SOURCES.iter().find(|(name, _)| *name == by).ok_or_else(|| value(format!("unit by {by:?}")))?;
    Ok(KnownUnit { unit: unit.parse().map_err(value)?, by: source.1 })
}

/// Files as a pickle has them.
pub fn files_out(files: &[Input]) -> Files {
    files.iter().map(|file| (file.path.clone().into(), file.sha256.clone())).collect()
}

/// [`files_out`], the other way.
pub fn files_in(files: Files) -> Vec<Input> {
    let input = |(path, sha256): (OsString, String)| Input { role: String::new(), path: path.into(), sha256 };
    files.into_iter().map(input).collect()
}

/// Refuses to overwrite files beside an output that are [somebody else's](MaterialFiles::is_foreign).
pub fn refuse_beside(out: &Path, materials: &MaterialFiles) -> PyResult<()> {
    match materials.writes(out).iter().find(|file| materials.is_foreign(out, file)) {
        None => Ok(()),
        Some(file) => {
            let message = format!("{}: is there already, and would be overwritten", file.display());
            Err(value(format!("{message}; move it away, or give another name")))
        }
    }
}

/// Texture coordinates, indices of texture and of normal of each corner, material libraries, statements with the polygon before which each stands.
type Metadata<'py> =
    (Bound<'py, PyArray2<f64>>, [Bound<'py, PyArray1<u32>>; 2], Vec<String>, Vec<(u32, &'static str, String)>);

#[pymethods]
impl Mesh {
    #[staticmethod]
    #[pyo3(signature = (path, unit=None))]
    fn read(py: Python<'_>, path: PathBuf, unit: Option<&str>) -> PyResult<Self> {
        let asked = self::unit(unit)?;
        abandonable(py, Some(1), move || {
            let inputs = Inputs::default();
            let mut file = inputs.reading("", || read_mesh_file(&path)).map_err(input)?;
            let points = surface_points(&file.mesh.positions, file.mesh.corners.iter().copied());
            let Measured { known, factor, note } = measured(&path, &points, asked)?;
            drop(points);
            file.mesh.positions.iter_mut().for_each(|p| *p *= factor);
            let path = absolute(&path);
            Ok(Self { file, known: Some(known), files: inputs.files(), materials: path.clone(), path, note })
        })
    }

    /// Positions alone, from an N x 3 array (.npy).
    #[staticmethod]
    #[pyo3(signature = (path, unit=None))]
    fn read_points(py: Python<'_>, path: PathBuf, unit: Option<&str>) -> PyResult<Self> {
        let asked = self::unit(unit)?;
        abandonable(py, Some(1), move || {
            let inputs = Inputs::default();
            let mut positions = inputs.reading("", || io::read_npy_points(&path)).map_err(input)?;
            let Measured { known, factor, note } = measured(&path, &positions, asked)?;
            positions.iter_mut().for_each(|p| *p *= factor);
            let file = MeshFile { mesh: PolygonMesh { positions, ..PolygonMesh::default() }, ..MeshFile::default() };
            Ok(Self { known: Some(known), files: inputs.files(), path: absolute(&path), note, ..Self::of_arrays(file) })
        })
    }

    #[staticmethod]
    #[pyo3(signature = (positions, starts, corners, normals=None, colors=None, metadata=None, source=None))]
    fn of(
        positions: PyReadonlyArray2<'_, f64>,
        starts: PyReadonlyArray1<'_, u32>,
        corners: PyReadonlyArray1<'_, u32>,
        normals: Option<PyReadonlyArray2<'_, f64>>,
        colors: Option<PyReadonlyArray2<'_, u8>>,
        metadata: Option<(
            PyReadonlyArray2<'_, f64>,
            [PyReadonlyArray1<'_, u32>; 2],
            Vec<String>,
            Vec<(u32, String, String)>,
        )>,
        source: Option<Source>,
    ) -> PyResult<Self> {
        let positions = arrays::points("vertices", &positions)?;
        let (starts, corners) = (starts.as_array().to_vec(), corners.as_array().to_vec());
        if let Some(v) = corners.iter().find(|v| **v as usize >= positions.len()) {
            return Err(value(format!("faces: vertex {v}, but there are {} vertices, from 0", positions.len())));
        }
        let whole = starts.first().is_none_or(|s| *s == 0) && starts.is_sorted();
        if !whole || starts.last().copied().unwrap_or(0) as usize != corners.len() {
            return Err(value("faces: starts must rise from 0 to the number of corners"));
        }
        if let Some(f) = starts.windows(2).position(|pair| pair[1] - pair[0] < 3) {
            return Err(value(format!("faces: polygon {f} has fewer than three corners")));
        }
        let same = |what: &str, found: usize| match found == positions.len() {
            true => Ok(()),
            false => {
                Err(value(format!("{what}: expected one for each of {} vertices, found {found}", positions.len())))
            }
        };
        let normals = normals.map(|n| arrays::points("normals", &n)).transpose()?;
        let colors = colors.map(|c| arrays::colors("colors", &c)).transpose()?;
        normals.as_ref().map_or(Ok(()), |n| same("normals", n.len()))?;
        colors.as_ref().map_or(Ok(()), |c| same("colors", c.len()))?;
        let metadata = match metadata {
            None => ObjMetadata::default(),
            Some((uvs, indices, material_libraries, statements)) => {
                let uvs: Vec<[f64; 2]> = uvs.as_array().rows().into_iter().map(|t| [t[0], t[1]]).collect();
                let [corner_uvs, corner_normals] = indices.map(|of_corner| of_corner.as_array().to_vec());
                let beyond = corner_uvs.iter().any(|t| *t != u32::MAX && *t as usize >= uvs.len());
                if beyond || !(corner_uvs.is_empty() || corner_uvs.len() == corners.len()) {
                    return Err(value("corner_uvs: expected an index into uvs for every corner of a face"));
                }
                if !(corner_normals.is_empty() || corner_normals.len() == corners.len()) {
                    return Err(value("corner_normals: expected an index for every corner of a face"));
                }
                let statements = statements.into_iter().map(|(at, keyword, rest)| Ok((at, statement(&keyword, rest)?)));
                let statements = statements.collect::<PyResult<_>>()?;
                ObjMetadata { uvs, corner_uvs, corner_normals, material_libraries, statements }
            }
        };
        let file = MeshFile { mesh: PolygonMesh { positions, starts, corners, metadata }, normals, colors };
        let Some((path, materials, files, known)) = source else { return Ok(Self::of_arrays(file)) };
        let known = known.map(unit_of_names).transpose()?;
        let (path, materials) = (path.into(), materials.into());
        Ok(Self { known, files: files_in(files), path, materials, ..Self::of_arrays(file) })
    }

    /// For a copy or a pickle.
    #[getter]
    fn source(&self) -> Source {
        let known = self.known.and_then(names_of_unit);
        (self.path.clone().into(), self.materials.clone().into(), files_out(&self.files), known)
    }

    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, &self.file.mesh.positions)
    }

    #[getter]
    fn starts<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        self.file.mesh.starts.clone().into_pyarray(py)
    }

    #[getter]
    fn corners<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        self.file.mesh.corners.clone().into_pyarray(py)
    }

    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let triangles = self.file.mesh.triangulate().triangles;
        PyArray1::from_vec(py, triangles.as_flattened().to_vec()).reshape([triangles.len(), 3])
    }

    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.file.normals.as_ref().map(|n| arrays::from_points(py, n)).transpose()
    }

    #[getter]
    fn colors<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        self.file.colors.as_ref().map(|c| arrays::from_colors(py, c)).transpose()
    }

    #[getter]
    fn metadata<'py>(&self, py: Python<'py>) -> PyResult<Metadata<'py>> {
        let ObjMetadata { uvs, corner_uvs, corner_normals, material_libraries, statements } = &self.file.mesh.metadata;
        let array = PyArray1::from_vec(py, uvs.as_flattened().to_vec()).reshape([uvs.len(), 2])?;
        let statements = statements.iter().map(|(at, s)| {
            let (keyword, rest) = parts(s);
            (*at, keyword, rest.to_owned())
        });
        let indices = [corner_uvs, corner_normals].map(|of_corner| of_corner.clone().into_pyarray(py));
        Ok((array, indices, material_libraries.clone(), statements.collect()))
    }

    /// Groups by name: the polygons of each.
    #[getter]
    fn groups(&self) -> Vec<(String, (usize, usize))> {
        self.file.mesh.groups().map(|(names, range)| (names.to_owned(), (range.start, range.end))).collect()
    }

    /// The file, or an empty path.
    #[getter]
    fn path(&self) -> OsString {
        self.path.clone().into()
    }

    /// Unit of the file, and how it is known.
    #[getter]
    fn unit(&self) -> Option<String> {
        self.known.map(unit_text)
    }

    #[getter]
    fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// Files that it was read from.
    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }

    #[pyo3(signature = (positions, colors=None))]
    fn with_positions(
        &self,
        positions: PyReadonlyArray2<'_, f64>,
        colors: Option<PyReadonlyArray2<'_, u8>>,
    ) -> PyResult<Self> {
        let positions = arrays::points("vertices", &positions)?;
        let (found, expected) = (positions.len(), self.file.mesh.positions.len());
        if found != expected {
            return Err(value(format!("vertices: found {found}, the mesh has {expected}; they must correspond")));
        }
        let colors = colors.map(|c| arrays::colors("colors", &c)).transpose()?;
        let file = MeshFile { mesh: self.file.mesh.with_positions(positions), normals: None, colors };
        Ok(Self { materials: self.materials.clone(), ..Self::of_arrays(file) })
    }

    /// Writes by extension: .obj, with copies of materials and images, .ply, .glb, .usda. `reads` are files that must not be overwritten.
    /// Returns what is to be said of that.
    fn write(&self, py: Python<'_>, path: PathBuf, reads: Vec<PathBuf>) -> PyResult<Vec<String>> {
        compute(py, Some(1), || {
            let is = |extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
            let of_file = !self.materials.as_os_str().is_empty();
            let mut mesh = self.file.mesh.clone();
            if !of_file {
                mesh.metadata.material_libraries.clear(); // they are nowhere
            }
            let materials =
                if is("obj") { MaterialFiles::of(&self.materials, &mesh) } else { MaterialFiles::default() };
            let writes: Vec<PathBuf> = std::iter::once(path.clone()).chain(materials.writes(&path)).collect();
            // a mesh that was made of another does not overwrite that either
            let made_of = Some(&self.materials).filter(|_| of_file);
            let reads: Vec<PathBuf> = reads.iter().chain(made_of).chain(materials.reads()).cloned().collect();
            check_plan(&reads, &writes)?;
            refuse_beside(&path, &materials)?;
            let mut notes: Vec<String> = materials.missing.iter().map(|(_, told)| told.clone()).collect();
            let copied = materials.write(&path, &mut mesh).map_err(input)?;
            let (colors, normals) = (self.file.colors.as_deref(), self.file.normals.as_deref());
            if is("ply") {
                let options = io::PlyOptions { normals, colors, precision: io::PlyPrecision::Double };
                io::write_ply_polygons(&path, &mesh, options).map_err(input)?;
            } else {
                io::write_colored_mesh(&path, &mesh, colors).map_err(input)?;
                if normals.is_some() && mesh.corners.is_empty() {
                    notes.push(format!("{}: this format holds no normals of a point cloud; .ply does", path.display()));
                }
            }
            copied.keep();
            Ok(notes)
        })
    }
}

fn parts(statement: &ObjStatement) -> (&'static str, &str) {
    match statement {
        ObjStatement::Object(rest) => ("o", rest),
        ObjStatement::Group(rest) => ("g", rest),
        ObjStatement::Material(rest) => ("usemtl", rest),
        ObjStatement::Smoothing(rest) => ("s", rest),
    }
}

fn statement(keyword: &str, rest: String) -> PyResult<ObjStatement> {
    Ok(match keyword {
        "o" => ObjStatement::Object(rest),
        "g" => ObjStatement::Group(rest),
        "usemtl" => ObjStatement::Material(rest),
        "s" => ObjStatement::Smoothing(rest),
        _ => return Err(value(format!("no statement {keyword:?}; there are o, g, usemtl and s"))),
    })
}

/// Refuses outputs that would overwrite what was read, or each other.
pub fn check_plan(reads: &[PathBuf], writes: &[PathBuf]) -> PyResult<()> {
    let plan = FilePlan::new().reads_all(reads.iter().map(|path| ("input", path)));
    plan.writes_all(writes.iter().map(|path| ("output", path))).check().map_err(input)
}

/// What a mesh file names and is not there, as named: buffers, material libraries, images; `<UDIM>` stands for tiles.
#[pyfunction]
fn missing_files(path: PathBuf) -> Vec<PathBuf> {
    let painted = io::files_of_painted_mesh(&path).into_iter().filter(|file| !file.exists());
    painted.chain(MaterialFiles::named_in(&path).missing.into_iter().map(|(file, _)| file)).collect()
}

/// Writes text, all of it or nothing; `reads` are files that must not be overwritten.
#[pyfunction]
fn write_text(py: Python<'_>, path: PathBuf, text: &str, reads: Vec<PathBuf>) -> PyResult<()> {
    compute(py, Some(1), || {
        check_plan(&reads, std::slice::from_ref(&path))?;
        write_atomically(&path, |out| out.write_all(text.as_bytes())).map_err(input)
    })
}

/// Refuses outputs that would overwrite what was read, or each other.
#[pyfunction]
#[pyo3(name = "check_plan")]
fn check_files(reads: Vec<PathBuf>, writes: Vec<PathBuf>) -> PyResult<()> {
    check_plan(&reads, &writes)
}

/// How many millimetres a unit is.
#[pyfunction]
fn millimetres(unit: &str) -> PyResult<f64> {
    unit.parse::<LengthUnit>().map(LengthUnit::millimetres).map_err(|e| value(format!("unit: {e}")))
}

/// What lengths that were read from `path` are multiplied by to be millimetres, what should be said about that, and names of their unit
/// and of how it is known.
#[pyfunction]
#[pyo3(signature = (path, points, unit=None))]
fn unit_of(
    path: PathBuf,
    points: PyReadonlyArray2<'_, f64>,
    unit: Option<&str>,
) -> PyResult<(f64, Option<String>, Option<(String, String)>)> {
    let Measured { known, note, .. } = measured(&path, &arrays::points("vertices", &points)?, self::unit(unit)?)?;
    Ok((known.unit.millimetres(), note, names_of_unit(known)))
}

/// Files that were read by others, as inputs.
pub fn hashed(files: Vec<PathBuf>) -> PyResult<Vec<Input>> {
    let hashed = files.into_iter().map(|path| {
        let sha256 = io::sha256_of_file(&path).map_err(|source| ReadError::Io { path: path.clone(), source })?;
        Ok(Input { role: String::new(), path: absolute(&path), sha256 })
    });
    hashed.collect::<Result<_, ReadError>>().map_err(input)
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Mesh>()?;
    module.add_function(wrap_pyfunction!(millimetres, module)?)?;
    module.add_function(wrap_pyfunction!(unit_of, module)?)?;
    module.add_function(wrap_pyfunction!(write_text, module)?)?;
    module.add_function(wrap_pyfunction!(missing_files, module)?)?;
    module.add_function(wrap_pyfunction!(check_files, module)?)
}
