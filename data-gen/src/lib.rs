//! Synthetic face rigs and scans of them with exact truth, all from one seed.
//!
//! [`FaceRig::generate`] makes a face of quads by formulas: a template with expressions, identity modes, landmarks
//! and regions, all samples of one continuous map, [`FaceModel`]. [`simulate_scan`] samples the same map elsewhere, deformed
//! and posed and with detail that the rig cannot express, and looks at it the way a scanner does: irregular triangles, only
//! what the cameras see, noise, holes, spikes, loose parts. [`Motion`] moves a person through a sequence of scans.
//! [`write_rig`] and [`write_case`] make folders of them. Millimetres, Y up, the face looks towards +Z, the subject's left
//! (`_L`) is +X. Equal options and seeds give equal bytes.

pub mod command;
mod contact_sheet;
mod expressions;
mod face;
mod files;
mod identity;
mod record;
mod rig;
mod scan;
mod sequence;
mod standard;

pub use contact_sheet::contact_sheet;
pub use face::{Eyeball, FaceModel, FaceWeights, Flat};
pub use files::{Subject, write_case, write_population, write_rig};
pub use rig::{FaceOptions, FaceRig, Landmark};
pub use scan::{
    Bend, Camera, PRESETS, ScanCase, ScanError, ScanOptions, Scanner, WrinkleMix, resolve_shapes, simulate_scan,
};
pub use sequence::{Motion, write_weights};
pub use standard::{STANDARD_CASES, StandardCase, preset_weights};
