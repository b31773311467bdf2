//! Samples as items of the assembler: `Y_sj = A_s dv_s/dT_j` by forward-mode duals through every node's map and the product rule,
//! `U_s = A_s dv_s/dw` by the constant slabs of the blendshapes.

use pulp::Simd;

use super::{MapJacobians, NodeGraph, ShapeBasis};
use crate::energy::{Quadric, Samples};
use crate::mesh::Vec3;
use crate::mesh::rows::Rows;
use crate::nlls::dense_kernels::prefetch;
use crate::nlls::{FillRows, ItemRows};

/// What a sample's position is made of: blended vertices, moved by the graph.
#[derive(Clone, Copy)]
pub(super) struct Blended<'a> {
    pub graph: &'a NodeGraph,
    pub shapes: &'a ShapeBasis,
    /// `b_i(w)`.
    pub vertices: &'a [Vec3],
}

/// The samples, those that one node moves most next to each other: what a node reads of its samples then lies close together.
#[derive(Default)]
pub(super) struct NodeSamples {
    /// Index of each in the problem's samples.
    pub order: Vec<u32>,
    nodes: Rows,
    corners: Rows<Corner>,
    slots: Vec<u32>,
}

/// One vertex of a sample with its weight.
pub(super) struct Corner {
    pub vertex: u32,
    pub weight: f64,
    first_slot: u32,
}

/// Slot of a node that is no parameter.
pub(super) const FIXED: u32 = u32::MAX;

impl NodeSamples {
    pub fn new(samples: &Samples, graph: &NodeGraph) -> Self {
        let order = by_strongest_node(samples, graph);
        let (mut all, mut nodes) = (Self::default(), Vec::new());
        for &s in &order {
            let corners = samples.corners(s as usize);
            let moved_by = corners.iter().flat_map(|c| graph.influences(c.0 as usize).iter().map(|i| i.0));
            nodes.clear();
            nodes.extend(moved_by.filter(|j| (*j as usize) < graph.free_nodes()));
            nodes.sort_unstable();
            nodes.dedup();
            let slot = |j: u32| nodes.binary_search(&j).map_or(FIXED, |slot| slot as u32);
            all.corners.push(corners.iter().map(|&(vertex, weight)| {
                let first_slot = all.slots.len() as u32;
                all.slots.extend(graph.influences(vertex as usize).iter().map(|i| slot(i.0)));
                Corner { vertex, weight, first_slot }
            }));
            all.nodes.push(nodes.iter().copied());
        }
        Self { order, ..all }
    }

    /// Free nodes that move an item, ascending.
    #[inline(always)]
    pub fn nodes(&self, item: usize) -> &[u32] {
        self.nodes.row(item)
    }

    /// The same of every item.
    pub fn all_nodes(&self) -> impl Iterator<Item = &[u32]> {
        self.nodes.iter()
    }

    #[inline(always)]
    pub fn corners(&self, item: usize) -> &[Corner] {
        self.corners.row(item)
    }

    /// Which of its item's nodes each influence of a corner is, and more after them.
    #[inline(always)]
    pub fn slots(&self, corner: &Corner) -> &[u32] {
        &self.slots[corner.first_slot as usize..]
    }

    /// The quadric of an item.
    #[inline(always)]
    pub fn quadric<'a>(&self, item: usize, quadrics: &'a [Quadric]) -> &'a Quadric {
        &quadrics[self.order[item] as usize]
    }
}

/// The samples by the node that moves each most.
fn by_strongest_node(samples: &Samples, graph: &NodeGraph) -> Vec<u32> {
    let strongest = |s: u32| {
        let corner = samples.corners(s as usize).first()?;
        graph.influences(corner.0 as usize).iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|influence| influence.0)
    };
    let mut order: Vec<u32> = (0..samples.len() as u32).collect();
    order.sort_by_cached_key(|&s| strongest(s));
    order
}

/// Forward-mode duals through every node's map, then the product rule; blendshapes enter as constant slabs.
pub(super) struct Structured<'a, const W: usize> {
    pub samples: &'a NodeSamples,
    pub maps: &'a MapJacobians<W>,
    pub quadrics: &'a [Quadric],
    pub blended: Blended<'a>,
}

/// How many samples before a sample its shapes are fetched.
const SAMPLES_AHEAD: usize = 3;

impl<const W: usize> FillRows for Structured<'_, W> {
    type Scratch = ();

    fn count(&self, item: usize) -> usize {
        self.samples.quadric(item, self.quadrics).rows().len()
    }

    #[inline(always)]
    fn fill<S: Simd>(&self, simd: S, item: usize, (): &mut (), out: &mut ItemRows<'_>) {
        let Blended { graph, shapes, vertices } = self.blended;
        let quadric = self.samples.quadric(item, self.quadrics);
        let rows = quadric.rows();
        if item + SAMPLES_AHEAD < self.samples.order.len() {
            for corner in self.samples.corners(item + SAMPLES_AHEAD) {
                for (_, slab) in shapes.vertex(corner.vertex as usize) {
                    (0..slab.len()).step_by(16).for_each(|at| prefetch(slab, at));
                }
            }
        }
        for (c, corner) in self.samples.corners(item).iter().enumerate() {
            let i = corner.vertex as usize;
            // Rbar_i, scaled by the corner's weight.
            let mut rbar = [[0.0; 3]; 3];
            for (&(j, omega), &slot) in graph.influences(i).iter().zip(self.samples.slots(corner)) {
                let (map, weight) = (self.maps.value(j as usize), corner.weight * omega);
                for a in 0..3 {
                    for b in 0..3 {
                        rbar[a][b] += weight * map.linear[a][b];
                    }
                }
                if slot == FIXED {
                    continue;
                }
                let q = (vertices[i] - graph.nodes()[j as usize]).into();
                for (r, row) in rows.iter().enumerate() {
                    let y = out.of_block(slot as usize, r);
                    self.maps.add_pulled_back(simd, j as usize, row.map(|e| weight * e), q, y);
                }
            }
            for (columns, slab) in shapes.vertex(i) {
                for (r, row) in rows.iter().enumerate() {
                    let direction = times(row, &rbar);
                    let out = &mut out.of_border(r)[columns.clone()];
                    if c == 0 {
                        shape_row::<false>(out, direction, slab);
                    } else {
                        shape_row::<true>(out, direction, slab);
                    }
                }
            }
        }
        out.set_residuals(quadric.residuals());
    }
}

#[inline(always)]
fn times(row: &[f64; 3], m: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|b| row[0] * m[0][b] + row[1] * m[1][b] + row[2] * m[2][b])
}

/// `out = c' slab` for a `3 x nb` slab, or its sum with `out`.
#[inline(always)]
fn shape_row<const ADD: bool>(out: &mut [f64], c: [f64; 3], slab: &[f32]) {
    let nb = out.len();
    let (s0, rest) = slab.split_at(nb);
    let (s1, s2) = rest.split_at(nb);
    for k in 0..nb {
        let [d0, d1, d2] = [s0[k], s1[k], s2[k]].map(f64::from);
        let before = if ADD { out[k] } else { 0.0 };
        out[k] = c[2].mul_add(d2, c[1].mul_add(d1, c[0].mul_add(d0, before)));
    }
}
