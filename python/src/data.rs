//! Generated faces with exact truth: what `data-gen` makes.

use std::ffi::OsString;

use data_gen::{FaceOptions, FaceRig, command, simulate_scan};
use nonrigid::console::{Failure, Stage};
use nonrigid::io::MeshFile;
use nonrigid::mesh::Vec3;
use nonrigid::rig::{Family, Regions, Shape};
use numpy::{IntoPyArray as _, PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{ComputationError, abandonable, in_python, input, interruptible, os_error, value};
use crate::mesh::Mesh;
use crate::rig::Rig;

fn failed(failure: &Failure) -> PyErr {
    let message = in_python(&failure.to_string());
    match failure.stage() {
        Stage::Arguments => value(message),
        Stage::Writing | Stage::Loading => os_error(&message),
        _ => ComputationError::new_err(message),
    }
}

/// Folders of a rig and scans of it, as the command line makes them. Ctrl-C ends it with what is whole.
#[pyfunction]
fn write_data(py: Python<'_>, arguments: Vec<OsString>, threads: Option<usize>) -> PyResult<()> {
    interruptible(py, threads, |stop| command::write(arguments, stop).map_err(|e| failed(&e)))
}

/// A generated face at one resolution.
#[pyclass(frozen, module = "nonrigid._nonrigid")]
struct Face(FaceRig);

/// Scan, truth, observed, landmark vertices, landmark points, expression weights, identity weights.
type Case<'py> = (
    Mesh,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<bool>>,
    Vec<u32>,
    Bound<'py, PyArray2<f64>>,
    Vec<f64>,
    Vec<f64>,
);

#[pymethods]
impl Face {
    #[new]
    fn new(py: Python<'_>, vertices: usize, identity_modes: usize) -> PyResult<Self> {
        if !(1000..=500_000).contains(&vertices) || identity_modes > 200 {
            return Err(value("vertices: 1,000 to 500,000; identity_modes: at most 200"));
        }
        abandonable(py, None, move || Ok(Self(FaceRig::generate(&FaceOptions { vertices, identity_modes }))))
    }

    fn rig(face: Py<Self>, py: Python<'_>) -> PyResult<Rig> {
        abandonable(py, None, move || {
            let face = &face.get().0;
            let expressions = face.expressions.iter().map(|(name, _)| (name.clone(), Family::Expression));
            let identities = (0..face.identities.len()).map(|k| (format!("identity{k:03}"), Family::Identity));
            let shapes = expressions.chain(identities).map(|(name, family)| Shape { name, family }).collect();
            let all = face.expressions.iter().map(|(_, deltas)| deltas).chain(&face.identities);
            let deltas = all.flatten().flat_map(|d: &Vec3| [d.x as f32, d.y as f32, d.z as f32]).collect();
            let (rig, warnings) =
                nonrigid::rig::Rig::new(face.neutral.clone(), Some(face.mesh.clone()), shapes, deltas)
                    .map_err(input)?;
            let regions = Regions::new(face.neutral.len(), face.regions.clone()).map_err(input)?;
            let rig = rig.with_regions(regions).map_err(input)?;
            let landmarks = face.landmarks.iter().map(|l| l.vertex).collect();
            let rig = rig.with_landmarks(landmarks).map_err(input)?;
            Ok(Rig::of_rig(rig, warnings.iter().map(ToString::to_string).collect()))
        })
    }

    fn anthropometric(&self) -> Vec<(String, u32)> {
        self.0.anthropometric.iter().map(|l| (l.name.to_string(), l.vertex)).collect()
    }

    fn scan(face: Py<Self>, py: Python<'_>, arguments: Vec<OsString>, seed: u64) -> PyResult<Case<'_>> {
        let case = abandonable(py, None, move || {
            let options = command::scan_options(arguments).map_err(|e| failed(&e))?;
            simulate_scan(&face.get().0, &options, seed).map_err(|e| match e {
                data_gen::ScanError::Option(_) => value(in_python(&e.to_string())),
                data_gen::ScanError::NothingSeen => ComputationError::new_err(e.to_string()),
            })
        })?;
        let scan = Mesh::of_arrays(MeshFile { mesh: case.scan.into(), normals: None, colors: None });
        let (vertices, points): (Vec<u32>, Vec<Vec3>) = case.landmarks.into_iter().unzip();
        let (truth, points) = (arrays::from_points(py, &case.truth)?, arrays::from_points(py, &points)?);
        let observed = case.observed.into_pyarray(py);
        Ok((scan, truth, observed, vertices, points, case.expression_weights, case.identity_weights))
    }

    fn expressions(&self) -> Vec<String> {
        self.0.expressions.iter().map(|(name, _)| name.clone()).collect()
    }
}

pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Face>()?;
    module.add_function(wrap_pyfunction!(write_data, module)?)
}
