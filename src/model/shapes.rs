//! Blendshapes as the solver sees them: one constant slab of displacements.

use crate::mesh::Vec3;

/// Linear shapes `b_i(w) = n_i + sum_k w_k delta_ik`, eq. (4) of Klimov 2020, with a prior of standard deviation
/// `sigma_k` on each weight, eq. (5).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeBasis {
    names: Vec<String>,
    sigmas: Vec<f64>,
    deltas: Vec<f64>,
}

impl ShapeBasis {
    /// No shapes: what rigid, similarity and graph use.
    #[must_use]
    pub fn none() -> Self {
        Self::default()
    }

    /// Shapes of the given names and `sigma_k`; `deltas` holds `3 N` rows of one entry per shape: row `3 i + a` is the
    /// displacement of vertex `i` along axis `a` at weight one.
    ///
    /// # Panics
    /// If the lengths do not fit together.
    #[must_use]
    pub fn new(names: Vec<String>, sigmas: Vec<f64>, deltas: Vec<f64>) -> Self {
        assert_eq!(names.len(), sigmas.len(), "one sigma per shape");
        assert!(
            deltas.is_empty() || deltas.len() % (3 * names.len()) == 0,
            "deltas must be 3 N rows of {} shapes",
            names.len()
        );
        Self { names, sigmas, deltas }
    }

    /// Number of shapes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Number of vertices that the shapes move; zero without shapes.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        if self.is_empty() { 0 } else { self.deltas.len() / (3 * self.len()) }
    }

    /// Shape names, in the order of the weights.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Prior standard deviations `sigma_k`.
    #[must_use]
    pub fn sigmas(&self) -> &[f64] {
        &self.sigmas
    }

    /// The three rows of vertex `i`: `3 x len`, row-major.
    #[inline(always)]
    #[must_use]
    pub fn vertex(&self, i: usize) -> &[f64] {
        let n = 3 * self.len();
        &self.deltas[i * n..(i + 1) * n]
    }

    /// `b_i(w)` for vertex `i` at rest in `rest`.
    #[inline(always)]
    #[must_use]
    pub fn blend(&self, i: usize, rest: Vec3, w: &[f64]) -> Vec3 {
        if self.is_empty() {
            return rest;
        }
        let mut b = rest;
        for (a, row) in self.vertex(i).chunks_exact(self.len()).enumerate() {
            b[a] += dot(row, w);
        }
        b
    }
}

/// Dot product with four running sums, so that it vectorises.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = a4.remainder().iter().zip(b4.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a4.zip(b4) {
        for l in 0..4 {
            sums[l] += a[l] * b[l];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}
