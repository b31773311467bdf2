//! Free-form deformation: a lattice of control points round the surface moves what lies in it.
//!
//! ```text
//!     v_i = n_i + sum_abc B_a(u) B_b(v) B_c(w) d_abc
//!     E_smooth = lambda (A / N) / (3 h^2) sum ( |D_xx d|^2 + |D_yy d|^2 + |D_zz d|^2 + 2 |D_xy d|^2 + 2 |D_xz d|^2 + 2 |D_yz d|^2 )
//! ```
//!
//! (T. Sederberg, S. Parry, "Free-form deformation of solid geometric models", 1986, eq. (2), with uniform quadratic B-splines for
//! Bernstein polynomials, so that a vertex feels 3 x 3 x 3 control points and the surface stays smooth.) `d` are displacements
//! of control points, `D` second differences: the thin plate's energy of the lattice (D. Rueckert et al., "Nonrigid registration
//! using free-form deformations", 1999, eq. (3)). No affine map costs anything. `h` is the lattice's spacing, `A / N` the surface's
//! area over the number of vertices that `lambda` is meant for, and three control points lie across the surface: `E_smooth` is in
//! square millimetres and hardly depends on spacing, triangulation and unit.
//!
//! Only cells that the surface goes through have control points, and a place of the lattice has one for each connected part of the
//! surface near it: upper and lower lip touch without being joined.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::factory::{BuiltIn, ModelError, RegistrationModel, SmoothLevel};
use super::linear_samples::LinearSamples;
use super::on_patch::PatchInput;
use super::smooth_rows::SmoothRows;
use super::vertex_assembly::{CHUNK, parameters};
use crate::energy::{DeformationModel, NamedEnergy, OptionTable, Options, OptionsError, QuadricField, Samples};
use crate::mesh::normals::face_areas;
use crate::mesh::surface_lattice::{ACROSS, SurfaceLattice};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::{Assembly, BlockStructure, NormalEquations};

/// `[model]` of the lattice.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatticeOptions {
    /// Side of a cell, millimetres.
    pub spacing: f64,
}

impl Default for LatticeOptions {
    fn default() -> Self {
        Self { spacing: 12.0 }
    }
}

impl OptionTable for LatticeOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::positive("spacing", self.spacing)
    }
}

/// A lattice round a surface.
pub struct Ffd {
    /// `lambda` of the regulariser.
    pub lambda_smooth: f64,
    rest: Vec<Vec3>,
    lattice: SurfaceLattice,
    /// Block of each control point among the parameters; none of those that are held at rest.
    blocks: Vec<Option<u32>>,
    rows: SmoothRows,
    samples: LinearSamples<1>,
}

/// The second differences of a lattice, times `scale`; a mixed one counts twice in `E_smooth`.
fn second_differences(lattice: &SurfaceLattice, scale: f64) -> SmoothRows {
    let mut rows = SmoothRows::default();
    for ([far, p, q, near], straight) in lattice.second_differences() {
        if straight {
            rows.push([(far, scale), (p, -2.0 * scale), (near, scale)]);
        } else {
            let scale = scale * 2f64.sqrt();
            rows.push([(far, scale), (p, -scale), (q, -scale), (near, scale)]);
        }
    }
    rows
}

impl Ffd {
    /// The lattice at rest round `mesh`; `options` has lengths in the mesh's unit, and `reference_vertices` is the number of vertices
    /// of the surface that `lambda_smooth` is meant for.
    ///
    /// Vertices that no triangle refers to move as the nearest that has triangles. Parts without data stay where they are if the
    /// solver damps (`Options::with_damping_floor`); without damping the normal equations are singular, which is an error there.
    ///
    /// # Errors
    /// When a position is not finite, a triangle indexes past the vertices, there are no triangles, or the spacing is so small that
    /// the surface would go through tens of millions of cells.
    ///
    /// # Panics
    /// If the spacing or `reference_vertices` is not positive.
    pub fn new(
        mesh: &TriangleMesh,
        options: LatticeOptions,
        reference_vertices: f64,
        lambda_smooth: f64,
    ) -> Result<Self, MeshError> {
        assert!(options.spacing > 0.0 && reference_vertices > 0.0, "spacing and reference_vertices must be positive");
        let lattice = SurfaceLattice::new(mesh, options.spacing)?;
        let area: f64 = face_areas(&mesh.positions, &mesh.triangles).iter().sum();
        let scale = (area / reference_vertices / ACROSS as f64).sqrt() / options.spacing;
        let rows = second_differences(&lattice, scale);
        let blocks = (0..lattice.control_points() as u32).map(Some).collect();
        let rest = mesh.positions.clone();
        Ok(Self { lambda_smooth, rest, lattice, blocks, rows, samples: LinearSamples::default() })
    }

