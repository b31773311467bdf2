//! What a change of shape sweeps and moves, by region.
//!
//! A region is a set of vertices; each triangle's area and volume go to its corners, a third each. So the regions of a partition add up
//! to the whole, whatever runs along their borders.

use serde::Serialize;

use crate::mesh::Vec3;
use crate::mesh::normals::vertex_areas;

/// Signed volume that a triangle sweeps as its corners move straight from `before` to `after`, cubic millimetres; positive outwards.
///
/// With `N(t)` the area vector at time `t` and `d` the mean displacement of the corners, the displacement being linear on the
/// triangle, it is `d . integral of N(t)` from 0 to 1, and `N` is quadratic in `t`:
///
/// ```text
///     V = d . ( e x f + (e x f' + e' x f) / 2 + e' x f' / 3 ) / 2
/// ```
///
/// for edges `e`, `f` before and their changes `e'`, `f'`. It is exact: over a closed surface the sum is the difference of the enclosed
/// volumes.
#[must_use]
pub fn swept_volume(before: [Vec3; 3], after: [Vec3; 3]) -> f64 {
    let moved = [0, 1, 2].map(|k| after[k] - before[k]);
    let (e, f) = (before[1] - before[0], before[2] - before[0]);
    let (de, df) = (moved[1] - moved[0], moved[2] - moved[0]);
    let area = e.cross(&f) + (e.cross(&df) + de.cross(&f)) * 0.5 + de.cross(&df) / 3.0;
    (moved[0] + moved[1] + moved[2]).dot(&area) / 6.0
}

/// What became of a region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Change {
    /// Volume swept, cubic millimetres, positive outwards.
    pub volume: f64,
    /// Mean length of the displacement, weighted by the area before, millimetres.
    pub displacement_mean: f64,
    /// Its largest.
    pub displacement_max: f64,
}

/// Changes per vertex, from which regions are summed.
pub(super) struct Changes {
    /// Before.
    areas: Vec<f64>,
    volume: Vec<f64>,
    displacement: Vec<f64>,
}

impl Changes {
    /// # Panics
    /// When the numbers of vertices differ or a triangle indexes past them.
    pub fn new(before: &[Vec3], after: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        assert_eq!(before.len(), after.len(), "vertices before and after");
        let mut volume = vec![0.0; before.len()];
        for t in triangles {
            let corners = |p: &[Vec3]| t.map(|v| p[v as usize]);
            let third = swept_volume(corners(before), corners(after)) / 3.0;
            t.iter().for_each(|&v| volume[v as usize] += third);
        }
        Self {
            areas: vertex_areas(before, triangles),
            volume,
            displacement: before.iter().zip(after).map(|(b, a)| (a - b).norm()).collect(),
        }
    }

    /// # Panics
    /// When there is no such vertex.
    pub fn of(&self, vertices: impl Iterator<Item = usize> + Clone) -> Change {
        let sum = |values: &[f64]| vertices.clone().map(|v| values[v]).sum::<f64>();
        let area = sum(&self.areas);
        let moved: f64 = vertices.clone().map(|v| self.areas[v] * self.displacement[v]).sum();
        Change {
            volume: sum(&self.volume),
            displacement_mean: if area > 0.0 { moved / area } else { 0.0 },
            displacement_max: vertices.map(|v| self.displacement[v]).fold(0.0, f64::max),
        }
    }
}
