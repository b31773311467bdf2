//! The template as a registration uses it.

use super::facing;
use super::{Level, Schedule};
use super::{RegistrationError, RegistrationInput};
use crate::correspondence::{ScanSurface, VertexMasks};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::normals::{NormalWeighting, vertex_areas, vertex_normals};
use crate::mesh::{MeshError, TriangleMesh, Vec3, hidden_vertices, referenced, rms_size};

/// The shape that a stage deforms, in the first stage the centred rest shape, and how the schedule's units translate to it.
pub(super) struct Rest {
    pub mesh: TriangleMesh,
    /// Vertices that a triangle uses.
    pub used: Vec<bool>,
    /// Vertices that the template hides from scanners.
    pub hidden: Vec<bool>,
    /// Which vertices the scan has a say in, at all and, with what the level says of the rim, now.
    all_masks: VertexMasks,
    pub masks: VertexMasks,
    edges: EdgeGraph,
    /// Surface that each vertex stands for, and by its side that of a sample of the scan, zero before that is known. Vertices finer
    /// than the schedule's reference template are crowded no sooner: they weigh less already.
    areas: Vec<f64>,
    sample_area: f64,
    pub centre: Vec3,
    /// Length of one of the schedule's millimetres.
    pub unit: f64,
    /// Weight per vertex for weight one on the schedule's reference template.
    pub density: f64,
}

impl Rest {
    pub fn new(input: &RegistrationInput<'_>, schedule: &Schedule) -> Result<Self, RegistrationError> {
        let mut mesh = input.template.triangulate();
        mesh.positions.copy_from_slice(input.rest_positions());
        let used = referenced(mesh.positions.len(), mesh.triangles.as_flattened().iter().copied());
        let points = mesh.surface_points();
        let count = points.len() as f64;
        let centre = points.iter().sum::<Vec3>() / count;
        let unit = rms_size(&points) / schedule.reference_size;
        mesh.positions.iter_mut().for_each(|p| *p -= centre);
        let finer = (count / schedule.reference_vertices).sqrt();
        let edges = EdgeGraph::of(&mesh);
        if mesh.triangles.len() > 1 && !edges.has_inner_edges() {
            return Err(RegistrationError::Template(MeshError::Unconnected.to_string()));
        }
        let rim = rim(&edges, (schedule.scan.template_rim * finer).round() as usize);
        let hidden = hidden(&mesh)?;
        let masks = VertexMasks::new(input.mask, input.free_mask, rim).without(|v| !used[v]);
        let density = schedule.reference_vertices / count;
        let areas = vertex_areas(&mesh.positions, &mesh.triangles);
        Ok(Self {
            mesh,
            used,
            hidden,
            all_masks: masks.clone(),
            masks,
            edges,
            areas,
            sample_area: 0.0,
            centre,
            unit,
            density,
        })
    }

    /// From now on the scan has no say in what the template hides at rest, if that leaves it any.
    pub fn reject_hidden(&mut self) {
        self.reject(&self.hidden.clone());
    }

    /// The same of what it hides where its vertices are now.
    pub fn reject_hidden_at(&mut self, vertices: &[Vec3]) -> Result<(), RegistrationError> {
        let mesh = TriangleMesh { positions: vertices.to_vec(), triangles: self.mesh.triangles.clone() };
        self.reject(&hidden(&mesh)?);
        Ok(())
    }

    fn reject(&mut self, hidden: &[bool]) {
        let shown = self.all_masks.clone().without(|v| hidden[v]);
        if shown.counted() > 0 {
            self.masks = shown;
        }
    }

    /// Hears of the scan, where it lies over the template.
    pub fn set_scan(&mut self, scan: &ScanSurface) {
        self.sample_area = scan.sample_area() * self.density.min(1.0);
    }

    /// Which vertices take correspondences from now on, and what they weigh.
    pub fn set_level(&mut self, level: &Level) {
        self.masks.share_samples(&self.areas, level.sampling * self.sample_area);
        self.masks.rim.iter_mut().zip(&self.all_masks.rim).for_each(|(now, on_rim)| *now = level.reject_rim && *on_rim);
        if level.thinned {
            self.masks.thin(&self.edges);
        } else {
            self.masks.let_all_speak();
        }
    }

    /// Whether the scan faces inwards, by its normals near vertices of the model.
    pub fn sees_the_inside(&self, scan: &ScanSurface, vertices: &[Vec3]) -> bool {
        let normals = vertex_normals(vertices, &self.mesh.triangles, NormalWeighting::Area);
        let unseen = self.masks.unseen();
        let each = vertices.len() / FACING_VERTICES + 1;
        let chosen = || (0..vertices.len()).step_by(each).filter(|&v| !unseen[v] && normals[v] != Vec3::zeros());
        let points: Vec<Vec3> = chosen().map(|v| vertices[v]).collect();
        let normals: Vec<Vec3> = chosen().map(|v| normals[v]).collect();
        facing::faces_inwards(scan, &points, &normals, FACING_REACH * self.unit)
    }
}

fn hidden(mesh: &TriangleMesh) -> Result<Vec<bool>, RegistrationError> {
    hidden_vertices(mesh).map_err(|e| RegistrationError::Template(e.to_string()))
}

/// Vertices of the template that are asked, about, and how far from the scan they may be, millimetres.
const FACING_VERTICES: usize = 1000;
const FACING_REACH: f64 = 20.0;

/// The vertices within `rings` rings of the open boundary; the boundary itself is the first.
fn rim(edges: &EdgeGraph, rings: usize) -> Vec<bool> {
    let mut marked = edges.boundary_vertices();
    marked.iter_mut().for_each(|m| *m &= rings > 0);
    for _ in 1..rings {
        let grown = (0..marked.len()).map(|i| marked[i] || edges.neighbours(i).iter().any(|&j| marked[j as usize]));
        marked = grown.collect();
    }
    marked
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;

    #[test]
    fn the_rim_grows_ring_by_ring() {
        let mesh = sheet(9, 7, |c, r| Vec3::new(c, r, 0.0));
        for (rings, marked) in [(0, 0), (1, 28), (2, 48), (3, 60), (4, 63), (9, 63)] {
            let rim = rim(&EdgeGraph::of(&mesh), rings);
            assert_eq!(rim.iter().filter(|m| **m).count(), marked, "{rings} rings");
            for (p, in_rim) in mesh.positions.iter().zip(rim) {
                let depth = p.x.min(8.0 - p.x).min(p.y).min(6.0 - p.y);
                assert_eq!(in_rim, depth < rings as f64, "{rings} rings, {p}");
            }
        }
    }

    #[test]
    fn a_closed_surface_has_no_rim() {
        let positions = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let closed = TriangleMesh { positions, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] };
        assert_eq!(rim(&EdgeGraph::of(&closed), 3), [false; 4]);
        let opened = TriangleMesh { triangles: closed.triangles[..3].to_vec(), ..closed };
        assert_eq!(rim(&EdgeGraph::of(&opened), 1), [true, false, true, true]);
    }
}
