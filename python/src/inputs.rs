//! What a registration takes besides meshes and rigs: landmarks, masks, schedules.

use std::ffi::OsString;
use std::path::PathBuf;

use nonrigid::io::{self, Input, Inputs, KnownUnit, LengthUnit, UnitSource, read_text};
use nonrigid::landmark::{LandmarkSet, parse_landmark_set, read_landmark_set, read_scan_landmark_set};
use nonrigid::registration;
use nonrigid::registration::{ModelKind, ScanFlip, TERMS};
use numpy::{IntoPyArray as _, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyList, PyString, PyTuple};

use crate::errors::{compute, guarded, input, value};
use crate::mesh::Mesh;
use crate::rig::Rig;

/// Landmarks of a file, or of a text in this project's own form.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Landmarks {
    pub set: LandmarkSet,
    pub path: PathBuf,
    pub files: Vec<Input>,
}

#[pymethods]
impl Landmarks {
    /// Reads a file; `scan` says whose landmarks they are, for the messages.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, scan: bool) -> PyResult<Self> {
        compute(py, Some(1), || {
            let inputs = Inputs::default();
            let read = if scan { read_scan_landmark_set } else { read_landmark_set };
            let set = inputs.reading("", || read(&path)).map_err(input)?;
            Ok(Self { set, files: inputs.files(), path })
        })
    }

    /// This project's own JSON; `name` is that of the argument, for the messages.
    #[staticmethod]
    fn parse(text: &str, name: PathBuf) -> PyResult<Self> {
        let set = guarded(|| parse_landmark_set(text.as_bytes(), &name).map_err(input))?;
        Ok(Self { set, path: name, files: Vec::new() })
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }
}

impl Landmarks {
    /// In millimetres: those of a file in the unit that it states, in the one that is asked for, or in that of the mesh they are on.
    pub fn in_millimetres(&self, asked: Option<LengthUnit>, mesh: &Mesh) -> PyResult<(LandmarkSet, Option<KnownUnit>)> {
        let mut set = self.set.clone();
        let known = match (set.unit, asked) {
            (Some(stated), Some(asked)) if stated != asked && !self.files.is_empty() => {
                let path = self.path.display();
                return Err(value(format!("unit of landmarks \"{asked}\": {path} says {stated}; leave that out")));
            }
            (Some(unit), _) => Some(KnownUnit { unit, by: UnitSource::File }),
            (None, Some(unit)) => Some(KnownUnit { unit, by: UnitSource::Option }),
            (None, None) => mesh.known.map(|known| KnownUnit { unit: known.unit, by: UnitSource::Mesh }),
        };
        let known = known.filter(|_| set.has_positions());
        if let Some(known) = known {
            set.assume(known.unit);
        }
        Ok((set, known.filter(|_| !self.files.is_empty())))
    }
}

/// A number from 0 to 1 for each vertex.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Mask {
    pub values: Vec<f64>,
    pub files: Vec<Input>,
}

#[pymethods]
impl Mask {
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, vertices: usize) -> PyResult<Self> {
        compute(py, Some(1), || {
            let inputs = Inputs::default();
            let values = inputs.reading("", || io::read_npy_vector(&path, Some(vertices))).map_err(input)?;
            check(&path.display().to_string(), &values)?;
            Ok(Self { values, files: inputs.files() })
        })
    }

    #[staticmethod]
    fn of(values: PyReadonlyArray1<'_, f64>) -> PyResult<Self> {
        let values = values.as_array().to_vec();
        check("mask", &values)?;
        Ok(Self { values, files: Vec::new() })
    }

    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.values.clone().into_pyarray(py)
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }
}

fn check(what: &str, values: &[f64]) -> PyResult<()> {
    match values.iter().position(|m| !(0.0..=1.0).contains(m)) {
        None => Ok(()),
        Some(v) => Err(value(format!("{what}: expected numbers from 0 to 1, found {} at vertex {v}", values[v]))),
    }
}

/// What steers a registration.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
pub struct Schedule {
    pub schedule: registration::Schedule,
    pub files: Vec<Input>,
}

