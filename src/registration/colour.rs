//! The colour of a scan on the vertices of the registered template.
//!
//! An observed vertex takes the colour of the closest point of the scan: interpolated between the corners of the triangle; of a
//! point cloud, the mean of the six nearest points of the same side, point `j` at distance `r_j` with weight `(1 - r_j / r_7)^2`.
//!
//! All other vertices take the colours that make `sum over edges |c_i - c_j|^2` least: harmonic on the template, each the mean of
//! its neighbours, so that no colour lies outside of the range of those observed.
//!
//! Everything is mixed as light ([`srgb`](crate::mesh::srgb)), not as the numbers of files.

use std::sync::Arc;

use rayon::prelude::*;

use super::input::check_mask;
use super::{RegistrationError, RegistrationInput, WITHIN_MM};
use crate::correspondence::{ScanSurface, VertexMasks};
use crate::mesh::adjacency::{Components, EdgeGraph};
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::srgb::{from_light, to_light};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::linear::BorderedCholesky;
use crate::nlls::{BlockStructure, LinearSolver as _, NormalEquations};

/// The colour of parts of which the scan shows nothing: middle grey.
pub const UNSEEN_COLOR: [u8; 3] = [128; 3];

/// Cosine of the widest angle between the normals of a vertex and the scan.
const FACING: f64 = 0.5;
/// Points of a cloud whose colours are mixed.
const POINTS: usize = 6;

/// Colours of a registered template.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VertexColors {
    /// Red, green, blue per vertex, 0-255.
    pub colors: Vec<[u8; 3]>,
    /// Which vertices have theirs from the scan: where it has a surface within [`WITHIN_MM`] that faces the same way (60 degrees at
    /// most) and does not end there, and where the masks let it have a say. The others' are diffused from them over the template;
    /// parts without any are [`UNSEEN_COLOR`].
    pub observed: Vec<bool>,
}

impl VertexColors {
    /// How many vertices are observed.
    #[must_use]
    pub fn observed_count(&self) -> usize {
        self.observed.iter().filter(|o| **o).count()
    }
}

/// Colours the template, registered to `positions` in the scan's frame, by the scan, whose vertices have `colors`; `surface` is that
/// scan as it was registered ([`RegistrationResult::scan`](super::RegistrationResult::scan)). Colours are interpolated as light
/// ([`srgb`](crate::mesh::srgb)).
///
/// # Errors
/// When there is not one colour per scan vertex, the surface is that of another scan, the template's geometry cannot be used, or positions or
/// masks are not one per template vertex.
pub fn scan_colors(
    input: &RegistrationInput<'_>,
    surface: &ScanSurface,
    colors: &[[u8; 3]],
    positions: &[Vec3],
) -> Result<VertexColors, RegistrationError> {
    let (found, expected) = (colors.len(), input.scan.positions.len());
    if found != expected {
        let message = format!("found {found} colours for {expected} vertices, expected one each");
        return Err(RegistrationError::Scan(message));
    }
    if surface.vertex_count() != expected {
        return Err(RegistrationError::Scan("its surface is that of another scan".to_owned()));
    }
    let mut template = input.template.triangulate();
    if positions.len() != template.positions.len() {
        let (found, template) = (positions.len(), template.positions.len());
        return Err(RegistrationError::VertexCount { what: "result", found, template });
    }
    template.positions.copy_from_slice(positions);
    template.check_indices().map_err(|e| RegistrationError::Template(e.to_string()))?;
    input.scan.check_indices().map_err(|e| RegistrationError::Scan(e.to_string()))?;
    check_mask("mask", input.mask, positions.len())?;
    check_mask("free mask", input.free_mask, positions.len())?;
    let light: Vec<Vec3> = colors.iter().map(|&c| to_light(c)).collect();
    let masks = VertexMasks::new(input.mask, input.free_mask, vec![false; positions.len()]);
    let seen = observed(input, surface, &light, &template, &masks)?;
    let observed = seen.iter().map(Option::is_some).collect();
    let colors = diffused(&EdgeGraph::of(&template), seen);
    Ok(VertexColors { colors: colors.into_iter().map(|c| c.map_or(UNSEEN_COLOR, from_light)).collect(), observed })
}

/// The light that the scan shows at each vertex.
fn observed(
    input: &RegistrationInput<'_>,
    surface: &ScanSurface,
    light: &[Vec3],
    template: &TriangleMesh,
    masks: &VertexMasks,
) -> Result<Vec<Option<Vec3>>, RegistrationError> {
    let points = if input.scan.triangles.is_empty() { Some(CloudColors::new(input, surface, light)?) } else { None };
    let normals = vertex_normals(&template.positions, &template.triangles, NormalWeighting::Area);
    let at = |v: usize| {
        if masks.data[v] <= 0.0 {
            return None;
        }
        let hit = surface.closest_hit(template.positions[v], WITHIN_MM)?;
        if hit.normal.dot(&normals[v]) < FACING {
            return None;
        }
        match &points {
            Some(points) => Some(points.at(&hit.point, &hit.normal)),
            None => surface.mixed(&hit, light),
        }
    };
    Ok((0..template.positions.len()).into_par_iter().map(at).collect())
}

