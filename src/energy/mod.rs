//! Where deformation models and data terms meet: samples, quadrics, and the energy as a least-squares problem.
//!
//! A data term is a function of **sample positions**; it leaves one small quadric per sample. A model turns parameters
//! into positions and pulls quadrics back. Terms and models never meet in code, so each new one works with all others.

mod deformation;
mod model;
mod options;
mod quadric;
mod sample;
mod term;

pub use deformation::Deformation;
pub use model::{DeformationModel, NamedEnergy};
pub use options::{NoOptions, OptionTable, Options, OptionsError, nearest_key};
pub use quadric::{Quadric, QuadricField};
pub use sample::{SampleError, Samples};
pub use term::{DataTerm, Pointwise, SampleResidual};