#[pymethods]
impl Schedule {
    /// A model's own.
    #[staticmethod]
    fn of_model(model: &str) -> PyResult<Self> {
        let model = model.parse::<ModelKind>().map_err(value)?;
        Ok(Self { schedule: model.schedule().map_err(input)?, files: Vec::new() })
    }

    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        compute(py, Some(1), || {
            let inputs = Inputs::default();
            let text = inputs.reading("", || read_text(&path)).map_err(input)?;
            let schedule = registration::Schedule::from_toml(&text);
            let schedule = schedule.map_err(|e| value(format!("{}: {e}", path.display())))?;
            Ok(Self { schedule, files: inputs.files() })
        })
    }

    #[staticmethod]
    fn of_toml(text: &str) -> PyResult<Self> {
        let read = || registration::Schedule::from_toml(text).map_err(|e| value(format!("schedule: {e}")));
        let schedule = guarded(read)?;
        Ok(Self { schedule, files: Vec::new() })
    }

    #[staticmethod]
    fn of_dict(keys: &Bound<'_, PyDict>) -> PyResult<Self> {
        let keys = to_toml("schedule", keys.as_any())?.unwrap_or(toml::Value::Boolean(false));
        Self::of_toml(&toml::to_string(&keys).map_err(|e| value(format!("schedule: {e}")))?)
    }

    fn to_toml(&self) -> PyResult<String> {
        toml::to_string(&self.schedule).map_err(|e| value(format!("schedule: {e}")))
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let keys = toml::Value::try_from(&self.schedule).map_err(|e| value(format!("schedule: {e}")))?;
        from_toml(py, &keys)
    }

    /// The same with what is given besides.
    #[pyo3(signature = (expression_bounds=None, identity_bounds=None, flip=None))]
    fn with_options(
        &self,
        expression_bounds: Option<[f64; 2]>,
        identity_bounds: Option<[f64; 2]>,
        flip: Option<&str>,
    ) -> PyResult<Self> {
        let mut schedule = self.schedule.clone();
        schedule.bounds.expression = expression_bounds.or(schedule.bounds.expression);
        schedule.bounds.identity = identity_bounds.or(schedule.bounds.identity);
        schedule.scan.flip = match flip {
            None => schedule.scan.flip,
            Some("auto") => ScanFlip::Auto,
            Some("yes") => ScanFlip::Yes,
            Some("no") => ScanFlip::No,
            Some(other) => return Err(value(format!("flip: {other:?}; there are \"auto\", \"yes\" and \"no\""))),
        };
        schedule.validate().map_err(|e| value(format!("schedule: {e}")))?;
        Ok(Self { schedule, files: self.files.clone() })
    }

    /// What it says and has no effect with a model and a rig's shapes, and why.
    fn without_effect(&self, model: &str, rig: Option<&Rig>) -> PyResult<Vec<String>> {
        let model = model.parse::<ModelKind>().map_err(value)?;
        let resolved = self.schedule.resolved(&model, &TERMS).map_err(|e| value(format!("schedule: {e}")))?;
        Ok(resolved.without_effect(Some(rig.map_or(&[], |rig| rig.rig.shapes()))))
    }

    #[getter]
    fn files(&self) -> Vec<OsString> {
        self.files.iter().map(|f| f.path.clone().into()).collect()
    }
}

/// Lists and dicts within each other: what is deeper holds itself.
const DEPTH: usize = 32;

/// A value of Python as TOML has it; `None` is a key that is not there.
pub fn to_toml(what: &str, value: &Bound<'_, PyAny>) -> PyResult<Option<toml::Value>> {
    nested(what, value, DEPTH)
}

fn nested(what: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<Option<toml::Value>> {
    let Some(depth) = depth.checked_sub(1) else {
        return Err(crate::errors::value(format!("{what}: lists and dicts in more than {DEPTH} others")));
    };
    if value.is_none() {
        return Ok(None);
    }
    if value.is_instance_of::<PyBool>() {
        return Ok(Some(toml::Value::Boolean(value.extract()?)));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Some(toml::Value::String(value.extract()?)));
    }
    if let Ok(keys) = value.cast::<PyDict>() {
        let mut table = toml::Table::new();
        for (key, item) in keys {
            let key: String = key.extract().map_err(|_| crate::errors::value(format!("{what}: keys must be text")))?;
            if let Some(item) = nested(&format!("{what}.{key}"), &item, depth)? {
                table.insert(key, item);
            }
        }
        return Ok(Some(toml::Value::Table(table)));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.map(|item| nested(what, &item?, depth));
        return Ok(Some(toml::Value::Array(items.filter_map(Result::transpose).collect::<PyResult<_>>()?)));
    }
    if !value.is_instance_of::<PyFloat>()
        && let Ok(number) = value.extract::<i64>()
    {
        return Ok(Some(toml::Value::Integer(number)));
    }
    match value.extract::<f64>() {
        Ok(number) => Ok(Some(toml::Value::Float(number))),
        Err(_) => Err(crate::errors::value(format!("{what}: expected a number, text, list or dict, found {value}"))),
    }
}

fn from_toml<'py>(py: Python<'py>, value: &toml::Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        toml::Value::String(text) => text.into_pyobject(py)?.into_any(),
        toml::Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        toml::Value::Float(number) => number.into_pyobject(py)?.into_any(),
        toml::Value::Boolean(truth) => truth.into_pyobject(py)?.to_owned().into_any(),
        toml::Value::Datetime(date) => date.to_string().into_pyobject(py)?.into_any(),
        toml::Value::Array(items) => {
            let items = items.iter().map(|item| from_toml(py, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_any()
        }
        toml::Value::Table(table) => {
            let keys = PyDict::new(py);
            for (key, item) in table {
                keys.set_item(key, from_toml(py, item)?)?;
            }
            keys.into_any()
        }
    })
}

/// Names of the deformation models.
#[pyfunction]
fn models() -> Vec<String> {
    ModelKind::ALL.iter().map(ToString::to_string).collect()
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Landmarks>()?;
    module.add_class::<Mask>()?;
    module.add_class::<Schedule>()?;
    module.add_function(wrap_pyfunction!(models, module)?)
}
