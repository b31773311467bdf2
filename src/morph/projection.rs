//! Which point of a grey texture belongs to a vertex (Li et al. 2018, section 1.1): seen by a camera, in the frame of landmarks,
//! or by the mesh's own texture coordinates.
//!
//! ```text
//! UV = M_lerp M_proj M_view M_model V                                                                          (1), (2)
//! ```
//!
//! The paper leaves out the perspective divide between `M_proj` and `M_lerp`; it is done here. Since `M_lerp` is affine and keeps
//! the fourth coordinate, dividing after it is the same: one matrix, one division.
//!
//! **Visible or through.** The paper moves all that lies under the mask, the back of the head included. By default only the visible
//! surface gets weights: those vertices that no triangle hides. That test is exact, it has no resolution. The vertices in question
//! are sorted into a grid on the picture; each triangle looks up those in the cells that it covers, and hides those inside its
//! projection that lie behind it.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{MorphError, Sampling, Texture, Weights};
use crate::mesh::{MirrorPlane, PolygonMesh, TriangleMesh, Vec3, check_finite};
use crate::render::{self, CameraError};

/// A map from space to texture coordinates and depth: `M` of equation (1) with the divide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projector {
    /// `M_lerp M_proj M_view M_model`.
    matrix: Matrix4<f64>,
}

/// Which vertices a projected mask is for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Visibility {
    /// Those that no triangle hides. One that lies at most `tolerance` millimetres behind a triangle still counts as visible: 0.001
    /// by default, which only lets the copies of a vertex along a seam be seen.
    Visible {
        /// Millimetres, not negative.
        #[serde(default = "tolerance")]
        tolerance: f64,
    },
    /// All, as the paper does: the mask goes through the head.
    Through,
}

fn tolerance() -> f64 {
    0.001
}

impl Default for Visibility {
    fn default() -> Self {
        Self::Visible { tolerance: tolerance() }
    }
}

impl Projector {
    /// From the matrices of (1): model to world, world to camera, camera to clip space with -1 to 1 on each axis after the divide
    /// (OpenGL's conventions: x right, y up, depth grows away from the viewer, the fourth coordinate is positive in front).
    ///
    /// Near and far planes cut nothing; what lies behind the camera has no texture coordinates.
    ///
    /// # Errors
    /// When the product is not finite or singular.
    pub fn new(model: &Matrix4<f64>, view: &Matrix4<f64>, projection: &Matrix4<f64>) -> Result<Self, MorphError> {
        let lerp = Matrix4::new(0.5, 0.0, 0.0, 0.5, 0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 1.0);
        let matrix = lerp * projection * view * model;
        let inverse = matrix.try_inverse().filter(|inverse| inverse.iter().all(|m| m.is_finite()));
        if !matrix.iter().all(|m| m.is_finite()) || inverse.is_none() {
            let rows = matrix.row_iter().map(|row| format!("{:?}", row.iter().collect::<Vec<_>>()));
            return Err(MorphError::Matrix(rows.collect::<Vec<_>>().join(" ")));
        }
        Ok(Self { matrix })
    }

    /// [`render::Camera::look`] with a picture whose width is `aspect` times its height. The model's matrix is the identity.
    ///
    /// # Errors
    /// As there, or when the aspect is not positive.
    pub fn look(
        eye: Vec3,
        target: Vec3,
        up: Vec3,
        projection: render::Projection,
        aspect: f64,
    ) -> Result<Self, MorphError> {
        Self::through(&render::Camera::look(eye, target, up, projection)?, aspect)
    }

    /// The projector of a picture's camera: a mask drawn on the picture, `size` pixels wide and high, falls where it is seen.
    ///
    /// # Errors
    /// When a side of the picture is 0.
    pub fn of_camera(camera: &render::Camera, size: [u32; 2]) -> Result<Self, MorphError> {
        Self::through(camera, f64::from(size[0]) / f64::from(size[1]))
    }

    fn through(camera: &render::Camera, aspect: f64) -> Result<Self, MorphError> {
        if !(aspect > 0.0 && aspect.is_finite()) {
            return Err(CameraError("the aspect, width / height, must be positive").into());
        }
        let mut clip = Matrix4::identity();
        match camera.projection() {
            render::Projection::Perspective { vertical_fov } => {
                // Near plane at 1 mm, far plane at infinity: z' / w' = 1 - 2 / depth.
                let f = 1.0 / (vertical_fov.to_radians() / 2.0).tan();
                (clip[(0, 0)], clip[(1, 1)]) = (f / aspect, f);
                (clip[(2, 2)], clip[(2, 3)], clip[(3, 2)], clip[(3, 3)]) = (-1.0, -2.0, -1.0, 0.0);
            }
            render::Projection::Orthographic { height } => {
                (clip[(0, 0)], clip[(1, 1)], clip[(2, 2)]) = (2.0 / (height * aspect), 2.0 / height, -2.0 / height);
            }
        }
        Self::new(&Matrix4::identity(), &frame_matrix(camera.axes(), camera.eye()), &clip)
    }

