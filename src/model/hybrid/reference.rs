//! The paper's way to differentiate, as the baseline of the structured one: each sample's position by the tangents of all
//! of its nodes and by all shape weights at once, in strides of [`STRIDE`] duals.

use std::marker::PhantomData;

use num_dual::DualSVec64;
use pulp::Simd;

use super::samples::{Blended, FIXED, NodeSamples};
use super::{AffineMap, NodeTransform, derivatives, moved_map, node_point, weights_in};
use crate::energy::Quadric;
use crate::nlls::{FillRows, ItemRows};

/// Duals at a time, as a Ceres user's stride would be.
const STRIDE: usize = 16;
type Dual = DualSVec64<STRIDE>;

/// [`Structured`](super::samples::Structured) at `x`, the paper's way.
pub(super) struct Strided<'a, T, const W: usize> {
    pub samples: &'a NodeSamples,
    pub x: &'a [f64],
    pub quadrics: &'a [Quadric],
    pub blended: Blended<'a>,
    pub transform: PhantomData<T>,
}

impl<T: NodeTransform<W>, const W: usize> FillRows for Strided<'_, T, W> {
    type Scratch = ();

    fn count(&self, item: usize) -> usize {
        self.samples.quadric(item, self.quadrics).rows().len()
    }

    #[inline(always)]
    fn fill<S: Simd>(&self, _: S, item: usize, (): &mut (), out: &mut ItemRows<'_>) {
        let quadric = self.samples.quadric(item, self.quadrics);
        strided::<T, W>(self, item, quadric, out);
        out.set_residuals(quadric.residuals());
    }
}

#[inline(always)]
fn strided<T: NodeTransform<W>, const W: usize>(
    &Strided { samples, x, blended: Blended { graph, shapes, vertices }, .. }: &Strided<'_, T, W>,
    item: usize,
    quadric: &Quadric,
    out: &mut ItemRows<'_>,
) {
    let nb = shapes.len();
    let w = weights_in::<T, W>(x, graph);
    let rows = quadric.rows();
    let of_nodes = samples.nodes(item).len() * W;
    for first in (0..of_nodes + nb).step_by(STRIDE) {
        let seed = |k: usize, value: f64| {
            let d = Dual::from_re(value);
            if (first..first + STRIDE).contains(&k) { d.derivative(k - first) } else { d }
        };
        let mut v = [Dual::from_re(0.0); 3];
        for corner in samples.corners(item) {
            let i = corner.vertex as usize;
            let mut b: [Dual; 3] = std::array::from_fn(|a| Dual::from_re(vertices[i][a]));
            // What this stride does not differentiate enters as numbers.
            for k in first.saturating_sub(of_nodes)..(first + STRIDE).saturating_sub(of_nodes).min(nb) {
                let w_k = seed(of_nodes + k, w[k]) - w[k];
                let displacement = shapes.displacement(i, k);
                (0..3).for_each(|a| b[a] += w_k * displacement[a]);
            }
            for (&(j, omega), &slot) in graph.influences(i).iter().zip(samples.slots(corner)) {
                let own =
                    if slot == FIXED { usize::MAX..usize::MAX } else { slot as usize * W..(slot as usize + 1) * W };
                let x_j = graph.nodes()[j as usize];
                let q: [Dual; 3] = std::array::from_fn(|a| b[a] - x_j[a]);
                let moved = if own.start < first + STRIDE && own.end > first {
                    let seeds: [Dual; W] = std::array::from_fn(|t| seed(own.start + t, 0.0));
                    moved_map::<T, W, _>(x, graph, j as usize, &seeds).apply(q)
                } else {
                    let AffineMap { linear, translation } = T::map::<f64>(node_point::<T, W>(x, graph, j as usize));
                    std::array::from_fn(|a| {
                        q[0] * linear[a][0] + q[1] * linear[a][1] + q[2] * linear[a][2] + translation[a]
                    })
                };
                for a in 0..3 {
                    v[a] += (moved[a] + x_j[a]) * (omega * corner.weight);
                }
            }
        }
        let jacobian = v.map(|v| derivatives(&v));
        for k in first..(first + STRIDE).min(of_nodes + nb) {
            let column = [jacobian[0][k - first], jacobian[1][k - first], jacobian[2][k - first]];
            let along = |row: &[f64; 3]| row[0] * column[0] + row[1] * column[1] + row[2] * column[2];
            if k < of_nodes {
                let (slot, t) = (k / W, k % W);
                for (r, row) in rows.iter().enumerate() {
                    out.of_block(slot, r)[t] = along(row);
                }
            } else {
                for (r, row) in rows.iter().enumerate() {
                    out.of_border(r)[k - of_nodes] = along(row);
                }
            }
        }
    }
}
