//! What data terms hand to a deformation model: per sample, a quadratic model of the data energy in the sample's position.

/// Gauss-Newton quadric of the data terms at one sample, for half the energy:
/// `g = sum alpha rho' a' r` (3) and `M = sum alpha rho' a' a` (3 x 3), kept as one to three rows `A` with `A' A = M`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quadric {
    rows: [[f64; 3]; 3],
    count: u8,
    /// `g`, the gradient of half the data energy in the sample's position.
    pub gradient: [f64; 3],
}

impl Quadric {
    /// The rows `A` (at most three) with `A' A = M`.
    #[must_use]
    pub fn rows(&self) -> &[[f64; 3]] {
        &self.rows[..self.count as usize]
    }

    /// `M`, row-major.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        let mut m = [[0.0; 3]; 3];
        for row in self.rows() {
            for a in 0..3 {
                for b in 0..3 {
                    m[a][b] += row[a] * row[b];
                }
            }
        }
        m
    }

    /// Adds the residual `r` with derivative `a` and weight `alpha rho'`.
    pub fn add(&mut self, weight: f64, a: [f64; 3], r: f64) {
        if weight == 0.0 {
            return;
        }
        for (g, a) in self.gradient.iter_mut().zip(a) {
            *g += weight * a * r;
        }
        let root = weight.sqrt();
        let row = a.map(|a| root * a);
        if self.count < 3 {
            self.rows[self.count as usize] = row;
            self.count += 1;
        } else {
            let mut m = self.matrix();
            for i in 0..3 {
                for j in 0..3 {
                    m[i][j] += row[i] * row[j];
                }
            }
            self.rows = upper_cholesky(m);
        }
    }
}

/// `U` upper triangular with `U' U = m`; a direction without weight gives a zero row.
fn upper_cholesky(m: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut u = [[0.0; 3]; 3];
    for i in 0..3 {
        let pivot = m[i][i] - (0..i).map(|k| u[k][i] * u[k][i]).sum::<f64>();
        if pivot <= 1e-14 * m[i][i] {
            continue;
        }
        u[i][i] = pivot.sqrt();
        for j in i + 1..3 {
            u[i][j] = (m[i][j] - (0..i).map(|k| u[k][i] * u[k][j]).sum::<f64>()) / u[i][i];
        }
    }
    u
}

/// One quadric per sample.
#[derive(Debug, Clone, Default)]
pub struct QuadricField {
    quadrics: Vec<Quadric>,
}

impl QuadricField {
    /// Sets all of `samples` quadrics to zero.
    pub fn reset(&mut self, samples: usize) {
        self.quadrics.clear();
        self.quadrics.resize(samples, Quadric::default());
    }

    /// The quadrics, in sample order.
    #[must_use]
    pub fn quadrics(&self) -> &[Quadric] {
        &self.quadrics
    }

    /// The quadric of one sample, for terms to add to.
    pub fn at_mut(&mut self, sample: usize) -> &mut Quadric {
        &mut self.quadrics[sample]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_reproduce_the_sum_of_any_number_of_residuals() {
        let residuals = [
            (0.5, [1.0, 2.0, -1.0], 0.3),
            (2.0, [0.1, -0.4, 1.0], -1.0),
            (0.0, [9.0, 9.0, 9.0], 5.0),
            (1.5, [0.7, 0.7, 0.2], 0.9),
            (0.25, [1.0, 2.0, -1.0], 2.0),
            (3.0, [-1.0, 0.3, 0.6], 0.1),
        ];
        let (mut quadric, mut m, mut g) = (Quadric::default(), [[0.0; 3]; 3], [0.0; 3]);
        for (w, a, r) in residuals {
            quadric.add(w, a, r);
            for i in 0..3 {
                g[i] += w * a[i] * r;
                for j in 0..3 {
                    m[i][j] += w * a[i] * a[j];
                }
            }
            for i in 0..3 {
                approx::assert_abs_diff_eq!(quadric.gradient[i], g[i], epsilon = 1e-13);
                for j in 0..3 {
                    approx::assert_abs_diff_eq!(quadric.matrix()[i][j], m[i][j], epsilon = 1e-12);
                }
            }
        }
    }

    #[test]
    fn coplanar_residuals_keep_the_free_direction_free() {
        let mut quadric = Quadric::default();
        for _ in 0..5 {
            quadric.add(1.0, [1.0, 0.0, 0.0], 0.0);
            quadric.add(1.0, [0.0, 1.0, 0.0], 0.0);
        }
        assert_eq!(quadric.matrix()[2][2], 0.0);
        approx::assert_abs_diff_eq!(quadric.matrix()[0][0], 5.0, epsilon = 1e-13);
    }
}
