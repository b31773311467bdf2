//! Soft tissue of finite elements: linear tetrahedra between the skin and an inner surface, corotational linear elasticity.
//!
//! ```text
//!     F = sum_k x_k g_k'                  deformation gradient, g_k the gradient of the k-th shape function at rest
//!     F = R S                             R the rotation closest to F (polar decomposition)
//!     eps = (R'F + F'R) / 2 - 1           corotational strain
//!     E = lambda sum_e m_e (V_e / T) ( mu |eps|^2 + (kappa / 2) tr(eps)^2 ) + anchor
//!     mu = 1 / (2 (1 + nu))               kappa = nu / ((1 + nu) (1 - 2 nu))
//! ```
//!
//! (M. Mueller, M. Gross, "Interactive virtual materials", 2004, section 4.) `lambda` is Young's modulus, `m_e` that of a region over
//! it (mean of the element's corners; 1 unless stated), `nu` Poisson's ratio, `mu` and `kappa` Lame's constants for a modulus of one,
//! `V_e` the volume of a tetrahedron. Division by the layer's thickness `T` makes
//! `E` square millimetres of the skin, in any unit and however the skin is triangulated. With a layer one tetrahedron thick,
//! bending is stiffer than that of the tissue it stands for.
//!
//! `R` follows `F`: `R'F` is symmetric there, so `eps = S - 1`, a rotation of an element costs nothing, and the gradient at fixed `R` is
//! the energy's own. Gauss-Newton on `eps` at fixed `R` is the paper's `R K R'`; it has no curvature in the directions of
//! rotations either.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, UnitQuaternion};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::elements::Elements;
use super::factory::{ModelError, ModelFactory, ModelInput, RegistrationModel};
use super::on_patch::{PatchFactory, PatchInput};
use super::rotation_fit::closest_rotation;
use super::vertex_assembly::{CHUNK, VertexAssembly};
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, Options, OptionsError, Samples};
use crate::mesh::normals::vertex_areas;
use crate::mesh::{InnerLayer, MeshError, TriangleMesh, Vec3, determinant};
use crate::nlls::{BlockStructure, NormalEquations};
use crate::rig::Regions;

/// `[model]` of finite elements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TissueOptions {
    /// Depth of the tissue below the skin, millimetres; less where it would fold.
    pub thickness: f64,
    /// Poisson's ratio, from 0 (no sideways strain) to below 0.5 (no change of volume).
    pub poisson: f64,
    /// How firmly the inner side is held where it rests, as on bone: 1 as if by one more layer of the same modulus, 0 not at all.
    /// Rotations then cost too.
    pub anchor: f64,
    /// Young's modulus of regions of the template (a rig's `regions.json`, or the mesh' groups) over that of the rest, by name:
    /// `modulus = { nose = 10.0 }`. Where regions overlap, theirs are multiplied.
    pub modulus: BTreeMap<String, f64>,
}

impl Default for TissueOptions {
    fn default() -> Self {
        Self { thickness: 5.0, poisson: 0.3, anchor: 0.0, modulus: BTreeMap::new() }
    }
}

impl OptionTable for TissueOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::positive("thickness", self.thickness)?;
        OptionsError::not_negative("anchor", self.anchor)?;
        let positive = |(name, modulus): (&String, &f64)| OptionsError::positive(&format!("modulus.{name}"), *modulus);
        self.modulus.iter().try_for_each(positive)?;
        let (key, value, bound) = ("poisson".to_owned(), self.poisson, "at least 0 and below 0.5");
        if (0.0..0.5).contains(&value) { Ok(()) } else { Err(OptionsError::OutOfBounds { key, value, bound }) }
    }
}

impl TissueOptions {
    /// `m_i` of each of so many vertices.
    fn moduli(&self, regions: Option<&Regions>, vertices: usize) -> Result<Vec<f64>, ModelError> {
        let (none, mut moduli) = (Regions::default(), vec![1.0; vertices]);
        for (name, modulus) in &self.modulus {
            let region = regions.unwrap_or(&none).named(name);
            let region = region.map_err(|e| ModelError::Other(format!("modulus: {e}")))?;
            region.iter().for_each(|v| moduli[*v as usize] *= modulus);
        }
        Ok(moduli)
    }
}

/// Volume of a tie of a vertex without tissue, as a part of the mean element's at most.
const TIE: f64 = 1e-3;

/// Soft tissue under a skin.
pub type Fem = VertexModel<Tissue>;

/// The tissue; `lambda` is Young's modulus.
pub struct Tissue {
    options: TissueOptions,
    layer: InnerLayer,
    elements: Elements<4>,
    at_rest: Vec<AtRest>,
    states: Vec<State>,
    anchors: Elements<1>,
    /// `m_i A_i / T^2` of each anchor.
    anchor_weights: Vec<f64>,
    /// How far each has moved.
    anchors_moved: Vec<Vec3>,
}

