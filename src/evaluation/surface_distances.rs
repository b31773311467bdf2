//! Distances between two surfaces, both ways, when no truth is known.

use serde::Serialize;

use super::ScanDistance;
use super::percentile::of_sorted;
use crate::mesh::{MeshError, PolygonMesh, TriangleMesh, Vec3};

/// Percentiles of one set of distances, millimetres; all 0 when `count` is 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Distances that are finite and counted below.
    pub count: usize,
    /// Points that had no distance (NaN or infinite) and are not counted.
    pub without: usize,
    /// Arithmetic mean.
    pub mean: f64,
    /// Root mean square.
    pub rms: f64,
    /// 5th percentile.
    pub p5: f64,
    /// Median.
    pub median: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest: the one-sided Hausdorff distance.
    pub max: f64,
    /// Share of the counted distances that is at most the threshold, 0 to 1.
    pub share_within: f64,
}

impl DistanceSummary {
    /// Summarises `distances`; `within` is the threshold of `share_within`.
    #[must_use]
    pub fn new(distances: &[f64], within: f64) -> Self {
        let mut sorted: Vec<f64> = distances.iter().copied().filter(|d| d.is_finite()).collect();
        let without = distances.len() - sorted.len();
        sorted.sort_unstable_by(f64::total_cmp);
        if sorted.is_empty() {
            return Self { without, ..Self::default() };
        }
        let n = sorted.len() as f64;
        let at = |percent| of_sorted(&sorted, percent).unwrap_or(0.0);
        Self {
            count: sorted.len(),
            without,
            mean: sorted.iter().sum::<f64>() / n,
            rms: (sorted.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
            p5: at(5.0),
            median: at(50.0),
            p90: at(90.0),
            p95: at(95.0),
            p99: at(99.0),
            max: at(100.0),
            share_within: sorted.partition_point(|d| *d <= within) as f64 / n,
        }
    }
}

/// Distances from the vertices of a result to the scan's surface and back.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SurfaceDistances {
    /// Threshold of `share_within`, millimetres.
    pub within: f64,
    /// From the result's vertices to the scan.
    pub result_to_scan: DistanceSummary,
    /// From the scan's vertices to the result.
    pub scan_to_result: DistanceSummary,
    /// Symmetric Hausdorff distance over the vertices: the larger of the two maxima.
    pub hausdorff: f64,
    /// Mean of the two medians: a symmetric distance that spikes and missing regions do not move.
    pub symmetric_median: f64,
}

impl SurfaceDistances {
    /// Between a result and a scan, whose own normals are needed only where it has no triangles; and the distance of each of the result's
    /// vertices to the scan. Vertices of no polygon are not summarised.
    ///
    /// # Errors
    /// As [`ScanDistance::new`].
    pub fn between(
        result: &PolygonMesh,
        scan: &TriangleMesh,
        normals: Option<&[Vec3]>,
        within: f64,
    ) -> Result<(Self, Vec<f64>), MeshError> {
        let on_scan = ScanDistance::new(scan, normals)?;
        let on_result = ScanDistance::new(&result.triangulate(), None)?;
        let forth: Vec<f64> = result.positions.iter().map(|p| on_scan.of(p)).collect();
        let back: Vec<f64> = scan.surface_points().iter().map(|p| on_result.of(p)).collect();
        let counted = forth.iter().zip(result.on_surface()).filter(|(_, on)| *on).map(|(d, _)| *d);
        Ok((Self::from_distances(&counted.collect::<Vec<_>>(), &back, within), forth))
    }

    /// Summarises distances that were measured already, one per vertex; NaN for a vertex that is not to count.
    #[must_use]
    pub fn from_distances(result_to_scan: &[f64], scan_to_result: &[f64], within: f64) -> Self {
        let forth = DistanceSummary::new(result_to_scan, within);
        let back = DistanceSummary::new(scan_to_result, within);
        Self {
            within,
            result_to_scan: forth,
            scan_to_result: back,
            hausdorff: forth.max.max(back.max),
            symmetric_median: 0.5 * (forth.median + back.median),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_summarised_as_by_hand() {
        let d = SurfaceDistances::from_distances(&[1.0, 2.0, 3.0], &[0.5, f64::NAN], 2.0);
        let forth = d.result_to_scan;
        assert_eq!((forth.count, forth.median, forth.mean, forth.max), (3, 2.0, 2.0, 3.0));
        assert!((forth.rms - (14.0f64 / 3.0).sqrt()).abs() < 1e-12 && (forth.share_within - 2.0 / 3.0).abs() < 1e-12);
        assert!((forth.p95 - 2.9).abs() < 1e-12);
        assert_eq!((d.scan_to_result.count, d.scan_to_result.without, d.scan_to_result.max), (1, 1, 0.5));
        assert_eq!((d.hausdorff, d.symmetric_median), (3.0, 1.25));
        assert_eq!(SurfaceDistances::from_distances(&[], &[], 1.0).hausdorff, 0.0);
    }
}
