//! What is in a picture: layers of surfaces, wireframes and points.

use super::{ColourScale, Rgb8};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};

/// How a surface looks.
#[derive(Debug, Clone, PartialEq)]
pub enum Style {
    /// Matt clay, smoothly shaded; the inside of a surface is a bluish grey.
    Clay,
    /// Clay of another colour, the same on both sides.
    Solid(Rgb8),
    /// Clay under a colour with a weight per vertex, 0 to 1: C_r = C_d (1 - G) + C_s G, equation (4) of Li et al. 2018, where
    /// `C_d` is the lit clay and the colours are mixed as light. Missing weights and NaN are 0.
    Overlay(Vec<f64>, Rgb8),
    /// One value per vertex, shown by a scale; NaN and missing values are grey. Shading is kept weak to leave the colours
    /// readable.
    Values(Vec<f64>, ColourScale),
}

pub(super) struct Surface {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub style: Style,
}

pub(super) struct Wires {
    pub positions: Vec<Vec3>,
    pub edges: Vec<[u32; 2]>,
    /// The polygons' own surface: hides the lines behind it without being drawn.
    pub occluder: Vec<[u32; 3]>,
    pub colour: Rgb8,
    /// Output pixels.
    pub width: f64,
}

pub(super) struct Points {
    pub positions: Vec<Vec3>,
    pub colour: Rgb8,
    /// Output pixels.
    pub radius: f64,
}

/// Layers to be drawn together, hiding each other. Layers copy what they are given.
#[derive(Default)]
pub struct Scene {
    pub(super) surfaces: Vec<Surface>,
    pub(super) wires: Vec<Wires>,
    pub(super) points: Vec<Points>,
}

impl Scene {
    /// An empty scene.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a surface. Triangles with a vertex that is NaN or does not exist are left out.
    #[must_use]
    pub fn mesh(self, mesh: &TriangleMesh, style: Style) -> Self {
        self.mesh_without(mesh, &[], style)
    }

    /// Adds a surface without the triangles that touch a vertex marked in `hidden` (missing marks are `false`).
    #[must_use]
    pub fn mesh_without(mut self, mesh: &TriangleMesh, hidden: &[bool], style: Style) -> Self {
        let shown = |v: &u32| {
            !hidden.get(*v as usize).copied().unwrap_or(false)
                && mesh.positions.get(*v as usize).is_some_and(|p| p.iter().all(|c| c.is_finite()))
        };
        let triangles = mesh.triangles.iter().copied().filter(|t| t.iter().all(shown)).collect();
        self.surfaces.push(Surface { positions: mesh.positions.clone(), triangles, style });
        self
    }

    /// Adds the edges of the polygons (not of their triangles) as thin dark lines.
    #[must_use]
    pub fn wireframe(self, mesh: &PolygonMesh) -> Self {
        self.wireframe_with(mesh, [62, 60, 64], 0.6)
    }

    /// Adds the edges of the polygons as lines of `width` output pixels. The mesh's own surface hides what is behind it,
    /// also when it is not drawn itself.
    #[must_use]
    pub fn wireframe_with(mut self, mesh: &PolygonMesh, colour: Rgb8, width: f64) -> Self {
        let known = |v: &u32| mesh.positions.get(*v as usize).is_some_and(|p| p.iter().all(|c| c.is_finite()));
        let (mut edges, mut occluder) = (Vec::new(), Vec::new());
        for range in mesh.starts.windows(2) {
            let Some(q) = mesh.corners.get(range[0] as usize..range[1] as usize) else { continue };
            if q.len() < 2 || !q.iter().all(known) {
                continue;
            }
            for (i, &a) in q.iter().enumerate() {
                let b = q[(i + 1) % q.len()];
                edges.push([a.min(b), a.max(b)]);
            }
            occluder.extend((1..q.len() - 1).map(|i| [q[0], q[i], q[i + 1]]));
        }
        edges.sort_unstable();
        edges.dedup();
        self.wires.push(Wires { positions: mesh.positions.clone(), edges, occluder, colour, width });
        self
    }

    /// Adds a point cloud as small discs of `radius` output pixels.
    #[must_use]
    pub fn points(mut self, points: &[Vec3], colour: Rgb8, radius: f64) -> Self {
        self.points.push(Points { positions: points.to_vec(), colour, radius });
        self
    }
}
