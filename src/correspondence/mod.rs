//! Which point of a scan belongs to which vertex of a template, and which of these pairs to believe.

mod closest;
mod masks;
mod scan;

use serde::{Deserialize, Serialize};

pub use closest::Correspondences;
pub use masks::VertexMasks;
pub(crate) use scan::check_normals;
pub use scan::{ScanError, ScanSample, ScanSurface};

/// What of the scan is believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanOptions {
    /// Rounds of averaging of the scan's vertex normals with their neighbours'.
    pub normal_smoothing: usize,
    /// Whether the scan is turned over first: `auto` (default), `yes` or `no`.
    pub flip: ScanFlip,
    /// Reject correspondences on the scan's open boundary.
    pub reject_boundary: bool,
    /// This many rings of vertices along the template's own open boundary take no correspondence, neither in the search of a
    /// start nor at levels that `reject_rim`: lips and lids roll inwards there, out of the scanner's sight, and hair or collar lie
    /// beyond. Rings of a template of `reference_vertices`; a finer
    /// one has more. (A width in millimetres does worse: rims are finer where there is less to leave out.)
    pub template_rim: f64,
    /// Vertices that the template hides from every scanner ([`hidden_vertices`](crate::mesh::hidden_vertices) at rest, such as inner
    /// sides of nostrils and lips) take no correspondence: a scan closes such places, or has something else there. Where a schedule has
    /// levels `bend`, those that it hides as each level after the first two finds it, since a pose brings to light what rest hides.
    pub reject_hidden: bool,
}

impl Default for ScanOptions {
    fn default() -> Self {
        Self {
            normal_smoothing: 2,
            flip: ScanFlip::Auto,
            reject_boundary: true,
            template_rim: 0.0,
            reject_hidden: true,
        }
    }
}

/// Whether a scan is turned over before it is registered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanFlip {
    /// Where it fits the template better so.
    #[default]
    Auto,
    /// Always.
    Yes,
    /// Never.
    No,
}

/// What a pair must keep to be accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceptance {
    /// Greatest distance, in the unit of the positions.
    pub distance: f64,
    /// Greatest angle between the normals, degrees.
    pub angle: f64,
    /// Standard deviation of the scan's noise at which a pair counts half, in the unit of the positions; 0 where all count alike.
    pub noise: f64,
}

impl Acceptance {
    /// What a pair counts where the scan's noise is this: `s^2 / (s^2 + noise^2)`, as if every pair were off by `s` besides.
    pub(crate) fn trust(&self, noise: f64) -> f64 {
        if self.noise > 0.0 { 1.0 / (1.0 + (noise / self.noise).powi(2)) } else { 1.0 }
    }
}
