//! Blendshape rigs: read, made of arrays, written, transferred, fitted, and found by principal components.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use nonrigid::io::{Input, Inputs, KnownUnit, LengthUnit, absolute};
use nonrigid::mesh::{PoseKind, Vec3};
use nonrigid::rig::{
    self, COMPONENT_FILES, Companions, Family, NAMED_LANDMARKS, Population, RIG_FILES, Regions, RigForm,
    RigReadOptions, Shape, ShapeKind, ShapePca, ShapeSelection, TransferError, TransferOptions, WeightFitOptions,
    WeightFitter,
};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArray3, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{abandonable, computation, compute, guarded, input, interruptible, value};
use crate::mesh::{
    Files, Measured, Mesh, check_plan, files_in, files_out, hashed, measured, names_of_unit, refuse_beside,
    unit_of_names, unit_text,
};

/// A rig, millimetres, with the files that it came from.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Rig {
    pub rig: rig::Rig,
    pub known: Option<KnownUnit>,
    pub files: Vec<Input>,
    /// What goes along where it is written.
    pub companions: Companions,
    /// Components that it was made of.
    pca: Option<ShapePca>,
    /// Files of the rig or the meshes that it was made of, which it does not overwrite.
    made_of: Vec<PathBuf>,
    notes: Vec<String>,
}

impl Rig {
    /// A rig of arrays.
    pub fn of_rig(rig: rig::Rig, notes: Vec<String>) -> Self {
        let (known, companions, pca) = (None, Companions::default(), None);
        Self { rig, known, files: Vec::new(), companions, pca, made_of: Vec::new(), notes }
    }

    /// Every file that it came from.
    fn origins(&self) -> impl Iterator<Item = &PathBuf> {
        self.files.iter().map(|file| &file.path).chain(&self.made_of)
    }
}

/// What a rig has besides shapes, for a copy or a pickle: files; files that it was made of; unit; the mesh of its materials; landmarks
/// beside it; components, standard deviations and the variance of all.
type Kept<'py> = (
    Files,
    Vec<OsString>,
    Option<(String, String)>,
    OsString,
    Vec<(OsString, Option<Vec<u8>>)>,
    Option<(Bound<'py, PyArray1<f64>>, Vec<f64>, f64)>,
);

fn family(name: &str) -> PyResult<Family> {
    match name {
        "expression" => Ok(Family::Expression),
        "identity" => Ok(Family::Identity),
        "other" => Ok(Family::Other),
        _ => Err(value(format!("families: {name:?}; there are \"expression\", \"identity\" and \"other\""))),
    }
}

fn pose_kind(align: &str) -> PyResult<Option<PoseKind>> {
    match align {
        "rigid" => Ok(Some(PoseKind::Rigid)),
        "similarity" => Ok(Some(PoseKind::Similarity)),
        "none" => Ok(None),
        _ => Err(value(format!("align: {align:?}; there are \"rigid\", \"similarity\" and \"none\""))),
    }
}

/// What a fit found in one frame: weights, scale, rotation (row by row), translation, rms, max, converged, doubts.
type Frame = (Vec<f64>, f64, [[f64; 3]; 3], [f64; 3], f64, f64, bool, Vec<String>);

#[pymethods]
impl Rig {
    #[staticmethod]
    #[pyo3(signature = (path, identity_modes=None, kind=None, unit=None))]
    fn read(
        py: Python<'_>,
        path: PathBuf,
        identity_modes: Option<usize>,
        kind: Option<&str>,
        unit: Option<&str>,
    ) -> PyResult<Self> {
        let kind = match kind {
            None => None,
            Some("full") => Some(ShapeKind::Full),
            Some("delta") => Some(ShapeKind::Delta),
            Some(other) => return Err(value(format!("shape_kind: {other:?}; there are \"full\" and \"delta\""))),
        };
        let asked: Option<LengthUnit> = crate::mesh::unit(unit)?;
        abandonable(py, None, move || {
            let inputs = Inputs::default();
            let options = RigReadOptions { identity_modes: identity_modes.unwrap_or(usize::MAX), kind };
            let (mut rig, warnings) = inputs.reading("", || rig::Rig::read(&path, &options)).map_err(input)?;
            let Measured { known, factor, note } = measured(&path, &rig.surface_points(), asked)?;
            rig.scale(factor);
            let notes = warnings.iter().map(ToString::to_string).chain(note).collect();
            let companions = Companions::of(&absolute(&path));
            Ok(Self { known: Some(known), files: inputs.files(), companions, ..Self::of_rig(rig, notes) })
        })
    }

