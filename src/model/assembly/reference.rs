//! The paper's way to differentiate, as the baseline of the structured one: each sample's position by the tangents of all
//! of its nodes and by all shape weights at once, in strides of [`STRIDE`] duals.

use num_dual::DualSVec64;

use super::samples::{Blended, SampleChunk, SampleJacobian, pitch, shape_pitch};
use super::{AffineMap, NodeTransform, derivatives, moved_map, node_point, weights_in};
use crate::energy::Quadric;
use crate::nlls::dense_kernels::vectorized;

/// Duals at a time, as a Ceres user's stride would be.
const STRIDE: usize = 16;
type Dual = DualSVec64<STRIDE>;

impl<const W: usize> SampleChunk<W> {
    /// [`linearize`](Self::linearize) at `x`, the paper's way.
    pub fn linearize_reference<T: NodeTransform<W>>(&mut self, x: &[f64], quadrics: &[Quadric], blended: Blended<'_>) {
        let nb = blended.shapes.len();
        vectorized(
            #[inline(always)]
            || {
                self.fill(
                    quadrics,
                    nb,
                    #[inline(always)]
                    |sample, quadric| strided::<T, W>(sample, quadric, x, blended),
                );
            },
        );
    }
}

#[inline(always)]
fn strided<T: NodeTransform<W>, const W: usize>(
    sample: SampleJacobian<'_>,
    quadric: &Quadric,
    x: &[f64],
    Blended { graph, shapes, vertices }: Blended<'_>,
) {
    let nb = shapes.len();
    let w = weights_in::<T, W>(x, graph);
    let rows = quadric.rows();
    let of_nodes = sample.y.len() / rows.len() / pitch::<W>() * W;
    for first in (0..of_nodes + nb).step_by(STRIDE) {
        let seed = |k: usize, value: f64| {
            let d = Dual::from_re(value);
            if (first..first + STRIDE).contains(&k) { d.derivative(k - first) } else { d }
        };
        let mut v = [Dual::from_re(0.0); 3];
        for corner in sample.corners {
            let i = corner.vertex as usize;
            let slab = shapes.vertex(i);
            let mut b: [Dual; 3] = std::array::from_fn(|a| Dual::from_re(vertices[i][a]));
            // What this stride does not differentiate enters as numbers.
            for k in first.saturating_sub(of_nodes)..(first + STRIDE).saturating_sub(of_nodes).min(nb) {
                let w_k = seed(of_nodes + k, w[k]) - w[k];
                for a in 0..3 {
                    b[a] += w_k * f64::from(slab[a * nb + k]);
                }
            }
            for (&(j, omega), &slot) in graph.influences(i).iter().zip(&corner.slots) {
                let own = slot as usize * W..(slot as usize + 1) * W;
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
                    sample.y[(slot * rows.len() + r) * pitch::<W>() + t] = along(row);
                }
            } else {
                for (r, row) in rows.iter().enumerate() {
                    sample.u[r * shape_pitch(nb) + k - of_nodes] = along(row);
                }
            }
        }
    }
}