/// What is known of an element before it moves.
#[derive(Debug, Clone, Copy)]
struct AtRest {
    /// `g_k`.
    gradients: [Vec3; 4],
    /// `m_e V_e / T`.
    weight: f64,
}

/// And what it is strained to.
#[derive(Clone, Copy)]
struct State {
    turn: UnitQuaternion<f64>,
    rotation: Matrix3<f64>,
    strain: Matrix3<f64>,
}

impl Fem {
    /// The tissue at rest under `mesh`; `options` has lengths in the mesh's unit.
    ///
    /// Vertices without tissue (in no triangle, or in such without area) hang on the nearest that has some, turning with it.
    /// Parts without data stay where they are if the solver damps (`Options::with_damping_floor`); without damping the normal
    /// equations are singular, which is an error there.
    ///
    /// # Errors
    /// When a position is not finite, a triangle indexes past the vertices, or no triangle has an area.
    ///
    /// # Panics
    /// If `options` are out of bounds.
    pub fn new(mesh: &TriangleMesh, options: TissueOptions, lambda_smooth: f64) -> Result<Self, MeshError> {
        options.check().expect("options within bounds");
        let layer = InnerLayer::new(mesh, options.thickness)?;
        let volume = |t: &[u32; 4]| determinant(&layer.nodes, *t) / 6.0;
        let tie = TIE * layer.tetrahedra.iter().map(volume).sum::<f64>() / layer.tetrahedra.len() as f64;
        let volumes = layer.tetrahedra.iter().map(volume).chain(layer.ties.iter().map(|t| volume(t).min(tie)));
        let corners = [&layer.tetrahedra[..], &layer.ties].concat();
        let at_rest = corners.iter().zip(volumes).map(|(t, volume)| AtRest {
            gradients: shape_gradients(t.map(|k| layer.nodes[k as usize])),
            weight: volume / options.thickness,
        });
        let at_rest: Vec<AtRest> = at_rest.collect();
        let (mut anchors, mut anchor_weights) = (Vec::new(), Vec::new());
        if options.anchor > 0.0 {
            let areas = vertex_areas(&mesh.positions, &mesh.triangles);
            for (inner, area) in layer.below.iter().zip(areas).filter_map(|(b, a)| Some(((*b)?, a))) {
                anchors.push([inner]);
                anchor_weights.push(options.anchor * area / options.thickness.powi(2));
            }
        }
        let joined: Vec<[u32; 2]> = corners.iter().flat_map(|t| [1, 2, 3].map(|k| [t[0], t[k]])).collect();
        let vertices = VertexAssembly::new(layer.nodes.clone(), mesh.positions.len(), &joined);
        let still = State { turn: UnitQuaternion::identity(), rotation: Matrix3::identity(), strain: Matrix3::zeros() };
        let tissue = Tissue {
            options,
            layer,
            states: vec![still; at_rest.len()],
            elements: Elements::new(corners),
            at_rest,
            anchors: Elements::new(anchors),
            anchor_weights,
            anchors_moved: Vec::new(),
        };
        Ok(Self::of(tissue, vertices, lambda_smooth))
    }

    /// The same tissue with Young's modulus `m_i` times that of the rest at vertex `i` and below it.
    ///
    /// # Panics
    /// If there is not one modulus per vertex, all positive.
    #[must_use]
    pub fn with_moduli(mut self, moduli: &[f64]) -> Self {
        let tissue = &mut self.regulariser;
        assert_eq!(moduli.len(), tissue.layer.below.len(), "one modulus per vertex");
        assert!(moduli.iter().all(|m| *m > 0.0 && m.is_finite()), "moduli must be positive and finite");
        let mut of_node = vec![1.0; tissue.layer.nodes.len()];
        for ((v, m), below) in moduli.iter().enumerate().zip(&tissue.layer.below) {
            [Some(v as u32), *below].into_iter().flatten().for_each(|node| of_node[node as usize] = *m);
        }
        for (corners, rest) in tissue.elements.nodes.iter().zip(&mut tissue.at_rest) {
            rest.weight *= corners.iter().map(|k| of_node[*k as usize]).sum::<f64>() / 4.0;
        }
        for ([node], weight) in tissue.anchors.nodes.iter().zip(&mut tissue.anchor_weights) {
            *weight *= of_node[*node as usize];
        }
        self
    }

    /// The layer of tissue at rest.
    #[must_use]
    pub fn layer(&self) -> &InnerLayer {
        &self.regulariser.layer
    }
}

impl Tissue {
    /// `mu` and `kappa`.
    fn lame(&self) -> [f64; 2] {
        let nu = self.options.poisson;
        [0.5 / (1.0 + nu), nu / ((1.0 + nu) * (1.0 - 2.0 * nu))]
    }
}

/// Gradients of the four linear shape functions of a tetrahedron.
fn shape_gradients([a, b, c, d]: [Vec3; 4]) -> [Vec3; 4] {
    let (p, q, r) = (b - a, c - a, d - a);
    let determinant = p.cross(&q).dot(&r);
    let [b, c, d] = [q.cross(&r), r.cross(&p), p.cross(&q)].map(|g| g / determinant);
    [-(b + c + d), b, c, d]
}

