//! The same landmarks as vertices, points of triangles or points in space, and on another mesh.

use std::path::Path;

use super::pairs::nearest_vertex;
use super::{LandmarkPlace, LandmarkSet, LengthUnit, PlacedLandmark, ReadError, TemplatePoint};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{MeshError, PolygonMesh, Vec3};

/// Kinds of [`LandmarkPlace`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaceKind {
    /// The nearest vertex.
    Vertex,
    /// The closest point of the surface.
    Face,
    /// A point in space.
    Position,
}

impl LandmarkSet {
    /// Where the landmarks are on or off a mesh, in their order; `path` is named in errors.
    ///
    /// # Errors
    /// On indices out of range.
    pub fn positions_on(&self, path: &Path, mesh: &PolygonMesh) -> Result<Vec<Vec3>, ReadError> {
        let fixed = self.on_template(path, mesh)?;
        let position = |(landmark, (_, fixed)): (&PlacedLandmark, (String, TemplatePoint))| match landmark.place {
            LandmarkPlace::Position(p) => p,
            _ => fixed.position(&mesh.positions),
        };
        Ok(self.landmarks.iter().zip(fixed).map(position).collect())
    }

    /// The same landmarks as places of another kind on a mesh; with how far the farthest was moved, millimetres.
    ///
    /// # Errors
    /// When the mesh's faces index past its vertices. A landmark keeps its place when the mesh has no such places.
    ///
    /// # Panics
    /// When there is not one position for each landmark.
    pub fn placed_as(&self, kind: PlaceKind, positions: &[Vec3], mesh: &PolygonMesh) -> Result<(Self, f64), MeshError> {
        assert_eq!(positions.len(), self.landmarks.len(), "a position for each landmark");
        let triangles = mesh.triangulate();
        let surface = ClosestPoint::new(&triangles)?;
        let mut set = self.clone();
        if kind == PlaceKind::Position {
            set.unit.get_or_insert(LengthUnit::Millimetre); // as meshes that were read
        }
        let (on_surface, mut farthest) = (mesh.on_surface(), 0.0_f64);
        for (landmark, p) in set.landmarks.iter_mut().zip(positions) {
            let place = match kind {
                PlaceKind::Position => Some((LandmarkPlace::Position(*p), *p)),
                PlaceKind::Vertex => nearest_vertex(&mesh.positions, &on_surface, *p)
                    .map(|v| (LandmarkPlace::Vertex(i64::from(v)), TemplatePoint::Vertex(v).position(&mesh.positions))),
                PlaceKind::Face => surface.query(p).map(|c| {
                    let triangle = u64::from(c.triangle);
                    (LandmarkPlace::Face { triangle, barycentric: c.barycentric }, c.point)
                }),
            };
            if let Some((place, at)) = place {
                landmark.place = place;
                farthest = farthest.max((at - p).norm());
            }
        }
        Ok((set, farthest))
    }

    /// The landmarks of `from` as points in space on `to`, and how far each was moved to reach a surface, millimetres.
    ///
    /// Meshes of the same polygons correspond by those. Others need `via`, one of them registered onto the other: it has the
    /// polygons of one and the shape of the other, where the closest point of the surface is taken.
    ///
    /// # Errors
    /// On indices out of range, and where no meshes correspond.
    pub fn transfer(
        &self,
        path: &Path,
        from: &PolygonMesh,
        via: Option<&PolygonMesh>,
        to: &PolygonMesh,
    ) -> Result<(Self, Vec<f64>), LandmarkError> {
        let at = self.positions_on(path, from)?;
        let carried = |set: &Self, a: &PolygonMesh, b: &PolygonMesh| -> Result<(Vec<Vec3>, Vec<f64>), LandmarkError> {
            let at = set.positions_on(path, a)?;
            let points = set.placed_as(PlaceKind::Face, &at, a)?.0.on_template(path, a)?;
            let moved =
                points.iter().zip(&at).map(|((_, point), p)| (point.position(&a.positions) - p).norm()).collect();
            Ok((points.iter().map(|(_, p)| p.position(&b.positions)).collect(), moved))
        };
        let (points, moved) = match via {
            None if same_polygons(from, to) => carried(self, from, to)?,
            Some(via) if same_polygons(from, via) => {
                let (points, moved) = carried(self, from, via)?;
                let surface = ClosestPoint::new(&to.triangulate())?;
                let closest: Vec<_> = points.iter().filter_map(|p| surface.query(p)).collect();
                if closest.len() != points.len() {
                    return Err(LandmarkError::NoSurface);
                }
                let moved = closest.iter().zip(moved).map(|(c, moved)| c.squared_distance.sqrt().max(moved)).collect();
                (closest.iter().map(|c| c.point).collect(), moved)
            }
            Some(via) if same_polygons(via, to) => {
                let (in_space, _) = self.placed_as(PlaceKind::Position, &at, from)?;
                carried(&in_space, via, to)?
            }
            _ => return Err(LandmarkError::NoCorrespondence),
        };
        Ok((self.placed_as(PlaceKind::Position, &points, to)?.0, moved))
    }
}

fn same_polygons(a: &PolygonMesh, b: &PolygonMesh) -> bool {
    a.positions.len() == b.positions.len() && (&a.starts, &a.corners) == (&b.starts, &b.corners)
}

/// Why landmarks could not be checked on a mesh, or carried to another one.
#[derive(Debug, thiserror::Error)]
pub enum LandmarkError {
    /// The landmarks do not fit the mesh that they should be on.
    #[error(transparent)]
    Landmarks(#[from] ReadError),
    /// A mesh is broken.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A mesh has no triangles.
    #[error("the mesh for the landmarks has no triangles")]
    NoSurface,
    /// No two meshes have the same polygons.
    #[error(
        "the meshes do not correspond: give two of the same polygons, or besides them one of them registered onto the other"
    )]
    NoCorrespondence,
}
