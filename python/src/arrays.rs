//! Arrays of numpy, in and out.

use nonrigid::mesh::Vec3;
use numpy::{PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray2, PyUntypedArrayMethods as _};
use pyo3::prelude::*;

use crate::errors;

/// The rows of an (N, 3) array.
pub fn points(what: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vec3>> {
    let array = array.as_array();
    match array.shape() {
        [_, 3] => Ok(array.rows().into_iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect()),
        shape => Err(errors::value(format!("{what}: expected an array of shape (N, 3), found {shape:?}"))),
    }
}

/// An (N, 3) array.
pub fn from_points<'py>(py: Python<'py>, points: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat: Vec<f64> = points.iter().flat_map(|p| <[f64; 3]>::from(*p)).collect();
    PyArray1::from_vec(py, flat).reshape([points.len(), 3])
}

/// An (N, 3) array of colours, sRGB.
pub fn from_colors<'py>(py: Python<'py>, colors: &[[u8; 3]]) -> PyResult<Bound<'py, PyArray2<u8>>> {
    PyArray1::from_vec(py, colors.as_flattened().to_vec()).reshape([colors.len(), 3])
}

/// The rows of an (N, 3) array of colours.
pub fn colors(what: &str, array: &PyReadonlyArray2<'_, u8>) -> PyResult<Vec<[u8; 3]>> {
    match array.shape() {
        [_, 3] => Ok(array.as_array().rows().into_iter().map(|c| [c[0], c[1], c[2]]).collect()),
        shape => Err(errors::value(format!("{what}: expected an array of shape (N, 3), found {shape:?}"))),
    }
}