/// The points of a cloud that have a normal, and their light.
struct CloudColors {
    points: Vec<(Vec3, Vec3)>,
    tree: ClosestVertices,
}

impl CloudColors {
    fn new(input: &RegistrationInput<'_>, surface: &ScanSurface, light: &[Vec3]) -> Result<Self, RegistrationError> {
        let normals = input.scan_normals.unwrap_or_default();
        let directed = || (0..normals.len()).filter(|&i| normals[i].norm_squared() > 0.0);
        let places: Vec<Vec3> = directed().map(|i| input.scan.positions[i]).collect();
        let tree = ClosestVertices::new(&places).map_err(|e: MeshError| RegistrationError::Scan(e.to_string()))?;
        Ok(Self { points: directed().map(|i| (surface.facing(&normals[i]), light[i])).collect(), tree })
    }

    fn at(&self, p: &Vec3, normal: &Vec3) -> Vec3 {
        let mut near = Vec::new();
        self.tree.k_nearest(p, 2 * POINTS + 1, &mut near);
        let first = near.first().map(|n| n.vertex as usize);
        near.retain(|n| self.points[n.vertex as usize].0.dot(normal) > 0.0);
        let reach = near.get(POINTS).or(near.last()).map_or(0.0, |n| n.squared_distance.sqrt());
        let weight = |squared: f64| if reach > 0.0 { (1.0 - squared.sqrt() / reach).powi(2) } else { 0.0 };
        let weighted = near.iter().take(POINTS).map(|n| (weight(n.squared_distance), self.points[n.vertex as usize].1));
        let (total, sum) = weighted.fold((0.0, Vec3::zeros()), |(total, sum), (w, c)| (total + w, sum + c * w));
        if total > 0.0 { sum / total } else { first.map_or_else(Vec3::zeros, |i| self.points[i].1) }
    }
}

/// Fills in the harmonic light of vertices without any; `None` remains where no path leads to one that has.
fn diffused(edges: &EdgeGraph, mut light: Vec<Option<Vec3>>) -> Vec<Option<Vec3>> {
    let parts = edges.components();
    let mut known = vec![false; parts.count()];
    let part = |v: usize| parts.labels()[v];
    for v in (0..light.len()).filter(|&v| light[v].is_some() && part(v) != Components::UNREFERENCED) {
        known[part(v) as usize] = true;
    }
    let fill = |v: &usize| light[*v].is_none() && part(*v) != Components::UNREFERENCED && known[part(*v) as usize];
    let unknown: Vec<usize> = (0..light.len()).filter(fill).collect();
    let mut index = vec![None; light.len()];
    unknown.iter().enumerate().for_each(|(k, &v)| index[v] = Some(k));
    let neighbours = |k: usize| edges.neighbours(unknown[k]).iter().map(|&w| w as usize);
    let pairs = (0..unknown.len()).flat_map(|k| neighbours(k).filter_map(|w| index[w]).map(move |l| (k, l)));
    let structure = BlockStructure::new(&vec![1; unknown.len()], pairs, 0).expect("proven: pairs are of these blocks");
    let structure = Arc::new(structure);
    let mut equations = NormalEquations::new(structure.clone());
    for k in 0..unknown.len() {
        let diagonal = structure.slot(k, k).expect("proven: diagonal blocks are always there");
        equations.block_mut(diagonal)[0] = neighbours(k).count() as f64;
        for l in neighbours(k).filter_map(|w| index[w]).filter(|&l| l < k) {
            let slot = structure.slot(k, l).expect("proven: every pair of neighbours has a block");
            equations.block_mut(slot)[0] = -1.0;
        }
    }
    let mut solver = BorderedCholesky::new(&structure);
    let mut channel = vec![0.0; unknown.len()];
    let mut found = vec![Vec3::zeros(); unknown.len()];
    for axis in 0..3 {
        for k in 0..unknown.len() {
            equations.gradient[k] = -neighbours(k).filter_map(|w| light[w]).map(|c| c[axis]).sum::<f64>();
        }
        // Each part has a vertex with light beside those without, so the matrix is positive definite.
        solver.solve(&equations, &[], &mut channel).expect("proven: a grounded graph Laplacian is positive definite");
        found.iter_mut().zip(&channel).for_each(|(c, x)| c[axis] = *x);
    }
    unknown.iter().zip(found).for_each(|(&v, c)| light[v] = Some(c));
    light
}
