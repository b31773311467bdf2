//! Linear elasticity of tetrahedra that turn with what they hold (M. Mueller, M. Gross, "Interactive virtual materials", 2004,
//! section 4).
//!
//! ```text
//!     F = sum_k x_k g_k'                  deformation gradient, g_k the gradient of the k-th shape function at rest
//!     F = R S                             R the rotation closest to F (polar decomposition)
//!     eps = (R'F + F'R) / 2 - 1           corotational strain
//!     E = lambda sum_e w_e ( mu |eps|^2 + (kappa / 2) tr(eps)^2 )
//!     mu = 1 / (2 (1 + nu))               kappa = nu / ((1 + nu) (1 - 2 nu))
//! ```
//!
//! `mu` and `kappa` are Lame's constants for a modulus of one and Poisson's ratio `nu`.
//!
//! `R` follows `F`: `R'F` is symmetric there, so `eps = S - 1`, a rotation of an element costs nothing, and the gradient at fixed `R` is
//! the energy's own. Gauss-Newton on `eps` at fixed `R` is the paper's `R K R'`; it has no curvature in the directions of
//! rotations either.

use nalgebra::{Matrix3, UnitQuaternion};
use rayon::prelude::*;

use super::elements::Elements;
use super::rotation_fit::closest_rotation;
use super::vertex_assembly::CHUNK;
use crate::mesh::{Vec3, shape_gradients};
use crate::nlls::NormalEquations;

/// Tetrahedra with the strain of each.
pub(super) struct Corotational {
    pub elements: Elements<4>,
    /// `g_k` of each.
    gradients: Vec<[Vec3; 4]>,
    /// `w_e` of each.
    pub weights: Vec<f64>,
    states: Vec<State>,
    mu: f64,
    kappa: f64,
}

/// What an element is strained to.
#[derive(Clone, Copy)]
struct State {
    turn: UnitQuaternion<f64>,
    rotation: Matrix3<f64>,
    strain: Matrix3<f64>,
}

impl Corotational {
    /// Tetrahedra of positive volume at rest.
    pub fn new(nodes: &[Vec3], tetrahedra: Vec<[u32; 4]>, weights: Vec<f64>, poisson: f64) -> Self {
        let still = State { turn: UnitQuaternion::identity(), rotation: Matrix3::identity(), strain: Matrix3::zeros() };
        Self {
            gradients: tetrahedra.iter().map(|t| shape_gradients(nodes, *t)).collect(),
            weights,
            states: vec![still; tetrahedra.len()],
            elements: Elements::new(tetrahedra),
            mu: 0.5 / (1.0 + poisson),
            kappa: poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        }
    }

    /// Takes the strains at these nodes.
    pub fn fit(&mut self, nodes: &[Vec3]) {
        let (corners, gradients) = (&self.elements.nodes, &self.gradients);
        self.states.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(e, state)| {
            let f: Matrix3<f64> =
                corners[e].iter().zip(&gradients[e]).map(|(v, g)| nodes[*v as usize] * g.transpose()).sum();
            state.turn = closest_rotation(&f, &state.turn);
            state.rotation = state.turn.to_rotation_matrix().into_inner();
            let turned_back = state.rotation.tr_mul(&f);
            state.strain = (turned_back + turned_back.transpose()) * 0.5 - Matrix3::identity();
        });
    }

    /// `E` over `lambda`.
    pub fn energy(&self) -> f64 {
        let of = |(weight, State { strain, .. }): (&f64, &State)| {
            weight * (self.mu * strain.norm_squared() + self.kappa / 2.0 * strain.trace().powi(2))
        };
        self.weights.iter().zip(&self.states).map(of).sum()
    }

    /// Adds gradient and Gauss-Newton Hessian of `E / 2`.
    pub fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        let Self { elements, gradients, weights, states, mu, kappa } = self;
        // mu |eps|^2 + (kappa / 2) tr(eps)^2 = mu |eps + third tr(eps) 1|^2
        let third = ((1.0 + 1.5 * *kappa / *mu).sqrt() - 1.0) / 3.0;
        elements.add(equations, |e, _| {
            let State { rotation, strain, .. } = &states[e];
            let root = (lambda * *mu * weights[e]).sqrt();
            let (mut rows, mut residuals) = ([[Vec3::zeros(); 4]; 6], [0.0; 6]);
            let shear = root * 2f64.sqrt();
            for a in 0..3 {
                let b = (a + 1) % 3;
                residuals[a] = root * (strain[(a, a)] + third * strain.trace());
                residuals[3 + a] = shear * strain[(a, b)];
                for (k, g) in gradients[e].iter().enumerate() {
                    let dilation = rotation * g;
                    rows[a][k] = (rotation.column(a) * g[a] + dilation * third) * root;
                    rows[3 + a][k] = (rotation.column(a) * g[b] + rotation.column(b) * g[a]) * (0.5 * shear);
                }
            }
            (rows, residuals)
        });
    }
}