    /// Holds the marked vertices at rest: the control points that move one are not parameters. Vertices near them move less than they
    /// would, or not at all.
    ///
    /// # Panics
    /// If there is not one mark per vertex.
    #[must_use]
    pub fn with_held(mut self, held: &[bool]) -> Self {
        assert_eq!(held.len(), self.rest.len(), "one mark per vertex");
        let mut at_rest = vec![false; self.lattice.control_points()];
        for v in (0..held.len()).filter(|v| held[*v]) {
            self.lattice.of(v as u32).filter(|(_, w)| *w > 0.0).for_each(|(k, _)| at_rest[k as usize] = true);
        }
        let mut free = 0..;
        self.blocks = at_rest.iter().map(|at_rest| if *at_rest { None } else { free.next() }).collect();
        self
    }

    /// Number of control points that are parameters.
    fn free_points(&self) -> usize {
        self.blocks.iter().flatten().count()
    }

    fn place(&mut self, x: &[f64]) {
        let blocks = &self.blocks;
        self.rows.place(|k| displacement(blocks, x, k));
    }
}

/// Of a control point.
fn displacement(blocks: &[Option<u32>], x: &[f64], k: u32) -> Vec3 {
    blocks[k as usize].map_or_else(Vec3::zeros, |block| parameters(x, block as usize))
}

impl DeformationModel for Ffd {
    fn name(&self) -> &'static str {
        "ffd"
    }

    fn vertex_count(&self) -> usize {
        self.rest.len()
    }

    fn parameter_len(&self) -> usize {
        3 * self.free_points()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        vec![0.0; self.parameter_len()]
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.rest.len(), "samples were made for another template");
        let block = |k: u32| self.blocks[k as usize];
        let rows: Vec<Vec<u32>> =
            self.rows.cliques().map(|row| row.iter().filter_map(|k| block(*k)).collect()).collect();
        let moved_by = |v: u32| self.lattice.of(v).filter_map(|(k, w)| Some((block(k)?, [w])));
        let rows = Assembly::pairs(rows.iter().map(Vec::as_slice));
        let structure = self.samples.analyse(samples, self.free_points(), moved_by, rows);
        self.rows.analyse(&structure, |k| block(k).map(|block| block as usize));
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        out.resize(self.rest.len(), Vec3::zeros());
        let (rest, lattice, blocks) = (&self.rest, &self.lattice, &self.blocks);
        out.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(v, p)| {
            *p = rest[v] + lattice.of(v as u32).map(|(k, w)| displacement(blocks, x, k) * w).sum::<Vec3>();
        });
    }

    fn pull_back(&mut self, _x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        self.samples.pull_back(field, equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        self.place(x);
        out.push(("lattice bending", self.lambda_smooth * self.rows.energy()));
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        self.place(x);
        self.rows.add_to(equations, self.lambda_smooth);
    }
}

impl RegistrationModel for Ffd {
    fn set_level(&mut self, options: &Options, _unit: f64) -> Result<(), OptionsError> {
        self.lambda_smooth = options.read::<SmoothLevel>()?.lambda_smooth;
        Ok(())
    }
}

pub(super) const MODEL: BuiltIn = BuiltIn::new::<LatticeOptions>("ffd", include_str!("schedules/ffd.toml"), |input| {
    let LatticeOptions { spacing } = input.options.read()?;
    let options = LatticeOptions { spacing: input.length(spacing) };
    Ok(Box::new(Ffd::new(input.rest, options, input.reference_vertices, 1.0)?))
})
.on_patch(&["smoothing", "nodes"], build_on_patch);

/// The lattice on a patch is this much finer at most than one with as many cells over the region as a graph has nodes.
const FINEST: i32 = 8;

/// As many cells over the region as a graph has nodes; finer where every control point would move a held vertex.
fn build_on_patch(input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
    let cells = input.nodes.min(input.moving.div_ceil(2)).max(1);
    let widest = (input.vertex_area * input.moving as f64 / cells as f64).sqrt();
    let area: f64 = face_areas(&input.mesh.positions, &input.mesh.triangles).iter().sum();
    // With this number of vertices E_smooth is that of the bi-Laplacian: lambda times a vertex' area times the integral.
    let vertices = (area / input.vertex_area).max(1.0);
    for finer in 0..=FINEST {
        let options = LatticeOptions { spacing: widest / 2f64.powi(finer) };
        let ffd = Ffd::new(input.mesh, options, vertices, input.gradient_weight().powi(2))?.with_held(input.held);
        if ffd.free_points() > 0 {
            return Ok(Box::new(ffd));
        }
    }
    Err(ModelError::Other("no lattice moves the region without what is held: it is too thin".to_owned()))
}