    /// `deltas`: shape by shape, vertex by vertex, x y z.
    #[staticmethod]
    #[pyo3(signature = (neutral, mesh, names, families, deltas, landmarks, regions, files, known=None, kept=None))]
    fn of(
        neutral: PyReadonlyArray2<'_, f64>,
        mesh: Option<&Mesh>,
        names: Vec<String>,
        families: Vec<String>,
        deltas: PyReadonlyArray1<'_, f32>,
        landmarks: Option<Vec<u32>>,
        regions: Option<Vec<(String, Vec<u32>)>>,
        files: Vec<PathBuf>,
        known: Option<(String, String)>,
        kept: Option<Kept<'_>>,
    ) -> PyResult<Self> {
        let neutral = arrays::points("neutral", &neutral)?;
        let families: Vec<Family> = families.iter().map(|f| family(f)).collect::<PyResult<_>>()?;
        if families.len() != names.len() {
            return Err(value(format!("{} names, but {} families", names.len(), families.len())));
        }
        let shapes = names.into_iter().zip(families).map(|(name, family)| Shape { name, family }).collect();
        let (vertices, deltas) = (neutral.len(), deltas.as_array().to_vec());
        let materials = mesh.map(|m| m.materials.clone()).unwrap_or_default();
        let mesh = mesh.map(|m| m.polygons().clone());
        let (mut rig, warnings) = guarded(|| rig::Rig::new(neutral, mesh, shapes, deltas).map_err(input))?;
        if let Some(regions) = regions {
            rig = rig.with_regions(Regions::new(vertices, regions).map_err(input)?).map_err(input)?;
        }
        if let Some(landmarks) = landmarks {
            rig = rig.with_landmarks(landmarks).map_err(input)?;
        }
        let notes = warnings.iter().map(ToString::to_string).collect();
        let Some((files, made_of, known, mesh, landmarks, pca)) = kept else {
            let companions = Companions { mesh: materials, ..Companions::default() };
            let known = known.map(unit_of_names).transpose()?;
            return Ok(Self { known, files: hashed(files)?, companions, ..Self::of_rig(rig, notes) });
        };
        let pca = pca.map(|(components, deviations, total)| {
            let components = components.readonly().as_array().to_vec();
            ShapePca::of_parts(rig.neutral().to_vec(), components, deviations, total).map_err(input)
        });
        let landmarks = landmarks.into_iter().map(|(path, text)| (path.into(), text)).collect();
        Ok(Self {
            known: known.map(unit_of_names).transpose()?,
            files: files_in(files),
            companions: Companions { mesh: mesh.into(), landmarks },
            pca: pca.transpose()?,
            made_of: made_of.into_iter().map(PathBuf::from).collect(),
            ..Self::of_rig(rig, notes)
        })
    }

