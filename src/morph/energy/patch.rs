//! The part of a mesh that an energy is about: what moves, and what is held round it.

use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::normals::vertex_areas;
use crate::mesh::{TriangleMesh, sewn};
use crate::morph::Weights;

/// What moves with two rings of held vertices: every star that a moving vertex is part of is whole, so energies over stars and
/// their derivatives are those on the whole mesh, and the cost is the region's. Vertices that stand more than once along a [seam](sewn)
/// are one here: they move together, as much as the one that moves most.
pub(super) struct Patch {
    /// Vertex of the whole mesh, the first along a seam, for each vertex of the patch; ascending.
    pub vertices: Vec<u32>,
    /// The patch.
    pub mesh: TriangleMesh,
    /// Whether a vertex of the patch is held.
    pub held: Vec<bool>,
    /// Vertex of the patch for each of the whole mesh, or [`OUTSIDE`].
    index: Vec<u32>,
    /// Square millimetres to a vertex that moves; 1 where there is no area.
    pub vertex_area: f64,
}

const OUTSIDE: u32 = u32::MAX;

impl Patch {
    /// The patch round the vertices that are marked in `moves`. Triangles must have vertices that exist.
    pub fn around(mesh: &TriangleMesh, moves: &[bool]) -> Self {
        let first = sewn(mesh, |_, _| true);
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| first[v as usize])).collect();
        let mut sewn_moves = vec![false; moves.len()];
        first.iter().zip(moves).for_each(|(&v, moves)| sewn_moves[v as usize] |= moves);
        let mut inside = sewn_moves.clone();
        for _ in 0..2 {
            let before = inside.clone();
            for t in triangles.iter().filter(|t| t.iter().any(|v| before[*v as usize])) {
                t.iter().for_each(|v| inside[*v as usize] = true);
            }
        }
        let vertices: Vec<u32> = (0..moves.len() as u32).filter(|v| inside[*v as usize]).collect();
        let mut index = vec![OUTSIDE; moves.len()];
        vertices.iter().enumerate().for_each(|(k, &v)| index[v as usize] = k as u32);
        let whole = triangles.iter().filter(|t| t.iter().all(|v| inside[*v as usize]));
        let patch = TriangleMesh {
            positions: vertices.iter().map(|&v| mesh.positions[v as usize]).collect(),
            triangles: whole.map(|t| t.map(|v| index[v as usize])).collect(),
        };
        let index = first.iter().map(|&v| index[v as usize]).collect();
        let held: Vec<bool> = vertices.iter().map(|&v| !sewn_moves[v as usize]).collect();
        let areas = vertex_areas(&patch.positions, &patch.triangles);
        let area: f64 = areas.iter().zip(&held).filter(|(_, held)| !**held).map(|(a, _)| a).sum();
        let moving = held.iter().filter(|h| !**h).count() as f64;
        let vertex_area = if area > 0.0 { area / moving } else { 1.0 };
        Self { vertices, mesh: patch, held, index, vertex_area }
    }

    /// The weight of each vertex of the patch; along a seam the largest.
    pub fn weights(&self, of_mesh: &Weights) -> Vec<f64> {
        let mut weights = vec![0.0_f64; self.vertices.len()];
        for (&k, weight) in self.index.iter().zip(of_mesh.values()).filter(|(k, _)| **k != OUTSIDE) {
            weights[k as usize] = weights[k as usize].max(*weight);
        }
        weights
    }

    /// The vertices of the whole mesh that move, each with its vertex of the patch.
    pub fn movers(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let inside = self.index.iter().enumerate().filter(|(_, k)| **k != OUTSIDE);
        inside.map(|(v, k)| (v, *k as usize)).filter(|(_, k)| !self.held[*k])
    }

    /// How many vertices of the patch move.
    pub fn moving(&self) -> usize {
        self.held.iter().filter(|h| !**h).count()
    }

    /// The vertex of the patch that is vertex `v` of the whole mesh.
    pub fn find(&self, v: u32) -> Option<u32> {
        Some(self.index[v as usize]).filter(|k| *k != OUTSIDE)
    }

    /// The connected part of each vertex of the patch, numbered from 0; one that no triangle refers to is a part of its own.
    pub fn parts(&self) -> (Vec<usize>, usize) {
        let components = EdgeGraph::of(&self.mesh).components();
        let mut count = components.count();
        let part = components.labels().iter().map(|&label| {
            if (label as usize) < components.count() {
                return label as usize;
            }
            count += 1;
            count - 1
        });
        (part.collect(), count)
    }
}
