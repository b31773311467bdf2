//! Residuals over a few vertices each, as of springs and tetrahedra: items of the assembler on the blocks of those that are free.

use super::vertex_assembly::{HELD, VertexAssembly};
use crate::mesh::Vec3;
use crate::nlls::{Assembly, BlockStructure, NormalEquations};

/// Elements of `N` different nodes.
pub(super) struct Elements<const N: usize> {
    /// The nodes of each.
    pub nodes: Vec<[u32; N]>,
    /// Which of its item's blocks each node has, or [`HELD`].
    slots: Vec<[u32; N]>,
    assembly: Assembly,
}

impl<const N: usize> Elements<N> {
    pub fn new(nodes: Vec<[u32; N]>) -> Self {
        Self { nodes, slots: Vec::new(), assembly: Assembly::default() }
    }

    /// Which nodes meet.
    pub fn cliques(&self) -> impl Iterator<Item = &[u32]> {
        self.nodes.iter().map(|n| &n[..])
    }

    /// Lays the elements out for equations of at most `rows` residuals each.
    pub fn analyse(&mut self, vertices: &VertexAssembly, structure: &BlockStructure, rows: usize) {
        self.slots = vec![[HELD; N]; self.nodes.len()];
        let (mut blocks, mut starts) = (Vec::new(), vec![0]);
        for (nodes, slots) in self.nodes.iter().zip(&mut self.slots) {
            let mut free: Vec<(u32, usize)> = (0..N).map(|k| (vertices.blocks[nodes[k] as usize], k)).collect();
            free.retain(|f| f.0 != HELD);
            free.sort_unstable();
            for (slot, &(block, k)) in free.iter().enumerate() {
                slots[k] = slot as u32;
                blocks.push(block);
            }
            starts.push(blocks.len());
        }
        self.assembly = Assembly::new(starts.windows(2).map(|s| &blocks[s[0]..s[1]]), structure, |_| rows);
    }

    /// Adds `R` residuals of each element to the equations; `rows` gives their derivatives by its nodes and their values.
    pub fn add<const R: usize>(
        &mut self,
        equations: &mut NormalEquations,
        rows: impl Fn(usize, [u32; N]) -> ([[Vec3; N]; R], [f64; R]) + Sync,
    ) {
        let (nodes, slots) = (&self.nodes, &self.slots);
        self.assembly.linearize(
            0,
            |_| R,
            #[inline(always)]
            |element, out| {
                let (jacobian, residuals) = rows(element, nodes[element]);
                for (r, by_node) in jacobian.iter().enumerate() {
                    for (derivative, &slot) in by_node.iter().zip(&slots[element]).filter(|s| *s.1 != HELD) {
                        out.of_block(slot as usize, r)[..3].copy_from_slice(derivative.as_slice());
                    }
                }
                out.set_residuals(&residuals);
            },
        );
        self.assembly.add_to(equations);
    }
}