    /// The parallel projection along -z of a frame, given by its unit axes and origin, onto the box from `low` to `high` in its x
    /// and y: the texture that [`Coordinates::Box`](super::Coordinates::Box) of the same corners covers.
    ///
    /// # Errors
    /// When the corners are not finite or the box has no area.
    pub(super) fn of_frame(axes: [Vec3; 3], origin: Vec3, low: [f64; 2], high: [f64; 2]) -> Result<Self, MorphError> {
        if !(0..2).all(|a| low[a].is_finite() && high[a].is_finite() && low[a] < high[a]) {
            return Err(MorphError::Covered { low, high });
        }
        let mut clip = Matrix4::identity();
        for a in 0..2 {
            let side = high[a] - low[a];
            (clip[(a, a)], clip[(a, 3)]) = (2.0 / side, -(low[a] + high[a]) / side);
        }
        clip[(2, 2)] = -2.0 / (high[1] - low[1]);
        Self::new(&Matrix4::identity(), &frame_matrix(axes, origin), &clip)
    }

    /// The projector that gives the mirror image of a point what this one gives the point: its mask is the mirror image of the mask.
    #[must_use]
    pub fn mirrored(&self, plane: &MirrorPlane) -> Self {
        Self { matrix: self.matrix * reflection(plane) }
    }

    /// `M_lerp M_proj M_view M_model`.
    #[must_use]
    pub fn matrix(&self) -> &Matrix4<f64> {
        &self.matrix
    }

    /// Texture coordinates of a point, v = 0 at the bottom row; `None` behind the camera.
    #[must_use]
    pub fn uv(&self, point: Vec3) -> Option<[f64; 2]> {
        let p = self.clip(point);
        (p.w > 0.0).then(|| [p.x / p.w, p.y / p.w])
    }

    #[inline]
    fn clip(&self, p: Vec3) -> Vector4<f64> {
        self.matrix * Vector4::new(p.x, p.y, p.z, 1.0)
    }

    /// The weight of each vertex: `texture` at its texture coordinates, equations (3) and (6); 0 outside the texture and where it is
    /// hidden.
    ///
    /// # Errors
    /// When a coordinate is not finite, a triangle has no such vertex, or the tolerance is negative or NaN.
    pub fn weights(
        &self,
        mesh: &TriangleMesh,
        texture: &Texture,
        sampling: Sampling,
        visibility: Visibility,
    ) -> Result<Weights, MorphError> {
        let positions = &mesh.positions;
        check_finite(positions)?;
        let mut weights = vec![0.0; positions.len()];
        weights.par_iter_mut().zip(positions).with_min_len(GRAIN).for_each(|(weight, p)| {
            *weight = self.uv(*p).map_or(0.0, |uv| texture.sample(uv, sampling));
        });
        if let Visibility::Visible { tolerance } = visibility {
            let hidden = Hidden { projector: self, mesh, tolerance }.of(&weights)?;
            for vertex in hidden {
                weights[vertex as usize] = 0.0;
            }
        }
        Ok(Weights::trusted(weights))
    }

    /// Whether each vertex is visible, wherever it lies on the picture's plane; nothing behind the camera is.
    ///
    /// # Errors
    /// As [`Self::weights`].
    pub fn visible(&self, mesh: &TriangleMesh, tolerance: f64) -> Result<Vec<bool>, MorphError> {
        check_finite(&mesh.positions)?;
        let mut visible: Vec<bool> = mesh.positions.iter().map(|p| self.uv(*p).is_some()).collect();
        let asked: Vec<f64> = visible.iter().map(|v| f64::from(u8::from(*v))).collect();
        for vertex in (Hidden { projector: self, mesh, tolerance }).of(&asked)? {
            visible[vertex as usize] = false;
        }
        Ok(visible)
    }
}

/// Vertices, or triangles, that stay on one thread.
const GRAIN: usize = 4096;

