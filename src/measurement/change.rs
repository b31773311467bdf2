//! What a change of shape sweeps and moves, by region.
//!
//! A third of a triangle belongs to each of its corners. A region of vertices has the thirds of its vertices, a group of polygons has its
//! polygons whole: either way the parts of a partition add up to the whole.

use serde::Serialize;

use super::NamedRegion;
use crate::mesh::normals::face_areas;
use crate::mesh::{PolygonMesh, Vec3};

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

/// A part of a surface.
pub(super) struct Part {
    /// Its vertices, each once.
    pub vertices: Vec<usize>,
    /// Its thirds of triangles: the triangle, and the corner at which the third is.
    thirds: Vec<(usize, usize)>,
}

impl Part {
    /// Everything.
    pub fn whole(mesh: &PolygonMesh, triangles: &[[u32; 3]]) -> Self {
        let vertices = 0..mesh.positions.len();
        Self { vertices: vertices.collect(), thirds: thirds(triangles.iter().enumerate()).collect() }
    }

    /// # Panics
    /// When a vertex of the region is none of the mesh.
    pub fn of(region: &NamedRegion<'_>, mesh: &PolygonMesh, triangles: &[[u32; 3]]) -> Self {
        let mut inside = vec![false; mesh.positions.len()];
        region.vertices.iter().for_each(|v| inside[*v as usize] = true);
        let vertices = (0..inside.len()).filter(|v| inside[*v]).collect();
        let Some(polygons) = region.polygons else {
            let of_vertices = thirds(triangles.iter().enumerate()).filter(|(_, v)| inside[*v]);
            return Self { vertices, thirds: of_vertices.collect() };
        };
        let mut chosen = vec![false; mesh.polygon_count()];
        polygons.iter().for_each(|f| chosen[*f as usize] = true);
        // the fan of a polygon has two triangles less than corners
        let fan = |f: usize| std::iter::repeat_n(chosen[f], mesh.polygon(f).len().saturating_sub(2));
        let chosen = (0..mesh.polygon_count()).flat_map(fan);
        let of_polygons = triangles.iter().enumerate().zip(chosen).filter(|t| t.1).map(|t| t.0);
        Self { vertices, thirds: thirds(of_polygons).collect() }
    }
}

fn thirds<'a>(triangles: impl Iterator<Item = (usize, &'a [u32; 3])>) -> impl Iterator<Item = (usize, usize)> {
    triangles.flat_map(|(t, corners)| corners.map(|v| (t, v as usize)))
}

/// Areas of the triangles of a shape, square millimetres.
pub(super) struct Areas(Vec<f64>);

impl Areas {
    pub fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        Self(face_areas(positions, triangles))
    }

    pub fn of(&self, part: &Part) -> f64 {
        part.thirds.iter().map(|(t, _)| self.0[*t]).sum::<f64>() / 3.0
    }
}

/// Changes of triangles and vertices, of which those of regions are made.
pub(super) struct Changes {
    /// Of each triangle before.
    areas: Areas,
    /// That each triangle sweeps.
    volumes: Vec<f64>,
    /// Of each vertex.
    displacements: Vec<f64>,
}

impl Changes {
    /// # Panics
    /// When the numbers of vertices differ or a triangle indexes past them.
    pub fn new(before: &[Vec3], after: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        assert_eq!(before.len(), after.len(), "vertices before and after");
        let corners = |p: &[Vec3], t: &[u32; 3]| t.map(|v| p[v as usize]);
        Self {
            areas: Areas::new(before, triangles),
            volumes: triangles.iter().map(|t| swept_volume(corners(before, t), corners(after, t))).collect(),
            displacements: before.iter().zip(after).map(|(b, a)| (a - b).norm()).collect(),
        }
    }

    /// # Panics
    /// When the part is of another surface.
    pub fn of(&self, part: &Part) -> Change {
        let area = self.areas.of(part);
        let moved = part.thirds.iter().map(|(t, v)| self.areas.0[*t] * self.displacements[*v]).sum::<f64>() / 3.0;
        Change {
            volume: part.thirds.iter().map(|(t, _)| self.volumes[*t]).sum::<f64>() / 3.0,
            displacement_mean: if area > 0.0 { moved / area } else { 0.0 },
            displacement_max: part.vertices.iter().map(|v| self.displacements[*v]).fold(0.0, f64::max),
        }
    }
}