    /// For a copy or a pickle.
    #[getter]
    fn kept<'py>(&self, py: Python<'py>) -> Kept<'py> {
        let landmarks =
            self.companions.landmarks.iter().map(|(path, text)| (path.clone().into(), text.clone())).collect();
        let pca = self.pca.as_ref().map(|pca| {
            let components = pca.components().to_vec().into_pyarray(py);
            (components, pca.standard_deviations().to_vec(), pca.total_variance())
        });
        let made_of = self.made_of.iter().map(|path| path.clone().into()).collect();
        let known = self.known.and_then(names_of_unit);
        (files_out(&self.files), made_of, known, self.companions.mesh.clone().into(), landmarks, pca)
    }

    #[getter]
    fn neutral<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, self.rig.neutral())
    }

    #[getter]
    fn mesh(&self) -> Option<Mesh> {
        let mesh = self.rig.mesh()?.clone();
        let materials = self.companions.mesh.clone();
        Some(Mesh { known: self.known, materials, ..Mesh::of_arrays(mesh.into()) })
    }

    #[getter]
    fn names(&self) -> Vec<String> {
        self.rig.shapes().iter().map(|s| s.name.clone()).collect()
    }

    #[getter]
    fn families(&self) -> Vec<&'static str> {
        let name = |family| match family {
            Family::Expression => "expression",
            Family::Identity => "identity",
            Family::Other => "other",
        };
        self.rig.shapes().iter().map(|s| name(s.family)).collect()
    }

    #[getter]
    fn deltas<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (shapes, vertices) = (self.rig.shapes().len(), self.rig.neutral().len());
        let all: Vec<f32> = (0..shapes).flat_map(|k| self.rig.deltas(k)).copied().collect();
        PyArray1::from_vec(py, all).reshape([shapes, vertices, 3])
    }

    #[getter]
    fn landmarks(&self) -> Option<Vec<u32>> {
        self.rig.landmarks().map(<[u32]>::to_vec)
    }

    #[getter]
    fn regions<'py>(&self, py: Python<'py>) -> Option<Vec<(String, Bound<'py, PyArray1<u32>>)>> {
        let regions = self.rig.regions()?;
        let vertices = |name: &str| regions.vertices(name).unwrap_or_default().to_vec().into_pyarray(py);
        Some(regions.names().map(|name| (name.to_owned(), vertices(name))).collect())
    }

    #[getter]
    fn unit(&self) -> Option<String> {
        self.known.map(unit_text)
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }

    /// `form`: folder, shapes, npz or gltf. Returns what is to be said of that.
    fn write(&self, py: Python<'_>, path: PathBuf, form: &str) -> PyResult<Vec<String>> {
        let form = match form {
            "folder" => RigForm::Arrays,
            "shapes" => RigForm::Meshes,
            "npz" => RigForm::Npz,
            "gltf" => RigForm::Gltf,
            _ => return Err(value(format!("form: {form:?}; there are folder, shapes, npz and gltf"))),
        };
        compute(py, Some(1), || {
            let materials = self.companions.materials(&self.rig, &path, form);
            let of_mesh = Some(&self.companions.mesh).filter(|mesh| !mesh.as_os_str().is_empty());
            let reads: Vec<PathBuf> = self.origins().chain(of_mesh).chain(materials.reads()).cloned().collect();
            if let Some(mesh) = form.mesh_in(&path) {
                let folder = real(&path);
                if let Some(file) = self.origins().find(|file| real(file).starts_with(&folder)) {
                    let (path, file) = (path.display(), file.display());
                    return Err(value(format!("{path}: {file} in it was read; give another folder")));
                }
                if let Some(name) = self.rig.stranger_in(&path, form == RigForm::Meshes) {
                    let message = format!("{name} is there, which would become a part of the rig");
                    return Err(value(format!("{}: {message}", path.display())));
                }
                let of_materials = materials.writes(&mesh);
                let shapes = self.rig.shapes().iter().map(|shape| format!("{}.obj", shape.name));
                let names = match form {
                    RigForm::Meshes => shapes.chain(["neutral.obj", "rig.json"].map(str::to_owned)).collect(),
                    _ => RIG_FILES.into_iter().chain(COMPONENT_FILES).map(str::to_owned).collect::<Vec<_>>(),
                };
                let names = names.into_iter().chain(NAMED_LANDMARKS.map(str::to_owned)).map(|name| path.join(name));
                check_plan(&reads, &names.chain(of_materials).collect::<Vec<_>>())?;
                refuse_beside(&mesh, &materials)?;
            } else {
                check_plan(&reads, std::slice::from_ref(&path))?;
            }
            let missing = materials.missing.iter().map(|(_, told)| told.clone());
            let written = self.companions.write(&self.rig, self.pca.as_ref(), &path, form, &materials);
            Ok(missing.chain(written.map_err(input)?).collect())
        })
    }

    fn transfer(rig: Py<Self>, py: Python<'_>, subject: PyReadonlyArray2<'_, f64>, anchor: f64) -> PyResult<Self> {
        let subject = arrays::points("subject", &subject)?;
        abandonable(py, None, move || {
            let this = rig.get();
            let transferred = this.rig.transfer(&subject, &TransferOptions { anchor });
            let (rig, warnings) = transferred.map_err(|e| match e {
                TransferError::Linear(_) => computation(e),
                _ => input(e),
            })?;
            let (companions, left) = this.companions.of_vertices();
            let notes = warnings.iter().map(ToString::to_string).chain(left).collect();
            Ok(Self { companions, made_of: this.origins().cloned().collect(), ..Self::of_rig(rig, notes) })
        })
    }

    #[pyo3(signature = (frames, names, neutral, align, bounds))]
    fn fit(
        &self,
        py: Python<'_>,
        frames: Vec<PyReadonlyArray2<'_, f64>>,
        names: Option<Vec<String>>,
        neutral: Option<PyReadonlyArray2<'_, f64>>,
        align: &str,
        bounds: [f64; 2],
    ) -> PyResult<(Vec<String>, Vec<Frame>)> {
        let frames = frames.iter().map(|f| arrays::points("meshes", f)).collect::<PyResult<Vec<_>>>()?;
        let neutral = neutral.map(|n| arrays::points("neutral", &n)).transpose()?;
        if let Some(v) = neutral.iter().flatten().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(value(format!("neutral: vertex {v} is not finite")));
        }
        let pose = pose_kind(align)?;
        interruptible(py, None, |stop| {
            let selection = ShapeSelection { names: names.as_deref(), identity_modes: 0 };
            let basis = self.rig.select(selection).map_err(input)?;
            let names = basis.shapes().iter().map(|s| s.name.clone()).collect();
            let options = WeightFitOptions { bounds, pose, ..WeightFitOptions::default() };
            let neutral = neutral.as_deref().unwrap_or(self.rig.neutral());
            let mut fitter = WeightFitter::new(neutral, self.rig.mesh(), basis, &options).map_err(input)?;
            let fit = |frame: &Vec<Vec3>| -> PyResult<Frame> {
                if stop.load(Ordering::Relaxed) {
                    return Err(value("stopped"));
                }
                let fitted = fitter.fit(frame).map_err(|e| match e {
                    rig::RigError::Fit { .. } => computation(e),
                    _ => input(e),
                })?;
                let (scale, rotation, shift) = (fitted.pose.scale, fitted.pose.rotation, fitted.pose.translation);
                let rows = std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)]));
                let rest = (fitted.rms, fitted.max, fitted.converged, fitted.doubts);
                Ok((fitted.weights, scale, rows, shift.into(), rest.0, rest.1, rest.2, rest.3))
            };
            Ok((names, frames.iter().map(fit).collect::<PyResult<_>>()?))
        })
    }

    /// Principal components of shapes of one topology, and their standard deviations and shares of the variance.
    #[staticmethod]
    fn pca(
        py: Python<'_>,
        samples: Vec<PyReadonlyArray2<'_, f64>>,
        mesh: Option<Py<Mesh>>,
        components: usize,
        align: &str,
        made_of: Vec<PathBuf>,
    ) -> PyResult<(Self, Vec<f64>, Vec<f64>)> {
        let samples = samples.iter().map(|s| arrays::points("meshes", s)).collect::<PyResult<Vec<_>>>()?;
        let pose = pose_kind(align)?;
        abandonable(py, None, move || {
            let mesh = mesh.as_ref().map(Py::get);
            let mut population = Population::new(samples).map_err(input)?;
            let odd = population.doubts(mesh.map(Mesh::polygons)).map_err(input)?;
            if let Some(kind) = pose {
                population.align(kind).map_err(computation)?;
            }
            let pca = ShapePca::fit(&population, components).map_err(input)?;
            let (rig, warnings) = pca.to_rig(mesh.map(Mesh::polygons)).map_err(input)?;
            let notes = odd.into_iter().chain(warnings.iter().map(ToString::to_string)).collect();
            let (deviations, shares) = (pca.standard_deviations().to_vec(), pca.explained());
            let materials = mesh.map(|m| m.materials.clone()).unwrap_or_default();
            let companions = Companions { mesh: materials, ..Companions::default() };
            let rig = Self { companions, pca: Some(pca), made_of, ..Self::of_rig(rig, notes) };
            Ok((rig, deviations, shares))
        })
    }
}

/// A path without links and steps back, as far as it is there.
fn real(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    std::fs::canonicalize(&absolute).unwrap_or(absolute)
}

/// The meshes of a folder, by name.
#[pyfunction]
fn mesh_files(folder: PathBuf) -> PyResult<Vec<PathBuf>> {
    Ok(rig::mesh_files(&folder).map_err(input)?.into_iter().map(|(_, path)| path).collect())
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Rig>()?;
    module.add_function(wrap_pyfunction!(mesh_files, module)?)
}
