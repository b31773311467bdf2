//! The native part of the Python package `nonrigid`, module `nonrigid._nonrigid`: what the package's own modules call. Arguments arrive
//! here as the package has brought them into form: arrays of 64-bit numbers, objects of these classes, text.
//!
//! Whatever computes gives up the interpreter's lock and has threads of its own (`errors::compute`): nothing runs in rayon's global
//! pool, whose threads a forked process would wait for in vain.
#![cfg(feature = "extension-module")]
#![allow(clippy::too_many_arguments, clippy::type_complexity)] // functions of Python have named arguments, and tuples

mod arrays;
mod batch;
mod data;
mod errors;
mod inputs;
mod mesh;
mod morph;
mod registration;
mod rig;

use pyo3::prelude::*;

/// The native part of the package nonrigid.
#[pymodule]
fn _nonrigid(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("ComputationError", module.py().get_type::<errors::ComputationError>())?;
    mesh::add_to(module)?;
    inputs::add_to(module)?;
    rig::add_to(module)?;
    morph::add_to(module)?;
    batch::add_to(module)?;
    data::add_to(module)?;
    registration::add_to(module)
}
