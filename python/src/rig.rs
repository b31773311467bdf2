//! Blendshape rigs: read, made of arrays, written, transferred, fitted, and found by principal components.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use nonrigid::io::{Input, Inputs, KnownUnit, LengthUnit};
use nonrigid::mesh::{PoseKind, Vec3};
use nonrigid::rig::{
    self, Family, Population, Regions, RigReadOptions, Shape, ShapeKind, ShapePca, ShapeSelection, TransferError,
    TransferOptions, WeightFitOptions, WeightFitter,
};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArray3, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{computation, compute, guarded, input, value};
use crate::mesh::{Measured, Mesh, check_plan, hashed, measured};

/// A rig, millimetres, with the files that it came from.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Rig {
    pub rig: rig::Rig,
    pub known: Option<KnownUnit>,
    pub files: Vec<Input>,
    notes: Vec<String>,
}

impl Rig {
    /// A rig of arrays.
    pub fn of_rig(rig: rig::Rig, notes: Vec<String>) -> Self {
        Self { rig, known: None, files: Vec::new(), notes }
    }

    /// The folder that it was read from, if it was one: there may be landmarks by name, which no rig holds.
    pub fn folder(&self) -> Option<&Path> {
        let neutral = ["neutral.npy", "neutral.obj", "neutral.ply", "template.obj", "template.ply"];
        let is_neutral = |path: &&Path| path.file_name().is_some_and(|name| neutral.iter().any(|n| name == *n));
        self.files.iter().map(|file| file.path.as_path()).find(is_neutral)?.parent()
    }
}

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
        compute(py, None, move || {
            let inputs = Inputs::default();
            let options = RigReadOptions { identity_modes: identity_modes.unwrap_or(usize::MAX), kind };
            let (mut rig, warnings) = inputs.reading("", || rig::Rig::read(&path, &options)).map_err(input)?;
            let Measured { known, factor, note } = measured(&path, &rig.surface_points(), asked)?;
            rig.scale(factor);
            let notes = warnings.iter().map(ToString::to_string).chain(note).collect();
            Ok(Self { rig, known: Some(known), files: inputs.files(), notes })
        })
    }

    /// `deltas`: shape by shape, vertex by vertex, x y z.
    #[staticmethod]
    #[pyo3(signature = (neutral, mesh, names, families, deltas, landmarks, regions, files))]
    fn of(
        neutral: PyReadonlyArray2<'_, f64>,
        mesh: Option<&Mesh>,
        names: Vec<String>,
        families: Vec<String>,
        deltas: PyReadonlyArray1<'_, f32>,
        landmarks: Option<Vec<u32>>,
        regions: Option<Vec<(String, Vec<u32>)>>,
        files: Vec<PathBuf>,
    ) -> PyResult<Self> {
        let neutral = arrays::points("neutral", &neutral)?;
        let families: Vec<Family> = families.iter().map(|f| family(f)).collect::<PyResult<_>>()?;
        if families.len() != names.len() {
            return Err(value(format!("{} names, but {} families", names.len(), families.len())));
        }
        let shapes = names.into_iter().zip(families).map(|(name, family)| Shape { name, family }).collect();
        let (vertices, deltas) = (neutral.len(), deltas.as_array().to_vec());
        let mesh = mesh.map(|m| m.polygons().clone());
        let (mut rig, warnings) = guarded(|| rig::Rig::new(neutral, mesh, shapes, deltas).map_err(input))?;
        if let Some(regions) = regions {
            rig = rig.with_regions(Regions::new(vertices, regions).map_err(input)?).map_err(input)?;
        }
        if let Some(landmarks) = landmarks {
            rig = rig.with_landmarks(landmarks).map_err(input)?;
        }
        let notes = warnings.iter().map(ToString::to_string).collect();
        Ok(Self { rig, known: None, files: hashed(files)?, notes })
    }

    #[getter]
    fn neutral<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, self.rig.neutral())
    }

    #[getter]
    fn mesh(&self) -> Option<Mesh> {
        let mesh = self.rig.mesh()?.clone();
        Some(Mesh { known: self.known, ..Mesh::of_arrays(mesh.into()) })
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
        self.known.as_ref().map(ToString::to_string)
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }

    /// `form`: folder, shapes, npz or gltf.
    fn write(&self, py: Python<'_>, path: PathBuf, form: &str, reads: Vec<PathBuf>) -> PyResult<()> {
        let write = match form {
            "folder" => rig::Rig::write,
            "shapes" => rig::Rig::write_meshes,
            "npz" => rig::Rig::write_npz,
            "gltf" => rig::Rig::write_gltf,
            _ => return Err(value(format!("form: {form:?}; there are folder, shapes, npz and gltf"))),
        };
        compute(py, Some(1), || {
            if matches!(form, "folder" | "shapes") {
                if let Some(file) = reads.iter().find(|file| file.starts_with(&path)) {
                    return Err(value(format!(
                        "{}: {} in it was read; give another folder",
                        path.display(),
                        file.display()
                    )));
                }
                if let Some(name) = self.rig.stranger_in(&path, form == "shapes") {
                    return Err(value(format!(
                        "{}: {name} is there, which would become a part of the rig",
                        path.display()
                    )));
                }
            } else {
                check_plan(&reads, std::slice::from_ref(&path))?;
            }
            write(&self.rig, &path).map_err(input)
        })
    }

    fn transfer(&self, py: Python<'_>, subject: PyReadonlyArray2<'_, f64>, anchor: f64) -> PyResult<Self> {
        let subject = arrays::points("subject", &subject)?;
        compute(py, None, || {
            let transferred = self.rig.transfer(&subject, &TransferOptions { anchor });
            let (rig, warnings) = transferred.map_err(|e| match e {
                TransferError::Linear(_) => computation(e),
                _ => input(e),
            })?;
            let notes = warnings.iter().map(ToString::to_string).collect();
            Ok(Self { rig, known: None, files: Vec::new(), notes })
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
        let pose = pose_kind(align)?;
        compute(py, None, || {
            let selection = ShapeSelection { names: names.as_deref(), identity_modes: 0 };
            let basis = self.rig.select(selection).map_err(input)?;
            let names = basis.shapes().iter().map(|s| s.name.clone()).collect();
            let options = WeightFitOptions { bounds, pose, ..WeightFitOptions::default() };
            let neutral = neutral.as_deref().unwrap_or(self.rig.neutral());
            let mut fitter = WeightFitter::new(neutral, basis, &options).map_err(input)?;
            let fit = |frame: &Vec<Vec3>| -> PyResult<Frame> {
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
        mesh: Option<&Mesh>,
        components: usize,
        align: &str,
    ) -> PyResult<(Self, Vec<f64>, Vec<f64>)> {
        let samples = samples.iter().map(|s| arrays::points("meshes", s)).collect::<PyResult<Vec<_>>>()?;
        let pose = pose_kind(align)?;
        compute(py, None, || {
            let mut population = Population::new(samples).map_err(input)?;
            let odd = population.doubts(mesh.map(Mesh::polygons)).map_err(input)?;
            if let Some(kind) = pose {
                population.align(kind).map_err(computation)?;
            }
            let pca = ShapePca::fit(&population, components).map_err(input)?;
            let (rig, warnings) = pca.to_rig(mesh.map(Mesh::polygons)).map_err(input)?;
            let notes = odd.into_iter().chain(warnings.iter().map(ToString::to_string)).collect();
            let (deviations, shares) = (pca.standard_deviations().to_vec(), pca.explained());
            Ok((Self { rig, known: None, files: Vec::new(), notes }, deviations, shares))
        })
    }
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