/// The mirror image, on homogeneous coordinates.
fn reflection(plane: &MirrorPlane) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    for column in 0..3 {
        let mut axis = Vec3::zeros();
        axis[column] = 1.0;
        m.fixed_view_mut::<3, 1>(0, column).copy_from(&plane.reflect_direction(axis));
    }
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&plane.reflect(Vec3::zeros()));
    m
}

/// From space to a frame's coordinates.
fn frame_matrix(axes: [Vec3; 3], origin: Vec3) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    for (row, axis) in axes.iter().enumerate() {
        m.fixed_view_mut::<1, 3>(row, 0).copy_from(&axis.transpose());
        m[(row, 3)] = -axis.dot(&origin);
    }
    m
}

/// The weights of a mask in the mesh's own texture coordinates (`vt` of an OBJ file), v = 0 at the texture's bottom row. A vertex that
/// has several, along a seam, takes the largest weight; one that has none, 0. What lies outside 0 to 1 gets 0: textures do not repeat.
///
/// # Errors
/// When the mesh has no texture coordinates, or a corner names one that does not exist or is not finite.
pub fn uv_weights(mesh: &PolygonMesh, texture: &Texture, sampling: Sampling) -> Result<Weights, MorphError> {
    let (uvs, indices) = (&mesh.metadata.uvs, &mesh.metadata.corner_uvs);
    if indices.is_empty() || uvs.is_empty() {
        return Err(MorphError::NoTextureCoordinates);
    }
    let mut weights = vec![0.0f64; mesh.positions.len()];
    for (corner, (&vertex, &index)) in mesh.corners.iter().zip(indices).enumerate() {
        if index == u32::MAX {
            continue;
        }
        let uv = uvs.get(index as usize).filter(|uv| uv.iter().all(|c| c.is_finite()));
        let uv = uv.ok_or(MorphError::TextureCoordinate { corner, index, count: uvs.len() })?;
        let count = weights.len();
        let weight = weights.get_mut(vertex as usize);
        let weight = weight.ok_or(MorphError::CornerVertex { corner, index: vertex, count })?;
        *weight = weight.max(texture.sample(*uv, sampling));
    }
    Ok(Weights::trusted(weights))
}

/// The test of visibility.
struct Hidden<'a> {
    projector: &'a Projector,
    mesh: &'a TriangleMesh,
    /// Millimetres.
    tolerance: f64,
}

/// A vertex on the picture.
#[derive(Clone, Copy)]
struct Spot {
    x: f64,
    y: f64,
    depth: f64,
    vertex: u32,
}

/// A vertex after the divide, or where the edge of a triangle meets the plane that cuts off what is behind the camera.
#[derive(Clone, Copy)]
struct Corner {
    /// On the picture, with depth.
    picture: [f64; 3],
    /// The fourth coordinate before the divide.
    w: f64,
}

impl Corner {
    #[inline]
    fn new(clip: Vector4<f64>) -> Self {
        Self { picture: [clip.x / clip.w, clip.y / clip.w, clip.z / clip.w], w: clip.w }
    }
}