impl VertexRegulariser for Tissue {
    const NAME: &'static str = "fem";

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        let structure = vertices.analyse(samples, self.elements.cliques());
        self.elements.analyse(vertices, &structure, 6);
        self.anchors.analyse(vertices, &structure, 3);
        structure
    }

    fn fit(&mut self, nodes: &[Vec3]) {
        let (corners, at_rest) = (&self.elements.nodes, &self.at_rest);
        self.states.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            for (k, state) in chunk.iter_mut().enumerate() {
                let (corners, gradients) = (corners[c * CHUNK + k], at_rest[c * CHUNK + k].gradients);
                let f: Matrix3<f64> =
                    corners.iter().zip(&gradients).map(|(v, g)| nodes[*v as usize] * g.transpose()).sum();
                state.turn = closest_rotation(&f, &state.turn);
                state.rotation = state.turn.to_rotation_matrix().into_inner();
                let turned_back = state.rotation.tr_mul(&f);
                state.strain = (turned_back + turned_back.transpose()) * 0.5 - Matrix3::identity();
            }
        });
        let moved = |[k]: &[u32; 1]| nodes[*k as usize] - self.layer.nodes[*k as usize];
        self.anchors_moved.clear();
        self.anchors_moved.extend(self.anchors.nodes.iter().map(moved));
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        let [mu, kappa] = self.lame();
        let of = |(rest, state): (&AtRest, &State)| {
            rest.weight * (mu * state.strain.norm_squared() + kappa / 2.0 * state.strain.trace().powi(2))
        };
        let elastic: f64 = self.at_rest.iter().zip(&self.states).map(of).sum();
        out.push(("elasticity", lambda * elastic));
        if self.options.anchor > 0.0 {
            let each = self.anchors_moved.iter().zip(&self.anchor_weights).map(|(moved, w)| w * moved.norm_squared());
            out.push(("anchor", lambda * each.sum::<f64>()));
        }
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        let [mu, kappa] = self.lame();
        let (at_rest, states) = (&self.at_rest, &self.states);
        // mu |eps|^2 + (kappa / 2) tr(eps)^2 = mu |eps + third tr(eps) 1|^2
        let third = ((1.0 + 1.5 * kappa / mu).sqrt() - 1.0) / 3.0;
        self.elements.add(equations, |e, _| {
            let (AtRest { gradients, weight }, State { rotation, strain, .. }) = (&at_rest[e], &states[e]);
            let root = (lambda * mu * weight).sqrt();
            let (mut rows, mut residuals) = ([[Vec3::zeros(); 4]; 6], [0.0; 6]);
            let shear = root * 2f64.sqrt();
            for a in 0..3 {
                let b = (a + 1) % 3;
                residuals[a] = root * (strain[(a, a)] + third * strain.trace());
                residuals[3 + a] = shear * strain[(a, b)];
                for (k, g) in gradients.iter().enumerate() {
                    let dilation = rotation * g;
                    rows[a][k] = (rotation.column(a) * g[a] + dilation * third) * root;
                    rows[3 + a][k] = (rotation.column(a) * g[b] + rotation.column(b) * g[a]) * (0.5 * shear);
                }
            }
            (rows, residuals)
        });
        let (moved, weights) = (&self.anchors_moved, &self.anchor_weights);
        self.anchors.add(equations, |i, _| {
            let root = (lambda * weights[i]).sqrt();
            ([[Vec3::x() * root], [Vec3::y() * root], [Vec3::z() * root]], (moved[i] * root).into())
        });
    }
}

pub(super) struct Factory;

impl ModelFactory for Factory {
    fn name(&self) -> &'static str {
        "fem"
    }

    fn default_schedule(&self) -> &'static str {
        include_str!("schedules/fem.toml")
    }

    fn options(&self, given: &Options) -> Result<Options, OptionsError> {
        given.filled::<TissueOptions>()
    }

    fn build(&self, input: &ModelInput<'_>) -> Result<Box<dyn RegistrationModel>, ModelError> {
        let options: TissueOptions = input.options.read()?;
        let moduli = options.moduli(input.regions, input.rest.positions.len())?;
        let options = TissueOptions { thickness: input.length(options.thickness), ..options };
        Ok(Box::new(Fem::new(input.rest, options, 1.0)?.with_moduli(&moduli)))
    }

    fn on_patch(&self) -> Option<&dyn PatchFactory> {
        Some(self)
    }
}

impl PatchFactory for Factory {
    fn by_vertex(&self) -> bool {
        true
    }

    fn build_on_patch(&self, input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
        let tissue = Fem::new(input.mesh, TissueOptions::default(), input.gradient_weight())?;
        Ok(Box::new(tissue.with_held_at(input.held, input.places)))
    }
}
