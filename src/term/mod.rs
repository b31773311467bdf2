//! Data terms: one file each. Each is a residual of one sample's position; see [`SampleResidual`](crate::energy::SampleResidual).

mod landmark;
mod point_to_plane;
mod point_to_point;
mod scan_to_template;
mod symmetric;

pub use landmark::Landmarks;
pub use point_to_plane::PointToPlane;
pub use point_to_point::PointToPoint;
pub use scan_to_template::ScanToTemplate;
pub use symmetric::Symmetric;