impl Hidden<'_> {
    /// Those vertices of positive weight that a triangle hides, in no order that matters.
    fn of(&self, weights: &[f64]) -> Result<Vec<u32>, MorphError> {
        if self.tolerance.is_nan() || self.tolerance < 0.0 {
            let (what, value) = ("the tolerance of visibility", self.tolerance);
            return Err(MorphError::Option { what, value, expected: "millimetres, at least 0" });
        }
        self.mesh.check_indices()?;
        let (positions, triangles) = (&self.mesh.positions, &self.mesh.triangles);
        let inverse = self.projector.matrix.try_inverse();
        let inverse = inverse.ok_or_else(|| MorphError::Matrix(self.projector.matrix.to_string()))?;
        let corner = |p: &Vec3| Corner::new(self.projector.clip(*p));
        let vertices: Vec<Corner> = positions.par_iter().with_min_len(GRAIN).map(corner).collect();
        let Some(grid) = Grid::new(&vertices, weights) else { return Ok(Vec::new()) };
        let hidden: Vec<AtomicBool> = grid.spots.iter().map(|_| AtomicBool::new(false)).collect();
        // A triangle that reaches behind the camera is cut off a little in front of it.
        let nearest = 1e-9 * vertices.iter().map(|c| c.w.abs()).fold(0.0, f64::max);
        triangles.par_iter().with_min_len(GRAIN).for_each(|triangle| {
            let corners = triangle.map(|v| vertices[v as usize]);
            let hide = |part: &[Corner; 3]| {
                grid.for_each_in(part, |i, spot| {
                    if !triangle.contains(&spot.vertex) && self.hides(part, spot, &inverse) {
                        hidden[i].store(true, Ordering::Relaxed);
                    }
                });
            };
            if corners.iter().all(|c| c.w > nearest) {
                hide(&corners);
            } else if corners.iter().any(|c| c.w > nearest) {
                self.in_front(triangle, nearest).iter().for_each(hide);
            }
        });
        let hidden = grid.spots.iter().zip(&hidden).filter(|(_, hidden)| hidden.load(Ordering::Relaxed));
        Ok(hidden.map(|(spot, _)| spot.vertex).collect())
    }

    /// Does the spot lie inside the projection of the corners, and behind them?
    #[inline]
    fn hides(&self, corners: &[Corner; 3], spot: &Spot, inverse: &Matrix4<f64>) -> bool {
        let [a, b, c] = corners.map(|corner| [corner.picture[0] - spot.x, corner.picture[1] - spot.y]);
        // Each is the exact negative of what the triangle on the other side of that edge gets, so there is no gap between them.
        let edges = [cross(b, c), cross(c, a), cross(a, b)];
        let area = edges[0] + edges[1] + edges[2];
        if area == 0.0 || !(edges.iter().all(|e| *e >= 0.0) || edges.iter().all(|e| *e <= 0.0)) {
            return false;
        }
        // Depth is linear on the picture, and so is 1 / w.
        let depth = (0..3).map(|k| edges[k] * corners[k].picture[2]).sum::<f64>() / area;
        if depth >= spot.depth {
            return false;
        }
        let reciprocal = (0..3).map(|k| edges[k] / corners[k].w).sum::<f64>() / area;
        let before = inverse * (Vector4::new(spot.x, spot.y, depth, 1.0) / reciprocal);
        let gap = before.xyz() / before.w - self.mesh.positions[spot.vertex as usize];
        gap.norm() > self.tolerance
    }

    /// The part of a triangle where the fourth coordinate is at least `nearest`, in triangles.
    fn in_front(&self, triangle: &[u32; 3], nearest: f64) -> Vec<[Corner; 3]> {
        let clip = triangle.map(|v| self.projector.clip(self.mesh.positions[v as usize]));
        let mut polygon: Vec<Corner> = Vec::with_capacity(4);
        for (p, q) in [(clip[0], clip[1]), (clip[1], clip[2]), (clip[2], clip[0])] {
            if p.w > nearest {
                polygon.push(Corner::new(p));
            }
            if (p.w > nearest) != (q.w > nearest) {
                let mut cut = p.lerp(&q, (nearest - p.w) / (q.w - p.w));
                cut.w = nearest;
                polygon.push(Corner::new(cut));
            }
        }
        (2..polygon.len()).map(|k| [polygon[0], polygon[k - 1], polygon[k]]).collect()
    }
}

#[inline(always)]
fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Spots sorted into the cells of a grid, row by row, and by x in each row.
struct Grid {
    low: [f64; 2],
    high: [f64; 2],
    /// Cells to a unit of the picture.
    scale: [f64; 2],
    columns: usize,
    rows: usize,
    /// Start of each cell in `spots`, and their number at the end.
    starts: Vec<u32>,
    spots: Vec<Spot>,
}

/// Spots to a cell, if they were spread evenly.
const SPOTS_PER_CELL: f64 = 2.0;
/// Spots above which a search is worth its while.
const CROWD: usize = 32;

