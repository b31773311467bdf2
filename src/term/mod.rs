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

use crate::mesh::Vec3;
use crate::nlls::Scalar;

/// `(v - c) . n`: the distance of `v` from the plane through `c` with normal `n`.
#[inline(always)]
fn along<D: Scalar>(v: [D; 3], c: Vec3, n: Vec3) -> D {
    (v[0] - c[0]) * n[0] + (v[1] - c[1]) * n[1] + (v[2] - c[2]) * n[2]
}
