//! The face: its flat domain, the neutral shape, the template's polygons.

mod anatomy;
mod layout;
mod model;
mod rings;
mod sculpt;
mod site;
mod spline;

pub(crate) use anatomy::{ANTHROPOMETRIC, LANDMARKS, REGIONS, region};
pub(crate) use layout::Layout;
pub use model::{Eyeball, FaceModel, FaceWeights};
pub(crate) use rings::Around;
pub(crate) use sculpt::{EYEBALL, bell, fade, site};
pub use site::Flat;
pub(crate) use site::{CLOSED_MOUTH, EYELIDS, MOUTH, Site, eye_point, flatten};
