//! Soft tissue of finite elements: linear tetrahedra between the skin and an inner surface, corotational linear elasticity.
//!
//! ```text
//!     E = lambda sum_e m_e (V_e / T) ( mu |eps_e|^2 + (kappa / 2) tr(eps_e)^2 ) + anchor
//! ```
//!
//! (M. Mueller, M. Gross, "Interactive virtual materials", 2004; strain `eps` and Lame's `mu` and `kappa` in `corotational.rs`.)
//! `lambda` is Young's modulus, `m_e` that of a region over it (mean of the element's corners; 1 unless stated), `V_e` the volume of a
//! tetrahedron. Division by the layer's thickness `T` makes `E` square millimetres of the skin, in any unit and however the skin is
//! triangulated. With a layer one tetrahedron thick, bending is stiffer than that of the tissue it stands for.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::corotational::Corotational;
use super::elements::Elements;
use super::factory::{BuiltIn, ModelError};
use super::vertex_assembly::VertexAssembly;
use super::vertex_model::{VertexModel, VertexRegulariser};
use crate::energy::{NamedEnergy, OptionTable, OptionsError, Samples};
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

/// Volume of a tie of a vertex without tissue, as a part of the mean element's at most.
const TIE: f64 = 1e-3;

/// Soft tissue under a skin.
pub type Fem = VertexModel<Tissue>;

/// The tissue; `lambda` is Young's modulus.
pub struct Tissue {
    options: TissueOptions,
    layer: InnerLayer,
    tetrahedra: Corotational,
    anchors: Elements<1>,
    /// `m_i A_i / T^2` of each anchor.
    anchor_weights: Vec<f64>,
    /// How far each has moved.
    anchors_moved: Vec<Vec3>,
}

impl Fem {
    /// The tissue at rest under `mesh`; `options` has lengths in the mesh's unit.
    ///
    /// Vertices without tissue (in no triangle, or in such without area) hang on the nearest that has some, turning with it.
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
        let weights = volumes.map(|volume| volume / options.thickness).collect();
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
        let tissue = Tissue {
            tetrahedra: Corotational::new(&layer.nodes, corners, weights, options.poisson),
            options,
            layer,
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
        let Corotational { elements, weights, .. } = &mut tissue.tetrahedra;
        for (corners, weight) in elements.nodes.iter().zip(weights) {
            *weight *= corners.iter().map(|k| of_node[*k as usize]).sum::<f64>() / 4.0;
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

impl VertexRegulariser for Tissue {
    const NAME: &'static str = "fem";

    fn analyse(&mut self, vertices: &mut VertexAssembly, samples: &Samples) -> BlockStructure {
        let structure = vertices.analyse(samples, self.tetrahedra.elements.cliques());
        self.tetrahedra.elements.analyse(vertices, &structure, 6);
        self.anchors.analyse(vertices, &structure, 3);
        structure
    }

    fn fit(&mut self, nodes: &[Vec3]) {
        self.tetrahedra.fit(nodes);
        let moved = |[k]: &[u32; 1]| nodes[*k as usize] - self.layer.nodes[*k as usize];
        self.anchors_moved.clear();
        self.anchors_moved.extend(self.anchors.nodes.iter().map(moved));
    }

    fn energy(&self, lambda: f64, out: &mut Vec<NamedEnergy>) {
        out.push(("elasticity", lambda * self.tetrahedra.energy()));
        if self.options.anchor > 0.0 {
            let each = self.anchors_moved.iter().zip(&self.anchor_weights).map(|(moved, w)| w * moved.norm_squared());
            out.push(("anchor", lambda * each.sum::<f64>()));
        }
    }

    fn add_to(&mut self, lambda: f64, equations: &mut NormalEquations) {
        self.tetrahedra.add_to(lambda, equations);
        let (moved, weights) = (&self.anchors_moved, &self.anchor_weights);
        self.anchors.add(equations, |i, _| {
            let root = (lambda * weights[i]).sqrt();
            ([[Vec3::x() * root], [Vec3::y() * root], [Vec3::z() * root]], (moved[i] * root).into())
        });
    }
}

pub(super) const MODEL: BuiltIn = BuiltIn::new::<TissueOptions>("fem", include_str!("schedules/fem.toml"), |input| {
    let options: TissueOptions = input.options.read()?;
    let (none, vertices) = (Regions::default(), input.rest.positions.len());
    let moduli = input.regions.unwrap_or(&none).products(&options.modulus, vertices);
    let moduli = moduli.map_err(|e| ModelError::Other(format!("modulus: {e}")))?;
    let options = TissueOptions { thickness: input.length(options.thickness), ..options };
    Ok(Box::new(Fem::new(input.rest, options, 1.0)?.with_moduli(&moduli)))
})
.on_patch_by_vertex(&["smoothing"], |input| {
    Fem::new(input.mesh, TissueOptions::default(), input.gradient_weight())?.on_patch(input)
});