impl Grid {
    /// The vertices of positive weight, which all lie in front of the camera; `None` if there are none.
    fn new(vertices: &[Corner], weights: &[f64]) -> Option<Self> {
        const NOWHERE: (usize, [f64; 2], [f64; 2]) = (0, [f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let join = |a: (usize, [f64; 2], [f64; 2]), b: (usize, [f64; 2], [f64; 2])| {
            let (low, high) = ([0, 1].map(|k| a.1[k].min(b.1[k])), [0, 1].map(|k| a.2[k].max(b.2[k])));
            (a.0 + b.0, low, high)
        };
        let asked = vertices.par_iter().with_min_len(GRAIN).zip(weights).filter(|(_, weight)| **weight > 0.0);
        let boxes = asked.map(|(v, _)| (1, [v.picture[0], v.picture[1]], [v.picture[0], v.picture[1]]));
        let (count, low, high) = boxes.reduce(|| NOWHERE, join);
        if count == 0 {
            return None;
        }
        let size = [high[0] - low[0], high[1] - low[1]].map(|s| s.max(f64::MIN_POSITIVE));
        let cells = (count as f64 / SPOTS_PER_CELL).max(1.0);
        // As square as the box allows, and never more than that many.
        let columns = ((cells * size[0] / size[1]).sqrt().clamp(1.0, cells)) as usize;
        let rows = ((cells / columns as f64).max(1.0)) as usize;
        let mut grid = Self {
            low,
            high,
            scale: [columns as f64 / size[0], rows as f64 / size[1]],
            columns,
            rows,
            starts: vec![0; columns * rows + 2],
            spots: vec![Spot { x: 0.0, y: 0.0, depth: 0.0, vertex: 0 }; count],
        };
        let cell = |(v, weight): (&Corner, &f64)| {
            if *weight > 0.0 { (grid.row(v.picture[1]) * columns + grid.column(v.picture[0])) as u32 } else { u32::MAX }
        };
        let cells: Vec<u32> = vertices.par_iter().with_min_len(GRAIN).zip(weights).map(cell).collect();
        // Shifted by one cell, so that filling in moves each start to where it belongs.
        for &cell in cells.iter().filter(|cell| **cell != u32::MAX) {
            grid.starts[cell as usize + 2] += 1;
        }
        for cell in 2..grid.starts.len() {
            grid.starts[cell] += grid.starts[cell - 1];
        }
        for ((vertex, v), &cell) in (0u32..).zip(vertices).zip(&cells) {
            if cell != u32::MAX {
                let at = &mut grid.starts[cell as usize + 1];
                let [x, y, depth] = v.picture;
                grid.spots[*at as usize] = Spot { x, y, depth, vertex };
                *at += 1;
            }
        }
        grid.sort_rows();
        Some(grid)
    }

    /// Sorts the spots of each row by x: cells are in that order, so each by itself.
    fn sort_rows(&mut self) {
        let (mut rest, mut rows) = (&mut self.spots[..], Vec::with_capacity(self.rows));
        for row in self.starts.windows(self.columns + 1).step_by(self.columns).take(self.rows) {
            let (spots, after) = rest.split_at_mut((row[self.columns] - row[0]) as usize);
            rest = after;
            rows.push((row, spots));
        }
        rows.into_par_iter().for_each(|(starts, spots)| {
            for cell in starts.windows(2) {
                let cell = &mut spots[(cell[0] - starts[0]) as usize..(cell[1] - starts[0]) as usize];
                cell.sort_unstable_by(|a, b| a.x.total_cmp(&b.x));
            }
        });
    }

    #[inline]
    fn column(&self, x: f64) -> usize {
        // The cast takes what is negative to 0.
        (((x - self.low[0]) * self.scale[0]) as usize).min(self.columns - 1)
    }

    #[inline]
    fn row(&self, y: f64) -> usize {
        (((y - self.low[1]) * self.scale[1]) as usize).min(self.rows - 1)
    }

    /// Calls `visit` for every spot in a cell that the box round the triangle touches, and that lies in that box.
    #[inline]
    fn for_each_in(&self, triangle: &[Corner; 3], mut visit: impl FnMut(usize, &Spot)) {
        let [a, b, c] = triangle.map(|corner| corner.picture);
        let low = [a[0].min(b[0]).min(c[0]), a[1].min(b[1]).min(c[1])];
        let high = [a[0].max(b[0]).max(c[0]), a[1].max(b[1]).max(c[1])];
        // Also false for NaN.
        if !(low[0] <= self.high[0] && low[1] <= self.high[1] && high[0] >= self.low[0] && high[1] >= self.low[1]) {
            return;
        }
        let (left, right) = (self.column(low[0]), self.column(high[0]));
        let nearest = a[2].min(b[2]).min(c[2]);
        for row in self.row(low[1])..=self.row(high[1]) {
            let cells = row * self.columns;
            let (mut first, mut end) = (self.starts[cells + left] as usize, self.starts[cells + right + 1] as usize);
            // Where vertices crowd, a cell holds many more than a small triangle meets.
            if end - first > CROWD {
                end = first + self.spots[first..end].partition_point(|spot| spot.x <= high[0]);
                first += self.spots[first..end].partition_point(|spot| spot.x < low[0]);
            }
            for (i, spot) in (first..).zip(&self.spots[first..end]) {
                // One branch: each by itself is a toss-up.
                let beside = (spot.x < low[0]) | (spot.x > high[0]) | (spot.y < low[1]) | (spot.y > high[1]);
                if !(beside | (spot.depth <= nearest)) {
                    visit(i, spot);
                }
            }
        }
    }
}
